"""Flexible bodies in floating frames of full-order samples on one rank, compiled: residual, matrix and energy.

With the moments of `bodies.floating`, whose w_k these are, inertia forces are

    r'' = p'' + sum_k (d_k'' w_k + 2 d_k' w_k' + d_k w_k''),
    F_p = int rho r'',    F_d_l = int rho w_l r'',    F_xi = sum_l int rho Psi_l^T d_l.r'',

exact in the rotation and with all that is quadratic in velocities. A uniform acceleration g of gravity is one of the
frame, ``p'' - g``; damping by the mass adds alpha times the velocities to the accelerations. Elastic forces are
``K (xi + beta xi')``, and modal damping brakes each amplitude by itself. A body that follows its foreshortening has
``dw_k / dxi = Psi_k + chi_k xi`` in place of Psi_k. In the plane the directors are those of an angle, and ``F_phi =
sum_l F_d_l . J d_l``.

Of the tangents those of inertia forces with the accelerations and of elastic forces are in the matrix; those with
velocities and unknowns, smaller by h times the angular velocity and its square, are left to Newton's method.

Samples lie side by side in the last axis (lanes). Where a model has no such bodies, functions are given None in place
of them, and are compiled to nothing: what follows costs a new machine nothing then.
"""

from __future__ import annotations

from pgmp_petsc.full.forces import add_entry
from pgmp_petsc.full.layout import by_dimension, n_pose_of, n_words, places_of, view_of
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import empty_lanes, fused, items, keep, sine_cosine


@njit(error_model="numpy")
def _read(dofs, axes, alpha, q, v, a, one):
    """Fill what a body does; accelerations are with alpha times the velocities, those of the directors too."""
    d = len(axes)
    n_pose = n_pose_of(d)
    zero = q[dofs[0]] * 0.0
    for c in range(d):
        one.p[c] = a[dofs[c]] + alpha * v[dofs[c]]
    if d == 2:
        sine, cosine = sine_cosine(q[dofs[2]])
        turn, spin = a[dofs[2]] + alpha * v[dofs[2]], v[dofs[2]]
        one.d[0, 0], one.d[0, 1], one.d[1, 0], one.d[1, 1] = cosine, sine, -sine, cosine
        for k in range(2):
            x, y = one.d[k, 0], one.d[k, 1]
            one.d1[k, 0], one.d1[k, 1] = -spin * y, spin * x  # d_k' = phi' J d_k
            one.d2[k, 0], one.d2[k, 1] = -turn * y - spin * spin * x, turn * x - spin * spin * y
    else:
        for k in range(3):
            for c in range(3):
                dof = dofs[3 + 3 * k + c]
                one.d[k, c], one.d1[k, c], one.d2[k, c] = q[dof], v[dof], a[dof] + alpha * v[dof]
    for l in range(d):
        for k in range(d):
            total = zero
            for c in range(d):
                total += one.d[l, c] * one.d1[k, c]
            one.spin[l, k] = total
    for i in range(one.x.size):
        dof = dofs[n_pose + i]
        one.x[i], one.x1[i], one.x2[i] = q[dof], v[dof], a[dof] + alpha * v[dof]


@njit(error_model="numpy", forceinline=True)
def _add_rows(rows, one, spin, into, other):
    """Add the rows of a matrix (n n,) times amplitudes, and times their rates and a spin to another vector: two rows at
    once, as sums are stored once for both, and numbers one behind the other, so that the loop is one of vectors."""
    n = one.x.size
    for i in range(0, n - 1, 2):
        first, second = rows[i * n : (i + 1) * n], rows[(i + 1) * n : (i + 2) * n]
        x, x1, y, y1 = one.x[i], spin * one.x1[i], one.x[i + 1], spin * one.x1[i + 1]
        for k in range(n):
            into[k] = fused(second[k], y, fused(first[k], x, into[k]))
            other[k] = fused(second[k], y1, fused(first[k], x1, other[k]))
    if n % 2:
        row, x, x1 = rows[(n - 1) * n : n * n], one.x[n - 1], spin * one.x1[n - 1]
        for k in range(n):
            into[k], other[k] = fused(row[k], x, into[k]), fused(row[k], x1, other[k])


