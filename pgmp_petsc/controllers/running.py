"""Controllers in a run: their states from step to step, and the forces that the mechanics take of them; and the forces
that joints carry, of friction that hangs on these.

`stepping.alpha_step` begins the iteration of a step with `begin`, lets every correction `act`, and ends it with `end`.
Between the corrections motions are read of the iterate itself, so that the iteration ends where mechanics and states
hold together. A controller that is sampled holds its force, and finds the next one, with states by Euler's implicit
rule over its sample time, between two steps (`sample`). Systems that take controllers along in steps of their own
(`reduced.control`, `full.steps`) do the same, lane by lane (`States`), and come here with steps that are too much for
them.

A force that levels off, at a limit or by a formula, may be the same about two iterates and jump between them, so that
they go to and fro: it is linearised at a place between them then (`Running.take_up`), as sharp laws of effects are at
the rate where they change fastest (`effects.law`).

The force that a joint carries is that of the iterate too. It goes with accelerations, and friction changes these: in
turn they contract by about the coefficient times a lever over a length, and faster by Broyden's method
(`follow_carried`), so that a step takes a few corrections more, until these forces are settled too (a correction of
1e-12 m is one of 1e-12 m / h^2 of accelerations), and what it ends with is solved with the step. In the first
accelerations of a run both are found in turn.

Numbers lie in `State.beside`, a row a sample: the forces carried, then of each controller z, z', the auxiliary rates
Z' and the force.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.controllers.acting import control_of, measured_by, rounded
from pgmp_petsc.controllers.law import GIVEN, ControlLaw, Room, begin_all, respond, respond_all
from pgmp_petsc.effects.time_function import TimeFunction
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.controllers import WHOLE, ControllerEntry

JUMPS = 4.0  # times that a force changes between two iterates by more than its slopes about both have it
HALVINGS, HALF = 60, 0.25  # of the way between them, until the force is as near to the mean, as a share of its change
MOST_STARTS, SETTLED = 100, 1e-13  # of the forces carried at the start, found in turn with accelerations
SETTLED_IN_STEP = 1e-9  # their change between two corrections, of which the next leaves the share that it contracts by
FIRST_SECANT = 2  # correction from which on their changes say how they hang on each other
SMALLEST_SECANT = 1e-6  # of these forces; what smaller changes say is round-off
WEAKEST, STRONGEST = 0.25, 2.0  # of what a change of them gives, in units of itself, as a secant is believed
#: Forces (n_carried, n_samples) in joints at a time (s), for a state of a system, from those that were found before.
Carried = Callable[[float, Any, np.ndarray], np.ndarray]
#: Motions (n_motions, n_samples), of all controllers, and their rates at a time (s), for a state of a system.
Measure = Callable[[float, Any], tuple[np.ndarray, np.ndarray]]
BEFORE, AFTER = range(2)  # of a force that jumps
N_GIVEN = len(GIVEN)
FORCE, STIFFNESS, DAMPING, MOTION, RATE = range(5)  # parameters of the actions (`controllers.acting`)


@dataclass(eq=False)
class Running:
    """One controller of some samples."""

    entry: ControllerEntry
    law: ControlLaw
    p: np.ndarray  # parameters of its law and its limits, (n_samples, n_parameters)
    reference: TimeFunction | np.ndarray  # over time, or of each sample
    columns: slice  # of the numbers beside
    motions: slice  # of those of all controllers
    x: np.ndarray  # what is `GIVEN`, and the motions with their rates, (n_samples, 3 + 2 k)
    z: np.ndarray  # states of an iterate, (n_samples, n)
    force: np.ndarray  # with its slopes by the motions and their rates, (n_samples, 1 + 2 k)
    rates: np.ndarray  # (n_samples, n)
    c: np.ndarray  # (n_samples, n)
    room: Room
    #: about: x of the iterate before in the same step, not a number where there is none
    about: np.ndarray
    before: np.ndarray  # the force of that with its slopes, as `force`
    lines: TimeFunction | None  # the reference as a scene has it, whose corners are `rounded`; None where they are not
    kappa: float = 0.0

    @classmethod
    def of(
        cls, scene: Scene, entry: ControllerEntry, every: Mapping[str, Any], n_samples: int, column: int, motion: int
    ) -> Running:
        """Return one of a scene, for values of parameters; `column` and `motion` are its first ones."""
        law, parameters, reference, takes_rate = control_of(scene, entry)
        n, k = len(law.states), law.n_motions
        p = np.empty((n_samples, len(parameters)))
        for into, value in zip(p.T, parameters.values()):
            into[:] = every[value] if isinstance(value, str) else value
        lines = reference if takes_rate else None
        if not isinstance(reference, TimeFunction):
            known = every[reference] if isinstance(reference, str) else reference
            reference = np.array(np.broadcast_to(np.asarray(known, dtype=float), (n_samples,)))
        room = (np.zeros((n_samples, m)) for m in (len(GIVEN) + 2 * k, n, 1 + 2 * k, n, n))
        columns, motions = slice(column, column + 3 * n + 1), slice(motion, motion + k)
        last = (np.full((n_samples, m), np.nan) for m in (len(GIVEN) + 2 * k, 1 + 2 * k))
        return cls(entry, law, p, reference, columns, motions, *room, Room.of([law]), *last, lines)

    def respond(self) -> None:
        """Solve for the states, and find the force."""
        respond_all(
            self.law.address, self.z.shape[1], self.force.shape[1] - 1, self.p, self.x, self.c, self.kappa, self.z,
            self.rates, self.force, self.room,
        )  # fmt: skip

    def take_up(self) -> np.ndarray:
        """Linearise a force that jumped since the iterate before at a place between both, where it is about halfway;
        return of which samples, a mask."""
        x, z, force, rates = (part.copy() for part in (self.x, self.z, self.force, self.rates))
        way, change = x - self.about, force[:, 0] - self.before[:, 0]
        motions = slice(N_GIVEN, None)

        def along(found: np.ndarray) -> np.ndarray:
            """Return by how much slopes have the force change over the whole way."""
            return np.einsum("nk,nk->n", found[:, 1:], way[:, motions])

        with np.errstate(invalid="ignore"):
            jumped = np.abs(change) > JUMPS * np.maximum(np.abs(along(force)), np.abs(along(self.before)))
        self.about[:], self.before[:] = x, force
        if not jumped.any():
            return jumped
        place, there = x.copy(), force.copy()
        low, high, going = np.zeros(len(x)), np.ones(len(x)), jumped.copy()
        for _ in range(HALVINGS):
            share = 0.5 * (low + high)
            # of each sample the same, whichever are beside it
            self.x[:], self.z[:] = np.where(going[:, None], x + (share - 1.0)[:, None] * way, x), z
            self.respond()
            place[going], there[going] = self.x[going], self.force[going]
            beyond = (there[:, 0] - force[:, 0]) / np.where(jumped, change, 1.0) + 0.5
            high, low = np.where(going & (beyond > 0.0), share, high), np.where(going & (beyond <= 0.0), share, low)
            going &= (np.abs(beyond) > HALF) | (np.abs(along(there)) < np.abs(change))
            if not going.any():
                break
        there[:, 0] += np.einsum("nk,nk->n", there[:, 1:], (x - place)[:, motions])
        self.x[:], self.z[:], self.force[:], self.rates[:] = x, z, there, rates
        self.about[jumped] = np.nan
        return jumped

    def parts(self, beside: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return z, z', Z' (n_samples, n) and the force (n_samples, 1) of the numbers beside, sharing memory."""
        own, n = beside[:, self.columns], self.z.shape[1]
        return own[:, :n], own[:, n : 2 * n], own[:, 2 * n : 3 * n], own[:, 3 * n :]

    def look(self, time: float, motions: np.ndarray, rates: np.ndarray) -> None:
        """Take what is measured at a time, of all controllers."""
        fixed = isinstance(self.reference, np.ndarray)
        now, change = (self.reference, 0.0) if fixed else self.reference.with_rates(time)[:2]
        for column, value in zip(self.x.T, (time, now, change)):
            column[:] = value
        self.x[:, len(GIVEN) :: 2], self.x[:, len(GIVEN) + 1 :: 2] = motions[self.motions].T, rates[self.motions].T

    def is_due(self, time: float) -> bool:
        """Whether it is sampled, and finds another force at a time."""
        if not self.entry.sample_time:
            return False
        number = time / self.entry.sample_time
        return abs(number - round(number)) <= WHOLE * max(1.0, number)


