"""Residual of the reduced Lagrangian and its exact derivatives, of LANES states at once; compiled.

The equations are those of `reduced.lagrangian`, written with the whole mass matrix, w = delta', and a sum over
equal indices::

    Mass_kl = M_kl + 2 b_kl.delta - delta^T c_kl delta,    Mass_kd = M_kd - A_k delta,    Mass_dd = M_dd
    r = Mass eta'' + (d/dt Mass) eta' - 1/2 d(eta'^T Mass eta')/d eta + d U/d eta + D eta' - a Q

The engine's iteration matrix leaves out what hardly matters to Newton's method. Here all of it is kept, ::

    d r/d eta'' = Mass,     d r/d eta' = d/dt Mass + P - P^T + D,     P_xy = sum_z (d Mass_xz/d eta_y) eta_z',

and d r/d delta. The residual is linear in the tables, so that its derivative with theta_k, or with a parameter, is the
residual itself of the tables' derivatives: `fill_residual` serves for all three. Entries of tables are in the order of
`Layout`, with their jets, (n_entries, n_jets); what belongs to a derivative of the tables has its place in a jet for
a number (`jets.second`). All arrays are of vectors, without their axis of lanes (`lane_items.items`).
"""

from __future__ import annotations

from pgmp_petsc.gradients.jets import second
from pgmp_petsc.runtime.compiled import njit
from pgmp_petsc.runtime.vectors import spread


