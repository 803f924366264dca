"""Scenes of a program: from a file or from tables, and with other values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pgmp_petsc.api.arguments import checked, overrides_of, plain, settings_of
from pgmp_petsc.api.ranks import ranks_of, tell_remarks
from pgmp_petsc.declare.plugins import take
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.scene import Scene, load_scene, scene_from_tables

if TYPE_CHECKING:
    from mpi4py import MPI

Overrides = Mapping[str, object] | Sequence[str] | None
Parameters = Mapping[str, float] | Sequence[str]


@checked
def use(path: str | PathLike[str], *, comm: MPI.Comm | None = None) -> None:
    """Take the ideas that a Python file declares, effects and outputs, which scenes may name from then on. Collective on
    `comm`.

    Every rank runs the file. One that is in use already is left as it is; one that has changed is read again.

    Parameters
    ----------
    path
        A file as docs/extending.md shows it.

    Raises
    ------
    InputError
        If it cannot be read, is not Python, fails, has no idea in it, or has one that is not whole or whose name is
        taken; with the file and line.
    """
    with agreed(ranks_of(comm), "reading plugins"):
        take(Path(path))


@checked
def load(
    path: str | PathLike[str],
    overrides: Overrides = (),
    parameters: Parameters | None = None,
    *,
    comm: MPI.Comm | None = None,
) -> Scene:
    """Return the scene of a TOML file. Collective on `comm`.

    Parameters
    ----------
    path
        The file; paths of meshes are relative to its folder.
    overrides
        Entries to create or replace before the scene is validated: a mapping of dotted keys to values, or texts
        ``"dotted.key=VALUE"`` with a TOML value.
    parameters
        Values of parameters in single runs, SI units, as a mapping or as texts ``"name=VALUE"``; their nominal values
        stay.

    Raises
    ------
    InputError
        If the file cannot be read, is no TOML, or says what a scene may not say.
    """
    comm = ranks_of(comm)
    with agreed(comm, "reading the scene"):
        changes = overrides_of(overrides), settings_of(parameters)
    found = on_root(comm, load_scene, Path(path), *changes)
    tell_remarks(comm, found.remarks)
    return found


@checked
def compose(tables: Mapping[str, Any], directory: str | PathLike[str] = ".", *, comm: MPI.Comm | None = None) -> Scene:
    """Return the scene of tables as a TOML file has them. Collective on `comm`; those of the first rank count.

    Parameters
    ----------
    tables
        ``{"scene": {"name": ...}, "bodies": {...}, ...}``; numbers and arrays of numpy may stand for plain ones. They
        are left as they are.
    directory
        Folder that paths of meshes are relative to.

    Raises
    ------
    InputError
        If they say what a scene may not say.
    """
    comm = ranks_of(comm)

    def composing_the_scene() -> Scene:
        return scene_from_tables(plain(tables), Path(directory))

    found = on_root(comm, composing_the_scene)
    tell_remarks(comm, found.remarks)
    return found


def changed(scene: Scene, overrides: Overrides, parameters: Parameters | None) -> Scene:
    """Return a scene with other entries and values of parameters; by every rank alike. Raises `InputError`.

    What the scene does not give stays open: a tolerance may choose it.
    """
    texts, settings = overrides_of(overrides), settings_of(parameters)
    if not texts and not settings:
        return scene
    tables = scene.model_dump(exclude_none=True, exclude_unset=True)
    return scene_from_tables(tables, scene.directory, texts, settings)
