"""Eigenfrequencies over the configurations of a program's scene.

Reduced models that a program builds.
"""

from __future__ import annotations

from dataclasses import replace
from os import PathLike, fspath
from typing import TYPE_CHECKING

from pgmp_petsc.api.arguments import checked
from pgmp_petsc.api.keeping import keeping
from pgmp_petsc.api.ranks import solving_ranks_of, tell, tell_remarks
from pgmp_petsc.api.requests import check_whole
from pgmp_petsc.api.result import Result, Rom
from pgmp_petsc.api.scenes import Overrides, Parameters, overrides_of, settings_of
from pgmp_petsc.api.sources import directory_of, model_of_rom, scene_and_meshes
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.building import build as build_model
from pgmp_petsc.studies.modes_table import tabulate_modes

if TYPE_CHECKING:
    from mpi4py import MPI


MOST_ANGLES = 10**6


@checked
def frequencies(
    scene: Scene | str | PathLike[str],
    *,
    rom: Rom | str | PathLike[str] | None = None,
    angles: int | None = None,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    ranks_per_angle: int = 1,
    output: str | PathLike[str] | None = None,
    on_all_ranks: bool = True,
    comm: MPI.Comm | None = None,
) -> Result:
    """Compute eigenfrequencies of a scene over its configurations, as ``pgmp modes``. Collective on `comm`.

    Parameters
    ----------
    scene, parameters, overrides, ranks_per_angle, output, on_all_ranks
        As of `build`.
    rom
        A reduced model, or its file, whose frequencies are added.
    angles
        Of each coordinate; otherwise as ``reduction.angles`` says.

    Returns
    -------
    Result
        With the attributes of `results.ModesTable`.

    Raises
    ------
    InputError, RunError
        As the command.
    """
    comm = solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        if angles is not None:
            check_whole("angles", angles, 2, MOST_ANGLES)
        texts, settings = overrides_of(overrides), settings_of(parameters)
    inputs = [fspath(one) for one in (scene, rom) if isinstance(one, (str, PathLike))]
    with keeping("modes", comm, output, on_all_ranks, inputs) as keeper:
        loaded, meshes = scene_and_meshes(scene, Purpose.MODES, texts, settings, comm)
        tell_remarks(comm, loaded.remarks)
        reduced = None if rom is None else model_of_rom(rom, comm)
        with RankGroup.split(comm, ranks_per_angle) as group:
            table = tabulate_modes(loaded, meshes, reduced, angles or loaded.reduction.angles, group)
        return keeper.result(table, directory_of(scene), loaded.remarks)


@checked
def build(
    scene: Scene | str | PathLike[str],
    *,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    ranks_per_angle: int = 1,
    output: str | PathLike[str] | None = None,
    resume: bool = False,
    on_all_ranks: bool = True,
    comm: MPI.Comm | None = None,
) -> Rom:
    """Build the reduced model of a scene, as ``pgmp build``. Collective on `comm`.

    Parameters
    ----------
    scene
        As from `load` or `compose`, or its file.
    parameters, overrides, on_all_ranks
        As of `simulate`.
    ranks_per_angle
        Ranks that share one eigenproblem.
    output, resume
        File to write, beside which finished parts are kept until then, and whether to take up what a killed build left
        there. Without a file nothing is kept on the way.

    Raises
    ------
    InputError
        If a mesh cannot be read, the scene has what reduced models do not have, or a tolerance cannot be met.
    RunError
        If the computation fails.
    """
    comm = solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        if resume and output is None:
            raise InputError("resume: without output nothing is kept that could be taken up; give the file's name")
        texts, settings = overrides_of(overrides), settings_of(parameters)
    inputs = () if isinstance(scene, Scene) else (fspath(scene),)
    with keeping("rom", comm, output, on_all_ranks, inputs) as keeper:
        loaded, meshes = scene_and_meshes(scene, Purpose.BUILD, texts, settings, comm)
        tell_remarks(comm, loaded.remarks)
        with RankGroup.split(comm, ranks_per_angle) as group:
            built = build_model(loaded, meshes, group, lambda text: tell(comm, text), keeper.output, resume)
        made = keeper.result(replace(built, checkpoint=None), directory_of(scene), loaded.remarks)
        if built.checkpoint is not None:
            built.checkpoint.remove()
        return made