@njit(counted=False)
def _clear(matrix):
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            matrix[i, j] = spread(0.0)


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_matrices(layout, jets, load_jets, delta, n_rows, matrices):
    """Fill the matrices of a deformed state, of the tables and of their derivatives.

    Parameters
    ----------
    jets, load_jets
        Of the tables (layout.end, n_jets) and of all loads together, with their amplitudes (layout.load_end, n_jets).
    delta
        Flexible coordinates (n_delta,).
    n_rows
        How many numbers of the jets are wanted.
    matrices
        Mass (n_jets, n_eta, n_eta), ``b_kl - c_kl delta`` (n_jets, n_theta, n_theta, n_delta), ``K - a B`` and what of
        second order in delta adds to the tangent, ``V delta``, each (n_jets, n_delta, n_delta).
    """
    mass, lean, linear, bent = matrices
    for row in range(n_rows):
        _fill_lean(layout, jets, row, delta, lean[row])
        _fill_mass(layout, jets, row, delta, lean[row], mass[row])
        _fill_stiffness(layout, jets, load_jets, row, delta, linear[row], bent[row])


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _fill_lean(layout, jets, row, delta, lean):
    r = len(layout.rigid)
    m = layout.n_eta - r
    pair = 0
    for k in range(r):
        for l in range(k + 1):
            for i in range(m):
                lean[k, l, i] = jets[layout.coupling + pair * m + i, row]
            if layout.cubic < layout.damping:
                at = layout.swing + pair * (m * (m + 1) // 2)
                for i in range(m):
                    total = lean[k, l, i]
                    for j in range(i):
                        total -= jets[at, row] * delta[j]
                        lean[k, l, j] -= jets[at, row] * delta[i]
                        at += 1
                    lean[k, l, i] = total - jets[at, row] * delta[i]
                    at += 1
            for i in range(m):
                lean[l, k, i] = lean[k, l, i]
            pair += 1


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _fill_mass(layout, jets, row, delta, lean, mass):
    r, n = len(layout.rigid), layout.n_eta
    m = n - r
    entry = 0
    for x in range(n):
        for y in range(x + 1):
            mass[x, y] = mass[y, x] = jets[entry, row]
            entry += 1
    at = layout.coupling
    for k in range(r):
        for l in range(k + 1):
            leant = mass[k, l]
            for i in range(m):
                leant += (jets[at, row] + lean[k, l, i]) * delta[i]  # 2 b_kl.delta - delta^T c_kl delta
                at += 1
            mass[k, l] = mass[l, k] = leant
    if layout.cubic < layout.damping:
        at = layout.gyroscopic
        for k in range(r):
            for i in range(m):
                swept = mass[k, r + i]
                for j in range(i):
                    swept -= jets[at, row] * delta[j]  # - A_k delta
                    mass[k, r + j] += jets[at, row] * delta[i]
                    at += 1
                mass[k, r + i] = swept
            for i in range(m):
                mass[r + i, k] = mass[k, r + i]


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _fill_stiffness(layout, jets, load_jets, row, delta, linear, bent):
    r = len(layout.rigid)
    m = layout.n_eta - r
    entry = layout.stiffness
    for i in range(m):
        for j in range(i + 1):
            linear[i, j] = linear[j, i] = jets[entry, row]
            entry += 1
    _clear(bent)
    if layout.cubic == layout.damping:
        return
    entry, of_load = layout.cubic, layout.n_eta
    for i in range(m):
        for j in range(i + 1):
            linear[i, j] -= load_jets[of_load, row]
            linear[j, i] = linear[i, j]
            of_load += 1
            total = bent[i, j]
            for k in range(j):
                total += jets[entry, row] * delta[k]
                bent[i, k] += jets[entry, row] * delta[j]
                if j < i:
                    bent[j, k] += jets[entry, row] * delta[i]
                entry += 1
            # two equal indices, or all three
            bent[i, j] = total + jets[entry, row] * delta[j]
            if j < i:
                bent[j, j] += jets[entry, row] * delta[i]
            entry += 1
    for i in range(m):
        for j in range(i):
            bent[j, i] = bent[i, j]


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _fill_swept(layout, jets, row, x, swept):
    """Fill ``A_k x`` for a vector x (n_delta,), shape (n_theta, n_delta)."""
    _clear(swept)
    if layout.cubic < layout.damping:
        at = layout.gyroscopic
        for k in range(len(layout.rigid)):
            for i in range(layout.n_eta - len(layout.rigid)):
                total = swept[k, i]
                for j in range(i):
                    total += jets[at, row] * x[j]
                    swept[k, j] -= jets[at, row] * x[i]
                    at += 1
                swept[k, i] = total


@njit(error_model="numpy", counted=False)
def take_up(layout, q, rate, a, mass_damping, moment):
    """Fill coordinates, velocities and accelerations as inertia forces see them, and velocities, shape (4, n_eta)."""
    for x in range(layout.n_eta):
        moment[0, x], moment[3, x] = q[x], rate[x]
        moment[1, x] = rate[x] if layout.quadratic else spread(0.0)
        moment[2, x] = a[x] + mass_damping * rate[x]


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_residual(layout, jets, load_jets, matrices, row, moment, swept, result):
    """Fill the residual (n_eta,).

    Parameters
    ----------
    jets, load_jets, matrices
        See `fill_matrices`.
    row
        Place in a jet of what is taken for the tables: 0 for the residual, ``1 + k`` for its derivative with theta_k as
        far as it is the tables'.
    moment
        See `take_up`.
    swept
        Room (n_theta, n_delta).
    """
    mass, lean, linear, bent = matrices
    r, n = len(layout.rigid), layout.n_eta
    m = n - r
    q, v, a, rate = moment
    delta, w = q[r:], v[r:]
    for x in range(n):
        total = -load_jets[x, row]  # - a Q
        for y in range(n):
            total += mass[row, x, y] * a[y]
        result[x] = total
    for i in range(m):
        total = result[r + i]
        for j in range(m):
            total += (linear[row, i, j] + 0.5 * bent[row, i, j]) * delta[j]
        result[r + i] = total
    if layout.damping < layout.end:
        entry = layout.damping
        for x in range(n):
            total = result[x]
            for y in range(x):
                total += jets[entry, row] * rate[y]
                result[y] += jets[entry, row] * rate[x]
                entry += 1
            result[x] = total + jets[entry, row] * rate[x]
            entry += 1
    _fill_swept(layout, jets, row, w, swept)
    for k in range(r):
        for l in range(r):
            turning, leaning = v[k] * v[l], spread(0.0)
            for i in range(m):
                leaning += lean[row, k, l, i] * w[i]
                result[r + i] -= lean[row, k, l, i] * turning
            result[k] += 2.0 * leaning * v[l]  # (d Mass_kl/d delta).delta' theta_l'
        for i in range(m):
            result[r + i] -= 2.0 * v[k] * swept[k, i]  # - 2 theta_k' A_k delta'
    for h in range(r):
        slope = 1 + h if row == 0 else second(r, row - 1, h)
        twice, bending = spread(0.0), spread(0.0)
        for x in range(n):
            along = spread(0.0)
            for y in range(n):
                along += mass[slope, x, y] * v[y]
            result[x] += v[h] * along  # theta_h' (d_h Mass) eta'
            twice += v[x] * along
        for i in range(m):
            pulled = -load_jets[r + i, slope]
            for j in range(m):
                pulled += (0.5 * linear[slope, i, j] + (1.0 / 6.0) * bent[slope, i, j]) * delta[j]
            bending += pulled * delta[i]
        result[h] += bending - 0.5 * twice  # - 1/2 eta'^T (d_h Mass) eta'


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_tangents(layout, jets, load_jets, matrices, moment, mass_damping, swept, by_q, by_v, by_a):
    """Fill the derivatives (n_eta, n_eta) of the residual with coordinates, velocities and accelerations.

    Columns of theta of `by_q`, in which tables have second derivatives, are left to `fill_columns`. Parameters as of
    `fill_residual`.
    """
    mass, lean, linear, bent = matrices
    r, n = len(layout.rigid), layout.n_eta
    m = n - r
    q, v, a, _ = moment
    delta, w = q[r:], v[r:]
    for x in range(n):
        for y in range(n):
            by_a[x, y] = mass[0, x, y]
            total = mass_damping * by_a[x, y]
            for h in range(r):
                total += v[h] * mass[1 + h, x, y]
            by_v[x, y] = total
            by_q[x, y] = spread(0.0) if x < r or y < r else linear[0, x - r, y - r] + bent[0, x - r, y - r]
    if layout.damping < layout.end:
        entry = layout.damping
        for x in range(n):
            for y in range(x):
                by_v[x, y] += jets[entry, 0]
                by_v[y, x] += jets[entry, 0]
                entry += 1
            by_v[x, x] += jets[entry, 0]
            entry += 1
    _fill_swept(layout, jets, 0, w, swept)
    for k in range(r):
        for l in range(r):
            for i in range(m):
                leant = 2.0 * lean[0, k, l, i]
                by_v[k, l] += leant * w[i]
                by_v[k, r + i] += leant * v[l]
                by_v[r + i, k] -= leant * v[l]
                by_q[k, r + i] += leant * a[l]
        for i in range(m):
            by_v[r + i, k] -= 2.0 * swept[k, i]
    _fill_swept(layout, jets, 0, a[r:], swept)
    for k in range(r):
        for i in range(m):
            by_q[k, r + i] += swept[k, i]
    if layout.cubic < layout.damping:
        _add_second_order(layout, jets, v, a, by_q, by_v)
    for h in range(r):
        slope = 1 + h
        for x in range(n):
            along = spread(0.0)
            for y in range(n):
                along += mass[slope, x, y] * v[y]
            by_v[x, h] += along
            by_v[h, x] -= along
        _fill_swept(layout, jets, slope, w, swept)
        for k in range(r):
            for l in range(r):
                turning, drift = v[k] * v[l], 2.0 * v[h] * v[l]
                for i in range(m):
                    by_q[k, r + i] += drift * lean[slope, k, l, i]
                    by_q[h, r + i] -= turning * lean[slope, k, l, i]
            for i in range(m):
                by_q[k, r + i] += v[h] * swept[k, i]
                by_q[h, r + i] -= v[k] * swept[k, i]
        for i in range(m):
            pulled = -load_jets[r + i, slope]
            for j in range(m):
                pulled += (linear[slope, i, j] + 0.5 * bent[slope, i, j]) * delta[j]
            by_q[h, r + i] += pulled


@njit(error_model="numpy", counted=False)
def fill_columns(layout, jets, load_jets, matrices, moment, swept, column, by_q):
    """Fill the columns of theta of `by_q`; `column` is room (n_eta,), other parameters as of `fill_residual`."""
    for k in range(len(layout.rigid)):
        fill_residual(layout, jets, load_jets, matrices, 1 + k, moment, swept, column)
        for x in range(layout.n_eta):
            by_q[x, k] = column[x]


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _add_second_order(layout, jets, v, a, by_q, by_v):
    """Add what c_kl and A_k, and the change of A_k with theta, have in the derivatives beside the mass matrix."""
    r = len(layout.rigid)
    m = layout.n_eta - r
    at = layout.swing
    for k in range(r):
        for l in range(k + 1):
            turning = (1.0 if k == l else 2.0) * v[k] * v[l]
            for i in range(m):
                x = r + i
                for j in range(i):
                    y = r + j
                    c = jets[at, 0]
                    by_q[x, y] += turning * c  # theta_k' theta_l' c_kl
                    by_q[y, x] += turning * c
                    by_q[k, x] -= 2.0 * c * v[y] * v[l]  # - 2 theta_l' c_kl delta'
                    by_q[k, y] -= 2.0 * c * v[x] * v[l]
                    if l < k:
                        by_q[l, x] -= 2.0 * c * v[y] * v[k]
                        by_q[l, y] -= 2.0 * c * v[x] * v[k]
                    at += 1
                c = jets[at, 0]
                by_q[x, x] += turning * c
                by_q[k, x] -= 2.0 * c * v[x] * v[l]
                if l < k:
                    by_q[l, x] -= 2.0 * c * v[x] * v[k]
                at += 1
    at = layout.gyroscopic
    for k in range(r):
        for i in range(m):
            for j in range(i):
                turned, swept = jets[at, 0] * a[k], 2.0 * v[k] * jets[at, 0]
                for h in range(r):
                    turned += jets[at, 1 + h] * v[h] * v[k]  # A_k theta_k'' + theta_k' sum_h theta_h' d_h A_k
                by_q[r + i, r + j] -= turned
                by_q[r + j, r + i] += turned
                by_v[r + i, r + j] -= swept
                by_v[r + j, r + i] += swept
                at += 1
