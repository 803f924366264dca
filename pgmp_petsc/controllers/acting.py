"""How a controller acts in the models: by a force in a joint that its states give, with slopes for the iteration.

The force in a joint is an action of the mechanics (`effects.action`). Its slopes are along the motions that measures
are made of (`measured`): of joints, distances and places of points. Of deformations, and of places outside of a base
that moves, none are taken, and the iteration of a step finds the force without them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.controllers.law import LIMITS, ControlLaw, Measured
from pgmp_petsc.declare.ideas import refuse
from pgmp_petsc.effects.action import NOTHING, Action, joint_measure
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.law import Law
from pgmp_petsc.effects.time_function import Piece, TimeFunction, amplitude_of
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.controllers import ControllerEntry
from pgmp_petsc.scene.fields import with_values
from pgmp_petsc.scene.outputs import unit_of
from pgmp_petsc.scene.units import own_powers
from pgmp_petsc.scene.uses import slides

#: Among the parameters, where the law notes the measure that it meets, and its rate.
NOTED = slice(3, 5)
ACTING = r'''"""A force that is given, with the slopes that the iteration of a step takes; notes what is measured."""

STIFFNESS = ""


def evaluate(p, amplitude, s, rate, about, depths):
    p[3], p[4] = s, rate
    return float(amplitude + p[0]), float(p[1]), float(p[2]), 0.0, 0.0, float(rate)


def slopes(p, amplitude, s, rate, found):
    found[0], found[1], found[2], found[3] = 1.0, 0.0, 0.0, 1.0
    return 0.0


def edges(p, s):
    return ()


C = """static void law_commanded(const double p[], double amplitude, double s, double rate, double about,
                          double found[]) {
    (void)s, (void)about;
    found[0] = amplitude + p[0], found[1] = p[1], found[2] = p[2], found[3] = rate;
}"""

COMPLETE = True
'''


class Acting(Law):
    """The force of a controller as the mechanics see it: ``amplitude + force``, whose stiffness and damping are given.

    The force does not hang on the measure that the mechanics have: the controller has found it there already.
    """

    linear_stiffness, bends = "", False

    def _printed(self) -> str:
        return ACTING


ACTING_LAW = Acting(
    "commanded",
    ("force", "stiffness", "damping", "measure", "rate_of_measure"),
    force="amplitude + force - stiffness * s - damping * rate",
    left_out="it is a controller, whose force follows what it measures",
)


def given_to(actions: Sequence[Action]) -> list[int]:
    """Return the numbers of the actions to which parameters are given between corrections."""
    return [k for k, action in enumerate(actions) if action.law.loaded or action.law is ACTING_LAW]


class ControllerEffect(ActionEffect):
    """The force of a controller, in as many parts as it measures motions: one for the slopes by each of them."""

    @property
    def entry(self) -> str:
        return f"controllers.{self.name}"

    def _fixed(self) -> list[Action]:
        return super()._fixed()[:1]

    def turning_patterns(self) -> list[Action]:
        return super().turning_patterns()[:1]


class JointController(ControllerEntry):
    """A controller that acts in a joint, and measures any outputs of places and speeds."""

    def forces(self, name: str, mechanism: Mechanism) -> ControllerEffect:
        """Return the force in the joint, a part for each motion that is measured, behind what measures it if that is
        another motion than the one that is acted on."""
        self._check(mechanism.scene)
        scene, nothing = mechanism.scene, (Quantity(0.0),) * len(ACTING_LAW.parameters)
        own, actions = joint_measure(mechanism, self), []
        for output in measured_by(scene, self).motions or (None,):
            read = None if output is None else scene.outputs[output]
            motion = read.stated(f"outputs.{output}", mechanism) if read is not None and read.is_stated else own
            led = any(motion[key] is not part for key, part in own.items())
            if led:
                actions.append(Action(name, law=NOTHING, parameters=(), **motion))
            actions.append(Action(name, law=ACTING_LAW, parameters=nothing, led=led, **own))
        return ControllerEffect(name, actions, mechanism)

    def _check(self, scene: Scene) -> None:
        """Raise `InputError` if the class gives its law other parameters than it has, as a plugin's may."""
        law, given = self.law(), self.parameters()
        if not isinstance(law, ControlLaw):
            raise refuse(type(self), f"law returns a ControlLaw, and not a {type(law).__name__}")
        if missing := [name for name in law.parameters if name not in given]:
            words = f"parameters gives its law {law.name} ({law.place}) no number for {', '.join(missing)}; it gives "
            raise refuse(type(self), f"{words}{', '.join(given) or 'none'}")
        for name in law.parameters:
            if isinstance(given[name], str) and given[name] not in scene.parameters:
                words = f"its law is given the parameter '{given[name]}', which the scene has not"
                raise refuse(type(self), words)


