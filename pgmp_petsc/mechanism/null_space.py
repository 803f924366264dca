"""Sparse null space N of the constraint Jacobian (Naets et al. 2015, eq. (15)): ``C N = 0``.

Constraints that share no unknown are independent of each other, so the Jacobian splits into small blocks, one a
connected group of joints. In each block a QR factorisation with column pivoting picks as many dependent unknowns as
the block has rank, and expresses them by the others::

    C_block P = Q [R11 R12],    dependent = -R11^-1 R12 independent

Every unknown that no joint touches is its own column. Rows beyond the rank are redundant constraints; they are
dropped and counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.linalg import lapack
from scipy.sparse.csgraph import connected_components

RANK_TOLERANCE = 1e-10  # of the largest pivot of a block; joint Jacobians have entries of order 1


@dataclass(frozen=True, eq=False)
class Elimination:
    """Unknowns of one block expressed by others: ``u[dependent] = weights @ u[by]``."""

    #: dependent, by: numbers of unknowns, shapes (rank,) and (k,)
    dependent: np.ndarray
    by: np.ndarray
    weights: np.ndarray  # shape (rank, k)


@dataclass(frozen=True, eq=False)
class NullSpace:
    """A basis of the null space in terms of independent unknowns."""

    n_dofs: int  # number of unknowns
    eliminations: tuple[Elimination, ...]  # one a block
    n_redundant: int  # number of constraints that followed from the others
    rows: np.ndarray  # as many constraints as the rank, from which the others follow, shape (rank,), increasing

    @cached_property
    def independent(self) -> np.ndarray:
        """The unknowns that stay, shape (n_independent,), increasing."""
        stays = np.ones(self.n_dofs, dtype=bool)
        for elimination in self.eliminations:
            stays[elimination.dependent] = False
        return np.flatnonzero(stays)

    @cached_property
    def _column(self) -> np.ndarray:
        column = np.full(self.n_dofs, -1)
        column[self.independent] = np.arange(self.independent.size)
        return column

    @cached_property
    def matrix(self) -> sp.csr_matrix:
        """N, shape (n_dofs, n_independent); row ``independent[j]`` is the j-th unit vector."""
        rows, columns, values = [self.independent], [self.independent], [np.ones(self.independent.size)]
        for part in self.eliminations:
            rows.append(np.repeat(part.dependent, part.by.size))
            columns.append(np.tile(part.by, part.dependent.size))
            values.append(part.weights.ravel())
        entries = np.concatenate(values), (np.concatenate(rows), self._column[np.concatenate(columns)])
        return sp.coo_matrix(entries, shape=(self.n_dofs, self.independent.size)).tocsr()

    @cached_property
    def touched(self) -> np.ndarray:
        """The unknowns that constraints touch, shape (n_touched,), increasing."""
        touches = np.zeros(self.n_dofs, dtype=bool)
        for elimination in self.eliminations:
            touches[elimination.dependent] = touches[elimination.by] = True
        return np.flatnonzero(touches)

    @cached_property
    def dependent(self) -> np.ndarray:
        """The unknowns that the others determine, block by block, shape (rank,)."""
        return np.concatenate([np.zeros(0, dtype=int), *(part.dependent for part in self.eliminations)])

    @cached_property
    def weights(self) -> np.ndarray:
        """Rows of N of `dependent`, dense, shape (rank, n_independent)."""
        found, first = np.zeros((self.dependent.size, self.independent.size)), 0
        for part in self.eliminations:
            found[first : first + part.dependent.size, self._column[part.by]] = part.weights
            first += part.dependent.size
        return found


class NullSpaces:
    """Null spaces of Jacobians on one nonzero pattern, a matrix (n_constraints, n_dofs) with no entry twice: which
    constraints share unknowns is found once."""

    def __init__(self, pattern: sp.csr_matrix) -> None:
        self._n_dofs = pattern.shape[1]
        # the pattern, not the values: orthogonal rows that share unknowns belong together. Constraints, and behind them
        # unknowns, are the nodes of a graph; unknowns that no constraint touches are groups of their own, behind others
        n, n_rows = sum(pattern.shape), pattern.shape[0]
        starts = np.append(pattern.indptr, np.full(pattern.shape[1], pattern.nnz))
        graph = sp.csr_matrix((np.ones(pattern.nnz), pattern.indices + n_rows, starts), (n, n))
        group_of = connected_components(graph, directed=False)[1][:n_rows]
        n_groups = int(group_of.max(initial=-1)) + 1
        row_of = np.repeat(np.arange(pattern.shape[0]), np.diff(pattern.indptr))
        # of every block: its constraints, its unknowns, its entries among those of the pattern, and their places in it
        self._blocks: list[tuple[np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]] = []
        for group in range(n_groups):
            rows, entries = np.flatnonzero(group_of == group), np.flatnonzero(group_of[row_of] == group)
            touched, column = np.unique(pattern.indices[entries], return_inverse=True)
            self._blocks.append((rows, touched, entries, (np.searchsorted(rows, row_of[entries]), column)))

    def of(self, values: np.ndarray) -> NullSpace:
        """Return the null space for values (n_entries,) on the pattern."""
        n_redundant, eliminations, chosen = 0, [], [np.zeros(0, dtype=int)]
        for rows, touched, entries, places in self._blocks:
            matrix = np.zeros((rows.size, touched.size), order="F")
            matrix[places] = values[entries]
            r, order, rank = _pivoted(matrix)
            n_redundant += rows.size - rank
            if rank == 0:
                continue
            chosen.append(rows if rank == rows.size else rows[_pivoted(matrix.T)[1][:rank]])
            weights = -lapack.dtrtrs(r[:rank, :rank], r[:rank, rank:])[0]
            eliminations.append(Elimination(touched[order[:rank]], touched[order[rank:]], weights))
        return NullSpace(self._n_dofs, tuple(eliminations), n_redundant, np.sort(np.concatenate(chosen)))


def null_space(constraints: sp.csr_matrix) -> NullSpace:
    """Return the null space of a constraint Jacobian of shape (n_constraints, n_dofs)."""
    constraints = constraints.tocsr()
    constraints.sum_duplicates()
    return NullSpaces(constraints).of(constraints.data)


def _pivoted(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Return R in its upper triangle (what is below it is not zero), the order of columns, and the rank.

    LAPACK itself: what SciPy checks and allocates takes ten times as long as a joint's few rows.
    """
    if not matrix.shape[1]:
        return matrix, np.zeros(0, dtype=int), 0
    r, order, *_ = lapack.dgeqp3(matrix)
    pivots = np.abs(np.diagonal(r))
    return r, order - 1, int(np.count_nonzero(pivots > RANK_TOLERANCE * max(pivots[0], 1e-300)))
