"""Ground points, joints and the coordinates that describe the rigid motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from pgmp_petsc.scene.fields import Axis, Connection, Direction, Interval, Name, Place, Table, refusal

ORIGIN = "origin"
PARALLEL = 1e-6  # sine of the angle between two axes that are taken for one


def are_parallel(first: Sequence[float], second: Sequence[float]) -> bool:
    """Whether two axes (x, y, z) have one direction."""
    return bool(np.linalg.norm(np.cross(first, second)) < PARALLEL * np.linalg.norm(first) * np.linalg.norm(second))


class Ground(Table):
    """Points fixed in space; ``ground:origin`` at (0, 0) is always there."""

    points: dict[Name, Place] = Field(
        {ORIGIN: (0.0, 0.0)},
        description="position (x, y) of each point (m), (x, y, z) in space; each a number or a parameter's name",
    )

    @property
    def positions(self) -> dict[str, tuple[float | str, ...]]:
        """Position of every ground point (m, or names of parameters), the origin included."""
        return {ORIGIN: (0.0, 0.0), **self.points}

    @field_validator("points")
    @classmethod
    def _origin_stays(cls, points: dict[str, tuple[float | str, ...]]) -> dict[str, tuple[float | str, ...]]:
        if any(points.get(ORIGIN, ())):
            raise refusal("the ground's origin is always at [0, 0]; give the point another name", ORIGIN)
        return points


class _Joint(Table):
    """Two points of different bodies, or of a body and the ground."""

    #: Number of constraints in the plane and in space.
    n_constraints: ClassVar[dict[int, int]]
    #: Motions that it leaves free and that are measured: "turning" about its axis, "sliding" along it or along its line.
    motions: ClassVar[tuple[str, ...]] = ()
    connect: Connection = Field(description='the two points, "body:point" or "ground:point"')

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """Directions that say how the joint stands in space, in the frame of the first point's owner; one or two."""
        return ((1.0, 0.0, 0.0),)


class Revolute(_Joint):
    """Two points share their position; the relative rotation is free, in space about an axis."""

    n_constraints: ClassVar[dict[int, int]] = {2: 2, 3: 5}
    motions: ClassVar[tuple[str, ...]] = ("turning",)
    type: Literal["revolute"]
    axis: Axis | None = Field(None, description="axis (x, y, z) in the frame of the first point's owner; in space")

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """The axis of rotation."""
        return (self.axis,)


class PointOnLine(_Joint):
    """The second point moves on a line through the first."""

    n_constraints: ClassVar[dict[int, int]] = {2: 1, 3: 2}
    motions: ClassVar[tuple[str, ...]] = ("sliding",)
    type: Literal["point_on_line"]
    connect: Connection = Field(description="the point that carries the line, then the point that moves on it")
    direction: Direction = Field(
        description="direction of the line, (x, y) or in space (x, y, z), fixed to the owner of the first point"
    )

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """The line's direction."""
        return (self.direction,)


class Fixed(_Joint):
    """Two points share position and rotation: their bodies are welded at the angle that they are placed at."""

    n_constraints: ClassVar[dict[int, int]] = {2: 3, 3: 6}
    type: Literal["fixed"]


class Spherical(_Joint):
    """Two points share their position; every rotation is free. In space."""

    n_constraints: ClassVar[dict[int, int]] = {3: 3}
    type: Literal["spherical"]


class Universal(_Joint):
    """Two points share their position, and an axis of each body stays at a right angle to one of the other. In
    space."""

    n_constraints: ClassVar[dict[int, int]] = {3: 4}
    type: Literal["universal"]
    axis: Axis = Field(description="axis (x, y, z) fixed in the first body, in its frame")
    second_axis: Axis = Field(description="axis fixed in the second body; in the frame of the first one, as assembled")

    @model_validator(mode="after")
    def _axes_differ(self) -> Self:
        if are_parallel(self.axis, self.second_axis):
            raise refusal("must not have the direction of axis; both axes are at a right angle", "second_axis")
        return self

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """Both axes of rotation."""
        return self.axis, self.second_axis


class _Guided(_Joint):
    axis: Axis = Field(description="axis (x, y, z) in the frame of the first point's owner")

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """The axis of the motion."""
        return (self.axis,)


class Cylindrical(_Guided):
    """The second point moves on an axis through the first, and turns about it. In space."""

    n_constraints: ClassVar[dict[int, int]] = {3: 4}
    motions: ClassVar[tuple[str, ...]] = ("turning", "sliding")
    type: Literal["cylindrical"]


class Prismatic(_Guided):
    """The second point moves on an axis through the first without turning. In space."""

    n_constraints: ClassVar[dict[int, int]] = {3: 5}
    motions: ClassVar[tuple[str, ...]] = ("sliding",)
    type: Literal["prismatic"]


class PointOnPlane(_Joint):
    """The second point moves on a plane through the first. In space."""

    n_constraints: ClassVar[dict[int, int]] = {3: 1}
    type: Literal["point_on_plane"]
    normal: Axis = Field(description="normal (x, y, z) of the plane, fixed to the owner of the first point")

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """The plane's normal."""
        return (self.normal,)


Joint = Annotated[
    Revolute | PointOnLine | Fixed | Spherical | Universal | Cylindrical | Prismatic | PointOnPlane,
    Field(discriminator="type"),
]
#: Joints that a mechanism in the plane may have.
PLANAR_JOINTS = ("revolute", "point_on_line", "fixed")


def joints_with(*motions: str, dimension: int = 3) -> tuple[type[_Joint], ...]:
    """Return the kinds of joints that leave one of these motions free, in the plane or in space."""
    kinds = (Revolute, PointOnLine, Cylindrical, Prismatic)
    return tuple(kind for kind in kinds if dimension in kind.n_constraints and not set(motions).isdisjoint(kind.motions))


class Coordinate(Table):
    """A rigid coordinate: the angle of a revolute joint over a range of configurations."""

    joint: str = Field(description="name of a revolute joint; its relative rotation is the coordinate")
    range: Interval = Field(
        description="first and last angle (rad); zero is where the frames of both bodies point the same way, in space "
        "where the bodies are as placed"
    )
    periodic: bool = Field(False, strict=True, description="whether the range closes on itself (it is then 2 pi long)")

    @model_validator(mode="after")
    def _period_is_a_revolution(self) -> Self:
        low, high = self.range
        if self.periodic and abs(high - low - 2.0 * math.pi) > 1e-9:
            raise refusal(f"the range of a periodic coordinate is 2 pi = {2.0 * math.pi!r} long", "range")
        return self
