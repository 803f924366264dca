"""How far a scene's results are to be trusted: the error budget, every source of error with its size and how it is
known, or that it is not; the verdict in words, what happens how surely, how far off the model is and what went wrong;
and a file's headline, for a command that goes through many steps."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pgmp_petsc.base.errors import counted
from pgmp_petsc.base.units import behind
from pgmp_petsc.figures import style
from pgmp_petsc.figures.motion import WORDS
from pgmp_petsc.figures.style import MODELS, axis_unit, same_case, scene_of
from pgmp_petsc.figures.trajectories import Comparison, paired
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.report.film import stress_of
from pgmp_petsc.report.sources import (
    Build,
    Datum,
    Place,
    Sentence,
    Source,
    chance_of,
    failed_of,
    mean_of,
    of_kind,
    read_sources,
)
from pgmp_petsc.results import Ensemble, Tradeoff, Trajectory
from pgmp_petsc.results.ensemble import DOUBT, OF_TIME_STEP, RareEvent
from pgmp_petsc.results.estimates import LARGE, OF_STEP, VALIDITY, EstimatedErrors, limits_of
from pgmp_petsc.results.numbers import end_texts, interval_text, number_text, percent, plain, share_text
from pgmp_petsc.results.trajectory import truncated

PARTS = {"basis": "basis", "interpolation": "interpolation", "step": "time step"}


@dataclass(frozen=True)
class Line:
    """A line of the budget."""

    what: str  # source of error
    size: Sentence  # how large it is; empty where that is not known
    how: str  # how it is known, or what would tell


@dataclass(frozen=True)
class ModelError:
    """How far reduced outputs are from those of a better model."""

    shares: dict[str, float]  # of every output, as a share of its largest value; NaN where it is not known
    how: str  # how it is known
    datums: dict[str, Datum]  # the same as figures of the page
    #: the estimate that knows of the time step too, where this error does not; None otherwise
    with_step: ModelError | None = None
    at_end: dict[str, float] = field(default_factory=dict)  # as `shares`, at the end of the run alone
    doubt: float = 1.0  # so many times as large are no more than 5 % of errors
    absent: Mapping[str, str] = field(default_factory=dict)  # why outputs have no estimate, those that have none
    whole: bool = True  # whether it is of the whole run, and not of a part, beyond which it may be of any size
    mesh: Mapping[str, float] = field(default_factory=dict)  # the mesh's besides, as a share
    largest: Mapping[str, float] = field(default_factory=dict)  # value of every output that shares are of

    @property
    def worst(self) -> str | None:
        """The output with the largest error; None where none is known."""
        return _worst(self.shares)

    def bound(self, output: str, when: str) -> float:
        """Return what an output's error hardly exceeds, ``ever`` or at the ``end``, as a share; NaN if not known.

        What was measured over a part of the run counts beside an estimate of all of it only.
        """
        shares = self.at_end if when == "end" else self.shares
        further = np.nan if self.with_step is None else self.with_step.bound(output, when)
        counts = self.whole or (when == "ever" and np.isfinite(further))
        known = np.fmax(self.doubt * shares.get(output, np.nan), further) if counts else further
        return float(known + self.mesh.get(output, 0.0))


def _worst(shares: Mapping[str, float]) -> str | None:
    known = {name: share for name, share in shares.items() if np.isfinite(share)}
    return max(known, key=known.__getitem__) if known else None


def model_error(sources: Sequence[Source], comparisons: Sequence[Comparison]) -> ModelError | None:
    """Return the error of the reduced model: measured where runs of a better one are there, else estimated."""
    estimated = _estimated(sources)
    found = _measured(comparisons, estimated) or estimated
    return None if found is None else replace(found, mesh=own_of_mesh(sources))


def _measured(comparisons: Sequence[Comparison], estimated: ModelError | None) -> ModelError | None:
    """Return the difference from the first run of a better model, and the estimate where that knows of more."""
    for comparison in comparisons:
        full, reduced, alike = comparison.full, comparison.reduced, comparison.same_steps
        if full is not None and reduced is not None:
            errors = {n: comparison.error_percent(n) if n in full.outputs else None for n in reduced.outputs}
            percents = {name: np.full(1, np.nan) if one is None else one[1] for name, one in errors.items()}
            shares = {name: float(np.max(values)) / 100.0 for name, values in percents.items()}
            at_end = {name: float(values[-1]) / 100.0 for name, values in percents.items()}
            how = f"measured: {MODELS[reduced.model]} against {MODELS[full.model]}, {comparison.part}"
            if alike:
                how += " and at the same time step; the time-step error is not included"
            return ModelError(
                shares, how, {name: Datum(v, share_text(v)) for name, v in shares.items()},
                estimated if alike else None, at_end, whole=comparison.is_whole,
                largest={name: float(np.max(np.abs(np.nan_to_num(x)))) for name, x in full.outputs.items()},
            )  # fmt: skip
    return None


def _estimated(sources: Sequence[Source]) -> ModelError | None:
    """Return the estimate of the first run that has one."""
    for source in sources:
        errors = source.result.errors if isinstance(source.result, Trajectory) else None
        if errors is not None and errors.what != OF_STEP:
            shares = {name: errors.share(name) for name in errors.outputs}
            how = "estimated from a run with smaller steps and residuals of the full-order equations, over the run"
            datums = {name: _share(source, name) for name in shares}
            ends = {name: abs(float(values[-1])) / errors.largest[name] if errors.largest[name] > 0.0 else float("nan")
                    for name, values in errors.outputs.items()}  # fmt: skip
            return ModelError(
                shares, how, datums, at_end=ends, doubt=DOUBT, absent=errors.absent, largest=errors.largest
            )
    return None


def _share(source: Source, name: str) -> Datum:
    share = source.result.errors.share(name)
    return Datum(share, share_text(share), source.name, f"/errors/{name}@share")


def error_budget(sources: Sequence[Source], error: ModelError | None) -> list[Line]:
    return [
        *_of_model(sources, error),
        *_of_steps(sources),
        *_of_parts(sources),
        *_of_mesh(sources),
        *_of_sampling(sources),
        *_of_balance(sources),
        *_of_small_deformations(sources),
    ]


def _of_model(sources: Sequence[Source], error: ModelError | None) -> Iterator[Line]:
    """Yield what reduction and step do to outputs, in single runs and in ensembles."""
    models = {_model_of(source) for source in sources} - {None}
    if error is not None and error.worst is not None:
        for what, one in (("model", error), ("model and time step", error.with_step)):
            known = {} if one is None else one.shares
            # those that are not known come last
            for name, share in sorted(known.items(), key=lambda item: -float(np.nan_to_num(item[1], nan=-1.0))):
                how = f"not estimated: {one.absent[name]}" if name in one.absent else one.how
                yield Line(f"{what}: {name}", [one.datums[name]] if np.isfinite(share) else [], how)
    elif "reduced" in models:
        here = "is here" if models == {"reduced"} else "goes far enough to compare with"
        how = f"no run of a better model {here}"
        if not any(np.isfinite(x).any() for one in of_kind(sources, Ensemble) for x in one.result.errors.values()):
            how += ", and errors were not estimated; see the notes for the reason"
        yield Line("model", [], f"{how}; run pgmp simulate SCENE --full and add its file")
    elif models:
        kinds = " and ".join(MODELS[model] for model in sorted(models))
        if models == {"full"}:
            yield Line("model", ["none"], f"{kinds}: nothing was reduced")
        else:
            yield Line("model", [], f"add a full-order run of the same scene: nothing tells it of {kinds}")
    for source in of_kind(sources, Ensemble):
        for name, values in source.result.errors.items():
            known = values[np.isfinite(values)]
            if not known.size:
                continue
            (largest, factor, unit), median = _largest_error(source, name), float(np.median(known))
            size = ["median ", Datum(median, plain(factor * median)), ", largest ", largest, unit]
            n_unsure = int(np.sum(source.result.errors_unsure.get(name, np.zeros(1)) == 1.0))
            how = f"estimated for {known.size} of {len(values)} samples{f', unsure in {n_unsure}' * bool(n_unsure)}"
            what = "model" if source.result.model == "reduced" else "time step"
            yield Line(f"{what}, in samples: {name}", size, how)


def _model_of(source: Source) -> str | None:
    """Return the model of a run or an ensemble; None of other results."""
    return source.result.model if isinstance(source.result, (Trajectory, Ensemble)) else None


def _of_steps(sources: Sequence[Source]) -> Iterator[Line]:
    """Yield what the time step does to outputs of full-order and component runs."""
    for source, errors in step_errors(sources):
        run = source.result
        part = f", up to {errors.time[-1]:.4g} s only" if errors.end_before(run.time[-1]) else ""
        for name in errors.outputs:
            size = [_share(source, name)] if np.isfinite(errors.share(name)) else []
            what = f"time step, {MODELS[run.model]}: {name}"
            yield Line(what, size, f"estimated from a run with a coarser step{part}")


def step_errors(sources: Sequence[Source]) -> Iterator[tuple[Source, EstimatedErrors]]:
    """Yield the runs that know the errors of their time step alone, and these; not runs on other meshes beside them."""
    twins = [other for _, other in mesh_twins(sources)]
    for source in (source for source in sources if source not in twins):
        errors = source.result.errors if isinstance(source.result, Trajectory) else None
        if errors is not None and errors.what == OF_STEP:
            yield source, errors


def _of_parts(sources: Sequence[Source]) -> Iterator[Line]:
    """Yield what was measured when the reduction was chosen by a tolerance, part by part; without a reduced model there
    is the time step alone."""
    if not any(isinstance(one.result, Build) or _model_of(one) in ("reduced", None) for one in sources):
        if next(step_errors(sources), None) is None:
            yield Line("time step", [], "not estimated; add a run of pgmp simulate, with simulation.error_indicator")
        return
    builds = [source.result for source in sources if isinstance(source.result, Build)]
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


def mesh_twins(sources: Sequence[Source]) -> list[tuple[Source, Source]]:
    """Return runs with later ones of the same model and case on another mesh, of which they have other numbers of
    nodes."""
    runs, found = of_kind(sources, Trajectory), list[tuple[Source, Source]]()
    for number, other in enumerate(runs):
        for own in runs[:number]:
            bodies = scene_of(own.record).get("bodies", {})
            meshes = [f"bodies.{body}.{entry}" for body in bodies for entry in ("mesh", "mesh_size", "faces")]
            alike = own.result.model == other.result.model and same_case(own.record, other.record, meshes)
            if alike and n_nodes(own.result) != n_nodes(other.result):
                found.append((own, other))
                break
    return found


#: the scene's own error over the difference from a mesh of twice the elements, which is of second order in their size
OWN_OF_MESH = 4.0 / 3.0


def mesh_errors(sources: Sequence[Source]) -> dict[str, tuple[float, float, str]]:
    """Return the difference of a run on another mesh, the scene's own error by that, both shares of the largest value,
    and how it was measured, by output; the largest one of several. Of a coarser mesh the scene's own is less."""
    found: dict[str, tuple[float, float, str]] = {}
    for own, other in mesh_twins(sources):
        coarse, fine = sorted((own.result, other.result), key=n_nodes)
        is_own = coarse is own.result
        whose = "" if is_own else "; of the coarser mesh, the scene's own is less"
        how = f"{n_nodes(coarse)} nodes against {n_nodes(fine)}, {MODELS[coarse.model]}{whose}"
        for name in own.result.outputs:
            error = Comparison(fine, coarse).error_percent(name) if name in other.result.outputs else None
            if error is not None:
                share = float(np.max(error[1]) / 100.0)
                one = share, share * (OWN_OF_MESH if is_own else 1.0), how
                found[name] = max(found.get(name, one), one)
    return found


