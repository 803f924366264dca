"""Solving with the iteration matrices of LANES samples at once, compiled; see `reduced_arrays.Matrix`.

The flexible block is positive definite at reasonable steps: it has Cholesky factors. Where it has not, they are NaN,
and so is every correction of that sample.
"""

from __future__ import annotations

from pgmp_petsc.runtime.vectors import load, spread, square_root, store
from pgmp_petsc.runtime.compiled import njit


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def factorise(packed, n):
    """Replace a packed positive definite matrix by its Cholesky factor, diagonal inverted."""
    row_i = 0
    for i in range(n):
        row_j = 0
        for j in range(i):
            total = load(packed, row_i + j)
            for k in range(j):
                total -= load(packed, row_i + k) * load(packed, row_j + k)
            store(packed, row_i + j, total * load(packed, row_j + j))
            row_j += j + 1
        total = load(packed, row_i + i)
        for k in range(i):
            other = load(packed, row_i + k)
            total -= other * other
        store(packed, row_i + i, 1.0 / square_root(total))
        row_i += i + 1


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def substitute(packed, n, x, first):
    """Solve ``L L^T y = x`` in place, for the rows of x from `first` on."""
    row = 0
    for i in range(n):
        total = load(x, first + i)
        for j in range(i):
            total -= load(packed, row + j) * load(x, first + j)
        store(x, first + i, total * load(packed, row + i))
        row += i + 1
    for i in range(n - 1, -1, -1):
        total = load(x, first + i)
        at = (i + 1) * (i + 2) // 2 + i
        for j in range(i + 1, n):
            total -= load(packed, at) * load(x, first + j)
            at += j + 1
        store(x, first + i, total * load(packed, i * (i + 1) // 2 + i))


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def invert(corner, r):
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
    """Factorise ``[[s, R], [C, S]]``: S becomes its factor, C becomes ``S^-1 C`` and s ``(s - R S^-1 C)^-1``."""
    factorise(matrix.factor, m)
    for k in range(r):
        substitute(matrix.factor, m, matrix.column, k * m)
    for k in range(r):
        for j in range(r):
            total = load(matrix.corner, k * r + j)
            for i in range(m):
                total -= load(matrix.row, k * m + i) * load(matrix.column, j * m + i)
            store(matrix.corner, k * r + j, total)
    invert(matrix.corner, r)


@njit(cache=True, error_model="numpy", fastmath={"contract"}, counted=False)
def solve(matrix, r, m, x, rest, right):
    """Solve with an eliminated matrix in place; x and `rest` have r + m rows, `right` has r.

    The skew part S of the flexible block is smaller than the symmetric one A by some thousandths at most: so is what
    the refinement ``x - A^-1 S x`` leaves of the error.
    """
    _solve_symmetric(matrix, r, m, x, right)
    if matrix.skew.shape[0] > 0:
        _multiply_skew(matrix.skew, r, m, x, rest)
        _solve_symmetric(matrix, r, m, rest, right)
        for i in range(r + m):
            store(x, i, load(x, i) - load(rest, i))


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _multiply_skew(skew, r, m, x, result):
    """Multiply the flexible rows of x by a packed skew matrix; the r rows before become zeros."""
    for k in range(r):
        store(result, k, spread(0.0))
    entry = 0
    for i in range(m):
        total, x_i = spread(0.0), load(x, r + i)
        for j in range(i):
            s = load(skew, entry)
            total += s * load(x, r + j)
            store(result, r + j, load(result, r + j) - s * x_i)
            entry += 1
        store(result, r + i, total)


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _solve_symmetric(matrix, r, m, x, right):
    """Solve with the symmetric flexible block alone."""
    substitute(matrix.factor, m, x, r)
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
        for i in range(m):
            store(x, r + i, load(x, r + i) - load(matrix.column, k * m + i) * total)
