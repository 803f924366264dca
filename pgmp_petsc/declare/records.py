"""Records: dataclasses whose fields say how they lie in a file.

    @dataclass(frozen=True)
    class Band(Record):
        time: np.ndarray = array("time", unit="s", about="instants")
        mean: np.ndarray = array("time", unit="{unit}", about="mean of output '{name}' at each instant", gaps=True)
        probabilities: np.ndarray = attribute("quantiles@probabilities", "probability")

A field has sizes by name, a unit and a meaning. From them follow writing, reading with checks, datasets of xarray
(`api.result`) and docs/files.md. Equal names are equal sizes: within a record, and within the records that it holds for
the sizes that it has itself. A name that ends in ``?`` has no axis where its size is 1; ``...`` is any shape.

The type of a field says what it holds: an array, a number, a text, texts (``tuple[str, ...]``), a record, rows that a
file has as columns (``tuple[Row, ...]``), and by name (``dict[str, ...]``) any of these. A `Result` is a record with a
file of its own.

Places are paths within the group of the record, the field's name if not given; ``path@key`` is an attribute. Places,
units and meanings may have ``{name}``, the key of a mapping, ``{outer}``, that of the mapping around it, ``{unit}``,
the unit of the name in the nearest field `units`, ``{own.field}``, a field of the record, and what the field's `words`
return; ``{...!p}`` is a share in per cent. ``{key}`` in a place is where the key of a mapping goes, else it comes last.
"""

from __future__ import annotations

import json
import os
import string
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache
from types import MappingProxyType, NoneType, UnionType
from typing import Any, ClassVar, NamedTuple, Self, Union, get_args, get_origin, get_type_hints

import h5py
import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.units import inverse
from pgmp_petsc.declare.values import Lazy, check_known, check_shape, converted, group_at, n_dimensions, units_in
from pgmp_petsc.files.hdf5 import TEXT, RunRecord, open_file, put, shapes_of, take, take_each, write_file

NEEDED = object()  # what an absent field is without which a file is damaged
JSON = (json.dumps, json.loads)  # code of attributes that are no number, text or texts
FLAGS = (lambda flags: flags, lambda numbers: numbers.astype(bool))  # code of truth values, which files have as numbers
NO_FILE = ""  # place of what is in datasets of xarray alone
INSTANT = "{instant}"  # of a dataset that is one of those along the time


@dataclass(frozen=True)
class Entry:
    """How a field lies in a file; see `array`."""

    sizes: tuple[str | int, ...] = ()
    unit: str = "1"
    about: str = ""
    at: str | None = None
    also: tuple[str, ...] = ()
    gaps: bool | Callable[[str], bool] = False
    absent: Any = NEEDED
    when: Callable[[Any], bool] | None = None
    code: tuple[Callable[[Any], Any], Callable[[Any], Any]] | None = None
    stored: Any = None
    allowed: tuple[str, ...] = ()
    part: int | str | None = None
    padded: int | None = None
    each: str | None = None
    columns: str | None = None
    ordered: bool = False
    colons: bool = False
    lazy: bool = False
    names: Callable[[h5py.Group, dict[str, Any]], Iterable[str]] | None = None
    keys: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    words: Callable[[Any, str, Context], dict[str, Any]] | None = None
    label: str | None = None
    is_axis: bool = False
    of: Callable[[Any, Context], Any] | None = None
    found: Callable[[h5py.Group, dict[str, Any]], Any] | None = None


def array(*sizes: str | int, default: Any = MISSING, **how: Any) -> Any:
    """Declare a field of a record.

    Parameters
    ----------
    sizes
        Names of the sizes, or numbers.
    default
        Of the constructor; what an absent one is, if not given.
    how
        ``unit``, ``about``, ``at``: see the module. ``also``: further places of an attribute. ``gaps``: whether numbers
        may be missing (NaN), which may depend on the name. ``absent``: what a file without it means, which is damaged
        if not given; it may depend on what was read before. ``when``: of which records it is written. ``code``: how a
        value is encoded and decoded.
        ``stored``: type of the numbers in the file. ``allowed``: its values. ``part``: it is this column of the array
        at its place, or this entry of the JSON objects there. ``padded``: number of columns in the file, filled with
        zeros. ``each``: a dataset for each entry along the first axis, and the word for such an entry. ``columns``: the
        field with name and unit of each column. ``label``: its name in datasets of xarray; ``is_axis``: it is a
        coordinate there. ``found``: how it is read where it is not written.

        By name: ``ordered``: a file keeps the order, and has the group also where it is empty. ``colons``: names may
        have slashes, which are colons in the file. ``lazy``: arrays are read when they are asked for. ``names``: which
        are read, given the group and what was read before. ``keys``: which there may be, and further words of texts for
        each. ``words``: further words, given the record, the name and the context.
    """
    if default is MISSING and how.get("absent", NEEDED) is not NEEDED:
        default = how["absent"]
    if isinstance(default, (dict, np.ndarray)):
        return field(default_factory=default.copy, metadata={"entry": Entry(sizes, **how)})
    return field(default=default, metadata={"entry": Entry(sizes, **how)})


