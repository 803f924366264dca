"""Estimated errors of reduced runs, from the residual of their motion in the full-order equations.

- The error of the time step is that between the run and one of the same reduced model with smaller steps (`FINER` of
  them in one): it goes through stops, friction and all that is nonlinear as the run itself does.
- `checking_model`: all that the full-order equations say against that run. This is what the reduction leaves out
  (modes, terms, parameters, interpolation). What loads do between two steps is added.

The equations are solved at two sets of instants and more, until two of them agree (`reference_motion`), and outputs are
evaluated at ``q_reduced - error``; where no two agree, the output has no estimate (docs/method.md, error indicator).

Samples side by side follow tables that are polynomials of the lengths, and so are their outputs (`models.lengths`).
Their motion is that of the exact kinematics of a sample's own lengths, and outputs of the corrected motion are compared
with what the sample said: what the polynomials are off by is in the estimate.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.controllers.running import AFTER
from pgmp_petsc.estimates import reference_motion
from pgmp_petsc.estimates.checking_model import Begin, CheckingModel, ErrorSystem
from pgmp_petsc.estimates.reference_motion import ReferenceMotion, Schedule
from pgmp_petsc.full.systems import FullBatch
from pgmp_petsc.models import ComponentModel, LengthLanes, Reduced, ReducedModel
from pgmp_petsc.models.model import floors_of
from pgmp_petsc.outputs.multipliers import judged
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.results.numbers import Arrays, with_unit
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.scene.uses import offset_names
from pgmp_petsc.stepping.generalised_alpha import ERROR_PREFIX, integrate
from pgmp_petsc.stepping.second_order_system import Observer, PooledObserver, State
from pgmp_petsc.stepping.status import Status

TOGETHER = 2**21  # unknowns of instants whose outputs are evaluated together

UNSOLVED = "the full-order equations could not be solved about this motion"
UNCONFIRMED = f"{UNSOLVED} with long steps, so that nothing confirms the estimate with short ones"
TOO_OFTEN = "controllers, or what joints carry, are found in so many steps that the estimate would take too long"
STOPPED = f"the reduced run with 1/{reference_motion.FINER} of the step, which the estimate is made from, stopped"


@dataclass(frozen=True)
class Estimate:
    """Estimated errors of n samples; NaN where a sample failed or has no estimate."""

    largest: dict[str, np.ndarray]  # largest size of the error of every output over the run, shape (n,)
    at_end: dict[str, np.ndarray]  # error of every output at the end, reduced less full-order, shape (n,)
    #: of every sample: instants (s), and errors of every output at these, each of shape (n_e,)
    histories: list[tuple[np.ndarray, dict[str, np.ndarray]]]
    #: of every output why each sample has none, n of them; empty where it has one, and where the sample failed
    absent: dict[str, list[str]]

    @classmethod
    def nothing(cls, outputs: Iterable[str], n: int = 1, why: str = "", times: np.ndarray = np.zeros(0)) -> Self:
        """Return that of n samples that have none at some times (s), and why; empty where they failed."""
        largest, at_end = ({name: np.full(n, np.nan) for name in outputs} for _ in range(2))
        histories = [(times, {name: np.full(times.size, np.nan) for name in outputs})] * n
        return cls(largest, at_end, histories, {name: [why] * n for name in outputs})

    def put(self, samples: Sequence[int], other: Estimate) -> None:
        """Take over what another one has of samples with these numbers here."""
        for k, sample in enumerate(samples):
            self.histories[sample] = other.histories[k]
            for name, reasons in self.absent.items():
                self.largest[name][sample], self.at_end[name][sample] = other.largest[name][k], other.at_end[name][k]
                reasons[sample] = other.absent[name][k]

    def over(self, time: np.ndarray, names: Iterable[str], sample: int = 0) -> dict[str, np.ndarray] | None:
        """Return the errors of outputs of a sample at other instants (n_t,); None where one is not known."""
        instants, errors = self.histories[sample]
        found = {name: np.interp(time, instants, errors[name]) for name in names} if instants.size else {}
        return found if instants.size and np.isfinite(list(found.values())).all() else None

    def why_not(self, names: Iterable[str]) -> str:
        """Return why errors of outputs are not known, by the first one that has none."""
        return next((reason for name in names for reason in self.absent[name] if reason), "there is no estimate")


class ErrorIndicator:
    """Estimates the errors of runs of one reduced model; to be made once for all of them.

    `told` has the outputs of runs, where these are not the model's own.
    """

    def __init__(self, model: ReducedModel, told: LengthLanes | None = None) -> None:
        self.model, self.told = model, told or model
        self.checking = CheckingModel(model)
        self.floors = dict(zip(model.outputs.functions, floors_of(model)))
        self._take_steps_of(model.scene.simulation)

    def _take_steps_of(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.step = simulation.duration / simulation.n_steps
        self.finer = simulation.model_copy(update={"step": self.step / reference_motion.FINER})
        self.schedules = reference_motion.schedules_of(self.checking.full.kinematics.mechanism, simulation)
        ends = [0, reference_motion.FINER * simulation.n_steps]
        self.kept = np.unique(np.concatenate([ends, *(schedule.steps for schedule in self.schedules)]))

    def stepped(self, simulation: Simulation) -> ErrorIndicator:
        """Return the indicator of runs of the same model with other steps."""
        if simulation == self.simulation:
            return self
        other = copy(self)
        other._take_steps_of(simulation)
        return other

    def watch(self, system: ReducedSystem, samples: np.ndarray) -> WatchedRun:
        """Begin to watch a run of a batch; the errors of samples with these numbers within it are wanted."""
        return WatchedRun(self, system, np.asarray(samples))


class _FinerRun(Observer):
    """The observer of a run with smaller steps, which keeps states of shape (3, n_samples, n_eta) after steps of these
    numbers."""

    def __init__(self, kept: np.ndarray, shape: tuple[int, int, int]) -> None:
        self._place = reference_motion.places_of(kept)
        self.states = np.empty((kept.size, *shape))

    def over(self, numbers: np.ndarray, times: np.ndarray, states: State) -> None:
        places = self._place[numbers]
        self.states[places[places >= 0]] = states.motion[places >= 0]


class WatchedRun(Observer):
    """The run of one batch: its observer while it runs, its estimate afterwards."""

    def __init__(self, indicator: ErrorIndicator, system: ReducedSystem, samples: np.ndarray) -> None:
        self._indicator, self._samples = indicator, samples
        self._values = {name: value[samples] for name, value in system.values.items()}
        told = indicator.kept[indicator.kept % reference_motion.FINER == 0] // reference_motion.FINER
        self._place = reference_motion.places_of(told)
        n_eta = indicator.model.kinematics.n_coordinates + indicator.model.terms.tables.n_modes
        self._plain = np.empty((told.size, 3, samples.size, n_eta))  # coordinates, rates, accelerations
        # what is beside them, before and after it jumps
        n_beside = len(system.beside.names) if indicator.told.outputs.takes_beside else 0
        self._beside = np.empty((told.size, samples.size, 2, n_beside))
        self._batch: tuple[np.ndarray, FullBatch] | None = None

    def over(self, numbers: np.ndarray, times: np.ndarray, states: State) -> None:
        places = self._place[numbers]
        kept = places >= 0
        self._plain[places[kept]] = states.motion[kept][:, :, self._samples]
        if self._beside.size:
            self._beside[places[kept]] = states.forces[kept][:, self._samples]

    def estimate(self, status: np.ndarray) -> Estimate:
        """Return the estimate once the run has ended, with the status of the whole batch, shape (n_batch,)."""
        indicator, n = self._indicator, self._samples.size
        if not indicator.schedules:
            ends = np.array([0.0, indicator.simulation.duration])
            return Estimate.nothing(indicator.model.outputs.functions, n, TOO_OFTEN, ends)
        fine = status[self._samples] == Status.FINE
        states, followed = self._followed(fine)
        about = followed & self._placeable(states)
        starts = indicator.checking.starts(self._values, about)
        if starts is not None:
            about &= np.isfinite(starts[0]).all(axis=0)
        # samples that cannot be placed stay at the start and are never advanced
        states[:, :, ~about] = states[:1, :, ~about]
        names = indicator.model.outputs.functions
        found, apart = Estimate.nothing(names, n), {name: np.full(n, np.nan) for name in names}
        largest, at_end, histories = found.largest, found.at_end, found.histories
        settled = np.zeros(n, dtype=bool)
        for schedule in indicator.schedules:
            chosen = np.flatnonzero(~settled)
            if not chosen.size:
                break
            begin = None if starts is None else tuple(part[:, chosen] for part in starts)
            errors = self._evaluate(schedule, chosen, states, about[chosen], begin)
            now = {name: np.max(np.abs(error), axis=0) for name, error in errors.items()}
            before = {name: values[chosen] for name, values in largest.items()}
            between = reference_motion.differences(before, now, indicator.floors)
            alike = np.all([factors <= reference_motion.AGREED for factors in between.values()], axis=0)
            settled[chosen] = alike | ~about[chosen]
            time = schedule.steps[schedule.told] * (indicator.step / reference_motion.FINER)
            for name, error in errors.items():
                largest[name][chosen], at_end[name][chosen], apart[name][chosen] = now[name], error[-1], between[name]
            for column, sample in enumerate(chosen):
                histories[sample] = time, {name: error[:, column] for name, error in errors.items()}
        factors = np.array([np.nan_to_num(apart[name], nan=np.inf) for name in names])
        is_any, densest = (factors > reference_motion.UNSURE).any(axis=0), indicator.schedules[-1]
        cure = "a smaller simulation.step is needed"
        if densest.interval > 1.1 * indicator.finer.step:  # shorter steps would not be looked at more often
            cure = (
                f"the full-order equations are looked at {densest.steps.size - 1} times, which is too seldom here; "
                "a shorter simulation.duration is needed"
            )
        named = indicator.model.scene.system.named
        allowed = np.where(is_any, reference_motion.UNSURE_WITH_OTHERS, reference_motion.UNSURE)
        for name in names:
            reasons = np.full(n, "", dtype=object)
            reasons[fine & ~np.isfinite(largest[name])] = UNSOLVED
            reasons[fine & ~followed] = STOPPED
            unsure = np.isfinite(largest[name]) & ~(apart[name] <= allowed)
            for sample in np.flatnonzero(unsure):
                factor = apart[name][sample]
                apart_by = f"two estimates, with long and with short steps, disagree by a factor of {factor:.2g}"
                why = apart_by if np.isfinite(factor) else UNCONFIRMED
                with_short = with_unit(*named(largest[name][sample], indicator.model.outputs.units[name]), 2)
                reasons[sample] = f"{why}; that with short ones is {with_short}; {cure}"
                histories[sample][1][name][:] = np.nan
            largest[name][unsure] = at_end[name][unsure] = np.nan
            found.absent[name] = reasons.tolist()
        return found

    def _followed(self, fine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Run the samples that are fine with smaller steps; return coordinates, velocities and accelerations, shape
        (n_kept, 3, n, n_eta), and which samples came to the end, shape (n,)."""
        indicator = self._indicator
        finer = _FinerRun(indicator.kept, (3, *self._plain.shape[2:]))
        system = indicator.model.batch(self._values, self._samples.size)
        run = integrate(system, indicator.finer, alive=fine, observer=finer, prefix=ERROR_PREFIX)
        return finer.states, fine & (run.status == Status.FINE)

    def _evaluate(
        self, schedule: Schedule, chosen: np.ndarray, states: np.ndarray, about: np.ndarray, begin: Begin | None
    ) -> dict[str, np.ndarray]:
        """Return errors (n_e, n) of some samples at the ends of the run's own steps among the instants of a schedule.

        States are of all samples, as of `_followed`; `about` tells which of the chosen ones are advanced at all, and
        `begin` is as of `ErrorSystem`.
        """
        indicator, r = self._indicator, self._indicator.model.kinematics.n_coordinates
        checking, states = indicator.checking, states[schedule.places][:, :, chosen]
        step = indicator.step / reference_motion.FINER
        values = {name: np.ascontiguousarray(value[chosen]) for name, value in self._values.items()}
        if self._batch is None or not np.array_equal(self._batch[0], chosen):
            self._batch = chosen, checking.batch(values, chosen.size)
        full = checking.scheduled(self._batch[1], schedule, step)
        unknowns, longest, turns = checking.unknowns_of, indicator.simulation.duration, indicator.model.terms.scale[:r]
        motion = ReferenceMotion(unknowns, full.n_dofs, states, r, longest, checking.rotations, turns)
        system = ErrorSystem(full, motion, schedule.interval, states[0, 0, :, :r].T, begin)
        checking.control(system, schedule, step)
        time = schedule.steps * step
        observed = _Observed(checking.full, full, values, motion, schedule, time)
        steps = {"step": schedule.interval, "duration": (len(states) - 1) * schedule.interval}
        simulation = indicator.simulation.model_copy(update={**steps, "spectral_radius": schedule.spectral_radius})
        run = integrate(system, simulation, alive=about, observer=observed, prefix=ERROR_PREFIX)
        # samples that failed stay at the start: they may be where nothing can be placed
        places = self._place[schedule.steps[schedule.told] // reference_motion.FINER]
        plain, beside = self._plain[places][:, :, chosen], self._beside[places][:, chosen]
        plain = np.where(about[:, None], plain, plain[:1])
        errors = self._errors(time[schedule.told], plain, beside, observed.outputs(), values)
        # where one output cannot be evaluated, the corrected motion ran away, and the others mean nothing either
        known = np.all([run.status == Status.FINE, *(np.isfinite(e).all(axis=0) for e in errors.values())], axis=0)
        return {name: np.where(known, error, np.nan) for name, error in errors.items()}

    def _errors(
        self, time: np.ndarray, plain: np.ndarray, beside: np.ndarray, there: Arrays, values: Arrays
    ) -> dict[str, np.ndarray]:
        """Return reduced less corrected outputs, shape (n_e, n), at times (n_e,), s, from reduced coordinates, rates
        and accelerations, (n_e, 3, n, n_eta), and what is beside, (n_e, n, 2, n_names)."""
        model, shape = self._indicator.told, (plain.shape[0], plain.shape[2])
        states = State(*np.moveaxis(plain, 1, 0).reshape(3, -1, plain.shape[3]), np.zeros(0))
        states.forces = beside.reshape(len(states.q), *beside.shape[2:])
        every_time = {name: np.tile(value, shape[0]) for name, value in values.items()}
        here = model.outputs.evaluate(model.observed_of(np.repeat(time, shape[1]), states, every_time))
        here, there = (
            model.outputs.counted_over(time, {k: v.reshape(shape) for k, v in found.items()}, values)
            for found in (here, there)
        )
        return judged(model.scene, {name: here[name] - there[name] for name in here})

    def _placeable(self, states: np.ndarray) -> np.ndarray:
        """Return which samples stay finite, and where the rigid mechanism can be placed, shape (n,)."""
        r = self._indicator.model.kinematics.n_coordinates
        theta = states[:, 0, :, :r]
        finite = np.isfinite(states).all(axis=(0, 1, 3))
        reached = self._indicator.model.kinematics.within_reach(theta)
        return finite & reached.all(axis=0)


class _Observed(PooledObserver):
    """Outputs of n corrected motions at some of the instants, evaluated for many together; observes their errors."""

    def __init__(
        self,
        model: ComponentModel,
        batch: FullBatch,
        values: Arrays,
        motion: ReferenceMotion,
        schedule: Schedule,
        time: np.ndarray,
    ) -> None:
        super().__init__(max(1, TOGETHER // (batch.n_dofs * batch.n_samples)))
        self._model, self._batch, self._values, self._motion = model, batch, values, motion
        self._told, self._time = schedule.told, time
        self._found: list[dict[str, np.ndarray]] = []

    def over(self, numbers: np.ndarray, times: np.ndarray, errors: State) -> None:
        told = self._told[numbers]
        motion, error = self._motion.over(int(numbers[0]), told.size)[:, told], errors.at(told)
        with np.errstate(invalid="ignore"):  # a motion that runs away is found by its outputs
            parts = [self._batch.pack(one, 1) + e for one, e in zip(motion, (error.q, error.v, error.a))]
        super().over(numbers[told], times[told], State(*parts, error.multipliers, error.turns))

    def see(self, first: int, states: State) -> None:
        batch, time, clock = self._batch, self._time[self.numbers[first:]], np.array(self.times[first:])
        forces = batch.joint_multipliers(clock, states) if self._model.outputs.forces else None
        beside = batch.beside.forces(clock, AFTER)[:, 0].T if self._model.outputs.beside else None
        values = {name: np.tile(value, time.size) for name, value in self._values.items()}
        time, frames = np.repeat(time, batch.n_samples), batch.frames_over(states)
        observed = self._model.observed_of(time, frames, values, *batch.unknowns_over(states), forces, beside)
        self._found.append(self._model.outputs.evaluate(observed))

    def outputs(self) -> dict[str, np.ndarray]:
        """Return every output, shape (n_e n,)."""
        self.finish()
        return {name: np.concatenate([found[name] for found in self._found]) for name in self._found[0]}


def indicator_of(model: Reduced) -> ErrorIndicator | MemberIndicator:
    """Return what estimates the errors of a model's samples."""
    apart = model.lengths if isinstance(model, LengthLanes) else offset_names(model.scene)
    return MemberIndicator(model, apart) if apart or model.scene.beside else ErrorIndicator(model)


class MemberIndicator:
    """Estimates the errors of runs of samples with mechanisms of their own; see `ErrorIndicator`.

    Every value of a parameter that is `apart` makes a mechanism of its own: lengths, or by how much joints are off.
    Controllers, and what joints carry, are of one sample of the full-order equations.
    """

    def __init__(self, model: Reduced, apart: Iterable[str]) -> None:
        self.model, self._apart = model, sorted(apart)
        self._simulation = model.scene.simulation

    def stepped(self, simulation: Simulation) -> MemberIndicator:
        """Return the indicator of runs of the same model with other steps."""
        other = copy(self)
        other._simulation = simulation
        return other

    def watch(self, system: ReducedSystem, samples: np.ndarray) -> WatchedSamples:
        return WatchedSamples([self._of(system, int(sample)) for sample in samples], self.model.outputs.functions)

    def _of(self, system: ReducedSystem, sample: int) -> WatchedRun | None:
        """Begin to watch a sample; None where its mechanism cannot be closed."""
        if not self._apart:
            return self._of_all.stepped(self._simulation).watch(system, np.array([sample]))
        given = {name: float(system.values[name][sample]) for name in self._apart}
        try:
            own = self.model.at_lengths(self.model.scene.with_values(given))
        except InputError:
            return None
        return ErrorIndicator(own, self.model).stepped(self._simulation).watch(system, np.array([sample]))

    @cached_property
    def _of_all(self) -> ErrorIndicator:
        """The indicator of samples that have the model's own mechanism."""
        return ErrorIndicator(self.model)


class WatchedSamples(Observer):
    """The run of one batch, whose samples are watched one by one; see `WatchedRun`."""

    def __init__(self, runs: list[WatchedRun | None], outputs: Iterable[str]) -> None:
        self._runs, self._outputs = runs, outputs

    def over(self, numbers: np.ndarray, times: np.ndarray, states: State) -> None:
        for run in self._runs:
            if run is not None:
                run.over(numbers, times, states)

    def estimate(self, status: np.ndarray) -> Estimate:
        """Return the estimate once the run has ended with the status of the whole batch, shape (n_batch,)."""
        found = Estimate.nothing(self._outputs, len(self._runs))
        for sample, run in enumerate(self._runs):
            if run is not None:
                found.put([sample], run.estimate(status))
        return found