def measured_by(scene: Scene, entry: ControllerEntry) -> Measured:
    """Return what a controller's measures are made of."""
    return Measured.of(scene, entry.measured)


def are_stated(scene: Scene) -> bool:
    """Return whether actions of the mechanics measure all that a scene's controllers do (`OutputEntry.stated`)."""
    each = (measured_by(scene, one).motions for one in scene.controllers.values())
    return all(scene.outputs[name].is_stated for motions in each for name in motions)


class Control(NamedTuple):
    """A controller in SI units."""

    law: ControlLaw  # of the motions that it measures
    parameters: dict[str, float | str]  # of the law, and its limits, in their order: numbers or parameters' names
    reference: TimeFunction | float | str  # over time, a number, or a parameter's name
    takes_rate: bool = False  # whether its force or its states jump with the rate of the reference; see `rounded`


def control_of(scene: Scene, entry: ControllerEntry) -> Control:
    """Return what a controller does, which a scene writes in its own units."""
    found, reference, power_of = measured_by(scene, entry), entry.reference, scene.system.power_of
    law = entry.law().measuring(found.seen, len(found.motions), found.constants)
    limits = dict(zip(LIMITS, entry.limits or (-np.inf, np.inf)))
    named = entry.parameters() | limits | ({} if reference.constant is None else {"r": reference.constant})
    force = power_of("N" if slides(scene, entry) else "N m")
    known = {name: power_of(unit_of(scene, output)) for name, output in entry.measured.items()}
    known |= own_powers(scene, named)
    law, in_si = law.in_si(known, force)
    given = entry.parameters() | dict(found.constants) | limits
    parameters = {name: in_si.number(name, given[name]) for name in (*law.parameters, *LIMITS)}
    if reference.constant is not None:
        return Control(law, parameters, in_si.number("r", reference.constant))
    over_time = amplitude_of(with_values(reference, lambda value: in_si.number("r", value)))
    return Control(law, parameters, over_time, law.reads("reference_rate") and not entry.sample_time)


@lru_cache(32)
def rounded(lines: TimeFunction, width: float) -> TimeFunction:
    """Return lines over time whose corners are parabolas of a width (s), within half of the lines that meet there.

    Of a width of a step, rates at the ends of steps are means over a step. So a force that goes with the rate has the
    impulse that it should have, wherever in a step the corner is, and errors fall as the square of the step.
    """
    pieces, corners = list(lines.pieces[:1]), [piece.begin for piece in lines.pieces]
    for (before, after), end in zip(pairwise(lines.pieces), [*corners[2:], np.inf]):
        corner, (a, b) = after.begin, ((*piece.cubic, 0.0)[1] for piece in (before, after))
        if corner > 0.0:  # a run begins behind a corner at its start
            reach = 0.5 * min(width, corner - max(before.begin, 0.0), end - corner)
            bend = 0.25 * (b - a) / reach
            pieces.append(Piece(corner - reach, corner, (after.cubic[0] + bend * reach**2, 0.5 * (a + b), bend)))
            after = after._replace(begin=corner + reach)
        pieces.append(after)
    return TimeFunction(*pieces)
