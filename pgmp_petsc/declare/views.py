"""Records seen from outside: as variables of a dataset of xarray, and as rows of the tables of the documentation."""

from __future__ import annotations

import string
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from pgmp_petsc.declare.records import GROUP, Record, encoded, joined, leaves, written


class Variable(NamedTuple):
    """A variable of a dataset: its axes, values and attributes (units, long_name and those of the file), and whether it
    is a coordinate."""

    axes: tuple[str, ...]
    values: Any
    attributes: dict[str, Any]
    is_axis: bool


def variables(record: Record) -> Iterator[tuple[str, Variable]]:
    """Yield the variables of a record by their labels."""
    found = [leaf for leaf in leaves(record) if leaf.value is not GROUP and not leaf.one.is_rows]
    of_place: dict[str, dict[str, Any]] = {}
    for leaf in found:
        path, _, key = leaf.place.partition("@")
        if key:
            of_place.setdefault(path, {})[key] = encoded(leaf.one.entry, leaf.value)
    for leaf in found:
        entry, context = leaf.one.entry, leaf.context
        if entry.label is None:
            continue
        about = {"units": context.unit(entry.unit), "long_name": context.text(entry.about)}
        about |= of_place.get(leaf.place, {})
        if entry.columns is None:
            yield context.text(entry.label), Variable(entry.sizes, leaf.value, about, entry.is_axis)
            continue
        columns = getattr(record, entry.columns)
        axis = next(k for k, size in enumerate(entry.sizes) if str(size).rstrip("?") == "coordinate")
        axes, values = entry.sizes[:axis] + entry.sizes[axis + 1 :], leaf.value
        values = values if values.ndim == len(entry.sizes) else np.expand_dims(values, axis)
        for (column, unit), own in zip(columns.items(), np.moveaxis(values, axis, 0)):
            label = context._replace(words={**context.words, "column": column}).text(entry.label)
            yield label, Variable(axes, own, {**about, "units": unit}, entry.is_axis)


class _Placeholders(string.Formatter):
    """Texts with the names of what is filled in."""

    def get_field(self, field_name: str, args: Any, kwargs: Any) -> Any:
        """Return a word that is given, else the name of a field."""
        words = f"<{field_name.rpartition('.')[2]}>"
        return kwargs.get(field_name, words).replace("{name}", "<name>"), field_name

    def convert_field(self, value: Any, conversion: str | None) -> Any:
        """Leave the name."""
        return value


_PLACEHOLDERS = _Placeholders()


class Row(NamedTuple):
    """One place in files of a kind of record: sizes, unit and meaning of an array or attribute, whether
    numbers may be missing, and whether it follows from the others."""

    place: str
    sizes: tuple[str, ...]
    unit: str
    about: str
    gaps: bool
    is_derived: bool


def described(kind: type[Record], base: str = "") -> Iterator[Row]:
    """Yield a row for each array and attribute that files of a kind of record may have; ``<name>`` is in the place of
    names."""
    for one in written(kind.STORED or kind):
        entry, place, sizes = one.entry, one.place, tuple(str(size) for size in one.entry.sizes)
        for level in range(one.depth):
            place = one.place_of(place, "<outer>" if level < one.depth - 1 else "{name}")
        place = joined(base, place if entry.keys else _PLACEHOLDERS.format(place))
        if one.is_record and not entry.about:
            for row in described(one.value, place):
                yield row._replace(sizes=(*sizes, *row.sizes)) if one.is_rows else row
        elif entry.about and (place or one.depth):
            if entry.each is not None:
                place, sizes = f"{place}/<{entry.each}>", sizes[1:]
            if isinstance(entry.part, int):
                sizes = (*sizes, "2")
            if entry.padded is not None:
                sizes = (*sizes[:-1], str(entry.padded))
            unit = entry.unit if entry.columns is None else "of each column"
            for key, words in entry.keys.items() if entry.keys else [("{name}", {})]:
                texts = [_PLACEHOLDERS.format(text, name=key, **words) for text in (place, unit, entry.about)]
                texts[1] = "" if one.is_attribute and unit == "1" else texts[1]
                yield Row(texts[0], sizes, *texts[1:], bool(entry.gaps), entry.of is not None)
