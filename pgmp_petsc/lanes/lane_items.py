"""Compiled code that is written once for one sample and for LANES of them side by side.

Arrays of samples have the shape (..., n_lanes), with one lane or LANES. `items` sees them as arrays without the last
axis, of numbers or of vectors (`vectors`), and everything here takes both: a kernel reads as that of one sample, and
is compiled for either when it is called with it. Which one follows from the type of a tuple as long as there are lanes
(`width_of`).

A sample's numbers are the same to the last bit alone and in any lane. Kernels on items are therefore compiled without
freedom in the order and the rounding of operations; products and sums are contracted by `fused` alone.

How the samples of a batch lie in arrays: sample k is lane ``k % n_lanes`` of block ``k // n_lanes``, or in an order
of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.vectors import CACHE_LINE, DOUBLES, LANES, alike, beyond, built, select, vector, widest

WIDE, ALONE = (0.0,) * LANES, (0.0,)


def width_of(n_lanes: int) -> tuple[float, ...]:
    """Return the tuple that tells compiled functions how many lanes there are."""
    return (0.0,) * n_lanes


def aligned(shape: tuple[int, ...]) -> np.ndarray:
    """Return an array of any numbers that begins at a cache line.

    Memory that was in use before is taken again as it is; for zeros it would be swept first (`vectors.aligned_zeros`).
    """
    size = math.prod(shape)
    buffer = np.empty(size + CACHE_LINE // 8)
    first = (-buffer.__array_interface__["data"][0] % CACHE_LINE) // 8  # as `ctypes.data`, in a third of the time
    return buffer[first : first + size].reshape(shape)


def _item(width: types.BaseTuple) -> types.Type:
    return types.float64 if len(width) == 1 else vector


@intrinsic
def items(typing, array, width):
    """Return the same numbers without the axis of lanes: an array of numbers for one lane, or of vectors.

    They are not counted as a user of the array (counting them would take as long as some of the work): an array that a
    kernel has made needs a `keep` behind the last use of its items.
    """
    of = _item(width)
    # numpy's arrays begin anywhere: nothing is promised about where vectors lie
    result = types.Array(of, array.ndim - 1, "C", aligned=of is not vector)

    def build(context, builder, sig, args):
        from numba.np.arrayobj import populate_array  # a noticeable time, and what is compiled has no use for it

        source = context.make_array(array)(context, builder, args[0])
        made = context.make_array(result)(context, builder)
        shape, strides = (cgutils.unpack_tuple(builder, part)[:-1] for part in (source.shape, source.strides))
        data = builder.bitcast(source.data, context.get_data_type(of).as_pointer())
        itemsize = context.get_constant(types.intp, 8 * len(width))
        populate_array(made, data, shape, strides, itemsize, None, None)
        return made._getvalue()

    return result(array, width), build


@njit(inline="always")
def empty_lanes(n, n_lanes):
    """Return an array (n, n_lanes) of any numbers that begins at a cache line."""
    buffer = np.empty(n * n_lanes + CACHE_LINE // 8)
    first = (-buffer.ctypes.data % CACHE_LINE) // 8
    return buffer[first : first + n * n_lanes].reshape((n, n_lanes))


@built(lambda array, row, column, width: _item(width)(array, types.intp, types.intp, width))
def of_column(builder, array, row, column, width):
    """Return what columns (..., LANES) have for all lanes, the vector in a row (all axes but the last count as one), or
    for a sample alone one number of it."""
    first, of = builder.mul(row, ir.Constant(row.type, LANES)), DOUBLES
    if len(width) == 1:
        first, of = builder.add(first, column), ir.DoubleType()
    place = builder.gep(array.numbers, [first])
    return builder.load(builder.bitcast(place, of.as_pointer()), align=8)


@intrinsic
def borrowed(typing, array):
    """Return the same array, not counted as a user of it either: functions that it is handed to need not count."""

    def build(context, builder, sig, args):
        made = context.make_array(array)(context, builder, args[0])
        made.meminfo, made.parent = (cgutils.get_null_value(part.type) for part in (made.meminfo, made.parent))
        return made._getvalue()

    return array(array), build


@built(lambda array: types.void(array))
def keep(builder, array):
    """Use an array made here once more: items do not own it, and it would be given back after its own last use."""


def _call(builder: ir.IRBuilder, name: str, *arguments: ir.Value) -> ir.Value:
    """Return what a function of LLVM makes of numbers or vectors; of both where some are vectors, a vector."""
    of = arguments[0].type
    suffix = f"v{LANES}f64" if of == DOUBLES else "f64"
    called = ir.FunctionType(of, [of] * len(arguments))
    return builder.call(cgutils.get_or_insert_function(builder.module, called, f"llvm.{name}.{suffix}"), arguments)


def _operation(name: str, about: str) -> Callable:
    def operate(builder, x):
        return _call(builder, name, x)

    operate.__doc__ = about
    return built(lambda x: widest(x)(widest(x)))(operate)


square_root = _operation("sqrt", "Return the square root of every number.")
floor = _operation("floor", "Return the largest whole number below or at every number.")
absolute = _operation("fabs", "Return the absolute value of every number.")
nearest_whole = _operation("rint", "Return the whole number that is nearest to every number.")


@built(lambda x, y, z: widest(x, y, z)(*alike(x, y, z)))
def fused(builder, x, y, z):
    """Return ``x y + z``, contracted where the machine can: one instruction, in vectors and in numbers alike."""
    return _call(builder, "fmuladd", x, y, z)


@built(lambda y, x: widest(x, y)(*alike(x, y)))
def angle_of(builder, y, x):
    """Return the angle of the point (x, y) in every lane, in (-pi, pi]; by the library's function, lane by lane."""
    number = ir.DoubleType()
    function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(number, [number, number]), "atan2")
    if x.type == number:
        return builder.call(function, [y, x])
    for place in (ir.Constant(ir.IntType(32), lane) for lane in range(LANES)):
        one = builder.call(function, [builder.extract_element(part, place) for part in (y, x)])
        y = builder.insert_element(y, one, place)
    return y