def own_of_mesh(sources: Sequence[Source]) -> dict[str, float]:
    """Return the errors of the scene's own mesh, as shares, of the outputs of which they are known."""
    return {name: own for name, (_, own, _) in mesh_errors(sources).items()}


def n_nodes(run: Trajectory) -> int:
    """Return the number of nodes of all bodies of a run, as its frames know them; 0 without frames."""
    frames = {} if run.frames is None else run.frames.nodes
    return sum(len(run.fields[name].nodes if name in run.fields else nodes) for name, nodes in frames.items())


def _of_mesh(sources: Sequence[Source]) -> Iterator[Line]:
    measured = mesh_errors(sources)
    for name, (share, _, how) in measured.items():
        yield Line(f"mesh: {name}", [Datum(share, share_text(share))], f"measured: {how}")
    if measured:
        return
    for source in of_kind(sources, Tradeoff):
        mesh = source.result.mesh
        own = np.flatnonzero(mesh.refinement == 1)
        if own.size and len(mesh.refinement) > 1:
            for column, name in enumerate(source.result.outputs):
                value = float(mesh.errors[own[0], column])
                datum = Datum(value, share_text(value), source.name, "/mesh/errors", f"{own[0]},{column}")
                how = f"measured: {mesh.cells[own[0]]} cells against {mesh.cells[-1]}"
                yield Line(f"mesh: {name}", [datum], how)
            return
    bodies = [body for source in sources for body in scene_of(source.record).get("bodies", {}).values()]
    if not bodies or any(body.get("flexible", True) for body in bodies):
        how = "add a run of the same model with another mesh (--override bodies.NAME.mesh=FILE)"
        yield Line("mesh", [], f"{how}; pgmp run does so for lines")
    else:
        yield Line("mesh", ["none"], "no body deforms")