class Controls:
    """The controllers of a system of samples with parameter values (n_samples,) each.

    `measure` reads the motions of a state. `put` takes what is given to each action: the force carried, (n_samples, 1),
    of each; then force, stiffness and damping of each controller, (n_samples, 3), for every motion that it measures, or
    once: the first has the force. `carried` finds the forces that joints carry; None where nothing hangs on these.

    All that is given has `names`, of effects by the force carried and of controllers, and goes to actions from the
    numbers `firsts` on. The iteration of a step may have the forces as it was given them (`iterates`), so that `forces`
    has none to add; they may jump between two steps (`jumps`). The `clock` gives the time (s) of references, formulas
    and samplings, where a run has another one.
    """

    def __init__(
        self, scene: Scene, values: Mapping[str, np.ndarray], n_samples: int, measure: Measure,
        put: Callable[[Sequence[np.ndarray]], object], carried: Carried | None,
    ) -> None:  # fmt: skip
        self._measure, self._put, self._find = measure, put, carried
        self.names = (*scene.carried, *scene.controllers)
        self.each: list[Running] = []
        n_carried = len(scene.carried)
        self._carried, self._changes = np.zeros((n_carried, n_samples)), np.zeros((n_carried, n_samples))
        self._followed, self._number = np.zeros((n_samples, N_FOLLOWED + n_carried, n_carried)), 0
        every, self.n_beside, n_motions = {**scene.values, **values}, n_carried, 0
        for entry in scene.controllers.values():
            one = Running.of(scene, entry, every, n_samples, self.n_beside, n_motions)
            self.each.append(one)
            self.n_beside, n_motions = one.columns.stop, one.motions.stop
        self._columns = [*range(n_carried), *(one.columns.stop - 1 for one in self.each)]  # of forces beside
        self._continuous = [one for one in self.each if not one.entry.sample_time]
        rows = rows_of(scene)
        self.firsts = np.cumsum([0, *rows])[:-1].tolist()
        rows = [slice(first - n_carried, first - n_carried + n) for first, n in zip(self.firsts, rows)]
        self._rows = rows[n_carried:]
        self._acting = np.zeros((rows[-1].stop, n_samples, 3))
        self.iterates = self.jumps = False
        self.holds = scene.held  # whether nothing of it changes but between two steps
        self.clock: Callable[[float], float] = float
        self._side: int | None = None  # which part `forces` returns where it is not said; None for the mean
        self._n_samples = n_samples
        self._taken_up = np.zeros(n_samples, dtype=bool)
        #: forces at the last instant that was reached, (n_samples, 2, n_names), before and after they jump there,
        #: and at those that are seen, which increase
        self.now = np.zeros((n_samples, 2, len(self.names)))
        self._times: list[float] = []
        self._seen: list[np.ndarray] = []
        self._n_last = 0

    def start(self, state) -> None:
        """Begin a run, before the first accelerations are known: find the first states and forces, at time 0, of joints
        without any."""
        self._look(0.0, state)
        self._carried[:] = 0.0
        state.beside = np.zeros((self._n_samples, self.n_beside))
        for one in self.each:
            begin_all(one.law.address_of_start, one.p, one.x, one.z)
            one.c[:] = one.z
            one.kappa = 0.0
            one.respond()
            z, change, auxiliary, force = one.parts(state.beside)
            z[:], change[:], auxiliary[:], force[:] = one.z, one.rates, one.rates, one.force[:, :1]
            if not np.isfinite(one.force[:, 0]).any():
                name, at = self.names[len(self._carried) + self.each.index(one)], one.x[0]
                measured = ", ".join(f"{value:g}" for value in at[len(GIVEN) :])
                raise InputError(
                    f"controllers.{name}: its force or the rates of its states are not finite at the start, where t = "
                    f"0, the reference is {at[1]:g}, and motions and their rates are {measured}"
                )
        self._times, self._seen = [0.0], [self.now.copy()]
        self._keep(0.0, state, np.ones(self._n_samples, dtype=bool))

    def settle(self, state) -> bool:
        """Find what joints carry with the accelerations at the start; return whether that changes these."""
        if not self._carried.size:
            return False
        self._number = 0  # in turn alone: from nothing a secant may go to another solution, far away
        self._find_carried(0.0, state)
        state.beside[:, : len(self._carried)] = self._carried.T
        self._keep(0.0, state, np.ones(self._n_samples, dtype=bool))
        return bool(np.any(self._changes > SETTLED * np.abs(self._carried)))

    def n_held(self, ends: np.ndarray) -> int:
        """Return after how many of the steps with the given ends a controller is sampled at first, or else how many
        there are."""
        due = (any(one.is_due(self.clock(end)) for one in self.each) for end in ends.tolist())
        return next((number for number, jumps in enumerate(due, 1) if jumps), ends.size)

    def open(self, times: np.ndarray, step: float) -> np.ndarray:
        """Make room for the forces at times (n_t,) that are to be seen, (n_t, n_samples, 2, n_names); return it. Steps
        from here on are that long, s.

        Of several samples, those that were seen before the last ones are forgotten."""
        for one in self.each:
            one.reference = one.reference if one.lines is None else rounded(one.lines, step)
        if self._n_samples > 1 and self._times:
            del self._times[: -max(self._n_last, 1)], self._seen[: -max(self._n_last, 1)]
        self.now[:, BEFORE] = self.now[:, AFTER]  # what they jumped to is what they are up to the next jump
        room = np.empty((times.size, *self.now.shape))
        room[:] = self.now[:, AFTER:]
        self._times += times.tolist()
        self._seen += list(room)
        self._n_last = times.size or self._n_last
        return room

    def begin(self, time: float, state, scheme) -> None:
        """Begin the iteration of a step that ends at a time, from the numbers beside at its beginning."""
        self._number, s = 0, scheme
        self._carried[:] = state.beside[:, : len(self._carried)].T
        step, kappa = s.gamma / (s.beta * s.gain_v), s.gain_v / s.gain_a
        for one in self._continuous:
            z, change, auxiliary, _ = one.parts(state.beside)
            share = step * s.gamma / (1 - s.alpha_m)
            one.c[:] = z + step * (1 - s.gamma) * auxiliary + share * (s.alpha_f * change - s.alpha_m * auxiliary)
            one.kappa, one.z[:] = kappa, one.c + kappa * change
            one.about[:] = np.nan

    def act(self, time: float, state) -> None:
        """Give the mechanics the forces about an iterate, before it is corrected."""
        self.iterates = True
        if self._continuous:
            self._look(time, state)
        self._taken_up[:] = False
        for one, rows in zip(self.each, self._rows):
            acting = self._acting[rows]
            if one.entry.sample_time:
                acting[0, :, 0] = one.parts(state.beside)[3][:, 0]
                continue
            one.respond()
            self._taken_up |= one.take_up()
            acting[0, :, 0] = one.force[:, 0]
            for k in range(one.law.n_motions):
                acting[k, :, 1:] = -one.force[:, 1 + 2 * k : 3 + 2 * k]
        self._find_carried(time, state)
        self._put([*self._carried[:, :, None], *self._acting])

    def end(self, time: float, state, scheme, samples: np.ndarray) -> None:
        """Take the numbers beside of some samples, a mask, to the end of the step."""
        if self._continuous:
            self._look(time, state)
        s = scheme
        for one in self._continuous:
            one.respond()
            z, change, auxiliary, force = one.parts(state.beside)
            found = ((1 - s.alpha_f) * one.rates + s.alpha_f * change - s.alpha_m * auxiliary) / (1 - s.alpha_m)
            for into, new in ((auxiliary, found), (z, one.z), (change, one.rates), (force, one.force[:, :1])):
                into[samples] = new[samples]
        self._number = 0  # what is found, whose round-off no secant makes larger
        self._find_carried(time, state)
        state.beside[samples, : len(self._carried)] = self._carried.T[samples]
        self.put_nothing()
        self._keep(time, state, samples)

    def put_nothing(self) -> None:
        """Let the mechanics have no forces between iterations, where `forces` has them."""
        self._put([*np.zeros((*self._carried.shape, 1)), *np.zeros_like(self._acting)])
        self.iterates = False

    def acting(self, state) -> np.ndarray:
        """Return what controllers give to each action, as of `put`, (n_actions, n_samples, 3): of the iterate of a step
        as it goes on, of a state elsewhere."""
        found = self._acting
        if not self.iterates:
            found = np.zeros_like(found)
            for one, rows in zip(self.each, self._rows):
                found[rows.start, :, 0] = one.parts(state.beside)[3][:, 0]
        return found

    def sample(self, time: float, state, samples: np.ndarray) -> bool:
        """Let the sampled controllers whose time it is find new forces for some samples; return whether any did, which
        is that they jump until `jumps` is put back."""
        due = [one for one in self.each if one.is_due(self.clock(time))]
        if not due:
            return False
        self._look(time, state)
        for one in due:
            z, _, _, force = one.parts(state.beside)
            one.c[:], one.z[:], one.kappa = z, z, one.entry.sample_time
            one.respond()
            z[samples], force[samples] = one.z[samples], one.force[samples, :1]
        self._keep(time, state, samples, (AFTER,))
        self.jumps = True
        return True

    def forces(self, times: np.ndarray, part: int | None = None) -> np.ndarray:
        """Return the forces at times (n_t,) that are seen, or were reached last, (n_t, n_samples, n_names).

        Where they jump it is what they are before or after, or else the mean of both, with which the trapezoidal rule
        of works is right.
        """
        found, part = np.zeros((times.size, self._n_samples, len(self.names))), self._side if part is None else part
        for row, time in zip(found, times.tolist()):
            at = bisect_left(self._times, time)
            known = self._seen[at] if at < len(self._times) and self._times[at] == time else self.now
            if self.jumps or known is self.now or part is not None:
                row[:] = known[:, AFTER if part is None else part]
            else:
                row[:] = 0.5 * (known[:, BEFORE] + known[:, AFTER])
        return found

    @contextmanager
    def on_side(self, part: int) -> Iterator[None]:
        """Let `forces` return one part of those that jump, `BEFORE` or `AFTER`."""
        self._side = part
        try:
            yield
        finally:
            self._side = None

    def take(self, state) -> None:
        """Take note of the forces of a state in which samples are after steps of a system's own."""
        self.now[:] = self._forces(state)[:, None]

    def over(self, ends: np.ndarray) -> np.ndarray:
        """Return the time, and references with their rates, of the only sample at the ends of steps (n_t,), (n_t, 1 + 2
        n)."""
        found = np.zeros((ends.size, 1 + 2 * len(self.each)))
        times = found[:, 0] = [self.clock(end) for end in ends.tolist()]
        for k, one in enumerate(self.each):
            fixed = isinstance(one.reference, np.ndarray)
            found[:, 1 + 2 * k] = one.reference if fixed else 0.0
            if not fixed:
                found[:, 1 + 2 * k : 3 + 2 * k] = one.reference.with_rates(np.array(times))[:2].T
        return found

    def take_steps(self, ends: np.ndarray, beside: np.ndarray) -> None:
        """Take note of the forces in steps of a system's own that end at times (n_t,), with numbers beside (n_t,
        n_samples, n_beside)."""
        forces = beside[:, :, None, self._columns]
        self.now[:] = forces[-1]
        first = bisect_left(self._times, ends[0])
        at = np.searchsorted(ends, self._times[first:], side="right") - 1
        for seen, number in zip(self._seen[first:], at.tolist()):
            seen[:] = forces[number]
        self.put_nothing()

    @property
    def is_continuous(self) -> bool:
        """Whether nothing of it is sampled."""
        return len(self._continuous) == len(self.each)

    @property
    def n_carried(self) -> int:
        """Number of the forces that joints carry."""
        return len(self._carried)

    @property
    def unsettled(self) -> np.ndarray:
        """Mask (n_samples,) of the samples in which the forces carried changed between the last two corrections, or a
        controller's was taken up between them."""
        return np.any(self._changes > SETTLED_IN_STEP * np.abs(self._carried), axis=0) | self._taken_up

    def _find_carried(self, time: float, state) -> None:
        if self._carried.size:
            with np.errstate(all="ignore"):  # samples that fail
                found = self._find(time, state, self._carried)
                self._changes[:] = np.abs(found - self._carried)
                carried, found = np.ascontiguousarray(self._carried.T), np.ascontiguousarray(found.T)
                for into, *one in zip(carried, found, self._followed):
                    follow_carried(self._number, *one, into)
                self._carried[:] = carried.T
            self._number += 1

    def _look(self, time: float, state) -> None:
        if not self.each:
            return
        (motions, rates), now = self._measure(time, state), self.clock(time)
        for one in self.each:
            one.look(now, motions, rates)

    def _keep(self, time: float, state, samples: np.ndarray, parts: tuple[int, ...] = (BEFORE, AFTER)) -> None:
        """Keep the forces of some samples from a time on, until they are others."""
        forces = self._forces(state)[samples]
        for part in parts:
            self.now[samples, part] = forces
            for at in range(bisect_left(self._times, time), len(self._times)):
                later = part == AFTER and self._times[at] > time
                self._seen[at][samples, part] = forces
                if later:
                    self._seen[at][samples, BEFORE] = forces

    def _forces(self, state) -> np.ndarray:
        return state.beside[:, self._columns]


