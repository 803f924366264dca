"""Consistent units: those of SI, in which everything is computed, of mm, t and s, and others that programs are fed
with.

A scene that says its units is converted where it is read (`scene.units`), and what is shown and written is converted
back (`UnitSystem.text`, `declare.records`); nothing between knows of them. A scene that says none is computed with its
numbers as they are.

Numbers may be texts with their unit: ``"500 mm"``. All scenes hold is made of kilogram, metre and second; an angle
counts as a number. pint knows the units that people use and how many of the SI unit each is. Factors that are whole
numbers, or one over these, are exact: 5.6 mm are the 5.6e-3 of SI units.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np

from pgmp_petsc.base.errors import nearest_name

#: Exponents of kilogram, metre and second; an angle counts as a number.
Dimension = tuple[float, float, float]
Units = Mapping[str, str]  # by names of outputs or parameters
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
    def is_si(self) -> bool:
        """Whether they are as large as those of SI, whatever they are called."""
        return self.length == self.mass == self.time == 1.0

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

    def size_of(self, unit: str) -> float:
        """Return how many of the SI unit one is here of what a unit measures: of these, or of SI."""
        return 1.0 if self.is_si else self.size(dimension_of(unit))

    def power_of(self, unit: str) -> int:
        """Return by which power of ten numbers of what a unit measures are larger in these units than in those of
        SI."""
        return -round(math.log10(self.size_of(unit)))

    def shown(self, value: Any, si: str) -> Any:
        """Return a number, through decimals, or an array of an SI unit in these units."""
        if self.is_si:
            return value
        return times(value, 1.0 / self.size_of(si)) if np.ndim(value) == 0 else value / self.size_of(si)

    def named(self, value: Any, si: str) -> tuple[Any, str]:
        """Return a number or an array of an SI unit in these units, and the unit."""
        return self.shown(value, si), self.unit(si)

    def converting(self, value: Any, unit: str) -> Any:
        """Return a number or an array of an SI unit in these units, or without one the unit."""
        return self.unit(unit) if value is None else self.shown(value, unit)

    def text(self, value: float, si: str, form: str = ".3g") -> str:
        """Return a number of an SI unit in these units, with the unit: ``12.5 mm``."""
        return f"{self.shown(value, si):{form}} {self.unit(si)}"

    def unit(self, si: str) -> str:
        """Return what numbers are in here that would be in an SI unit, ``mm`` for ``m``, ``t/mm3`` for ``kg/m3``."""
        names = {"m": self.names[0], "kg": self.names[1], "s": self.names[2], "N": self.force, "Pa": self.pressure}
        names["J"] = self.energy or f"{self.force} {self.names[0]}"
        names["W"] = "W" if self.energy == "J" else f"{names['J']}/{self.names[2]}"
        if "/" in names["kg"] and si != "kg":
            names["kg"] = f"({names['kg']})"  # of lbf s2/in, which is a quotient itself
        return _WORD.sub(lambda word: names.get(word[0], word[0]), si)

    def __str__(self) -> str:
        return "{}, {} and {}".format(*self.names)


_WORD = re.compile(r"(?<![A-Za-z])(m|kg|s|N|Pa|J|W)(?![A-Za-z])")
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
    UnitSystem(("in", "lbf s2/in", "s"), 0.0254, 4.4482216152605 / 0.0254, 1.0, "lbf", "psi"),
    UnitSystem(("um", "kg", "s"), 1e-6, 1.0, 1.0, "uN", "MPa"),
)
#: Units of lengths.
LENGTHS = frozenset(system.names[0] for system in (SI, *OTHERS))
WAVE_SPEEDS = (100.0, 20_000.0)  # m/s, of longitudinal waves: 50 in rubber, 1,300 in lead, 12,000 in diamond
DENSITIES = (10.0, 25_000.0)  # kg/m3: foams to osmium
#: Density and modulus of steel, aluminium, titanium, copper, magnesium, tungsten, a ceramic, concrete, wood, fibres
#: in carbon and in glass, nylon, polyethylene, rubber and foam.
MATERIALS = (
    (7850.0, 210e9), (2700.0, 70e9), (4430.0, 114e9), (8700.0, 115e9), (1770.0, 45e9), (19300.0, 400e9),
    (3900.0, 380e9), (2400.0, 30e9), (600.0, 12e9), (1600.0, 130e9), (1900.0, 40e9), (1150.0, 2.5e9),
    (950.0, 1e9), (1100.0, 5e6), (50.0, 1e7),
)  # fmt: skip
FAR = 1.0  # sum of the logarithms of both ratios
DENSITY, STRESS = (1, -3, 0), (1, -1, -2)  # exponents of kg, m and s


def exists(density: float, modulus: float, system: UnitSystem = SI) -> bool:
    """Whether there is a material of a density and a modulus in the units of a system."""
    density, modulus = density * system.size(DENSITY), modulus * system.size(STRESS)
    has_density = DENSITIES[0] <= density <= DENSITIES[1]
    return has_density and WAVE_SPEEDS[0] <= math.sqrt(modulus / density) <= WAVE_SPEEDS[1]


def system_of(materials: Sequence[tuple[float, float]]) -> UnitSystem | None:
    """Return SI where all materials, by density and modulus, exist in it, else the system in which they are nearest to
    common ones; None where they are near to none in any."""
    if all(exists(*material) for material in materials):
        return SI
    apart = {one: max(_apart(*material, one) for material in materials) for one in OTHERS}
    nearest = min(OTHERS, key=apart.__getitem__)
    return nearest if apart[nearest] < FAR else None


def _apart(density: float, modulus: float, system: UnitSystem) -> float:
    """Return how far a material is from the nearest common one, by the logarithms of both numbers."""
    density, modulus = density * system.size(DENSITY), modulus * system.size(STRESS)
    return min(abs(math.log(density / rho)) + abs(math.log(modulus / e)) for rho, e in MATERIALS)


#: Of what the names of SI units are made.
_MADE_OF: dict[str, Dimension] = {
    "1": (0, 0, 0), "rad": (0, 0, 0), "kg": (1, 0, 0), "m": (0, 1, 0), "s": (0, 0, 1), "N": (1, 1, -2), "W": (1, 2, -3),
    "Pa": (1, -1, -2),
}  # fmt: skip


def _dimension(si: str) -> Dimension:
    """Return the dimension of an SI unit as it is written, such as ``N m/(rad s)``."""
    found = (0, 0, 0)
    for part, sign in zip(si.split("/"), (1, -1)):
        for name, power in re.findall(r"([A-Za-z]+|1)(\d?)", part):
            found = tuple(n + sign * int(power or 1) * own for n, own in zip(found, _MADE_OF[name]))
    return found


#: SI units of what scenes hold, which are taken without a library, as those of other systems are.
UNITS: dict[str, Dimension] = {
    unit: _dimension(unit)
    for unit in (
        "1", "rad", "kg", "m", "s", "m/s", "m/s2", "rad/s", "s/rad", "s/m", "1/m", "1/s", "N", "N m", "N m2", "N/m",
        "N s/m", "N m/rad", "N m s", "N m s/rad", "N m/(rad s)", "N/(m s)", "W", "Pa", "N/m2", "kg/m", "kg m", "kg m2",
        "kg/m3",
    )
}  # fmt: skip
ANGULAR = ("rad", "deg", "\N{DEGREE SIGN}", "rpm", "rev", "turn", "gon", "arcmin", "arcsec")  # in units with angles
BASE = ("[mass]", "[length]", "[time]")
LONGEST = 40  # characters of a unit
ROUNDING = 1e-14  # by which a factor of pint may miss a whole number, and a number that is converted twice itself
#: Units to propose for one that is not known, beside those of systems.
COMMON = ("ft", "lb", "MN", "bar", "g/cm3", "kg/dm3", "t/m3", "deg", "rpm", "percent")
NEEDED = 'a unit such as "m", "mm", "GPa", "kg/m3" or "N m/rad" is needed, or none for those of the scene'
HERTZ = "Hz"  # of frequencies, in turns a second where SI counts radians
#: What quantities of a dimension are called.
NAMES: dict[Dimension, str] = {
    (0, 0, 0): "a number or an angle",
    (1, 0, 0): "a mass",
    (0, 1, 0): "a length",
    (0, 0, 1): "a time",
    (0, 2, 0): "an area",
    (0, 3, 0): "a volume",
    (0, 1, -1): "a speed",
    (0, 1, -2): "an acceleration",
    (0, 0, -1): "a frequency or an angular speed",
    (1, 1, -2): "a force",
    (1, 2, -2): "a torque or a rotary stiffness",
    (1, 3, -2): "a bending stiffness",
    (1, 2, -3): "a power",
    (1, 0, -2): "a stiffness",
    (1, 0, -1): "a damping coefficient",
    (1, 2, -1): "a rotary damping coefficient",
    (1, -1, -2): "a stress",
    (1, -1, 0): "a mass by length",
    (1, 1, 0): "a rotary inertia by length",
    (1, 2, 0): "a moment of inertia",
    (1, -3, 0): "a density",
}
#: A text that begins as a number does, which no name does: the number, and the unit behind it.
QUANTITY = r"^\s*([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)(.*)$"


class UnknownUnit(ValueError):
    """A text that is no unit; says what is allowed."""


def measure(unit: str) -> tuple[float, Dimension]:
    """Return how many of the SI unit one of `unit` is, and its dimension; no unit is 1. Raises `UnknownUnit` if it is
    not one, or of something that scenes do not hold, such as a temperature."""
    known = plain_names().get(plain(unit)) or names_in_others().get(unit)
    if known is not None:
        return known
    if len(unit) > LONGEST or not re.fullmatch(r"[\w \N{DEGREE SIGN}%*/^().\N{MIDDLE DOT}-]*", unit):
        raise UnknownUnit(NEEDED)
    text = unit.replace("\N{MIDDLE DOT}", "*").replace("^", "**").replace("\N{DEGREE SIGN}", "deg")
    # newton metres as engineers write them, and exponents without a sign: kNm/rad, kg/m3
    text = re.sub(r"\b([kM]?N)(mm|cm|m)(s?)\b", lambda found: " ".join(filter(None, found.groups())), text)
    text = re.sub(r"([A-Za-z])([0-9])", r"\1**\2", text)
    if re.search(r"(?<![.\d])\d{2}|[\d)]\s*\*\*", text):  # powers of powers, which would be worked out
        raise UnknownUnit(NEEDED)
    registry = _registry()
    try:
        quantity = registry.Quantity(1.0, registry.parse_units(text)).to_base_units()
        dimension = dict(quantity.dimensionality)
        factor = float(quantity.magnitude)
    except Exception as error:  # of many kinds, also of Python's own parser
        hint = nearest_name(unit, (*UNITS, *names_in_others(), *COMMON))
        raise UnknownUnit(f"no such unit{hint if 'did you mean' in hint else ''}; {NEEDED}") from error
    strange = [name for name in dimension if name not in BASE]
    if strange or not (math.isfinite(factor) and factor > 0.0):
        raise UnknownUnit(f"made from {', '.join(strange) or 'no'} units, which scenes have no use for; {NEEDED}")
    return factor, tuple(dimension.get(name, 0) for name in BASE)


@cache
def dimension_of(unit: str) -> Dimension:
    """Return the dimension of a unit, also of the `inverse` of a long one. Raises `UnknownUnit`."""
    below = re.fullmatch(r"1/\(([^()]*)\)", unit)
    return tuple(-power for power in dimension_of(below[1])) if below else measure(unit)[1]


def behind(unit: str) -> str:
    """Return a unit as written behind a number; nothing where there is none."""
    return "" if unit in ("", "1") else f" {unit}"


def inverse(unit: str) -> str:
    """Return the unit of a density over what has a unit: ``1/(N m)``; ``1`` where there is none."""
    return "1" if unit in ("", "1") else f"1/({unit})" if re.search("[ /]", unit) else f"1/{unit}"


def si_name(dimension: Dimension) -> str:
    """Return the SI unit of a dimension."""
    known = next((unit for unit, own in UNITS.items() if tuple(own) == tuple(dimension) and "rad" not in unit), None)
    above, below = ([(n, abs(p)) for n, p in zip(("kg", "m", "s"), dimension) if sign * p > 0] for sign in (1, -1))
    over, under = (" ".join(f"{n}{'' if p == 1 else f'{p:g}'}" for n, p in part) for part in (above, below))
    under = f"({under})" if " " in under else under
    return known or (f"{over or 1}/{under}" if under else over)


def take_unit(unit: str) -> None:
    """Take a unit that an effect declares, such as N/m3, among those of scenes; raises `UnknownUnit` if it is none of
    SI."""
    if unit not in UNITS:
        factor, dimension = measure(unit)
        if abs(factor - 1.0) > ROUNDING:
            raise UnknownUnit(f"it is {factor:g} SI units")
        UNITS[unit] = dimension
        plain_names.cache_clear()


def named(dimension: Dimension) -> str:
    """Return what quantities of a dimension are called: ``a length``."""
    return NAMES.get(dimension) or f"a quantity in {in_powers(dimension)}"


def in_powers(dimension: Dimension) -> str:
    """Return a dimension in kg, m and s: ``kg^1 m^2 s^-2``; empty of a number."""
    return " ".join(f"{unit}^{power:g}" for unit, power in zip(("kg", "m", "s"), dimension) if power)


def number_of(text: str, units: Sequence[str], system: UnitSystem) -> float | None:
    """Return a number that is given with its unit, ``"500 mm"``, in the units of a system; None of a text that is none.
    Raises `UnknownUnit` if it is none of the dimensions of some SI units, of which none allows all."""
    found = re.match(QUANTITY, text)
    if found is None:
        return None
    value, unit = float(found[1]), found[2].strip()
    if not unit:
        raise UnknownUnit('a number in quotes has its unit behind it, such as "500 mm"; leave the quotes out otherwise')
    factor, dimension = measure(unit)
    wanted = {UNITS["1/s"] if one == HERTZ else dimension_of(one): one for one in units}
    if wanted and dimension not in wanted:
        kinds = " or ".join(f"{named(one)} ({system.unit(label)})" for one, label in wanted.items())
        raise UnknownUnit(f"'{unit}' is the unit of {named(dimension)}; needed is {kinds}")
    if dimension == UNITS["1/s"]:
        if has_angles(unit) and HERTZ in units:
            factor /= 2.0 * math.pi
        elif is_hertz(unit) and "rad/s" in units:
            raise UnknownUnit(IN_TURNS)
    return times(value, factor / system.size(dimension))


IN_TURNS = "'Hz' counts turns, and an angular speed is needed: give it in rad/s, deg/s or rpm"


def has_angles(unit: str) -> bool:
    """Return whether there is an angle in a unit: ``rpm``, ``N m/rad``."""
    return any(one in plain(unit) for one in ANGULAR)


def is_hertz(unit: str) -> bool:
    """Whether a unit counts turns a second."""
    return re.search(r"hertz|hz", unit, re.IGNORECASE) is not None


def times(value: Any, factor: float) -> Any:
    """Return a number, or all of an array, times the factor, so that 5.6 mm are the 5.6e-3 of SI units."""
    if factor == 1.0:
        return value
    if isinstance(value, np.ndarray):
        return np.array([times(x, factor) for x in value.flat], dtype=float).reshape(value.shape)
    exact = Decimal(repr(float(value)))  # in decimals, in which the factors of most units are exact
    inverse = round(1.0 / factor)
    if inverse > 0 and abs(inverse * factor - 1.0) < ROUNDING:
        return float(exact / inverse)
    return float(exact * (round(factor) if abs(round(factor) / factor - 1.0) < ROUNDING else Decimal(factor)))


def plain(unit: str) -> str:
    """Return a unit without the signs of products and powers."""
    return re.sub(r"[ *^\N{MIDDLE DOT}]", "", unit)


@cache
def plain_names() -> dict[str, tuple[float, Dimension]]:
    """Return what `measure` finds of SI units, by their `plain` names."""
    return {plain(name): (1.0, dimension) for name, dimension in ({"": (0, 0, 0), "-": (0, 0, 0)} | UNITS).items()}


@cache
def names_in_others() -> dict[str, tuple[float, Dimension]]:
    """Return what `measure` finds of units of the other systems, as these write them: in "m s" the blank counts."""
    return {one.unit(name): (one.size(own), own) for one in OTHERS for name, own in UNITS.items()}


#: The units that pint knows, read in a third of a second, for which few scenes wait.
_registry = cache(lambda: import_module("pint").UnitRegistry())
