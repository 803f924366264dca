"""The Lagrangian of the reduced model: residual and iteration matrix of LANES samples at once, compiled.

For any number of rigid coordinates theta_k and flexible ones delta, eta = [theta, delta]::

    T = 1/2 eta'^T Mass eta'      Mass_kl = M_kl + 2 b_kl.delta - delta^T c_kl delta
                                  Mass_kd = M_kd + (A_k^T + P_k) delta,    Mass_dd = M_dd
    U = 1/2 delta^T K delta + 1/6 V delta delta delta - a(t) (Q.eta + 1/2 delta^T B delta)

with tables that depend on theta, one index d for the flexible coordinates, and a(t) the amplitudes of the loads (Naets
et al. 2015, eqs. (11)-(12)). The residual is ``r = d/dt dT/d eta' - dT/d eta + dU/d eta``, d_k = d/d theta_k::

    r = M eta'' + sum_k theta_k' (d_k M) eta' + K delta - a Q + ...
        and in the rows of theta  - 1/2 eta'^T (d_k M) eta' + 1/2 delta^T (d_k K) delta - a (d_k Q).delta + ...

b, the symmetric part of ``(d_k rho)^T M (d_l Psi)``, and the changes of K and Q with theta are missing in the paper.
b holds the inertia forces of the rigid motion, which bend the bodies, and the change of the rigid inertia with their
bending. Without it the modes are blind to inertia loads, because their mass coupling with theta vanishes identically.

Of second order in delta, where a scene asks for them (a quadratic manifold as of Jain et al. 2017 with the modal
derivatives chi of Wu and Tiso 2016)::

    V = third derivative of the strain energy,  B = f^T chi
    c_kl = (d_k d_l rho)^T M chi - sym(D_k^T M D_l) - sym(d_l P_k),   P_k = (d_k rho)^T M chi,
    A_k = skew part of D_k^T M Psi,   D_k = d_k (R Psi)

B and the first part of c are the work of loads and inertia forces on the second-order displacement, which is called
geometric stiffness. So is what P_k does, of prescribed coordinates alone: with its part of c it is the kinetic energy
``theta_k' d/dt (1/2 delta^T P_k delta)``, whose forces are ``theta_k'' P_k delta``. The rest is the kinetic energy of
modes that change with theta, their gyroscopic terms. Left out is what vanishes at the nominal parameters, where chi is
M-orthogonal to the basis and to what is free to move, and Psi is M-orthonormal.

Structural damping adds ``D eta'``. Damping proportional to the mass, ``alpha dT/d eta'``, needs no term of its own:
because T is quadratic in eta', it is what ``alpha eta'`` added to eta'' makes of the inertia forces.

With all of it the system is Lagrangian in the interpolated tables and conserves energy. Terms that a scene does not
call for have no entries. The iteration matrix leaves out second derivatives of the tables. Its flexible block is
symmetric but for gyroscopic terms, rows and columns of theta border it.

Each function adds its part to the residual and, if `fresh`, to the iteration matrix.
"""

