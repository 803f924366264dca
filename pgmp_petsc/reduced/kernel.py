"""Newton corrections of the reduced model, LANES samples at a time, compiled.

The equations are those of `lagrangian`. Their tables are interpolated at the sample's own theta and weighted
with its own parameters.

A prescribed coordinate has its position, velocity and acceleration given; its correction is zero. The residual of its
row is the driving force. Flexible ones that are given do not move.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import absolute
from pgmp_petsc.lanes.vectors import (
    EVERY_LANE,
    LANES,
    N_POWERS,
    add,
    add_product,
    add_to_row,
    larger,
    load,
    load_rows,
    polynomial,
    rigid_polynomial,
    select,
    spread,
    store,
)
from pgmp_petsc.reduced.action_kernel import act, add_tangents, load_nodes
from pgmp_petsc.reduced.arrays import acting_of, layout_n_rigid, matrix_of, pair, places_of
from pgmp_petsc.reduced.bordered import eliminate, solve
from pgmp_petsc.reduced.carried import find_carried
from pgmp_petsc.reduced.cells import enter_cells, refill
from pgmp_petsc.reduced.lagrangian import evaluate


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def interpolate(equations, memory, block, amplitudes, work):
    """Bring the polynomials of a block to the cells of its samples, and evaluate rigid inertia and loads there."""
    layout, tables, weights = equations.layout, equations.tables, equations.weights
    loads, n_rigid = memory.loads[block], layout_n_rigid(len(equations.grid))
    own, together = weights.terms[block], weights.together
    moved, cells = enter_cells(work.q, equations.grid, work.place, memory.cells, block), memory.cells[block]
    if moved != 0:
        refill(tables.rigid, cells, moved, own, together, 0, memory.rigid[block])
        first = n_rigid * N_POWERS ** len(equations.grid)
        refill(tables.terms, cells, moved, own, together, first, memory.terms[block])
        if amplitudes.size > 0:
            refill(tables.loads, cells, moved, weights.loads[block], weights.effects, 0, loads)
    place = load_rows(work.place, 0, 1, layout.rigid)
    for entry in range(n_rigid):
        value, slopes = rigid_polynomial(memory.rigid[block], entry, place)
        store(work.rigid, entry, value)
        for k in range(len(place)):
            store(work.rigid_slope, k * n_rigid + entry, slopes[k])
    if amplitudes.size > 0:
        for entry in range(layout.load_end):
            value, slopes = polynomial(loads, entry, place)
            amplitude = load(amplitudes, 0)
            store(work.load, entry, value * amplitude)
            for k in range(len(place)):
                store(work.load_slope, k * layout.load_end + entry, slopes[k] * amplitude)
        for effect in range(1, amplitudes.shape[0]):
            amplitude = load(amplitudes, effect)
            for entry in range(layout.load_end):
                value, slopes = polynomial(loads, effect * layout.load_end + entry, place)
                add_to_row(work.load, entry, value, amplitude)
                total = load_rows(work.load_slope, entry, layout.load_end, place)
                total = add_product(total, slopes, amplitude)
                for k in range(len(place)):
                    store(work.load_slope, k * layout.load_end + entry, total[k])


@njit(cache=True, apart=True, error_model="numpy", fastmath={"contract"}, counted=False)
def evaluate_block(equations, memory, room, block, amplitudes, gains, fresh):
    """Evaluate residual and, if `fresh`, iteration matrix at q, rate and acceleration of ``room.work``.

    Lanes have `amplitudes` of loads (n_effects, LANES) and a vector of each of the two `gains` of their own.
    """
    work, layout = room.work, equations.layout
    r, n = len(layout.rigid), layout.n_eta
    gain_v, gain_a = gains
    interpolate(equations, memory, block, amplitudes, work)
    for i in range(n):
        rate = load(work.rate, i)
        store(work.v, i, rate if layout.quadratic else spread(0.0))
        # the inertia forces see other accelerations where damping is proportional to the mass
        store(work.a, i, load(work.acceleration, i) + rate * equations.mass_damping)
    place = load_rows(work.place, 0, 1, layout.rigid)
    matrix = matrix_of(memory, block)
    evaluate(
        layout, memory.terms[block], place, gain_v, gain_a + gain_v * equations.mass_damping, fresh,
        amplitudes.size > 0, work, matrix,
    )  # fmt: skip
    if memory.acting.balance.size > 0:
        acting = acting_of(memory, block)
        for i in range(n):
            add(work.balance, i, load(acting.balance, i))
        if fresh:
            add_tangents(acting.tangent, r, matrix)


@njit(cache=True, apart=True, error_model="numpy", fastmath={"contract"}, counted=False)
def correct_block(equations, memory, room, block, amplitudes, gains, fresh):
    """Replace ``room.work.balance`` of a block by its Newton correction; see `evaluate_block`."""
    evaluate_block(equations, memory, room, block, amplitudes, gains, fresh)
    matrix, work = matrix_of(memory, block), room.work
    r, n = len(equations.layout.rigid), equations.layout.n_eta
    for k in range(n):
        if equations.prescribed[k]:
            store(work.balance, k, spread(0.0))
    if fresh:
        _hold_prescribed(equations, matrix)
        eliminate(matrix, r, n - r)
    solve(matrix, r, n - r, work.balance, work.right)


@njit(inline="always")
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
    for i in range(m):
        if equations.prescribed[r + i]:
            for j in range(m):
                store(matrix.factor, pair(i, j), spread(1.0 if j == i else 0.0))
                if matrix.skew.shape[0] > 0:
                    store(matrix.skew, pair(i, j), spread(0.0))
            for k in range(r):
                store(matrix.column, k * m + i, spread(0.0))


@njit(inline="always")
def follow_correction(equations, gains, lanes, work):
    """Take the correction in ``work.balance`` off the iterate of some lanes.

    Returns the largest displacement that it makes in each lane, a vector; NaN where any part of it is.
    """
    gain_v, gain_a = gains
    size = spread(0.0)
    for i in range(equations.layout.n_eta):
        correction = load(work.balance, i)
        size = larger(absolute(correction) * equations.scale[i], size)
        change = select(lanes, correction, spread(0.0))
        store(work.q, i, load(work.q, i) - change)
        store(work.rate, i, load(work.rate, i) - gain_v * change)
        store(work.acceleration, i, load(work.acceleration, i) - gain_a * change)
    return size


@njit(inline="always")
def gather(rows, samples, vectors):
    """Copy rows (n_samples, n) of a block's samples to vectors (n, LANES)."""
    for lane in range(LANES):
        row = rows[samples[lane]]
        for i in range(row.size):
            vectors[i, lane] = row[i]


