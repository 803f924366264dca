"""Generalised-alpha time integration of second-order systems with constraints, as a PETSc TS.

The scheme of Chung and Hulbert (1993) in the form of Arnold and Bruls (2007) for the index-3 equations
``r(t, q, q', q'') + C^T lambda = 0``, ``c(q) = 0``: dynamics and constraints hold exactly at the end of every step,

    (1 - alpha_m) A_{n+1} + alpha_m A_n = (1 - alpha_f) q''_{n+1} + alpha_f q''_n
    q_{n+1}  = q_n  + h q'_n + h^2 ((1/2 - beta) A_n + beta A_{n+1})
    q'_{n+1} = q'_n + h ((1 - gamma) A_n + gamma A_{n+1})

with the auxiliary accelerations A. All coefficients follow from the spectral radius at infinite frequency. A batch of
samples is one bigger system: samples share time and step, but each has its own Newton iteration, so that no sample
can change another.

PETSc's own TSALPHA2 is not used: it is no integrator for index-3 equations, and in PETSc 3.18 it starts with twice
the initial acceleration.

Options prefix: ``pgmp_ts_`` (e.g. ``-pgmp_ts_ts_monitor``), unless a caller gives another one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.runtime.errors import InputError

if TYPE_CHECKING:
    from mpi4py import MPI
    from petsc4py import PETSc

    from pgmp_petsc.scene.numerics import Simulation

PREFIX = "pgmp_ts_"
MAX_ITERATIONS = 12
CAREFUL_ITERATIONS = 40
LONGEST = 0.2  # correction that is not shortened, in units of the mechanism's size or of 1 rad
REFRESH_EVERY = 4  # corrections that share one factorisation
FIRST_CONTRACTION = 0.5  # assumed where only one correction is known
ROUND_OFF = 1e-15
NEWTON_TOLERANCE = 1e-12  # of the remaining correction, in units of the mechanism's size or of 1 rad


@dataclass
class State:
    """State at one time; the arrays have the system's own shapes, all samples together.

    Attributes
    ----------
    q, v, a
        Coordinates, velocities, accelerations.
    multipliers
        Lagrange multipliers; of size zero for a system without constraints.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    multipliers: np.ndarray

    def copy(self) -> State:
        """Return a deep copy."""
        return State(self.q.copy(), self.v.copy(), self.a.copy(), self.multipliers.copy())


@dataclass(frozen=True)
class Scheme:
    """Coefficients for a spectral radius and a step; `gain_v` and `gain_a` are dv/dq and da/dq within a step."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    gain_v: float
    gain_a: float

    @classmethod
    def of(cls, spectral_radius: float, step: float) -> Scheme:
        """Return the coefficients of second order with the given spectral radius at infinite frequency."""
        alpha_m = (2 * spectral_radius - 1) / (spectral_radius + 1)
        alpha_f = spectral_radius / (spectral_radius + 1)
        gamma = 0.5 + alpha_f - alpha_m
        beta = 0.25 * (gamma + 0.5) ** 2
        return cls(
            alpha_m,
            alpha_f,
            beta,
            gamma,
            gain_v=gamma / (beta * step),
            gain_a=(1 - alpha_m) / ((1 - alpha_f) * beta * step**2),
        )


class SecondOrderSystem(Protocol):
    """What the integrator asks of a model; a batch of samples is one system.

    Samples are numbered 0 to n_samples - 1 whatever the shapes of the state's arrays.
    """

    comm: MPI.Comm
    n_samples: int

    def start(self) -> State:
        """Return the consistent state at time 0."""

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction of the active samples, in place.

        Parameters
        ----------
        time
            End of the step, s.
        state
            Iterate; ``q``, ``v``, ``a`` and multipliers are corrected consistently with the scheme.
        scheme
            Gains of the step.
        active
            Samples to correct, shape (n_samples,).
        fresh
            Whether the iteration matrix is to be evaluated anew.

        Returns
        -------
        ndarray, shape (n_samples,)
            Size of the correction, in units of the mechanism's size or of 1 rad; not finite where it failed.
        """

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put the given samples (a mask) of `state` back to `previous`."""

    def outside(self, state: State) -> np.ndarray:
        """Return a mask of the samples that left the model's range of validity."""


Observer = Callable[[int, float, State], None]


