"""All constraints of a mechanism in nodal unknowns: residual, Jacobian and curvature on fixed patterns.

Trailing axes of q (samples) are kept; entries are given as values on a pattern that does not depend on q.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.mechanism.connection import Connection
from pgmp_petsc.mechanism.constraints import constraint_jacobian
from pgmp_petsc.mechanism.frame_tie import N_TIES, frame_ties
from pgmp_petsc.mechanism.joints import N_FRAME, N_PAIR
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.null_space import null_space


class ConstraintSet:
    """Constraints ``c(q) = 0`` of a mechanism's joints and frame ties, and ``phi_b - phi_a`` of the joints that are
    driven.

    Parameters
    ----------
    mechanism
        The mechanism.
    kept
        Numbers of the constraints to take, increasing; all by default. The redundant ones among the nodes, those of a
        joint that is there twice, make the equations of motion singular.

    Attributes
    ----------
    n_constraints
        Number of constraints taken, the driven rotations at the end.
    linear
        Whether all of them are linear in q.
    jacobian_pattern
        Rows (constraints) and columns (unknowns) of the entries of C, each of shape (n_entries,).
    curvature_pattern
        Rows and columns of the entries of ``sum lambda d2c/dq2``, one of each symmetric pair, each (n_curved,).
    """

    def __init__(self, mechanism: Mechanism, kept: np.ndarray | None = None) -> None:
        self._ties = tuple(frame_ties(mechanism.bodies, mechanism.n_constraints))
        n_own = self._ties[-1].rows.stop if self._ties else mechanism.n_constraints
        driven = mechanism.driven_connections(n_own)
        self._n_all = n_own + len(driven)
        kept = np.arange(n_own) if kept is None else kept
        self._kept = np.concatenate([kept, np.arange(n_own, self._n_all)])
        self.n_constraints = self._kept.size
        self.n_driven = len(driven)
        self._connections = (*mechanism.connections, *driven)
        self.linear = not self._ties and all(connection.linear for connection in self._connections)
        self._entries = [_find_entries(connection) for connection in self._connections]
        self.jacobian_pattern = self._jacobian_pattern()
        self.curvature_pattern = self._curvature_pattern()

    def residual(self, q: np.ndarray, driven: np.ndarray | None = None) -> np.ndarray:
        """Return c, shape (n_constraints, ...), m or rad.

        Parameters
        ----------
        q
            Nodal unknowns, shape (n_dofs, ...).
        driven
            Angles that the driven rotations are to have, shape (n_driven,), rad; none needed where nothing is driven.
        """
        result = np.empty((self._n_all, *q.shape[1:]))
        for connection in self._connections:
            result[connection.rows] = connection.residual(q)
        for tie in self._ties:
            result[tie.rows] = tie.residual(q)
        if self.n_driven:
            result[-self.n_driven :] -= driven.reshape(-1, *(1,) * (q.ndim - 1))
        return result[self._kept]

    def jacobian_values(self, q: np.ndarray) -> np.ndarray:
        """Return the entries of C on `jacobian_pattern`, shape (n_entries, ...)."""
        parts = []
        for connection, (rows, columns) in zip(self._connections, self._entries):
            parts.append(connection.jacobian(q)[rows, columns])
        for tie in self._ties:
            parts.append(tie.jacobian(q).reshape(-1, *q.shape[1:]))
        return np.concatenate(parts)[self._kept_entries]

    def curvature_values(self, q: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return the entries of ``sum lambda d2c/dq2`` on `curvature_pattern`, shape (n_curved, ...)."""
        everywhere = np.zeros((self._n_all, *multipliers.shape[1:]))
        everywhere[self._kept] = multipliers
        parts = [np.empty((0, *q.shape[1:]))]
        for connection in self._connections:
            if not connection.linear:
                columns = connection.moving_columns
                total = np.einsum("c...,cij...->ij...", everywhere[connection.rows], connection.hessian(q))
                i, j = np.tril_indices(columns.size)
                parts.append(total[columns[i], columns[j]])
        for tie in self._ties:
            parts.append(tie.curvature(q, everywhere[tie.rows]))
        return np.concatenate(parts)

    def drift(self, q: np.ndarray, v: np.ndarray, driven: np.ndarray | None = None) -> np.ndarray:
        """Return ``(dC/dt) v``, shape (n_constraints, ...): what is left of c'' at zero acceleration.

        `driven` are the angular accelerations of the driven rotations, shape (n_driven,), rad/s2.
        """
        result = np.zeros((self._n_all, *q.shape[1:]))
        for connection in self._connections:
            if not connection.linear:
                rate = np.zeros((N_PAIR, *q.shape[1:]))
                rate[connection.moving_columns] = v[connection.dofs]
                result[connection.rows] = np.einsum("cij...,i...,j...->c...", connection.hessian(q), rate, rate)
        for tie in self._ties:
            result[tie.rows] = tie.drift(q, v)
        if self.n_driven:
            result[-self.n_driven :] = -driven.reshape(-1, *(1,) * (q.ndim - 1))
        return result[self._kept]

    def _jacobian_pattern(self) -> tuple[np.ndarray, np.ndarray]:
        rows, unknowns = [], []
        for connection, (row, column) in zip(self._connections, self._entries):
            unknown_of = np.full(N_PAIR, -1)
            unknown_of[connection.moving_columns] = connection.dofs
            rows.append(connection.rows.start + row)
            unknowns.append(unknown_of[column])
        for tie in self._ties:
            rows.append(np.repeat(np.arange(tie.rows.start, tie.rows.stop), tie.dofs.size))
            unknowns.append(np.tile(tie.dofs, N_TIES))
        place = np.full(self._n_all, -1)
        place[self._kept] = np.arange(self._kept.size)
        row = place[np.concatenate(rows)]
        self._kept_entries = np.flatnonzero(row >= 0)
        return row[self._kept_entries], np.concatenate(unknowns)[self._kept_entries]

    def _curvature_pattern(self) -> tuple[np.ndarray, np.ndarray]:
        rows, columns = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
        for connection in self._connections:
            if not connection.linear:
                i, j = np.tril_indices(connection.dofs.size)
                rows.append(connection.dofs[i])
                columns.append(connection.dofs[j])
        for tie in self._ties:
            rows.append(np.full(tie.dofs.size, tie.frame[2]))
            columns.append(tie.dofs)
        return np.concatenate(rows), np.concatenate(columns)


def _find_entries(connection: Connection) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of a joint's Jacobian in its six node unknowns that can be nonzero."""
    generic = np.linspace(0.1, 0.7, N_PAIR)
    jacobian = connection.joint.jacobian(generic[:N_FRAME], generic[N_FRAME:])
    for first, side in zip((0, N_FRAME), connection.sides):
        if not side.on_ground and not side.at_node:
            jacobian[:, first + 2] += np.abs(jacobian[:, first : first + 2]).sum(axis=1)
    chosen = np.zeros(N_PAIR, dtype=bool)
    chosen[connection.moving_columns] = True
    return np.nonzero((jacobian != 0.0) & chosen)


def independent_constraints(kinematics: RigidKinematics, theta: np.ndarray) -> ConstraintSet:
    """Return a mechanism's constraints without those that follow from the others, as found at theta (n_theta,), rad."""
    mechanism = kinematics.mechanism
    poses = kinematics.poses(theta)[..., 0]
    return ConstraintSet(mechanism, null_space(constraint_jacobian(mechanism, poses)).rows)