def _of_sampling(sources: Sequence[Source]) -> Iterator[Line]:
    for source in of_kind(sources, Ensemble):
        result = source.result
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
                size = [Datum(half, f"± {plain(factor * half)}"), behind(unit)]
                how = f"{percent(s.confidence)} interval of {s.count} samples"
                yield Line(f"sampling: mean of {name}", size, how)


def _of_balance(sources: Sequence[Source]) -> Iterator[Line]:
    for source in sources:
        balance = source.result.balance if isinstance(source.result, Trajectory) else None
        if balance is not None and balance.exchanged > 0.0:
            largest = float(np.abs(balance.residual).max()) / balance.exchanged
            size = [Datum(largest, share_text(largest)), " of what is moved around"]
            yield Line(f"balance of energy: {source.name}", size, "of the time step; numerical damping is a part of it")


def _of_small_deformations(sources: Sequence[Source]) -> Iterator[Line]:
    """Yield how far single runs left small deformations, for which the models are made."""
    for source in of_kind(sources, Trajectory):
        result = source.result
        scene = scene_of(result.record)
        stiffened = any(effect.get("type") == "geometric_stiffening" for effect in scene.get("effects", {}).values())
        limits = limits_of(stiffened or bool(scene.get("reduction", {}).get("second_order")))
        for name, value in result.validity.items():
            if np.isfinite(value):
                unit, about = VALIDITY[name].values()
                shown = Datum(value, f"{value:.2g}", source.name, f"/validity/{name}")
                size, limit = [shown, behind(unit)], limits[name]
                beyond = "no limit" if np.isinf(limit) else f"worth a warning beyond {limit:g}"
                yield Line(f"small deformations: {name.replace('_', ' ')}", size, f"{about}; {beyond}")


