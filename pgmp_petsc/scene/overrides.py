"""Changes from the command line, on raw tables: `--override dotted.key=VALUE` and `--set NAME=VALUE`."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from typing import Any

from pgmp_petsc.runtime.errors import InputError, nearest_name, shortened
from pgmp_petsc.scene.messages import DEEPEST, dotted_name


def apply_overrides(data: dict[str, Any], overrides: Sequence[str]) -> None:
    """Put the value of each ``dotted.key=VALUE`` into `data`, creating tables on the way; later ones win.

    Raises
    ------
    InputError
        If the key or the value is not TOML, or if the key leads through something that is not a table.
    """
    for override in overrides:
        keys, value = _parse_override(override)
        table = data
        for depth, key in enumerate(keys[:-1], start=1):
            table = table.setdefault(key, {})
            if not isinstance(table, dict):
                raise InputError(
                    f"--override {shortened(override)}: {dotted_name(keys[:depth])} is not a table, so it has no key "
                    f"'{keys[depth]}'; override {dotted_name(keys[:depth])} itself"
                )
        table[keys[-1]] = value


def apply_settings(data: dict[str, Any], settings: Sequence[str]) -> None:
    """Put the value of each ``NAME=VALUE`` into `data` as that parameter's value of the run; later ones win.

    Raises
    ------
    InputError
        If there is no such parameter or the value is not a finite number.
    """
    for setting in settings:
        name, equals, text = (part.strip() for part in setting.partition("="))
        if not (name and equals):
            raise InputError(f"--set {shortened(setting)}: NAME=VALUE is needed, such as --set r1=5e-3")
        parameters = data.get("parameters", {})
        if not isinstance(parameters, dict) or not isinstance(parameters.get(name, {}), dict):
            return  # the validation of the scene says what is wrong with its parameters
        if name not in parameters:
            raise InputError(
                f"--set {shortened(setting)}: the scene has no parameter '{name}'{nearest_name(name, parameters)}"
            )
        parameters[name]["value"] = _finite(setting, text)


def _finite(setting: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        needed = "the number of SI units alone is needed"
        raise InputError(f"--set {shortened(setting)}: '{shortened(text)}' is not a finite number; {needed}")
    return value


def _parse_override(override: str) -> tuple[list[str], Any]:
    """Split ``dotted.key=VALUE`` at the first equals sign that leaves a TOML key before it."""
    if "=" not in override:
        raise InputError(
            f"--override {shortened(override)}: dotted.key=VALUE is needed, such as --override reduction.modes=10"
        )
    position = override.find("=")
    while position >= 0:
        keys = _parse_key(override[:position])
        if keys:
            if len(keys) > DEEPEST:
                raise InputError(
                    f"--override {shortened(override)}: a key of {len(keys)} names; a scene's entries are at most "
                    f"{DEEPEST} deep"
                )
            return keys, _parse_value(override, override[position + 1 :])
        position = override.find("=", position + 1)
    raise InputError(
        f"--override {shortened(override)}: '{shortened(override.partition('=')[0])}' is not a dotted key of TOML; "
        "an example is reduction.modes=10"
    )


def _parse_key(text: str) -> list[str]:
    """Return the keys of a dotted TOML key, empty if it is none."""
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


def _parse_value(override: str, text: str) -> Any:
    try:
        table = tomllib.loads(f"value = {text.strip()}")
    except (ValueError, RecursionError):
        table = {}
    if list(table) != ["value"]:
        key = override[: len(override) - len(text) - 1].strip()
        raise InputError(
            f"--override {shortened(override)}: '{shortened(text.strip())}' is not a TOML value; text needs quotes, as "
            "in "
            f"--override '{shortened(key)}=\"text\"'"
        )
    return table["value"]
