"""Constraints of joints: statements about two frames that are to be zero, and the connections that they make.

Where joints and effects hold: a point of a body, seen as a frame, or a point of the ground.

A frame is given as a pose is (`space`): ``(x, y, phi)`` in the plane, position and directors in space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from pgmp_petsc.bodies.affine import AffineSum
from pgmp_petsc.mechanism.space import Space, space_of
from pgmp_petsc.mechanism.statements import (
    IDENTITY,
    MEET,
    Combination,
    Function,
    Statement,
    along,
    angle,
    bulging,
    fading,
    meet,
    perpendicular,
)


@dataclass(frozen=True, eq=False)
class Attachment:
    """A point of a body or of the ground."""

    body: int  # index of the body, or -1 for the ground
    node: int  # global number of the node that carries it, or -1 for the ground
    point: np.ndarray  # coordinates in the body's (or the ground's) frame, shape (d,), m
    #: from the node to the point, in the body's frame, shape (d,), m: zero but for rigid bodies, whose only node is
    #: their centre of mass
    arm: np.ndarray

    @classmethod
    def on_ground_at(cls, point: np.ndarray) -> Attachment:
        """Return a point (d,) of the ground."""
        return cls(-1, -1, point, np.zeros(len(point)))

    @property
    def space(self) -> Space:
        return space_of(len(self.point))

    @property
    def on_ground(self) -> bool:
        return self.body < 0

    @cached_property
    def at_node(self) -> bool:
        """Whether the point is the node itself."""
        return not self.arm.any()

    @property
    def dofs(self) -> np.ndarray:
        """The node's unknowns, shape (3,), in space (6,)."""
        return self.space.n_dofs * self.node + np.arange(self.space.n_dofs)

    def on_pose(self) -> Attachment:
        """Return the same point with the pose of its body as its node."""
        return self if self.on_ground else Attachment(self.body, self.body, self.point, self.point)

    def frame_of(self, node_frame: np.ndarray) -> np.ndarray:
        """Return the frame (n_pose or more, ...) from that of the node; what follows it is kept."""
        if self.at_node:
            return node_frame
        frame, n = node_frame.copy(), self.space.n_pose
        frame[:n] = self.space.place(node_frame[:n], self.arm[None])[0]
        return frame

    def natural_jet(self, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return position and directors (d (d + 1), n), with as many derivatives over time as there are of the frame of
        the node, (n_pose or more, n) each."""
        d, (frame, *changes) = self.space.dimension, parts
        z = self.space.natural(self.frame_of(frame))
        found = [z]
        for order, change in enumerate(changes, start=1):
            if d == 2:  # a director turns to the other one, and that back
                ahead, across = z[2:4], z[4:6]
                turned = [change[2] * across, -change[2] * ahead]
                if order == 2:
                    turned = [part - changes[0][2] ** 2 * axis for part, axis in zip(turned, (ahead, across))]
                change = np.concatenate([change[:2], *turned])
            else:
                change = change.copy()
            if not self.at_node:
                change[:d] += np.einsum("j,jcn->cn", self.arm, change[d:].reshape(d, d, -1))
            found.append(change)
        return found

    def frame_of_pose(self, poses: np.ndarray) -> np.ndarray:
        """Return the frame (n_pose, ...) from rigid poses of shape (n_bodies, n_pose, ...)."""
        if self.on_ground:
            return self.ground_frame(poses.shape[2:])
        return self.space.place(poses[self.body], self.point[None])[0]

    def ground_frame(self, trailing: tuple[int, ...]) -> np.ndarray:
        """Return the frame of a point of the ground, shape (n_pose, *trailing)."""
        frame = self.space.identity.copy()
        frame[: self.point.size] = self.point
        return np.multiply.outer(frame, np.ones(trailing))


#: A statement, or a combination of several, with the attachments that it is about, a pair for each term.
Attached = tuple[Statement | Combination, tuple[Attachment, ...]]


def meeting(dimension: int) -> list[Statement]:
    """Return that two points share their position."""
    return [meet(axis) for axis in np.eye(dimension)]


def guided(in_a: np.ndarray) -> list[Statement]:
    """Return that a point is on the line along the first axis of a triad (d, d) in a, one axis a column."""
    return [along(axis) for axis in in_a.T[1:]]


def aligned(in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
    """Return that the first axes of triads (3, 3) in a and in b have one direction."""
    return [perpendicular(in_a[:, k], in_b[:, 0]) for k in (1, 2)]


def parallel(in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
    """Return that triads (d, d) in a and in b have the same directions."""
    if len(in_a) == 2:
        return [perpendicular(in_a[:, 0], in_b[:, 1])]
    return [*aligned(in_a, in_b), perpendicular(in_a[:, 1], in_b[:, 2])]


def weld(in_a: np.ndarray, in_b: np.ndarray) -> list[Statement]:
    """Return that two points share their position, and triads (d, d) in a and in b their directions."""
    return [*meeting(len(in_a)), *parallel(in_a, in_b)]


def ridden(in_a: np.ndarray, in_b: np.ndarray, run: Sequence[Attachment], b: Attachment) -> list[Attached]:
    """Return that b, which rides on them, is on the bent line through the nodes of a run, in its order, with the sides.

    Hermite's interpolation between nodes at X_i with directors t_i, n_i has the deflection ``sum_i H_i w_i + G_i w'_i``
    with local weights. With ``xi_i = t_i . (p_b - p_i)``, which is how far b is from a node along it, and the slopes
    ``w'_i = t_i . n_b``, so that a rigid motion of all does not count, b is on it where, for each normal n,

        sum_i  H(xi_i) n_i . (p_b - p_i) + K(xi_i) t_i . n_b = 0,    K(xi) = xi H(xi) - G(xi),

    to the second order in what the nodes are turned (docs/effects.md, what travels along a beam). Of the triads (d, d)
    in both frames, one axis a column, the first axis is along the line.
    """
    way, found = in_a[:, 0], []
    places = np.array([side.point @ way for side in run])
    for normal, same in zip(in_a.T[1:], in_b.T[1:]):
        terms, sides = [], []
        for k, side in enumerate(run):
            reaches = [places[other] - places[k] for other in (k + 1, k - 1) if 0 <= other < len(run)]
            own = [(fading(reach * way, normal), IDENTITY) for reach in reaches]
            own += [(bulging(reach * way, way, same), Function(reach)) for reach in reaches]
            if len(reaches) == 2:  # each weight is 1 on the other's side
                own.append((along(normal), Function(-1.0)))
            terms += own
            sides += len(own) * [side, b]
        found.append((Combination(tuple(terms)), tuple(sides)))
    return found


def about(statements: Sequence[Statement | Combination], *sides: Attachment) -> tuple[Attached, ...]:
    """Return statements about two attachments with these as the sides of each of their terms."""
    return tuple((part, len(part.terms) * sides) for part in statements)


def share_position(statements: Sequence[Statement | Combination]) -> bool:
    """Return whether the points of two frames meet where such statements are zero."""
    meeting = [part for part in statements if isinstance(part, Statement) and part.kind == MEET]
    return bool(meeting) and len(meeting) == meeting[0].axes.shape[1]


def triad(axis: np.ndarray, second: np.ndarray | None = None) -> np.ndarray:
    """Return orthonormal axes (d, d), one a column: the first along an axis, in space the second nearest to another
    direction."""
    first = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    if first.size == 2:
        return np.array([[first[0], -first[1]], [first[1], first[0]]])
    if second is None:
        second = np.eye(3)[np.argmin(np.abs(first))]
    second = second - first * (first @ second)
    second = second / np.linalg.norm(second)
    return np.column_stack([first, second, np.cross(first, second)])


@dataclass(frozen=True, eq=False)
class Release:
    """A direction that a joint holds in the configuration, and releases in the motion."""

    statement: Statement  # what is measured along or about it
    key: str  # the entry of its stiffness, ``stiffness`` or ``turning_stiffness``
    axis: int  # the number of its axis
    #: the statement without force, m or rad: in the configuration, and by how much the joint is off
    rest: AffineSum = AffineSum(())


@dataclass(frozen=True, eq=False)
class Connection:
    """A named joint between two attachments, and the rows of its constraints."""

    name: str
    #: what is zero in the configuration; joints whose points share their position begin with that
    statements: tuple[Statement | Combination, ...]
    a: Attachment
    b: Attachment
    rows: slice  # of these, among those of all joints
    #: the axes that it turns about and slides along, the first of triads in the frames of a and of b, shape (d, d)
    #: each, one axis a column
    axes: tuple[np.ndarray, np.ndarray]
    #: what is zero in the motion, with its sides: about a where the joint is, if it is off, or along a beam
    held: tuple[Attached, ...]
    released: tuple[Release, ...]  # directions that are held in the configuration alone
    #: what would be zero in the motion if it were where it should be; None if it is
    level: tuple[Attached, ...] | None = None

    @property
    def sides(self) -> tuple[Attachment, Attachment]:
        return self.a, self.b

    def holding(self, moving: bool = False) -> list[Attached]:
        """Return what is zero in the configuration, or in the motion too, with its sides."""
        return list(self.held if moving else about(self.statements, *self.sides))

    @property
    def straight(self) -> Connection:
        """The joint where it should be, if it is off."""
        return self if self.level is None else replace(self, held=self.level, level=None)

    def measure(self, motion: str) -> Statement:
        """Return what measures ``turning`` or ``sliding``."""
        return {"turning": self.angle, "sliding": self.way}[motion]

    def motion(self, motion: str) -> dict[str, Any]:
        """Return what measures a motion and both attachments, as `effects.action.Action` takes them."""
        return {"statement": self.measure(motion), "a": self.a, "b": self.b}

    @cached_property
    def angle(self) -> Statement:
        """How far b is turned against a about the joint's axis; in the plane from where both bodies are parallel, in
        space from where they are assembled."""
        return angle(*self.axes)

    @cached_property
    def way(self) -> Statement:
        """How far b is from a along the joint's line."""
        return along(self.axes[0][:, 0])


@dataclass(frozen=True, eq=False)
class Coupling:
    """A named joint that couples the motions of others: a combination of what measures these, which keeps a value."""

    name: str
    combination: Combination
    sides: tuple[Attachment, ...]  # of the statements, a pair for each
    value: float  # that the combination keeps
    rows: slice
    elastic: bool  # whether it does so in the configuration alone

    def holding(self, moving: bool = False) -> list[Attached]:
        """Return what has its value in the configuration, or in the motion too, with its sides."""
        return [] if moving and self.elastic else [(self.combination, self.sides)]