def attribute(at: str, *sizes: str, **how: Any) -> Any:
    """Declare an attribute at ``path@key``, as `array`."""
    return array(*sizes, at=at, **how)


def derived(kind: Any, of: Callable[[Any, Context], Any], at: str, *sizes: str | int, **how: Any) -> Any:
    """Declare what follows from a record, given it and the context, and is written with it; of a type, as `array`."""
    return Entry(sizes, of=of, at=at, **how), kind


def run_record() -> Any:
    """Declare where a result comes from."""
    return array(found=lambda group, _: RunRecord.read(group))


def units_of(*groups: str, default: Any = MISSING) -> Any:
    """Declare the units of all in some groups, by name."""
    return array(found=lambda group, _: units_in(group, *groups), default=default)


def columns_of(place: str, size: str) -> Any:
    """Declare name and unit of each column of an array that has ``columns``."""

    def found(group: h5py.Group, _: dict[str, Any]) -> dict[str, str]:
        about = group[place].attrs
        return dict(zip(json.loads(about["names"]), str(about["unit"]).split(", ")))

    return array(size, found=found, default={"theta": "rad"})


class Context(NamedTuple):
    """Objects that texts refer to: a record, or None when it is read, words, and the record around it."""

    own: Any
    words: dict[str, Any]
    outer: Context | None = None

    def of_key(self, entry: Entry, key: str) -> Context:
        """Return the context of an entry of a mapping."""
        words = {**self.words, "name": key, "outer": self.words.get("name", "")}
        around: Context | None = self
        while around is not None and not hasattr(around.own, "units"):
            around = around.outer
        if around is not None:
            unit = around.own.units.get(key, "1")
            words |= {"unit": unit, "per_unit": inverse(unit)}
        words |= entry.keys.get(key, {})
        if entry.words is not None:
            words |= entry.words(self.own, key, self)
        return self._replace(words=words)

    def unit(self, template: str) -> str:
        """Return a unit of a declaration, which is one of SI, as that of the result's scene."""
        unit, around = self.text(template), self
        while around is not None and not hasattr(around.own, "record"):
            around = around.outer
        return unit if around is None or around.own.internal else around.own.record.system.unit(unit)

    def text(self, template: str) -> str:
        return _FORMAT.vformat(template, (), {**self.words, "own": self.own}) if "{" in template else template


class _Format(string.Formatter):
    """Texts with ``!p``."""

    def convert_field(self, value: Any, conversion: str | None) -> Any:
        return f"{100 * value:g} %" if conversion == "p" else super().convert_field(value, conversion)


_FORMAT = _Format()


class Holding(NamedTuple):
    """A field, and what its type says: how deep it is by name, whether it is rows, and of which type its values are
    (a record, float, int, bool, str, ndarray, and tuple for texts)."""

    name: str
    entry: Entry
    depth: int
    is_rows: bool
    value: Any

    @property
    def place(self) -> str:
        """Where it lies, within the group of the record."""
        return self.name if self.entry.at is None else self.entry.at

    @property
    def is_record(self) -> bool:
        return isinstance(self.value, type) and issubclass(self.value, Record)

    @property
    def is_attribute(self) -> bool:
        return "@" in self.place

    def place_of(self, place: str, key: str) -> str:
        """Return the place of an entry of a mapping that lies at a place."""
        key = key.replace("/", ":") if self.entry.colons else key
        if "{key}" in place:
            return place.replace("{key}", key, 1)
        is_apart = not (self.is_record and any("{name}" in one.place for one in written(self.value)))
        return joined(place, key) if is_apart else place


