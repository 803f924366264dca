"""Statements about pairs of nodes as rows of a system of equations: values, derivatives on fixed patterns, drift.

Trailing axes of the unknowns (samples, configurations) are kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

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
    compiled
        The rows as compiled functions take them.
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
        self._compile()

    def values(self, q: np.ndarray, known: np.ndarray | float = 0.0) -> np.ndarray:
        """Return the statements, shape (n, ...), for unknowns (n_dofs, ...).

        In space angles are nearest to `known`, which broadcasts against the result, rad.
        """
        known = np.ascontiguousarray(np.broadcast_to(known, (self.n, *q.shape[1:])), dtype=float)
        return self._filled(_values, self.n, q, known)

    def gradients(self, q: np.ndarray) -> np.ndarray:
        """Return the first derivatives in the unknowns of `dofs`, shape (n, 2 m, ...)."""
        return self._derivatives(q)[0]

    def hessians(self, q: np.ndarray) -> np.ndarray:
        """Return the second derivatives in the unknowns of `dofs`, shape (n, 2 m, 2 m, ...)."""
        return self._derivatives(q)[1]

    def jacobian_values(self, q: np.ndarray) -> np.ndarray:
        """Return the first derivatives on `jacobian_pattern`, shape (n_entries, ...)."""
        return self._filled(_jacobian, self.jacobian_pattern[0].size, q)

    def curvature_values(self, q: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return the second derivatives times the rows' multipliers (n, ...) on `curvature_pattern`, shape (n_curved,
        ...)."""
        return self._filled(_curvature, self.curvature_pattern[0].size, q, multipliers)

    def drift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return ``v^T h v``, shape (n, ...): what the velocities do to the rates of the statements."""
        return self._filled(_drift, self.n, q, v)

    def _filled(self, fill, size: int, *arrays: np.ndarray) -> np.ndarray:
        trailing = arrays[0].shape[1:]
        n = math.prod(trailing)
        flat = [np.ascontiguousarray(array.reshape(len(array), n), dtype=float) for array in arrays]
        result = np.zeros((size, n))
        fill(self.compiled, *flat, result)
        return result.reshape(size, *trailing)

    def _derivatives(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        trailing, m = q.shape[1:], self.dofs.shape[1]
        n = math.prod(trailing)
        gradients, hessians = np.empty((self.n, m, n)), np.empty((self.n, m, m, n))
        unknowns = np.ascontiguousarray(q.reshape(len(q), n), dtype=float)
        _derivatives(self.statements, self.dofs, unknowns, gradients, hessians)
        return gradients.reshape(self.n, m, *trailing), hessians.reshape(self.n, m, m, *trailing)

    def _compile(self) -> None:
        """Find what is not zero at a place that no mechanism comes to, and what is the same everywhere."""
        n_dofs = self.dofs.max(initial=0) + 1
        gradients, hessians = self._derivatives(np.random.default_rng(0).normal(size=(n_dofs, 2)))
        moving = self.dofs >= 0
        lower = (self.dofs[:, :, None] >= self.dofs[:, None, :]) & moving[:, :, None] & moving[:, None, :]
        curved = (np.abs(hessians).max(axis=-1, initial=0.0) > ROUND_OFF) & moving[:, :, None] & moving[:, None, :]
        bent = curved.any(axis=(1, 2))
        first = (np.abs(gradients).max(axis=-1, initial=0.0) > ROUND_OFF) & moving
        rows, columns = np.nonzero(first)
        entries = _starts(rows, self.n), columns, self.dofs[rows, columns]
        self.jacobian_pattern = rows, entries[2]
        rows, i, j = np.nonzero(curved & lower)
        self.curvature_pattern = self.dofs[rows, i], self.dofs[rows, j]
        # linear rows are their value at zero and their slopes there
        at_zero = np.zeros((n_dofs, 1))
        slopes = self._derivatives(at_zero)[0][..., 0]
        self.compiled = Rows(
            self.statements, self.dofs, np.flatnonzero(~bent), np.flatnonzero(bent), np.zeros(self.n), entries,
            slopes[first], (_starts(rows, self.n), i, j),
        )  # fmt: skip
        constants = np.zeros((self.n, 1))
        _nonlinear_values(self.compiled, np.arange(self.n), at_zero, np.zeros((self.n, 1)), constants)
        self.compiled.constants[:] = constants[:, 0]


class Rows(NamedTuple):
    """Rows as compiled functions take them.

    Attributes
    ----------
    statements, dofs
        As in `StatementRows`.
    linear, bent
        Numbers of the rows that are linear in the unknowns, and of the others.
    constants
        Values where all unknowns are zero, shape (n,).
    entries
        First entry of each row (n + 1,) on the pattern of first derivatives, column in `dofs` and unknown of each.
    slopes
        First derivatives there where all unknowns are zero, shape (n_entries,).
    curved
        First entry of each row (n + 1,) on the pattern of second derivatives, and its two columns in `dofs`.
    """

    statements: NodeStatements
    dofs: np.ndarray
    linear: np.ndarray
    bent: np.ndarray
    constants: np.ndarray
    entries: tuple[np.ndarray, np.ndarray, np.ndarray]
    slopes: np.ndarray
    curved: tuple[np.ndarray, np.ndarray, np.ndarray]


def _starts(rows: np.ndarray, n: int) -> np.ndarray:
    """Return the first of the entries of each of n rows, and their number, shape (n + 1,)."""
    return np.searchsorted(rows, np.arange(n + 1))


@njit(inline="always")
def _gather(dofs, k, q, sample, y):
    """Fill the unknowns (2 m,) of row k."""
    for i in range(y.size):
        y[i] = q[dofs[k, i], sample] if dofs[k, i] >= 0 else 0.0


@njit(cache=True, error_model="numpy")
def _values(rows, q, known, result):
    """Fill values (n, n_samples)."""
    starts, _, unknowns = rows.entries
    for k in rows.linear:
        result[k] = rows.constants[k]
        for entry in range(starts[k], starts[k + 1]):
            slope, own = rows.slopes[entry], q[unknowns[entry]]
            for sample in range(q.shape[1]):
                result[k, sample] += slope * own[sample]
    _nonlinear_values(rows, rows.bent, q, known, result)


@njit(cache=True, error_model="numpy")
def _nonlinear_values(rows, numbers, q, known, result):
    width = rows.dofs.shape[1]
    scratch, y, g, h = scratch_of(rows.statements, width // 2), np.zeros(width), np.zeros(width), np.zeros((1, 1))
    for k in numbers:
        for sample in range(q.shape[1]):
            _gather(rows.dofs, k, q, sample, y)
            result[k, sample] = state(rows.statements, k, y, known[k, sample], False, scratch, g, h)


@njit(cache=True, error_model="numpy")
def _jacobian(rows, q, result):
    """Fill first derivatives (n_entries, n_samples)."""
    starts, columns, _ = rows.entries
    for k in rows.linear:
        for entry in range(starts[k], starts[k + 1]):
            result[entry] = rows.slopes[entry]
    width = rows.dofs.shape[1]
    scratch, y, g, h = scratch_of(rows.statements, width // 2), np.zeros(width), np.zeros(width), np.zeros((1, 1))
    for k in rows.bent:
        for sample in range(q.shape[1]):
            _gather(rows.dofs, k, q, sample, y)
            state(rows.statements, k, y, 0.0, False, scratch, g, h)
            for entry in range(starts[k], starts[k + 1]):
                result[entry, sample] = g[columns[entry]]


@njit(cache=True, error_model="numpy")
def _curvature(rows, q, multipliers, result):
    """Fill second derivatives times multipliers (n_curved, n_samples)."""
    starts, one, other = rows.curved
    width = rows.dofs.shape[1]
    scratch, y, g = scratch_of(rows.statements, width // 2), np.zeros(width), np.zeros(width)
    h = np.zeros((width, width))
    for k in rows.bent:
        for sample in range(q.shape[1]):
            _gather(rows.dofs, k, q, sample, y)
            state(rows.statements, k, y, 0.0, True, scratch, g, h)
            for entry in range(starts[k], starts[k + 1]):
                result[entry, sample] = multipliers[k, sample] * h[one[entry], other[entry]]


@njit(cache=True, error_model="numpy")
def _drift(rows, q, v, result):
    """Fill ``v^T h v`` (n, n_samples)."""
    width = rows.dofs.shape[1]
    scratch, y, g = scratch_of(rows.statements, width // 2), np.zeros(width), np.zeros(width)
    rates, h = np.zeros(width), np.zeros((width, width))
    for k in rows.bent:
        for sample in range(q.shape[1]):
            _gather(rows.dofs, k, q, sample, y)
            _gather(rows.dofs, k, v, sample, rates)
            state(rows.statements, k, y, 0.0, True, scratch, g, h)
            result[k, sample] = rates @ (h @ rates)


@njit(cache=True, error_model="numpy")
def _derivatives(statements, dofs, q, gradients, hessians):
    """Fill gradients (n, 2 m, n_samples) and hessians (n, 2 m, 2 m, n_samples)."""
    n, width = dofs.shape
    scratch, y, g = scratch_of(statements, width // 2), np.zeros(width), np.zeros(width)
    h = np.zeros((width, width))
    for k in range(n):
        for sample in range(q.shape[1]):
            _gather(dofs, k, q, sample, y)
            state(statements, k, y, 0.0, True, scratch, g, h)
            gradients[k, :, sample] = g
            hessians[k, :, :, sample] = h