@njit(inline="always")
def fill(array, number, width):
    """Put a number into all items of an array (n, n_lanes)."""
    places = items(array, width)
    for k in range(places.size):
        places[k] = number


@njit(error_model="numpy", forceinline=True)
def lanes_of(mask):
    """Return the set of lanes that a mask (n_lanes,) has."""
    lanes = 0
    for lane in range(mask.size):
        lanes |= np.int64(mask[lane]) << lane
    return lanes


# pi / 2 in three parts, whose products with whole numbers up to 2^20 are exact, and the polynomials of both functions
# up to pi / 4 (Sun's fdlibm): the highest power first
PI_HALVES = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
SINE = (
    1.58969099521155010221e-10, -2.50507602534068634195e-08, 2.75573137070700676789e-06, -1.98412698298579493134e-04,
    8.33333333332248946124e-03, -1.66666666666666324348e-01,
)  # fmt: skip
COSINE = (
    -1.13596475577881948265e-11, 2.08757232129817482790e-09, -2.75573143513906633035e-07, 2.48015872894767294178e-05,
    -1.38888888888741095749e-03, 4.16666666666666019037e-02,
)  # fmt: skip


@njit(error_model="numpy", forceinline=True)
def sine_cosine(x):
    """Return sine and cosine, to a unit or two in the last place for up to 250,000 revolutions.

    One polynomial is evaluated in all lanes, where the library's functions would be called lane by lane.
    """
    turns = floor(x * (2.0 / np.pi) + 0.5)
    r = ((x - turns * PI_HALVES[0]) - turns * PI_HALVES[1]) - turns * PI_HALVES[2]
    z = r * r
    s, c = fused(z, SINE[0], SINE[1]), fused(z, COSINE[0], COSINE[1])
    s, c = fused(z, s, SINE[2]), fused(z, c, COSINE[2])
    s, c = fused(z, s, SINE[3]), fused(z, c, COSINE[3])
    s, c = fused(z, s, SINE[4]), fused(z, c, COSINE[4])
    s, c = fused(z, s, SINE[5]), fused(z, c, COSINE[5])
    s, c = fused(r * z, s, r), fused(z * z, c, 1.0 - 0.5 * z)
    half = floor(0.5 * turns)
    is_odd = beyond(turns - 2.0 * half, 0.5)
    sign = 1.0 - 2.0 * (half - 2.0 * floor(0.5 * half))
    return sign * select(is_odd, c, s), sign * select(is_odd, -s, c)


