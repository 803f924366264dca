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
from pgmp_petsc.indicator.schedule import Schedule, agree, kept_steps, most_evaluations, schedules
from pgmp_petsc.indicator.step_error import SOFTEST, StepError, Turns, find_turns
from pgmp_petsc.models import ComponentModel, LengthLanes, ReducedModel

if TYPE_CHECKING:
    from pgmp_petsc.scene.numerics import Simulation

# rad that a sample may turn with the same modes. Vibrations from two instants add up or cancel, by their phase: over
# 80 periods in between, a frequency that is wrong by a thousandth turns it by a twelfth of a period.
HOLD = 0.03
TOGETHER = 2**21  # unknowns of instants whose outputs are evaluated together
FINER = 4  # steps of the run that is followed in one of the run itself
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
    stopped
        Which samples have none because their runs with smaller steps stopped, shape (n,).
    unsure
        Which have none of an output because two sets of instants disagree, shape (n,).
    """

    largest: dict[str, np.ndarray]
    at_end: dict[str, np.ndarray]
    histories: tuple[tuple[np.ndarray, dict[str, np.ndarray]], ...]
    stopped: np.ndarray
    unsure: dict[str, np.ndarray]


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
        self._most = most_evaluations(self.checking.full.kinematics.mechanism)
        self._take_steps_of(model.scene.simulation)

    def _take_steps_of(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.n_steps = count_steps(simulation.duration, simulation.step)
        self.step = simulation.duration / self.n_steps
        self.finer = simulation.model_copy(update={"step": self.step / FINER})
        self.schedules = schedules(self.n_steps, simulation.duration, self._most)
        self.kept = kept_steps([schedule.steps for schedule in self.schedules])

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


class _FinerRun:
    """The observer of a run with smaller steps: what its steps still do to it, at the instants that are evaluated."""

    every = 1

    def __init__(self, indicator: ErrorIndicator, values: Mapping[str, np.ndarray], n: int) -> None:
        self._indicator, self._values = indicator, values
        self._weights = indicator.modes.weights(values, n)
        kept = FINER * indicator.kept
        self._place = np.full(FINER * indicator.n_steps + 1, -1)
        self._place[kept] = np.arange(kept.size)
        r = self._r = indicator.model.kinematics.n_coordinates
        self.states = np.empty((kept.size, 3, n, r + indicator.model.terms.tables.n_modes))

    def __call__(self, number: int, time: float, state: State) -> None:
        """Take in the state after a step; the observer of the run."""
        if number == 0:
            self._begin(np.array([state.q, state.v, state.a]))
        else:
            self.over(np.array([number]), np.array([time]), np.array([[state.q, state.v, state.a]]))

    def over(self, numbers: np.ndarray, times: np.ndarray, motion: np.ndarray) -> None:
        """Take in the states after many steps; see `TrailObserver`."""
        # a sample that fails may overflow here before it is given up
        with np.errstate(all="ignore"):
            shares = self._crossings.over(times, motion)
            exact, missing = self._step_error.advance(motion, shares, self._turns(numbers, motion))
            self._keep(numbers, motion, exact, missing)

    def _begin(self, start: np.ndarray) -> None:
        q, v, _ = start
        step, r = self._indicator.step / FINER, self._r
        self._middles = q[:, :r] + 0.5 * np.copysign(HOLD, v[:, :r])
        modes = self._indicator.modes.at(self._middles, self._weights)
        self.slowest = 1.0 / np.maximum(modes.omega[:, 0], SOFTEST / step)
        self._step_error = StepError(step, start.copy(), modes, self._indicator.checking.driven)
        self._crossings = EdgeCrossings(self._indicator.model, self._values, start)
        self.states[0] = start

    def _turns(self, numbers: np.ndarray, motion: np.ndarray) -> Turns | None:
        """Return where samples take other modes in some steps, given by their numbers, (n_t, 3, n, n_eta)."""
        looks = np.flatnonzero(numbers % LOOK == 0)
        n_samples = motion.shape[2]
        most = looks.size * n_samples
        places, who, middles = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64), np.empty((most, self._r))
        n = find_turns(motion, looks, HOLD, self._middles, places, who, middles)
        if not n:
            return None
        weights = tuple(part[who[:n]] for part in self._weights)
        return Turns(places[:n], who[:n], self._indicator.modes.at(middles[:n], weights))

    def _keep(self, numbers: np.ndarray, motion: np.ndarray, exact: np.ndarray, missing: np.ndarray) -> None:
        """Keep what may be evaluated of some steps, given by their numbers."""
        kept = np.flatnonzero(self._place[numbers] >= 0)
        places = self._place[numbers[kept]]
        self.states[places, :2], self.states[places, 2] = exact[kept], motion[kept, 2]
        self.states[places] += missing[kept]


class WatchedRun:
    """The run of one batch: its observer while it runs, its estimate afterwards."""

    every = 1

    def __init__(self, indicator: ErrorIndicator, values: Mapping[str, np.ndarray], samples: np.ndarray) -> None:
        self._indicator = indicator
        self._values = values
        self._samples = samples
        self._place = np.full(indicator.n_steps + 1, -1)
        self._place[indicator.kept] = np.arange(indicator.kept.size)
        n_eta = indicator.model.kinematics.n_coordinates + indicator.model.terms.tables.n_modes
        self._plain = np.empty((indicator.kept.size, samples.size, n_eta))
        self._batch: FullBatch | None = None

    def __call__(self, number: int, time: float, state: State) -> None:
        """Take in the state after a step; the observer of the run."""
        self._keep(np.array([number]), state.q[None])

    def over(self, numbers: np.ndarray, times: np.ndarray, trail: np.ndarray) -> None:
        """Take in the states after many steps; see `TrailObserver`."""
        self._keep(numbers, trail[:, 0])

    def _keep(self, numbers: np.ndarray, motion: np.ndarray) -> None:
        places = self._place[numbers]
        kept = places >= 0
        self._plain[places[kept]] = motion[kept][:, self._samples]

    def estimate(self, status: np.ndarray) -> Estimate:
        """Return the estimate once the run has ended.

        Parameters
        ----------
        status
            Of the whole batch, shape (n_batch,).
        """
        indicator, n = self._indicator, self._samples.size
        fine = status[self._samples] == Status.FINE
        states, slowest, followed = self._followed(fine)
        about = followed & self._placeable(states)
        equilibria = indicator.checking.equilibria(self._values, about)
        if equilibria is not None:
            about &= np.isfinite(equilibria).all(axis=0)
        # what cannot be placed stands still at the start, and is never advanced
        states[:, :, ~about] = states[:1, :, ~about]
        found = [self._evaluate(schedule, states, slowest, about, equilibria) for schedule in indicator.schedules]
        sizes = [{name: np.max(np.abs(error), axis=0) for name, error in errors.items()} for errors in found]
        unsure = {name: np.zeros(n, dtype=bool) for name in sizes[0]}
        if len(sizes) > 1:
            known = {name: np.isfinite(sizes[-1][name]) for name in unsure}
            unsure = {name: known[name] & ~same for name, same in agree(*sizes).items()}
        errors = {name: np.where(unsure[name], np.nan, error) for name, error in found[-1].items()}
        time = indicator.schedules[-1].steps * indicator.step
        return Estimate(
            {name: np.where(unsure[name], np.nan, size) for name, size in sizes[-1].items()},
            {name: error[-1] for name, error in errors.items()},
            tuple((time, {name: error[:, k] for name, error in errors.items()}) for k in range(n)),
            fine & ~followed,
            unsure,
        )

    def _followed(self, fine: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Run the samples that are fine with smaller steps.

        Returns
        -------
        states : ndarray, shape (n_kept, 3, n, n_eta)
            Coordinates, velocities and accelerations without what those steps still do.
        slowest : ndarray, shape (n,)
            Time in which the slowest vibration turns by a radian, s.
        followed : ndarray, shape (n,)
            Which samples came to the end.
        """
        indicator, n = self._indicator, self._samples.size
        finer = _FinerRun(indicator, self._values, n)
        system = indicator.model.batch(self._values, n)
        run = integrate(system, indicator.finer, alive=fine, observer=finer, prefix=ERROR_PREFIX)
        return finer.states, finer.slowest, fine & (run.status == Status.FINE)

    def _evaluate(
        self,
        schedule: Schedule,
        states: np.ndarray,
        slowest: np.ndarray,
        about: np.ndarray,
        equilibria: np.ndarray | None,
    ) -> dict[str, np.ndarray]:
        """Return errors (n_e, n) at the instants of a schedule; `equilibria` as of `ErrorSystem`."""
        indicator, r = self._indicator, self._indicator.model.kinematics.n_coordinates
        checking, states = indicator.checking, states[schedule.places]
        full = checking.scheduled(self._full, schedule, indicator.step, FINER)
        motion = ReferenceMotion(checking.unknowns_of, full.n_dofs, states, r, slowest, checking.rotations)
        system = ErrorSystem(full, motion, schedule.interval, states[0, 0, :, :r].T, equilibria)
        observed = _Observed(checking.full, full, self._values, motion)
        simulation = indicator.simulation.model_copy(
            update={
                "step": schedule.interval,
                "duration": (len(states) - 1) * schedule.interval,
                "spectral_radius": 0.0,
            }
        )
        run = integrate(system, simulation, alive=about, observer=observed, prefix=ERROR_PREFIX)
        errors = self._errors(self._plain[schedule.places], observed.outputs(), about)
        # where one output cannot be evaluated, the corrected motion ran away, and the others mean nothing either
        known = np.all([run.status == Status.FINE, *(np.isfinite(e).all(axis=0) for e in errors.values())], axis=0)
        return {name: np.where(known, error, np.nan) for name, error in errors.items()}

    @property
    def _full(self) -> FullBatch:
        """The full-order equations of the samples."""
        if self._batch is None:
            self._batch = self._indicator.checking.batch(self._values, self._samples.size)
        return self._batch

    def _errors(
        self, plain: np.ndarray, there: Mapping[str, np.ndarray], known: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return reduced less corrected outputs, shape (n_e, n), from reduced coordinates (n_e, n, n_eta)."""
        model, shape = self._indicator.told, plain.shape[:2]
        # samples that failed stand still at the start: they may be where nothing can be placed
        plain = np.where(known[:, None], plain, plain[:1])
        every_time = {name: np.tile(value, shape[0]) for name, value in self._values.items()}
        here = model.outputs.evaluate(model.observed_of(plain.reshape(-1, plain.shape[2]), every_time))
        return {name: (here[name] - there[name]).reshape(shape) for name in here}

    def _placeable(self, states: np.ndarray) -> np.ndarray:
        """Return which samples stay finite, and where the rigid mechanism can be placed, shape (n,)."""
        r = self._indicator.model.kinematics.n_coordinates
        theta = states[:, 0, :, :r]
        finite = np.isfinite(states).all(axis=(0, 1, 3))
        reached = self._indicator.model.kinematics.within_reach(theta).reshape(theta.shape[:3])
        return finite & reached.all(axis=(0, 2))


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
        motion = self._motion.over(number, len(errors))[0]
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
