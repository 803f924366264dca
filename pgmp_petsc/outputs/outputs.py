"""Outputs: what a user sees of a motion.

All outputs are functions of the frames of some nodes, whichever model moved them: ``(x, y, phi)`` in the plane, and in
space position, directors and the rigid coordinates, which say how often a joint has turned. A deformation is the
position less that of the rigid mechanism at the same measured coordinates, e.g. the same rotation of the hinge node,
which in a free-free basis is not theta itself. It is not a number (NaN) where a measured coordinate is far outside a
limited range, because the rigid mechanism may not exist there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.mechanism.statements import Statement, along, distance
from pgmp_petsc.scene import Scene

AXES = {"x": 0, "y": 1, "z": 2}
Frames = dict[int, np.ndarray]  # node -> frame, shape (n_frame, n)


@dataclass(frozen=True)
class OutputSet:
    """The outputs of a scene.

    Attributes
    ----------
    nodes
        Global node numbers whose frames are needed, increasing.
    units
        Unit of every output.
    functions
        From frames to the values of an output, each of shape (n,).
    """

    nodes: tuple[int, ...]
    units: dict[str, str]
    functions: dict[str, Callable[[Frames], np.ndarray]]

    def evaluate(self, frames: np.ndarray) -> dict[str, np.ndarray]:
        """Return the outputs, each of shape (n,), for frames of `nodes`, shape (n_nodes, 3, n)."""
        by_node = dict(zip(self.nodes, frames))
        return {name: function(by_node) for name, function in self.functions.items()}

    @classmethod
    def of(cls, scene: Scene, kinematics: RigidKinematics, start: np.ndarray | None = None) -> OutputSet:
        """Prepare the outputs of a scene.

        Parameters
        ----------
        start
            Coordinates at the start, shape (n_theta,), rad; by default what the scene says of those that are not
            prescribed.

        Raises
        ------
        InputError
            If an output names a point that the mesh does not have.
        """
        makers = {
            "angle": _angle,
            "sliding": _sliding,
            "distance": _distance,
            "rotation": _rotation,
            "position": _position,
            "displacement": _displacement,
            "deformation": _deformation,
        }
        if start is None:
            start = np.array([scene.initial_state(c.name).position for c in kinematics.mechanism.coordinates])
        nodes: set[int] = set()
        functions, units = {}, {}
        for name, entry in scene.outputs.items():
            function, needed, unit = makers[entry.type](f"outputs.{name}", entry, start, kinematics)
            functions[name], units[name] = function, unit
            nodes |= needed
        return cls(tuple(sorted(nodes)), units, functions)


def _frame(side: Attachment, frames: Frames, n: int) -> np.ndarray:
    return side.ground_frame((n,)) if side.on_ground else side.frame_of(frames[side.node])


def joint_angle(connection, kinematics: RigidKinematics) -> tuple[Callable[[Frames], np.ndarray], set[int]]:
    """Return the relative rotation b - a of a joint.

    In space a joint that is a coordinate counts its turns as the coordinate does; another one is in (-pi, pi].
    """
    numbers = [k for k, c in enumerate(kinematics.coordinates) if c.connection is connection]
    space = kinematics.mechanism.space
    nodes = {side.node for side in (connection.a, connection.b) if not side.on_ground}

    def angle(frames: Frames) -> np.ndarray:
        first = next(frames[node] for node in nodes)
        n = first.shape[1]
        turned = first[SPATIAL.n_pose + numbers[0]] if space is SPATIAL and numbers else 0.0
        return space.angle(connection.angle, *(_frame(side, frames, n) for side in connection.sides), turned)

    return angle, nodes


def _angle(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    return *joint_angle(kinematics.mechanism.connection(entry.joint), kinematics), "rad"


def _sliding(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    connection = kinematics.mechanism.connection(entry.joint)
    axis = np.array(kinematics.mechanism.scene.joints[entry.joint].axes[0])
    return *_measured(along(axis), connection.sides, kinematics), "m"


def _distance(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    sides = tuple(kinematics.mechanism.attachment(point, f"{name}.points") for point in entry.points)
    return *_measured(distance(kinematics.mechanism.space.dimension), sides, kinematics), "m"


def _measured(
    statement: Statement, sides: tuple[Attachment, Attachment], kinematics: RigidKinematics
) -> tuple[Callable[[Frames], np.ndarray], set[int]]:
    """Return the value of a statement about two attachments."""
    nodes, natural = {side.node for side in sides if not side.on_ground}, kinematics.mechanism.space.natural

    def value(frames: Frames) -> np.ndarray:
        n = next(frames[node] for node in nodes).shape[1]
        return statement.value(*(natural(_frame(side, frames, n)) for side in sides))

    return value, nodes


def _rotation(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    point = kinematics.mechanism.attachment(entry.point, f"{name}.point")
    return lambda frames: frames[point.node][2], {point.node}, "rad"


def _position(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    point, axis = kinematics.mechanism.attachment(entry.point, f"{name}.point"), AXES[entry.axis]
    return lambda frames: point.frame_of(frames[point.node])[axis], {point.node}, "m"


def _displacement(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    point, axis = kinematics.mechanism.attachment(entry.point, f"{name}.point"), AXES[entry.axis]
    origin = point.frame_of_pose(kinematics.poses(start[None]))[axis, 0]
    return lambda frames: point.frame_of(frames[point.node])[axis] - origin, {point.node}, "m"


def _deformation(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    point, axis = kinematics.mechanism.attachment(entry.point, f"{name}.point"), AXES[entry.axis]
    measures = [joint_angle(coordinate.connection, kinematics) for coordinate in kinematics.mechanism.coordinates]

    def deformation(frames: Frames) -> np.ndarray:
        measured = np.stack([angle(frames) for angle, _ in measures], axis=1)
        values = np.full(len(measured), np.nan)
        inside = kinematics.within_reach(measured).reshape(len(measured))
        poses = kinematics.poses(measured[inside])
        d = kinematics.mechanism.space.dimension
        moved = point.frame_of(frames[point.node])[:d, inside] - point.frame_of_pose(poses)[:d]
        if entry.frame == "body":
            moved = kinematics.mechanism.space.to_body(poses[point.body], moved)
        values[inside] = moved[axis]
        return values

    return deformation, {point.node}.union(*(needed for _, needed in measures)), "m"