class Laws(NamedTuple):
    """Controllers as compiled functions take them, an entry or a row each."""

    addresses: np.ndarray  # of their laws, (n,)
    #: n_states, columns: how many states; first of its numbers beside, (n,)
    n_states: np.ndarray
    columns: np.ndarray
    #: n_motions, rows: how many motions it measures; first part of its force, (n,)
    n_motions: np.ndarray
    rows: np.ndarray
    is_sampled: np.ndarray  # (n,)
    parameters: np.ndarray  # (n, n_samples, n_parameters), as many as the law that has most
    sample_times: np.ndarray  # s, (n,)
    is_fixed: np.ndarray  # whether the reference is a number of each sample, (n,)
    fixed: np.ndarray  # these numbers, (n, n_samples)

    @classmethod
    def of(cls, each: Sequence[Running], rows: Sequence[int], n_samples: int) -> Self:
        """Return those of controllers, each with the first part of its force."""

        def numbers(values: list, kind: type = np.int64) -> np.ndarray:
            return np.array(values, dtype=kind)

        n, are_fixed = len(each), [isinstance(one.reference, np.ndarray) for one in each]
        parameters = np.zeros((n, n_samples, max((one.p.shape[1] for one in each), default=0)))
        fixed = np.zeros((n, n_samples))
        for one, is_fixed, into, value in zip(each, are_fixed, parameters, fixed):
            into[:, : one.p.shape[1]] = one.p
            value[:] = one.reference if is_fixed else 0.0
        return cls(
            numbers([one.law.address for one in each]), numbers([one.z.shape[1] for one in each]),
            numbers([one.columns.start for one in each]), numbers([one.law.n_motions for one in each]),
            numbers(rows), numbers([bool(one.entry.sample_time) for one in each], bool), parameters,
            numbers([one.entry.sample_time for one in each], float), numbers(are_fixed, bool), fixed,
        )  # fmt: skip


