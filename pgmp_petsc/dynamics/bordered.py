"""Solving with the iteration matrices of LANES samples at once, compiled; see `reduced_arrays.Matrix`.

The flexible block has factors ``L D U`` without pivoting, L and U with unit diagonals: ``U = L^T`` but for gyroscopic
terms. Its symmetric part is positive definite at reasonable steps, and so are all pivots positive. Where one is not,
the factors are NaN, and so is every correction of that sample.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.dynamics.reduced_arrays import upper_of
from pgmp_petsc.runtime.vectors import blend, exceeding, load, spread, store
from pgmp_petsc.runtime.compiled import njit


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _join_skew(factor, skew, m):
    """Make of the symmetric and the skew part of a block its lower triangle and its upper one, transposed."""
    entry = 0
    for i in range(m):
        for _ in range(i):
            even, odd = load(factor, entry), load(skew, entry)
            store(factor, entry, even + odd)
            store(skew, entry, even - odd)
            entry += 1
        entry += 1


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _factorise(matrix, r, m):
    """Replace S by L and U, with ``D^-1`` on the diagonal of L, C by ``L^-1 C``, R by ``R U^-1 D^-1``
    and s by ``s - R S^-1 C``.

    Every column of L is taken off all that lies behind it at once: these differences do not wait for each other, as
    sums over the columns before an entry would.
    """
    lower, upper, column, row, corner = matrix.factor, upper_of(matrix), matrix.column, matrix.row, matrix.corner
    is_skewed = matrix.skew.shape[0] > 0
    for k in range(m):
        diagonal = k * (k + 3) // 2
        pivot = load(lower, diagonal)
        inverse = 1.0 / blend(exceeding(pivot, spread(0.0)), pivot, spread(np.nan))
        store(lower, diagonal, inverse)
        below = diagonal + k + 1  # entry (k + 1, k)
        at = below
        for i in range(k + 1, m):
            down, across = load(lower, at), load(upper, at)  # L_ik D_k and D_k U_ki
            store(lower, at, down * inverse)
            if is_skewed:
                store(upper, at, across * inverse)
            other = below
            for j in range(k + 1, i):
                into = at + j - k
                store(lower, into, load(lower, into) - down * load(upper, other))
                if is_skewed:
                    store(upper, into, load(upper, into) - across * load(lower, other))
                other += j + 1
            into = at + i - k
            store(lower, into, load(lower, into) - down * (across * inverse))
            at += i + 1
        for h in range(r):
            first, at = h * m, below
            from_column, from_row = load(column, first + k), load(row, first + k)
            for j in range(k + 1, m):
                store(column, first + j, load(column, first + j) - from_column * load(lower, at))
                store(row, first + j, load(row, first + j) - from_row * load(upper, at))
                at += j + 1
            store(row, first + k, from_row * inverse)
        for h in range(r):
            for g in range(r):
                into = h * r + g
                store(corner, into, load(corner, into) - load(row, h * m + k) * load(column, g * m + k))


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _invert(corner, r):
    """Invert a small matrix, row after row, in place by Gauss-Jordan elimination without pivots."""
    for p in range(r):
        pivot = 1.0 / load(corner, p * r + p)
        store(corner, p * r + p, spread(1.0))
        for j in range(r):
            store(corner, p * r + j, load(corner, p * r + j) * pivot)
        for i in range(r):
            if i != p:
                times = load(corner, i * r + p)
                store(corner, i * r + p, spread(0.0))
                for j in range(r):
                    store(corner, i * r + j, load(corner, i * r + j) - times * load(corner, p * r + j))


@njit(cache=True, error_model="numpy", fastmath={"contract"}, counted=False)
def eliminate(matrix, r, m):
    """Factorise ``[[s, R], [C, S]]`` as `_factorise` says; s becomes ``(s - R S^-1 C)^-1``."""
    if matrix.skew.shape[0] > 0:
        _join_skew(matrix.factor, matrix.skew, m)
    _factorise(matrix, r, m)
    _invert(matrix.corner, r)


@njit(cache=True, error_model="numpy", fastmath={"contract"}, counted=False)
def solve(matrix, r, m, x, right):
    """Solve with an eliminated matrix in place; x has r + m rows, `right` has r."""
    lower, upper = matrix.factor, upper_of(matrix)
    at = 0
    for i in range(m):
        total = load(x, r + i)
        for j in range(i):
            total -= load(lower, at + j) * load(x, r + j)
        store(x, r + i, total)
        at += i + 1
    for k in range(r):
        total = load(x, k)
        for i in range(m):
            total -= load(matrix.row, k * m + i) * load(x, r + i)
        store(right, k, total)
    for k in range(r):
        total = load(matrix.corner, k * r) * load(right, 0)
        for j in range(1, r):
            total += load(matrix.corner, k * r + j) * load(right, j)
        store(x, k, total)
    for i in range(m - 1, -1, -1):
        total = load(x, r + i)
        for k in range(r):
            total -= load(matrix.column, k * m + i) * load(x, k)
        total = total * load(lower, i * (i + 3) // 2)
        # what was found last comes last: the other products do not wait for it
        for j in range(m - 1, i, -1):
            total -= load(upper, j * (j + 1) // 2 + i) * load(x, r + j)
        store(x, r + i, total)
