"""Generalised-alpha time integration of second-order systems with constraints, driven by PETSc's TS.

The scheme of Chung and Hulbert (1993) in the form of Arnold and Bruls (2007) for the index-3 equations
``r(t, q, q', q'') + C^T lambda = 0``, ``c(q) = 0``: dynamics and constraints hold exactly at the end of every step,

    (1 - alpha_m) A_{n+1} + alpha_m A_n = (1 - alpha_f) q''_{n+1} + alpha_f q''_n
    q_{n+1}  = q_n  + h q'_n + h^2 ((1/2 - beta) A_n + beta A_{n+1})
    q'_{n+1} = q'_n + h ((1 - gamma) A_n + gamma A_{n+1})

with the auxiliary accelerations A. All coefficients follow from the spectral radius at infinite frequency. A batch of
samples is one bigger system: samples share time and step, but each has its own Newton iteration, so that no sample
can change another.

One step of the TS is many steps of the scheme (`stops_of`), or one where an option lets PETSc look at the steps. What
observes a run is shown every step that it wants to see in any case; the others are not even written down, which takes a
tenth of the time of a step.

PETSc's own TSALPHA2 is not used: it is no integrator for index-3 equations, and in PETSc 3.18 it starts with twice
the initial acceleration.

Options prefix: ``pgmp_ts_`` (e.g. ``-pgmp_ts_ts_monitor``), unless a caller gives another one; see `ts_options` for
what is allowed.

What drives an integration from stop to stop: PETSc's TS, or a plain loop where there is no PETSc.

An integrator advances itself. The driver says when, and with PETSc lets its monitors see the states at the stops; both
make the same calls in the same order, so that no number depends on which of them it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import gcd
from typing import TYPE_CHECKING, Protocol

import numpy as np

from pgmp_petsc.dynamics.alpha_step import FIRST_CONTRACTION, AlphaStep
from pgmp_petsc.dynamics.event_location import EventLocation, Moment, put
from pgmp_petsc.dynamics.first_accelerations import first_accelerations, n_first_steps
from pgmp_petsc.dynamics.second_order_system import SecondOrderSystem, State
from pgmp_petsc.dynamics.status import Outcome, Status
from pgmp_petsc.dynamics.ts_options import PREFIX, check_end, check_ts_options
from pgmp_petsc.runtime.petsc import as_raised, has_options, petsc_solver
from pgmp_petsc.runtime.surroundings import has_petsc

if TYPE_CHECKING:
    from mpi4py import MPI
    from petsc4py import PETSc

    from pgmp_petsc.scene.numerics import Simulation


# Steps of the scheme in one of the TS. What surrounds one takes the time of some hundred steps of a single sample in
# compiled code, so that few samples go further at once; of many, the positions, velocities and accelerations that are
# written down are to stay in the cache. Where Python goes from step to step more gain nothing.
AT_ONCE, MOST_AT_ONCE = 50, 4000
LARGEST = 2**19  # numbers that are written down, of all samples and steps
FURTHEST = 2**21  # numbers of all samples and steps: in more of them samples that began side by side drift apart


class Observer(Protocol):
    """Sees the states of a run as it goes on."""

    def __call__(self, number: int, time: float, state: State) -> None:
        """See the state after a step, given by its number, 0 for the start."""


class TrailObserver(Observer, Protocol):
    """Sees the states of many steps at once too, where the system takes them so.

    Attributes
    ----------
    every
        Steps of which it is to see one, beside start and end; it may be shown more.
    """

    every: int

    def over(self, numbers: np.ndarray, times: np.ndarray, trail: np.ndarray) -> None:
        """See positions, velocities and accelerations after some steps.

        Parameters
        ----------
        numbers, times
            Of these steps, increasing, and of their ends, s, each of shape (n_t,).
        trail
            Shape (n_t, 3, n_samples, n); of samples that have failed, where they stand.
        """


class StatesObserver(Observer, Protocol):
    """Sees whole states of many steps at once too, where the system takes them so."""

    def over_states(self, numbers: np.ndarray, times: np.ndarray, states: State) -> None:
        """See the states after some steps, with a leading axis of steps; others are as of `TrailObserver`."""


@dataclass(frozen=True)
class Together:
    """One observer for several."""

    observers: Sequence[TrailObserver]

    @property
    def every(self) -> int:
        """Steps of which one is to be seen."""
        return gcd(*(observer.every for observer in self.observers))

    def __call__(self, number: int, time: float, state: State) -> None:
        """Show the state after a step to all."""
        for observer in self.observers:
            observer(number, time, state)

    def over(self, numbers: np.ndarray, times: np.ndarray, trail: np.ndarray) -> None:
        """Show the states after many steps to all."""
        for observer in self.observers:
            observer.over(numbers, times, trail)


class GeneralisedAlpha:
    """Steps a `SecondOrderSystem` from stop to stop, as a `drivers.Driver` calls it.

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
    stops
        Numbers of the steps at which the driver sees the state, 0 and the last one included.
    n_done
        Steps that are behind it.
    n_divided
        Steps of every sample that were taken in parts, shape (n_samples,).
    """

    def __init__(
        self,
        system: SecondOrderSystem,
        spectral_radius: float,
        duration: float,
        n_steps: int,
        alive: np.ndarray,
        stops: np.ndarray,
        observer: Observer | None,
        pulse: Callable[[float], object] | None,
        parts: int = 1,
    ) -> None:
        self.system, self._parts = system, parts
        self.state = system.start()
        self.status = np.where(alive, Status.FINE, Status.UNPHYSICAL)
        self.failure_time = np.where(alive, np.nan, 0.0)
        self._find_living()
        if system.settled is not None:
            self._retire(alive & system.settled.lost, Status.NO_EQUILIBRIUM, 0.0)
        self._stepper = AlphaStep(system, spectral_radius, patient=parts == 1)
        self._finer, self.n_divided = AlphaStep(system, spectral_radius), np.zeros(system.n_samples, dtype=int)
        self.instants, self.stops, self.n_done = instants(duration, n_steps), stops, 0
        self._n_at_once = getattr(system, "steps_at_once", 1)
        self._step = duration / n_steps
        self._auxiliary, self._before = self.state.a.copy(), self.state.a.copy()
        if n_first_steps(system) and self._n_alive:
            first = first_accelerations(system, self.state, self._step, self._alive)
            self._auxiliary, self._stepper.n_iterations = first
        self._contraction = np.full((system.n_samples, 1), FIRST_CONTRACTION)
        self._events = EventLocation(system, self._stepper, self.state) if system.n_events else None
        self._observer, self._pulse = observer, pulse
        self._show(0, self.state)

    @property
    def n_iterations(self) -> int:
        """Newton corrections done so far, all samples together."""
        return self._stepper.n_iterations + self._finer.n_iterations

    @property
    def n_fresh(self) -> int:
        """Corrections so far that found a matrix and its factors anew; known of a single sample."""
        return self._stepper.n_fresh + self._finer.n_fresh

    @property
    def n_calls(self) -> int:
        """Calls of the system for steps and corrections, so far."""
        return self._stepper.n_calls + self._finer.n_calls

    @property
    def shortest_crossing(self) -> np.ndarray:
        """Time between two crossings of an edge, the shortest of every sample, shape (n_samples,), s; infinite where no
        edge was crossed twice."""
        return np.full(self._alive.size, np.inf) if self._events is None else self._events.shortest

    def _show(self, number: int, state: State) -> None:
        """Show the state after a step to the observer."""
        if self._observer is not None:
            # not PETSc's own time, a sum of steps: its round-off grows over the run
            self._observer(number, float(self.instants[number]), state)

    def advance(self) -> None:
        """Advance all living samples to the next stop."""
        last = int(self.stops[np.searchsorted(self.stops, self.n_done, side="right")])
        if hasattr(self.system, "advance"):
            self._advance_at_once(last)
        else:
            number = self.n_done
            while number < last:
                number += self._advance_far(number, last) or self._advance_one_step(number)
        self.n_done = last
        if self._pulse is not None:
            self._pulse(last / (self.instants.size - 1))

    def _advance_far(self, number: int, last: int) -> int:
        """Advance all living samples by the steps that the system takes in one call; return how many that are."""
        if not (self._stepper.goes_far and self._n_alive):
            return 0
        ends = self.instants[number + 1 : last + 1][: self._n_at_once]
        taken, reached = self._stepper.advance_far(self.state, self._auxiliary, ends, self._step, self._alive)
        if reached is None:
            return 0
        self.state, self._auxiliary = reached.state, reached.auxiliary
        numbers = np.arange(number + 1, number + 1 + len(taken))
        if hasattr(self._observer, "over_states"):
            self._observer.over_states(numbers, self.instants[numbers], taken.states)
        else:
            for k, each in enumerate(numbers):
                self._show(int(each), taken.states.at(k))
        return len(taken)

    def _advance_one_step(self, number: int) -> int:
        """Advance all living samples from one instant to the next, and show it; return how many steps that are."""
        if self._n_alive:
            self._advance_with_looks(number)
        self._show(number + 1, self.state)
        return 1

    def _advance_with_looks(self, number: int) -> None:
        """Advance all living samples by a step, and look for edges, failures and what is outside."""
        previous, auxiliary, alive = self.state, self._auxiliary, self._alive
        # where steps are taken far, one that comes here is the one that went wrong
        n_ahead = 0 if self._stepper.goes_far else self._n_at_once - 1
        end, following = float(self.instants[number + 1]), self.instants[number + 2 :][:n_ahead]
        self.state, self._auxiliary, lost = self._stepper.advance(
            previous, auxiliary, end, self._step, alive, following
        )
        if self._events is not None:
            beyond = self._events.beyond.copy()
            lost |= self._events.repeat_steps(
                (previous, auxiliary), (self.state, self._auxiliary), end, self._step, alive & ~lost
            )
            if self._parts > 1:
                self._events.beyond[:, lost] = beyond[:, lost]
        if self._parts > 1 and lost.any():
            lost = self._advance_in_parts((previous, auxiliary), number, lost)
        if lost.any():
            self._retire(lost, self.system.reasons(end, previous, lost), end)
        outside = self.system.outside(self.state)
        if outside.any():
            self._retire(alive & ~lost & outside, Status.LEFT_RANGE, end)
        if self._n_alive < alive.size:
            self.system.restore(self.state, previous, ~self._alive)

    def _advance_in_parts(self, moment: Moment, number: int, samples: np.ndarray) -> np.ndarray:
        """Take a step of some samples, a mask, again in equal parts; return those whose iteration failed.

        The auxiliary accelerations run ahead of the others by a share of the step.
        """
        begin, step, lost = float(self.instants[number]), self._step / self._parts, np.zeros_like(samples)
        moment = moment[0], moment[0].a + (moment[1] - moment[0].a) / self._parts
        events = None if self._events is None else self._events.by(self._finer)
        self.n_divided += samples
        ends = np.append(begin + step * np.arange(1, self._parts), self.instants[number + 1])
        for k, end in enumerate(ends.tolist()):
            going = samples & ~lost
            state, ahead, failed = self._finer.advance(*moment, end, step, going, ends[k + 1 :])
            if events is not None:
                failed |= events.repeat_steps(moment, (state, ahead), end, step, going & ~failed)
            lost, moment = lost | failed, (state, ahead)
            if not (samples & ~lost).any():
                break
        put(self.system, (self.state, self._auxiliary), moment, samples & ~lost)
        self._stepper.moved(samples, lost)
        return lost

    def _advance_at_once(self, last: int) -> None:
        """Advance all living samples to an instant as far as they go by themselves; see the rest through one by one.

        Those that a step is too much for, or that cross an edge in it, take that step with care and go on.
        """
        at, todo = np.full(self._alive.size, self.n_done), self._alive.copy()
        shown = self._shown(last)
        trail = np.empty((shown.size, 3, *self.state.q.shape))
        trail[:, :, ~todo] = self._now()[:, ~todo]
        while todo.any():
            first = int(at[todo].min())
            together = todo & (at == first)
            ends, scheme = self.instants[first + 1 : last + 1], self._stepper.scheme(self._step)
            beyond = np.zeros((0, at.size), dtype=bool) if self._events is None else self._events.beyond
            moment = self.state, self._auxiliary, self._before, self._contraction
            outcome, n_steps, n_corrections = self.system.advance(
                moment, first, ends, self._step, scheme, together, beyond, shown, trail
            )
            self._stepper.n_iterations += n_corrections
            at[together] = first + n_steps[together]
            stopped_at = np.where(together & (outcome != Outcome.DONE), at, last)
            for number in np.unique(stopped_at[stopped_at < last]):
                there = stopped_at == number
                self._retire(there & (outcome == Outcome.OUTSIDE), Status.LEFT_RANGE, float(self.instants[number + 1]))
                stuck = there & self._alive
                if stuck.any():
                    self._advance_with_care(number, stuck)
                trail[np.searchsorted(shown, number + 1) :, :, there] = self._now()[:, there]
                at[there] += 1
            todo &= self._alive & (at < last)
        if hasattr(self._observer, "over"):
            if shown.size:
                self._observer.over(shown, self.instants[shown], trail)
            return
        for number, parts in zip(shown, trail):
            self._show(int(number), State(*parts, self.state.multipliers))

    def _shown(self, last: int) -> np.ndarray:
        """Return the numbers of the steps up to `last` that the observer is to see."""
        if self._observer is None:
            return np.zeros(0, dtype=np.int64)
        numbers = np.arange(self.n_done + 1, last + 1)
        every = getattr(self._observer, "every", 1)
        return numbers[(numbers % every == 0) | (numbers == self.instants.size - 1)]

    def _now(self) -> np.ndarray:
        """Return positions, velocities and accelerations of all samples together."""
        return np.array([self.state.q, self.state.v, self.state.a])

    def _advance_with_care(self, number: int, samples: np.ndarray) -> None:
        """Advance some samples by one step, in place, with smaller corrections or up to an edge and on."""
        previous, auxiliary, end = self.state, self._auxiliary, float(self.instants[number + 1])
        state, ahead, lost = self._stepper.advance(previous, auxiliary, end, self._step, samples)
        if self._events is not None:
            lost |= self._events.repeat_steps((previous, auxiliary), (state, ahead), end, self._step, samples & ~lost)
        if lost.any():
            self._retire(lost, self.system.reasons(end, previous, lost), end)
        outside = samples & ~lost & self.system.outside(state)
        self._retire(outside, Status.LEFT_RANGE, end)
        fine = samples & self._alive
        self._before[fine] = previous.a[fine]
        self._auxiliary[fine] = ahead[fine]
        self._contraction[fine] = FIRST_CONTRACTION
        for into, part in ((self.state.q, state.q), (self.state.v, state.v), (self.state.a, state.a)):
            into[fine] = part[fine]

    def _retire(self, samples: np.ndarray, reason: Status | np.ndarray, time: float) -> None:
        """Record a failure; the sample stays where it was at the beginning of the step."""
        if samples.any():
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
    n_fresh
        Those that found a matrix and its factors anew; known of a single sample.
    n_calls
        Calls of the system for steps and corrections.
    """

    state: State
    status: np.ndarray
    failure_time: np.ndarray
    n_steps: int
    n_iterations: int
    n_fresh: int = 0
    n_calls: int = 0


