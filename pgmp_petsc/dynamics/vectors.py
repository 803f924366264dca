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
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from pgmp_petsc.runtime.compiled import njit

LANES = 8
CACHE_LINE = 64  # bytes

_DOUBLES = ir.VectorType(ir.DoubleType(), LANES)
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


class Vector(types.Type):
    """LANES doubles."""

    def __init__(self) -> None:
        super().__init__(name=f"Vector{LANES}")


vector = Vector()


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, of: types.Type) -> None:
        super().__init__(manager, of, _DOUBLES)


def _spread(builder: ir.IRBuilder, number: ir.Value) -> ir.Value:
    """Return a vector with the same number in every lane."""
    undefined = ir.Constant(_DOUBLES, ir.Undefined)
    one = builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, undefined, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))


def _arithmetic(operators: tuple[Callable, ...], instruction: str) -> None:
    """Give vectors an operation with vectors and with numbers."""

    def lowered(first: bool, second: bool) -> Callable:
        def build(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
            left = args[0] if first else _spread(builder, args[0])
            right = args[1] if second else _spread(builder, args[1])
            return getattr(builder, instruction)(left, right)

        return build

    pairs = [(vector, vector), (types.float64, vector), (vector, types.float64)]
    for name in operators:
        template = type("_Operation", (ConcreteTemplate,), {"cases": [signature(vector, *pair) for pair in pairs]})
        infer_global(name)(template)
        for pair in pairs:
            lower_builtin(name, *pair)(lowered(pair[0] is vector, pair[1] is vector))


_arithmetic((operator.add, operator.iadd), "fadd")
_arithmetic((operator.sub, operator.isub), "fsub")
_arithmetic((operator.mul, operator.imul), "fmul")
_arithmetic((operator.truediv, operator.itruediv), "fdiv")


@infer_global(operator.neg)
class _Negation(ConcreteTemplate):
    cases = [signature(vector, vector)]


@lower_builtin(operator.neg, vector)
def _negate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
    return builder.fneg(args[0])


def _row(context: Any, builder: ir.IRBuilder, array_type: types.Array, array: ir.Value, row: ir.Value) -> ir.Value:
    """Return the address of a row of LANES doubles, of an array contiguous over all of its axes."""
    data = context.make_array(array_type)(context, builder, array).data
    first = builder.mul(row, ir.Constant(row.type, LANES))
    return builder.bitcast(builder.gep(data, [first]), ir.PointerType(_DOUBLES))


@intrinsic
def load(typing, array, row):
    """Return row number `row` of an array of vectors; its axes but the last count as one."""

    def build(context, builder, sig, args):
        return builder.load(_row(context, builder, sig.args[0], *args), align=CACHE_LINE)

    return vector(array, types.intp), build


@intrinsic
def store(typing, array, row, x):
    """Put a vector into a row; a number goes to all lanes."""

    def build(context, builder, sig, args):
        x = args[2] if sig.args[2] is vector else _spread(builder, args[2])
        builder.store(x, _row(context, builder, sig.args[0], *args[:2]), align=CACHE_LINE)
        return context.get_dummy_value()

    return types.void(array, types.intp, x if x is vector else types.float64), build


@njit(inline="always")
def add(array, row, x):
    """Add a vector to a row."""
    store(array, row, load(array, row) + x)


@intrinsic
def spread(typing, x):
    """Return a vector with the same number in every lane."""
    return vector(types.float64), lambda context, builder, sig, args: _spread(builder, args[0])


def _unary(name: str) -> Callable:
    @intrinsic
    def function(typing, x):
        def build(context, builder, sig, args):
            of = ir.FunctionType(_DOUBLES, [_DOUBLES])
            return builder.call(cgutils.get_or_insert_function(builder.module, of, f"llvm.{name}.v{LANES}f64"), args)

        return vector(vector), build

    return function


square_root, floor, absolute = _unary("sqrt"), _unary("floor"), _unary("fabs")


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


def _parts(builder: ir.IRBuilder, values: ir.Value, count: int) -> list[ir.Value]:
    return [builder.extract_value(values, k) for k in range(count)]


def _tuple(builder: ir.IRBuilder, parts: list[ir.Value]) -> ir.Value:
    values = ir.Constant(ir.ArrayType(_DOUBLES, len(parts)), ir.Undefined)
    for k, part in enumerate(parts):
        values = builder.insert_value(values, part, k)
    return values


def _fused(builder: ir.IRBuilder, x: ir.Value, y: ir.Value, z: ir.Value) -> ir.Value:
    """Return ``x y + z``; the compiler contracts it where the machine can."""
    return builder.fadd(builder.fmul(x, y), z)


@intrinsic
def load_rows(typing, array, first, stride, like):
    """Return rows first, first + stride, ... as a tuple as long as another one."""

    def build(context, builder, sig, args):
        rows = [builder.add(args[1], builder.mul(args[2], ir.Constant(args[2].type, k))) for k in range(len(like))]
        return _tuple(
            builder,
            [builder.load(_row(context, builder, sig.args[0], args[0], row), align=CACHE_LINE) for row in rows],
        )

    return types.UniTuple(vector, len(like))(array, types.intp, types.intp, like), build


@intrinsic
def zeros(typing, like):
    """Return a tuple of zeros as long as another one."""
    none = ir.Constant(_DOUBLES, [0.0] * LANES)
    return (
        types.UniTuple(vector, len(like))(like),
        lambda context, builder, sig, args: _tuple(builder, [none] * len(like)),
    )


@intrinsic
def add_product(typing, total, x, y):
    """Return ``total_k + x_k y`` for tuples total and x."""

    def build(context, builder, sig, args):
        pairs = zip(*(_parts(builder, values, len(total)) for values in args[:2]))
        return _tuple(builder, [_fused(builder, part, args[2], sum_) for sum_, part in pairs])

    return total(total, x, y), build


@intrinsic
def dot(typing, x, y):
    """Return ``sum_k x_k y_k`` for two tuples."""

    def build(context, builder, sig, args):
        pairs = list(zip(*(_parts(builder, values, len(x)) for values in args)))
        total = builder.fmul(*pairs[0])
        for pair in pairs[1:]:
            total = _fused(builder, *pair, total)
        return total

    return vector(x, y), build


@intrinsic
def add_to_rows(typing, array, first, stride, x, y):
    """Add ``x_k y`` to rows first + k stride of an array, for a tuple x."""

    def build(context, builder, sig, args):
        for k, part in enumerate(_parts(builder, args[3], len(x))):
            row = builder.add(args[1], builder.mul(args[2], ir.Constant(args[2].type, k)))
            address = _row(context, builder, sig.args[0], args[0], row)
            total = _fused(builder, part, args[4], builder.load(address, align=CACHE_LINE))
            builder.store(total, address, align=CACHE_LINE)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, x, y), build


