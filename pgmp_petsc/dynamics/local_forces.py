"""Actions in the full-order model: forces on nodal unknowns, and their tangents on a fixed sparse pattern."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.effects.action import Action, amplitudes_of, compile_actions, evaluate_actions
from pgmp_petsc.mechanism.attachment import onto_nodes
from pgmp_petsc.mechanism.joints import N_FRAME, N_PAIR
from pgmp_petsc.runtime.log_events import log_event


@dataclass(frozen=True)
class LocalState:
    """Actions evaluated for n samples.

    Attributes
    ----------
    forces
        On the unknowns of `LocalForces.dofs`, shape (n_actions, 6, n), N and N m; zero for sides on the ground.
    tangents
        Minus their derivatives on `LocalForces.pattern`, shape (n_entries, n).
    powers
        Power of what is not elastic, shape (n_actions, n), W.
    stored
        Potential energy, shape (n_actions, n), J.
    depths
        How deep a stop is entered, NaN for other actions, shape (n_actions, n).
    """

    forces: np.ndarray
    tangents: np.ndarray
    powers: np.ndarray
    stored: np.ndarray
    depths: np.ndarray


class LocalForces:
    """The actions of a batch of samples.

    Parameters
    ----------
    actions
        Actions of all effects.
    values
        Parameter values of the samples, each of shape (n_samples,).
    n_samples
        Number of samples.

    Attributes
    ----------
    n_actions
        Number of actions; with none, nothing is ever evaluated.
    dofs
        Unknowns of both nodes of every action, -1 on the ground, shape (n_actions, 6).
    pattern
        Rows and columns of the tangents' entries, one of each symmetric pair, each of shape (n_entries,).
    """

    def __init__(self, actions: Sequence[Action], values: Mapping[str, np.ndarray], n_samples: int) -> None:
        self.actions = tuple(actions)
        self.n_actions = len(self.actions)
        self._compiled = compile_actions(self.actions, values, n_samples)
        ground = np.full(N_FRAME, -1)
        self.dofs = np.array(
            [
                np.concatenate([ground if side.on_ground else side.dofs for side in action.sides])
                for action in self.actions
            ],
            dtype=int,
        ).reshape(self.n_actions, N_PAIR)
        self._entries = []
        rows, columns = [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
        for dofs in self.dofs:
            moving = np.flatnonzero(dofs >= 0)
            i, j = (moving[part] for part in np.tril_indices(moving.size))
            self._entries.append((i, j))
            rows.append(dofs[i])
            columns.append(dofs[j])
        self.pattern = np.concatenate(rows), np.concatenate(columns)

    @property
    def edges(self) -> list[int]:
        """Numbers of the actions whose law has an edge."""
        return [k for k, action in enumerate(self.actions) if action.has_events]

    def evaluate(self, time: float, q: np.ndarray, v: np.ndarray, gain_v: float) -> LocalState:
        """Evaluate all actions.

        Parameters
        ----------
        time
            s.
        q, v
            Nodal unknowns and velocities, shape (n_dofs, n); only the rows of `dofs` are read.
        gain_v
            Derivative of velocities with positions in the iteration, 1/s.
        """
        n = q.shape[1]
        z, rates = np.empty((self.n_actions, N_PAIR, n)), np.zeros((self.n_actions, N_PAIR, n))
        for action, frame, rate in zip(self.actions, z, rates):
            for first, side in zip((0, N_FRAME), action.sides):
                part = slice(first, first + N_FRAME)
                frame[part] = side.frame_of_node(q)
                if not side.on_ground:
                    rate[part] = side.rate_of(q[side.dofs], v[side.dofs])
        forces, tangents = np.empty_like(z), np.empty((self.n_actions, N_PAIR, N_PAIR, n))
        powers, stored, depths = (np.empty((self.n_actions, n)) for _ in range(3))
        amplitudes = amplitudes_of(self.actions, time)
        with log_event("local_effects"):
            evaluate_actions(self._compiled, amplitudes, z, rates, gain_v, forces, tangents, powers, stored, depths)
        values = [np.zeros((0, n))]
        for action, force, tangent, (i, j) in zip(self.actions, forces, tangents, self._entries):
            curvature = -tangent[None]
            onto_nodes(action.sides, q, force[None], curvature)
            # a force that turns with its body has no symmetric tangent; its mean serves the symmetric factorisation
            values.append(-0.5 * (curvature[0, i, j] + curvature[0, j, i]))
        return LocalState(forces, np.concatenate(values), powers, stored, depths)

    def add_forces(self, state: LocalState, total: np.ndarray) -> None:
        """Add the forces to nodal ones, shape (n_dofs, n)."""
        for dofs, force in zip(self.dofs, state.forces):
            moving = dofs >= 0
            total[dofs[moving]] += force[moving]
