"""What belongs to a point of a body.

- A mass: a part of the mass matrix from the start (`mechanism.composition`).
- Coulomb friction of a point that rubs along a line of the ground: ``-limit tanh(s' / speed)`` on its place s.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.action import FRICTION, Action
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.loads import GROUND_ORIGIN
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.statements import along
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import AddedMass, EffectEntry
from pgmp_petsc.scene.fields import Direction, NotNegativeOrParameter, Point, PositiveOrParameter, Unit


class PointMass(AddedMass):
    """A mass and a moment of inertia at a point of a body."""

    type: Literal["point_mass"]
    acts = "mechanism"
    cause = True
    point: Point = Field(description='where it is, "body:point"')
    mass: Annotated[PositiveOrParameter, Unit("kg")] = Field(description="mass (kg), a number or a parameter's name")
    inertia: Annotated[NotNegativeOrParameter, Unit("kg m2")] = Field(
        0.0, description="moment of inertia about the point (kg m2), a number or a parameter's name"
    )

    @classmethod
    def if_added(cls, scene: Scene, run: Any, exchanged: float, tolerance: float) -> tuple[float, str] | None:
        """Say from which mass on it would matter."""
        return np.nan, f"would matter from {scene.system.text(tolerance * run.mass, 'kg', '.2g')} on"

    @property
    def adds(self) -> str:
        """Where it is a part of the mass."""
        return f"part of the mass matrix at {self.point}"


class PointFriction(EffectEntry):
    """Coulomb friction of a point of a body along a direction of the ground under a constant load, regularised:
    ``-limit tanh(rate / speed)``."""

    type: Literal["point_friction"]
    acts = "forces"
    local = edged = True
    changeable = ("limit", "speed")
    nothing_without = "limit"
    point: Point = Field(description='where it rubs, "body:point"')
    direction: Direction = Field(description="direction (x, y), in space (x, y, z); its length does not matter")
    limit: Annotated[NotNegativeOrParameter, Unit("N")] = Field(
        description="friction force (N) while it slides, a number or a parameter's name"
    )
    speed: Annotated[PositiveOrParameter, Unit("m/s")] = Field(
        description="rate at which 76 % of the limit are reached (m/s), a number or a parameter's name"
    )

    def forces(self, name: str, mechanism: Mechanism) -> ActionEffect:
        """Return the friction."""
        sides = (mechanism.attachment(point, f"effects.{name}.point") for point in (GROUND_ORIGIN, self.point))
        parameters, statement = (Quantity.of(self.limit), Quantity.of(self.speed)), along(np.array(self.direction))
        return ActionEffect(name, [Action(name, statement, *sides, FRICTION, parameters)], mechanism)
