"""A step of the generalised-alpha scheme: prediction, Newton's iteration of every sample to its own convergence, and
what is tried where it fails. For all systems: what is compiled for speed decides by the same functions.

What remains after a correction is estimated from the contraction between the last two (Hairer and Wanner 1996, section
IV.8), after the first one from that of the step before.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import beyond, select
from pgmp_petsc.stepping.second_order_system import (
    NOTHING,
    Moment,
    Scheme,
    SecondOrderSystem,
    State,
    StepsAsked,
    StepsTaken,
    Stretch,
)
from pgmp_petsc.stepping.status import Outcome

MAX_ITERATIONS = 12
CAREFUL_ITERATIONS = 80
LONGEST = 0.2  # correction that is not shortened, in units of the mechanism's size or of 1 rad
HOPELESS = 1e30  # correction that no shortening makes one, in the same units: of a load that is absurd
REFRESH_EVERY = 4  # corrections that share one factorisation
FIRST_CONTRACTION = 0.5  # assumed where only one correction is known
PROBED_EVERY = 10  # steps, of which one is corrected twice at least, to see how the iteration contracts
CAUTION = 4.0  # times that contraction is expected until the next one: it changes with the motion
LEAST_CONTRACTION, WORST_CONTRACTION = 1e-8, 0.999  # the iteration of a large correction contracts less than others
ALMOST_NONE = 1e-300
ROUND_OFF = 1e-15
DAMPED = 0.99  # spectral radius with which what alternates is gone after some hundred steps
NEWTON_TOLERANCE = 1e-12  # of the remaining correction, in units of the mechanism's size or of 1 rad
TOLERANCE_OF_ONE = 1e-13  # the same after one correction, where the contraction is that of a step before
LENGTHS = (0.5, 1.0)  # of a run's step, of those that the first accelerations are taken of
WEIGHTS = (2.0, -1.0)  # of the accelerations at their ends


@njit(inline="always")
def contraction_of(iteration, size, last, expected):
    """Return the contraction of a correction of `size`, numbers or vectors: from the one before, `last`, or, of the
    first one, as it is `expected`."""
    if iteration == 0:
        return expected
    return _bounded(size / select(beyond(ALMOST_NONE, last), ALMOST_NONE, last))


@njit(inline="always")
def expected_after(contraction):
    """Return the contraction to be expected in later steps, from that of a second correction."""
    cautious = _bounded(CAUTION * contraction)
    return select(beyond(LEAST_CONTRACTION, cautious), LEAST_CONTRACTION, cautious)


@njit(inline="always")
def goes_on(size, contraction, tolerance):
    """Return the lanes that need one more correction; what is no number does."""
    return beyond(size * contraction / (1.0 - contraction), tolerance) & beyond(size, ROUND_OFF)


@njit(inline="always")
def _bounded(contraction):
    """Return a contraction that is no larger than the worst that is reckoned with."""
    return select(beyond(contraction, WORST_CONTRACTION), WORST_CONTRACTION, contraction)


@njit(cache=True, error_model="numpy")
def judge(iteration, size, last, expected, active, lost):
    """Decide which samples are done after a correction of `size`, with the one before, `last`; each (n_samples,).

    The second correction shows what to expect of later steps. Those whose correction is no number are lost.
    """
    for sample in range(size.size):
        if active[sample]:
            contraction = contraction_of(iteration, size[sample], last[sample], expected[sample])
            if iteration == 1:
                expected[sample] = expected_after(contraction)
            if not np.isfinite(size[sample]):
                lost[sample], active[sample] = True, False
            elif not goes_on(size[sample], contraction, NEWTON_TOLERANCE if iteration > 0 else TOLERANCE_OF_ONE):
                active[sample] = False
            last[sample] = size[sample]


class AlphaStep:
    """Steps of any length of a system, all samples together, of a scheme with a spectral radius at infinite frequency.

    In a system with ``moving_constraints`` each step without enough damping (`DAMPED`) ends with a projection
    (``project``): velocities that the constraints allow, and accelerations that follow from the equations
    (docs/components.md, without numerical damping).

    Where it is `patient`, an iteration that fails with factors of its own is tried again with limited corrections.
    `counted` has the Newton corrections so far, all samples together; those of them that found a matrix and its factors
    anew, known of a single sample; and calls of the system, for steps or for a correction.
    """

    def __init__(self, system: SecondOrderSystem, spectral_radius: float, patient: bool = True) -> None:
        self._system, self._patient, self._spectral_radius = system, patient, spectral_radius
        self._projects = spectral_radius > DAMPED and system.moving_constraints
        self._scheme, self._step = Scheme.of(spectral_radius, 1.0), 1.0
        self.counted = np.zeros(3, dtype=np.int64)

    @property
    def _corrects(self) -> bool:
        """Whether something beside the mechanics changes that steps of the system's own do not take along: then they
        are taken by corrections, one by one."""
        return self._system.changing is not NOTHING and not self._system.carries

    def scheme(self, step: float) -> Scheme:
        """Return the coefficients for a step."""
        if step != self._step:
            self._scheme, self._step = Scheme.of(self._spectral_radius, step), step
        return self._scheme

    def take(self, moment: Moment, ends: np.ndarray, step: float, samples: np.ndarray) -> StepsTaken:
        """Take equal steps of some samples, a mask, up to one in which an iteration fails."""
        ends, scheme = ends[:1] if self._projects else ends, self.scheme(step)
        probed = (np.rint(ends / step) % PROBED_EVERY == 0) | self._system.bends
        asked = StepsAsked(moment, ends, step, probed, scheme, samples)
        taken = None if self._corrects else self._system.take_steps(asked)
        if taken is None:
            taken = _taken_by_corrections(self._system, asked)
        self.count(taken.n_corrections, -(-taken.n_corrections // REFRESH_EVERY), taken.n_calls)
        if self._projects:
            state = taken.states.at(0)
            self._system.project(float(ends[0]), state, step, samples & ~taken.lost)
            taken.auxiliary[0] = _following(scheme, moment.auxiliary, state.a, moment.state.a)
        return taken

    def take_one(self, moment: Moment, end: float, step: float, samples: np.ndarray) -> tuple[Moment, np.ndarray]:
        """Take one step of some samples with all care; return the moment at its end, and a mask of those whose
        iteration failed."""
        taken = self.take(moment, np.array([end]), step, samples)
        after, lost = taken.after(1, moment.state.a.copy()), taken.lost
        if lost.any():
            again, still = self.retry(moment, end, step, lost)
            put(self._system, after, again, lost)
            lost = still
        return after, lost

    def retry(self, moment: Moment, end: float, step: float, samples: np.ndarray) -> tuple[Moment, np.ndarray]:
        """Take a step once more in which the iteration of some samples failed; return as `take_one` does.

        A load that sets in at once gives light nodes accelerations that no step can follow; the displacement, held at
        constant velocity, is then the better prediction.
        """
        scheme, known = self.scheme(step), np.full(samples.size, FIRST_CONTRACTION)
        ahead = -(0.5 - scheme.beta) / scheme.beta * moment.auxiliary
        weighted = (1 - scheme.alpha_m) * ahead + scheme.alpha_m * moment.auxiliary - scheme.alpha_f * moment.state.a
        predicted = _predicted(scheme, step, moment, weighted / (1 - scheme.alpha_f))
        state = predicted.copy()
        lost, n_corrections, n_calls = iterate(self._system, end, state, scheme, samples, 1, known.copy())
        self.count(n_corrections, n_calls, n_calls)
        if lost.any() and self._patient:
            self._system.restore(state, predicted, lost)
            lost = self._iterate_carefully(end, state, scheme, lost)
        if self._projects:
            self._system.project(end, state, step, samples & ~lost)
        self._system.count_turns(state)
        follows = _following(scheme, moment.auxiliary, state.a, moment.state.a)
        return Moment(state, follows, moment.state.a.copy(), known), lost

    def advance(self, stretch: Stretch) -> tuple[np.ndarray, np.ndarray]:
        """Take some samples through equal steps; see `SecondOrderSystem.advance`."""
        found = None if self._corrects else self._system.advance(stretch)
        return self._advanced_together(stretch) if found is None else found

    def _advanced_together(self, stretch: Stretch) -> tuple[np.ndarray, np.ndarray]:
        """Advance samples side by side, up to a step that is too much for one, and none over an edge."""
        begun = stretch.moment.state.a.copy()
        taken = self.take(stretch.moment, stretch.ends, stretch.step, stretch.samples)
        n_steps, outcome = np.where(stretch.samples, len(taken), 0), np.full(stretch.samples.size, Outcome.DONE)
        n_steps[taken.lost], outcome[taken.lost] = len(taken) - 1, Outcome.LOST
        n_seen = n_steps.max() if stretch.beyond.size or self._system.has_range else 0
        states = taken.states.at(slice(n_seen))
        depths = self._system.depths(stretch.ends[:n_seen], states, stretch.samples) if n_seen else ()
        for k, found in enumerate(depths):
            here = n_steps > k
            crossed = here & np.any((found > 0.0) != stretch.beyond, axis=0)
            stretch.depths[:, crossed] = found[:, crossed]
            outside = here & ~crossed & self._system.outside(states.at(k))
            outcome[crossed], outcome[outside] = Outcome.CROSSED, Outcome.OUTSIDE
            n_steps[crossed | outside] = k
        for n in set(n_steps.tolist()) - {0}:
            there = n_steps == n
            put(self._system, stretch.moment, taken.after(n, begun), there)
            rows = slice(*np.searchsorted(stretch.shown, [stretch.first + 1, stretch.first + n + 1]))
            steps = stretch.shown[rows] - stretch.first - 1
            if steps.size and not there.all():
                self._system.restore_all(stretch.trail.at(rows), taken.states.at(steps), there)
            elif steps.size:
                for part, found in zip(stretch.trail.parts(), taken.states.parts()):
                    part[rows] = found[:n] if steps.size == n else found[steps]
        return outcome, n_steps

    def count(self, n_corrections: np.ndarray | int, n_fresh: np.ndarray | int, n_calls: int) -> None:
        """Count corrections, those with a matrix of their own, and calls of the system."""
        self.counted += (np.sum(n_corrections), np.sum(n_fresh), n_calls)

    def _iterate_carefully(self, time: float, state: State, scheme: Scheme, alive: np.ndarray) -> np.ndarray:
        """Run Newton's iteration with limited corrections, in place; return the samples that failed.

        A load that sets in at once may throw the first corrections far beyond the range in which the equations look
        like their linearisation: nodes turn by half a revolution. A correction is shortened to `LONGEST`.
        """
        active, lost = alive.copy(), np.zeros_like(alive)
        beside = self._system.changing
        self._system.begin_iteration()
        beside.begin(time, state, scheme)
        for _ in range(CAREFUL_ITERATIONS):
            before = state.copy()
            beside.act(time, state)
            size = self._system.correct(time, state, scheme, active, True)
            self.count(active.sum(), 0, 1)
            near = size < HOPELESS  # and a number
            lost |= active & ~near
            active &= near
            # by halves, together: rarely more than a few samples come here
            while True:
                long = active & (size > LONGEST)
                if not long.any():
                    break
                halfway = State(*(0.5 * (one + other) for one, other in zip(before.parts(), state.parts())))
                self._system.restore(state, halfway, long)
                size = np.where(long, 0.5 * size, size)
            active &= (size > NEWTON_TOLERANCE) | self._system.limited()
            if not active.any():
                break
        beside.end(time, state, scheme, alive & ~lost & ~active)
        return lost | active


def _taken_by_corrections(system: SecondOrderSystem, asked: StepsAsked) -> StepsTaken:
    """Return the first of the steps that are asked for, taken by a system's corrections one by one."""
    state, auxiliary, before, contraction = asked.moment
    expected = np.where(asked.probed[0], FIRST_CONTRACTION, contraction)
    ahead = _predicted(asked.scheme, asked.step, asked.moment, state.a + (state.a - before))
    lost, n_corrections, n_calls = iterate(
        system, float(asked.ends[0]), ahead, asked.scheme, asked.samples, REFRESH_EVERY, expected
    )
    system.count_turns(ahead)
    expected[lost] = FIRST_CONTRACTION
    follows = _following(asked.scheme, auxiliary, ahead.a, state.a)
    states = State(*(part[None] for part in (*ahead.parts(), ahead.beside)))
    return StepsTaken(states, follows[None], expected[None], lost, np.array([n_corrections]), n_calls)


