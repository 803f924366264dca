"""A torque in a revolute joint: a couple on the second body and its reaction on the first, over time."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects.amplitude import amplitude_of
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.effects.load import Load
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import effects as schema


class Torque(Effect):
    """Torque effect; see the module."""

    def __init__(self, name: str, entry: schema.Torque, mechanism: Mechanism) -> None:
        super().__init__(name)
        self._amplitude = amplitude_of(entry)
        self._scale = Quantity.of(entry.scale)
        self._connection = mechanism.connection(entry.joint)

    def loads(self, matrices: AffineMatrices) -> list[Load]:
        """Return one term: unit couples at the joint's nodes."""
        vector = np.zeros(len(matrices.rows))
        for sign, side in ((-1.0, self._connection.a), (1.0, self._connection.b)):
            if not side.on_ground and side.dofs[2] in matrices.rows:
                vector[side.dofs[2] - matrices.rows.start] += sign * self._scale.coefficient
        return [Load(self.name, self._scale.monomial, vector)]

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return the couples, which are the same in every frame of the plane."""
        return [load.vector for load in self.loads(matrices)]

    def amplitude(self, time: float | np.ndarray) -> float | np.ndarray:
        """Return the torque, N m."""
        return self._amplitude(time)
