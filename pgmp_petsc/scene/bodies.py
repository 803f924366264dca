"""Materials, cross-sections and bodies."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pgmp_petsc.scene.fields import Number, Pair, PositiveOrParameter, Table


class Material(Table):
    """An isotropic linear elastic material."""

    E: PositiveOrParameter = Field(description="Young's modulus (Pa), a number or a parameter's name")
    nu: Number = Field(gt=-1.0, lt=0.5, description="Poisson's ratio")
    rho: PositiveOrParameter = Field(description="density (kg/m3), a number or a parameter's name")


class Circle(Table):
    """A solid circular cross-section."""

    shape: Literal["circle"]
    radius: PositiveOrParameter = Field(description="radius (m), a number or a parameter's name")


class Rectangle(Table):
    """A solid rectangular cross-section."""

    shape: Literal["rectangle"]
    width: PositiveOrParameter = Field(
        description="size across the plane of motion (m), or a parameter's name"
    )
    height: PositiveOrParameter = Field(description="size in the plane of motion (m), or a parameter's name")


Section = Annotated[Circle | Rectangle, Field(discriminator="shape")]


class Placement(Table):
    """First guess of a body's place for the assembly: rotate about the mesh's origin, then move."""

    origin: Pair = Field((0.0, 0.0), description="where the mesh's origin goes (m)")
    angle: Number = Field(0.0, description="rotation about the mesh's origin (rad, anticlockwise)")


class Body(Table):
    """A flexible body."""

    mesh: str = Field(min_length=1, description="mesh file, relative to the scene's directory")
    element: Literal["beam2d"] = Field(description="element type")
    material: str = Field(description="name of a material")
    section: Section = Field(description='cross-section, such as { shape = "circle", radius = 0.01 }')
    placement: Placement | None = Field(None, description="first guess for the assembly")
