"""The reduced equations of one sample linearised along its run; compiled.

At every instant, with r the residual of the equations of motion, local effects included,

    by_q, by_v, by_a = d r/d eta, d r/d eta', d r/d eta'',     by_parameters = d r/d p_j at a fixed state.

All of them are exact derivatives of what is interpolated but for the second derivatives of local effects' measures.
The run is known, so that its instants need no order: those in the same cell of the tables are taken together, LANES of
them at once. In a cell every entry of a table is a polynomial of the place (`reduced.arrays.Tables`). With the weights
w of one sample, or their derivatives with a parameter, in place of those of all terms,

    A = sum_t w_t sum_c C_tc prod_k x_k^(c_k),

and a jet of it has the value, the slopes ``d_k A`` and the second derivatives ``d_k d_l A``, those of each
slope together: jets of all entries are vectors (n_entries, n_jets, LANES).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba import types

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.gradients.local_effects import LocalDerivatives
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import WIDE, aligned, items
from pgmp_petsc.lanes.tiles import store_rows
from pgmp_petsc.lanes.vectors import (
    LANES,
    N_POWERS,
    N_POWERS_OF_RIGID,
    built,
    derivatives_of,
    load_rows,
    spread,
    vector,
    widened,
)
from pgmp_petsc.models import Observing
from pgmp_petsc.reduced.arrays import Layout
from pgmp_petsc.reduced.cells import Grid, place_of
from pgmp_petsc.reduced.lagrangian import fill_residual, fill_tangents
from pgmp_petsc.stepping.second_order_system import State


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def weigh(terms, weights, coefficients):
    """Fill coefficients (n,), numbers or vectors, with the sum of terms (n_terms, n) with weights of their kind."""
    nothing = 0.0 * weights[0]
    for c in range(coefficients.size):
        coefficients[c] = nothing
    for t in range(terms.shape[0]):
        for c in range(coefficients.size):
            coefficients[c] += weights[t] * terms[t, c]


def _jet(n_powers: int, order: int, about: str) -> Callable:
    def wanted(r: int) -> list[tuple[int, ...]]:
        return [which for total in range(order + 1) for which in product(range(r), repeat=total)]

    def evaluate(builder, coefficients, entry, place):
        r = len(place)
        base = builder.mul(entry, ir.Constant(entry.type, n_powers**r))

        def coefficient(number: int) -> ir.Value:
            at = builder.add(base, ir.Constant(base.type, number))
            return coefficients.load(at) if coefficients.of.ndim == 2 else widened(builder, coefficients.number(at))

        found = derivatives_of(builder, coefficient, place, n_powers, order)
        return [found[tuple(which.count(k) for k in range(r))] for which in wanted(r)]

    def typed(coefficients, entry, place):
        return types.UniTuple(vector, len(wanted(len(place))))(coefficients, types.intp, place)

    evaluate.__doc__ = about
    return built(typed)(evaluate)


# Of a polynomial with coefficients (n_entries * n_powers^r,), the same numbers in all lanes, or vectors (..., LANES)
_jet_of = _jet(N_POWERS, 2, "Return the jet of an entry, cubic in each coordinate.")
_slopes_of = _jet(N_POWERS, 1, "Return value and slopes of an entry, cubic in each coordinate.")
_rigid_jet_of = _jet(N_POWERS_OF_RIGID, 2, "Return the jet of an entry of degree 7.")
_rigid_slopes_of = _jet(N_POWERS_OF_RIGID, 1, "Return value and slopes of an entry of degree 7.")


def _filling(jet: Callable, slopes: Callable) -> Callable:
    @njit(error_model="numpy", fastmath={"contract"}, counted=False)
    def fill(coefficients, places, rigid, first, n_entries, whole, jets):
        """Fill the jets of entries from one on, at places (n_theta, LANES): value and slopes, and if `whole` the rest.

        `rigid` is a tuple as long as there are coordinates.
        """
        place, n = load_rows(places, 0, 1, rigid), jets.shape[1]
        for e in range(first, n_entries):
            if whole:
                store_rows(jets, e * n, jet(coefficients, e, place))
            else:
                store_rows(jets, e * n, slopes(coefficients, e, place))

    return fill


fill_jets, fill_rigid_jets = _filling(_jet_of, _slopes_of), _filling(_rigid_jet_of, _rigid_slopes_of)


@dataclass(frozen=True, eq=False)
class Linearised:
    """Derivatives of the residual at some instants."""

    by_q: np.ndarray  # by_q, by_v, by_a: with coordinates, velocities and accelerations, shape (n_t, n_eta, n_eta)
    by_v: np.ndarray
    by_a: np.ndarray
    by_parameters: np.ndarray  # with the parameters, shape (n_t, n_parameters, n_eta)
    residual: np.ndarray  # the residual itself, shape (n_t, n_eta)


class Linearisation:
    """Derivatives of the equations of motion of one sample of a reduced model with the parameters of these names;
    `prescribed` says whether a coordinate is given, shape (n_eta,)."""

    def __init__(self, model: Observing, values: Mapping[str, float], names: Sequence[str]) -> None:
        self._terms, self.names, self.values = model.terms, tuple(names), dict(values)
        terms, tables = model.terms, model.terms.tables
        self._weights = _weights(terms.weights, values, names)
        self._load_weights = _weights(tables.load_weights, values, names)
        by_name = {effect.name: effect for effect in model.effects}
        self._load_effects = [by_name[name] for name in tables.load_effects]
        self.local = LocalDerivatives(model, values, names)
        self.prescribed = tables.prescribed(model.motions)
        self._room = _room(terms.layout, len(tables.load_weights))

    def at(self, times: np.ndarray, states: State, by_time: bool = False, loaded: bool = True) -> Linearised:
        """Return the derivatives at times (n_t,), in states of which each array has the shape (n_t, n_eta).

        If asked for, the derivative with time in a given state is the last of those with the parameters, and loads are
        left out where it is not `loaded`.
        """
        n_t, n = states.q.shape
        strengths = np.array([effect.strength.with_rates(times) for effect in self._load_effects]).reshape(-1, 3, n_t)
        weights, loads = self._weights, np.einsum("sl,lt->tsl", self._load_weights, strengths[:, 0])
        if by_time:
            weights = np.concatenate([weights, np.zeros_like(weights[:1])])
            loads = np.concatenate([loads, (self._load_weights[0] * strengths[:, 1].T)[:, None]], axis=1)
        loads = loads if loaded else np.zeros_like(loads)
        cells, places = _located(self._terms.grid, states.q)
        own = tuple(np.ascontiguousarray(part) for part in (states.q, states.v, states.a))
        result = Linearised(
            *(np.zeros((n_t, n, n)) for _ in range(3)), np.zeros((n_t, len(weights) - 1, n)), np.zeros((n_t, n))
        )
        self.local.add(times, states, result.by_q, result.by_v, result.by_parameters, result.residual)
        damping = self._terms.damping
        _linearise(
            self._terms.layout, self._terms.cells, weights, np.ascontiguousarray(loads),
            0.0 if damping is None else damping.mass, (np.argsort(cells, kind="stable"), cells, places), own,
            self._room, (result.by_q, result.by_v, result.by_a, result.by_parameters, result.residual),
        )  # fmt: skip
        return result


def _weights(monomials: Sequence[Monomial], values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
    """Return the weights of terms and their derivatives with each parameter, shape (1 + n_parameters, n_terms)."""
    rows = [[monomial.evaluate(values) for monomial in monomials]]
    rows += [[monomial.derivative(name, values) for monomial in monomials] for name in names]
    return np.array(rows, dtype=float).reshape(1 + len(names), len(monomials))


class _Room(NamedTuple):
    """Work arrays for LANES instants, arrays of vectors (..., LANES)."""

    place: np.ndarray  # in the cell, (n_theta,), rad
    #: jets, loads, load_jets: of the tables (layout.end, n_jets), coefficients of the loads (layout.load_end *
    #: n_powers**n_theta,), and their jets (layout.load_end, n_jets)
    jets: np.ndarray
    loads: np.ndarray
    load_jets: np.ndarray
    amplitudes: np.ndarray  # weights of the load terms (n_load_terms,)
    state: np.ndarray  # state, moment: coordinates, velocities and accelerations (3, n_eta); see `_take_up`
    moment: np.ndarray
    balance: np.ndarray  # a residual, (n_eta,)
    by_q: np.ndarray  # by_q, by_v, by_a: derivatives, (n_eta, n_eta)
    by_v: np.ndarray
    by_a: np.ndarray


def _room(layout: Layout, n_loads: int) -> _Room:
    """Return room for tables of a layout and a number of load terms."""
    r, n, of_loads = len(layout.rigid), layout.n_eta, layout.load_end
    n_jets = 1 + r + r * r
    shapes = {
        "place": (r,), "jets": (layout.end, n_jets), "loads": (of_loads * N_POWERS**r,),
        "load_jets": (of_loads, n_jets), "amplitudes": (n_loads,), "state": (3, n), "moment": (4, n), "balance": (n,),
    }  # fmt: skip
    square = dict.fromkeys(("by_q", "by_v", "by_a"), (n, n))
    room = _Room(**{name: aligned((*shape, LANES)) for name, shape in (shapes | square).items()})
    room.load_jets[:] = 0.0  # where there are no loads
    return room


@njit(error_model="numpy", counted=False)
def _take_up(layout, state, mass_damping, moment):
    """Fill coordinates, velocities and accelerations as inertia forces see them, and velocities, items (4, n_eta)."""
    for x in range(layout.n_eta):
        moment[0, x], moment[3, x] = state[0, x], state[1, x]
        moment[1, x] = state[1, x] if layout.quadratic else spread(0.0)
        moment[2, x] = state[2, x] + mass_damping * state[1, x]


def _located(grid: Sequence[Grid], theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of the cells of theta (n_t, n_theta or more), (n_t,), and the places there (n_t, n_theta)."""
    cells, places = np.zeros(len(theta), dtype=np.int64), np.empty((len(theta), len(grid)))
    for k, axis in enumerate(grid):
        position = (theta[:, k] - axis.lower) / axis.step
        cell = np.floor(position) if axis.periodic else np.clip(np.floor(position), 0, axis.n_cells - 1)
        places[:, k] = (position - cell) * axis.step
        cells = cells * axis.n_cells + cell.astype(np.int64) % axis.n_cells
    return cells, places


