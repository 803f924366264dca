"""End stops of a joint: one-sided springs with Hunt and Crossley's damping, entered and left at instants found in time.

The time of contact itself, about ``pi sqrt(inertia / stiffness)``, is not refined: steps have to resolve it. Where they
do not, the balance of energy shows it.
"""

from __future__ import annotations

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.joint_measure import joint_measure
from pgmp_petsc.effects.laws import STOP
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import effects as schema


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
