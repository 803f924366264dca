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

F and G are the same for all gaps, so that a row costs a product of these with the tables alone; states in one cell lie
side by side, each with the weights of its sample's parameters. ``1/2
a_k d_i`` is what skew gyroscopic terms leave out, as the inertia of Y and Psi changes with theta
(`JointGaps.changing`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.effects import Effect
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.vectors import LANES, add, aligned_zeros, load, spread, store
from pgmp_petsc.reduced.carried import fill_elasticity, fill_inertia
from pgmp_petsc.reduced.terms import ReducedDamping
from pgmp_petsc.reduction.cell_products import (
    N_ROWS,
    by_cell,
    cells_of,
    end_of_cell,
    fill_lane_weights,
    stencil_room,
    tensor_stencil,
)
from pgmp_petsc.reduction.interpolation import Interpolant, interpolant
from pgmp_petsc.reduction.joint_gaps import JointGaps
from pgmp_petsc.reduction.tables import ReducedTables
from pgmp_petsc.stepping.second_order_system import State


@dataclass(frozen=True, eq=False)
class GapForces:
    """Rows of g gaps, as a sum of products over a basis of r rigid and m flexible coordinates."""

    #: entries of all terms as in the table above, mass terms first, then those of stiffness, loads, damping and local
    #: effects, rows of shape (g, n_entries)
    table: Interpolant
    #: M[g,i] and A of every mass term, whose derivatives are taken, rows of shape (g, n_changing)
    changing: Interpolant
    #: of each of these kinds the number of entries of a term, that of terms that one table is the sum of, and that of
    #: these tables: one, but of loads one for each, as each has an amplitude
    kinds: tuple[tuple[int, int, int], ...]
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
        mass, stiffness, loads, changing = [], [], [], []
        for t in range(len(tables.mass_weights)):
            inertia = 0.5 * (gaps.inertia[:, t, k, h] + gaps.inertia[:, t, h, k])
            along = [gaps.mass[:, t, :, r:]]
            parts = [gaps.mass[:, t], np.swapaxes(inertia, 1, 2)]
            if second:
                swing = np.swapaxes(gaps.curved_inertia[:, t] - gaps.spread[:, t], 1, 2)
                along.append(np.swapaxes(gaps.gyroscopic[:, t], 1, 2).reshape(n, g, r * m))
                pushed = np.swapaxes(gaps.curved_mass[:, t], 1, 2).reshape(n, g, driven * m)
                parts += [swing.reshape(n, g, k.size * m), along[-1], pushed]
            mass.append(np.concatenate(parts, axis=2))
            changing += along
        for t in range(len(tables.stiffness_weights)):
            bent = [gaps.cubic[:, t][:, :, i, j]] if second else []
            stiffness.append(np.concatenate([gaps.stiffness[:, t], *bent], axis=2))
        for t in range(len(tables.load_weights)):
            bent = [gaps.curved_load[:, t]] if second else []
            loads.append(np.concatenate([gaps.load[:, t, :, None], *bent], axis=2))
        damped = () if damping is None else damping.weights
        dampers = [damping.table[:, t, r + m :, : r + m] for t in range(len(damped))]
        dofs = np.concatenate([*loaded, np.zeros(0, dtype=int)])
        moved = gaps.shapes[:, dofs, :, None]
        if gaps.curvature is not None:
            moved = np.concatenate([moved, gaps.curvature[:, dofs]], axis=3)
        local = [np.swapaxes(moved, 1, 2).reshape(n, g, -1)] if dofs.size else []
        kinds = [(own[0].shape[2], len(own), 1) if own else (0, 1, 0) for own in (mass, stiffness, dampers, local)]
        kinds.insert(2, (1 + (m if second else 0), 1, len(loads)))
        every = [*mass, *stiffness, *loads, *dampers, *local]
        return cls(
            interpolant(tables.samples, np.concatenate(every, axis=2), scheme),
            interpolant(tables.samples, np.concatenate(changing, axis=2), scheme), tuple(kinds),
            (tables.mass_weights, tables.stiffness_weights, tables.load_weights, damped),
            tables.load_effects, (r, m, second, driven), 0.0 if damping is None else damping.mass, quadratic,
        )  # fmt: skip

    def at(
        self, times: np.ndarray, states: State, values: Mapping[str, np.ndarray], effects: Sequence[Effect],
        loads: np.ndarray, n_samples: int,
    ) -> np.ndarray:  # fmt: skip
        """Return the rows (g, n) in states (n, n_eta) at times (n,), s.

        States are those of all samples at one instant after the other, and parameter values those of the samples,
        (n_samples,) each; `loads` are those of local effects on the unknowns that they act on, (n, n_dofs).
        """
        n, by_name = len(states.q), {effect.name: effect for effect in effects}
        amplitudes = np.empty((len(self.load_effects), n))
        weights = np.ones((sum(map(len, self.weights)) + 1, n_samples))  # the last one of local effects
        for row, weight in zip(weights, (weight for own in self.weights for weight in own)):
            row[:] = weight.evaluate(values)
        instants = times if n_samples == n else times[::n_samples]
        for row, name in zip(amplitudes, self.load_effects):
            row.reshape(instants.size, -1)[:] = by_name[name].amplitude(instants)[:, None]
        (g, _), r, n = self.table.shape, self.sizes[0], self.sizes[0] + self.sizes[1]
        n_changing = self.changing.shape[1] // len(self.weights[0])
        n_factors = sum(length * tables for length, _, tables in self.kinds)
        sizes = (N_ROWS**r, N_ROWS, n, n, n, len(weights), n_factors, r * n_changing, g)
        work = tuple(aligned_zeros((size, LANES)) for size in sizes)
        # one layout, one compiled function
        theta, *moving = map(np.ascontiguousarray, (states.q[:, :r], states.q, states.v, states.a))
        tables = (one.rows.reshape(-1, *one.shape) for one in (self.table, self.changing))
        cells, found = cells_of(theta, self.table.axes), np.empty((g, len(theta)))
        _fill(
            self.sizes, self.kinds, self.mass_damping, self.quadratic, weights, amplitudes, np.ascontiguousarray(loads),
            (theta, *moving), self.table.axes, *tables, cells, by_cell(cells), work, found,
        )  # fmt: skip
        return found


@njit(cache=True, entry=True, error_model="numpy", fastmath={"contract"})
def _fill(
    sizes, kinds, mass_damping, quadratic, weights, amplitudes, loads, states, axes, table, changing, cells, order,
    work, found,
):  # fmt: skip
    """Fill the rows (g, n) of states (n, n_eta), of samples with weights of the terms (n_terms, n_samples), at one
    instant after the other, with amplitudes of loads (n_loads, n) and loads of local effects (n, n_dofs), LANES that
    are in one cell (n,) side by side, as an order (n,) has them: whichever sample they are of, as the tables are more
    than the processor's cache holds, and what they say of a cell is not.

    `work` has room for weights of rows and those along an axis, q, v, a, weights of terms, factors, slopes and
    rows, all of them vectors.
    """
    (theta, q, rates, accelerations), r, n_samples = states, sizes[0], weights.shape[1]
    of_rows, along, at, rate, own, of_terms, factors, slopes, sums = work
    one_axis, n_rows, n_slopes = stencil_room(), N_ROWS ** len(axes), changing.shape[2] // kinds[0][1]
    rows, spare, first = np.empty(n_rows, dtype=np.int64), np.empty(n_rows), 0
    of_changes = ((n_slopes, kinds[0][1], 1),)
    while first < order.size:
        together = order[first : end_of_cell(cells, order, first)]
        tensor_stencil(theta[together[0]], axes, -1, one_axis, rows, spare)
        for lane in range(together.size):
            s = together[lane]
            for x in range(q.shape[1]):
                at[x, lane], rate[x, lane], own[x, lane] = q[s, x], rates[s, x], accelerations[s, x]
            for t in range(weights.shape[0]):
                of_terms[t, lane] = weights[t, s % n_samples]
        _fill_factors(
            sizes, kinds, mass_damping, quadratic, amplitudes, loads, together, at, rate, own, factors, slopes
        )
        fill_lane_weights(theta, axes, together, -1, along, of_rows)
        for g in range(table.shape[1]):
            store(sums, g, _summed(table, rows, g, kinds, of_terms, of_rows, factors, 0))
        for k in range(r):
            fill_lane_weights(theta, axes, together, k, along, of_rows)
            for g in range(table.shape[1]):
                add(sums, g, _summed(changing, rows, g, of_changes, of_terms, of_rows, slopes, k * n_slopes))
        for g in range(table.shape[1]):
            for lane in range(together.size):
                found[g, together[lane]] = sums[g, lane]
        first += together.size


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _fill_factors(sizes, kinds, mass_damping, quadratic, amplitudes, loads, together, q, rate, own, factors, slopes):
    """Fill the factors F of `_fill` and, coordinate after coordinate, G; `own` has the accelerations."""
    r, m, second, _ = sizes
    fill_inertia(sizes, mass_damping, quadratic, q, rate, own, factors, slopes, slopes.shape[0] // r)
    begin = kinds[0][0]
    if kinds[1][2]:
        fill_elasticity(sizes, q, factors, begin)
    begin += kinds[1][0] * kinds[1][2]
    for number in range(amplitudes.shape[0]):
        for lane in range(together.size):
            factors[begin, lane] = -amplitudes[number, together[lane]]
        for i in range(m if second else 0):
            store(factors, begin + 1 + i, load(factors, begin) * load(q, r + i))
        begin += kinds[2][0]
    for x in range(r + m if kinds[3][2] else 0):
        store(factors, begin + x, load(rate, x))
    begin += kinds[3][0] * kinds[3][2]
    for f in range(loads.shape[1] if kinds[4][2] else 0):
        for lane in range(together.size):
            factors[begin, lane] = -loads[together[lane], f]
        for i in range(m if second else 0):
            store(factors, begin + 1 + i, load(factors, begin) * load(q, r + i))
        begin += 1 + (m if second else 0)


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _summed(table, rows, gap, kinds, of_terms, of_rows, factors, begin):
    """Return the sums of products of a gap's entries in some rows of a table (n_rows, g, n), with weights of these rows
    and of the terms, and factors from the first one on, those of a kind for all its terms: four rows in one pass."""
    total = spread(0.0)
    for p in range(0, rows.size, N_ROWS):
        one, two, three, four = load(of_rows, p), load(of_rows, p + 1), load(of_rows, p + 2), load(of_rows, p + 3)
        row_0, row_1 = table[rows[p], gap], table[rows[p + 1], gap]
        row_2, row_3 = table[rows[p + 2], gap], table[rows[p + 3], gap]
        term, entry, first = 0, 0, begin
        for n, n_terms, n_tables in kinds:
            for _ in range(n_tables):
                for _ in range(n_terms):
                    a, b, c, d = spread(0.0), spread(0.0), spread(0.0), spread(0.0)
                    for e in range(n):
                        x, of = load(factors, first + e), entry + e
                        a, b, c, d = a + x * row_0[of], b + x * row_1[of], c + x * row_2[of], d + x * row_3[of]
                    total += load(of_terms, term) * (one * a + two * b + three * c + four * d)
                    term, entry = term + 1, entry + n
                first += n
    return total
