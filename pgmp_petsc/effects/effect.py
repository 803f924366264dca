"""What the models know of an effect.

An effect contributes what its kind calls for, and nothing else:

- loads ``g_ext = amplitude(t) sum_j w_j(p) f_j`` with constant nodal vectors (`load`),
- actions: force laws on a measure of two frames (`action`),
- patterns: nodal vectors that its forces are made of, whose static answers extend the reduced basis.

The full-order model adds them to its nodes; the reduced model projects them. Point masses are parts of the mass matrix from the start
(`mechanism.composition`), prescribed motions constraints (`motion`), structural damping a property of bodies
(`structural_damping`).
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.load import Load
from pgmp_petsc.effects.measures import ROTATION
from pgmp_petsc.mechanism.mechanism import Mechanism


class Effect:
    """An effect of a scene without any contribution; kinds of effects override what they contribute.

    Parameters
    ----------
    name
        Name in the scene.
    """

    #: Whether its loads derive from a potential energy, as weights do.
    conservative = False

    def __init__(self, name: str) -> None:
        self.name = name

    def loads(self, matrices: AffineMatrices) -> list[Load]:
        """Return the load terms for the rows of `matrices`."""
        return []

    def amplitude(self, time: float | np.ndarray) -> float | np.ndarray:
        """Return the common factor of the load terms at a time (s), or at each of several."""
        return np.ones_like(time)

    def actions(self) -> list[Action]:
        """Return the local effects."""
        return []

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return nodal vectors in body frames, for the rows of `matrices`, that span the forces in any configuration."""
        return []


class ActionEffect(Effect):
    """An effect that is nothing but one action, or several.

    Parameters
    ----------
    name
        Name in the scene.
    actions
        Its actions.
    """

    def __init__(self, name: str, actions: list[Action]) -> None:
        super().__init__(name)
        self._actions = actions

    def actions(self) -> list[Action]:
        """Return the local effects."""
        return self._actions

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return unit forces on the frames' unknowns, couples of two bodies together."""
        unknowns = {}
        for action in self._actions:
            unknowns.update(local_patterns(action, matrices))
        return list(unknowns.values())


def local_patterns(action: Action, matrices: AffineMatrices) -> dict[tuple[int, ...], np.ndarray]:
    """Return the nodal vectors, in body frames, that the forces of an action are made of, by the unknowns they act on."""
    sides = action.sides
    dofs = [int(sides[column // 3].dofs[column % 3]) for column in action.columns]
    groups = [tuple(dofs)] if action.measure == ROTATION else [(dof,) for dof in dofs]
    found = {}
    for group in groups:
        vector = np.zeros(len(matrices.rows))
        # the couples of a rotation are equal and opposite, where both bodies move
        for sign, dof in zip((1.0, -1.0), group):
            if dof in matrices.rows:
                vector[dof - matrices.rows.start] = sign
        found[group] = vector
    return found
