"""Values of records: their shapes, and in other units, by the sizes and units that their fields declare."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import h5py
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

        return Lazy(value, of) if type(value) is not dict else {key: of(key) for key in value}
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


class Lazy(Mapping[str, Any]):
    """Values by name that are made, by `of`, when they are asked for."""

    def __init__(self, names: Collection[str], of: Callable[[str], Any]) -> None:
        self._names, self._of = names, of

    def __getitem__(self, name: str) -> Any:
        return self._of(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def check_shape(label: str, shape: tuple[int, ...], sizes: tuple[str | int, ...], known: dict[str, int]) -> None:
    """Raise `ValueError` unless a shape is of these sizes; add those to the `known` ones that are new."""
    if sizes == ("...",):
        return
    own = [size for size in sizes if len(shape) >= len(sizes) or not str(size).endswith("?")]
    pairs = [*zip(own, shape), *((size, 1) for size in sizes if size not in own)]
    found = {size.rstrip("?"): n for size, n in pairs if isinstance(size, str)}
    wanted = [(size if isinstance(size, int) else {**found, **known}[size.rstrip("?")], n) for size, n in pairs]
    if len(own) != len(shape) or any(n != length for length, n in wanted):
        words = ", ".join(f"{size}: {known[size]}" if size in known else str(size) for size in sizes)
        raise ValueError(f"{label} has shape {shape}; needed: ({words})")
    known |= found


def n_dimensions(sizes: tuple[str | int, ...], group: h5py.Group, place: str) -> int:
    """Return how many dimensions a dataset is to have; as many as it has where any will do."""
    least = sum(not str(size).endswith("?") for size in sizes)
    if sizes != ("...",) and least == len(sizes):
        return least
    n_found = getattr(group.get(place), "ndim", 0)
    return n_found if sizes == ("...",) or least <= n_found <= len(sizes) else len(sizes)


def units_in(group: h5py.Group, *places: str) -> dict[str, str]:
    """Return the unit of all in some groups, by name; of an array with a dataset for each entry, that of the first."""
    found = {}
    for name, item in (pair for place in places if place in group for pair in group[place].items()):
        while not hasattr(item, "shape"):
            if not len(item):
                raise KeyError(f"'{item.name}' is empty")
            item = item[next(iter(item))]
        found[name] = str(item.attrs["unit"])
    return found


def check_known(group: h5py.Group, place: str, data: np.ndarray) -> np.ndarray:
    """Return numbers; raise `ValueError` where one is missing."""
    if data.dtype.kind == "f" and np.isnan(data).any():
        where = f"{group.name.rstrip('/')}/{place}"
        raise ValueError(f"dataset '{where}' holds NaN, which no number of it can be")
    return data


def group_at(group: h5py.Group, place: str) -> h5py.Group:
    """Return a group; raises `TypeError` where there is a dataset, which would be gone through number by number."""
    if place and place not in group:
        raise KeyError(f"'/{place}' is missing")
    found = group[place] if place else group
    if not isinstance(found, h5py.Group):
        raise TypeError(f"'/{place}' is no group")
    return found
