"""Messages about wrong and strange entries: `dotted.name = received: what is allowed`, one line a problem."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from pgmp_petsc.base.errors import InputError, nearest_name, shortened
from pgmp_petsc.base.units import QUANTITY, SI, UnitSystem
from pgmp_petsc.declare.ideas import Found
from pgmp_petsc.scene.fields import NAMED, AnyScene, Quantified, notes_on

MAX_LINES = 8
MAX_RECEIVED = 60
DEEPEST = 16  # tables and lists within each other; a scene needs six

#: What is allowed, by the type of pydantic's error, with the fields of its context.
ALLOWED = {
    "float_type": "a number is needed",
    "float_parsing": "a number is needed",
    "finite_number": "a finite number is needed",
    "int_type": "an integer is needed",
    "bool_type": "true or false is needed",
    "string_type": "text in quotes is needed",
    "string_too_short": "text that is not empty is needed",
    "model_type": "a table is needed",
    "model_attributes_type": "a table is needed",
    "dict_type": "a table is needed",
    "tuple_type": "a list in brackets is needed",
    "too_short": "{min_length} or more entries are needed",
    "greater_than": "must be greater than {gt}",
    "greater_than_equal": "must be at least {ge}",
    "less_than": "must be less than {lt}",
    "less_than_equal": "must be at most {le}",
}
#: What a place or direction needs, by the dimension of the scene.
COMPONENTS = {2: "two numbers (x, y) are needed in the plane", 3: "three numbers (x, y, z) are needed in space"}
#: What pydantic appends to the location of a refused key of a table.
KEY_MARK = "[key]"
_NOTHING = object()
#: SI units of numbers in what entries mean.
_UNITS = re.compile(r"\((?:(?:kg|Pa|rad|[NJWms])\d?(?:[ /]|(?=\))))+\)")


def input_error(problems: Sequence[str]) -> InputError:
    """Return one error for several problems, cut to a readable number of lines."""
    lines = list(problems)
    if len(lines) > MAX_LINES:
        lines[MAX_LINES - 1 :] = [f"... and {len(lines) - MAX_LINES + 1} more problems"]
    return InputError("\n".join(lines))


def problem(entry: str, allowed: str, received: object = _NOTHING) -> str:
    """Return the line about one entry."""
    return f"{entry}: {allowed}" if received is _NOTHING else f"{entry} = {toml_text(received)}: {allowed}"


def unknown(entry: str, kind: str, name: str, known: Iterable[str]) -> str:
    """Return the line about a name that nothing has."""
    if kind == "parameter" and re.match(QUANTITY, name):
        return problem(entry, "a number of any quantity is in the units of the scene; give it without quotes", name)
    return problem(entry, f"there is no such {kind}{nearest_name(name, known)}", name)


def toml_text(value: object) -> str:
    """Return `value` as it would be in a scene, shortened if it is long."""
    return shortened(inline_toml(value), MAX_RECEIVED)


def dotted_name(keys: Sequence[str | int]) -> str:
    """Return the dotted name of an entry, with keys quoted as in TOML and rows of a list in brackets."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{_toml_key(key)}" for key in keys).removeprefix(".")


def explain(error: ValidationError, model: type[BaseModel], units: Mapping[str, str], system: UnitSystem) -> InputError:
    """Turn what pydantic says about tables read as a `model` into messages for the author of the scene.

    Parameters that were converted had these units, and were converted to those of the system.
    """
    problems = []
    for details in error.errors(include_url=False):
        table, name, *_ = *details["loc"], "", ""
        text = _UNITS.sub(lambda found: system.unit(found[0]), _explain(details, model))
        if table == "parameters" and name in units and details["type"] == "refusal" and re.search(r"\d", text):
            own = "SI units" if system == SI else str(system)
            text += f" (in {own}; the parameter's unit is {units[name]})"
        problems.append(text)
    return input_error(problems)


def _explain(details: Mapping[str, Any], model: type[BaseModel]) -> str:
    location, kind, context, received = (details["loc"], details["type"], details.get("ctx", {}), details["input"])
    keys, members = _follow(model, location)
    entry = dotted_name(keys)
    if kind in ("missing", "extra_forbidden"):
        (parent,) = _follow(model, location[:-1])[1]
        if kind == "extra_forbidden":
            choice = _choice(keys[-1], list(parent.model_fields), f"unknown key{_home(model, location)}")
            return problem(entry, choice, received)
        field = parent.model_fields[location[-1]]
        about = field.description or ""
        if notes_on(field, Quantified) and "parameter" not in about:
            what, mark, more = about.partition(";")
            about = f"{what}, {NAMED}{mark}{more}"
        return problem(entry, f"missing; needed: {about}" if about else "missing")
    if kind in ("union_tag_invalid", "union_tag_not_found"):  # of the key that says which kind of table it is
        key, allowed = context["discriminator"].strip("'"), [_tag(member) for member in members]
        if kind == "union_tag_not_found":
            return problem(f"{entry}.{key}", f"missing (allowed: {', '.join(allowed)})")
        choice = _choice(received[key], allowed)
        plugin = "" if "did you mean" in choice else "; if a plugin has it, give --plugin FILE.py"
        return problem(f"{entry}.{key}", choice + plugin, received[key])
    if kind == "literal_error":
        allowed = [one.strip("'") for one in re.split(", | or ", context["expected"])]
        return problem(entry, _choice(received, allowed), received)
    if kind == "refusal":  # by one of the scene's own validators, perhaps on account of one key of a table
        received = _NOTHING if location[-1] == KEY_MARK else received
        if context["key"]:
            keys = [*keys, context["key"]]
            received = received.get(context["key"], _NOTHING) if isinstance(received, Mapping) else _NOTHING
        return problem(dotted_name(keys), context["allowed"], received)
    listed = getattr(members[0], "model_fields", ()) if kind == "model_type" and len(members) == 1 else ()
    words = ALLOWED[kind].format(**context) if kind in ALLOWED else details["msg"]
    words += f", with {', '.join(listed)}" if listed else ""
    if words.startswith(ALLOWED["model_type"]) and get_origin(_follow(model, location[:-1])[1][0]) is dict:
        words += _home(model, location)
    return problem(entry, words, received)