@dataclass(frozen=True)
class Decision:
    """The traffic light above the verdict."""

    kind: str  # ``decided``, ``undecided``, ``failed`` or ``unasked``
    title: str  # the same in words
    why: str  # how it follows from intervals and errors


def decision(sources: Sequence[Source], error: ModelError | None) -> Decision:
    """Return whether the questions of a scene are decided: by the runs that ended, the intervals and the model's error.

    An event is decided where the model's error, estimated or measured, could not move its probability beyond the
    interval of sampling (`Chance.is_decided`); a rare event where its levels reached it.
    """
    runs, ensembles = of_kind(sources, Trajectory), of_kind(sources, Ensemble)
    stopped = [f"{source.name} stopped before its end" for source in runs if style.ended_early(source.result)]
    lost = [f"all samples of {source.name} failed" for source in ensembles if source.result.status.all()]
    if stopped or lost:
        return Decision("failed", "Failed", "; ".join([*stopped, *lost]))
    chances, mesh = [], own_of_mesh(sources)
    for source in ensembles:
        for label, chance in source.result.probabilities.items():
            of_runs, of_mesh = _of_runs(source.result, label, error, mesh)
            known = float(np.fmax(chance.model_error, of_runs))
            label = (f"{source.name}: " if len(ensembles) > 1 else "") + label
            label += " (too many samples failed)" * bool(np.isnan(chance.estimate))
            chances.append((label, chance, known, of_mesh))
    events = [(label, chance.is_decided(known)) for label, chance, known, _ in chances]
    events += [(source.result.event, source.result.reached) for source in of_kind(sources, RareEvent)]
    if not events:
        if any(scene_of(source.record).get("ensemble", {}).get("probabilities") for source in sources):
            return Decision("unasked", "No probability known", "no samples are here: add a file of pgmp montecarlo")
        return Decision("unasked", "No probability asked for", "the scene has no ensemble.probabilities")
    doubtful = [label for label, decided in events if not decided]
    if doubtful:
        open_ = [(one, of_mesh) for _, one, known, of_mesh in chances if not one.is_decided(known)]
        lost = any(np.isnan(one.estimate) for _, one, *_ in chances) or len(open_) < len(doubtful)
        by = "by this model"
        if not lost and all(one.is_of_mesh(of_mesh) for one, of_mesh in open_):
            by = "with this mesh"
        elif not lost and all(one.whose == OF_TIME_STEP for one, _ in open_):
            by = "with this time step"
        return Decision("undecided", f"Not decided {by}", ", ".join(dict.fromkeys(doubtful)))
    words = [
        f"{label}: {one.whose} error is {share_text(known)}, and the answer holds up to {share_text(one.holds_to)}"
        for label, one, known, _ in chances
        if known > 0.0
    ]
    return Decision("decided", "Decided", "; ".join(words) or "nothing was reduced")