def iterate(
    system: SecondOrderSystem,
    time: float,
    state: State,
    scheme: Scheme,
    alive: np.ndarray,
    refresh_every: int,
    expected: np.ndarray,
) -> tuple[np.ndarray, int, int]:
    """Run Newton's iteration of every living sample to its own convergence, in place; return those that failed, the
    number of corrections of all samples together, and that of calls.

    `expected` are the contractions, shape (n_samples,), brought up to date.
    """
    active, lost, last = alive.copy(), np.zeros_like(alive), np.full(alive.size, np.inf)
    n_corrections, n_calls, going = 0, 0, alive.copy()
    system.begin_iteration()
    beside = system.changing
    beside.begin(time, state, scheme)
    for iteration in range(MAX_ITERATIONS):
        beside.act(time, state)
        size = system.correct(time, state, scheme, going, iteration % refresh_every == 0)
        last[system.limited()] = 0.0  # nothing follows from the size of the last correction
        n_corrections += int(going.sum())
        n_calls += 1
        begun = active.copy()
        judge(iteration, size, last, expected, active, lost)
        going &= active | beside.unsettled & (size > ROUND_OFF)
        if system.precise:  # once more where the iteration has converged
            going |= begun & ~active & ~lost
        if not going.any():
            break
    beside.end(time, state, scheme, alive & ~lost & ~active)
    return lost | active, n_corrections, n_calls


