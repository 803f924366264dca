"""Numbers that programs give for parameters: columns of samples, and points of a grid or table.

    {"k": [1.0, 2.0], "c": [0.1, 0.2, 0.3]}            a grid of 2 x 3 points with the dimensions k and c
    {"k": ("point", [1.0, 2.0]), "c": 0.1}             2 points along a dimension of the caller's own
    DataFrame, Dataset of xarray                       a point a row; the points of its dimensions

Arrays have dimensions as in xarray: a list of numbers, or an array without names of dimensions, has one of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc.base.errors import InputError, shortened

if TYPE_CHECKING:
    import xarray

ALLOWED = (
    "a number, a list of numbers (a dimension of its own), ('point', numbers) along a dimension that others share, or "
    "a DataArray"
)
#: Points, ResultOrDataset: for checkers of types, which cannot tell a mapping with arrays from one of numbers
Points = Any
ResultOrDataset = Any
OF_RESULTS = "parameter."  # of the parameters in datasets of results


def needs_xarray(what: str) -> Any:
    """Return the package xarray; raises `InputError` where it is not installed."""
    try:
        import xarray
    except ImportError as error:
        why = f"{what}: the package xarray is not installed (pip install 'xarray<2024.4' suits numpy before 2)"
        raise InputError(f"{why}; the arrays themselves are attributes of results ({error})") from error
    return xarray


@dataclass(frozen=True)
class PointSet:
    """Values of parameters at points: arrays of xarray by parameter, along any dimensions."""

    arrays: Mapping[str, xarray.DataArray]
    #: coordinates that say where points are, which may have the name of a parameter and are its values then
    places: Mapping[str, xarray.DataArray]
    fixed: Mapping[str, object]  # values of other parameters, the same at all points

    @property
    def dimensions(self) -> dict[str, int]:
        """Number of points along each dimension, in the order in which parameters name them."""
        return {str(name): size for one in self.arrays.values() for name, size in one.sizes.items()}

    def of(self, parameters: Iterable[str]) -> PointSet:
        """Return the points with those coordinates that are parameters; raises `InputError` if dimensions of the same
        name differ in length or labels, or there are no points."""
        taken = {name: one for name, one in self.places.items() if name in set(parameters) and one.ndim}
        found = replace(self, arrays={**self.arrays, **{k: v for k, v in taken.items() if k not in self.arrays}})
        shapes = ", ".join(f"{name} {dict(one.sizes)}" for name, one in found.arrays.items())
        try:
            needs_xarray("parameters").align(*found.arrays.values(), join="exact")
        except ValueError as error:
            raise InputError(f"parameters: dimensions differ in length or labels: {shapes}") from error
        if not found.arrays or 0 in found.dimensions.values():
            raise InputError(
                f"parameters: there are no points in {shapes or 'it'}; give each parameter a number at least"
            )
        return found

    def columns(self) -> dict[str, np.ndarray]:
        """Return the values of each parameter at all points, (n,); those along the last dimension are neighbours."""
        arrays = needs_xarray("parameters").broadcast(*self.arrays.values())
        flat = (np.array(one.transpose(*self.dimensions).values, dtype=float).reshape(-1) for one in arrays)
        return dict(zip(self.arrays, flat))


def points_of(value: object) -> object:
    """Return points, NotImplemented where every parameter has one value; raises `InputError` where numbers are none."""
    if _is_frame(value):
        xarray, index = needs_xarray("parameters"), value.index
        name = getattr(index, "name", None) or "point"
        given = {column: (name, numbers("parameters", column, value[column])) for column in _names(value.columns)}
        value = xarray.Dataset(given, {} if getattr(index, "nlevels", 1) > 1 else {name: np.asarray(index)})
    if hasattr(value, "data_vars"):
        data = _of_dataset(value, "parameters")
        return PointSet(dict(data.data_vars), dict(data.coords), {})
    if not isinstance(value, Mapping) or all(map(_is_one, value.values())):
        return NotImplemented
    xarray, fixed = needs_xarray("parameters"), {name: one for name, one in value.items() if _is_one(one)}
    arrays = {name: _array(xarray, name, value[name]) for name in _names(value) if name not in fixed}
    return PointSet(arrays, {key: one for array in arrays.values() for key, one in array.coords.items()}, fixed)


def columns_of(value: object) -> object:
    """Return a table as columns of numbers (n,): of a mapping, a DataFrame, a Dataset, or a structured array of numpy.

    NotImplemented where it is none of these; raises `InputError` where a column is not one of numbers.
    """
    if hasattr(value, "data_vars"):
        value = {str(name): one.values for name, one in _of_dataset(value, "samples").items()}
    names = getattr(getattr(value, "dtype", None), "names", None)
    if _is_frame(value) or isinstance(value, Mapping):
        names = list(value)
    if not names:
        return NotImplemented
    found = {}
    for name in names:
        values = numbers("samples", name, value[name])
        if values.ndim != 1:
            raise InputError(f"samples: column '{name}' has shape {values.shape}; numbers of shape (N,) are needed")
        found[str(name)] = values
    return found


def numbers(what: str, name: object, values: object) -> np.ndarray:
    """Return an array of floats; raises `InputError`, naming the first entry that is something else."""
    given = np.asarray(values)
    if given.dtype.kind in "iuf":
        return given.astype(float)
    entries = np.asarray(values, dtype=object)
    for place, one in enumerate(entries.reshape(-1)):
        if isinstance(one, (bool, np.bool_)) or not isinstance(one, (int, float, np.integer, np.floating)):
            what = f"{what}: {name}, entry {place}"
            raise InputError(f"{what}: {type(one).__name__} {shortened(repr(one))} received; a number is needed")
    return entries.astype(float)


def _is_frame(value: object) -> bool:
    """Return whether a value is a table of pandas, or of a package that has the same attributes."""
    return hasattr(value, "columns") and hasattr(value, "index") and hasattr(value, "iloc")


def _is_one(value: object) -> bool:
    if isinstance(value, (tuple, list)):
        return False
    return getattr(value, "ndim", 0) == 0 and not isinstance(value, (Sequence, Mapping)) or isinstance(value, str)


def _names(names: Any) -> list[str]:
    for name in names:
        if not isinstance(name, str):
            raise InputError(f"parameters: a column is called {name!r}; allowed are names of parameters")
    return list(names)


def _array(xarray: Any, name: str, value: Any) -> Any:
    if hasattr(value, "dims"):
        return value.copy(data=numbers("parameters", name, value.values))
    dims: tuple[Any, ...] = ()
    if isinstance(value, tuple) and len(value) == 2 and not isinstance(value[1], (int, float)):
        names, value = value
        dims = (names,) if isinstance(names, str) else tuple(names)
    values = numbers("parameters", name, value)
    if not dims and values.ndim == 1:
        return xarray.DataArray(values, {name: values}, (name,))
    if values.ndim != len(dims) or not all(isinstance(one, str) for one in dims):
        raise InputError(f"parameters: {name} has shape {values.shape}; allowed is {ALLOWED}")
    return xarray.DataArray(values, dims=dims)


def _of_dataset(data: Any, what: str) -> Any:
    """Return a dataset of parameters: of the variables that results call so where there are any, else of all."""
    own = [name for name in data.data_vars if str(name).startswith(OF_RESULTS)]
    if own:
        data = data[own].rename({name: name.removeprefix(OF_RESULTS) for name in own})
    names = _names(data.data_vars)
    return data.assign({name: data[name].copy(data=numbers(what, name, data[name].values)) for name in names})