def _home(model: type[BaseModel], location: Sequence[str | int]) -> str:
    """Return which table has a key that is not known where it is: one around, since TOML puts what follows a table's
    head into that table, or else those of the scene that do."""
    for end in range(len(location) - 2, 0, -1):
        keys, members = _follow(model, location[:end])
        if len(members) == 1 and location[-1] in getattr(members[0], "model_fields", {}):
            head = dotted_name(_follow(model, location[:-1])[0])
            return f"; {dotted_name(keys)} has this key: write it there, above any head [{head}]"
    known = {name: _members(field.annotation)[0] for name, field in model.model_fields.items()}
    others = [f"[{name}]" for name, table in known.items() if location[-1] in getattr(table, "model_fields", {})]
    return f"; {' and '.join(others)} {'has' if len(others) == 1 else 'have'} this key" if others else ""


def _choice(received: object, allowed: Sequence[str], what: str = "unknown") -> str:
    """Return what is allowed, with the nearest name ahead where there is one."""
    hint = nearest_name(received, allowed) if isinstance(received, str) else ""
    return f"{what}{hint if 'did you mean' in hint else ''} (allowed: {', '.join(allowed)})"


def _follow(model: type[BaseModel], location: Sequence[str | int]) -> tuple[list[str | int], list[Any]]:
    """Follow pydantic's location of an error through the fields of `model`.

    Returns the keys in the user's own file, without the types of tables that pydantic puts between them,
    and the types allowed at the end (none behind an unknown key).
    """
    keys: list[str | int] = []
    members: list[Any] = [model]
    for key in location:
        if key == KEY_MARK:
            break
        if len(members) > 1:
            members = [member for member in members if _tag(member) == key]
            continue
        if key == _only_tag(members):
            continue
        keys.append(key)
        (kind,) = members
        if get_origin(kind) is None:
            members = _members(kind.model_fields[key].annotation) if key in kind.model_fields else []
        else:
            members = _members(get_args(kind)[1 if get_origin(kind) is dict else 0])
    return keys, members


def _only_tag(members: Sequence[Any]) -> str | None:
    """Return the `type` of the only member of a family, which pydantic puts into locations as those of several."""
    fields = getattr(members[0], "model_fields", {}) if len(members) == 1 else {}
    return _tag(members[0]) if "type" in fields and get_args(fields["type"].annotation) else None


def _members(annotation: Any) -> list[Any]:
    """Return the alternatives of a type, without None and without the notes around it."""
    while get_origin(annotation) is Annotated:
        annotation, *notes = get_args(annotation)
        found = [note.family.found() for note in notes if isinstance(note, Found)]
        if found:
            return list(found[0])
    if get_origin(annotation) in (Union, UnionType):
        alternatives = [member for member in get_args(annotation) if member is not type(None)]
        return [member for alternative in alternatives for member in _members(alternative)]
    return [annotation]


def _tag(model: type[BaseModel]) -> str:
    """Return the value of `type` or `shape` that selects a model."""
    key = next(key for key in ("type", "shape") if key in model.model_fields)
    return get_args(model.model_fields[key].annotation)[0]


def _toml_key(key: str) -> str:
    key = shortened(key, MAX_RECEIVED)
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key, ensure_ascii=False)


def inline_toml(value: object) -> str:
    """Return a value as TOML on one line, whatever its length."""
    if isinstance(value, Mapping):
        inside = ", ".join(f"{_toml_key(str(key))} = {inline_toml(item)}" for key, item in value.items())
        return f"{{ {inside} }}" if value else "{}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(inline_toml, value)) + "]"
    if isinstance(value, (str, bool)):
        return json.dumps(value, ensure_ascii=False)
    return str(value)


@dataclass(frozen=True)
class Finding:
    """One strange entry."""

    entry: str  # dotted name
    reason: str  # what is strange about it and the cure
    received: tuple[Any, ...]  # its value, if it has one to show
    refused: bool = False  # whether it cannot be meant; otherwise it may be, and the scene is computed with a warning

    def text(self, own: Callable[[str, Any], Any]) -> str:
        """Return the line about it; `own` returns the value of an entry in the units of the scene."""
        return problem(self.entry, self.reason, *(own(self.entry, value) for value in self.received))


def doubt(entry: str, reason: str, *received: object) -> Finding:
    """Return what probably is not meant; `received` is the entry's value, if it has one to show."""
    return Finding(entry, reason, received)


def refusal(entry: str, reason: str, *received: object) -> Finding:
    """Return what cannot be meant; `received` is the entry's value, if it has one to show."""
    return Finding(entry, reason, received, refused=True)


def named(scene: AnyScene, entry: str, value: float | str) -> tuple[str, float]:
    """Return the entry that a number is in, and the number: of a parameter's name, the parameter's own entry."""
    if not isinstance(value, str):
        return entry, value
    parameter = scene.parameters[value]
    return f"parameters.{value}.{'nominal' if parameter.value is None else 'value'}", parameter.current
