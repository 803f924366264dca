"""The probability of a rare event of a model: `rare_events` with a model's runs, over ranks.

Samples are dealt to ranks in pieces whose size depends on their number alone, and every rank has all values before it
decides what comes next: so all decide the same, and any number of ranks finds the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack

import numpy as np
from scipy.special import ndtr

from pgmp_petsc.base.errors import InputError, PgmpError, Remark, gathered, note, warning
from pgmp_petsc.base.progress import progress
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.ensemble import intervals, rare_events
from pgmp_petsc.ensemble.importance import FURTHEST, DesignPoints
from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.rare_events import RareSamples
from pgmp_petsc.ensemble.sampling import draw_remarks, drawn_names, mixing_of, values_of
from pgmp_petsc.ensemble.statistics import in_words
from pgmp_petsc.ensemble.stopping import Reader
from pgmp_petsc.ensemble.watchers import watch_over_time
from pgmp_petsc.estimates.own_error import of_figures
from pgmp_petsc.estimates.runs_at_points import RunsAtPoints
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.gradients.differentiated import differentiate
from pgmp_petsc.lanes.vectors import LANES
from pgmp_petsc.models import ComponentModel, FullModel, Model, Reduced, ReducedModel, of_samples
from pgmp_petsc.outputs.outputs import measured_in, with_outputs
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.reduction.rom import outside_of
from pgmp_petsc.results.ensemble import MostLikely, RareEvent
from pgmp_petsc.results.numbers import Arrays
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.numerics import Ensemble, Event
from pgmp_petsc.scene.units import own_values
from pgmp_petsc.scene.uses import offset_directions
from pgmp_petsc.stepping.generalised_alpha import check_ts_options

FEWEST = 500  # samples: three levels of the least size, and as many to be weighted
LEAST, MOST, PIECES = 16, 128, 16  # samples of a piece, and pieces that samples are cut into
FEW = 50.0  # effective samples below which an interval is not to be trusted: a few large weights decide
EXAMPLES = (
    "an event is an output, < or >, and a number, such as 'slider_deformation < -2e-4' or 'tip > 25 mm', with 'ever' "
    "before it for any time in the run, or the label of one of ensemble.probabilities"
)
DIFFERENCE = 1e-4  # of a normal variable, for derivatives of the parameters that it makes
APART = 3.0  # factor between what levels and weights say, beyond which one of them has missed something


def event_of(text: str, scene: Scene) -> Event:
    """Return the event that is meant. Raises `InputError` if it is none, with the place marked."""
    reader = Reader("--rare", text, scene, EXAMPLES)
    label, event = reader.event(may_be_ever=True)
    reader.end()
    return event or scene.ensemble.probabilities[label]


def run_rare_event(model: Model, event: Event, n_samples: int, seed: int, comm: Comm) -> RareEvent | None:
    """Find the probability of an event with at most n samples, on the first rank; None elsewhere. Collective on `comm`.
    Raises `InputError` if no parameter has a distribution, or there are too few samples; `RunError` if samples cannot
    be integrated at all."""
    if n_samples < FEWEST:
        raise InputError(f"-n {n_samples}: with --rare at least {FEWEST} samples are needed, of which levels are made")
    timings = Timings()
    with agreed(comm, "checking what the run is asked for"):
        names = drawn_names(model.scene)
        check_ts_options()
        # other outputs are found for nothing, forces in joints at every step in most of a run's time
        lean = with_outputs(model.scene, [event.output, *measured_in(model.scene)])
        of_runs = of_samples(model.in_scene(lean) if isinstance(model, ReducedModel) else model, names)
    with timings.phase("integration"), ExitStack() as stack:
        bar = stack.enter_context(progress(n_samples, f"{model.title} samples", comm))
        runs = _Runs(of_runs, event, names, comm, bar)
        off = bool(offset_directions(model.scene))  # without derivatives
        slopes = runs.slopes if isinstance(of_runs, Reduced) and not off else None
        found = rare_events.find(runs.limit_state, len(names), n_samples, seed, slopes, not runs.stepping)
    timings = timings.maximum(comm)
    return _result(model, event, found, runs, n_samples, seed, comm.size, timings) if comm.rank == 0 else None


class _Runs:
    """Runs of points in the space of normal variables; `names` are drawn, `values`, `status` and `parameters` of all
    samples so far."""

    def __init__(self, model: Model, event: Event, names: list[str], comm: Comm, bar) -> None:
        self._model, self._event, self._comm, self._bar = model, event, comm, bar
        self.names, self._mixing = names, mixing_of(model.scene, names)
        #: parameters that are drawn and have values with shares of their own, sorted
        self.stepping = [name for name in names if not model.scene.parameters[name].distribution.is_continuous]
        self._watcher = watch_over_time(model, False, Ensemble(extremes=True))
        self.values: list[np.ndarray] = []
        self.status: list[np.ndarray] = []
        self.parameters: list[dict[str, np.ndarray]] = []

    def limit_state(self, points: np.ndarray) -> np.ndarray:
        """Return g of points (n, d), shape (n,): how far the output is from the level; not above 0 in the event."""
        values, n = self.values_of(points), len(points)
        size = min(max(LEAST, -(-n // (PIECES * LANES)) * LANES), MOST, self._model.largest_batch)
        ranges = [(first, min(first + size, n)) for first in range(0, n, size)]
        own = []
        with agreed(self._comm, "integration of the samples"):
            for first, last in ranges[self._comm.rank :: self._comm.size]:
                own.append((first, *self._run({name: column[first:last] for name, column in values.items()})))
        parts = sorted((part for rank in self._comm.allgather(own) for part in rank), key=lambda part: part[0])
        value, status = (np.concatenate([part[k] for part in parts]) for k in (1, 2))
        self.values.append(value)
        self.status.append(status)
        self.parameters.append(values)
        self._bar.update(n)
        return -self._event.sign * (value - self._event.level)

    def values_of(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """Return the values of all parameters, each (n,), that points (n, d) mean."""
        return values_of(self._model.scene, self.names, ndtr(np.clip(points, -FURTHEST, FURTHEST)), self._mixing)

    def slopes(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return g of points (n, d) and its exact derivatives, shapes (n,) and (n, d); NaN where there are none."""
        n, d = points.shape
        steps = DIFFERENCE * np.concatenate([np.eye(d), -np.eye(d)])
        near = self.values_of((points[:, None] + steps).reshape(-1, d))
        changes = np.array([near[name].reshape(n, 2, d) for name in self.names])  # (names, n, 2, d)
        by_normal = (changes[:, :, 0] - changes[:, :, 1]) / (2.0 * DIFFERENCE)
        values, own = self.values_of(points), []
        with agreed(self._comm, "derivatives of the samples"):
            for number in range(self._comm.rank, n, self._comm.size):
                one = {name: float(column[number]) for name, column in values.items()}
                own.append((number, *self._differentiated(one)))
        g, found = np.full(n, np.nan), np.full((n, d), np.nan)
        for number, value, by_parameter in (part for rank in self._comm.allgather(own) for part in rank):
            g[number] = -self._event.sign * (value - self._event.level)
            found[number] = -self._event.sign * np.einsum("p,pd->d", by_parameter, by_normal[:, number])
        self._bar.update(n)
        return g, found

    def _differentiated(self, values: dict[str, float]) -> tuple[float, np.ndarray]:
        try:
            run = differentiate(self._model, values, self.names)
        except PgmpError:
            return np.nan, np.full(len(self.names), np.nan)
        history, at = run.outputs[self._event.output], -1
        if self._event.when == "ever":
            at = int(np.argmax(self._event.sign * history))
        return float(history[at]), np.array([run.derivatives[self._event.output][name][at] for name in self.names])

    def most_likely(self, design: DesignPoints | None) -> MostLikely | None:
        """Return design points as a result has them.

        Shares are the squares of alpha; of correlated parameters, whose normal variables are ``z = L u``, those of
        ``L^-T alpha`` over their sum (Haukaas and Der Kiureghian, Journal of Engineering Mechanics 131 (2005)
        1013-1026).
        """
        if design is None:
            return None
        along = design.alpha
        if self._mixing is not None:
            along = np.linalg.solve(self._mixing.factor.T, along.T).T
        shares = along**2 / np.sum(along**2, axis=1, keepdims=True)
        drawn = {name: column for name, column in self.values_of(design.points).items() if name in self.names}
        return MostLikely(design.beta, design.points, shares, drawn, design.is_exact, design.n_runs)

    def _run(self, values: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return the output that the event is of, NaN where the run failed, and the status, each (n,)."""
        name, ever = self._event.output, self._event.when == "ever"
        batch = run_batch(self._model, values, watchers=[self._watcher] if ever else [])
        if not ever:
            return batch.outputs[name], batch.status
        return batch.extremes[f"{name}/{self._event.extreme}"], batch.status


def _result(
    model: Model, event: Event, found: RareSamples, runs: _Runs, n_samples: int, seed: int, ranks: int, timings: Timings
) -> RareEvent:
    scene, unit = model.scene, model.outputs.units[event.output]
    value, status = np.concatenate(runs.values), np.concatenate(runs.status)
    weight = np.zeros(value.size)
    weight[value.size - found.weights.size :] = found.weights
    values, probabilities = found.curve()
    side = ">" if event.above is not None else "<"  # as --rare takes it
    text = f"{'ever ' if event.when == 'ever' else ''}{event.output} {side} {scene.system.shown(event.level, unit)!r}"
    confidence, words = scene.ensemble.confidence, in_words(event, unit, scene.system)
    parameters = {name: np.concatenate([part[name] for part in runs.parameters]) for name in scene.parameters}
    remarks = rare_remarks(found, status, isinstance(model, FullModel | Reduced), confidence)
    said = (*scene.remarks, *remarks, *draw_remarks(scene))
    if runs.stepping:
        what = f"values of {', '.join(runs.stepping)} step, so that the event has no design point"
        said += (note(f"{what}, and none was looked for"),)
    if isinstance(model, (ReducedModel, ComponentModel)):
        said += outside_of(model.served, parameters, "--rare")
    if isinstance(model, Reduced):
        said += _of_own_error(model, event, found, runs.names, parameters, value)
    return RareEvent(
        model=model.name,
        record=RunRecord(scene_to_toml(scene), own_values(scene), seed, ranks, timings.as_dict(), said),
        event=words,
        text=text,
        output=event.output,
        unit=unit,
        confidence=confidence,
        estimate=found.probability,
        interval=with_failed(found, confidence),
        variation=found.variation,
        at_most=found.at_most,
        n_effective=found.n_effective,
        threshold=np.array([event.level - event.sign * level.threshold for level in found.levels]),
        share=np.array([level.share for level in found.levels]),
        accepted=np.array([level.accepted for level in found.levels]),
        curve=(event.level - event.sign * values, probabilities),
        names=tuple(runs.names),
        normal=found.points,
        value=value,
        weight=weight,
        most_likely=runs.most_likely(found.design),
        asked=n_samples,
        parameters=parameters,
        status=status,
    )


def _of_own_error(
    model: Reduced, event: Event, found: RareSamples, names: Sequence[str], parameters: Arrays, value: np.ndarray
) -> tuple[Remark, ...]:
    """Return what errors of the model do to the probability: as much as if the level were off by their mean at the
    samples nearest to it.

    Of an event at any time, errors are taken at their largest.
    """
    what = "the probability"
    known = np.flatnonzero(np.isfinite(value))
    nearest = known[np.argsort(np.abs(value[known] - event.level), kind="stable")[:LANES]]
    if not (found.reached and nearest.size):
        return ()
    points = [{name: float(column[k]) for name, column in parameters.items()} for k in nearest]
    runs = RunsAtPoints.of(of_samples(model, names), points)
    errors, beyond = runs.errors, runs.beyond("samples that are nearest to the level")
    if errors is None:
        return (runs.not_known(what), *beyond)
    at = errors.at_end[event.output]
    if event.when == "ever":
        rows = [of_run[event.output] for _, of_run in errors.histories]
        at = np.array([row[np.argmax(np.abs(row))] if row.size else np.nan for row in rows])
    if not np.isfinite(at).any():
        return (runs.not_known(what, [event.output]), *beyond)
    without = min(1.0, found.probability * found.factor_of(-event.sign * float(np.nanmean(at))))
    return (*of_figures([(what, found.probability, without, found.probability)], what), *beyond)


def with_failed(found: RareSamples, confidence: float) -> np.ndarray:
    """Return the interval of the probability, (2,), in which failed samples are outside the event at the lower end, and
    in it at the upper one.

    The plain ones from which the search begins bound the event together with all that fails; so do the weighted ones,
    but for what fails where they do not come, as some of the plain ones did.
    """
    ends = found.interval(confidence)
    if not np.isnan(found.limit_state).any():
        return ends
    own = found.limit_state[found.limit_state.size - found.weights.size :]
    plain = own if found.is_plain else found.levels[0].before if found.levels else found.limit_state
    n_failed, n_in = int(np.sum(~np.isfinite(plain))), int(np.sum(plain <= 0.0))
    open_end = intervals.of_probability(n_in, plain.size - n_failed, confidence, n_failed)[1]
    if own.size and not n_failed:
        rounds = np.split(np.where(own > found.weighed, 0.0, found.weights), np.cumsum(found.rounds)[:-1])
        open_end = np.fmin(open_end, intervals.of_weighted(rounds, confidence)[1])
    return np.array([np.fmax(ends[0], 0.0), np.fmax(ends[1], open_end)])


@gathered
def rare_remarks(found: RareSamples, status: np.ndarray, whole: bool, confidence: float = 0.95) -> Iterator[Remark]:
    n_failed = int(np.count_nonzero(status))
    if not found.reached:
        yield warning(_not_reached(found, confidence))
    elif found.is_plain:
        n_in = int(np.count_nonzero(found.contributions))
        yield warning(
            f"the output is the same in most samples, so nothing led to the event: {n_in} of {found.weights.size} "
            "plain random samples are in it, and the interval is theirs; take a larger -n"
        )
    else:
        yield note(
            f"the interval is of {found.weights.size} weighted samples in {len(found.rounds)} rounds (central "
            "limit theorem of the logarithm); a part of the event apart from all that was found is not in it: "
            "another --seed looks again"
        )
        if not found.n_effective >= FEW:
            few = f"{found.n_effective:.3g} equally weighted ones"
            yield warning(f"the weighted samples are worth {few} only: the interval may be too short; take a larger -n")
        if found.may_have_lost_parts:
            yield warning(
                "the event has parts that lie apart, and no design points, by which further ones would be found: "
                "the probability may be too small by whole parts, and the interval goes on to the upper end of "
                "what the levels alone say; compare other seeds, or take a larger -n"
            )
        is_guess = any(level.is_afar for level in found.levels)
        if not is_guess and not 1.0 / APART < found.by_levels / found.probability < APART:
            yield warning(
                f"the levels alone say {found.by_levels:.3g}, far from the weighted {found.probability:.3g}: parts "
                "of the event may be missing; take a larger -n or another --seed"
            )
    if n_failed:
        most = f"; with all of them in the event the probability would be {found.at_most:.4g}" if found.reached else ""
        both = "count as not in the event, and in the upper end of the interval as in it"
        yield warning(f"{n_failed} of {status.size} samples failed and {both}{most}")
    if not whole:
        yield note(
            "errors of the model and of the time step were not estimated at these samples, and the interval does "
            "not know of them"
        )


def _not_reached(found: RareSamples, confidence: float) -> str:
    cure = "it is rarer, or cannot happen; take a larger -n, or a level that is nearer"
    low, bound = with_failed(found, confidence)
    if found.may_have_lost_parts:
        return (
            "not decided: the event has parts that lie apart, and searches still found more when samples for them "
            f"ended, so that whole parts of it may be missing: from those that were found it is {low:.3g} at least, "
            f"and {bound:.3g} at most by the levels alone ({100 * confidence:g} %); take a larger -n"
        )
    said = f"the event was not reached by {len(found.levels)} levels of subset simulation"
    if not bound < 1.0:
        return f"{said}: {cure}"
    if found.is_plain:
        return (
            f"none of {found.weights.size} plain random samples is in the event, and the output, the same in most of "
            f"them, does not show where it is: its probability is at most {bound:.3g} ({100 * confidence:g} %); {cure}"
        )
    if found.is_weak and not found.weighed > 0.0:
        return (
            f"the event was found, but its {found.weights.size} weighted samples are worth {found.n_effective:.2g} "
            f"equally weighted ones, of which no probability follows; by {found.levels[0].before.size} plain random "
            f"samples it is at most {bound:.3g} ({100 * confidence:g} %); take a larger -n"
        )
    by = f"{found.weights.size} samples about the last of them"
    if bound >= found.of_first(confidence):
        by = f"{found.levels[0].before.size} plain random samples, before the first of them,"
    return f"{said}; {by} bound its probability: at most {bound:.3g} ({100 * confidence:g} %); {cure}"
