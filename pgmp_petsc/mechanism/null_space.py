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
from functools import cached_property, lru_cache

import numpy as np
import scipy.sparse as sp
from scipy.linalg import qr, solve_triangular
from scipy.sparse.csgraph import connected_components

RANK_TOLERANCE = 1e-10  # of the largest pivot of a block; joint Jacobians have entries of order 1
PATTERNS = 64  # of Jacobians whose blocks are remembered


@dataclass(frozen=True, eq=False)
class Elimination:
    """Unknowns of one block expressed by others: ``u[dependent] = weights @ u[by]``.

    Attributes
    ----------
    dependent, by
        Numbers of unknowns, shapes (rank,) and (k,).
    weights
        Shape (rank, k).
    """

    dependent: np.ndarray
    by: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True, eq=False)
class NullSpace:
    """A basis of the null space in terms of independent unknowns.

    Attributes
    ----------
    n_dofs
        Number of unknowns.
    eliminations
        One a block.
    n_redundant
        Number of constraints that followed from the others.
    rows
        As many constraints as the rank, from which the others follow, shape (rank,), increasing.
    """

    n_dofs: int
    eliminations: tuple[Elimination, ...]
    n_redundant: int
    rows: np.ndarray

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

    def dense(self) -> np.ndarray:
        """Return N as a dense array."""
        matrix = np.zeros((self.n_dofs, self.independent.size))
        matrix[self.independent, np.arange(self.independent.size)] = 1.0
        for part in self.eliminations:
            matrix[part.dependent[:, None], self._column[part.by]] = part.weights
        return matrix


def null_space(constraints: sp.csr_matrix) -> NullSpace:
    """Compute the sparse null space of a constraint Jacobian of shape (n_constraints, n_dofs)."""
    constraints = sp.csr_matrix(constraints)
    n_redundant, eliminations, chosen = 0, [], [np.zeros(0, dtype=int)]
    # scipy's whole numbers have 4 or 8 bytes, by the size of the matrix and its history
    pattern = (part.astype(np.int64).tobytes() for part in (constraints.indptr, constraints.indices))
    for block in _blocks(*pattern, constraints.shape):
        values = np.zeros((block.rows.size, block.touched.size))
        np.add.at(values, block.places, constraints.data[block.entries])
        r, order = qr(values, mode="r", pivoting=True, check_finite=False)
        pivots = np.abs(np.diagonal(r))
        rank = int(np.sum(pivots > RANK_TOLERANCE * max(pivots[0], 1e-300))) if pivots.size else 0
        n_redundant += block.rows.size - rank
        if rank == 0:
            continue
        independent_rows = slice(None)
        if rank < block.rows.size:
            independent_rows = qr(values.T, mode="r", pivoting=True, check_finite=False)[1][:rank]
        chosen.append(block.rows[independent_rows])
        weights = -solve_triangular(r[:rank, :rank], r[:rank, rank:], check_finite=False)
        eliminations.append(Elimination(block.touched[order[:rank]], block.touched[order[rank:]], weights))
    return NullSpace(constraints.shape[1], tuple(eliminations), n_redundant, np.sort(np.concatenate(chosen)))


@dataclass(frozen=True, eq=False)
class _Block:
    """Constraints that share unknowns, and where their entries are.

    Attributes
    ----------
    rows, touched
        Numbers of the constraints and of the unknowns.
    entries, places
        Numbers of the entries among those of the Jacobian, and their places in the block.
    """

    rows: np.ndarray
    touched: np.ndarray
    entries: np.ndarray
    places: tuple[np.ndarray, np.ndarray]


@lru_cache(maxsize=PATTERNS)
def _blocks(indptr: bytes, indices: bytes, shape: tuple[int, int]) -> tuple[_Block, ...]:
    """Return the blocks of a pattern, which from one configuration to the next is mostly the same."""
    starts, columns = np.frombuffer(indptr, dtype=np.int64), np.frombuffer(indices, dtype=np.int64)
    # the pattern, not the values: orthogonal rows that share unknowns belong together
    pattern = sp.csr_matrix((np.ones(columns.size), columns, starts), shape)
    n_groups, group_of = connected_components(pattern @ pattern.T, directed=False)
    row_of = np.repeat(np.arange(shape[0]), np.diff(starts))
    blocks = []
    for group in range(n_groups):
        rows, entries = np.flatnonzero(group_of == group), np.flatnonzero(group_of[row_of] == group)
        touched, column = np.unique(columns[entries], return_inverse=True)
        blocks.append(_Block(rows, touched, entries, (np.searchsorted(rows, row_of[entries]), column)))
    return tuple(blocks)
