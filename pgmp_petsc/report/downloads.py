"""Data to take along from a page: CSV with all digits, within the page itself."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import PurePath

from pgmp_petsc.report.sources import Source
from pgmp_petsc.results import Ensemble, Tradeoff, Trajectory
from pgmp_petsc.results.tables import Columns, columns_of, csv_text

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
    for kind, about in ((Trajectory, "outputs over time"), (Ensemble, "samples"), (Tradeoff, "settings")):
        if isinstance(result, kind):
            found.append(_table(f"{stem}.csv", about, columns_of(result)))
    if isinstance(result, Ensemble):
        for name, band in result.bands.items():
            unit = result.units.get(name, "1")
            columns = {"time": ("s", band.time), "mean": (unit, band.mean), "std": (unit, band.std)}
            columns |= {f"q{100 * p:g}": (unit, band.quantiles[:, k]) for k, p in enumerate(band.probabilities)}
            found.append(_table(f"{stem}_{name}.csv", f"{name} over time, of the samples", columns))
    toml = result.record.scene_toml.encode("utf-8", "backslashreplace")
    return [*found, Download(f"{stem}.toml", "the scene, with all its defaults", _address("application/toml", toml))]


def _table(name: str, about: str, columns: Columns) -> Download:
    """Return a table; one with too many numbers has the first rows alone, and says so."""
    rows = len(next(iter(columns.values()))[1])
    kept = min(rows, max(1, MOST_NUMBERS // len(columns)))
    about = f"{about}, {rows} rows" if kept == rows else f"{about}, the first {kept} of {rows} rows: the file has all"
    return Download(name, about, _address("text/csv", csv_text(columns, kept).encode()))


def _address(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