class States(NamedTuple):
    """Controllers of samples in steps of a system's own, and room for what they find in the lanes of a block."""

    law: Laws
    actions: np.ndarray  # that each part of a force acts by, (n_rows,)
    origins: np.ndarray  # what counts as zero of the motion, (n_rows, n_samples)
    #: of a lane: time and references at the end of its step (n_lanes, 1 + 2 n), kappa (n_lanes,), what laws are given
    #: (n_lanes, most), c, states and rates (n_lanes, n_beside), force with slopes (n_lanes, n, most)
    now: np.ndarray
    kappa: np.ndarray
    x: np.ndarray
    c: np.ndarray
    z: np.ndarray
    rates: np.ndarray
    found: np.ndarray
    before: np.ndarray  # forces before they jump, (n_lanes, n)
    n_carried: int  # numbers beside that forces in joints take, the first ones
    room: Room

    @classmethod
    def of(
        cls, controls: Controls | None, actions: Sequence[int], origins: np.ndarray, n_samples: int, n_lanes: int
    ) -> Self:
        """Return those of controllers, none where there are none, whose forces act by `actions`, part by part."""
        each = [] if controls is None else controls.each
        n, most = len(each), max((1 + 2 * one.law.n_motions for one in each), default=1)
        n_beside, n_carried = (0, 0) if controls is None else (controls.n_beside, controls.n_carried)
        rows = [] if controls is None else controls.firsts[n_carried:]
        shapes = (1 + 2 * n,), (), (N_GIVEN + most - 1,), *((n_beside,),) * 3, (n, most), (n,)
        return cls(
            Laws.of(each, rows, n_samples), np.array(actions, dtype=np.int64), origins,
            *(np.zeros((n_lanes, *shape)) for shape in shapes), n_carried, Room.of([one.law for one in each]),
        )  # fmt: skip


