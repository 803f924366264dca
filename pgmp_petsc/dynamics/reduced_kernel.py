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

Samples are taken LANES at a time: each lane interpolates at its own theta, along the contiguous entries of the tables;
all that follows runs over the lanes side by side, where it vectorises. Symmetric matrices are packed as lower triangles
row by row. A lane never touches another's numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pgmp_petsc.reduction.stencil import N_ROWS, stencil

LANES = 8  # samples side by side: one AVX-512 register, or two of AVX2


class Layout(NamedTuple):
    """Where the parts of a table row begin: packed mass, coupling b, packed stiffness; and their end."""

    n_eta: int
    coupling: int
    stiffness: int
    end: int


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def combine(table, rows, weights, slopes, term_weights, value, slope):
    """Sum ``table[rows[r], t]`` with factors ``weights[r] w[t]`` into value, and with ``slopes[r] w[t]`` into slope."""
    value[:] = 0.0
    slope[:] = 0.0
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    s0, s1, s2, s3 = slopes[0], slopes[1], slopes[2], slopes[3]
    for t in range(term_weights.size):
        w = term_weights[t]
        row_0, row_1, row_2, row_3 = table[rows[0], t], table[rows[1], t], table[rows[2], t], table[rows[3], t]
        # the four rows in one pass: each entry of the table is read once, each sum written once
        for e in range(value.size):
            a, b, c, d = row_0[e], row_1[e], row_2[e], row_3[e]
            value[e] += w * (w0 * a + w1 * b + w2 * c + w3 * d)
            slope[e] += w * (s0 * a + s1 * b + s2 * c + s3 * d)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def multiply(packed, first, n, x, skip, result):
    """Multiply packed symmetric matrices, from row `first` on, with ``x[skip:]``: (n, LANES) each."""
    for i in range(n):
        for lane in range(LANES):
            result[i, lane] = 0.0
    at = first
    for i in range(n):
        for j in range(i):
            for lane in range(LANES):
                result[i, lane] += packed[at, lane] * x[skip + j, lane]
                result[j, lane] += packed[at, lane] * x[skip + i, lane]
            at += 1
        for lane in range(LANES):
            result[i, lane] += packed[at, lane] * x[skip + i, lane]
        at += 1


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def factorise(packed, n):
    """Replace packed positive definite matrices by their Cholesky factors, diagonals inverted; NaN where not."""
    for i in range(n):
        row_i = i * (i + 1) // 2
        for j in range(i + 1):
            row_j = j * (j + 1) // 2
            for k in range(j):
                for lane in range(LANES):
                    packed[row_i + j, lane] -= packed[row_i + k, lane] * packed[row_j + k, lane]
            if i == j:
                for lane in range(LANES):
                    packed[row_i + i, lane] = 1.0 / np.sqrt(packed[row_i + i, lane])
            else:
                for lane in range(LANES):
                    packed[row_i + j, lane] *= packed[row_j + j, lane]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def substitute(packed, n, x):
    """Solve ``L L^T y = x`` in place, x of shape (n, LANES)."""
    for i in range(n):
        row = i * (i + 1) // 2
        for j in range(i):
            for lane in range(LANES):
                x[i, lane] -= packed[row + j, lane] * x[j, lane]
        for lane in range(LANES):
            x[i, lane] *= packed[row + i, lane]
    for i in range(n - 1, -1, -1):
        row = i * (i + 1) // 2
        for lane in range(LANES):
            x[i, lane] *= packed[row + i, lane]
        for j in range(i):
            for lane in range(LANES):
                x[j, lane] -= packed[row + j, lane] * x[i, lane]


