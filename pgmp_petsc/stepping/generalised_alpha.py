"""Generalised-alpha time integration of second-order systems with constraints (docs/method.md, time integration).

The scheme of Chung and Hulbert (1993) in the form of Arnold and Bruls (2007) for the index-3 equations
``r(t, q, q', q'') + C^T lambda = 0``, ``c(q) = 0``: dynamics and constraints hold exactly at the end of every step,

    (1 - alpha_m) A_{n+1} + alpha_m A_n = (1 - alpha_f) q''_{n+1} + alpha_f q''_n
    q_{n+1}  = q_n  + h q'_n + h^2 ((1/2 - beta) A_n + beta A_{n+1})
    q'_{n+1} = q'_n + h ((1 - gamma) A_n + gamma A_{n+1})

with the auxiliary accelerations A. All coefficients follow from the spectral radius at infinite frequency. A batch of
samples is one bigger system: samples share time and step, but each has its own Newton iteration, so that no sample
can change another. Each goes as far as it goes by itself (`SecondOrderSystem.advance`); a step that is too much for it,
or in which it crosses the edge of a law, is taken with care (`alpha_step`, `edge_search`), and it goes on.

The integrator advances itself from stop to stop. A driver says when, and with PETSc lets the monitors of its TS see the
states there; a plain loop, where there is no PETSc, makes the same calls in the same order, so that no number depends
on which of them it is. One step of PETSc's TS is many steps of the scheme (`stops_of`), or one where an option lets
PETSc look at the steps. What observes a run is shown every step that it wants to see in any case; the others are not
even written down, which takes a tenth of the time of a step.

Options prefix: ``pgmp_ts_`` (e.g. ``-pgmp_ts_ts_monitor``), unless a caller gives another one. The scene says how long
a run is and how it is stepped, and the integrator is the program's own. Options that look on (``ts_monitor``,
``ts_view``) are taken, all others refused: to PETSc they are legal, and many would end a run early or change its steps
without a word.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import gcd
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.base.errors import InputError, RunError
from pgmp_petsc.base.surroundings import Comm, has_petsc
from pgmp_petsc.ranks.petsc import options_of, petsc_solver
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.stepping.alpha_step import AlphaStep, first_accelerations, put, resolved_jump, standing
from pgmp_petsc.stepping.edge_search import EventLocation
from pgmp_petsc.stepping.second_order_system import Moment, Observer, SecondOrderSystem, State, Stretch
from pgmp_petsc.stepping.status import Outcome, Status

if TYPE_CHECKING:
    from petsc4py import PETSc


MOST_AT_ONCE = 4000  # steps in one of the TS
DIVISORS = (1, 2, 4, 8)  # of the scene's step; the last is as far as a first try may be from a good step
PREFIX = "pgmp_ts_"
ERROR_PREFIX = "pgmp_error_ts_"  # of the integration of estimated errors
LOOKING_ON = ("ts_monitor", "ts_view", "ts_adapt_monitor", "ts_converged_reason")
_CURES = {
    "ts_type": "the integrator is the program's own",
    **dict.fromkeys(("ts_dt", "ts_time_step"), "set simulation.step in the scene"),
    **dict.fromkeys(
        ("ts_max_steps", "ts_run_steps", "ts_max_time", "ts_time_span"), "set simulation.duration in the scene"
    ),
    "ts_init_time": "a run starts at time 0",
    "ts_exact_final_time": "a run ends at simulation.duration exactly",
}
TIME_TOLERANCE = 1e-9  # of the duration: far above the round-off in the sum of all steps, far below one of them
RETRIED = (Status.NOT_CONVERGED, Status.NOT_FINITE, Status.SOLVER_FAILED, Status.BROKE_DOWN, Status.UNSTABLE)


@dataclass(frozen=True)
class Together(Observer):
    """One observer for several."""

    observers: Sequence[Observer]

    @property
    def every(self) -> int:
        return gcd(*(observer.every for observer in self.observers))

    def over(self, numbers: np.ndarray, times: np.ndarray, states: State) -> None:
        for observer in self.observers:
            observer.over(numbers, times, states)


class StateRecord(Observer):
    """Keeps all states of a batch of reduced runs; `pulse` is called with numbers of steps."""

    def __init__(self, pulse: Callable[[int], object]) -> None:
        self._pulse = pulse
        self._times: list[np.ndarray] = []
        self._states: list[State] = []

    def over(self, numbers: np.ndarray, times: np.ndarray, states: State) -> None:
        self._times.append(times)
        self._states.append(states)
        self._pulse(int(np.count_nonzero(numbers)))

    def states(self) -> tuple[np.ndarray, State]:
        """Return the instants (n_t,) and all states of the first run, each of shape (n_t, n_eta)."""
        times, every = self.of_batch()
        forces = every.forces[:, 0] if every.forces.size else every.forces
        return times, State(*(part[:, 0].copy() for part in every.parts()[:3]), np.zeros(0), forces=forces)

    def of_batch(self) -> tuple[np.ndarray, State]:
        """Return the instants (n_t,) and all states, each of shape (n_t, n_samples, n_eta)."""
        return np.concatenate(self._times), State.along(self._states, np.concatenate)


class GeneralisedAlpha:
    """Steps a `SecondOrderSystem` from stop to stop, as a driver calls it.

    Every sample has a `status` and the time (s) at which it failed, NaN where it did not, (n_samples,). `instants` are
    those of the start and the ends of all steps, (n_steps + 1,), s, of which n_done are behind it; `stops` are the
    numbers of steps at which the driver sees the state, 0 and the last one included. `divided` has the steps that were
    taken in parts, in order: their numbers, and masks of the samples, (n_samples,). See `AlphaStep` of what is
    `counted`.
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
        start = system.start()
        self.status = np.where(alive, Status.FINE, Status.UNPHYSICAL)
        self.failure_time = np.where(alive, np.nan, 0.0)
        self._alive = alive.copy()
        if system.settled is not None:
            self._retire(alive & system.settled.lost, Status.NO_EQUILIBRIUM, 0.0)
        self._stepper = AlphaStep(system, spectral_radius, patient=parts == 1)
        self._finer, self.divided = AlphaStep(system, spectral_radius), list[tuple[int, np.ndarray]]()
        self.counted = self._finer.counted = self._stepper.counted
        self.instants, self.stops, self.n_done = instants(duration, n_steps), stops, 0
        self._step = duration / n_steps
        self._moment = standing(start, start.a.copy(), system.n_samples)
        begun = State.along([start])
        if system.beside is not None:
            begun.forces = system.beside.now[None].copy()
        if self._alive.any():
            first = first_accelerations(system, start, self._step, self._alive, spectral_radius)
            self._stepper.count(first.n_iterations, 0, 0)
            self._moment = standing(replace(start, a=first.a), first.auxiliary, system.n_samples)
        self._events = EventLocation(system, self._stepper, start)
        self._observer, self._pulse = observer, pulse
        if observer is not None:
            observer.over(np.array([0]), np.zeros(1), begun)

    @property
    def state(self) -> State:
        """The current state."""
        return self._moment.state

    @property
    def shortest_crossing(self) -> np.ndarray:
        """Time between two crossings of an edge, the shortest of every sample, shape (n_samples,), s; infinite where no
        edge was crossed twice."""
        return self._events.shortest

    def advance(self) -> None:
        """Advance all living samples to the next stop."""
        last = int(self.stops[np.searchsorted(self.stops, self.n_done, side="right")])
        system = self.system
        while self.n_done < last:
            until = min(last, self.n_done + system.steps_at_once)
            if system.held:
                until = self.n_done + system.beside.n_held(self.instants[self.n_done + 1 : until + 1])
            elif system.beside is not None and not system.carries:
                until = self.n_done + 1
            self._advance_to(until)
        # iterations may converge where a free body turns by so much in a step that the scheme is unstable
        if self._alive.any():
            strayed = self._alive & system.strayed(self.state, self._step)
            self._retire(strayed, Status.UNSTABLE, float(self.instants[last]))
        if self._pulse is not None:
            self._pulse(last / (self.instants.size - 1))

    def _advance_to(self, last: int) -> None:
        """Advance all living samples to an instant, each as far as it goes by itself, and from there with care.

        Those that a step is too much for, or that cross an edge in it, take that step with care and go on.
        """
        system, at, todo = self.system, np.full(self._alive.size, self.n_done), self._alive.copy()
        every, end = self.instants.size if self._observer is None else self._observer.every, self.instants.size - 1
        shown = np.arange(self.n_done + 1, last + 1)
        shown = shown[(shown % every == 0) | (shown == end)]
        trail, scheme = system.trail(self.state, shown.size), self._stepper.scheme(self._step)
        if system.beside is not None:
            trail.forces = system.beside.open(self.instants[shown], self._step)
        self._stand(trail, ~todo)
        while todo.any():
            first = int(at[todo].min())
            together = todo & (at == first)
            ends = self.instants[first + 1 : at[todo & ~together].min(initial=last) + 1]  # up to the next one, if any
            stretch = Stretch(
                self._moment, first, ends, self._step, scheme, together, self._events.beyond, self._events.depths,
                shown, trail, self.counted,
            )  # fmt: skip
            outcome, n_steps = self._stepper.advance(stretch)
            at[together] += n_steps[together]
            # one that is through its step with care is not to be taken up with others that are stuck in the next one
            stuck_at = np.where(together & (outcome != Outcome.DONE), at, last)
            for number in sorted(set(stuck_at.tolist()) - {last}):
                there = stuck_at == number
                self._advance_with_care(number, there, outcome)
                self._stand(trail.at(slice(int(np.searchsorted(shown, number + 1)), None)), there)
                at[there] += 1
                if system.carries:
                    self._jump(number + 1, there & self._alive)
            todo &= self._alive & (at < last)
        self.n_done = last
        if system.beside is not None:
            if not system.carries:
                self._jump(last, self._alive)
            if last == self.instants.size - 1:  # a run ends before forces jump, as what is seen of it does
                self.state.a[:], system.beside.now[:] = trail.a[-1], trail.forces[-1]
        if self._observer is not None and shown.size:
            # not PETSc's own time, a sum of steps: its round-off grows over the run
            self._observer.over(shown, self.instants[shown], trail)

    def _jump(self, number: int, samples: np.ndarray) -> None:
        """Let forces of some samples, a mask, that jump after a step do so; accelerations jump with them."""
        system, state, time = self.system, self.state, float(self.instants[number])
        if not samples.any() or not system.beside.sample(time, state, samples):
            return
        jump = 0.0 if system.about_motion else resolved_jump(system, state, self._step, samples, time)
        system.beside.jumps = False
        after = standing(replace(state, a=state.a + jump), self._moment.auxiliary + jump, system.n_samples)
        put(system, self._moment, after, samples)

    def _stand(self, trail: State, samples: np.ndarray) -> None:
        """Leave some samples where they are in all instants of a trail."""
        if samples.any() and len(trail.q):
            parts = zip(trail.parts(), self.state.parts())
            here = State(*(np.broadcast_to(part, of_trail.shape) for of_trail, part in parts))
            self.system.restore_all(trail, here, samples)

    def _advance_with_care(self, number: int, samples: np.ndarray, outcome: np.ndarray) -> None:
        """Advance some samples by one step, in place; retire those for which that fails.

        `outcome` says what came of it before; those that were lost may cross an edge too.
        """
        lost, crossing, outside = (
            samples & (outcome == each) for each in (Outcome.LOST, Outcome.CROSSED, Outcome.OUTSIDE)
        )
        before, end = self._moment, float(self.instants[number + 1])
        after, failed = standing(before.state.copy(), before.auxiliary.copy(), samples.size), np.zeros_like(samples)
        if lost.any():
            after, failed = self._stepper.retry(before, end, self._step, lost)
        crossing |= self._events.crossing(end, after.state, lost & ~failed)
        failed |= self._events.repeat_steps(before, after, end, self._step, crossing)
        if self._parts > 1 and failed.any():
            failed = self._advance_in_parts(before, after, number, failed)
        if failed.any():
            self._retire(failed, self.system.reasons(end, before.state, failed), end)
        outside = outside | samples & ~failed & self.system.outside(after.state)
        self._retire(outside, Status.LEFT_RANGE, end)
        fine = samples & self._alive
        if fine.any():
            put(self.system, before, after._replace(before=before.state.a.copy()), fine)

    def _advance_in_parts(self, before: Moment, after: Moment, number: int, samples: np.ndarray) -> np.ndarray:
        """Take a step of some samples, a mask, in equal parts, into `after`; return those whose iteration failed.

        The auxiliary accelerations run ahead of the others by a share of the step.
        """
        begin, step, lost = float(self.instants[number]), self._step / self._parts, np.zeros_like(samples)
        ahead = before.state.a + (before.auxiliary - before.state.a) / self._parts
        moment = standing(before.state, ahead, samples.size)
        events = self._events.by(self._finer)
        self.divided.append((number, samples.copy()))
        ends = np.append(begin + step * np.arange(1, self._parts), self.instants[number + 1])
        for end in ends.tolist():
            going = samples & ~lost
            reached, failed = self._finer.take_one(moment, end, step, going)
            crossing = events.crossing(end, reached.state, going & ~failed)
            failed |= events.repeat_steps(moment, reached, end, step, crossing)
            lost, moment = lost | failed, reached
            if not (samples & ~lost).any():
                break
        put(self.system, after, moment, samples & ~lost)
        return lost

    def _retire(self, samples: np.ndarray, reason: Status | np.ndarray, time: float) -> None:
        """Record a failure; the sample stays where it was at the beginning of the step."""
        self.status[samples] = reason
        self.failure_time[samples] = time
        self._alive &= ~samples


