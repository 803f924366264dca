"""In which consistent units a scene is: those that it says, or those in which its materials are ones that exist."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pgmp_petsc.base.unit_systems import OTHERS, SAID, SI, UnitSystem

if TYPE_CHECKING:
    from pgmp_petsc.scene.bodies import Material
    from pgmp_petsc.scene.schema import Scene

WAVE_SPEEDS = (100.0, 20_000.0)  # m/s, of longitudinal waves: 50 in rubber, 1,300 in lead, 12,000 in diamond
DENSITIES = (10.0, 25_000.0)  # kg/m3: foams to osmium
#: Density and modulus of steel, aluminium, titanium, copper, magnesium, tungsten, a ceramic, concrete, wood, fibres
#: in carbon and in glass, nylon, polyethylene, rubber and foam.
COMMON = (
    (7850.0, 210e9), (2700.0, 70e9), (4430.0, 114e9), (8700.0, 115e9), (1770.0, 45e9), (19300.0, 400e9),
    (3900.0, 380e9), (2400.0, 30e9), (600.0, 12e9), (1600.0, 130e9), (1900.0, 40e9), (1150.0, 2.5e9),
    (950.0, 1e9), (1100.0, 5e6), (50.0, 1e7),
)  # fmt: skip
FAR = 1.0  # sum of the logarithms of both ratios
DENSITY, STRESS = (1, -3, 0), (1, -1, -2)  # exponents of kg, m and s


def in_si(scene: Scene, material: Material, system: UnitSystem) -> tuple[float, float]:
    """Return the density, kg/m3, and the modulus, Pa, of a material whose numbers are in the units of a system."""
    density, modulus = scene.number(material.rho), scene.number(material.E)
    return density * system.size(DENSITY), modulus * system.size(STRESS)


def exists(density: float, modulus: float) -> bool:
    """Whether there is a material of a density (kg/m3) and a modulus (Pa)."""
    has_density = DENSITIES[0] <= density <= DENSITIES[1]
    return has_density and WAVE_SPEEDS[0] <= math.sqrt(modulus / density) <= WAVE_SPEEDS[1]


def unit_system(scene: Scene) -> UnitSystem:
    """Return the units of a scene: those that it says, or else those that its materials are in; SI if these are none.

    See `material_units`."""
    return SAID[scene.scene.units] if scene.scene.units else material_units(scene) or SI


def material_units(scene: Scene) -> UnitSystem | None:
    """Return SI where all materials of bodies exist in it, else the system in which they are nearest to common ones;
    None where they are near to none in any. Materials that name no parameter there is tell nothing."""
    used = {material for body in scene.bodies.values() for material in (body.material, *body.regions.values())}
    materials = [
        material
        for name, material in scene.materials.items()
        if name in used and all(not isinstance(one, str) or one in scene.values for one in (material.rho, material.E))
    ]
    if all(exists(*in_si(scene, material, SI)) for material in materials):
        return SI
    apart = {one: max(_apart(*in_si(scene, material, one)) for material in materials) for one in OTHERS}
    nearest = min(OTHERS, key=apart.__getitem__)
    return nearest if apart[nearest] < FAR else None


def _apart(density: float, modulus: float) -> float:
    """Return how far a material is from the nearest common one, by the logarithms of both numbers."""
    return min(abs(math.log(density / rho)) + abs(math.log(modulus / e)) for rho, e in COMMON)
