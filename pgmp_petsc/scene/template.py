"""Commented scenes that run as they are, to begin with: package data in ``scene/templates``.

A template is a scene, and where its bodies need meshes the files that it names, which are written beside it.
"""

from __future__ import annotations

import os
import tomllib
from importlib import resources
from pathlib import Path

from pgmp_petsc.runtime.errors import InputError, nearest_name
from pgmp_petsc.runtime.files import replacing
from pgmp_petsc.scene.loading import parse

ENDING = ".toml"
_FOLDER = resources.files("pgmp_petsc.scene") / "templates"


def template_names() -> list[str]:
    """Return the names of all templates."""
    return sorted(Path(item.name).stem for item in _FOLDER.iterdir() if item.name.endswith(ENDING))


def describe_template(name: str) -> str:
    """Return what a template shows, in a sentence without its full stop."""
    return tomllib.loads(_text(name))["scene"]["description"]


def write_template(name: str, path: Path, force: bool = False) -> list[Path]:
    """Write a template's scene to ``path`` and its meshes beside it, and return the files; by one process only.

    Parameters
    ----------
    name
        One of `template_names`.
    path
        Of the scene; comments that name the scene's file take its name.
    force
        Whether files that are there may be replaced.

    Raises
    ------
    InputError
        If there is no such template, or the files cannot be made where they are to be, or exist.
    RunError
        If the system fails to write.
    """
    if name not in template_names():
        known = ", ".join(template_names())
        close = nearest_name(name, template_names())
        raise InputError(f"template '{name}': there is none{close if 'known' not in close else ''}; known: {known}")
    if path.is_dir():
        raise InputError(f"scene file '{path}' is a directory; give the name of a file in it, FILE{ENDING}")
    if path.suffix.lower() != ENDING:
        raise InputError(f"scene file '{path}': scenes are TOML; name it '{path.with_suffix(ENDING)}'")
    if not path.parent.is_dir():
        raise InputError(f"scene file '{path}': directory '{path.parent}' does not exist; create it first")
    text = _text(name)
    contents = {path: text.replace(f"{name}{ENDING}", path.name).encode()}
    for body in parse(text, name)["bodies"].values():
        if "mesh" in body:
            contents[path.parent / body["mesh"]] = (_FOLDER / body["mesh"]).read_bytes()
    for target, content in contents.items():
        _check_free(target, content, force)
    for target, content in contents.items():
        with replacing(target, "scene file" if target == path else "mesh") as partial:
            partial.write_bytes(content)
    return list(contents)


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