def _holding(name: str, entry: Entry, hint: Any) -> Holding:
    if get_origin(hint) in (Union, UnionType):
        hint = next(kind for kind in get_args(hint) if kind is not NoneType)
    depth, is_rows = 0, False
    while get_origin(hint) in (dict, Mapping) and entry.code is None and entry.found is None:
        hint, depth = get_args(hint)[1], depth + 1
    if get_origin(hint) is tuple:
        first = get_args(hint)[0]
        is_rows = isinstance(first, type) and issubclass(first, Record)
        hint = first if is_rows else tuple
    return Holding(name, entry, depth, is_rows, hint)


@cache
def declared(kind: type[Record]) -> tuple[Holding, ...]:
    """Return the fields that a kind of record declares."""
    hints = get_type_hints(kind)
    found = [(item.name, item.metadata["entry"]) for item in fields(kind) if "entry" in item.metadata]
    return tuple(_holding(name, entry, hints[name]) for name, entry in found)


@cache
def written(kind: type[Record]) -> tuple[Holding, ...]:
    """Return what is written of a kind of record: its fields and what is derived of them."""
    own = [one for one in declared(kind) if one.entry.found is None]
    return (*own, *(_holding(entry.at, entry, hint) for entry, hint in kind.FURTHER))


class Record:
    """Data that can be written into a group of a file, and read again; its sizes are checked when it is made."""

    FURTHER: ClassVar[tuple[Any, ...]] = ()  # what is `derived`
    STORED: ClassVar[type[Record] | None] = None  # the kind of record that files have in its place

    def __post_init__(self) -> None:
        check_sizes(self)

    def put(self, group: h5py.Group) -> None:
        """Write it into a group, one array after the other: those of a mapping may be read from a file for that."""
        attributes = []  # of arrays that have to be there
        for leaf in leaves(self):
            if leaf.value is GROUP:
                if leaf.place not in group:
                    group.create_group(leaf.place, track_order=True)
            elif leaf.one.is_rows:
                _put_rows(group, leaf)
            elif leaf.one.is_attribute:
                attributes.append(leaf)
            elif leaf.one.place != NO_FILE or leaf.one.depth:
                _put_arrays(group, leaf)
        for leaf in attributes:
            _put_attribute(group, leaf)

    @classmethod
    def take(
        cls, group: h5py.Group, words: Mapping[str, Any] | None = None, most: Mapping[str, int] = MappingProxyType({})
    ) -> Self:
        """Read what `put` wrote, of arrays whose first size is named in `most` so many entries at most. Raises
        `ValueError` or `LookupError` or `TypeError` if it does not fit together; see
        :func:`~pgmp_petsc.files.hdf5.shapes_of`."""
        taken: dict[str, Any] = {}
        for one in declared(cls):
            taken[one.name] = _Reader(cls, group, taken, most).take(one, dict(words or {}), one.place, one.depth)
        try:
            return cls(**taken)
        except ValueError as error:
            if group.name == "/":
                raise
            raise ValueError(f"'{group.name}': {error}") from error

    @classmethod
    def found_in(cls, group: h5py.Group) -> Self | None:
        """Read what `put` wrote; None where there is nothing."""
        return cls.take(group) if cls.is_in(group) else None

    def stored(self) -> Record:
        """Return what a file has in its place."""
        return self

    def converted(self, convert: Callable[[Any, str], Any], outer: Context | None = None) -> Self:
        """Return it in other units; `convert` takes an array or number and its unit, and of a text the text's."""
        context = Context(self, {} if outer is None else outer.words, outer)
        known = ((one, getattr(self, one.name)) for one in declared(type(self)))
        found = {one.name: converted(one, value, context, convert, one.depth) for one, value in known}
        return replace(self, **found | self.converted_by_itself(convert))

    def converted_by_itself(self, convert: Callable[[Any, str], Any]) -> dict[str, Any]:
        """Return what `converted` does not know of, by the names of the fields that are not declared for it."""
        return {}

    def each(self, size: str, of: Callable[..., np.ndarray], *others: Self) -> dict[str, Any]:
        """Return by field what `of` makes of every array that has a size, of this one and of those of other records;
        of records that it holds it makes records."""
        found = {}
        for one in declared(type(self)):
            parts = [getattr(record, one.name) for record in (self, *others)]
            if isinstance(parts[0], Record):
                own = parts[0].each(size, of, *parts[1:])
                found |= {one.name: replace(parts[0], **own)} if own else {}
            elif size in one.entry.sizes and parts[0] is not None:
                found[one.name] = of(*parts)
        return found

    @classmethod
    def is_in(cls, group: h5py.Group) -> bool:
        """Return whether a group has one: the first name of its first place is there."""
        return declared(cls.STORED or cls)[0].place.split("@")[0].split("/")[0] in group


