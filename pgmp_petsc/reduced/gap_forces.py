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
from pgmp_petsc.reduced.terms import ReducedDamping
from pgmp_petsc.reduction.cell_products import stencil_room, tensor_stencil
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
    #: monomials of the terms of mass, stiffness, loads and damping
    weights: tuple[tuple[Monomial, ...], ...]
    load_effects: tuple[str, ...]  # names, of the load terms
    sizes: tuple[int, int, bool, int]  # r, m, whether there are entries of second order, and coordinates k of P
    mass_damping: float  # factor of the damping proportional to the mass, 1/s
    quadratic: bool  # whether inertia forces quadratic in the velocities act

    @classmethod
    def of(
        cls, gaps: JointGaps, tables: ReducedTables, scheme: str, damping: ReducedDamping | None, quadratic: bool
    ) -> Self:
        """Prepare the rows. `damping` is that of a basis that has the vectors of the gaps behind its own."""
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
        return cls(
            interpolant(tables.samples, np.concatenate(parts, axis=2), scheme),
            interpolant(tables.samples, np.concatenate(changing, axis=2), scheme),
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
        found = np.empty((self.table.shape[0], n))
        tables = (part.rows.reshape(-1, *part.shape) for part in (self.table, self.changing))
        _fill(
            self.sizes, counts, self.mass_damping, self.quadratic, weights, states.q, states.v, states.a,
            self.table.axes, *tables, found,
        )  # fmt: skip
        return found


@njit(cache=True, entry=True, error_model="numpy", fastmath={"contract"})
def _fill(sizes, counts, mass_damping, quadratic, weights, q, rates, accelerations, axes, table, changing, found):
    """Fill the rows (g, n) of states (n, n_eta) with weights of the terms (n_terms, n), of the tables' rows (n_rows, g,
    n_entries) and (n_rows, g, n_changing)."""
    (r, m, second, driven), (n_mass, n_stiffness, n_load, n_damping) = sizes, counts
    pairs, n_rows = r * (r + 1) // 2, N_ROWS ** len(axes)
    n_changing = m + (r * m if second else 0)
    # what a term of each kind has, without its weight
    inert, stiff = np.empty(r + 2 * m + pairs + pairs * m + 2 * r * m), np.empty(m + m * (m + 1) // 2)
    changed, worked, v = np.empty((r, n_changing)), np.empty(1 + m), np.empty(r + m)
    n_inert, n_stiff, n_worked = r + m + pairs, m, 1
    if second:
        n_inert, n_stiff, n_worked = n_inert + (pairs + r + driven) * m, m + m * (m + 1) // 2, 1 + m
    factors, slopes = np.empty(table.shape[2]), np.empty(changing.shape[2])
    one_axis, rows, of_rows = stencil_room(), np.empty(n_rows, dtype=np.int64), np.empty(n_rows)
    for s in range(q.shape[0]):
        theta, d, rate = q[s, :r], q[s, r:], rates[s]
        for x in range(r + m):
            v[x] = rate[x] if quadratic else 0.0
            inert[x] = accelerations[s, x] + mass_damping * rate[x]
        for k in range(r):
            for i in range(m):
                changed[k, i] = v[k] * v[r + i] + 0.5 * inert[k] * d[i]
        into, swing, bent = r + m, r + m + pairs, m
        for k in range(r):
            for j in range(k + 1):
                inert[into] = (1.0 if k == j else 2.0) * v[k] * v[j]
                if second:
                    for i in range(m):
                        inert[swing + i] = inert[into] * d[i]
                    swing += m
                into += 1
        worked[0] = -1.0
        for i in range(m):
            stiff[i] = d[i]
            worked[1 + i] = -d[i]
        if second:
            for h in range(r):
                for i in range(m):
                    inert[swing + i] = -2.0 * v[h] * v[r + i] - inert[h] * d[i]
                swing += m
                for k in range(r):
                    for i in range(m):
                        changed[k, m + h * m + i] = -v[k] * v[h] * d[i]
            for h in range(driven):
                for i in range(m):
                    inert[swing + i] = inert[h] * d[i]
                swing += m
            for i in range(m):
                for j in range(i):
                    stiff[bent + j] = d[i] * d[j]
                stiff[bent + i] = 0.5 * d[i] * d[i]
                bent += i + 1
        into = _weigh(inert, n_inert, weights, 0, n_mass, s, factors, 0)
        into = _weigh(stiff, n_stiff, weights, n_mass, n_stiffness, s, factors, into)
        into = _weigh(worked, n_worked, weights, n_mass + n_stiffness, n_load, s, factors, into)
        _weigh(rate, r + m, weights, n_mass + n_stiffness + n_load, n_damping, s, factors, into)
        for g in range(found.shape[0]):
            found[g, s] = 0.0
        tensor_stencil(theta, axes, -1, one_axis, rows, of_rows)
        _add(table, rows, of_rows, factors, found, s)
        for k in range(r):
            _weigh(changed[k], n_changing, weights, 0, n_mass, s, slopes, 0)
            tensor_stencil(theta, axes, k, one_axis, rows, of_rows)
            _add(changing, rows, of_rows, slopes, found, s)


@njit(error_model="numpy", fastmath={"contract", "reassoc"})
def _add(table, rows, weights, factors, found, sample):
    """Add products of some rows of a table (n_rows, g, n), with weights, and factors (n,) to those of a sample."""
    for p in range(rows.size):
        for g in range(table.shape[1]):
            total, entries = 0.0, table[rows[p], g]
            for e in range(factors.size):
                total += factors[e] * entries[e]
            found[g, sample] += weights[p] * total


@njit(inline="always")
def _weigh(entries, n, weights, first, count, sample, found, into):
    """Put the first n entries, with the weights of some terms, one after the other; return where they end."""
    for term in range(first, first + count):
        for e in range(n):
            found[into + e] = weights[term, sample] * entries[e]
        into += n
    return into
