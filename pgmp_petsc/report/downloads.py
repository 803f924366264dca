"""Data to take along from a page: CSV with all digits, within the page itself."""

from __future__ import annotations

import base64
import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from pgmp_petsc.report.sources import Source
from pgmp_petsc.results import Ensemble, Tradeoff, Trajectory

MOST_NUMBERS = 400_000  # of a table: about 8 MB; the files have the rest


@dataclass(frozen=True)
class Download:
    """A file within the page.

    Attributes
    ----------
    name
        Under which it is saved.
    about
        What is in it.
    address
        ``data:`` address with the content.
    """

    name: str
    about: str
    address: str


def downloads_of(source: Source) -> list[Download]:
    """Return the tables of a file, and the scene that it was made from."""
    stem = PurePath(source.name).with_suffix("").as_posix().replace("/", "_")
    result = source.result
    found = []
    if isinstance(result, Trajectory):
        columns = {"time": ("s", result.time)}
        columns |= {name: (result.units.get(name, "1"), values) for name, values in result.outputs.items()}
        found.append(_table(f"{stem}.csv", "outputs over time", columns))
    if isinstance(result, Ensemble):
        columns = {"sample": ("1", np.arange(len(result.status))), "status": ("1", result.status)}
        for name, values in (*result.parameters.items(), *result.outputs.items()):
            columns[name] = (result.units.get(name, "1"), values)
        for key, values in result.extremes.items():
            name, _, which = key.rpartition("/")
            columns[f"{name}.{which}"] = ("s" if which.startswith("time") else result.units.get(name, "1"), values)
        columns |= {label: ("s", values) for label, values in result.first_passages.items()}
        found.append(_table(f"{stem}.csv", "samples", columns))
        for name, band in result.bands.items():
            unit = result.units.get(name, "1")
            columns = {"time": ("s", band.time), "mean": (unit, band.mean), "std": (unit, band.std)}
            columns |= {f"q{100 * p:g}": (unit, band.quantiles[:, k]) for k, p in enumerate(band.probabilities)}
            found.append(_table(f"{stem}_{name}.csv", f"{name} over time, of the samples", columns))
    if isinstance(result, Tradeoff):
        columns = {"setting": ("", np.array([result.name(row) for row in range(len(result.families))], dtype=object))}
        columns |= {f"error {name}": ("1", result.errors[:, k]) for k, name in enumerate(result.outputs)}
        columns |= {f"{clock} time": ("s", values) for clock, values in vars(result.times).items()}
        found.append(_table(f"{stem}.csv", "settings", columns))
    toml = result.record.scene_toml.encode("utf-8", "backslashreplace")
    return [*found, Download(f"{stem}.toml", "the scene, with all its defaults", _address("application/toml", toml))]


def _table(name: str, about: str, columns: Mapping[str, tuple[str, np.ndarray]]) -> Download:
    """Return a table; one with too many numbers has the first rows alone, and says so."""
    rows = len(next(iter(columns.values()))[1])
    kept = min(rows, max(1, MOST_NUMBERS // len(columns)))
    about = f"{about}, {rows} rows" if kept == rows else f"{about}, the first {kept} of {rows} rows: the file has all"
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([f"{name} ({unit})" if unit not in ("", "1") else name for name, (unit, _) in columns.items()])
    writer.writerows(zip(*([_digits(value) for value in values[:kept].tolist()] for _, values in columns.values())))
    return Download(name, about, _address("text/csv", stream.getvalue().encode()))


def _digits(value: float | int | str) -> str:
    return repr(value) if isinstance(value, float) else str(value)


def _address(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