@njit(error_model="numpy")
def eliminate(n, n_right, matrix, right):
    """Solve n equations by elimination with pivots, in place: items of a matrix (n, n) and of right sides (n, n_right),
    which become the solutions."""
    for k in range(n):
        for i in range(k + 1, n):
            lanes = beyond(absolute(matrix[i, k]), absolute(matrix[k, k]))
            if lanes:
                for j in range(k, n):
                    above, below = matrix[k, j], matrix[i, j]
                    matrix[k, j], matrix[i, j] = select(lanes, below, above), select(lanes, above, below)
                for j in range(n_right):
                    above, below = right[k, j], right[i, j]
                    right[k, j], right[i, j] = select(lanes, below, above), select(lanes, above, below)
        inverse = 1.0 / matrix[k, k]
        for i in range(k + 1, n):
            factor = -(matrix[i, k] * inverse)
            for j in range(k + 1, n):
                matrix[i, j] = fused(factor, matrix[k, j], matrix[i, j])
            for j in range(n_right):
                right[i, j] = fused(factor, right[k, j], right[i, j])
        matrix[k, k] = inverse
    for k in range(n - 1, -1, -1):
        for j in range(n_right):
            right[k, j] = right[k, j] * matrix[k, k]
        for i in range(k):
            for j in range(n_right):
                right[i, j] = fused(-matrix[i, k], right[k, j], right[i, j])


def solutions(matrices: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solutions (k, n) of systems of equations (k, n, n) with right sides (k, n); they are no numbers where
    what is given has none, or a matrix is singular."""
    found, (n, width) = np.empty_like(right), (right.shape[1], width_of(LANES))
    _fill_solutions(matrices, right, aligned((n, n, LANES)), aligned((n, 1, LANES)), width, found)
    return found


@njit(cache=True, entry=True, error_model="numpy")
def _fill_solutions(matrices, right, matrix, x, width, found):
    n = right.shape[1]
    for first in range(0, len(right), LANES):
        behind = min(first + LANES, len(right))
        for lane in range(LANES):  # places that are left over have the last system once more
            k = min(first + lane, behind - 1)
            for i in range(n):
                x[i, 0, lane] = right[k, i]
                for j in range(n):
                    matrix[i, j, lane] = matrices[k, i, j]
        eliminate(n, 1, items(matrix, width), items(x, width))
        for k in range(first, behind):
            for i in range(n):
                found[k, i] = x[i, 0, k - first]


@dataclass(frozen=True)
class SampleBlocks:
    """Blocks of samples side by side; the last is filled up with copies of the last sample that are never active.

    A sample's numbers do not depend on how many lie beside it.
    """

    n_samples: int  # number of samples
    #: n_lanes, n_blocks: samples of a block, LANES but for a sample alone, and number of blocks
    n_lanes: int
    n_blocks: int
    #: numbers of the samples as they lie in the lanes, shape (n_samples,); None where they lie one after the other
    order: np.ndarray | None = None

    @classmethod
    def of(cls, n_samples: int) -> SampleBlocks:
        """Choose the blocks for a number of samples."""
        n_lanes = 1 if n_samples == 1 else LANES
        return cls(n_samples, n_lanes, -(-n_samples // n_lanes))

    @property
    def n_places(self) -> int:
        """Number of lanes of all blocks."""
        return self.n_blocks * self.n_lanes

    def ordered(self, order: np.ndarray) -> Self:
        """Return the same blocks with the samples in another order."""
        return replace(self, order=order)

    @property
    def samples(self) -> np.ndarray:
        """Number of the sample in each lane, shape (n_blocks, n_lanes)."""
        return self.pack(np.arange(self.n_samples))

    def fill(self, rows: np.ndarray) -> np.ndarray:
        """Repeat the last sample so that the last axis, of samples, fills all blocks."""
        return np.concatenate([rows, np.repeat(rows[..., -1:], self.n_places - self.n_samples, axis=-1)], axis=-1)

    def pack(self, rows: np.ndarray, place: int = 0) -> np.ndarray:
        """Return rows of shape (..., n_samples) as contiguous (n_blocks, ..., n_lanes); the axis of blocks may have
        another place."""
        rows = rows if self.order is None else rows[..., self.order]
        blocks = self.fill(rows).reshape(*rows.shape[:-1], self.n_blocks, self.n_lanes)
        return np.ascontiguousarray(np.moveaxis(blocks, -2, place))

    def unpack(self, array: np.ndarray) -> np.ndarray:
        """Return an array of shape (n_blocks, ..., n_lanes) as (..., n_samples)."""
        # one block, of a single run, is not moved: that takes as long as some of the work
        rows = array[0] if self.n_blocks == 1 else np.moveaxis(array, 0, -2).reshape(*array.shape[1:-1], self.n_places)
        rows = rows[..., : self.n_samples]
        if self.order is None:
            return rows
        result = np.empty_like(rows)
        result[..., self.order] = rows
        return result

    def mask(self, samples: np.ndarray) -> np.ndarray:
        """Return a mask of samples as (n_blocks, n_lanes), False where there is none."""
        filled = np.zeros(self.n_places, dtype=bool)
        filled[: self.n_samples] = samples if self.order is None else samples[self.order]
        return filled.reshape(self.n_blocks, self.n_lanes)
