"""Captions above pictures: how results differ, and what their reader has to know besides.

Results belong together where their scenes have one name and the same bodies, joints and coordinates. What may differ
within that is said: ``r1 = 5 mm``, ``simulation.step = 0.001``, ``without effects.weight``, ``reduced``, and the name
of the file where nothing else differs. Runs that ended early are named, and warnings that come with results.
"""

from __future__ import annotations

import os
import textwrap
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from pgmp_petsc.base.errors import counted
from pgmp_petsc.figures.style import heading, quantity, scene_of, top_legend
from pgmp_petsc.files.claims import KINDS, named
from pgmp_petsc.files.hdf5 import RunRecord, open_file
from pgmp_petsc.files.seal import kind_of
from pgmp_petsc.results import Trajectory

MOST, LONGEST = 3, 220  # a picture has room for so many, of so many characters; the files have the rest


def planned_end(run: Trajectory) -> float:
    """Return the instant (s) at which the scene ends, the run's own end where it says none."""
    return max(scene_of(run.record).get("simulation", {}).get("duration", 0.0), float(run.time[-1]))


def ended_early(run: Trajectory) -> bool:
    """Tell whether a run ended before its scene does."""
    return bool(run.time[-1] < planned_end(run) * (1.0 - 1e-9))


def of_runs(runs: Sequence[Trajectory], labels: Sequence[str] = ()) -> list[str]:
    """Return the notes for a picture of runs, the labels before them where there are several."""
    labels = labels or [""] * len(runs)
    early = [
        _labelled(f"ended early, at {run.time[-1]:.4g} s of {planned_end(run):.4g} s", label)
        for run, label in zip(runs, labels)
        if ended_early(run)
    ]
    return [*early, *of_records([run.record for run in runs], labels)]


def headed(figure: Figure, keys: Sequence[Artist], what: str, record: RunRecord, label: str) -> Figure:
    """Put what a picture of one result shows above it, the warnings that come with the result, and rows of keys."""
    return top_legend(figure, keys, heading(what, record, label), of_records([record]))


def of_records(records: Sequence[RunRecord], labels: Sequence[str] = ()) -> list[str]:
    """Return the warnings of results, each once."""
    labels = labels or [""] * len(records)
    texts = dict.fromkeys(
        _labelled(str(remark), label)
        for record, label in zip(records, labels)
        for remark in record.remarks
        if remark.kind == "warning"
    )
    shown = [_short(text) for text in list(texts)[:MOST]]
    left = len(texts) - len(shown)
    return [*shown, f"and {counted(left, 'more warning')}: see pgmp info"] if left else shown


def _short(text: str) -> str:
    """Return as many clauses of a warning as a picture has room for, the first one at least."""
    if len(text) <= LONGEST:
        return text
    end = max(text.rfind(mark, 0, LONGEST) for mark in ("; ", ": ", ". "))
    return f"{text[:end]} …" if end > 0 else textwrap.shorten(text, LONGEST, placeholder=" …")


def _labelled(text: str, label: str) -> str:
    return f"{label}: {text}" if label else text


# Parts of a scene that change nothing in a run, and those that one model has alone or that only resolve it in time.
WITHOUT_EFFECT = ("scene", "parameters", "outputs", "ensemble", "simulation.frames", "simulation.error_indicator")
OF_THE_MODEL = ("reduction", "simulation")
OF_RUNS = ("simulation", "simulation.initial", "initial")
_START = "simulation.initial"
MOST_ENTRIES, LONGEST_VALUE = 3, 24  # more entries, and longer values, are not spelled out: the file's name says more
_ABSENT = object()


def mechanism_key(record: RunRecord) -> tuple:
    """Return what results that belong together have in common: the scene's name and those of the mechanism's parts."""
    scene = scene_of(record)
    parts = (tuple(sorted(scene.get(part, {}))) for part in ("bodies", "joints", "coordinates"))
    return (scene.get("scene", {}).get("name", ""), *parts)


def read_scenes(
    files: Sequence[Path], readers: Mapping[str, type], done: str, **most: int
) -> tuple[list[list[tuple[Path, Any, str]]], list[str]]:
    """Return results with their files before and the programs' versions behind, one list a scene, in the order in which
    they come, and a line for each file given twice, of what is done once, or of a kind that there is no reader for. At
    `most` so many entries along a size are read. Raises `InputError` if a file is damaged, or all are of such kinds.
    """
    scenes: dict[tuple, list[tuple[Path, Any, str]]] = {}
    lines, seen = [], set()
    for path in files:
        if (real := os.path.realpath(path)) in seen:
            lines.append(f"{path} is given twice and {done} once")
            continue
        seen.add(real)
        kind = kind_of(path)
        if kind in KINDS and kind not in readers:
            lines.append(f"{path} holds {named(kind)} and is not {done}: see pgmp info")
            continue
        with open_file(path, readers) as file:
            program = str(file.attrs["program_version"])
        result = readers[kind].read(path, **most)
        scenes.setdefault(mechanism_key(result.record), []).append((path, result, program))
    if not scenes:
        open_file(files[0], readers)  # which says what there is to give
    return list(scenes.values()), lines


