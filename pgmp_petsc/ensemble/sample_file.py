"""Samples from a file: a table with a column for every uncertain parameter, as CSV or HDF5, in the scene's units.

CSV has the names in its first line, with or without the parameters' units, and commas between numbers. HDF5 has a data
set (N,) for each parameter, at the top or in a group ``parameters``: any ensemble of this program is such a file, whose
samples another model can so repeat.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from pgmp_petsc.base.errors import InputError, Remark, nearest_name, note, shortened
from pgmp_petsc.base.units import Units, behind
from pgmp_petsc.files.hdf5 import csv_table, without_unit
from pgmp_petsc.results.numbers import Arrays
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.messages import MAX_LINES, input_error
from pgmp_petsc.scene.parameters import uncertain_names
from pgmp_petsc.scene.units import in_own_units, own_units, si_values
from pgmp_petsc.scene.uses import ordered_ends

OPTION = "--samples"


@dataclass(frozen=True)
class SampleFile:
    """Samples that a file gives: values (N,) by parameter, the identity of its content, and what is said of it."""

    path: Path
    values: dict[str, np.ndarray]
    identity: str
    remarks: tuple[Remark, ...] = ()


def called(samples: Path | Arrays | None) -> str:
    """Return what messages call samples: the option with its file, or a program's argument."""
    return f"{OPTION} {samples}" if isinstance(samples, Path) else "samples"


def read_samples(path: Path | Arrays, scene: Scene, n_samples: int | None) -> SampleFile:
    """Read the first `n_samples` samples of a file, or of columns, or all. By one process. Raises `InputError` if the
    file cannot be read, lacks the column of an uncertain parameter, has fewer samples, or one that is no finite number
    within the parameter's bounds, with its line."""
    where = called(path)
    if not isinstance(path, Path):
        columns = {name: np.asarray(path[name], dtype=float) for name in _used(where, list(path), scene)}
        return of_columns(columns, scene, where, n_samples, [name for name in path if name not in columns])
    try:
        if not path.is_file():
            raise InputError(f"{where}: there is no such file; a CSV or HDF5 file of samples is needed")
        is_hdf5 = h5py.is_hdf5(path)
        columns, lines, others = _of_hdf5(path, scene) if is_hdf5 else _of_csv(path, scene)
        with open(path, "rb") as stream:
            content = hashlib.file_digest(stream, "sha256").hexdigest()
    except (OSError, UnicodeDecodeError, csv.Error, RuntimeError) as error:
        raise InputError(f"{where}: it cannot be read as CSV or HDF5: {error}") from error
    return _checked(path, columns, lines, others, content, scene, n_samples, where, "sample" if is_hdf5 else "line")


def of_columns(
    columns: Arrays,
    scene: Scene,
    where: str,
    n_samples: int | None = None,
    others: Sequence[str] = (),
    place: str = "sample",
) -> SampleFile:
    """Return the first `n_samples`, or all, of columns of parameters of a scene as samples; raises `InputError` where
    one is wrong.

    Messages call the columns `where`, and a row of them `place`; `others` are names of columns that have no part.
    """
    _check_lengths(columns, where)
    content, lines = hashlib.sha256(), np.arange(len(next(iter(columns.values()))))
    for name, values in columns.items():
        content.update(name.encode() + b"\0" + values.tobytes())
    return _checked(Path(where), columns, lines, others, content.hexdigest(), scene, n_samples, where, place)


def _checked(
    path: Path, columns: Arrays, lines: np.ndarray, others: Sequence[str], content: str, scene: Scene,
    n_samples: int | None, where: str, place: str,
) -> SampleFile:  # fmt: skip
    """Return the samples that are wanted; raises `InputError` where there are too few, or one is wrong."""
    n = min(map(len, columns.values()))
    if n_samples is not None and n_samples > n:
        raise InputError(f"-n {n_samples}: {where} has {n} samples; give at most so many, or leave -n out")
    n = n if n_samples is None else n_samples
    columns, lines = {name: values[:n] for name, values in columns.items()}, lines[:n]
    problems = []
    for problem in _problems(columns, lines, in_own_units(scene), own_units(scene), place):
        problems.append(f"{where}: {problem}")
        if len(problems) > MAX_LINES:
            break
    if problems:
        raise input_error(problems)
    text = f"columns of '{path}' that are no parameters have no part: {', '.join(others)}"
    return SampleFile(path, si_values(scene, columns), content, (note(text),) if others else ())


