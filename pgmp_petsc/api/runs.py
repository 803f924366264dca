"""Single runs, and bodies at any instants of a run."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike

from pgmp_petsc import models
from pgmp_petsc.api.arguments import Points, PointSet, ResultOrDataset, settings_of, wrong
from pgmp_petsc.api.declared import Argument, command, interface
from pgmp_petsc.api.ranks import solving_ranks_of
from pgmp_petsc.api.result import Result, Rom, StoppedRun
from pgmp_petsc.api.scenes import Overrides, Parameters
from pgmp_petsc.api.sources import SOURCE, AnySource, Origin, keeping, scene_of_built
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.results.trajectory import BodyField
from pgmp_petsc.studies.simulate import simulate as simulated
from pgmp_petsc.texts.models import report_of_run


@command(
    "simulate", "One run over time, of any model.", 60, report=report_of_run, ending=lambda _: "run",
    then="pgmp report {file} -o report.html", source=SOURCE,
    gives="With the attributes of `results.Trajectory`. Where `parameters` has arrays, or is a table (DataFrame, "
    "Dataset), a Dataset of xarray over all its points and time, NaN where a run failed (`sample.status`).",
)  # fmt: skip
def simulate(
    source: AnySource,
    parameters: Points | Parameters | None = None,
    *,
    model: str | None = None,
    overrides: Overrides = (),
    output: str | PathLike[str] | None = None,
    on_all_ranks: bool = True,
    comm: Comm | None = None,
) -> ResultOrDataset:
    """Run a model that was built, or with `model` the full-order or the component model of a scene.

    A run that stops before its end has exit status 1; what was computed is written.

    Raises
    ------
    StoppedRun
        If the run stops before its end; it holds what was computed.
    """
    comm, points = solving_ranks_of(comm), parameters if isinstance(parameters, PointSet) else None
    with agreed(comm, "looking at the arguments"):
        settings = parameters if points is None else settings_of(points.fixed)
        if points is not None and output is not None:
            raise InputError(
                "output: runs over arrays of parameters are a Dataset of xarray, which writes files of its own "
                "(to_netcdf, to_zarr); leave it out"
            )
    origin = Origin.of(comm, source, model, overrides, settings)
    if points is not None:
        from pgmp_petsc.api.sweeps import sweep  # takes a noticeable time, and few runs are many

        return sweep(origin, points, comm, on_all_ranks)
    with keeping("trajectory", comm, output, on_all_ranks, (origin.path,)) as keeper:
        prepared = origin.settled(comm)
        data = simulated(prepared, comm)
        # why it stopped, the first of its remarks, is the error
        reason = data.record.remarks[:1] if data is not None and data.why_stopped else ()
        run = keeper.result(data, prepared.scene, reason)
    why = comm.bcast("" if data is None else data.why_stopped)
    if why:
        holds = "the error's result" if output is None else output
        raise StoppedRun(f"{why}; {holds} holds the run up to there", run)
    return run


@interface(
    "By body, with the attributes of `results.trajectory.BodyField`: positions, deformation, "
    "at_nodes, at_cells and others, an entry along the first axis for every instant.",
    rom=Argument("The reduced model."),
    run=Argument("A run of it, as from `simulate` or `read`."),
    times=Argument("Instants within the run, s."),
)
def fields(rom: Rom, run: Result, times: Sequence[float], *, comm: Comm | None = None) -> dict[str, BodyField]:
    """Return bodies as they are at any instants of a run of a reduced model.

    Between steps the reduced coordinates are interpolated linearly: bodies keep their shape.

    Raises
    ------
    InputError
        If the run is not of this model, an instant is outside the run, or no mesh of a body is known.
    """
    comm = solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        if rom.kind != "rom":
            raise wrong("rom", rom, "a reduced model: states of component runs are not kept")
        if run.kind != "trajectory":
            raise wrong("run", run, "a run, as from pgmp.simulate or pgmp.read")

    def finding_the_fields() -> dict[str, BodyField]:
        from pgmp_petsc.studies.field_frames import fields_at  # runs do not wait for it

        scene = scene_of_built(rom.data.rom, rom.directory, (), settings_of(run.record.parameters), "the reduced model")
        found = fields_at(models.ReducedModel(scene, rom.data.rom), run.data.in_si_units(), times)
        return {name: field.converted(scene.system.converting) for name, field in found.items()}

    return on_root(comm, finding_the_fields)