from __future__ import annotations

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.vectors import (
    add,
    add_product,
    add_to_rows,
    dot,
    load,
    load_rows,
    polynomial,
    polynomial_value,
    spread,
    store,
    zeros,
)
from pgmp_petsc.reduced.arrays import layout_n_rigid, pair


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def add_cubic(layout, kept, place, fresh, work, matrix):
    """Add the terms of ``1/6 V delta delta delta``; `bent` becomes ``V delta``."""
    q, balance, bent = work.q, work.balance, work.bent
    r = len(place)
    m = layout.n_eta - r
    for entry in range(m * (m + 1) // 2):
        store(bent, entry, 0.0)
    energy = zeros(place)  # (d V) delta delta delta
    at = layout.cubic
    for i in range(m):
        q_i = load(q, r + i)
        row_i = i * (i + 1) // 2
        for j in range(i + 1):
            q_j = load(q, r + j)
            row_j = j * (j + 1) // 2
            part = zeros(place)
            own = load(bent, row_i + j)
            # entries with equal indices are separate: they count once, others for each of their orders
            for k in range(j):
                value, slopes = polynomial(kept, at, place)
                q_k = load(q, r + k)
                own += value * q_k
                add(bent, row_i + k, value * q_j)
                if j < i:
                    add(bent, row_j + k, value * q_i)
                part = add_product(part, slopes, q_k)
                at += 1
            value, slopes = polynomial(kept, at, place)
            at += 1
            store(bent, row_i + j, own + value * q_j)
            if j < i:
                add(bent, row_j + j, value * q_i)
            product = q_i * q_j
            energy = add_product(energy, part, product * (6.0 if j < i else 3.0))
            energy = add_product(energy, slopes, product * q_j * (3.0 if j < i else 1.0))
    add_to_rows(balance, 0, 1, energy, spread(1.0 / 6.0))
    entry = 0
    for i in range(m):
        q_i, total = load(q, r + i), spread(0.0)
        for j in range(i):
            value = 0.5 * load(bent, entry + j)
            total += value * load(q, r + j)  # 1/2 (V delta) delta
            add(balance, r + j, value * q_i)
        add(balance, r + i, total + 0.5 * load(bent, entry + i) * q_i)
        entry += i + 1
    if fresh:
        for entry in range(m * (m + 1) // 2):
            add(matrix.factor, entry, load(bent, entry))


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def add_bent_loads(layout, place, fresh, work, matrix):
    """Add the terms of ``- 1/2 a delta^T B delta``."""
    q, balance = work.q, work.balance
    r, n = len(place), layout.n_eta
    energy = zeros(place)  # a delta^T (d B) delta
    entry = n
    for i in range(n - r):
        q_i = load(q, r + i)
        for j in range(i + 1):
            value = load(work.load, entry)
            slopes = load_rows(work.load_slope, entry, layout.load_end, place)
            product = q_i * load(q, r + j)
            if j < i:
                product = product + product
                add(balance, r + j, -(value * q_i))  # - a B delta
            add(balance, r + i, -(value * load(q, r + j)))
            energy = add_product(energy, slopes, product)
            if fresh:
                add(matrix.factor, entry - n, -value)
            entry += 1
    add_to_rows(balance, 0, 1, energy, spread(-0.5))


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def add_swing(layout, kept, place, velocity, gain_v, gain_a, fresh, work, matrix):
    """Add the terms of ``- 1/2 sum_kl theta_k' theta_l' delta^T c_kl delta``, pair by pair (k >= j)."""
    q, v, a, balance, swung = work.q, work.v, work.a, work.balance, work.along
    r, n = len(place), layout.n_eta
    m = n - r
    at = layout.swing
    for k in range(r):
        for j in range(k + 1):
            both = 1.0 if j == k else 2.0
            v_k, v_j, a_k, a_j = load(v, k), load(v, j), load(a, k), load(a, j)
            turning = both * v_k * v_j
            energy = zeros(place)  # delta^T (d c) delta
            entry = 0
            for i in range(m):
                q_i, total = load(q, r + i), spread(0.0)
                for other in range(i + 1):
                    c, slopes = polynomial(kept, at, place)
                    q_j = load(q, r + other)
                    product = q_i * q_j
                    if other < i:
                        product = product + product
                        add(swung, other, c * q_i)
                    total += c * q_j
                    energy = add_product(energy, slopes, product)
                    if fresh:
                        add(matrix.factor, entry, turning * c)
                    at += 1
                    entry += 1
                store(swung, i, total)
            held, moving = spread(0.0), spread(0.0)  # delta^T c delta, delta'^T c delta
            for i in range(m):
                c = load(swung, i)
                held += load(q, r + i) * c
                moving += load(v, r + i) * c
                add(balance, r + i, turning * c)  # theta_k' theta_j' c delta
                if fresh:
                    add(matrix.column, k * m + i, 2.0 * gain_v * (v_j * c))
                    add(matrix.row, k * m + i, -2.0 * ((gain_v * v_j + a_j) * c))
                    if j < k:
                        add(matrix.column, j * m + i, 2.0 * gain_v * (v_k * c))
                        add(matrix.row, j * m + i, -2.0 * ((gain_v * v_k + a_k) * c))
            drift = dot(energy, velocity)
            add(balance, k, -(held * a_j + 2.0 * (moving * v_j) + drift * v_j))  # - (delta^T c delta theta_j')'
            if j < k:
                add(balance, j, -(held * a_k + 2.0 * (moving * v_k) + drift * v_k))
            add_to_rows(balance, 0, 1, energy, 0.5 * turning)
            if fresh:
                add(matrix.corner, k * r + j, -(gain_a * held + 2.0 * gain_v * moving))
                if j < k:
                    add(matrix.corner, j * r + k, -(gain_a * held + 2.0 * gain_v * moving))


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def add_gyroscopic(layout, kept, place, velocity, gain_v, gain_a, fresh, work, matrix):
    """Add the terms ``sum_k theta_k' (A_k delta').delta``, A_k skew."""
    q, v, a, balance, skewed, driven = work.q, work.v, work.a, work.balance, work.along, work.across
    r, n = len(place), layout.n_eta
    m = n - r
    at = layout.gyroscopic
    for k in range(r):
        v_k, a_k = load(v, k), load(a, k)
        changing = zeros(place)  # delta'.(d A_k) delta
        pushed = a_k + 2.0 * (gain_v * v_k)
        entry = 0
        for i in range(m):
            q_i, v_i = load(q, r + i), load(v, r + i)
            skew, drive = spread(0.0), spread(0.0)
            for j in range(i):
                value, slopes = polynomial(kept, at, place)
                q_j, v_j = load(q, r + j), load(v, r + j)
                # 2 A delta' + A' delta, with A' = sum_h theta_h' d_h A
                change = dot(slopes, velocity)
                skew += value * q_j
                drive += 2.0 * (value * v_j) + change * q_j
                add(skewed, j, -(value * q_i))
                add(driven, j, -(2.0 * (value * v_i) + change * q_i))
                changing = add_product(changing, slopes, v_i * q_j - v_j * q_i)
                if fresh:
                    before = load(matrix.skew, entry) if k > 0 else spread(0.0)
                    store(matrix.skew, entry, before - (value * pushed + v_k * change))
                at += 1
                entry += 1
            entry += 1
            store(skewed, i, skew)
            store(driven, i, drive)
        total = spread(0.0)
        for i in range(m):
            skew = load(skewed, i)
            # - theta_k'' A delta - theta_k' (2 A delta' + A' delta)
            add(balance, r + i, -(a_k * skew + v_k * load(driven, i)))
            total += load(a, r + i) * skew
            if fresh:
                add(matrix.column, k * m + i, -(gain_a * skew))
                add(matrix.row, k * m + i, -(gain_a * skew))
        add(balance, k, -(total + dot(changing, velocity)))  # - delta''.(A delta) - delta'.(A' delta)
        add_to_rows(balance, 0, 1, changing, v_k)  # theta_k' delta'.(d A_k) delta


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def add_driven(layout, kept, place, velocity, fresh, work, matrix):
    """Add the terms ``sum_k theta_k' (P_k delta').delta`` of prescribed coordinates, P_k symmetric; no corrections of
    these, so that they have no part in the border of the iteration matrix."""
    q, v, a, balance = work.q, work.v, work.a, work.balance
    r, n = len(place), layout.n_eta
    m = n - r
    at = layout.driven
    for k in range(r):
        v_k, a_k = load(v, k), load(a, k)
        held, changing = spread(0.0), zeros(place)  # delta''.P delta + delta'.(P delta)', delta'.(d P_k) delta
        entry = 0
        for i in range(m):
            q_i, v_i, a_i = load(q, r + i), load(v, r + i), load(a, r + i)
            for j in range(i + 1):
                value, slopes = polynomial(kept, at, place)
                q_j, v_j = load(q, r + j), load(v, r + j)
                change = dot(slopes, velocity)
                pushed = a_k * value + v_k * change
                moved, pulled = v_i * q_j, a_i * q_j + v_i * v_j
                add(balance, r + i, pushed * q_j)  # theta_k'' P delta + theta_k' P' delta
                if j < i:
                    add(balance, r + j, pushed * q_i)
                    moved += v_j * q_i
                    pulled += load(a, r + j) * q_i + v_i * v_j
                held += value * pulled + change * moved
                changing = add_product(changing, slopes, moved)
                if fresh:
                    add(matrix.factor, entry, pushed)
                at += 1
                entry += 1
        add(balance, k, held)
        add_to_rows(balance, 0, 1, changing, -v_k)  # - theta_k' delta'.(d P_k) delta


@njit(inline="always")
def inertia_of(layout, kept, entry, place):
    """Return an entry of the inertia, with its derivatives where inertia forces quadratic in the velocities act."""
    if layout.quadratic:
        return polynomial(kept, entry, place)
    return polynomial_value(kept, entry, place), zeros(place)


@njit(cache=True, error_model="numpy", fastmath={"contract"}, counted=False)
def evaluate(layout, kept, place, gain_v, gain_a, fresh, loaded, work, matrix):
    """Evaluate the residual into ``work.balance`` and, if `fresh`, the iteration matrix; see `Work` and `Matrix`.

    `kept` are polynomials of the cell of every sample, weighted with its parameters: rows of `polynomial`; `place` is
    that in the cell, a tuple of vectors. The positions of `work` are those of the iterate, ``v`` and ``a`` what the
    inertia forces see; gain_v and gain_a are the derivatives of eta' and eta'' with eta within a step, vectors. The
    terms are inlined: to hand the many arrays on would take as long as to evaluate some of them.
    """
    velocity = load_rows(work.v, 0, 1, place)
    _add_inertia_and_stiffness(layout, kept, place, velocity, gain_v, gain_a, fresh, work, matrix)
    _add_rigid_rows(layout, velocity, gain_v, gain_a, fresh, loaded, work, matrix)
    _add_coupling(layout, kept, place, velocity, gain_v, gain_a, fresh, work, matrix)
    if layout.cubic < layout.damping:
        add_cubic(layout, kept, place, fresh, work, matrix)
        if loaded:
            add_bent_loads(layout, place, fresh, work, matrix)
        add_swing(layout, kept, place, velocity, gain_v, gain_a, fresh, work, matrix)
        add_gyroscopic(layout, kept, place, velocity, gain_v, gain_a, fresh, work, matrix)
    if layout.driven < layout.damping:
        add_driven(layout, kept, place, velocity, fresh, work, matrix)
    if layout.damping < layout.end:
        _add_damping(layout, kept, place, gain_v, fresh, work, matrix)


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _add_inertia_and_stiffness(layout, kept, place, velocity, gain_v, gain_a, fresh, work, matrix):
    """Begin with ``M eta'' + K delta``, and fill `moved`, `turned` and, if `fresh`, `pulled`."""
    q, v, a, balance, moved, turned = work.q, work.v, work.a, work.balance, work.moved, work.turned
    pulled = work.pulled
    r, n = len(place), layout.n_eta
    m = n - r
    for k in range(r):
        total, change, pull = spread(0.0), zeros(place), zeros(place)
        for j in range(r):
            slopes = load_rows(work.rigid_slope, pair(k, j), layout_n_rigid(r), place)
            total += load(work.rigid, pair(k, j)) * load(a, j)  # M_kj theta_j''
            change = add_product(change, slopes, load(v, j))  # (d M_kj) theta_j'
            pull = add_product(pull, slopes, load(a, j))  # (d M_kj) theta_j''
        store(balance, k, total)
        for h in range(r):
            store(moved, h * n + k, change[h])
            store(pulled, h * n + k, pull[h])
    entry = layout.stiffness
    into = 0
    for i in range(m):
        at = (r + i) * (r + i + 1) // 2
        a_i, v_i, q_i = load(a, r + i), load(v, r + i), load(q, r + i)
        total, change, pull, turn = spread(0.0), zeros(place), zeros(place), zeros(place)
        for k in range(r):
            mass, slopes = inertia_of(layout, kept, at + k, place)
            total += mass * load(a, k)  # M_ik theta_k''
            add(balance, k, mass * a_i)  # M_ki delta_i''
            change = add_product(change, slopes, load(v, k))  # (d M_ik) theta_k'
            add_to_rows(moved, k, n, slopes, v_i)  # (d M_ki) delta_i'
            if fresh:
                pull = add_product(pull, slopes, load(a, k))  # (d M_ik) theta_k''
                add_to_rows(pulled, k, n, slopes, a_i)  # (d M_ki) delta_i''
                coupled, swept = gain_a * mass, gain_v * dot(slopes, velocity)
                store(matrix.column, k * m + i, coupled + swept)
                store(matrix.row, k * m + i, coupled + swept)
        for j in range(i):
            mass, slopes = inertia_of(layout, kept, at + r + j, place)
            stiffness, bends = polynomial(kept, entry + j, place)
            total += mass * load(a, r + j) + stiffness * load(q, r + j)  # M_ij delta_j'' + K_ij delta_j
            change = add_product(change, slopes, load(v, r + j))  # (d M_ij) delta_j'
            turn = add_product(turn, bends, load(q, r + j))  # (d K_ij) delta_j
            add(balance, r + j, mass * a_i + stiffness * q_i)
            add_to_rows(moved, r + j, n, slopes, v_i)
            add_to_rows(turned, j, m, bends, q_i)
            if fresh:
                pull = add_product(pull, slopes, load(a, r + j))  # (d M_ij) delta_j''
                add_to_rows(pulled, r + j, n, slopes, a_i)
                store(matrix.factor, into, gain_a * mass + gain_v * dot(slopes, velocity) + stiffness)
            into += 1
        mass, slopes = inertia_of(layout, kept, at + r + i, place)
        stiffness, bends = polynomial(kept, entry + i, place)
        store(balance, r + i, total + mass * a_i + stiffness * q_i)
        change, turn = add_product(change, slopes, v_i), add_product(turn, bends, q_i)
        pull = add_product(pull, slopes, a_i)
        for h in range(r):
            store(moved, h * n + r + i, change[h])
            store(pulled, h * n + r + i, pull[h])
            store(turned, h * m + i, turn[h])
        if fresh:
            store(matrix.factor, into, gain_a * mass + gain_v * dot(slopes, velocity) + stiffness)
        into += 1
        entry += i + 1


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _add_rigid_rows(layout, velocity, gain_v, gain_a, fresh, loaded, work, matrix):
    """Add what `moved`, `turned` and the loads give, and begin the border of the iteration matrix."""
    q, v, balance, moved, turned = work.q, work.v, work.balance, work.moved, work.turned
    r, n = len(velocity), layout.n_eta
    m = n - r
    for k in range(r):
        twice, bending, leaning = spread(0.0), spread(0.0), spread(0.0)
        for i in range(n):
            change = load(moved, k * n + i)
            add(balance, i, load(v, k) * change)  # theta_k' (d_k M) eta'
            twice += load(v, i) * change
        for i in range(m):
            bending += load(q, r + i) * load(turned, k * m + i)
        if loaded:
            for i in range(m):
                slope = load(work.load_slope, k * layout.load_end + r + i)
                leaning += load(q, r + i) * slope
                add(turned, k * m + i, -slope)
        # 1/2 delta (d_k K) delta - 1/2 eta' (d_k M) eta' - d_k Q.delta
        add(balance, k, 0.5 * (bending - twice) - leaning)
    if loaded:
        for i in range(n):
            add(balance, i, -load(work.load, i))  # - a Q
    if fresh:
        for k in range(r):
            for i in range(m):
                turn, swing = load(turned, k * m + i), gain_v * load(moved, k * n + r + i)
                add(matrix.column, k * m + i, turn + swing + load(work.pulled, k * n + r + i))
                add(matrix.row, k * m + i, turn - swing)
            for j in range(r):
                total = gain_a * load(work.rigid, pair(k, j))
                total += gain_v * (load(moved, j * n + k) - load(moved, k * n + j)) + load(work.pulled, j * n + k)
                for h in range(r):
                    n_rigid = layout_n_rigid(r)
                    total += load(work.rigid_slope, h * n_rigid + pair(k, j)) * (gain_v * load(v, h))
                store(matrix.corner, k * r + j, total)


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _add_coupling(layout, kept, place, velocity, gain_v, gain_a, fresh, work, matrix):
    """Add the terms of ``sum_kl theta_k' theta_l' b_kl.delta`` of the kinetic energy, pair by pair (k >= j)."""
    q, v, a, balance, row, corner = work.q, work.v, work.a, work.balance, matrix.row, matrix.corner
    r, n = len(place), layout.n_eta
    m = n - r
    at = layout.coupling
    for k in range(r):
        for j in range(k + 1):
            both = 1.0 if j == k else 2.0
            v_k, v_j, a_k, a_j = load(v, k), load(v, j), load(a, k), load(a, j)
            turning = both * v_k * v_j
            leant, leaning = spread(0.0), spread(0.0)  # b.delta, b.delta'
            turned, turning_on = zeros(place), zeros(place)  # (d b).delta, (d b).delta'
            for i in range(m):
                b, slopes = inertia_of(layout, kept, at + i, place)
                q_i, v_i = load(q, r + i), load(v, r + i)
                add(balance, r + i, -(b * turning))  # - b theta_k' theta_j'
                leant, leaning = leant + b * q_i, leaning + b * v_i
                turned = add_product(turned, slopes, q_i)
                if fresh:
                    turning_on = add_product(turning_on, slopes, v_i)
                    change = dot(slopes, velocity)
                    add(matrix.column, k * m + i, -2.0 * (gain_v * (b * v_j)))
                    add(row, k * m + i, 2.0 * (b * (gain_v * v_j + a_j) + change * v_j))
                    if j < k:
                        add(matrix.column, j * m + i, -2.0 * (gain_v * (b * v_k)))
                        add(row, j * m + i, 2.0 * (b * (gain_v * v_k + a_k) + change * v_k))
                    add_to_rows(matrix.column, i, m, slopes, -turning)
                    add_to_rows(row, i, m, slopes, -turning)
            drift = dot(turned, velocity)
            add(balance, k, 2.0 * (leant * a_j + leaning * v_j + drift * v_j))  # 2 (b.delta theta_j')'
            if j < k:
                add(balance, j, 2.0 * (leant * a_k + leaning * v_k + drift * v_k))
            add_to_rows(balance, 0, 1, turned, -turning)  # - (d b).delta theta_k' theta_j'
            if fresh:
                own = 2.0 * (leant * gain_a + gain_v * (leaning + drift))
                add(corner, k * r + j, own)
                swept = gain_v * v_j
                # rows of k: how (b.delta)' and b.delta change with every theta
                add_to_rows(corner, k * r, 1, turned, 2.0 * (swept + a_j))
                add_to_rows(corner, k * r, 1, turning_on, 2.0 * v_j)
                add_to_rows(corner, k, r, turned, -2.0 * swept)
                if j < k:
                    add(corner, j * r + k, own)
                    swept = gain_v * v_k
                    add_to_rows(corner, j * r, 1, turned, 2.0 * (swept + a_k))
                    add_to_rows(corner, j * r, 1, turning_on, 2.0 * v_k)
                    add_to_rows(corner, j, r, turned, -2.0 * swept)
            at += m


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def _add_damping(layout, kept, place, gain_v, fresh, work, matrix):
    """Add ``D eta'``; the change of D with theta is left out of the iteration matrix."""
    rate, balance = work.rate, work.balance
    r, n = len(place), layout.n_eta
    m = n - r
    at, into = layout.damping, 0
    for i in range(n):
        total = spread(0.0)
        for j in range(i + 1):
            value, _ = polynomial(kept, at, place)
            at += 1
            total += value * load(rate, j)
            if j < i:
                add(balance, j, value * load(rate, i))
            if fresh:
                braked = gain_v * value
                if i < r:
                    add(matrix.corner, i * r + j, braked)
                    if j < i:
                        add(matrix.corner, j * r + i, braked)
                elif j < r:
                    add(matrix.column, j * m + i - r, braked)
                    add(matrix.row, j * m + i - r, braked)
                else:
                    add(matrix.factor, into, braked)
                    into += 1
        add(balance, i, total)