class Result(Record):
    """A record with a file of its own, of a kind of `files.claims.KINDS`, and a field `record`.

    Results of runs are in the units of the scene once they leave the program (`in_own_units`), and in SI units where it
    takes them in again (`in_si_units`). Models, and what is kept on the way, are in SI units.
    """

    kind: ClassVar[str]
    internal: ClassVar[bool] = False  # whether it stays in SI units

    def in_own_units(self) -> Self:
        """Return what was computed in the units of its scene."""
        return self._in_units(self.record.system.converting)

    def in_si_units(self) -> Self:
        """Return what is in the units of its scene as it was computed; names of units stay."""
        size_of = self.record.system.size_of
        return self._in_units(lambda value, unit: unit if value is None else value * size_of(unit))

    def _in_units(self, convert: Callable[[Any, str], Any]) -> Self:
        return self if self.record.system.is_si or self.internal else self.converted(convert)

    def write(self, path: str | os.PathLike[str], *parts: Callable[[h5py.File], None]) -> None:
        """Write the file, to which `parts` add; by one process only. Raises as
        :func:`~pgmp_petsc.files.hdf5.write_file`."""
        in_si = {"computed_in": "SI"} if self.internal and not self.record.system.is_si else {}
        with write_file(path, self.kind, in_si) as file:
            self.record.write(file)
            self.put(file)
            for part in parts:
                part(file)

    @classmethod
    def take(cls, group: h5py.Group, *how: Any) -> Self:
        """Read what `put` wrote; raises `InputError` of what an earlier version computed in other units than SI."""
        found = super().take(group, *how)
        if cls.internal and not found.record.system.is_si and "computed_in" not in group.attrs:
            words = f"an earlier version computed it in {found.record.system}; make it anew from its scene"
            raise InputError(f"'{group.file.filename}': {words}")
        return found

    @classmethod
    def read(cls, path: str | os.PathLike[str], **most: int) -> Self:
        """Read a file, so many entries at most along a size (``frame=0``: no frames); raises `InputError` where it is
        not a whole one."""
        with cls.opened(path, **most) as found:
            return found

    @classmethod
    @contextmanager
    def opened(cls, path: str | os.PathLike[str], **most: int) -> Iterator[Self]:
        """Read a file, within the block also what is read when it is asked for. Raises as `read`."""
        with open_file(path, cls.kind) as file:
            with shapes_of(file):
                found = cls.take(file, {}, most)
            yield found


class Leaf(NamedTuple):
    """A value of a record, its place within the group of the record, its declaration and context."""

    place: str
    one: Holding
    value: Any
    context: Context


GROUP = object()  # in place of the value: a group that keeps its order


def leaves(record: Record, outer: Context | None = None, base: str = "") -> Iterator[Leaf]:
    """Yield all arrays, attributes and rows of a record and of those within it, in the order of the fields."""
    record = record.stored()
    context = Context(record, {} if outer is None else outer.words, outer)
    values = [(one, _value(one, context)) for one in written(type(record))]
    values = [(one, value) for one, value in values if value is not NEEDED]
    for one, _ in values:
        if one.entry.ordered and one.depth < 2 and one.place:
            yield Leaf(joined(base, one.place.removesuffix("/{name}")), one, GROUP, context)
    for one, value in values:
        for place in (one.place, *one.entry.also):
            yield from _leaves(one, value, context, joined(base, place), one.depth)


def _leaves(one: Holding, value: Any, context: Context, place: str, depth: int) -> Iterator[Leaf]:
    if depth:
        if one.entry.ordered and depth < one.depth:
            yield Leaf(place, one, GROUP, context)
        for key, own in value.items():
            yield from _leaves(one, own, context.of_key(one.entry, key), one.place_of(place, key), depth - 1)
    elif one.is_record and not one.is_rows:
        if one.depth == 0 and one.entry.words is not None:
            context = context._replace(words={**context.words, **one.entry.words(context.own, "", context)})
        yield from leaves(value, context, place)
    else:
        yield Leaf(context.text(place), one, value, context)


