"""In which consistent units a scene is written: those in which all of its materials are ones that exist.

Scenes are in SI units, and all equations hold in any other consistent ones too. What has a size of its own does not:
the acceleration of gravity that is not said, and what is judged in m/s.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.bodies import Material
from pgmp_petsc.scene.effects import Gravity
from pgmp_petsc.studies.plausibility.finding import Finding, doubt, refusal

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
    """Consistent units: how many m, kg and s one of length, mass and time is, and their names."""

    names: tuple[str, str, str]
    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0

    @property
    def gravity(self) -> float:
        """The Earth's acceleration in these units."""
        return STANDARD_GRAVITY * self.time**2 / self.length

    @property
    def speed(self) -> float:
        """How many m/s one unit of speed is."""
        return self.length / self.time

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
    UnitSystem(("mm", "t", "s"), 1e-3, 1e3),
    UnitSystem(("mm", "kg", "ms"), 1e-3, 1.0, 1e-3),
    UnitSystem(("mm", "kg", "s"), 1e-3),
    UnitSystem(("mm", "g", "ms"), 1e-3, 1e-3, 1e-3),
    UnitSystem(("mm", "g", "s"), 1e-3, 1e-3),
    UnitSystem(("cm", "g", "s"), 1e-2, 1e-3),
    UnitSystem(("cm", "kg", "s"), 1e-2),
    UnitSystem(("m", "t", "s"), 1.0, 1e3),
    UnitSystem(("in", "lbf s2/in", "s"), 0.0254, 175.126835),
    UnitSystem(("um", "kg", "s"), 1e-6),
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


def system_findings(scene: Scene, system: UnitSystem | None) -> Iterator[Finding]:
    """Yield what is wrong with a scene that is not in SI units: gravity that is not said, units of parameters."""
    if system in (None, SI):
        return
    name, material = next(iter(scene.materials.items()))
    shown = f"{name} has rho = {scene.number(material.rho):g} and E = {scene.number(material.E):g}"
    missing = [
        name
        for name, effect in scene.effects.items()
        if isinstance(effect, Gravity) and "acceleration" not in effect.model_fields_set
    ]
    for effect in missing if system.gravity != STANDARD_GRAVITY else ():
        yield refusal(
            f"effects.{effect}.acceleration",
            f"missing, and 9.81 m/s2 does not fit: the materials are in {system} ({shown}); say acceleration = "
            f"{system.gravity:g} ({system.names[0]}/{system.names[2]}2), or give materials and lengths in SI units",
        )
    yield doubt(
        "materials",
        f"they are in {system} ({shown}), and all numbers are computed with as they are; where messages, pages and "
        f"files say m, kg and s, read {system}; SI units make them right",
    )
    for name, parameter in scene.parameters.items():
        if parameter.unit not in ("", "-", "1", "rad"):
            yield doubt(
                f"parameters.{name}.unit",
                f"numbers with a unit are converted to SI, but the materials are in {system}; leave the unit out and "
                "give the number in these",
                parameter.unit,
            )
