"""What the reader of a picture has to know besides: runs that ended early, and warnings that come with results."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from matplotlib.artist import Artist
from matplotlib.figure import Figure

from pgmp_petsc.figures.style import heading, scene_of, top_legend
from pgmp_petsc.results import Trajectory
from pgmp_petsc.runtime.files import RunRecord

# A picture has room for so many, of so many characters; the files have the rest.
MOST, LONGEST = 3, 220


def planned_end(run: Trajectory) -> float:
    """Return the instant (s) at which the scene ends, the run's own end where it says none."""
    try:
        return max(float(scene_of(run.record)["simulation"]["duration"]), float(run.time[-1]))
    except (KeyError, TypeError, ValueError):
        return float(run.time[-1])


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


def headed(figure: Figure, keys: Sequence[Artist], what: str, record: RunRecord, label: str = "") -> None:
    """Put what a picture of one result shows above it, the warnings that come with the result, and rows of keys."""
    top_legend(figure, keys, heading(what, record, label), of_records([record]))


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
    return [*shown, f"and {left} more warnings: see pgmp info"] if left else shown


def _short(text: str) -> str:
    """Return as many clauses of a warning as a picture has room for, the first one at least."""
    if len(text) <= LONGEST:
        return text
    end = max(text.rfind(mark, 0, LONGEST) for mark in ("; ", ": ", ". "))
    return f"{text[:end]} …" if end > 0 else textwrap.shorten(text, LONGEST, placeholder=" …")


def _labelled(text: str, label: str) -> str:
    return f"{label}: {text}" if label else text
