"""The error budget of a scene's results: every source of error with its size and how it is known, or that it is not."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pgmp_petsc.figures.style import MODELS, axis_unit, scene_of
from pgmp_petsc.figures.trajectories import Comparison
from pgmp_petsc.report.sources import Build, Datum, Sentence, Source, in_words
from pgmp_petsc.results import Ensemble, Tradeoff, Trajectory
from pgmp_petsc.results.errors import OF_STEP, VALIDITY, EstimatedErrors, limits_of
from pgmp_petsc.results.numbers import percent, share_text
from pgmp_petsc.results.statistics import DOUBT

PARTS = {"basis": "basis", "interpolation": "interpolation", "step": "time step"}


@dataclass(frozen=True)
class Line:
    """A line of the budget.

    Attributes
    ----------
    what
        Source of error.
    size
        How large it is; empty where that is not known.
    how
        How it is known, or what would tell.
    """

    what: str
    size: Sentence
    how: str


@dataclass(frozen=True)
class ModelError:
    """How far reduced outputs are from those of a better model.

    Attributes
    ----------
    shares
        Of every output, as a share of its largest value; NaN where it is not known.
    how
        How it is known.
    datums
        The same as figures of the page.
    with_step
        The estimate that knows of the time step too, where this error does not; None otherwise.
    at_end
        As `shares`, at the end of the run alone.
    doubt
        So many times as large are no more than 5 % of errors.
    absent
        Why outputs have no estimate, those that have none.
    whole
        Whether it is of the whole run, and not of a part, beyond which it may be of any size.
    """

    shares: dict[str, float]
    how: str
    datums: dict[str, Datum]
    with_step: ModelError | None = None
    at_end: dict[str, float] = field(default_factory=dict)
    doubt: float = 1.0
    absent: Mapping[str, str] = field(default_factory=dict)
    whole: bool = True

    @property
    def worst(self) -> str | None:
        """The output with the largest error; None where none is known."""
        known = {name: share for name, share in self.shares.items() if np.isfinite(share)}
        return max(known, key=known.__getitem__) if known else None

    def bound(self, output: str, when: str) -> float:
        """Return what an output's error hardly exceeds, ``ever`` or at the ``end``, as a share; NaN if not known.

        What was measured over a part of the run counts beside an estimate of all of it only.
        """
        shares = self.at_end if when == "end" else self.shares
        further = np.nan if self.with_step is None else self.with_step.bound(output, when)
        counts = self.whole or (when == "ever" and np.isfinite(further))
        return float(np.fmax(self.doubt * shares.get(output, np.nan), further) if counts else further)


def model_error(sources: Sequence[Source], comparisons: Sequence[Comparison]) -> ModelError | None:
    """Return the error of the reduced model: measured where runs of a better one are there, else estimated."""
    estimated = _estimated(sources)
    return _measured(comparisons, estimated) or estimated


def _measured(comparisons: Sequence[Comparison], estimated: ModelError | None) -> ModelError | None:
    """Return the difference from the first run of a better model, and the estimate where that knows of more."""
    for comparison in comparisons:
        if comparison.full is not None and comparison.reduced is not None:
            shares, at_end = {}, {}
            for name in comparison.reduced.outputs:
                found = comparison.error_percent(name) if name in comparison.full.outputs else None
                shares[name] = float("nan") if found is None else float(np.max(found[1]) / 100.0)
                at_end[name] = float("nan") if found is None else float(found[1][-1] / 100.0)
            models = f"{MODELS[comparison.reduced.model]} against {MODELS[comparison.full.model]}"
            how = f"measured: {models}, {comparison.part}"
            alike = comparison.same_steps
            if alike:
                how += " and at the same time step; the time-step error is not included"
            datums = {name: Datum(v, share_text(v)) for name, v in shares.items()}
            known = estimated if alike else None
            return ModelError(shares, how, datums, known, at_end, whole=comparison.is_whole)
    return None


def _estimated(sources: Sequence[Source]) -> ModelError | None:
    """Return the estimate of the first run that has one."""
    for source in sources:
        errors = source.result.errors if isinstance(source.result, Trajectory) else None
        if errors is not None and errors.what != OF_STEP:
            shares = {name: errors.share(name) for name in errors.outputs}
            how = "estimated from a run with smaller steps and residuals of the full-order equations, over the run"
            datums = {
                name: Datum(share, share_text(share), source.name, f"/errors/{name}@share")
                for name, share in shares.items()
            }
            ends = {name: abs(float(values[-1])) / errors.largest[name] if errors.largest[name] > 0.0 else float("nan")
                    for name, values in errors.outputs.items()}  # fmt: skip
            return ModelError(shares, how, datums, at_end=ends, doubt=DOUBT, absent=errors.absent)
    return None


def error_budget(sources: Sequence[Source], error: ModelError | None) -> list[Line]:
    """Return the lines of the budget of one scene."""
    studies = [source for source in sources if isinstance(source.result, Tradeoff)]
    builds = [source.result for source in sources if isinstance(source.result, Build)]
    return [
        *_of_model(sources, error),
        *_of_steps(sources),
        *_of_parts(builds),
        *_of_mesh(studies),
        *_of_sampling(sources),
        *_of_balance(sources),
        *_of_small_deformations(sources),
    ]


def _of_model(sources: Sequence[Source], error: ModelError | None) -> Iterator[Line]:
    """Yield what reduction and step do to outputs, in single runs and in ensembles."""
    models = {source.result.model for source in sources if isinstance(source.result, (Trajectory, Ensemble))}
    if error is not None and error.worst is not None:
        for what, one in (("model", error), ("model and time step", error.with_step)):
            for name, share in () if one is None else sorted(one.shares.items(), key=_largest_first):
                how = f"not estimated: {one.absent[name]}" if name in one.absent else one.how
                yield Line(f"{what}: {in_words(name)}", [one.datums[name]] if np.isfinite(share) else [], how)
    elif "reduced" in models:
        here = "is here" if models == {"reduced"} else "goes far enough to compare with"
        how = f"no run of a better model {here}, and errors were not estimated; see the notes for the reason"
        yield Line("model", [], f"{how}, or run pgmp simulate SCENE --full and add its file")
    elif models:
        kinds = " and ".join(MODELS[model] for model in sorted(models))
        if models == {"full"}:
            yield Line("model", ["none"], f"{kinds}: nothing was reduced")
        else:
            yield Line("model", [], f"add a full-order run of the same scene: nothing tells it of {kinds}")
    for source in sources:
        result = source.result
        if not isinstance(result, Ensemble):
            continue
        for name, values in result.errors.items():
            known = values[np.isfinite(values)]
            if not known.size:
                continue
            place = int(np.nanargmax(values))
            factor, unit = axis_unit(result.units.get(name, "1"), known)
            median = float(np.median(known))
            largest = Datum(known.max(), f"{factor * known.max():.2g}", source.name, f"/errors/{name}", str(place))
            size = ["median ", Datum(median, f"{factor * median:.2g}"), ", largest ", largest]
            size.append("" if unit == "1" else f" {unit}")
            yield Line(
                f"model, in samples: {in_words(name)}", size, f"estimated for {known.size} of {len(values)} samples"
            )


def _of_steps(sources: Sequence[Source]) -> Iterator[Line]:
    """Yield what the time step does to outputs of full-order and component runs."""
    for source, errors in step_errors(sources):
        run = source.result
        part = "" if errors.time[-1] >= run.time[-1] * (1.0 - 1e-9) else f", up to {errors.time[-1]:.4g} s only"
        for name in errors.outputs:
            share = errors.share(name)
            size = [Datum(share, share_text(share), source.name, f"/errors/{name}@share")] if np.isfinite(share) else []
            what = f"time step, {MODELS[run.model]}: {in_words(name)}"
            yield Line(what, size, f"estimated from a run with a coarser step{part}")


def step_errors(sources: Sequence[Source]) -> Iterator[tuple[Source, EstimatedErrors]]:
    """Yield the runs that know the errors of their time step alone, and these."""
    for source in sources:
        errors = source.result.errors if isinstance(source.result, Trajectory) else None
        if errors is not None and errors.what == OF_STEP:
            yield source, errors


def _largest_first(item: tuple[str, float]) -> float:
    """Return the key by which errors that are not known come last."""
    return -float(np.nan_to_num(item[1], nan=-1.0))


def _of_parts(builds: Sequence[Build]) -> Iterator[Line]:
    """Yield what was measured when the reduction was chosen by a tolerance, part by part."""
    chosen = next((build.selection for build in builds if build.selection is not None), None)
    unknown = []
    for part, words in PARTS.items():
        limit = np.inf if chosen is None else chosen.allowed.get(part, np.inf)
        tried = [] if chosen is None else [a for a in chosen.attempts if a.part == part and a.largest <= limit]
        if not tried:
            unknown.append(words)
            continue
        last = tried[-1]
        allowed = f", allowed {share_text(limit)}" if np.isfinite(limit) else ""
        how = f"measured at the build{allowed}: {last.where}"
        yield Line(words, [Datum(last.largest, share_text(last.largest))], how)
    if unknown:
        how = "not known apart from each other: build with reduction.tolerance, or add a file of pgmp tradeoff"
        yield Line(", ".join(unknown), [], how)


def _of_mesh(studies: Sequence[Source]) -> Iterator[Line]:
    """Yield the discretisation error."""
    for source in studies:
        mesh = source.result.mesh
        own = np.flatnonzero(mesh.refinement == 1)
        if own.size and len(mesh.refinement) > 1:
            for column, name in enumerate(source.result.outputs):
                value = float(mesh.errors[own[0], column])
                datum = Datum(value, share_text(value), source.name, "/mesh/errors", f"{own[0]},{column}")
                how = f"measured: {mesh.cells[own[0]]} cells against {mesh.cells[-1]}"
                yield Line(f"mesh: {in_words(name)}", [datum], how)
            return
    yield Line("mesh", [], "pgmp tradeoff measures it for meshes of lines; compare solids with a finer mesh")


def _of_sampling(sources: Sequence[Source]) -> Iterator[Line]:
    """Yield the half widths of intervals."""
    for source in sources:
        result = source.result
        if not isinstance(result, Ensemble):
            continue
        for label, chance in result.probabilities.items():
            half = 0.5 * float(chance.interval[1] - chance.interval[0])
            size = [Datum(half, f"± {100 * half:.2g} percentage points")] if np.isfinite(half) else []
            how = f"{percent(chance.confidence)} interval of {chance.of}"
            yield Line(f"sampling: P({label})", size, how)
        for name in result.outputs:
            s = result.statistics.get(name)
            if s is not None and np.isfinite(s.mean_interval).all() and not s.constant:
                half = 0.5 * float(s.mean_interval[1] - s.mean_interval[0])
                factor, unit = axis_unit(result.units.get(name, "1"), np.array([half]))
                size = [Datum(half, f"± {factor * half:.2g}"), "" if unit == "1" else f" {unit}"]
                how = f"{percent(s.confidence)} interval of {s.count} samples"
                yield Line(f"sampling: mean of {in_words(name)}", size, how)


def _of_balance(sources: Sequence[Source]) -> Iterator[Line]:
    """Yield what is left over of the balances of energy."""
    for source in sources:
        balance = source.result.balance if isinstance(source.result, Trajectory) else None
        if balance is not None and balance.exchanged > 0.0:
            largest = float(np.abs(balance.residual).max()) / balance.exchanged
            size = [Datum(largest, share_text(largest)), " of what is moved around"]
            yield Line(f"balance of energy: {source.name}", size, "of the time step; numerical damping is a part of it")


def _of_small_deformations(sources: Sequence[Source]) -> Iterator[Line]:
    """Yield how far single runs left small deformations, for which the models are made."""
    for source in sources:
        result = source.result
        if not isinstance(result, Trajectory):
            continue
        scene = scene_of(result.record)
        stiffened = any(effect.get("type") == "geometric_stiffening" for effect in scene.get("effects", {}).values())
        limits = limits_of(stiffened or bool(scene.get("reduction", {}).get("second_order")))
        for name, value in result.validity.items():
            if np.isfinite(value):
                unit, about = VALIDITY[name]
                size = [
                    Datum(value, f"{value:.2g}", source.name, f"/validity/{name}"),
                    "" if unit == "1" else f" {unit}",
                ]
                limit = limits[name]
                beyond = "no limit" if np.isinf(limit) else f"worth a warning beyond {limit:g}"
                yield Line(f"small deformations: {name.replace('_', ' ')}", size, f"{about}; {beyond}")
