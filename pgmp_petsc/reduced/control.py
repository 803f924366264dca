"""Controllers in the steps of reduced samples, LANES at a time, compiled; see `controllers.running` and `.law`.

Before each correction actions measure the motions at the iterate, the states respond, and the force with its slopes
goes to the actions' parameters. Lanes step by themselves: each has a time and a step of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import types

from pgmp_petsc.controllers.law import GIVEN, Room, respond
from pgmp_petsc.controllers.running import AFTER, BEFORE, Controls, Running
from pgmp_petsc.effects.time_function import TimeFunction, TimeFunctions, evaluate, joined
from pgmp_petsc.full.part_reference import loaded
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.vectors import LANES, blend, load, spread, store
from pgmp_petsc.reduced.action_kernel import Chosen, act, forget_rates
from pgmp_petsc.reduced.actions import ReducedActions
from pgmp_petsc.reduced.arrays import acting_of, places_of
from pgmp_petsc.reduced.kernel import correct_block
from pgmp_petsc.stepping.alpha_step import FIRST_CONTRACTION, LENGTHS, WEIGHTS
from pgmp_petsc.stepping.edge_search import REST, WHOLE

N_GIVEN = len(GIVEN)
FORCE, STIFFNESS, DAMPING, MOTION, RATE = range(5)  # parameters of the actions (`controllers.acting`)


class Law(NamedTuple):
    """The controllers, an entry or a row each."""

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
    def of(cls, each: Sequence[Running], rows: Sequence[int], n_samples: int) -> Law:
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


class Control(NamedTuple):
    """The controllers of a batch in some steps, and room for what they find of a block."""

    law: Law
    actions: np.ndarray  # that each part of a force acts by, (n_rows,)
    origins: np.ndarray  # what counts as zero of the motion, (n_rows, n_samples)
    #: measuring, due: actions that measure for those that are continuous, and for those that are sampled
    measuring: Chosen
    sampling: Chosen
    functions: TimeFunctions  # references over time
    #: over, is_due: references and their rates at the ends of steps, (n_t, n, 2); which controllers are sampled there,
    #: (n_t, n)
    over: np.ndarray
    is_due: np.ndarray
    forces: np.ndarray  # of those steps that are shown, (n_shown, n_samples, 2, n), before and after they jump
    #: of a lane: time and references at the end of its step (LANES, 1 + 2 n), kappa (LANES,), what laws are given
    #: (LANES, most), c, states and rates (LANES, n_beside), force with slopes (LANES, n, most)
    now: np.ndarray
    kappa: np.ndarray
    x: np.ndarray
    c: np.ndarray
    z: np.ndarray
    rates: np.ndarray
    found: np.ndarray
    before: np.ndarray  # forces before they jump, (LANES, n)
    n_carried: int  # numbers beside that forces in joints take, the first ones
    room: Room

    @classmethod
    def of(
        cls,
        controls: Controls | None,
        actions: Sequence[int],
        origins: np.ndarray,
        every: ReducedActions,
        n_samples: int,
    ) -> Control:
        """Return the controllers of a system, none where there are none; `every` are all of its actions, `actions` the
        numbers of those that are parts of forces."""
        each = [] if controls is None else controls.each
        n, most = len(each), max((1 + 2 * one.law.n_motions for one in each), default=1)
        references = [one.reference for one in each]
        functions = [TimeFunction.constant(0.0) if isinstance(one, np.ndarray) else one for one in references]
        n_carried = 0 if controls is None else len(controls.names) - n
        rows = [*([] if controls is None else controls.firsts[n_carried:]), len(actions)]
        parts = [actions[first:last] for first, last in zip(rows, rows[1:])]

        def led(part: Sequence[int]) -> list[int]:
            return sorted({*part, *(k - 1 for k in part if every.actions[k].led)})

        measuring, sampling = (
            every.chosen(
                [k for one, part in zip(each, parts) if bool(one.entry.sample_time) is sampled for k in led(part)]
            )
            for sampled in (False, True)
        )
        n_beside = 0 if controls is None else controls.n_beside
        places = np.zeros((3, LANES, n_beside))
        return cls(
            Law.of(each, rows[:-1], n_samples), np.array(actions, dtype=np.int64), origins, measuring, sampling,
            joined(functions), np.zeros((0, n, 2)), np.zeros((0, n), dtype=bool), np.zeros((0, n_samples, 2, n)),
            np.zeros((LANES, 1 + 2 * n)), np.zeros(LANES), np.zeros((LANES, N_GIVEN + most - 1)), *places,
            np.zeros((LANES, n, most)), np.zeros((LANES, n)), n_carried, Room.of([one.law for one in each]),
        )  # fmt: skip

    def over_steps(self, controls: Controls | None, ends: np.ndarray, goes_on: bool, forces: np.ndarray) -> Control:
        """Return the same for steps that end at times (n_t,), after the last of which the run may go on."""
        if controls is None:
            return self
        over = np.zeros((ends.size, len(controls.each), 2))
        is_due = np.zeros((ends.size, len(controls.each)), dtype=bool)
        for k, one in enumerate(controls.each):
            if not isinstance(one.reference, np.ndarray):
                over[:, k] = one.reference.with_rates(ends)[:2].T
            is_due[:, k] = [one.is_due(time) for time in ends.tolist()] if one.entry.sample_time else False
        is_due[-1:] &= goes_on
        return self._replace(over=over, is_due=is_due, forces=forces)


@njit(cache=True, apart=True, error_model="numpy", counted=False)
def begin_steps(control, search, scheme, steps, n_steps, pace, beside, samples, lanes, parameters):
    """Begin the steps of some lanes, or parts of them: find what the states' iteration starts from, and what references
    are at their ends; those that are sampled keep their force. Searches of edges, length and gains of the steps are
    those of `steps.Clocks`; scheme and steps see `steps.advance`. Numbers `beside` are vectors (n_beside, LANES) at the
    beginning."""
    law, now = loaded(control.law), control.now
    alpha_m, alpha_f, _, gamma = scheme
    for lane in range(LANES):
        if not lanes & (1 << lane):
            continue
        step, number, whole = pace[0, lane], n_steps[lane], True
        now[lane, 0] = steps[1][number]
        if search.depths.shape[0] > 0:
            stage = search.stage[lane]
            whole = stage == WHOLE or stage == REST
            if not whole:
                now[lane, 0] += search.duration[lane] - search.left[lane]
        control.kappa[lane] = pace[1, lane] / pace[2, lane]
        share = step * gamma / (1.0 - alpha_m)
        for k in range(law.addresses.size):
            if law.is_fixed[k]:
                now[lane, 1 + 2 * k], now[lane, 2 + 2 * k] = law.fixed[k, samples[lane]], 0.0
            elif whole:
                now[lane, 1 + 2 * k], now[lane, 2 + 2 * k] = control.over[number, k, 0], control.over[number, k, 1]
            else:
                value = evaluate(loaded(control.functions), k, now[lane, 0])
                now[lane, 1 + 2 * k], now[lane, 2 + 2 * k] = value[0], value[1]
            first, n = law.columns[k], law.n_states[k]
            if law.is_sampled[k]:
                _put(control, law, k, beside[first + 3 * n, lane], samples[lane], parameters)
                continue
            for i in range(n):
                change, auxiliary = beside[first + n + i, lane], beside[first + 2 * n + i, lane]
                start = beside[first + i, lane] + step * (1.0 - gamma) * auxiliary
                start += share * (alpha_f * change - alpha_m * auxiliary)
                control.c[lane, first + i] = start
                control.z[lane, first + i] = start + control.kappa[lane] * change


@njit(error_model="numpy", counted=False)
def _put(control, law, k, force, sample, parameters):
    """Let a controller's actions have a force without slopes."""
    for row in range(law.rows[k], control.actions.size if k + 1 == law.rows.size else law.rows[k + 1]):
        p = parameters[control.actions[row], sample]
        p[FORCE], p[STIFFNESS], p[DAMPING] = force, 0.0, 0.0
        force = 0.0