def same_case(one: RunRecord, other: RunRecord, ignored: Collection[str] = ()) -> bool:
    """Tell whether the runs of two models show the same case: equal parameters, but for the last digits, and scenes
    that differ in what concerns one model or the resolution in time alone, or in tables and entries that are ignored.
    """
    mine, theirs = one.parameters, other.parameters
    alike = (np.isclose(mine[name], theirs[name], rtol=1e-9, atol=0.0) for name in mine)
    equal = mine.keys() == theirs.keys() and all(alike)
    different = _differing([scene_of(one), scene_of(other)])
    return equal and not any(_counts(name, (*WITHOUT_EFFECT, *OF_THE_MODEL, *ignored)) for name, _ in different)


def tell_apart(
    records: Sequence[RunRecord],
    kinds: Sequence[str] = (),
    files: Sequence[Path | None] = (),
    ignored: Collection[str] = WITHOUT_EFFECT,
) -> list[str]:
    """Return for each result the words that tell it from the others; empty texts where there is one result alone.

    What else a result is, the model say, is told where `kinds` vary, and the file it comes from where nothing else
    differs; `ignored` tables and entries of scenes make no difference.
    """
    if len(records) < 2:
        return [""] * len(records)
    words = [[text] if text else [] for text in labels_by_parameters(records)]
    entries = [row for row in _differing([scene_of(record) for record in records]) if _counts(row[0], ignored)]
    for name, values in entries[:MOST_ENTRIES]:
        for text, value in zip(words, values):
            text.append(_entry(name, value))
    if kinds and len(set(kinds)) > 1:
        for text, kind in zip(words, kinds):
            text.insert(0, kind)
    if len({record.seed for record in records}) > 1:
        for text, record in zip(words, records):
            text.append(f"seed {'none' if record.seed is None else record.seed}")
    texts = [", ".join(filter(None, text)) for text in words]
    alone = len(entries) <= MOST_ENTRIES
    if alone and len(set(texts)) == len(texts) or not files or None in files:
        return texts
    return [
        text if texts.count(text) == 1 and alone else ", ".join(filter(None, (text, name)))
        for text, name in zip(texts, short_names(files))
    ]


def labels_by_parameters(records: Sequence[RunRecord]) -> list[str]:
    """Return for each run the parameters in which the runs differ; an empty text where they do not."""
    names = sorted({name for record in records for name in record.parameters})
    varied = [name for name in names if len({record.parameters.get(name) for record in records}) > 1]
    words = []
    for record in records:
        entries, known = scene_of(record).get("parameters", {}), [name for name in varied if name in record.parameters]
        units = (str(entries.get(name, {}).get("unit", "1")) for name in known)
        words.append(", ".join(quantity(name, record.parameters[name], unit) for name, unit in zip(known, units)))
    return words


def short_names(files: Sequence[Path]) -> list[str]:
    """Return the files' names, with as many of their directories as tell them apart."""
    absolute = [Path(os.path.abspath(file)).parts for file in files]
    for length in range(1, max(map(len, absolute)) + 1):
        names = [os.path.join(*parts[-length:]) for parts in absolute]
        if len(set(names)) == len(set(absolute)):
            break
    return names


def _differing(scenes: Sequence[Any], prefix: str = "") -> Iterator[tuple[str, list[Any]]]:
    """Yield dotted names of entries in which scenes differ, with every scene's value; a missing table as a whole."""
    for name in dict.fromkeys(name for scene in scenes for name in scene):
        values = [scene.get(name, _ABSENT) for scene in scenes]
        if all(isinstance(value, dict) for value in values):
            yield from _differing(values, f"{prefix}{name}.")
        elif any(value != values[0] for value in values):
            yield f"{prefix}{name}", values


def _counts(name: str, ignored: Collection[str]) -> bool:
    """Tell whether an entry makes a difference. How a run starts is no matter of its resolution in time."""
    if f"{name}.".startswith(f"{_START}."):
        return _START not in ignored
    return not any(f"{name}.".startswith(f"{table}.") for table in ignored)


def _entry(name: str, value: Any) -> str:
    """Return ``simulation.step = 0.001``, ``with effects.weight`` or ``without effects.weight``."""
    if value is _ABSENT:
        return f"without {name}"
    if isinstance(value, dict):
        return f"with {name}"
    if isinstance(value, float):
        return f"{name} = {value:.6g}"
    text = f"{name} = {str(value).lower() if isinstance(value, bool) else value}"
    # long values are all cut alike: names of files then tell the results apart
    return text if len(text) <= len(name) + LONGEST_VALUE else f"{name} = …"
