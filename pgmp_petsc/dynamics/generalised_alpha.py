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

Options prefix: ``pgmp_ts_`` (e.g. ``-pgmp_ts_ts_monitor``), unless a caller gives another one; see `ts_options` for what
is allowed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.dynamics.alpha_step import AlphaStep
from pgmp_petsc.dynamics.event_location import EventLocation
from pgmp_petsc.dynamics.second_order_system import SecondOrderSystem, State
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.dynamics.ts_options import PREFIX, check_end, check_ts_options
from pgmp_petsc.runtime.petsc import as_raised, petsc_solver

if TYPE_CHECKING:
    from petsc4py import PETSc

    from pgmp_petsc.scene.numerics import Simulation

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
    instants
        Of the start and the ends of all steps, shape (n_steps + 1,), s.
    """

    def __init__(
        self, system: SecondOrderSystem, spectral_radius: float, duration: float, n_steps: int, alive: np.ndarray
    ) -> None:
        self.system = system
        self.state = system.start()
        self.status = np.where(alive, Status.FINE, Status.UNPHYSICAL)
        self.failure_time = np.where(alive, np.nan, 0.0)
        self._find_living()
        if system.settled is not None:
            self._retire(alive & system.settled.lost, Status.NO_EQUILIBRIUM, 0.0)
        self._stepper = AlphaStep(system, spectral_radius)
        self.instants, self._n_done = instants(duration, n_steps), 0
        self._n_ahead = getattr(system, "steps_at_once", 1) - 1
        self._step = duration / n_steps
        self._auxiliary = self.state.a.copy()
        self._events = EventLocation(system, self._stepper, self.state) if system.n_events else None

    @property
    def n_iterations(self) -> int:
        """Newton corrections done so far, all samples together."""
        return self._stepper.n_iterations

    def solveStep(self, ts: PETSc.TS, end: float, u: PETSc.Vec) -> None:  # noqa: N802 (called by PETSc)
        """Advance all living samples one step; PETSc's own `end` of it is a sum of steps, with its round-off."""
        self._n_done += 1
        end = float(self.instants[self._n_done])
        alive = self._alive
        if self._n_alive:
            previous, auxiliary = self.state, self._auxiliary
            self.state, self._auxiliary, lost = self._stepper.advance(
                previous, auxiliary, end, self._step, alive, self.instants[self._n_done + 1 :][: self._n_ahead]
            )
            if self._events is not None:
                lost |= self._events.repeat_steps(
                    (previous, auxiliary), (self.state, self._auxiliary), end, self._step, alive & ~lost
                )
            if lost.any():
                self._retire(lost, self.system.reasons(end, previous, lost), end)
            outside = self.system.outside(self.state)
            if outside.any():
                self._retire(alive & ~lost & outside, Status.LEFT_RANGE, end)
            if self._n_alive < alive.size:
                self.system.restore(self.state, previous, ~self._alive)
        u.setArray(self.state.q.ravel())

    def _retire(self, samples: np.ndarray, reason: Status | np.ndarray, time: float) -> None:
        """Record a failure; the sample stays where it was at the beginning of the step."""
        self.status[samples] = reason
        self.failure_time[samples] = time
        self._find_living()

    def _find_living(self) -> None:
        self._alive = self.status == Status.FINE
        self._n_alive = int(self._alive.sum())


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


def count_steps(duration: float, step: float) -> int:
    """Return the number of equal steps, none longer than `step`, that end at `duration`."""
    return max(1, int(np.ceil(duration / step * (1 - 1e-12))))


def instants(duration: float, n_steps: int) -> np.ndarray:
    """Return the times of equal steps, without the round-off of their sum, shape (n_steps + 1,); the last is the
    duration."""
    times = duration * np.arange(n_steps + 1) / n_steps
    times[-1] = duration
    return times


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

    Raises
    ------
    InputError
        If an option of PETSc would change what the scene asks for.
    RunError
        If the run ends early, with PETSc's reason. A sample that fails ends nothing: it is a status.
    """
    from petsc4py import PETSc

    check_ts_options()
    if alive is None:
        alive = np.ones(system.n_samples, dtype=bool)
    n_steps = count_steps(simulation.duration, simulation.step)
    stepper = GeneralisedAlpha(system, simulation.spectral_radius, simulation.duration, n_steps, alive)
    solution = PETSc.Vec().createMPI((stepper.state.q.size, None), comm=system.comm)
    solution.setArray(stepper.state.q.ravel())
    ts = PETSc.TS().create(comm=system.comm)
    try:
        ts.setOptionsPrefix(prefix)
        ts.setType(PETSc.TS.Type.PYTHON)
        ts.setPythonContext(stepper)
        ts.setTime(0.0)
        ts.setTimeStep(simulation.duration / n_steps)
        ts.setMaxTime(2 * simulation.duration)  # the number of steps ends the run, not round-off in their sum
        ts.setMaxSteps(n_steps)
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.STEPOVER)
        if observer is not None:
            # not the TS's own time, a sum of steps: its round-off grows over the run
            ts.setMonitor(lambda _, number, *__: observer(number, float(stepper.instants[number]), stepper.state))
        with petsc_solver(prefix, "time integration"):
            ts.setFromOptions()
        with as_raised():
            ts.solve(solution)
        check_end(ts, n_steps, simulation.duration)
    finally:
        ts.destroy()
        solution.destroy()
    return Run(stepper.state, stepper.status, stepper.failure_time, n_steps, stepper.n_iterations)
