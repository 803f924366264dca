"""The files of a page, read and checked, and which of them are of one scene.

Figures of a page: what is read, and where it comes from, so that a program can compare the two.

A sentence is a list of texts, figures and intervals; the page writes figures as ``<data value=... data-file=...
data-path=... data-index=...>``, with all digits of the file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pgmp_petsc.base.units import behind
from pgmp_petsc.figures.style import axis_unit, read_scenes, short_names
from pgmp_petsc.files.hdf5 import RunRecord, open_file
from pgmp_petsc.results import Ensemble, Fit, Selection, Tradeoff, Trajectory
from pgmp_petsc.results.ensemble import RareEvent
from pgmp_petsc.results.numbers import end_texts, number_text


@dataclass(frozen=True)
class Build:
    """Build of a model, as recorded in its file."""

    kind: str  # ``rom`` or ``components``
    record: RunRecord  # where it comes from
    selection: Selection | None  # what was chosen for tolerances, None where nothing was

    @classmethod
    def read(cls, path: str | os.PathLike[str], **most: int) -> Build:
        """Read a file; raises `InputError` where it is no whole model."""
        with open_file(path, ("rom", "components")) as file:
            return cls(str(file.attrs["kind"]), RunRecord.read(file), Selection.found_in(file))


READERS = {
    "trajectory": Trajectory, "ensemble": Ensemble, "tradeoff": Tradeoff, "rare_event": RareEvent, "fit": Fit,
    "rom": Build, "components": Build,
}  # fmt: skip
Result = Trajectory | Ensemble | Tradeoff | RareEvent | Fit | Build


@dataclass(frozen=True)
class Source:
    """A file and what is in it."""

    name: str  # of the file, with as many of its directories as tell it from the others
    result: Result  # what it holds
    program: str  # version of the program that wrote it
    path: Path  # as it was given

    @property
    def record(self) -> RunRecord:
        return self.result.record


def read_sources(files: Sequence[Path], **most: int) -> tuple[list[list[Source]], list[str]]:
    """Return the sources, one list a scene, in the order in which they come, and a line for each file given twice or
    not shown; `most` as in `read_scenes`. Raises `InputError` if a file is damaged, or a page shows none of them."""
    scenes, lines = read_scenes(files, READERS, "shown", **most)
    paths = [path for scene in scenes for path, *_ in scene]
    names = dict(zip(paths, short_names(paths)))
    return [[Source(names[path], result, program, path) for path, result, program in scene] for scene in scenes], lines


def of_kind(sources: Iterable[Source], kind: type | tuple[type, ...]) -> list[Source]:
    return [source for source in sources if isinstance(source.result, kind)]


def compact_json(data: object) -> str:
    """Return JSON that is allowed within a script element of a page."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


@dataclass(frozen=True)
class Datum:
    """A figure."""

    value: float  # as in the file, in the file's unit
    text: str  # as it is read
    #: file, path, index: name of the file, its dataset, and the place in it (``3`` or ``3,1``); empty for figures that
    #: were worked out of several
    file: str = ""
    path: str = ""
    index: str = ""


@dataclass(frozen=True)
class Interval:
    """Both ends of a confidence interval, which the page writes in brackets."""

    low: Datum
    high: Datum


Sentence = Sequence[str | Datum | Interval]


@dataclass(frozen=True)
class Place:
    """Where figures come from: a file, and a group in it."""

    file: str
    group: str

    def datum(self, name: str, value: float, text: str, index: str = "") -> Datum:
        """Return a figure of a dataset of the group."""
        return Datum(float(value), text, self.file, f"{self.group}/{name}", index)

    def figure(
        self, name: str, value: float, interval_name: str, ends: np.ndarray, factor: float, index: str = ""
    ) -> list[str | Datum | Interval]:
        """Return a figure and its interval, ``5.8 [4.5, 7.4]``, in a unit of which the file's has `factor`."""
        shown = self.datum(name, value, number_text(factor * float(value), factor * ends, 8), index)
        if np.isnan(ends).any() or np.isinf(ends).all():
            return [shown, " [unknown]"]
        low, high = self.ends(interval_name, ends, factor, index, value)
        return [shown, Interval(low, high)]

    def ends(self, name: str, ends: np.ndarray, factor: float, index: str = "", value: float = np.nan) -> list[Datum]:
        """Return both ends of an interval, of a value where that is known, in a unit as of `figure`."""
        row = f"{index}," if index else ""
        texts = end_texts(factor * ends, factor * float(value))
        return [self.datum(name, end, text, f"{row}{k}") for k, (end, text) in enumerate(zip(ends, texts))]


def mean_of(source: Source, name: str) -> tuple[Sentence, float, str]:
    """Return the mean of a quantity of an ensemble, with its interval unless it is constant, how many of the unit that
    it is shown in the file's unit is, and that unit behind a space; empty where there is none."""
    s, place = source.result.statistics[name], Place(source.name, f"/statistics/{name}")
    factor, unit = axis_unit(source.result.units.get(name, "1"), s.quantiles, np.array([s.mean]))
    if s.constant:
        mean = [place.datum("mean", s.mean, f"{factor * s.mean:.6g}")]
    else:
        mean = place.figure("mean", s.mean, "mean_interval", s.mean_interval, factor)
    return mean, factor, behind(unit)


def chance_of(source: Source) -> Sentence:
    """Return the probability of a rare event; nothing where not even a bound of it is known."""
    found, place = source.result, Place(source.name, "/probability")
    ends = [place.datum("interval", end, f"{end:.3g}", str(k)) for k, end in enumerate(found.interval)]
    if found.reached:
        return [place.datum("estimate", found.estimate, f"{found.estimate:.3g}"), " ", Interval(*ends)]
    if found.interval[0] > 0.0:
        return ["not decided, as parts of it may be missing; ", ends[0], " to ", ends[1]]
    return ["not reached; its probability is at most ", ends[1]] if np.isfinite(found.interval[1]) else []


def failed_of(source: Source) -> str:
    status = source.result.status
    return f"{source.name}: {np.count_nonzero(status)} of {len(status)} samples failed"
