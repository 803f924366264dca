"""The reduced equations of motion and their iteration matrix for LANES samples at once, compiled.

Residual (Naets et al. 2015, eqs. (11)-(12)), eta = [theta, delta], for one or two rigid coordinates theta_k::

    r = M eta'' + sum_k theta_k' (d_k M) eta' + K delta - Q(t) - sum_kl b_kl theta_k' theta_l' e_delta
        + sum_k e_k (- 1/2 eta'^T (d_k M) eta' + 2 sum_l (b_kl.delta theta_l'' + b_kl.delta' theta_l')
                     + sum_lm (2 d_m b_kl - d_k b_lm).delta theta_l' theta_m'
                     + 1/2 delta^T (d_k K) delta - (d_k Q_delta).delta)

with ``d_k = d/d theta_k`` and e_k, e_delta the rows of theta_k and of delta. The terms of b and the last line are
missing in the paper. b belongs to the kinetic energy ``sum_kl theta_k' theta_l' b_kl(theta).delta`` of first order in
delta, with ``b_kl`` the symmetric part of ``(d_k rho)^T M (d_l Psi)``: the inertia forces of the rigid motion, which
bend the bodies, and the change of the rigid inertia with their bending. Without it the modes are blind to inertia
loads, because their mass coupling with theta vanishes identically. The last line is the work of loads and elastic
forces on the change of the modes with theta: of second order in the loads, both together or none. With all of them the
system is Lagrangian in the interpolated tables and conserves energy.

Where a scene asks for it, structural damping adds ``D eta'``. Damping proportional to the mass, ``alpha d T / d eta'``,
needs no term of its own: because T is quadratic in eta', it is what ``alpha eta'`` added to eta'' makes of the inertia
forces.

The iteration matrix leaves out second derivatives of the tables alone; its flexible block is symmetric positive
definite at reasonable steps, rows and columns of theta border it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.dynamics.lanes import LANES, multiply
from pgmp_petsc.runtime.compiled import njit


class Layout(NamedTuple):
    """Where the parts of a table row begin.

    Packed mass; couplings b_kl, k >= l, one after the other; packed stiffness; with terms of second order packed V, c
    and A (see `second_order_kernel`); packed structural damping, if there is any; and the end. A load row has n_eta
    entries, and with terms of second order packed ones after them.

    Attributes
    ----------
    rigid
        Numbers of the rigid coordinates: a tuple, so that the compiler knows how many there are.
    n_eta
        Number of coordinates.
    quadratic
        Whether inertia forces quadratic in the velocities are evaluated; in slow motion they may be left out.
    """

    rigid: tuple[int, ...]
    n_eta: int
    coupling: int
    stiffness: int
    cubic: int
    swing: int
    gyroscopic: int
    damping: int
    end: int
    load_end: int
    quadratic: bool

    @property
    def second_order(self) -> bool:
        """Whether there are terms of second order."""
        return self.cubic < self.damping

    @property
    def n_rigid(self) -> int:
        """Number of entries of the packed rigid inertia, with which a row begins."""
        return len(self.rigid) * (len(self.rigid) + 1) // 2


class Work(NamedTuple):
    """State of one block of samples, and what is evaluated there; all arrays end with the axis of the lanes.

    Attributes
    ----------
    q, v, a
        Coordinates; velocities and accelerations as the inertia forces see them (see the module), shape (n_eta, LANES).
    rate
        Velocities, of the same shape: the same array as v, which is zero instead where forces quadratic in it are left
        out.
    terms, slopes
        Interpolated terms (layout.end, LANES) and their derivatives (n_theta, layout.end, LANES).
    load, load_slope
        The same for the loads, (layout.load_end, LANES) and (n_theta, layout.load_end, LANES).
    balance
        The residual, shape (n_eta, LANES).
    moved, turned
        ``(d_k M) eta'`` and ``(d_k K) delta - d_k Q_delta``, shapes (n_theta, n_eta, LANES) and (n_theta, n_delta,
        LANES).
    bent, swung, skewed
        Of the terms of second order; see `second_order_kernel`.
    braked
        ``D eta'``, shape (n_eta, LANES).
    place, fine_place, fine_cells
        Places in the cells of the tables, and places and cells on the grid of the rigid inertia, shapes
        (n_theta, LANES) and (LANES,).
    unit, unit_slope
        A unit of one effect's load, and its derivatives, of the shapes of `load` and `load_slope`.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    rate: np.ndarray
    terms: np.ndarray
    slopes: np.ndarray
    load: np.ndarray
    load_slope: np.ndarray
    balance: np.ndarray
    moved: np.ndarray
    turned: np.ndarray
    bent: np.ndarray
    swung: np.ndarray
    skewed: np.ndarray
    braked: np.ndarray
    place: np.ndarray
    fine_place: np.ndarray
    fine_cells: np.ndarray
    unit: np.ndarray
    unit_slope: np.ndarray


