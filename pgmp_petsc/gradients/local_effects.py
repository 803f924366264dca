"""Derivatives of what local effects add to the equations of motion of one sample, along its run.

An action (`effects.action`) with the measure s of two frames adds ``- F(s, s', p) g`` with ``g = d s/d eta``, as the
engine evaluates it (`reduced.action_kernel`), so that with ``H = d g/d eta``, k = -dF/ds and c = -dF/ds'

    by_q += k g g^T + c g (H eta')^T - F H,     by_v += c g g^T,     by_parameters -= (dF/dp) g.

Of a law that is led by the action before it, with the measure s and the gradient l there, it is ``k g l^T + c g (L
eta')^T - F H`` and ``c g l^T``. H follows from differences of g, which is exact; they leave 1e-8 of it. Where the
places of actions depend on a length, ``by_parameters += (k ds/dl + c ds'/dl) g - F dg/dl`` with differences of fourth
order along it of the measure, its rate and g, in which places are polynomials. The law itself is not differenced: the
force of a stop has a corner where it is met, and k has to be that of ``by_q``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.effects.action import BY_LOAD, LED, amplitudes_over
from pgmp_petsc.effects.law import differentiate, obey
from pgmp_petsc.full.part_reference import Reference, loaded
from pgmp_petsc.gradients.differences import CENTRAL
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import aligned
from pgmp_petsc.lanes.vectors import LANES, add, load, same_in_all_lanes, spread, store
from pgmp_petsc.models import Observing
from pgmp_petsc.reduced.action_frames import KeptPlaces, place_nodes
from pgmp_petsc.reduced.action_kernel import LEADING, MEASURE, RATE, LocalEffects, LocalWork, measure
from pgmp_petsc.stepping.second_order_system import State

DIFFERENCE = 1e-8  # in rad, and of flexible coordinates in units of the mechanism's size or of 1 rad
ALONG_LENGTH = 1e-3  # of half the range of a length: truncation leaves 1e-12 of it, rounding 1e-13
OFFSETS, OF_FOURTH_ORDER = (np.delete(one, 2) for one in (CENTRAL[0], CENTRAL[1][0]))  # not of the run itself
S, SPEED, FORCE, STIFFNESS, DAMPING = range(5)  # what is measured of an action


@dataclass(frozen=True, eq=False)
class Edge:
    """How far an edge of a law is crossed, depth, in a state: its derivatives."""

    effect: str  # name of the effect
    #: gradient, by_parameters: with the reduced coordinates, shape (n_eta,), and with the parameters in a given state,
    #: (n_parameters,)
    gradient: np.ndarray
    by_parameters: np.ndarray
    rate: float  # rate, acceleration: with time along the motion, per s and per s2
    acceleration: float


class LocalDerivatives:
    """Derivatives of the local effects of one sample.

    Parameters
    ----------
    model, values, names
        As of `Linearisation`.
    """

    def __init__(self, model: Observing, values: Mapping[str, float], names: Sequence[str]) -> None:
        self._actions, self._terms = model.actions.actions, model.terms
        of_sample = {name: np.array([value]) for name, value in values.items()}
        self._local = model.actions.of_samples(of_sample, 1)
        weights = model.actions.weights
        self._room = Reference(_Room.of(self._local, len(self._terms.grid), self._terms.layout.n_eta))
        self._weights = same_in_all_lanes(evaluate_weights(weights, values))
        places = {place.name: place for weight in weights for place, _ in weight.places}
        # weights beside those of a length, by its number: how far these are (m), and the factors of differences
        self._beside: dict[int, list[tuple[float, np.ndarray]]] = {}
        for number, name in enumerate(names):
            for far, factor in zip(OFFSETS, OF_FOURTH_ORDER):
                if name in places:
                    step = ALONG_LENGTH * places[name].half
                    there = evaluate_weights(weights, {**values, name: values[name] + far * step})
                    self._beside.setdefault(number, []).append((factor / step, same_in_all_lanes(there)))
        self._edges = model.actions.edges
        self._led, self._by_load = (np.flatnonzero(self._local.actions.roles == role) for role in (LED, BY_LOAD))
        self._addresses = np.array([action.law.address_of_slopes for action in self._actions], dtype=np.int64)
        # changes of the parameters of laws with those of the scene, (n_parameters, n_actions, of one law)
        self._changes = np.zeros((len(names), *self._local.actions.parameters.shape[::2]))
        for row, name in zip(self._changes, names):
            for action, table in zip(self._actions, row):
                for k, quantity in enumerate(action.parameters):
                    table[k] = quantity.derivative(name, values)

    def add(
        self, times: np.ndarray, states: State, by_q: np.ndarray, by_v: np.ndarray, by_parameters: np.ndarray,
        residual: np.ndarray,
    ) -> None:  # fmt: skip
        """Add all local effects to the residual and its derivatives; see `Linearised`.

        A row of `by_parameters` behind those of the parameters is that with time.
        """
        if not self._actions:
            return
        gradient, measured, slopes, _ = self._measured(times, states.q, states.v, self._weights)
        force, stiffness, damping = (measured[:, :, row] for row in (FORCE, STIFFNESS, DAMPING))
        residual -= _summed(force, gradient)
        across, leading = np.swapaxes(gradient, 1, 2), gradient
        pushes = np.zeros_like(force)  # minus the derivatives with the rate of the action before
        if self._led.size or self._by_load.size:
            leading = gradient.copy()
            leading[:, self._led] = gradient[:, self._led - 1]
        by_v += np.matmul(across * damping[:, None], leading)
        for number in self._by_load:
            pushes[:, number] = -slopes[:, number, len(self._actions[number].parameters)]
            leading[:, number] = gradient[:, number - 1]
            by_v += pushes[:, number, None, None] * gradient[:, number, :, None] * gradient[:, number - 1, None]
        by_q += np.matmul(across * stiffness[:, None], leading)
        _bend(
            self._local, self._weights, self._terms.grid, self._room, DIFFERENCE / self._terms.scale,
            np.ascontiguousarray(states.q), np.ascontiguousarray(states.v), measured, pushes, by_q,
        )  # fmt: skip
        for number, beside in self._beside.items():
            for factor, weights in beside:
                at, found, *_ = self._measured(times, states.q, states.v, weights)
                pushed = stiffness * found[:, :, S] + damping * found[:, :, SPEED]
                by_parameters[:, number] += factor * (_summed(pushed, gradient) - _summed(force, at))
        for number, (action, own) in enumerate(zip(self._actions, self._changes.transpose(1, 0, 2))):
            n = len(action.parameters)
            if own.any():
                found = slopes[:, number, :n]
                by_parameters[:, : len(own)] -= np.einsum("pk,tk,ti->tpi", own[:, :n], found, gradient[:, number])
            if action.amplitude is not None and by_parameters.shape[1] > len(own):
                rate = action.amplitude.with_rates(times)[1] * slopes[:, number, n]
                by_parameters[:, -1] -= rate[:, None] * gradient[:, number]

    def depths(self, times: np.ndarray, states: State) -> np.ndarray:
        """Return how far every edge of a law is crossed (negative: not), shape (n_t, n_events)."""
        if not self._edges:
            return np.zeros((len(times), 0))
        return self._measured(times, states.q, states.v, self._weights)[3]

    def edge(self, event: int, time: float, state: State) -> Edge:
        """Return the derivatives of how far an edge is crossed, in a state whose arrays have the shape (1, n_eta)."""
        (number, of_law), times = self._edges[event], np.array([time])
        action = self._actions[number]
        gradient, measured, *_ = self._measured(times, state.q, state.v, self._weights)
        # along the motion, over a time that moves no coordinate further than the differences above
        turn = DIFFERENCE / max(np.abs(state.v * self._terms.scale).max(), 1.0)
        ahead = self._measured(times, state.q + turn * state.v, state.v, self._weights)[0]
        gradient, turned = gradient[0, number], (ahead - gradient)[0, number] / turn
        s, speed = measured[0, number, [S, SPEED]]
        slope, bend, own = action.law.edge_slopes(of_law, self._local.actions.parameters[number, 0], s)
        by_parameters = self._changes[:, number, : own.size] @ own
        for length, beside in self._beside.items():
            for factor, weights in beside:
                by_parameters[length] += factor * self._measured(times, state.q, state.v, weights)[3][0, event]
        rate = float(gradient @ state.a[0] + turned @ state.v[0])
        return Edge(action.effect, slope * gradient, by_parameters, slope * speed, slope * rate + bend * speed**2)

    def _measured(
        self, times: np.ndarray, q: np.ndarray, v: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return gradients of the measures (n_t, n_actions, n_eta), what is measured (n_t, n_actions, 5), derivatives
        of forces with parameters and, behind them, the amplitude, (n_t, n_actions, n_parameters + 1), and depths (n_t,
        n_edges).

        Weights are those of the terms of the places, vectors (n_terms, LANES).
        """
        n_t, n_actions = len(q), len(self._actions)
        gradients, measured = np.empty((n_t, n_actions, q.shape[1])), np.empty((n_t, n_actions, DAMPING + 1))
        slopes = np.empty((n_t, n_actions, self._changes.shape[2] + 1))
        depths = np.empty((n_t, len(self._edges)))
        strengths = np.ascontiguousarray(amplitudes_over(self._actions, times))
        _measure(
            self._local, weights, self._terms.grid, self._room, strengths, np.ascontiguousarray(q),
            np.ascontiguousarray(v), self._addresses, gradients, measured, slopes, depths,
        )  # fmt: skip
        return gradients, measured, slopes, depths


