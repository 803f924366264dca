"""The mechanism: bodies, the connections between them, and the coordinates that drive it.

Unknowns are absolute and nodal, ``q = (x, y, phi)`` of every node, body after body. A connection is a joint between two
attachments; an attachment is a node of a body, or a point of the ground.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import DOFS_PER_NODE, Body
from pgmp_petsc.bodies.section import BeamSection
from pgmp_petsc.mechanism.joints import N_FRAME, Joint, PointOnLine, Revolute
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.scene.schema import Scene

GROUND = "ground"


@dataclass(frozen=True)
class Attachment:
    """Where a joint holds.

    Attributes
    ----------
    body
        Index of the body, or -1 for the ground.
    node
        Global node number, or -1 for the ground.
    point
        Coordinates in the body's (or the ground's) frame, shape (2,), m.
    """

    body: int
    node: int
    point: np.ndarray

    @property
    def on_ground(self) -> bool:
        """Whether it is a point of the ground."""
        return self.body < 0

    def frame_of_node(self, q: np.ndarray) -> np.ndarray:
        """Return the frame (3, ...) from nodal unknowns q of shape (n_dofs, ...)."""
        if self.on_ground:
            return self._ground_frame(q.shape[1:])
        return q[DOFS_PER_NODE * self.node : DOFS_PER_NODE * self.node + N_FRAME]

    def frame_of_pose(self, poses: np.ndarray) -> np.ndarray:
        """Return the frame (3, ...) from rigid poses of shape (n_bodies, 3, ...)."""
        if self.on_ground:
            return self._ground_frame(poses.shape[2:])
        pose = poses[self.body]
        frame = pose.copy()
        frame[:2] += rotate(pose[2], self.point)
        return frame

    def _ground_frame(self, trailing: tuple[int, ...]) -> np.ndarray:
        frame = np.zeros((N_FRAME, *trailing))
        frame[0], frame[1] = self.point
        return frame


@dataclass(frozen=True)
class Connection:
    """A named joint between two attachments, and the rows of its constraints."""

    name: str
    joint: Joint
    a: Attachment
    b: Attachment
    rows: slice


@dataclass(frozen=True)
class Coordinate:
    """An independent rigid coordinate: the relative rotation of a revolute joint over a range (rad).

    A prescribed one follows a given motion: the flexible vectors of the reduced basis do not turn its joint.
    """

    name: str
    connection: Connection
    lower: float
    upper: float
    periodic: bool
    prescribed: bool = False

    def measure(self, frame_a: np.ndarray, frame_b: np.ndarray) -> np.ndarray:
        """Return the coordinate for frames of shape (3, ...)."""
        return frame_b[2] - frame_a[2]


@dataclass(frozen=True)
class Mechanism:
    """Bodies, connections and coordinates of a scene, with their numbering.

    Attributes
    ----------
    bodies, connections, coordinates
        In the order of the scene.
    first_guess
        Poses near which the mechanism is assembled, shape (n_bodies, 3).
    """

    bodies: tuple[Body, ...]
    connections: tuple[Connection, ...]
    coordinates: tuple[Coordinate, ...]
    first_guess: np.ndarray

    @property
    def n_nodes(self) -> int:
        """Number of nodes of all bodies."""
        return sum(body.n_nodes for body in self.bodies)

    @property
    def n_dofs(self) -> int:
        """Number of nodal unknowns."""
        return DOFS_PER_NODE * self.n_nodes

    @property
    def n_constraints(self) -> int:
        """Number of scalar constraints, redundant ones included."""
        return sum(connection.joint.n_constraints for connection in self.connections)

    @property
    def mass_weights(self) -> tuple[Monomial, ...]:
        """Weights of the affine mass terms, sorted."""
        return tuple(sorted({m for body in self.bodies for m in body.section.mass_terms()}))

    @property
    def stiffness_weights(self) -> tuple[Monomial, ...]:
        """Weights of the affine stiffness terms, sorted."""
        return tuple(sorted({m for body in self.bodies for m in body.section.stiffness_terms()}))

    def connection(self, name: str) -> Connection:
        """Return the connection of the joint with this name."""
        return next(connection for connection in self.connections if connection.name == name)

    def node(self, address: str, entry: str) -> int:
        """Return the global number of the node at ``"body:point"``.

        Raises
        ------
        InputError
            If the body's mesh has no such point; `entry` is the scene entry to blame.
        """
        name, _, point = address.partition(":")
        body = next(body for body in self.bodies if body.name == name)
        return body.first_node + body.mesh.point(point, entry)

    def constraint_dofs(self, connection: Connection) -> tuple[np.ndarray, np.ndarray]:
        """Return the nodal unknowns of a connection and which of its six frame unknowns they are."""
        dofs, columns = [], []
        for offset, attachment in ((0, connection.a), (N_FRAME, connection.b)):
            if not attachment.on_ground:
                dofs.append(DOFS_PER_NODE * attachment.node + np.arange(N_FRAME))
                columns.append(offset + np.arange(N_FRAME))
        return np.concatenate(dofs), np.concatenate(columns)

    def place(self, poses: np.ndarray) -> np.ndarray:
        """Place the undeformed bodies: rho of eq. (4).

        Parameters
        ----------
        poses
            Rigid poses ``(X, Y, Phi)``, shape (n_bodies, 3, ...).

        Returns
        -------
        ndarray, shape (n_dofs, ...)
            Nodal unknowns q.
        """
        q = np.empty((self.n_nodes, DOFS_PER_NODE, *poses.shape[2:]))
        for index, body in enumerate(self.bodies):
            q[body.nodes] = place_points(poses[index], body.mesh.nodes)
        return q.reshape(self.n_dofs, *poses.shape[2:])

    def place_rates(self, poses: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return ``d rho / d theta`` in the inertial frame.

        Parameters
        ----------
        poses, rates
            One configuration, shape (n_bodies, 3), and ``dP/dtheta``, shape (n_bodies, 3, n_theta).

        Returns
        -------
        ndarray, shape (n_dofs, n_theta)
        """
        result = np.empty((self.n_nodes, DOFS_PER_NODE, rates.shape[2]))
        for body, pose, rate in zip(self.bodies, poses, rates):
            arm = rotate(pose[2], body.mesh.nodes.T)[..., None]
            result[body.nodes, 0] = rate[0] - arm[1] * rate[2]
            result[body.nodes, 1] = rate[1] + arm[0] * rate[2]
            result[body.nodes, 2] = rate[2]
        return result.reshape(self.n_dofs, -1)

    @classmethod
    def from_scene(cls, scene: Scene, meshes: Mapping[str, LineMesh]) -> Mechanism:
        """Number the unknowns of a scene's bodies and attach its joints.

        Raises
        ------
        InputError
            If a joint names a point that its body's mesh does not have.
        """
        bodies, first_node = [], 0
        for name, entry in scene.bodies.items():
            section = BeamSection.of(entry.section, scene.materials[entry.material])
            bodies.append(Body(name, meshes[name], section, first_node))
            first_node += bodies[-1].n_nodes
        connections = _connections(scene, bodies)
        by_name = {connection.name: connection for connection in connections}
        coordinates = tuple(
            Coordinate(name, by_name[entry.joint], *entry.range, entry.periodic, _is_prescribed(scene, name))
            for name, entry in scene.coordinates.items()
        )
        guess = _first_guess(scene, bodies, connections)
        return cls(tuple(bodies), connections, coordinates, guess)


