"""Forces that effects are made of, as nodal vectors in body frames: their static answers extend the reduced basis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.effects.action import Action
from pgmp_petsc.mechanism.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class Patterns:
    """The forces that some effects are made of.

    Attributes
    ----------
    fixed
        Vectors that do not change with the configuration, local rows, shape (n_local, n_fixed).
    turning
        Actions whose forces turn in body frames with the configuration; one vector each (`unit_force`).
    """

    fixed: np.ndarray
    turning: tuple[Action, ...] = ()

    @property
    def n(self) -> int:
        """Number of vectors at a configuration."""
        return self.fixed.shape[1] + len(self.turning)


def unit_force(action: Action, mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return an action's unit force on the rigid mechanism at poses (n_bodies, n_pose), in body frames, (n_dofs,)."""
    space, total = mechanism.space, np.zeros(mechanism.n_dofs)
    gradient = action.statement.gradient(*(space.natural(side.frame_of_pose(poses)) for side in action.sides))
    for side, part in zip(action.sides, np.split(gradient, 2)):
        if not side.on_ground:
            total[side.dofs] += part @ space.natural_gradient(poses[side.body], side.arm)
    return total
