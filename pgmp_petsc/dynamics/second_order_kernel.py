"""Terms of second order in the deformation, for LANES samples at once, compiled.

The displacement ``1/2 chi_ij delta_i delta_j`` and the cubic strain energy (a quadratic manifold as of Jain et al.
2017, with the modal derivatives of Wu and Tiso 2016) and the change of the mode shapes with theta add to the
Lagrangian::

    L_2 = -1/6 V_ijk delta_i delta_j delta_k + 1/2 Q_ij delta_i delta_j - 1/2 theta'^2 c_ij delta_i delta_j
          + theta' A_ij delta_i delta_j'

    Q = sum amplitude f^T chi
    c = (d2 rho/d theta2)^T M chi - D^T M D,   A = skew part of D^T M Psi,   D = d(R Psi)/d theta

Q and the first part of c are the work of loads and inertia forces on the second-order displacement, which is called
geometric stiffness; the rest is the kinetic energy of modes that change with theta, their gyroscopic terms. Left out is
what vanishes at the nominal parameters, where chi is M-orthogonal to the basis and Psi is M-orthonormal:
``(d rho/d theta)^T M chi``, ``Psi^T M chi`` and the symmetric part of ``D^T M Psi``.
"""

from __future__ import annotations

from pgmp_petsc.dynamics.lanes import contract, multiply
from pgmp_petsc.runtime.compiled import njit


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
def multiply_skew(packed, first, n, x, skip, result):
    """Multiply skew matrices with ``x[skip:]``; packed as strict lower triangles row by row, from row `first` on."""
    n_lanes = result.shape[1]
    for i in range(n):
        for lane in range(n_lanes):
            result[i, lane] = 0.0
    at = first
    for i in range(n):
        for j in range(i):
            for lane in range(n_lanes):
                result[i, lane] += packed[at, lane] * x[skip + j, lane]
                result[j, lane] -= packed[at, lane] * x[skip + i, lane]
            at += 1


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def add_second_order(layout, work, loaded):
    """Add the second-order terms, for one rigid coordinate, to the residual ``work.balance``.

    ``work.bent`` becomes what they add to the stiffness, packed, shape (n_packed_delta, LANES); ``work.swung`` and
    ``work.skewed`` become ``c delta`` and ``A delta``, shape (n_delta, LANES).
    """
    q, v, a, terms, slopes, r = work.q, work.v, work.a, work.terms, work.slopes[0], work.balance
    load, load_slope, bent, swung, skewed = work.load, work.load_slope[0], work.bent, work.swung, work.skewed
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
    multiply_skew(slopes, layout.gyroscopic, m, q, 1, skewed)
    for i in range(m):
        for lane in range(n_lanes):
            r[1 + i, lane] -= v[0, lane] * v[0, lane] * skewed[i, lane]
    multiply_skew(terms, layout.gyroscopic, m, v, 1, skewed)
    for i in range(m):
        for lane in range(n_lanes):
            r[1 + i, lane] -= 2.0 * v[0, lane] * skewed[i, lane]
    multiply_skew(terms, layout.gyroscopic, m, q, 1, skewed)
    for i in range(m):
        for lane in range(n_lanes):
            r[0, lane] -= a[1 + i, lane] * skewed[i, lane]
            r[1 + i, lane] -= a[0, lane] * skewed[i, lane]
    for entry in range(m * (m + 1) // 2):
        for lane in range(n_lanes):
            bent[entry, lane] += v[0, lane] * v[0, lane] * terms[layout.swing + entry, lane]
            if loaded:
                bent[entry, lane] -= load[n + entry, lane]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def add_second_order_tangent(layout, work, gain_v, gain_a, factor, border):
    """Add the tangents of what `add_second_order` gave to the iteration matrix; see `iteration_matrix`.

    The flexible block stays symmetric: its gyroscopic part, of size ``theta' A`` beside ``gain_v M``, is left out.
    """
    q, v, a, bent, swung, skewed = work.q, work.v, work.a, work.bent, work.swung, work.skewed
    n_lanes = border.shape[1]
    m = layout.n_eta - 1
    for entry in range(m * (m + 1) // 2):
        for lane in range(n_lanes):
            factor[entry, lane] += bent[entry, lane]
    for i in range(m):
        for lane in range(n_lanes):
            speed, swing = v[0, lane], swung[i, lane]
            border[1 + i, lane] += 2.0 * gain_v * speed * swing - gain_a[lane] * skewed[i, lane]
            border[1 + m + i, lane] -= gain_a[lane] * skewed[i, lane]
            border[1 + m + i, lane] -= 2.0 * (gain_v * speed + a[0, lane]) * swing
            border[0, lane] -= (gain_a[lane] * q[1 + i, lane] + 2.0 * gain_v * v[1 + i, lane]) * swing