class GeneralisedAlpha:
    """Python context of a PETSc TS that steps a `SecondOrderSystem`.

    Attributes
    ----------
    state
        The current state.
    status
        Status of every sample, shape (n_samples,).
    failure_time
        Time at which a sample failed, NaN where it did not, shape (n_samples,), s.
    n_iterations
        Newton corrections done so far, all samples together.
    """

    def __init__(self, system: SecondOrderSystem, spectral_radius: float, step: float, alive: np.ndarray) -> None:
        self.system = system
        self.scheme = Scheme.of(spectral_radius, step)
        self.state = system.start()
        self.status = np.where(alive, Status.FINE, Status.OUT_OF_BOUNDS)
        self.failure_time = np.where(alive, np.nan, 0.0)
        self.n_iterations = 0
        self._step = step
        self._auxiliary = self.state.a.copy()

    def solveStep(self, ts: PETSc.TS, end: float, u: PETSc.Vec) -> None:  # noqa: N802 (called by PETSc)
        """Advance all living samples to `end`, one step on."""
        alive = self.status == Status.FINE
        if alive.any():
            previous = self.state
            self.state = self._predict(previous, previous.a)
            lost = self._iterate(end, alive, REFRESH_EVERY)
            if lost.any():
                # A load that sets in at once gives light nodes accelerations that no step can follow; the
                # displacement, held at constant velocity, is then the better prediction.
                self.system.restore(self.state, self._predict(previous, self._coasting(previous)), lost)
                lost = self._iterate(end, lost, 1)
            if lost.any():
                self.system.restore(self.state, self._predict(previous, self._coasting(previous)), lost)
                lost = self._iterate_carefully(end, lost)
            self._retire(lost, Status.NOT_CONVERGED, end)
            self._retire(alive & ~lost & self.system.outside(self.state), Status.LEFT_RANGE, end)
            self.system.restore(self.state, previous, self.status != Status.FINE)
            self._auxiliary = self._ahead(self.state.a, previous.a)
        u.setArray(self.state.q.ravel())

    def _ahead(self, a: np.ndarray, previous_a: np.ndarray) -> np.ndarray:
        """Return A_{n+1} from the accelerations at the end and the beginning of the step."""
        s = self.scheme
        weighted = (1 - s.alpha_f) * a + s.alpha_f * previous_a - s.alpha_m * self._auxiliary
        return weighted / (1 - s.alpha_m)

    def _coasting(self, previous: State) -> np.ndarray:
        """Return the accelerations at the end of the step for which the displacement is ``q + h q'``."""
        s = self.scheme
        ahead = -(0.5 - s.beta) / s.beta * self._auxiliary
        weighted = (1 - s.alpha_m) * ahead + s.alpha_m * self._auxiliary - s.alpha_f * previous.a
        return weighted / (1 - s.alpha_f)

    def _predict(self, previous: State, a: np.ndarray) -> State:
        """Predict the end of the step with given accelerations there."""
        s, h = self.scheme, self._step
        ahead = self._ahead(a, previous.a)
        q = previous.q + h * previous.v + h**2 * ((0.5 - s.beta) * self._auxiliary + s.beta * ahead)
        v = previous.v + h * ((1 - s.gamma) * self._auxiliary + s.gamma * ahead)
        return State(q, v, a.copy(), previous.multipliers.copy())

    def _iterate(self, time: float, alive: np.ndarray, refresh_every: int) -> np.ndarray:
        """Run Newton's iteration of every living sample to its own convergence; return those that failed.

        What remains after a correction is estimated from the contraction between the last two (Hairer and Wanner
        1996, section IV.8). A contraction is not carried over from the step before: it grows with the speed.
        """
        lost = np.zeros_like(alive)
        active = alive.copy()
        last = np.full(active.shape, np.inf)
        for iteration in range(MAX_ITERATIONS):
            fresh = iteration % refresh_every == 0
            size = self.system.correct(time, self.state, self.scheme, active, fresh)
            self.n_iterations += int(active.sum())
            lost |= active & ~np.isfinite(size)
            active &= np.isfinite(size)
            contraction = np.clip(size / np.maximum(last, 1e-300), 0.0, 0.999) if iteration else FIRST_CONTRACTION
            remaining = size * contraction / (1.0 - contraction)
            active &= ~((remaining <= NEWTON_TOLERANCE) | (size <= ROUND_OFF))
            last = size
            if not active.any():
                break
        return lost | active

    def _iterate_carefully(self, time: float, alive: np.ndarray) -> np.ndarray:
        """Run Newton's iteration with limited corrections; return the samples that failed.

        A load that sets in at once may throw the first corrections far beyond the range in which the equations look like
        their linearisation: nodes turn by half a revolution. A correction is shortened to `LONGEST`.
        """
        active, lost = alive.copy(), np.zeros_like(alive)
        for _ in range(CAREFUL_ITERATIONS):
            before = self.state.copy()
            size = self.system.correct(time, self.state, self.scheme, active, True)
            self.n_iterations += int(active.sum())
            lost |= active & ~np.isfinite(size)
            active &= np.isfinite(size)
            # by halves, together: rarely more than a few samples come here
            while True:
                long = active & (size > LONGEST)
                if not long.any():
                    break
                self.system.restore(self.state, _halfway(before, self.state), long)
                size = np.where(long, 0.5 * size, size)
            active &= size > NEWTON_TOLERANCE
            if not active.any():
                break
        return lost | active

    def _retire(self, samples: np.ndarray, reason: Status, time: float) -> None:
        """Record a failure; the sample stays where it was at the beginning of the step."""
        self.status[samples] = reason
        self.failure_time[samples] = time


