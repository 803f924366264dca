"""A force on a point of a body: along a direction of the ground, of the body, or towards another point.

A force with a direction of the ground on a node is a load; one that turns with its body, one that pulls towards a
point, and any force on a rigid body away from its centre of mass depend on the state, and are actions: on the place of
the point along the direction, or on its distance from the other one.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.amplitude import amplitude_of
from pgmp_petsc.effects.effect import ActionEffect, Effect
from pgmp_petsc.effects.laws import SOURCE
from pgmp_petsc.effects.load import Load
from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.statements import along, distance, following
from pgmp_petsc.scene import effects as schema

GROUND_ORIGIN = "ground:origin"


def force(name: str, entry: schema.Force, mechanism: Mechanism) -> Effect:
    """Return the effect that fits the force's direction; see the module."""
    point = mechanism.attachment(entry.point, f"effects.{name}.point")
    other = mechanism.attachment(entry.towards or GROUND_ORIGIN, f"effects.{name}.towards")
    scale, amplitude = Quantity.of(entry.scale), amplitude_of(entry)
    if entry.towards is not None:
        # it makes the distance shorter
        statement, scale = distance(mechanism.space.dimension), -1.0 * scale
    elif entry.follows:
        statement = following(np.array(entry.direction))
    else:
        statement = along(np.array(entry.direction))
        if point.at_node:
            return FixedForce(name, entry, other, point, _is_guided(mechanism, point))
    return ActionEffect(name, [Action(name, statement, other, point, SOURCE, (scale,), amplitude)], mechanism)


def _is_guided(mechanism: Mechanism, point: Attachment) -> bool:
    """Return whether a point slides along a line or a plane, which takes up a part of a force on it."""
    return any(c.b.node == point.node and not c.joint.holds_position for c in mechanism.connections)


class FixedForce(Effect):
    """A force on a node that keeps its direction in space.

    Parameters
    ----------
    ground, point
        The ground's origin, and where it acts.
    guided
        Whether a guide takes up a part of it: then there is no answer to both axes of the body, but to the force as it
        is.
    """

    def __init__(self, name: str, entry: schema.Force, ground: Attachment, point: Attachment, guided: bool) -> None:
        super().__init__(name)
        self.strength = amplitude_of(entry)
        self._scale = Quantity.of(entry.scale)
        self._direction = np.asarray(entry.direction, dtype=float) / np.linalg.norm(entry.direction)
        self._ground, self._point, self._guided = ground, point, guided

    def loads(self, matrices: AffineMatrices) -> list[Load]:
        """Return one term: a unit force at the node."""
        vector = self._vector(matrices, self._scale.coefficient * self._direction)
        return [Load(self.name, self._scale.monomial, vector)]

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return unit forces along all axes of the body in whose frame the direction turns; none of a guided point."""
        return [] if self._guided else [self._vector(matrices, axis) for axis in np.eye(self._direction.size)]

    def turning_patterns(self) -> list[Action]:
        """Return the force on a guided point, in its own direction."""
        if not self._guided:
            return []
        return [Action(self.name, along(self._direction), self._ground, self._point, SOURCE, (self._scale,))]

    def _vector(self, matrices: AffineMatrices, components: np.ndarray) -> np.ndarray:
        vector = np.zeros(len(matrices.rows))
        for dof, component in zip(self._point.dofs, components):
            if dof in matrices.rows:
                vector[dof - matrices.rows.start] = component
        return vector
