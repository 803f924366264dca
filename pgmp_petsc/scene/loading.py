"""From a TOML file to a scene, and back to the resolved TOML that every result file carries.

Changes from the command line, `--override dotted.key=VALUE` and `--set NAME=VALUE`, are of raw tables, before they are
validated. Deep tables end in recursion, null bytes and lone surrogates in system calls and HDF5: they are refused here
for all entries.

Templates are commented scenes that run as they are, with the meshes that they name: package data in
``scene/templates``.
"""

from __future__ import annotations

import math
import os
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from importlib import resources
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from pgmp_petsc.base.errors import InputError, irregular, nearest_name, shortened
from pgmp_petsc.base.units import SAID, SI, UnitSystem, UnknownUnit, measure
from pgmp_petsc.declare.ideas import FAMILIES
from pgmp_petsc.files.claims import replacing
from pgmp_petsc.files.seal import SIGNATURE, SIZE
from pgmp_petsc.scene.fields import in_files, raw_tables
from pgmp_petsc.scene.messages import DEEPEST, dotted_name, explain, problem, toml_text
from pgmp_petsc.scene.parameters import add_field_parameters
from pgmp_petsc.scene.schema import Scene
from pgmp_petsc.scene.units import convert_parameters, in_own_units, in_si, setting_of

MOST_BYTES = 16_000_000  # of a scene's file
MOST_ROWS = 100_000  # of a table in a file: every result keeps the scene with them
LONGEST_TEXT = 10_000  # characters
SHOWN_KEYS = 4  # of a path that is too deep


def read_text(path: Path) -> str:
    """Return the text of a scene's file; raises `InputError` if there is none, it is a directory, pipe or device, too
    large, or no text in UTF-8."""
    try:
        kind = path.stat()
        if irregular(kind.st_mode):
            raise InputError(f"{path}: this is {irregular(kind.st_mode)}; a scene is a TOML file")
        if kind.st_size > MOST_BYTES:
            allowed = f"a scene is a TOML file of at most {MOST_BYTES:,} bytes"
            raise InputError(f"{path}: has {kind.st_size:,} bytes; {allowed}")
        content = path.read_bytes()
        if SIGNATURE in content[: SIZE + len(SIGNATURE)]:
            what = "an HDF5 file (pgmp info and pgmp.read read the program's own)"
            raise InputError(f"{path}: {what}; a scene is a TOML file")
        text = content.decode("utf-8")
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no such scene file{_beside(path)}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file in UTF-8 (byte {error.start}); a scene is a TOML file") from error
    except (OSError, ValueError) as error:  # no permission, a loop of links, a name too long or with a null byte
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{shortened(str(path))}: the scene file cannot be read ({reason})") from error
    return text.removeprefix("\N{ZERO WIDTH NO-BREAK SPACE}")  # some editors' mark of UTF-8


def parse(text: str, source: str) -> dict[str, Any]:
    """Return the tables of a TOML text; `source` begins the message. Raises `InputError` if it is no TOML."""
    try:
        return tomllib.loads(text)
    except ValueError as error:  # tomllib's own, or Python's for an integer of thousands of digits
        raise InputError(f"{source}: not valid TOML: {shortened(' '.join(str(error).split()))}") from error
    except RecursionError as error:
        raise InputError(f"{source}: tables or lists within each other, deeper than {DEEPEST}") from error


def check_tables(data: Mapping[str, Any]) -> None:
    """Refuse tables that are too deep, and texts too long or with characters that are none; raises `InputError`, naming
    the entry."""
    waiting: list[tuple[tuple[str | int, ...], object]] = [((), data)]
    while waiting:
        keys, value = waiting.pop()
        if len(keys) > DEEPEST:
            words = f"tables or lists within each other, deeper than {DEEPEST}"
            raise InputError(problem(dotted_name(keys[:SHOWN_KEYS]), words))
        if isinstance(value, Mapping):
            for key, item in value.items():
                _check_text(key, keys, "a key")
                waiting.append(((*keys, key), item))
        elif isinstance(value, list):
            waiting += [((*keys, k), item) for k, item in enumerate(value)]
        elif isinstance(value, str):
            _check_text(value, keys, "a text")


