"""A model as the integrator sees it: a second-order system, its states, the scheme of a step, and who sees a run.

Its energies and powers are what balances are drawn up from: `results.estimates` has that of one run's history,
`ensemble.watchers` those of many samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.controllers.running import Controls
from pgmp_petsc.mechanism.mechanism import Coordinate

# What surrounds a call takes the time of some hundred steps of a single sample in compiled code; where Python goes from
# step to step more gain nothing.
AT_ONCE = 50


@dataclass
class State:
    """State at one time; the arrays have the system's own shapes, all samples together."""

    #: q, v, a: coordinates, velocities, accelerations
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    multipliers: np.ndarray  # Lagrange multipliers; of size zero for a system without constraints
    #: angles (rad) that unknowns do not count beyond half a revolution, at this instant, or of an iterate at the one
    #: before; of size zero where there are none
    turns: np.ndarray = field(default_factory=lambda: np.zeros(0))
    #: numbers of states beside the mechanics, a row a sample; of size zero for a system without any
    beside: np.ndarray = field(default_factory=lambda: np.zeros(0))
    #: of a trail, those of what is beside, before and after they jump, (n_t, n_samples, 2, n_names)
    forces: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def copy(self) -> State:
        """Return a deep copy."""
        return State(*(part.copy() for part in (*self.parts(), self.beside)))

    def parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return all arrays of the mechanics."""
        return self.q, self.v, self.a, self.multipliers, self.turns

    @classmethod
    def along(cls, states: Sequence[State], join: Callable = np.stack) -> State:
        """Return the mechanics of states, and forces beside, with a leading axis of instants; `np.concatenate` joins
        those with one."""
        found = State(*(join(parts) for parts in zip(*(state.parts() for state in states))))
        if states[0].forces.size:
            found.forces = join([state.forces for state in states])
        return found

    @property
    def alone(self) -> State:
        """Its mechanics with a leading axis of one instant, sharing memory."""
        return State(*(part[None] for part in self.parts()))

    @property
    def motion(self) -> np.ndarray:
        """Positions, velocities and accelerations of states with a leading axis of instants, (n_t, 3, ...)."""
        return np.stack([self.q, self.v, self.a], axis=1)

    def merged(self) -> State:
        """Return the mechanics, and forces beside, with the first two axes of all arrays as one."""
        every = (*self.parts(), self.forces if self.forces.size else np.zeros((0, 0)))
        *parts, forces = (part.reshape(math.prod(part.shape[:2]), *part.shape[2:]) for part in every)
        return State(*parts, forces=forces)

    def at(self, number: int | slice) -> State:
        """Return one or some of states whose arrays have a leading axis of instants, sharing memory."""
        more = (part[number] if part.size else part for part in (self.beside, self.forces))
        return State(*(part[number] for part in self.parts()), *more)


class Moment(NamedTuple):
    """Samples between two steps."""

    #: state, auxiliary: state, and the auxiliary accelerations there
    state: State
    auxiliary: np.ndarray
    before: np.ndarray  # accelerations one step before, from which the next ones are extrapolated
    contraction: np.ndarray  # of Newton's iteration, as it is expected in the next step, shape (n_samples,)


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
        gain_v, gain_a = gamma / (beta * step), (1 - alpha_m) / ((1 - alpha_f) * beta * step**2)
        return cls(alpha_m, alpha_f, beta, gamma, gain_v=gain_v, gain_a=gain_a)


@dataclass(frozen=True, eq=False)
class StepsTaken:
    """Equal steps, one after the other; arrays have a leading axis of steps."""

    #: states, auxiliary: states and auxiliary accelerations at their ends
    states: State
    auxiliary: np.ndarray
    contraction: np.ndarray  # of Newton's iteration, as it is expected in the next step, shape (n, n_samples)
    lost: np.ndarray  # mask of the samples whose iteration failed in the last of them, shape (n_samples,)
    n_corrections: np.ndarray  # Newton corrections, all samples together, shape (n,)
    n_calls: int = 1  # calls of the system

    def __len__(self) -> int:
        return len(self.auxiliary)

    def after(self, n: int, before: np.ndarray) -> Moment:
        """Return where samples are after the first n steps, n > 0; `before` are the accelerations they began with."""
        before = before if n == 1 else self.states.a[n - 2]
        return Moment(self.states.at(n - 1), self.auxiliary[n - 1], before, self.contraction[n - 1])


@dataclass(frozen=True, eq=False)
class StepsAsked:
    """Equal steps that a system is asked to take."""

    moment: Moment  # at the beginning
    #: ends, step: ends of the steps, shape (n,), and length of each, s
    ends: np.ndarray
    step: float
    probed: np.ndarray  # which of them are corrected as if nothing were known of the contraction, shape (n,)
    scheme: Scheme  # coefficients for a step
    samples: np.ndarray  # mask of the samples to advance, shape (n_samples,)


@dataclass(frozen=True, eq=False)
class Stretch:
    """Steps of a run that some samples are to take, each until it is done or something happens to it."""

    #: where samples are; brought up to date. One to which something happens stays at the beginning of that step.
    moment: Moment
    #: first, ends: number of the first step in the run; ends of the steps, shape (n,), s
    first: int
    ends: np.ndarray
    step: float  # s
    scheme: Scheme  # coefficients for a step
    samples: np.ndarray  # mask, shape (n_samples,)
    #: whether the edges of laws are crossed, shape (n_events, n_samples); brought up to date where the system passes
    #: them by itself
    beyond: np.ndarray
    #: how far edges are crossed at the end of the step in which a sample is found to cross one, of the same shape;
    #: filled, unless the system passes them by itself
    depths: np.ndarray
    shown: np.ndarray  # numbers of the steps that somebody wants to see, increasing, shape (n_t,)
    trail: State  # the states after these, of the samples that are advanced; filled
    counted: np.ndarray  # see `AlphaStep`; brought up to date


class Observer:
    """Sees the states of a run as it goes on. Those that it is shown do not change afterwards."""

    every: int = 1  # steps of which it is to see one, beside start and end; it may be shown more

    def over(self, numbers: np.ndarray, times: np.ndarray, states: State) -> None:
        """See the states after some steps, with a leading axis of these; of samples that have failed, where they stand.

        Numbers of the steps, increasing, 0 for the start, and their ends, s, have shape (n_t,).
        """
        raise NotImplementedError


class PooledObserver(Observer):
    """Sees states of a run, with a leading axis of instants, as many at once as a system is quickest with; `numbers` of
    steps and `times` (s) are those so far, and `pulse` is called with how many steps there were."""

    def __init__(self, at_once: int, pulse: Callable[[int], object] = lambda n_steps: None) -> None:
        self._at_once, self._pulse, self._waiting, self._n_seen = at_once, pulse, [], 0
        self.numbers: list[int] = []
        self.times: list[float] = []

    def see(self, first: int, states: State) -> None:
        """See the states at the instants of `times` from the number of the first one on."""
        raise NotImplementedError

    def over(self, numbers: np.ndarray, times: np.ndarray, states: State) -> None:
        first = 0
        while first < times.size:
            room = self._at_once + self._n_seen - len(self.times)
            some = slice(first, first + room)
            self.numbers += numbers[some].tolist()
            self.times += times[some].tolist()
            self._waiting.append(states.at(some))
            if len(times[some]) == room:
                self.finish()
            first += room
        self._pulse(int(np.count_nonzero(numbers)))

    def finish(self) -> None:
        """See those that wait."""
        waiting, self._waiting, first, self._n_seen = self._waiting, [], self._n_seen, len(self.times)
        if waiting:
            states = waiting[0] if len(waiting) == 1 else State.along(waiting, np.concatenate)
            with np.errstate(all="ignore"):  # a run that fails may overflow before it is given up
                self.see(first, states)


@dataclass(frozen=True, eq=False)
class Settled:
    """The start of samples."""

    theta: np.ndarray  # rigid coordinates, shape (n_samples, n_theta), rad
    unknowns: np.ndarray  # of the model, a column a sample
    reasons: dict[int, str]  # why a sample has no equilibrium, by its number
    unstable: np.ndarray  # mask of the samples whose equilibrium is unstable
    coordinates: tuple[Coordinate, ...]  # all of them
    free: bool  # whether any coordinate was free

    @property
    def lost(self) -> np.ndarray:
        """Mask of the samples without equilibrium."""
        return np.isin(np.arange(len(self.theta)), list(self.reasons))

    def at_rest(self, state: State, n_driven: int) -> State:
        """Return a start without the accelerations that round-off of the forces gives light nodes, in place.

        Only where all coordinates are free there are none: held ones are let go, driven ones (`n_driven`) move.
        """
        if self.free and n_driven == 0:
            state.a[:] = 0.0
        return state


class _Nothing:
    n_carried, unsettled = 0, False

    def begin(self, *_: object) -> None:
        """Do as little as there is."""

    act = end = put_nothing = begin


NOTHING = _Nothing()


class SecondOrderSystem:
    """Interface of a model for the integrator; a batch of samples is one system.

    Samples are numbered 0 to n_samples - 1 whatever the shapes of the state's arrays. What a model does not say is as
    of one without constraints that move, edges and limits of laws, turns, and steps of its own.
    """

    comm: Comm  # ranks that share the samples
    n_samples: int  # number of samples
    settled: Settled | None = None  # static equilibria that the samples start from, None where they start without loads
    #: what samples start with where joints that are off deform them, such as unknowns and velocities; None where none
    #: does
    built_in: tuple[np.ndarray, np.ndarray] | np.ndarray | None = None
    n_events: int = 0  # edges of laws whose crossing is to be found in time
    steps_at_once: int = 1  # steps that the samples are to take at most until they meet
    bends: bool = False  # whether nothing is to be concluded from how an iteration contracted in the step before
    instants_at_once: int = 1  # instants of a run whose outputs and energies are best evaluated together
    has_range: bool = False  # whether samples may leave the model's range of validity (`outside`)
    #: whether iterations of a reduced model go on to round-off, by one more correction, for derivatives of runs
    precise: bool = False
    moving_constraints: bool = False  # whether constraints turn or follow motions; see `AlphaStep`
    beside: Controls | None = None  # states beside the mechanics; None where there are none
    carries: bool = False  # whether steps of its own (`advance`) take what is beside along
    held: bool = False  # whether what is beside holds, and steps know its forces as they know loads
    about_motion: bool = False  # whether states are about a motion, whose accelerations jump with those of the system

    @property
    def changing(self) -> Controls | _Nothing:
        """The states beside the mechanics that change within a step; `NOTHING` where none do."""
        return NOTHING if self.beside is None or self.held else self.beside

    def start(self) -> State:
        """Return the consistent state at time 0."""
        raise NotImplementedError

    def require_settled(self) -> None:
        """Refuse a single run that has no static equilibrium to start from, and close the system.

        Raises `InputError`, with the reason.
        """
        if self.settled is not None and self.settled.reasons:
            self.close()
            raise InputError(self.settled.reasons[min(self.settled.reasons)])

    def correct(self, time: float, state: State, scheme: Scheme, active: np.ndarray, fresh: bool) -> np.ndarray:
        """Do one Newton correction of the active samples, (n_samples,), towards the end of a step at a time (s), in
        place: q, v, a and multipliers consistently with the scheme. Return its size (n_samples,), in units of the
        mechanism's size or of 1 rad; not finite where it failed. The iteration matrix is evaluated anew if `fresh`."""
        raise NotImplementedError

    def restore(self, state: State, previous: State, samples: np.ndarray) -> None:
        """Put the given samples (a mask) of `state` back to `previous`."""
        raise NotImplementedError

    def reasons(self, time: float, state: State, samples: np.ndarray) -> np.ndarray:
        """Return why n samples of a mask, shape (n_samples,), failed in a step, numbers of a `Status`, shape (n,).

        Time is that of the end of the step, and the state that at its beginning.
        """
        raise NotImplementedError

    def close(self) -> None:
        """Give back what the system holds outside Python."""

    def outside(self, state: State) -> np.ndarray:
        """Return a mask of the samples that left the model's range of validity."""
        return np.zeros(self.n_samples, dtype=bool)

    def depths(self, times: np.ndarray, states: State, samples: np.ndarray) -> np.ndarray:
        """Return how far each edge is crossed (negative: not) at times (n_t,), s, in states with a leading axis of
        instants, shape (n_t, n_events, n_samples); of others than the given samples (a mask) they are any numbers."""
        return np.zeros((times.size, 0, self.n_samples))

    def begin_iteration(self) -> None:
        """Take note that an iteration begins: laws with limits are evaluated as if for the first time."""

    def limited(self) -> np.ndarray:
        """Return a mask of the samples of which a law was limited in the last correction (`effects.law`): their
        iteration goes on."""
        return np.zeros(self.n_samples, dtype=bool)

    def count_turns(self, state: State) -> None:
        """Take note of the angles at an instant that is kept."""

    def project(self, time: float, state: State, step: float, samples: np.ndarray) -> None:
        """Make velocities and accelerations of some samples consistent with the constraints at the end of a step."""

    def strayed(self, state: State, step: float) -> np.ndarray:
        """Return a mask of the samples whose velocities have left what the constraints allow, as nothing moves by in a
        `step` (s) that is short enough. Collective on `comm`."""
        return np.zeros(self.n_samples, dtype=bool)

    def take_steps(self, asked: StepsAsked) -> StepsTaken | None:
        """Take equal steps, up to one in which an iteration fails; None where they are taken by corrections."""

    def advance(self, stretch: Stretch) -> tuple[np.ndarray, np.ndarray] | None:
        """Take some samples through equal steps, each until it is done or something happens to it; return an `Outcome`
        and the number of steps of each, shape (n_samples,). One that is done with fewer than all is to go on.

        None where samples are taken through the same steps together."""

    def trail(self, state: State, n: int) -> State:
        """Return room for n states such as a given one."""
        return State(*(np.empty((n, *part.shape)) for part in state.parts()))

    def restore_all(self, trail: State, states: State, samples: np.ndarray) -> None:
        """Put the given samples (a mask) in all instants of a trail to what they are in other states."""
        for number in range(len(trail.q)):
            self.restore(trail.at(number), states.at(number), samples)

    def energies(self, time: float, state: State) -> Energies:
        """Return energies and powers at an instant, each of shape (n_samples,)."""
        return self.energies_over(np.array([time]), state.alone)

    def energies_over(self, times: Sequence[float], states: State) -> Energies:
        """Return energies and powers in states with a leading axis of instants (n_t,), s, each of shape (n_t
        n_samples,), instant after instant."""
        raise NotImplementedError

    def steps_between_looks(self, every: int | None) -> int:
        """Return how many steps make one of PETSc's TS where it does not look, if one in `every` is observed, or none
        (None); the same on all ranks."""
        return AT_ONCE


