"""The JSON schema of scenes, for editors that complete and check TOML, made from the models that validate scenes; and
every entry that a scene may have as a page, made from that schema.

Draft 4 of JSON Schema, which the language servers of TOML know. It holds names, types, choices, limits of single
numbers and descriptions. What entries ask of each other (names that exist, exactly one of two keys, units) is left to
`pgmp_petsc.scene.loading`: a scene that the schema refuses is refused there too, and not the other way round.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

from pgmp_petsc.base.units import QUANTITY, UNITS
from pgmp_petsc.scene.schema import Scene

DIALECT = "http://json-schema.org/draft-04/schema#"
TITLE = "Scene of pgmp"
#: Limits as pydantic writes them beside its own validators, and whether the limit itself is left out.
_LIMITS = {
    "ge": ("minimum", False),
    "gt": ("minimum", True),
    "exclusiveMinimum": ("minimum", True),
    "le": ("maximum", False),
    "lt": ("maximum", True),
    "exclusiveMaximum": ("maximum", True),
}
_KEPT = ("type", "enum", "description", "default", "minItems", "maxItems", "minLength", "minProperties", "pattern")


def editor_schema() -> dict[str, Any]:
    """Return the schema of a scene as plain data.

    Every table is in ``definitions`` by the name of its model; tables of the user's own names
    (``[bodies.NAME]``) have one entry in ``patternProperties``.
    """
    found = Scene.model_json_schema()
    schema = _table_schema(found)
    # the word in place of all effects, see `Scene._defaults_of_the_reduction`
    schema["properties"]["effects"] |= {"type": ["object", "string"], "pattern": "^auto$"}
    return {
        "$schema": DIALECT,
        "title": TITLE,
        **schema,
        "description": "A mechanism, what acts on it, how it is computed and what is asked of it. SI units, or "
        "those of `scene.units`.",
        "definitions": {name: _table_schema(model) for name, model in found["$defs"].items()},
    }


def schema_text() -> str:
    return json.dumps(editor_schema(), indent=1, ensure_ascii=False) + "\n"


def _table_schema(model: Mapping[str, Any]) -> dict[str, Any]:
    """Return a model's table, its kind (``type``, ``shape``) first, then what is needed."""
    needed = list(model.get("required", ()))
    names = sorted(model["properties"], key=lambda name: (name not in ("type", "shape"), name not in needed))
    table = {
        "type": "object",
        "description": _sentence(model.get("description", "")),
        "properties": {name: _entry(model["properties"][name]) for name in names},
        "additionalProperties": False,
    }
    more = model.get("additionalProperties", False)
    if isinstance(more, Mapping):
        table["additionalProperties"] = _entry(more)
    return table | ({"required": needed} if needed else {})


def _entry(node: Mapping[str, Any]) -> dict[str, Any]:
    """Return one entry in the words of draft 4: nothing beside a reference, no null (TOML has none), no const."""
    alternatives = [one for one in node.get("anyOf", ()) if one.get("type") != "null"]
    if len(alternatives) == 1:
        return _entry({**alternatives[0], **{key: value for key, value in node.items() if key != "anyOf"}})
    entry = {key: node[key] for key in _KEPT if key in node}
    if "description" in entry:
        entry["description"] = _sentence(entry["description"])
    # an entry without a default is absent; defaults of tables are those of their own entries
    if entry.get("default", 0) is None or isinstance(entry.get("default"), Mapping):
        del entry["default"]
    if "const" in node:
        entry["enum"] = [node["const"]]
    if "$ref" in node:
        return entry | {"allOf": [{"$ref": node["$ref"].replace("#/$defs/", "#/definitions/")}]}
    for key, (limit, is_open) in _LIMITS.items():
        if key in node:
            entry[limit] = node[key]
            entry |= {f"exclusive{limit.capitalize()}": True} if is_open else {}
    if "maximum" in node:
        entry["maximum"] = min(node["maximum"], entry.get("maximum", node["maximum"]))
    if "minimum" in node:
        entry["minimum"] = node["minimum"]
    if "prefixItems" in node:
        entry |= {"items": [_entry(item) for item in node["prefixItems"]], "additionalItems": False}
    elif "items" in node:
        entry["items"] = _entry(node["items"])
    lists = {"anyOf": alternatives, "oneOf": node.get("oneOf")}
    entry |= {key: [_entry(one) for one in parts] for key, parts in lists.items() if parts}
    if "patternProperties" in node:
        named = {key: _entry(one) for key, one in node["patternProperties"].items()}
        entry |= {"patternProperties": named, "additionalProperties": False}
    elif isinstance(node.get("additionalProperties"), Mapping):
        entry["additionalProperties"] = _entry(node["additionalProperties"])
    return entry