@njit(cache=True, error_model="numpy")
def allocate(layout):
    """Return work arrays; zero is what depends on velocities and slopes that are left out, and nothing else."""
    r, n = len(layout.rigid), layout.n_eta
    m = n - r
    rate = np.empty((n, LANES))
    work = Work(
        np.empty((n, LANES)),
        rate if layout.quadratic else np.zeros((n, LANES)),
        np.empty((n, LANES)),
        rate,
        np.empty((layout.end, LANES)),
        np.empty((r, layout.end, LANES)),
        np.empty((layout.load_end, LANES)),
        np.empty((r, layout.load_end, LANES)),
        np.empty((n, LANES)),
        np.empty((r, n, LANES)),
        np.empty((r, m, LANES)),
        np.empty((m * (m + 1) // 2, LANES)),
        np.empty((m, LANES)),
        np.empty((m, LANES)),
        np.empty((n, LANES)),
        np.empty((r, LANES)),
        np.empty((r, LANES)),
        np.empty(LANES, dtype=np.int64),
        np.empty((layout.load_end, LANES)),
        np.empty((r, layout.load_end, LANES)),
    )
    if not layout.quadratic:
        work.slopes[:] = 0.0
        work.moved[:] = 0.0
    return work


@njit(inline="always")
def pair(k, j):
    """Return the place of entry (k, j) of a packed symmetric matrix."""
    return k * (k + 1) // 2 + j if k >= j else j * (j + 1) // 2 + k


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def residual(layout, work, loaded):
    """Evaluate the equations of motion into ``work.balance``, `moved` and `turned`; see the module."""
    q, v, a, terms, slopes, balance = work.q, work.v, work.a, work.terms, work.slopes, work.balance
    n_lanes = balance.shape[1]
    r, n = len(layout.rigid), layout.n_eta
    m = n - r
    multiply(terms, 0, n, a, 0, balance)
    if layout.quadratic:
        for k in range(r):
            moved = work.moved[k]
            multiply(slopes[k], 0, n, v, 0, moved)
            for i in range(n):
                for lane in range(n_lanes):
                    balance[i, lane] += v[k, lane] * moved[i, lane]
                    balance[k, lane] -= 0.5 * v[i, lane] * moved[i, lane]
    elastic = work.turned[0]
    multiply(terms, layout.stiffness, m, q, r, elastic)
    for i in range(m):
        for lane in range(n_lanes):
            balance[r + i, lane] += elastic[i, lane]
    add_coupling(layout, work)
    for k in range(r):
        turned = work.turned[k]
        multiply(slopes[k], layout.stiffness, m, q, r, turned)
        for i in range(m):
            for lane in range(n_lanes):
                balance[k, lane] += 0.5 * q[r + i, lane] * turned[i, lane]
    if loaded:
        for i in range(n):
            for lane in range(n_lanes):
                balance[i, lane] -= work.load[i, lane]
        for k in range(r):
            turned, load_slope = work.turned[k], work.load_slope[k]
            for i in range(m):
                for lane in range(n_lanes):
                    balance[k, lane] -= load_slope[r + i, lane] * q[r + i, lane]
                    turned[i, lane] -= load_slope[r + i, lane]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def add_coupling(layout, work):
    """Add the terms of b to ``work.balance``."""
    q, v, a, terms, slopes, balance = work.q, work.v, work.a, work.terms, work.slopes, work.balance
    n_lanes = balance.shape[1]
    r = len(layout.rigid)
    m = layout.n_eta - r
    for i in range(m):
        for k in range(r):
            for j in range(r):
                b = layout.coupling + pair(k, j) * m + i
                for lane in range(n_lanes):
                    delta, speed = q[r + i, lane], v[j, lane]
                    balance[r + i, lane] -= terms[b, lane] * v[k, lane] * speed
                    balance[k, lane] += 2.0 * terms[b, lane] * (delta * a[j, lane] + v[r + i, lane] * speed)
                for h in range(r):
                    across = layout.coupling + pair(j, h) * m + i
                    for lane in range(n_lanes):
                        change = 2.0 * slopes[h, b, lane] - slopes[k, across, lane]
                        balance[k, lane] += change * q[r + i, lane] * v[j, lane] * v[h, lane]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def add_damping(layout, work):
    """Add structural damping ``D eta'`` to ``work.balance``."""
    multiply(work.terms, layout.damping, layout.n_eta, work.rate, 0, work.braked)
    for i in range(layout.n_eta):
        for lane in range(work.balance.shape[1]):
            work.balance[i, lane] += work.braked[i, lane]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def iteration_matrix(layout, work, gain_v, gain_a, factor, border):
    """Fill the iteration matrix ``[[s, R], [C, S]]``: packed S (n_packed_delta, LANES) and border.

    Its flexible block ``S = gain_a M + gain_v sum_k theta_k' d_k M + K`` is symmetric; the inertia forces of the rigid
    motion make rows and columns of theta differ. `gain_a` has shape (LANES,). See `eliminate_border`.
    """
    v, a, terms, slopes = work.v, work.a, work.terms, work.slopes
    n_lanes = border.shape[1]
    r = len(layout.rigid)
    m = layout.n_eta - r
    at, of, into = r * (r + 1) // 2, layout.stiffness, 0
    for i in range(m):
        for k in range(r):
            column, row = r * r + k * m + i, r * r + (r + k) * m + i
            moved, turned = work.moved[k], work.turned[k]
            for lane in range(n_lanes):
                coupled, swept, leaned = gain_a[lane] * terms[at + k, lane], 0.0, 0.0
                follow = turned[i, lane]
                for j in range(r):
                    b, speed = layout.coupling + pair(k, j) * m + i, v[j, lane]
                    swept += slopes[j, at + k, lane] * speed
                    leaned += terms[b, lane] * speed
                    follow += 2.0 * terms[b, lane] * (gain_v * speed + a[j, lane])
                    for h in range(r):
                        across = layout.coupling + pair(j, h) * m + i
                        follow += (2.0 * slopes[h, b, lane] - slopes[k, across, lane]) * speed * v[h, lane]
                border[column, lane] = coupled + gain_v * (moved[r + i, lane] + swept - 2.0 * leaned) + turned[i, lane]
                border[row, lane] = coupled - gain_v * (moved[r + i, lane] - swept) + follow
        for j in range(i + 1):
            for lane in range(n_lanes):
                inertia = gain_a[lane] * terms[at + r + j, lane]
                for k in range(r):
                    inertia += gain_v * v[k, lane] * slopes[k, at + r + j, lane]
                factor[into + j, lane] = inertia + terms[of + j, lane]
        at += i + 1 + r
        of += i + 1
        into += i + 1
    for k in range(r):
        for j in range(r):
            _fill_corner(layout, work, k, j, gain_v, gain_a, border[k * r + j])
    if layout.damping < layout.end:
        _add_damping_tangent(layout, work, gain_v, factor, border)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _add_damping_tangent(layout, work, gain_v, factor, border):
    """Add ``gain_v D`` to the iteration matrix; the change of D with theta is left out."""
    r = len(layout.rigid)
    m = layout.n_eta - r
    n_lanes = border.shape[1]
    at, into = layout.damping, 0
    for k in range(r):
        for j in range(r):
            for lane in range(n_lanes):
                border[k * r + j, lane] += gain_v * work.terms[at + pair(k, j), lane]
    at += r * (r + 1) // 2
    for i in range(m):
        for k in range(r):
            for lane in range(n_lanes):
                braked = gain_v * work.terms[at + k, lane]
                border[r * r + k * m + i, lane] += braked
                border[r * r + (r + k) * m + i, lane] += braked
        for j in range(i + 1):
            for lane in range(n_lanes):
                factor[into, lane] += gain_v * work.terms[at + r + j, lane]
            into += 1
        at += r + i + 1


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _fill_corner(layout, work, k, j, gain_v, gain_a, corner):
    """Fill entry (k, j) of the corner: the derivative of the balance of theta_k with theta_j."""
    q, v, a, terms, slopes = work.q, work.v, work.a, work.terms, work.slopes
    n_lanes = corner.size
    r = len(layout.rigid)
    m = layout.n_eta - r
    for lane in range(n_lanes):
        corner[lane] = gain_a[lane] * terms[pair(k, j), lane]
        corner[lane] += gain_v * (work.moved[j, k, lane] - work.moved[k, j, lane])
        for h in range(r):
            corner[lane] += slopes[h, pair(k, j), lane] * (gain_v * v[h, lane])
            corner[lane] += slopes[j, pair(k, h), lane] * a[h, lane]
    for i in range(m):
        b = layout.coupling + pair(k, j) * m + i
        for lane in range(n_lanes):
            delta, speed = q[r + i, lane], v[r + i, lane]
            total = terms[b, lane] * (gain_a[lane] * delta + gain_v * speed)
            for h in range(r):
                to, across = layout.coupling + pair(k, h) * m + i, layout.coupling + pair(j, h) * m + i
                change = slopes[h, b, lane] + slopes[j, to, lane] - slopes[k, across, lane]
                total += change * gain_v * delta * v[h, lane]
                total += slopes[j, to, lane] * (delta * a[h, lane] + speed * v[h, lane])
            corner[lane] += 2.0 * total
