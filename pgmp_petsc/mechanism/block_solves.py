"""Many small systems ``J x = right`` of rigid mechanisms, compiled: square ones by blocks, others in least squares.

Where some motions of bodies follow from others, as along a chain, J has a block triangular form (Duff and Reid 1978).
The blocks on its diagonal are inverted (Gauss and Jordan, with pivots), which shows at once how far from singular they
are; what is near is left to QR and singular values. Each J goes its own way, so that the others have no part in its
last digits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from graphlib import TopologicalSorter
from typing import Self

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components, maximum_bipartite_matching

from pgmp_petsc.lanes.compiled import njit

FAR_FROM_SINGULAR = 1e6  # norm of J times that of its inverse, at which the inverse loses six digits of sixteen
RANK_TOLERANCE = 1e-10  # of the largest pivot or singular value of J


@dataclass(frozen=True, eq=False)
class Blocks:
    """The block triangular form of square matrices, in the order in which blocks are solved."""

    #: starts, rows, columns: first row of each block and their number (n_blocks + 1,), and rows and columns of J, (m,)
    starts: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    #: entered, before: columns of blocks before in which rows of each block have entries, and where its own begin
    entered: np.ndarray
    before: np.ndarray

    @classmethod
    def of(cls, blocks: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Self:
        """Take them from `triangular_blocks`."""
        rows, columns, before = (np.concatenate(part).astype(np.int64) for part in zip(*blocks))
        entered = np.cumsum([0, *(len(block[2]) for block in blocks)])
        return cls(np.cumsum([0, *(len(block[0]) for block in blocks)]), rows, columns, entered, before)

    @classmethod
    def whole(cls, m: int) -> Self:
        """Return the one block of matrices (m, m) of no form."""
        return cls.of([(np.arange(m), np.arange(m), np.arange(0))])

    def factorise(self, matrices: np.ndarray) -> np.ndarray:
        """Put inverses in place of the blocks of matrices (n, m, m); return which are far from singular, (n,)."""
        sound = np.ones(len(matrices), dtype=bool)
        work, pivots = np.empty(matrices.shape[1:]), np.empty(len(self.rows), dtype=np.int64)
        _factorise(matrices, self.starts, self.rows, self.columns, work, pivots, sound)
        return sound

    def substituted(self, factors: np.ndarray, chosen: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Return x (n, m, k) for right-hand sides of this shape, by chosen ones (n,) of matrices after `factorise`."""
        found = np.empty(right.shape)
        parts = self.starts, self.rows, self.columns, self.entered, self.before
        _substitute(factors, chosen, np.ascontiguousarray(right), *parts, np.empty(right.shape[1:]), found)
        return found


def solver(jacobian: np.ndarray, blocks: Blocks | None = None) -> Callable[[np.ndarray], np.ndarray]:
    """Return what gives the least x, (n, n_columns, k), that comes nearest to ``J x = right`` for right-hand sides of J
    (n, n_rows, n_columns).

    Where J is square and its inverse shows that it is far from singular, the inverse is the answer, of its blocks where
    they are given. Where J has full column rank that is R^-1 Q^T, of which Q^T times the right-hand side stands beside
    R; the singular values, at ten times the cost, are for the rest.
    """
    n, rest, inverted = jacobian.shape[2], np.ones(len(jacobian), dtype=bool), []
    for form in (blocks, Blocks.whole(n)) if jacobian.shape[1] == n else ():
        if form is not None and rest.any():
            factors, chosen = jacobian[rest], np.flatnonzero(rest)
            sound = np.flatnonzero(form.factorise(factors))
            inverted.append((form, factors, sound, chosen[sound]))
            rest[chosen[sound]] = False

    def solve(right: np.ndarray) -> np.ndarray:
        found = np.empty((len(jacobian), n, right.shape[2]))
        for form, factors, sound, chosen in inverted:
            found[chosen] = form.substituted(factors, sound, right[chosen])
        if rest.any():
            found[rest] = _least(jacobian[rest], right[rest])
        return found

    return solve