MUCH_MORE = 2.4  # times the other: beyond it no more than 5 % of estimates are wrong, see docs/method.md


def verdict(sources: Sequence[Source], error: ModelError | None) -> list[Sentence]:
    """Return the sentences, the most telling one first."""
    ensembles = of_kind(sources, Ensemble)
    runs = of_kind(sources, Trajectory)
    sentences: list[Sentence] = []
    for source in ensembles:
        sentences += _of_ensemble(source, len(ensembles) > 1, error, sources)
    if not sentences and runs:
        sentences += _of_run(runs[0], error)
    if not sentences:
        chances = [(source, chance_of(source)) for source in sources if isinstance(source.result, RareEvent)]
        sentences += [[f"{source.result.event.replace('_', ' ')}: ", *of, "."] for source, of in chances if of]
    if not sentences:
        studies = [source.result for source in sources if isinstance(source.result, Tradeoff)]
        sentences += [[line] for study in studies for line in study.advice[:1]]
    sentences += _of_error(error, runs or ensembles, ensembles)
    for name, (share, _, how) in sorted(mesh_errors(sources).items(), key=lambda item: -item[1][0])[:1]:
        sentences.append(["Mesh: ", Datum(share, share_text(share)), f" of the largest {name}; measured: {how}."])
    sentences += _of_time_steps(sources)
    sentences += _of_failures(ensembles, runs)
    return sentences