class _Room(NamedTuple):
    """What the compiled functions below work with, arrays of vectors (n, LANES)."""

    work: LocalWork
    #: rigid, shapes: polynomials of places in the cells of the instants
    rigid: np.ndarray
    shapes: np.ndarray
    cells: np.ndarray  # numbers of these, 2
    #: q, v, total: coordinates, velocities and what forces come to, n_eta each
    q: np.ndarray
    v: np.ndarray
    total: np.ndarray
    straight: np.ndarray  # gradients of all actions
    laws: np.ndarray  # force, damping and push of every action
    leading: np.ndarray  # of the action before, 1

    @classmethod
    def of(cls, local: LocalEffects, r: int, n: int) -> _Room:
        """Return room for local effects in r rigid and n coordinates in all."""
        rigid, shapes = (places.polynomials.shape[2] for places in (local.places.rigid, local.places.shapes))
        n_actions = local.actions.roles.size
        sizes = rigid, shapes, 2, n, n, n, n_actions * n, 3 * n_actions, 1
        return cls(LocalWork.of(local, r, n), *(aligned((size, LANES)) for size in sizes))


def _summed(forces: np.ndarray, gradients: np.ndarray) -> np.ndarray:
    """Return the sum over actions of forces (n_t, n_actions) times gradients, shape (n_t, n_eta)."""
    return np.matmul(forces[:, None], gradients)[:, 0]