@njit(error_model="numpy", counted=False)
def _respond(control, law, k, lane, sample, kappa, parameters):
    """Let the states of a controller respond in a lane to what its actions have measured."""
    x, first, n, n_motions = control.x[lane], law.columns[k], law.n_states[k], law.n_motions[k]
    x[0], x[1], x[2] = control.now[lane, 0], control.now[lane, 1 + 2 * k], control.now[lane, 2 + 2 * k]
    for row in range(n_motions):
        p = parameters[control.actions[law.rows[k] + row], sample]
        x[N_GIVEN + 2 * row] = p[MOTION] - control.origins[law.rows[k] + row, sample]
        x[N_GIVEN + 1 + 2 * row] = p[RATE]
    respond(
        law.addresses[k], n, 2 * n_motions, law.parameters[k, sample], x, control.c[lane, first:], kappa,
        control.z[lane, first:], control.rates[lane, first:], control.found[lane, k], loaded(control.room),
    )  # fmt: skip


@njit(cache=True, apart=True, error_model="numpy", counted=False)
def act_of_states(control, local, grid, amplitudes, q, v, samples, lanes, work, kept, acting, known, depths):
    """Give the actions the forces of continuous controllers about an iterate of some lanes; see `act`."""
    law, parameters = loaded(control.law), local.actions.parameters
    if control.measuring.actions.size == 0:
        return
    act(
        local, control.measuring, grid, amplitudes, q, v, samples, lanes, spread(0.0), np.bool_(False), np.bool_(False),
        work, kept, acting, known, depths,
    )  # fmt: skip
    for lane in range(LANES):
        if not lanes & (1 << lane):
            continue
        for k in range(law.addresses.size):
            if law.is_sampled[k]:
                continue
            _respond(control, law, k, lane, samples[lane], control.kappa[lane], parameters)
            found = control.found[lane, k]
            _put(control, law, k, found[0], samples[lane], parameters)
            for row in range(law.n_motions[k]):
                p = parameters[control.actions[law.rows[k] + row], samples[lane]]
                p[STIFFNESS], p[DAMPING] = -found[1 + 2 * row], -found[2 + 2 * row]


