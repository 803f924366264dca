"""Watchers: they follow the runs of an ensemble's batches and add arrays to what is kept of the samples.

`RangeWatch` fails samples of full-order and component models whose coordinate leaves its range, where a deformation is
an output, which is not known beyond; reduced models stop by themselves. `watch_over_time` keeps extremes, first
passages of levels, which lie where the straight line between the ends of two steps crosses the level, and values at the
instants of the bands. A sample that fails has none of these, and one whose output is no number for a while has no
extremes of it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pgmp_petsc.base.errors import counted
from pgmp_petsc.base.progress import doing
from pgmp_petsc.ensemble.plan import IN_CHECKED, Piece, block_of, share_of
from pgmp_petsc.estimates.coarser_run import fewest_steps, largest_felt, run_coarser, step_errors, times_of
from pgmp_petsc.estimates.error_indicator import ErrorIndicator, MemberIndicator, indicator_of
from pgmp_petsc.estimates.own_error import FEW_STEPS
from pgmp_petsc.estimates.validity import Validity
from pgmp_petsc.models import FullModel, Model, OutputRecord, Reduced, SeparateLengths
from pgmp_petsc.outputs.rainflow import Counting
from pgmp_petsc.results.ensemble import EXTREMES
from pgmp_petsc.results.estimates import BALANCE, VALIDITY, moved_around
from pgmp_petsc.results.numbers import Arrays
from pgmp_petsc.scene.numerics import Ensemble, Event, Simulation
from pgmp_petsc.scene.outputs import after_start
from pgmp_petsc.stepping.generalised_alpha import Run
from pgmp_petsc.stepping.second_order_system import Energies, Observer, PooledObserver, SecondOrderSystem, State
from pgmp_petsc.stepping.status import Status

TOGETHER = 512  # states of reduced samples whose energies are evaluated together, about as many as stay in a cache
Found = dict[str, dict[str, np.ndarray]]


@dataclass(frozen=True, eq=False)
class Begun:
    """A run of some samples that begins."""

    #: system, values: the system, and the parameter values of all its samples
    system: SecondOrderSystem
    values: Arrays
    samples: np.ndarray  # numbers of those that are watched: what is no mechanism at all is not
    simulation: Simulation  # its steps


class Watch(NamedTuple):
    """Looks at one run of some samples."""

    observer: Observer  # takes in the states of the whole run
    #: what was found once the run has ended with the given status of all its samples: arrays (n_watched,) by name, and
    #: these by the field of `Batch` that they belong to; NaN where nothing is known
    found: Callable[[np.ndarray], Found]
    #: outputs that are counted over a run, at its end, by name (n_samples,)
    counted: Callable[[], Arrays] = dict


@dataclass(frozen=True, eq=False)
class Watcher:
    """Looks at the runs of all batches."""

    names: Mapping[str, Collection[str]]  # of arrays, by the field of `Batch` that they belong to
    watch: Callable[[Begun], Watch]  # begins to look at a run
    n_instants: int = 0  # of the bands

    def empty(self, n: int) -> Found:
        """Return the arrays of n samples of which nothing is known: NaN."""
        shapes = {"bands": (n, self.n_instants)}
        return {kind: {name: np.full(shapes.get(kind, n), np.nan) for name in of} for kind, of in self.names.items()}


def watch_errors(indicator: ErrorIndicator | MemberIndicator) -> Watcher:
    """Estimate the errors of all samples by the indicator of a model, with the steps of each run."""

    def watch(begun: Begun) -> Watch:
        run = indicator.stepped(begun.simulation).watch(begun.system, begun.samples)

        def found(status: np.ndarray) -> Found:
            with doing(f"errors of {counted(begun.samples.size, 'checked sample')}"):
                estimate = run.estimate(status)
            few = float(begun.simulation.n_steps < FEW_STEPS)
            unsure = {name: np.where(np.isfinite(one), few, np.nan) for name, one in estimate.largest.items()}
            return {"errors": estimate.largest, "errors_at_end": estimate.at_end, "errors_unsure": unsure}

        return Watch(run, found)

    return Watcher(dict.fromkeys(IN_CHECKED, indicator.model.outputs.functions), watch)


def watch_coarser(model: Model) -> Watcher:
    """Estimate the errors of the time step of all samples of a full-order or component model: keep the outputs of a
    run, and run its system again."""
    names = dict.fromkeys(IN_CHECKED, model.outputs.functions)

    def watch(begun: Begun) -> Watch:
        record = OutputRecord(model, begun.system)

        def found(status: np.ndarray) -> Found:
            time, outputs = record.outputs()
            alive = np.isin(np.arange(status.size), begun.samples) & (status == Status.FINE)
            kept = {kind: {name: np.full(begun.samples.size, np.nan) for name in of} for kind, of in names.items()}
            if begun.simulation.n_steps < fewest_steps(times_of(model.scene, begun.simulation)):
                return kept
            with doing(f"errors of {counted(begun.samples.size, 'checked sample')}"):
                other = run_coarser(model, begun.system, begun.simulation, alive)
            for place, sample in enumerate(begun.samples):
                if not alive[sample]:
                    continue
                own = {name: values[:, sample] for name, values in outputs.items()}
                errors = step_errors(model.scene, time, own, largest_felt(model, own), other, sample)
                if errors is None or errors.time.size < other.time.size:
                    continue
                for name, values in errors.outputs.items():
                    of_one = np.abs(values).max(), values[-1], bool(errors.unsure)
                    for kind, one in zip(IN_CHECKED, of_one):
                        kept[kind][name][place] = one
            return kept

        return Watch(record, found)

    return Watcher(names, watch)


def watch_validity(model: Reduced) -> Watcher:
    """Keep how far every sample of a reduced model leaves small deformations."""

    def watch(begun: Begun) -> Watch:
        seen = Validity(model, begun.system, begun.values, begun.simulation)
        return Watch(seen, lambda status: {"validity": {k: v[begun.samples] for k, v in seen.extremes.items()}})

    return Watcher({"validity": VALIDITY}, watch)


def watch_balance() -> Watcher:
    """Draw up the balance of energy of every sample; see `results.estimates`."""
    return Watcher({"balance": BALANCE}, lambda begun: Watch(run := _BalanceWatch(begun), run.found))


class _BalanceWatch(PooledObserver):
    """Sums up works as the run goes on, by the trapezoidal rule over its steps."""

    def __init__(self, begun: Begun) -> None:
        self._system, self._samples = begun.system, begun.samples
        super().__init__(max(1, TOGETHER // self._system.n_samples))
        self._largest = np.zeros((4, self._system.n_samples))  # of the residual, and what `moved_around` takes
        self._first: Energies | None = None
        self._work: dict[str, np.ndarray] = {}

    def see(self, first: int, states: State) -> None:
        n, times = self._system.n_samples, self.times[first:]
        energies = self._system.energies_over(np.array(times), states)
        for k, time in enumerate(times):
            self._add(time, energies[n * k : n * (k + 1)])

    def _add(self, time: float, now: Energies) -> None:
        if self._first is None:
            self._first, self._work = now, {name: np.zeros_like(power) for name, power in now.powers.items()}
        else:
            half = 0.5 * (time - self._time)
            for name, power in now.powers.items():
                self._work[name] = self._work[name] + half * (self._last.powers[name] + power)
        self._time, self._last = time, now
        work = dict(self._work)
        for name, stored in now.potential.items():
            work[name] = work.get(name, 0.0) + self._first.potential[name] - stored
        kinetic, strain = now.kinetic - self._first.kinetic, now.strain - self._first.strain
        residual = np.abs(kinetic + strain - sum(work.values()))
        handed = np.abs(strain) + sum(np.abs(done) for done in work.values())
        self._largest = np.maximum(self._largest, [residual, np.abs(kinetic) + handed, handed, now.kinetic])

    def found(self, status: np.ndarray) -> Found:
        """Return the largest residual and the most energy that was moved around, NaN for samples that failed."""
        self.finish()
        residual, *largest = self._largest
        kept = np.where(status == Status.FINE, [residual, moved_around(*largest)], np.nan)[:, self._samples]
        return {"balance": dict(zip(BALANCE, kept))}


class RangeWatch(Observer):
    """Sees which samples of a run of a model, some of whose outputs are deformations, leave the range, and when."""

    def __init__(self, model: FullModel | SeparateLengths, system: SecondOrderSystem) -> None:
        self._model, self._system = model, system
        self._time = np.full(system.n_samples, np.inf)

    def over(self, numbers: np.ndarray, times: np.ndarray, states: State) -> None:
        for k, time in enumerate(times):
            left = self._model.left_range(self._system, states.at(k))
            self._time[left & np.isinf(self._time)] = time

    def judged(self, done: Run) -> Run:
        """Return the run with the samples that left the range as failed, whatever happened to them later."""
        lost = np.isfinite(self._time) & ~(done.failure_time <= self._time)
        return replace(
            done,
            status=np.where(lost, Status.LEFT_RANGE, done.status),
            failure_time=np.where(lost, self._time, done.failure_time),
        )


def band_steps(simulation: Simulation, most: int) -> np.ndarray:
    """Return the numbers of the steps at whose ends outputs are described: the start, the end, equally many between; at
    most `most`, none for 0."""
    if not most:
        return np.zeros(0, dtype=int)
    n_steps = simulation.n_steps
    return np.unique([*range(0, n_steps, -(-n_steps // (most - 1))), n_steps])


def watch_over_time(model: Model, with_bands: bool, asked: Ensemble | None = None) -> Watcher | None:
    """Keep what is `asked` for of the outputs over time, by default by the scene, and with bands values at their
    instants; None where that is nothing."""
    asked, simulation = model.scene.ensemble if asked is None else asked, model.scene.simulation
    outputs = list(model.outputs.functions)
    of_extremes = asked.with_extremes(outputs)
    events = {label: event for label, event in asked.probabilities.items() if event.when == "ever"}
    steps = band_steps(simulation, asked.bands if with_bands else 0)
    if not (outputs and (of_extremes or events or steps.size or model.outputs.counts)):
        return None

    def watch(begun: Begun) -> Watch:
        divisor = begun.simulation.n_steps // simulation.n_steps
        run = _OverTimeWatch(model, begun, of_extremes, events, steps * divisor)
        return Watch(run, run.found, run.counted)

    extremes = [f"{name}/{which}" for name in of_extremes for which in EXTREMES]
    names = {"extremes": extremes, "first_passages": events, "bands": outputs if steps.size else ()}
    return Watcher(names, watch, steps.size)


class Watching:
    """Follows runs of a model's samples; `share` and `block` are of those whose errors are estimated (`block_of`)."""

    def __init__(self, model: Model) -> None:
        self.share, self.block = share_of(model), block_of(model.scene, model.name)
        self._errors: list[Watcher] = []
        if self.share > 0.0:
            self._errors = [watch_errors(indicator_of(model)) if isinstance(model, Reduced) else watch_coarser(model)]
        self._others: list[Watcher] = [watch_balance()] if model.scene.ensemble.balance else []
        if isinstance(model, Reduced):
            self._others.append(watch_validity(model))
        self._n_bands = model.scene.ensemble.band_samples
        self._over_time = {with_bands: watch_over_time(model, with_bands) for with_bands in (True, False)}

    def of(self, piece: Piece) -> list[Watcher]:
        """Return what looks at a piece; at outputs over time of the first samples more than of the others."""
        over_time = self._over_time[piece.first < self._n_bands]
        others = self._others if over_time is None else [*self._others, over_time]
        if piece.is_checked:
            return [*self._errors, *others] if piece.is_both else self._errors
        return others


