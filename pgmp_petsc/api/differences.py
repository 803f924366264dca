"""How far two results of the same kind are apart: of an output the largest difference, and where it is."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from pgmp_petsc.api.arguments import Range
from pgmp_petsc.api.declared import Argument, command
from pgmp_petsc.api.files import read
from pgmp_petsc.api.ranks import ranks_of
from pgmp_petsc.api.result import Result
from pgmp_petsc.base.errors import InputError, counted
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.files.claims import named
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.results.numbers import axis_unit, share_text
from pgmp_petsc.results.summary import plain


@dataclass(frozen=True)
class Difference:
    """The largest difference of an output; that of the second result less the first."""

    #: largest, unit: its value, unit
    largest: float
    unit: str
    #: of the output's largest magnitude in the first result; infinite where that is zero and the second's is not
    share: float
    place: float  # instant (s) of a run, number of the sample of an ensemble


@dataclass(frozen=True)
class Differences:
    """How far two results are apart."""

    kind: str  # ``trajectory`` or ``ensemble``
    compared: int  # number of instants, or of samples that are fine in both
    outputs: dict[str, Difference]  # by name, of outputs that both have
    #: what one of the two lacks, in words: outputs, the end of a run, samples that failed there alone
    lacking: tuple[str, ...]
    tolerance: float | None = None  # largest share that passes; None where any does

    @property
    def is_within(self) -> bool:
        """Whether no output differs by more than the tolerance, and nothing is lacking."""
        largest = max(one.share for one in self.outputs.values())
        return self.tolerance is None or (not self.lacking and largest <= self.tolerance)

    def summary(self) -> dict[str, object]:
        """Return its figures as plain data, those of ``pgmp diff --json``."""
        return plain(asdict(self) | {"is_within": self.is_within})


def _report(found: Differences, name: Path, said: object) -> str:
    where = {"trajectory": "s", "ensemble": "(sample)"}[found.kind]
    lines = [f"{found.compared} {'instants' if found.kind == 'trajectory' else 'samples that are fine in both'}"]
    for output, one in found.outputs.items():
        factor, unit = axis_unit(one.unit, np.array([one.largest]))
        share = "" if np.isinf(one.share) else f" ({share_text(one.share)} of its largest value)"
        lines.append(f"  {output:24s}{factor * one.largest:+14.6g} {unit} at {one.place:g} {where}{share}")
    return "\n".join([*lines, *(f"  {text}" for text in found.lacking)])


@command(
    "diff", "Largest differences of the outputs of two results.", 175, petsc=False, report=_report,
    status=lambda found: int(not found.is_within),
    first=Argument("Run or ensemble, or its file.", word="A.h5"),
    second=Argument("Another one, of the same kind.", word="B.h5"),
    tolerance=Argument(
        "End with status 1 if an output differs by more than this share of its largest value in A.h5, or if one of "
        "the two lacks an output, the end of the run, or a sample that is fine in the other.", word="SHARE",
        allowed=Range(0.0),
    ),
    gives="By output.",
)  # fmt: skip
def diff(
    first: Result | str | PathLike[str],
    second: Result | str | PathLike[str],
    *,
    tolerance: float | None = None,
    comm: Comm | None = None,
) -> Differences:
    """Compare the outputs of `first` and `second`: two runs over time, or two ensembles of the same samples.

    Runs are compared at the instants of the one that has fewer, in the time that both cover; the other is interpolated
    linearly between its own. Ensembles are compared sample by sample at the end.
    """
    comm = ranks_of(comm)
    a, b = (one if isinstance(one, Result) else read(one, comm=comm) for one in (first, second))
    with agreed(comm, "comparing the results"):
        for one, name in ((a, first), (b, second)):
            if one.kind not in ("trajectory", "ensemble"):
                raise InputError(f"{_called(name)}: {named(one.kind)}; two runs or two ensembles can be compared")
        if a.kind != b.kind:
            raise InputError(f"{named(a.kind)} ({_called(first)}) and {named(b.kind)} ({_called(second)}): two kinds")
        common = [name for name in a.outputs if name in b.outputs]
        if not common:
            raise InputError(f"{_called(first)} and {_called(second)} have no output in common")
        places, of_a, of_b, lacking = _runs(a, b, common) if a.kind == "trajectory" else _samples(a, b, common)
        if not places.size:
            raise InputError(f"{_called(first)} and {_called(second)} have no instant, or no fine sample, in common")
        found = {name: _largest(of_a[name], of_b[name], a.units[name], places) for name in common}
        lacking += [f"output {name} is in one of the two" for name in sorted({*a.outputs} ^ {*b.outputs})]
        return Differences(a.kind, len(places), found, tuple(lacking), tolerance)


Columns = dict[str, np.ndarray]


def _called(result: Result | str | PathLike[str]) -> str:
    return f"'{(result.path or 'a result without a file') if isinstance(result, Result) else result}'"


def _runs(a: Result, b: Result, names: list[str]) -> tuple[np.ndarray, Columns, Columns, list[str]]:
    """Return the instants (n,) at which two runs are compared, s, their outputs there, and what one lacks."""
    coarse = min((a.time, b.time), key=len)
    # the last instants of two steps may differ by round-off
    begin, end = max(a.time[0], b.time[0]), min(a.time[-1], b.time[-1]) * (1.0 + 1e-12)
    time = coarse[(coarse >= begin) & (coarse <= end)]
    of_a, of_b = ({name: np.interp(time, one.time, one.outputs[name]) for name in names} for one in (a, b))
    last = max(a.time[-1], b.time[-1])
    return time, of_a, of_b, [f"one of the two ends at {end:g} s, the other at {last:g} s"] if last > end else []


def _samples(a: Result, b: Result, names: list[str]) -> tuple[np.ndarray, Columns, Columns, list[str]]:
    """Return the numbers (n,) of the samples that are fine in both ensembles, their outputs, and what one lacks."""
    same = len(a.status) == len(b.status) and {*a.parameters} == {*b.parameters}
    if not same or any(not np.array_equal(a.parameters[name], b.parameters[name]) for name in a.parameters):
        why = "they are not of the same values of parameters; give two of one scene, number and seed"
        raise InputError(f"ensembles of {len(a.status)} and {len(b.status)} samples: {why}")
    fine = np.flatnonzero((a.status == 0) & (b.status == 0))
    of_a, of_b = ({name: np.asarray(one.outputs[name])[fine] for name in names} for one in (a, b))
    n = int(np.sum((a.status == 0) != (b.status == 0)))
    return fine, of_a, of_b, [f"{counted(n, 'sample')} failed in one of the two"] if n else []


def _largest(a: np.ndarray, b: np.ndarray, unit: str, places: np.ndarray) -> Difference:
    away = b - a
    k, scale = int(np.argmax(np.abs(away))), float(np.max(np.abs(a)))
    share = abs(away[k]) / scale if scale > 0.0 else (np.inf if away[k] else 0.0)
    return Difference(float(away[k]), unit, float(share), float(places[k]))
