"""Steps of the reduced model by the generalised-alpha scheme, LANES samples at a time, compiled.

A block of LANES samples goes through many steps before the next one begins, so that its polynomials stay in the nearest
cache; every lane has a clock, a Newton iteration and a fate of its own. A lane that crosses the edge of a law within a
step takes it in parts, up to the edge and on (`edge_search`).

`Clocks` say where the lanes of a block are in their steps, how long their next one is and what acts at its end. Lanes
go from step to step by themselves: one that searches the edge of a law takes parts of a step while others go on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.controllers.running import begin_carried, follow_states, keep_carried, take_carried
from pgmp_petsc.effects.law import any_bend
from pgmp_petsc.effects.time_function import evaluate
from pgmp_petsc.full.part_reference import loaded
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import aligned
from pgmp_petsc.lanes.vectors import (
    CACHE_LINE,
    EVERY_LANE,
    LANES,
    beyond,
    count_lanes,
    expect,
    first_lane,
    load,
    select,
    spread,
    store,
)
from pgmp_petsc.reduced.action_kernel import act, bent_lanes, forget_rates, limited_lanes
from pgmp_petsc.reduced.arrays import Strengths, acting_of, places_of
from pgmp_petsc.reduced.carried import find_carried
from pgmp_petsc.reduced.control import act_of_states, begin_steps, jump_lanes, sample_states, show_forces
from pgmp_petsc.reduced.kernel import copy_lane, correct_block, follow_correction, gather, scatter
from pgmp_petsc.stepping.alpha_step import (
    FIRST_CONTRACTION,
    MAX_ITERATIONS,
    PROBED_EVERY,
    REFRESH_EVERY,
    ROUND_OFF,
    contraction_of,
    expected_after,
    goes_on,
)
from pgmp_petsc.stepping.alpha_step import NEWTON_TOLERANCE as TOLERANCE_OF_TRIALS
from pgmp_petsc.stepping.edge_search import REST, WHOLE, EdgeSearch, begin_step, give_up, in_search, look_at_all
from pgmp_petsc.stepping.status import Outcome


class Clocks(NamedTuple):
    """Next steps of the lanes of a block, and values kept of the beginning of their steps."""

    #: length of the step or of a part of it (s), and the derivatives of velocities and accelerations with positions
    #: that belong to it, vectors (3, LANES)
    pace: np.ndarray
    strengths: Strengths  # what acts at its end
    search: EdgeSearch  # of the edges of laws
    #: state, kept: state of the block as `advance` takes it, and at the beginning of a step in which edges are searched
    state: tuple[np.ndarray, ...]
    kept: tuple[np.ndarray, ...]
    rows: np.ndarray  # of the trail, the next one to be filled, (LANES,)

    @classmethod
    def of(cls, n: int, n_beside: int, strengths: Strengths, n_events: int) -> Clocks:
        """Return those of a block of n coordinates and numbers beside; they show nothing yet."""
        sizes = n, n, n, n, n, 1, n_beside
        return cls(
            aligned((GAIN_A + 1, LANES)),
            Strengths(*(aligned((part.shape[1], LANES)) for part in strengths)),
            EdgeSearch.of(n_events),
            tuple(aligned((size, LANES)) for size in sizes),
            tuple(aligned((size, LANES)) for size in sizes),
            np.empty(LANES, dtype=np.int64),
        )


STEP, GAIN_V, GAIN_A = range(3)  # rows of a pace


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
            store(expected, 0, select(lanes, spread(FIRST_CONTRACTION), load(expected, 0)))
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


LOST, OUTSIDE, CROSSED = int(Outcome.LOST), int(Outcome.OUTSIDE), int(Outcome.CROSSED)
# In the units of `alpha_step`. One correction is then enough in nine of ten steps of the default scene; it leaves 3e-13
# in the median.
NEWTON_TOLERANCE = 1e-11
# Times what a second correction is estimated to leave: it has the factors of the first, those of the prediction, and
# the next one contracts worse. Of 25 models it left 1 to 20 times that in the median, up to this in 99 of 100 steps.
OF_OLD_FACTORS = 100.0


class Progress(NamedTuple):
    """How far samples went."""

    outcome: np.ndarray  # an `Outcome` of every sample, (n_blocks, LANES)
    n_steps: np.ndarray  # steps that are behind it, (n_blocks, LANES)
    n_corrections: np.ndarray  # Newton corrections, all samples together, shape (1,)
    beyond: np.ndarray  # whether the sample is beyond the edges of laws, (n_samples, n_events); brought up to date
    #: shown, trail: numbers of the steps that somebody wants to see, increasing, and positions, velocities and
    #: accelerations after them, (n_t, 3, n_samples, n_eta)
    shown: np.ndarray
    trail: np.ndarray
    precise: bool  # whether steps are corrected once more, in runs that derivatives are of


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def advance(
    equations, memory, room, clocks, strengths, functions, scheme, steps, state, bounds, lanes, progress, control
):  # fmt: skip
    """Take some samples through several equal steps, each until it is done or something happens to it.

    A lane goes from step to step by itself: where one searches the edge of a law within a step, others go on. Strengths
    are those at the ends of all steps; `functions` give them at any time, `TimeFunctions` of each effect with loads,
    action and coordinate, which edges of laws alone ask for. The scheme is ``(alpha_m, alpha_f, beta, gamma)``, `steps`
    the number of the first step in the run, ends of all, (n_t,), and length of each, s. The state ``(q, v, a,
    auxiliary, before, contraction, beside)``, each (n_samples, n_eta), has the auxiliary accelerations and those one
    step before, the contraction to be expected, (n_samples, 1), and numbers beside, (n_samples, n_beside). It is
    advanced in place; a sample to which something happens stays at the beginning of that step. Tables hold in the range
    `bounds` of each coordinate, (n_theta, 2). `lanes` are sets of those to advance, (n_blocks,), `progress` is a
    result, and `control` a reference to `control.Control`.
    """
    for block in range(lanes.size):
        if lanes[block] == 0:
            continue
        for part, vectors in zip(state, clocks.state):
            gather(part, memory.samples[block], vectors)
        _advance_block(
            equations, memory, room, clocks, block, strengths, functions, scheme, steps, bounds, lanes[block], progress,
            control,
        )  # fmt: skip
        for part, vectors in zip(state, clocks.state):
            scatter(vectors, memory.samples[block], lanes[block], part)


@njit(cache=True, apart=True, error_model="numpy", fastmath={"contract"}, counted=False)
def _advance_block(
    equations, memory, room, clocks, block, strengths, functions, scheme, steps, bounds, lanes, progress, control
):  # fmt: skip
    """Take some lanes of a block through the steps."""
    work, local = room.work, room.local
    state, going, outcome, n_steps = clocks.state, lanes, progress.outcome[block], progress.n_steps[block]
    samples, n, search = memory.samples[block], equations.layout.n_eta, clocks.search
    begin(scheme, steps, progress.shown, clocks)
    while going != 0:
        set_out(strengths, functions, scheme, steps, going, n_steps, state[5], clocks)
        _expect(samples, steps, clocks.rows, n_steps, going, progress)
        if state[6].shape[0] > 0:
            begin_steps(
                control, search, scheme, steps, n_steps, clocks.pace, state[6], samples, going,
                equations.local.actions.parameters,
            )  # fmt: skip
        searching, lost = in_search(search), going
        for attempt in range(2):
            if attempt == 0:
                _predict(equations, scheme, state, clocks, work)
            else:
                _predict_anew(equations, scheme, state, clocks, lost, work)
            careful = searching if attempt == 0 else lost
            lost = _converge(equations, memory, room, block, clocks, lost, careful, attempt, state, progress, control)
            if lost == 0:
                break
            store(state[5], 0, select(lost, spread(FIRST_CONTRACTION), load(state[5], 0)))
        going &= ~_note(lost & ~searching, LOST, outcome)
        done, onward, hopeless = going & ~lost, 0, lost & searching
        if memory.depths.shape[1] > 0 and done != 0:
            act(
                equations.local, equations.local.with_edges, equations.grid, clocks.strengths.actions, work.q,
                work.rate, samples, done, spread(0.0), np.bool_(False), np.bool_(False), local,
                places_of(memory, block), acting_of(memory, block), memory.known, memory.depths,
            )  # fmt: skip
            begun, onward, done, failed = look_at_all(search, done, steps[2], memory.depths, samples, progress.beyond)
            hopeless |= failed
            _keep(state, begun, clocks.kept)
            _stand(state, begun, n)
        beyond_bounds = _outside(work, bounds) & done
        done &= ~beyond_bounds
        if state[6].shape[0] > 0 and done | onward != 0:
            act_of_states(
                control, equations.local, equations.grid, clocks.strengths.actions, work.q, work.rate, samples,
                done | onward, local, places_of(memory, block), acting_of(memory, block), memory.known, memory.depths,
            )  # fmt: skip
            follow_states(control.states, loaded(control.states.law), scheme, state[6], done | onward)
            if equations.carried.actions.size > 0:
                find_carried(
                    equations, memory, room, block, places_of(memory, block), clocks.strengths, samples, done | onward
                )  # fmt: skip
                keep_carried(room.carried, state[6], done | onward)
        _follow(scheme, state, done | onward, n, work)
        if searching != 0:
            _stand(state, onward, n)
            ended = done & searching
            for i in range(n):
                store(state[4], i, select(ended, load(clocks.kept[2], i), load(state[4], i)))
            store(state[5], 0, select(ended, spread(FIRST_CONTRACTION), load(state[5], 0)))
            back = searching & (hopeless | beyond_bounds)
            _keep(clocks.kept, back, state)
            give_up(search, back, samples, progress.beyond)
        going &= ~(_note(hopeless, CROSSED, outcome) | _note(beyond_bounds, OUTSIDE, outcome))
        jumping = 0
        if state[6].shape[0] > 0 and done != 0:
            jumping = sample_states(
                control, equations.local, equations.grid, clocks.strengths.actions, work.q, work.rate, samples, done,
                n_steps, state[6], local, places_of(memory, block), acting_of(memory, block), memory.known,
                memory.depths,
            )  # fmt: skip
        going &= ~_arrive(state, done, samples, steps, clocks.rows, n_steps, progress, control)
        if jumping != 0:
            jump_lanes(equations, memory, room, block, clocks.strengths, steps[2], state, jumping)


@njit(inline="always")
def _expect(samples, steps, rows, n_steps, lanes, progress):
    """Bring close where some lanes are shown after their step: the trail is too long for the cache nearby."""
    shown, trail = progress.shown, progress.trail
    n_samples, n = trail.shape[2], trail.shape[3]
    for lane in range(LANES):
        row = rows[lane]
        if lanes & (1 << lane) and row < shown.size and shown[row] == steps[0] + n_steps[lane] + 1:
            for part in range(3):
                first = ((3 * row + part) * n_samples + samples[lane]) * n
                for i in range(0, n, CACHE_LINE // 8):
                    expect(trail, first + i)


@njit(inline="always")
def _arrive(state, lanes, samples, steps, rows, n_steps, progress, control):
    """Count a step of some lanes and show where they are; return those that were through all steps."""
    for lane in range(LANES):
        n_steps[lane] += (lanes >> lane) & 1
    if progress.shown.size > 0:
        for lane in range(LANES):
            row = rows[lane]
            if lanes & (1 << lane) and row < progress.shown.size and progress.shown[row] == steps[0] + n_steps[lane]:
                for part in range(3):
                    copy_lane(state[part], lane, progress.trail[row, part, samples[lane]])
                if state[6].shape[0] > 0:
                    show_forces(control, row, samples[lane], lane, state[6])
                rows[lane] = row + 1
    through = 0
    for lane in range(LANES):
        through |= np.int64(n_steps[lane] == steps[1].size) << lane
    return through & lanes


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _keep(state, lanes, kept):
    """Copy the state of some lanes."""
    if lanes != 0:
        for part, into in zip(state, kept):
            for i in range(part.shape[0]):
                store(into, i, select(lanes, load(part, i), load(into, i)))


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _stand(state, lanes, n):
    """Let the next step of some lanes begin with constant accelerations."""
    for i in range(n):
        store(state[4], i, select(lanes, load(state[2], i), load(state[4], i)))


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _note(lanes, what, outcome):
    """Note what happened to some lanes, and return them."""
    if lanes != 0:
        for lane in range(LANES):
            if lanes & (1 << lane):
                outcome[lane] = what
    return lanes


@njit(inline="always")
def _predict(equations, scheme, state, clocks, work):
    """Predict the end of a step, with accelerations that are extrapolated linearly, prescribed coordinates where they
    are.

    Lanes at rest predict too: a store of some lanes is read again only when it has reached the cache.
    """
    step, weight = load(clocks.pace, STEP), 1.0 / (1.0 - scheme[0])
    for i in range(equations.layout.n_eta):
        then = 2.0 * load(state[2], i) - load(state[4], i)
        place, rate = _end_of_step(scheme, weight, step, state, i, then)
        store(work.q, i, place)
        store(work.rate, i, rate)
        store(work.acceleration, i, then)
    _prescribe(equations, clocks, EVERY_LANE, work)


@njit(inline="always")
def _predict_anew(equations, scheme, state, clocks, lanes, work):
    """Predict the end of a step in some lanes with accelerations that keep the velocity, as in `alpha_step`."""
    alpha_m, alpha_f, beta, _ = scheme
    step, weight = load(clocks.pace, STEP), 1.0 / (1.0 - alpha_m)
    for i in range(equations.layout.n_eta):
        behind = load(state[3], i)
        kept = (1.0 - alpha_m) * (-(0.5 - beta) / beta * behind) + alpha_m * behind - alpha_f * load(state[2], i)
        then = kept / (1.0 - alpha_f)
        place, rate = _end_of_step(scheme, weight, step, state, i, then)
        store(work.q, i, select(lanes, place, load(work.q, i)))
        store(work.rate, i, select(lanes, rate, load(work.rate, i)))
        store(work.acceleration, i, select(lanes, then, load(work.acceleration, i)))
    _prescribe(equations, clocks, lanes, work)


@njit(inline="always")
def _end_of_step(scheme, weight, step, state, i, then):
    """Return position and velocity of a coordinate that has the acceleration `then` at the end of a step."""
    alpha_m, alpha_f, beta, gamma = scheme
    speed, now, behind = load(state[1], i), load(state[2], i), load(state[3], i)
    end = ((1.0 - alpha_f) * then + alpha_f * now - alpha_m * behind) * weight
    place = load(state[0], i) + step * speed + (step * step) * ((0.5 - beta) * behind + beta * end)
    return place, speed + step * ((1.0 - gamma) * behind + gamma * end)


@njit(inline="always")
def _prescribe(equations, clocks, lanes, work):
    """Put the prescribed coordinates of some lanes where they are at the end of a step."""
    motions = clocks.strengths.motions
    for k in range(len(equations.layout.rigid)):
        if equations.prescribed[k]:
            store(work.q, k, select(lanes, load(motions, 3 * k), load(work.q, k)))
            store(work.rate, k, select(lanes, load(motions, 3 * k + 1), load(work.rate, k)))
            store(work.acceleration, k, select(lanes, load(motions, 3 * k + 2), load(work.acceleration, k)))


@njit(inline="always")
def _converge(equations, memory, room, block, clocks, lanes, careful, attempt, state, progress, control):
    """Run Newton's iteration of some lanes, each to its own convergence; return those that are lost.

    At the second attempt every correction has factors of its own. The tolerance of `careful` lanes is that of trials,
    and that of `precise` runs, whose lanes are then corrected once more if more than round-off is left: of
    accelerations it is larger by the gain of a step, and derivatives of deformations of micrometres saw it. What
    remains after a correction is estimated from the contraction between the last two, and after the first one from that
    expected, in `state`; see `alpha_step.judge`, and `OF_OLD_FACTORS` of the second one.
    """
    gain_v, gain_a, strengths = load(clocks.pace, GAIN_V), load(clocks.pace, GAIN_A), clocks.strengths
    expected, work, local = state[5], room.work, room.local
    last, active, lost = spread(np.inf), lanes, 0
    strict = EVERY_LANE if progress.precise else careful
    tolerance = select(strict, spread(TOLERANCE_OF_TRIALS), spread(NEWTON_TOLERANCE))
    forget_rates(memory.known, memory.samples[block], lanes)
    # it goes on until forces that joints carry are settled; with those as they are found a sample is not lost
    rubbing, parameters = equations.carried.actions, equations.local.actions.parameters
    carries, going = rubbing.size > 0, lanes
    if carries:
        begin_carried(rubbing, room.carried, parameters, state[6], memory.samples[block], lanes)
    first, bending = load(expected, 0), any_bend(equations.local.actions.laws)
    for iteration in range(MAX_ITERATIONS):
        fresh, unsettled = attempt > 0 or iteration % REFRESH_EVERY == 0, 0
        if state[6].shape[0] > 0:
            act_of_states(
                control, equations.local, equations.grid, strengths.actions, work.q, work.rate, memory.samples[block],
                going, local, places_of(memory, block), acting_of(memory, block), memory.known, memory.depths,
            )  # fmt: skip
        if carries:
            find_carried(
                equations, memory, room, block, places_of(memory, block), strengths, memory.samples[block], going
            )  # fmt: skip
            unsettled = take_carried(rubbing, room.carried, parameters, iteration, memory.samples[block], going)
        if memory.acting.balance.size > 0:
            act(
                equations.local, equations.local.all, equations.grid, strengths.actions, work.q, work.rate,
                memory.samples[block], going, gain_v, fresh, fresh, local, places_of(memory, block),
                acting_of(memory, block), memory.known, memory.depths,
            )  # fmt: skip
            # nothing follows from the size of the last correction
            limited = limited_lanes(memory.known, memory.samples[block], going)
            last = select(limited, spread(0.0), last)
        correct_block(equations, memory, room, block, strengths.loads, (gain_v, gain_a), fresh)
        size = follow_correction(equations, (gain_v, gain_a), going, work)
        progress.n_corrections[0] += count_lanes(going)
        if bending and iteration == 0:
            bent = bent_lanes(
                equations.local, strengths.actions, work.rate, gain_v, memory.samples[block], going, local,
                memory.depths,
            )  # fmt: skip
            first = select(bent, spread(FIRST_CONTRACTION), first)
        contraction = contraction_of(iteration, size, last, first)
        if iteration == 1:
            store(expected, 0, select(active, expected_after(contraction), load(expected, 0)))
        broken = active & beyond(size * 0.0, spread(0.0))  # infinity times zero is no number either
        lost |= broken & active
        allowed = tolerance / OF_OLD_FACTORS if iteration == 1 else tolerance
        onward = active & ~broken & goes_on(size, contraction, allowed)
        once_more = goes_on(size, contraction, spread(ROUND_OFF)) if progress.precise else 0
        once_more &= active & ~broken & ~onward
        active, last = onward, size
        unsettled &= beyond(size, spread(ROUND_OFF))
        going = (going & (active | unsettled) if carries else active) | once_more
        if going == 0:
            break
    return lost | active


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _outside(work, bounds):
    """Return the lanes that left the range of the tables."""
    lanes = 0
    for k in range(bounds.shape[0]):
        theta = load(work.q, k)
        lanes |= beyond(theta, spread(bounds[k, 1])) | beyond(spread(bounds[k, 0]), theta)
    return lanes


@njit(inline="always")
def _follow(scheme, state, lanes, n, work):
    """Let some lanes go to the end of the step, with the auxiliary accelerations there."""
    alpha_m, alpha_f = scheme[0], scheme[1]
    q, v, a, auxiliary, before, _, _ = state
    weight = 1.0 / (1.0 - alpha_m)
    if lanes == EVERY_LANE:  # what is stored as a whole is at hand in the next step; see `_predict`
        for i in range(n):
            now, then = load(a, i), load(work.acceleration, i)
            end = ((1.0 - alpha_f) * then + alpha_f * now - alpha_m * load(auxiliary, i)) * weight
            store(q, i, load(work.q, i))
            store(v, i, load(work.rate, i))
            store(a, i, then)
            store(auxiliary, i, end)
            store(before, i, now)
        return
    for i in range(n):
        now, then, behind = load(a, i), load(work.acceleration, i), load(auxiliary, i)
        end = ((1.0 - alpha_f) * then + alpha_f * now - alpha_m * behind) * weight
        store(q, i, select(lanes, load(work.q, i), load(q, i)))
        store(v, i, select(lanes, load(work.rate, i), load(v, i)))
        store(a, i, select(lanes, then, now))
        store(auxiliary, i, select(lanes, end, behind))
        store(before, i, select(lanes, now, load(before, i)))