def _value(one: Holding, context: Context) -> Any:
    """Return what is to be written of a field, `NEEDED` where nothing is."""
    entry, record = one.entry, context.own
    if entry.when is not None and not entry.when(record):
        return NEEDED
    value = getattr(record, one.name) if entry.of is None else entry.of(record, context)
    return NEEDED if value is None and entry.absent is None else value


def joined(base: str, place: str) -> str:
    """Return a place within a group; of an attribute of the group it begins with @."""
    return f"{base}/{place}" if base and place and not place.startswith("@") else f"{base}{place}"


def number_name(number: int) -> str:
    """Return the name of a dataset of those for each entry along an axis: ``00012``."""
    return f"{number:05d}"


def _put_arrays(group: h5py.Group, leaf: Leaf) -> None:
    """Write an array, or a dataset for each entry along its first axis."""
    context, entry = leaf.context, leaf.one.entry
    columns = None if entry.columns is None else getattr(context.own, entry.columns)
    unit = context.unit(entry.unit) if columns is None else ", ".join(columns.values())
    names = {} if columns is None else {"names": json.dumps(list(columns))}
    if entry.each is None:
        put(group, leaf.place, _kept(entry, encoded(entry, leaf.value)), unit, context.text(entry.about), names)
    elif len(leaf.value):
        parent = group.require_group(leaf.place)
        # what is alike of all is said once
        about = context._replace(words=context.words | {"instant": INSTANT}).text(entry.about)
        for number, own in enumerate(leaf.value):
            said = about.replace(INSTANT, f"{context.own.time[number]:g}") if INSTANT in about else about
            like = number_name(number - 1) if number and said == about else ""
            put(parent, number_name(number), _kept(entry, encoded(entry, own)), unit, said, names, like)


def _kept(entry: Entry, value: Any) -> Any:
    """Return an encoded array as the file has it."""
    if isinstance(value, tuple) or getattr(value, "dtype", None) == object:
        value = np.array(list(value), dtype=TEXT)
    elif entry.padded is not None:
        missing = np.zeros((*value.shape[:-1], entry.padded - value.shape[-1]), value.dtype)
        value = np.concatenate([value, missing], axis=-1)
    return value if entry.stored is None else np.asarray(value).astype(entry.stored)


def _put_attribute(group: h5py.Group, leaf: Leaf) -> None:
    path, _, key = leaf.place.partition("@")
    target, entry = group[path] if path else group, leaf.one.entry
    value = encoded(entry, leaf.value)
    if isinstance(value, tuple):
        target.attrs.create(key, list(value), dtype=h5py.string_dtype())
    else:
        target.attrs[key] = h5py.Empty("f8") if value is None else value


def _put_rows(group: h5py.Group, leaf: Leaf) -> None:
    rows, sizes = leaf.value, check_sizes(leaf.context.own)
    for place, holdings in _columns(leaf.one.value).items():
        entry = holdings[0].entry
        values = [[encoded(one.entry, getattr(row, one.name)) for row in rows] for one in holdings]
        path, _, key = joined(leaf.place, place).partition("@")
        if key:
            (group[path] if path else group).attrs[key] = json.dumps(values[0])
            continue
        if isinstance(entry.part, str):
            names = [one.entry.part for one in holdings]
            data: Any = tuple(json.dumps(dict(zip(names, texts))) for texts in zip(*values))
        elif entry.part is not None:
            data = np.array(values, dtype=float).T.reshape(len(rows), len(holdings))
        else:
            data = np.array(values[0]).reshape(len(rows), *(sizes.get(size, size) for size in entry.sizes))
        put(group, path, _kept(entry, data), leaf.context.unit(entry.unit), leaf.context.text(entry.about))


def encoded(entry: Entry, value: Any) -> Any:
    """Return a value as the file has it."""
    return value if entry.code is None else entry.code[0](value)


