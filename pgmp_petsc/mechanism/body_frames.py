"""Between inertial and body frames, and rigid velocities as vectors in body frames.

Vectors have shape (n_dofs, ...): displacements and rotations of every node, and internal coordinates, which of
condensed bodies are in body frames always. In its body's frame a vector is turned back: ``u = R^T v``. A rigid velocity
of a body is then a combination of constant vectors.

Gradients of statements on the rigid mechanism, in body frames: rows of constraints, forces of actions.

A node of a body at the pose P has the frame z(P) in the inertial frame. Its displacement and rotation u in the body's
frame change that by ``dz = F(P) u`` (`Space.frame_gradient`), wherever the node is. With the slopes g of a statement in
the frames of its two nodes its gradient in body frames is

    ds/du = g(z(P)) F(P).

Which unknowns a statement feels does not depend on the configuration: it is found once, and values alone are filled in.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.statement_rows import ROUND_OFF, StatementRows
from pgmp_petsc.mechanism.statements import Combination, Statement


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
    """Return displacements in body frames of bodies that move as linear fields.

    Parameters
    ----------
    coefficients
        Of every body, shape (n_bodies, d + d^2, ...).

    Returns
    -------
    ndarray, shape (n_dofs, ...)
    """
    trailing = coefficients[0].shape[1:]
    result = np.zeros((mechanism.n_dofs, math.prod(trailing)))
    for (dofs, fields), own in zip(mechanism.linear_fields, coefficients):
        result[dofs] = fields @ own.reshape(len(own), -1)
    return result.reshape(mechanism.n_dofs, *trailing)


def rigid_velocities(mechanism: Mechanism, poses: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return ``d rho / d theta`` in body frames.

    Parameters
    ----------
    poses
        One configuration, shape (n_bodies, n_pose).
    rates
        ``dP/dtheta``, shape (n_bodies, n_pose, n_theta).

    Returns
    -------
    ndarray, shape (n_dofs, n_theta)
    """
    return linear_motion(mechanism, [mechanism.space.velocity_field(*own) for own in zip(poses, rates)])


class BodyGradients:
    """Gradients of statements about attachments, one statement a row, at any configuration.

    Parameters
    ----------
    mechanism
        The mechanism that the attachments belong to.
    held
        The statements, or combinations of them, and their sides.

    Attributes
    ----------
    n
        Number of rows.
    rows, dofs
        Row and unknown of every entry, shape (n_entries,), none of them twice; no entry is zero everywhere.
    """

    def __init__(
        self, mechanism: Mechanism, held: Sequence[tuple[Statement | Combination, tuple[Attachment, ...]]]
    ) -> None:
        space, sides = mechanism.space, [own for _, own in held]
        self.n, self._space, self._n_dofs = len(held), space, mechanism.n_dofs
        moving = {side.node: side for pair in sides for side in pair if not side.on_ground}
        nodes = np.array(sorted(moving), dtype=int)
        # statements see the nodes that they are about, one after the other
        self._rows = StatementRows(
            [part for part, _ in held],
            sides,
            lambda node: space.n_pose * np.searchsorted(nodes, node) + np.arange(space.n_pose),
            space.dimension,
        )
        starts, columns, _ = self._rows.compiled.entries
        self._slopes = np.repeat(np.arange(starts.size - 1), np.diff(starts)), columns
        bodies = np.array([moving[node].body for node in nodes], dtype=int)
        points = np.array([moving[node].point - moving[node].arm for node in nodes]).reshape(-1, space.dimension)
        self._nodes = [(body, points[bodies == body]) for body in np.unique(bodies)]
        every = [side for own in sides for side in own]
        self._bodies = np.array([side.body for side in every], dtype=int).reshape(-1, 2)
        grounded = np.full(space.n_dofs, -1)
        dofs = np.array([grounded if side.on_ground else side.dofs for side in every], dtype=int)
        dofs = dofs.reshape(-1, 2, space.n_dofs)
        self._entries = self._felt(dofs, len(mechanism.bodies))
        # terms of a row may be about one node, and both sides of a statement too
        pairs = np.stack([self._rows.row_of[self._entries[0]], dofs[self._entries]])
        (self.rows, self.dofs), self._entry_of = np.unique(pairs, axis=1, return_inverse=True)
        self._entry_of = self._entry_of.ravel()

    def values(self, poses: np.ndarray) -> np.ndarray:
        """Return the entries at poses (n_bodies, n_pose), shape (n_entries,)."""
        return np.bincount(self._entry_of, self._everything(poses)[self._entries], self.rows.size)

    def dense(self, poses: np.ndarray) -> np.ndarray:
        """Return the gradients in all unknowns at poses (n_bodies, n_pose), shape (n, n_dofs)."""
        found = np.zeros((self.n, self._n_dofs))
        if not self.n:
            return found
        found[self.rows, self.dofs] = self.values(poses)
        return found

    def _everything(self, poses: np.ndarray) -> np.ndarray:
        """Return the derivatives of terms in both nodes' unknowns, shape (n_terms, 2, n_dofs of a node); any on the
        ground."""
        space = self._space
        frames = [space.place(poses[body], points).ravel() for body, points in self._nodes]
        n = len(self._bodies)
        slopes = np.zeros((n, 2 * space.n_pose))
        slopes[self._slopes] = self._rows.jacobian_values(np.concatenate([*frames, np.zeros(0)]))
        turns = np.array([space.frame_gradient(pose) for pose in poses])
        return (slopes.reshape(n, 2, 1, space.n_pose) @ turns[self._bodies])[:, :, 0]

    def _felt(self, dofs: np.ndarray, n_bodies: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the places of the derivatives that are not zero at poses that no mechanism comes to."""
        random, d = np.random.default_rng(0), self._space.dimension
        poses = random.normal(size=(n_bodies, self._space.n_pose))
        if self._space.n_tied:  # directors
            poses[:, d:] = np.linalg.qr(poses[:, d:].reshape(n_bodies, d, d))[0].reshape(n_bodies, d * d)
        with self._rows.bent_functions():
            felt = np.abs(self._everything(poses)) > ROUND_OFF
        return np.nonzero(felt & (dofs >= 0))
