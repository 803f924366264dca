"""Steps of the reduced model by the generalised-alpha scheme, LANES samples at a time, compiled.

A block of LANES samples goes through many steps before the next one begins, so that its polynomials stay in the nearest
cache; every lane has a Newton iteration and a fate of its own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.dynamics.action_kernel import DEPTH, act, allocate_local
from pgmp_petsc.dynamics.alpha_step import (
    CAUTION,
    FIRST_CONTRACTION,
    LEAST_CONTRACTION,
    MAX_ITERATIONS,
    PROBED_EVERY,
    REFRESH_EVERY,
    ROUND_OFF,
    WORST_CONTRACTION,
)
from pgmp_petsc.dynamics.reduced_arrays import Strengths, acting_of, allocate, places_of
from pgmp_petsc.dynamics.reduced_kernel import correct_block, gather, scatter, size_of
from pgmp_petsc.dynamics.status import Outcome
from pgmp_petsc.runtime.lane_items import empty_lanes
from pgmp_petsc.runtime.vectors import (
    LANES,
    blend,
    count_lanes,
    exceeding,
    larger,
    load,
    spread,
    store,
)
from pgmp_petsc.runtime.compiled import njit

LOST, OUTSIDE, CROSSED = int(Outcome.LOST), int(Outcome.OUTSIDE), int(Outcome.CROSSED)
ALMOST_NONE = 1e-300
# In the units of `alpha_step`. One correction is then enough in nine of ten steps of the default scene; it leaves 3e-13
# in the median.
NEWTON_TOLERANCE = 1e-11


class Progress(NamedTuple):
    """How far samples went.

    Attributes
    ----------
    outcome
        An `Outcome` of every sample, (n_blocks, LANES).
    n_steps
        Steps that are behind it, (n_blocks, LANES).
    n_corrections
        Newton corrections, all samples together, shape (1,).
    beyond
        Whether the sample is beyond the edges of laws, (n_samples, n_events).
    shown, trail
        Numbers of the steps that somebody wants to see, increasing, and positions, velocities and accelerations after
        them, (n_t, 3, n_samples, n_eta).
    """

    outcome: np.ndarray
    n_steps: np.ndarray
    n_corrections: np.ndarray
    beyond: np.ndarray
    shown: np.ndarray
    trail: np.ndarray


@njit(cache=True, entry=True, error_model="numpy")
def advance(equations, memory, strengths, scheme, step, first, state, bounds, edges, lanes, progress):
    """Take some samples through several equal steps, each until it is done or something happens to it.

    Parameters
    ----------
    strengths
        At the ends of all steps, with an axis of steps in front.
    scheme
        ``(alpha_m, alpha_f, beta, gamma, gain_v, gain_a)``.
    step, first
        Length of a step, s; number of the first one in the run.
    state
        ``(q, v, a, auxiliary, before, contraction)``, each (n_samples, n_eta), with the auxiliary accelerations and the
        accelerations one step before, and the contraction to be expected (n_samples, 1); advanced in place. A sample to
        which something happens stays at the beginning of that step.
    bounds
        Range of each coordinate in which the tables hold, (n_theta, 2).
    edges
        Numbers of the actions whose law has an edge.
    lanes
        Sets of those to advance, shape (n_blocks,).
    progress
        Result.
    """
    n = equations.layout.n_eta
    work = allocate(equations.layout)
    local = allocate_local(equations.local, len(equations.grid), n)
    of_block = (
        empty_lanes(n, LANES), empty_lanes(n, LANES), empty_lanes(n, LANES), empty_lanes(n, LANES),
        empty_lanes(n, LANES), empty_lanes(1, LANES),
    )  # fmt: skip
    for block in range(lanes.size):
        if lanes[block] == 0:
            continue
        for part, vectors in zip(state, of_block):
            gather(part, memory.samples[block], vectors)
        _advance_block(
            equations, memory, block, strengths, scheme, step, first, bounds, edges, lanes[block], of_block, work,
            local, progress,
        )  # fmt: skip
        for part, vectors in zip(state, of_block):
            scatter(vectors, memory.samples[block], lanes[block], part)


@njit(error_model="numpy", counted=False)
def _advance_block(
    equations, memory, block, strengths, scheme, step, first, bounds, edges, lanes, state, work, local, progress
):  # fmt: skip
    """Take some lanes of a block through the steps; `state` are its vectors."""
    going, samples, outcome = lanes, memory.samples[block], progress.outcome[block]
    row = 0
    while row < progress.shown.size and progress.shown[row] <= first:
        row += 1
    for number in range(strengths.loads.shape[0]):
        if going == 0:
            break
        now = Strengths(strengths.loads[number], strengths.actions[number], strengths.motions[number])
        _predict(equations, scheme, step, state, now, work)
        if (first + number + 1) % PROBED_EVERY == 0:
            store(state[5], 0, FIRST_CONTRACTION)
        gains = (scheme[4], scheme[5])
        lost = _converge(equations, memory, block, now, gains, going, state[5], work, local, progress)
        going &= ~_note(lost, LOST, outcome)
        going &= ~_note(_outside(work, bounds) & going, OUTSIDE, outcome)
        if edges.size > 0 and going != 0:
            crossed = _crossed(equations, memory, block, now, edges, going, work, local, progress)
            going &= ~_note(crossed, CROSSED, outcome)
        _follow(scheme, state, going, equations.layout.n_eta, work)
        for lane in range(LANES):
            if going & (1 << lane):
                progress.n_steps[block, lane] = number + 1
        if row < progress.shown.size and progress.shown[row] == first + number + 1:
            for part in range(3):
                scatter(state[part], samples, lanes, progress.trail[row, part])
            row += 1


@njit(inline="always")
def _note(lanes, what, outcome):
    """Note what happened to some lanes, and return them."""
    for lane in range(LANES):
        if lanes & (1 << lane):
            outcome[lane] = what
    return lanes


@njit(inline="always")
def _predict(equations, scheme, step, state, strengths, work):
    """Predict the end of a step with the accelerations extrapolated linearly, prescribed coordinates where they are."""
    alpha_m, alpha_f, beta, gamma, _, _ = scheme
    q, v, a, auxiliary, before, _ = state
    weight = 1.0 / (1.0 - alpha_m)
    for i in range(equations.layout.n_eta):
        behind, speed, now = load(auxiliary, i), load(v, i), load(a, i)
        then = 2.0 * now - load(before, i)
        ahead = ((1.0 - alpha_f) * then + alpha_f * now - alpha_m * behind) * weight
        store(work.q, i, load(q, i) + step * speed + (step * step) * ((0.5 - beta) * behind + beta * ahead))
        store(work.rate, i, speed + step * ((1.0 - gamma) * behind + gamma * ahead))
        store(work.a, i, then)
    for k in range(len(equations.layout.rigid)):
        if equations.prescribed[k]:
            store(work.q, k, spread(strengths.motions[k, 0]))
            store(work.rate, k, spread(strengths.motions[k, 1]))
            store(work.a, k, spread(strengths.motions[k, 2]))


@njit(inline="always")
def _converge(equations, memory, block, strengths, gains, lanes, expected, work, local, progress):
    """Run Newton's iteration of some lanes, each to its own convergence; return those that are lost.

    What remains after a correction is estimated from the contraction between the last two, and after the first one
    from that `expected`, a vector (1, LANES); see `alpha_step.judge`.
    """
    gain_v, gain_a = gains
    n = equations.layout.n_eta
    last, active, lost = spread(np.inf), lanes, 0
    for iteration in range(MAX_ITERATIONS):
        fresh = iteration % REFRESH_EVERY == 0
        if memory.acting.balance.size > 0:
            act(
                equations.local, equations.grid, strengths.actions, work.q, work.rate, memory.samples[block],
                active, gain_v, fresh, local, places_of(memory, block),
            acting_of(memory, block), memory.known,
            )  # fmt: skip
        # the inertia forces see other accelerations where damping is proportional to the mass
        for i in range(n):
            store(work.kept_a, i, load(work.a, i))
        correct_block(equations, memory, block, strengths.loads, gains, fresh, work)
        for i in range(n):
            change = blend(active, load(work.balance, i), spread(0.0))
            store(work.q, i, load(work.q, i) - change)
            store(work.rate, i, load(work.rate, i) - gain_v * change)
            store(work.a, i, load(work.kept_a, i) - gain_a * change)
        size = size_of(equations, work.balance)
        progress.n_corrections[0] += count_lanes(active)
        contraction = load(expected, 0)
        if iteration > 0:
            contraction = _bounded(size / larger(last, spread(ALMOST_NONE)))
        if iteration == 1:
            known = larger(_bounded(CAUTION * contraction), spread(LEAST_CONTRACTION))
            store(expected, 0, blend(active, known, load(expected, 0)))
        remaining = size * contraction / (1.0 - contraction)
        broken = active & exceeding(size * 0.0, spread(0.0))  # infinity times zero is no number either
        lost |= broken
        active &= ~broken & exceeding(remaining, spread(NEWTON_TOLERANCE)) & exceeding(size, spread(ROUND_OFF))
        last = size
        if active == 0:
            break
    return lost | active


@njit(inline="always")
def _bounded(contraction):
    """Return contractions, none of them larger than the worst that is reckoned with."""
    return blend(exceeding(contraction, spread(WORST_CONTRACTION)), spread(WORST_CONTRACTION), contraction)


@njit(inline="always")
def _outside(work, bounds):
    """Return the lanes that left the range of the tables."""
    lanes = 0
    for k in range(bounds.shape[0]):
        theta = load(work.q, k)
        lanes |= exceeding(theta, spread(bounds[k, 1])) | exceeding(spread(bounds[k, 0]), theta)
    return lanes


@njit(inline="always")
def _crossed(equations, memory, block, strengths, edges, lanes, work, local, progress):
    """Return the lanes that crossed an edge of a law in this step."""
    act(
        equations.local, equations.grid, strengths.actions, work.q, work.rate, memory.samples[block], lanes,
        0.0, np.bool_(False), local, places_of(memory, block),
            acting_of(memory, block), memory.known,
    )  # fmt: skip
    crossed = 0
    for lane in range(LANES):
        if lanes & (1 << lane):
            sample = memory.samples[block, lane]
            for event in range(edges.size):
                if (memory.known[sample, DEPTH, edges[event]] > 0.0) != progress.beyond[sample, event]:
                    crossed |= 1 << lane
    return crossed


@njit(inline="always")
def _follow(scheme, state, lanes, n, work):
    """Let some lanes go to the end of the step, with the auxiliary accelerations there."""
    alpha_m, alpha_f = scheme[0], scheme[1]
    q, v, a, auxiliary, before, _ = state
    weight = 1.0 / (1.0 - alpha_m)
    for i in range(n):
        now, then, behind = load(a, i), load(work.a, i), load(auxiliary, i)
        ahead = ((1.0 - alpha_f) * then + alpha_f * now - alpha_m * behind) * weight
        store(q, i, blend(lanes, load(work.q, i), load(q, i)))
        store(v, i, blend(lanes, load(work.rate, i), load(v, i)))
        store(a, i, blend(lanes, then, now))
        store(auxiliary, i, blend(lanes, ahead, behind))
        store(before, i, blend(lanes, now, load(before, i)))
