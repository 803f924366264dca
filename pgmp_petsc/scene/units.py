"""Units of a scene's numbers: those of the scene, any compatible ones where they are said.

What a parameter is follows from the entries that name it: a radius is a length, a Young's modulus a pressure. Its
`unit` says what its numbers are given in: nominal, value, bounds, and ``loc``, ``scale`` and ``values`` of its
distribution (shape parameters have no unit). They are converted before the scene is validated; ``--set`` is in the
scene's units whatever the unit. Where a number is a text with its own unit, it is converted for itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.units import (
    IN_TURNS,
    QUANTITY,
    ROUNDING,
    UNITS,
    Dimension,
    UnitSystem,
    UnknownUnit,
    has_angles,
    is_hertz,
    measure,
    named,
    number_of,
    plain,
    si_name,
    times,
)
from pgmp_petsc.scene.fields import AnyScene, Use, is_number, raw_tables
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.parameters import OWN
from pgmp_petsc.scene.uses import controller_uses, measured_uses, uses_of


def convert_parameters(data: dict[str, Any], system: UnitSystem) -> dict[str, str]:
    """Convert parameters given in other units than the scene's, in place on raw tables; return the unit that each of
    them was given in.

    What is no number, or has an unknown unit, is left for the validation to refuse. Raises `InputError` if a number is
    a text with another unit than the rest of its parameter.
    """
    given: dict[str, str] = {}
    own_names = {"", "-"} | {plain(system.unit(label)) for label in UNITS}
    for name, parameter in raw_tables(data, "parameters").items():
        found: list[object] = []
        converted(parameter, found.append)
        texts = [value for value in found if isinstance(value, str) and re.match(QUANTITY, value)]
        unit = parameter.get("unit", _unit_behind(texts[0]) if texts else None)
        if not isinstance(unit, str):
            continue
        try:
            factor, dimension = measure(unit)
            for text in texts:
                _check(name, text, unit)
        except UnknownUnit as error:
            if texts and "unit" not in parameter:
                raise InputError(problem(f"parameters.{name}", str(error), texts[0])) from error
            continue
        label, own = label_of(unit, dimension, system), abs(factor / system.size(dimension) - 1.0) < ROUNDING
        if not texts and (plain(unit) in own_names or own and dimension not in UNITS.values()):
            continue
        given[name] = unit
        # numbers beside a text are in the scene's units, where the parameter says no other
        factor = factor / system.size(dimension) if "unit" in parameter else 1.0
        numbers = converted(parameter, lambda value, factor=factor: _number(value, factor, system))
        data["parameters"][name] = numbers | {"unit": label}
    return given


def label_of(unit: str, dimension: Dimension, system: UnitSystem) -> str:
    """Return the unit of a dimension in a system, with angles where `unit` has them."""
    fitting = [label for label, known in UNITS.items() if known == dimension]
    fitting.sort(key=lambda label: ("rad" in label) != has_angles(unit))
    return system.unit(fitting[0] if fitting else si_name(dimension))


def setting_of(text: str, parameter: dict[str, Any], system: UnitSystem) -> float | None:
    """Return a value with its own unit, in those of the scene, for a raw parameter that is converted; None if it has
    none. A parameter without a unit is given it. Raises `UnknownUnit` if it is none, or none of the parameter's."""
    value = number_of(text, (), system) if _unit_behind(text) else None
    if value is None:
        return None
    unit, dimension = _unit_behind(text), measure(_unit_behind(text))[1]
    own = parameter.get("unit")
    if isinstance(own, str) and own and (words := _strange(unit, own)):
        raise UnknownUnit(words)
    if not own:
        parameter["unit"] = label_of(unit, dimension, system)
    return value


def unit_problems(scene: AnyScene, given: Mapping[str, str]) -> Iterator[str]:
    """Yield a line for each parameter whose unit, as `convert_parameters` returned it, is unknown or none of what uses
    it, or whose uses differ."""
    uses: dict[str, list[Use]] = {name: [] for name in scene.parameters}
    for use in uses_of(scene):
        if use.parameter in uses and use.units:  # what is in a formula may have any
            uses[use.parameter].append(use)
    for name, parameter in scene.parameters.items():
        unit, units = given.get(name, parameter.unit), [{UNITS[unit] for unit in use.units} for use in uses[name]]
        allowed = set.intersection(*units) if units else set()
        if uses[name] and not allowed:
            used = " and ".join(f"{use.entry} ({' or '.join(use.units)})" for use in uses[name][:3])
            words = f"{used} use it, which are different quantities; take a parameter for each"
            yield problem(f"parameters.{name}", words)
            continue
        entry = f"parameters.{name}.unit"
        try:
            _, dimension = measure(unit)
            if is_hertz(unit) and any("rad/s" in use.units for use in uses[name]):
                raise UnknownUnit(IN_TURNS)
        except UnknownUnit as error:
            yield problem(entry, str(error), unit)
            continue
        if unit and allowed and dimension not in allowed:
            system = scene.system
            fitting = dict.fromkeys(label for use in uses[name] for label in use.units if UNITS[label] in allowed)
            words = " or ".join("1 (no unit)" if label == "1" else system.unit(label) for label in fitting)
            needs = f"{uses[name][0].entry} uses it, which needs {words}, or what can be converted to it"
            yield problem(entry, f"{needs}; this is the unit of {named(dimension)}", unit)


