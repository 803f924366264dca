"""A mass at a point of a body: a part of the mass matrix from the start (`mechanism.composition`)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import AddedMass
from pgmp_petsc.scene.fields import NotNegativeOrParameter, Point, PositiveOrParameter, Unit


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
        return np.nan, f"would matter from {tolerance * run.mass:.2g} {scene.system.unit('kg')} on"

    @property
    def adds(self) -> str:
        """Where it is a part of the mass."""
        return f"part of the mass matrix at {self.point}"
