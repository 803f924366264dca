"""What opens gaps of joints: rows of the reduced equations of vectors Y whose amplitudes are zero.

`reduction.joint_gaps` has the vectors and their tables over theta. With coordinates d, velocities v and accelerations a
of flexible coordinates i, j and rigid ones k, l, the row of gap g is a sum over the entries T of its tables,

    sum T F + sum_k dT/dtheta_k G_k,

=========== ================================ ======================= =================================
entry       what it is                       F                       G_k
=========== ================================ ======================= =================================
M[g,l]      ``Y^T M d_l rho``                a_l
M[g,i]      ``Y^T M Psi``                    a_i                     v_k v_i + 1/2 a_k d_i
I[kl,g]     ``(d_k d_l rho)^T M Y``          v_k v_l
c[kl,g,i]   inertia of second order          v_k v_l d_i
P[l,g,i]    momentum of prescribed ones      a_l d_i
A[l,g,i]    gyroscopic                       -2 v_l v_i - a_l d_i    -v_k v_l d_i
K[g,i]      ``Y^T K Psi``                    d_i
V[g,ij]     cubic energy                     1/2 d_i d_j
Q[g]        ``Y^T f``, f loads               -1
B[g,i]      their work on the curvature      -d_i
Y[f,g]      Y where local effects act        -F
chi[f,g,i]  its curvature there              -F d_i
D[g,x]      ``Y^T D [d rho, Psi]``           rate of x
=========== ================================ ======================= =================================

F and G are the same for all gaps, so that a row costs a product of these with the tables alone. ``1/2 a_k d_i`` is what
skew gyroscopic terms leave out, as the inertia of Y and Psi changes with theta (`JointGaps.changing`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.effects import Effect
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.vectors import LANES, add, aligned_zeros, load, number_at, spread, store
from pgmp_petsc.reduced.terms import ReducedDamping
from pgmp_petsc.reduction.cell_products import (
    by_cells,
    end_of_cell,
    fill_lane_weights,
    stencil_room,
    tensor_stencil,
)
from pgmp_petsc.reduction.interpolation import Interpolant, interpolant
from pgmp_petsc.reduction.joint_gaps import JointGaps
from pgmp_petsc.reduction.stencil import N_ROWS
from pgmp_petsc.reduction.tables import ReducedTables
from pgmp_petsc.stepping.second_order_system import State


@dataclass(frozen=True, eq=False)
class GapForces:
    """Rows of g gaps, as a sum of products over a basis of r rigid and m flexible coordinates."""

    #: entries of all terms as in the table above, mass terms first, then those of stiffness, loads and damping, rows
    #: of shape (g, n_entries)
    table: Interpolant
    #: M[g,i] and A of every mass term, whose derivatives are taken, rows of shape (g, n_changing)
    changing: Interpolant
    #: Y at the unknowns that local effects act on and, of second order, its curvature in pairs with the basis, rows of
    #: shape (n_dofs * (1 + m), g)
    moved: Interpolant
    #: monomials of the terms of mass, stiffness, loads and damping
    weights: tuple[tuple[Monomial, ...], ...]
    load_effects: tuple[str, ...]  # names, of the load terms
    sizes: tuple[int, int, bool, int]  # r, m, whether there are entries of second order, and coordinates k of P
    mass_damping: float  # factor of the damping proportional to the mass, 1/s
    quadratic: bool  # whether inertia forces quadratic in the velocities act

    @classmethod
    def of(
        cls, gaps: JointGaps, tables: ReducedTables, scheme: str, damping: ReducedDamping | None, quadratic: bool,
        loaded: Sequence[np.ndarray],
    ) -> Self:  # fmt: skip
        """Prepare the rows. `damping` is that of a basis that has the vectors of the gaps behind its own; local effects
        act on the nodes with the unknowns `loaded`, (n_dofs,) each."""
        r, m, n, g = tables.n_coordinates, tables.n_modes, tables.samples.n, gaps.rows.size
        second = gaps.cubic is not None
        driven = gaps.curved_mass.shape[2] if second else 0
        (k, h), (i, j) = np.tril_indices(r), np.tril_indices(m)
        parts, changing = [], []
        for t in range(len(tables.mass_weights)):
            inertia = 0.5 * (gaps.inertia[:, t, k, h] + gaps.inertia[:, t, h, k])
            along = [gaps.mass[:, t, :, r:]]
            parts += [gaps.mass[:, t], np.swapaxes(inertia, 1, 2)]
            if second:
                swing = np.swapaxes(gaps.curved_inertia[:, t] - gaps.spread[:, t], 1, 2)
                along.append(np.swapaxes(gaps.gyroscopic[:, t], 1, 2).reshape(n, g, r * m))
                pushed = np.swapaxes(gaps.curved_mass[:, t], 1, 2).reshape(n, g, driven * m)
                parts += [swing.reshape(n, g, k.size * m), along[-1], pushed]
            changing += along
        for t in range(len(tables.stiffness_weights)):
            parts += [gaps.stiffness[:, t], *([gaps.cubic[:, t][:, :, i, j]] if second else [])]
        for t in range(len(tables.load_weights)):
            parts += [gaps.load[:, t, :, None], *([gaps.curved_load[:, t]] if second else [])]
        damped = () if damping is None else damping.weights
        parts += [damping.table[:, t, r + m :, : r + m] for t in range(len(damped))]
        dofs = np.concatenate([*loaded, np.zeros(0, dtype=int)])
        moved = gaps.shapes[:, dofs, :, None]
        if gaps.curvature is not None:
            moved = np.concatenate([moved, gaps.curvature[:, dofs]], axis=3)
        return cls(
            interpolant(tables.samples, np.concatenate(parts, axis=2), scheme),
            interpolant(tables.samples, np.concatenate(changing, axis=2), scheme),
            interpolant(tables.samples, np.swapaxes(moved, 2, 3).reshape(n, -1, g), scheme),
            (tables.mass_weights, tables.stiffness_weights, tables.load_weights, damped),
            tables.load_effects, (r, m, second, driven), 0.0 if damping is None else damping.mass, quadratic,
        )  # fmt: skip

    def at(
        self, times: np.ndarray, states: State, values: Mapping[str, np.ndarray], effects: Sequence[Effect]
    ) -> np.ndarray:
        """Return the rows (g, n) in states (n, n_eta) at times (n,), s, for parameter values (n,) each, without local
        effects."""
        n, by_name = len(states.q), {effect.name: effect for effect in effects}
        counts = tuple(len(one) for one in self.weights)
        weights = np.empty((sum(counts), n))
        for row, weight in zip(weights, (weight for own in self.weights for weight in own)):
            row[:] = weight.evaluate(values)
        for row, name in zip(weights[counts[0] + counts[1] :], self.load_effects):
            row *= by_name[name].amplitude(times)
        (g, n_factors), (r, m, _, driven), n_changing = self.table.shape, self.sizes, self.changing.shape[1]
        found, n_bent = np.empty((g, n)), m * (m + 1) // 2
        rows = (N_ROWS**r, N_ROWS, r + m, r + m, len(weights), n_factors, r * n_changing)
        pairs = r * (r + 1) // 2
        most = max(r + m + pairs + (pairs + r + driven) * m, 1 + m, m + n_bent)
        work = tuple(aligned_zeros((size, LANES)) for size in (*rows, most, g))
        theta = np.ascontiguousarray(states.q[:, :r])
        tables = (part.rows.reshape(-1, *part.shape) for part in (self.table, self.changing))
        _fill(
            self.sizes, counts, self.mass_damping, self.quadratic, weights, (theta, states.q, states.v, states.a),
            self.table.axes, *tables, *by_cells(theta, self.table.axes), work, found,
        )  # fmt: skip
        return found

    def work_of(self, loads: np.ndarray, states: State) -> np.ndarray:
        """Return the work of forces on the unknowns that local effects act on, (n, n_dofs), in the gaps, (g, n)."""
        r, _, second, _ = self.sizes
        if second:
            loads = np.concatenate([loads[..., None], loads[..., None] * states.q[:, None, r:]], axis=2)
        return self.moved.product(states.q[:, :r], loads.reshape(len(loads), -1)).T


@njit(cache=True, entry=True, error_model="numpy", fastmath={"contract"})
def _fill(sizes, counts, mass_damping, quadratic, weights, states, axes, table, changing, cells, order, work, found):
    """Fill the rows (g, n) of states (n, n_eta) with weights of the terms (n_terms, n), of the tables' rows (n_rows, g,
    n_entries) and (n_rows, g, n_changing), LANES of a cell side by side.

    `work` has room for weights of rows and those along an axis, q, v, weights of terms, factors, slopes, monomials of a
    kind of terms, and rows, all of them vectors.
    """
    (theta, q, rates, accelerations), r = states, sizes[0]
    of_rows, along, at, rate, of_terms, factors, slopes, monomials, sums = work
    one_axis, n_rows = stencil_room(), N_ROWS ** len(axes)
    rows, spare, first, n_slopes = np.empty(n_rows, dtype=np.int64), np.empty(n_rows), 0, changing.shape[2]
    while first < order.size:
        together = order[first : end_of_cell(cells, order, first)]
        for lane in range(together.size):
            s = together[lane]
            for x in range(q.shape[1]):
                at[x, lane], rate[x, lane], monomials[x, lane] = q[s, x], rates[s, x], accelerations[s, x]
            for t in range(weights.shape[0]):
                of_terms[t, lane] = weights[t, s]
        _fill_factors(sizes, counts, mass_damping, quadratic, of_terms, at, rate, monomials, factors, slopes)
        tensor_stencil(theta[together[0]], axes, -1, one_axis, rows, spare)
        fill_lane_weights(theta, axes, together, -1, along, of_rows)
        for g in range(table.shape[1]):
            store(sums, g, 0.0)
        _add(table, rows, of_rows, factors, 0, sums)
        for k in range(r):
            fill_lane_weights(theta, axes, together, k, along, of_rows)
            _add(changing, rows, of_rows, slopes, k * n_slopes, sums)
        for lane in range(together.size):
            for g in range(table.shape[1]):
                found[g, together[lane]] = sums[g, lane]
        first += together.size


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _fill_factors(sizes, counts, mass_damping, quadratic, weights, q, rate, own, factors, slopes):
    """Fill the factors F of `_fill` and, coordinate after coordinate, G; `own` has the accelerations, and room."""
    (r, m, second, driven), (n_mass, n_stiffness, n_load, n_damping) = sizes, counts
    n, moving = r + m, 1.0 if quadratic else 0.0
    n_changing = m + (r * m if second else 0)
    for x in range(n):
        add(own, x, mass_damping * load(rate, x))
    for k in range(r):
        v, a = moving * load(rate, k), load(own, k)
        for i in range(m):
            d, vi = load(q, r + i), moving * load(rate, r + i)
            _weigh(v * vi + 0.5 * a * d, weights, 0, n_mass, n_changing, k * n_mass * n_changing + i, slopes)
            for h in range(r if second else 0):
                bend = -v * (moving * load(rate, h)) * d
                into = k * n_mass * n_changing + m + h * m + i
                _weigh(bend, weights, 0, n_mass, n_changing, into, slopes)
    e = n
    for k in range(r):
        for j in range(k + 1):
            store(own, e, moving * (1.0 if k == j else 2.0) * load(rate, k) * load(rate, j))
            e += 1
    if second:
        for pair in range(n, e):
            for i in range(m):
                store(own, e, load(own, pair) * load(q, r + i))
                e += 1
        for h in range(r):
            v, a = moving * load(rate, h), load(own, h)
            for i in range(m):
                store(own, e, -2.0 * v * (moving * load(rate, r + i)) - a * load(q, r + i))
                e += 1
        for h in range(driven):
            for i in range(m):
                store(own, e, load(own, h) * load(q, r + i))
                e += 1
    into = _weigh_all(own, e, weights, 0, n_mass, 0, factors)
    for i in range(m):
        store(own, i, load(q, r + i))
    e = m
    for i in range(m if second else 0):
        for j in range(i + 1):
            store(own, e, (0.5 if i == j else 1.0) * load(q, r + i) * load(q, r + j))
            e += 1
    into = _weigh_all(own, e, weights, n_mass, n_stiffness, into, factors)
    store(own, 0, -1.0)
    for i in range(m if second else 0):
        store(own, 1 + i, -load(q, r + i))
    e = 1 + m if second else 1
    into = _weigh_all(own, e, weights, n_mass + n_stiffness, n_load, into, factors)
    _weigh_all(rate, n, weights, n_mass + n_stiffness + n_load, n_damping, into, factors)


@njit(inline="always")
def _weigh(entry, weights, first, count, stride, into, found):
    """Put an entry, with the weights of some terms, a stride apart."""
    for term in range(count):
        store(found, into + term * stride, load(weights, first + term) * entry)


@njit(error_model="numpy", counted=False)
def _weigh_all(entries, n, weights, first, count, into, found):
    """Put n entries, with the weights of some terms, one after the other; return where they end."""
    for e in range(n):
        _weigh(load(entries, e), weights, first, count, n, into + e, found)
    return into + count * n


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _add(table, rows, weights, factors, first, sums):
    """Add products of some rows of a table (n_rows, g, n), with weights, and factors from the first one on to sums."""
    n = table.shape[2]
    for g in range(table.shape[1]):
        total = load(sums, g)
        for p in range(0, rows.size, N_ROWS):
            at_0, at_1 = (rows[p] * table.shape[1] + g) * n, (rows[p + 1] * table.shape[1] + g) * n
            at_2, at_3 = (rows[p + 2] * table.shape[1] + g) * n, (rows[p + 3] * table.shape[1] + g) * n
            one, two, three, four = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
            for e in range(n):
                x = load(factors, first + e)
                one, two = one + x * number_at(table, at_0 + e), two + x * number_at(table, at_1 + e)
                three, four = three + x * number_at(table, at_2 + e), four + x * number_at(table, at_3 + e)
            total += load(weights, p) * one + load(weights, p + 1) * two
            total += load(weights, p + 2) * three + load(weights, p + 3) * four
        store(sums, g, total)