def text_problems(scene: AnyScene, raw: Mapping[str, Any]) -> Iterator[str]:
    """Yield a line for each number, in the tables that the scene was read from, that is a text with a unit of another
    motion than it is about: N/m on a hinge."""
    system, seen = scene.system, set()
    has_any = any(re.match(QUANTITY, text) for text in _strings(raw))
    for use in (*uses_of(scene), *measured_uses(scene), *controller_uses(scene)) if has_any else ():
        found = _at(raw, use.entry)
        in_row = use.entry.endswith("]") and isinstance(found, (list, tuple))  # a time, and what the use is of
        for text in () if isinstance(found, dict) else _strings(found[-1] if in_row else found):
            if (use.entry, text) in seen:
                continue
            seen.add((use.entry, text))
            try:
                number_of(text, use.units, system)
            except UnknownUnit as error:
                yield problem(use.entry, str(error), text)


def _at(raw: object, entry: str) -> object:
    """Return what is at a dotted name in raw tables; None where nothing is."""
    for key in re.findall(r"[^.\[\]]+", entry):
        if isinstance(raw, dict):
            raw = raw.get(key)
        elif isinstance(raw, (list, tuple)) and key.isdigit() and int(key) < len(raw):
            raw = raw[int(key)]
        else:
            return None
    return raw


def _strings(value: object) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, (list, tuple, dict)):
        value = value.values() if isinstance(value, dict) else value
        for one in value:
            yield from _strings(one)


def _unit_behind(text: str) -> str:
    found = re.match(QUANTITY, text)
    return found[2].strip() if found else ""


def _check(name: str, text: str, own: str) -> None:
    """Raise `InputError` if a number is of another quantity than its parameter, whose unit is given."""
    unit = _unit_behind(text)
    without = 'a number in quotes has its unit behind it, such as "5 mm"; leave the quotes out otherwise'
    if words := _strange(unit, own) if unit else without:
        raise InputError(problem(f"parameters.{name}", words, text))


def _strange(unit: str, own: str) -> str:
    """Return how a unit is of another quantity than a parameter's own; empty where it is not."""
    found, wanted = measure(unit)[1], measure(own)[1]
    if found != wanted:
        return f"'{unit}' is the unit of {named(found)}; needed is {named(wanted)} ({own})"
    return IN_TURNS if is_hertz(unit) and has_angles(own) else ""


def _number(value: object, factor: float, system: UnitSystem) -> object:
    """Return a number times a factor, or a text with its own unit as a number; others unchanged."""
    if isinstance(value, str):
        number = number_of(value, (), system) if re.match(QUANTITY, value) else None
        return value if number is None else number
    return times(value, factor) if is_number(value) else value


def converted(parameter: Mapping[str, Any], number: Callable[[Any], Any]) -> dict[str, Any]:
    """Return a raw parameter with other numbers."""
    found = dict(parameter)
    for key in ("nominal", "value"):
        if key in found:
            found[key] = number(found[key])
    if isinstance(bounds := found.get("bounds"), (list, tuple)):
        found["bounds"] = [number(bound) for bound in bounds]
    if isinstance(distribution := found.get("distribution"), dict):
        found["distribution"] = _of_distribution(distribution, number)
    return found


def _of_distribution(drawn: Mapping[str, Any], number: Callable[[object], object]) -> dict[str, Any]:
    """Return a raw distribution with the numbers that are in the parameter's unit converted."""
    converted = dict(drawn)
    # scipy's default for scale is 1, of the unit
    name = drawn.get("name")
    scaled = {} if isinstance(name, str) and name in OWN else {"scale": 1.0}
    scaled |= {key: drawn[key] for key in ("loc", "scale") if key in drawn}
    converted |= {key: number(value) for key, value in scaled.items()}
    if isinstance(drawn.get("values"), (list, tuple)):
        converted["values"] = [number(value) for value in drawn["values"]]
    if isinstance(drawn.get("of"), (list, tuple)):
        converted["of"] = [_of_distribution(one, number) if isinstance(one, dict) else one for one in drawn["of"]]
    return converted
