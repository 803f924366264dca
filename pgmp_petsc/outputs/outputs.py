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
from pgmp_petsc.mechanism.joint_turns import JointTurns
from pgmp_petsc.mechanism.joints import Connection
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.mechanism.statements import Statement, along, distance
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.unit_systems import SI, unit_system

if TYPE_CHECKING:
    from pgmp_petsc.outputs.stress import StressOutput

AXES = {"x": 0, "y": 1, "z": 2}
Frames = dict[int, np.ndarray]  # node -> frame, shape (n_frame, n)
# of frames and poses of the rigid mechanism (n_bodies, n_pose, n), None where no output asks for them
Function = Callable[[Frames, np.ndarray | None], np.ndarray]


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
        From frames and `rigid` poses to the values of an output, each of shape (n,); None of a stress.
    stresses
        Stress outputs, in the order in which models observe them.
    reached
        From frames to where the coordinates are within their ranges, shape (n,); None where all outputs are known
        everywhere: none is a deformation, or every coordinate is periodic.
    rigid
        The rigid mechanism that deformations are taken from; None where there are none.
    """

    nodes: tuple[int, ...]
    units: dict[str, str]
    n_frame: int
    functions: dict[str, Function | None]
    stresses: tuple[StressOutput, ...] = ()
    reached: Callable[[Frames], np.ndarray] | None = None
    rigid: RigidReference | None = None

    def observed(self, frames: np.ndarray, stresses: np.ndarray) -> np.ndarray:
        """Return what `evaluate` takes, shape (n_observed, n), of frames of `nodes` (n_nodes, n_frame, n) and stresses
        (n_stresses, n)."""
        return np.concatenate([frames.reshape(len(self.nodes) * self.n_frame, stresses.shape[1]), stresses])

    def evaluate(self, observed: np.ndarray) -> dict[str, np.ndarray]:
        """Return the outputs, each of shape (n,), for what a model observes, shape (n_observed, n)."""
        return self._evaluated(observed, self.rigid and self.rigid.poses)

    def near(self, observed: np.ndarray) -> Callable[[np.ndarray], dict[str, np.ndarray]]:
        """Return `evaluate` for what is observed there and next to it, for central differences; see
        `RigidKinematics.near`."""
        poses = self.rigid and self.rigid.near(self._by_node(observed))
        return lambda beside: self._evaluated(beside, poses)

    def _evaluated(self, observed: np.ndarray, poses: Callable[[Frames], np.ndarray] | None) -> dict[str, np.ndarray]:
        by_node = self._by_node(observed)
        rigid = poses and poses(by_node)
        of_stresses = dict(zip((stress.name for stress in self.stresses), observed[len(self.nodes) * self.n_frame :]))
        return {
            name: of_stresses[name] if function is None else function(by_node, rigid)
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
        rigid = reached = None
        if any(entry.type == "deformation" for entry in scene.outputs.values()):
            rigid = RigidReference(kinematics)
            if not all(coordinate.periodic for coordinate in mechanism.coordinates):
                reached = rigid.reached
        system = unit_system(scene)
        if system not in (None, SI):
            units = {name: system.unit(unit) for name, unit in units.items()}
        return cls(tuple(sorted(nodes)), units, n_frame, functions, tuple(stresses), reached, rigid)


class RigidReference:
    """The rigid mechanism at the coordinates that joints of the flexible one have.

    Parameters
    ----------
    kinematics
        Of the mechanism.

    Attributes
    ----------
    nodes
        Global numbers of the nodes that joints are measured at.
    """

    def __init__(self, kinematics: RigidKinematics) -> None:
        measures = [joint_angle(coordinate.connection, kinematics) for coordinate in kinematics.coordinates]
        self._kinematics, self._angles = kinematics, [angle for angle, _ in measures]
        self.nodes = set().union(*(needed for _, needed in measures))

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
        return np.stack([angle(frames) for angle in self._angles], axis=1)

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


def _of_frames(function: Callable[[Frames], np.ndarray]) -> Function:
    """Return an output that has no use for the rigid mechanism."""
    return lambda frames, rigid: function(frames)


def _angle(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    angle, nodes = joint_angle(kinematics.mechanism.connection(entry.joint), kinematics, start)
    return _of_frames(angle), nodes, "rad"


def _sliding(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    connection = kinematics.mechanism.connection(entry.joint)
    axis = np.array(kinematics.mechanism.scene.joints[entry.joint].axes[0])
    return *_measured(along(axis), connection.sides, kinematics), "m"


def _distance(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    sides = tuple(kinematics.mechanism.attachment(point, f"{name}.points") for point in entry.points)
    return *_measured(distance(kinematics.mechanism.space.dimension), sides, kinematics), "m"


def _measured(
    statement: Statement, sides: tuple[Attachment, Attachment], kinematics: RigidKinematics
) -> tuple[Function, set[int]]:
    """Return the value of a statement about two attachments."""
    nodes, natural = {side.node for side in sides if not side.on_ground}, kinematics.mechanism.space.natural

    def value(frames: Frames) -> np.ndarray:
        n = next(frames[node] for node in nodes).shape[1]
        return statement.value(*(natural(_frame(side, frames, n)) for side in sides))

    return _of_frames(value), nodes


def _rotation(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    point = kinematics.mechanism.attachment(entry.point, f"{name}.point")
    return _of_frames(lambda frames: frames[point.node][2]), {point.node}, "rad"


def _position(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    point, axis = kinematics.mechanism.attachment(entry.point, f"{name}.point"), AXES[entry.axis]
    return _of_frames(lambda frames: point.frame_of(frames[point.node])[axis]), {point.node}, "m"


def _displacement(name: str, entry, start: np.ndarray, kinematics: RigidKinematics):
    point, axis = kinematics.mechanism.attachment(entry.point, f"{name}.point"), AXES[entry.axis]
    origin = point.frame_of_pose(kinematics.poses(start[None]))[axis, 0]
    return _of_frames(lambda frames: point.frame_of(frames[point.node])[axis] - origin), {point.node}, "m"


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
    space = kinematics.mechanism.space

    def deformation(frames: Frames, rigid: np.ndarray) -> np.ndarray:
        moved = point.frame_of(frames[point.node])[: space.dimension] - point.frame_of_pose(rigid)[: space.dimension]
        return space.to_body(rigid[point.body], moved)[axis] if entry.frame == "body" else moved[axis]

    return deformation, {point.node} | RigidReference(kinematics).nodes, "m"
