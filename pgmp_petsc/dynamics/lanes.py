"""Small dense algebra on LANES samples side by side, compiled.

Symmetric matrices are packed as lower triangles row by row, the lanes last and contiguous. Loops over the lanes take
their number from the arrays: of a number known in advance the compiler makes scalar code, where it cannot prove that
the arrays do not overlap. A lane never touches another's numbers.
"""

from __future__ import annotations

import numpy as np
from numba import njit

LANES = 32  # samples side by side: enough to make the compiler's check for overlap cheap, few enough for the cache


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def multiply(packed, first, n, x, skip, result):
    """Multiply packed symmetric matrices, from row `first` on, with ``x[skip:]``: (n, LANES) each."""
    n_lanes = result.shape[1]
    for i in range(n):
        for lane in range(n_lanes):
            result[i, lane] = 0.0
    at = first
    for i in range(n):
        for j in range(i):
            for lane in range(n_lanes):
                result[i, lane] += packed[at, lane] * x[skip + j, lane]
                result[j, lane] += packed[at, lane] * x[skip + i, lane]
            at += 1
        for lane in range(n_lanes):
            result[i, lane] += packed[at, lane] * x[skip + i, lane]
        at += 1


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
        for j in range(i + 1):
            row_j = j * (j + 1) // 2
            for k in range(j + 1):
                for lane in range(n_lanes):
                    value = packed[at, lane]
                    result[row_i + j, lane] += value * x[skip + k, lane]
                    if k != j:
                        result[row_i + k, lane] += value * x[skip + j, lane]
                    if i != j:
                        result[row_j + k, lane] += value * x[skip + i, lane]
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
def eliminate_border(factor, border, m):
    """Factorise S of ``[[s, r^T], [c, S]]`` and turn the border into ``(1 / (s - r^T S^-1 c), S^-1 c, r)``."""
    n_lanes = border.shape[1]
    factorise(factor, m)
    substitute(factor, m, border[1 : 1 + m])
    for i in range(m):
        for lane in range(n_lanes):
            border[0, lane] -= border[1 + m + i, lane] * border[1 + i, lane]
    for lane in range(n_lanes):
        border[0, lane] = 1.0 / border[0, lane]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def solve_bordered(factor, border, m, x):
    """Solve with the bordered matrix in place, x of shape (1 + m, LANES)."""
    n_lanes = x.shape[1]
    substitute(factor, m, x[1:])
    for i in range(m):
        for lane in range(n_lanes):
            x[0, lane] -= border[1 + m + i, lane] * x[1 + i, lane]
    for lane in range(n_lanes):
        x[0, lane] *= border[0, lane]
    for i in range(m):
        for lane in range(n_lanes):
            x[1 + i, lane] -= border[1 + i, lane] * x[0, lane]
