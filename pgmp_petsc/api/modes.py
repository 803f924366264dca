"""Eigenfrequencies over the configurations of a scene, and reduced models."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike, fspath
from typing import TYPE_CHECKING

from pgmp_petsc.api.arguments import Range
from pgmp_petsc.api.declared import Argument, command
from pgmp_petsc.api.ranks import solving_ranks_of, tell, tell_remarks
from pgmp_petsc.api.result import Result, Rom
from pgmp_petsc.api.scenes import Overrides, Parameters
from pgmp_petsc.api.sources import SCENE, directory_of, keeping, model_of_rom, scene_and_meshes
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.building import build as build_model
from pgmp_petsc.studies.modes_table import tabulate_modes
from pgmp_petsc.texts.models import report_of_build, report_of_modes

if TYPE_CHECKING:
    from mpi4py import MPI


@command(
    "modes", "Eigenfrequencies over the configurations.", 50, report=report_of_modes, scene=SCENE,
    rom=Argument("Add the frequencies of this reduced model, or of its file.", word="ROM.h5"),
    angles=Argument("Angles of each coordinate; reduction.angles if not given.", word="N", allowed=Range(2, 10**6)),
    gives="With the attributes of `results.ModesTable`.",
)  # fmt: skip
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
    """Compute eigenfrequencies of `scene` over its configurations, full-order and (with `rom`) reduced."""
    comm = solving_ranks_of(comm)
    inputs = [fspath(one) for one in (scene, rom) if isinstance(one, (str, PathLike))]
    with keeping("modes", comm, output, on_all_ranks, inputs) as keeper:
        loaded, meshes = scene_and_meshes(scene, Purpose.MODES, overrides, parameters, comm)
        tell_remarks(comm, loaded.remarks)
        reduced = None if rom is None else model_of_rom(rom, comm)
        with RankGroup.split(comm, ranks_per_angle) as group:
            table = tabulate_modes(loaded, meshes, reduced, angles or loaded.reduction.angles, group)
        return keeper.result(table, directory_of(scene), loaded.remarks)


@command(
    "build",
    "Build the reduced model of a scene (offline).",
    40,
    report=report_of_build,
    scene=SCENE,
    gives="With the attributes of `reduction.rom.ReducedOrderModel`.",
)
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
    """Compute modes at the sampled configurations of `scene` and write the reduced model (ROM.h5).

    With reduction.tolerance, or simulation.tolerance, what `scene` does not give is chosen so that no output has a
    larger error; all that was tried is kept in the file. With reduction.effects = "auto" effects too small to matter
    are left out, and terms of the reduced model that do are added; the estimate is printed and kept too. Otherwise what
    `scene` leaves out although it matters is said, as in pgmp check --effects.

    Finished bodies and configurations are kept in ROM.h5.partial until the file is written; `resume` takes them up,
    with any number of ranks. With a tolerance it is the runs that errors are measured against.
    """
    comm = solving_ranks_of(comm)
    inputs = () if isinstance(scene, Scene) else (fspath(scene),)
    with keeping("rom", comm, output, on_all_ranks, inputs) as keeper:
        loaded, meshes = scene_and_meshes(scene, Purpose.BUILD, overrides, parameters, comm)
        tell_remarks(comm, loaded.remarks)
        with RankGroup.split(comm, ranks_per_angle) as group:
            built = build_model(loaded, meshes, group, lambda text: tell(comm, text), keeper.output, resume)
        made = keeper.result(replace(built, checkpoint=None), directory_of(scene), loaded.remarks)
        if built.checkpoint is not None:
            built.checkpoint.remove()
        return made
