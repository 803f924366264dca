"""What acts on reduced models over time: amplitudes of loads and of local effects, and prescribed motions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pgmp_petsc.dynamics.reduced_arrays import Strengths
from pgmp_petsc.dynamics.second_order_system import State
from pgmp_petsc.effects import Effect, Motion
from pgmp_petsc.effects.action import Action, amplitudes_over
from pgmp_petsc.runtime.vectors import same_in_all_lanes


class ReducedStrengths:
    """What acts on all samples of a batch alike.

    Parameters
    ----------
    load_effects
        Effects with loads, in the order of the tables.
    actions
        Local effects.
    motions
        Of the prescribed coordinates, by their numbers.
    n_coordinates
        Number of rigid coordinates.
    """

    def __init__(
        self,
        load_effects: Sequence[Effect],
        actions: Sequence[Action],
        motions: Mapping[int, Motion],
        n_coordinates: int,
    ) -> None:
        self._load_effects, self._actions, self._motions = load_effects, actions, motions
        self._n_motions = 3 * n_coordinates if motions else 0

    def at(self, time: float) -> Strengths:
        """Return what acts on every lane at an instant (s)."""
        return Strengths(*(same_in_all_lanes(part[0]) for part in self.over(np.array([time]))))

    def over(self, times: np.ndarray) -> Strengths:
        """Return what acts at several instants (n_t,), s, one a row."""
        loads = np.empty((times.size, len(self._load_effects)))
        for column, effect in zip(loads.T, self._load_effects):
            column[:] = effect.amplitude(times)
        motions = np.zeros((times.size, self._n_motions))
        for k, motion in self._motions.items():
            motions[:, 3 * k : 3 * k + 3] = np.transpose(motion.at(times))
        return Strengths(loads, amplitudes_over(self._actions, times), motions)

    def prescribe(self, time: float, state: State, samples: np.ndarray) -> None:
        """Put the prescribed coordinates of some samples (a mask) where they are at a time (s)."""
        for k, motion in self._motions.items():
            state.q[samples, k], state.v[samples, k], state.a[samples, k] = motion.at(time)
