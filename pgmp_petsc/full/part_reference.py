"""Nested named tuples of arrays that compiled functions take by reference.

Handed over by value, each array of a tuple is seven arguments, in every call and for the compiler: the equations of a
full-order model, a hundred arrays, took most of the time that compiling took. Here all is a table of words, addresses
and shapes, which compiled code reads by the names of the tuples' fields::

    reference = Reference(problem)  # in Python
    reference.elements.length[e]    # in a compiled function

What is not there is None, for which compiled code is left out. What is nested is a reference in its turn; `loaded`
gives it by value. Arrays are contiguous, and are not counted as in use: the object in Python keeps them.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, intrinsic, lower_getattr_generic, models, register_model, typeof_impl, unbox
from numba.misc.special import typeof

_WORD = ir.IntType(64)
_TYPES: dict[Any, types.Type] = {}  # of arrays, which are asked for a hundred times for each model
# of all parts together, by what tells them: to put a type together takes a tenth of making a small model's equations
_REFERENCES: dict[Any, ReferenceType] = {}


class Reference:
    """Parts, nested named tuples of contiguous arrays, numbers and tuples of these, and the address of their words."""

    def __init__(self, parts: Any) -> None:
        self.parts = parts
        words: list[int] = []
        _append_words(parts, words)
        self._table = np.array([*words, 0], dtype=np.int64)
        self.address = self._table.ctypes.data
        kind = _kind_of(parts)
        if kind not in _REFERENCES:
            _REFERENCES[kind] = ReferenceType(_type_of(parts))
        self._numba_type_ = _REFERENCES[kind]


def _kind_of(part: Any) -> Any:
    """Return what parts of the same type have in common, and no others."""
    if isinstance(part, np.ndarray):
        return part.dtype, part.ndim, part.flags.num, part.flags.aligned
    if isinstance(part, tuple):
        return type(part), *map(_kind_of, part)
    return type(part) if part is None or isinstance(part, (bool, float)) else typeof(part)


def _type_of(part: Any) -> types.Type:
    """Return the type of a part, as `typeof` does; that of an array is looked up."""
    if isinstance(part, np.ndarray):
        key = _kind_of(part)
        if key not in _TYPES:
            if not part.flags.c_contiguous:
                raise ValueError(f"an array of shape {part.shape} is not contiguous: its strides are not in the table")
            _TYPES[key] = typeof(part)
        return _TYPES[key]
    if not isinstance(part, tuple):
        return typeof(part)
    inner = tuple(map(_type_of, part))
    return types.NamedTuple(inner, type(part)) if hasattr(part, "_fields") else types.BaseTuple.from_types(inner)


def _append_words(part: Any, words: list[int]) -> None:
    if isinstance(part, np.ndarray):
        # the address as `ctypes.data` has it, in a third of the time
        words += (part.__array_interface__["data"][0], *part.shape)
    elif isinstance(part, tuple):
        for one in part:
            _append_words(one, words)
    elif part is None:
        words.append(0)
    elif isinstance(part, float):
        words.append(int(np.float64(part).view(np.int64)))
    else:
        words.append(int(part))


def _n_words(of: types.Type) -> int:
    if isinstance(of, types.BaseTuple):
        return sum(map(_n_words, of))
    return 1 + of.ndim if isinstance(of, types.Array) else 1


class ReferenceType(types.Type):
    """Parts of a type."""

    def __init__(self, parts: types.NamedTuple) -> None:
        self.parts = parts
        # part of the name of every function that takes it, several times in the text that LLVM reads
        super().__init__(name=f"Reference({hashlib.sha256(str(parts).encode()).hexdigest()[:16]})")


@typeof_impl.register(Reference)
def _typeof(reference: Reference, context: Any) -> ReferenceType:
    return reference._numba_type_


@register_model(ReferenceType)
class _ReferenceModel(models.PrimitiveModel):
    def __init__(self, manager: Any, of: types.Type) -> None:
        super().__init__(manager, of, _WORD.as_pointer())


@unbox(ReferenceType)
def _unbox(of: types.Type, reference: Any, c: Any) -> NativeValue:
    number = c.pyapi.object_getattr_string(reference, "address")
    address = c.pyapi.long_as_voidptr(number)
    c.pyapi.decref(number)
    return NativeValue(
        c.builder.bitcast(address, _WORD.as_pointer()), is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred())
    )


@infer_getattr
class _ReferenceAttributes(AttributeTemplate):
    key = ReferenceType

    def generic_resolve(self, reference: ReferenceType, name: str) -> types.Type | None:
        if name not in reference.parts.fields:
            return None
        of = reference.parts[reference.parts.fields.index(name)]
        return ReferenceType(of) if isinstance(of, types.NamedTuple) else of


@lower_getattr_generic(ReferenceType)
def _attribute(context: Any, builder: ir.IRBuilder, reference: ReferenceType, address: ir.Value, name: str) -> ir.Value:
    number = reference.parts.fields.index(name)
    of, first = reference.parts[number], sum(_n_words(reference.parts[k]) for k in range(number))
    if isinstance(of, types.NamedTuple):
        return builder.gep(address, [_WORD(first)])
    return _value(context, builder, of, address, first)


def _value(context: Any, builder: ir.IRBuilder, of: types.Type, table: ir.Value, first: int) -> ir.Value:
    """Return the contents of a table from a word on."""
    if isinstance(of, types.BaseTuple):
        parts = []
        for part in of:
            parts.append(_value(context, builder, part, table, first))
            first += _n_words(part)
        return context.make_tuple(builder, of, parts)
    word = _word(builder, table, first)
    if isinstance(of, types.Array):
        from numba.np.arrayobj import populate_array  # a noticeable time, and what is compiled has no use for it

        shape = [_word(builder, table, first + 1 + axis) for axis in range(of.ndim)]
        size = context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(of.dtype)))
        strides = [size]
        for extent in shape[:0:-1]:
            strides.insert(0, builder.mul(strides[0], extent))
        array = context.make_array(of)(context, builder)
        data = builder.inttoptr(word, context.get_data_type(of.dtype).as_pointer())
        populate_array(array, data, shape, strides[-of.ndim :] if of.ndim else [], size, None, None)
        return array._getvalue()
    if isinstance(of, types.NoneType):
        return context.get_dummy_value()
    if isinstance(of, types.Boolean):
        return builder.icmp_signed("!=", word, _WORD(0))
    return builder.bitcast(word, ir.DoubleType()) if isinstance(of, types.Float) else word


def _word(builder: ir.IRBuilder, table: ir.Value, number: int) -> ir.Value:
    word = builder.load(builder.gep(table, [_WORD(number)]))
    word.set_metadata("invariant.load", builder.module.add_metadata([]))  # what is in the table stays
    return word


@intrinsic
def loaded(typing, part):
    """Return a part as the named tuple that it is."""
    if not isinstance(part, ReferenceType):
        return part(part), lambda context, builder, sig, args: impl_ret_borrowed(context, builder, part, args[0])
    return part.parts(part), lambda context, builder, sig, args: _value(context, builder, part.parts, args[0], 0)
