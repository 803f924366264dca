"""Eigenfrequencies over the configurations of a scene, reduced models, and the cost of their accuracy in time."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from pathlib import Path

from pgmp_petsc.api.arguments import Range
from pgmp_petsc.api.declared import Argument, command
from pgmp_petsc.api.ranks import solving_ranks_of, tell, tell_remarks
from pgmp_petsc.api.result import Result, Rom
from pgmp_petsc.api.scenes import SCENE, Overrides, Parameters
from pgmp_petsc.api.sources import keeping
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bench.tradeoff import FULL, QUICK, measure_tradeoff
from pgmp_petsc.ensemble.plan import MOST_SAMPLES
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.checkpoint import Finished
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.building import build as build_model
from pgmp_petsc.studies.building import build_components
from pgmp_petsc.studies.inputs import read_scene
from pgmp_petsc.studies.modes_table import tabulate_modes
from pgmp_petsc.texts.models import report_of_build, report_of_modes
from pgmp_petsc.texts.studies import report_of_tradeoff


@command(
    "modes", "Eigenfrequencies over the configurations.", 50, report=report_of_modes, scene=SCENE,
    ending=lambda _: "modes", then="pgmp plot {file} -o pictures",
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
    comm: Comm | None = None,
) -> Result:
    """Compute eigenfrequencies of `scene` over its configurations, full-order and (with `rom`) reduced."""
    comm = solving_ranks_of(comm)
    with keeping("modes", comm, output, on_all_ranks, (scene, rom)) as keeper:
        loaded, meshes = read_scene(scene, overrides, parameters, comm, Purpose.MODES)
        tell_remarks(comm, loaded.remarks)
        tables = rom.data.rom if isinstance(rom, Rom) else rom and on_root(comm, ReducedOrderModel.read, Path(rom))
        with RankGroup.split(comm, ranks_per_angle) as group:
            table = tabulate_modes(loaded, meshes, tables, angles or loaded.reduction.angles, group)
        return keeper.result(table, loaded)


@command(
    "build", "Build the reduced or the component model of a scene (offline).", 40, report=report_of_build, scene=SCENE,
    ending=lambda given: "components" if given.get("components") else "rom", then="pgmp montecarlo {file} -n 1000",
    components=Argument("Condense the bodies to a component model, of any number of coordinates."),
    gives="With the attributes of `reduction.rom.ReducedOrderModel`, or of `models.component_file.ComponentsFile`.",
)  # fmt: skip
def build(
    scene: Scene | str | PathLike[str],
    *,
    components: bool = False,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    ranks_per_angle: int = 1,
    output: str | PathLike[str] | None = None,
    resume: bool = False,
    on_all_ranks: bool = True,
    comm: Comm | None = None,
) -> Rom:
    """Make a model of `scene` that stands alone: it runs without meshes and without PETSc.

    A reduced model has modes at the sampled configurations and tables (ROM.h5). With reduction.tolerance, or
    simulation.tolerance, what `scene` does not give is chosen so that no output has a larger error; all that was tried
    is kept in the file. With reduction.effects = "auto" effects too small to matter are left out, and terms of the
    reduced model that do are added; the estimate is printed and kept too. Otherwise what `scene` leaves out although it
    matters is said, as in pgmp check --effects.

    Finished bodies and configurations are kept in ROM.h5.partial until the file is written; `resume` takes them up,
    with any number of ranks. With a tolerance it is the runs that errors are measured against.

    A component model (`components`) has the condensed bodies alone. Each is condensed by one rank.
    """
    comm = solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        for option, is_given in (("--resume", resume), ("--ranks-per-angle", ranks_per_angle > 1)):
            if components and is_given:
                why = "bodies are condensed one a rank, over no angles, and nothing is kept on the way"
                raise InputError(f"{option} with --components: {why}; leave it out")
    purpose = Purpose.COMPONENTS if components else Purpose.BUILD
    with keeping("components" if components else "rom", comm, output, on_all_ranks, (scene,)) as keeper:
        loaded, meshes = read_scene(scene, overrides, parameters, comm, purpose)
        tell_remarks(comm, loaded.remarks)
        if components:
            return keeper.result(build_components(loaded, meshes, comm), loaded)
        with RankGroup.split(comm, ranks_per_angle) as group:
            built = build_model(loaded, meshes, group, lambda text: tell(comm, text), keeper.output, resume)
        made = keeper.result(replace(built, checkpoint=None), loaded)
        if built.checkpoint is not None:
            built.checkpoint.remove()
        return made


@command(
    "tradeoff", "What accuracy costs in time, and which setting to take.", 90, report=report_of_tradeoff, scene=SCENE,
    ending=lambda _: "tradeoff",
    quick=Argument("Measure fewer settings: within a minute for a small scene."),
    n=Argument("Number of samples that the advice is for.", "-n", "N", Range(1, MOST_SAMPLES)),
    gives="With the attributes of `results.tradeoff.Tradeoff`.",
)  # fmt: skip
def tradeoff(
    scene: Scene | str | PathLike[str],
    *,
    quick: bool = False,
    n: int = 10_000,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    output: str | PathLike[str] | None = None,
    resume: bool = False,
    on_all_ranks: bool = True,
    comm: Comm | None = None,
) -> Result:
    """Measure what accuracy costs in time for `scene`, and say which setting to take.

    Settings of the reduced model (modes, static modes, angles, interpolation, second-order terms, time step), of the
    component model, the full-order model and response surfaces are compared with a converged reference at quantiles of
    the uncertain parameters: the full-order model, or the component model where that is too dear (reference.budget).
    Refined meshes of lines tell the discretisation error. A setting that fails is listed with its reason.

    Finished settings are kept in FILE.partial until the file is written; `resume` takes them up, with any number of
    ranks.
    """
    comm = solving_ranks_of(comm)
    with keeping("tradeoff", comm, output, on_all_ranks, (scene,)) as keeper:
        loaded, meshes = read_scene(scene, overrides, parameters, comm, Purpose.TRADEOFF)
        kind, finished = {"command": "tradeoff", "quick": quick}, None
        if keeper.output is not None:
            finished = Finished(keeper.output, kind, loaded, meshes, comm, resume)
        try:
            sweep = QUICK if quick else FULL
            study = measure_tradeoff(loaded, meshes, sweep, n, comm, lambda text: tell(comm, text), finished)
        except InputError:
            if finished is not None:
                finished.forget()
            raise
        tell_remarks(comm, loaded.remarks)
        made = keeper.result(study, loaded)
        if finished is not None:
            finished.remove()
        return made
