"""Solving with the iteration matrices of LANES samples at once, compiled; see `arrays.Matrix`.

The flexible block has factors ``L D U`` without pivoting, L and U with unit diagonals: ``U = L^T`` but for gyroscopic
terms. Its symmetric part is positive definite at reasonable steps, and so are all pivots positive. Where one is not,
the factors are NaN, and so is every correction of that sample.

Columns are taken four at once, the last ones two and one at once: the numbers of such a tile stay in registers, and
what lies behind it is fetched and put back once for all of its columns.
"""

from __future__ import annotations

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.tiles import (
    backward,
    diagonal_of,
    factorise_tile,
    forward,
    less_dot,
    less_product,
    load_tile,
    products,
    store_rows,
    store_tile,
)
from pgmp_petsc.lanes.vectors import load, load_rows, spread, store
from pgmp_petsc.reduced.arrays import upper_of

WIDEST = 4
FOUR, TWO, ONE = (0,) * WIDEST, (0,) * 2, (0,)  # tuples, so that the compiler knows how wide a tile is


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
def _factorise_columns(matrix, upper, is_skewed, r, m, k, like):
    """Do `_factorise` for as many columns as `like` has, from column k on, and take them off all that lies behind."""
    lower, column, row, corner = matrix.factor, matrix.column, matrix.row, matrix.corner
    behind, diagonal = k + len(like), k * (k + 3) // 2
    low, up = load_tile(lower, diagonal, k + 1, like), load_tile(upper, diagonal, k + 1, like)
    low, up = factorise_tile(low, up)
    inverse = diagonal_of(low, like)
    store_tile(lower, diagonal, k + 1, low)
    if is_skewed:
        store_tile(upper, diagonal, k + 1, up)
    below = behind * (behind + 1) // 2 + k  # entry (behind, k)
    at = below
    for i in range(behind, m):
        down = forward(up, load_rows(lower, at, 1, like))  # L_ij D_j
        across = forward(low, load_rows(upper, at, 1, like))  # D_j U_ji
        scaled = products(across, inverse)
        other, into = below, at + len(like)
        for j in range(behind, i):
            store(lower, into, less_dot(load(lower, into), down, load_rows(upper, other, 1, like)))
            if is_skewed:
                store(upper, into, less_dot(load(upper, into), across, load_rows(lower, other, 1, like)))
            other += j + 1
            into += 1
        store(lower, into, less_dot(load(lower, into), down, scaled))
        store_rows(lower, at, products(down, inverse))
        if is_skewed:
            store_rows(upper, at, scaled)
        at += i + 1
    for h in range(r):
        first, at = h * m, below
        from_column = forward(low, load_rows(column, first + k, 1, like))
        from_row = forward(up, load_rows(row, first + k, 1, like))
        for j in range(behind, m):
            store(column, first + j, less_dot(load(column, first + j), from_column, load_rows(lower, at, 1, like)))
            store(row, first + j, less_dot(load(row, first + j), from_row, load_rows(upper, at, 1, like)))
            at += j + 1
        store_rows(column, first + k, from_column)
        store_rows(row, first + k, products(from_row, inverse))
    for h in range(r):
        for g in range(r):
            into = h * r + g
            of_row, of_column = load_rows(row, h * m + k, 1, like), load_rows(column, g * m + k, 1, like)
            store(corner, into, less_dot(load(corner, into), of_row, of_column))


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _factorise(matrix, upper, is_skewed, r, m):
    """Replace S by L and U, with ``D^-1`` on the diagonal of L, C by ``L^-1 C``, R by ``R U^-1 D^-1``
    and s by ``s - R S^-1 C``.

    Columns of L are taken off all that lies behind them at once: these differences do not wait for each other, as
    sums over the columns before an entry would.
    """
    k = 0
    while k + WIDEST <= m:
        _factorise_columns(matrix, upper, is_skewed, r, m, k, FOUR)
        k += WIDEST
    if m & 2:
        _factorise_columns(matrix, upper, is_skewed, r, m, k, TWO)
        k += 2
    if m & 1:
        _factorise_columns(matrix, upper, is_skewed, r, m, k, ONE)


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
        _factorise(matrix, matrix.skew, True, r, m)
    else:
        _factorise(matrix, matrix.factor, False, r, m)
    _invert(matrix.corner, r)


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _go_forward(lower, r, m, x, k, like):
    """Solve for some rows of the flexible part of ``L y = x`` from row k on, and take them off those behind."""
    behind, diagonal = k + len(like), k * (k + 3) // 2
    found = forward(load_tile(lower, diagonal, k + 1, like), load_rows(x, r + k, 1, like))
    store_rows(x, r + k, found)
    at = behind * (behind + 1) // 2 + k
    for i in range(behind, m):
        store(x, r + i, less_dot(load(x, r + i), found, load_rows(lower, at, 1, like)))
        at += i + 1


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _go_back(matrix, upper, r, m, x, k, like):
    """Solve for some rows of the flexible part from row k on, those behind being known."""
    behind, diagonal = k + len(like), k * (k + 3) // 2
    total = load_rows(x, r + k, 1, like)
    for h in range(r):
        total = less_product(total, load_rows(matrix.column, h * m + k, 1, like), load(x, h))
    total = products(total, diagonal_of(load_tile(matrix.factor, diagonal, k + 1, like), like))
    # what was found last comes last: the other products do not wait for it
    for j in range(m - 1, behind - 1, -1):
        total = less_product(total, load_rows(upper, j * (j + 1) // 2 + k, 1, like), load(x, r + j))
    store_rows(x, r + k, backward(load_tile(upper, diagonal, k + 1, like), total))


@njit(cache=True, error_model="numpy", fastmath={"contract"}, counted=False)
def solve(matrix, r, m, x, right):
    """Solve with an eliminated matrix in place; x has r + m rows, `right` has r."""
    lower, upper = matrix.factor, upper_of(matrix)
    narrow = m // WIDEST * WIDEST
    for k in range(0, narrow, WIDEST):
        _go_forward(lower, r, m, x, k, FOUR)
    if m & 2:
        _go_forward(lower, r, m, x, narrow, TWO)
    if m & 1:
        _go_forward(lower, r, m, x, m - 1, ONE)
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
    if m & 1:
        _go_back(matrix, upper, r, m, x, m - 1, ONE)
    if m & 2:
        _go_back(matrix, upper, r, m, x, narrow, TWO)
    for k in range(narrow - WIDEST, -1, -WIDEST):
        _go_back(matrix, upper, r, m, x, k, FOUR)