@njit(error_model="numpy", forceinline=True, counted=False)
def _places_kept(room, weights):
    """Return room for the polynomials of places, of no cell yet."""
    room.cells[:] = -1.0
    return KeptPlaces(room.cells, weights, room.rigid, room.shapes)


@njit(error_model="numpy", forceinline=True, counted=False)
def _take(q, first, of_q):
    """Take the rows (n_t, n_eta) of LANES instants from one on; where there are none left, the last one again."""
    for lane in range(LANES):
        t = min(first + lane, q.shape[0] - 1)
        for i in range(q.shape[1]):
            of_q[i, lane] = q[t, i]


@njit(cache=True, entry=True, error_model="numpy", counted=False)
def _measure(local, weights, grid, room, strengths, q, v, addresses, gradients, measured, slopes, depths):
    """Measure all actions in states (n_t, n_eta), LANES of them at once.

    Weights are those of the terms of the places, vectors (n_terms, LANES); strengths are (n_t, n_actions); addresses
    are those of the derivatives of laws.
    """
    places, actions = local.places, local.actions
    n_t, n = q.shape
    d, n_actions, r = actions.statements.axes.shape[2], actions.roles.size, len(grid)
    work, kept, of_q, of_v = loaded(room.work), _places_kept(room, weights), room.q, room.v
    for first in range(0, n_t, LANES):
        _take(q, first, of_q)
        _take(v, first, of_v)
        place_nodes(places, local.all.nodes, grid, d, of_q, of_v, kept, work.frames)
        for action in range(n_actions):
            s, speed = measure(local, action, r, of_q, of_v, False, work)
            if actions.roles[action] != LED:
                store(work.measured, RATE, speed)
                if actions.roles[action] != BY_LOAD:
                    store(work.measured, MEASURE, s)
                    store(work.measured, LEADING, speed)
            for lane in range(min(LANES, n_t - first)):
                t, p = first + lane, actions.parameters[action, 0]
                place, rate = work.measured[MEASURE, lane], work.measured[RATE, lane]
                strength, crossed = strengths[t, action], depths[t, actions.laws.edges[action] :]
                if actions.roles[action] == BY_LOAD:
                    strength = work.measured[LEADING, lane]
                now = obey(actions.laws.addresses[action], p, strength, place, rate, np.nan, crossed)
                found = measured[t, action]
                found[S], found[SPEED], found[FORCE] = place, rate, now.force
                found[STIFFNESS], found[DAMPING] = now.stiffness, now.damping
                differentiate(addresses[action], p, strength, place, rate, slopes[t, action])
                for i in range(n):
                    gradients[t, action, i] = work.projected[i, lane]


