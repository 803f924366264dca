"""Outputs: what a run reports over time."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pgmp_petsc.scene.fields import Point, Table

Axis = Literal["x", "y", "z"]


class Angle(Table):
    """Relative rotation of a revolute joint (rad), measured on the flexible bodies' nodes."""

    type: Literal["angle"]
    joint: str = Field(description="name of a revolute joint")


class Rotation(Table):
    """Rotation of a point's cross-section in space (rad)."""

    type: Literal["rotation"]
    point: Point = Field(description='point of a body, "body:point"')


class Position(Table):
    """Position of a point along an axis in space (m)."""

    type: Literal["position"]
    point: Point = Field(description='point of a body, "body:point"')
    axis: Axis = Field(description="x or y, in space also z")


class Displacement(Table):
    """Position of a point along an axis minus that at the start of the run (m)."""

    type: Literal["displacement"]
    point: Point = Field(description='point of a body, "body:point"')
    axis: Axis = Field(description="x or y, in space also z")


class Deformation(Table):
    """Position of a point along an axis minus that of the rigid mechanism at the same joint angle (m)."""

    type: Literal["deformation"]
    point: Point = Field(description='point of a body, "body:point"')
    axis: Axis = Field(description="x or y, in space also z")
    frame: Literal["ground", "body"] = Field(
        "ground", description="whose axes: the ground's, or those of the rigid body that carries the point"
    )


Output = Annotated[Angle | Rotation | Position | Displacement | Deformation, Field(discriminator="type")]
