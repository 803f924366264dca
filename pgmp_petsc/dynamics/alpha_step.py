"""A step of the generalised-alpha scheme: prediction, and Newton's iteration of every sample to its own convergence."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.dynamics.second_order_system import Scheme, SecondOrderSystem, State
from pgmp_petsc.runtime.compiled import njit

MAX_ITERATIONS = 12
CAREFUL_ITERATIONS = 40
LONGEST = 0.2  # correction that is not shortened, in units of the mechanism's size or of 1 rad
REFRESH_EVERY = 4  # corrections that share one factorisation
FIRST_CONTRACTION = 0.5  # assumed where only one correction is known
PROBED_EVERY = 10  # steps, of which one is corrected twice at least, to see how the iteration contracts
CAUTION = 4.0  # times that contraction is expected until the next one: it changes with the motion
LEAST_CONTRACTION, WORST_CONTRACTION = 1e-8, 0.999  # the iteration of a large correction contracts less than others
ROUND_OFF = 1e-15
DAMPED = 0.99  # spectral radius with which what alternates is gone after some hundred steps
NOTHING = np.zeros(0)
NEWTON_TOLERANCE = 1e-12  # of the remaining correction, in units of the mechanism's size or of 1 rad
TOLERANCE_OF_ONE = 1e-13  # the same after one correction, where the contraction is that of a step before


@dataclass(frozen=True, eq=False)
class StepsAsked:
    """Equal steps that a system is asked to take.

    Attributes
    ----------
    previous, auxiliary
        State at the beginning, and the auxiliary accelerations there.
    behind
        Accelerations one step before.
    expected
        Contraction of Newton's iteration that is expected, as the system keeps it; None where nothing is known.
    ends, step
        Ends of the steps, shape (n,), and length of each, s.
    probed
        Which of them are corrected as if nothing were known of the contraction, shape (n,).
    scheme
        Coefficients for a step.
    samples
        Mask of the samples to advance, shape (n_samples,).
    """

    previous: State
    auxiliary: np.ndarray
    behind: np.ndarray
    expected: np.ndarray | None
    ends: np.ndarray
    step: float
    probed: np.ndarray
    scheme: Scheme
    samples: np.ndarray


@dataclass(frozen=True, eq=False)
class StepTaken:
    """A step that a system took by itself.

    Attributes
    ----------
    state, auxiliary
        State and auxiliary accelerations at its end.
    expected
        Contraction of Newton's iteration that is expected in the next one, as the system keeps it.
    lost
        Mask of the samples whose iteration failed, shape (n_samples,).
    n_iterations
        Newton corrections, all samples together.
    """

    state: State
    auxiliary: np.ndarray
    expected: np.ndarray
    lost: np.ndarray
    n_iterations: int


@dataclass(frozen=True, eq=False)
class StepsTaken:
    """Steps that a system took by itself, one after the other.

    Attributes
    ----------
    states, auxiliary, expected, n_iterations
        As of `StepTaken`, each with a leading axis of steps.
    lost
        Mask of the samples whose iteration failed in the last of them, shape (n_samples,).
    """

    states: State
    auxiliary: np.ndarray
    expected: np.ndarray
    n_iterations: np.ndarray
    lost: np.ndarray

    def __len__(self) -> int:
        return len(self.auxiliary)

    def __getitem__(self, number: int) -> StepTaken:
        """Return a step by its number, from 0 on."""
        lost = self.lost.copy() if number == len(self) - 1 else np.zeros_like(self.lost)
        expected, n_iterations = self.expected[number], int(self.n_iterations[number])
        return StepTaken(self.states.at(number), self.auxiliary[number], expected, lost, n_iterations)

    def first(self, n: int) -> StepsTaken:
        """Return the first n of more steps, or all of them."""
        if n == len(self):
            return self
        parts = (part[:n] for part in (self.auxiliary, self.expected, self.n_iterations))
        return StepsTaken(self.states.at(slice(n)), *parts, np.zeros_like(self.lost))


class AlphaStep:
    """Steps of any length of a system.

    A system with a method ``take_steps`` predicts and iterates by itself, several equal steps in one call
    (`StepsTaken`, up to one in which a sample is lost), and is valid everywhere; what fails there is tried here. One
    with events can also put samples of a step into another one (``with_samples``). A step is told what the one before
    has left: the accelerations at its beginning, from which it extrapolates, and the contraction to expect. A system
    with a method ``count_turns`` keeps turns in its states. One with a method ``limited`` has laws that a correction
    may take at another rate than the iterate's (`effects.law`): it is told where an iteration begins
    (``begin_iteration``), and one goes on as long as its sample is among the limited ones, a mask (n_samples,).

    The scheme multiplies what velocities have against the constraints by minus the spectral radius in a step, and
    accelerations have it with the number of steps as a factor. Without numerical damping it stays: as long as the
    constraints are always the same nothing comes of it, but where they turn or move it grows until it destroys the
    run. In a system with ``moving_constraints`` each step without enough damping (`DAMPED`) therefore ends with a
    projection (``project``): velocities that the constraints allow, and accelerations that follow from the equations.

    Parameters
    ----------
    system
        The system; all its samples advance together.
    spectral_radius
        Of the scheme at infinite frequency.
    patient
        Whether an iteration that fails is tried again with factors of its own, and with limited corrections.

    Attributes
    ----------
    goes_far
        Whether `advance_far` is of use: nothing is to be looked at between steps.
    n_iterations
        Newton corrections done so far, all samples together.
    n_fresh
        Those of them that found a matrix and its factors anew; known of a single sample.
    n_calls
        Calls of the system, for steps or for a correction.
    """

    def __init__(self, system: SecondOrderSystem, spectral_radius: float, patient: bool = True) -> None:
        self._system, self._patient = system, patient
        self._spectral_radius = spectral_radius
        self._by_itself, self._counts_turns = hasattr(system, "take_steps"), hasattr(system, "count_turns")
        self._limits, self._rubs = hasattr(system, "limited"), getattr(system, "rubs", False)
        self._projects = spectral_radius > DAMPED and getattr(system, "moving_constraints", False)
        self.goes_far = self._by_itself and not (self._projects or system.n_events)
        self._ahead: deque[StepTaken] = deque()
        self._moved = np.zeros(system.n_samples, dtype=bool)
        self._asked_next: tuple[State | None, float, float] = (None, 0.0, 0.0)
        self._left: tuple[State | None, np.ndarray | None, np.ndarray | None] = (None, None, None)
        self._scheme, self._step = Scheme.of(spectral_radius, 1.0), 1.0
        self.n_iterations = self.n_fresh = self.n_calls = 0

    def scheme(self, step: float) -> Scheme:
        """Return the coefficients for a step."""
        if step != self._step:
            self._scheme, self._step = Scheme.of(self._spectral_radius, step), step
        return self._scheme

    def advance_far(
        self, previous: State, auxiliary: np.ndarray, ends: np.ndarray, step: float, samples: np.ndarray
    ) -> tuple[StepsTaken | None, StepTaken | None]:
        """Advance some samples by equal steps, up to the first one that is too much for a sample.

        Parameters are as of `advance`, which takes that step up, and the ends of the steps have the shape (n,). Returns
        the steps in which no sample is lost, and the last of them; None where there is none.
        """
        self.scheme(step)
        if self._ahead and previous is self._asked_next[0]:
            return None, None
        asked = self._ask(previous, auxiliary, ends, samples)
        n, reached = len(asked) - int(asked.lost.any()), previous
        taken, last = (asked.first(n), asked[n - 1]) if n else (None, None)
        if last is not None:
            reached = last.state
            self._left = reached, previous.a if n == 1 else taken.states.a[-2], last.expected
            self._count(taken.n_iterations)
        if n < len(asked):
            self._ahead, self._asked_next = deque([asked[n]]), (reached, float(ends[n]), self._step)
        return taken, last

    def advance(
        self,
        previous: State,
        auxiliary: np.ndarray,
        end: float,
        step: float,
        samples: np.ndarray,
        following: np.ndarray = NOTHING,
        for_good: bool = True,
    ) -> tuple[State, np.ndarray, np.ndarray]:
        """Advance some samples.

        Parameters
        ----------
        previous, auxiliary
            State at the beginning of the step, and the auxiliary accelerations A there.
        end, step
            End and length of the step, s.
        samples
            Mask of the samples to advance, shape (n_samples,).
        following
            Ends of equal steps of the same samples that will be asked for next unless something happens, shape (n,), s.
        for_good
            Whether the run goes on from its end; otherwise it is a trial, of which nothing is remembered.

        Returns
        -------
        state, auxiliary
            At the end.
        lost
            Mask of the samples whose iteration failed.
        """
        scheme = self.scheme(step)
        if self._by_itself:
            if for_good:
                taken = self._take(previous, auxiliary, end, samples, NOTHING if self._projects else following)
                self._left = taken.state, previous.a, taken.expected
            else:
                taken = self._ask(previous, auxiliary, np.array([end]), samples)[0]
            self._count(taken.n_iterations)
            state, lost = taken.state, taken.lost
            if not (lost.any() or self._projects):
                return state, taken.auxiliary, lost
        else:
            behind, expected = self._left[1:] if previous is self._left[0] else (previous.a, _nothing_known(samples))
            expected = _nothing_known(samples) if self._probed(end) else expected.copy()
            state = _predict(scheme, step, previous, auxiliary, previous.a + (previous.a - behind))
            lost = self._iterate(end, state, scheme, samples, REFRESH_EVERY, expected)
            expected[lost] = FIRST_CONTRACTION
            if for_good:
                self._left = state, previous.a, expected
        # A load that sets in at once gives light nodes accelerations that no step can follow; the displacement, held at
        # constant velocity, is then the better prediction.
        if lost.any() and self._by_itself and not self._patient:
            behind = 2.0 * previous.a - _coasting(scheme, previous, auxiliary)
            again = self._ask(previous, auxiliary, np.array([end]), lost, behind)[0]
            self._count(again.n_iterations)
            self._system.restore(state, again.state, lost)
            lost = lost & again.lost
        elif lost.any() and self._patient:
            coasting = _predict(scheme, step, previous, auxiliary, _coasting(scheme, previous, auxiliary))
            self._system.restore(state, coasting, lost)
            lost = self._iterate(end, state, scheme, lost, 1, _nothing_known(lost))
            if lost.any():
                self._system.restore(state, coasting, lost)
                state, lost = self._iterate_carefully(end, state, scheme, lost)
        if self._projects:
            self._system.project(end, state, step, samples & ~lost)
        if self._counts_turns:
            self._system.count_turns(state)
        return state, _ahead(scheme, auxiliary, state.a, previous.a), lost

    def _take(
        self, previous: State, auxiliary: np.ndarray, end: float, samples: np.ndarray, following: np.ndarray
    ) -> StepTaken:
        """Return a step that the system takes, or took ahead from the very state that it begins with."""
        known, known_end, known_step = self._asked_next
        if not (self._ahead and previous is known and end == known_end and self._step == known_step):
            asked = self._ask(previous, auxiliary, np.append(end, following), samples)
            self._ahead = deque(asked[k] for k in range(len(asked)))
        elif self._moved.any():
            ends = np.append(end, following)[: len(self._ahead)]
            again = self._ask(previous, auxiliary, ends, self._moved & samples)
            pairs = zip(self._ahead, range(len(again)))  # up to a step in which one of them fails
            self._ahead = deque([self._system.with_samples(taken, again[k], self._moved) for taken, k in pairs])
        self._moved[:] = False
        taken = self._ahead.popleft()
        self._asked_next = taken.state, float(following[0]) if following.size else np.nan, self._step
        return taken

    def _ask(
        self,
        previous: State,
        auxiliary: np.ndarray,
        ends: np.ndarray,
        samples: np.ndarray,
        behind: np.ndarray | None = None,
    ) -> StepsTaken:
        """Return equal steps of some samples that the system takes; `behind` are accelerations to extrapolate from."""
        left = self._left[1:] if previous is self._left[0] else (previous.a, None)
        left = left if behind is None else (behind, None)
        self.n_calls += 1
        asked = StepsAsked(previous, auxiliary, *left, ends, self._step, self._probed(ends), self._scheme, samples)
        return self._system.take_steps(asked)

    def _count(self, n_iterations: int | np.ndarray) -> None:
        """Count the corrections of steps that the system took."""
        self.n_iterations += int(np.sum(n_iterations))
        self.n_fresh += int(np.sum(-(-n_iterations // REFRESH_EVERY)))

    def moved(self, samples: np.ndarray, lost: np.ndarray) -> None:
        """Take note of samples, a mask, that were put elsewhere at the end of the last step, or were lost there.

        What the system took ahead of them is void; with one that is lost, of all.
        """
        self._moved |= samples
        if lost.any():
            self._ahead.clear()

    def _probed(self, end: float | np.ndarray) -> bool | np.ndarray:
        """Return whether a step is corrected as if nothing were known of the contraction."""
        return (np.rint(end / self._step) % PROBED_EVERY == 0) | self._rubs

    def _iterate(
        self, time: float, state: State, scheme: Scheme, alive: np.ndarray, refresh_every: int, expected: np.ndarray
    ) -> np.ndarray:
        """Run Newton's iteration of every living sample to its own convergence; return those that failed.

        What remains after a correction is estimated from the contraction between the last two (Hairer and Wanner
        1996, section IV.8), after the first one from the one expected, shape (n_samples,).
        """
        lost = np.zeros_like(alive)
        active = alive.copy()
        last = np.full(active.shape, np.inf)
        if self._limits:
            self._system.begin_iteration()
        for iteration in range(MAX_ITERATIONS):
            fresh = iteration % refresh_every == 0
            size = self._system.correct(time, state, scheme, active, fresh)
            if self._limits:
                last[self._system.limited()] = 0.0  # nothing follows from the size of the last correction
            self.n_iterations += int(active.sum())
            self.n_fresh += fresh
            self.n_calls += 1
            judge(iteration, size, last, expected, active, lost)
            if not active.any():
                break
        return lost | active

    def _iterate_carefully(
        self, time: float, state: State, scheme: Scheme, alive: np.ndarray
    ) -> tuple[State, np.ndarray]:
        """Run Newton's iteration with limited corrections; return the state and the samples that failed.

        A load that sets in at once may throw the first corrections far beyond the range in which the equations look
        like their linearisation: nodes turn by half a revolution. A correction is shortened to `LONGEST`.
        """
        active, lost = alive.copy(), np.zeros_like(alive)
        if self._limits:
            self._system.begin_iteration()
        for _ in range(CAREFUL_ITERATIONS):
            before = state.copy()
            size = self._system.correct(time, state, scheme, active, True)
            self.n_iterations += int(active.sum())
            self.n_calls += 1
            lost |= active & ~np.isfinite(size)
            active &= np.isfinite(size)
            # by halves, together: rarely more than a few samples come here
            while True:
                long = active & (size > LONGEST)
                if not long.any():
                    break
                self._system.restore(state, _halfway(before, state), long)
                size = np.where(long, 0.5 * size, size)
            active &= (size > NEWTON_TOLERANCE) | (self._limits and self._system.limited())
            if not active.any():
                break
        return state, lost | active


@njit(cache=True, error_model="numpy")
def judge(iteration, size, last, expected, active, lost):
    """Decide which samples are done after a correction of `size`, with the one before, `last`; each (n_samples,).

    What remains is estimated from the contraction between both, after the first correction from the one expected; the
    second one shows what to expect of later steps. Those whose correction is no number are lost.
    """
    for sample in range(size.size):
        if active[sample]:
            contraction = expected[sample]
            if iteration > 0:
                contraction = min(max(size[sample] / max(last[sample], 1e-300), 0.0), WORST_CONTRACTION)
            if iteration == 1:
                expected[sample] = min(max(CAUTION * contraction, LEAST_CONTRACTION), WORST_CONTRACTION)
            remaining = size[sample] * contraction / (1.0 - contraction)
            if not np.isfinite(size[sample]):
                lost[sample], active[sample] = True, False
            elif remaining <= (NEWTON_TOLERANCE if iteration > 0 else TOLERANCE_OF_ONE) or size[sample] <= ROUND_OFF:
                active[sample] = False
            last[sample] = size[sample]


def _nothing_known(samples: np.ndarray) -> np.ndarray:
    """Return contractions to be expected of samples (a mask) of which none is known."""
    return np.full(samples.shape, FIRST_CONTRACTION)


def _ahead(scheme: Scheme, auxiliary: np.ndarray, a: np.ndarray, previous_a: np.ndarray) -> np.ndarray:
    """Return A_{n+1} from the accelerations at the end and the beginning of the step."""
    s = scheme
    weighted = (1 - s.alpha_f) * a + s.alpha_f * previous_a - s.alpha_m * auxiliary
    return weighted / (1 - s.alpha_m)


def _coasting(scheme: Scheme, previous: State, auxiliary: np.ndarray) -> np.ndarray:
    """Return the accelerations at the end of the step for which the displacement is ``q + h q'``."""
    s = scheme
    ahead = -(0.5 - s.beta) / s.beta * auxiliary
    weighted = (1 - s.alpha_m) * ahead + s.alpha_m * auxiliary - s.alpha_f * previous.a
    return weighted / (1 - s.alpha_f)


def _predict(scheme: Scheme, step: float, previous: State, auxiliary: np.ndarray, a: np.ndarray) -> State:
    """Predict the end of the step with given accelerations there."""
    s, h = scheme, step
    ahead = _ahead(scheme, auxiliary, a, previous.a)
    q = previous.q + h * previous.v + h**2 * ((0.5 - s.beta) * auxiliary + s.beta * ahead)
    v = previous.v + h * ((1 - s.gamma) * auxiliary + s.gamma * ahead)
    return State(q, v, a.copy(), previous.multipliers.copy(), previous.turns.copy())


def _halfway(one: State, other: State) -> State:
    return State(
        0.5 * (one.q + other.q),
        0.5 * (one.v + other.v),
        0.5 * (one.a + other.a),
        0.5 * (one.multipliers + other.multipliers),
        0.5 * (one.turns + other.turns),
    )
