"""Units of a scene's numbers: those of the scene, any compatible ones where they are said.

What a parameter is follows from the entries that name it: a radius is a length, a Young's modulus a pressure. Its
`unit` says what its numbers are given in: nominal, value, bounds, and ``loc``, ``scale`` and ``values`` of its
distribution (shape parameters have no unit). They are converted before the scene is validated; ``--set`` is in the
scene's units whatever the unit. Where a number is a text with its own unit, it is converted for itself.

Numbers become SI where a scene is read, and those of its own units where it is written. Between, a `Scene` is in SI
units, whatever `scene.units` says: that is what results are shown and written in. Numbers are converted by the unit
that their entry declares, or that follows from what a joint turns or slides, through decimals: 123.4 mm are bit for bit
the 0.1234 m of the same scene in SI units. What formulas and controllers have of their own stays as it is written,
since these compute in the units of the scene (`to_own`). Entries that the scene leaves out have their defaults, which
are in SI units.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.units import (
    IN_TURNS,
    QUANTITY,
    ROUNDING,
    SI,
    UNITS,
    Dimension,
    UnitSystem,
    UnknownUnit,
    behind,
    dimension_of,
    has_angles,
    is_hertz,
    measure,
    named,
    number_of,
    plain,
    si_name,
    times,
)
from pgmp_petsc.scene.fields import AnyScene, Unit, Use, is_number, notes_on, raw_tables
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.parameters import OWN, Parameter
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


SomeScene = TypeVar("SomeScene", bound=BaseModel)
#: Converts a number, or numbers in lists, of a unit of SI.
Convert = Callable[[Any, str], Any]


def in_si(scene: SomeScene) -> SomeScene:
    """Return a scene whose numbers are in its own units in SI units."""
    system = scene.system
    if system.is_si:
        return scene

    def label(unit: str) -> str:
        found = label_of(unit, dimension_of(unit), SI)
        return found if found in UNITS else unit

    return _whole(scene, lambda value, unit: _times(value, system.size_of(unit)), label, False)


def in_own_units(scene: SomeScene, every: bool = True) -> SomeScene:
    """Return a scene in SI units in its own ones, to be written; of `every` entry or of those that were given."""
    system = scene.system
    if system.is_si:
        return scene
    return _whole(scene, lambda value, unit: _times(value, 1.0 / system.size_of(unit)), system.unit, every)


def own_values(scene: AnyScene, values: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return values of parameters, numbers or arrays, in the units of the scene; those of a single run if not given."""
    values = scene.values if values is None else values
    return {name: _times(value, to_own(scene, name)) for name, value in values.items()}


def values_text(scene: AnyScene, values: Mapping[str, float], form: str = ".6g") -> str:
    """Name parameters with their values and units in those of the scene: ``r1 = 5.6 mm``."""
    units = own_units(scene)
    return ", ".join(f"{name} = {x:{form}}{behind(units[name])}" for name, x in own_values(scene, values).items())