@njit(error_model="numpy")
def _shape(body, axes, one, shaped):
    """Fill the moments of the deformed body, a `View`."""
    d = len(axes)
    n, zero, table, rows, columns = one.x.size, one.p[0] * 0.0, body.table, body.rows, body.columns
    common = body.common
    places = places_of(d, n, rows)
    squares, fields, mixed, both, curved = places.squares, places.fields, places.mixed, places.both, places.stiffness
    bends = d * d * n + n if rows.size > d * d * n + n + 1 else -1
    dense = rows[d * d * n] == d * d * n * n
    for k in range(d):
        s, s1, s2 = table[1 + k], zero, zero
        for i in range(n):
            field = table[fields + k * n + i]
            s, s1, s2 = s + field * one.x[i], s1 + field * one.x1[i], s2 + field * one.x2[i]
        shaped.s[k], shaped.s1[k], shaped.s2[k] = s, s1, s2
    for j in range(n):
        shaped.h[j] = zero
    for l in range(d):
        for k in range(d):
            at, g, spin = (l * d + k) * n, shaped.g[l, k], one.spin[k, l]
            shaped.bent[l, k] = shaped.bending[l, k] = zero
            for j in range(n):
                g[j] = table[mixed + at + j]  # int rho w_l Psi_k
            first = (k * d + l) * n * n  # of int rho Psi_l Psi_k
            if common.size:
                _add_rows(common[first : first + n * n], one, spin, g, shaped.h)
            elif dense:
                _add_rows(table[both + first : both + first + n * n], one, spin, g, shaped.h)
            for j in range(0 if dense else n):
                total, rate = g[j], zero
                for entry in range(rows[at + j], rows[at + j + 1]):
                    total = fused(table[both + entry], one.x[columns[entry]], total)
                    rate = fused(table[both + entry], one.x1[columns[entry]], rate)
                g[j] = total
                shaped.h[j] = fused(spin, rate, shaped.h[j])
            for i in range(n if bends >= 0 else 0):
                total, rate, row = zero, zero, bends + at + i
                for entry in range(rows[row], rows[row + 1]):
                    total = fused(table[curved + entry], one.x[columns[entry]], total)
                    rate = fused(table[curved + entry], one.x1[columns[entry]], rate)
                shaped.g[l, k, i] += total  # + int rho X_l chi_k xi
                shaped.bent[l, k] += one.x[i] * total
                shaped.bending[l, k] += one.x1[i] * rate
    for l in range(d):
        for k in range(d):
            at = mixed + (k * d + l) * n
            # g has all of X_l chi_k, and nothing of X_k chi_l: w_l w_k has half of both
            j0 = table[squares + l * d + k] + 0.5 * (shaped.bent[k, l] - shaped.bent[l, k])
            j1, j2 = zero, shaped.bending[l, k]
            for i in range(n):
                g = shaped.g[l, k, i]
                j0 = fused(table[at + i] + g, one.x[i], j0)
                j1 = fused(g, one.x1[i], j1)
                j2 = fused(g, one.x2[i], j2)
            shaped.j[l, k], shaped.j1[l, k], shaped.j2[l, k] = j0, j1, j2


@njit(error_model="numpy")
def _push(body, axes, beta, one, shaped, force, pull):
    """Fill the forces on p, d_l and xi, one after the other."""
    d = len(axes)
    n, table, rows, columns = one.x.size, body.table, body.rows, body.columns
    places = places_of(d, n, rows)
    fields, own, stiffness, viscous = places.fields, places.both, places.stiffness, places.viscous
    for c in range(d):
        total = table[0] * one.p[c]  # m p''
        for k in range(d):
            total += one.d2[k, c] * shaped.s[k] + 2.0 * one.d1[k, c] * shaped.s1[k] + one.d[k, c] * shaped.s2[k]
        force[c] = total
        for l in range(d):
            total = shaped.s[l] * one.p[c]
            for k in range(d):
                total += one.d2[k, c] * shaped.j[l, k]  # int rho w_l (d_k'' w_k
                total += 2.0 * one.d1[k, c] * shaped.j1[l, k] + one.d[k, c] * shaped.j2[l, k]  # + 2 d_k' w_k' + ...)
            force[d + l * d + c] = total
    for l in range(d):
        along = one.p[0] * 0.0
        for c in range(d):
            along += one.d[l, c] * one.p[c]
        pull[l] = along  # d_l.p''
    for j in range(n):
        total = 2.0 * shaped.h[j] + table[viscous + j] * one.x1[j]
        for l in range(d):
            total += table[fields + l * n + j] * pull[l]
        force[d + d * d + j] = total
    for l in range(d):
        for k in range(d):
            turned = one.p[0] * 0.0
            for c in range(d):
                turned += one.d[k, c] * one.d2[l, c]  # d_k.d_l''
            for j in range(n):
                force[d + d * d + j] = fused(turned, shaped.g[l, k, j], force[d + d * d + j])
    for j in range(n):
        total = force[d + d * d + j]
        for entry in range(rows[d * d * n + j], rows[d * d * n + j + 1]):
            i = columns[entry]
            total = fused(table[own + entry], one.x2[i], total)
            total = fused(table[stiffness + entry], fused(beta, one.x1[i], one.x[i]), total)
        force[d + d * d + j] = total