def _is_prescribed(scene: Scene, coordinate: str) -> bool:
    """Return whether an effect of a scene prescribes the motion of a coordinate."""
    return any(
        getattr(entry, "type", None) == "prescribed_motion" and entry.coordinate == coordinate
        for entry in scene.effects.values()
    )


def rotate(angle: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Turn points (2, ...) by angles that broadcast against a coordinate; the result has shape (2, ...)."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * point[0] - sin * point[1], sin * point[0] + cos * point[1]])


def place_points(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the frames (n_points, 3, ...) of points (n_points, 2) of a rigid body at a pose (3, ...)."""
    frames = np.empty((len(points), N_FRAME, *pose.shape[1:]))
    frames[:, :2] = pose[:2] + np.moveaxis(rotate(pose[2][..., None], points.T), -1, 0)
    frames[:, 2] = pose[2]
    return frames


def _connections(scene: Scene, bodies: list[Body]) -> tuple[Connection, ...]:
    index = {body.name: i for i, body in enumerate(bodies)}

    def attach(address: str, entry: str) -> Attachment:
        name, _, point = address.partition(":")
        if name == GROUND:
            return Attachment(-1, -1, np.asarray(scene.ground.positions[point], dtype=float))
        body = bodies[index[name]]
        node = body.mesh.point(point, entry)
        return Attachment(index[name], body.first_node + node, body.mesh.nodes[node])

    connections, row = [], 0
    for name, entry in scene.joints.items():
        a, b = (attach(address, f"joints.{name}.connect") for address in entry.connect)
        joint: Joint = Revolute() if entry.type == "revolute" else PointOnLine(
            entry.direction, turning=not a.on_ground
        )
        connections.append(Connection(name, joint, a, b, slice(row, row + joint.n_constraints)))
        row += joint.n_constraints
    return tuple(connections)


def _first_guess(scene: Scene, bodies: list[Body], connections: tuple[Connection, ...]) -> np.ndarray:
    """Return poses to start the assembly from.

    A body with a `placement` takes that; the others are moved, joint by joint from the ground, so that their joint
    point meets the one already placed, with the direction that they have in their mesh.
    """
    poses = np.zeros((len(bodies), N_FRAME))
    placed = np.zeros(len(bodies), dtype=bool)
    for i, body in enumerate(bodies):
        placement = scene.bodies[body.name].placement
        if placement is not None:
            poses[i] = (*placement.origin, placement.angle)
            placed[i] = True
    waiting = list(connections)
    while True:
        ready = [
            c
            for c in waiting
            if isinstance(c.joint, Revolute)
            and (c.a.on_ground or placed[c.a.body]) != (c.b.on_ground or placed[c.b.body])
        ]
        if not ready:
            return poses
        connection = ready[0]
        a, b = connection.a, connection.b
        anchor, loose = (a, b) if a.on_ground or placed[a.body] else (b, a)
        gap = anchor.frame_of_pose(poses)[:2] - loose.frame_of_pose(poses)[:2]
        poses[loose.body, :2] += gap
        placed[loose.body] = True
        waiting.remove(connection)