def standing(state: State, auxiliary: np.ndarray, n_samples: int) -> Moment:
    """Return a moment of which no step before is known."""
    return Moment(state, auxiliary, state.a.copy(), np.full(n_samples, FIRST_CONTRACTION))


def put(system: SecondOrderSystem, target: Moment, source: Moment, samples: np.ndarray) -> None:
    """Copy where some samples are, a mask; a system alone knows where its samples are in arrays."""
    state = target.state
    if state.beside.size and source.state.beside.size:  # steps that hold it have none
        state.beside[samples] = source.state.beside[samples]
    if samples.all():
        for into, found in zip((*state.parts(), *target[1:]), (*source.state.parts(), *source[1:])):
            into[:] = found
        return
    system.restore(state, source.state, samples)
    # multipliers and turns are copied onto themselves
    into, found = (State(m.auxiliary, m.before, m.before, state.multipliers, state.turns) for m in (target, source))
    system.restore(into, found, samples)
    target.contraction[samples] = source.contraction[samples]


def _following(scheme: Scheme, auxiliary: np.ndarray, a: np.ndarray, previous_a: np.ndarray) -> np.ndarray:
    """Return A_{n+1} from the accelerations at the end and the beginning of the step."""
    s = scheme
    return ((1 - s.alpha_f) * a + s.alpha_f * previous_a - s.alpha_m * auxiliary) / (1 - s.alpha_m)


