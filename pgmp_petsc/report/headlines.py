"""What is in a result file, in one line: for a command that goes through many steps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pgmp_petsc.figures.style import MODELS
from pgmp_petsc.figures.trajectories import Comparison
from pgmp_petsc.report.sources import Build
from pgmp_petsc.report.verdict import MUCH_MORE
from pgmp_petsc.results import Ensemble, Trajectory
from pgmp_petsc.results.errors import OF_STEP
from pgmp_petsc.results.numbers import interval_text, number_text, share_text
from pgmp_petsc.runtime.errors import counted
from pgmp_petsc.runtime.files import RunRecord


def headline_of_build(path: Path) -> str:
    """Return what was chosen for a reduced model and how long it took."""
    build = Build.read(path)
    chosen = {} if build.selection is None else dict(build.selection.chosen)
    what = ", ".join(f"{name} = {value}" for name, value in chosen.items()) or "as the scene says"
    return f"{what}; {_seconds(build.record)}{_remarks(build.record)}"


def headline_of_run(path: Path) -> str:
    """Return how far a run came and what is known of its error."""
    run = Trajectory.read(path)
    known = {} if run.errors is None else {name: run.errors.share(name) for name in run.errors.outputs}
    known = {name: share for name, share in known.items() if np.isfinite(share)}
    error = "errors were not estimated"
    if known:
        worst = max(known, key=known.__getitem__)
        of = " of the time step" if run.errors.what == OF_STEP else ""
        part = f" up to {run.errors.time[-1]:.4g} s" if of and run.errors.time[-1] < run.time[-1] * (1.0 - 1e-9) else ""
        error = f"estimated error{of}{part} at most {share_text(known[worst])} ({worst})"
    elif run.model == "full":
        error = "nothing was reduced"
    return f"{MODELS[run.model]}, {len(run.time) - 1} steps to {run.time[-1]:g} s; {error}{_remarks(run.record)}"


def headline_of_comparison(path: Path, better: Path) -> str:
    """Return by how much a run differs from that of a better model."""
    run, other = Trajectory.read(path), Trajectory.read(better)
    comparison = Comparison(other, run)
    found = {name: comparison.error_percent(name) for name in run.outputs if name in other.outputs}
    known = {name: error for name, error in found.items() if error is not None and np.isfinite(error[1]).all()}
    if not known:
        if comparison.covered == 0.0:
            stopped = [MODELS[one.model] for one in comparison.runs if len(one.time) < 2]
            runs = f"{' and '.join(stopped)} run{'s' if len(stopped) > 1 else ''}"
            return f"nothing is compared: the {runs} did no step"
        return f"{MODELS[other.model]}: its outputs are zero or not known, so no share can be given"
    worst = max(known, key=lambda name: np.max(known[name][1]))
    time, error = known[worst]
    alike = ", with the same time step," if comparison.same_steps else ""
    share, when = np.max(error) / 100.0, f"{time[np.argmax(error)]:.4g} s"
    words = (
        f"differs from {MODELS[other.model]}{alike} by at most {share_text(share)} of the largest {worst}, at {when}"
    )
    if comparison.part != "over the run":
        words += f"; compared {comparison.part}"
    knows = comparison.same_steps and run.errors is not None and run.errors.what != OF_STEP
    estimated = run.errors.outputs if knows else ()
    own = run.errors.share(worst) if worst in estimated else np.nan
    if MUCH_MORE * own < share:
        words += f"; {share_text(own)} is estimated to be the {MODELS[run.model]} run's"
        words += ", the rest the time step's in the other"
    return words


def headline_of_ensemble(path: Path) -> str:
    """Return how many samples are fine, and the probability of the scene's first event or an output's mean."""
    ensemble = Ensemble.read(path)
    failed = int(np.count_nonzero(ensemble.status))
    parts = [f"{len(ensemble.status)} samples, {failed} failed"]
    for chance in list(ensemble.probabilities.values())[:1]:
        ends = 100.0 * chance.interval
        known = f"= {number_text(100 * chance.estimate, ends, 6)} % {interval_text(ends)}"
        known = f"is not known {interval_text(ends)} %" if np.isnan(chance.estimate) else known
        parts.append(f"P({chance.event}) {known if chance.is_decided() else f'is {chance.doubt()}'}")
    if not ensemble.probabilities:
        for name in list(ensemble.outputs)[-1:]:
            s = ensemble.statistics[name]
            unit = ensemble.units.get(name, "1")
            mean = f"{number_text(s.mean, s.mean_interval, 7)} {interval_text(s.mean_interval)}"
            mean = f"{s.mean:.7g}, constant" if s.constant else mean
            parts.append(f"mean {name} {mean}{'' if unit == '1' else ' ' + unit}")
    return f"{'; '.join(parts)}{_remarks(ensemble.record)}"


def _seconds(record: RunRecord) -> str:
    return f"{sum(record.timings.values()):.3g} s"


def _remarks(record: RunRecord) -> str:
    """Return how many warnings a result has; the report has their texts."""
    n = sum(remark.kind == "warning" for remark in record.remarks)
    return f"; {counted(n, 'warning')}, see the report" if n else ""
