"""Outputs: what a user sees of a motion.

All outputs but stresses are functions of the frames of some nodes, whichever model moved them: ``(x, y, phi)`` in the
plane, and in space position, directors and the rigid coordinates, which say how often a joint has turned. Stresses
depend on what else a model knows of a body, and on parameters; each model evaluates them in its own way
(`models.stresses`), and they stand behind the frames in what it observes. A deformation is the
position less that of the rigid mechanism at the same measured coordinates, e.g. the same rotation of the hinge node,
which in a free-free basis is not theta itself. It is not a number (NaN) where a measured coordinate is far outside a
limited range, because the rigid mechanism may not exist there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.connection import Connection
from pgmp_petsc.mechanism.joint_turns import JointTurns
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.mechanism.statements import Statement, along, distance
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene

if TYPE_CHECKING:
    from pgmp_petsc.outputs.stress import StressOutput

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
    n_frame
        Numbers of a frame: 3 in the plane, in space 12 and the coordinates.
    functions
        From frames to the values of an output, each of shape (n,); None of a stress.
    stresses
        Stress outputs, in the order in which models observe them.
    reached
        From frames to where the coordinates are within their ranges, shape (n,); None where all outputs are known
        everywhere: none is a deformation, or every coordinate is periodic.
    """

    nodes: tuple[int, ...]
    units: dict[str, str]
    n_frame: int
    functions: dict[str, Callable[[Frames], np.ndarray] | None]
    stresses: tuple[StressOutput, ...] = ()
    reached: Callable[[Frames], np.ndarray] | None = None

    def observed(self, frames: np.ndarray, stresses: np.ndarray) -> np.ndarray:
        """Return what `evaluate` takes, shape (n_observed, n), of frames of `nodes` (n_nodes, n_frame, n) and stresses
        (n_stresses, n)."""
        return np.concatenate([frames.reshape(len(self.nodes) * self.n_frame, stresses.shape[1]), stresses])

    def evaluate(self, observed: np.ndarray) -> dict[str, np.ndarray]:
        """Return the outputs, each of shape (n,), for what a model observes, shape (n_observed, n)."""
        by_node = self._by_node(observed)
        of_stresses = dict(zip((stress.name for stress in self.stresses), observed[len(self.nodes) * self.n_frame :]))
        return {
            name: of_stresses[name] if function is None else function(by_node)
            for name, function in self.functions.items()
        }

    def left_range(self, observed: np.ndarray) -> np.ndarray:
        """Return where a coordinate is outside the range that a deformation is known in, shape (n,), for what a model
        observes, shape (n_observed, n)."""
        if self.reached is None:
            return np.zeros(observed.shape[1], dtype=bool)
        return ~self.reached(self._by_node(observed))

    def _by_node(self, observed: np.ndarray) -> Frames:
        n_rows = len(self.nodes) * self.n_frame
        return dict(zip(self.nodes, observed[:n_rows].reshape(len(self.nodes), self.n_frame, observed.shape[1])))

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
            If an output names a point that the mesh does not have, or a stress that is not known there.
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
        functions, units, stresses = {}, {}, []
        for name, entry in scene.outputs.items():
            if entry.type == "stress":
                stresses.append(_stress(name, scene, kinematics))
                functions[name], units[name] = None, stresses[-1].unit
                nodes |= _nodes_of_beams(kinematics.mechanism.bodies[stresses[-1].body])
                continue
            function, needed, unit = makers[entry.type](f"outputs.{name}", entry, start, kinematics)
            functions[name], units[name] = function, unit
            nodes |= needed
        mechanism = kinematics.mechanism
        n_frame = mechanism.space.n_pose + (len(mechanism.coordinates) if mechanism.space is SPATIAL else 0)
        reached = None
        limited = not all(coordinate.periodic for coordinate in mechanism.coordinates)
        if limited and any(entry.type == "deformation" for entry in scene.outputs.values()):
            measured, _ = measured_coordinates(kinematics)

            def reached(frames: Frames) -> np.ndarray:
                return within_reach(kinematics, measured(frames))

        return cls(tuple(sorted(nodes)), units, n_frame, functions, tuple(stresses), reached)


def _stress(name: str, scene: Scene, kinematics: RigidKinematics) -> StressOutput:
    from pgmp_petsc.outputs.stress import StressOutput  # few scenes have them

    bodies = kinematics.mechanism.bodies
    number = next(k for k, body in enumerate(bodies) if body.name == scene.outputs[name].body)
    return StressOutput.of(name, scene, number, bodies[number])


def _nodes_of_beams(body: Body) -> set[int]:
    """Return the nodes of a body of beams, whose frames say all of its strains."""
    return set(range(body.nodes.start, body.nodes.stop)) if body.is_beam else set()


def _frame(side: Attachment, frames: Frames, n: int) -> np.ndarray:
    return side.ground_frame((n,)) if side.on_ground else side.frame_of(frames[side.node])


def joint_angle(
    connection: Connection, kinematics: RigidKinematics, start: np.ndarray | None = None
) -> tuple[Callable[[Frames], np.ndarray], set[int]]:
    """Return the relative rotation b - a of a joint, which counts turns.

    In space that of a coordinate is near the coordinate, that of another joint in (-pi, pi] at the start, coordinates
    (n_theta,); see `JointTurns`.
    """
    space = kinematics.mechanism.space
    nodes = {side.node for side in (connection.a, connection.b) if not side.on_ground}
    start = np.zeros(kinematics.n_coordinates) if start is None else start
    turns = JointTurns.of(connection, kinematics, start) if space is SPATIAL else None

    def angle(frames: Frames) -> np.ndarray:
        first = next(frames[node] for node in nodes)
        near = 0.0 if turns is None else turns.near(first[SPATIAL.n_pose :])
        return space.angle(connection.angle, *(_frame(side, frames, first.shape[1]) for side in connection.sides), near)

    return angle, nodes


def measured_coordinates(kinematics: RigidKinematics) -> tuple[Callable[[Frames], np.ndarray], set[int]]:
    """Return the coordinates as the joints have them, from frames to shape (n, n_theta), rad."""
    measures = [joint_angle(coordinate.connection, kinematics) for coordinate in kinematics.coordinates]
    nodes = set().union(*(needed for _, needed in measures))
    return lambda frames: np.stack([angle(frames) for angle, _ in measures], axis=1), nodes


def within_reach(kinematics: RigidKinematics, measured: np.ndarray) -> np.ndarray:
    """Return where the rigid mechanism can be placed at measured coordinates (n, n_theta), shape (n,)."""
    return kinematics.within_reach(measured).reshape(len(measured))


def _angle(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    return *joint_angle(kinematics.mechanism.connection(entry.joint), kinematics, start), "rad"


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


def _deformation(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    point, axis = kinematics.mechanism.attachment(entry.point, f"{name}.point"), AXES[entry.axis]
    coordinates, nodes = measured_coordinates(kinematics)

    def deformation(frames: Frames) -> np.ndarray:
        measured = coordinates(frames)
        values = np.full(len(measured), np.nan)
        inside = within_reach(kinematics, measured)
        poses = poses_where_closed(kinematics, measured[inside])
        d = kinematics.mechanism.space.dimension
        moved = point.frame_of(frames[point.node])[:d, inside] - point.frame_of_pose(poses)[:d]
        if entry.frame == "body":
            moved = kinematics.mechanism.space.to_body(poses[point.body], moved)
        values[inside] = moved[axis]
        return values

    return deformation, {point.node} | nodes, "m"
