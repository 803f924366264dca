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
from pgmp_petsc.dynamics.second_order_system import State
from pgmp_petsc.gradients.jets import cell_of, fill_basis, fill_jet, n_jets, second, weigh
from pgmp_petsc.gradients.lagrangian import fill_derivatives, fill_residual, room
from pgmp_petsc.gradients.local_effects import LocalDerivatives
from pgmp_petsc.models import ReducedModel
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

    def __init__(self, model: ReducedModel, values: Mapping[str, float], names: Sequence[str]) -> None:
        self._terms, self.names = model.terms, tuple(names)
        terms, tables = model.terms, model.terms.tables
        self._weights = _weights(terms.weights, values, names)
        self._load_weights = _weights(tables.load_weights, values, names)
        by_name = {effect.name: effect for effect in model.effects}
        self._load_effects = [by_name[name] for name in tables.load_effects]
        self._local = LocalDerivatives(model, values, names)

    def at(self, times: np.ndarray, states: State) -> Linearised:
        """Return the derivatives at times (n_t,), in states of which each array has the shape (n_t, n_eta)."""
        n_t, n = states.q.shape
        amplitudes = np.array([effect.amplitude(times) for effect in self._load_effects]).reshape(-1, n_t)
        loads = np.einsum("sl,lt->tsl", self._load_weights, amplitudes)
        result = Linearised(
            *(np.zeros((n_t, n, n)) for _ in range(3)),
            np.zeros((n_t, len(self.names), n)),
            np.zeros((n_t, n)),
        )
        mass_damping = 0.0 if self._terms.damping is None else self._terms.damping.mass
        q, v, a = (np.ascontiguousarray(part) for part in (states.q, states.v, states.a))
        _linearise(
            self._terms.layout, self._terms.grid, self._terms.polynomials, self._weights, np.ascontiguousarray(loads),
            mass_damping, q, v, a,
            (result.by_q, result.by_v, result.by_a, result.by_parameters, result.residual),
        )  # fmt: skip
        result.by_v[:] += mass_damping * result.by_a
        self._local.add(times, states, result.by_q, result.by_v, result.by_parameters, result.residual)
        return result

    def crossed(self, times: np.ndarray, states: State) -> list[str]:
        """Return the effects whose laws have edges that the states cross from one instant to the next."""
        return self._local.crossed(times, states)


def _weights(monomials: Sequence[Monomial], values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
    """Return the weights of terms and their derivatives with each parameter, shape (1 + n_parameters, n_terms)."""
    rows = [[monomial.evaluate(values) for monomial in monomials]]
    rows += [[monomial.derivative(name, values) for monomial in monomials] for name in names]
    return np.array(rows, dtype=float).reshape(1 + len(names), len(monomials))


@njit(cache=True, entry=True, error_model="numpy")
def _linearise(layout, grid, tables, weights, loads, mass_damping, q, rate, acceleration, result):
    """Fill the derivatives at all instants.

    Parameters
    ----------
    weights, loads
        Of terms, (n_sets, n_terms), and of load terms with their amplitudes, (n_t, n_sets, n_load_terms): of the
        sample, and their derivatives with the parameters.
    q, rate, acceleration
        (n_t, n_eta).
    result
        See `Linearised`.
    """
    by_q, by_v, by_a, by_parameters, residual = result
    r, n, n_sets = len(layout.rigid), layout.n_eta, weights.shape[0]
    n_rigid, n_rows = r * (r + 1) // 2, n_jets(r)
    n_c, n_c_rigid = N_POWERS**r, N_POWERS_OF_RIGID**r
    of_rigid, of_terms = np.empty((n_sets, n_c_rigid, n_rigid)), np.empty((n_sets, n_c, layout.end))
    of_loads = np.zeros((n_c, layout.load_end))
    place, last = np.empty(r), -1
    basis, basis_of_rigid = np.empty((n_rows, n_c)), np.empty((n_rows, n_c_rigid))
    jet, rigid_jet = np.empty((n_rows, layout.end)), np.empty((n_rows, n_rigid))
    load_jet = np.zeros((n_rows, layout.load_end))
    slope, load_slope = np.empty((r, layout.end)), np.empty((r, layout.load_end))
    work, v, a, column = room(layout), np.zeros(n), np.empty(n), np.empty(n)
    for t in range(q.shape[0]):
        cell = cell_of(q[t], grid, place)
        if cell != last:
            for s in range(n_sets):
                weigh(tables.rigid[cell], weights[s], of_rigid[s])
                weigh(tables.terms[cell], weights[s], of_terms[s])
            last = cell
        fill_basis(place, N_POWERS, basis)
        fill_basis(place, N_POWERS_OF_RIGID, basis_of_rigid)
        for x in range(n):
            v[x] = rate[t, x] if layout.quadratic else 0.0
            a[x] = acceleration[t, x] + mass_damping * rate[t, x]
        for s in range(n_sets - 1, -1, -1):  # the sample itself last: its jets are needed further
            n_wanted = n_rows if s == 0 else 1 + r
            fill_jet(basis, of_terms[s], n_wanted, jet)
            fill_jet(basis_of_rigid, of_rigid[s], n_wanted, rigid_jet)
            jet[:, :n_rigid] = rigid_jet
            if loads.shape[2] > 0:
                weigh(tables.loads[cell], loads[t, s], of_loads)
                fill_jet(basis, of_loads, n_wanted, load_jet)
            into = residual[t] if s == 0 else by_parameters[t, s - 1]
            fill_residual(
                layout, jet[0], jet[1 : 1 + r], load_jet[0], load_jet[1 : 1 + r], q[t], v, a, rate[t], work, into
            )
        fill_derivatives(
            layout, jet[0], jet[1 : 1 + r], load_jet[0], load_jet[1 : 1 + r], q[t], v, a, work, by_q[t], by_v[t], by_a[t]
        )
        for k in range(r):
            for h in range(r):
                slope[h], load_slope[h] = jet[second(r, k, h)], load_jet[second(r, k, h)]
            fill_residual(layout, jet[1 + k], slope, load_jet[1 + k], load_slope, q[t], v, a, rate[t], work, column)
            by_q[t, :, k] = column