@njit(cache=True, entry=True, error_model="numpy", fastmath={"contract"}, counted=False)
def _bend(local, weights, grid, room, steps, q, v, measured, pushes, by_q):
    """Add ``c g (H eta')^T - F H`` to `by_q` (n_t, n_eta, n_eta), with differences over steps (n_eta,) for H; pushes
    (n_t, n_actions) are damping by the rate of the action before.

    Parameters as of `_measure`, which has filled `measured`. A tile of states is bent along all coordinates before the
    next one: so the polynomials of its cells serve for all.
    """
    places = local.places
    n_t, n = q.shape
    d, n_actions, r = local.actions.statements.axes.shape[2], local.actions.roles.size, len(grid)
    work, kept, of_q, of_v = loaded(room.work), _places_kept(room, weights), room.q, room.v
    total, straight, laws, leading, roles = room.total, room.straight, room.laws, room.leading, local.actions.roles
    for first in range(0, n_t, LANES):
        _take(q, first, of_q)
        _take(v, first, of_v)
        for action in range(n_actions):
            for lane in range(LANES):
                t = min(first + lane, n_t - 1)
                laws[3 * action, lane] = measured[t, action, FORCE]
                laws[3 * action + 1, lane] = measured[t, action, DAMPING]
                laws[3 * action + 2, lane] = pushes[t, action]
        place_nodes(places, local.all.nodes, grid, d, of_q, of_v, kept, work.frames)
        for action in range(n_actions):
            measure(local, action, r, of_q, of_v, False, work)
            for i in range(n):
                store(straight, action * n + i, load(work.projected, i))
        for j in range(n):
            here, inverse = load(of_q, j), 1.0 / steps[j]
            store(of_q, j, here + steps[j])
            place_nodes(places, local.all.nodes, grid, d, of_q, of_v, kept, work.frames)
            for i in range(n):
                store(total, i, 0.0)
            for action in range(n_actions):
                measure(local, action, r, of_q, of_v, False, work)
                turned, force, damping = spread(0.0), load(laws, 3 * action), load(laws, 3 * action + 1)
                for i in range(n):
                    bent = (load(work.projected, i) - load(straight, action * n + i)) * inverse
                    turned += bent * load(of_v, i)
                    add(total, i, -(force * bent))
                if roles[action] == LED:
                    turned = load(leading, 0)
                pushed = damping * turned
                if roles[action] == BY_LOAD:
                    pushed += load(laws, 3 * action + 2) * load(leading, 0)
                elif roles[action] != LED:
                    store(leading, 0, turned)
                for i in range(n):
                    add(total, i, pushed * load(straight, action * n + i))
            store(of_q, j, here)
            for lane in range(min(LANES, n_t - first)):
                for i in range(n):
                    by_q[first + lane, i, j] += total[i, lane]
