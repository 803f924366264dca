"""Reduced models that a program builds, and files that it reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pgmp_petsc.api.ranks import ranks_of, solving_ranks_of, tell, tell_remarks
from pgmp_petsc.api.result import Result, Rom, wrong
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.scene import Scene

if TYPE_CHECKING:
    from mpi4py import MPI


def build(scene: Scene, *, ranks_per_angle: int = 1, comm: MPI.Comm | None = None) -> Rom:
    """Build the reduced model of a scene, as ``pgmp build``. Collective on `comm`.

    Parameters
    ----------
    scene
        As from `load` or `compose`.
    ranks_per_angle
        Ranks that share one eigenproblem.

    Raises
    ------
    InputError
        If a mesh cannot be read, the scene has what reduced models do not have, or a tolerance cannot be met.
    RunError
        If the computation fails.
    """
    comm = solving_ranks_of(comm)
    from pgmp_petsc.mechanism.capabilities import Purpose
    from pgmp_petsc.runtime.groups import RankGroup
    from pgmp_petsc.studies.building import Built
    from pgmp_petsc.studies.building import build as build_model
    from pgmp_petsc.studies.inputs import with_meshes

    with agreed(comm, "looking at the scene"):
        check_scene(scene)
    scene, meshes = on_root(comm, with_meshes, scene, Purpose.BUILD)
    tell_remarks(comm, scene.remarks)
    with RankGroup.split(comm, ranks_per_angle, "ranks_per_angle") as group:
        built = build_model(scene, meshes, group, lambda text: tell(comm, text))

    def handing_out_the_model() -> Built:
        return built

    rom = Rom("rom", on_root(comm, handing_out_the_model), comm, scene.directory)
    tell_remarks(comm, tuple(remark for remark in rom.remarks if remark not in scene.remarks))
    return rom


def read(path: str | PathLike[str], *, comm: MPI.Comm | None = None) -> Result:
    """Read a result file of any kind but a shard: a `Rom`, or a `Result`. Collective on `comm`.

    Raises
    ------
    InputError
        If it is no whole result of this program.
    """
    comm, path = ranks_of(comm), Path(path)
    kind = on_root(comm, _kind_of, path)
    if kind == "rom":
        # its modules need PETSc, which all ranks start together
        solving_ranks_of(comm)
    data = on_root(comm, _read, path, kind)
    return (Rom if kind == "rom" else Result)(kind, data, comm, path.parent, path)


def _kind_of(path: Path) -> str:
    from pgmp_petsc.results.readers import READERS
    from pgmp_petsc.runtime.files import open_file

    with open_file(path, ("rom", *READERS)) as file:
        return str(file.attrs["kind"])


def _read(path: Path, kind: str) -> Any:
    if kind != "rom":
        from pgmp_petsc.results.readers import READERS

        return in_memory(READERS[kind].read(path))
    from pgmp_petsc.studies.building import Built

    return Built.read(path)


def in_memory(data: Any) -> Any:
    """Return a result whose columns are arrays, where they are read from a file when they are asked for."""
    found = {item.name: getattr(data, item.name) for item in fields(data)}
    lazy = {
        name: dict(value) for name, value in found.items() if isinstance(value, Mapping) and type(value) is not dict
    }
    return replace(data, **lazy) if lazy else data


def check_scene(scene: object) -> None:
    """Refuse what is no scene."""
    if not isinstance(scene, Scene):
        raise wrong("scene", scene, "a scene, as from pgmp.load or pgmp.compose")