@dataclass(frozen=True)
class Run:
    """Result of an integration."""

    state: State  # final state
    #: status, failure_time: of every sample, shape (n_samples,)
    status: np.ndarray
    failure_time: np.ndarray
    n_steps: int  # number of steps
    counted: np.ndarray  # see `AlphaStep`


def instants(duration: float, n_steps: int) -> np.ndarray:
    """Return the times of equal steps, without the round-off of their sum, shape (n_steps + 1,); the last is the
    duration."""
    times = duration * np.arange(n_steps + 1) / n_steps
    times[-1] = duration
    return times


def stops_of(n_steps: int, at_once: int, prefix: str) -> np.ndarray:
    """Return the numbers of the steps at which PETSc's TS sees the state, 0 and the last one included."""
    return np.arange(n_steps + 1) if options_of(prefix) else np.append(np.arange(0, n_steps, at_once), n_steps)


def integrate(
    system: SecondOrderSystem,
    simulation: Simulation,
    alive: np.ndarray | None = None,
    observer: Observer | None = None,
    prefix: str = PREFIX,
    pulse: Callable[[float], object] | None = None,
) -> Run:
    """Integrate a system over a scene's duration, all its samples or those `alive`, (n_samples,). Collective on
    ``system.comm``.

    The observer sees the start and the states after steps. The prefix is that of the options that reach this
    integration. The pulse is called at every step of the driver, which may be many of the integrator's, with the share
    of all steps that are behind it.

    Raises `InputError` if an option of PETSc would change what the scene asks for; `RunError` if the run ends early,
    with PETSc's reason. A sample that fails ends nothing: it is a status.
    """
    check_ts_options()
    if alive is None:
        alive = np.ones(system.n_samples, dtype=bool)
    n_steps = simulation.n_steps
    at_once = system.steps_between_looks(None if observer is None else observer.every)
    stops = stops_of(n_steps, min(at_once, MOST_AT_ONCE), prefix)
    radius, duration = simulation.spectral_radius, simulation.duration
    stepper = GeneralisedAlpha(system, radius, duration, n_steps, alive, stops, observer, pulse)
    driver_here()(stepper, system.comm, prefix)
    return Run(stepper.state, stepper.status, stepper.failure_time, n_steps, stepper.counted)