def _of_ensemble(
    source: Source, several: bool, error: ModelError | None, sources: Sequence[Source]
) -> Iterator[Sentence]:
    """Yield probabilities of events; where the scene has none, the means and where most samples lie.

    A probability that the model does not decide has no figure that the page would print in bold.
    """
    ensemble, mesh, stops = source.result, own_of_mesh(sources), _full_order_stops(sources)
    ahead = f"{source.name}: " if several else ""
    for label, chance in ensemble.probabilities.items():
        place = Place(source.name, f"/probabilities/{label}")
        parts = place.figure("estimate", chance.estimate, "interval", chance.interval, 100.0)
        of = f"{percent(chance.confidence)} interval of {chance.of}"
        of_runs, of_mesh = _of_runs(ensemble, label, error, mesh)
        if np.isnan(chance.estimate):
            words = f"{ahead}P({chance.event}) is not known"
            yield [f"{words}: no sample tells."] if np.isnan(chance.interval).any() else [words, parts[1], f" %, {of}."]
        elif chance.is_decided(of_runs):
            yield [f"{ahead}P({chance.event}) = ", parts[0], " %", *parts[1:], f", {of}."]
        else:
            ends = 100.0 * chance.interval
            said = f"{number_text(100.0 * chance.estimate, ends, 6)} % {interval_text(ends)}, {of}"
            yield [f"{ahead}P({chance.event}) is {chance.doubt(of_runs, stops, of_mesh)}."]
            yield [f"What the samples of this model say: {said}."]
    if ensemble.probabilities:
        return
    for name in ensemble.outputs:
        s = ensemble.statistics.get(name)
        if s is None or not s.count:
            continue
        mean, factor, unit = mean_of(source, name)
        if s.constant or not s.probabilities.size:
            what = "is constant: " if s.constant else "has the mean "
            yield [f"{ahead}{name} at the end {what}", *mean, f"{unit}."]
            continue
        place = Place(source.name, f"/statistics/{name}")
        low, high = int(np.argmin(s.probabilities)), int(np.argmax(s.probabilities))
        spread = percent(float(s.probabilities[high] - s.probabilities[low]))
        texts = end_texts(factor * s.quantiles[[low, high]])
        ends = [place.datum("quantiles", s.quantiles[k], text, str(k)) for k, text in zip((low, high), texts)]
        yield [
            f"{ahead}{name} at the end: mean ", *mean, f"{unit}; {spread} of the samples lie between ",
            ends[0], " and ", ends[1], f"{unit}.",
        ]  # fmt: skip


def _full_order_stops(sources: Iterable[Source]) -> bool:
    """Return whether the full-order run of a scene stopped before its end."""
    runs = (source.result for source in sources if isinstance(source.result, Trajectory))
    return any(run.model == "full" and bool(run.why_stopped) for run in runs)


VANISHES = 0.01  # of what samples end with: the share of a run's error in an output as small says nothing of theirs


def _of_runs(
    ensemble: Ensemble, label: str, error: ModelError | None, mesh: Mapping[str, float]
) -> tuple[float, float]:
    """Return what single runs say of the error that decides an event, as a share, and the mesh's part of it, known by
    output.

    NaN where they say nothing: of other models beside what their samples know, or where the output is next to nothing
    in them, as at offsets of zero, but not in samples.
    """
    event = scene_of(ensemble.record).get("ensemble", {}).get("probabilities", {}).get(label, {})
    output = event.get("output", "")
    of_mesh = mesh.get(output, 0.0)
    if ensemble.model != "reduced":
        return ensemble.probabilities[label].model_error + of_mesh, of_mesh
    ends = np.nan_to_num(np.abs(ensemble.outputs.get(output, np.zeros(1))))
    if error is None or error.largest.get(output, np.inf) < VANISHES * np.median(ends):
        return np.nan, 0.0
    return error.bound(output, event.get("when", "end")), of_mesh


def _of_run(source: Source, error: ModelError | None) -> Iterator[Sentence]:
    """Yield the largest size of every output of a run, when it has it, and by how much it may be off, if much."""
    run = source.result
    off = [] if run.errors is None else [{name: _share(source, name) for name in run.errors.outputs}]
    if error is not None and run.model == "reduced":  # measured, where it is
        off = [one.datums for one in (error, error.with_step) if one is not None]
    for name, values in run.outputs.items():
        if not np.isfinite(values).any():
            yield [f"{name} is not known at any instant."]
            continue
        place = int(np.argmax(np.abs(np.where(np.isfinite(values), values, 0.0))))
        factor, unit = axis_unit(run.units.get(name, "1"), values)
        shown = f"{factor * values[place] + 0.0:.4g}"  # no -0
        largest = Datum(values[place], shown, source.name, f"/outputs/{name}", str(place))
        unit = behind(unit)
        shares = [own[name] for own in off if name in own and np.isfinite(own[name].value)]
        worst = max(shares, key=lambda one: one.value, default=None)
        doubt = [", off by up to ", worst, " of that"] if worst is not None and worst.value > LARGE else []
        yield [f"{name} is furthest from zero at {run.time[place]:.4g} s: ", largest, unit, *doubt, "."]
    if (stress := stress_of(run)) is not None:
        largest, unit = stress.shown(source.name, run.record.system.unit("Pa"))
        lacking = run.model == "reduced" and truncated(run.record.tables)
        doubt = "; it is that of the modes alone and may be far off" if lacking else ""
        yield [f"Largest {WORDS['mises']} ", largest, f" {unit}, in {stress.body} {stress.when}{doubt}."]