def count_steps(duration: float, step: float) -> int:
    """Return the number of equal steps, none longer than `step`, that end at `duration`."""
    return max(1, int(np.ceil(duration / step * (1 - 1e-12))))


def instants(duration: float, n_steps: int) -> np.ndarray:
    """Return the times of equal steps, without the round-off of their sum, shape (n_steps + 1,); the last is the
    duration."""
    times = duration * np.arange(n_steps + 1) / n_steps
    times[-1] = duration
    return times


def steps_at_once(system: SecondOrderSystem, observer: Observer | None) -> int:
    """Return how many steps of the scheme make one of the TS where PETSc does not look; the same on all ranks."""
    if not hasattr(system, "advance"):
        return min(AT_ONCE, MOST_AT_ONCE)
    largest = FURTHEST if observer is None else min(LARGEST * getattr(observer, "every", 1), FURTHEST)
    return min(max(1, largest // (3 * system.n_samples * system.n_eta)), MOST_AT_ONCE)


def stops_of(n_steps: int, at_once: int, prefix: str) -> np.ndarray:
    """Return the numbers of the steps at which PETSc's TS sees the state, 0 and the last one included."""
    if has_options(prefix):
        return np.arange(n_steps + 1)
    return np.append(np.arange(0, n_steps, at_once), n_steps)


def integrate(
    system: SecondOrderSystem,
    simulation: Simulation,
    alive: np.ndarray | None = None,
    observer: Observer | None = None,
    prefix: str = PREFIX,
    pulse: Callable[[float], object] | None = None,
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
        Called with step number, time and state at the start and after every step. The state may change afterwards.
    prefix
        Of the options that reach this integration.
    pulse
        Called at every step of the driver, which may be many of the integrator's, with the share of all steps that are
        behind it.

    Raises
    ------
    InputError
        If an option of PETSc would change what the scene asks for.
    RunError
        If the run ends early, with PETSc's reason. A sample that fails ends nothing: it is a status.
    """
    check_ts_options()
    if alive is None:
        alive = np.ones(system.n_samples, dtype=bool)
    n_steps = count_steps(simulation.duration, simulation.step)
    stops = stops_of(n_steps, steps_at_once(system, observer), prefix)
    radius, duration = simulation.spectral_radius, simulation.duration
    stepper = GeneralisedAlpha(system, radius, duration, n_steps, alive, stops, observer, pulse)
    driver_here().drive(stepper, system.comm, prefix)
    counted = stepper.n_iterations, stepper.n_fresh, stepper.n_calls
    return Run(stepper.state, stepper.status, stepper.failure_time, n_steps, *counted)


class Driven(Protocol):
    """An integration.

    Attributes
    ----------
    state
        The current state.
    instants
        Of the start and the ends of all steps, shape (n_steps + 1,), s.
    stops
        Numbers of the steps that it stops at, 0 and the last one included.
    n_done
        Steps that are behind it.
    """

    state: State
    instants: np.ndarray
    stops: np.ndarray
    n_done: int

    def advance(self) -> None:
        """Go on to the next stop."""


def driver_here() -> Driver:
    """Return the driver of this Python."""
    return PetscDriver() if has_petsc() else LoopDriver()


class Driver(Protocol):
    """Drives an integration to its end."""

    def drive(self, integration: Driven, comm: MPI.Comm, prefix: str) -> None:
        """Go through all stops. Collective on `comm`.

        Parameters
        ----------
        prefix
            Of the options of PETSc that reach this integration.

        Raises
        ------
        InputError
            If PETSc refuses the value of an option.
        RunError
            If it ends early, with PETSc's reason.
        """


class LoopDriver:
    """A plain loop; takes no options."""

    def drive(self, integration: Driven, comm: MPI.Comm, prefix: str) -> None:
        """Go through all stops; see `Driver`."""
        while integration.n_done < integration.stops[-1]:
            integration.advance()


class PetscDriver:
    """PETSc's TS, whose steps are those from stop to stop."""

    def drive(self, integration: Driven, comm: MPI.Comm, prefix: str) -> None:
        """Go through all stops; see `Driver`."""
        from petsc4py import PETSc

        instants, n_stops = integration.instants, len(integration.stops) - 1
        solution = PETSc.Vec().createMPI((integration.state.q.size, None), comm=comm)
        solution.setArray(integration.state.q.ravel())
        ts = PETSc.TS().create(comm=comm)
        try:
            ts.setOptionsPrefix(prefix)
            ts.setType(PETSc.TS.Type.PYTHON)
            ts.setPythonContext(_Context(integration))
            ts.setTime(0.0)
            ts.setTimeStep(float(instants[integration.stops[1]]))
            # the number of steps ends the run, not round-off in their sum
            ts.setMaxTime(2 * float(instants[-1]))
            ts.setMaxSteps(n_stops)
            ts.setExactFinalTime(PETSc.TS.ExactFinalTime.STEPOVER)
            with petsc_solver(prefix, "time integration"):
                ts.setFromOptions()
            with as_raised():
                ts.solve(solution)
            check_end(ts, n_stops, float(instants[-1]))
        finally:
            ts.destroy()
            solution.destroy()


class _Context:
    """What a TS of type python calls."""

    def __init__(self, integration: Driven) -> None:
        self._integration = integration

    def solveStep(self, ts: PETSc.TS, end: float, u: PETSc.Vec) -> None:  # noqa: N802 (PETSc's name)
        """Do a step of the TS."""
        integration = self._integration
        begin = integration.n_done
        integration.advance()
        ts.setTimeStep(float(integration.instants[integration.n_done] - integration.instants[begin]))
        u.setArray(integration.state.q.ravel())