@njit(cache=True, error_model="numpy")
def interpolate_lanes(first, count, q, layout, grids, tables, weights, amplitudes, terms, slopes, load, load_slope):
    """Fill all terms and their derivatives at the thetas of samples first to first + count - 1, lane by lane."""
    rows = np.empty(N_ROWS, dtype=np.int64)
    value, slope = np.empty(N_ROWS), np.empty(N_ROWS)
    entries, entry_slopes = np.empty(layout.end), np.empty(layout.end)
    forces, force_slopes = np.empty(layout.n_eta), np.empty(layout.n_eta)
    load_weights = np.empty(amplitudes.size)
    for lane in range(LANES):
        b = first + min(lane, count - 1)
        theta = q[b, 0]
        if not abs(theta) < 1e9:
            theta = grids[0][0]
        stencil(theta, *grids[1], rows, value, slope)
        combine(tables[1], rows, value, slope, weights[0][b], entries, entry_slopes)
        if amplitudes.size > 0:
            for t in range(amplitudes.size):
                load_weights[t] = amplitudes[t] * weights[1][b, t]
            combine(tables[2], rows, value, slope, load_weights, forces, force_slopes)
            for i in range(layout.n_eta):
                load[i, lane], load_slope[i, lane] = forces[i], force_slopes[i]
        stencil(theta, *grids[0], rows, value, slope)
        entries[0], entry_slopes[0] = 0.0, 0.0
        for r in range(N_ROWS):
            inertia = 0.0
            for t in range(weights[0].shape[1]):
                inertia += weights[0][b, t] * tables[0][rows[r], t, 0]
            entries[0] += value[r] * inertia
            entry_slopes[0] += slope[r] * inertia
        for e in range(layout.end):
            terms[e, lane], slopes[e, lane] = entries[e], entry_slopes[e]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def residual(layout, q, v, a, terms, slopes, load, load_slope, loaded, moved, turned, r):
    """Evaluate the equations of motion into r (n_eta, LANES); see the module.

    ``(dM/dtheta) eta'`` is left in `moved` (n_eta, LANES), ``(dK/dtheta) delta - dQ_delta/dtheta`` in `turned`
    (n_delta, LANES).
    """
    n, m = layout.n_eta, layout.n_eta - 1
    multiply(slopes, 0, n, v, 0, moved)
    multiply(terms, 0, n, a, 0, r)
    multiply(terms, layout.stiffness, m, q, 1, turned)
    for i in range(n):
        for lane in range(LANES):
            r[i, lane] += v[0, lane] * moved[i, lane]
            r[0, lane] -= 0.5 * v[i, lane] * moved[i, lane]
    for i in range(m):
        b = layout.coupling + i
        for lane in range(LANES):
            speed, delta = v[0, lane], q[1 + i, lane]
            r[1 + i, lane] += turned[i, lane] - terms[b, lane] * speed * speed
            r[0, lane] += 2.0 * terms[b, lane] * (delta * a[0, lane] + v[1 + i, lane] * speed)
            r[0, lane] += slopes[b, lane] * delta * speed * speed
    multiply(slopes, layout.stiffness, m, q, 1, turned)
    for i in range(m):
        for lane in range(LANES):
            r[0, lane] += 0.5 * q[1 + i, lane] * turned[i, lane]
    if loaded:
        for i in range(n):
            for lane in range(LANES):
                r[i, lane] -= load[i, lane]
        for i in range(m):
            for lane in range(LANES):
                r[0, lane] -= load_slope[1 + i, lane] * q[1 + i, lane]
                turned[i, lane] -= load_slope[1 + i, lane]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def iteration_matrix(layout, q, v, a, terms, slopes, moved, turned, gain_v, gain_a, factor, border):
    """Fill the iteration matrix ``[[s, r^T], [c, S]]``: packed S (n_packed_delta, LANES) and border (s, c, r).

    Its flexible block ``S = gain_a M + gain_v theta' dM/dtheta + K`` is symmetric; the inertia forces of the rigid
    motion make row and column of theta differ.
    """
    m = layout.n_eta - 1
    at, of, into = 1, layout.stiffness, 0
    for i in range(m):
        b = layout.coupling + i
        for lane in range(LANES):
            speed = v[0, lane]
            coupled = gain_a * terms[at, lane]
            rate = 2.0 * gain_v * speed * (slopes[at, lane] - terms[b, lane])
            border[1 + i, lane] = coupled + rate + gain_v * (moved[1 + i, lane] - slopes[at, lane] * speed)
            border[1 + i, lane] += turned[i, lane]
            border[1 + m + i, lane] = coupled - gain_v * (moved[1 + i, lane] - slopes[at, lane] * speed)
            border[1 + m + i, lane] += 2.0 * terms[b, lane] * (gain_v * speed + a[0, lane])
            border[1 + m + i, lane] += slopes[b, lane] * speed * speed + turned[i, lane]
        for j in range(i + 1):
            for lane in range(LANES):
                inertia = gain_a * terms[at + 1 + j, lane] + gain_v * v[0, lane] * slopes[at + 1 + j, lane]
                factor[into + j, lane] = inertia + terms[of + j, lane]
        at += i + 2
        of += i + 1
        into += i + 1
    for lane in range(LANES):
        border[0, lane] = gain_a * terms[0, lane] + slopes[0, lane] * (gain_v * v[0, lane] + a[0, lane])
    for i in range(m):
        b = layout.coupling + i
        for lane in range(LANES):
            stretched = gain_a * q[1 + i, lane] + gain_v * v[1 + i, lane]
            turning = gain_v * q[1 + i, lane] * v[0, lane] + q[1 + i, lane] * a[0, lane] + v[1 + i, lane] * v[0, lane]
            border[0, lane] += 2.0 * (terms[b, lane] * stretched + slopes[b, lane] * turning)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def eliminate_border(factor, border, m):
    """Factorise S and turn the border into ``(1 / (s - r^T S^-1 c), S^-1 c, r)``."""
    factorise(factor, m)
    substitute(factor, m, border[1 : 1 + m])
    for i in range(m):
        for lane in range(LANES):
            border[0, lane] -= border[1 + m + i, lane] * border[1 + i, lane]
    for lane in range(LANES):
        border[0, lane] = 1.0 / border[0, lane]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def solve_bordered(factor, border, m, x):
    """Solve with the iteration matrix in place, x of shape (1 + m, LANES)."""
    substitute(factor, m, x[1:])
    for i in range(m):
        for lane in range(LANES):
            x[0, lane] -= border[1 + m + i, lane] * x[1 + i, lane]
    for lane in range(LANES):
        x[0, lane] *= border[0, lane]
    for i in range(m):
        for lane in range(LANES):
            x[1 + i, lane] -= border[1 + i, lane] * x[0, lane]


