"""From a TOML file to a scene, and back to the resolved TOML that every result file carries."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from pgmp_petsc.runtime.errors import InputError, nearest_name
from pgmp_petsc.scene.messages import explain
from pgmp_petsc.scene.overrides import apply_overrides, apply_settings
from pgmp_petsc.scene.schema import Scene


def load_scene(path: Path | str, overrides: Sequence[str] = (), settings: Sequence[str] = ()) -> Scene:
    """Read and validate a scene file.

    Parameters
    ----------
    path : Path or str
        The TOML file; paths of meshes are relative to its directory.
    overrides : sequence of str
        ``dotted.key=VALUE`` with a TOML value: creates or replaces any entry before validation.
    settings : sequence of str
        ``NAME=VALUE``: the value of a parameter in a single run; its nominal value stays.

    Raises
    ------
    InputError
        If the file cannot be read, is no TOML, or says what a scene may not say (one line a problem).
    """
    path = Path(path)
    return _scene(_parse(_text(path), str(path)), path.parent, overrides, settings)


def scene_from_toml(
    text: str, directory: Path | str, overrides: Sequence[str] = (), settings: Sequence[str] = ()
) -> Scene:
    """Validate a scene given as TOML text, with paths relative to `directory`; otherwise as `load_scene`."""
    return _scene(_parse(text, "the scene's text"), Path(directory), overrides, settings)


def scene_to_toml(scene: Scene) -> str:
    """Return the scene with all defaults and set values; `scene_from_toml` reads it back unchanged."""
    return tomli_w.dumps(scene.model_dump(exclude_none=True))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        beside = [candidate.name for candidate in path.parent.glob("*.toml")]
        hint = f"{nearest_name(path.name, beside)} in {path.parent}" if beside else ""
        raise InputError(f"{path}: there is no such scene file{hint}") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: this is a directory; a scene is a TOML file") from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: not a text file in UTF-8 (byte {error.start}); a scene is a TOML file"
        ) from error
    except OSError as error:
        raise InputError(f"{path}: the scene file cannot be read ({error.strerror})") from error


def _parse(text: str, source: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except ValueError as error:  # tomllib's own, or Python's for an integer of thousands of digits
        raise InputError(f"{source}: not valid TOML: {error}") from error


def _scene(data: dict[str, Any], directory: Path, overrides: Sequence[str], settings: Sequence[str]) -> Scene:
    apply_overrides(data, overrides)
    apply_settings(data, settings)
    try:
        return Scene.model_validate(data, context={"directory": directory})
    except ValidationError as error:
        raise explain(error, Scene) from error
