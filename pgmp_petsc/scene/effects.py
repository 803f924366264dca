"""Effects: what acts on the mechanism. An effect that a scene does not name is never evaluated."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, field_validator

from pgmp_petsc.scene.fields import Direction, NumberOrParameter, Pair, Table, refusal


class Torque(Table):
    """A torque over time on a revolute joint: it turns the second body, and its reaction the first."""

    type: Literal["torque"]
    joint: str = Field(description="name of a revolute joint")
    table: tuple[Pair, ...] = Field(
        min_length=1,
        description="rows [time (s), torque (Nm)]; linear between rows, constant before and after them",
    )
    scale: NumberOrParameter = Field(1.0, description="factor on the torque, a number or a parameter's name")

    @field_validator("table")
    @classmethod
    def _times_increase(cls, table: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        for earlier, later in pairwise(table):
            if not earlier[0] < later[0]:
                raise refusal(f"times must increase strictly, but {later[0]} s follows {earlier[0]} s")
        return table


class Gravity(Table):
    """A uniform field of acceleration on every body."""

    type: Literal["gravity"]
    direction: Direction = Field((0.0, -1.0), description="direction (x, y); its length does not matter")
    acceleration: NumberOrParameter = Field(
        9.81, description="acceleration (m/s2), a number or a parameter's name"
    )


Effect = Annotated[Torque | Gravity, Field(discriminator="type")]