@njit(cache=True, apart=True, error_model="numpy", counted=False)
def follow_states(control, scheme, beside, samples, lanes):
    """Let what is beside some lanes go to the ends of their steps, with the last of `act_of_states`."""
    law = loaded(control.law)
    alpha_m, alpha_f = scheme[0], scheme[1]
    for lane in range(LANES):
        if not lanes & (1 << lane):
            continue
        for k in range(law.addresses.size):
            first, n = law.columns[k], law.n_states[k]
            if not law.is_sampled[k]:
                for i in range(first, first + n):
                    rate = control.rates[lane, i]
                    end = (1.0 - alpha_f) * rate + alpha_f * beside[n + i, lane] - alpha_m * beside[2 * n + i, lane]
                    beside[2 * n + i, lane] = end / (1.0 - alpha_m)
                    beside[i, lane], beside[n + i, lane] = control.z[lane, i], rate
                beside[first + 3 * n, lane] = control.found[lane, k, 0]
            control.before[lane, k] = beside[first + 3 * n, lane]


@njit(cache=True, apart=types.int64, error_model="numpy", counted=False)
def sample_states(
    control, local, grid, amplitudes, q, v, samples, lanes, n_steps, beside, work, kept, acting, known, depths
):  # fmt: skip
    """Let sampled controllers whose time it is at the ends of the steps of some lanes find new forces; return the lanes
    in which any did."""
    law, parameters, jumping = loaded(control.law), local.actions.parameters, 0
    for lane in range(LANES):
        for k in range(law.addresses.size):
            if lanes & (1 << lane) and control.is_due[n_steps[lane], k]:
                jumping |= 1 << lane
    if jumping == 0:
        return 0
    act(
        local, control.sampling, grid, amplitudes, q, v, samples, jumping, spread(0.0), np.bool_(False),
        np.bool_(False), work, kept, acting, known, depths,
    )  # fmt: skip
    for lane in range(LANES):
        if not jumping & (1 << lane):
            continue
        for k in range(law.addresses.size):
            first, n = law.columns[k], law.n_states[k]
            if control.is_due[n_steps[lane], k]:
                for i in range(n):
                    control.c[lane, first + i] = control.z[lane, first + i] = beside[first + i, lane]
                _respond(control, law, k, lane, samples[lane], law.sample_times[k], parameters)
                for i in range(n):
                    beside[first + i, lane] = control.z[lane, first + i]
                beside[first + 3 * n, lane] = control.found[lane, k, 0]
            _put(control, law, k, beside[first + 3 * n, lane], samples[lane], parameters)
    return jumping