def _of_error(error: ModelError | None, sources: Sequence[Source], ensembles: Sequence[Source]) -> Iterator[Sentence]:
    """Yield how far off the model is: of single runs, else of the samples that were checked."""
    if not sources:
        return
    models = {source.result.model for source in sources}
    if error is not None and error.worst is not None:
        of = f" of the largest {error.worst}, the worst of the outputs; {error.how}."
        yield ["Model error ", error.datums[error.worst], of]
        if error.with_step is not None:
            yield from _what_steps_hide(error, error.with_step)
        for source in ensembles:
            if source.result.model not in models:
                said = f"The samples are of {MODELS[source.result.model]}, whose error in them is "
                checked = ["estimated to be at most ", *_checked(source)]
                yield [said, *checked[:-1], "."] if checked[1:] else [f"{said}not known."]
    elif "reduced" in models:
        checked = [part for source in ensembles for part in _checked(source)]
        if checked:
            yield ["Estimated model error at most ", *checked[:-1], " in the samples that were checked."]
        else:
            yield ["Model error: not known; the error budget says why."]
    elif models == {"full"}:
        yield ["All runs are full-order: nothing was reduced."]
    else:
        yield [f"Model error: not known of {' and '.join(MODELS[model] for model in sorted(models))}."]


def _what_steps_hide(measured: ModelError, known: ModelError) -> Iterator[Sentence]:
    """Yield what a comparison with the same time step does not tell: a step that is too large for both runs, or for the
    better model alone, which has vibrations that the reduced one has not."""
    largest = measured.shares[measured.worst]
    if known.worst and known.shares[known.worst] > MUCH_MORE * largest:
        cure = f"{known.worst}: take a smaller simulation.step, or name a simulation.tolerance."
        said = "With the error of the time step it is estimated to be "
        yield [said, known.datums[known.worst], f" of the largest {cure}"]
    elif MUCH_MORE * known.shares.get(measured.worst, np.nan) < largest:
        rest = " of it; the rest should be the time step's error of the better model: repeat both with a smaller "
        said = "The reduced run itself is estimated to be off by "
        yield [said, known.datums[measured.worst], f"{rest}simulation.step."]


def _of_time_steps(sources: Sequence[Source]) -> Iterator[Sentence]:
    """Yield what is known of the time step's error in full-order and component runs, where it is worth a sentence."""
    for source, errors in step_errors(sources):
        worst = _worst({name: errors.share(name) for name in errors.outputs})
        if worst is not None:
            model = MODELS[source.result.model]
            of = f" of the largest {worst}."
            yield [f"Error of the time step of the {model} run, estimated: ", _share(source, worst), of]


def _checked(source: Source) -> Iterator[str | Datum]:
    """Yield the largest estimated error of every output of an ensemble, commas between them and at the end."""
    for name, values in source.result.errors.items():
        if np.isfinite(values).any():
            largest, _, unit = _largest_error(source, name)
            yield from (largest, f"{unit} ({name})", ", ")


def _largest_error(source: Source, name: str) -> tuple[Datum, float, str]:
    """Return the largest estimated error of an output in an ensemble, with factor and unit as of `mean_of`."""
    values = source.result.errors[name]
    place = int(np.nanargmax(values))
    factor, unit = axis_unit(source.result.units.get(name, "1"), values[np.isfinite(values)])
    datum = Datum(values[place], plain(factor * values[place]), source.name, f"/errors/{name}", str(place))
    return datum, factor, behind(unit)


