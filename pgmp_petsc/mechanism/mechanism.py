"""The mechanism: bodies, the connections between them, and the coordinates that drive it.

Unknowns are absolute and nodal, ``q = (x, y, phi)`` of every node, body after body; a rigid body has one node, its
centre of mass. The internal coordinates of condensed bodies follow; they are zero where a body is undeformed.

In full-order models in the plane a node has ``(x, y, phi)``. In space every node, the frame of a group of faces or the
centre of mass of a rigid body, has the twelve natural coordinates of its frame, position and directors (`space`): rigid
motion, joints and ties are then polynomials of first and second degree (Garcia de Jalon and Bayo 1994), and nothing is
singular anywhere. After all of them come the positions of the meshes' nodes.

Vectors have shape (n_dofs, ...): displacements and rotations of every node, and internal coordinates, which of
condensed bodies are in body frames always. In its body's frame a vector is turned back: ``u = R^T v``. A rigid velocity
of a body is then a combination of constant vectors.

A node of a body at the pose P has the frame z(P) in the inertial frame. Its displacement and rotation u in the body's
frame change that by ``dz = F(P) u`` (`Space.frame_gradients`), wherever the node is. With the slopes g of a statement
in the frames of its two nodes its gradient in body frames is

    ds/du = g(z(P)) F(P),

and its second derivatives are ``F^T h F + g.z''``, h those in the frames; z'' is zero in the plane.

Which unknowns a statement feels does not depend on the configuration: it is found once, and values alone are filled in.

In body frames (`u_b = R_b^T (q_b - rho_b)` node by node) mass and stiffness do not depend on the configuration; the
constraint Jacobian alone does, through the directions in which the bodies meet.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.linalg import block_diag

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.units import SI, UnitSystem
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.mechanism.composition import attachment_at, bodies_of, connections_of, couplings_of, first_guess
from pgmp_petsc.mechanism.joints import Attached, Attachment, Connection, Coupling
from pgmp_petsc.mechanism.space import SPATIAL, Space, space_of
from pgmp_petsc.mechanism.statement_rows import ROUND_OFF, StatementRows
from pgmp_petsc.mechanism.statements import ANGLE, Statement, distance, within
from pgmp_petsc.scene.messages import unknown
from pgmp_petsc.scene.schema import Scene
from pgmp_petsc.scene.uses import slides


@dataclass(frozen=True, eq=False)
class Coordinate:
    """An independent rigid coordinate: the value of a statement over a range.

    A prescribed one follows a given motion: the flexible vectors of the reduced basis do not change it.
    """

    name: str
    statement: Statement  # what it is, rad or m
    sides: tuple[Attachment, Attachment]  # of the statement
    #: lower, upper: its range
    lower: float
    upper: float
    periodic: bool
    prescribed: bool = False
    connection: Connection | None = None  # the joint whose motion it is; None of a distance
    system: UnitSystem = SI  # in which it is shown

    @property
    def turns(self) -> bool:
        """Whether it is an angle."""
        return self.statement.kind == ANGLE

    @property
    def unit(self) -> str:
        """The unit of its values: of SI, or what that is called in a scene without units."""
        return "rad" if self.turns else self.system.unit("m") if self.system.is_si else "m"

    def text(self, value: float, form: str = ".6g") -> str:
        """Return a value with its unit, as it is shown."""
        return self.system.text(value, self.unit, form)

    def shown(self, value: float) -> float:
        return self.system.shown(value, self.unit)

    def scale(self, size: float) -> float:
        """Return what a small change of it is measured against, in a mechanism of a size, m: 1 rad, or the size."""
        return 1.0 if self.turns else size

    def described(self, value: float, digits: int = 6) -> str:
        """Return ``theta = 0.1 rad``."""
        return f"{self.name} = {self.text(value, f'.{digits}g')}"


def words_of(coordinates: Sequence[Coordinate], theta: np.ndarray, digits: int = 6) -> str:
    """Name a configuration (n_theta,): ``theta = 0.1 rad, x = 0.2 m``."""
    return ", ".join(c.described(value, digits) for c, value in zip(coordinates, theta))


#: tables of a scene that say what its mechanism is, and its bodies
TABLES = ("ground", "materials", "bodies", "joints", "coordinates")


@dataclass(frozen=True)
class Mechanism:
    """Bodies, connections and coordinates of a scene, with their numbering."""

    #: bodies, connections, couplings, coordinates: in the order of the scene
    bodies: tuple[Body, ...]
    connections: tuple[Connection, ...]
    couplings: tuple[Coupling, ...]
    coordinates: tuple[Coordinate, ...]
    first_guess: np.ndarray  # poses near which the mechanism is assembled, shape (n_bodies, n_pose)
    #: scene, shapes: the scene and the shapes of its bodies that it was made from
    scene: Scene
    shapes: Mapping[str, BodyShape]

    @cached_property
    def space(self) -> Space:
        return space_of(self.scene.dimension)

    @cached_property
    def n_nodes(self) -> int:
        return sum(body.n_nodes for body in self.bodies)

    @cached_property
    def n_dofs(self) -> int:
        return self.space.n_dofs * self.n_nodes + sum(body.n_internal for body in self.bodies)

    @property
    def free(self) -> np.ndarray:
        """Numbers of the coordinates that are not prescribed."""
        return np.flatnonzero([not coordinate.prescribed for coordinate in self.coordinates])

    @property
    def holders(self) -> tuple[Connection | Coupling, ...]:
        """What holds the mechanism together, in the order of the constraints."""
        return (*self.connections, *self.couplings)

    @property
    def n_constraints(self) -> int:
        """Number of scalar constraints of the configuration, redundant ones included."""
        return sum(len(one.holding()) for one in self.holders)

    @property
    def n_held(self) -> int:
        """Number of scalar constraints of the motion: without those that elastic joints release."""
        return sum(len(one.holding(moving=True)) for one in self.holders)

    @property
    def straight(self) -> Mechanism:
        """The mechanism with no joint off."""
        return replace(self, connections=tuple(connection.straight for connection in self.connections))

    @cached_property
    def mass_weights(self) -> tuple[Monomial, ...]:
        """Weights of the affine mass terms, sorted."""
        return tuple(sorted({m for body in self.bodies for m in body.weights("mass")}))

    @cached_property
    def stiffness_weights(self) -> tuple[Monomial, ...]:
        """Weights of the affine stiffness terms, sorted."""
        return tuple(sorted({m for body in self.bodies for m in body.weights("stiffness")}))

    @cached_property
    def linear_fields(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """Unknowns and linear displacement fields of every body."""
        return tuple((body.dofs, body.linear_fields()) for body in self.bodies)

    def connection(self, name: str) -> Connection:
        """Return the connection of the joint with this name; raises `InputError` if there is none."""
        for connection in self.connections:
            if connection.name == name:
                return connection
        raise InputError(unknown("joint", "joint", name, self.scene.joints))

    def attachment(self, address: str, entry: str) -> Attachment:
        """Return the attachment at ``"body:point"`` or ``"ground:point"``.

        Raises `InputError` if the body's mesh has no such point; `entry` is the scene entry to blame.
        """
        return attachment_at(self.scene, self.bodies, address, entry)

    def between(self, statement: Statement, points: Sequence[str], entry: str) -> dict[str, Any]:
        """Return a statement with the attachments at two points, as `effects.action.Action` takes them; `entry` as of
        `attachment`."""
        a, b = (self.attachment(point, entry) for point in points)
        return {"statement": statement, "a": a, "b": b}

    def node_dofs(self, node: int) -> np.ndarray:
        """Return the unknowns of a node, shape (3,), in space (6,)."""
        return self.space.n_dofs * node + np.arange(self.space.n_dofs)

    def body_of(self, node: int) -> tuple[int, np.ndarray]:
        """Return the number of a node's body, and the node's place in the body's frame, shape (2,), m."""
        number = next(i for i, body in enumerate(self.bodies) if body.nodes.start <= node < body.nodes.stop)
        body = self.bodies[number]
        return number, body.mesh.nodes[node - body.first_node]

    def holding(self, frames: Sequence[Attachment], moving: bool = False) -> tuple[list[Attached], np.ndarray]:
        """Return what holds the mechanism together, statements with their sides, and the values that they have, (n,).

        These are the statements of the joints, which are zero, combinations of what couplings couple, and in space the
        statements that make the directors of `frames` a rotation: of its bodies' poses, or of all nodes. Elastic joints
        are locked and none is off, as in the configuration; `moving` is without what they release, and about joints
        where they are.
        """
        held = [part for one in self.holders for part in one.holding(moving)]
        wanted = [coupling.value for coupling in self.couplings for _ in coupling.holding(moving)]
        values = np.concatenate([np.zeros(len(held) - len(wanted)), wanted])
        if self.space is SPATIAL:
            ground, axes = Attachment.on_ground_at(np.zeros(3)), np.eye(3)
            pairs = [(i, j) for i in range(3) for j in range(i + 1)]  # of directors, which are a rotation
            parts = [within(axes[i], axes[j]) for i, j in pairs]
            held += [(part, (ground, frame)) for frame in frames for part in parts]
            values = np.concatenate([values, np.tile([float(i == j) for i, j in pairs], len(frames))])
        return held, values

    def by_node(self, vectors: np.ndarray) -> np.ndarray:
        """View the nodal part of vectors (n_dofs, ...) as (n_nodes, n_dofs of a node, ...)."""
        per_node = self.space.n_dofs
        return vectors[: per_node * self.n_nodes].reshape(self.n_nodes, per_node, *vectors.shape[1:])

    def made_of(self, scene: Scene, shapes: Mapping[str, BodyShape]) -> bool:
        """Return whether this very scene and these very shapes of bodies make the same mechanism."""
        same = self.shapes.keys() == shapes.keys() and all(self.shapes[name] is shapes[name] for name in shapes)
        driven = {coordinate.name for coordinate in self.coordinates if coordinate.prescribed}
        return self.scene is scene and same and driven == set(scene.driven)

    @classmethod
    def from_scene(cls, scene: Scene, shapes: Mapping[str, BodyShape]) -> Mechanism:
        """Number the unknowns of a scene's bodies and attach its joints.

        Raises `InputError` if a joint names a point that its body's mesh does not have.
        """
        bodies = bodies_of(scene, shapes)
        guess = first_guess(scene, bodies)
        connections = connections_of(scene, bodies, guess)
        by_name = {connection.name: connection for connection in connections}
        coordinates = []
        for name, entry in scene.coordinates.items():
            joint = by_name.get(entry.joint)
            if joint is None:
                statement, address = distance(scene.dimension), f"coordinates.{name}.points"
                sides = tuple(attachment_at(scene, bodies, point, address) for point in entry.points)
            else:
                statement, sides = joint.measure("sliding" if slides(scene, entry) else "turning"), joint.sides
            rest = (*entry.range, entry.periodic, name in scene.driven, joint, scene.system)
            coordinates.append(Coordinate(name, statement, sides, *rest))
        coordinates = tuple(coordinates)
        couplings = couplings_of(scene, connections, guess, [c.statement for c in coordinates])
        return cls(bodies, connections, couplings, coordinates, guess, scene, shapes)


