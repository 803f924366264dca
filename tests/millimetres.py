"""Any scene in SI units turned into mm, t and s, number by number; files, texts and pictures of both compared."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import tomli_w
from pydantic import BaseModel

from pgmp_petsc.base.units import MM, QUANTITY, UNITS, measure, times
from pgmp_petsc.joints.coupled import Cam
from pgmp_petsc.results.numbers import _PREFIXED_UNITS, _PREFIXES
from pgmp_petsc.scene.fields import Unit, notes_on
from pgmp_petsc.scene.loading import load_scene
from pgmp_petsc.scene.uses import measured_uses, uses_of

OF_ROUND_OFF = 0.02  # of the numbers in a text: derivatives that are zero are shown as what is left of them
NOTHING = 1e-18  # of what is round-off in either system
ONE = 1e-15  # round-off of 1
OF_VALUES = ("nominal", "value", "bounds")


def with_short_numbers(text: str, folder: Path) -> str:
    """Return a scene's text with copies of its meshes in a folder, whose places are multiples of a nanometre: those of
    16 digits would be rounded where they are written in mm."""
    for name in dict.fromkeys(re.findall(r'"([^"]+\.msh)"', text)):
        mesh = meshio.read(name)
        mesh.points = np.round(mesh.points, 9)
        mesh.write(folder / Path(name).name, file_format="gmsh22", binary=False)
        text = text.replace(name, Path(name).name)
    return text


def in_millimetres(path: Path, changes: list[str], target: Path) -> Path:
    """Write a scene that is in SI units, changed, as the same one in mm, with its meshes.

    What has any unit, such as a constant of a formula, is a text with its unit in the file.
    """
    scene = load_scene(path, changes)
    units = dict(_units_of_texts(tomllib.loads(path.read_text(encoding="utf-8")), ""))
    for use in (*measured_uses(scene), *uses_of(scene)):
        if use.units:
            units[use.entry] = use.units[0]
    for name, joint in scene.joints.items():
        if isinstance(joint, Cam) and joint.shares_in(scene)[0].motion == "sliding":
            units |= {f"joints.{name}.table[{k}]": "m" for k in range(len(joint.table))}
    tables = _converted(scene, "", units)
    tables["scene"]["units"] = "mm"
    of_parameters = {use.parameter: use.units[0] for use in uses_of(scene) if use.parameter and use.units}
    for name, parameter in tables.get("parameters", {}).items():
        _convert_parameter(parameter, scene.parameters[name].unit or of_parameters.get(name, "1"))
    for name, body in tables["bodies"].items():
        if "mesh" in body:
            mesh = meshio.read(scene.path_of(body["mesh"]))
            mesh.points = np.vectorize(lambda x: float(Decimal(repr(float(x))).scaleb(3)))(mesh.points)
            mesh.write(target.with_name(f"{name}.msh"), file_format="gmsh22", binary=False)
            body["mesh"] = f"{name}.msh"
    target.write_text(tomli_w.dumps(tables), encoding="utf-8")
    return target


def _units_of_texts(value: object, entry: str) -> Iterator[tuple[str, str]]:
    """Yield the entries of raw tables that are numbers with their own unit, with the unit."""
    if isinstance(value, dict):
        for key, one in value.items():
            yield from _units_of_texts(one, f"{entry}.{key}".removeprefix("."))
    elif isinstance(value, str) and (found := re.match(QUANTITY, value)) and found[2].strip():
        yield entry, found[2].strip()


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
        notes = notes_on(field, Unit)
        if value is not None and name in table.model_fields_set:
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
    return times(value, factor) if isinstance(value, float) and np.isfinite(value) else value


def differences(one: Path, other: Path) -> dict[str, float]:
    """Return how far numbers of two files of the same scene in SI and in mm differ, by the places of what belongs
    together, as shares of the largest number there, or of that which they are differences of, and refuse units that do
    not fit; times that runs took have no part."""
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
            assert str(b.attrs["unit"]) == MM.unit(unit), (place, unit, b.attrs["unit"])
            factors = np.array([MM.size(_dimension(part)) for part in unit.split(", ")])
            left, right = np.atleast_1d(a[()], b[()])
            if not left.size:
                assert not right.size, place
                continue
            if factors.size > 1:  # along one of the axes
                behind = left.ndim - 1 - left.shape.index(factors.size)
                factors = factors.reshape(-1, *[1] * behind)
            right = right * factors
            assert np.array_equal(np.isnan(left), np.isnan(right)), place
            if re.search(r"(min|max)/(edges|pdf)$", place) and np.ptp(left) < 1e-5 * np.abs(left).max():
                continue  # of an output that is the same in all samples: as wide as it is large, or 1 of its unit
            known, kin = np.isfinite(left), re.sub(r"/[0-9]{5}$", "", place)
            size, far = (float(np.max(np.abs(x), initial=0.0)) for x in (left[known], left[known] - right[known]))
            if place.startswith("validity/"):
                far = max(far - ONE, 0.0)  # differences of lengths that are nearly the same
            elif place.endswith("/pdf"):
                edges = si[place.removesuffix("pdf") + "edges"][()]
                far *= np.ptp(edges) / np.abs(edges).max() / (2 * edges.size)  # both ends of a bin
            elif kin.endswith(("/deformation", "/displacement")):  # of places, which are known to round-off
                of = kin.rpartition("/")[0] + "/points"
                size = max(size, float(np.max(np.abs(si[place.replace(kin, of)]), initial=0.0)))
            elif place == "energy/residual":
                size = max(size, *(float(np.max(np.abs(si[f"energy/{part}"]))) for part in ("kinetic", "potential")))
            elif re.match(r"statistics/\w+/(std|mean_standard_error)", place):  # of values that are known to round-off
                size = max(size, float(np.max(np.abs(si["/".join([*place.split("/")[:2], "mean"])]))))
            sizes[kin], off[kin] = max(sizes.get(kin, 0.0), size), max(off.get(kin, 0.0), far)
    return {place: off[place] / (sizes[place] or 1.0) for place in off}


def _dimension(unit: str) -> tuple[float, float, float]:
    """Return the exponents of kilogram, metre and second of a unit that files have."""
    if unit.startswith("1/"):
        return tuple(-power for power in _dimension(unit.removeprefix("1/")))
    return measure({"J": "N m", "Hz": "1/s", "": "1", "W": "N m/s"}.get(unit, unit))[1]


#: Units as texts have them, with prefixes, and the SI unit of each.
IN_SI = {f"{prefix}{unit}": unit for unit in _PREFIXED_UNITS for prefix in _PREFIXES.values()} | {u: u for u in UNITS}
IN_SI |= {"m2": "m2"}  # of surfaces
IN_MM = {unit: f"{unit} of SI" for unit in IN_SI.values()} | {MM.unit(unit): unit for unit in IN_SI.values()}
IN_MM |= {f"{prefix}{unit}": unit for unit in ("N", "s", "rad", "Hz") for prefix in _PREFIXES.values()}
NUMBER = r"(?<![\w.])[-+]?(?:\d+(?:,\d{3})*(?:\.\d*)?|\.\d+)(?:e[-+]?\d+)?"
#: Lines that differ from run to run: how long it took, or is predicted to, and when.
OF_THE_RUN = re.compile(
    r"^\s*(?:.*processor time.*|[a-z ,]+\s+[\d.]+ s|written .*|pgmp: working.*|.*\d+ of \d+, \d+ s.*)$", re.MULTILINE
)


def told(text: str, units: dict[str, str]) -> tuple[str, list[tuple[float, bool]]]:
    """Return the words of a text, with SI units for those that it has and # for numbers, and the numbers, in SI units
    where their unit is behind them, which is said too."""
    text = OF_THE_RUN.sub("", text.replace("\N{MINUS SIGN}", "-"))
    labels = "|".join(map(re.escape, sorted({*units} - {"1"}, key=len, reverse=True)))
    numbers = []
    for found in re.finditer(rf"({NUMBER})(?: ({labels})(?=[,;.)\]]|\s\s|$))?", text):
        size = 1.0 if found[2] is None else measure(found[2])[0]
        # a count may be before a unit of a table
        known = found[2] is not None and re.search(r"[.e]", found[1]) is not None
        numbers.append((float(found[1].replace(",", "")) * (size if known else 1.0), known))
    text = re.sub(NUMBER, "#", text)
    text = re.sub(rf"(?<!\w)({labels})(?!\w| =)", lambda found: units[found[1]], text)
    return " ".join(text.split()), numbers


def strange(si: str, mm: str, share: float = 0.02) -> str:
    """Say where texts of the same scene in SI and in mm differ otherwise than by units, and by powers of a thousand of
    numbers without their unit; empty where they do not."""
    (words, left), (others, right) = told(si, IN_SI), told(mm, IN_MM)
    if words != others:
        at = next((k for k, (a, b) in enumerate(zip(words, others)) if a != b), min(len(words), len(others)))
        return f"{words[max(at - 80, 0) : at + 60]!r} is not {others[max(at - 80, 0) : at + 60]!r}"
    others = [f"{a[0]} in SI is {b[0]} in mm" for a, b in zip(left, right, strict=True) if not _alike(a, b, share)]
    return ", ".join(others) if len(others) > OF_ROUND_OFF * len(left) else ""


def _alike(one: tuple[float, bool], other: tuple[float, bool], share: float) -> bool:
    (si, known), (mm, also) = one, other
    if max(abs(si), abs(mm)) < NOTHING:
        return True
    thousands = np.log10(abs(mm / si)) / 3.0 if si and mm else np.inf
    whole = 0.0 if known and also else np.round(thousands)  # a number without its unit may be of any prefix
    return si * mm > 0.0 and abs(thousands - whole) <= share / 3.0


def flat(text: str) -> str:
    """Return what JSON says, a line an entry, without times that runs took and names of files."""

    def lines(value: object, entry: str) -> Iterator[str]:
        if isinstance(value, (dict, list)):
            pairs = value.items() if isinstance(value, dict) else enumerate(value)
            for key, one in pairs:
                if not re.search("second|timing|time|file|cost", str(key)):
                    yield from lines(one, f"{entry}/{key}")
        else:
            yield f"{entry}: {value}"

    return "\n".join(lines(json.loads(text), ""))
