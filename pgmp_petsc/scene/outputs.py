"""Outputs: what a run reports over time."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pgmp_petsc.scene.fields import Connection, Point, Table

Axis = Literal["x", "y", "z"]


class Angle(Table):
    """Relative rotation of a revolute joint (rad), measured on the flexible bodies' nodes."""

    type: Literal["angle"]
    joint: str = Field(description="name of a revolute joint, in space also of a cylindrical one")


class Sliding(Table):
    """Displacement along the line or axis of a joint that slides (m)."""

    type: Literal["sliding"]
    joint: str = Field(description="name of a joint that slides: point_on_line, prismatic, cylindrical")


class Distance(Table):
    """Distance of two points (m)."""

    type: Literal["distance"]
    points: Connection = Field(description='two points, "body:point" or "ground:point"')


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


Output = Annotated[
    Angle | Sliding | Distance | Rotation | Position | Displacement | Deformation, Field(discriminator="type")
]
