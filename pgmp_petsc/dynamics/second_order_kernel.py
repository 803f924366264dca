"""Terms of second order in the deformation, for LANES samples at once, compiled.

The displacement ``1/2 chi_ij delta_i delta_j`` and the cubic strain energy add to the Lagrangian (Wu and Tiso 2016, for
free bodies; here about the rigid motion of a mechanism)::

    L_2 = -1/6 V_ijk delta_i delta_j delta_k - 1/2 theta'^2 c_ij delta_i delta_j + 1/2 Q_ij delta_i delta_j

with ``c = (d2 rho/d theta2)^T M chi`` and ``Q = sum amplitude f^T chi``: the work of inertia forces and loads on the
second-order displacement, which is what is called geometric stiffness. ``(d rho/d theta)^T M chi`` vanishes where chi is
M-orthogonal to the rigid motion, that is at the nominal parameters, and is left out elsewhere, as are products of
``theta' delta delta'``.
"""

from __future__ import annotations

from numba import njit

from pgmp_petsc.dynamics.lanes import LANES, contract, multiply


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def cubic_form(packed, first, n, x, skip, result):
    """Return ``T_ijk x_i x_j x_k`` for tensors packed as in `contract`, in result (LANES,)."""
    n_lanes = packed.shape[1]
    for lane in range(n_lanes):
        result[lane] = 0.0
    at = first
    for i in range(n):
        for j in range(i + 1):
            for k in range(j + 1):
                same = 1.0 if i == k else (3.0 if i == j or j == k else 6.0)
                for lane in range(n_lanes):
                    result[lane] += same * packed[at, lane] * x[skip + i, lane] * x[skip + j, lane] * x[skip + k, lane]
                at += 1


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def add_second_order(layout, q, v, a, terms, slopes, load, load_slope, loaded, bent, swung, r):
    """Add the second-order terms to the residual r (n_eta, LANES).

    Parameters
    ----------
    layout, q, v, a, terms, slopes, load, load_slope, loaded
        As for `residual`.
    bent
        Result: what they add to the stiffness, packed, shape (n_packed_delta, LANES).
    swung
        Result: ``c delta``, shape (n_delta, LANES).
    """
    n_lanes = r.shape[1]
    n, m = layout.n_eta, layout.n_eta - 1
    contract(terms, layout.cubic, m, q, 1, bent)
    multiply(bent, 0, m, q, 1, swung)
    for i in range(m):
        for lane in range(n_lanes):
            r[1 + i, lane] += 0.5 * swung[i, lane]
    cubic_form(slopes, layout.cubic, m, q, 1, swung[0])
    for lane in range(n_lanes):
        r[0, lane] += swung[0, lane] / 6.0
    if loaded:
        multiply(load_slope, n, m, q, 1, swung)
        for i in range(m):
            for lane in range(n_lanes):
                r[0, lane] -= 0.5 * q[1 + i, lane] * swung[i, lane]
        multiply(load, n, m, q, 1, swung)
        for i in range(m):
            for lane in range(n_lanes):
                r[1 + i, lane] -= swung[i, lane]
    multiply(slopes, layout.swing, m, q, 1, swung)
    for i in range(m):
        for lane in range(n_lanes):
            r[0, lane] -= 0.5 * v[0, lane] * v[0, lane] * q[1 + i, lane] * swung[i, lane]
    multiply(terms, layout.swing, m, q, 1, swung)
    for i in range(m):
        for lane in range(n_lanes):
            r[1 + i, lane] += v[0, lane] * v[0, lane] * swung[i, lane]
            rate = a[0, lane] * q[1 + i, lane] + 2.0 * v[0, lane] * v[1 + i, lane]
            r[0, lane] -= rate * swung[i, lane]
    for entry in range(m * (m + 1) // 2):
        for lane in range(n_lanes):
            bent[entry, lane] += v[0, lane] * v[0, lane] * terms[layout.swing + entry, lane]
            if loaded:
                bent[entry, lane] -= load[n + entry, lane]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def add_second_order_tangent(layout, q, v, a, bent, swung, gain_v, gain_a, factor, border):
    """Add the tangents of what `add_second_order` gave to the iteration matrix; see `iteration_matrix`."""
    n_lanes = border.shape[1]
    m = layout.n_eta - 1
    for entry in range(m * (m + 1) // 2):
        for lane in range(n_lanes):
            factor[entry, lane] += bent[entry, lane]
    for i in range(m):
        for lane in range(n_lanes):
            speed, swing = v[0, lane], swung[i, lane]
            border[1 + i, lane] += 2.0 * gain_v * speed * swing
            border[1 + m + i, lane] -= 2.0 * (gain_v * speed + a[0, lane]) * swing
            border[0, lane] -= (gain_a * q[1 + i, lane] + 2.0 * gain_v * v[1 + i, lane]) * swing
