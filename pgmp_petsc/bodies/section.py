"""Sectional stiffness and inertia of planar beams as affine quantities.

Circle of radius r: ``A = pi r^2``, ``I = pi r^4 / 4``, shear factor ``6 (1 + nu) / (7 + 6 nu)``; rectangle of
width b and height h (h in the plane of motion): ``A = b h``, ``I = b h^3 / 12``, shear factor
``10 (1 + nu) / (12 + 11 nu)`` (Cowper 1966).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from pgmp_petsc.bodies.affine import Monomial, Quantity
from pgmp_petsc.scene.bodies import Circle, Coefficients, Material, Rectangle


@dataclass(frozen=True)
class BeamSection:
    """Coefficients of a planar beam, each a constant times a monomial of the parameters."""

    axial: Quantity  # E A, N
    shear: Quantity  # k_s G A, N
    bending: Quantity  # E I, N m^2
    line_density: Quantity  # rho A, kg/m
    rotary_density: Quantity  # rho I, kg m

    @classmethod
    def of(cls, section: Circle | Rectangle | Coefficients, material: Material | None) -> BeamSection:
        """Derive the coefficients from a scene's section and material; a section given by coefficients has none."""
        if isinstance(section, Coefficients):
            entries = (section.axial, section.shear, section.bending, section.line_density, section.rotary_density)
            return cls(*map(Quantity.of, entries))
        nu = material.nu
        if isinstance(section, Circle):
            radius = Quantity.of(section.radius)
            area, inertia = math.pi * radius**2, math.pi / 4 * radius**4
            shear_factor = 6 * (1 + nu) / (7 + 6 * nu)
        else:
            width, height = Quantity.of(section.width), Quantity.of(section.height)
            area, inertia = width * height, width * height**3 * (1 / 12)
            shear_factor = 10 * (1 + nu) / (12 + 11 * nu)
        young, density = Quantity.of(material.E), Quantity.of(material.rho)
        return cls(
            axial=young * area,
            shear=young * area * (shear_factor / (2 * (1 + nu))),
            bending=young * inertia,
            line_density=density * area,
            rotary_density=density * inertia,
        )

    def stiffness_terms(self) -> dict[Monomial, tuple[float, float, float]]:
        """Return (EA, k_s GA, EI) coefficients by monomial."""
        return _by_monomial((self.axial, self.shear, self.bending))

    def mass_terms(self) -> dict[Monomial, tuple[float, float]]:
        """Return (rho A, rho I) coefficients by monomial."""
        return _by_monomial((self.line_density, self.rotary_density))


def _by_monomial(quantities: tuple[Quantity, ...]) -> dict[Monomial, tuple[float, ...]]:
    """Group quantities by monomial, with zeros where a quantity has another one."""
    monomials = dict.fromkeys(quantity.monomial for quantity in quantities)
    return {m: tuple(q.coefficient if q.monomial == m else 0.0 for q in quantities) for m in monomials}
