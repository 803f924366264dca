"""Residual of the reduced Lagrangian and its exact derivatives, of LANES states at once; compiled.

The equations are those of `dynamics.reduced_lagrangian`, written with the whole mass matrix, w = delta', and a sum over
equal indices::

    Mass_kl = M_kl + 2 b_kl.delta - delta^T c_kl delta,    Mass_kd = M_kd - A_k delta,    Mass_dd = M_dd
    r = Mass eta'' + (d/dt Mass) eta' - 1/2 d(eta'^T Mass eta')/d eta + d U/d eta + D eta' - a Q

The engine's iteration matrix leaves out what hardly matters to Newton's method. Here all of it is kept, ::

    d r/d eta'' = Mass,     d r/d eta' = d/dt Mass + P - P^T + D,     P_xy = sum_z (d Mass_xz/d eta_y) eta_z',

and d r/d delta. The residual is linear in the tables, so that its derivative with theta_k, or with a parameter, is the
residual itself of the tables' derivatives: `fill_residual` serves for all three. Entries of tables are in the order of
`Layout`; `value` and `slope` (n_theta, n_entries) are their values and derivatives with theta. All arrays are of
vectors, without their axis of lanes (`lane_items.items`).
"""

from __future__ import annotations

from pgmp_petsc.gradients.jets import second
from pgmp_petsc.runtime.compiled import njit
from pgmp_petsc.runtime.vectors import spread


