"""Factorisation of many small sparse symmetric matrices of one pattern at once.

The iteration matrices of a batch of full-order samples differ in their numbers only. Ordering and fill-in are found
once; the numeric factorisation ``L D L^T`` then runs over the common pattern, with the samples of a block side by side
in the innermost loop (see `lanes`), where they vectorise. A sample never touches another's numbers.

There is no pivoting: the matrices are saddle points ``[[S, C^T], [C, 0]]`` with S positive definite at reasonable
steps, and the ordering puts every constraint behind all unknowns that it acts on; each leading block is then
non-singular, because C has full rank.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import reverse_cuthill_mckee

from pgmp_petsc.runtime.compiled import njit


@dataclass(frozen=True)
class Symbolic:
    """Elimination order and fill pattern.

    Attributes
    ----------
    order
        ``order[k]`` is the unknown eliminated k-th, shape (n,).
    starts, rows
        Columns of L below the diagonal in elimination order: column k holds ``rows[starts[k]:starts[k+1]]``.
    targets
        Where each product of a column's entries goes, in the order in which `factorise` meets them: an entry of L, or
        ``-1 - row`` for a diagonal one.
    """

    order: np.ndarray
    starts: np.ndarray
    rows: np.ndarray
    targets: np.ndarray

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.order.size

    @cached_property
    def place(self) -> np.ndarray:
        """Turn of every unknown in the elimination, shape (n,)."""
        place = np.empty(self.n, dtype=np.int64)
        place[self.order] = np.arange(self.n)
        return place

    def position(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Return where matrix entries (unknown numbers) are stored: entry of L, or ``-1 - k`` on the diagonal."""
        first, second = self.place[np.asarray(row)], self.place[np.asarray(column)]
        lower, upper = np.maximum(first, second), np.minimum(first, second)
        # entries lie column after column, each with growing rows
        stored = np.repeat(np.arange(self.n), np.diff(self.starts)) * self.n + self.rows
        return np.where(lower == upper, -1 - lower, np.searchsorted(stored, upper * self.n + lower))


def analyse(pattern: sp.spmatrix, constraints: np.ndarray) -> Symbolic:
    """Find an elimination order and the fill-in.

    Parameters
    ----------
    pattern
        Symmetric pattern, shape (n, n).
    constraints
        Unknowns that are multipliers: each is eliminated after all unknowns that it is coupled with.
    """
    pattern = sp.csr_matrix(pattern)
    order = _constraints_last(reverse_cuthill_mckee(pattern, symmetric_mode=True), pattern, constraints)
    place = np.empty(order.size, dtype=np.int64)
    place[order] = np.arange(order.size)
    columns: list[set[int]] = [set() for _ in order]
    coo = pattern.tocoo()
    for i, j in zip(place[coo.row], place[coo.col]):
        if i > j:
            columns[j].add(int(i))
    for column in columns:
        if column:
            # fill-in: the first row below inherits the rest (elimination tree)
            parent = min(column)
            columns[parent] |= column - {parent}
    starts = np.concatenate([[0], np.cumsum([len(column) for column in columns])]).astype(np.int64)
    rows = np.array([i for column in columns for i in sorted(column)], dtype=np.int64)
    targets = []
    for k in range(order.size):
        below = rows[starts[k] : starts[k + 1]]
        for a, row in enumerate(below):
            for column in below[:a]:
                inside = rows[starts[column] : starts[column + 1]]
                targets.append(starts[column] + np.searchsorted(inside, row))
            targets.append(-1 - row)
    return Symbolic(order, starts, rows, np.array(targets, dtype=np.int64))


def _constraints_last(order: np.ndarray, pattern: sp.csr_matrix, constraints: np.ndarray) -> np.ndarray:
    """Move each multiplier right behind the last unknown that it is coupled with."""
    place = np.empty(order.size)
    place[order] = np.arange(order.size)
    for multiplier in constraints:
        neighbours = pattern.indices[pattern.indptr[multiplier] : pattern.indptr[multiplier + 1]]
        neighbours = neighbours[~np.isin(neighbours, constraints)]
        place[multiplier] = max(place[neighbours]) + 0.5
    return np.argsort(place, kind="stable")


@njit(cache=True, error_model="numpy")
def factorise(starts, targets, diagonal, lower):
    """Factorise in place, all lanes of a block: ``lower`` becomes L, ``diagonal`` becomes the inverse of D.

    Parameters
    ----------
    starts, targets
        Of the symbolic factorisation.
    diagonal
        Shape (n, n_lanes), in elimination order.
    lower
        Entries below the diagonal, shape (n_entries, n_lanes).
    """
    n_lanes = diagonal.shape[1]
    at = 0
    for k in range(diagonal.shape[0]):
        for lane in range(n_lanes):
            diagonal[k, lane] = 1.0 / diagonal[k, lane]
        for a in range(starts[k], starts[k + 1]):
            for b in range(starts[k], a):
                target = targets[at]
                at += 1
                for lane in range(n_lanes):
                    lower[target, lane] -= lower[a, lane] * lower[b, lane]
            row = -1 - targets[at]
            at += 1
            for lane in range(n_lanes):
                scaled = lower[a, lane] * diagonal[k, lane]
                diagonal[row, lane] -= lower[a, lane] * scaled
                lower[a, lane] = scaled


@njit(cache=True, error_model="numpy")
def substitute(starts, rows, diagonal, lower, x):
    """Solve ``L D L^T y = x`` in place, x of shape (n, n_lanes) in elimination order."""
    n_lanes = x.shape[1]
    n = diagonal.shape[0]
    for k in range(n):
        for a in range(starts[k], starts[k + 1]):
            row = rows[a]
            for lane in range(n_lanes):
                x[row, lane] -= lower[a, lane] * x[k, lane]
    for k in range(n - 1, -1, -1):
        for lane in range(n_lanes):
            x[k, lane] *= diagonal[k, lane]
        for a in range(starts[k], starts[k + 1]):
            row = rows[a]
            for lane in range(n_lanes):
                x[k, lane] -= lower[a, lane] * x[row, lane]
