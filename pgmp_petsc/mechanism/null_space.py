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

import numpy as np
import scipy.sparse as sp
from scipy.linalg import qr, solve_triangular
from scipy.sparse.csgraph import connected_components

RANK_TOLERANCE = 1e-10  # of the largest pivot of a block; joint Jacobians have entries of order 1


@dataclass(frozen=True)
class NullSpace:
    """A basis of the null space in terms of independent unknowns.

    Attributes
    ----------
    matrix
        N, CSR of shape (n_dofs, n_independent); row ``independent[j]`` is the j-th unit vector.
    independent
        The unknowns that stay, shape (n_independent,), increasing.
    n_redundant
        Number of constraints that followed from the others.
    rows
        As many constraints as the rank, from which the others follow, shape (rank,), increasing.
    """

    matrix: sp.csr_matrix
    independent: np.ndarray
    n_redundant: int
    rows: np.ndarray


def null_space(constraints: sp.csr_matrix) -> NullSpace:
    """Compute the sparse null space of a constraint Jacobian of shape (n_constraints, n_dofs)."""
    constraints = sp.csr_matrix(constraints)
    n_dofs = constraints.shape[1]
    # the pattern, not the values: orthogonal rows that share unknowns belong together
    ones = np.ones_like(constraints.data)
    pattern = sp.csr_matrix((ones, constraints.indices, constraints.indptr), constraints.shape)
    n_groups, group_of = connected_components(pattern @ pattern.T, directed=False)
    dependent = np.zeros(n_dofs, dtype=bool)
    rows, columns, values = [], [], []
    chosen_rows = [np.zeros(0, dtype=int)]
    n_redundant = 0
    for group in range(n_groups):
        members = np.flatnonzero(group_of == group)
        block_rows = constraints[members]
        touched = np.unique(block_rows.indices)
        r, order = qr(block_rows[:, touched].toarray(), mode="r", pivoting=True)
        pivots = np.abs(np.diagonal(r))
        rank = int(np.sum(pivots > RANK_TOLERANCE * max(pivots[0], 1e-300))) if pivots.size else 0
        n_redundant += block_rows.shape[0] - rank
        if rank == 0:
            continue
        if rank < members.size:
            members = members[qr(block_rows[:, touched].toarray().T, mode="r", pivoting=True)[1][:rank]]
        chosen_rows.append(members)
        gone, kept = touched[order[:rank]], touched[order[rank:]]
        dependent[gone] = True
        weights = -solve_triangular(r[:rank, :rank], r[:rank, rank:])
        rows.append(np.repeat(gone, kept.size))
        columns.append(np.tile(kept, gone.size))
        values.append(weights.ravel())
    independent = np.flatnonzero(~dependent)
    position = np.full(n_dofs, -1)
    position[independent] = np.arange(independent.size)
    rows.append(independent)
    columns.append(independent)
    values.append(np.ones(independent.size))
    matrix = sp.coo_matrix(
        (np.concatenate(values), (np.concatenate(rows), position[np.concatenate(columns)])),
        shape=(n_dofs, independent.size),
    ).tocsr()
    return NullSpace(matrix, independent, n_redundant, np.sort(np.concatenate(chosen_rows)))
