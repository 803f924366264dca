"""Values of records in other units, by the units that their fields declare."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

NAMES_OF_UNITS = ("unit", "units", "coordinate_units", "parameter_units")  # fields that have these
UNKNOWN_UNITS = ("SI", "as attribute units")  # of numbers that stay, or are converted by their record


def converted(one: Any, value: Any, context: Any, convert: Callable[[Any, str], Any], depth: int) -> Any:
    """Return a value of a record in other units: of a field `one` (`records.Holding`), in its `records.Context`."""
    entry = one.entry
    if value is None:
        return None
    if one.name in NAMES_OF_UNITS:
        if isinstance(value, str):
            return convert(None, value)
        if isinstance(value, tuple):
            return tuple(convert(None, unit) for unit in value)
        return {name: convert(None, unit) for name, unit in value.items()}
    if depth:

        def of(key: str) -> Any:
            return converted(one, value[key], context.of_key(entry, key), convert, depth - 1)

        return Converted(value, of) if type(value) is not dict else {key: of(key) for key in value}
    if one.is_rows:
        return tuple(row.converted(convert, context) for row in value)
    if one.is_record:
        if one.depth == 0 and entry.words is not None:
            context = context._replace(words={**context.words, **entry.words(context.own, "", context)})
        return value.converted(convert, context)
    is_number = isinstance(value, float) or getattr(value, "dtype", None) is not None and value.dtype.kind == "f"
    if not is_number or entry.unit in UNKNOWN_UNITS:
        return value
    units = context.text(entry.unit).split(", ")
    if entry.columns is not None:
        units = list(getattr(context.own, entry.columns).values())
    if len(units) == 1:
        return convert(value, units[0])
    axis = next(k for k, size in enumerate(entry.sizes) if str(size).rstrip("?") in ("coordinate", "parameter"))
    parts = [convert(part, unit) for part, unit in zip(np.moveaxis(value, axis, 0), units)]
    return np.moveaxis(np.array(parts).reshape(len(units), *np.delete(value.shape, axis)), 0, axis)


class Converted(Mapping[str, Any]):
    """Arrays by name that are converted when they are asked for."""

    def __init__(self, given: Mapping[str, Any], of: Callable[[str], Any]) -> None:
        self._given, self._of = given, of

    def __getitem__(self, name: str) -> Any:
        return self._of(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._given)

    def __len__(self) -> int:
        return len(self._given)
