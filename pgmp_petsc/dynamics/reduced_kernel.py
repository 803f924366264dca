"""Newton correction of the reduced equations of motion, sample by sample, compiled.

Residual (Naets et al. 2015, eqs. (11)-(12)), eta = [theta, delta], for one rigid coordinate theta::

    r = M eta'' + theta' (dM/dtheta) eta' - 1/2 (eta'^T (dM/dtheta) eta') e_theta + K delta - Q(t)
        + (2 b.delta theta'' + 2 b.delta' theta' + (db/dtheta).delta theta'^2) e_theta - b theta'^2 e_delta
        + (1/2 delta^T (dK/dtheta) delta - (dQ_delta/dtheta).delta) e_theta

The second and third lines are missing in the paper. The second belongs to the kinetic energy
``theta'^2 b(theta).delta`` of first order in delta, with ``b = (d rho/d theta)^T M (d Psi/d theta)``: the inertia
forces of the rigid motion, which bend the bodies, and the change of the rigid inertia with their bending. Without it
the modes are blind to inertia loads, because their mass coupling with theta vanishes identically. The third is the
work of loads and elastic forces on the change of the modes with theta: of second order in the loads, both together or
none. With all of them the system is Lagrangian in the interpolated tables and conserves energy.

M, b, K and Q are interpolated at the sample's own theta and weighted with its own parameters. The iteration matrix
leaves out second derivatives of the tables alone; its flexible block is symmetric positive definite at reasonable
steps and is factorised so, row and column of theta border it.

Where a scene asks for them, the terms of second order in delta follow; see `second_order_kernel`. Samples are taken
LANES at a time, side by side; see `lanes` and `cells`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pgmp_petsc.dynamics.cells import evaluate, evaluate_one, locate, refill
from pgmp_petsc.dynamics.lanes import LANES, eliminate_border, multiply, solve_bordered
from pgmp_petsc.dynamics.second_order_kernel import add_second_order, add_second_order_tangent


class Layout(NamedTuple):
    """Where the parts of a table row begin.

    Packed mass, coupling b, packed stiffness; with terms of second order packed V, c and A (see `second_order_kernel`);
    and the end. A load row has n_eta entries, and with terms of second order packed ones
    after them.
    """

    n_eta: int
    coupling: int
    stiffness: int
    cubic: int
    swing: int
    gyroscopic: int
    end: int
    load_end: int

    @property
    def second_order(self) -> bool:
        """Whether there are terms of second order."""
        return self.cubic < self.end


class Tables(NamedTuple):
    """Polynomials of the rigid inertia, of all other terms and of the loads; each (n_cells, n_terms, 4, n_entries)."""

    rigid: np.ndarray
    terms: np.ndarray
    loads: np.ndarray


class Weights(NamedTuple):
    """Of the terms and of the load terms, shapes (n_samples, n); and the number of the effect of each load term."""

    terms: np.ndarray
    loads: np.ndarray
    effects: np.ndarray


@njit(cache=True, error_model="numpy")
def interpolate(block, first, count, q, layout, grids, tables, weights, amplitudes, cache, terms, slopes, load, load_slope):
    """Fill all terms and their derivatives at the thetas of samples first to first + count - 1, lane by lane."""
    n_lanes = terms.shape[1]
    place = np.empty(LANES)
    none = np.zeros(weights.terms.shape[1], dtype=np.int64)
    for lane in range(n_lanes):
        b = first + min(lane, count - 1)
        theta = q[b, 0]
        if not abs(theta) < 1e9:
            theta = grids[1].lower
        cell, place[lane] = locate(theta, grids[1])
        if cell != cache.cells[block, lane]:
            cache.cells[block, lane] = cell
            refill(tables.terms, cell, weights.terms[b], none, layout.end, lane, cache.terms[block])
            if amplitudes.size > 0:
                refill(tables.loads, cell, weights.loads[b], weights.effects, layout.load_end, lane, cache.loads[block])
        terms[0, lane], slopes[0, lane] = evaluate_one(tables.rigid, grids[0], theta, weights.terms[b])
    evaluate(cache.terms[block, 1:], layout.end - 1, place, grids[1].step, terms[1:], slopes[1:])
    load[:] = 0.0
    load_slope[:] = 0.0
    value, slope = np.empty((layout.load_end, LANES)), np.empty((layout.load_end, LANES))
    for effect in range(amplitudes.size):
        kept = cache.loads[block, effect * layout.load_end :]
        evaluate(kept, layout.load_end, place, grids[1].step, value, slope)
        for i in range(layout.load_end):
            for lane in range(n_lanes):
                load[i, lane] += amplitudes[effect] * value[i, lane]
                load_slope[i, lane] += amplitudes[effect] * slope[i, lane]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def residual(layout, q, v, a, terms, slopes, load, load_slope, loaded, moved, turned, r):
    """Evaluate the equations of motion into r (n_eta, LANES); see the module.

    ``(dM/dtheta) eta'`` is left in `moved` (n_eta, LANES), ``(dK/dtheta) delta - dQ_delta/dtheta`` in `turned`
    (n_delta, LANES).
    """
    n_lanes = r.shape[1]
    n, m = layout.n_eta, layout.n_eta - 1
    multiply(slopes, 0, n, v, 0, moved)
    multiply(terms, 0, n, a, 0, r)
    multiply(terms, layout.stiffness, m, q, 1, turned)
    for i in range(n):
        for lane in range(n_lanes):
            r[i, lane] += v[0, lane] * moved[i, lane]
            r[0, lane] -= 0.5 * v[i, lane] * moved[i, lane]
    for i in range(m):
        b = layout.coupling + i
        for lane in range(n_lanes):
            speed, delta = v[0, lane], q[1 + i, lane]
            r[1 + i, lane] += turned[i, lane] - terms[b, lane] * speed * speed
            r[0, lane] += 2.0 * terms[b, lane] * (delta * a[0, lane] + v[1 + i, lane] * speed)
            r[0, lane] += slopes[b, lane] * delta * speed * speed
    multiply(slopes, layout.stiffness, m, q, 1, turned)
    for i in range(m):
        for lane in range(n_lanes):
            r[0, lane] += 0.5 * q[1 + i, lane] * turned[i, lane]
    if loaded:
        for i in range(n):
            for lane in range(n_lanes):
                r[i, lane] -= load[i, lane]
        for i in range(m):
            for lane in range(n_lanes):
                r[0, lane] -= load_slope[1 + i, lane] * q[1 + i, lane]
                turned[i, lane] -= load_slope[1 + i, lane]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def iteration_matrix(layout, q, v, a, terms, slopes, moved, turned, gain_v, gain_a, factor, border):
    """Fill the iteration matrix ``[[s, r^T], [c, S]]``: packed S (n_packed_delta, LANES) and border (s, c, r).

    Its flexible block ``S = gain_a M + gain_v theta' dM/dtheta + K`` is symmetric; the inertia forces of the rigid
    motion make row and column of theta differ.
    """
    n_lanes = border.shape[1]
    m = layout.n_eta - 1
    at, of, into = 1, layout.stiffness, 0
    for i in range(m):
        b = layout.coupling + i
        for lane in range(n_lanes):
            speed = v[0, lane]
            coupled = gain_a * terms[at, lane]
            rate = 2.0 * gain_v * speed * (slopes[at, lane] - terms[b, lane])
            border[1 + i, lane] = coupled + rate + gain_v * (moved[1 + i, lane] - slopes[at, lane] * speed)
            border[1 + i, lane] += turned[i, lane]
            border[1 + m + i, lane] = coupled - gain_v * (moved[1 + i, lane] - slopes[at, lane] * speed)
            border[1 + m + i, lane] += 2.0 * terms[b, lane] * (gain_v * speed + a[0, lane])
            border[1 + m + i, lane] += slopes[b, lane] * speed * speed + turned[i, lane]
        for j in range(i + 1):
            for lane in range(n_lanes):
                inertia = gain_a * terms[at + 1 + j, lane] + gain_v * v[0, lane] * slopes[at + 1 + j, lane]
                factor[into + j, lane] = inertia + terms[of + j, lane]
        at += i + 2
        of += i + 1
        into += i + 1
    for lane in range(n_lanes):
        border[0, lane] = gain_a * terms[0, lane] + slopes[0, lane] * (gain_v * v[0, lane] + a[0, lane])
    for i in range(m):
        b = layout.coupling + i
        for lane in range(n_lanes):
            stretched = gain_a * q[1 + i, lane] + gain_v * v[1 + i, lane]
            turning = gain_v * q[1 + i, lane] * v[0, lane] + q[1 + i, lane] * a[0, lane] + v[1 + i, lane] * v[0, lane]
            border[0, lane] += 2.0 * (terms[b, lane] * stretched + slopes[b, lane] * turning)


@njit(cache=True, error_model="numpy")
def correct(layout, grids, tables, weights, amplitudes, scale, state, gains, active, fresh, factors, cache, size):
    """Do one Newton correction of every active sample in place.

    Parameters
    ----------
    layout
        Parts of a table row.
    grids
        `Grid` of the rigid inertia, and of all other terms.
    tables, weights
        See `Tables`, `Weights`.
    amplitudes
        Of the effects at the end of the step, shape (n_effects,).
    scale
        Displacement (in units of the mechanism's size or 1 rad) per unit of each coordinate, shape (n_eta,).
    state
        ``(q, v, a)``, each of shape (n_samples, n_eta).
    gains
        ``(gain_v, gain_a)``.
    active
        Shape (n_samples,).
    fresh
        Whether to factorise anew; otherwise `factors` of the last call serve.
    factors
        ``(packed Cholesky factors, borders)``, shapes (n_blocks, n_packed_delta, LANES) and (n_blocks, 1 + 2 n_delta,
        LANES).
    cache
        Polynomials of the cells that the samples are in.
    size
        Result: size of the correction, shape (n_samples,).
    """
    n = layout.n_eta
    gain_v, gain_a = gains
    second_order = layout.cubic < layout.end
    terms, slopes = np.empty((layout.end, LANES)), np.empty((layout.end, LANES))
    load, load_slope = np.empty((layout.load_end, LANES)), np.empty((layout.load_end, LANES))
    q, v, a = np.empty((n, LANES)), np.empty((n, LANES)), np.empty((n, LANES))
    r, moved, turned = np.empty((n, LANES)), np.empty((n, LANES)), np.empty((n - 1, LANES))
    bent, swung, skewed = np.empty((n * (n - 1) // 2, LANES)), np.empty((n - 1, LANES)), np.empty((n - 1, LANES))
    loaded = amplitudes.size > 0
    for block in range(factors[0].shape[0]):
        first = block * LANES
        count = min(LANES, size.size - first)
        size[first : first + count] = 0.0
        if not active[first : first + count].any():
            continue
        interpolate(
            block, first, count, state[0], layout, grids, tables, weights, amplitudes, cache,
            terms, slopes, load, load_slope,
        )  # fmt: skip
        for i in range(n):
            for lane in range(LANES):
                b = first + min(lane, count - 1)
                q[i, lane], v[i, lane], a[i, lane] = state[0][b, i], state[1][b, i], state[2][b, i]
        residual(layout, q, v, a, terms, slopes, load, load_slope, loaded, moved, turned, r)
        if second_order:
            add_second_order(layout, q, v, a, terms, slopes, load, load_slope, loaded, bent, swung, skewed, r)
        factor, border = factors[0][block], factors[1][block]
        if fresh:
            iteration_matrix(layout, q, v, a, terms, slopes, moved, turned, gain_v, gain_a, factor, border)
            if second_order:
                add_second_order_tangent(layout, q, v, a, bent, swung, skewed, gain_v, gain_a, factor, border)
            eliminate_border(factor, border, n - 1)
        solve_bordered(factor, border, n - 1, r)
        for lane in range(count):
            b = first + lane
            if active[b]:
                for i in range(n):
                    step = r[i, lane]
                    state[0][b, i] -= step
                    state[1][b, i] -= gain_v * step
                    state[2][b, i] -= gain_a * step
                    displacement = abs(step) * scale[i]
                    # written so that a NaN is kept
                    if not displacement <= size[b]:
                        size[b] = displacement
