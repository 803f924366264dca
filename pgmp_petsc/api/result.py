"""Results of a program: the package's own data, with what needs the ranks that made it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import fields, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from pgmp_petsc.api.arguments import checked, needs_xarray
from pgmp_petsc.api.ranks import ranks_of
from pgmp_petsc.base import __version__
from pgmp_petsc.base.errors import InputError, Remark, RunError
from pgmp_petsc.base.notebooks import Grid, card
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.declare.records import GROUP, Record, encoded, leaves
from pgmp_petsc.files.claims import claimed, form_of, is_table, named
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.ranks.agreement import on_root
from pgmp_petsc.results.summary import json_data, origin_of, summary_of, units_of_parameters, write_result

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

    from pgmp_petsc.scene import Scene


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


class Result:
    """A result, the same on all ranks that made it, `comm`; attributes of its data are its own.

    The kind is one of `files.claims.KINDS`; the data, None on a rank that was not given it, are a dataclass of
    `pgmp_petsc.results`, `studies.building.Built`, or `models.component_file.ComponentsFile`: arrays of numpy in the
    scene's units. Paths of the scene are relative to `directory`; `path` is the file that it was read from or last
    written to.
    """

    def __init__(self, kind: str, data: Any, comm: Comm, directory: Path, path: Path | None = None) -> None:
        self.kind, self.data, self.comm, self.directory, self.path = kind, data, comm, directory, path

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: all but the ranks, which are of this process, with columns that are in a file."""
        return {**self.__dict__, "comm": None, "data": self._in_memory()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take what was pickled, on the ranks that calls here have by default."""
        self.__dict__.update(state)
        self.comm = ranks_of(None)

    def __copy__(self) -> Self:
        return type(self)(self.kind, self.data, self.comm, self.directory, self.path)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return type(self)(self.kind, deepcopy(self._in_memory(), memo), self.comm, self.directory, self.path)

    def _variables(self) -> list[tuple[str, Variable]]:
        return [*variables(self.data)] if isinstance(self.data, Record) else []

    def _in_memory(self) -> Any:
        return None if self.data is None else in_memory(self.data)

    def _own(self) -> Any:
        if self.data is None:
            raise AttributeError(f"this {self.kind} is on the first rank alone (on_all_ranks=False)")
        return self.data

    def __getattr__(self, name: str) -> Any:
        # copying and pickling ask for names before there is any data
        if name.startswith("_") or "data" not in self.__dict__:
            raise AttributeError(name)
        return getattr(self._own(), name)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *(name for name in dir(self._own()) if not name.startswith("_"))})

    def __repr__(self) -> str:
        if self.data is None:
            return f"<pgmp {self.kind} on the first rank alone>"
        said = "".join(f"\n  {remark}" for remark in self.remarks)
        return f"<pgmp {self.kind} of scene '{origin_of(self.record)['scene']}'>{said}"

    def _repr_html_(self) -> str:
        """Return what a notebook shows: figures, parameters, remarks and, folded, the dataset."""
        if self.data is None:
            return card(repr(self)[1:-1], {})
        found, units = self.summary(), units_of_parameters(self.record)
        about = {
            key: value for key, value in found.items() if isinstance(value, (str, float, int)) and key not in HIDDEN
        }
        grids = [
            Grid(("parameter", "value", "unit"), [(k, v, units.get(k)) for k, v in self.record.parameters.items()])
        ]
        for key in FIGURES:
            rows = {name: row for name, row in (found.get(key) or {}).items() if isinstance(row, dict)}
            columns = list(dict.fromkeys(name for row in rows.values() for name in row if _is_short(row[name])))
            grids.append(Grid(("", *columns), [(name, *map(row.get, columns)) for name, row in rows.items()]))
        dataset = {"dataset": self.to_xarray()._repr_html_()} if self._variables() else {}
        return card(f"pgmp {self.kind} of scene '{found['scene']}'", about, grids, self.remarks, dataset)

    @property
    def record(self) -> RunRecord:
        """Where it comes from."""
        return self._own().record

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """Remarks for its reader: warnings, and notes on what is absent."""
        return self.record.remarks

    @property
    def scene(self) -> Scene:
        """The scene that it is of."""
        from pgmp_petsc.scene import scene_from_toml  # takes a noticeable time, and tables of results need none

        return scene_from_toml(self.record.scene_toml, self.directory)

    def summary(self) -> dict[str, Any]:
        """Return its figures as plain data, those of the command's ``--json``."""
        return json_data(summary_of(self.data))

    def to_xarray(self) -> xarray.Dataset:
        """Return its arrays as a dataset of xarray by name, with units and descriptions as attributes.

        Outputs have their own names; what else there is begins with its kind and a dot, which no name of a scene has:
        ``parameter.r1``, ``state.theta``, ``error.crank_angle``. A result declares these names (``label``). Raises
        `InputError` if xarray is not installed, or results of this kind have no dataset.
        """
        xarray = needs_xarray("to_xarray")
        found = self._variables()
        if not found:
            raise InputError(f"to_xarray: there is no dataset of a {self.kind}; its arrays are attributes")
        axes = {axis for _, one in found for axis in one.axes} | {name for name, one in found if one.is_axis}
        taken = [name for name, one in found if name in axes and not one.is_axis]
        if taken:
            raise InputError(
                f"to_xarray: '{taken[0]}' is the name of an axis of the dataset; give the scene's another name"
            )
        record = self.record
        about = {"kind": self.kind, "scene": origin_of(record)["scene"], "program_version": __version__}
        about |= {"parameters": json.dumps(record.parameters), "remarks": [str(remark) for remark in record.remarks]}
        about |= {"model": self.data.model} if hasattr(self.data, "model") else {}
        about |= {} if record.seed is None else {"seed": record.seed}
        arrays = {
            is_axis: {name: (one.axes, one.values, one.attributes) for name, one in found if one.is_axis is is_axis}
            for is_axis in (False, True)
        }
        return xarray.Dataset(arrays[False], arrays[True], about)

    def to_groups(self) -> Mapping[str, Any]:
        """Return the arrays of `to_xarray` in groups, so that names have no dots: ``groups["error"]["crank_angle"]``.

        A DataTree where the installed xarray has it, else a mapping of datasets; outputs are in the group ``output``.
        Raises as `to_xarray`.
        """
        data = self.to_xarray()
        groups: dict[str, Any] = {}
        own_names: dict[str, dict[str, str]] = {}
        for name in map(str, data.data_vars):
            path, _, own = name.rpartition(".")
            own_names.setdefault(path.replace(".", "/") or "output", {})[name] = own
        for path, names in own_names.items():
            part = data[[*names]]
            # so have coordinates of all groups, theta.phi, where they are not the names of others then
            free = {str(name): str(name).rpartition(".")[2] for name in part.coords if "." in str(name)}
            taken = {*part.variables, *part.dims, *names.values()}
            groups[path] = part.rename(names | {name: own for name, own in free.items() if own not in taken})
        tree = getattr(needs_xarray("to_groups"), "DataTree", None)
        return groups if tree is None else tree.from_dict(groups, name=self.kind)

    @checked
    def plot(self, picture: str | None = None, *, exaggerate: float = 1.0, at: float | None = None) -> Figure:
        """Return a picture that ``pgmp plot`` draws of it, as a figure of matplotlib.

        The picture is given by its name, without .png; by default the first of them, such as ``trajectories``. The
        others are as of `pgmp.plot`. Raises `InputError` where there is no picture of this name, or of results of this
        kind, or nothing to draw.
        """
        from pgmp_petsc.figures.collection import pictures_of  # matplotlib takes a noticeable time

        pictures = pictures_of(self._own(), self.path or Path(self.kind), exaggerate, at)
        if not pictures:
            raise InputError(f"plot: there is no picture of {named(self.kind)}")
        name = next(iter(pictures)) if picture is None else picture
        if name not in pictures:
            raise InputError(f"picture = {name!r}: of this {self.kind} there are {', '.join(pictures)}")
        return pictures[name]()

    @checked
    def write(self, path: str | PathLike[str]) -> Path:
        """Write the file that the command writes, on the first rank, and return its path. Collective on `comm`.

        A name that ends in .csv gives a table of its columns (`results.summary`), where results of its kind have some.
        Raises `InputError` if there is another file of this name, or it cannot be made there; `RunError` if the system
        fails to write.
        """
        with claimed(self.comm, path, form_of(path, self.kind)) as target:
            on_root(self.comm, write_result, self.data, target, doing="writing the result")
        if not is_table(target):  # of which nothing can be read again
            self.path = target
        return target


#: Entries of summaries that a notebook does not show, and those that it shows as tables.
HIDDEN = ("kind", "scene", "ranks")
FIGURES = ("outputs", "statistics", "probabilities")


def _is_short(value: object) -> bool:
    """Return whether a figure has room in a cell: a number, a text, or an interval."""
    is_interval = isinstance(value, list) and len(value) == 2
    return is_interval or isinstance(value, (int, float, str)) and not isinstance(value, bool)


#: Kinds of models that stand alone.
MODELS = ("rom", "components")


class Rom(Result):
    """A model that was built; attributes of `reduction.rom.ReducedOrderModel`, or of
    `models.component_file.ComponentsFile`, are its own."""

    def _own(self) -> Any:
        return super()._own().rom if self.kind == "rom" else super()._own()

    def summary(self) -> dict[str, Any]:
        return json_data(self.data.figures() | origin_of(self.record))


class StoppedRun(RunError):
    """A run stopped before its end; its `result` is the run up to there."""

    def __init__(self, message: str, result: Result | None = None) -> None:
        super().__init__(message)
        self.result = result


def in_memory(data: Any) -> Any:
    """Return a result whose columns are arrays, where they are read from a file when they are asked for."""
    found = {item.name: getattr(data, item.name) for item in fields(data)}
    lazy = {
        name: dict(value) for name, value in found.items() if isinstance(value, Mapping) and type(value) is not dict
    }
    return replace(data, **lazy) if lazy else data


def file_of(result: Result | str | PathLike[str]) -> Path:
    """Return the file of a result, or of its name; raises `InputError` if it was not written yet."""
    if not isinstance(result, Result):
        return Path(result)
    if result.path is None:
        raise InputError(f"result: {named(result.kind)} without a file; write it first: result.write('NAME.h5')")
    return Path(result.path)
