"""Flexible bodies in floating frames of full-order samples on one rank, compiled: residual, matrix and energy.

With ``r = p + sum_k d_k w_k``, ``w_k = X_k + Psi_k xi`` and the moments of `bodies.floating`, inertia forces are

    r'' = p'' + sum_k (d_k'' w_k + 2 d_k' w_k' + d_k w_k''),
    F_p = int rho r'',    F_d_l = int rho w_l r'',    F_xi = sum_l int rho Psi_l^T d_l.r'',

exact in the rotation and with all that is quadratic in velocities. A uniform acceleration g of gravity is one of the
frame, ``p'' - g``; damping by the mass adds alpha times the velocities to the accelerations. Elastic forces are
``K (xi + beta xi')``. In the plane the directors are those of an angle, and ``F_phi = sum_l F_d_l . J d_l``.

Of the tangents those of inertia forces with the accelerations and of elastic forces are in the matrix; those with
velocities and unknowns, smaller by h times the angular velocity and its square, are left to Newton's method.

Samples lie side by side in the last axis (lanes). For each body and sample ``table`` has, one after the other: mass and
``int rho X``; ``int rho X_k X_l``; ``int rho Psi_k``; ``int rho X_k Psi_l``; the mass of the amplitudes; their
stiffness; ``int rho Psi_k Psi_l``, as `body_tables` lays them out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.floating import first_moments, second_moments
from pgmp_petsc.dynamics.full_forces import add_entry
from pgmp_petsc.runtime.lane_items import empty_lanes, items, keep, sine_cosine
from pgmp_petsc.runtime.compiled import njit


class FloatingBodies(NamedTuple):
    """Flexible bodies in floating frames.

    Attributes
    ----------
    dofs
        Unknowns of all bodies, body after body: of the floating frame, then the amplitudes.
    firsts
        Where the unknowns, the words of the table and the positions of each body begin, and their ends, shape (n + 1,
        3).
    body
        Number of the body, shape (n,).
    table
        Moments and stiffness, shape (n_blocks, n_words, n_lanes).
    gravity
        Acceleration of every gravity effect, shape (n_blocks, n_gravity, d, n_lanes), m/s2.
    gravity_loads
        The load whose amplitude each of them has, shape (n_gravity,).
    positions
        Where the matrix stores the packed lower triangle of each body.
    counted
        Whether a body is counted here, in sums over all ranks, shape (n,).
    """

    dofs: np.ndarray
    firsts: np.ndarray
    body: np.ndarray
    table: np.ndarray
    gravity: np.ndarray
    gravity_loads: np.ndarray
    positions: np.ndarray
    counted: np.ndarray


def body_tables(moments: np.ndarray, stiffness: np.ndarray, d: int) -> np.ndarray:
    """Lay out the moments (r, r, n_samples) and the stiffness (n, n, n_samples) of a body: (n_words, n_samples)."""
    places, of_fields = first_moments(moments, d)
    squares, mixed, both = second_moments(moments, d)
    own = np.einsum("kkij...->ij...", both)
    parts = (places, squares, of_fields, mixed, own, stiffness, both)
    return np.concatenate([part.reshape(-1, moments.shape[2]) for part in parts])


class Places(NamedTuple):
    """Where the parts of a body's table begin; mass and ``int rho X`` are its first 1 + d words."""

    squares: int
    fields: int
    mixed: int
    mass: int
    stiffness: int
    both: int


@njit(inline="always")
def places_of(d, n):
    """Return where the parts of the table of a body with n amplitudes begin, as `body_tables` lays them out."""
    squares = 1 + d
    fields = squares + d * d
    mixed = fields + d * n
    mass = mixed + d * d * n
    return Places(squares, fields, mixed, mass, mass + n * n, mass + 2 * n * n)


class Moving(NamedTuple):
    """A body in motion, items of shape (d,), (d, d) and (n,): directors are rows of `d`, with the components of their
    velocities in the body's frame, ``spin[l, k] = d_l.d_k'``."""

    p: np.ndarray
    d: np.ndarray
    d1: np.ndarray
    d2: np.ndarray
    spin: np.ndarray
    x: np.ndarray
    x1: np.ndarray
    x2: np.ndarray


class Shaped(NamedTuple):
    """Moments of the deformed body: ``s_k = int rho w_k``, its rate and acceleration (d,); ``J_kl = int rho w_k w_l``,
    ``int rho w_k w_l'`` and ``int rho w_k w_l''`` (d, d); ``int rho w_k Psi_l`` (d, d, n); and ``sum_kl spin_kl int rho
    Psi_k Psi_l xi'`` (n,)."""

    s: np.ndarray
    s1: np.ndarray
    s2: np.ndarray
    j: np.ndarray
    j1: np.ndarray
    j2: np.ndarray
    g: np.ndarray
    h: np.ndarray


