"""Units of parameters: SI inside, any compatible unit in a scene's file.

What a parameter is follows from the entries that name it: a radius is a length, a Young's modulus a pressure. Its
`unit` says what its numbers are given in: nominal, value, bounds, and ``loc``, ``scale`` and ``values`` of its
distribution (shape parameters have no unit). They are converted before the scene is validated; ``--set`` is in SI units
whatever the unit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from decimal import Decimal
from functools import cache
from typing import TYPE_CHECKING, Any

from pgmp_petsc.base.errors import nearest_name
from pgmp_petsc.scene.fields import is_number
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.parameters import OWN
from pgmp_petsc.scene.uses import Use, uses_of

if TYPE_CHECKING:
    import pint

    from pgmp_petsc.scene.schema import Scene

#: Exponents of kilogram, metre and second; an angle counts as a number.
Dimension = tuple[float, float, float]

#: SI units of what scenes hold, which are taken without a library.
SI: dict[str, Dimension] = {
    "1": (0, 0, 0),
    "rad": (0, 0, 0),
    "kg": (1, 0, 0),
    "m": (0, 1, 0),
    "s": (0, 0, 1),
    "m/s": (0, 1, -1),
    "m/s2": (0, 1, -2),
    "rad/s": (0, 0, -1),
    "s/rad": (0, 0, 1),
    "s/m": (0, -1, 1),
    "N": (1, 1, -2),
    "N m": (1, 2, -2),
    "N m2": (1, 3, -2),
    "N/m": (1, 0, -2),
    "N s/m": (1, 0, -1),
    "N m/rad": (1, 2, -2),
    "N m s": (1, 2, -1),
    "N m s/rad": (1, 2, -1),
    "Pa": (1, -1, -2),
    "N/m2": (1, -1, -2),
    "kg/m": (1, -1, 0),
    "kg m": (1, 1, 0),
    "kg m2": (1, 2, 0),
    "kg/m3": (1, -3, 0),
}
ANGULAR = ("rad", "deg", "\N{DEGREE SIGN}", "rpm", "rev", "turn", "gon", "arcmin", "arcsec")  # in units with angles
BASE = ("[mass]", "[length]", "[time]")
LONGEST = 40  # characters of a unit
ROUNDING = 1e-14  # by which a factor of pint may miss a whole number
#: Units to propose for one that is not known.
COMMON = (
    *SI, "mm", "cm", "um", "in", "ft", "g", "t", "lb", "kN", "MN", "N mm", "kN m", "lbf", "kPa", "MPa", "GPa", "bar",
    "psi", "g/cm3", "kg/dm3", "t/m3", "deg", "rpm", "percent", "N/mm", "N/mm2", "N s/mm", "mm/s2", "kN/m",
)  # fmt: skip
NEEDED = 'a unit such as "m", "mm", "GPa", "kg/m3" or "N m/rad" is needed, or none for SI units'


class UnknownUnit(ValueError):
    """A text that is no unit; says what is allowed."""


def convert_parameters(data: dict[str, Any]) -> dict[str, str]:
    """Convert parameters given in other units than SI, in place on raw tables.

    Returns
    -------
    dict
        The unit that each converted parameter was given in. What is no number, or has an unknown unit, is left for the
        validation to refuse.
    """
    parameters = data.get("parameters")
    given: dict[str, str] = {}
    for name, parameter in parameters.items() if isinstance(parameters, dict) else ():
        unit = parameter.get("unit") if isinstance(parameter, dict) else None
        if not isinstance(unit, str):
            continue
        try:
            factor, dimension = measure(unit)
        except UnknownUnit:
            continue
        # the SI unit of a dimension, with angles where `unit` has them; None where scenes hold no such numbers
        fitting = [label for label, known in SI.items() if known == dimension]
        if len(fitting) > 1:
            angular = any(turn in _plain(unit) for turn in ANGULAR)
            fitting.sort(key=lambda label: ("rad" in label) != angular)
        label = next(iter(fitting), None)
        if label is not None and _plain(unit) not in _plain_names():
            given[name] = unit
            parameters[name] = _in_si(parameter, factor) | {"unit": label}
    return given


def unit_problems(scene: Scene, given: Mapping[str, str]) -> Iterator[str]:
    """Yield a line for each parameter whose unit is unknown or none of what uses it, or whose uses differ.

    Parameters
    ----------
    given : mapping of str to str
        Units as `convert_parameters` returned them.
    """
    uses: dict[str, list[Use]] = {name: [] for name in scene.parameters}
    for use in uses_of(scene):
        if use.parameter in uses and use.units:  # what is in a formula may have any
            uses[use.parameter].append(use)
    for name, parameter in scene.parameters.items():
        unit, allowed = given.get(name, parameter.unit), _allowed(uses[name])
        if uses[name] and not allowed:
            yield _contradiction(name, uses[name])
            continue
        entry = f"parameters.{name}.unit"
        try:
            _, dimension = measure(unit)
        except UnknownUnit as error:
            yield problem(entry, str(error), unit)
            continue
        if unit and allowed and dimension not in allowed:
            fitting = dict.fromkeys(label for use in uses[name] for label in use.units if SI[label] in allowed)
            named = " or ".join("1 (no unit)" if label == "1" else label for label in fitting)
            yield problem(
                entry, f"{uses[name][0].entry} uses it, which needs {named}, or what can be converted to it", unit
            )


def measure(unit: str) -> tuple[float, Dimension]:
    """Return how many of the SI unit one of `unit` is, and its dimension; no unit is 1.

    Raises `UnknownUnit` if it is not one, or of something that scenes do not hold, such as a temperature.
    """
    known = _plain_names().get(_plain(unit))
    if known is not None:
        return 1.0, known
    if len(unit) > LONGEST or not re.fullmatch(r"[\w \N{DEGREE SIGN}%*/^().\N{MIDDLE DOT}-]*", unit):
        raise UnknownUnit(NEEDED)
    text = unit.replace("\N{MIDDLE DOT}", "*").replace("^", "**").replace("\N{DEGREE SIGN}", "deg")
    # newton metres as engineers write them, and exponents without a sign: kNm/rad, kg/m3
    text = re.sub(r"\b([kM]?N)(mm|cm|m)(s?)\b", lambda found: " ".join(filter(None, found.groups())), text)
    text = re.sub(r"([A-Za-z])([0-9])", r"\1**\2", text)
    if re.search(r"\d{2}|[\d)]\s*\*\*", text):  # powers of powers, which would be worked out
        raise UnknownUnit(NEEDED)
    registry = _registry()
    try:
        quantity = registry.Quantity(1.0, registry.parse_units(text)).to_base_units()
        dimension = dict(quantity.dimensionality)
        factor = float(quantity.magnitude)
    except Exception as error:  # of many kinds, also of Python's own parser
        raise UnknownUnit(f"no such unit{_nearest(unit)}; {NEEDED}") from error
    strange = [name for name in dimension if name not in BASE]
    if strange or not (math.isfinite(factor) and factor > 0.0):
        raise UnknownUnit(f"made from {', '.join(strange) or 'no'} units, which scenes have no use for; {NEEDED}")
    return factor, tuple(dimension.get(name, 0) for name in BASE)


def take_unit(unit: str) -> None:
    """Take a unit that an effect declares, such as N/m3, among those of scenes.

    Raises `UnknownUnit` if it is none of SI.
    """
    if unit not in SI:
        factor, dimension = measure(unit)
        if abs(factor - 1.0) > ROUNDING:
            raise UnknownUnit(f"it is {factor:g} SI units")
        SI[unit] = dimension
        _plain_names.cache_clear()


def _allowed(uses: list[Use]) -> set[Dimension]:
    """Return the dimensions that all uses take."""
    return set.intersection(*({SI[unit] for unit in use.units} for use in uses)) if uses else set()


def _contradiction(name: str, uses: list[Use]) -> str:
    named = " and ".join(f"{use.entry} ({' or '.join(use.units)})" for use in uses[:3])
    return problem(f"parameters.{name}", f"{named} use it, which are different quantities; take a parameter for each")


def _in_si(parameter: Mapping[str, Any], factor: float) -> dict[str, Any]:
    """Return a raw parameter with all its numbers converted."""
    converted = dict(parameter)
    for key in ("nominal", "value"):
        if key in converted:
            converted[key] = _times(converted[key], factor)
    bounds, distribution = converted.get("bounds"), converted.get("distribution")
    if isinstance(bounds, list):
        converted["bounds"] = [_times(bound, factor) for bound in bounds]
    if isinstance(distribution, dict):
        converted["distribution"] = _law_in_si(distribution, factor)
    return converted


def _law_in_si(law: Mapping[str, Any], factor: float) -> dict[str, Any]:
    """Return a raw distribution with the numbers that are in the parameter's unit converted."""
    converted = dict(law)
    # scipy's default for scale is 1, of the unit
    scaled = {} if law.get("name") in OWN else {"scale": 1.0}
    scaled |= {key: law[key] for key in ("loc", "scale") if key in law}
    converted |= {key: _times(value, factor) for key, value in scaled.items()}
    if isinstance(law.get("values"), list):
        converted["values"] = [_times(value, factor) for value in law["values"]]
    if isinstance(law.get("of"), list):
        converted["of"] = [_law_in_si(one, factor) if isinstance(one, dict) else one for one in law["of"]]
    return converted


def _times(value: object, factor: float) -> object:
    """Return a number times the factor, so that 5.6 mm are the 5.6e-3 of SI units; others unchanged."""
    if not is_number(value):
        return value
    exact = Decimal(repr(float(value)))  # in decimals, in which the factors of most units are exact
    inverse = round(1.0 / factor)
    if inverse > 0 and abs(inverse * factor - 1.0) < ROUNDING:
        return float(exact / inverse)
    return float(exact * (round(factor) if abs(round(factor) / factor - 1.0) < ROUNDING else Decimal(factor)))


def _plain(unit: str) -> str:
    """Return a unit without the signs of products and powers."""
    return re.sub(r"[ *^\N{MIDDLE DOT}]", "", unit)


@cache
def _plain_names() -> dict[str, Dimension]:
    return {"": (0, 0, 0), "-": (0, 0, 0)} | {_plain(name): dimension for name, dimension in SI.items()}


@cache
def _registry() -> pint.UnitRegistry:
    import pint  # most of a second, which a scene in SI units need not wait for

    return pint.UnitRegistry()


def _nearest(unit: str) -> str:
    hint = nearest_name(unit, COMMON)
    return hint if "did you mean" in hint else ""
