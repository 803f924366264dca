"""Estimated errors of reduced runs, from the residual of their motion in the full-order equations.

The estimate has three parts, each of which follows a kind of error through the run:

- `step_error`: vibrations that the time step changes, mode by mode; the angle that an exact step would have reached,
- `sampled_load`: what loads do between two steps,
- `residual_error`: all that the full-order equations say against the motion so corrected. This is what the reduction
  leaves out (modes, terms, parameters, interpolation), and what the change of the angle sets off.

Nothing is linearised about the reduced motion but the vibrations, so that ``q_reduced - error`` is an estimate of the
full-order motion itself, and outputs are evaluated there.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.dynamics.full_batch import FullBatch
from pgmp_petsc.dynamics.generalised_alpha import count_steps, integrate
from pgmp_petsc.dynamics.second_order_system import State
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.dynamics.ts_options import ERROR_PREFIX
from pgmp_petsc.indicator.checking_model import CheckingModel
from pgmp_petsc.indicator.edge_crossings import EdgeCrossings
from pgmp_petsc.indicator.flexible_modes import FlexibleModes
from pgmp_petsc.indicator.reference_motion import ReferenceMotion
from pgmp_petsc.indicator.residual_error import ErrorSystem
from pgmp_petsc.indicator.schedule import Schedule, agree, choose, longest_intervals, schedules
from pgmp_petsc.indicator.step_error import SOFTEST, StepError, Turns, find_turns
from pgmp_petsc.models import ComponentModel, LengthLanes, ReducedModel

if TYPE_CHECKING:
    from pgmp_petsc.scene.numerics import Simulation

# rad that a sample may turn with the same modes. Vibrations from two instants add up or cancel, by their phase: over
# 80 periods in between, a frequency that is wrong by a thousandth turns it by a twelfth of a period.
HOLD = 0.03
TOGETHER = 2**21  # unknowns of instants whose outputs are evaluated together
LOOK = 10  # steps after which it is looked at whether a sample has turned


@dataclass(frozen=True)
class Estimate:
    """Estimated errors of n samples; NaN where a sample failed or has no estimate.

    Attributes
    ----------
    largest
        Largest size of the error of every output over the run, shape (n,).
    at_end
        Error of every output at the end, reduced less full-order, shape (n,).
    histories
        Of every sample: instants (s), and errors of every output at these, each of shape (n_e,).
    """

    largest: dict[str, np.ndarray]
    at_end: dict[str, np.ndarray]
    histories: tuple[tuple[np.ndarray, dict[str, np.ndarray]], ...]


class ErrorIndicator:
    """Estimates the errors of runs of one reduced model; to be made once for all of them.

    Parameters
    ----------
    model
        The reduced model.
    told
        The model whose outputs runs have, where these are not the model's own.
    """

    def __init__(self, model: ReducedModel, told: LengthLanes | None = None) -> None:
        self.model, self.told = model, told or model
        self.checking = CheckingModel(model)
        terms, scheme = model.terms, model.scene.reduction.interpolation
        self.modes = FlexibleModes(terms.tables, scheme, terms.damping, self.checking.driven)
        self._take_steps_of(model.scene.simulation)

    def _take_steps_of(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.n_steps = count_steps(simulation.duration, simulation.step)
        self.step = simulation.duration / self.n_steps
        self.schedules = schedules(self.n_steps, simulation.duration)

    def stepped(self, simulation: Simulation) -> ErrorIndicator:
        """Return the indicator of runs of the same model with other steps."""
        if simulation == self.simulation:
            return self
        other = copy(self)
        other._take_steps_of(simulation)
        return other

    def watch(self, values: Mapping[str, np.ndarray], samples: np.ndarray) -> WatchedRun:
        """Begin to watch a run of a batch.

        Parameters
        ----------
        values
            Parameter values of the whole batch, each of shape (n_batch,).
        samples
            Numbers of the samples within the batch whose errors are wanted, shape (n,).
        """
        return WatchedRun(self, {name: value[samples] for name, value in values.items()}, np.asarray(samples))


class WatchedRun:
    """The run of one batch: its observer while it runs, its estimate afterwards."""

    every = 1

    def __init__(self, indicator: ErrorIndicator, values: Mapping[str, np.ndarray], samples: np.ndarray) -> None:
        self._indicator = indicator
        self._values = values
        self._samples = samples
        self._weights = indicator.modes.weights(values, samples.size)
        kept = indicator.schedules[-1].steps
        self._place = np.full(indicator.n_steps + 1, -1)
        self._place[kept] = np.arange(kept.size)
        r = self._r = indicator.model.kinematics.n_coordinates
        n_eta = r + indicator.model.terms.tables.n_modes
        # coordinates, velocities, accelerations, and what vibrations lack; and the rigid coordinates of the run itself
        self._states = np.empty((kept.size, 4, samples.size, n_eta))
        self._theta = np.empty((kept.size, samples.size, r))
        self._speeds = np.zeros(samples.size)
        self._batch: tuple[np.ndarray, FullBatch] | None = None

    def __call__(self, number: int, time: float, state: State) -> None:
        """Take in the state after a step; the observer of the run."""
        if number == 0:
            self._begin(np.array([part[self._samples] for part in (state.q, state.v, state.a)]))
        else:
            self.over(np.array([number]), np.array([time]), np.array([[state.q, state.v, state.a]]))

    def over(self, numbers: np.ndarray, times: np.ndarray, trail: np.ndarray) -> None:
        """Take in the states after many steps; see `TrailObserver`."""
        motion = np.take(trail, self._samples, axis=2)
        # a sample that fails may overflow here before it is given up
        with np.errstate(all="ignore"):
            shares = self._crossings.over(times, motion)
            exact, missing = self._step_error.advance(motion, shares, self._turns(numbers, motion))
            self._keep(numbers, motion, exact, missing)

    def _begin(self, start: np.ndarray) -> None:
        q, v, a = start
        r = self._r
        self._middles = q[:, :r] + 0.5 * np.copysign(HOLD, v[:, :r])
        modes = self._indicator.modes.at(self._middles, self._weights)
        self._slowest = 1.0 / np.maximum(modes.omega[:, 0], SOFTEST / self._indicator.step)
        self._step_error = StepError(self._indicator.step, start.copy(), modes, self._indicator.checking.driven)
        self._crossings = EdgeCrossings(self._indicator.model, self._values, start)
        self._states[0] = q, v, a, np.zeros_like(q)
        self._theta[0] = q[:, :r]

    def _turns(self, numbers: np.ndarray, motion: np.ndarray) -> Turns | None:
        """Return where samples take other modes in some steps, given by their numbers, (n_t, 3, n, n_eta)."""
        looks = np.flatnonzero(numbers % LOOK == 0)
        most = looks.size * self._samples.size
        places, who, middles = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64), np.empty((most, self._r))
        n = find_turns(motion, looks, HOLD, self._middles, places, who, middles)
        if not n:
            return None
        weights = tuple(part[who[:n]] for part in self._weights)
        return Turns(places[:n], who[:n], self._indicator.modes.at(middles[:n], weights))

    def _keep(self, numbers: np.ndarray, motion: np.ndarray, exact: np.ndarray, missing: np.ndarray) -> None:
        """Keep what may be evaluated of some steps, given by their numbers."""
        r, kept = self._r, np.flatnonzero(self._place[numbers] >= 0)
        places = self._place[numbers[kept]]
        self._states[places, :2], self._states[places, 2] = exact[kept], motion[kept, 2]
        self._states[places, 3], self._theta[places] = missing[kept], motion[kept, 0, :, :r]
        np.maximum(self._speeds, np.max(np.abs(motion[:, 1, :, :r]), axis=(0, 2)), out=self._speeds)

    def estimate(self, status: np.ndarray) -> Estimate:
        """Return the estimate once the run has ended.

        Parameters
        ----------
        status
            Of the whole batch, shape (n_batch,).
        """
        n, names = self._samples.size, self._indicator.model.outputs.functions
        largest, at_end = ({name: np.full(n, np.nan) for name in names} for _ in range(2))
        fine = (status[self._samples] == Status.FINE) & self._placeable()
        equilibria = self._indicator.checking.equilibria(self._values, fine)
        if equilibria is not None:
            fine &= np.isfinite(equilibria).all(axis=0)
        with np.errstate(all="ignore"):
            bent, missing = (np.max(np.abs(self._states[:, part, :, self._r :]), axis=(0, 2)) for part in (0, 3))
            longest = longest_intervals(self._speeds, missing / bent, self._slowest, self._crossings.shortest)
        needed = choose(self._indicator.schedules, np.where(fine, longest, np.inf))
        histories: list = [None] * n
        settled = np.zeros(n, dtype=bool)
        for number, schedule in enumerate(self._indicator.schedules):
            # of no use to compare with where every step is evaluated
            compared = (number == needed - 1) & ~self._complete(needed)
            chosen = np.flatnonzero(~settled & ((number >= needed) | compared))
            if not chosen.size:
                continue
            begin = None if equilibria is None else equilibria[:, chosen]
            errors = self._evaluate(schedule, chosen, fine[chosen], begin)
            now = {name: np.max(np.abs(error), axis=0) for name, error in errors.items()}
            agreed = agree({name: values[chosen] for name, values in largest.items()}, now)
            settled[chosen] = (number >= needed[chosen]) & (agreed | schedule.complete | ~fine[chosen])
            for name, error in errors.items():
                largest[name][chosen], at_end[name][chosen] = now[name], error[-1]
            time = schedule.steps * self._indicator.step
            for column, sample in enumerate(chosen):
                histories[sample] = time, {name: error[:, column] for name, error in errors.items()}
        return Estimate(largest, at_end, tuple(histories))

    def _evaluate(
        self, schedule: Schedule, chosen: np.ndarray, fine: np.ndarray, begin: np.ndarray | None
    ) -> dict[str, np.ndarray]:
        """Return errors (n_e, n) of some samples at the instants of a schedule; `begin` as of `ErrorSystem`."""
        checking, r = self._indicator.checking, self._r
        states = self._states[schedule.places][:, :, chosen]
        # what cannot be placed stands still at the start, and is never advanced
        states[:, :, ~fine] = states[:1, :, ~fine]
        plain = states[:, 0].copy()
        plain[:, fine, :r] = self._theta[schedule.places][:, chosen[fine]]
        values = {name: np.ascontiguousarray(value[chosen]) for name, value in self._values.items()}
        full = checking.scheduled(self._batch_of(chosen, values), schedule, self._indicator.step)
        slowest = self._slowest[chosen]
        motion = ReferenceMotion(checking.unknowns_of, full.n_dofs, states, r, slowest, checking.rotations)
        system = ErrorSystem(full, motion, schedule.interval, states[0, 0, :, :r].T, begin)
        observed = _Observed(checking.full, full, values, motion)
        simulation = self._indicator.simulation.model_copy(
            update={
                "step": schedule.interval,
                "duration": (len(states) - 1) * schedule.interval,
                "spectral_radius": 0.0,
            }
        )
        run = integrate(system, simulation, alive=fine, observer=observed, prefix=ERROR_PREFIX)
        errors = self._errors(plain, observed.outputs(), values)
        # where one output cannot be evaluated, the corrected motion ran away, and the others mean nothing either
        known = np.all([run.status == Status.FINE, *(np.isfinite(e).all(axis=0) for e in errors.values())], axis=0)
        return {name: np.where(known, error, np.nan) for name, error in errors.items()}

    def _batch_of(self, chosen: np.ndarray, values: Mapping[str, np.ndarray]) -> FullBatch:
        """Return the equations of some samples; those of the last call where they are the same."""
        if self._batch is None or not np.array_equal(self._batch[0], chosen):
            self._batch = chosen, self._indicator.checking.batch(values, chosen.size)
        return self._batch[1]

    def _complete(self, numbers: np.ndarray) -> np.ndarray:
        """Return whether schedules, given by their numbers, evaluate every step."""
        return np.array([schedule.complete for schedule in self._indicator.schedules])[numbers]

    def _errors(
        self, plain: np.ndarray, there: Mapping[str, np.ndarray], values: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Return reduced less corrected outputs, shape (n_e, n), from reduced coordinates (n_e, n, n_eta)."""
        model, shape = self._indicator.told, plain.shape[:2]
        every_time = {name: np.tile(value, shape[0]) for name, value in values.items()}
        here = model.outputs.evaluate(model.observed_of(plain.reshape(-1, plain.shape[2]), every_time))
        return {name: (here[name] - there[name]).reshape(shape) for name in here}

    def _placeable(self) -> np.ndarray:
        """Return which samples stay finite, and where the rigid mechanism can be placed, shape (n,)."""
        r = self._r
        theta = np.array([self._states[:, 0, :, :r], self._states[:, 0, :, :r] + self._states[:, 3, :, :r]])
        finite = np.isfinite(self._states).all(axis=(0, 1, 3))
        reached = self._indicator.model.kinematics.within_reach(theta).reshape(theta.shape[:3])
        return finite & reached.all(axis=(0, 1))