def _check_text(text: str, keys: tuple[str | int, ...], what: str) -> None:
    if len(text) > LONGEST_TEXT:
        why = f"{what} of {len(text):,} characters; at most {LONGEST_TEXT:,} are taken"
    elif "\0" in text or text.encode(errors="ignore").decode() != text:
        why = f"{what} with characters that no file takes (null, or bytes that are no UTF-8): {toml_text(text)}"
    else:
        return
    raise InputError(f"{shortened(dotted_name(keys) or 'the scene')}: {why}")


def _beside(path: Path) -> str:
    try:
        beside = [candidate.name for candidate in path.parent.glob("*.toml")]
    except OSError:
        beside = []
    return f"{nearest_name(path.name, beside)} in {path.parent}" if beside else ""


def _read_values(drawn: object, entry: str, directory: Path, own: object, system: UnitSystem) -> None:
    if not isinstance(drawn, dict):
        return
    if isinstance(drawn.get("values"), str):
        drawn["values"] = _numbers_of(drawn["values"], f"{entry}.values", directory, own, system)
    parts = drawn.get("of")
    for number, part in enumerate(parts if isinstance(parts, list) else ()):
        _read_values(part, f"{entry}.of[{number}]", directory, own, system)


def _numbers_of(name: str, entry: str, directory: Path, own: object, system: UnitSystem) -> list[float]:
    """Return the numbers of a file, one a line, behind a name in the first line or none. The name may end with the unit
    of their parameter, `own`, or of the system where that has none; raises `InputError` if it ends with another one."""
    numbers: list[float] = []
    for line, row in enumerate(_text_of(name, entry, directory).splitlines(), 1):
        cell = row.strip().strip('"')
        if not cell:
            continue
        try:
            numbers.append(float(cell))
        except ValueError as error:
            if line == 1 and "," not in cell and ";" not in cell:  # the name of the column
                unit = _unit_of_column(cell, entry, name)
                if unit and not _is_own(unit, system, own):
                    words = (
                        f"its column is in {unit}, the parameter in {own or 'units of the scene'}; give both one unit"
                    )
                    raise InputError(problem(entry, words, name)) from error
                continue
            words = f"line {line} is '{shortened(cell, 40)}'; one number is needed in each line"
            raise InputError(problem(entry, words, name)) from error
    return numbers


def _text_of(name: str, entry: str, directory: Path) -> str:
    try:
        path = directory / name
        kind = path.stat()
        if irregular(kind.st_mode):
            raise InputError(problem(entry, f"this is {irregular(kind.st_mode)}; a file of numbers is needed", name))
        if kind.st_size > MOST_BYTES:
            raise InputError(problem(entry, f"the file has more than {MOST_BYTES:,} bytes; take fewer values", name))
        return path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(problem(entry, "no text file in UTF-8", name)) from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        words = f"the file cannot be read ({reason}); it is sought in {directory.resolve()}"
        raise InputError(problem(entry, words, name)) from error


def _read_tables(data: dict[str, Any], directory: Path, system: UnitSystem) -> None:
    """Put the rows of files in the place of their names, in every entry of an idea that may have them."""
    for family in FAMILIES:
        for name, entry in raw_tables(data, family.group).items():
            said = entry.get(family.key)
            for *within, key in in_files(family.named(said)) if isinstance(said, str) and said in family.names else ():
                table = reduce(lambda table, part: table.get(part) if isinstance(table, dict) else None, within, entry)
                given = table.get(key) if isinstance(table, dict) else None
                if isinstance(given, (str, dict)):
                    table[key] = _rows_of(given, dotted_name((family.group, name, *within, key)), directory, system)