def _predicted(scheme: Scheme, step: float, moment: Moment, a: np.ndarray) -> State:
    """Predict the end of the step with given accelerations there."""
    s, h, previous, auxiliary = scheme, step, moment.state, moment.auxiliary
    ahead = _following(scheme, auxiliary, a, previous.a)
    q = previous.q + h * previous.v + h**2 * ((0.5 - s.beta) * auxiliary + s.beta * ahead)
    v = previous.v + h * ((1 - s.gamma) * auxiliary + s.gamma * ahead)
    return State(q, v, a.copy(), previous.multipliers.copy(), previous.turns.copy(), previous.beside.copy())


class _ImplicitStep(AlphaStep):
    """Steps whose displacements and velocities follow from the accelerations at their ends alone."""

    def scheme(self, step: float) -> Scheme:
        return Scheme(0.0, 0.0, 0.5, 1.0, gain_v=2.0 / step, gain_a=2.0 / step**2)


def goes_on_resolved(spectral_radius: float) -> bool:
    """Return whether a run goes on from accelerations that its steps resolve; see `first_accelerations`."""
    return spectral_radius < DAMPED


class First(NamedTuple):
    """Accelerations that a run begins with; see `first_accelerations`."""

    #: a, auxiliary: accelerations, and auxiliary ones, of the shape of those of a state
    a: np.ndarray
    auxiliary: np.ndarray
    ends: list[State]  # of the steps that they are taken of
    lost: np.ndarray  # mask of the samples that begin with their accelerations, (n_samples,)
    n_iterations: int  # Newton corrections that they took, all samples together


