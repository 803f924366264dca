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
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.dynamics.full_batch import FullBatch
from pgmp_petsc.dynamics.generalised_alpha import State, count_steps, integrate
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.effects import effects_of
from pgmp_petsc.indicator.flexible_modes import FlexibleModes
from pgmp_petsc.indicator.reference_motion import LARGEST, ReferenceMotion
from pgmp_petsc.indicator.residual_error import ErrorSystem
from pgmp_petsc.indicator.sampled_load import SampledLoad
from pgmp_petsc.indicator.step_error import StepError
from pgmp_petsc.indicator.validity import Validity
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.models.model import start_of

N_EVALUATIONS = 100
N_HOLDS = 25  # how often the modes of the vibrations are taken anew
PREFIX = "pgmp_error_ts_"


@dataclass(frozen=True)
class Estimate:
    """Estimated errors and validity of n samples; NaN where a sample failed or has no estimate.

    Attributes
    ----------
    time
        Instants of evaluation, shape (n_e,), s.
    errors
        Reduced less full-order value of every output, shape (n_e, n).
    validity
        See `validity`; each of shape (n,).
    """

    time: np.ndarray
    errors: dict[str, np.ndarray]
    validity: dict[str, np.ndarray]

    @property
    def largest(self) -> dict[str, np.ndarray]:
        """Largest size of the error of every output over the run, shape (n,)."""
        return {name: np.max(np.abs(error), axis=0) for name, error in self.errors.items()}


class ErrorIndicator:
    """Estimates the errors of runs of one reduced model; to be made once for all of them."""

    def __init__(self, model: ReducedModel) -> None:
        self.model = model
        self.simulation = model.scene.simulation
        self.n_steps = count_steps(self.simulation.duration, self.simulation.step)
        self.step = self.simulation.duration / self.n_steps
        self.steps = evaluation_steps(self.n_steps)
        self.interval = self.simulation.duration / (self.steps.size - 1)
        self.modes = FlexibleModes(model.terms.tables, model.scene.reduction.interpolation)
        self.loads = tuple(
            SampledLoad(effect, self.steps, self.step, self.interval)
            for effect in effects_of(model.scene, model.kinematics.mechanism)
        )

    def watch(self, values: Mapping[str, np.ndarray], samples: np.ndarray) -> WatchedRun:
        """Begin to watch a run of a batch.

        Parameters
        ----------
        values
            Parameter values of the whole batch, each of shape (n_batch,).
        samples
            Numbers of the samples within the batch whose errors are wanted, shape (n,).
        """
        chosen = {name: np.ascontiguousarray(value[samples]) for name, value in values.items()}
        return WatchedRun(self, chosen, np.asarray(samples))


