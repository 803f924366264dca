"""A force on a point of a body: along a direction of the ground, of the body, or towards another point.

A force with a direction of the ground on a node is a load; one that turns with its body, one that pulls towards a
point, and any force on a rigid body away from its centre of mass depend on the state, and are actions.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.amplitude import amplitude_of
from pgmp_petsc.effects.effect import ActionEffect, Effect
from pgmp_petsc.effects.laws import SOURCE
from pgmp_petsc.effects.load import Load
from pgmp_petsc.effects.measures import DISTANCE, FOLLOWING, SLIDE
from pgmp_petsc.effects.patterns import GroundForce
from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.joints import Joint, PointOnLine
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.natural_coordinates import NaturalUnknowns
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.mechanism.spatial_joints import SpatialJoint
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import effects as schema

GROUND_ORIGIN = Attachment(-1, -1, np.zeros(2))


def force(name: str, entry: schema.Force, mechanism: Mechanism) -> Effect:
    """Return the effect that fits the force's direction; see the module.

    Raises
    ------
    InputError
        If the force would be an action, and the mechanism moves in space.
    """
    point = mechanism.attachment(entry.point, f"effects.{name}.point")
    if point.at_node and entry.towards is None and not entry.follows:
        return FixedForce(name, entry, point, _is_guided(mechanism, point))
    if mechanism.space is SPATIAL:
        raise InputError(
            f'effects.{name}.point = "{entry.point}": in space a force acts on a point of a flexible body, or on the centre '
            "of mass of a rigid one; take such a point, or make the body flexible"
        )
    scale, amplitude = Quantity.of(entry.scale), amplitude_of(entry)
    if entry.towards is not None:
        # it makes the distance shorter
        target = mechanism.attachment(entry.towards, f"effects.{name}.towards")
        return ActionEffect(name, [Action(name, DISTANCE, target, point, SOURCE, (-1.0 * scale,), amplitude=amplitude)])
    kind = FOLLOWING if entry.follows else SLIDE
    return ActionEffect(name, [Action(name, kind, GROUND_ORIGIN, point, SOURCE, (scale,), entry.direction, amplitude)])


def _is_guided(mechanism: Mechanism, point: Attachment) -> bool:
    """Return whether a point slides along a line or a plane, which takes up a part of a force on it."""
    return any(c.b.node == point.node and _guides(c.joint) for c in mechanism.connections)


def _guides(joint: Joint | SpatialJoint) -> bool:
    """Return whether a joint leaves the positions of its points apart."""
    return not joint.holds_position if isinstance(joint, SpatialJoint) else isinstance(joint, PointOnLine)


class FixedForce(Effect):
    """A force on a node that keeps its direction in space.

    Parameters
    ----------
    guided
        Whether a guide takes up a part of it: then there is no answer to both axes of the body, but to the force as it
        is.
    """

    def __init__(self, name: str, entry: schema.Force, point: Attachment, guided: bool) -> None:
        super().__init__(name)
        self._amplitude = amplitude_of(entry)
        self._scale = Quantity.of(entry.scale)
        self._direction = np.asarray(entry.direction, dtype=float) / np.linalg.norm(entry.direction)
        self._point, self._guided = point, guided

    def loads(self, matrices: AffineMatrices) -> list[Load]:
        """Return one term: a unit force at the node."""
        vector = self._vector(matrices, self._scale.coefficient * self._direction)
        return [Load(self.name, self._scale.monomial, vector)]

    def natural_load(
        self, unknowns: NaturalUnknowns, mass: sp.csr_matrix, rows: range, values: Mapping[str, float]
    ) -> np.ndarray:
        """Return the force on the position of the node's frame."""
        vector = np.zeros(len(rows))
        for dof, component in zip(unknowns.frame(self._point.node), self._scale.at(values) * self._direction):
            if dof in rows:
                vector[dof - rows.start] = component
        return vector

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return unit forces along all axes of the body in whose frame the direction turns; none of a guided point."""
        return [] if self._guided else [self._vector(matrices, axis) for axis in np.eye(self._direction.size)]

    def turning_patterns(self) -> list[GroundForce]:
        """Return the force on a guided point, in its own direction."""
        if not self._guided:
            return []
        return [GroundForce(self._point.dofs[: self._direction.size], self._direction)]

    def amplitude(self, time: float | np.ndarray) -> float | np.ndarray:
        """Return the force, N."""
        return self._amplitude(time)

    def _vector(self, matrices: AffineMatrices, components: np.ndarray) -> np.ndarray:
        vector = np.zeros(len(matrices.rows))
        for dof, component in zip(self._point.dofs, components):
            if dof in matrices.rows:
                vector[dof - matrices.rows.start] = component
        return vector
