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
from functools import update_wrapper
from typing import Any, NamedTuple

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


def widened(builder: ir.IRBuilder, x: ir.Value) -> ir.Value:
    """Return a vector: as it is, or of a number that in every lane."""
    if x.type == DOUBLES:
        return x
    undefined = ir.Constant(DOUBLES, ir.Undefined)
    one = builder.insert_element(undefined, x, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, undefined, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))


@lower_cast(types.float64, vector)
def _widen(
    context: Any, builder: ir.IRBuilder, from_type: types.Type, to_type: types.Type, number: ir.Value
) -> ir.Value:
    return widened(builder, number)


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

    def lowered(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
        return getattr(builder, instruction)(*(widened(builder, one) for one in args))

    for name in operators:
        infer_global(name)(_Operation)
        for pair in ((vector, vector), (types.float64, vector), (vector, types.float64)):
            lower_builtin(name, *pair)(lowered)


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


class Rows(NamedTuple):
    """An array of vectors, contiguous over all of its axes, where code is built; its axes but the last count as one."""

    context: Any
    builder: ir.IRBuilder
    of: types.Array
    array: ir.Value

    @property
    def numbers(self) -> ir.Value:
        """Where the numbers of the array begin."""
        return data_of(self.context, self.builder, self.of, self.array)

    def address(self, row: ir.Value) -> ir.Value:
        """Return that of a row of LANES doubles."""
        first = self.builder.mul(row, ir.Constant(row.type, LANES))
        return self.builder.bitcast(self.builder.gep(self.numbers, [first]), ir.PointerType(DOUBLES))

    def number(self, at: ir.Value) -> ir.Value:
        """Return one of the numbers."""
        return self.builder.load(self.builder.gep(self.numbers, [at]))

    def load(self, row: ir.Value) -> ir.Value:
        """Return the vector in a row."""
        return self.builder.load(self.address(row), align=CACHE_LINE)

    def store(self, row: ir.Value, x: ir.Value) -> None:
        """Put a vector into a row, or a number into all of its lanes."""
        self.builder.store(widened(self.builder, x), self.address(row), align=CACHE_LINE)


def built(typed: Callable) -> Callable:
    """Return what makes a function for compiled code of one that builds its result.

    That takes a builder of instructions and the values of the arguments: of a tuple the list of its parts, of an array
    its `Rows`. It returns a value, a list, which is a tuple of vectors, a tuple of these, or None. `typed` gives the
    signature, in numba's form, from the types of the arguments.
    """

    def decorate(build: Callable) -> Callable:
        def defined(typing: Any, *given: types.Type) -> tuple[Any, Callable]:
            def lower(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
                def handed(of: types.Type, value: ir.Value) -> Any:
                    if isinstance(of, types.Array):
                        return Rows(context, builder, of, value)
                    return parts_of(builder, value, len(of)) if isinstance(of, types.BaseTuple) else value

                def returned(found: Any) -> ir.Value:
                    if isinstance(found, tuple):
                        return context.make_tuple(builder, sig.return_type, tuple(map(returned, found)))
                    return join(builder, found) if isinstance(found, list) else found

                found = build(builder, *map(handed, sig.args, args))
                return context.get_dummy_value() if found is None else returned(found)

            return typed(*given), lower

        return intrinsic(update_wrapper(defined, build))

    return decorate


def widest(*of: types.Type) -> types.Type:
    """Return the type of vectors where one of these is, else that of numbers."""
    return vector if vector in of else types.float64


def alike(*of: types.Type) -> list[types.Type]:
    """Return the types of numbers and vectors as which all of them are taken: vectors where one is."""
    return [widest(*of)] * len(of)


@built(lambda array, row: vector(array, types.intp))
def load(builder, array, row):
    """Return row number `row` of an array of vectors; its axes but the last count as one."""
    return array.load(row)


@built(lambda array, at: types.float64(array, types.intp))
def number_at(builder, array, at):
    """Return a number of a contiguous array, all of its axes counting as one."""
    return array.number(at)


@built(lambda array, at: types.void(array, types.intp))
def expect(builder, array, at):
    """Bring the cache line of a number close, as of `number_at`: it is about to be written."""
    place = builder.bitcast(builder.gep(array.numbers, [at]), ir.IntType(8).as_pointer())
    whole = ir.IntType(32)
    of = ir.FunctionType(ir.VoidType(), [place.type, whole, whole, whole])
    called = cgutils.get_or_insert_function(builder.module, of, "llvm.prefetch.p0i8")
    builder.call(called, [place, *(ir.Constant(whole, k) for k in (1, 3, 1))])  # to write, to stay, of data


@built(lambda array, row, x: types.void(array, types.intp, widest(x)))
def store(builder, array, row, x):
    """Put a vector into a row; a number goes to all lanes."""
    array.store(row, x)


@built(lambda x: vector(types.float64))
def spread(builder, x):
    """Return a vector with the same number in every lane."""
    return widened(builder, x)


@built(lambda x, y: vector(vector, vector))
def larger(builder, x, y):
    """Return the larger of two numbers in every lane, NaN where the first one is."""
    return builder.select(builder.fcmp_unordered("ugt", x, y), x, y)


def _comparison(instruction: str, operator_name: str, about: str) -> Callable:
    def compare(builder, x, y):
        found = getattr(builder, instruction)(operator_name, x, y)
        bits = builder.bitcast(found, ir.IntType(LANES)) if x.type == DOUBLES else found
        return builder.zext(bits, ir.IntType(64))

    compare.__doc__ = about
    return built(lambda x, y: types.int64(*alike(x, y)))(compare)


# of numbers a set of lanes is 1 or 0
beyond = _comparison("fcmp_unordered", ">", "Return the lanes where not x <= y: a NaN counts.")
differing = _comparison("fcmp_unordered", "!=", "Return the lanes where x is not y, or a NaN.")
equal = _comparison("fcmp_ordered", "==", "Return the lanes where x is y.")


@built(lambda lanes, x, y: widest(x, y)(types.int64, *alike(x, y)))
def select(builder, lanes, x, y):
    """Return x in some lanes, y in the others."""
    is_vector = x.type == DOUBLES
    bits = builder.trunc(lanes, ir.IntType(LANES if is_vector else 1))
    return builder.select(builder.bitcast(bits, _BITS) if is_vector else bits, x, y)


@built(lambda lanes: types.int64(types.int64))
def first_lane(builder, lanes):
    """Return the number of the first of some lanes; undefined without any."""
    of = ir.FunctionType(ir.IntType(64), [ir.IntType(64), ir.IntType(1)])
    count = cgutils.get_or_insert_function(builder.module, of, "llvm.cttz.i64")
    return builder.call(count, [lanes, ir.Constant(ir.IntType(1), 1)])


@built(lambda lanes: types.int64(types.int64))
def count_lanes(builder, lanes):
    """Return how many lanes there are in a set."""
    of = ir.FunctionType(ir.IntType(64), [ir.IntType(64)])
    return builder.call(cgutils.get_or_insert_function(builder.module, of, "llvm.ctpop.i64"), [lanes])


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


def _every(builder: ir.IRBuilder, first: ir.Value, stride: ir.Value, n: int) -> list[ir.Value]:
    """Return numbers of n rows first, first + stride, ..."""
    return [builder.add(first, builder.mul(stride, ir.Constant(stride.type, k))) for k in range(n)]


@built(lambda array, row, x: types.void(array, types.intp, vector))
def add(builder, array, row, x):
    """Add a vector to a row."""
    array.store(row, builder.fadd(array.load(row), x))


@built(lambda array, row, x, y: types.void(array, types.intp, vector, widest(y)))
def add_to_row(builder, array, row, x, y):
    """Add ``x y`` to a row; y may be a number."""
    array.store(row, _fused(builder, x, widened(builder, y), array.load(row)))


@built(lambda array, first, stride, like: types.UniTuple(vector, len(like))(array, types.intp, types.intp, like))
def load_rows(builder, array, first, stride, like):
    """Return rows first, first + stride, ... as a tuple as long as another one."""
    return [array.load(row) for row in _every(builder, first, stride, len(like))]


@built(lambda like: types.UniTuple(vector, len(like))(like))
def zeros(builder, like):
    """Return a tuple of zeros as long as another one."""
    return [ir.Constant(DOUBLES, [0.0] * LANES)] * len(like)


@built(lambda total, x, y: total(total, x, y))
def add_product(builder, total, x, y):
    """Return ``total_k + x_k y`` for tuples total and x."""
    return [_fused(builder, part, y, sum_) for sum_, part in zip(total, x)]


@built(lambda x, y: vector(x, y))
def dot(builder, x, y):
    """Return ``sum_k x_k y_k`` for two tuples."""
    total = builder.fmul(x[0], y[0])
    for pair in zip(x[1:], y[1:]):
        total = _fused(builder, *pair, total)
    return total


@built(lambda array, first, stride, x, y: types.void(array, types.intp, types.intp, x, y))
def add_to_rows(builder, array, first, stride, x, y):
    """Add ``x_k y`` to rows first + k stride of an array, for a tuple x."""
    for part, row in zip(x, _every(builder, first, stride, len(x))):
        array.store(row, _fused(builder, part, y, array.load(row)))


def derivatives_of(
    builder: ir.IRBuilder, coefficient: Callable[[int], ir.Value], places: list[ir.Value], n_powers: int, order: int
) -> dict[tuple[int, ...], ir.Value]:
    """Build a polynomial and its derivatives up to an order, by how often each coordinate is differentiated with."""

    def along(level: int, first: int) -> dict[tuple[int, ...], ir.Value]:
        if level == len(places):
            return {(): coefficient(first)}
        stride, s = n_powers ** (len(places) - level - 1), places[level]
        inner = [along(level + 1, first + power * stride) for power in range(n_powers)]
        found = {}
        for others in inner[0]:
            # Horner's scheme, and what it makes of its own partial sums
            sums = [inner[-1][others]]
            for power in range(n_powers - 2, -1, -1):
                longer = [_fused(builder, s, sums[0], inner[power][others])]
                longer += [_fused(builder, s, y, x) for x, y in zip(sums, sums[1:])]
                sums = (longer + sums[-1:])[: order - sum(others) + 1]
            for times, total in enumerate(sums):
                found[(times, *others)] = builder.fadd(total, total) if times == 2 else total
        return found

    return along(0, 0)


def _polynomial(n_powers: int, about: str) -> Callable:
    def evaluate(builder, kept, entry, place):
        r = len(place)
        base = builder.mul(entry, ir.Constant(entry.type, n_powers**r))

        def row(number: int) -> ir.Value:
            return kept.load(builder.add(base, ir.Constant(base.type, number)))

        found = derivatives_of(builder, row, place, n_powers, 1)
        return found[(0,) * r], [found[tuple(int(k == other) for other in range(r))] for k in range(r)]

    def typed(kept, entry, place):
        return types.Tuple((vector, types.UniTuple(vector, len(place))))(kept, types.intp, place)

    evaluate.__doc__ = about
    return built(typed)(evaluate)


# Polynomials at a place, a tuple of r vectors, from kept coefficients: n_powers^r rows of each entry, with the powers
# of the last coordinate running fastest.
N_POWERS, N_POWERS_OF_RIGID = 4, 8
polynomial = _polynomial(N_POWERS, "Return value and derivatives of a polynomial, cubic in each coordinate.")
rigid_polynomial = _polynomial(N_POWERS_OF_RIGID, "Return value and derivatives of a polynomial of degree 7.")