@dataclass(frozen=True)
class Attempt:
    """Samples and step of an integration from time 0."""

    samples: np.ndarray  # numbers of the samples in the batch, shape (n,)
    alive: np.ndarray  # which of these are to be integrated at all, shape (n,)
    simulation: Simulation  # the scene's, with the step of this attempt
    divisor: int  # by which the scene's step is divided


@dataclass(frozen=True)
class RetriedRun:
    """Result of a batch, with repeated attempts."""

    #: status, failure_time: of every sample in its last attempt, shape (n_samples,)
    status: np.ndarray
    failure_time: np.ndarray
    divisors: np.ndarray  # by what the scene's step was divided in that attempt, shape (n_samples,)


def integrate_with_smaller_steps(
    run: Callable[[Attempt], Run], simulation: Simulation, alive: np.ndarray, divisors: tuple[int, ...] = DIVISORS
) -> RetriedRun:
    """Integrate a batch, and those of its samples that fail again, from the start, with smaller steps: of the scene's
    step, one divisor after the other; the first is 1.

    Only they are: a sample that is fine keeps its numbers to the last bit, and a sample that is tried again has
    nobody's but its own, so that neither batch nor number of ranks plays a part. A sample whose reduced model broke
    down with two steps in turn is not tried further: it is the model that ends there, not the integration.

    `run` integrates an attempt of those `alive`, (n_samples,), and keeps what it wants of the samples that are fine;
    what it kept of an earlier attempt of the same sample is void.
    """
    n_steps = simulation.n_steps
    status = np.full(alive.size, Status.UNPHYSICAL, dtype=int)
    failure_time, divided = np.zeros(alive.size), np.ones(alive.size, dtype=int)
    samples = np.arange(alive.size)
    for divisor in divisors:
        # the first step as it is: a quotient of a product may differ in the last bit
        step = simulation.step if divisor == 1 else simulation.duration / (n_steps * divisor)
        done = run(Attempt(samples, alive[samples], simulation.model_copy(update={"step": step}), divisor))
        before = status[samples]
        status[samples], failure_time[samples], divided[samples] = done.status, done.failure_time, divisor
        unchanged = (done.status == Status.BROKE_DOWN) & (before == Status.BROKE_DOWN)
        samples = samples[np.isin(done.status, RETRIED) & ~unchanged]
        if not samples.size:
            break
    return RetriedRun(status, failure_time, divided)


