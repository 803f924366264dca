"""Outputs: what a run reports over time."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pgmp_petsc.scene.fields import Connection, Point, Table, Vector

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


#: Quantities of a stress output by the kind of element, with their units.
STRESSES = {
    "solid2d": dict.fromkeys(("von_mises", "principal_max", "principal_min"), "Pa"),
    "solid3d": dict.fromkeys(("von_mises", "principal_max", "principal_min"), "Pa"),
    "beam2d": {
        "axial_force": "N",
        "shear_force": "N",
        "bending_moment": "N m",
        "stress_max": "Pa",
        "stress_min": "Pa",
    },
    "beam3d": {
        "axial_force": "N",
        "shear_force_2": "N",
        "shear_force_3": "N",
        "torsion_moment": "N m",
        "bending_moment_2": "N m",
        "bending_moment_3": "N m",
        "stress_max": "Pa",
        "stress_min": "Pa",
    },
}
#: Quantities of beams that need the shape of the section.
OF_FIBRES = ("stress_max", "stress_min")


class Stress(Table):
    """Stress of a flexible body, or the force or moment in a section of a beam, largest of what it is asked of."""

    type: Literal["stress"]
    body: str = Field(description="name of a flexible body")
    quantity: Literal[
        "von_mises",
        "principal_max",
        "principal_min",
        "axial_force",
        "shear_force",
        "shear_force_2",
        "shear_force_3",
        "torsion_moment",
        "bending_moment",
        "bending_moment_2",
        "bending_moment_3",
        "stress_max",
        "stress_min",
    ] = Field(
        description="von_mises, principal_max, principal_min (Pa) of solids; of beams axial_force, shear_force (N), "
        "bending_moment (N m), stress_max, stress_min of the outermost fibres (Pa), in space shear_force_2 and _3, "
        "bending_moment_2 and _3, torsion_moment"
    )
    at: Vector | None = Field(None, description="place in the body's own frame, that of its mesh (m)")
    group: str | None = Field(
        None, description="group of faces of a solid, or named point of a beam: the largest value there"
    )
    region: str | None = Field(None, description="region of cells of a solid: the largest value there")


Output = Annotated[
    Angle | Sliding | Distance | Rotation | Position | Displacement | Deformation | Stress, Field(discriminator="type")
]