def si_values(scene: AnyScene, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values of parameters that are in the units of the scene, numbers or arrays, in SI units."""
    return {name: _times(value, 1.0 / to_own(scene, name)) for name, value in values.items()}


def to_own(scene: AnyScene, parameter: str) -> float:
    """Return what the value of a parameter is multiplied by for formulas, which have it in the units of the scene."""
    return 1.0 / scene.system.size_of(scene.parameters[parameter].unit or "1")


def own_powers(scene: AnyScene, given: Mapping[str, float | str]) -> dict[str, int | None]:
    """Return by which power of ten what names parameters is larger in the units of the scene, by the keys of `given`;
    numbers have no part, and parameters without a unit, which stay as they are written, have None."""
    units = {key: scene.parameters[one].unit for key, one in given.items() if isinstance(one, str)}
    return {key: scene.system.power_of(unit) if unit else None for key, unit in units.items()}


def shown_in(scene: AnyScene) -> Callable[[str, Any], Any]:
    """Return what gives the value of an entry, by its dotted name, in the units of the scene."""
    if scene.system.is_si:
        return lambda entry, value: value
    units = _units(scene)
    _converted(scene, "", units, lambda value, unit: value, True, noted := dict(units))
    for name, unit in parameter_units(scene).items():
        noted |= dict.fromkeys((f"parameters.{name}.{key}" for key in ("nominal", "value", "bounds")), unit or "1")
    return lambda entry, value: _times(value, 1.0 / scene.system.size_of(noted.get(entry, "1")))


def _whole(scene: SomeScene, convert: Convert, label: Callable[[str], str], every: bool) -> SomeScene:
    """Return a scene with other numbers, and other units of its parameters."""
    units, of_parameters = _units(scene), parameter_units(scene)
    changed = _converted(scene, "", units, convert, every, {})
    parameters = {
        name: _parameter(parameter, of_parameters[name], convert, label) for name, parameter in scene.parameters.items()
    }
    return changed.model_copy(update={"parameters": parameters} if parameters else {})


def _units(scene: AnyScene) -> dict[str, str]:
    """Return the units of entries that hang on the rest of a scene, by their dotted names."""
    found = {use.entry: use.units[0] for use in (*measured_uses(scene), *uses_of(scene)) if use.units}
    for name, effect in scene.effects.items():
        scale = getattr(effect, "scale", None)
        if isinstance(scale, str) and any(dimension_of(scene.parameters[scale].unit or "1")):
            # a table is of numbers where the parameter that scales it has its unit
            of_values = [key for key in found if re.match(rf"effects\.{name}\.(table\[\d+\]$|harmonic\.)", key)]
            found |= dict.fromkeys(of_values, "1")
    return found


def parameter_units(scene: AnyScene) -> dict[str, str]:
    """Return the SI unit of each parameter: its own, or that of the entries that name it, empty where any may be."""
    uses = {use.parameter: use.units[0] for use in (*measured_uses(scene), *uses_of(scene)) if use.units}
    return {name: parameter.unit or uses.get(name, "") for name, parameter in scene.parameters.items()}


def own_units(scene: AnyScene) -> dict[str, str]:
    """Return the unit of each parameter by the names of the scene, empty where any may be."""
    return {name: scene.system.unit(unit) for name, unit in parameter_units(scene).items()}


def result_units(scene: AnyScene) -> dict[str, str]:
    """Return the unit of each parameter, 1 where it is not known, in results before they are converted: of SI, or of
    the same size by the scene's names."""
    system, units = scene.system, parameter_units(scene)
    return {name: (system.unit(unit) if system.is_si else unit) or "1" for name, unit in units.items()}


def _parameter(parameter: Parameter, unit: str, convert: Convert, label: Callable[[str], str]) -> Parameter:
    """Return a parameter with other numbers, and another unit."""
    if not any(dimension_of(unit or "1")):
        return parameter
    given = parameter.model_dump(exclude_unset=True)
    return Parameter.model_validate(converted(given, lambda value: convert(value, unit)) | {"unit": label(unit)})


def _converted(
    table: Any, entry: str, units: Mapping[str, str], convert: Convert, every: bool, noted: dict[str, str]
) -> Any:
    """Return a table with other numbers; note the units of its entries."""
    changed: dict[str, Any] = {}
    for name, field in type(table).model_fields.items():
        value, own = getattr(table, name), f"{entry}.{name}".removeprefix(".")
        if value is None or own == "parameters" or not (every or name in table.model_fields_set):
            continue
        notes = notes_on(field, Unit)
        unit = notes[-1].on_turning if notes else "1"

        def of(value: Any, own: str, unit: str) -> Any:
            unit = units.get(own, unit) or "1"
            if isinstance(value, BaseModel):
                return _converted(value, own, units, convert, every, noted)
            if isinstance(value, dict):
                return {key: of(one, f"{own}.{key}", unit) for key, one in value.items()}
            if isinstance(value, tuple) and re.search(r"\.table$", own):
                return tuple(
                    (convert(x, units.get(f"{own}[{k}][0]", "1")),
                     convert(y, units.get(f"{own}[{k}][1]", units.get(f"{own}[{k}]", "1"))))
                    for k, (x, y) in enumerate(value)
                )  # fmt: skip
            if isinstance(value, tuple) and any(isinstance(one, BaseModel) for one in value):
                return tuple(of(one, f"{own}[{k}]", unit) for k, one in enumerate(value))
            noted[own] = unit
            return convert(value, unit)

        new = of(value, own, unit)
        if new != value:
            changed[name] = new
    return table.model_copy(update=changed) if changed else table


def _times(value: Any, factor: float) -> Any:
    """Return numbers times the factor; texts, flags and what is infinite as they are."""
    if isinstance(value, (list, tuple)):
        return type(value)(_times(one, factor) for one in value)
    has_numbers = isinstance(value, np.ndarray) or isinstance(value, float) and is_number(value)
    return times(value, factor) if has_numbers else value
