"""Small dense algebra on LANES samples side by side, compiled.

Symmetric matrices are packed as lower triangles row by row, the lanes last and contiguous. Loops over the lanes take
their number from the arrays: of a number known in advance the compiler makes scalar code, where it cannot prove that
the arrays do not overlap. A lane never touches another's numbers.
"""

from __future__ import annotations

import math

import numpy as np

from pgmp_petsc.runtime.compiled import njit

LANES = 32  # samples side by side: enough to make the compiler's check for overlap cheap, few enough for the cache
CACHE_LINE = 64  # bytes


def aligned_zeros(shape: tuple[int, ...]) -> np.ndarray:
    """Return zeros that begin at a cache line.

    numpy begins at any multiple of 16 bytes. Where vectors of the machine straddle cache lines, a factorisation takes
    1.7 times as long, and a product 1.4 times.
    """
    size = 8 * math.prod(shape)
    buffer = np.zeros(size + CACHE_LINE, dtype=np.uint8)
    first = -buffer.ctypes.data % CACHE_LINE
    return buffer[first : first + size].view(np.float64).reshape(shape)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def multiply(packed, first, n, x, skip, result):
    """Multiply packed symmetric matrices, from row `first` on, with ``x[skip:]``: (n, LANES) each."""
    n_lanes = result.shape[1]
    at = first
    for i in range(n):
        for lane in range(n_lanes):
            result[i, lane] = packed[at + i, lane] * x[skip + i, lane]
        for j in range(i):
            for lane in range(n_lanes):
                result[i, lane] += packed[at + j, lane] * x[skip + j, lane]
                result[j, lane] += packed[at + j, lane] * x[skip + i, lane]
        at += i + 1


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def contract(packed, first, n, x, skip, result):
    """Contract symmetric tensors of third order, from row `first` on, with ``x[skip:]``: packed matrices.

    Tensors are packed over ``i >= j >= k``, k fastest; ``result_ij = sum_k T_ijk x_k``.
    """
    n_lanes = result.shape[1]
    for entry in range(n * (n + 1) // 2):
        for lane in range(n_lanes):
            result[entry, lane] = 0.0
    at = first
    for i in range(n):
        row_i = i * (i + 1) // 2
        # entries with equal indices have loops of their own, which leaves nothing to decide for every lane
        for j in range(i):
            row_j = j * (j + 1) // 2
            for k in range(j):
                for lane in range(n_lanes):
                    value = packed[at, lane]
                    result[row_i + j, lane] += value * x[skip + k, lane]
                    result[row_i + k, lane] += value * x[skip + j, lane]
                    result[row_j + k, lane] += value * x[skip + i, lane]
                at += 1
            for lane in range(n_lanes):
                value = packed[at, lane]
                result[row_i + j, lane] += value * x[skip + j, lane]
                result[row_j + j, lane] += value * x[skip + i, lane]
            at += 1
        for k in range(i):
            for lane in range(n_lanes):
                value = packed[at, lane]
                result[row_i + i, lane] += value * x[skip + k, lane]
                result[row_i + k, lane] += value * x[skip + i, lane]
            at += 1
        for lane in range(n_lanes):
            result[row_i + i, lane] += packed[at, lane] * x[skip + i, lane]
        at += 1


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def factorise(packed, n):
    """Replace packed positive definite matrices by their Cholesky factors, diagonals inverted; NaN where not."""
    n_lanes = packed.shape[1]
    for i in range(n):
        row_i = i * (i + 1) // 2
        for j in range(i + 1):
            row_j = j * (j + 1) // 2
            for k in range(j):
                for lane in range(n_lanes):
                    packed[row_i + j, lane] -= packed[row_i + k, lane] * packed[row_j + k, lane]
            if i == j:
                for lane in range(n_lanes):
                    packed[row_i + i, lane] = 1.0 / np.sqrt(packed[row_i + i, lane])
            else:
                for lane in range(n_lanes):
                    packed[row_i + j, lane] *= packed[row_j + j, lane]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def substitute(packed, n, x):
    """Solve ``L L^T y = x`` in place, x of shape (n, LANES)."""
    n_lanes = x.shape[1]
    for i in range(n):
        row = i * (i + 1) // 2
        for j in range(i):
            for lane in range(n_lanes):
                x[i, lane] -= packed[row + j, lane] * x[j, lane]
        for lane in range(n_lanes):
            x[i, lane] *= packed[row + i, lane]
    for i in range(n - 1, -1, -1):
        row = i * (i + 1) // 2
        for lane in range(n_lanes):
            x[i, lane] *= packed[row + i, lane]
        for j in range(i):
            for lane in range(n_lanes):
                x[j, lane] -= packed[row + j, lane] * x[i, lane]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def invert(matrix, n):
    """Invert small matrices (n * n, LANES), row after row, in place by Gauss-Jordan elimination without pivots."""
    n_lanes = matrix.shape[1]
    for p in range(n):
        for lane in range(n_lanes):
            pivot = 1.0 / matrix[p * n + p, lane]
            matrix[p * n + p, lane] = 1.0
            for j in range(n):
                matrix[p * n + j, lane] *= pivot
            for i in range(n):
                if i != p:
                    factor = matrix[i * n + p, lane]
                    matrix[i * n + p, lane] = 0.0
                    for j in range(n):
                        matrix[i * n + j, lane] -= factor * matrix[p * n + j, lane]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def eliminate_border(factor, border, r, m):
    """Factorise S of ``[[s, R], [C, S]]`` and turn the border into ``((s - R S^-1 C)^-1, S^-1 C, R)``.

    Parameters
    ----------
    factor
        Packed S, shape (n_packed, LANES).
    border
        Corner s row by row, then the r columns of C, then the r rows of R, shape (r * r + 2 * r * m, LANES).
    r, m
        Sizes of s and S.
    """
    n_lanes = border.shape[1]
    columns, rows = r * r, r * r + r * m
    factorise(factor, m)
    for k in range(r):
        substitute(factor, m, border[columns + k * m : columns + (k + 1) * m])
    for k in range(r):
        for j in range(r):
            for i in range(m):
                for lane in range(n_lanes):
                    border[k * r + j, lane] -= border[rows + k * m + i, lane] * border[columns + j * m + i, lane]
    invert(border, r)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def solve_bordered(factor, border, r, m, x):
    """Solve with the bordered matrix in place, x of shape (r + m, LANES)."""
    n_lanes = x.shape[1]
    columns, rows = r * r, r * r + r * m
    substitute(factor, m, x[r:])
    for k in range(r):
        for i in range(m):
            for lane in range(n_lanes):
                x[k, lane] -= border[rows + k * m + i, lane] * x[r + i, lane]
    right = x[:r].copy()
    for k in range(r):
        for lane in range(n_lanes):
            x[k, lane] = border[k * r, lane] * right[0, lane]
        for j in range(1, r):
            for lane in range(n_lanes):
                x[k, lane] += border[k * r + j, lane] * right[j, lane]
    for k in range(r):
        for i in range(m):
            for lane in range(n_lanes):
                x[r + i, lane] -= border[columns + k * m + i, lane] * x[k, lane]
