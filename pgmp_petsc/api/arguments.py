"""Checks of the interface's arguments: in one place, by their annotations, before a function begins; and numbers that
programs give for parameters, columns of samples, and points of a grid or table.

    {"k": [1.0, 2.0], "c": [0.1, 0.2, 0.3]}            a grid of 2 x 3 points with the dimensions k and c
    {"k": ("point", [1.0, 2.0]), "c": 0.1}             2 points along a dimension of the caller's own
    DataFrame, Dataset of xarray                       a point a row; the points of its dimensions

Arrays have dimensions as in xarray: a list of numbers, or an array without names of dimensions, has one of its own.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import cache, wraps
from os import PathLike, fsencode, fspath
from time import monotonic
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pgmp_petsc.api.ranks import ranks_of
from pgmp_petsc.base.errors import InputError, PgmpError, shortened
from pgmp_petsc.ranks.agreement import agreed

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


Function = TypeVar("Function", bound=Callable[..., Any])

_PLAIN = ("int", "float", "bool")  # whose value says more than its type


# when the command line began that calls, in whose words messages of the program are; None where there is none
_command_began: ContextVar[float | None] = ContextVar("command_began", default=None)
# a command line that a message quotes, which stays as it is, or an option
_OPTION = re.compile(r"pgmp (?:[^;,.)]|\.(?=\w))*|(?<![\w-])(?:--[a-z][a-z-]+|-[a-z])(?![\w-])")


@dataclass(frozen=True)
class Range:
    """Numbers that an argument may be."""

    #: least, most: the ends, which belong to it; None where it has none above
    least: float
    most: float | None = None
    above: bool = False  # whether the lower end does not belong to it
    unit: str = ""  # of the ends, for messages

    def holds(self, value: float) -> bool:
        """Return whether a number is in it."""
        begins = value > self.least if self.above else value >= self.least
        return begins and (self.most is None or value <= self.most)

    def __str__(self) -> str:
        least, most = (x if isinstance(x, int) else None if x is None else f"{x:g}" for x in (self.least, self.most))
        join = "and at most" if self.above else "to"
        end = "" if most is None else f" {join} {most}"
        return f"{'above' if self.above else 'from'} {least}{end}{f' {self.unit}' if self.unit else ''}"


def checked(
    function: Function, declared: Mapping[str, Any] | None = None, names: Mapping[str, str] | None = None
) -> Function:
    """Let a function of the interface, or a method of a result, be called with arguments that its annotations allow.

    Numbers of numpy become Python's, None means no overrides. Arguments are declared (`api.declared.Argument`); `names`
    are a program's for options of the command line, which messages use: no caller reads words that are not its own.
    Raises `InputError`, from the function, on all ranks, if an argument is something else.
    """
    signature = inspect.signature(function)
    kinds = {name: kinds_of(str(entry.annotation)) for name, entry in signature.parameters.items()}
    said, own_names = declared or {}, names or {}

    @wraps(function)
    def call(*given: Any, **named: Any) -> Any:
        try:
            bound = signature.bind(*given, **named)
        except TypeError as error:  # which does not say of what
            raise TypeError(f"{function.__qualname__}(): {error}") from None
        bound.apply_defaults()
        own = bound.arguments.get("self")
        comm = ranks_of(bound.arguments.get("comm")) if own is None else own.comm
        with agreed(comm, "looking at the arguments"):
            for name, value in bound.arguments.items():
                bound.arguments[name] = taken(name, value, kinds[name], getattr(said.get(name), "allowed", None))
            for name, one in said.items():
                one.check(bound.arguments[name], bound.arguments)
        try:
            return function(*bound.args, **bound.kwargs)
        except PgmpError as error:
            if own_names and _command_began.get() is None:
                error.args = (_OPTION.sub(lambda found: own_names.get(found[0], found[0]), str(error)), *error.args[1:])
            raise

    return call


@contextmanager
def by_command_line(began: float) -> Iterator[None]:
    """Leave messages of calls within the block in the words of a command line, which began at a time (`monotonic`)."""
    token = _command_began.set(began)
    try:
        yield
    finally:
        _command_began.reset(token)


def began() -> float:
    """Return when (`monotonic`) the command line began that calls, or else now."""
    found = _command_began.get()
    return monotonic() if found is None else found


def wrong(what: str, received: object, allowed: str) -> InputError:
    """Return the error of an argument of another kind."""
    return InputError(f"{what}: {type(received).__name__} received; allowed is {allowed}")


def overrides_of(overrides: object) -> tuple[str, ...]:
    """Return overrides as a command takes them, none for None; raises `InputError` where they are something else."""
    if isinstance(overrides, Mapping):
        from pgmp_petsc.scene.messages import inline_toml  # with all that a scene may say, which results need not

        return tuple(f"{key}={inline_toml(toml_data(value))}" for key, value in overrides.items())
    return _texts(
        "overrides", overrides, "a mapping such as {'reduction.modes': 8}, or a list of texts such as "
        "['reduction.modes=8']",
    )  # fmt: skip


def settings_of(parameters: object) -> tuple[str, ...]:
    """Return values of parameters as a command takes them, to the last bit; raises `InputError`."""
    if isinstance(parameters, Mapping):
        numbers = (int, float, np.number)
        return tuple(f"{k}={float(v)!r}" if isinstance(v, numbers) else f"{k}={v!s}" for k, v in parameters.items())
    return _texts(
        "parameters", parameters, "a mapping of names to numbers, such as {'r1': 5e-3}, or a list of texts such as "
        "['r1=5e-3']",
    )  # fmt: skip


def _texts(name: str, given: object, allowed: str) -> tuple[str, ...]:
    if given is None:
        return ()
    if not isinstance(given, (list, tuple)) or not all(isinstance(text, str) for text in given):
        raise InputError(f"{name} = {given!r}: allowed are {allowed}")
    return tuple(given)


def toml_data(value: object) -> Any:
    """Return tables without numpy's types, tuples and paths, which TOML does not have."""
    if isinstance(value, Mapping):
        return {key: toml_data(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return toml_data(value.tolist())
    if isinstance(value, (list, tuple)):
        return [toml_data(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return fspath(value) if isinstance(value, PathLike) else value


@cache
def kinds_of(annotation: str) -> tuple[str, ...]:
    """Return the kinds that an annotation joins: of ``Sequence[str | int] | None`` the two."""
    kinds: list[str] = []
    for part in annotation.split(" | "):
        if kinds and kinds[-1].count("[") > kinds[-1].count("]"):
            kinds[-1] += f" | {part}"
        else:
            kinds.append(part)
    return tuple(kind for kind in kinds if kind != "str" or "PathLike[str]" not in kinds)


def taken(name: str, value: object, kinds: tuple[str, ...], limits: object) -> Any:
    """Return what a value becomes as one of some kinds, within limits; raises `InputError` where it is none."""
    for kind in kinds:
        if kind not in _KINDS:
            return value  # the function's own to look at
        found = _KINDS[kind][0](value)
        if found is not NotImplemented:
            _check(name, value, found, kind, limits)
            return found
    kind = next(kind for kind in kinds if kind != "None")
    text = limits if isinstance(limits, str) else _KINDS[kind][1]
    text += f" {limits}" if isinstance(limits, Range) else ""
    if kind in ("Scene", "Rom", "Result") and "PathLike[str]" in kinds:
        text += ", or its file"
    if kind in _PLAIN or isinstance(value, str) and kind.startswith(("PathLike", "Sequence")):
        verb = "are" if kind in _PLAIN else "is"
        raise InputError(f"{name} = {shortened(repr(value))}: allowed {verb} {text}")
    raise wrong(name, value, text)


def _check(name: str, given: object, value: Any, kind: str, limits: object) -> None:
    if isinstance(limits, Range) and kind in ("int", "float") and not limits.holds(value):
        what = "whole numbers" if kind == "int" else "numbers"
        raise InputError(f"{name} = {given!r}: allowed are {what} {limits}")
    if kind == "Mapping[str, float]":
        for key, one in value.items():
            if _finite(one) is NotImplemented or isinstance(limits, Range) and not limits.holds(one):
                what = f"numbers {limits}" if isinstance(limits, Range) else limits or "finite numbers"
                raise InputError(f"{name}[{key!r}] = {one!r}: allowed are {what}")
    if isinstance(limits, tuple) and kind == "str" and value not in limits:
        raise InputError(f"{name} = {shortened(repr(given))}: allowed are {', '.join(limits)}")


def _whole(value: object) -> object:
    is_whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return int(value) if is_whole else NotImplemented


def _finite(value: object) -> object:
    if not isinstance(value, (int, float, np.integer, np.floating)) or isinstance(value, bool):
        return NotImplemented
    try:
        number = float(value)
    except OverflowError:
        return NotImplemented
    return number if math.isfinite(number) else NotImplemented


def _path(value: object) -> object:
    if not isinstance(value, (str, PathLike)):
        return NotImplemented
    text = fspath(value)
    try:
        name = fsencode(text) if isinstance(text, str) else b""
    except UnicodeError:  # half of a character
        name = b""
    return value if name and b"\0" not in name else NotImplemented


def _list_of(kind: Callable[[object], object]) -> Callable[[object], object]:

    def taken(value: object) -> object:
        if isinstance(value, np.ndarray) and value.ndim == 1:
            value = value.tolist()
        if isinstance(value, (str, bytes, Mapping)) or not isinstance(value, Sequence):
            return NotImplemented
        found = [kind(item) for item in value]
        if any(item is NotImplemented for item in found):
            return NotImplemented
        return found if isinstance(value, list) else tuple(found)

    return taken


def _instance(name: str) -> Callable[[object], object]:
    """Return what takes objects of a class of the interface, whose module is imported when one is made."""

    def taken(value: object) -> object:
        own = (base for base in type(value).__mro__ if base.__module__.startswith("pgmp_petsc."))
        return value if any(base.__name__ == name for base in own) else NotImplemented

    return taken


def _text(value: object) -> object:
    try:
        return value.encode().decode() if isinstance(value, str) else NotImplemented
    except UnicodeError:
        return NotImplemented


def _mapping(value: object) -> object:
    return value if isinstance(value, Mapping) and all(isinstance(key, str) for key in value) else NotImplemented


def _either(*names: str) -> Callable[[object], object]:
    def taken(value: object) -> object:
        taken = (_KINDS[name][0](value) for name in names)
        return next((found for found in taken if found is not NotImplemented), NotImplemented)

    return taken


#: What an argument becomes, by the kinds of annotations, NotImplemented where it is none of the kind; what is allowed.
_KINDS: dict[str, tuple[Callable[[Any], Any], str]] = {
    "None": (lambda value: None if value is None else NotImplemented, ""),
    "str": (_text, "a text"),
    "PathLike[str]": (_path, "the name of a file"),
    "int": (_whole, "whole numbers"),
    "float": (_finite, "finite numbers"),
    "bool": (lambda value: bool(value) if isinstance(value, (bool, np.bool_)) else NotImplemented, "True and False"),
    "Scene": (_instance("Scene"), "a scene, as from pgmp.load or pgmp.compose"),
    "Rom": (_instance("Rom"), "a model that was built, as from pgmp.build or pgmp.read"),
    "Result": (_instance("Result"), "a result, as from pgmp.simulate or pgmp.read"),
    "Shard": (_instance("Shard"), "pgmp.Shard(number, count), such as pgmp.Shard(2, 8)"),
    "Stopping": (_instance("Stopping"), "pgmp.Stopping(until, budget)"),
    "Robust": (_instance("Robust"), "pgmp.Robust(deviations, n, seed)"),
    "AnySource": (
        _either("Rom", "Scene", "PathLike[str]"),
        "a built model (pgmp.build, pgmp.read), a scene (pgmp.load), or a file",
    ),
    "Overrides": (overrides_of, ""),
    "Parameters": (settings_of, ""),
    "Points": (points_of, ""),
    "Arrays": (columns_of, "a DataFrame, a Dataset, or a mapping of parameters' names to columns of numbers"),
    "Mapping[str, float]": (_mapping, "a mapping of names to numbers"),
    "Mapping[str, Any]": (_mapping, "a mapping of tables"),
    "Sequence[str]": (_list_of(_text), "a list of texts"),
    "Sequence[int]": (_list_of(_whole), "a list of whole numbers"),
    "Sequence[float]": (_list_of(_finite), "a list of finite numbers"),
    "Sequence[Correction]": (_list_of(_instance("Correction")), "a list of pgmp.Correction(model, n)"),
    "Sequence[str | PathLike[str]]": (_list_of(_path), "a list of names of files"),
    "Sequence[Result | str | PathLike[str]]": (
        _list_of(_either("Result", "PathLike[str]")),
        "a list of results, or of names of files",
    ),
}
