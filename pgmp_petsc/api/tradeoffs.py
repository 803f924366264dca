"""The cost of accuracy in time, for a scene."""

from __future__ import annotations

from os import PathLike, fspath
from typing import TYPE_CHECKING

from pgmp_petsc.api.arguments import Range
from pgmp_petsc.api.declared import Argument, command
from pgmp_petsc.api.ranks import solving_ranks_of, tell, tell_remarks
from pgmp_petsc.api.result import Result
from pgmp_petsc.api.scenes import Overrides, Parameters
from pgmp_petsc.api.sources import SCENE, directory_of, keeping, scene_and_meshes
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench.candidates import FULL, QUICK
from pgmp_petsc.bench.finished import Finished
from pgmp_petsc.bench.tradeoff import measure_tradeoff
from pgmp_petsc.ensemble.plan import MOST_SAMPLES
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.scene import Scene
from pgmp_petsc.texts.tradeoff_table import report

if TYPE_CHECKING:
    from mpi4py import MPI


@command(
    "tradeoff", "What accuracy costs in time, and which setting to take.", 90, report=report, scene=SCENE,
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
    comm: MPI.Comm | None = None,
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
    inputs = () if isinstance(scene, Scene) else (fspath(scene),)
    with keeping("tradeoff", comm, output, on_all_ranks, inputs) as keeper:
        loaded, meshes = scene_and_meshes(scene, Purpose.TRADEOFF, overrides, parameters, comm)
        kind, finished = {"command": "tradeoff", "quick": quick}, None
        if keeper.output is not None:
            finished = Finished(keeper.output, kind, loaded, meshes, comm, resume)
        try:
            sweep = QUICK if quick else FULL
            study = measure_tradeoff(loaded, meshes, sweep, n, quick, comm, finished, lambda text: tell(comm, text))
        except InputError:
            if finished is not None:
                finished.forget()
            raise
        tell_remarks(comm, loaded.remarks)
        made = keeper.result(study, directory_of(scene), loaded.remarks)
        if finished is not None:
            finished.remove()
        return made
