"""What the models know of an effect.

An effect contributes what its kind calls for, and nothing else:

- loads ``g_ext = amplitude(t) sum_j w_j(p) f_j`` with constant nodal vectors (`load`),
- actions: force laws on a measure of two frames (`action`),
- patterns: nodal vectors that its forces are made of, whose static answers extend the reduced basis.

The full-order model adds them to its nodes; the reduced model projects them. Point masses are parts of the mass matrix
from the start (`mechanism.composition`), prescribed motions constraints (`motion`), structural damping a property of
bodies (`structural_damping`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.load import Load
from pgmp_petsc.effects.patterns import FIXED, GroundForce, fixed_pattern

if TYPE_CHECKING:
    import scipy.sparse as sp

    from pgmp_petsc.mechanism.natural_coordinates import NaturalUnknowns
    from pgmp_petsc.mechanism.spatial_connection import SpatialConnection


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

    def natural_load(
        self, unknowns: NaturalUnknowns, mass: sp.csr_matrix, rows: range, values: Mapping[str, float]
    ) -> np.ndarray | None:
        """Return the constant vector of its loads in natural coordinates, shape (n_rows,), or None.

        Parameters
        ----------
        unknowns
            The numbering.
        mass
            The given rows of the mass matrix.
        rows
            Unknowns that a rank owns.
        values
            Parameter values.
        """
        return None

    def couple(self) -> tuple[SpatialConnection, Quantity] | None:
        """Return the joint in space about whose axis the effect turns, and what the amplitude is to be multiplied
        with."""
        return None

    def actions(self) -> list[Action]:
        """Return the local effects."""
        return []

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return nodal vectors in body frames, for the rows of `matrices`, that span the forces in any configuration.

        None of forces that `turning_patterns` returns.
        """
        return []

    def turning_patterns(self) -> list[Action | GroundForce]:
        """Return the unit forces that are to be answered in the direction that they have in each configuration."""
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
        """Return the unit forces of the actions whose direction is constant in body frames."""
        return [fixed_pattern(action, matrices) for action in self._actions if action.measure in FIXED]

    def turning_patterns(self) -> list[Action]:
        """Return the other actions."""
        return [action for action in self._actions if action.measure not in FIXED]
