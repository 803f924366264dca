"""How a controller acts in the models: by a force in a joint that its states give, with slopes for the iteration.

The force in a joint is an action of the mechanics (`effects.action`). Its slopes are along the motion that the measure
is of: that of a joint, or of a point along an axis; of other measures none are taken, and the iteration of a step finds
the force without them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.action import NOTHING, Action
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.joint_effects import joint_measure, measure_of
from pgmp_petsc.effects.law import Law
from pgmp_petsc.effects.laws import CARRIED_FRICTION
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.statements import along
from pgmp_petsc.outputs.of_frames import OnTheGround, Speed
from pgmp_petsc.outputs.readings import AXES
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.controllers import ControllerEntry
from pgmp_petsc.scene.uses import slides

#: Among the parameters, where the law notes the measure that it meets, and its rate.
NOTED = slice(3, 5)
ACTING = '''"""A force that is given, with the slopes that the iteration of a step takes; notes what is measured."""

STIFFNESS = ""


def evaluate(p, amplitude, s, rate, about, depths):
    p[3], p[4] = s, rate
    return float(amplitude + p[0]), float(p[1]), float(p[2]), 0.0, 0.0, float(rate)


def slopes(p, amplitude, s, rate, found):
    found[0], found[1], found[2], found[3] = 1.0, 0.0, 0.0, 1.0
    return 0.0


def edges(p, s):
    return ()


C = ""

COMPLETE = True
'''


class Acting(Law):
    """The force of a controller as the mechanics see it: ``amplitude + force``, whose stiffness and damping are given.

    The force does not hang on the measure that the mechanics have: the controller has found it there already.
    """

    linear_stiffness = ""

    def _printed(self) -> str:
        return ACTING


ACTING_LAW = Acting(
    "controlled",
    ("force", "stiffness", "damping", "measure", "rate_of_measure"),
    force="amplitude + force - stiffness * s - damping * rate",
)

#: Laws of which the first parameters are given between corrections, and how many.
GIVEN = {ACTING_LAW: 3, CARRIED_FRICTION: 1}


def given_to(actions: Sequence[Action]) -> list[int]:
    """Return the numbers of the actions to which parameters are given between corrections."""
    return [k for k, action in enumerate(actions) if action.law in GIVEN]


class JointController(ControllerEntry):
    """What acts in a joint, and measures any output of places and speeds."""

    def forces(self, name: str, mechanism: Mechanism) -> ActionEffect:
        """Return the force in the joint, behind what leads it if its measure is of another motion."""
        nothing = (Quantity(0.0),) * len(ACTING_LAW.parameters)
        leading = leading_of(mechanism, self)
        action = Action(name, law=ACTING_LAW, parameters=nothing, led=bool(leading), **joint_measure(mechanism, self))
        return ActionEffect(
            name, [*(Action(name, law=NOTHING, parameters=(), **one) for one in leading), action], mechanism
        )


def has_slopes(scene: Scene, entry: ControllerEntry) -> bool:
    """Whether slopes are taken: of a measure, or the rate of one, along the motion of a joint or of a point."""
    output = scene.outputs[entry.measures]
    return getattr(output, "joint", None) is not None or isinstance(output, (OnTheGround, Speed))


def leading_of(mechanism: Mechanism, entry: ControllerEntry) -> list[dict[str, Any]]:
    """Return the motion that the slopes are along, as `Action` takes it; none where it is that which is acted on."""
    scene, output = mechanism.scene, mechanism.scene.outputs[entry.measures]
    if not has_slopes(scene, entry):
        return []
    joint, slid = getattr(output, "joint", None), slides(scene, output)
    if joint is not None:
        own = joint == entry.joint and slid == slides(scene, entry)
        return [] if own else [measure_of(mechanism, joint, "sliding" if slid else "turning")]
    direction, where = np.eye(mechanism.space.dimension)[AXES[output.axis]], f"outputs.{entry.measures}.point"
    ends = (mechanism.attachment(point, where) for point in ("ground:origin", output.point))
    return [{"statement": along(direction), **dict(zip("ab", ends))}]
