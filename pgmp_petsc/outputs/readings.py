"""Readings of frames for outputs: a statement about two points, a place, a rotation, or a place from that of the rigid
mechanism. Of all but the last there are rates too. The same readings are evaluated here and in models in C
(`c_export.statements`).

Frames are ``(x, y, phi)`` in the plane, and in space position, directors and the rigid coordinates, which say how often
a joint has turned. A deformation is the position less that of the rigid mechanism at the same measured coordinates,
e.g. the same rotation of the hinge node, which in a free-free basis is not theta itself. It is not a number (NaN) where
a measured coordinate is far outside a limited range, because the rigid mechanism may not exist there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.joint_turns import JointTurns
from pgmp_petsc.mechanism.joints import Connection
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Coordinate
from pgmp_petsc.mechanism.space import SPATIAL, Space
from pgmp_petsc.mechanism.statements import ANGLE, Statement

AXES = {"x": 0, "y": 1, "z": 2}
Frames = dict[int, np.ndarray]  # node -> frame, shape (n_frame, n)


@dataclass(frozen=True, eq=False)
class Reading:
    """A number that is read of frames."""

    #: ``MEASURE`` of a statement, ``POSITION`` of a point along an axis, ``ROTATION`` of its node in the plane, or
    #: ``DEFORMATION``: the position from that in the rigid mechanism
    kind: Literal["MEASURE", "POSITION", "ROTATION", "DEFORMATION"]
    sides: tuple[Attachment, ...]  # the attachments: two of a statement, else the point
    statement: Statement | None = None  # of a measure
    space: Space = SPATIAL  # of the mechanism
    turns: JointTurns | None = None  # what an angle in space is near to; None of other readings
    #: axis, origin: of a position: its number, and what counts as zero, m
    axis: int = 0
    origin: float = 0.0
    in_body: bool = False  # whether the axis of a deformation is one of the body
    of_coordinates: frozenset[int] = frozenset()  # nodes that the rigid mechanism of a deformation is measured at
    rate: bool = False  # whether it is how fast the number changes

    @classmethod
    def of_coordinate(cls, coordinate: Coordinate, kinematics: RigidKinematics) -> Self:
        """Return what measures a coordinate."""
        if coordinate.turns:
            return cls.of_angle(coordinate.connection, kinematics)
        return cls("MEASURE", coordinate.sides, coordinate.statement, kinematics.mechanism.space)

    @classmethod
    def of_angle(cls, connection: Connection, kinematics: RigidKinematics, start: np.ndarray | None = None) -> Self:
        """Return the relative rotation b - a of a joint, which counts turns.

        In space that of a coordinate is near the coordinate, that of another joint in (-pi, pi] at the start,
        coordinates (n_theta,); see `JointTurns`.
        """
        space = kinematics.mechanism.space
        start = np.zeros(kinematics.n_coordinates) if start is None else start
        turns = JointTurns.of(connection, kinematics, start) if space is SPATIAL else None
        return cls("MEASURE", connection.sides, connection.angle, space, turns)

    @classmethod
    def at_point(
        cls, kind: Literal["POSITION", "ROTATION", "DEFORMATION"], point: str, name: str, kinematics: RigidKinematics,
        axis: int = 0,
    ) -> Self:  # fmt: skip
        """Return what is read of ``"body:point"``; `name` is the output's, for messages."""
        mechanism = kinematics.mechanism
        return cls(kind, (mechanism.attachment(point, f"{name}.point"),), space=mechanism.space, axis=axis)

    @property
    def nodes(self) -> set[int]:
        """The nodes whose frames are read."""
        return {side.node for side in self.sides if not side.on_ground} | self.of_coordinates

    def value(self, frames: Frames, rigid: np.ndarray | None = None, rates: Frames | None = None) -> np.ndarray:
        """Return the number, shape (n,), for frames, poses of the rigid mechanism (n_bodies, n_pose, n), and rates of
        frames."""
        if self.rate:
            if self.kind == "ROTATION":
                return rates[self.sides[0].node][2]
            moving = [self._moving(side, frames, rates) for side in self.sides]
            if self.kind == "POSITION":
                return moving[0][1][self.axis]
            gradient = self.statement.gradient(*(z for z, _ in moving))
            return np.einsum("cn,cn->n", gradient, np.concatenate([change for _, change in moving]))
        if self.kind == "MEASURE":
            return self._measure(frames)
        (point,) = self.sides
        if self.kind == "ROTATION":
            return frames[point.node][2]
        frame = point.frame_of(frames[point.node])
        if self.kind == "POSITION":
            return frame[self.axis] - self.origin if self.origin else frame[self.axis]
        d = self.space.dimension
        moved = frame[:d] - point.frame_of_pose(rigid)[:d]
        return self.space.to_body(rigid[point.body], moved)[self.axis] if self.in_body else moved[self.axis]

    def _measure(self, frames: Frames) -> np.ndarray:
        first = next(frames[side.node] for side in self.sides if not side.on_ground)
        sides = [
            side.ground_frame(first.shape[1:]) if side.on_ground else side.frame_of(frames[side.node])
            for side in self.sides
        ]
        if self.statement.kind == ANGLE:
            near = 0.0 if self.turns is None else self.turns.near(first[SPATIAL.n_pose :])
            return self.space.angle(self.statement, *sides, near)
        return self.statement.value(*map(self.space.natural, sides))

    def _moving(self, side: Attachment, frames: Frames, rates: Frames) -> tuple[np.ndarray, np.ndarray]:
        """Return position and directors of an attachment, and their rates, both (n_natural, n)."""
        d = self.space.dimension
        if side.on_ground:
            z = self.space.natural(side.ground_frame(next(iter(frames.values())).shape[1:]))
            return z, np.zeros_like(z)
        frame, rate = frames[side.node], rates[side.node]
        z = self.space.natural(side.frame_of(frame))
        # in the plane a director turns to the other one, and that back
        change = rate.copy() if d == 3 else np.concatenate([rate[:2], rate[2] * z[4:6], -rate[2] * z[2:4]])
        change[:d] += np.einsum("j,jcn->cn", side.arm, change[d:].reshape(d, d, -1))
        return z, change


