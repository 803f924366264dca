"""Newton correction of the reduced equations of motion, sample by sample, compiled.

Residual (Naets et al. 2015, eqs. (11)-(12)), eta = [theta, delta], for one rigid coordinate theta::

    r = M eta'' + theta' (dM/dtheta) eta' - 1/2 (eta'^T (dM/dtheta) eta') e_theta + K delta - Q(t)
        + (2 b.delta theta'' + 2 b.delta' theta' + (db/dtheta).delta theta'^2) e_theta - b theta'^2 e_delta
        + (1/2 delta^T (dK/dtheta) delta - (dQ_delta/dtheta).delta) e_theta

The second and third lines are missing in the paper. The second belongs to the kinetic energy
``theta'^2 b(theta).delta`` of first order in delta, with ``b = (d rho/d theta)^T M (d Psi/d theta)``: the inertia forces
of the rigid motion, which bend the bodies, and the change of the rigid inertia with their bending. Without it the modes
are blind to inertia loads, because their mass coupling with theta vanishes identically. The third is the work of loads
and elastic forces on the change of the modes with theta: of second order in the loads, both together or none. With all
of them the system is Lagrangian in the interpolated tables and conserves energy.

M, b, K and Q are interpolated at the sample's own theta and weighted with its own parameters. The iteration matrix
``gain_a M + K``, with the rigid inertia's own derivatives added, is symmetric positive definite; what it leaves out
contracts by the square of ``h theta'`` an iteration.

Symmetric matrices are packed as lower triangles row by row; the sums run over packed entries, which vectorise.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pgmp_petsc.reduction.stencil import N_ROWS, stencil


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def combine(table, rows, factors, term_weights, result):
    """Accumulate ``sum_row sum_term factors[row] w[term] table[rows[row], term]`` into result (n_entries,)."""
    result[:] = 0.0
    for r in range(N_ROWS):
        for t in range(term_weights.size):
            factor = factors[r] * term_weights[t]
            source = table[rows[r], t]
            for e in range(result.size):
                result[e] += factor * source[e]


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def multiply(packed, x, result):
    """Multiply a packed symmetric matrix with a vector."""
    n = x.size
    result[:] = 0.0
    at = 0
    for i in range(n):
        total = 0.0
        xi = x[i]
        for j in range(i):
            entry = packed[at + j]
            total += entry * x[j]
            result[j] += entry * xi
        result[i] += total + packed[at + i] * xi
        at += i + 1


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def factorise(packed, n):
    """Replace a packed positive definite matrix by its Cholesky factor; False if it is not positive definite."""
    for i in range(n):
        row_i = i * (i + 1) // 2
        for j in range(i + 1):
            row_j = j * (j + 1) // 2
            total = packed[row_i + j]
            for k in range(j):
                total -= packed[row_i + k] * packed[row_j + k]
            if i == j:
                if not total > 0.0:
                    return False
                packed[row_i + i] = np.sqrt(total)
            else:
                packed[row_i + j] = total / packed[row_j + j]
    return True


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def substitute(packed, x):
    """Solve ``L L^T y = x`` in place."""
    n = x.size
    for i in range(n):
        row = i * (i + 1) // 2
        total = x[i]
        for j in range(i):
            total -= packed[row + j] * x[j]
        x[i] = total / packed[row + i]
    for i in range(n - 1, -1, -1):
        row = i * (i + 1) // 2
        x[i] /= packed[row + i]
        for j in range(i):
            x[j] -= packed[row + j] * x[i]


@njit(cache=True, error_model="numpy")
def correct(grids, tables, weights, amplitudes, scale, state, gains, active, fresh, factors, size):
    """Do one Newton correction of every active sample in place.

    Parameters
    ----------
    grids
        Of the rigid inertia and of all other terms; see `Interpolant.grid`.
    tables
        Rows of ``(rigid, mass, coupling, stiffness, load)``; see `ReducedTerms`.
    weights
        ``(mass, stiffness, load)`` of every sample, shapes (n_samples, n_terms).
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
        Packed Cholesky factors, shape (n_samples, n_packed).
    size
        Result: size of the correction, shape (n_samples,).
    """
    rigid_grid, grid = grids
    q, v, a = state
    gain_v, gain_a = gains
    n_samples, n_eta = q.shape
    rows = np.empty(N_ROWS, dtype=np.int64)
    value, slope = np.empty(N_ROWS), np.empty(N_ROWS)
    mass, mass_slope = np.empty(tables[1].shape[2]), np.empty(tables[1].shape[2])
    stiffness, stiffness_slope = np.empty(tables[3].shape[2]), np.empty(tables[3].shape[2])
    rigid, bent, turned = np.empty(1), np.empty(n_eta - 1), np.empty(n_eta - 1)
    load, load_slope = np.empty(n_eta), np.empty(n_eta)
    coupling, coupling_slope = np.empty(n_eta - 1), np.empty(n_eta - 1)
    r, moved = np.empty(n_eta), np.empty(n_eta)
    load_weights = np.empty(amplitudes.size)
    for b in range(n_samples):
        size[b] = 0.0
        if not active[b]:
            continue
        theta = q[b, 0]
        if not np.isfinite(theta) or abs(theta) > 1e9:
            size[b] = np.nan
            continue
        stencil(theta, *grid, rows, value, slope)
        combine(tables[1], rows, value, weights[0][b], mass)
        combine(tables[1], rows, slope, weights[0][b], mass_slope)
        combine(tables[2], rows, value, weights[0][b], coupling)
        combine(tables[2], rows, slope, weights[0][b], coupling_slope)
        combine(tables[3], rows, value, weights[1][b], stiffness)
        combine(tables[3], rows, slope, weights[1][b], stiffness_slope)
        if amplitudes.size > 0:
            for t in range(amplitudes.size):
                load_weights[t] = amplitudes[t] * weights[2][b, t]
            combine(tables[4], rows, value, load_weights, load)
            combine(tables[4], rows, slope, load_weights, load_slope)
        stencil(theta, *rigid_grid, rows, value, slope)
        combine(tables[0], rows, value, weights[0][b], rigid)
        mass[0] = rigid[0]
        combine(tables[0], rows, slope, weights[0][b], rigid)
        mass_slope[0] = rigid[0]
        multiply(mass, a[b], r)
        multiply(mass_slope, v[b], moved)
        power = 0.0
        for i in range(n_eta):
            power += v[b, i] * moved[i]
            r[i] += v[b, 0] * moved[i]
        r[0] -= 0.5 * power
        multiply(stiffness, q[b, 1:], bent)
        multiply(stiffness_slope, q[b, 1:], turned)
        speed = v[b, 0]
        for i in range(n_eta - 1):
            r[1 + i] += bent[i] - coupling[i] * speed * speed
            r[0] += 2.0 * coupling[i] * (q[b, 1 + i] * a[b, 0] + v[b, 1 + i] * speed)
            r[0] += q[b, 1 + i] * (coupling_slope[i] * speed * speed + 0.5 * turned[i])
        if amplitudes.size > 0:
            for i in range(n_eta):
                r[i] -= load[i]
            for i in range(1, n_eta):
                r[0] -= load_slope[i] * q[b, i]
        if fresh:
            factor = factors[b]
            for e in range(mass.size):
                factor[e] = gain_a * mass[e]
            factor[0] += mass_slope[0] * (gain_v * speed + a[b, 0])
            at = 1
            of = 0
            for i in range(1, n_eta):
                for j in range(i):
                    factor[at + 1 + j] += stiffness[of + j]
                at += i + 1
                of += i
            if not factorise(factor, n_eta):
                size[b] = np.nan
                continue
        substitute(factors[b], r)
        largest = 0.0
        for i in range(n_eta):
            q[b, i] -= r[i]
            v[b, i] -= gain_v * r[i]
            a[b, i] -= gain_a * r[i]
            largest = max(largest, abs(r[i]) * scale[i])
            if not np.isfinite(r[i]):
                largest = np.nan
                break
        size[b] = largest