def first_accelerations(
    system: SecondOrderSystem, start: State, step: float, samples: np.ndarray, spectral_radius: float
) -> First:
    """Return the accelerations that a run begins with, auxiliary ones too. Collective on ``system.comm``.

    The scheme may begin with any A_0 within O(h) of q''_0, and keeps its order (Arnold and Bruls 2007). With q''_0
    itself vibrations that the steps do not resolve overshoot (Hilber and Hughes 1978; docs/method.md, time
    integration). A_0 is therefore taken of steps that cannot overshoot,

        q_1 = q_0 + h q'_0 + h^2 / 2 q''_1,    q'_1 = q'_0 + h q''_1

    (Newmark's with beta = 1/2, gamma = 1). Where they resolve a motion, q''_1 = q''_0 + h q'''_0 + O(h^2); where not,
    it is q''_0 / (1 + (h omega)^2 / 2) from rest. Twice that of a step of half the length, less that of a whole one, is
    q''_0 + O(h^2) of what is resolved, and next to nothing of the rest. Where the scheme damps what alternates
    (`DAMPED`) it goes on from it in place of q''_0 too.

    `step` is the length of the steps of the run, s, and `samples` a mask of those to advance, (n_samples,): others, and
    those that such a step is too much for, begin with their accelerations.
    """
    stepper, lost, ends = _ImplicitStep(system, 0.0), ~samples, []
    for length in (share * step for share in LENGTHS):
        begun = standing(start, start.a, system.n_samples)
        after, failed = stepper.take_one(begun, length, length, samples)
        # to the last digit: what is left of positions is 2 / h^2 times as much of accelerations
        beside = system.changing
        if (samples & ~failed).any() and not beside.n_carried:
            beside.begin(length, begun.state, stepper.scheme(length))
            beside.act(length, after.state)
            system.correct(length, after.state, stepper.scheme(length), samples & ~failed, True)
            stepper.count(samples & ~failed, 0, 1)
            beside.put_nothing()
        ends.append(after.state)
        lost |= failed
    found = replace(start.copy(), a=sum(weight * end.a for weight, end in zip(WEIGHTS, ends)))
    system.restore(found, start, lost)
    a = found.a.copy() if goes_on_resolved(spectral_radius) else start.a
    return First(a, found.a, ends, lost, int(stepper.counted[0]))


def resolved_jump(system: SecondOrderSystem, state: State, step: float, samples: np.ndarray, time: float) -> np.ndarray:
    """Return by how much accelerations jump with forces, as far as steps resolve it; see `first_accelerations`.

    With the jump F of the forces, M, C and K of the state, ``(M + h C + h^2 / 2 K) x(h) = F``, it is ``2 x(h / 2) -
    x(h)``. Forces have jumped, ``state.a`` has not.
    """
    jump = np.zeros_like(state.a)
    for share, weight in zip(LENGTHS, WEIGHTS):
        trial = state.copy()
        system.begin_iteration()
        system.correct(time, trial, _ImplicitStep(system, 0.0).scheme(share * step), samples, True)
        jump += weight * (trial.a - state.a)
    return jump
