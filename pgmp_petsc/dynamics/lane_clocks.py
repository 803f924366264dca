"""Where the lanes of a block are in their steps, how long their next one is and what acts at its end, compiled.

Lanes go from step to step by themselves: one that searches the edge of a law takes parts of a step while others go on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.dynamics.alpha_step import FIRST_CONTRACTION, PROBED_EVERY
from pgmp_petsc.dynamics.edge_search import REST, WHOLE, EdgeSearch, allocate_search, begin_step
from pgmp_petsc.dynamics.reduced_arrays import Strengths
from pgmp_petsc.effects.time_function import evaluate
from pgmp_petsc.runtime.compiled import njit
from pgmp_petsc.runtime.lane_items import empty_lanes
from pgmp_petsc.runtime.vectors import LANES, blend, first_lane, load, spread, store


class Clocks(NamedTuple):
    """What the lanes of a block do next, and what is kept of the beginning of their steps.

    Attributes
    ----------
    pace
        Length of the step or of a part of it (s), and the derivatives of velocities and accelerations with positions
        that belong to it, vectors (3, LANES).
    strengths
        What acts at its end.
    search
        Of the edges of laws.
    kept
        State at the beginning of a step in which edges are searched, as `reduced_steps.advance` takes it.
    rows
        Of the trail, the next one to be filled, (LANES,).
    """

    pace: np.ndarray
    strengths: Strengths
    search: EdgeSearch
    kept: tuple[np.ndarray, ...]
    rows: np.ndarray


STEP, GAIN_V, GAIN_A = range(3)  # rows of a pace


@njit(error_model="numpy", forceinline=True)
def allocate_clocks(n, strengths, n_events):
    """Return those of a block of n coordinates, as long as they show nothing."""
    return Clocks(
        empty_lanes(GAIN_A + 1, LANES),
        Strengths(
            empty_lanes(strengths.loads.shape[1], LANES),
            empty_lanes(strengths.actions.shape[1], LANES),
            empty_lanes(strengths.motions.shape[1], LANES),
        ),
        allocate_search(n_events),
        allocate_state(n),
        np.empty(LANES, dtype=np.int64),
    )


@njit(error_model="numpy", forceinline=True)
def allocate_state(n):
    """Return vectors for a state as `reduced_steps.advance` takes it."""
    return (
        empty_lanes(n, LANES), empty_lanes(n, LANES), empty_lanes(n, LANES), empty_lanes(n, LANES),
        empty_lanes(n, LANES), empty_lanes(1, LANES),
    )  # fmt: skip


@njit(inline="always")
def begin(scheme, steps, shown, clocks):
    """Let all lanes of a block begin with a whole step."""
    for lane in range(LANES):
        _go_at(scheme, steps[2], lane, clocks.pace)
        begin_step(clocks.search, lane, steps[2])
        clocks.rows[lane] = 0
        while clocks.rows[lane] < shown.size and shown[clocks.rows[lane]] <= steps[0]:
            clocks.rows[lane] += 1


@njit(inline="always")
def _go_at(scheme, step, lane, pace):
    """Put the length of a lane's step, and the gains that belong to it."""
    alpha_m, alpha_f, beta, gamma = scheme
    pace[STEP, lane], pace[GAIN_V, lane] = step, gamma / (beta * step)
    pace[GAIN_A, lane] = (1.0 - alpha_m) / ((1.0 - alpha_f) * beta * (step * step))


@njit(error_model="numpy", forceinline=True, counted=False)
def set_out(strengths, functions, scheme, steps, lanes, n_steps, expected, clocks):
    """Find what acts on some lanes at the ends of their steps, or of parts of them, and what to expect of Newton.

    It is inlined: to hand its arguments on took as long as what it does in most steps.
    """
    first, ends, _ = steps
    search, now = clocks.search, clocks.strengths
    if search.depths.shape[0] == 0:  # all of them go in step
        number = n_steps[first_lane(lanes)]
        if (first + number + 1) % PROBED_EVERY == 0:
            store(expected, 0, blend(lanes, spread(FIRST_CONTRACTION), load(expected, 0)))
        _put_in_all(strengths.loads, number, now.loads)
        _put_in_all(strengths.actions, number, now.actions)
        _put_in_all(strengths.motions, number, now.motions)
        return
    for lane in range(LANES):
        if not lanes & (1 << lane):
            continue
        number, stage, duration = n_steps[lane], search.stage[lane], search.duration[lane]
        if duration != clocks.pace[STEP, lane]:
            _go_at(scheme, duration, lane, clocks.pace)
        if stage != WHOLE or (first + number + 1) % PROBED_EVERY == 0:
            expected[0, lane] = FIRST_CONTRACTION
        if stage == WHOLE or stage == REST:
            for k in range(now.loads.shape[0]):
                now.loads[k, lane] = strengths.loads[number, k]
            for k in range(now.actions.shape[0]):
                now.actions[k, lane] = strengths.actions[number, k]
            for k in range(now.motions.shape[0]):
                now.motions[k, lane] = strengths.motions[number, k]
        else:
            _find_between(functions, ends[number] - search.left[lane] + duration, lane, now)


@njit(inline="always")
def _put_in_all(rows, number, now):
    """Put row `number` of several numbers into all lanes."""
    for k in range(now.shape[0]):
        store(now, k, spread(rows[number, k]))


@njit(error_model="numpy", counted=False)
def _find_between(functions, time, lane, now):
    """Find what acts on a lane at a time within a step."""
    for k in range(now.loads.shape[0]):
        now.loads[k, lane] = evaluate(functions.loads, k, time)[0]
    for k in range(now.actions.shape[0]):
        now.actions[k, lane] = evaluate(functions.actions, k, time)[0]
    for k in range(now.motions.shape[0] // 3):
        motion = evaluate(functions.motions, k, time)
        for derivative in range(3):
            now.motions[3 * k + derivative, lane] = motion[derivative]
