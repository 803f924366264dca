"""A torque in a revolute joint: a couple on the second body and its reaction on the first, over time."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.amplitude import amplitude_of
from pgmp_petsc.effects.effect import Effect
from pgmp_petsc.effects.laws import SOURCE
from pgmp_petsc.effects.load import Load
from pgmp_petsc.mechanism.connection import Connection
from pgmp_petsc.mechanism.mechanism import Coordinate, Mechanism
from pgmp_petsc.scene import effects as schema


class Torque(Effect):
    """Torque effect; see the module."""

    def __init__(self, name: str, entry: schema.Torque, mechanism: Mechanism) -> None:
        super().__init__(name)
        self.strength = amplitude_of(entry)
        self._scale = Quantity.of(entry.scale)
        self._connection = mechanism.connection(entry.joint)

    def loads(self, matrices: AffineMatrices) -> list[Load]:
        """Return one term: unit couples about the joint's axis at its nodes; the axis is fixed in both bodies."""
        vector = self._scale.coefficient * _couples(self._connection, matrices)
        return [Load(self.name, self._scale.monomial, vector, in_bodies=True)]

    def natural_actions(self) -> list[Action]:
        """Return the torque on the joint's angle."""
        joint = self._connection
        return [Action(self.name, joint.angle, joint.a, joint.b, SOURCE, (self._scale,), self.strength)]

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return the couples, which are constant in the bodies."""
        return [load.vector for load in self.loads(matrices)]


class HoldingTorque(Effect):
    """What holds a coordinate until a run starts: no load in the run, but the static basis answers it."""

    def __init__(self, coordinate: Coordinate) -> None:
        super().__init__(f"hold {coordinate.name}")
        self._connection = coordinate.connection

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return the couples on the coordinate's joint."""
        return [_couples(self._connection, matrices)]


def _couples(connection: Connection, matrices: AffineMatrices) -> np.ndarray:
    """Return unit couples about a joint's axis at its nodes, on the rows of `matrices`."""
    vector = np.zeros(len(matrices.rows))
    for sign, side, axes in zip((-1.0, 1.0), connection.sides, connection.axes):
        axis = axes[:, 0] if len(axes) == 3 else np.ones(1)  # in the plane rotations have one component
        for dof, component in zip(side.dofs[-axis.size :], axis):
            if not side.on_ground and dof in matrices.rows:
                vector[dof - matrices.rows.start] += sign * component
    return vector