def _rows_of(given: str | dict[str, Any], entry: str, directory: Path, system: UnitSystem) -> list[list[float | str]]:
    """Return the rows [x, y] of a CSV file: of two columns, or of those that are named. Where the name of a column ends
    with a unit, its numbers have that; of the scene's own, the first one has it, which is then checked."""

    def wrong(words: str) -> InputError:
        return InputError(problem(entry, words, given))

    asked = {"file": given} if isinstance(given, str) else given
    names = [asked.get(key) for key in ("x", "y")]
    texts = [asked.get("file"), *(name for name in names if name is not None)]
    if not {*asked} <= {"file", "x", "y"} or not all(isinstance(one, str) for one in texts) or names.count(None) == 1:
        needed = 'rows, the name of a CSV file of two columns, or { file = "NAME.csv", x = "COLUMN", y = "COLUMN" }'
        raise wrong(f"needed are {needed}")
    rows, before, places, units = list[list[float | str]](), -math.inf, (0, 1), ["", ""]
    for number, (line, cells) in enumerate(_cells_of(asked["file"], entry, directory)):
        has_names = number == 0 and (names[0] is not None or all(_finite(cell) is None for cell in cells))
        if has_names and names[0] is not None:
            missing = next((name for name in names if name not in cells), None)
            if missing is not None:
                raise wrong(
                    f"there is no column '{shortened(missing)}' in its first line{nearest_name(missing, cells)}"
                )
            places = tuple(map(cells.index, names))
        elif names[0] is None and len(cells) != 2:
            raise wrong(f"line {line} has {len(cells)} columns; two are needed, or say which: {{ file, x, y }}")
        if has_names:
            units = [_unit_of_column(cells[place], entry, given) for place in places]
            continue
        row = [_finite(cells[place]) if place < len(cells) else None for place in places]
        if None in row:
            shown = shortened(", ".join(cells), 40)
            raise wrong(f"line {line} is '{shown}'; two finite numbers are needed")
        if not before < row[0]:
            raise wrong(f"line {line}: {row[0]:g} follows {before:g}; the first column must increase")
        before = row[0]
        said = [unit if not (rows and _is_own(unit, system)) else "" for unit in units]
        rows.append([f"{number!r} {unit}" if unit else number for number, unit in zip(row, said)])
        if len(rows) > MOST_ROWS:
            raise wrong(f"has more than {MOST_ROWS:,} rows; take fewer")
    if not rows:
        raise wrong("there are no numbers in the file")
    return rows


def _unit_of_column(name: str, entry: str, given: object) -> str:
    """Return the unit in brackets at the end of a column's name; empty where none is there, or none is needed."""
    found = re.search(r"[\[(]([^\[\]()]*)[\])]$", name)
    unit = found[1].strip() if found else ""
    unit = "" if unit in ("-", "1") else unit
    try:
        measure(unit)
    except UnknownUnit as error:
        words = f"the brackets in '{shortened(name, 40)}' are no unit of its numbers: {error}"
        raise InputError(problem(entry, f"{words}; write that unit, or leave the brackets out", given)) from error
    return unit


def _is_own(unit: str, system: UnitSystem, own: object = None) -> bool:
    """Whether a unit is that of a parameter, or where that has none of a system; what is none is said elsewhere."""
    factor, dimension = measure(unit)
    try:
        wanted = measure(own) if isinstance(own, str) and own else (system.size(dimension), dimension)
    except UnknownUnit:
        return True
    return dimension == wanted[1] and math.isclose(factor, wanted[0], rel_tol=1e-12)


