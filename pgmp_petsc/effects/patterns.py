"""Forces that effects are made of, as nodal vectors in body frames: their static answers extend the reduced basis."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pgmp_petsc.effects.action import Action
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene.numerics import Reduction


@dataclass(frozen=True, eq=False)
class Patterns:
    """The forces that some effects are made of.

    Attributes
    ----------
    fixed
        Vectors that do not change with the configuration, local rows, shape (n_local, n_fixed).
    turning
        Actions whose forces turn in body frames with the configuration; one vector each (`unit_force`).
    elastic
        Numbers of the vectors among `fixed` that are forces of linear springs, shape (n_elastic,).
    """

    fixed: np.ndarray
    turning: tuple[Action, ...] = ()
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
            springs = tuple(action for action in self.turning if action.is_spring)
            return Patterns(self.fixed[:, self.elastic], springs, np.arange(self.elastic.size))
        return Patterns(self.fixed[:, :0])


def unit_force(action: Action, mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return an action's unit force on the rigid mechanism at poses (n_bodies, n_pose), in body frames, (n_dofs,)."""
    space, total = mechanism.space, np.zeros(mechanism.n_dofs)
    gradient = action.statement.gradient(*(space.natural(side.frame_of_pose(poses)) for side in action.sides))
    for side, part in zip(action.sides, np.split(gradient, 2)):
        if not side.on_ground:
            total[side.dofs] += part @ space.natural_gradient(poses[side.body], side.arm)
    return total