def _columns(kind: type[Record]) -> dict[str, list[Holding]]:
    """Return the fields of rows by their places, arrays before attributes of them."""
    found: dict[str, list[Holding]] = {}
    for one in sorted(declared(kind), key=lambda one: one.is_attribute):
        found.setdefault(one.place, []).append(one)
    return found


class _Reader(NamedTuple):
    """A record that is being read: its kind, its group, its fields so far, and how many entries of which sizes."""

    kind: type[Record]
    group: h5py.Group
    taken: dict[str, Any]
    most: Mapping[str, int]

    def take(self, one: Holding, words: dict[str, Any], place: str, depth: int) -> Any:
        """Read a field, or what is at a place of it."""
        entry = one.entry
        if entry.found is not None:
            return entry.found(self.group, self.taken)
        if depth:
            if entry.lazy:
                return Stored(self, one, group_at(self.group, place))
            pairs = ((key, self._of_key(one, words, place, depth, key)) for key in self._keys(one, place, depth))
            return {key: value for key, value in pairs if value is not NEEDED}
        if one.is_rows:
            return self._rows(one, place)
        if one.is_record:
            is_there = place in self.group if place else one.value.is_in(self.group)
            if entry.absent is not NEEDED and not is_there:
                return entry.absent
            return one.value.take(group_at(self.group, place), words, self.most)
        place = Context(None, words).text(place)
        path, _, key = place.partition("@")
        absent = entry.absent(self.taken) if callable(entry.absent) else entry.absent
        is_there = not path or path in self.group
        if absent is not NEEDED and not (is_there and (not key or key in self._attributes(path))):
            return absent
        if one.is_attribute:
            return _decoded(one, self._attributes(path)[key])
        return self.array(one, self.group, place, words.get("name", ""))

    def _attributes(self, path: str) -> Mapping[str, Any]:
        if path and path not in self.group:
            raise KeyError(f"'/{path}' is missing")
        return (self.group[path] if path else self.group).attrs

    def _of_key(self, one: Holding, words: dict[str, Any], place: str, depth: int, key: str) -> Any:
        inner = {**words, "name": key, "outer": words.get("name", "")}
        if one.is_attribute and one.entry.absent is not NEEDED:  # those are absent that have none
            path, _, attribute_key = one.place_of(place, key).partition("@")
            if attribute_key not in self._attributes(path):
                return NEEDED
        return self.take(one, inner, one.place_of(place, key), depth - 1)

    def _keys(self, one: Holding, place: str, depth: int) -> Iterable[str]:
        """Return the names of a mapping."""
        entry = one.entry
        if entry.names is not None and depth == one.depth:
            return entry.names(self.group, self.taken)
        if place and place not in self.group and (entry.absent is not NEEDED or not entry.ordered):
            return []
        beside = {other.place for other in declared(self.kind) if other is not one}
        names = [name for name in group_at(self.group, place) if joined(place, name) not in beside]
        return [name.replace(":", "/") for name in names] if entry.colons else names

    def array(self, one: Holding, group: h5py.Group, place: str, name: str) -> Any:
        entry = one.entry
        data = self._numbers(one, group, place, name)
        if one.value in (float, int, bool) and data.ndim == 0:
            return one.value(data)
        if one.value is tuple:
            return tuple(text.decode() for text in data)
        return data if entry.code is None else entry.code[1](data)

    def _numbers(self, one: Holding, group: h5py.Group, place: str, name: str) -> np.ndarray:
        entry, texts = one.entry, one.value is tuple
        most = self.most.get(entry.sizes[0]) if entry.sizes else None
        if one.value is Any and place in group:  # numbers or texts
            texts = h5py.check_string_dtype(group[place].dtype) is not None
        if entry.each is None:
            data = take(group, place, n_dimensions(entry.sizes, group, place), texts)
            data = data if most is None else data[:most]
        else:
            numbered = group_at(group, place)
            data = take_each(numbered, n_dimensions(entry.sizes[1:], numbered, next(iter(numbered), "")), most)
        if not (entry.gaps(name) if callable(entry.gaps) else entry.gaps):
            check_known(group, place, data)
        if one.value is Any and texts:
            data = np.array([text.decode() for text in data], dtype=object)
        if entry.padded is not None:
            data = data[..., : self._size(entry.sizes[-1])]
        return data

    def _size(self, size: str | int) -> int | None:
        """Return a size that was read before; None where none was."""
        for one in declared(self.kind):
            if one.name in self.taken and size in one.entry.sizes and isinstance(self.taken[one.name], np.ndarray):
                return self.taken[one.name].shape[one.entry.sizes.index(size)]
        return None

    def _rows(self, one: Holding, place: str) -> tuple[Record, ...]:
        columns: dict[str, Iterable[Any]] = {}
        for where, holdings in _columns(one.value).items():
            first, (path, _, key) = holdings[0], joined(place, where).partition("@")
            if key:
                if first.entry.absent is NEEDED or key in self._attributes(path):
                    columns[first.name] = json.loads(self._attributes(path)[key])
                continue
            n_dimensions = 2 if isinstance(first.entry.part, int) else 1 + len(first.entry.sizes)
            whole = replace(first.entry, sizes=("row",) * n_dimensions, code=None)
            is_text = isinstance(first.entry.part, str)
            data = self.array(first._replace(entry=whole, value=tuple if is_text else np.ndarray), self.group, path, "")
            if is_text:
                texts = [json.loads(text) for text in data]
                columns |= {own.name: [text[own.entry.part] for text in texts] for own in holdings}
            elif first.entry.part is None:
                columns[first.name] = [_decoded(first, value) for value in data]
            else:
                columns |= {own.name: [own.value(value) for value in data[:, own.entry.part]] for own in holdings}
        return tuple(one.value(**dict(zip(columns, row))) for row in zip(*columns.values(), strict=True))


