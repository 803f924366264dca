"""Sectional stiffness and inertia of beams, affine in the parameters.

In the plane a section bends about its third axis; in space (y_2 along the second axis)

    E A, k_2 G A, k_3 G A, G J, E I_2, E I_3;    rho A, rho I_2, rho I_3;    I_2 = int y_3^2 dA,  I_3 = int y_2^2 dA.

A section is given by its shape (`ShapedSection`), or by these coefficients themselves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import Field

from pgmp_petsc.bodies.affine import AffineSum, Monomial, Quantity
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.bodies import SectionEntry, Spans
from pgmp_petsc.scene.fields import NotNegativeOrParameter, PositiveOrParameter, Unit
from pgmp_petsc.scene.parameters import outermost_values

RARE = 1e-6  # share of samples beyond values that sections are made for


@dataclass(frozen=True)
class BeamSection:
    """Coefficients of beams."""

    stiffness: tuple[AffineSum, ...]  # (EA, k_s GA, EI), in space (EA, GA_2, GA_3, GJ, EI_2, EI_3), N and N m^2
    mass: tuple[AffineSum, ...]  # (rho A, rho I), in space (rho A, rho I_2, rho I_3), kg/m and kg m

    @classmethod
    def of(cls, scene: Scene, body: str) -> BeamSection:
        """Return the coefficients of a body of beams of a scene."""
        entry = scene.bodies[body]
        material = None if entry.material is None else scene.materials[entry.material]
        spans = partial(outermost_values, scene, RARE)
        with entry.section.blamed():
            found = entry.section.coefficients(entry.dimension, material, scene.nominal, spans)
            parts = (*found.stiffness, *found.mass)
            if not all(isinstance(part, AffineSum) for part in parts):
                raise TypeError("its area, inertia and the others are AffineSum, such as AffineSum.of(self.radius)")
            if min(float(part.at(scene.nominal)) for part in parts) < 0.0:
                raise ValueError("its area, inertia, or another of its coefficients is negative")
            reach = entry.section.reach
            fibres = isinstance(reach, tuple) and [isinstance(part, (Quantity, AffineSum)) for part in reach]
            if reach is not None and fibres != [True, True]:
                raise TypeError("its reach is two quantities, such as Quantity.of(self.radius), or None")
            return found

    @property
    def axial(self) -> AffineSum:
        """E A, N."""
        return self.stiffness[0]

    @property
    def bending(self) -> tuple[AffineSum, ...]:
        """E I, in space E I_2 and E I_3, N m^2."""
        return self.stiffness[4:] if len(self.stiffness) == 6 else self.stiffness[2:]

    def lever(self, nominal: Mapping[str, float]) -> float:
        """Return ``(I_3 - I_2) / (I_2 + I_3)`` of a section in space at nominal values: how unlike both are."""
        about_2, about_3 = (float(part.at(nominal)) for part in self.mass[1:])
        return (about_3 - about_2) / (about_2 + about_3)

    def terms(self, kind: str) -> dict[Monomial, tuple[float, ...]]:
        """Return the coefficients of ``"mass"`` or ``"stiffness"`` by monomial, zeros where one has it not."""
        sums = [dict(part.terms) for part in getattr(self, kind)]
        return {
            monomial: tuple(part.get(monomial, 0.0) for part in sums)
            for monomial in dict.fromkeys([monomial for part in sums for monomial in part])
        }


class ShapedSection(SectionEntry):
    """A section of a material, by its shape."""

    def area(self) -> AffineSum:
        """Return the area, m^2."""
        raise NotImplementedError

    def inertia(self) -> tuple[AffineSum, AffineSum]:
        """Return I_2 and I_3, m^4."""
        raise NotImplementedError

    def sheared(self, nu: float, nominal: Mapping[str, float], spans: Spans) -> tuple[AffineSum, AffineSum]:
        """Return k_2 A and k_3 A, m^2."""
        raise NotImplementedError

    def torsion(self, nominal: Mapping[str, float], spans: Spans) -> AffineSum:
        """Return the torsion constant J, m^4."""
        raise NotImplementedError

    def coefficients(self, dimension: int, material: Any, nominal: Mapping[str, float], spans: Spans) -> BeamSection:
        """Derive the coefficients from the shape; see `SectionEntry.coefficients`."""
        young, density = Quantity.of(material.E), Quantity.of(material.rho)
        half_shear, area, inertia = young * (0.5 / (1.0 + material.nu)), self.area(), self.inertia()
        sheared = self.sheared(material.nu, nominal, spans)
        for name, pair in (("inertia", inertia), ("sheared", sheared)):
            if not isinstance(pair, tuple) or len(pair) != 2:
                raise TypeError(f"{name} returns two AffineSum, of the second and of the third axis")
        if dimension == 2:
            return BeamSection(
                (area * young, sheared[0] * half_shear, inertia[1] * young), (area * density, inertia[1] * density)
            )
        stiffness = area, *sheared, self.torsion(nominal, spans), *inertia
        moduli = young, half_shear, half_shear, half_shear, young, young
        return BeamSection(
            tuple(part * modulus for part, modulus in zip(stiffness, moduli)),
            tuple(part * density for part in (area, *inertia)),
        )


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
    axial: Annotated[PositiveOrParameter, Unit("N")] = Field(description="EA (N)")
    shear: Annotated[PositiveOrParameter, Unit("N")] = Field(description="k_s GA (N)")
    bending: Annotated[PositiveOrParameter, Unit("N m2")] = Field(description="EI (N m2)")
    line_density: Annotated[PositiveOrParameter, Unit("kg/m")] = Field(description="rho A (kg/m)")
    rotary_density: Annotated[NotNegativeOrParameter, Unit("kg m")] = Field(
        0.0, description="rho I (kg m); above 0 in a flexible body"
    )


class Coefficients3d(_Given):
    """The cross-section of a beam in space, given by its stiffness and inertia; its axes are those of `orientation`."""

    elements = ("beam3d",)
    shape: Literal["coefficients3d"]
    axial: Annotated[PositiveOrParameter, Unit("N")] = Field(description="EA (N)")
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
