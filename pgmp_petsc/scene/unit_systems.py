"""In which consistent units a scene is written: those in which all of its materials are ones that exist.

Scenes are in SI units, and all equations hold in any other consistent ones too. What has a size of its own does not:
the acceleration of gravity that is not said, and what is judged in m/s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pgmp_petsc.scene.bodies import Material

if TYPE_CHECKING:
    from pgmp_petsc.scene.schema import Scene

WAVE_SPEEDS = (100.0, 20_000.0)  # m/s, of longitudinal waves: 50 in rubber, 1,300 in lead, 12,000 in diamond
DENSITIES = (10.0, 25_000.0)  # kg/m3: foams to osmium
STANDARD_GRAVITY = 9.81  # m/s2
#: Density and modulus of steel, aluminium, titanium, copper, magnesium, tungsten, a ceramic, concrete, wood, fibres
#: in carbon and in glass, nylon, polyethylene, rubber and foam.
COMMON = (
    (7850.0, 210e9), (2700.0, 70e9), (4430.0, 114e9), (8700.0, 115e9), (1770.0, 45e9), (19300.0, 400e9),
    (3900.0, 380e9), (2400.0, 30e9), (600.0, 12e9), (1600.0, 130e9), (1900.0, 40e9), (1150.0, 2.5e9),
    (950.0, 1e9), (1100.0, 5e6), (50.0, 1e7),
)  # fmt: skip
FAR = 1.0  # sum of the logarithms of both ratios


@dataclass(frozen=True)
class UnitSystem:
    """Consistent units: how many m, kg and s one of length, mass and time is; names of these, of force and pressure."""

    names: tuple[str, str, str]
    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0
    force: str = "N"
    pressure: str = "Pa"

    @property
    def gravity(self) -> float:
        """The Earth's acceleration in these units."""
        return STANDARD_GRAVITY * self.time**2 / self.length

    @property
    def speed(self) -> float:
        """How many m/s one unit of speed is."""
        return self.length / self.time

    def unit(self, si: str) -> str:
        """Return what numbers are in here that would be in an SI unit, ``mm`` for ``m``."""
        names = {"m": self.names[0], "kg": self.names[1], "s": self.names[2], "N": self.force, "Pa": self.pressure}
        return "/".join(" ".join(names.get(word, word) for word in part.split(" ")) for part in si.split("/"))

    def in_si(self, scene: Scene, material: Material) -> tuple[float, float]:
        """Return the density, kg/m3, and the modulus, Pa, of a material whose numbers are in these units."""
        modulus = self.mass / (self.length * self.time**2)
        return scene.number(material.rho) * self.mass / self.length**3, scene.number(material.E) * modulus

    def has(self, scene: Scene, material: Material) -> bool:
        """Whether a material in these units is one that exists."""
        density, modulus = self.in_si(scene, material)
        exists = DENSITIES[0] <= density <= DENSITIES[1]
        return exists and WAVE_SPEEDS[0] <= math.sqrt(modulus / density) <= WAVE_SPEEDS[1]

    def __str__(self) -> str:
        return "{}, {} and {}".format(*self.names)


SI = UnitSystem(("m", "kg", "s"))
#: Others that programs are fed with.
OTHERS = (
    UnitSystem(("mm", "t", "s"), 1e-3, 1e3, 1.0, "N", "MPa"),
    UnitSystem(("mm", "kg", "ms"), 1e-3, 1.0, 1e-3, "kN", "GPa"),
    UnitSystem(("mm", "kg", "s"), 1e-3, 1.0, 1.0, "mN", "kPa"),
    UnitSystem(("mm", "g", "ms"), 1e-3, 1e-3, 1e-3, "N", "MPa"),
    UnitSystem(("mm", "g", "s"), 1e-3, 1e-3, 1.0, "uN", "Pa"),
    UnitSystem(("cm", "g", "s"), 1e-2, 1e-3, 1.0, "dyn", "dyn/cm2"),
    UnitSystem(("cm", "kg", "s"), 1e-2, 1.0, 1.0, "cN", "cN/cm2"),
    UnitSystem(("m", "t", "s"), 1.0, 1e3, 1.0, "kN", "kPa"),
    UnitSystem(("in", "lbf s2/in", "s"), 0.0254, 175.126835, 1.0, "lbf", "psi"),
    UnitSystem(("um", "kg", "s"), 1e-6, 1.0, 1.0, "uN", "MPa"),
)


def unit_system(scene: Scene) -> UnitSystem | None:
    """Return SI where all materials of bodies exist in it, else the system in which they are nearest to common ones;
    None where they are near to none in any."""
    used = {material for body in scene.bodies.values() for material in (body.material, *body.regions.values())}
    materials = [material for name, material in scene.materials.items() if name in used]
    if all(SI.has(scene, material) for material in materials):
        return SI
    apart = {one: max(_apart(*one.in_si(scene, material)) for material in materials) for one in OTHERS}
    nearest = min(OTHERS, key=apart.__getitem__)
    return nearest if apart[nearest] < FAR else None


def _apart(density: float, modulus: float) -> float:
    """Return how far a material is from the nearest common one, by the logarithms of both numbers."""
    return min(abs(math.log(density / rho)) + abs(math.log(modulus / e)) for rho, e in COMMON)
