"""Results as tables: columns with their units in the first line of a CSV file, all digits.

=================== ==================================================================================================
result              rows and columns
=================== ==================================================================================================
trajectory          instants: time, outputs
ensemble            samples: number, status (0 = fine), parameters, outputs at the end; extremes over time and first
                    passages where it has them
table of modes      configurations: coordinates, frequencies of the full-order and of the reduced model
trade-off study     settings: name, errors of the outputs, times
sensitivities       instants: time, outputs, derivatives of each output with each parameter
=================== ==================================================================================================

What is no column (statistics, shapes, remarks, the scene) is in the HDF5 files alone.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc.runtime.claims import TABLE, check_output, is_table
from pgmp_petsc.runtime.files import replacing

if TYPE_CHECKING:
    from pgmp_petsc.results.derivatives import Derivatives
    from pgmp_petsc.results.ensemble import Ensemble
    from pgmp_petsc.results.modes import ModesTable
    from pgmp_petsc.results.tradeoff import Tradeoff
    from pgmp_petsc.results.trajectory import Trajectory

#: Unit ("1" or "" for none) and values, shape (n_rows,), by name.
Columns = dict[str, tuple[str, np.ndarray]]


def columns_of(result: Any) -> Columns:
    """Return the columns of a trajectory, an ensemble, a table of modes, a trade-off study or sensitivities.

    Raises
    ------
    TypeError
        If it is something else.
    """
    kind = getattr(result, "kind", "")
    if kind not in _COLUMNS:
        raise TypeError(f"{type(result).__name__} has no table")
    return _COLUMNS[kind](result)


def csv_text(columns: Mapping[str, tuple[str, np.ndarray]], rows: int | None = None) -> str:
    """Return the first `rows` rows (all if not given) as CSV: names with units, then numbers with all digits."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([f"{name} ({unit})" if unit not in ("", "1") else name for name, (unit, _) in columns.items()])
    writer.writerows(zip(*(map(_digits, values[:rows].tolist()) for _, values in columns.values())))
    return stream.getvalue()


def write_result(result: Any, path: str | os.PathLike[str], *parts: Any) -> None:
    """Write a result: as a table where the file's name ends in .csv, else as HDF5. By one process only.

    Parameters
    ----------
    result
        Of any kind that `write` is a method of; of one with columns for a table.
    path
        File to write.
    parts
        What adds itself to the HDF5 file.

    Raises
    ------
    InputError
        If the file cannot be made there, or is there and may not be replaced.
    RunError
        If the system fails to write.
    """
    if not is_table(path):
        result.write(path, *parts)
        return
    text = csv_text(columns_of(result))
    with replacing(check_output(path, TABLE)) as partial:
        Path(partial).write_text(text, encoding="utf-8")


def _of_run(run: Trajectory) -> Columns:
    return {"time": ("s", run.time)} | {name: (run.units.get(name, "1"), run.outputs[name]) for name in run.outputs}


def _of_ensemble(ensemble: Ensemble) -> Columns:
    columns: Columns = {"sample": ("1", np.arange(len(ensemble.status))), "status": ("1", ensemble.status)}
    for name, values in ensemble.parameters.items():
        # an output may have the name of a parameter
        label = f"parameter.{name}" if name in ensemble.outputs else name
        columns[label] = (ensemble.units.get(name, "1"), values)
    for name, values in ensemble.outputs.items():
        columns[name] = (ensemble.units.get(name, "1"), values)
    for key, values in ensemble.extremes.items():
        name, _, which = key.rpartition("/")
        columns[f"{name}.{which}"] = ("s" if which.startswith("time") else ensemble.units.get(name, "1"), values)
    return columns | {label: ("s", values) for label, values in ensemble.first_passages.items()}


def _of_modes(table: ModesTable) -> Columns:
    angles = np.atleast_2d(table.theta)
    columns: Columns = {name: (unit, angle) for (name, unit), angle in zip(table.coordinate_units.items(), angles)}
    for model, frequencies in (("full", table.full_hz), ("reduced", table.reduced_hz)):
        for number, values in enumerate(() if frequencies is None else frequencies.T, 1):
            columns[f"{model}.{number}"] = ("Hz", values)
    return columns


def _of_study(study: Tradeoff) -> Columns:
    names = np.array([study.name(row) for row in range(len(study.families))], dtype=object)
    columns: Columns = {"setting": ("", names)}
    columns |= {f"error {name}": ("1", study.errors[:, k]) for k, name in enumerate(study.outputs)}
    return columns | {f"{clock} time": ("s", values) for clock, values in vars(study.times).items()}


def _of_derivatives(found: Derivatives) -> Columns:
    columns: Columns = {"time": ("s", found.time)}
    columns |= {name: (found.units.get(name, "1"), values) for name, values in found.outputs.items()}
    for output, derivatives in found.derivatives.items():
        columns |= {f"d {output} / d {name}": (found.unit(output, name), derivatives[name]) for name in derivatives}
    return columns


_COLUMNS: dict[str, Callable[[Any], Columns]] = {
    "trajectory": _of_run,
    "ensemble": _of_ensemble,
    "modes": _of_modes,
    "tradeoff": _of_study,
    "sensitivities": _of_derivatives,
}


def _digits(value: float | int | str) -> str:
    return repr(value) if isinstance(value, float) else str(value)