@njit(cache=True, entry=True, error_model="numpy")
def _linearise(layout, tables, weights, loads, mass_damping, located, states, room, result):
    """Add the derivatives at all instants to those of local effects.

    Parameters
    ----------
    weights, loads
        Of terms, (n_sets, n_terms), and of load terms with their amplitudes, (n_t, n_sets, n_load_terms): of the
        sample, and their derivatives with the parameters.
    located
        Instants in the order of their cells (n_t,), and of every instant cell (n_t,) and place (n_t, n_theta).
    states
        Coordinates, velocities and accelerations, (n_t, n_eta) each.
    room
        See `_Room`.
    result
        See `Linearised`.
    """
    all_by_q, all_by_v, all_by_a, by_parameters, residual = result
    turns, cells, places = located
    r, n, n_sets = len(layout.rigid), layout.n_eta, weights.shape[0]
    n_rigid, n_t = r * (r + 1) // 2, turns.size
    of_rigid = np.empty((n_sets, n_rigid * N_POWERS_OF_RIGID**r))
    of_terms = np.empty((n_sets, layout.end * N_POWERS**r))
    at = np.empty(LANES, dtype=np.int64)
    state, moment = items(room.state, WIDE), items(room.moment, WIDE)
    balance, by_q = items(room.balance, WIDE), items(room.by_q, WIDE)
    loaded, first, last, at_load = loads.shape[2] > 0, 0, -1, 0
    while first < n_t:
        cell, count = cells[turns[first]], 1
        while count < LANES and first + count < n_t and cells[turns[first + count]] == cell:
            count += 1
        if cell != last:
            of_cell = tables.rigid.polynomials[place_of(tables.rigid, cell)]
            for s in range(n_sets):
                weigh(of_cell, weights[s], of_rigid[s])
            of_cell = tables.terms.polynomials[place_of(tables.terms, cell)]
            for s in range(n_sets):
                weigh(of_cell, weights[s], of_terms[s])
            last, at_load = cell, place_of(tables.loads, cell)
        of_loads = tables.loads.polynomials[at_load]
        for lane in range(LANES):
            # lanes that are left have the last instant again
            t = at[lane] = turns[first + min(lane, count - 1)]
            for k in range(r):
                room.place[k, lane] = places[t, k]
            for part in range(3):
                for i in range(n):
                    room.state[part, i, lane] = states[part][t, i]
        _fill_all_jets(layout, of_terms[0], of_rigid[0], of_loads, loads, 0, at, True, room)
        _take_up(layout, state, mass_damping, moment)
        fill_residual(layout, room.jets, room.load_jets, 0, 1, layout.rigid, loaded, room.moment, room.balance)
        for lane in range(count):
            for i in range(n):
                residual[at[lane], i] += room.balance[i, lane]
        fill_tangents(
            layout, room.jets, room.load_jets, layout.rigid, loaded, room.moment, room.by_q, room.by_v, room.by_a
        )
        for k in range(r):
            # the residual is linear in the tables: of their derivatives it is its own
            fill_residual(
                layout, room.jets, room.load_jets, 1 + k, 1 + r + k * r, layout.rigid, loaded, room.moment, room.balance
            )
            for i in range(n):
                by_q[i, k] = balance[i]
        for lane in range(count):
            t = at[lane]
            for i in range(n):
                for j in range(n):
                    all_by_q[t, i, j] += room.by_q[i, j, lane]
                    all_by_v[t, i, j] += room.by_v[i, j, lane] + mass_damping * room.by_a[i, j, lane]
                    all_by_a[t, i, j] += room.by_a[i, j, lane]
        for s in range(1, n_sets):
            _fill_all_jets(layout, of_terms[s], of_rigid[s], of_loads, loads, s, at, False, room)
            fill_residual(layout, room.jets, room.load_jets, 0, 1, layout.rigid, loaded, room.moment, room.balance)
            for lane in range(count):
                for i in range(n):
                    by_parameters[at[lane], s - 1, i] += room.balance[i, lane]
        first += count


@njit(cache=True, apart=True, error_model="numpy", counted=False)
def _fill_all_jets(layout, of_terms, of_rigid, of_loads, loads, s, at, whole, room):
    """Fill the jets of all tables with the weights of the set s, at instants `at` (LANES,); see `fill_jets`."""
    n_rigid, amplitudes = len(layout.rigid) * (len(layout.rigid) + 1) // 2, items(room.amplitudes, WIDE)
    fill_jets(of_terms, room.place, layout.rigid, n_rigid, layout.end, whole, room.jets)
    fill_rigid_jets(of_rigid, room.place, layout.rigid, 0, n_rigid, whole, room.jets)
    if loads.shape[2] > 0:
        for lane in range(LANES):
            for j in range(loads.shape[2]):
                room.amplitudes[j, lane] = loads[at[lane], s, j]
        weigh(of_loads, amplitudes, items(room.loads, WIDE))
        fill_jets(room.loads, room.place, layout.rigid, 0, layout.load_end, whole, room.load_jets)
