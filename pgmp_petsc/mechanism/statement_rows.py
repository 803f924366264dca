"""Statements about pairs of nodes as rows of a system of equations: values, derivatives on fixed patterns, drift.

Trailing axes of the unknowns (samples, configurations) are kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.node_statements import NodeStatements, scratch_of, state
from pgmp_petsc.mechanism.statements import Statement
from pgmp_petsc.runtime.compiled import njit

ROUND_OFF = 1e-14  # of derivatives of order 1 at a generic place, below which they are zero everywhere


class StatementRows:
    """Statements about pairs of nodes, one a row.

    Parameters
    ----------
    parts
        The statements.
    sides
        Their attachments.
    node_dofs
        From a node to the unknowns that its frame depends on, shape (m,): ``(x, y, phi)`` or natural coordinates.
    dimension
        2 in the plane, 3 in space.

    Attributes
    ----------
    n
        Number of rows.
    dofs
        Unknowns of both nodes, -1 on the ground, shape (n, 2 m).
    jacobian_pattern
        Rows and unknowns of the first derivatives that are not zero everywhere, each of shape (n_entries,).
    curvature_pattern
        Rows and columns among all unknowns of the second derivatives of all rows that are not, one of each symmetric
        pair, each of shape (n_curved,). Rows repeat a pair.
    """

    def __init__(
        self,
        parts: Sequence[Statement],
        sides: Sequence[tuple[Attachment, Attachment]],
        node_dofs: Callable[[int], np.ndarray],
        dimension: int,
    ) -> None:
        self.n = len(parts)
        self.statements = NodeStatements.of(parts, sides, dimension)
        grounded = np.full(node_dofs(0).size, -1)
        dofs = [[grounded if side.on_ground else node_dofs(side.node) for side in pair] for pair in sides]
        self.dofs = np.array(dofs, dtype=np.int64).reshape(self.n, 2 * grounded.size)
        self._find_patterns()

    def values(self, q: np.ndarray, known: np.ndarray | float = 0.0) -> np.ndarray:
        """Return the statements, shape (n, ...), for unknowns (n_dofs, ...).

        In space angles are nearest to `known`, which broadcasts against the result, rad.
        """
        return self._evaluated(q, known, False, False)[0]

    def gradients(self, q: np.ndarray) -> np.ndarray:
        """Return the first derivatives in the unknowns of `dofs`, shape (n, 2 m, ...)."""
        return self._evaluated(q, 0.0, True, False)[1]

    def hessians(self, q: np.ndarray) -> np.ndarray:
        """Return the second derivatives in the unknowns of `dofs`, shape (n, 2 m, 2 m, ...)."""
        return self._evaluated(q, 0.0, True, True)[2]

    def jacobian_values(self, q: np.ndarray) -> np.ndarray:
        """Return the first derivatives on `jacobian_pattern`, shape (n_entries, ...)."""
        return self.gradients(q)[self._entries]

    def curvature_values(self, q: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return the second derivatives times the rows' multipliers (n, ...) on `curvature_pattern`, shape (n_curved,
        ...)."""
        rows = self._curved[0]
        if not rows.size:
            return np.zeros((0, *q.shape[1:]))
        return multipliers[rows] * self.hessians(q)[self._curved]

    def drift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return ``v^T h v``, shape (n, ...): what the velocities do to the rates of the statements."""
        rates = v[self.dofs]
        rates[self.dofs < 0] = 0.0
        return np.einsum("nij...,ni...,nj...->n...", self.hessians(q), rates, rates)

    def _evaluated(
        self, q: np.ndarray, known: np.ndarray | float, first: bool, second: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        trailing, m = q.shape[1:], self.dofs.shape[1]
        n = math.prod(trailing)
        unknowns = np.ascontiguousarray(q.reshape(len(q), n))
        known = np.ascontiguousarray(np.broadcast_to(known, (self.n, *trailing)), dtype=float).reshape(self.n, n)
        values = np.empty((self.n, n))
        gradients = np.empty((self.n if first else 0, m, n))
        hessians = np.empty((self.n if second else 0, m, m, n))
        _evaluate(self.statements, self.dofs, unknowns, known, first, second, values, gradients, hessians)
        return tuple(part.reshape(*part.shape[:-1], *trailing) for part in (values, gradients, hessians))

    def _find_patterns(self) -> None:
        """Find what is not zero at a place that no mechanism comes to."""
        n_dofs = self.dofs.max(initial=0) + 1
        generic = np.random.default_rng(0).normal(size=(n_dofs, 2))
        moving = self.dofs >= 0
        gradients, hessians = self.gradients(generic), self.hessians(generic)
        self._entries = np.nonzero((np.abs(gradients).max(axis=-1) > ROUND_OFF) & moving)
        rows, columns = self._entries
        self.jacobian_pattern = rows, self.dofs[rows, columns]
        lower = self.dofs[:, :, None] >= self.dofs[:, None, :]
        pairs = moving[:, :, None] & moving[:, None, :] & lower
        self._curved = np.nonzero((np.abs(hessians).max(axis=-1, initial=0.0) > ROUND_OFF) & pairs)
        rows, i, j = self._curved
        self.curvature_pattern = self.dofs[rows, i], self.dofs[rows, j]


@njit(cache=True, error_model="numpy")
def _evaluate(statements, dofs, q, known, first, second, values, gradients, hessians):
    """Fill values (n, n_samples), and where they are wanted gradients (n, 2 m, n_samples) and hessians (n, 2 m, 2 m,
    n_samples)."""
    n, width = dofs.shape
    scratch = scratch_of(statements, width // 2)
    y, g, h = np.zeros(width), np.zeros(width), np.zeros((width, width))
    for k in range(n):
        for sample in range(q.shape[1]):
            for i in range(width):
                y[i] = q[dofs[k, i], sample] if dofs[k, i] >= 0 else 0.0
            values[k, sample] = state(statements, k, y, known[k, sample], second, scratch, g, h)
            if first:
                gradients[k, :, sample] = g
            if second:
                hessians[k, :, :, sample] = h