def _horner(
    builder: ir.IRBuilder, row: Callable[[int], ir.Value], places: list[ir.Value], with_slopes: bool
) -> tuple[ir.Value, list[ir.Value]]:
    """Build value and derivatives of a polynomial, cubic along each of several places, from rows of coefficients."""

    def along(level: int, first: int) -> tuple[ir.Value, list[ir.Value]]:
        if level == len(places):
            return row(first), []
        stride, s = 4 ** (len(places) - level - 1), places[level]
        c = [along(level + 1, first + power * stride) for power in range(4)]
        values = [value for value, _ in c]
        # with t = c3 s, u = c2 + t and w = c1 + s u the derivative is w + s (u + t)
        t = builder.fmul(values[3], s)
        u = builder.fadd(values[2], t)
        w = _fused(builder, s, u, values[1])
        slopes = []
        if with_slopes:
            slopes.append(_fused(builder, s, builder.fadd(u, t), w))
            for k in range(len(places) - level - 1):
                slope = c[3][1][k]
                for power in (2, 1, 0):
                    slope = _fused(builder, s, slope, c[power][1][k])
                slopes.append(slope)
        return _fused(builder, s, w, values[0]), slopes

    return along(0, 0)


def _coefficients(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Callable[[int], ir.Value]:
    """Return what loads the coefficients of an entry of kept polynomials."""
    base = builder.mul(args[1], ir.Constant(args[1].type, 4 ** len(sig.args[2])))

    def row(number: int) -> ir.Value:
        at = builder.add(base, ir.Constant(base.type, number))
        return builder.load(_row(context, builder, sig.args[0], args[0], at), align=CACHE_LINE)

    return row


@intrinsic
def polynomial(typing, kept, entry, place):
    """Return value and derivatives of a polynomial, cubic in each of the coordinates of a place.

    Parameters
    ----------
    kept
        Coefficients, rows ``entry 4^r + ...`` with those of the last coordinate running fastest.
    place
        Tuple of r vectors.
    """

    def build(context, builder, sig, args):
        rows = _coefficients(context, builder, sig, args)
        value, slopes = _horner(builder, rows, _parts(builder, args[2], len(place)), True)
        return context.make_tuple(builder, sig.return_type, (value, _tuple(builder, slopes)))

    return types.Tuple((vector, types.UniTuple(vector, len(place))))(kept, types.intp, place), build


@intrinsic
def polynomial_value(typing, kept, entry, place):
    """Return the value of a polynomial alone; see `polynomial`."""

    def build(context, builder, sig, args):
        rows = _coefficients(context, builder, sig, args)
        return _horner(builder, rows, _parts(builder, args[2], len(place)), False)[0]

    return vector(kept, types.intp, place), build
