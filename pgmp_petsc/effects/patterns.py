"""Forces that effects are made of, as nodal vectors in body frames: their static answers extend the reduced basis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from pgmp_petsc.effects.action import Action
from pgmp_petsc.mechanism.body_frames import BodyGradients
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene.numerics import Reduction


@dataclass(frozen=True, eq=False)
class Patterns:
    """The forces that some effects are made of."""

    fixed: np.ndarray  # vectors that do not change with the configuration, local rows, shape (n_local, n_fixed)
    #: actions whose forces turn in body frames with the configuration; one vector each (`UnitForces`)
    turning: tuple[Action, ...] = ()
    #: numbers of the vectors among `fixed` that are forces of linear springs, shape (n_elastic,)
    elastic: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))

    @property
    def n(self) -> int:
        """Number of vectors at a configuration."""
        return self.fixed.shape[1] + len(self.turning)

    def wanted(self, reduction: Reduction) -> Patterns:
        """Return those whose static answers a basis takes: all, those of linear springs, or none."""
        if reduction.static_modes:
            return self
        if reduction.spring_modes:
            springs = tuple(action for action in self.turning if action.stiffness)
            return Patterns(self.fixed[:, self.elastic], springs, np.arange(self.elastic.size))
        return Patterns(self.fixed[:, :0])


class UnitForces:
    """Unit forces of actions on the rigid mechanism, in body frames, at any configuration.

    Parameters
    ----------
    actions
        What acts.
    mechanism
        What they act on.

    Attributes
    ----------
    actions
        The actions.
    """

    def __init__(self, actions: Sequence[Action], mechanism: Mechanism) -> None:
        self.actions, self._mechanism = tuple(actions), mechanism
        self._gradients = BodyGradients(mechanism, [(action.statement, action.sides) for action in actions])

    def chosen(self, numbers: np.ndarray) -> UnitForces:
        """Return those of some of the actions, by their numbers or a mask."""
        numbers = np.arange(len(self.actions))[numbers]
        return UnitForces([self.actions[k] for k in numbers], self._mechanism)

    def at(self, poses: np.ndarray) -> np.ndarray:
        """Return the forces at poses (n_bodies, n_pose), all rows, shape (n_dofs, n_actions)."""
        return self._gradients.dense(poses).T