@njit(inline="always")
def scatter(vectors, samples, lanes, rows):
    """Copy some lanes of vectors (n, LANES) to the rows (n_samples, n) of their samples."""
    for lane in range(LANES):
        if lanes & (1 << lane):
            copy_lane(vectors, lane, rows[samples[lane]])


@njit(inline="always")
def copy_lane(vectors, lane, row):
    """Copy one lane of vectors (n, LANES) to a row (n,)."""
    for i in range(row.size):
        row[i] = vectors[i, lane]


@njit(inline="always")
def take_up(state, samples, work):
    """Copy the state ``(q, v, a)`` of a block's samples to where it is evaluated."""
    gather(state[0], samples, work.q)
    gather(state[1], samples, work.rate)
    gather(state[2], samples, work.acceleration)


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def correct(equations, memory, room, strengths, state, gains, active, fresh, size):
    """Do one Newton correction of samples in sets of active lanes (n_blocks,), in place; fill its size, 0 where there
    is none, (n_blocks, LANES).

    The state ``(q, v, a)`` has shapes (n_samples, n_eta), gains are ``(gain_v, gain_a)``; of the strengths at the end
    of the step motions are not used. Where it is not `fresh` the factors of the last call serve.
    """
    gain_v, gain_a, work = spread(gains[0]), spread(gains[1]), room.work
    for block in range(active.size):
        store(size, block, spread(0.0))
        if active[block] == 0:
            continue
        take_up(state, memory.samples[block], work)
        correct_block(equations, memory, room, block, strengths.loads, (gain_v, gain_a), fresh)
        found = follow_correction(equations, (gain_v, gain_a), EVERY_LANE, work)
        scatter(work.q, memory.samples[block], active[block], state[0])
        scatter(work.rate, memory.samples[block], active[block], state[1])
        scatter(work.acceleration, memory.samples[block], active[block], state[2])
        store(size, block, select(active[block], found, spread(0.0)))