def _of_failures(ensembles: Sequence[Source], runs: Sequence[Source]) -> Iterator[Sentence]:
    for source in ensembles:
        if source.result.status.any():
            fate = "are in no figure above, which may bias them"
            if source.result.probabilities:
                fate = "count both ways in intervals of probabilities; all other figures of outputs are without them"
            yield [f"{failed_of(source)}, and {fate}."]
    for source in runs:
        if style.ended_early(source.result):
            end = style.planned_end(source.result)
            yield [f"{source.name}: the run stopped at {source.result.time[-1]:.4g} s of {end:.4g} s."]


def headline_of_build(path: Path) -> str:
    build = Build.read(path)
    chosen = {} if build.selection is None else dict(build.selection.chosen)
    what = ", ".join(f"{name} = {value}" for name, value in chosen.items()) or "sized without a tolerance"
    return f"{what}; {plain(sum(build.record.timings.values()), 3)} s{_remarks(build.record)}"


def headline_of_run(path: Path) -> str:
    run = Trajectory.read(path, frame=0)
    known = {} if run.errors is None else {name: run.errors.share(name) for name in run.errors.outputs}
    worst, error = _worst(known), "errors were not estimated"
    if worst is not None:
        of = " of the time step" if run.errors.what == OF_STEP else ""
        part = f" over the first {run.errors.time[-1]:.4g} s" if run.errors.end_before(run.time[-1]) else ""
        error = f"estimated error{of}{part} at most {share_text(known[worst])} ({worst})"
    elif run.model == "full":
        error = "nothing was reduced"
    of = f" of {style.planned_end(run):g} s" if style.ended_early(run) else ""
    return f"{MODELS[run.model]}, {len(run.time) - 1} steps to {run.time[-1]:g} s{of}; {error}{_remarks(run.record)}"


def headline_of_comparison(path: Path, better: Path) -> str:
    run, other = Trajectory.read(path, frame=0), Trajectory.read(better, frame=0)
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
    words = f"differs from {MODELS[other.model]}{alike} by at most {share_text(share)} of the largest {worst}, at"
    words += f" {when}" if comparison.is_whole else f" {when}; compared {comparison.part}"
    knows = comparison.same_steps and run.errors is not None and run.errors.what != OF_STEP
    estimated = run.errors.outputs if knows else ()
    own = run.errors.share(worst) if worst in estimated else np.nan
    if MUCH_MORE * own < share:
        words += f"; {share_text(own)} is estimated to be the {MODELS[run.model]} run's"
        words += ", the rest the time step's in the other"
    return words


def headline_of_meshes(own: Path, other: Path) -> str:
    known = mesh_errors([source for scene in read_sources([own, other], frame=0)[0] for source in scene])
    if not known:
        return "outputs are zero or not known, so no share of the mesh can be given"
    worst = max(known, key=known.__getitem__)
    share, own, how = known[worst]
    least = "about" if own > share else "at most"
    apart = f"another mesh differs by at most {share_text(share)} of the largest {worst} ({how})"
    return f"{apart}, an error of {least} {share_text(own)}"


def headline_of_ensemble(path: Path, *runs: Path) -> str:
    """Return how many samples are fine, and the probability of the scene's first event or an output's mean.

    What is known of the model's error is taken from the file of single runs, too.
    """
    ensemble = Ensemble.read(path)
    sources = [source for scene in read_sources(runs, frame=0)[0] for source in scene] if runs else []
    meshes = [other for _, other in mesh_twins(sources)]
    singles = [one.result for one in sources if isinstance(one.result, Trajectory) and one not in meshes]
    error = model_error(sources, paired(singles))
    failed = int(np.count_nonzero(ensemble.status))
    mesh = own_of_mesh(sources)
    answer = ensemble.answer(lambda label: _of_runs(ensemble, label, error, mesh), _full_order_stops(sources))
    return f"{counted(len(ensemble.status), 'sample')}, {failed} failed; {answer}{_remarks(ensemble.record)}"


def _remarks(record: RunRecord) -> str:
    n = sum(remark.kind == "warning" for remark in record.remarks)
    return f"; {counted(n, 'warning')}, see the report" if n else ""
