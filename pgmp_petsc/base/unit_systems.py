"""Consistent units: those of SI, of mm, t and s, and others that programs are fed with.

All equations hold in any consistent units, so that the numbers of a scene are computed with as they are, and everything
is in its units. What has a size of its own asks for them: the acceleration of gravity that is not said, what is judged
in m/s or kg/m3, and whoever names a unit.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

#: Exponents of kilogram, metre and second; an angle counts as a number.
Dimension = tuple[float, float, float]
STANDARD_GRAVITY = 9.80665  # m/s2, exact by definition (BIPM, The International System of Units)


@dataclass(frozen=True)
class UnitSystem:
    """Consistent units: how many m, kg and s one of length, mass and time is; names of these, of force, pressure
    and energy."""

    names: tuple[str, str, str]
    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0
    force: str = "N"
    pressure: str = "Pa"
    energy: str = ""  # where it has a name of its own

    @property
    def gravity(self) -> float:
        """The Earth's acceleration in these units."""
        return STANDARD_GRAVITY * self.time**2 / self.length

    @property
    def speed(self) -> float:
        """How many m/s one unit of speed is."""
        return self.length / self.time

    def size(self, dimension: Dimension) -> float:
        """Return how many of the SI unit one of a dimension is."""
        return self.mass ** dimension[0] * self.length ** dimension[1] * self.time ** dimension[2]

    def unit(self, si: str) -> str:
        """Return what numbers are in here that would be in an SI unit, ``mm`` for ``m``, ``t/mm3`` for ``kg/m3``."""
        names = {"m": self.names[0], "kg": self.names[1], "s": self.names[2], "N": self.force, "Pa": self.pressure}
        names["J"] = self.energy or f"{self.force} {self.names[0]}"
        return _WORD.sub(lambda word: names.get(word[0], word[0]), si)

    def __str__(self) -> str:
        return "{}, {} and {}".format(*self.names)


_WORD = re.compile(r"(?<![A-Za-z])(m|kg|s|N|Pa|J)(?![A-Za-z])")
SI = UnitSystem(("m", "kg", "s"), energy="J")
MM = UnitSystem(("mm", "t", "s"), 1e-3, 1e3, 1.0, "N", "MPa", "mJ")
#: Those that a scene may say.
SAID = {"SI": SI, "mm": MM}
#: Others that programs are fed with.
OTHERS = (
    MM,
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
#: Units of lengths.
LENGTHS = frozenset(system.names[0] for system in (SI, *OTHERS))
