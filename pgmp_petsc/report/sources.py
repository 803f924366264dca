"""The files of a page, read and checked, and which of them are of one scene."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pgmp_petsc.figures.differences import mechanism_key, short_names
from pgmp_petsc.results import Ensemble, Selection, Tradeoff, Trajectory
from pgmp_petsc.results.rare_event import RareEvent
from pgmp_petsc.runtime.files import RunRecord, open_file


@dataclass(frozen=True)
class Build:
    """What a reduced model's file says of its making.

    Attributes
    ----------
    record
        Where it comes from.
    selection
        What was chosen for tolerances, None where nothing was.
    """

    record: RunRecord
    selection: Selection | None

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Build:
        """Read a file; raises `InputError` where it is no whole reduced model."""
        with open_file(path, "rom") as file:
            return cls(RunRecord.read(file), Selection.read(file))


READERS = {
    "trajectory": Trajectory, "ensemble": Ensemble, "tradeoff": Tradeoff, "rare_event": RareEvent, "rom": Build
}  # fmt: skip
Result = Trajectory | Ensemble | Tradeoff | RareEvent | Build


@dataclass(frozen=True)
class Source:
    """A file and what is in it.

    Attributes
    ----------
    name
        Of the file, with as many of its directories as tell it from the others.
    result
        What it holds.
    program
        Version of the program that wrote it.
    path
        As it was given.
    """

    name: str
    result: Result
    program: str
    path: Path

    @property
    def record(self) -> RunRecord:
        """Where the result comes from."""
        return self.result.record


def read_sources(files: Sequence[Path]) -> tuple[list[list[Source]], list[str]]:
    """Return the sources, one list a scene, in the order in which they come, and a line for each file given twice.

    Raises
    ------
    InputError
        If a file is damaged, or none of those that a page shows.
    """
    once: dict[str, Path] = {}
    lines = []
    for path in files:
        if (real := os.path.realpath(path)) in once:
            lines.append(f"{path} is given twice and shown once")
        once.setdefault(real, path)
    paths = list(once.values())
    scenes: dict[tuple, list[Source]] = {}
    for path, name in zip(paths, short_names(paths)):
        with open_file(path, READERS) as file:
            reader, program = READERS[str(file.attrs["kind"])], str(file.attrs["program_version"])
        source = Source(name, reader.read(path), program, path)
        scenes.setdefault(mechanism_key(source.record), []).append(source)
    return list(scenes.values()), lines


def compact_json(data: object) -> str:
    """Return JSON that may stand within a script element of a page."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
