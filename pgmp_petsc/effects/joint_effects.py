"""Effects on the motion s in a joint, the rotation about its axis or the displacement along its line.

End stops are one-sided springs with Hunt and Crossley's damping, entered and left at instants found in time. The time
of contact itself, about ``pi sqrt(inertia / stiffness)``, is not refined: steps have to resolve it. Where they do not,
the balance of energy shows it.

Viscous damping is ``-c s'``, Coulomb friction ``-limit tanh(s' / speed)``. Its limit is given, of a joint under a
constant load, or hangs on the force N that the joint carries, ``coefficient radius N`` of what turns and
``coefficient N`` of what slides, N being the size of the whole force in the joint (docs/effects.md, friction under the
force that a joint carries), found between the corrections of a step (`controllers.running`).

Friction is regularised, so that the force is smooth: below the speed the joint creeps instead of sticking. Where
friction alone changes the rate by several times this speed in one step, Newton's iteration goes back and forth between
sliding one way and the other when the joint comes to rest, and the sample fails: take a larger speed or a smaller step.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.effects.action import FRICTION, SPRING_DAMPER, joint_measure
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.law import Law
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import OnJoint
from pgmp_petsc.scene.fields import NotNegativeOrParameter, NumberOrParameter, PositiveOrParameter, Unit, refusal
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.uses import slides

# A stop never pulls, and its force begins at zero, so that it is continuous at contact; side is 1 for an upper stop, -1
# for a lower one.
STOP = Law(
    "stop",
    ("k", "c", "place", "side"),
    potential="k * (side * (s - place))**2 / 2 if side * (s - place) > 0 else 0",
    force="elastic * max(0, 1 + c * side * rate)",
    edges=("side * (s - place)",),
    left_out="it is one-sided, not linear",
)

CARRIED_FRICTION = Law(
    "carried_friction",
    ("load", "coefficient", "radius", "speed"),
    force="-coefficient * radius * load * tanh(rate / speed)",
    left_out=FRICTION.left_out,
    loaded=True,
)


class ElasticEnds(OnJoint):
    """A spring beyond the ends of a joint's motion, with the instants of contact found exactly."""

    changeable = ("lower", "upper", "stiffness", "damping")
    edged = True
    stiff_by = "stiffness"
    sets_in = {"lower": -1.0, "upper": 1.0}
    ordered = (("lower", "upper"),)
    lower: Annotated[NumberOrParameter | None, Unit("rad", "m")] = Field(
        None, description="where the stop at the lower end is (rad or m)"
    )
    upper: Annotated[NumberOrParameter | None, Unit("rad", "m")] = Field(
        None, description="where the stop at the upper end is (rad or m)"
    )
    stiffness: Annotated[PositiveOrParameter, Unit("N m/rad", "N/m")] = Field(description="(Nm/rad or N/m)")
    damping: Annotated[NotNegativeOrParameter, Unit("s/rad", "s/m")] = Field(
        0.0,
        description="of Hunt and Crossley (s/rad or s/m): force of stiffness times depth (1 + damping depth'), "
        "which never pulls; a number or a parameter's name",
    )


class EndStop(ElasticEnds):
    """A one-sided elastic stop of a joint, with the instants of contact found exactly."""

    type: Literal["end_stop"]
    cause = True

    def check_entries(self) -> None:
        if self.lower is None and self.upper is None:
            raise refusal("at least one of lower and upper is needed")

    @classmethod
    def if_added(cls, scene: Scene, run: Any, exchanged: float, tolerance: float) -> tuple[float, str] | None:
        ranges = [
            f"{one.name} from {one.shown(path.min()):.3g} to {one.text(path.max(), '.3g')}"
            for one, path in zip(run.coordinates, run.theta.T)
        ]
        return np.nan, f"would matter where the motion ends: {', '.join(ranges)}"

    def forces(self, name: str, mechanism: Mechanism) -> ActionEffect:
        ends = ((getattr(self, key), side) for key, side in self.sets_in.items())
        each = [(self.stiffness, self.damping, end, side) for end, side in ends if end is not None]
        return ActionEffect.of_laws(name, mechanism, joint_measure(mechanism, self), STOP, *each)


class JointDamping(OnJoint):
    """Viscous damping of the relative rotation or sliding in a joint."""

    type: Literal["joint_damping"]
    changeable = ("coefficient",)
    nothing_without = strength = "coefficient"
    coefficient: Annotated[NotNegativeOrParameter, Unit("N m s/rad", "N s/m")] = Field(
        description="(Nm s/rad or N s/m)"
    )

    @classmethod
    def work(cls, rate: np.ndarray, time: np.ndarray, turns_freely: bool) -> float:
        from scipy.integrate import trapezoid  # a noticeable time, and only sizes of effects need it

        return float(trapezoid(rate**2, time))

    def forces(self, name: str, mechanism: Mechanism) -> ActionEffect:
        place, parameters = joint_measure(mechanism, self), (0.0, self.coefficient, 0.0)
        return ActionEffect.of_laws(name, mechanism, place, SPRING_DAMPER, parameters)


class JointFriction(OnJoint):
    """Coulomb friction in a joint, regularised: ``-limit tanh(rate / speed)``, where the limit is given or follows the
    force that the joint carries."""

    type: Literal["joint_friction"]
    one_of = ("limit", "coefficient")
    changeable = ("limit", "coefficient", "radius", "speed")
    strength = "limit"
    edged = True
    limit: Annotated[NotNegativeOrParameter | None, Unit("N m", "N")] = Field(
        None, description="friction torque (Nm) or force (N) while it slides"
    )
    coefficient: Annotated[NotNegativeOrParameter | None, Unit("1")] = Field(
        None, description="in place of a limit: of friction under the force that the joint carries"
    )
    radius: Annotated[PositiveOrParameter | None, Unit("m")] = Field(
        None, description="at which it rubs (m), of what turns, with a coefficient"
    )
    speed: Annotated[PositiveOrParameter, Unit("rad/s", "m/s")] = Field(
        description="rate at which 76 % of the limit are reached (rad/s or m/s)"
    )

    def check_entries(self) -> None:
        if self.radius is not None and self.limit is not None:
            raise refusal("without effect, as the limit is given; leave it out", "radius")

    @property
    def nothing_without(self) -> str:
        return "limit" if self.coefficient is None else "coefficient"

    @property
    def by_load(self) -> bool:
        return self.coefficient is not None

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        """Yield a line if what turns has no radius at which it rubs, or what slides has one."""
        if self.by_load and self.joint in scene.joints:
            entry, slid = f"effects.{name}.radius", slides(scene, self)
            if slid and self.radius is not None:
                yield problem(entry, "what slides rubs at no radius; leave it out", self.radius)
            elif not slid and self.radius is None:
                yield problem(entry, "missing; what turns rubs at a radius (m): that of the pin in its bearing")

    @classmethod
    def work(cls, rate: np.ndarray, time: np.ndarray, turns_freely: bool) -> float:
        from scipy.integrate import trapezoid  # as above

        return float(trapezoid(np.abs(rate), time))

    def forces(self, name: str, mechanism: Mechanism) -> ActionEffect:
        law, given = FRICTION, (self.limit, self.speed)
        if self.by_load:
            radius = 1.0 if self.radius is None else self.radius
            law, given = CARRIED_FRICTION, (0.0, self.coefficient, radius, self.speed)
        return ActionEffect.of_laws(name, mechanism, joint_measure(mechanism, self), law, given)
