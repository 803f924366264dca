"""Actions in the full-order model: forces on the unknowns, and their tangents on a fixed sparse pattern."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.dynamics.node_actions import evaluate_actions
from pgmp_petsc.effects.action import Action, amplitudes_of, compile_actions
from pgmp_petsc.runtime.log_events import log_event


@dataclass(frozen=True)
class LocalState:
    """Actions evaluated for n samples.

    Attributes
    ----------
    forces
        On the unknowns of `LocalForces.dofs`, shape (n_actions, 2 m, n), N and N m; zero for sides on the ground.
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
    node_dofs
        From a node to the unknowns that its frame depends on, shape (m,): ``(x, y, phi)``, or natural coordinates.
    dimension
        2 in the plane, 3 in space.

    Attributes
    ----------
    n_actions
        Number of actions; with none, nothing is ever evaluated.
    dofs
        Unknowns of both nodes of every action, -1 on the ground, shape (n_actions, 2 m).
    pattern
        Rows and columns of the tangents' entries, one of each symmetric pair, each of shape (n_entries,).
    compiled, entries
        The actions and the entries as `evaluate_actions` takes them.
    """

    def __init__(
        self,
        actions: Sequence[Action],
        values: Mapping[str, np.ndarray],
        n_samples: int,
        node_dofs: Callable[[int], np.ndarray],
        dimension: int = 2,
    ) -> None:
        self.actions = tuple(actions)
        self.n_actions = len(self.actions)
        self.compiled = compile_actions(self.actions, values, n_samples, dimension)
        # angles at the instant before, and in the last state of this one, which may be any trial of an iteration
        self._known, self._turned = np.zeros((2, self.n_actions, n_samples))
        self._time = 0.0
        m = node_dofs(0).size
        self.dofs = np.full((self.n_actions, 2, m), -1)
        for action, dofs in zip(self.actions, self.dofs):
            for side, own in zip(action.sides, dofs):
                if not side.on_ground:
                    own[:] = node_dofs(side.node)
        self.dofs = self.dofs.reshape(self.n_actions, 2 * m)
        moving = [np.flatnonzero(dofs >= 0) for dofs in self.dofs]
        lower = [[own[part] for part in np.tril_indices(own.size)] for own in moving]
        starts = np.cumsum([0, *(i.size for i, _ in lower)])
        rows, columns = (np.concatenate([np.zeros(0, dtype=int), *(pair[k] for pair in lower)]) for k in (0, 1))
        owner = np.repeat(np.arange(self.n_actions), np.diff(starts))
        self.entries = starts, rows, columns
        self.pattern = self.dofs[owner, rows], self.dofs[owner, columns]

    @property
    def edges(self) -> list[int]:
        """Numbers of the actions whose law has an edge."""
        return [k for k, action in enumerate(self.actions) if action.has_events]

    def count_from(self, theta: np.ndarray) -> None:
        """Count the turns of angles from coordinates (n_theta,) on; of joints that are none from (-pi, pi]."""
        for action, known in zip(self.actions, self._known):
            known[:] = theta[action.coordinate] if action.coordinate >= 0 else 0.0
        self._turned[:] = self._known

    def forget(self, samples: np.ndarray) -> None:
        """Forget the angles of samples (a mask) at an instant that is not kept."""
        self._turned[:, samples] = self._known[:, samples]

    def evaluate(
        self, time: float, q: np.ndarray, v: np.ndarray, gain_v: float, with_tangents: bool = True
    ) -> LocalState:
        """Evaluate all actions.

        Parameters
        ----------
        time
            s.
        q, v
            Unknowns and velocities, shape (n_dofs, n); only the rows of `dofs` are read.
        gain_v
            Derivative of velocities with positions in the iteration, 1/s.
        with_tangents
            Whether tangents are wanted; they are zero otherwise.
        """
        n = q.shape[1]
        if time != self._time:
            self._known[:], self._time = self._turned, time
        grounded = self.dofs < 0
        y, rates = q[self.dofs], v[self.dofs]
        y[grounded] = rates[grounded] = 0.0
        forces, tangents = np.empty_like(y), np.zeros((self.pattern[0].size, n))
        powers, stored, depths = (np.empty((self.n_actions, n)) for _ in range(3))
        with log_event("local_effects"):
            evaluate_actions(
                self.compiled, self.entries, amplitudes_of(self.actions, time), y, rates, self._known, self._turned,
                gain_v, with_tangents, forces, tangents, powers, stored, depths,
            )  # fmt: skip
        return LocalState(forces, tangents, powers, stored, depths)

    def add_forces(self, state: LocalState, total: np.ndarray) -> None:
        """Add the forces to those on all unknowns, shape (n_dofs, n)."""
        for dofs, force in zip(self.dofs, state.forces):
            moving = dofs >= 0
            total[dofs[moving]] += force[moving]