@njit(error_model="numpy", counted=False)
def put_force(states, law, k, force, sample, parameters):
    """Let a controller's actions have a force without slopes."""
    for row in range(law.rows[k], states.actions.size if k + 1 == law.rows.size else law.rows[k + 1]):
        p = parameters[states.actions[row], sample]
        p[FORCE], p[STIFFNESS], p[DAMPING] = force, 0.0, 0.0
        force = 0.0


@njit(error_model="numpy", counted=False)
def respond_in_lane(states, law, k, lane, sample, kappa, parameters):
    """Let the states of a controller respond in a lane to what its actions have measured."""
    x, first, n, n_motions = states.x[lane], law.columns[k], law.n_states[k], law.n_motions[k]
    x[0], x[1], x[2] = states.now[lane, 0], states.now[lane, 1 + 2 * k], states.now[lane, 2 + 2 * k]
    for row in range(n_motions):
        p = parameters[states.actions[law.rows[k] + row], sample]
        x[N_GIVEN + 2 * row] = p[MOTION] - states.origins[law.rows[k] + row, sample]
        x[N_GIVEN + 1 + 2 * row] = p[RATE]
    respond(
        law.addresses[k], n, 2 * n_motions, law.parameters[k, sample], x, states.c[lane, first:], kappa,
        states.z[lane, first:], states.rates[lane, first:], states.found[lane, k], states.room,
    )  # fmt: skip


