"""What moves in a joint: its rotation about its axis, or the displacement along its line.

End stops of a joint: one-sided springs with Hunt and Crossley's damping, entered and left at instants found in time.

The time of contact itself, about ``pi sqrt(inertia / stiffness)``, is not refined: steps have to resolve it. Where they
do not, the balance of energy shows it.

Viscous damping in a joint: ``-c s'`` on its rotation or displacement s.

Coulomb friction in a joint under a constant load: ``-limit tanh(s' / speed)`` on its rotation or displacement s.

Regularised, so that the force is smooth: below the speed the joint creeps instead of sticking. Where friction alone
changes the rate by several times this speed in one step, Newton's iteration goes back and forth between sliding one way
and the other when the joint comes to rest, and the sample fails: take a larger speed or a smaller step.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.laws import FRICTION, SPRING_DAMPER, STOP
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.statements import along
from pgmp_petsc.scene import effects as schema
from pgmp_petsc.scene.uses import slides


def joint_measure(mechanism: Mechanism, entry: Any) -> dict[str, Any]:
    """Return statement, attachments and coordinate of an effect's joint, as `Action` takes them."""
    connection = mechanism.connection(entry.joint)
    place = {"a": connection.a, "b": connection.b}
    if slides(mechanism.scene, entry):
        return {"statement": along(np.array(mechanism.scene.joints[entry.joint].axes[0])), **place}
    numbers = [k for k, c in enumerate(mechanism.coordinates) if c.connection is connection]
    return {"statement": connection.angle, "coordinate": numbers[0] if numbers else -1, **place}


def end_stop(name: str, entry: schema.EndStop, mechanism: Mechanism) -> ActionEffect:
    """Return the effect with one action for each end; see the module."""
    place = joint_measure(mechanism, entry)
    ends = [(entry.lower, -1.0), (entry.upper, 1.0)]
    return ActionEffect(
        name,
        [
            Action(
                name,
                law=STOP,
                parameters=(*map(Quantity.of, (entry.stiffness, entry.damping, end)), Quantity(side)),
                **place,
            )
            for end, side in ends
            if end is not None
        ],
        mechanism,
    )


def joint_damping(name: str, entry: schema.JointDamping, mechanism: Mechanism) -> ActionEffect:
    """Return the effect; see the module."""
    parameters = (Quantity(0.0), Quantity.of(entry.coefficient), Quantity(0.0))
    place = joint_measure(mechanism, entry)
    return ActionEffect(name, [Action(name, law=SPRING_DAMPER, parameters=parameters, **place)], mechanism)


def joint_friction(name: str, entry: schema.JointFriction, mechanism: Mechanism) -> ActionEffect:
    """Return the effect; see the module."""
    parameters = (Quantity.of(entry.limit), Quantity.of(entry.speed))
    place = joint_measure(mechanism, entry)
    return ActionEffect(name, [Action(name, law=FRICTION, parameters=parameters, **place)], mechanism)