class WatchedRun:
    """The run of one batch: its observer while it runs, its estimate afterwards."""

    def __init__(self, indicator: ErrorIndicator, values: Mapping[str, np.ndarray], samples: np.ndarray) -> None:
        self._indicator = indicator
        self._values = values
        self._samples = samples
        self._weights = indicator.modes.weights(values, samples.size)
        self._evaluated = set(indicator.steps.tolist())
        holds = np.linspace(0, indicator.n_steps, N_HOLDS + 1).round().astype(int)
        self._holds = dict(zip(holds[:-1].tolist(), np.diff(holds).tolist()))
        self._plain: list[np.ndarray] = []
        self._states: list[np.ndarray] = []

    def observe(self, number: int, time: float, state: State) -> None:
        """Take in the state after a step; the observer of the run."""
        q, v, a = (part[self._samples] for part in (state.q, state.v, state.a))
        # a sample that fails may overflow here before it is given up
        with np.errstate(all="ignore"):
            if number > 0:
                self._step_error.advance(q, v, a)
            if number in self._holds:
                self._hold(number, q, v, a)
            if number in self._evaluated:
                self._plain.append(q)
                self._states.append(np.array([*self._step_error.exact_steps(), a, self._step_error.vibration()]))

    def _hold(self, number: int, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        """Take the modes anew, those of the middle of the stretch that they are held for."""
        ahead = q[:, 0] + 0.5 * self._holds[number] * self._indicator.step * v[:, 0]
        modes = self._indicator.modes.at(ahead, self._weights)
        if number == 0:
            self._step_error = StepError(self._indicator.step, q, v, a, modes)
        else:
            self._step_error.hold(modes)

    def estimate(self, status: np.ndarray) -> Estimate:
        """Return the estimate once the run has ended.

        Parameters
        ----------
        status
            Of the whole batch, shape (n_batch,).
        """
        model, simulation = self._indicator.model, self._indicator.simulation
        plain, states = np.array(self._plain), np.array(self._states)
        fine = (status[self._samples] == Status.FINE) & self._placeable(states)
        # what cannot be placed stands still at the start, and is never advanced
        for part in (plain, states):
            part[..., ~fine, :] = part[:1, ..., ~fine, :]
        n, interval = self._samples.size, self._indicator.interval
        motion = ReferenceMotion(model.frames_of, states, self._indicator.step)
        start = start_of(model.scene, model.kinematics)
        system = ErrorSystem(FullBatch(model.kinematics, self._indicator.loads, self._values, start, n), motion, interval)
        validity = Validity(model.scene, model.kinematics.mechanism, self._values, n)
        nodes, waiting, corrected = list(model.outputs.nodes), [], []

        def record(number: int, time: float, state: State) -> None:
            nodal = motion.at(number).shaken + system.unpack(state.q)
            waiting.append(nodal.reshape(-1, DOFS_PER_NODE, n))
            corrected.append(waiting[-1][nodes])
            if len(waiting) * nodal.size > LARGEST or number == len(states) - 1:
                theta = states[number + 1 - len(waiting) : number + 1, 0, :, 0]
                poses = model.kinematics.poses(theta.ravel())
                validity.add(np.stack(waiting, axis=2), poses.reshape(*poses.shape[:2], *theta.shape))
                waiting.clear()

        run = integrate(
            system,
            simulation.model_copy(update={"step": interval, "spectral_radius": 0.0}),
            alive=fine,
            observer=record,
            prefix=PREFIX,
        )
        fine &= run.status == Status.FINE
        errors = self._errors(plain, np.array(corrected))
        return Estimate(
            time=self._indicator.steps * self._indicator.step,
            errors={name: np.where(fine, error, np.nan) for name, error in errors.items()},
            validity={name: np.where(fine, validity.largest[name], np.nan) for name in validity.largest},
        )

    def _errors(self, plain: np.ndarray, corrected: np.ndarray) -> dict[str, np.ndarray]:
        """Return reduced less corrected outputs, shape (n_e, n), from coordinates and frames of the outputs' nodes."""
        outputs, shape = self._indicator.model.outputs, plain.shape[:2]
        here = outputs.evaluate(self._indicator.model.output_frames_of(plain.reshape(-1, plain.shape[2])))
        frames = np.moveaxis(corrected, 0, 2)
        there = outputs.evaluate(frames.reshape(*frames.shape[:2], shape[0] * shape[1]))
        return {name: (here[name] - there[name]).reshape(shape) for name in here}

    def _placeable(self, states: np.ndarray) -> np.ndarray:
        """Return which samples stay finite, and where the rigid mechanism can be placed, shape (n,)."""
        theta = np.array([states[:, 0, :, 0], states[:, 0, :, 0] + states[:, 3, :, 0]])
        finite = np.isfinite(states).all(axis=(0, 1, 3))
        return finite & self._indicator.model.kinematics.within_reach(theta).all(axis=(0, 1))


def evaluation_steps(n_steps: int) -> np.ndarray:
    """Return the numbers of the steps at which errors are evaluated: about `N_EVALUATIONS`, as even as steps allow."""
    n_intervals = n_steps if n_steps <= 2 * N_EVALUATIONS else N_EVALUATIONS
    return np.linspace(0, n_steps, n_intervals + 1).round().astype(int)
