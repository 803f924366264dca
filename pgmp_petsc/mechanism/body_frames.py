"""Between inertial and body frames, and rigid velocities as vectors in body frames.

Vectors have shape (n_dofs, ...): displacements and rotations of every node, and internal coordinates, which of
condensed bodies are in body frames always. In its body's frame a vector is turned back: ``u = R^T v``. A rigid velocity
of a body is then a combination of constant vectors.

Derivatives of statements on the rigid mechanism, in body frames: rows of constraints, forces of actions.

A node of a body at the pose P has the frame z(P) in the inertial frame. Its displacement and rotation u in the body's
frame change that by ``dz = F(P) u`` (`Space.frame_gradients`), wherever the node is. With the slopes g of a statement
in the frames of its two nodes its gradient in body frames is

    ds/du = g(z(P)) F(P),

and its second derivatives are ``F^T h F + g.z''``, h those in the frames; z'' is zero in the plane.

Which unknowns a statement feels does not depend on the configuration: it is found once, and values alone are filled in.

Constraint Jacobians of the full-order model in body frames, at configurations of the rigid mechanism.

In body frames (`u_b = R_b^T (q_b - rho_b)` node by node) mass and stiffness do not depend on the configuration; the
constraint Jacobian alone does, through the directions in which the bodies meet.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.linalg import block_diag

from pgmp_petsc.mechanism.joints import Attached
from pgmp_petsc.mechanism.mechanism import Coordinate, Mechanism
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.mechanism.statement_rows import ROUND_OFF, StatementRows


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