def _sentence(text: str) -> str:
    return " ".join(text.replace("``", "`").split())


MADE_BY = "made by `pgmp schema`"
HEAD = f"""# All entries of a scene

Every entry that a scene may have, in the order in which its tables are best written. This page is {MADE_BY} from the
models that read scenes, and a test holds it to them: `pgmp schema -o docs/scene_reference.md` writes it again.
[scenes.md](scenes.md) says what the entries mean together, what is refused and what is warned of;
[effects.md](effects.md) what acts how.

Numbers are in SI units, or in those of `scene.units`. A number that has a unit in these tables may be a text with
another one of its kind, such as `"500 mm"` or `"30 deg"`. An entry with "or a parameter" takes a number or the name of
one of `[parameters]`. What has neither a default nor the word *needed* is absent unless a scene has it. Names that a
scene chooses begin with a letter or `_` and go on with letters, digits, `_` and `-`.
"""
#: Units in texts that are written otherwise than in `base.units.UNITS`.
SPELLED = {"Nm": "N m", "Nm/rad": "N m/rad", "Nm s/rad": "N m s/rad", "Hz": "Hz"}


def reference_page() -> str:
    """Return the page as Markdown. Raises `ValueError` if a model is in none of its tables."""
    schema = editor_schema()
    models = schema["definitions"]
    parts, done = [HEAD], set()
    waiting: list[tuple[str, str]] = []
    for name in Scene.model_fields:
        entry, needed = schema["properties"][name], " *Needed.*" if name in schema["required"] else ""
        said = entry["description"]
        about = "" if entry.get("allOf") else f"{said[:1].upper()}{said[1:]}."  # a table alone says what it is for
        parts.append("\n\n".join([f"## {name}", *filter(None, [f"{about}{needed}".strip()])]) + "\n")
        kinds = list(_references(entry))
        for kind in kinds:
            place = f"[{name}]" if entry.get("allOf") else f"[{name}.NAME]"
            parts.append(_table(models[kind], place, kind if len(kinds) > 1 else "", waiting))
            done.add(kind)
        if not kinds:  # a table of the scene's own names in tables of such names
            (inner,) = entry["patternProperties"].values()
            (value,) = inner["patternProperties"].values()
            parts.append(f"`[{name}]` holds `NAME = {{ OTHER_NAME = {allowed(value)} }}`.\n")
    parts.append("## Tables within these\n")
    while waiting:
        kind, place = waiting.pop(0)
        if kind not in done:
            done.add(kind)
            parts.append(_table(models[kind], place, kind, waiting))
    missing = models.keys() - done
    if missing:
        raise ValueError(f"models that the page does not reach: {', '.join(sorted(missing))}")
    return "\n".join(parts).rstrip() + "\n"


def _table(model: Mapping[str, Any], place: str, kind: str, waiting: list[tuple[str, str]]) -> str:
    """Return a model as a heading, a sentence and a table of its entries; note the tables that these hold."""
    lines = [f"### {heading(model, kind)}\n"] if kind else []
    lines += [f"{model['description']}\n"] if model["description"] else []
    lines += [f"`{place}`" + (f" with `{_selector(model)}`" if _selector(model) else "") + "\n"]
    rows = []
    for name, entry in model["properties"].items():
        if name in ("type", "shape") and len(entry.get("enum", ())) == 1:
            continue
        inner = list(_references(entry))
        waiting += [(one, f"{place[:-1]}.{name}]") for one in inner]
        default = f"`{_toml(entry['default'])}`" if "default" in entry else ""
        default = "*needed*" if name in model.get("required", ()) else default
        text = entry.get("description", "").replace("|", "\\|")
        rows.append(f"| `{name}` | {allowed(entry)} | {unit_of(entry)} | {default} | {text} |")
    if isinstance(more := model["additionalProperties"], Mapping):
        rows.append(f"| any other name | {allowed(more)} | | | its arguments, by their names |")
    if rows:
        lines += ["| entry | allowed | unit | default | meaning |", "|---|---|---|---|---|", *rows, ""]
    return "\n".join(lines)