def check_ts_options() -> None:
    """Refuse options with the prefix of a TS of this program, unless they only look on.

    Raises `InputError`, naming the first option that is refused; the same on all ranks, because options are.
    """
    for prefix in (PREFIX, ERROR_PREFIX):
        for name, value in sorted(options_of(prefix).items()):
            if not name.startswith(LOOKING_ON):
                shown = f"-{prefix}{name} {'' if value is None else value}".strip()
                cure = _CURES.get(name, "how a run is integrated follows from the scene's [simulation]")
                raise InputError(
                    f"option {shown}: it cannot be changed here; {cure} (allowed with this prefix: "
                    f"{', '.join(f'-{prefix}{allowed}' for allowed in LOOKING_ON)})"
                )


def driver_here() -> Callable[[GeneralisedAlpha, Comm, str], None]:
    """Return the driver of this Python: of an integration, a communicator and a prefix of options."""
    return drive_by_petsc if has_petsc() else drive_in_a_loop


def drive_in_a_loop(integration: GeneralisedAlpha, comm: Comm, prefix: str) -> None:
    """Go through all stops of an integration in a plain loop, which takes no options."""
    while integration.n_done < integration.stops[-1]:
        integration.advance()


def drive_by_petsc(integration: GeneralisedAlpha, comm: Comm, prefix: str) -> None:
    """Go through all stops of an integration as steps of PETSc's TS, with a prefix of the options that reach it;
    collective on `comm`.

    Raises `InputError` if PETSc refuses the value of an option, and `RunError` if it ends early, with PETSc's reason.
    """
    from petsc4py import PETSc

    instants, n_stops = integration.instants, len(integration.stops) - 1
    solution = PETSc.Vec().createMPI((integration.state.q.size, None), comm=comm)
    solution.setArray(integration.state.q.ravel())
    ts, context = PETSc.TS().create(comm=comm), _Context(integration)
    try:
        ts.setOptionsPrefix(prefix)
        ts.setType(PETSc.TS.Type.PYTHON)
        ts.setPythonContext(context)
        ts.setTime(0.0)
        ts.setTimeStep(float(instants[integration.stops[1]]))
        # the number of steps ends the run, not round-off in their sum
        ts.setMaxTime(2 * float(instants[-1]))
        ts.setMaxSteps(n_stops)
        ts.setExactFinalTime(PETSc.TS.ExactFinalTime.STEPOVER)
        with petsc_solver(prefix, "time integration"):
            ts.setFromOptions()
        ts.solve(solution)
        if context.failure is not None:
            raise context.failure
        reason, done, time, duration = ts.getConvergedReason(), ts.getStepNumber(), ts.getTime(), float(instants[-1])
        if reason <= 0 or done != n_stops or not abs(time - duration) <= TIME_TOLERANCE * duration:
            names = {value: name for name, value in vars(type(ts).ConvergedReason).items() if isinstance(value, int)}
            raise RunError(
                f"the time integration ended at {time:.6g} s of {duration:g} s after {done} of {n_stops} steps: "
                f"PETSc's TS gives reason {reason} ({names.get(reason, 'unknown')})"
            )
    finally:
        ts.destroy()
        solution.destroy()


class _Context:
    """Context of a TS of type python, which calls it.

    What is raised in a step does not go through PETSc, whose own error after it may end the process: the TS stops, and
    `failure` is raised behind it.
    """

    def __init__(self, integration: GeneralisedAlpha) -> None:
        self._integration = integration
        self.failure: BaseException | None = None

    def solveStep(self, ts: PETSc.TS, end: float, u: PETSc.Vec) -> None:  # noqa: N802 (PETSc's name)
        """Do a step of the TS."""
        integration = self._integration
        begin = integration.n_done
        try:
            integration.advance()
        except BaseException as failure:
            self.failure = failure
            ts.setConvergedReason(ts.ConvergedReason.CONVERGED_USER)
            return
        ts.setTimeStep(float(integration.instants[integration.n_done] - integration.instants[begin]))
        u.setArray(integration.state.q.ravel())
