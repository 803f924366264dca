"""From a TOML file to a scene, and back to the resolved TOML that every result file carries."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import ValidationError

from pgmp_petsc.scene.messages import explain
from pgmp_petsc.scene.overrides import apply_overrides, apply_settings
from pgmp_petsc.scene.random_fields import add_field_parameters
from pgmp_petsc.scene.raw_tables import check_tables, parse, read_text, read_values
from pgmp_petsc.scene.schema import Scene
from pgmp_petsc.scene.units import convert_parameters


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
    return _scene(parse(read_text(path), str(path)), path.parent, overrides, settings)


def scene_from_toml(
    text: str, directory: Path | str, overrides: Sequence[str] = (), settings: Sequence[str] = ()
) -> Scene:
    """Validate a scene given as TOML text, with paths relative to `directory`; otherwise as `load_scene`."""
    return _scene(parse(text, "the scene's text"), Path(directory), overrides, settings)


def scene_from_tables(
    tables: dict[str, Any], directory: Path | str, overrides: Sequence[str] = (), settings: Sequence[str] = ()
) -> Scene:
    """Validate a scene given as the tables of a TOML text, with paths relative to `directory`; see `load_scene`.

    The tables are changed.
    """
    return _scene(tables, Path(directory), overrides, settings)


def scene_to_toml(scene: Scene) -> str:
    """Return the scene with all defaults and set values; `scene_from_toml` reads it back unchanged."""
    return tomli_w.dumps(scene.model_dump(exclude_none=True))


def _scene(data: dict[str, Any], directory: Path, overrides: Sequence[str], settings: Sequence[str]) -> Scene:
    apply_overrides(data, overrides)
    check_tables(data)
    add_field_parameters(data)
    read_values(data, directory)
    given = convert_parameters(data)
    apply_settings(data, settings)  # after the conversion: they are in SI units
    try:
        return Scene.model_validate(data, context={"directory": directory, "units": given})
    except ValidationError as error:
        raise explain(error, Scene) from error