N_POSE = SPATIAL.n_pose


class Unknowns:
    """The numbering of the unknowns of a mechanism, whose flexible bodies are on their meshes where they are solids in
    space.

    `bodies` are the mechanism's, with internal coordinates numbered as here, in 2 or 3 dimensions, with n_dofs
    unknowns.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism, self._space = mechanism, mechanism.space
        self.dimension = self._space.dimension
        self._more = self._space.n_pose - self._space.n_dofs  # unknowns of a frame than it has in the mechanism
        more = self._more * mechanism.n_nodes
        self.bodies: tuple[Body, ...] = tuple(
            body.numbered(body.first_node, body.first_internal + more) for body in mechanism.bodies
        )
        self.n_dofs = mechanism.n_dofs + more

    def frame(self, node: int) -> np.ndarray:
        """Return the unknowns of a node's frame, shape (3,) or (12,)."""
        return self._space.n_pose * node + np.arange(self._space.n_pose)

    def frames(self, q: np.ndarray) -> np.ndarray:
        """View the frames of all nodes in unknowns (n_dofs, ...), shape (n_nodes, n_pose, ...)."""
        n_nodes, n_pose = self.mechanism.n_nodes, self._space.n_pose
        return q[: n_pose * n_nodes].reshape(n_nodes, n_pose, *q.shape[1:])

    def place(self, poses: np.ndarray, rates: np.ndarray | None = None) -> np.ndarray:
        """Return the unknowns (n_dofs, ...) of undeformed bodies, rho of eq. (4), at poses (n_bodies, n_pose, ...), or
        with rates (n_bodies, n_pose, ...) at one configuration how fast they change."""
        q, space = np.zeros((self.n_dofs, *(poses if rates is None else rates).shape[2:])), self._space
        frames = self.frames(q)
        for k, body in enumerate(self.bodies):
            of = partial(space.place, poses[k]) if rates is None else partial(space.place_rates, poses[k], rates[k])
            frames[body.nodes] = of(body.mesh.nodes)
            body.at_points(q)[:] = of(body.points)[:, : space.dimension]
        return q

    def share(self, rank: int, size: int) -> range:
        """Return a rank's contiguous share of the unknowns, whole frames and whole nodes of meshes at a time."""
        first, last = (self._boundary(self.n_dofs * part // size) for part in (rank, rank + 1))
        return range(first, last)

    def in_mechanism(self, rows: range) -> range:
        """Return the numbers that a share of the unknowns has in the mechanism."""
        frames = (min(bound // self._space.n_pose, self.mechanism.n_nodes) for bound in (rows.start, rows.stop))
        return range(*(bound - self._more * n for bound, n in zip((rows.start, rows.stop), frames)))

    def of_mechanism(self, dofs: np.ndarray) -> np.ndarray:
        """Return the unknowns of positions that have given numbers in the mechanism, shape (n,)."""
        return dofs + self._more * np.minimum(dofs // self._space.n_dofs, self.mechanism.n_nodes)

    def _boundary(self, number: int) -> int:
        of_frames = self._space.n_pose * self.mechanism.n_nodes
        if number <= of_frames:
            return number // self._space.n_pose * self._space.n_pose
        if number == self.n_dofs:
            return number
        return of_frames + (number - of_frames) // self.dimension * self.dimension


def to_body(mechanism: Mechanism, poses: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Turn vectors (n_dofs, ...) from the inertial frame into body frames at poses (n_bodies, n_pose)."""
    turned, d = vectors.reshape(len(vectors), -1).copy(), mechanism.space.dimension
    nodal = mechanism.by_node(turned)
    for body, pose in zip(mechanism.bodies, poses):
        rotation = mechanism.space.rotation(pose).T
        nodal[body.nodes] = np.einsum("ij,njk->nik", rotation, nodal[body.nodes])
        body.at_points(turned)[:] = np.einsum("ij,njk->nik", rotation[:d, :d], body.at_points(turned))
    return turned.reshape(vectors.shape)


def rigid_positions(mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return the undeformed bodies' positions in the inertial frame, as vectors in body frames, shape (n_dofs,).

    Poses have the shape (n_bodies, n_pose). What belongs to rotations is zero: a position has none.
    """
    d = mechanism.space.dimension
    places = np.zeros(mechanism.n_dofs)
    for (dofs, fields), pose in zip(mechanism.linear_fields, poses):
        origin = mechanism.space.to_body(pose[:, None], pose[:d, None])[:, 0]
        places[dofs] = fields @ np.concatenate([origin, np.eye(d).ravel()])
    return places


def linear_motion(mechanism: Mechanism, coefficients: Sequence[np.ndarray]) -> np.ndarray:
    """Return displacements in body frames (n_dofs, ...) of bodies that move as linear fields, by the coefficients of
    every body, shape (n_bodies, d + d^2, ...)."""
    trailing = coefficients[0].shape[1:]
    result = np.zeros((mechanism.n_dofs, math.prod(trailing)))
    for (dofs, fields), own in zip(mechanism.linear_fields, coefficients):
        result[dofs] = fields @ own.reshape(len(own), -1)
    return result.reshape(mechanism.n_dofs, *trailing)


def rigid_velocities(mechanism: Mechanism, poses: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return ``d rho / d theta`` in body frames, shape (n_dofs, n_theta), at one configuration: poses (n_bodies,
    n_pose) and their rates ``dP/dtheta``, shape (n_bodies, n_pose, n_theta)."""
    return linear_motion(mechanism, [mechanism.space.velocity_field(*own) for own in zip(poses, rates)])


class BodyStatements:
    """Derivatives of statements, or combinations of them, about attachments of a mechanism, one a row, in body frames,
    at any configuration of the rigid mechanism.

    There are n rows. `rows` and `dofs` are row and unknown of every first derivative, shape (n_entries,), none of them
    twice; no entry is zero everywhere. `nodal` are the unknowns of all nodes that the statements are about, shape (k,),
    and `linear` says whether their second derivatives are zero everywhere.
    """

    def __init__(self, mechanism: Mechanism, held: Sequence[Attached]) -> None:
        space = self._space = mechanism.space
        self.n, self._n_dofs = len(held), mechanism.n_dofs
        moving = {side.node: side for _, sides in held for side in sides if not side.on_ground}
        sides = [moving[node] for node in sorted(moving)]
        # statements see the nodes that they are about, one after the other
        first = {side.node: space.n_pose * k for k, side in enumerate(sides)}
        self._rows = StatementRows(held, lambda node: first.get(node, 0) + np.arange(space.n_pose), space.dimension)
        self._bodies = np.array([side.body for side in sides], dtype=int)
        points = np.array([side.point - side.arm for side in sides]).reshape(-1, space.dimension)
        self._points = [(body, points[self._bodies == body]) for body in np.unique(self._bodies)]
        self.nodal = np.array([side.dofs for side in sides], dtype=int).ravel()
        self.linear = not (held and (self._rows.curvature_pattern[0].size or space is SPATIAL))
        # terms of a row may be about one node, and both sides of a statement too
        of, columns = self._rows.jacobian_pattern
        pairs, own = np.unique(of * len(sides) + columns // space.n_pose, return_inverse=True)
        self._places = own * space.n_pose + columns % space.n_pose
        row, self._nodes = np.divmod(pairs, max(len(sides), 1))
        # poses that no mechanism comes to
        generic = np.random.default_rng(0).normal(size=(len(mechanism.bodies), space.n_pose, 1))
        self._felt = np.nonzero(np.abs(self._slopes(space.straightened(generic)[..., 0], True)) > ROUND_OFF)
        self.rows = row[self._felt[0]]
        self.dofs = self.nodal.reshape(-1, space.n_dofs)[self._nodes][self._felt]

    def values(self, poses: np.ndarray) -> np.ndarray:
        """Return the entries at poses (n_bodies, n_pose), shape (n_entries,)."""
        return self._slopes(poses)[self._felt]

    def dense(self, poses: np.ndarray) -> np.ndarray:
        """Return the gradients in all unknowns at poses (n_bodies, n_pose), shape (n, n_dofs)."""
        found = np.zeros((self.n, self._n_dofs))
        found[self.rows, self.dofs] = self.values(poses)
        return found

    def second(self, poses: np.ndarray) -> np.ndarray:
        """Return the second derivatives in the `nodal` unknowns at poses (n_bodies, n_pose), shape (n, k, k)."""
        space, at = self._space, poses[self._bodies]
        slopes, values = self._rows.dense(self._frames(poses))
        turn = block_diag(*space.frame_gradients(at))
        curved, k = turn.T @ values @ turn, len(at)
        of_nodes = np.einsum("niaib->niab", curved.reshape(self.n, k, space.n_dofs, k, space.n_dofs))
        of_nodes += space.frame_curvatures(at, slopes.reshape(self.n, k, space.n_pose))
        return curved

    def _frames(self, poses: np.ndarray) -> np.ndarray:
        """Return the frames of all nodes, one after the other."""
        return np.concatenate([np.zeros(0), *(self._space.place(poses[k], at).ravel() for k, at in self._points)])

    def _slopes(self, poses: np.ndarray, generic: bool = False) -> np.ndarray:
        """Return the first derivatives of rows in the unknowns of each node that they are about, shape (n_pairs, n_dofs
        of a node); `generic` as of `StatementRows.jacobian_values`."""
        space, values = self._space, self._rows.jacobian_values(self._frames(poses), generic)
        in_frames = np.bincount(self._places, values, space.n_pose * len(self._nodes))
        return (in_frames.reshape(-1, 1, space.n_pose) @ space.frame_gradients(poses[self._bodies[self._nodes]]))[:, 0]


class ConstraintJacobian:
    """C in body frames at configurations of the rigid mechanism, on one nonzero pattern.

    Rows are those that the joints hold in the motion, of the clamped coordinates, each of whose statements is one more
    constraint, and of the ties of frames to the meshes of continuum bodies. `pattern` is a matrix with the nonzero
    pattern, shape (n_held + n_clamped + n_ties, n_dofs). What no constraint feels at any configuration is not in it:
    such an unknown must not become a dependent one.
    """

    def __init__(self, mechanism: Mechanism, clamped: Sequence[Coordinate] = ()) -> None:
        held = [part for one in mechanism.holders for part in one.holding(moving=True)]
        own = self._own = BodyStatements(mechanism, held + [(c.statement, c.sides) for c in clamped])
        joints = sp.csr_matrix((np.ones(own.rows.size), (own.rows, own.dofs)), shape=(own.n, mechanism.n_dofs))
        self.pattern = sp.vstack([joints, *_ties(mechanism)]).tocsr()
        self._last = np.zeros(0), self.pattern

    def at(self, poses: np.ndarray) -> sp.csr_matrix:
        """Return C at poses (n_bodies, n_pose), for reading alone: many ask for it at the same ones."""
        if self._last[0] is not poses:
            pattern, values = self.pattern, self.pattern.data.copy()
            values[: self._own.rows.size] = self._own.values(poses)
            self._last = poses, sp.csr_matrix((values, pattern.indices, pattern.indptr), shape=pattern.shape)
        return self._last[1]


def constraint_jacobian(mechanism: Mechanism, poses: np.ndarray, clamped: Sequence[Coordinate] = ()) -> sp.csr_matrix:
    """Return C at one configuration, poses (n_bodies, n_pose)."""
    return ConstraintJacobian(mechanism, clamped).at(poses)


def _ties(mechanism: Mechanism) -> Iterator[sp.spmatrix]:
    """Yield the constraints between the frames of each meshed body and its mesh: the same at every configuration."""
    for body in mechanism.bodies:
        if body.face_frames:
            n_points = len(body.points)
            means = sp.vstack([frame.functionals(n_points) for frame in body.face_frames.values()]).tocoo()
            n = means.shape[0]
            nodal = body.dofs[:n]
            rows = np.concatenate([np.arange(n), means.row])
            columns = np.concatenate([nodal, body.first_internal + means.col])
            data = np.concatenate([np.ones(n), -means.data])
            yield sp.coo_matrix((data, (rows, columns)), shape=(n, mechanism.n_dofs))


@dataclass(frozen=True, eq=False)
class ConstraintHessian:
    """Second derivatives of the constraints of one joint or coupling, or of a clamped coordinate, in body frames."""

    rows: slice  # numbers of the constraints, n_c of them
    dofs: np.ndarray  # the nodal unknowns that they depend on, shape (k,)
    values: np.ndarray  # shape (n_c, k, k)


class ConstraintHessians:
    """Second derivatives of joints and clamped coordinates that are not linear, in body frames, at configurations of
    the rigid mechanism."""

    def __init__(self, mechanism: Mechanism, clamped: Sequence[Coordinate] = ()) -> None:
        self._joints: list[tuple[slice, BodyStatements]] = []
        first = 0
        held = [one.holding(moving=True) for one in mechanism.holders]
        for parts in [*held, *([(c.statement, c.sides)] for c in clamped)]:
            numbered, own = slice(first, first := first + len(parts)), BodyStatements(mechanism, parts)
            if not own.linear:
                self._joints.append((numbered, own))

    def at(self, poses: np.ndarray) -> list[ConstraintHessian]:
        """Return them at poses (n_bodies, n_pose)."""
        return [ConstraintHessian(rows, one.nodal, one.second(poses)) for rows, one in self._joints]
