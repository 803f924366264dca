"""Any scene in SI units turned into mm, t and s, number by number, and files of both compared."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import tomli_w
from pydantic import BaseModel

from pgmp_petsc.base.units import MM, measure, times
from pgmp_petsc.scene.fields import Unit, _notes
from pgmp_petsc.scene.loading import load_scene
from pgmp_petsc.scene.uses import measured_uses, uses_of

OF_VALUES = ("nominal", "value", "bounds")


def in_millimetres(path: Path, changes: list[str], target: Path) -> Path:
    """Write a scene that is in SI units, changed, as the same one in mm; meshes have to be lines."""
    scene = load_scene(path, changes)
    units: dict[str, str] = {}
    for use in (*measured_uses(scene), *uses_of(scene)):
        if use.units:
            units[use.entry] = use.units[0]
    tables = _converted(scene, "", units)
    tables["scene"]["units"] = "mm"
    of_parameters = {use.parameter: use.units[0] for use in uses_of(scene) if use.parameter and use.units}
    for name, parameter in tables.get("parameters", {}).items():
        _convert_parameter(parameter, of_parameters.get(name, "1"))
    target.write_text(tomli_w.dumps(tables), encoding="utf-8")
    return target


def _size(unit: str) -> float:
    return 1.0 / MM.size(_dimension(unit))


def _convert_parameter(parameter: dict[str, Any], unit: str) -> None:
    if parameter.get("unit"):
        parameter["unit"] = MM.unit(parameter["unit"])
    for key in OF_VALUES:
        if key in parameter:
            parameter[key] = _times(parameter[key], _size(unit))
    law = parameter.get("distribution", {})
    law |= {key: _times(law[key], _size(unit)) for key in ("loc", "scale", "values") if key in law}


def _converted(table: BaseModel, entry: str, units: dict[str, str]) -> dict[str, Any]:
    found = {}
    for name, field in type(table).model_fields.items():
        value, own = getattr(table, name), f"{entry}.{name}".removeprefix(".")
        notes = [note for note in (*field.metadata, *_notes(field.annotation)) if isinstance(note, Unit)]
        if value is not None:
            found[name] = _value(value, own, notes[-1].on_turning if notes else "1", units)
    return found | dict(table.__pydantic_extra__ or {})


def _value(value: Any, entry: str, unit: str, units: dict[str, str]) -> Any:
    unit = units.get(entry, unit)
    if isinstance(value, BaseModel):
        return _converted(value, entry, units)
    if isinstance(value, dict):
        return {key: _value(one, f"{entry}.{key}", unit, units) for key, one in value.items()}
    if isinstance(value, tuple) and re.search(r"\.table$", entry):
        return [
            [_times(x, _size(units.get(f"{entry}[{k}][0]", "s"))),
             _times(y, _size(units.get(f"{entry}[{k}][1]", units.get(f"{entry}[{k}]", "1"))))]
            for k, (x, y) in enumerate(value)
        ]  # fmt: skip
    return _times(value, _size(unit or "1"))


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, (list, tuple)):
        return [_times(one, factor) for one in value]
    return times(value, factor) if isinstance(value, float) else value


def differences(one: Path, other: Path, alike: bool = False) -> dict[str, float]:
    """Return how far numbers of two files of the same scene in SI and in mm differ, by the places of what belongs
    together, as shares of the largest number there, and refuse units that do not fit; times that runs took have no
    part. With `alike` both are in SI units."""
    off: dict[str, float] = {}
    sizes: dict[str, float] = {}
    with h5py.File(one) as si, h5py.File(other) as mm:
        places: list[str] = []
        si.visititems(lambda name, item: places.append(name) if isinstance(item, h5py.Dataset) else None)
        for place in places:
            a, b = si[place], mm[place]
            if a.dtype.kind != "f" or place.startswith("timings") or re.search(r"second|cost", place):
                continue
            unit = str(a.attrs["unit"])
            # of mass-normalised modes, whose signs are any; goals are formulas, and have no unit
            if place == "state/modal" or place.split("/")[-1] in ("goal", "goals"):
                continue
            assert str(b.attrs["unit"]) == (unit if alike else MM.unit(unit)), (place, unit, b.attrs["unit"])
            factors = [1.0 if alike else MM.size(_dimension(part)) for part in unit.split(", ")]
            left, right = a[()], b[()] * (factors[0] if len(set(factors)) == 1 else np.array(factors))
            assert np.array_equal(np.isnan(left), np.isnan(right)), place
            if re.search(r"(min|max)/(edges|pdf)$", place) and np.ptp(left) < 1e-5 * np.abs(left).max():
                continue  # of an output that is the same in all samples: as wide as it is large, or 1 of its unit
            known, kin = np.isfinite(left), re.sub(r"/[0-9]{5}$", "", place)
            sizes[kin] = max(sizes.get(kin, 0.0), float(np.max(np.abs(left)[known], initial=0.0)))
            off[kin] = max(off.get(kin, 0.0), float(np.max(np.abs(left - right)[known], initial=0.0)))
    return {place: off[place] / (sizes[place] or 1.0) for place in off}


def _dimension(unit: str) -> tuple[float, float, float]:
    """Return the exponents of kilogram, metre and second of a unit that files have."""
    if unit.startswith("1/"):
        return tuple(-power for power in _dimension(unit.removeprefix("1/")))
    return measure({"J": "N m", "Hz": "1/s", "": "1"}.get(unit, unit))[1]
