"""Forces on a block of full-order samples from outside and between points, compiled: loads and actions.

Samples lie side by side in the last axis (lanes); see `batched_ldl`. The equations are those of `effects.load` and
`effects.action`. Actions are on the unknowns of nodes (`mechanism.statement_rows`).
"""

from typing import NamedTuple

import numpy as np
from numba import types

from pgmp_petsc.effects.action import BY_LOAD, LED, Actions
from pgmp_petsc.effects.law import Laws, obey
from pgmp_petsc.full.part_reference import loaded
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import empty_lanes, items, keep
from pgmp_petsc.mechanism.statement_rows import NodeStatements, scratch_of, state


@njit(cache=True, apart=True, error_model="numpy")
def evaluate_actions(
    actions, width, entries, amplitudes, y, rates, known, gain_v, with_tangents, about, forces, slopes, stiffness,
    tangents, powers, stored, depths
):  # fmt: skip
    """Evaluate all actions for all samples: statements side by side, in lanes (`lane_items`), and laws one by one.

    Given are `actions` and `amplitudes` as from `compile_actions` and `amplitudes_over`; which `entries` of the
    tangents are wanted, first one of each action (n_actions + 1,), and rows and columns among the unknowns of the nodes
    of its terms, each (n_entries,); the unknowns y of both nodes and their rates, zero on the ground, (n_terms, 2 m,
    n_samples), m = 3 in the plane or 12; what angles are nearest to, `known`, rad, (n_terms, n_samples); and gain_v,
    the derivative of velocities with positions in the iteration, 1/s. Second derivatives, of which tangents are made,
    cost more than all the rest. `about` has the rates at which laws were evaluated last in an iteration, (n_actions,
    n_samples), NaN before the first, infinite where one is limited (`Found.about`), and is brought up to date; None,
    (0, n_samples), where laws are to be taken as they are.

    Filled are forces on the unknowns, and `slopes`, derivatives of the terms in these, (n_terms, 2 m, n_samples);
    `stiffness`, minus the derivative of each force with the measure and its rate, (n_actions, n_samples); `tangents`,
    minus the derivative of the force on the unknowns, the mean of each entry and its mirror, (n_entries, n_samples),
    without derivatives of forces that are led with what leads them, which are not symmetric, and between other nodes;
    the power of what is not elastic (W) and the potential energy of what is (J), (n_actions, n_samples); and how far
    each edge of a law is crossed, negative where it is not, `depths`, (n_samples, n_edges).
    """
    starts, rows, columns = entries
    firsts, statements, m, n_lanes, most = actions.firsts, actions.statements, y.shape[1], y.shape[2], 1
    for k in range(firsts.size - 1):
        most = max(most, firsts[k + 1] - firsts[k])
    scratch, h = (
        scratch_of(statements, m // 2, width),
        empty_lanes(most * m * m, n_lanes).reshape((most, m, m, n_lanes)),
    )
    leading = np.zeros((2, n_lanes))  # measures of the actions that lead, and their rates
    measured = empty_lanes(2, n_lanes)
    of, moved, all_slopes = items(measured, width), items(rates, width), items(slopes, width)
    for k in range(actions.laws.addresses.size):
        first = firsts[k]
        n_terms = firsts[k + 1] - first
        curved = with_tangents and starts[k + 1] > starts[k]
        for term in range(n_terms):
            at = first + term
            s = state(statements, at, y[at], known[at], curved, scratch, width, slopes[at], h[term])
            rate = 0.0 * s
            for i in range(m):
                rate += all_slopes[at, i] * moved[at, i]
            if term == 0:
                of[0], of[1] = s, rate
            else:
                of[0], of[1] = of[0] + s, of[1] + rate
        for sample in range(n_lanes):
            p = actions.parameters[k, sample]
            s, rate = measured[0, sample], measured[1, sample]
            led, by_load, amplitude = actions.roles[k] == LED, actions.roles[k] == BY_LOAD, amplitudes[k]
            at, at_rate = s, rate
            if led or by_load:
                at = leading[0, sample]
            else:
                leading[0, sample], leading[1, sample] = s, rate
            if led:
                at_rate = leading[1, sample]
            elif by_load:
                amplitude = leading[1, sample]
            before = about[k, sample] if with_tangents and about.shape[0] else np.nan
            crossed = depths[sample, actions.laws.edges[k] :]
            found = obey(actions.laws.addresses[k], p, amplitude, at, at_rate, before, crossed)
            if about.shape[0]:
                about[k, sample] = found.about
            powers[k, sample] = (found.force - (0.0 if led else found.elastic)) * rate
            stored[k, sample] = 0.0 if led else found.stored
            for term in range(first, first + n_terms):
                for i in range(m):
                    forces[term, i, sample] = found.force * slopes[term, i, sample]
            own_stiffness = 0.0 if led else (0.0 if by_load else found.stiffness) + gain_v * found.damping
            stiffness[k, sample] = own_stiffness
            for entry in range(starts[k], starts[k + 1] if curved else starts[k]):
                one, other = rows[entry] // m, columns[entry] // m
                i, j = rows[entry] - one * m, columns[entry] - other * m
                # a force that turns with its body has no symmetric tangent; its mean serves the factorisation
                bent = 0.5 * found.force * (h[one, i, j, sample] + h[one, j, i, sample]) if one == other else 0.0
                both = slopes[first + one, i, sample] * slopes[first + other, j, sample]
                tangents[entry, sample] = own_stiffness * both - bent
    keep(measured)
    keep(h)


class Loads(NamedTuple):
    """Load vectors by their entries: load, unknown and value (n_entries,); weights (n_blocks, n_loads, n_lanes)."""

    numbers: np.ndarray
    dofs: np.ndarray
    values: np.ndarray
    weights: np.ndarray


class BlockActions(NamedTuple):
    """The actions of all samples, block by block."""

    #: statements, laws: as in `Actions`
    statements: NodeStatements
    laws: Laws
    parameters: np.ndarray  # of the laws, shape (n_blocks, n_actions, n_lanes, n_parameters)
    roles: np.ndarray  # as in `Actions`
    firsts: np.ndarray  # as in `Actions`
    dofs: np.ndarray  # unknowns of both nodes of every term, -1 on the ground, shape (n_terms, 2 m)
    entries: tuple[np.ndarray, np.ndarray, np.ndarray]  # as for `evaluate_actions`
    positions: np.ndarray  # where the matrix stores these entries, shape (n_entries,)
    counted: np.ndarray  # whether an action is counted here, in sums over all ranks, shape (n_actions,)
    #: as for `evaluate_actions`, shape (n_blocks, n_actions, n_lanes); none where nothing is iterated
    about: np.ndarray = np.empty((0, 0, 0))


class Acted(NamedTuple):
    """Actions evaluated in a block; see `evaluate_actions`."""

    forces: np.ndarray
    slopes: np.ndarray
    stiffness: np.ndarray
    tangents: np.ndarray
    powers: np.ndarray
    stored: np.ndarray
    depths: np.ndarray


_MATRIX = types.float64[:, ::1]
_TERMS = types.float64[:, :, ::1]
_ACTED = types.NamedTuple((_TERMS, _TERMS, _MATRIX, _MATRIX, _MATRIX, _MATRIX, _MATRIX), Acted)


@njit(error_model="numpy", forceinline=True)
def add_loads(loads, width, block, amplitudes, share, x, place):
    """Take a share of the loads with amplitudes (n_loads,) from x, shape (n, n_lanes) in elimination order."""
    x, weights = items(x, width), items(loads.weights, width)
    for entry in range(loads.dofs.size):
        number = loads.numbers[entry]
        x[place[loads.dofs[entry]]] -= share * loads.values[entry] * amplitudes[number] * weights[block, number]


@njit(cache=True, apart=_ACTED, error_model="numpy")
def act(actions, width, block, amplitudes, q, v, turns, gain_v, with_tangents, iterating=False):
    """Evaluate the actions of a block at q and v (n_dofs, n_lanes), for an iteration in time or as they are.

    Angles are those nearest to `turns`, shape (n_terms, n_lanes), rad, or (0, n_lanes) in the plane, where they count
    turns by themselves.
    """
    (n_terms, m), n, n_lanes = actions.dofs.shape, actions.firsts.size - 1, q.shape[1]
    y, rates, forces = np.zeros((n_terms, m, n_lanes)), np.zeros((n_terms, m, n_lanes)), np.empty((n_terms, m, n_lanes))
    slopes, stiffness = np.zeros((n_terms, m, n_lanes)), np.empty((n, n_lanes))
    powers, stored = np.empty((n, n_lanes)), np.empty((n, n_lanes))
    laws = loaded(actions.laws)
    depths = np.empty((n_lanes, laws.edges[n]))
    tangents = np.empty((actions.positions.size, n_lanes))
    for k in range(n_terms):
        for i in range(m):
            dof = actions.dofs[k, i]
            for lane in range(n_lanes if dof >= 0 else 0):
                y[k, i, lane], rates[k, i, lane] = q[dof, lane], v[dof, lane]
    known = turns if turns.shape[0] else np.zeros((n_terms, n_lanes))
    about = actions.about[block][: n if iterating else 0]
    evaluate_actions(
        Actions(loaded(actions.statements), laws, actions.parameters[block], actions.roles, actions.firsts), width,
        actions.entries, amplitudes, y, rates, known, gain_v, with_tangents, about, forces, slopes, stiffness, tangents,
        powers, stored, depths,
    )  # fmt: skip
    return Acted(forces, slopes, stiffness, tangents, powers, stored, depths)


@njit(cache=True, entry=True, error_model="numpy")
def act_over(actions, width, amplitudes, q, v, turns, samples, depths):
    """Evaluate the actions at instants with amplitudes (n_t, n_actions), as they are, and fill how far edges are
    crossed, (n_t, n_blocks, n_events, n_lanes).

    Unknowns, velocities and turns have the shape (n_t, n_blocks, n_dofs or n_turns, n_lanes), the turns of terms
    behind others; only blocks with any of some samples, (n_blocks, n_lanes), are evaluated.
    """
    behind = max(turns.shape[2] - actions.dofs.shape[0], 0)
    for k in range(q.shape[0]):
        for block in range(q.shape[1]):
            if samples[block].any():
                now = act(
                    actions, width, block, amplitudes[k], q[k, block], v[k, block], turns[k, block, behind:], 0.0, False
                )
                for event in range(depths.shape[2]):
                    for lane in range(depths.shape[3]):
                        depths[k, block, event, lane] = now.depths[lane, event]


@njit(cache=True, apart=True, error_model="numpy")
def add_actions(actions, width, block, amplitudes, share, q, v, turns, gains, fresh, x, place, diagonal, lower):
    """Take a share of the forces of all actions from x, and add their tangents to the matrix; `turns` as for `act`."""
    now = act(actions, width, block, amplitudes, q, v, turns, gains[0], fresh, gains[0] != 0.0)
    forces, tangents = items(now.forces, width), items(now.tangents, width)
    x, diagonal, lower = items(x, width), items(diagonal, width), items(lower, width)
    n, m = actions.dofs.shape
    for k in range(n):
        for i in range(m):
            if actions.dofs[k, i] >= 0:
                x[place[actions.dofs[k, i]]] -= share * forces[k, i]
    for entry in range(actions.positions.size if fresh else 0):
        add_entry(actions.positions[entry], gains[2] * share * tangents[entry], diagonal, lower)
    keep(now)


@njit(inline="always")
def forget_rates(about):
    """Begin an iteration: no law, (n_actions, n_lanes), is known to have been evaluated."""
    for action in range(about.shape[0]):
        for lane in range(about.shape[1]):
            about[action, lane] = np.nan


@njit(inline="always")
def doubt_limited(about, last):
    """Let nothing follow from the size of the last correction, (n_lanes,), where this one had a limited law."""
    for action in range(about.shape[0]):
        for lane in range(about.shape[1]):
            if np.isinf(about[action, lane]):
                last[lane] = 0.0


@njit(error_model="numpy", forceinline=True)
def add_entry(position, value, diagonal, lower):
    """Add an item at a stored position."""
    if position < 0:
        diagonal[-1 - position] += value
    else:
        lower[position] += value