class _OverTimeWatch(PooledObserver):
    """Looks at one run; `steps` are the numbers of those of the bands in this run."""

    def __init__(
        self, model: Model, begun: Begun, extremes: list[str], events: dict[str, Event], steps: np.ndarray
    ) -> None:
        super().__init__(begun.system.instants_at_once)
        self._model, self._begun, self._steps = model, begun, steps
        n, names = begun.system.n_samples, list(model.outputs.functions)
        self._extremes = {name: _Extremes(n) for name in extremes}
        self._passages = {label: _Passage(event, n) for label, event in events.items()}
        self._bands = {name: np.full((n, steps.size), np.nan) for name in names if steps.size}
        self._counts, self._late = model.outputs.counts, after_start(model.scene)
        self._counting = Counting(self._counts, begun.values, n)
        self._last: dict[str, np.ndarray] = {}
        self._looks_always = bool(self._extremes or self._passages or self._counts)
        self.every = 1 if self._looks_always or steps.size < 2 else int(steps[1] - steps[0])

    def over(self, numbers: np.ndarray, times: np.ndarray, states: State) -> None:
        if not self._looks_always:
            chosen = self._of_bands(numbers)[0]
            numbers, times, states = numbers[chosen], times[chosen], states.at(chosen)
        super().over(numbers, times, states)

    def see(self, first: int, states: State) -> None:
        numbers, times = np.array(self.numbers[first:]), np.array(self.times[first:])
        with doing("outputs over time"):
            found = self._model.outputs.evaluate(self._model.observed_over(self._begun.system, states, times))
        outputs = self._counting.over(times, {name: row.reshape(times.size, -1) for name, row in found.items()})
        self._last = {name: outputs[name][-1] for name in self._counts}
        judged = {name: slice(int(first == 0 and name in self._late), None) for name in outputs}
        for name, extremes in self._extremes.items():
            extremes.take(times[judged[name]], outputs[name][judged[name]])
        for passage in self._passages.values():
            of = passage.event.output
            passage.take(times[judged[of]], outputs[of][judged[of]])
        of_bands, places = self._of_bands(numbers)
        for name, band in self._bands.items():
            band[:, places] = outputs[name][of_bands].T

    def _of_bands(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return which of these steps are steps of the bands, and which of those they are."""
        if not self._steps.size:
            return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
        # both are in order: numpy's isin would first sort them, many times in a run
        places = np.minimum(np.searchsorted(self._steps, numbers), self._steps.size - 1)
        there = np.flatnonzero(self._steps[places] == numbers)
        return there, places[there]

    def counted(self) -> dict[str, np.ndarray]:
        """Return the outputs that are counted, at the last instant, each of shape (n_samples,)."""
        self.finish()
        return self._last

    def found(self, status: np.ndarray) -> Found:
        """Return what was kept, NaN for samples that failed."""
        self.finish()
        samples = self._begun.samples
        lost = (status != Status.FINE)[samples]
        if self._steps.size > 2:
            for name in (self._bands.keys() & {*self._late}) - self._counts.keys():
                self._bands[name][:, 0] = self._bands[name][:, 1]  # as `outputs.multipliers.judged` has them
        kept: Found = {
            "extremes": {f"{name}/{w}": v for name, one in self._extremes.items() for w, v in one.found().items()},
            "first_passages": {label: passage.time for label, passage in self._passages.items()},
            "bands": self._bands,
        }
        return {
            kind: {
                name: np.where(lost.reshape(-1, *[1] * (values.ndim - 1)), np.nan, values[samples])
                for name, values in arrays.items()
            }
            for kind, arrays in kept.items()
        }


class _Extremes:
    """The largest and the smallest values of an output so far, and when they were reached first."""

    def __init__(self, n: int) -> None:
        self._columns = {"max": np.full(n, -np.inf), "min": np.full(n, np.inf)}
        self._columns |= {"time_of_max": np.zeros(n), "time_of_min": np.zeros(n)}
        self._unknown = np.zeros(n, dtype=bool)

    def take(self, times: np.ndarray, values: np.ndarray) -> None:
        """Take in values (n_t, n) at some instants (n_t,), or at none."""
        if not times.size:
            return
        self._unknown |= np.isnan(values).any(axis=0)
        for which, place_of, is_beyond in (("max", np.argmax, np.greater), ("min", np.argmin, np.less)):
            place = place_of(values, axis=0)
            here = np.take_along_axis(values, place[None], axis=0)[0]
            further = is_beyond(here, self._columns[which])
            for name, now in ((which, here), (f"time_of_{which}", times[place])):
                self._columns[name] = np.where(further, now, self._columns[name])

    def found(self) -> dict[str, np.ndarray]:
        """Return the columns; NaN where the output was no number for a while."""
        return {which: np.where(self._unknown, np.nan, column) for which, column in self._columns.items()}


class _Passage:
    """The instant at which an output first passes a level, NaN until it does."""

    def __init__(self, event: Event, n: int) -> None:
        self.event, self.time = event, np.full(n, np.nan)
        self._last = np.zeros(0), np.full((1, n), np.nan)

    def take(self, times: np.ndarray, values: np.ndarray) -> None:
        """Take in values (n_t, n) at some instants (n_t,), or at none."""
        if not times.size:
            return
        before, row = self._last
        times = np.concatenate([before if before.size else times[:1], times])  # at the start, the start
        excess = np.concatenate([row, self.event.sign * (values - self.event.level)])
        beyond = excess[1:] > 0.0
        new = np.flatnonzero(beyond.any(axis=0) & np.isnan(self.time))
        place = np.argmax(beyond[:, new], axis=0)
        earlier, later, here, there = times[place], times[place + 1], excess[place, new], excess[place + 1, new]
        with np.errstate(all="ignore"):  # the line from the instant before crosses the level; no number before: here
            share = np.where(np.isfinite(here), np.where(here < 0.0, here / (here - there), 0.0), 1.0)
        self.time[new] = earlier + share * (later - earlier)
        self._last = times[-1:], excess[-1:]
