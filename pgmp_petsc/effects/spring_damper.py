"""A spring-damper: ``-k (s - rest) - c s'`` on a joint's rotation or displacement, or on the distance of two points."""

from __future__ import annotations

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.joint_measure import joint_measure
from pgmp_petsc.effects.laws import SPRING_DAMPER
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.statements import distance
from pgmp_petsc.scene import effects as schema


def spring_damper(name: str, entry: schema.SpringDamper, mechanism: Mechanism) -> ActionEffect:
    """Return the effect; see the module."""
    if entry.points is None:
        place = joint_measure(mechanism, entry)
    else:
        a, b = (mechanism.attachment(point, f"effects.{name}.points") for point in entry.points)
        place = {"statement": distance(mechanism.space.dimension), "a": a, "b": b}
    parameters = tuple(map(Quantity.of, (entry.stiffness, entry.damping, entry.rest or 0.0)))
    return ActionEffect(name, [Action(name, law=SPRING_DAMPER, parameters=parameters, **place)], mechanism)