class RigidReference:
    """The rigid mechanism at the coordinates that joints of the flexible one have.

    Attributes
    ----------
    nodes
        Global numbers of the nodes that joints are measured at.
    """

    def __init__(self, kinematics: RigidKinematics) -> None:
        self._kinematics = kinematics
        self._angles = [Reading.of_coordinate(coordinate, kinematics) for coordinate in kinematics.coordinates]
        self.nodes = frozenset().union(*(angle.nodes for angle in self._angles))

    def reached(self, frames: Frames) -> np.ndarray:
        """Return where it can be placed, shape (n,)."""
        return self._reached(self._measured(frames))

    def poses(self, frames: Frames) -> np.ndarray:
        """Return its poses (n_bodies, n_pose, n), not a number where it cannot be placed."""
        return self._poses(self._measured(frames))

    def near(self, frames: Frames) -> Callable[[Frames], np.ndarray]:
        """Return what gives its poses for frames next to these, for central differences."""
        measured = self._measured(frames)
        poses = self._kinematics.near(measured, self._poses(measured))
        return lambda beside: poses(self._measured(beside))

    def _measured(self, frames: Frames) -> np.ndarray:
        return np.stack([angle.value(frames) for angle in self._angles], axis=1)

    def _reached(self, measured: np.ndarray) -> np.ndarray:
        return self._kinematics.within_reach(measured).reshape(len(measured))

    def _poses(self, measured: np.ndarray) -> np.ndarray:
        inside = self._reached(measured)
        if inside.all():
            return poses_where_closed(self._kinematics, measured)
        mechanism = self._kinematics.mechanism
        poses = np.full((len(mechanism.bodies), mechanism.space.n_pose, len(measured)), np.nan)
        poses[..., inside] = poses_where_closed(self._kinematics, measured[inside])
        return poses


def poses_where_closed(kinematics: RigidKinematics, theta: np.ndarray) -> np.ndarray:
    """Return rigid poses (n_bodies, n_pose, n) at configurations (n, n_theta), not a number where loops cannot close.

    Over more than two coordinates nobody has followed the range, and a flexible mechanism goes where the rigid one
    cannot.
    """
    try:
        return kinematics.poses(theta)
    except InputError:
        if len(theta) > 1:
            return np.concatenate([poses_where_closed(kinematics, half) for half in np.array_split(theta, 2)], axis=2)
        return np.full((len(kinematics.mechanism.bodies), kinematics.mechanism.space.n_pose, 1), np.nan)
