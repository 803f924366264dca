"""Small triangular matrices of vectors, held in registers: tuples, the length of which is known when code is compiled.

A tile of w columns is the lower triangle of w rows, packed by rows, a tuple of ``w (w + 1) / 2`` vectors (`vectors`).
What is between its loads and stores never waits for the memory, and costs no addresses.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types

from pgmp_petsc.lanes.vectors import DOUBLES, LANES, built, vector


def _at(row: int, column: int) -> int:
    """Return where an entry of a packed triangle is."""
    return row * (row + 1) // 2 + column


def _less(builder: ir.IRBuilder, total: ir.Value, x: ir.Value, y: ir.Value) -> ir.Value:
    """Return ``total - x y``; the compiler contracts it where the machine can."""
    return builder.fsub(total, builder.fmul(x, y))


def _of_tile(builder: ir.IRBuilder, at: ir.Value, stride: ir.Value, w: int) -> list[ir.Value]:
    """Return the rows of the entries of a tile, the first one `at`, in a packed triangle.

    `stride` is from the first entry to the one below.
    """
    rows = []
    for row in range(w):
        # every row of a packed triangle is one longer than the one above
        first = builder.mul(stride, ir.Constant(stride.type, row))
        apart = [builder.add(first, ir.Constant(stride.type, row * (row - 1) // 2 + k)) for k in range(row + 1)]
        rows += [builder.add(at, one) for one in apart]
    return rows


def _width(count: int) -> int:
    """Return the width of a tile with so many entries."""
    return next(w for w in range(count + 1) if _at(w, 0) == count)


@built(lambda array, at, stride, like: types.UniTuple(vector, _at(len(like), 0))(array, types.intp, types.intp, like))
def load_tile(builder, array, at, stride, like):
    """Return the tile that begins at an entry of a packed triangle, as wide as the tuple `like` is long.

    From its first entry to the one below it is `stride`.
    """
    return [array.load(row) for row in _of_tile(builder, at, stride, len(like))]


@built(lambda array, at, stride, tile: types.void(array, types.intp, types.intp, tile))
def store_tile(builder, array, at, stride, tile):
    """Put a tile where `load_tile` takes it from."""
    for part, row in zip(tile, _of_tile(builder, at, stride, _width(len(tile)))):
        array.store(row, part)


@built(lambda array, first, x: types.void(array, types.intp, x))
def store_rows(builder, array, first, x):
    """Put a tuple into rows one after the other."""
    for k, part in enumerate(x):
        array.store(builder.add(first, ir.Constant(first.type, k)), part)


@built(lambda lower, upper: types.Tuple((lower, upper))(lower, upper))
def factorise_tile(builder, low, up):
    """Return L and U^T of ``L D U``, with unit diagonals, of a matrix whose lower triangle and transposed upper one are
    given. In place of the diagonals is ``D^-1``, NaN where a pivot is not positive."""
    nothing, invalid, one = (ir.Constant(DOUBLES, [number] * LANES) for number in (0.0, np.nan, 1.0))
    w = _width(len(low))
    for k in range(w):
        pivot = low[_at(k, k)]
        valid = builder.select(builder.fcmp_unordered(">", pivot, nothing), pivot, invalid)
        inverse = builder.fdiv(one, valid)
        low[_at(k, k)] = up[_at(k, k)] = inverse
        down = {i: low[_at(i, k)] for i in range(k + 1, w)}
        across = {i: up[_at(i, k)] for i in range(k + 1, w)}
        for i in range(k + 1, w):
            low[_at(i, k)] = builder.fmul(down[i], inverse)
            up[_at(i, k)] = builder.fmul(across[i], inverse)
            for j in range(k + 1, i + 1):
                low[_at(i, j)] = _less(builder, low[_at(i, j)], down[i], up[_at(j, k)])
                up[_at(i, j)] = _less(builder, up[_at(i, j)], across[i], low[_at(j, k)])
    return low, up


@built(lambda tile, like: types.UniTuple(vector, len(like))(tile, like))
def diagonal_of(builder, tile, like):
    """Return the diagonal of a tile, as many vectors as `like` has."""
    return [tile[_at(k, k)] for k in range(len(like))]


@built(lambda tile, x: x(tile, x))
def forward(builder, tile, x):
    """Return ``L^-1 x`` for a tuple x, L the tile with a unit diagonal."""
    for k in range(len(x)):
        for i in range(k + 1, len(x)):
            x[i] = _less(builder, x[i], tile[_at(i, k)], x[k])
    return x


@built(lambda tile, x: x(tile, x))
def backward(builder, tile, x):
    """Return ``L^-T x`` for a tuple x, L the tile with a unit diagonal."""
    for k in range(len(x) - 1, -1, -1):
        for i in range(k):
            x[i] = _less(builder, x[i], tile[_at(k, i)], x[k])
    return x


@built(lambda x, y: x(x, y))
def products(builder, x, y):
    """Return ``x_k y_k`` for two tuples."""
    return [builder.fmul(*pair) for pair in zip(x, y)]


@built(lambda total, x, y: total(total, x, y))
def less_product(builder, total, x, y):
    """Return ``total_k - x_k y`` for tuples total and x."""
    return [_less(builder, sum_, part, y) for sum_, part in zip(total, x)]


@built(lambda total, x, y: vector(vector, x, y))
def less_dot(builder, total, x, y):
    """Return ``total - sum_k x_k y_k`` for two tuples."""
    for pair in zip(x, y):
        total = _less(builder, total, *pair)
    return total
