"""Samples side by side in one register: a type of LANES doubles for compiled code.

It is LLVM's vector type with arithmetic, loads and stores. Whatever the machine has (AVX-512, pairs of AVX registers,
NEON, none), LLVM makes of it, so that the same source runs everywhere. Loops over the lanes of an array are not the
same: the compiler then has to prove that arrays do not overlap, and chooses a width of its own.

An array of vectors has the shape (n, LANES), is contiguous and begins at a cache line (`aligned_zeros`); ``load(x, i)``
is its row i. A set of lanes is an integer with one bit for each. A lane never touches another's numbers.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_cast
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

LANES = 8
EVERY_LANE = (1 << LANES) - 1
CACHE_LINE = 64  # bytes

DOUBLES = ir.VectorType(ir.DoubleType(), LANES)
_BITS = ir.VectorType(ir.IntType(1), LANES)


def aligned_zeros(shape: tuple[int, ...]) -> np.ndarray:
    """Return zeros that begin at a cache line.

    numpy begins at any multiple of 16 bytes. Where vectors of the machine straddle cache lines, a factorisation takes
    1.7 times as long, and a product 1.4 times.
    """
    size = 8 * math.prod(shape)
    buffer = np.zeros(size + CACHE_LINE, dtype=np.uint8)
    first = -buffer.ctypes.data % CACHE_LINE
    return buffer[first : first + size].view(np.float64).reshape(shape)


def same_in_all_lanes(numbers: np.ndarray) -> np.ndarray:
    """Return numbers (n,) as vectors, (n, LANES)."""
    vectors = aligned_zeros((numbers.size, LANES))
    vectors[:] = numbers[:, None]
    return vectors


class Vector(types.Type):
    """LANES doubles."""

    def __init__(self) -> None:
        super().__init__(name=f"Vector{LANES}")

    def can_convert_from(self, typing: Any, other: types.Type) -> Conversion | None:
        """Treat a number as the same number in every lane."""
        return Conversion.safe if other is types.float64 else None


vector = Vector()


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, of: types.Type) -> None:
        super().__init__(manager, of, DOUBLES)


def spread_number(builder: ir.IRBuilder, number: ir.Value) -> ir.Value:
    """Return a vector with the same number in every lane."""
    undefined = ir.Constant(DOUBLES, ir.Undefined)
    one = builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, undefined, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))


@lower_cast(types.float64, vector)
def _widen(
    context: Any, builder: ir.IRBuilder, from_type: types.Type, to_type: types.Type, number: ir.Value
) -> ir.Value:
    return spread_number(builder, number)


class _Operation(AbstractTemplate):
    """What operations with vectors return."""

    metadata = {"target": "cpu"}  # numba asks what it has for any target behind this: some thirty kinds of things

    def generic(self, args: tuple, kws: dict) -> Any:
        """Return the signature of an operation, or None where no vector is part of it."""
        if vector not in args or not all(one is vector or isinstance(one, types.Number) for one in args):
            return None
        return signature(vector, *(one if one is vector else types.float64 for one in args))


def _arithmetic(operators: tuple[Callable, ...], instruction: str) -> None:
    """Give vectors an operation with vectors and with numbers."""

    def lowered(first: bool, second: bool) -> Callable:
        def build(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
            left = args[0] if first else spread_number(builder, args[0])
            right = args[1] if second else spread_number(builder, args[1])
            return getattr(builder, instruction)(left, right)

        return build

    for name in operators:
        infer_global(name)(_Operation)
        for pair in ((vector, vector), (types.float64, vector), (vector, types.float64)):
            lower_builtin(name, *pair)(lowered(pair[0] is vector, pair[1] is vector))


_arithmetic((operator.add, operator.iadd), "fadd")
_arithmetic((operator.sub, operator.isub), "fsub")
_arithmetic((operator.mul, operator.imul), "fmul")
_arithmetic((operator.truediv, operator.itruediv), "fdiv")


infer_global(operator.neg)(_Operation)


@lower_builtin(operator.neg, vector)
def _negate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
    return builder.fneg(args[0])


def data_of(context: Any, builder: ir.IRBuilder, array_type: types.Array, array: ir.Value) -> ir.Value:
    """Return where the numbers of an array begin; `make_array` would put all of it on the stack."""
    return context.data_model_manager[array_type].get(builder, array, "data")


def row_of(context: Any, builder: ir.IRBuilder, array_type: types.Array, array: ir.Value, row: ir.Value) -> ir.Value:
    """Return the address of a row of LANES doubles, of an array contiguous over all of its axes."""
    data = data_of(context, builder, array_type, array)
    first = builder.mul(row, ir.Constant(row.type, LANES))
    return builder.bitcast(builder.gep(data, [first]), ir.PointerType(DOUBLES))


@intrinsic
def load(typing, array, row):
    """Return row number `row` of an array of vectors; its axes but the last count as one."""

    def build(context, builder, sig, args):
        return builder.load(row_of(context, builder, sig.args[0], *args), align=CACHE_LINE)

    return vector(array, types.intp), build


@intrinsic
def number_at(typing, array, at):
    """Return a number of a contiguous array, all of its axes counting as one."""

    def build(context, builder, sig, args):
        return builder.load(builder.gep(data_of(context, builder, sig.args[0], args[0]), [args[1]]))

    return types.float64(array, types.intp), build


@intrinsic
def store(typing, array, row, x):
    """Put a vector into a row; a number goes to all lanes."""

    def build(context, builder, sig, args):
        x = args[2] if sig.args[2] is vector else spread_number(builder, args[2])
        builder.store(x, row_of(context, builder, sig.args[0], *args[:2]), align=CACHE_LINE)
        return context.get_dummy_value()

    return types.void(array, types.intp, x if x is vector else types.float64), build


@intrinsic
def spread(typing, x):
    """Return a vector with the same number in every lane."""
    return vector(types.float64), lambda context, builder, sig, args: spread_number(builder, args[0])


@intrinsic
def larger(typing, x, y):
    """Return the larger of two numbers in every lane, NaN where the first one is."""

    def build(context, builder, sig, args):
        return builder.select(builder.fcmp_unordered("ugt", *args), *args)

    return vector(vector, vector), build


def _comparison(instruction: str, operator_name: str, about: str) -> Callable:
    @intrinsic
    def function(typing, x, y):
        def build(context, builder, sig, args):
            bits = getattr(builder, instruction)(operator_name, *args)
            return builder.zext(builder.bitcast(bits, ir.IntType(LANES)), ir.IntType(64))

        return types.int64(vector, vector), build

    function.__doc__ = about
    return function


exceeding = _comparison("fcmp_unordered", ">", "Return the lanes where not x <= y: a NaN counts.")
differing = _comparison("fcmp_unordered", "!=", "Return the lanes where x is not y, or a NaN.")
equal = _comparison("fcmp_ordered", "==", "Return the lanes where x is y.")


@intrinsic
def blend(typing, lanes, x, y):
    """Return x in some lanes, y in the others."""

    def build(context, builder, sig, args):
        bits = builder.bitcast(builder.trunc(args[0], ir.IntType(LANES)), _BITS)
        return builder.select(bits, args[1], args[2])

    return vector(types.int64, vector, vector), build


@intrinsic
def first_lane(typing, lanes):
    """Return the number of the first of some lanes; undefined without any."""

    def build(context, builder, sig, args):
        of = ir.FunctionType(ir.IntType(64), [ir.IntType(64), ir.IntType(1)])
        count = cgutils.get_or_insert_function(builder.module, of, "llvm.cttz.i64")
        return builder.call(count, [args[0], ir.Constant(ir.IntType(1), 1)])

    return types.int64(types.int64), build


@intrinsic
def count_lanes(typing, lanes):
    """Return how many lanes there are in a set."""

    def build(context, builder, sig, args):
        of = ir.FunctionType(ir.IntType(64), [ir.IntType(64)])
        return builder.call(cgutils.get_or_insert_function(builder.module, of, "llvm.ctpop.i64"), args)

    return types.int64(types.int64), build


# Tuples of vectors: one for each rigid coordinate. Their length is known when the code is compiled.


def parts_of(builder: ir.IRBuilder, values: ir.Value, count: int) -> list[ir.Value]:
    return [builder.extract_value(values, k) for k in range(count)]


def join(builder: ir.IRBuilder, parts: list[ir.Value]) -> ir.Value:
    values = ir.Constant(ir.ArrayType(DOUBLES, len(parts)), ir.Undefined)
    for k, part in enumerate(parts):
        values = builder.insert_value(values, part, k)
    return values


def _fused(builder: ir.IRBuilder, x: ir.Value, y: ir.Value, z: ir.Value) -> ir.Value:
    """Return ``x y + z``; the compiler contracts it where the machine can.

    Where two sums share the product it may keep that and two additions, for which some machines have units of their
    own beside those of products: to ask for two operations of both took 7 % more of a step with terms of second order.
    """
    return builder.fadd(builder.fmul(x, y), z)


@intrinsic
def add(typing, array, row, x):
    """Add a vector to a row."""

    def build(context, builder, sig, args):
        address = row_of(context, builder, sig.args[0], *args[:2])
        builder.store(builder.fadd(builder.load(address, align=CACHE_LINE), args[2]), address, align=CACHE_LINE)
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), build


@intrinsic
def add_to_row(typing, array, row, x, y):
    """Add ``x y`` to a row; y may be a number."""

    def build(context, builder, sig, args):
        address = row_of(context, builder, sig.args[0], *args[:2])
        y = args[3] if sig.args[3] is vector else spread_number(builder, args[3])
        builder.store(_fused(builder, args[2], y, builder.load(address, align=CACHE_LINE)), address, align=CACHE_LINE)
        return context.get_dummy_value()

    return types.void(array, types.intp, vector, y if y is vector else types.float64), build


@intrinsic
def load_rows(typing, array, first, stride, like):
    """Return rows first, first + stride, ... as a tuple as long as another one."""

    def build(context, builder, sig, args):
        rows = [builder.add(args[1], builder.mul(args[2], ir.Constant(args[2].type, k))) for k in range(len(like))]
        return join(
            builder,
            [builder.load(row_of(context, builder, sig.args[0], args[0], row), align=CACHE_LINE) for row in rows],
        )

    return types.UniTuple(vector, len(like))(array, types.intp, types.intp, like), build


@intrinsic
def zeros(typing, like):
    """Return a tuple of zeros as long as another one."""
    none = ir.Constant(DOUBLES, [0.0] * LANES)
    return (
        types.UniTuple(vector, len(like))(like),
        lambda context, builder, sig, args: join(builder, [none] * len(like)),
    )


@intrinsic
def add_product(typing, total, x, y):
    """Return ``total_k + x_k y`` for tuples total and x."""

    def build(context, builder, sig, args):
        pairs = zip(*(parts_of(builder, values, len(total)) for values in args[:2]))
        return join(builder, [_fused(builder, part, args[2], sum_) for sum_, part in pairs])

    return total(total, x, y), build


@intrinsic
def dot(typing, x, y):
    """Return ``sum_k x_k y_k`` for two tuples."""

    def build(context, builder, sig, args):
        pairs = list(zip(*(parts_of(builder, values, len(x)) for values in args)))
        total = builder.fmul(*pairs[0])
        for pair in pairs[1:]:
            total = _fused(builder, *pair, total)
        return total

    return vector(x, y), build


@intrinsic
def add_to_rows(typing, array, first, stride, x, y):
    """Add ``x_k y`` to rows first + k stride of an array, for a tuple x."""

    def build(context, builder, sig, args):
        for k, part in enumerate(parts_of(builder, args[3], len(x))):
            row = builder.add(args[1], builder.mul(args[2], ir.Constant(args[2].type, k)))
            address = row_of(context, builder, sig.args[0], args[0], row)
            total = _fused(builder, part, args[4], builder.load(address, align=CACHE_LINE))
            builder.store(total, address, align=CACHE_LINE)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, x, y), build


def _horner(
    builder: ir.IRBuilder, row: Callable[[int], ir.Value], places: list[ir.Value], n_powers: int
) -> tuple[ir.Value, list[ir.Value]]:
    """Build value and derivatives of a polynomial with n_powers along each of several places, from its coefficients."""

    def along(level: int, first: int) -> tuple[ir.Value, list[ir.Value]]:
        if level == len(places):
            return row(first), []
        stride, s = n_powers ** (len(places) - level - 1), places[level]
        c = [along(level + 1, first + power * stride) for power in range(n_powers)]
        value, others = c[-1]
        slope = value
        for power in range(n_powers - 2, -1, -1):
            value = _fused(builder, s, value, c[power][0])
            others = [_fused(builder, s, other, part) for other, part in zip(others, c[power][1])]
            slope = _fused(builder, s, slope, value) if power else slope
        return value, [slope, *others]

    return along(0, 0)


def _coefficients(context: Any, builder: ir.IRBuilder, sig: Any, args: Any, n_powers: int) -> Callable[[int], ir.Value]:
    """Return what loads the coefficients of an entry of kept polynomials."""
    base = builder.mul(args[1], ir.Constant(args[1].type, n_powers ** len(sig.args[2])))

    def row(number: int) -> ir.Value:
        at = builder.add(base, ir.Constant(base.type, number))
        return builder.load(row_of(context, builder, sig.args[0], args[0], at), align=CACHE_LINE)

    return row


def _polynomial(n_powers: int, about: str) -> Callable:
    @intrinsic
    def function(typing, kept, entry, place):
        result = types.Tuple((vector, types.UniTuple(vector, len(place))))

        def build(context, builder, sig, args):
            rows = _coefficients(context, builder, sig, args, n_powers)
            value, parts = _horner(builder, rows, parts_of(builder, args[2], len(place)), n_powers)
            return context.make_tuple(builder, sig.return_type, (value, join(builder, parts)))

        return result(kept, types.intp, place), build

    function.__doc__ = about
    return function


# Polynomials at a place, a tuple of r vectors, from kept coefficients: n_powers^r rows of each entry, with the powers
# of the last coordinate running fastest.
N_POWERS, N_POWERS_OF_RIGID = 4, 8
polynomial = _polynomial(N_POWERS, "Return value and derivatives of a polynomial, cubic in each coordinate.")
rigid_polynomial = _polynomial(N_POWERS_OF_RIGID, "Return value and derivatives of a polynomial of degree 7.")
