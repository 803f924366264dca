"""What acts on a block of full-order samples from outside and between points, compiled: loads and actions.

Samples lie side by side in the last axis (lanes); see `batched_ldl`. The equations are those of `effects.load` and
`effects.action`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.dynamics.part_reference import loaded
from pgmp_petsc.runtime.lane_items import items, keep
from pgmp_petsc.dynamics.node_actions import evaluate_actions
from pgmp_petsc.effects.action import Actions
from pgmp_petsc.mechanism.node_statements import NodeStatements
from pgmp_petsc.runtime.compiled import njit


class Loads(NamedTuple):
    """Load vectors by their entries: load, unknown and value (n_entries,); weights (n_blocks, n_loads, n_lanes)."""

    numbers: np.ndarray
    dofs: np.ndarray
    values: np.ndarray
    weights: np.ndarray


class BlockActions(NamedTuple):
    """The actions of all samples, block by block.

    Attributes
    ----------
    statements, laws
        As in `Actions`.
    parameters
        Of the laws, shape (n_blocks, n_actions, n_lanes, N_PARAMETERS).
    dofs
        Unknowns of both nodes, -1 on the ground, shape (n_actions, 2 m).
    entries
        As for `evaluate_actions`.
    positions
        Where the matrix stores these entries, shape (n_entries,).
    counted
        Whether an action is counted here, in sums over all ranks, shape (n_actions,).
    about
        As for `evaluate_actions`, shape (n_blocks, n_actions, n_lanes).
    """

    statements: NodeStatements
    laws: np.ndarray
    parameters: np.ndarray
    dofs: np.ndarray
    entries: tuple[np.ndarray, np.ndarray, np.ndarray]
    positions: np.ndarray
    counted: np.ndarray
    about: np.ndarray


class Acted(NamedTuple):
    """Actions evaluated in a block; see `evaluate_actions`."""

    forces: np.ndarray
    tangents: np.ndarray
    powers: np.ndarray
    stored: np.ndarray
    depths: np.ndarray


@njit(error_model="numpy", forceinline=True)
def add_loads(loads, width, block, amplitudes, share, x, place):
    """Take a share of the loads with amplitudes (n_loads,) from x, shape (n, n_lanes) in elimination order."""
    x, weights = items(x, width), items(loads.weights, width)
    for entry in range(loads.dofs.size):
        number = loads.numbers[entry]
        x[place[loads.dofs[entry]]] -= share * loads.values[entry] * amplitudes[number] * weights[block, number]


@njit(cache=True, error_model="numpy")
def act(actions, block, amplitudes, q, v, turns, gain_v, with_tangents, iterating=False):
    """Evaluate the actions of a block at q and v (n_dofs, n_lanes), for an iteration in time or as they are.

    Angles are those nearest to `turns`, shape (n_actions, n_lanes), rad, or (0, n_lanes) in the plane, where they count
    turns by themselves.
    """
    n, m = actions.dofs.shape
    n_lanes = q.shape[1]
    y, rates, forces = np.zeros((n, m, n_lanes)), np.zeros((n, m, n_lanes)), np.empty((n, m, n_lanes))
    powers, stored, depths = np.empty((n, n_lanes)), np.empty((n, n_lanes)), np.empty((n, n_lanes))
    tangents = np.empty((actions.positions.size, n_lanes))
    for k in range(n):
        for i in range(m):
            dof = actions.dofs[k, i]
            for lane in range(n_lanes if dof >= 0 else 0):
                y[k, i, lane], rates[k, i, lane] = q[dof, lane], v[dof, lane]
    known = turns if turns.shape[0] else np.zeros((n, n_lanes))
    about = actions.about[block][: n if iterating else 0]
    evaluate_actions(
        Actions(loaded(actions.statements), actions.laws, actions.parameters[block]), actions.entries, amplitudes, y,
        rates, known, np.empty((n, n_lanes)), gain_v, with_tangents, about, forces, tangents, powers, stored, depths,
    )  # fmt: skip
    return Acted(forces, tangents, powers, stored, depths)


@njit(cache=True, error_model="numpy")
def add_actions(actions, width, block, amplitudes, share, q, v, turns, gains, fresh, x, place, diagonal, lower):
    """Take a share of the forces of all actions from x, and add their tangents to the matrix; `turns` as for `act`."""
    now = act(actions, block, amplitudes, q, v, turns, gains[0], fresh, gains[0] != 0.0)
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
            if np.isnan(about[action, lane]):
                last[lane] = 0.0


@njit(error_model="numpy", forceinline=True)
def add_entry(position, value, diagonal, lower):
    """Add an item at a stored position."""
    if position < 0:
        diagonal[-1 - position] += value
    else:
        lower[position] += value


@njit(inline="always")
def add_entry_of_lane(position, lane, value, diagonal, lower):
    """Add a number of one lane at a stored position; diagonal (n, n_lanes), lower (n_lower, n_lanes)."""
    if position < 0:
        diagonal[-1 - position, lane] += value
    else:
        lower[position, lane] += value
