"""Controllers in the steps of reduced samples, LANES at a time, compiled; see `controllers.running` and `.law`.

Before each correction actions measure the motions at the iterate, the states respond, and the force with its slopes
goes to the actions' parameters. Lanes step by themselves: each has a time and a step of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import types

from pgmp_petsc.controllers.running import (
    AFTER,
    BEFORE,
    Controls,
    States,
    begin_state,
    give_forces,
    put_force,
    respond_in_lane,
)
from pgmp_petsc.effects.time_function import TimeFunction, TimeFunctions, evaluate, joined
from pgmp_petsc.full.part_reference import loaded
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.vectors import LANES, load, select, spread, store
from pgmp_petsc.reduced.action_kernel import Chosen, act, forget_rates
from pgmp_petsc.reduced.actions import ReducedActions
from pgmp_petsc.reduced.arrays import acting_of, places_of
from pgmp_petsc.reduced.kernel import correct_block
from pgmp_petsc.stepping.alpha_step import FIRST_CONTRACTION, LENGTHS, WEIGHTS
from pgmp_petsc.stepping.edge_search import REST, WHOLE


class Control(NamedTuple):
    """The controllers of a batch in some steps, and room for what they find of a block."""

    states: States
    #: measuring, due: actions that measure for those that are continuous, and for those that are sampled
    measuring: Chosen
    sampling: Chosen
    functions: TimeFunctions  # references over time
    #: over, is_due: references and their rates at the ends of steps, (n_t, n, 2); which controllers are sampled there,
    #: (n_t, n)
    over: np.ndarray
    is_due: np.ndarray
    forces: np.ndarray  # of those steps that are shown, (n_shown, n_samples, 2, n), before and after they jump

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
        n, references = len(each), [one.reference for one in each]
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
        return cls(
            States.of(controls, actions, origins, n_samples, LANES), measuring, sampling, joined(functions),
            np.zeros((0, n, 2)), np.zeros((0, n), dtype=bool), np.zeros((0, n_samples, 2, n)),
        )  # fmt: skip

    def over_steps(self, controls: Controls | None, ends: np.ndarray, forces: np.ndarray) -> Control:
        """Return the same for steps that end at times (n_t,)."""
        if controls is None:
            return self
        over = np.zeros((ends.size, len(controls.each), 2))
        is_due = np.zeros((ends.size, len(controls.each)), dtype=bool)
        for k, one in enumerate(controls.each):
            if not isinstance(one.reference, np.ndarray):
                over[:, k] = one.reference.with_rates(ends)[:2].T
            is_due[:, k] = [one.is_due(time) for time in ends.tolist()] if one.entry.sample_time else False
        return self._replace(over=over, is_due=is_due, forces=forces)


@njit(cache=True, apart=True, error_model="numpy", counted=False)
def begin_steps(control, search, scheme, steps, n_steps, pace, beside, samples, lanes, parameters):
    """Begin the steps of some lanes, or parts of them: find what the states' iteration starts from, and what references
    are at their ends; those that are sampled keep their force. Searches of edges, length and gains of the steps are
    those of `steps.Clocks`; scheme and steps see `steps.advance`. Numbers `beside` are vectors (n_beside, LANES) at the
    beginning."""
    law, now = loaded(control.states.law), control.states.now
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
        control.states.kappa[lane] = pace[1, lane] / pace[2, lane]
        for k in range(law.addresses.size):
            if law.is_fixed[k]:
                now[lane, 1 + 2 * k], now[lane, 2 + 2 * k] = law.fixed[k, samples[lane]], 0.0
            elif whole:
                now[lane, 1 + 2 * k], now[lane, 2 + 2 * k] = control.over[number, k, 0], control.over[number, k, 1]
            else:
                value = evaluate(loaded(control.functions), k, now[lane, 0])
                now[lane, 1 + 2 * k], now[lane, 2 + 2 * k] = value[0], value[1]
            begin_state(control.states, law, k, lane, scheme, step, beside, samples[lane], parameters)


@njit(cache=True, apart=True, error_model="numpy", counted=False)
def act_of_states(control, local, grid, amplitudes, q, v, samples, lanes, work, kept, acting, known, depths):
    """Give the actions the forces of continuous controllers about an iterate of some lanes; see `act`."""
    law, parameters = loaded(control.states.law), local.actions.parameters
    if control.measuring.actions.size == 0:
        return
    act(
        local, control.measuring, grid, amplitudes, q, v, samples, lanes, spread(0.0), np.bool_(False), np.bool_(False),
        work, kept, acting, known, depths,
    )  # fmt: skip
    give_forces(control.states, law, parameters, samples, lanes)


@njit(cache=True, apart=types.int64, error_model="numpy", counted=False)
def sample_states(
    control, local, grid, amplitudes, q, v, samples, lanes, n_steps, beside, work, kept, acting, known, depths
):  # fmt: skip
    """Let sampled controllers whose time it is at the ends of the steps of some lanes find new forces; return the lanes
    in which any did."""
    states, law, parameters, jumping = control.states, loaded(control.states.law), local.actions.parameters, 0
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
                    states.c[lane, first + i] = states.z[lane, first + i] = beside[first + i, lane]
                respond_in_lane(states, law, k, lane, samples[lane], law.sample_times[k], parameters)
                for i in range(n):
                    beside[first + i, lane] = states.z[lane, first + i]
                beside[first + 3 * n, lane] = states.found[lane, k, 0]
            put_force(states, law, k, beside[first + 3 * n, lane], samples[lane], parameters)
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
        store(state[4], i, select(lanes, begun, load(state[4], i)))
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
            store(state[4], i, select(lanes, load(state[4], i) + jump, load(state[4], i)))
    for i in range(n):
        now, then = load(state[2], i), load(state[4], i)
        store(state[2], i, select(lanes, then, now))
        store(state[3], i, select(lanes, load(state[3], i) + (then - now), load(state[3], i)))
    store(state[5], 0, select(lanes, spread(FIRST_CONTRACTION), load(state[5], 0)))


@njit(cache=True, apart=True, error_model="numpy", counted=False)
def show_forces(control, row, sample, lane, beside):
    """Note the forces of a lane before and after they jump at an instant that is shown."""
    law, first = loaded(control.states.law), control.states.n_carried
    for k in range(first):
        control.forces[row, sample, BEFORE, k] = control.forces[row, sample, AFTER, k] = beside[k, lane]
    for k in range(law.addresses.size):
        control.forces[row, sample, BEFORE, first + k] = control.states.before[lane, k]
        control.forces[row, sample, AFTER, first + k] = beside[law.columns[k] + 3 * law.n_states[k], lane]
