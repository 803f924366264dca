"""Newton correction of the reduced equations of motion, sample by sample, compiled.

The equations are those of `reduced_equations`. M, b, K and Q are interpolated at the sample's own theta and weighted
with its own parameters. Where a scene asks for them, the terms of second order in delta follow; see
`second_order_kernel`. Samples are taken LANES at a time, side by side; see `lanes` and `cells`.

A prescribed coordinate has its position, velocity and acceleration given; its correction is zero. The residual of its
row is the driving force.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.dynamics.action_kernel import add_tangents
from pgmp_petsc.dynamics.cells import Grid, evaluate, evaluate_directly, evaluate_values, locate_all, refill
from pgmp_petsc.dynamics.lanes import LANES, eliminate_border, solve_bordered
from pgmp_petsc.dynamics.reduced_equations import Layout, add_damping, allocate, iteration_matrix, residual
from pgmp_petsc.dynamics.second_order_kernel import add_second_order, add_second_order_tangent
from pgmp_petsc.runtime.compiled import njit


class Tables(NamedTuple):
    """Polynomials of the rigid inertia, of all other terms and of the loads.

    Each of shape (n_cells, n_terms, 4**n_theta, n_entries).
    """

    rigid: np.ndarray
    terms: np.ndarray
    loads: np.ndarray


class Weights(NamedTuple):
    """Of the terms and of the load terms, shapes (n_samples, n); and the number of the effect of each load term."""

    terms: np.ndarray
    loads: np.ndarray
    effects: np.ndarray


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
    mass_damping
        Factor alpha of the damping proportional to the mass, shape (n_samples,), 1/s; empty where there is none.
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
    mass_damping: np.ndarray
    prescribed: np.ndarray
    scale: np.ndarray


@njit(cache=True, error_model="numpy")
def interpolate(equations, block, first, count, q, amplitudes, cache, work):
    """Fill all terms and their derivatives at the thetas of samples first to first + count - 1, lane by lane."""
    layout, grid, fine, tables = equations.layout, equations.grid, equations.fine, equations.tables
    of_terms, of_loads, effects = equations.weights
    rigid, polynomials, loads = tables
    cells, kept_terms, kept_loads = cache
    terms, slopes, load, load_slope = work.terms, work.slopes, work.load, work.load_slope
    r, n_lanes = len(grid), terms.shape[1]
    place, fine_place, fine_cells = work.place, work.fine_place, work.fine_cells
    for lane in range(n_lanes):
        b = first + min(lane, count - 1)
        cell = locate_all(q, b, grid, lane, place)
        if cell != cells[block, lane]:
            cells[block, lane] = cell
            none = np.zeros(of_terms.shape[1], dtype=np.int64)
            refill(polynomials, cell, of_terms[b], none, layout.end, lane, kept_terms[block])
            if amplitudes.size > 0:
                refill(loads, cell, of_loads[b], effects, layout.load_end, lane, kept_loads[block])
        fine_cells[lane] = locate_all(q, b, fine, lane, fine_place)
    evaluate_directly(rigid, fine_cells, fine, of_terms, first, count, fine_place, terms, slopes)
    n_rigid = r * (r + 1) // 2
    if layout.quadratic:
        evaluate(kept_terms[block], n_rigid, layout.end, place, grid, terms, slopes)
    else:
        evaluate_values(kept_terms[block], n_rigid, layout.stiffness, place, grid, terms)
        evaluate(kept_terms[block], layout.stiffness, layout.end, place, grid, terms, slopes)
    load[:] = 0.0
    load_slope[:] = 0.0
    value, slope = work.unit, work.unit_slope
    for effect in range(amplitudes.size):
        kept = kept_loads[block, effect * layout.load_end :]
        evaluate(kept, 0, layout.load_end, place, grid, value, slope)
        for i in range(layout.load_end):
            for lane in range(n_lanes):
                load[i, lane] += amplitudes[effect] * value[i, lane]
                for k in range(r):
                    load_slope[k, i, lane] += amplitudes[effect] * slope[k, i, lane]


@njit(inline="always")
def evaluate_balance(equations, block, first, count, amplitudes, acting, state, cache, work):
    """Evaluate the residual of one block of samples into ``work.balance``.

    Inlined, because a function between `correct` and the others makes the compiler optimise those once more.
    """
    layout, mass_damping = equations.layout, equations.mass_damping
    positions, velocities, accelerations = state
    q, a, rate = work.q, work.a, work.rate
    interpolate(equations, block, first, count, positions, amplitudes, cache, work)
    for i in range(layout.n_eta):
        for lane in range(LANES):
            b = first + min(lane, count - 1)
            q[i, lane], rate[i, lane], a[i, lane] = positions[b, i], velocities[b, i], accelerations[b, i]
    if mass_damping.size > 0:
        for i in range(layout.n_eta):
            for lane in range(LANES):
                a[i, lane] += mass_damping[first + min(lane, count - 1)] * rate[i, lane]
    loaded = amplitudes.size > 0
    residual(layout, work, loaded)
    if layout.cubic < layout.damping:
        add_second_order(layout, work, loaded)
    if layout.damping < layout.end:
        add_damping(layout, work)
    if acting.balance.size > 0:
        for i in range(layout.n_eta):
            for lane in range(LANES):
                work.balance[i, lane] += acting.balance[block, i, lane]


@njit(cache=True, error_model="numpy")
def correct(equations, amplitudes, acting, state, gains, active, fresh, factors, cache, size):
    """Do one Newton correction of every active sample in place.

    Parameters
    ----------
    equations
        See `Equations`.
    amplitudes
        Of the effects with loads at the end of the step, shape (n_effects,).
    acting
        What local effects add; see `action_kernel.Acting`.
    state
        ``(q, v, a)``, each of shape (n_samples, n_eta).
    gains
        ``(gain_v, gain_a)``.
    active
        Shape (n_samples,).
    fresh
        Whether to factorise anew; otherwise `factors` of the last call serve.
    factors
        ``(packed Cholesky factors, borders)``, shapes (n_blocks, n_packed_delta, LANES) and (n_blocks, n_border,
        LANES).
    cache
        Polynomials of the cells that the samples are in.
    size
        Result: size of the correction, shape (n_samples,).
    """
    layout, scale, mass_damping = equations.layout, equations.scale, equations.mass_damping
    positions, velocities, accelerations = state
    r, n = len(layout.rigid), layout.n_eta
    gain_v, gain_a = gains
    work = allocate(layout)
    gain_of_lane = np.empty(LANES)
    for block in range(factors[0].shape[0]):
        first = block * LANES
        count = min(LANES, size.size - first)
        size[first : first + count] = 0.0
        if not active[first : first + count].any():
            continue
        evaluate_balance(equations, block, first, count, amplitudes, acting, state, cache, work)
        factor, border = factors[0][block], factors[1][block]
        if fresh:
            gain_of_lane[:] = gain_a
            if mass_damping.size > 0:
                for lane in range(LANES):
                    gain_of_lane[lane] += mass_damping[first + min(lane, count - 1)] * gain_v
            iteration_matrix(layout, work, gain_v, gain_of_lane, factor, border)
            if layout.cubic < layout.damping:
                add_second_order_tangent(layout, work, gain_v, gain_of_lane, factor, border)
            if acting.tangent.size > 0:
                add_tangents(acting.tangent[block], r, factor, border)
            _hold_prescribed(equations, border)
            eliminate_border(factor, border, r, n - r)
        for k in range(r):
            if equations.prescribed[k]:
                for lane in range(LANES):
                    work.balance[k, lane] = 0.0
        correction = work.balance
        solve_bordered(factor, border, r, n - r, correction)
        for lane in range(count):
            b = first + lane
            if active[b]:
                largest = 0.0
                for i in range(n):
                    step = correction[i, lane]
                    positions[b, i] -= step
                    velocities[b, i] -= gain_v * step
                    accelerations[b, i] -= gain_a * step
                    displacement = abs(step) * scale[i]
                    # written so that a NaN is kept
                    if not displacement <= largest:
                        largest = displacement
                size[b] = largest


@njit(cache=True, error_model="numpy")
def _hold_prescribed(equations, border):
    """Make the rows of prescribed coordinates those of the identity: they are not corrected."""
    r = len(equations.layout.rigid)
    m = equations.layout.n_eta - r
    for k in range(r):
        if equations.prescribed[k]:
            for lane in range(border.shape[1]):
                for j in range(r):
                    border[k * r + j, lane] = 1.0 if j == k else 0.0
                for i in range(m):
                    border[r * r + (r + k) * m + i, lane] = 0.0


@njit(cache=True, error_model="numpy")
def evaluate_residual(equations, amplitudes, acting, state, cache, result):
    """Evaluate the residual of every sample, shape (n_samples, n_eta).

    Of prescribed coordinates it is the driving force.
    """
    work = allocate(equations.layout)
    for block in range(cache.cells.shape[0]):
        first = block * LANES
        count = min(LANES, len(result) - first)
        evaluate_balance(equations, block, first, count, amplitudes, acting, state, cache, work)
        for lane in range(count):
            for i in range(equations.layout.n_eta):
                result[first + lane, i] = work.balance[i, lane]


@njit(cache=True, error_model="numpy")
def fill_tangents(equations, amplitudes, acting, state, gain_a, matrices, cache, n_samples):
    """Fill the iteration matrix of every sample, not factorised and without gain of the velocities.

    `matrices` are ``(packed S, border)`` with the shapes of the factors in `correct`, before their elimination: see
    `eliminate_border`.
    """
    layout = equations.layout
    work = allocate(layout)
    gain_of_lane = np.full(LANES, gain_a)
    for block in range(cache.cells.shape[0]):
        first = block * LANES
        count = min(LANES, n_samples - first)
        evaluate_balance(equations, block, first, count, amplitudes, acting, state, cache, work)
        factor, border = matrices[0][block], matrices[1][block]
        iteration_matrix(layout, work, 0.0, gain_of_lane, factor, border)
        if layout.cubic < layout.damping:
            add_second_order_tangent(layout, work, 0.0, gain_of_lane, factor, border)
        if acting.tangent.size > 0:
            add_tangents(acting.tangent[block], len(layout.rigid), factor, border)