@njit(inline="always")
def act_at(equations, memory, room, block, amplitudes, lanes, gain_v, with_tangent):
    """Evaluate all local effects in some lanes of a block at q and rate of ``room.work``; see `act`."""
    act(
        equations.local, equations.local.all, equations.grid, amplitudes, room.work.q, room.work.rate,
        memory.samples[block], lanes, spread(gain_v), with_tangent, with_tangent and gain_v != 0.0, room.local,
        places_of(memory, block), acting_of(memory, block), memory.known, memory.depths,
    )  # fmt: skip


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def act_on(equations, memory, room, amplitudes, trail, active, gain_v, with_tangent, known):
    """Evaluate the local effects on samples in sets of active lanes (n_blocks,) at several instants, the last of which
    stays in the memory; fill what is `known`, as of `act`, shape (n_t, n_samples, 3, n_actions).

    Actions have amplitudes at every instant, of the sample in each lane, (n_t, n_blocks, n_actions, LANES); the trail
    has positions and velocities, (n_t, 2, n_samples, n_eta), and what else is behind them.
    """
    work, n_actions = room.work, amplitudes.shape[2]
    for block in range(active.size):
        if active[block] == 0:
            continue
        samples = memory.samples[block]
        for instant in range(trail.shape[0]):
            gather(trail[instant, 0], samples, work.q)
            gather(trail[instant, 1], samples, work.rate)
            act_at(equations, memory, room, block, amplitudes[instant, block], active[block], gain_v, with_tangent)
            for lane in range(LANES):
                if active[block] & (1 << lane):
                    for row in range(known.shape[2]):
                        for k in range(n_actions):
                            known[instant, samples[lane], row, k] = memory.known[samples[lane], row, k]


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def load_on(equations, memory, room, amplitudes, trail, loads):
    """Fill what local effects do to their nodes in all samples at several instants, vectors (n_t, n_blocks, n_nodes,
    n_dofs, LANES); see `load_nodes` and `act_on`."""
    local, q, v, work = equations.local, room.work.q, room.work.rate, room.rates
    for block in range(amplitudes.shape[1]):
        for instant in range(trail.shape[0]):
            gather(trail[instant, 0], memory.samples[block], q)
            gather(trail[instant, 1], memory.samples[block], v)
            load_nodes(
                local, equations.grid, amplitudes[instant, block], q, v, memory.samples[block], EVERY_LANE, work,
                places_of(memory, block), memory.known, memory.depths, loads[instant, block],
            )  # fmt: skip


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def evaluate_residuals(equations, memory, room, strengths, trail, active, residuals):
    """Evaluate the residuals of samples in sets of active lanes (n_blocks,) at several instants, (n_t, n_samples,
    n_eta); of prescribed coordinates they are driving forces. Local effects of the last one stay in the memory.

    Loads and actions have amplitudes at every instant, of the sample in each lane, `strengths` of (n_t, n_blocks,
    n_effects or n_actions, LANES); the trail has positions, velocities and accelerations, (n_t, 3, n_samples, n_eta).
    A block goes through all instants: it enters a cell once, and its tables stay in the processor's cache.
    """
    work, at_rest, (loads, amplitudes) = room.work, (spread(0.0), spread(0.0)), strengths
    for block in range(active.size):
        samples = memory.samples[block]
        for instant in range(trail.shape[0]):
            take_up((trail[instant, 0], trail[instant, 1], trail[instant, 2]), samples, work)
            if amplitudes.shape[2] > 0:
                act_at(equations, memory, room, block, amplitudes[instant, block], active[block], 0.0, np.bool_(False))
            evaluate_block(equations, memory, room, block, loads[instant, block], at_rest, np.bool_(False))
            scatter(work.balance, samples, active[block], residuals[instant])


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def fill_matrices(equations, memory, room, strengths, state, gain_a):
    """Fill the iteration matrices of ``memory.matrix``, not factorised and without gain of the velocities."""
    gains = spread(0.0), spread(gain_a)
    for block in range(memory.cells.shape[0]):
        take_up(state, memory.samples[block], room.work)
        evaluate_block(equations, memory, room, block, strengths.loads, gains, np.bool_(True))


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def find_all_carried(equations, memory, room, strengths, state, active, found):
    """Fill forces (n, n_samples) that joints carry in states ``(q, v, a)``, in some lanes of every block."""
    for block in range(active.size):
        if active[block] == 0:
            continue
        samples = memory.samples[block]
        take_up(state, samples, room.work)
        find_carried(
            equations, memory, room, block, places_of(memory, block), strengths, samples, active[block]
        )  # fmt: skip
        for lane in range(LANES):
            if active[block] & (1 << lane):
                for k in range(found.shape[0]):
                    found[k, samples[lane]] = room.carried.forces[k, lane]
