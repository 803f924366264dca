"""The JSON schema of scenes, for editors that complete and check TOML; made from the models that validate scenes.

Draft 4 of JSON Schema, which the language servers of TOML know. It holds names, types, choices, limits of single
numbers and descriptions. What entries ask of each other (names that exist, exactly one of two keys, units) is left to
`pgmp_petsc.scene.loading`: a scene that the schema refuses is refused there too, and not the other way round.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

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
    schema = _table(found)
    # the word in place of all effects, see `Scene._defaults_of_the_reduction`
    schema["properties"]["effects"] |= {"type": ["object", "string"], "pattern": "^auto$"}
    return {
        "$schema": DIALECT,
        "title": TITLE,
        **schema,
        "description": "A mechanism, what acts on it, how it is computed and what is asked of it. SI units.",
        "definitions": {name: _table(model) for name, model in found["$defs"].items()},
    }


def schema_text() -> str:
    """Return the schema as the text of a file."""
    return json.dumps(editor_schema(), indent=1, ensure_ascii=False) + "\n"


def _table(model: Mapping[str, Any]) -> dict[str, Any]:
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
        entry["items"] = [_entry(item) for item in node["prefixItems"]]
        entry["additionalItems"] = False
    elif "items" in node:
        entry["items"] = _entry(node["items"])
    if alternatives:
        entry["anyOf"] = [_entry(one) for one in alternatives]
    if "oneOf" in node:
        entry["oneOf"] = [_entry(one) for one in node["oneOf"]]
    if "patternProperties" in node:
        entry["patternProperties"] = {key: _entry(one) for key, one in node["patternProperties"].items()}
        entry["additionalProperties"] = False
    elif isinstance(node.get("additionalProperties"), Mapping):
        entry["additionalProperties"] = _entry(node["additionalProperties"])
    return entry


def _sentence(text: str) -> str:
    """Return a description on one line."""
    return " ".join(text.replace("``", "`").split())
