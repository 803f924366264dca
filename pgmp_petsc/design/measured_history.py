"""A measured history: a table of instants and outputs in a CSV file.

The first line has the names: ``time`` (s) and outputs of the scene, in their units. Other columns have no part. A cell
that is empty, or ``nan``, is a gap: sensors may measure at instants of their own.
"""

from __future__ import annotations

import csv
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from pgmp_petsc.base.errors import InputError, Remark, nearest_name, note, plain_reason, shortened
from pgmp_petsc.base.units import SI, UnitSystem, times
from pgmp_petsc.files.hdf5 import csv_table
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.scene.fields import LARGEST

TIME = "time"
GAPS = ("", "nan")
LARGE = 1_000_000  # bytes of a file that is read at once
MOST_ORDER = 20  # of the autoregression of what is left
NOTHING = 1e-6  # correlation that is none
REMEMBERED = 0.5  # correlation of what is left with a later measurement, beyond which it is no noise
LAGS = 10  # later measurements that are looked at: a vibration that is off may leave nothing at the next one
BY_CHANCE = 3.5  # times 1 / sqrt(n), the deviation of correlations of n independent values: 1 of 200 such fits


@dataclass(frozen=True, eq=False)
class MeasuredHistory:
    """Measured outputs over time."""

    time: np.ndarray  # increasing, shape (n,), s
    outputs: dict[str, np.ndarray]  # by name, each of shape (n,); NaN where it was not measured
    remarks: tuple[Remark, ...] = ()  # what is to be said of the file

    def there(self, output: str) -> np.ndarray:
        """Return at which instants an output was measured, shape (n,)."""
        return np.isfinite(self.outputs[output])

    def of(self, output: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the instants (n_k,), s, at which an output was measured, and what was."""
        there = self.there(output)
        return self.time[there], self.outputs[output][there]

    def counts(self) -> dict[str, int]:
        """Return how many measurements there are of each output."""
        return {name: int(self.there(name).sum()) for name in self.outputs}


def read_history(path: Path, outputs: OutputSet, duration: float, system: UnitSystem = SI) -> MeasuredHistory:
    """Read a file in the units of a system, and check that it fits the outputs of a scene and a run of some duration
    (s); return it in SI units. Raises `InputError` naming line and column."""
    try:
        with open(path, encoding="utf-8-sig", newline="") as stream:
            names, rows = csv_table(
                stream, f"'{path}'", {TIME: "s", **{name: system.unit(unit) for name, unit in outputs.units.items()}}
            )
            used = _used(path, names, outputs)
            places = {name: names.index(name) for name in used}
            table, lines = _all_at_once(path, len(names), list(places.values()), duration), []
            rows = rows if table is None else ()
            table = [] if table is None else table
            for line, row in rows:
                where = f"'{path}': line {line}"
                table.append([_number(row[place], where, name) for name, place in places.items()])
                lines.append(line)
    except UnicodeError as error:
        text = f"measured history '{path}' is no text in UTF-8; take a CSV file, as pgmp export makes of a run"
        raise InputError(text) from error
    except (OSError, csv.Error) as error:
        raise InputError(f"measured history '{path}' cannot be read: {plain_reason(error) or error}") from error
    if not len(table):
        raise InputError(f"'{path}': there are no measurements in it, only a first line of names")
    columns = dict(zip(used, np.array(table).T))
    time = columns.pop(TIME)
    if lines:
        _check_times(path, time, lines, duration)
    for name, values in columns.items():
        if np.isnan(values).all():
            raise InputError(f"'{path}': the column '{name}' has no measurement at all; leave it out")
    others = [name for name in names if name not in used]
    remarks = (note(f"columns of '{path}' that are no outputs have no part: {', '.join(others)}"),) if others else ()
    found = {name: times(values, system.size_of(outputs.units[name])) for name, values in columns.items()}
    return MeasuredHistory(time, found, remarks)


def _all_at_once(path: Path, n_columns: int, places: list[int], duration: float) -> np.ndarray | None:
    """Return the columns of a file without any fault, shape (n, n_columns); None where reading line by line has to say
    what is wrong, or is as quick."""
    if path.stat().st_size < LARGE:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of a file without rows
            table = np.loadtxt(path, delimiter=",", skiprows=1, encoding="utf-8-sig", ndmin=2, comments=None)
    except (ValueError, OSError):
        return None
    if table.shape[1] != n_columns or not len(table):
        return None
    found, time = table[:, places], table[:, places[0]]
    fine = np.all(np.abs(found) <= LARGEST) and np.all(np.diff(time) > 0.0)
    return found if fine and time[0] >= 0.0 and time[-1] <= duration * (1.0 + 1e-12) else None


def _used(path: Path, names: list[str], outputs: OutputSet) -> list[str]:
    """Return the columns to read: the time and outputs."""
    if TIME not in names:
        hint = nearest_name(TIME, names) if names else "; it has none at all"
        raise InputError(f"'{path}': there is no column '{TIME}' (s) in its first line{hint}")
    used = [TIME, *(name for name in dict.fromkeys(names) if name in outputs.functions)]
    if len(used) == 1:
        raise InputError(
            f"'{path}': none of its columns is an output of the scene{nearest_name('', outputs.functions)}"
        )
    return used


def _number(text: str, where: str, name: str) -> float:
    if name != TIME and text.strip().lower() in GAPS:
        return np.nan
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not abs(value) <= LARGEST:
        shown = f"'{shortened(text.strip(), 40)}'" if text.strip() else "nothing"
        gaps = "" if name == TIME else " (or nothing, for a gap)"
        raise InputError(
            f"{where}: {name} = {shown}; a finite number is needed, of a magnitude up to {LARGEST:g}{gaps}"
        )
    return value


def _check_times(path: Path, time: np.ndarray, lines: list[int], duration: float) -> None:
    """Refuse times that do not increase or are not in the run."""
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size:
        row = int(back[0]) + 1
        raise InputError(
            f"'{path}': line {lines[row]}: {TIME} = {time[row]:g} s comes after {time[row - 1]:g} s; times must "
            "increase"
        )
    outside = np.flatnonzero((time < 0.0) | (time > duration * (1.0 + 1e-12)))
    if outside.size:
        row = int(outside[0])
        raise InputError(
            f"'{path}': line {lines[row]}: {TIME} = {time[row]:g} s is not in the run, [0, {duration:g}] s; give a "
            "longer one (--override simulation.duration=...), or leave these lines out"
        )


def remembered(left: np.ndarray) -> tuple[int, float]:
    """Return how many measurements later what is left, (n,), is most like itself, and the correlation; 0 for noise."""
    size = float(np.sum(left**2))
    lags = range(1, min(LAGS, left.size // 4) + 1)
    if size == 0.0 or not lags:
        return 0, 0.0
    found = np.array([np.sum(left[lag:] * left[:-lag]) for lag in lags]) / size
    if found[0] > REMEMBERED:
        return 1, float(found[0])
    most = int(np.argmax(np.abs(found)))
    is_noise = abs(found[most]) <= max(REMEMBERED, BY_CHANCE / np.sqrt(left.size))
    return (0, 0.0) if is_noise else (most + 1, float(found[most]))


def autocorrelation(left: np.ndarray) -> np.ndarray:
    """Return the correlations of what is left, (n,), with later values, from 1 of none later to where they end.

    Those of the autoregression whose order has the least information criterion (Schwarz, Annals of Statistics 6 (1978)
    461-464), by Yule and Walker's equations: 1 alone for independent noise. Its first correlations are what was found,
    and later ones follow without their noise (den Haan and Levin, Handbook of Statistics 15 (1997) 299-342). Of the
    first order the bias of few values is taken off (Kendall, Biometrika 41 (1954) 403-404).
    """
    n, size = left.size, float(np.sum(left**2))
    most = min(MOST_ORDER, n // 10)
    if not size > 0.0 or most < 1:
        return np.ones(1)
    found = np.array([1.0, *(np.sum(left[lag:] * left[:-lag]) / size for lag in range(1, most + 1))])
    best, least = np.zeros(0), 0.0
    for order in range(1, most + 1):
        weights = scipy.linalg.solve_toeplitz(found[:order], found[1 : order + 1])
        rest = 1.0 - weights @ found[1 : order + 1]
        criterion = n * np.log(max(rest, 1e-300)) + order * np.log(n)
        if criterion < least:
            best, least = weights, criterion
    if best.size == 1:
        best = found[1:2] = np.minimum(best + (1.0 + 3.0 * best) / n, 1.0 - 1.0 / n)
    correlations = list(found[: best.size + 1])
    while best.size and len(correlations) < n and max(np.abs(correlations[-best.size :])) > NOTHING:
        correlations.append(float(best @ correlations[: -best.size - 1 : -1]))
    return np.array(correlations)