@dataclass
class Energies:
    """Energies of a system, of n samples at one instant or of one sample at n instants."""

    #: kinetic, strain: shape (n,), J
    kinetic: np.ndarray
    strain: np.ndarray
    #: potential energy of each effect that has one, by its name, shape (n,), J
    potential: dict[str, np.ndarray] = field(default_factory=dict)
    #: power of each effect but for what is in its potential energy, by its name, shape (n,), W
    powers: dict[str, np.ndarray] = field(default_factory=dict)

    def add_potential(self, effect: str, energy: np.ndarray) -> None:
        """Add to the potential energy of an effect."""
        self.potential[effect] = self.potential.get(effect, 0.0) + energy

    def add_power(self, effect: str, power: np.ndarray) -> None:
        """Add to the power of an effect."""
        self.powers[effect] = self.powers.get(effect, 0.0) + power

    def __getitem__(self, chosen: slice) -> Energies:
        """Return those of some samples or instants."""
        return joined([self], lambda parts: parts[0][chosen])


def joined(parts: Sequence[Energies], join: Callable[[list[np.ndarray]], np.ndarray] = np.concatenate) -> Energies:
    """Return the energies of one sample over the instants of all parts, one after the other."""
    of_bodies = (join([getattr(part, kind) for part in parts]) for kind in ("kinetic", "strain"))
    of_effects = (
        {name: join([getattr(part, kind)[name] for part in parts]) for name in getattr(parts[0], kind)}
        for kind in ("potential", "powers")
    )
    return Energies(*of_bodies, *of_effects)
