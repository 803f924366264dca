"""Coulomb friction in a joint under a constant load: ``-limit tanh(s' / speed)`` on its rotation or displacement s.

Regularised, so that the force is smooth: below the speed the joint creeps instead of sticking. Where friction alone
changes the rate by several times this speed in one step, Newton's iteration goes back and forth between sliding one way
and the other when the joint comes to rest, and the sample fails: take a larger speed or a smaller step.
"""

from __future__ import annotations

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.joint_measure import joint_measure
from pgmp_petsc.effects.laws import FRICTION
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import effects as schema


def joint_friction(name: str, entry: schema.JointFriction, mechanism: Mechanism) -> ActionEffect:
    """Return the effect; see the module."""
    parameters = (Quantity.of(entry.limit), Quantity.of(entry.speed))
    place = joint_measure(mechanism, entry)
    return ActionEffect(name, [Action(name, law=FRICTION, parameters=parameters, **place)], mechanism)