def _halfway(one: State, other: State) -> State:
    return State(
        0.5 * (one.q + other.q),
        0.5 * (one.v + other.v),
        0.5 * (one.a + other.a),
        0.5 * (one.multipliers + other.multipliers),
    )


@dataclass(frozen=True)
class Run:
    """What an integration leaves.

    Attributes
    ----------
    state
        Final state.
    status, failure_time
        Of every sample, shape (n_samples,).
    n_steps, n_iterations
        Steps, and Newton corrections of all samples together.
    """

    state: State
    status: np.ndarray
    failure_time: np.ndarray
    n_steps: int
    n_iterations: int


def _check_options(ts: PETSc.TS, prefix: str, step: float, n_steps: int) -> None:
    """Refuse PETSc options that would change what the scene asks for."""
    wanted = {
        "ts_type": (ts.getType(), ts.Type.PYTHON, "the integrator is the program's own"),
        "ts_dt": (ts.getTimeStep(), step, "set simulation.step in the scene"),
        "ts_max_steps": (ts.getMaxSteps(), n_steps, "set simulation.duration in the scene"),
    }
    for option, (found, own, cure) in wanted.items():
        if found != own:
            raise InputError(f"option -{prefix}{option} = {found}: it cannot be changed here ({own}); {cure}")


def count_steps(duration: float, step: float) -> int:
    """Return the number of equal steps, none longer than `step`, that end at `duration`."""
    return max(1, int(np.ceil(duration / step * (1 - 1e-12))))


def integrate(
    system: SecondOrderSystem,
    simulation: Simulation,
    alive: np.ndarray | None = None,
    observer: Observer | None = None,
    prefix: str = PREFIX,
) -> Run:
    """Integrate a system over a scene's duration. Collective on ``system.comm``.

    Parameters
    ----------
    system
        The model; all its samples advance together.
    simulation
        Duration, step and spectral radius of the scene.
    alive
        Samples to integrate at all, shape (n_samples,); all by default.
    observer
        Called with step number, time and state at the start and after every step.
    prefix
        Of the options that reach this integration.
    """
    from petsc4py import PETSc

    if alive is None:
        alive = np.ones(system.n_samples, dtype=bool)
    n_steps = count_steps(simulation.duration, simulation.step)
    step = simulation.duration / n_steps
    stepper = GeneralisedAlpha(system, simulation.spectral_radius, step, alive)
    solution = PETSc.Vec().createMPI((stepper.state.q.size, None), comm=system.comm)
    solution.setArray(stepper.state.q.ravel())
    ts = PETSc.TS().create(comm=system.comm)
    try:
        ts.setOptionsPrefix(prefix)
        ts.setType(PETSc.TS.Type.PYTHON)
        ts.setPythonContext(stepper)
        ts.setTime(0.0)
        ts.setTimeStep(step)
        ts.setMaxTime(2 * simulation.duration)  # the number of steps ends the run, not round-off in their sum
        ts.setMaxSteps(n_steps)
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.STEPOVER)
        if observer is not None:
            ts.setMonitor(lambda _, number, time, __: observer(number, time, stepper.state))
        ts.setFromOptions()
        _check_options(ts, prefix, step, n_steps)
        ts.solve(solution)
    finally:
        ts.destroy()
        solution.destroy()
    return Run(stepper.state, stepper.status, stepper.failure_time, n_steps, stepper.n_iterations)
