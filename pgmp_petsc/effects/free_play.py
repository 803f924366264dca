"""A torsional spring with free play: a coupling or gear whose teeth touch on one side or on the other.

Within the play there is no force; beyond it that of a spring, with Hunt and Crossley's damping, which begins at zero.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pgmp_petsc.effects.action import joint_measure
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.joint_effects import ElasticEnds
from pgmp_petsc.effects.law import Law
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene.fields import NumberOrParameter, Unit

FREE_PLAY = Law(
    "free_play",
    ("k", "c", "lower", "upper"),
    potential="k * (max(0, s - upper)**2 + max(0, lower - s)**2) / 2",
    force="elastic * max(0, 1 + c * (rate if s > upper else -rate))",
    edges=("s - upper", "lower - s"),
    left_out="it has free play, not linear",
)


class FreePlay(ElasticEnds):
    """A spring in a joint with free play: no force between lower and upper, elastic beyond, with the instants of
    contact found exactly."""

    type: Literal["free_play"]
    lower: Annotated[NumberOrParameter, Unit("rad", "m")] = Field(description="where the play ends below (rad or m)")
    upper: Annotated[NumberOrParameter, Unit("rad", "m")] = Field(description="where the play ends above (rad or m)")

    def forces(self, name: str, mechanism: Mechanism) -> ActionEffect:
        place, parameters = joint_measure(mechanism, self), (self.stiffness, self.damping, self.lower, self.upper)
        return ActionEffect.of_laws(name, mechanism, place, FREE_PLAY, parameters)
