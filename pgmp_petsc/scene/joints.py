"""Ground points, joints and the coordinates that describe the rigid motion."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from pgmp_petsc.scene.fields import Connection, Direction, Interval, Name, Pair, Table, refusal

ORIGIN = "origin"


class Ground(Table):
    """Points fixed in space; ``ground:origin`` at (0, 0) is always there."""

    points: dict[Name, Pair] = Field({ORIGIN: (0.0, 0.0)}, description="position (x, y) of each point (m)")

    @property
    def positions(self) -> dict[str, tuple[float, float]]:
        """Position (x, y) of every ground point (m), the origin included."""
        return {ORIGIN: (0.0, 0.0), **self.points}

    @field_validator("points")
    @classmethod
    def _origin_stays(cls, points: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        if points.get(ORIGIN, (0.0, 0.0)) != (0.0, 0.0):
            raise refusal("the ground's origin is always at [0, 0]; give the point another name", ORIGIN)
        return points


class Revolute(Table):
    """Two points share their position; the relative rotation is free."""

    type: Literal["revolute"]
    connect: Connection = Field(description='the two points, "body:point" or "ground:point"')


class PointOnLine(Table):
    """The second point moves on a line through the first."""

    type: Literal["point_on_line"]
    connect: Connection = Field(
        description="the point that carries the line, then the point that moves on it"
    )
    direction: Direction = Field(
        description="direction (x, y) of the line, fixed to the owner of the first point"
    )


class Fixed(Table):
    """Two points share position and rotation: their bodies are welded at the angle that they are placed at."""

    type: Literal["fixed"]
    connect: Connection = Field(description='the two points, "body:point" or "ground:point"')


Joint = Annotated[Revolute | PointOnLine | Fixed, Field(discriminator="type")]


class Coordinate(Table):
    """A rigid coordinate: the angle of a revolute joint over a range of configurations."""

    joint: str = Field(description="name of a revolute joint; its relative rotation is the coordinate")
    range: Interval = Field(description="first and last angle (rad)")
    periodic: bool = Field(
        False, strict=True, description="whether the range closes on itself (it is then 2 pi long)"
    )

    @model_validator(mode="after")
    def _period_is_a_revolution(self) -> Self:
        low, high = self.range
        if self.periodic and abs(high - low - 2.0 * math.pi) > 1e-9:
            raise refusal(f"the range of a periodic coordinate is 2 pi = {2.0 * math.pi!r} long", "range")
        return self
