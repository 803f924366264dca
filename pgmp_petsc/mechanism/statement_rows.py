"""Statements about pairs of nodes as rows of a system of equations: values, derivatives on fixed patterns, drift.

Trailing axes of the unknowns (samples, configurations) are kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.node_statements import NodeStatements, scratch_of, state
from pgmp_petsc.mechanism.statements import Statement

VALUES, SLOPES, CURVATURES, DRIFT = range(4)
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
        known = np.array(np.broadcast_to(known, (self.n, *q.shape[1:])))
        return self._evaluated(VALUES, self.n, q, known)

    def gradients(self, q: np.ndarray) -> np.ndarray:
        """Return the first derivatives in the unknowns of `dofs`, shape (n, 2 m, ...)."""
        return self._everything(SLOPES, q).reshape(*self.dofs.shape, *q.shape[1:])

    def hessians(self, q: np.ndarray) -> np.ndarray:
        """Return the second derivatives in the unknowns of `dofs`, shape (n, 2 m, 2 m, ...)."""
        return self._everything(CURVATURES, q).reshape(*self.dofs.shape, self.dofs.shape[1], *q.shape[1:])

    def jacobian_values(self, q: np.ndarray) -> np.ndarray:
        """Return the first derivatives on `jacobian_pattern`, shape (n_entries, ...)."""
        return self._evaluated(SLOPES, self.jacobian_pattern[0].size, q)

    def curvature_values(self, q: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return the second derivatives times the rows' multipliers (n, ...) on `curvature_pattern`, shape (n_curved,
        ...)."""
        return self._evaluated(CURVATURES, self.curvature_pattern[0].size, q, multipliers)

    def drift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return ``v^T h v``, shape (n, ...): what the velocities do to the rates of the statements."""
        return self._evaluated(DRIFT, self.n, q, rates=v)

    def _evaluated(
        self,
        what: int,
        size: int,
        q: np.ndarray,
        known: np.ndarray | None = None,
        rates: np.ndarray | None = None,
        rows: Rows | None = None,
    ) -> np.ndarray:
        """Return what is wanted, shape (size, ...); `known` are the angles or the multipliers of the rows."""
        trailing = q.shape[1:]
        n = math.prod(trailing)
        if not size * n:
            return np.zeros((size, *trailing))
        known = np.zeros((0, n)) if known is None else known
        arrays = (q, q if rates is None else rates, known)
        q, rates, known = (np.ascontiguousarray(part.reshape(len(part), n), dtype=float) for part in arrays)
        result = np.zeros((size, n))
        _evaluate(what, self.compiled if rows is None else rows, q, rates, known, result)
        return result.reshape(size, *trailing)

    def _everything(self, what: int, q: np.ndarray) -> np.ndarray:
        """Return all first or second derivatives, zeros included, row by row."""
        ones = np.ones((self.n, *q.shape[1:]))
        size = self.dofs.size * (1 if what == SLOPES else self.dofs.shape[1])
        return self._evaluated(what, size, q, ones, rows=self._all)

    @cached_property
    def _all(self) -> Rows:
        """Return the rows with every derivative on their patterns, none of them known beforehand."""
        width = self.dofs.shape[1]
        everyone, columns = np.arange(self.n), np.tile(np.arange(width), self.n)
        pairs = np.tile(np.indices((width, width)).reshape(2, -1), self.n)
        return Rows(
            self.statements, self.dofs, everyone[:0], everyone, np.zeros(self.n),
            (width * np.arange(self.n + 1), columns, self.dofs.ravel()), np.zeros(columns.size),
            (width**2 * np.arange(self.n + 1), *np.ascontiguousarray(pairs)),
        )  # fmt: skip

    def _compile(self) -> None:
        """Find what is not zero at a place that no mechanism comes to, and what is the same everywhere."""
        n_dofs = self.dofs.max(initial=0) + 1
        generic, at_zero = np.random.default_rng(0).normal(size=(n_dofs, 2)), np.zeros((n_dofs, 1))
        gradients, hessians = self.gradients(generic), self.hessians(generic)
        moving = self.dofs >= 0
        lower = (self.dofs[:, :, None] >= self.dofs[:, None, :]) & moving[:, :, None] & moving[:, None, :]
        curved = (np.abs(hessians).max(axis=-1, initial=0.0) > ROUND_OFF) & moving[:, :, None] & moving[:, None, :]
        bent = curved.any(axis=(1, 2))
        first = (np.abs(gradients).max(axis=-1, initial=0.0) > ROUND_OFF) & moving
        rows, columns = np.array(np.nonzero(first))  # contiguous, as everywhere: one compiled function for all
        entries = _starts(rows, self.n), columns, self.dofs[rows, columns]
        self.jacobian_pattern = rows, entries[2]
        rows, i, j = np.array(np.nonzero(curved & lower))
        self.curvature_pattern = self.dofs[rows, i], self.dofs[rows, j]
        # linear rows are their value at zero and their slopes there
        constants = self._evaluated(VALUES, self.n, at_zero, np.zeros((self.n, 1)), rows=self._all).ravel()
        self.compiled = Rows(
            self.statements, self.dofs, np.flatnonzero(~bent), np.flatnonzero(bent), constants, entries,
            self.gradients(at_zero)[..., 0][first], (_starts(rows, self.n), i, j),
        )  # fmt: skip


class Rows(NamedTuple):
    """Rows as compiled functions take them."""

    #: statements, dofs: as in `StatementRows`
    statements: NodeStatements
    dofs: np.ndarray
    #: linear, bent: numbers of the rows that are linear in the unknowns, and of the others
    linear: np.ndarray
    bent: np.ndarray
    constants: np.ndarray  # values where all unknowns are zero, shape (n,)
    #: first entry of each row (n + 1,) on the pattern of first derivatives, column in `dofs` and unknown of each
    entries: tuple[np.ndarray, np.ndarray, np.ndarray]
    slopes: np.ndarray  # first derivatives there where all unknowns are zero, shape (n_entries,)
    #: first entry of each row (n + 1,) on the pattern of second derivatives, and its two columns in `dofs`
    curved: tuple[np.ndarray, np.ndarray, np.ndarray]


def _starts(rows: np.ndarray, n: int) -> np.ndarray:
    """Return the first of the entries of each of n rows, and their number, shape (n + 1,)."""
    return np.searchsorted(rows, np.arange(n + 1))


@njit(cache=True, entry=True, error_model="numpy")
def _evaluate(what, rows, q, rates, known, result):
    """Fill what is wanted of all rows, for all samples; one function, as each compiles the statements anew.

    Parameters
    ----------
    what
        ``VALUES``, ``SLOPES`` or ``CURVATURES`` on the patterns of `rows`, or ``DRIFT``.
    q, rates
        Shape (n_dofs, n_samples); the rates are for the drift.
    known
        What angles are nearest to, or the multipliers of the curvatures, shape (n, n_samples).
    result
        Zeros, shape (n or n_entries or n_curved, n_samples).
    """
    starts, columns, unknowns = rows.entries
    curved_starts, one, other = rows.curved
    n_samples, width = q.shape[1], rows.dofs.shape[1]
    for k in rows.linear:
        if what == VALUES:
            for sample in range(n_samples):
                result[k, sample] = rows.constants[k]
        for entry in range(starts[k], starts[k + 1]):
            slope = rows.slopes[entry]
            for sample in range(n_samples):
                if what == VALUES:
                    result[k, sample] += slope * q[unknowns[entry], sample]
                elif what == SLOPES:
                    result[entry, sample] = slope
    scratch, y, g = scratch_of(rows.statements, width // 2), np.zeros(width), np.zeros(width)
    second = what == CURVATURES or what == DRIFT
    h = np.zeros((width, width)) if second else np.zeros((1, 1))
    for k in rows.bent:
        for sample in range(n_samples):
            for i in range(width):
                y[i] = q[rows.dofs[k, i], sample] if rows.dofs[k, i] >= 0 else 0.0
            near = known[k, sample] if what == VALUES else 0.0
            s = state(rows.statements, k, y, near, second, scratch, g, h)
            if what == VALUES:
                result[k, sample] = s
            elif what == SLOPES:
                for entry in range(starts[k], starts[k + 1]):
                    result[entry, sample] = g[columns[entry]]
            elif what == CURVATURES:
                for entry in range(curved_starts[k], curved_starts[k + 1]):
                    result[entry, sample] = known[k, sample] * h[one[entry], other[entry]]
            else:
                for i in range(width):
                    for j in range(width):
                        if h[i, j] != 0.0:
                            turning = _rate(rows, k, i, rates, sample) * _rate(rows, k, j, rates, sample)
                            result[k, sample] += h[i, j] * turning


@njit(inline="always")
def _rate(rows, k, i, rates, sample):
    """Return the rate of the unknown i of a row, zero on the ground."""
    dof = rows.dofs[k, i]
    return rates[dof, sample] if dof >= 0 else 0.0
