"""Newton corrections and steps of the reduced model, LANES samples at a time, compiled.

The equations are those of `reduced_lagrangian`. Their tables are interpolated at the sample's own theta and weighted
with its own parameters. A block of LANES samples goes through many steps before the next one begins, so that its
polynomials stay in the nearest cache; every lane has a Newton iteration and a fate of its own.

A prescribed coordinate has its position, velocity and acceleration given; its correction is zero. The residual of its
row is the driving force.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.dynamics.action_kernel import DEPTH, Acting, LocalEffects, act, add_tangents, allocate_local
from pgmp_petsc.dynamics.alpha_step import (
    FIRST_CONTRACTION,
    MAX_ITERATIONS,
    NEWTON_TOLERANCE,
    REFRESH_EVERY,
    ROUND_OFF,
)
from pgmp_petsc.dynamics.bordered import eliminate, solve
from pgmp_petsc.dynamics.cells import N_COEFFICIENTS, Grid, gather_cells, locate_all, refill
from pgmp_petsc.dynamics.reduced_lagrangian import Layout, Matrix, Work, evaluate, layout_n_rigid
from pgmp_petsc.dynamics.status import Outcome
from pgmp_petsc.dynamics.vectors import (
    LANES,
    absolute,
    add_product,
    blend,
    count_lanes,
    differing,
    equal,
    exceeding,
    first_lane,
    larger,
    load,
    load_rows,
    polynomial,
    spread,
    store,
)
from pgmp_petsc.runtime.compiled import njit

LOST, OUTSIDE, CROSSED = int(Outcome.LOST), int(Outcome.OUTSIDE), int(Outcome.CROSSED)
ALMOST_NONE = 1e-300
WORST_CONTRACTION = 0.999


class Tables(NamedTuple):
    """Polynomials of the rigid inertia, of all other terms and of the loads, (n_cells, n_terms, 4**n_theta, n_entries).

    In radians from the lower end of a cell; those of the rigid inertia have cells of their own.
    """

    rigid: np.ndarray
    terms: np.ndarray
    loads: np.ndarray


class Weights(NamedTuple):
    """Of the terms and of the load terms, (n_blocks, n, LANES); and the number of the effect of each load term.

    `together` are as many zeros as there are terms: all of them add to one polynomial.
    """

    terms: np.ndarray
    loads: np.ndarray
    effects: np.ndarray
    together: np.ndarray


class Equations(NamedTuple):
    """What the equations of motion of a batch are made of.

    Attributes
    ----------
    layout
        Parts of a table row.
    fine, grid
        `Grid` of every coordinate, of the rigid inertia and of all other terms.
    tables, weights
        See `Tables`, `Weights`.
    local
        Local effects.
    mass_damping
        Factor alpha of the damping proportional to the mass, 1/s.
    prescribed
        Whether a coordinate's motion is given, shape (n_theta,).
    scale
        Displacement (in units of the mechanism's size or 1 rad) per unit of each coordinate, shape (n_eta,).
    """

    layout: Layout
    fine: tuple[Grid, ...]
    grid: tuple[Grid, ...]
    tables: Tables
    weights: Weights
    local: LocalEffects
    mass_damping: float
    prescribed: np.ndarray
    scale: np.ndarray


class Memory(NamedTuple):
    """What is kept of every block from one evaluation to the next.

    Attributes
    ----------
    cells
        Numbers of the cells that the samples are in, -1 before the first, vectors (n_blocks, LANES).
    terms, loads
        Polynomials there, (n_blocks, n_entries * 4**n_theta, LANES): of the terms, and of a unit of every effect's
        amplitude, effect after effect.
    matrix
        Iteration matrices, each array with an axis of blocks in front.
    acting
        What local effects add; see `action_kernel.Acting`.
    known
        See `action_kernel.act`.
    """

    cells: np.ndarray
    terms: np.ndarray
    loads: np.ndarray
    matrix: Matrix
    acting: Acting
    known: np.ndarray


class Strengths(NamedTuple):
    """What acts at one instant or, with an axis in front, at the ends of several steps.

    Attributes
    ----------
    loads, actions
        Amplitudes of the effects with loads (n_effects,) and of the actions (n_actions,).
    motions
        Position, velocity and acceleration of every coordinate, where they are given, shape (n_theta, 3).
    """

    loads: np.ndarray
    actions: np.ndarray
    motions: np.ndarray


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
    trail
        Positions, velocities and accelerations after every step, (n_steps, 3, n_samples, n_eta), or no steps where
        nobody wants them.
    """

    outcome: np.ndarray
    n_steps: np.ndarray
    n_corrections: np.ndarray
    beyond: np.ndarray
    trail: np.ndarray


@njit(error_model="numpy", forceinline=True)
def vectors_of(n):
    """Return n vectors that begin at a cache line, not set."""
    buffer = np.empty((n + 1) * LANES)
    first = (-buffer.ctypes.data % (8 * LANES)) // 8
    return buffer[first : first + n * LANES].reshape((n, LANES))


@njit(error_model="numpy", forceinline=True)
def allocate(layout):
    """Return work arrays of one block."""
    r, n = len(layout.rigid), layout.n_eta
    m = n - r
    return Work(
        vectors_of(n),
        vectors_of(n),
        vectors_of(n),
        vectors_of(n),
        vectors_of(n),
        vectors_of(layout_n_rigid(r)),
        vectors_of(r * layout_n_rigid(r)),
        vectors_of(layout.load_end),
        vectors_of(r * layout.load_end),
        vectors_of(r * n),
        vectors_of(r * m),
        vectors_of(m * (m + 1) // 2),
        vectors_of(max(r, m)),
        vectors_of(max(r, m)),
        vectors_of(n),
        vectors_of(r),
        vectors_of(r),
        vectors_of(1),
        vectors_of(layout_n_rigid(r) * N_COEFFICIENTS**r),
    )


@njit(inline="always")
def matrix_of(memory, block):
    """Return the iteration matrix of a block."""
    whole = memory.matrix
    return Matrix(whole.factor[block], whole.corner[block], whole.column[block], whole.row[block])


@njit(inline="always")
def acting_of(memory, block):
    """Return what local effects add to a block."""
    return Acting(memory.acting.balance[block], memory.acting.tangent[block])


@njit(error_model="numpy", forceinline=True)
def interpolate(equations, memory, block, amplitudes, work):
    """Bring the polynomials of a block to the cells of its samples, and evaluate rigid inertia and loads there."""
    layout, tables, weights = equations.layout, equations.tables, equations.weights
    loads, n_rigid = memory.loads[block], layout_n_rigid(len(equations.grid))
    cells = locate_all(work.q, equations.grid, work.place)
    moved = differing(cells, load(memory.cells, block))
    store(memory.cells, block, cells)
    while moved != 0:
        number = memory.cells[block, first_lane(moved)]
        together = moved & equal(cells, spread(number))
        moved &= ~together
        refill(
            tables.terms, int(number), weights.terms[block], weights.together, n_rigid, layout.end, together,
            memory.terms[block],
        )  # fmt: skip
        if amplitudes.size > 0:
            refill(tables.loads, int(number), weights.loads[block], weights.effects, 0, layout.load_end, together, loads)
    store(work.fine_cells, 0, locate_all(work.q, equations.fine, work.fine))
    gather_cells(tables.rigid, work.fine_cells, weights.terms[block], work.fine_kept)
    place = load_rows(work.fine, 0, 1, layout.rigid)
    for entry in range(n_rigid):
        value, slopes = polynomial(work.fine_kept, entry, place)
        store(work.rigid, entry, value)
        for k in range(len(place)):
            store(work.rigid_slope, k * n_rigid + entry, slopes[k])
    if amplitudes.size > 0:
        place = load_rows(work.place, 0, 1, layout.rigid)
        for entry in range(layout.load_end):
            value, slopes = polynomial(loads, entry, place)
            value, amplitude = value * amplitudes[0], spread(amplitudes[0])
            store(work.load, entry, value)
            for k in range(len(place)):
                store(work.load_slope, k * layout.load_end + entry, slopes[k] * amplitude)
        for effect in range(1, amplitudes.size):
            amplitude = spread(amplitudes[effect])
            for entry in range(layout.load_end):
                value, slopes = polynomial(loads, effect * layout.load_end + entry, place)
                store(work.load, entry, load(work.load, entry) + value * amplitude)
                total = load_rows(work.load_slope, entry, layout.load_end, place)
                total = add_product(total, slopes, amplitude)
                for k in range(len(place)):
                    store(work.load_slope, k * layout.load_end + entry, total[k])


@njit(error_model="numpy", forceinline=True)
def evaluate_block(equations, memory, block, amplitudes, gains, fresh, work):
    """Evaluate residual and, if `fresh`, iteration matrix of a block, at ``work.q``, ``work.rate`` and ``work.a``.

    ``work.a`` becomes the accelerations as the inertia forces see them.
    """
    layout = equations.layout
    r, n = len(layout.rigid), layout.n_eta
    gain_v, gain_a = gains
    interpolate(equations, memory, block, amplitudes, work)
    for i in range(n):
        rate = load(work.rate, i)
        store(work.v, i, rate if layout.quadratic else spread(0.0))
        store(work.a, i, load(work.a, i) + rate * equations.mass_damping)
    place = load_rows(work.place, 0, 1, layout.rigid)
    matrix = matrix_of(memory, block)
    evaluate(
        layout, memory.terms[block], place, gain_v, spread(gain_a + equations.mass_damping * gain_v), fresh,
        amplitudes.size > 0, work, matrix,
    )  # fmt: skip
    if memory.acting.balance.size > 0:
        acting = acting_of(memory, block)
        for i in range(n):
            store(work.balance, i, load(work.balance, i) + load(acting.balance, i))
        if fresh:
            add_tangents(acting.tangent, r, matrix)


@njit(error_model="numpy", forceinline=True)
def correct_block(equations, memory, block, amplitudes, gains, fresh, work):
    """Replace ``work.balance`` of a block by its Newton correction; see `evaluate_block`."""
    layout = equations.layout
    r, n = len(layout.rigid), layout.n_eta
    evaluate_block(equations, memory, block, amplitudes, gains, fresh, work)
    matrix = matrix_of(memory, block)
    for k in range(r):
        if equations.prescribed[k]:
            store(work.balance, k, spread(0.0))
    if fresh:
        _hold_prescribed(equations, matrix)
        eliminate(matrix, r, n - r)
    solve(matrix, r, n - r, work.balance, work.along)


@njit(error_model="numpy", forceinline=True)
def _hold_prescribed(equations, matrix):
    """Make the rows of prescribed coordinates those of the identity: they are not corrected."""
    r = len(equations.layout.rigid)
    m = equations.layout.n_eta - r
    for k in range(r):
        if equations.prescribed[k]:
            for j in range(r):
                store(matrix.corner, k * r + j, spread(1.0 if j == k else 0.0))
            for i in range(m):
                store(matrix.row, k * m + i, spread(0.0))


@njit(inline="always")
def size_of(equations, correction):
    """Return the largest displacement that a correction makes, a vector; NaN where any part of it is."""
    size = spread(0.0)
    for i in range(equations.layout.n_eta):
        size = larger(absolute(load(correction, i)) * equations.scale[i], size)
    return size


@njit(inline="always")
def gather(rows, block, vectors):
    """Copy rows (n_samples, n) of a block's samples to vectors (n, LANES), the last one again where none is left."""
    for lane in range(LANES):
        sample = min(block * LANES + lane, rows.shape[0] - 1)
        for i in range(rows.shape[1]):
            vectors[i, lane] = rows[sample, i]


@njit(inline="always")
def scatter(vectors, block, lanes, rows):
    """Copy some lanes of vectors (n, LANES) to the rows (n_samples, n) of their samples."""
    for lane in range(LANES):
        if lanes & (1 << lane):
            for i in range(rows.shape[1]):
                rows[block * LANES + lane, i] = vectors[i, lane]


@njit(inline="always")
def take_up(state, block, work):
    """Copy the state ``(q, v, a)`` of a block to where it is evaluated."""
    gather(state[0], block, work.q)
    gather(state[1], block, work.rate)
    gather(state[2], block, work.a)


@njit(cache=True, error_model="numpy")
def correct(equations, memory, strengths, state, gains, active, fresh, size):
    """Do one Newton correction of some samples in place.

    Parameters
    ----------
    strengths
        At the end of the step; motions are not used.
    state
        ``(q, v, a)``, each (n_samples, n_eta).
    gains
        ``(gain_v, gain_a)``.
    active
        Sets of lanes, shape (n_blocks,).
    fresh
        Whether to factorise anew; otherwise the factors of the last call serve.
    size
        Result: size of the correction, 0 where there is none, (n_blocks, LANES).
    """
    gain_v, gain_a = gains
    work = allocate(equations.layout)
    for block in range(active.size):
        store(size, block, spread(0.0))
        if active[block] == 0:
            continue
        take_up(state, block, work)
        for i in range(equations.layout.n_eta):
            store(work.kept_a, i, load(work.a, i))
        correct_block(equations, memory, block, strengths.loads, gains, fresh, work)
        for i in range(equations.layout.n_eta):
            step = load(work.balance, i)
            store(work.q, i, load(work.q, i) - step)
            store(work.rate, i, load(work.rate, i) - gain_v * step)
            store(work.a, i, load(work.kept_a, i) - gain_a * step)
        scatter(work.q, block, active[block], state[0])
        scatter(work.rate, block, active[block], state[1])
        scatter(work.a, block, active[block], state[2])
        store(size, block, blend(active[block], size_of(equations, work.balance), spread(0.0)))


@njit(cache=True, error_model="numpy")
def act_on(equations, memory, strengths, state, active, gain_v, with_tangent):
    """Evaluate the local effects on some samples; parameters as of `correct`."""
    work = allocate(equations.layout)
    local = allocate_local(equations.local, len(equations.grid), equations.layout.n_eta)
    for block in range(active.size):
        take_up(state, block, work)
        act(
            equations.local, (equations.fine, equations.grid), strengths.actions, work.q, work.rate, block * LANES,
            active[block], gain_v, with_tangent, local, acting_of(memory, block), memory.known,
        )  # fmt: skip


@njit(cache=True, error_model="numpy")
def evaluate_residual(equations, memory, strengths, state, result):
    """Evaluate the residual of every sample, (n_samples, n_eta); of prescribed coordinates it is the driving force."""
    work = allocate(equations.layout)
    for block in range(memory.cells.shape[0]):
        take_up(state, block, work)
        evaluate_block(equations, memory, block, strengths.loads, (0.0, 0.0), False, work)
        count = min(LANES, result.shape[0] - block * LANES)
        scatter(work.balance, block, (1 << count) - 1, result)


@njit(cache=True, error_model="numpy")
def fill_matrices(equations, memory, strengths, state, gain_a):
    """Fill the iteration matrices of ``memory.matrix``, not factorised and without gain of the velocities."""
    work = allocate(equations.layout)
    for block in range(memory.cells.shape[0]):
        take_up(state, block, work)
        evaluate_block(equations, memory, block, strengths.loads, (0.0, gain_a), True, work)


@njit(cache=True, error_model="numpy")
def advance(equations, memory, strengths, scheme, step, state, bounds, edges, lanes, progress):
    """Take some samples through several equal steps, each until it is done or something happens to it.

    Parameters
    ----------
    strengths
        At the ends of all steps, with an axis of steps in front.
    scheme
        ``(alpha_m, alpha_f, beta, gamma, gain_v, gain_a)``.
    step
        s.
    state
        ``(q, v, a, auxiliary, before)``, each (n_samples, n_eta), with the auxiliary accelerations and the
        accelerations one step before; advanced in place. A sample to which something happens stays at the beginning of
        that step.
    bounds
        Range of each coordinate in which the tables hold, (n_theta, 2).
    edges
        Numbers of the actions whose law has an edge.
    lanes
        Sets of those to advance, shape (n_blocks,).
    progress
        Result.
    """
    layout, gains = equations.layout, (scheme[4], scheme[5])
    work = allocate(layout)
    local = allocate_local(equations.local, len(equations.grid), layout.n_eta)
    n_steps = strengths.loads.shape[0]
    of_block = (
        vectors_of(layout.n_eta),
        vectors_of(layout.n_eta),
        vectors_of(layout.n_eta),
        vectors_of(layout.n_eta),
        vectors_of(layout.n_eta),
    )
    for block in range(lanes.size):
        going = lanes[block]
        if going == 0:
            continue
        for part, vectors in zip(state, of_block):
            gather(part, block, vectors)
        for number in range(n_steps):
            if going == 0:
                break
            now = Strengths(strengths.loads[number], strengths.actions[number], strengths.motions[number])
            _predict(equations, scheme, step, of_block, now, work)
            lost = _converge(equations, memory, block, now, gains, going, work, local, progress)
            outcome = progress.outcome[block]
            going &= ~_note(lost, LOST, outcome)
            going &= ~_note(_outside(work, bounds) & going, OUTSIDE, outcome)
            if edges.size > 0 and going != 0:
                crossed = _crossed(equations, memory, block, now, edges, going, work, local, progress)
                going &= ~_note(crossed, CROSSED, outcome)
            _follow(scheme, of_block, going, layout.n_eta, work)
            for lane in range(LANES):
                if going & (1 << lane):
                    progress.n_steps[block, lane] = number + 1
            if progress.trail.shape[0] > 0:
                for part in range(3):
                    scatter(of_block[part], block, lanes[block], progress.trail[number, part])
        for part, vectors in zip(state, of_block):
            scatter(vectors, block, lanes[block], part)


@njit(inline="always")
def _note(lanes, what, outcome):
    """Note what happened to some lanes, and return them."""
    for lane in range(LANES):
        if lanes & (1 << lane):
            outcome[lane] = what
    return lanes


@njit(error_model="numpy", forceinline=True)
def _predict(equations, scheme, step, state, strengths, work):
    """Predict the end of a step with the accelerations extrapolated linearly, prescribed coordinates where they are."""
    alpha_m, alpha_f, beta, gamma, _, _ = scheme
    q, v, a, auxiliary, before = state
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


@njit(error_model="numpy", forceinline=True)
def _converge(equations, memory, block, strengths, gains, lanes, work, local, progress):
    """Run Newton's iteration of some lanes, each to its own convergence; return those that are lost.

    What remains after a correction is estimated from the contraction between the last two (Hairer and Wanner 1996,
    section IV.8); see `alpha_step.judge`.
    """
    gain_v, gain_a = gains
    n = equations.layout.n_eta
    last, active, lost = spread(np.inf), lanes, 0
    for iteration in range(MAX_ITERATIONS):
        fresh = iteration % REFRESH_EVERY == 0
        if memory.acting.balance.size > 0:
            act(
                equations.local, (equations.fine, equations.grid), strengths.actions, work.q, work.rate, block * LANES,
                active, gain_v, fresh, local, acting_of(memory, block), memory.known,
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
        contraction = spread(FIRST_CONTRACTION)
        if iteration > 0:
            contraction = size / larger(last, spread(ALMOST_NONE))
            contraction = blend(
                exceeding(contraction, spread(WORST_CONTRACTION)), spread(WORST_CONTRACTION), contraction
            )
        remaining = size * contraction / (1.0 - contraction)
        broken = active & exceeding(size * 0.0, spread(0.0))  # infinity times zero is no number either
        lost |= broken
        active &= ~broken & exceeding(remaining, spread(NEWTON_TOLERANCE)) & exceeding(size, spread(ROUND_OFF))
        last = size
        if active == 0:
            break
    return lost | active


@njit(inline="always")
def _outside(work, bounds):
    """Return the lanes that left the range of the tables."""
    lanes = 0
    for k in range(bounds.shape[0]):
        theta = load(work.q, k)
        lanes |= exceeding(theta, spread(bounds[k, 1])) | exceeding(spread(bounds[k, 0]), theta)
    return lanes


@njit(error_model="numpy", forceinline=True)
def _crossed(equations, memory, block, strengths, edges, lanes, work, local, progress):
    """Return the lanes that crossed an edge of a law in this step."""
    act(
        equations.local, (equations.fine, equations.grid), strengths.actions, work.q, work.rate, block * LANES, lanes,
        0.0, False, local, acting_of(memory, block), memory.known,
    )  # fmt: skip
    crossed = 0
    for lane in range(LANES):
        if lanes & (1 << lane):
            sample = block * LANES + lane
            for event in range(edges.size):
                if (memory.known[sample, DEPTH, edges[event]] > 0.0) != progress.beyond[sample, event]:
                    crossed |= 1 << lane
    return crossed


@njit(error_model="numpy", forceinline=True)
def _follow(scheme, state, lanes, n, work):
    """Let some lanes go to the end of the step, with the auxiliary accelerations there."""
    alpha_m, alpha_f = scheme[0], scheme[1]
    q, v, a, auxiliary, before = state
    weight = 1.0 / (1.0 - alpha_m)
    for i in range(n):
        now, then, behind = load(a, i), load(work.a, i), load(auxiliary, i)
        ahead = ((1.0 - alpha_f) * then + alpha_f * now - alpha_m * behind) * weight
        store(q, i, blend(lanes, load(work.q, i), load(q, i)))
        store(v, i, blend(lanes, load(work.rate, i), load(v, i)))
        store(a, i, blend(lanes, then, now))
        store(auxiliary, i, blend(lanes, ahead, behind))
        store(before, i, blend(lanes, now, load(before, i)))