def _of_csv(path: Path, scene: Scene) -> tuple[dict[str, np.ndarray], np.ndarray, list[str]]:
    """Return the columns of parameters, the number of each sample's line, and the names of columns without a part."""
    with open(path, encoding="utf-8-sig", newline="") as stream:
        names, rows = csv_table(stream, f"{OPTION} {path}", own_units(scene))
        used = _used(f"{OPTION} {path}", names, scene)
        places = [names.index(name) for name in used]
        values: list[list[float]] = []
        lines = []
        for line, row in rows:
            where = f"{OPTION} {path}: line {line}"
            values.append([_number(row[place], where, name) for place, name in zip(places, used)])
            lines.append(line)
    if not lines:
        raise InputError(f"{OPTION} {path}: there are no samples in it, only a first line of names")
    return dict(zip(used, np.array(values).T)), np.array(lines), [name for name in names if name not in used]


def _number(text: str, where: str, name: str) -> float:
    try:
        return float(text)
    except ValueError:
        shown = f"'{shortened(text.strip(), 40)}'" if text.strip() else "nothing"
        raise InputError(f"{where}: {name} = {shown}; a number is needed") from None


def _of_hdf5(path: Path, scene: Scene) -> tuple[dict[str, np.ndarray], np.ndarray, list[str]]:
    """Return the columns of parameters and the number of each sample; data sets that have no part are not named."""
    with h5py.File(path, "r") as file:
        group = file["parameters"] if isinstance(file.get("parameters"), h5py.Group) else file
        names = [name for name, item in group.items() if isinstance(item, h5py.Dataset)]
        used = _used(f"{OPTION} {path}", names, scene)
        columns = {}
        for name in used:
            data = group[name]
            if data.ndim != 1 or data.dtype.kind not in "iuf" or not data.size:
                what = f"has shape {data.shape} and type {data.dtype}; numbers of shape (N,) are needed"
                raise InputError(f"{OPTION} {path}: data set '{data.name}' {what}")
            if (unit := str(data.attrs.get("unit", "1"))) != "1":
                without_unit(f"{name} ({unit})", f"{OPTION} {path}", own_units(scene))
            columns[name] = np.asarray(data[()], dtype=float)
    _check_lengths(columns, f"{OPTION} {path}")
    return columns, np.arange(len(columns[used[0]])), []


def _check_lengths(columns: Arrays, where: str) -> None:
    """Refuse columns of several lengths, and without numbers."""
    lengths = {name: len(values) for name, values in columns.items()}
    if len(set(lengths.values())) > 1 or 0 in lengths.values():
        found = ", ".join(f"{name} {length}" for name, length in lengths.items())
        what = "differ in length" if len(set(lengths.values())) > 1 else "are empty"
        raise InputError(f"{where}: columns {what}: {found}")


def _used(where: str, names: list[str], scene: Scene) -> list[str]:
    """Return the columns that are parameters of the scene; all uncertain ones must be there."""
    for name in uncertain_names(scene):
        if name not in names:
            hint = nearest_name(name, names) if names else "; it has none at all"
            raise InputError(f"{where}: there is no column '{name}', an uncertain parameter{hint}")
    used = [name for name in dict.fromkeys(names) if name in scene.parameters]
    if not used:
        known = nearest_name("", scene.parameters)
        raise InputError(f"{where}: none of its columns is a parameter of the scene{known}")
    return used


def _problems(columns: Arrays, lines: np.ndarray, scene: Scene, units: Units, place: str) -> Iterator[str]:
    """Yield what is wrong with values, the first lines first within a column; all in these units."""
    for name, values in columns.items():
        bounds, wrong = scene.parameters[name].bounds, {"a finite number is needed": ~np.isfinite(values)}
        if bounds is not None:
            limits = f"parameters.{name}.bounds, [{bounds[0]:g}, {bounds[1]:g}]{behind(units[name])}"
            wrong[f"must lie in {limits}"] = (values < bounds[0]) | (values > bounds[1])
        if name in scene.positive_parameters:
            wrong["must be positive for what uses it"] = values <= 0.0
        elif name in scene.parameters_not_negative:
            wrong["must not be negative for what uses it"] = values < 0.0
        for words, which in wrong.items():
            for number in np.flatnonzero(which):
                yield f"{place} {lines[number]}: {name} = {values[number]:g}; {words}"
    for ends in ordered_ends(scene):
        low, high = (np.broadcast_to(end, lines.shape) for end in ends.at(scene, {**scene.values, **columns}))
        for number in np.flatnonzero(low >= high):
            where = f"{ends.entry} = {low[number]:g}; must be below {ends.other}, {high[number]:g}"
            yield f"{place} {lines[number]}: {where}"