@njit(inline="always")
def _moving(space, d, n):
    """View work space as what `Moving` has."""
    m = d * d
    return Moving(
        space[:d], space[d : d + m].reshape((d, d)), space[d + m : d + 2 * m].reshape((d, d)),
        space[d + 2 * m : d + 3 * m].reshape((d, d)), space[d + 3 * m : d + 4 * m].reshape((d, d)),
        space[d + 4 * m : d + 4 * m + n], space[d + 4 * m + n : d + 4 * m + 2 * n],
        space[d + 4 * m + 2 * n : d + 4 * m + 3 * n],
    )  # fmt: skip


@njit(inline="always")
def _shaped(space, d, n):
    """View work space as what `Shaped` has."""
    m, at = d * d, 3 * d + 3 * d * d
    return Shaped(
        space[:d], space[d : 2 * d], space[2 * d : 3 * d], space[3 * d : 3 * d + m].reshape((d, d)),
        space[3 * d + m : 3 * d + 2 * m].reshape((d, d)), space[3 * d + 2 * m : at].reshape((d, d)),
        space[at : at + m * n].reshape((d, d, n)), space[at + m * n : at + m * n + n],
    )  # fmt: skip


@njit(inline="always")
def n_words(d, n):
    """Return the words of work space that a body takes: moving, shaped, its forces."""
    return d + 4 * d * d + 3 * n + 3 * d + 3 * d * d + d * d * n + n + d + d * d + n


@njit(error_model="numpy")
def _read(dofs, d, alpha, q, v, a, one):
    """Fill what a body does; accelerations are with alpha times the velocities, those of the directors too."""
    n_pose = 3 if d == 2 else 12
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


@njit(error_model="numpy")
def _shape(table, d, one, shaped):
    """Fill the moments of the deformed body from its table (n_words,)."""
    n, zero = one.x.size, one.p[0] * 0.0
    squares, fields, mixed, _, _, both = places_of(d, n)
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
            at = mixed + (l * d + k) * n
            for j in range(n):
                shaped.g[l, k, j] = table[at + j]
            spin = one.spin[k, l]
            for i in range(n):
                x, turned = one.x[i], spin * one.x1[i]
                row = both + ((l * d + k) * n + i) * n
                for j in range(n):
                    entry = table[row + j]
                    shaped.g[l, k, j] += x * entry  # int rho w_l Psi_k
                    shaped.h[j] += turned * entry
    for l in range(d):
        for k in range(d):
            at = mixed + (k * d + l) * n
            j0, j1, j2 = table[squares + l * d + k], zero, zero
            for i in range(n):
                g = shaped.g[l, k, i]
                j0 += (table[at + i] + g) * one.x[i]
                j1 += g * one.x1[i]
                j2 += g * one.x2[i]
            shaped.j[l, k], shaped.j1[l, k], shaped.j2[l, k] = j0, j1, j2


@njit(error_model="numpy")
def _push(table, d, beta, one, shaped, force, pull):
    """Fill the forces on p, d_l and xi, one after the other."""
    n = one.x.size
    _, fields, _, own, stiffness, _ = places_of(d, n)
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
        total = 2.0 * shaped.h[j]
        for l in range(d):
            total += table[fields + l * n + j] * pull[l]
        force[d + d * d + j] = total
    for l in range(d):
        for k in range(d):
            turned = one.p[0] * 0.0
            for c in range(d):
                turned += one.d[k, c] * one.d2[l, c]  # d_k.d_l''
            for j in range(n):
                force[d + d * d + j] += turned * shaped.g[l, k, j]
    for i in range(n):
        x2, bent = one.x2[i], one.x[i] + beta * one.x1[i]
        for j in range(n):
            force[d + d * d + j] += table[own + i * n + j] * x2 + table[stiffness + i * n + j] * bent


