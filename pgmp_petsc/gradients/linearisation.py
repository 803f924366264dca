"""The reduced equations of one sample linearised along its run.

At every instant, with r the residual of the equations of motion, local effects included,

    by_q, by_v, by_a = d r/d eta, d r/d eta', d r/d eta'',     by_parameters = d r/d p_j at a fixed state.

All of them are exact derivatives of what is interpolated but for the second derivatives of local effects' measures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.dynamics.second_order_system import Scheme, State
from pgmp_petsc.gradients.elimination import factorise, hold, substitute
from pgmp_petsc.gradients.jets import cell_of, fill_basis, fill_jet, n_jets, weigh
from pgmp_petsc.gradients.lagrangian import fill_balance, fill_tangents, room, take_up
from pgmp_petsc.gradients.local_effects import Edge, LocalDerivatives
from pgmp_petsc.models import LengthLanes, ReducedModel
from pgmp_petsc.runtime.compiled import njit
from pgmp_petsc.runtime.vectors import N_POWERS, N_POWERS_OF_RIGID


@dataclass(frozen=True, eq=False)
class Linearised:
    """Derivatives of the residual at some instants.

    Attributes
    ----------
    by_q, by_v, by_a
        With coordinates, velocities and accelerations, shape (n_t, n_eta, n_eta).
    by_parameters
        With the parameters, shape (n_t, n_parameters, n_eta).
    residual
        The residual itself, shape (n_t, n_eta).
    """

    by_q: np.ndarray
    by_v: np.ndarray
    by_a: np.ndarray
    by_parameters: np.ndarray
    residual: np.ndarray


class Linearisation:
    """Derivatives of the equations of motion of one sample.

    Parameters
    ----------
    model
        The reduced model.
    values
        Value of every parameter.
    names
        Parameters to differentiate with.
    """

    def __init__(self, model: ReducedModel | LengthLanes, values: Mapping[str, float], names: Sequence[str]) -> None:
        self._terms, self.names, self.values = model.terms, tuple(names), dict(values)
        terms, tables = model.terms, model.terms.tables
        self._weights = _weights(terms.weights, values, names)
        self._load_weights = _weights(tables.load_weights, values, names)
        by_name = {effect.name: effect for effect in model.effects}
        self._load_effects = [by_name[name] for name in tables.load_effects]
        self._local = LocalDerivatives(model, values, names)
        self._prescribed = np.array([k in model.motions for k in terms.layout.rigid])

    def at(self, times: np.ndarray, states: State, scheme: Scheme | None = None, with_time: bool = False) -> Linearised:
        """Return the derivatives at times (n_t,), in states of which each array has the shape (n_t, n_eta).

        With a scheme they are those at the end of its steps, where the engine's iteration leaves a part of 1e-11 of the
        mechanism's size: little of the coordinates, but more of the accelerations. One more correction takes that away.
        If asked for, the derivative with time in a given state is the last of those with the parameters.
        """
        n_t, n = states.q.shape
        strengths = np.array([effect.strength.with_rates(times) for effect in self._load_effects]).reshape(-1, 3, n_t)
        weights, loads = self._weights, np.einsum("sl,lt->tsl", self._load_weights, strengths[:, 0])
        if with_time:
            weights = np.concatenate([weights, np.zeros_like(weights[:1])])
            loads = np.concatenate([loads, (self._load_weights[0] * strengths[:, 1].T)[:, None]], axis=1)
        result = Linearised(
            *(np.zeros((n_t, n, n)) for _ in range(3)),
            np.zeros((n_t, len(weights) - 1, n)),
            np.zeros((n_t, n)),
        )
        self._local.add(times, states, result.by_q, result.by_v, result.by_parameters, result.residual)
        damping, gains = self._terms.damping, (0.0, 0.0) if scheme is None else (scheme.gain_v, scheme.gain_a)
        _linearise(
            self._terms.layout, self._terms.grid, self._terms.polynomials, weights, np.ascontiguousarray(loads),
            0.0 if damping is None else damping.mass, self._prescribed, gains,
            tuple(np.ascontiguousarray(part) for part in (states.q, states.v, states.a)),
            (result.by_q, result.by_v, result.by_a, result.by_parameters, result.residual),
        )  # fmt: skip
        return result

    def depths(self, times: np.ndarray, states: State) -> np.ndarray:
        """Return how far every edge of a law is crossed (negative: not), shape (n_t, n_events)."""
        return self._local.depths(times, states)

    def edge(self, event: int, time: float, state: State) -> Edge:
        """Return the derivatives of how far an edge is crossed, in a state whose arrays have the shape (1, n_eta)."""
        return self._local.edge(event, time, state)


def _weights(monomials: Sequence[Monomial], values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
    """Return the weights of terms and their derivatives with each parameter, shape (1 + n_parameters, n_terms)."""
    rows = [[monomial.evaluate(values) for monomial in monomials]]
    rows += [[monomial.derivative(name, values) for monomial in monomials] for name in names]
    return np.array(rows, dtype=float).reshape(1 + len(names), len(monomials))


@njit(cache=True, entry=True, error_model="numpy")
def _linearise(layout, grid, tables, weights, loads, mass_damping, prescribed, gains, states, result):
    """Add the derivatives at all instants to those of local effects.

    Parameters
    ----------
    weights, loads
        Of terms, (n_sets, n_terms), and of load terms with their amplitudes, (n_t, n_sets, n_load_terms): of the
        sample, and their derivatives with the parameters.
    prescribed
        Whether a coordinate's motion is given, shape (n_theta,).
    gains
        ``(gain_v, gain_a)`` of the step that ends here, zero where the states are to be taken as they are.
    states
        Coordinates, velocities and accelerations, (n_t, n_eta) each.
    result
        See `Linearised`; the residual is that before a correction.
    """
    all_by_q, all_by_v, all_by_a, by_parameters, residual = result
    r, n, n_sets = len(layout.rigid), layout.n_eta, weights.shape[0]
    n_rigid, n_rows = r * (r + 1) // 2, n_jets(r)
    n_c, n_c_rigid = N_POWERS**r, N_POWERS_OF_RIGID**r
    of_rigid, of_terms = np.empty((n_sets, n_c_rigid, n_rigid)), np.empty((n_sets, n_c, layout.end))
    of_loads = np.zeros((n_c, layout.load_end))
    place, last = np.empty(r), -1
    basis, basis_of_rigid = np.empty((n_rows, n_c)), np.empty((n_rows, n_c_rigid))
    jet, rigid_jet = np.empty((n_rows, layout.end)), np.empty((n_rows, n_rigid))
    load_jet = np.zeros((n_rows, layout.load_end))
    slopes = np.empty((r, layout.end)), np.empty((r, layout.load_end))
    work, moment, balance = room(layout), np.empty((4, n)), np.empty(n)
    by_q, by_v, by_a = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    matrix, order, factorised = np.empty((n, n)), np.empty(n, dtype=np.int64), False
    q, v, a = np.empty(n), np.empty(n), np.empty(n)
    correcting = gains[1] > 0.0
    for t in range(states[0].shape[0]):
        for i in range(n):
            q[i], v[i], a[i] = states[0][t, i], states[1][t, i], states[2][t, i]
        cell = cell_of(q, grid, place)
        if cell != last:
            for s in range(n_sets):
                weigh(tables.rigid[cell], weights[s], of_rigid[s])
                weigh(tables.terms[cell], weights[s], of_terms[s])
            last = cell
        fill_basis(place, N_POWERS, basis)
        fill_basis(place, N_POWERS_OF_RIGID, basis_of_rigid)
        fill_jet(basis, of_terms[0], n_rows, jet)
        fill_jet(basis_of_rigid, of_rigid[0], n_rows, rigid_jet)
        jet[:, :n_rigid] = rigid_jet
        if loads.shape[2] > 0:
            weigh(tables.loads[cell], loads[t, 0], of_loads)
            fill_jet(basis, of_loads, n_rows, load_jet)
        take_up(layout, q, v, a, mass_damping, moment)
        fill_balance(layout, jet, load_jet, moment, work, balance)
        for i in range(n):
            residual[t, i] += balance[i]
        # what is to be taken away is so small that the matrix of the step before will do, and the same tables
        for _ in range(2 if correcting and not factorised else 1):
            if factorised:
                balance[:] = residual[t]
                for k in range(r):
                    if prescribed[k]:
                        balance[k] = 0.0
                substitute(matrix, order, balance)
                for i in range(n):
                    q[i], v[i], a[i] = q[i] - balance[i], v[i] - gains[0] * balance[i], a[i] - gains[1] * balance[i]
                take_up(layout, q, v, a, mass_damping, moment)
            fill_tangents(layout, jet, load_jet, moment, mass_damping, work, slopes, balance, by_q, by_v, by_a)
            if correcting:
                for i in range(n):
                    for j in range(n):
                        of_step = gains[0] * (by_v[i, j] + all_by_v[t, i, j]) + gains[1] * by_a[i, j]
                        matrix[i, j] = by_q[i, j] + all_by_q[t, i, j] + of_step
                hold(prescribed, matrix, balance)
                factorise(matrix, order)
                factorised = True
        for i in range(n):
            for j in range(n):
                all_by_q[t, i, j] += by_q[i, j]
                all_by_v[t, i, j] += by_v[i, j]
                all_by_a[t, i, j] += by_a[i, j]
        for s in range(1, n_sets):
            fill_jet(basis, of_terms[s], 1 + r, jet)
            fill_jet(basis_of_rigid, of_rigid[s], 1 + r, rigid_jet)
            jet[:, :n_rigid] = rigid_jet
            if loads.shape[2] > 0:
                weigh(tables.loads[cell], loads[t, s], of_loads)
                fill_jet(basis, of_loads, 1 + r, load_jet)
            fill_balance(layout, jet, load_jet, moment, work, balance)
            for i in range(n):
                by_parameters[t, s - 1, i] += balance[i]
