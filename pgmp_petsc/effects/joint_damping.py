"""Viscous damping in a joint: ``-c s'`` on its rotation or displacement s."""

from __future__ import annotations

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.joint_measure import joint_measure
from pgmp_petsc.effects.laws import SPRING_DAMPER
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import effects as schema


def joint_damping(name: str, entry: schema.JointDamping, mechanism: Mechanism) -> ActionEffect:
    """Return the effect; see the module."""
    parameters = (Quantity(0.0), Quantity.of(entry.coefficient), Quantity(0.0))
    place = joint_measure(mechanism, entry)
    return ActionEffect(name, [Action(name, law=SPRING_DAMPER, parameters=parameters, **place)], mechanism)
