"""Sections that are given by their stiffness and inertia."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from pgmp_petsc.bodies.affine import AffineSum
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.scene.bodies import SectionEntry, Spans
from pgmp_petsc.scene.fields import NotNegativeOrParameter, PositiveOrParameter, Unit


class _Given(SectionEntry):
    """Coefficients that are the entries, those of the mass behind those of the stiffness."""

    of_material = False

    def coefficients(self, dimension: int, material: Any, nominal: Mapping[str, float], spans: Spans) -> BeamSection:
        """Return the entries; see `SectionEntry.coefficients`."""
        given = [AffineSum.of(entry) for name, entry in self if name != "shape"]
        n = {2: 3, 3: 6}[dimension]
        return BeamSection(tuple(given[:n]), tuple(given[n:]))


class Coefficients(_Given):
    """A cross-section given by its stiffness and inertia."""

    elements = ("beam2d",)
    shape: Literal["coefficients"]
    axial: Annotated[PositiveOrParameter, Unit("N")] = Field(description="EA (N), a number or a parameter's name")
    shear: Annotated[PositiveOrParameter, Unit("N")] = Field(description="k_s GA (N), a number or a parameter's name")
    bending: Annotated[PositiveOrParameter, Unit("N m2")] = Field(
        description="EI (N m2), a number or a parameter's name"
    )
    line_density: Annotated[PositiveOrParameter, Unit("kg/m")] = Field(
        description="rho A (kg/m), a number or a parameter's name"
    )
    rotary_density: Annotated[NotNegativeOrParameter, Unit("kg m")] = Field(
        0.0, description="rho I (kg m), a number or a parameter's name; above 0 in a flexible body"
    )


class Coefficients3d(_Given):
    """The cross-section of a beam in space, given by its stiffness and inertia; its axes are those of `orientation`."""

    elements = ("beam3d",)
    shape: Literal["coefficients3d"]
    axial: Annotated[PositiveOrParameter, Unit("N")] = Field(description="EA (N), a number or a parameter's name")
    shear_2: Annotated[PositiveOrParameter, Unit("N")] = Field(description="GA_2 (N): shear along the second axis")
    shear_3: Annotated[PositiveOrParameter, Unit("N")] = Field(description="GA_3 (N): shear along the third axis")
    torsion: Annotated[PositiveOrParameter, Unit("N m2")] = Field(description="GJ (N m2)")
    bending_2: Annotated[PositiveOrParameter, Unit("N m2")] = Field(
        description="EI_2 (N m2): bending about the second axis"
    )
    bending_3: Annotated[PositiveOrParameter, Unit("N m2")] = Field(
        description="EI_3 (N m2): bending about the third axis"
    )
    line_density: Annotated[PositiveOrParameter, Unit("kg/m")] = Field(description="rho A (kg/m)")
    rotary_2: Annotated[PositiveOrParameter, Unit("kg m")] = Field(description="rho I_2 (kg m)")
    rotary_3: Annotated[PositiveOrParameter, Unit("kg m")] = Field(description="rho I_3 (kg m)")
