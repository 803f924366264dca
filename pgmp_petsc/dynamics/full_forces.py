"""What acts on a block of full-order samples beside the elements, compiled: loads, actions and modal damping.

Samples lie side by side in the last axis (lanes); see `batched_ldl`. The equations are those of `effects.load`,
`effects.action` and `effects.modal_damping`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.dynamics.node_actions import evaluate_actions
from pgmp_petsc.effects.action import Actions
from pgmp_petsc.effects.modal_damping import ModalDamping
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
        Unknowns of both nodes, -1 on the ground, shape (n_actions, 6).
    entries
        As for `evaluate_actions`.
    positions
        Where the matrix stores these entries, shape (n_entries,).
    """

    statements: NodeStatements
    laws: np.ndarray
    parameters: np.ndarray
    dofs: np.ndarray
    entries: tuple[np.ndarray, np.ndarray, np.ndarray]
    positions: np.ndarray


class ModalFactors(NamedTuple):
    """Modal damping of all bodies; that of body k has the rows ``starts[k]`` to ``starts[k + 1]``.

    Attributes
    ----------
    starts
        Shape (n + 1,).
    dofs
        Unknowns that are damped, three a node, shape (n_rows,).
    factors
        P in the body's frame, shape (n_rows, n_modes); zero where a body has fewer modes.
    levers
        Shares of the nodes in the mass of their body, at the rows of their rotations, shape (n_rows,).
    """

    starts: np.ndarray
    dofs: np.ndarray
    factors: np.ndarray
    levers: np.ndarray

    @classmethod
    def of(cls, damped: Sequence[ModalDamping]) -> ModalFactors:
        """Collect the modal damping of beams in the plane."""
        n_modes = max((one.factor.shape[1] for one in damped), default=0)
        starts = np.cumsum([0, *(one.dofs.size for one in damped)])
        factors, levers = np.zeros((starts[-1], n_modes)), np.zeros(starts[-1])
        for one, first, last in zip(damped, starts, starts[1:]):
            factors[first:last, : one.factor.shape[1]] = one.factor
            levers[first + 2 : last : DOFS_PER_NODE] = one.levers[:, 0]
        dofs = np.concatenate([np.zeros(0, dtype=np.int64), *(one.dofs for one in damped)])
        return cls(starts, dofs, factors, levers)


class Acted(NamedTuple):
    """Actions evaluated in a block; see `evaluate_actions`."""

    forces: np.ndarray
    tangents: np.ndarray
    powers: np.ndarray
    stored: np.ndarray


@njit(cache=True, error_model="numpy")
def add_loads(loads, block, amplitudes, x, place):
    """Take the loads with amplitudes (n_loads,) from x, shape (n, n_lanes) in elimination order."""
    for entry in range(loads.dofs.size):
        number = loads.numbers[entry]
        at, value, weight = place[loads.dofs[entry]], loads.values[entry], loads.weights[block, number]
        for lane in range(x.shape[1]):
            x[at, lane] -= value * (amplitudes[number] * weight[lane])


@njit(cache=True, error_model="numpy")
def act(actions, block, amplitudes, q, v, gain_v, with_tangents):
    """Evaluate the actions of a block at q and v (n_dofs, n_lanes)."""
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
    known = np.zeros((n, n_lanes))  # angles in the plane count turns by themselves
    evaluate_actions(
        Actions(actions.statements, actions.laws, actions.parameters[block]), actions.entries, amplitudes, y, rates,
        known, np.empty((n, n_lanes)), gain_v, with_tangents, forces, tangents, powers, stored, depths,
    )  # fmt: skip
    return Acted(forces, tangents, powers, stored)


@njit(cache=True, error_model="numpy")
def add_actions(actions, block, amplitudes, q, v, gains, fresh, x, place, diagonal, lower):
    """Take the forces of all actions from x, and add their tangents to the matrix."""
    now = act(actions, block, amplitudes, q, v, gains[0], fresh)
    n, m = actions.dofs.shape
    for k in range(n):
        for i in range(m):
            dof = actions.dofs[k, i]
            for lane in range(x.shape[1] if dof >= 0 else 0):
                x[place[dof], lane] -= now.forces[k, i, lane]
    for entry in range(actions.positions.size if fresh else 0):
        add_entry(actions.positions[entry], gains[2], now.tangents[entry], diagonal, lower)


@njit(cache=True, error_model="numpy")
def add_modal_damping(modal, q, v, x, place, powers):
    """Take the forces of modal damping from x; `powers` are those of each body, shape (n, n_lanes), W."""
    n_modes = modal.factors.shape[1]
    along = np.zeros(n_modes)
    for body in range(modal.starts.size - 1):
        rows = range(modal.starts[body], modal.starts[body + 1], 3)
        for lane in range(q.shape[1]):
            angle = 0.0
            for row in rows:
                angle += modal.levers[row + 2] * q[modal.dofs[row + 2], lane]
            cos, sin = np.cos(angle), np.sin(angle)
            along[:] = 0.0
            for row in rows:
                vx, vy, spin = v[modal.dofs[row], lane], v[modal.dofs[row + 1], lane], v[modal.dofs[row + 2], lane]
                for mode in range(n_modes):
                    along[mode] += (  # P^T R^T q'
                        modal.factors[row, mode] * (cos * vx + sin * vy)
                        + modal.factors[row + 1, mode] * (cos * vy - sin * vx)
                        + modal.factors[row + 2, mode] * spin
                    )
            powers[body, lane] = 0.0
            for mode in range(n_modes):
                powers[body, lane] -= along[mode] * along[mode]
            for row in rows:
                fx, fy, couple = 0.0, 0.0, 0.0
                for mode in range(n_modes):
                    fx -= modal.factors[row, mode] * along[mode]
                    fy -= modal.factors[row + 1, mode] * along[mode]
                    couple -= modal.factors[row + 2, mode] * along[mode]
                x[place[modal.dofs[row]], lane] -= cos * fx - sin * fy
                x[place[modal.dofs[row + 1]], lane] -= sin * fx + cos * fy
                x[place[modal.dofs[row + 2]], lane] -= couple


@njit(cache=True, error_model="numpy")
def add_entry(position, factor, values, diagonal, lower):
    """Add ``factor * values`` (n_lanes,) at a stored position."""
    n_lanes = diagonal.shape[1]
    if position < 0:
        for lane in range(n_lanes):
            diagonal[-1 - position, lane] += factor * values[lane]
    else:
        for lane in range(n_lanes):
            lower[position, lane] += factor * values[lane]