def heading(model: Mapping[str, Any], kind: str) -> str:
    """Return the heading of a model: what a scene writes to have it, or else the model's name."""
    selector = _selector(model)
    return selector.partition('"')[2].rstrip('"') if selector else kind


def _selector(model: Mapping[str, Any]) -> str:
    for key in ("type", "shape"):
        choices = model["properties"].get(key, {}).get("enum", ())
        if len(choices) == 1:
            return f'{key} = "{choices[0]}"'
    return ""


def allowed(entry: Mapping[str, Any]) -> str:
    """Return what an entry may be, in words."""
    if "enum" in entry:
        return ", ".join(f"`{json.dumps(one)}`" for one in entry["enum"])
    if "anyOf" in entry:
        limits = {key: entry[key] for key in entry if "imum" in key}
        kinds = [one for one in entry["anyOf"] if one.get("pattern") != QUANTITY]  # numbers may be texts with a unit
        words = [allowed(one | limits if one.get("type") == "number" else one) for one in kinds]
        is_quantity = {one.get("type") for one in kinds} == {"number", "string"}
        return f"{words[0]} or a parameter" if is_quantity else " or ".join(words)
    if "allOf" in entry or "oneOf" in entry:
        return "table"
    if "patternProperties" in entry:
        (inner,) = entry["patternProperties"].values()
        return f"{{ NAME = {allowed(inner)}, ... }}"
    if entry["type"] == "array":
        if isinstance(entry["items"], list):
            return f"[{', '.join(allowed(item) for item in entry['items'])}]"
        item = allowed(entry["items"])
        low, high = entry.get("minItems"), entry.get("maxItems")
        return f"[{', '.join([item] * low)}], in space one more" if (low, high) == (2, 3) else f"list of {item}"
    if entry["type"] in ("number", "integer"):
        return ("number" if entry["type"] == "number" else "integer") + _bounds(entry)
    if entry["type"] == "string":
        return '"OWNER:POINT"' if entry.get("pattern", "").startswith("^[^:]") else "text"
    return {"boolean": "`true`, `false`", "object": "table"}[entry["type"]]


def _bounds(entry: Mapping[str, Any]) -> str:
    words = ""
    for limit, is_open, closed in (("minimum", "above", "from"), ("maximum", "below", "to")):
        if limit in entry:
            words += f" {is_open if entry.get(f'exclusive{limit.capitalize()}') else closed} {_toml(entry[limit])}"
    return words


def unit_of(entry: Mapping[str, Any]) -> str:
    """Return the units that a description has in brackets."""
    found = []
    for text in re.findall(r"\(([^()]*)\)", entry.get("description", "")):
        for word in re.split(r" or |, ", text):
            unit = SPELLED.get(word, word)
            if (unit in UNITS and unit != "1") or unit in SPELLED.values():
                found.append(unit)
    return ", ".join(dict.fromkeys(found))


def _references(entry: Mapping[str, Any]) -> Iterator[str]:
    """Yield the names of the models that an entry refers to, in order."""
    if "$ref" in entry:
        yield entry["$ref"].rpartition("/")[2]
    for key in ("allOf", "anyOf", "oneOf"):
        for one in entry.get(key, ()):
            yield from _references(one)
    for one in entry.get("patternProperties", {}).values():
        yield from _references(one)
    for key in ("items", "additionalProperties"):
        if isinstance(entry.get(key), Mapping):
            yield from _references(entry[key])


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else f"{value}"