@njit(error_model="numpy")
def _add_matrix(body, positions, axes, gain_m, gain_v, gain_k, one, shaped, diagonal, lower):
    """Add the tangents of a body: unknowns of the frame first, the packed lower triangle row by row."""
    d = len(axes)
    n, table, rows, columns = one.x.size, body.table, body.rows, body.columns
    n_pose = n_pose_of(d)
    places = places_of(d, n, rows)
    fields, own, stiffness = places.fields, places.both, places.stiffness
    zero = table[0] * 0.0
    at = 0
    for i in range(n_pose):
        for j in range(i + 1):
            value = zero
            if i < d:
                if i == j:
                    value = table[0]
            elif d == 2:  # phi
                if j < 2:
                    value = one.d[1, j] * shaped.s[0] - one.d[0, j] * shaped.s[1]  # J d_1 = d_2, J d_2 = -d_1
                else:
                    value = shaped.j[0, 0] + shaped.j[1, 1]
            elif i % 3 == j % 3:
                value = shaped.s[i // 3 - 1] if j < 3 else shaped.j[i // 3 - 1, j // 3 - 1]
            add_entry(positions[at], gain_m * value, diagonal, lower)
            at += 1
    for i in range(n):
        for c in range(d):
            value = zero
            for k in range(d):
                value = fused(one.d[k, c], table[fields + k * n + i], value)
            add_entry(positions[at + c], gain_m * value, diagonal, lower)
        if d == 2:
            value = shaped.g[0, 1, i] - shaped.g[1, 0, i]  # sum_kl (J d_k).d_l int rho w_k Psi_l
            add_entry(positions[at + 2], gain_m * value, diagonal, lower)
        for l in range(d if d == 3 else 0):
            for c in range(d):
                value = zero
                for k in range(d):
                    value = fused(one.d[k, c], shaped.g[l, k, i], value)
                add_entry(positions[at + d + d * l + c], gain_m * value, diagonal, lower)
        at += n_pose
        for entry in range(rows[d * d * n + i], rows[d * d * n + i + 1]):
            j = columns[entry]
            if j > i:
                continue
            value = gain_m * table[own + entry] + gain_k * table[stiffness + entry]
            if i == j:
                value += gain_v * table[places.viscous + i]
            add_entry(positions[at + j], value, diagonal, lower)
        at += i + 1


@njit(cache=True, apart=True, error_model="numpy")
def _add_floating(
    axes, floating, width, rayleigh, block, amplitudes, share, q, v, a, gains, fresh, x, place, diagonal, lower
):  # fmt: skip
    """Add inertia, weight, elastic and damping forces of all bodies to x, and their tangents to the matrix.

    `amplitudes` are those of the loads, (n_loads,), and `share` what part of them acts.
    """
    q, v, a, tables = items(q, width), items(v, width), items(a, width), items(floating.table, width)
    weights, x = items(floating.gravity, width), items(x, width)
    diagonal, lower = items(diagonal, width), items(lower, width)
    gain_v, gain_a, gain_k = gains
    d = len(axes)
    n_pose = n_pose_of(d)
    space = empty_lanes(n_words(floating, d), len(width))
    work = items(space, width)
    for k in range(floating.body.size):
        beta, alpha = rayleigh[floating.body[k], 0], rayleigh[floating.body[k], 1]
        body = view_of(work, floating, k, tables[block], d)
        n, dofs, one, shaped, force = body.n, body.dofs, body.one, body.shaped, body.force
        _read(dofs, axes, alpha, q, v, a, one)
        for number in range(floating.gravity_loads.size):
            strength = share * amplitudes[floating.gravity_loads[number]]
            for c in range(d):
                one.p[c] -= strength * weights[block, number, c]
        _shape(body, axes, one, shaped)
        _push(body, axes, beta, one, shaped, force, body.pull)
        for c in range(d):
            x[place[dofs[c]]] += force[c]
        if d == 2:
            turning = force[2] * one.d[1, 0] + force[3] * one.d[1, 1]
            x[place[dofs[2]]] += turning - force[4] * one.d[0, 0] - force[5] * one.d[0, 1]
        else:
            for c in range(9):
                x[place[dofs[3 + c]]] += force[3 + c]
        for i in range(n):
            x[place[dofs[n_pose + i]]] += force[d + d * d + i]
        if fresh:
            positions = floating.positions[floating.firsts[k, 2] : floating.firsts[k + 1, 2]]
            gain_m, stiffer = gain_a + alpha * gain_v, gain_k * (1.0 + beta * gain_v)
            _add_matrix(body, positions, axes, gain_m, gain_v, stiffer, one, shaped, diagonal, lower)
    keep(space)


@njit(cache=True, apart=True, error_model="numpy")
def _add_energies_of_floating(
    axes, floating, width, rayleigh, block, amplitudes, conservative, q, v, result, powers, weights
):  # fmt: skip
    """Add kinetic and strain energy of the bodies that are counted here, the power of their damping (n_bodies,
    n_lanes), and to the loads (n_loads, n_lanes) the potential energy of their weight, the power of what is not
    conservative."""
    q, v, tables = items(q, width), items(v, width), items(floating.table, width)
    result, powers, weights = items(result, width), items(powers, width), items(weights, width)
    falls, d = items(floating.gravity, width), len(axes)
    space = empty_lanes(n_words(floating, d), len(width))
    work = items(space, width)
    for b in range(floating.body.size):
        if not floating.counted[b]:
            continue
        body = floating.body[b]
        beta, alpha = rayleigh[body, 0], rayleigh[body, 1]
        view = view_of(work, floating, b, tables[block], d)
        n, dofs, table, rows, one, shaped = view.n, view.dofs, view.table, view.rows, view.one, view.shaped
        _read(dofs, axes, 0.0, q, v, v, one)
        _shape(view, axes, one, shaped)
        places = places_of(d, n, rows)
        own, stiffness = places.both, places.stiffness
        moving, strain, viscous, braked = one.p[0] * 0.0, one.p[0] * 0.0, one.p[0] * 0.0, one.p[0] * 0.0
        for c in range(d):
            moving += table[0] * one.p[c] * one.p[c]  # p is p' here
            for k in range(d):
                moving += 2.0 * one.p[c] * (one.d1[k, c] * shaped.s[k] + one.d[k, c] * shaped.s1[k])
                for l in range(d):
                    moving += one.d1[l, c] * one.d1[k, c] * shaped.j[l, k]
                    moving += 2.0 * one.d1[l, c] * one.d[k, c] * shaped.j1[l, k]  # d_l' w_l . d_k w_k'
        for i in range(n):
            braked += one.x1[i] * one.x1[i] * table[places.viscous + i]
            for entry in range(rows[d * d * n + i], rows[d * d * n + i + 1]):
                j = view.columns[entry]
                moving += one.x1[i] * one.x1[j] * table[own + entry]
                strain += one.x[i] * one.x[j] * table[stiffness + entry]
                viscous += one.x1[i] * one.x1[j] * table[stiffness + entry]
        result[0] += 0.5 * moving
        result[1] += 0.5 * strain
        powers[body] -= beta * viscous + alpha * moving + braked
        for number in range(floating.gravity_loads.size):
            load = floating.gravity_loads[number]
            for c in range(d):
                if conservative[load]:
                    moved = -table[0] * q[dofs[c]]
                    for k in range(d):
                        moved -= one.d[k, c] * shaped.s[k]
                else:
                    moved = table[0] * one.p[c]
                    for k in range(d):
                        moved += one.d1[k, c] * shaped.s[k] + one.d[k, c] * shaped.s1[k]
                weights[load] += amplitudes[load] * falls[block, number, c] * moved
    keep(space)


add_floating, add_energies_of_floating = map(by_dimension, (_add_floating, _add_energies_of_floating))