@njit(cache=True, error_model="numpy")
def correct(layout, grids, tables, weights, amplitudes, scale, state, gains, active, fresh, factors, size):
    """Do one Newton correction of every active sample in place.

    Parameters
    ----------
    layout
        Parts of a table row.
    grids
        Of the rigid inertia and of all other terms; see `Interpolant.grid`.
    tables
        Rows of ``(rigid, terms, load)``; see `ReducedTerms`.
    weights
        ``(terms, load)`` of every sample, shapes (n_samples, n_terms).
    amplitudes
        Of the load terms at the end of the step, shape (n_load_terms,).
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
    size
        Result: size of the correction, shape (n_samples,).
    """
    n = layout.n_eta
    gain_v, gain_a = gains
    terms, slopes = np.empty((layout.end, LANES)), np.empty((layout.end, LANES))
    load, load_slope = np.empty((n, LANES)), np.empty((n, LANES))
    q, v, a = np.empty((n, LANES)), np.empty((n, LANES)), np.empty((n, LANES))
    r, moved, turned = np.empty((n, LANES)), np.empty((n, LANES)), np.empty((n - 1, LANES))
    for block in range(factors[0].shape[0]):
        first = block * LANES
        count = min(LANES, size.size - first)
        size[first : first + count] = 0.0
        if not active[first : first + count].any():
            continue
        interpolate_lanes(
            first, count, state[0], layout, grids, tables, weights, amplitudes, terms, slopes, load, load_slope
        )
        for i in range(n):
            for lane in range(LANES):
                b = first + min(lane, count - 1)
                q[i, lane], v[i, lane], a[i, lane] = state[0][b, i], state[1][b, i], state[2][b, i]
        residual(layout, q, v, a, terms, slopes, load, load_slope, amplitudes.size > 0, moved, turned, r)
        factor, border = factors[0][block], factors[1][block]
        if fresh:
            iteration_matrix(layout, q, v, a, terms, slopes, moved, turned, gain_v, gain_a, factor, border)
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