@njit(counted=False)
def clear(matrix):
    """Put zeros into a matrix."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            matrix[i, j] = spread(0.0)


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_mass(layout, value, delta, mass):
    """Fill the mass matrix (n_eta, n_eta) of a deformed state, or its derivative with the tables' derivatives."""
    r, n = len(layout.rigid), layout.n_eta
    m = n - r
    entry = 0
    for x in range(n):
        for y in range(x + 1):
            mass[x, y] = mass[y, x] = value[entry]
            entry += 1
    pair = 0
    for k in range(r):
        for l in range(k + 1):
            leant = spread(0.0)
            for i in range(m):
                leant += 2.0 * value[layout.coupling + pair * m + i] * delta[i]  # 2 b_kl.delta
            if layout.cubic < layout.damping:
                at = layout.swing + pair * (m * (m + 1) // 2)
                for i in range(m):
                    for j in range(i + 1):
                        leant -= (1.0 if i == j else 2.0) * value[at] * delta[i] * delta[j]  # - delta^T c_kl delta
                        at += 1
            mass[k, l] += leant
            if l < k:
                mass[l, k] += leant
            pair += 1
    if layout.cubic < layout.damping:
        at = layout.gyroscopic
        for k in range(r):
            for i in range(m):
                for j in range(i):
                    mass[k, r + i] -= value[at] * delta[j]  # - A_k delta
                    mass[k, r + j] += value[at] * delta[i]
                    at += 1
            for i in range(m):
                mass[r + i, k] = mass[k, r + i]


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_lean(layout, value, delta, lean):
    """Fill ``b_kl - c_kl delta``, shape (n_theta, n_theta, n_delta)."""
    r = len(layout.rigid)
    m = layout.n_eta - r
    pair = 0
    for k in range(r):
        for l in range(k + 1):
            for i in range(m):
                lean[k, l, i] = value[layout.coupling + pair * m + i]
            if layout.cubic < layout.damping:
                at = layout.swing + pair * (m * (m + 1) // 2)
                for i in range(m):
                    for j in range(i + 1):
                        lean[k, l, i] -= value[at] * delta[j]
                        if j < i:
                            lean[k, l, j] -= value[at] * delta[i]
                        at += 1
            for i in range(m):
                lean[l, k, i] = lean[k, l, i]
            pair += 1


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_swept(layout, value, x, swept):
    """Fill ``A_k x`` for a vector x (n_delta,), shape (n_theta, n_delta)."""
    r = len(layout.rigid)
    clear(swept)
    if layout.cubic < layout.damping:
        at = layout.gyroscopic
        for k in range(r):
            for i in range(layout.n_eta - r):
                for j in range(i):
                    swept[k, i] += value[at] * x[j]
                    swept[k, j] -= value[at] * x[i]
                    at += 1


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_stiffness(layout, value, load, delta, linear, bent):
    """Fill ``K - a B``, and what of second order in delta adds to the tangent, ``V delta``, each (n_delta, n_delta)."""
    r = len(layout.rigid)
    m = layout.n_eta - r
    entry = layout.stiffness
    for i in range(m):
        for j in range(i + 1):
            linear[i, j] = linear[j, i] = value[entry]
            entry += 1
    clear(bent)
    if layout.cubic == layout.damping:
        return
    entry, of_load = layout.cubic, layout.n_eta
    for i in range(m):
        for j in range(i + 1):
            linear[i, j] -= load[of_load]
            if j < i:
                linear[j, i] -= load[of_load]
            of_load += 1
            for k in range(j):
                bent[i, j] += value[entry] * delta[k]
                bent[i, k] += value[entry] * delta[j]
                if j < i:
                    bent[j, k] += value[entry] * delta[i]
                entry += 1
            # two equal indices, or all three
            bent[i, j] += value[entry] * delta[j]
            if j < i:
                bent[j, j] += value[entry] * delta[i]
            entry += 1
    for i in range(m):
        for j in range(i):
            bent[j, i] = bent[i, j]


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_damping(layout, value, damping):
    """Fill D (n_eta, n_eta), zero where there is none."""
    clear(damping)
    entry = layout.damping
    if entry < layout.end:
        for x in range(layout.n_eta):
            for y in range(x + 1):
                damping[x, y] = damping[y, x] = value[entry]
                entry += 1


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_residual(layout, value, slope, load, load_slope, moment, work, result):
    """Fill the residual, shape (n_eta,).

    Parameters
    ----------
    load, load_slope
        Of all loads together, with their amplitudes, shapes (load_end,) and (n_theta, load_end).
    moment
        Coordinates, velocities and accelerations as inertia forces see them, and velocities (4, n_eta); see `take_up`.
    work
        Matrices: (n_eta, n_eta), (n_theta, n_theta, n_delta), (n_theta, n_delta), twice (n_delta, n_delta), and
        (n_eta, n_eta).
    """
    mass, lean, swept, linear, bent, damping = work
    r, n = len(layout.rigid), layout.n_eta
    m = n - r
    q, v, a, rate = moment
    delta, w = q[r:], v[r:]
    fill_mass(layout, value, delta, mass)
    fill_damping(layout, value, damping)
    for x in range(n):
        result[x] = -load[x]  # - a Q
        for y in range(n):
            result[x] += mass[x, y] * a[y] + damping[x, y] * rate[y]
    fill_stiffness(layout, value, load, delta, linear, bent)
    for i in range(m):
        for j in range(m):
            result[r + i] += (linear[i, j] + 0.5 * bent[i, j]) * delta[j]
    fill_lean(layout, value, delta, lean)
    fill_swept(layout, value, w, swept)
    for k in range(r):
        for l in range(r):
            for i in range(m):
                result[k] += 2.0 * lean[k, l, i] * w[i] * v[l]  # (d Mass_kl/d delta).delta' theta_l'
                result[r + i] -= lean[k, l, i] * v[k] * v[l]
        for i in range(m):
            result[r + i] -= 2.0 * v[k] * swept[k, i]  # - 2 theta_k' A_k delta'
    for h in range(r):
        fill_mass(layout, slope[h], delta, mass)
        for x in range(n):
            along = spread(0.0)
            for y in range(n):
                along += mass[x, y] * v[y]
            result[x] += v[h] * along  # theta_h' (d_h Mass) eta'
            result[h] -= 0.5 * v[x] * along  # - 1/2 eta'^T (d_h Mass) eta'
        fill_stiffness(layout, slope[h], load_slope[h], delta, linear, bent)
        for i in range(m):
            result[h] -= load_slope[h, r + i] * delta[i]
            for j in range(m):
                result[h] += delta[i] * (0.5 * linear[i, j] + (1.0 / 6.0) * bent[i, j]) * delta[j]


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_derivatives(layout, value, slope, load, load_slope, moment, work, by_q, by_v, by_a):
    """Fill the derivatives (n_eta, n_eta) of the residual with eta'', eta' and the flexible coordinates.

    Columns of theta of `by_q` are left to the tables' derivatives. Parameters as of `fill_residual`.
    """
    mass, lean, swept, linear, bent, damping = work
    r, n = len(layout.rigid), layout.n_eta
    m = n - r
    q, v, a, _ = moment
    delta, w = q[r:], v[r:]
    fill_mass(layout, value, delta, by_a)
    fill_damping(layout, value, by_v)
    clear(by_q)
    fill_stiffness(layout, value, load, delta, linear, bent)
    for i in range(m):
        for j in range(m):
            by_q[r + i, r + j] += linear[i, j] + bent[i, j]
    fill_lean(layout, value, delta, lean)
    fill_swept(layout, value, w, swept)
    for k in range(r):
        for l in range(r):
            for i in range(m):
                by_v[k, l] += 2.0 * lean[k, l, i] * w[i]
                by_v[k, r + i] += 2.0 * lean[k, l, i] * v[l]
                by_v[r + i, k] -= 2.0 * lean[k, l, i] * v[l]
                by_q[k, r + i] += 2.0 * lean[k, l, i] * a[l]
        for i in range(m):
            by_v[r + i, k] -= 2.0 * swept[k, i]
    fill_swept(layout, value, a[r:], swept)
    for k in range(r):
        for i in range(m):
            by_q[k, r + i] += swept[k, i]
    if layout.cubic < layout.damping:
        _add_second_order(layout, value, slope, v, a, by_q, by_v)
    for h in range(r):
        fill_mass(layout, slope[h], delta, mass)
        for x in range(n):
            along = spread(0.0)
            for y in range(n):
                along += mass[x, y] * v[y]
                by_v[x, y] += v[h] * mass[x, y]
            by_v[x, h] += along
            by_v[h, x] -= along
        fill_lean(layout, slope[h], delta, lean)
        fill_swept(layout, slope[h], w, swept)
        for k in range(r):
            for i in range(m):
                for l in range(r):
                    by_q[k, r + i] += 2.0 * v[h] * lean[k, l, i] * v[l]
                    by_q[h, r + i] -= lean[k, l, i] * v[k] * v[l]
                by_q[k, r + i] += v[h] * swept[k, i]
                by_q[h, r + i] -= v[k] * swept[k, i]
        fill_stiffness(layout, slope[h], load_slope[h], delta, linear, bent)
        for i in range(m):
            by_q[h, r + i] -= load_slope[h, r + i]
            for j in range(m):
                by_q[h, r + i] += (linear[i, j] + 0.5 * bent[i, j]) * delta[j]


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _add_second_order(layout, value, slope, v, a, by_q, by_v):
    """Add what c_kl and A_k, and the change of A_k with theta, have in the derivatives beside the mass matrix."""
    r = len(layout.rigid)
    m = layout.n_eta - r
    pair, n_packed = 0, m * (m + 1) // 2
    for k in range(r):
        for l in range(k + 1):
            both = 1.0 if k == l else 2.0
            at = layout.swing + pair * n_packed
            for i in range(m):
                for j in range(i + 1):
                    for turn in range(1 if i == j else 2):
                        x, y = (r + i, r + j) if turn == 0 else (r + j, r + i)
                        by_q[x, y] += both * v[k] * v[l] * value[at]  # theta_k' theta_l' c_kl
                        by_q[k, x] -= 2.0 * value[at] * v[y] * v[l]  # - 2 theta_l' c_kl delta'
                        if l < k:
                            by_q[l, x] -= 2.0 * value[at] * v[y] * v[k]
                    at += 1
            pair += 1
    at = layout.gyroscopic
    for k in range(r):
        for i in range(m):
            for j in range(i):
                turned = value[at] * a[k]  # A_k theta_k'' + theta_k' sum_h theta_h' d_h A_k
                for h in range(r):
                    turned += slope[h, at] * v[h] * v[k]
                by_q[r + i, r + j] -= turned
                by_q[r + j, r + i] += turned
                by_v[r + i, r + j] -= 2.0 * v[k] * value[at]
                by_v[r + j, r + i] += 2.0 * v[k] * value[at]
                at += 1


@njit(error_model="numpy", counted=False)
def take_up(layout, q, rate, a, mass_damping, moment):
    """Fill coordinates, velocities and accelerations as inertia forces see them, and velocities, shape (4, n_eta)."""
    for x in range(layout.n_eta):
        moment[0, x], moment[3, x] = q[x], rate[x]
        moment[1, x] = rate[x] if layout.quadratic else spread(0.0)
        moment[2, x] = a[x] + mass_damping * rate[x]


@njit(error_model="numpy", counted=False)
def fill_balance(layout, jet, load_jet, moment, work, residual):
    """Fill the residual (n_eta,), from the tables' jets."""
    first = slice(1, 1 + len(layout.rigid))
    fill_residual(layout, jet[0], jet[first], load_jet[0], load_jet[first], moment, work, residual)


@njit(error_model="numpy", counted=False)
def fill_tangents(layout, jet, load_jet, moment, mass_damping, work, by_q, by_v, by_a):
    """Fill the derivatives of the residual with a state (n_eta, n_eta), from the tables' jets.

    Columns of theta of `by_q`, in which tables have second derivatives, are left to `fill_columns`.
    """
    first = slice(1, 1 + len(layout.rigid))
    fill_derivatives(layout, jet[0], jet[first], load_jet[0], load_jet[first], moment, work, by_q, by_v, by_a)
    for x in range(layout.n_eta):
        for y in range(layout.n_eta):
            by_v[x, y] += mass_damping * by_a[x, y]


@njit(error_model="numpy", counted=False)
def fill_columns(layout, jet, load_jet, moment, work, slopes, column, by_q):
    """Fill the columns of theta of `by_q`.

    `slopes` and `column` are room for second derivatives of tables, (n_theta, n_entries) of terms and of loads, and for
    a column (n_eta,).
    """
    r = len(layout.rigid)
    slope, load_slope = slopes
    for k in range(r):
        for h in range(r):
            row = second(r, k, h)
            for entry in range(slope.shape[1]):
                slope[h, entry] = jet[row, entry]
            for entry in range(load_slope.shape[1]):
                load_slope[h, entry] = load_jet[row, entry]
        fill_residual(layout, jet[1 + k], slope, load_jet[1 + k], load_slope, moment, work, column)
        for x in range(layout.n_eta):
            by_q[x, k] = column[x]
