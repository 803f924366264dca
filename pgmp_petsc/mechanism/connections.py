"""All constraints of a mechanism in nodal unknowns: residual, Jacobian and curvature on fixed patterns.

Trailing axes of q (samples) are kept; entries are given as values on a pattern that does not depend on q.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.mechanism.joints import N_PAIR
from pgmp_petsc.mechanism.mechanism import Connection, Mechanism


class ConstraintSet:
    """Constraints ``c(q) = 0`` of a mechanism.

    Attributes
    ----------
    linear
        Whether all of them are linear in q.
    jacobian_pattern
        Rows (constraints) and columns (unknowns) of the entries of C, each of shape (n_entries,).
    curvature_pattern
        Rows and columns of the entries of ``sum lambda d2c/dq2``, one of each symmetric pair, each (n_curved,).
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.n_constraints = mechanism.n_constraints
        self._connections = mechanism.connections
        self._dofs = [mechanism.constraint_dofs(connection) for connection in self._connections]
        self.linear = all(connection.joint.linear for connection in self._connections)
        self._entries = [self._find_entries(c, columns) for c, (_, columns) in zip(self._connections, self._dofs)]
        self.jacobian_pattern = self._jacobian_pattern()
        self.curvature_pattern = self._curvature_pattern()

    def residual(self, q: np.ndarray) -> np.ndarray:
        """Return c, shape (n_constraints, ...), m, for q of shape (n_dofs, ...)."""
        result = np.empty((self.n_constraints, *q.shape[1:]))
        for connection in self._connections:
            result[connection.rows] = connection.joint.residual(*_frames(connection, q))
        return result

    def jacobian_values(self, q: np.ndarray) -> np.ndarray:
        """Return the entries of C on `jacobian_pattern`, shape (n_entries, ...)."""
        parts = []
        for connection, (rows, columns) in zip(self._connections, self._entries):
            jacobian = connection.joint.jacobian(*_frames(connection, q))
            parts.append(jacobian[rows, columns])
        return np.concatenate(parts)

    def curvature_values(self, q: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return the entries of ``sum lambda d2c/dq2`` on `curvature_pattern`, shape (n_curved, ...)."""
        parts = [np.empty((0, *q.shape[1:]))]
        for connection, (_, columns) in zip(self._connections, self._dofs):
            if not connection.joint.linear:
                hessian = connection.joint.hessian(*_frames(connection, q))
                total = np.einsum("c...,cij...->ij...", multipliers[connection.rows], hessian)
                i, j = np.tril_indices(columns.size)
                parts.append(total[columns[i], columns[j]])
        return np.concatenate(parts)

    def drift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return ``(dC/dt) v``, shape (n_constraints, ...): what is left of c'' at zero acceleration."""
        result = np.zeros((self.n_constraints, *q.shape[1:]))
        for connection, (dofs, columns) in zip(self._connections, self._dofs):
            if not connection.joint.linear:
                rate = np.zeros((N_PAIR, *q.shape[1:]))
                rate[columns] = v[dofs]
                hessian = connection.joint.hessian(*_frames(connection, q))
                result[connection.rows] = np.einsum("cij...,i...,j...->c...", hessian, rate, rate)
        return result

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
        return np.concatenate(rows), np.concatenate(unknowns)

    def _curvature_pattern(self) -> tuple[np.ndarray, np.ndarray]:
        rows, columns = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
        for connection, (dofs, _) in zip(self._connections, self._dofs):
            if not connection.joint.linear:
                i, j = np.tril_indices(dofs.size)
                rows.append(dofs[i])
                columns.append(dofs[j])
        return np.concatenate(rows), np.concatenate(columns)


def _frames(connection: Connection, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return connection.a.frame_of_node(q), connection.b.frame_of_node(q)