@njit(cache=True, apart=True, error_model="numpy", fastmath={"contract"}, counted=False)
def jump_lanes(equations, memory, room, block, strengths, step, state, lanes):
    """Let accelerations of some lanes jump with forces, as `alpha_step.resolved_jump` says; the next step begins with
    these.

    `state` are the vectors of the block, `strengths` what acts on the lanes now, `step` the length of their steps, s;
    the room's `work` is at their place.
    """
    work, local = room.work, room.local
    n = equations.layout.n_eta
    for i in range(n):
        begun = load(state[2], i)
        if i < len(equations.layout.rigid) and equations.prescribed[i]:
            begun = load(strengths.motions, 3 * i + 2)
        store(work.q, i, load(state[0], i))
        store(work.rate, i, load(state[1], i))
        store(work.acceleration, i, begun)
        store(state[4], i, blend(lanes, begun, load(state[4], i)))
    for part in range(len(LENGTHS)):
        length = LENGTHS[part] * step
        gains = spread(2.0 / length), spread(2.0 / (length * length))
        forget_rates(memory.known, memory.samples[block], lanes)
        act(
            equations.local, equations.local.all, equations.grid, strengths.actions, work.q, work.rate,
            memory.samples[block], lanes, gains[0], np.bool_(True), np.bool_(False), local, places_of(memory, block),
            acting_of(memory, block), memory.known, memory.depths,
        )  # fmt: skip
        correct_block(equations, memory, room, block, strengths.loads, gains, np.bool_(True))
        for i in range(n):
            jump = -WEIGHTS[part] * (gains[1] * load(work.balance, i))
            store(state[4], i, blend(lanes, load(state[4], i) + jump, load(state[4], i)))
    for i in range(n):
        now, then = load(state[2], i), load(state[4], i)
        store(state[2], i, blend(lanes, then, now))
        store(state[3], i, blend(lanes, load(state[3], i) + (then - now), load(state[3], i)))
    store(state[5], 0, blend(lanes, spread(FIRST_CONTRACTION), load(state[5], 0)))


@njit(cache=True, apart=True, error_model="numpy", counted=False)
def show_forces(control, row, sample, lane, beside):
    """Note the forces of a lane before and after they jump at an instant that is shown."""
    law, first = loaded(control.law), control.n_carried
    for k in range(first):
        control.forces[row, sample, BEFORE, k] = control.forces[row, sample, AFTER, k] = beside[k, lane]
    for k in range(law.addresses.size):
        control.forces[row, sample, BEFORE, first + k] = control.before[lane, k]
        control.forces[row, sample, AFTER, first + k] = beside[law.columns[k] + 3 * law.n_states[k], lane]