@njit(error_model="numpy", counted=False)
def begin_state(states, law, k, lane, scheme, step, beside, sample, parameters):
    """Begin a controller's step in a lane: find what the iteration of its states starts from; one that is sampled keeps
    its force. Numbers `beside`, (n_beside, n_lanes), are those at the beginning, `scheme` is ``(alpha_m, alpha_f, beta,
    gamma)``."""
    alpha_m, alpha_f, _, gamma = scheme
    first, n, share = law.columns[k], law.n_states[k], step * gamma / (1.0 - alpha_m)
    if law.is_sampled[k]:
        put_force(states, law, k, beside[first + 3 * n, lane], sample, parameters)
        return
    for i in range(n):
        change, auxiliary = beside[first + n + i, lane], beside[first + 2 * n + i, lane]
        start = beside[first + i, lane] + step * (1.0 - gamma) * auxiliary
        start += share * (alpha_f * change - alpha_m * auxiliary)
        states.c[lane, first + i] = start
        states.z[lane, first + i] = start + states.kappa[lane] * change


@njit(error_model="numpy", counted=False)
def give_forces(states, law, parameters, samples, lanes):
    """Give the actions in some lanes the forces of continuous controllers, of what they have measured."""
    for lane in range(samples.size):
        if not lanes & (1 << lane):
            continue
        for k in range(law.addresses.size):
            if law.is_sampled[k]:
                continue
            respond_in_lane(states, law, k, lane, samples[lane], states.kappa[lane], parameters)
            found = states.found[lane, k]
            put_force(states, law, k, found[0], samples[lane], parameters)
            for row in range(law.n_motions[k]):
                p = parameters[states.actions[law.rows[k] + row], samples[lane]]
                p[STIFFNESS], p[DAMPING] = -found[1 + 2 * row], -found[2 + 2 * row]


