"""The border of a scene: its numbers become SI where it is read, and those of its own units where it is written.

Between, a `Scene` is in SI units, whatever `scene.units` says: that is what results are shown and written in. Numbers
are converted by the unit that their entry declares, or that follows from what a joint turns or slides, through
decimals: 123.4 mm are bit for bit the 0.1234 m of the same scene in SI units. What formulas and controllers have of
their own stays as it is written, since these compute in the units of the scene (`to_own`). Entries that the scene
leaves out have their defaults, which are in SI units.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from pgmp_petsc.base.units import SI, UNITS, behind, dimension_of, times
from pgmp_petsc.scene.fields import AnyScene, Unit, is_number, notes_on
from pgmp_petsc.scene.parameters import Parameter
from pgmp_petsc.scene.units import converted, label_of
from pgmp_petsc.scene.uses import measured_uses, uses_of

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