class _Observed:
    """Outputs of n corrected motions, evaluated for many instants together; observes their errors."""

    def __init__(
        self, model: ComponentModel, batch: FullBatch, values: Mapping[str, np.ndarray], motion: ReferenceMotion
    ) -> None:
        self._model, self._batch, self._values, self._motion = model, batch, values, motion
        self._waiting: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self._found: list[dict[str, np.ndarray]] = []

    def __call__(self, number: int, time: float, error: State) -> None:
        """Take in the error at an instant."""
        self._take(number, error.q[None], error.turns[None])

    def over_states(self, numbers: np.ndarray, times: np.ndarray, errors: State) -> None:
        """Take in the errors at many instants in turn; see `StatesObserver`."""
        self._take(int(numbers[0]), errors.q, errors.turns)

    def _take(self, number: int, errors: np.ndarray, turns: np.ndarray) -> None:
        motion = self._motion.shaken(number, len(errors))
        # what is kept of states has to be theirs: angles are counted on in place
        self._waiting.append((motion, errors, turns.copy()))
        if sum(part.size for part, _, _ in self._waiting) > TOGETHER:
            self._evaluate()

    def _evaluate(self) -> None:
        motions, *errors = (np.concatenate(parts) for parts in zip(*self._waiting))
        n_e, n = len(motions), self._batch.n_samples
        # the axis of instants behind that of unknowns
        errors, turns = (self._batch.unpack(np.moveaxis(part, 0, 2)) for part in errors)
        q = (np.moveaxis(motions, 0, 1) + errors).reshape(-1, n_e * n)
        values = {name: np.tile(value, n_e) for name, value in self._values.items()}
        frames = self._batch.frames_of(q, turns.reshape(len(turns), n_e * n))
        self._found.append(self._model.outputs.evaluate(self._model.observed_of(q, frames, values)))
        self._waiting.clear()

    def outputs(self) -> dict[str, np.ndarray]:
        """Return every output, shape (n_e n,)."""
        if self._waiting:
            self._evaluate()
        return {name: np.concatenate([found[name] for found in self._found]) for name in self._found[0]}