def _least(jacobian: np.ndarray, right: np.ndarray) -> np.ndarray:
    n, found = jacobian.shape[2], np.empty((len(jacobian), jacobian.shape[2], right.shape[2]))
    full = np.zeros(len(jacobian), dtype=bool)
    if jacobian.shape[1] >= n:
        both = np.linalg.qr(np.concatenate([jacobian, right], axis=2), mode="r")
        pivots = np.abs(np.diagonal(both[..., :n], axis1=1, axis2=2))
        full = pivots.min(axis=1) > RANK_TOLERANCE * pivots.max(axis=1)
        found[full] = np.linalg.solve(both[full, :n, :n], both[full, :n, n:])
    if not full.all():
        found[~full] = np.linalg.pinv(jacobian[~full], rcond=RANK_TOLERANCE) @ right[~full]
    return found


def triangular_blocks(pattern: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return the block triangular form of matrices with a pattern (n_rows, n_columns), bool.

    Each block has its rows, its columns, and columns of blocks before that its rows have entries in. A pattern that is
    not square, or of matrices that are singular, is one block.
    """
    whole, none = (np.arange(n) for n in pattern.shape), np.arange(0)
    one = [(*whole, none)]
    if pattern.shape[0] != pattern.shape[1]:
        return one
    rows = maximum_bipartite_matching(sp.csr_matrix(pattern), perm_type="row")
    if np.any(rows < 0):
        return one
    n, label = connected_components(sp.csr_matrix(pattern[rows]), connection="strong")
    needed = {k: set(label[pattern[rows[label == k]].any(axis=0)]) - {k} for k in range(n)}
    blocks = []
    for k in TopologicalSorter(needed).static_order():
        columns = np.flatnonzero(label == k)
        entered = np.flatnonzero(pattern[rows[columns]].any(axis=0) & (label != k))
        blocks.append((rows[columns], columns, entered))
    return blocks


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def _factorise(matrices, starts, rows, columns, work, pivots, sound):
    """Put inverses in place of blocks, the transpose of each; those of matrices that are not far from singular stop at
    the block that shows it. `work` has the shape (m, m), `pivots` (m,)."""
    for number in range(matrices.shape[0]):
        matrix = matrices[number]
        for block in range(starts.size - 1):
            first, n = starts[block], starts[block + 1] - starts[block]
            norm = found = 0.0
            for i in range(n):
                for j in range(n):
                    work[i, j] = matrix[rows[first + i], columns[first + j]]
                    norm += work[i, j] * work[i, j]
            for k in range(n):
                pivots[k] = k
                for i in range(k + 1, n):
                    if abs(work[i, k]) > abs(work[pivots[k], k]):
                        pivots[k] = i
                for j in range(n if pivots[k] != k else 0):
                    work[pivots[k], j], work[k, j] = work[k, j], work[pivots[k], j]
                scale = 1.0 / work[k, k]
                work[k, k] = 1.0
                for j in range(n):
                    work[k, j] *= scale
                for i in range(n):
                    if i != k:
                        factor = work[i, k]
                        work[i, k] = 0.0
                        for j in range(n):
                            work[i, j] -= factor * work[k, j]
            for k in range(n - 1, -1, -1):
                if pivots[k] != k:
                    for i in range(n):
                        work[i, k], work[i, pivots[k]] = work[i, pivots[k]], work[i, k]
            for i in range(n):
                for j in range(n):
                    found += work[i, j] * work[i, j]
            # what is no number is not far
            if not norm * found < FAR_FROM_SINGULAR * FAR_FROM_SINGULAR:
                sound[number] = False
                break
            for i in range(n):
                for j in range(n):
                    matrix[rows[first + i], columns[first + j]] = work[j, i]


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def _substitute(factors, chosen, right, starts, rows, columns, entered, before, work, found):
    """Fill x (n, m, k) from `_factorise`; `work` has shape (m, k)."""
    n_right = right.shape[2]
    for number in range(chosen.size):
        matrix, known, x = factors[chosen[number]], right[number], found[number]
        for block in range(starts.size - 1):
            first, n = starts[block], starts[block + 1] - starts[block]
            for i in range(n):
                row = rows[first + i]
                for c in range(n_right):
                    work[i, c] = known[row, c]
                for place in range(entered[block], entered[block + 1]):
                    factor = matrix[row, before[place]]
                    for c in range(n_right):
                        work[i, c] -= factor * x[before[place], c]
            for j in range(n):
                column = columns[first + j]
                for c in range(n_right):
                    total = 0.0
                    for i in range(n):
                        total += matrix[rows[first + i], column] * work[i, c]
                    x[column, c] = total