def _decoded(one: Holding, value: Any) -> Any:
    if one.entry.code is not None:
        return one.entry.code[1](value)
    if isinstance(value, h5py.Empty):
        return None
    if one.value is tuple:
        return tuple(str(text) for text in value)
    return one.value(value) if one.value in (float, int, bool, str) else np.array(value)


def check_finite(record: Record) -> None:
    """Raise `ValueError` where a number of a record is missing or not finite that may not be."""
    for leaf in leaves(record):
        is_array = isinstance(leaf.value, np.ndarray) and leaf.value.dtype.kind == "f"
        if is_array and not leaf.one.entry.gaps and not np.isfinite(leaf.value).all():
            raise ValueError(f"{leaf.place} holds numbers that are not finite")


class Stored(Lazy):
    """Arrays of a group, read when they are asked for."""

    def __init__(self, reader: _Reader, one: Holding, group: h5py.Group) -> None:
        def read(name: str) -> np.ndarray:
            with shapes_of(group.file):
                return reader.array(one, group, name.replace("/", ":"), name)

        super().__init__([name.replace(":", "/") for name in group], read)
        self._group = group

    def dataset(self, name: str) -> h5py.Dataset:
        """Return an array without reading it."""
        return self._group[name.replace("/", ":")]


def check_sizes(record: Record, known: Mapping[str, int] | None = None, within: str = "") -> dict[str, int]:
    """Return the sizes of a record by name; raise `ValueError` unless its arrays, and those of the records that it
    holds, agree about them and about those that are `known`, and texts are allowed ones."""
    sizes, inner = dict(known or {}), {}
    for one in declared(type(record)):
        value = getattr(record, one.name)
        if value is None:
            continue
        for text in value if isinstance(value, tuple) else (value,):
            if one.entry.allowed and text not in one.entry.allowed:
                raise ValueError(f"{one.name} is '{text}'; allowed: {', '.join(one.entry.allowed)}")
        if one.is_record:
            inner |= {f"{within}{label}: ": own for label, own in _labelled(one.name, value, one.depth, one.is_rows)}
        if one.entry.sizes:
            for label, own in _labelled(one.name, value, one.depth):
                shape = own.shape if hasattr(own, "shape") else (len(own),)
                check_shape(f"{within}{label}", shape, one.entry.sizes, sizes)
    for label, own in inner.items():
        check_sizes(own, sizes, label)
    return sizes


def _labelled(label: str, value: Any, depth: int, is_rows: bool = False) -> Iterator[tuple[str, Any]]:
    """Yield all values of a field, or its rows, with what a message calls them."""
    if isinstance(value, Stored):
        yield from ((f"{label} '{name}'", value.dataset(name)) for name in value)
    elif depth or is_rows:
        for name, own in value.items() if depth else enumerate(value):
            yield from _labelled(f"{label} {name!r}", own, depth - bool(depth))
    else:
        yield label, value