@njit(error_model="numpy")
def _add_matrix(table, positions, d, gain_m, gain_k, one, shaped, diagonal, lower):
    """Add the tangents of a body: unknowns of the frame first, the packed lower triangle row by row."""
    n = one.x.size
    n_pose = 3 if d == 2 else 12
    _, fields, _, own, stiffness, _ = places_of(d, n)
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
        for j in range(n_pose):
            value = zero
            if j < d:
                for k in range(d):
                    value += one.d[k, j] * table[fields + k * n + i]
            elif d == 2:
                value = shaped.g[0, 1, i] - shaped.g[1, 0, i]  # sum_kl (J d_k).d_l int rho w_k Psi_l
            else:
                for k in range(3):
                    value += one.d[k, j % 3] * shaped.g[j // 3 - 1, k, i]
            add_entry(positions[at], gain_m * value, diagonal, lower)
            at += 1
        for j in range(i + 1):
            value = gain_m * table[own + i * n + j] + gain_k * table[stiffness + i * n + j]
            add_entry(positions[at], value, diagonal, lower)
            at += 1


@njit(cache=True, error_model="numpy")
def add_floating(
    floating, width, d, rayleigh, block, amplitudes, share, q, v, a, gains, fresh, x, place, diagonal, lower
):  # fmt: skip
    """Add inertia, weight, elastic and damping forces of all bodies to x, and their tangents to the matrix.

    `amplitudes` are those of the loads, (n_loads,), and `share` what part of them acts.
    """
    q, v, a, tables = items(q, width), items(v, width), items(a, width), items(floating.table, width)
    weights, x = items(floating.gravity, width), items(x, width)
    diagonal, lower = items(diagonal, width), items(lower, width)
    gain_v, gain_a, gain_k = gains
    n_pose = 3 if d == 2 else 12
    firsts, most = floating.firsts, 0
    for k in range(floating.body.size):
        most = max(most, firsts[k + 1, 0] - firsts[k, 0] - n_pose)
    space = empty_lanes(n_words(d, most) + d, len(width))
    work = items(space, width)
    for k in range(floating.body.size):
        beta, alpha = rayleigh[floating.body[k], 0], rayleigh[floating.body[k], 1]
        dofs, n = floating.dofs[firsts[k, 0] : firsts[k + 1, 0]], firsts[k + 1, 0] - firsts[k, 0] - n_pose
        table = tables[block, firsts[k, 1] : firsts[k + 1, 1]]
        n_moving, n_shaped = d + 4 * d * d + 3 * n, 3 * d + 3 * d * d + d * d * n + n
        one = _moving(work[:n_moving], d, n)
        shaped = _shaped(work[n_moving : n_moving + n_shaped], d, n)
        force = work[n_moving + n_shaped : n_moving + n_shaped + d + d * d + n]
        pull = work[n_moving + n_shaped + d + d * d + n : n_moving + n_shaped + 2 * d + d * d + n]
        _read(dofs, d, alpha, q, v, a, one)
        for number in range(floating.gravity_loads.size):
            strength = share * amplitudes[floating.gravity_loads[number]]
            for c in range(d):
                one.p[c] -= strength * weights[block, number, c]
        _shape(table, d, one, shaped)
        _push(table, d, beta, one, shaped, force, pull)
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
            positions = floating.positions[firsts[k, 2] : firsts[k + 1, 2]]
            gain_m, stiffer = gain_a + alpha * gain_v, gain_k * (1.0 + beta * gain_v)
            _add_matrix(table, positions, d, gain_m, stiffer, one, shaped, diagonal, lower)
    keep(space)


@njit(cache=True, error_model="numpy")
def add_energies_of_floating(floating, width, d, rayleigh, block, amplitudes, q, v, result, powers, weights):
    """Add kinetic and strain energy of the bodies that are counted here, the power of their damping (n_bodies,
    n_lanes), and the potential energy of their weight to that of the loads (n_loads, n_lanes)."""
    q, v, tables = items(q, width), items(v, width), items(floating.table, width)
    result, powers, weights = items(result, width), items(powers, width), items(weights, width)
    falls = items(floating.gravity, width)
    n_pose = 3 if d == 2 else 12
    firsts, most = floating.firsts, 0
    for k in range(floating.body.size):
        most = max(most, firsts[k + 1, 0] - firsts[k, 0] - n_pose)
    space = empty_lanes(n_words(d, most), len(width))
    work = items(space, width)
    for b in range(floating.body.size):
        if not floating.counted[b]:
            continue
        body = floating.body[b]
        beta, alpha = rayleigh[body, 0], rayleigh[body, 1]
        dofs, n = floating.dofs[firsts[b, 0] : firsts[b + 1, 0]], firsts[b + 1, 0] - firsts[b, 0] - n_pose
        table = tables[block, firsts[b, 1] : firsts[b + 1, 1]]
        n_moving, n_shaped = d + 4 * d * d + 3 * n, 3 * d + 3 * d * d + d * d * n + n
        one = _moving(work[:n_moving], d, n)
        shaped = _shaped(work[n_moving : n_moving + n_shaped], d, n)
        _read(dofs, d, 0.0, q, v, v, one)
        _shape(table, d, one, shaped)
        _, _, _, own, stiffness, _ = places_of(d, n)
        moving, strain, viscous = one.p[0] * 0.0, one.p[0] * 0.0, one.p[0] * 0.0
        for c in range(d):
            moving += table[0] * one.p[c] * one.p[c]  # p is p' here
            for k in range(d):
                moving += 2.0 * one.p[c] * (one.d1[k, c] * shaped.s[k] + one.d[k, c] * shaped.s1[k])
                for l in range(d):
                    moving += one.d1[l, c] * one.d1[k, c] * shaped.j[l, k]
                    moving += 2.0 * one.d1[l, c] * one.d[k, c] * shaped.j1[l, k]  # d_l' w_l . d_k w_k'
        for i in range(n):
            for j in range(n):
                moving += one.x1[i] * one.x1[j] * table[own + i * n + j]
                strain += one.x[i] * one.x[j] * table[stiffness + i * n + j]
                viscous += one.x1[i] * one.x1[j] * table[stiffness + i * n + j]
        result[0] += 0.5 * moving
        result[1] += 0.5 * strain
        powers[body] -= beta * viscous + alpha * moving
        for number in range(floating.gravity_loads.size):
            load = floating.gravity_loads[number]
            for c in range(d):
                place = table[0] * q[dofs[c]]
                for k in range(d):
                    place += one.d[k, c] * shaped.s[k]
                weights[load] -= amplitudes[load] * falls[block, number, c] * place
    keep(space)