def _cells_of(name: str, entry: str, directory: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the lines of a file that are not empty, by their numbers, as cells between commas."""
    for line, row in enumerate(_text_of(name, entry, directory).splitlines(), 1):
        if not row.strip():
            continue
        if "," not in row and (";" in row or "\t" in row):
            words = f"line {line}: columns are separated by commas, and numbers have points"
            raise InputError(problem(entry, f"{words}; this one is '{shortened(row.strip(), 40)}'", name))
        yield line, [cell.strip().strip('"') for cell in row.split(",")]


def _finite(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def load_scene(path: Path | str, overrides: Sequence[str] = (), settings: Sequence[str] = ()) -> Scene:
    """Read and validate a scene file; meshes are relative to its directory.

    Overrides are ``dotted.key=VALUE`` with a TOML value: each creates or replaces any entry before validation. Settings
    are ``NAME=VALUE``: the value of a parameter in a single run; its nominal value stays. Raises `InputError` if the
    file cannot be read, is no TOML, or says what a scene may not say (one line a problem).
    """
    path = Path(path)
    return scene_from_tables(parse(read_text(path), str(path)), path.parent, overrides, settings)


def scene_from_toml(
    text: str, directory: Path | str, overrides: Sequence[str] = (), settings: Sequence[str] = ()
) -> Scene:
    """Validate a scene given as TOML text, with paths relative to `directory`; otherwise as `load_scene`."""
    return scene_from_tables(parse(text, "the scene's text"), directory, overrides, settings)


def scene_from_tables(
    data: dict[str, Any], directory: Path | str, overrides: Sequence[str] = (), settings: Sequence[str] = ()
) -> Scene:
    """Validate a scene given as the tables of a TOML text, which are changed, with paths relative to `directory`; see
    `load_scene`."""
    directory = Path(directory)
    apply_overrides(data, overrides)
    check_tables(data)
    said = data["scene"].get("units") if isinstance(data.get("scene"), dict) else None
    system = SAID.get(said, SI) if isinstance(said, str) else SI
    _read_tables(data, directory, system)
    add_field_parameters(data)
    for name, parameter in raw_tables(data, "parameters").items():
        entry = f"parameters.{name}.distribution"
        _read_values(parameter.get("distribution"), entry, directory, parameter.get("unit"), system)
    given = convert_parameters(data, system)
    apply_settings(data, settings, system)  # after the conversion: they are in the scene's units
    context = {"directory": directory, "units": given, "system": system, "raw": data}
    try:
        return in_si(Scene.model_validate(data, context=context))
    except ValidationError as error:
        raise explain(error, Scene, given, system) from error


def scene_to_toml(scene: Scene) -> str:
    """Return the scene with all defaults and set values; `scene_from_toml` reads it back unchanged."""
    return tomli_w.dumps(in_own_units(scene).model_dump(exclude_none=True))


def apply_overrides(data: dict[str, Any], overrides: Sequence[str]) -> None:
    """Put the value of each ``dotted.key=VALUE`` into `data`, creating tables on the way; later ones win. Raises
    `InputError` if the key or the value is not TOML, or if the key leads through something that is not a table."""
    for override in overrides:
        keys, value = _parse_override(override)
        table = data
        for depth, key in enumerate(keys[:-1], start=1):
            table = table.setdefault(key, {})
            if not isinstance(table, dict):
                parent = dotted_name(keys[:depth])
                why = f"{parent} is not a table, so it has no key '{keys[depth]}'; override {parent} itself"
                raise InputError(f"--override {shortened(override)}: {why}")
        table[keys[-1]] = value


def apply_settings(data: dict[str, Any], settings: Sequence[str], system: UnitSystem = SI) -> None:
    """Put the value of each ``NAME=VALUE`` into `data` as that parameter's value of the run; later ones win. Raises
    `InputError` if there is no such parameter or the value is no finite number, which may have its unit."""
    for setting in settings:
        name, equals, text = (part.strip() for part in setting.partition("="))
        if not (name and equals):
            raise InputError(f"--set {shortened(setting)}: NAME=VALUE is needed, such as --set r1=5e-3")
        parameters = data.get("parameters", {})
        if not isinstance(parameters, dict) or not isinstance(parameters.get(name, {}), dict):
            return  # the validation of the scene says what is wrong with its parameters
        if name not in parameters:
            is_entry = name.split(".")[0] in data and "." in name
            hint = "; --override sets entries of the scene" if is_entry else nearest_name(name, parameters)
            raise InputError(f"--set {shortened(setting)}: the scene has no parameter '{shortened(name, 40)}'{hint}")
        try:
            value = setting_of(text.strip("\"'"), parameters[name], system)
        except UnknownUnit as error:
            raise InputError(f"--set {shortened(setting)}: {error}") from error
        value = _finite(text) if value is None else value
        if value is None or not math.isfinite(value):
            needed = f"a number of the scene's units ({system}), or one with its unit, such as '5 mm', is needed"
            raise InputError(f"--set {shortened(setting)}: '{shortened(text)}' is not a finite number; {needed}")
        parameters[name]["value"] = value


def _parse_override(override: str) -> tuple[list[str], Any]:
    """Split ``dotted.key=VALUE`` at the first equals sign that leaves a TOML key before it."""
    said = f"--override {shortened(override)}"
    if "=" not in override:
        raise InputError(f"{said}: dotted.key=VALUE is needed, such as --override reduction.modes=10")
    for position in (k for k, letter in enumerate(override) if letter == "="):
        keys = _parse_key(override[:position])
        if len(keys) > DEEPEST:
            raise InputError(f"{said}: a key of {len(keys)} names; a scene's entries are at most {DEEPEST} deep")
        if keys:
            return keys, _parse_value(said, override[:position], override[position + 1 :].strip())
    key = shortened(override.partition("=")[0])
    raise InputError(f"{said}: '{key}' is not a dotted key of TOML; an example is reduction.modes=10")


def _parse_key(text: str) -> list[str]:
    if "\n" in text:
        return []
    try:
        table = tomllib.loads(f"{text} = 0")
    except (ValueError, RecursionError):
        return []
    keys = []
    while isinstance(table, dict) and table:
        ((key, table),) = table.items()
        keys.append(key)
    return keys


def _parse_value(said: str, key: str, text: str) -> Any:
    try:
        table = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        table = {}
    if list(table) != ["value"]:
        cure = f"text needs quotes, as in --override '{shortened(key.strip())}=\"text\"'"
        raise InputError(f"{said}: '{shortened(text)}' is not a TOML value; {cure}")
    return table["value"]


ENDING = ".toml"
_FOLDER = resources.files("pgmp_petsc.scene") / "templates"


def template_names() -> list[str]:
    return sorted(Path(item.name).stem for item in _FOLDER.iterdir() if item.name.endswith(ENDING))


def describe_template(name: str) -> str:
    """Return what a template shows, in a sentence without its full stop."""
    return tomllib.loads(_text(name))["scene"]["description"]


def write_template(name: str, path: Path, force: bool = False) -> list[Path]:
    """Write a template's scene to ``path`` and its meshes beside it, and return the files; by one process only.

    Comments that name the scene's file take its name; `force` lets files that are there be replaced. Raises
    `InputError` if there is no such template, or the files cannot be made where they are to be, or exist; `RunError` if
    the system fails to write.
    """
    if name not in (known := template_names()):
        close = nearest_name(name, known)
        close = "" if "known" in close else close
        raise InputError(f"template '{name}': there is none{close}; known: {', '.join(known)}")
    check_scene_file(path)
    text = _text(name)
    contents = {path: text.replace(f"{name}{ENDING}", path.name).encode()}
    for body in parse(text, name)["bodies"].values():
        if "mesh" in body:
            contents[path.parent / body["mesh"]] = (_FOLDER / body["mesh"]).read_bytes()
    write_files(contents, path, force)
    return list(contents)


def check_scene_file(path: Path) -> None:
    """Refuse a name that no scene can be written to."""
    if path.is_dir():
        raise InputError(f"scene file '{path}' is a directory; give the name of a file in it, FILE{ENDING}")
    if path.suffix.lower() != ENDING:
        raise InputError(f"scene file '{path}': scenes are TOML; name it '{path.with_suffix(ENDING)}'")
    if not path.parent.is_dir():
        raise InputError(f"scene file '{path}': directory '{path.parent}' does not exist; create it first")


def write_files(contents: Mapping[Path, bytes], path: Path, force: bool) -> None:
    """Write files, of which that at `path` is a scene; none where one cannot be written. Raises as `write_template`."""
    for target, content in contents.items():
        _check_free(target, content, force)
    for target, content in contents.items():
        with replacing(target, "scene file" if target == path else "mesh") as partial:
            partial.write_bytes(content)


def _check_free(target: Path, content: bytes, force: bool) -> None:
    """Refuse what cannot be replaced, and without force what exists and is something else."""
    if not os.path.lexists(target):
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise InputError(f"file '{target}': no permission to write in directory '{target.parent}'")
        return
    if not target.is_file():
        raise InputError(f"file '{target}' is there and no regular file; give another name")
    if not force and target.read_bytes() != content:
        raise InputError(f"file '{target}' exists; give another name, or replace it with --force")


def _text(name: str) -> str:
    return (_FOLDER / f"{name}{ENDING}").read_text(encoding="utf-8")


def changed(scene: Scene, overrides: Sequence[str], settings: Sequence[str]) -> Scene:
    """Return a scene with other entries and values of parameters; by every rank alike. Raises `InputError`.

    What the scene does not give stays open: a tolerance may choose it.
    """
    if not overrides and not settings:
        return scene
    tables = in_own_units(scene, every=False).model_dump(exclude_none=True, exclude_unset=True)
    return scene_from_tables(tables, scene.directory, overrides, settings)
