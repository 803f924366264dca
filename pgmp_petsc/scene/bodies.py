"""Materials, cross-sections and bodies."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from pgmp_petsc.scene.fields import (
    Angle,
    Integer,
    Name,
    NotNegativeOrParameter,
    Number,
    PositiveNumber,
    PositiveOrParameter,
    Table,
    Triple,
    Vector,
    at_most,
    exactly_one,
    refusal,
)

MOST_ELEMENTS = 100_000


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


class Coefficients(Table):
    """A cross-section given by its stiffness and inertia."""

    shape: Literal["coefficients"]
    axial: PositiveOrParameter = Field(description="EA (N), a number or a parameter's name")
    shear: PositiveOrParameter = Field(description="k_s GA (N), a number or a parameter's name")
    bending: PositiveOrParameter = Field(description="EI (N m2), a number or a parameter's name")
    line_density: PositiveOrParameter = Field(description="rho A (kg/m), a number or a parameter's name")
    rotary_density: NotNegativeOrParameter = Field(
        0.0, description="rho I (kg m), a number or a parameter's name; above 0 in a flexible body"
    )


Section = Annotated[Circle | Rectangle | Coefficients, Field(discriminator="shape")]


class StraightBeam(Table):
    """A straight line of equal elements along the x axis of the body's frame, with points hinge and tip at its ends."""

    length: PositiveNumber = Field(description="length (m)")
    elements: Annotated[Integer, at_most(MOST_ELEMENTS, "no straight beam needs more, and its matrices fill memory")] = (
        Field(ge=1, description="number of elements")
    )
    start: Number = Field(0.0, description="x of the hinge (m)")


class Placement(Table):
    """First guess of a body's place for the assembly: rotate about the mesh's origin, then move."""

    origin: Vector = Field((0.0, 0.0), description="where the mesh's origin goes (m)")
    angle: Angle = Field(0.0, description="rotation about the mesh's origin (rad, anticlockwise); in the plane")
    rotation: Triple | None = Field(None, description="rotation vector: axis times angle (rad); in space")

    def origin_in(self, dimension: int) -> np.ndarray:
        """Return the origin, shape (dimension,)."""
        return np.array((*self.origin, 0.0)[:dimension])


class Body(Table):
    """A body: flexible, or rigid with the same mass."""

    mesh: str | None = Field(None, min_length=1, description="mesh file, relative to the scene's directory")
    line: StraightBeam | None = Field(
        None, description="instead of a mesh file, a straight line { length = 0.3, elements = 5 }"
    )
    element: Literal["beam2d", "solid2d", "solid3d"] = Field(
        description="beam, plane stress or solid; the cells of the mesh say which element of its kind"
    )
    material: str | None = Field(None, description="name of a material; not for a section given by coefficients")
    section: Section | None = Field(
        None, description='cross-section of a beam, such as { shape = "circle", radius = 0.01 }'
    )
    thickness: PositiveOrParameter | None = Field(
        None, description="thickness of solid2d (m), a number or a parameter's name"
    )
    section_scale: PositiveOrParameter | None = Field(
        None,
        description="scale of the cross-section of a continuum body about the x axis of its mesh, of which the mesh "
        "has 1; a number or a parameter's name",
    )
    regions: dict[Name, str] = Field(
        {}, description="materials of named regions of the mesh, other than the body's; continuum elements only"
    )
    flexible: bool = Field(True, strict=True, description="false makes the body rigid")
    placement: Placement | None = Field(None, description="first guess for the assembly")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        exactly_one(self, "mesh", "line")
        return self._consistent_beam() if self.element == "beam2d" else self._consistent_solid()

    @property
    def continuum(self) -> bool:
        """Whether the body is meshed with continuum elements."""
        return self.element != "beam2d"

    def _consistent_solid(self) -> Self:
        for key in ("line", "section"):
            if getattr(self, key) is not None:
                raise refusal(f"{self.element} takes its shape from a mesh; {key} is for beam2d", key)
        if self.material is None:
            raise refusal("missing; needed: name of a material", "material")
        if self.element == "solid2d" and self.thickness is None:
            raise refusal("missing; needed: thickness of the body (m), a number or a parameter's name", "thickness")
        if self.element == "solid3d" and self.thickness is not None:
            raise refusal("for solid2d only; a solid3d body has its thickness from its mesh", "thickness")
        if self.section_scale is not None and not self.flexible:
            raise refusal("for flexible bodies; the inertia of a rigid one would not be affine in it", "section_scale")
        return self

    def _consistent_beam(self) -> Self:
        for key in ("thickness", "section_scale", "regions"):
            if getattr(self, key):
                raise refusal("for solid2d and solid3d only", key)
        if self.section is None:
            raise refusal('missing; needed: a cross-section, such as { shape = "circle", radius = 0.01 }', "section")
        given = isinstance(self.section, Coefficients)
        if given and self.material is not None:
            raise refusal("a section given by coefficients has no material", "material")
        if not given and self.material is None:
            raise refusal("missing; needed: name of a material", "material")
        if given and self.flexible and self.section.rotary_density == 0.0:
            raise refusal("a flexible body needs section.rotary_density above 0", "section")
        return self
