"""Small triangular matrices of vectors, held in registers: tuples, the length of which is known when code is compiled.

A tile of w columns is the lower triangle of w rows, packed by rows, a tuple of ``w (w + 1) / 2`` vectors (`vectors`).
What is between its loads and stores never waits for the memory, and costs no addresses.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pgmp_petsc.lanes.vectors import CACHE_LINE, DOUBLES, LANES, join, parts_of, row_of, vector


def _at(row: int, column: int) -> int:
    """Return where an entry of a packed triangle is."""
    return row * (row + 1) // 2 + column


def _less(builder: ir.IRBuilder, total: ir.Value, x: ir.Value, y: ir.Value) -> ir.Value:
    """Return ``total - x y``; the compiler contracts it where the machine can."""
    return builder.fsub(total, builder.fmul(x, y))


def _addresses(context: Any, builder: ir.IRBuilder, array_type: Any, array: Any, at: Any, numbers: list) -> list:
    """Return the addresses of rows ``at + number``."""
    return [row_of(context, builder, array_type, array, builder.add(at, number)) for number in numbers]


def _of_tile(builder: ir.IRBuilder, stride: ir.Value, w: int) -> list[ir.Value]:
    """Return how far the entries of a tile are from its first one, in a packed triangle.

    `stride` is from the first entry to the one below.
    """
    numbers = []
    for row in range(w):
        # every row of a packed triangle is one longer than the one above
        first = builder.mul(stride, ir.Constant(stride.type, row))
        numbers += [builder.add(first, ir.Constant(stride.type, row * (row - 1) // 2 + k)) for k in range(row + 1)]
    return numbers


@intrinsic
def load_tile(typing, array, at, stride, like):
    """Return the tile that begins at an entry of a packed triangle, as wide as the tuple `like` is long.

    From its first entry to the one below it is `stride`.
    """
    w = len(like)

    def build(context, builder, sig, args):
        numbers = _of_tile(builder, args[2], w)
        rows = _addresses(context, builder, sig.args[0], args[0], args[1], numbers)
        return join(builder, [builder.load(row, align=CACHE_LINE) for row in rows])

    return types.UniTuple(vector, _at(w, 0))(array, types.intp, types.intp, like), build


@intrinsic
def store_tile(typing, array, at, stride, tile):
    """Put a tile where `load_tile` takes it from."""

    def build(context, builder, sig, args):
        parts = parts_of(builder, args[3], len(tile))
        w = next(w for w in range(len(parts) + 1) if _at(w, 0) == len(parts))
        numbers = _of_tile(builder, args[2], w)
        for part, row in zip(parts, _addresses(context, builder, sig.args[0], args[0], args[1], numbers)):
            builder.store(part, row, align=CACHE_LINE)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, tile), build


@intrinsic
def store_rows(typing, array, first, x):
    """Put a tuple into rows one after the other."""

    def build(context, builder, sig, args):
        numbers = [ir.Constant(args[1].type, k) for k in range(len(x))]
        rows = _addresses(context, builder, sig.args[0], args[0], args[1], numbers)
        for part, row in zip(parts_of(builder, args[2], len(x)), rows):
            builder.store(part, row, align=CACHE_LINE)
        return context.get_dummy_value()

    return types.void(array, types.intp, x), build


@intrinsic
def factorise_tile(typing, lower, upper):
    """Return L and U^T of ``L D U``, with unit diagonals, of a matrix whose lower triangle and transposed upper one are
    given. In place of the diagonals is ``D^-1``, NaN where a pivot is not positive."""
    count = len(lower)

    def build(context, builder, sig, args):
        low, up = (parts_of(builder, triangle, count) for triangle in args)
        nothing, invalid, one = (ir.Constant(DOUBLES, [number] * LANES) for number in (0.0, np.nan, 1.0))
        w = next(w for w in range(count + 1) if _at(w, 0) == count)
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
        return context.make_tuple(builder, sig.return_type, (join(builder, low), join(builder, up)))

    return types.Tuple((lower, upper))(lower, upper), build


@intrinsic
def diagonal_of(typing, tile, like):
    """Return the diagonal of a tile, as many vectors as `like` has."""
    w = len(like)

    def build(context, builder, sig, args):
        parts = parts_of(builder, args[0], len(tile))
        return join(builder, [parts[_at(k, k)] for k in range(w)])

    return types.UniTuple(vector, w)(tile, like), build


@intrinsic
def forward(typing, tile, x):
    """Return ``L^-1 x`` for a tuple x, L the tile with a unit diagonal."""

    def build(context, builder, sig, args):
        parts, found = parts_of(builder, args[0], len(tile)), parts_of(builder, args[1], len(x))
        for k in range(len(x)):
            for i in range(k + 1, len(x)):
                found[i] = _less(builder, found[i], parts[_at(i, k)], found[k])
        return join(builder, found)

    return x(tile, x), build


@intrinsic
def backward(typing, tile, x):
    """Return ``L^-T x`` for a tuple x, L the tile with a unit diagonal."""

    def build(context, builder, sig, args):
        parts, found = parts_of(builder, args[0], len(tile)), parts_of(builder, args[1], len(x))
        for k in range(len(x) - 1, -1, -1):
            for i in range(k):
                found[i] = _less(builder, found[i], parts[_at(k, i)], found[k])
        return join(builder, found)

    return x(tile, x), build


@intrinsic
def products(typing, x, y):
    """Return ``x_k y_k`` for two tuples."""

    def build(context, builder, sig, args):
        pairs = zip(*(parts_of(builder, values, len(x)) for values in args))
        return join(builder, [builder.fmul(*pair) for pair in pairs])

    return x(x, y), build


@intrinsic
def less_product(typing, total, x, y):
    """Return ``total_k - x_k y`` for tuples total and x."""

    def build(context, builder, sig, args):
        pairs = zip(*(parts_of(builder, values, len(total)) for values in args[:2]))
        return join(builder, [_less(builder, sum_, part, args[2]) for sum_, part in pairs])

    return total(total, x, y), build


@intrinsic
def less_dot(typing, total, x, y):
    """Return ``total - sum_k x_k y_k`` for two tuples."""

    def build(context, builder, sig, args):
        total = args[0]
        for pair in zip(*(parts_of(builder, values, len(x)) for values in args[1:])):
            total = _less(builder, total, *pair)
        return total

    return vector(vector, x, y), build
