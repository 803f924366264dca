"""Displacements and stresses over whole bodies at any instants of a reduced run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pgmp_petsc.api.arguments import settings_of, wrong
from pgmp_petsc.api.declared import Argument, interface
from pgmp_petsc.api.ranks import solving_ranks_of
from pgmp_petsc.api.result import Result, Rom
from pgmp_petsc.runtime.agreement import agreed, on_root

if TYPE_CHECKING:
    from mpi4py import MPI

    from pgmp_petsc.results.body_fields import BodyField


@interface(
    "By body, with the attributes of `results.body_fields.BodyField`: positions, deformation, "
    "at_nodes, at_cells and others, an entry along the first axis for every instant.",
    rom=Argument("The reduced model."),
    run=Argument("A run of it, as from `simulate` or `read`."),
    times=Argument("Instants within the run, s."),
)
def fields(rom: Rom, run: Result, times: Sequence[float], *, comm: MPI.Comm | None = None) -> dict[str, BodyField]:
    """Return bodies as they are at any instants of a run of a reduced model.

    Between steps the reduced coordinates are interpolated linearly: bodies keep their shape.

    Raises
    ------
    InputError
        If the run is not of this model, an instant is outside the run, or no mesh of a body is known.
    """
    comm = solving_ranks_of(comm)
    from pgmp_petsc.models import ReducedModel
    from pgmp_petsc.studies.field_frames import fields_at
    from pgmp_petsc.studies.inputs import scene_of_rom

    with agreed(comm, "looking at the arguments"):
        if run.kind != "trajectory":
            raise wrong("run", run, "a run, as from pgmp.simulate or pgmp.read")

    def finding_the_fields() -> dict[str, BodyField]:
        settings = settings_of(run.record.parameters)
        scene = scene_of_rom(rom.data.rom, rom.directory, (), settings, "the reduced model")
        return fields_at(ReducedModel(scene, rom.data.rom), run.data, times)

    return on_root(comm, finding_the_fields)