@njit(error_model="numpy", counted=False)
def follow_states(states, law, scheme, beside, lanes):
    """Let what is beside some lanes go to the ends of their steps, with the last of `give_forces`."""
    alpha_m, alpha_f = scheme[0], scheme[1]
    for lane in range(beside.shape[1]):
        if not lanes & (1 << lane):
            continue
        for k in range(law.addresses.size):
            first, n = law.columns[k], law.n_states[k]
            if not law.is_sampled[k]:
                for i in range(first, first + n):
                    rate = states.rates[lane, i]
                    end = (1.0 - alpha_f) * rate + alpha_f * beside[n + i, lane] - alpha_m * beside[2 * n + i, lane]
                    beside[2 * n + i, lane] = end / (1.0 - alpha_m)
                    beside[i, lane], beside[n + i, lane] = states.z[lane, i], rate
                beside[first + 3 * n, lane] = states.found[lane, k, 0]
            states.before[lane, k] = beside[first + 3 * n, lane]


N_FOLLOWED = 4  # rows before the inverse Jacobian in what `follow_carried` keeps


@njit(cache=True, error_model="numpy")
def follow_carried(number, found, kept, carried):
    """Take forces that joints carry (n,) on to those of which the mechanics gives the same, by Broyden's method (1965),
    from what is `found` with them in correction `number` of an iteration; rows `kept` (4 + n, n) go from one to the
    next: forces before and what they were off, two of work, and the inverse Jacobian, that of taking what is found at
    first and behind a change that contradicts it."""
    n, inverse = carried.size, kept[N_FOLLOWED:]
    before, off, ahead, across = kept[0], kept[1], kept[2], kept[3]
    whole = size = along = 0.0
    for i in range(n):
        ahead[i], across[i] = 0.0, 0.0
        for j in range(n):
            ahead[i] += inverse[i, j] * (off[j] - (found[j] - carried[j]))
            across[i] += inverse[j, i] * (carried[j] - before[j])
        whole += carried[i] ** 2
        size += (carried[i] - before[i]) ** 2
        along += (carried[i] - before[i]) * ahead[i]
    known = number >= FIRST_SECANT and size > SMALLEST_SECANT**2 * whole
    believed = WEAKEST * size < along < STRONGEST * size
    for i in range(n):
        for j in range(n):
            if known and believed:
                inverse[i, j] += (carried[i] - before[i] - ahead[i]) * across[j] / along
            elif known or number < FIRST_SECANT:
                inverse[i, j] = 1.0 if i == j else 0.0
    for i in range(n):
        before[i], off[i] = carried[i], found[i] - carried[i]
    for i in range(n):
        for j in range(n):
            carried[i] += inverse[i, j] * off[j]


