"""All constraints of a mechanism in nodal unknowns: residual, Jacobian and curvature on fixed patterns.

Trailing axes of q (samples) are kept; entries are given as values on a pattern that does not depend on q.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.mechanism.constraints import constraint_jacobian
from pgmp_petsc.mechanism.joints import N_PAIR
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Connection, Mechanism
from pgmp_petsc.mechanism.null_space import null_space


class ConstraintSet:
    """Constraints ``c(q) = 0`` of a mechanism.

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
        Number of constraints taken.
    linear
        Whether all of them are linear in q.
    jacobian_pattern
        Rows (constraints) and columns (unknowns) of the entries of C, each of shape (n_entries,).
    curvature_pattern
        Rows and columns of the entries of ``sum lambda d2c/dq2``, one of each symmetric pair, each (n_curved,).
    """

    def __init__(self, mechanism: Mechanism, kept: np.ndarray | None = None) -> None:
        self._kept = np.arange(mechanism.n_constraints) if kept is None else kept
        self._n_all = mechanism.n_constraints
        self.n_constraints = self._kept.size
        self._connections = mechanism.connections
        self._dofs = [mechanism.constraint_dofs(connection) for connection in self._connections]
        self.linear = all(connection.joint.linear for connection in self._connections)
        self._entries = [self._find_entries(c, columns) for c, (_, columns) in zip(self._connections, self._dofs)]
        self.jacobian_pattern = self._jacobian_pattern()
        self.curvature_pattern = self._curvature_pattern()

    def residual(self, q: np.ndarray) -> np.ndarray:
        """Return c, shape (n_constraints, ...), m, for q of shape (n_dofs, ...)."""
        result = np.empty((self._n_all, *q.shape[1:]))
        for connection in self._connections:
            result[connection.rows] = connection.joint.residual(*_frames(connection, q))
        return result[self._kept]

    def jacobian_values(self, q: np.ndarray) -> np.ndarray:
        """Return the entries of C on `jacobian_pattern`, shape (n_entries, ...)."""
        parts = []
        for connection, (rows, columns) in zip(self._connections, self._entries):
            jacobian = connection.joint.jacobian(*_frames(connection, q))
            parts.append(jacobian[rows, columns])
        return np.concatenate(parts)[self._kept_entries]

    def curvature_values(self, q: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return the entries of ``sum lambda d2c/dq2`` on `curvature_pattern`, shape (n_curved, ...)."""
        everywhere = np.zeros((self._n_all, *multipliers.shape[1:]))
        everywhere[self._kept] = multipliers
        parts = [np.empty((0, *q.shape[1:]))]
        for connection, (_, columns) in zip(self._connections, self._dofs):
            if not connection.joint.linear:
                hessian = connection.joint.hessian(*_frames(connection, q))
                total = np.einsum("c...,cij...->ij...", everywhere[connection.rows], hessian)
                i, j = np.tril_indices(columns.size)
                parts.append(total[columns[i], columns[j]])
        return np.concatenate(parts)

    def drift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return ``(dC/dt) v``, shape (n_constraints, ...): what is left of c'' at zero acceleration."""
        result = np.zeros((self._n_all, *q.shape[1:]))
        for connection, (dofs, columns) in zip(self._connections, self._dofs):
            if not connection.joint.linear:
                rate = np.zeros((N_PAIR, *q.shape[1:]))
                rate[columns] = v[dofs]
                hessian = connection.joint.hessian(*_frames(connection, q))
                result[connection.rows] = np.einsum("cij...,i...,j...->c...", hessian, rate, rate)
        return result[self._kept]

    def _find_entries(self, connection: Connection, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and frame columns of a joint's Jacobian that can be nonzero."""
        generic = np.linspace(0.1, 0.7, N_PAIR)
        jacobian = connection.joint.jacobian(generic[:3], generic[3:])
        chosen = np.zeros(N_PAIR, dtype=bool)
        chosen[columns] = True
        return np.nonzero((jacobian != 0.0) & chosen)

    def _jacobian_pattern(self) -> tuple[np.ndarray, np.ndarray]:
        rows, unknowns = [], []
        for connection, (dofs, columns), (row, column) in zip(self._connections, self._dofs, self._entries):
            unknown_of = np.full(N_PAIR, -1)
            unknown_of[columns] = dofs
            rows.append(connection.rows.start + row)
            unknowns.append(unknown_of[column])
        place = np.full(self._n_all, -1)
        place[self._kept] = np.arange(self._kept.size)
        row = place[np.concatenate(rows)]
        self._kept_entries = np.flatnonzero(row >= 0)
        return row[self._kept_entries], np.concatenate(unknowns)[self._kept_entries]

    def _curvature_pattern(self) -> tuple[np.ndarray, np.ndarray]:
        rows, columns = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
        for connection, (dofs, _) in zip(self._connections, self._dofs):
            if not connection.joint.linear:
                i, j = np.tril_indices(dofs.size)
                rows.append(dofs[i])
                columns.append(dofs[j])
        return np.concatenate(rows), np.concatenate(columns)


def independent_constraints(kinematics: RigidKinematics, theta: float) -> ConstraintSet:
    """Return the constraints of a mechanism without those that follow from the others, as found at theta (rad)."""
    mechanism = kinematics.mechanism
    poses = kinematics.poses(np.array([theta]))[..., 0]
    return ConstraintSet(mechanism, null_space(constraint_jacobian(mechanism, poses)).rows)


def _frames(connection: Connection, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return connection.a.frame_of_node(q), connection.b.frame_of_node(q)