@njit(error_model="numpy", counted=False)
def begin_carried(actions, room, parameters, beside, samples, lanes):
    """Let the actions that rub act in some lanes by the forces at the beginning of their steps, `beside`, (n, n_lanes);
    `samples` are those in the lanes, (n_lanes,), of which the parameters are."""
    for k in range(actions.size):
        for lane in range(samples.size):
            if lanes & (1 << lane):
                room.given[lane, k] = beside[k, lane]
                parameters[actions[k], samples[lane], 0] = beside[k, lane]


@njit(error_model="numpy", counted=False)
def take_carried(actions, room, parameters, number, samples, lanes):
    """Let them act in some lanes by forces from those, (n, n_lanes), that were found in correction `number`; return the
    lanes in which they are not settled."""
    unsettled = 0
    for lane in range(samples.size):
        if not lanes & (1 << lane):
            continue
        given, found = room.given[lane], room.found[lane]
        for k in range(actions.size):
            found[k] = room.forces[k, lane]
        follow_carried(number, found, room.followed[lane], given)
        for k in range(actions.size):
            unsettled |= np.int64(abs(room.followed[lane, 1, k]) > SETTLED_IN_STEP * abs(given[k])) << lane
            parameters[actions[k], samples[lane], 0] = given[k]
    return unsettled


@njit(error_model="numpy", counted=False)
def keep_carried(room, beside, lanes):
    """Keep the forces that were found last as those at the ends of steps of some lanes."""
    for k in range(room.forces.shape[0]):
        for lane in range(beside.shape[1]):
            if lanes & (1 << lane):
                beside[k, lane] = room.forces[k, lane]


def rows_of(scene: Scene) -> list[int]:
    """Return to how many actions each force is given: that which a joint carries to one, that of a controller to one
    for every motion that it measures (`acting.JointController`)."""
    each = (max(1, len(measured_by(scene, one).motions)) for one in scene.controllers.values())
    return [*(1 for _ in scene.carried), *each]
