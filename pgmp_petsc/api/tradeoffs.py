"""What accuracy costs in time, for a scene of a program."""

from __future__ import annotations

from os import PathLike, fspath
from typing import TYPE_CHECKING

from pgmp_petsc.api.arguments import checked
from pgmp_petsc.api.keeping import keeping
from pgmp_petsc.api.ranks import solving_ranks_of, tell, tell_remarks
from pgmp_petsc.api.requests import check_whole
from pgmp_petsc.api.result import Result
from pgmp_petsc.api.scenes import Overrides, Parameters, overrides_of, settings_of
from pgmp_petsc.api.sources import directory_of, scene_and_meshes
from pgmp_petsc.ensemble.allotment import MOST_SAMPLES
from pgmp_petsc.experiments.finished import Finished
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.tradeoff import measure_tradeoff
from pgmp_petsc.studies.tradeoff_settings import FULL, QUICK

if TYPE_CHECKING:
    from mpi4py import MPI


@checked
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
    """Measure what accuracy costs in time for a scene, as ``pgmp tradeoff``. Collective on `comm`.

    Parameters
    ----------
    scene, parameters, overrides, output, resume, on_all_ranks
        As of `build`.
    quick
        Whether fewer settings are measured.
    n
        Number of samples that the advice is for.

    Returns
    -------
    Result
        With the attributes of `results.tradeoff.Tradeoff`.

    Raises
    ------
    InputError, RunError
        As the command.
    """
    comm = solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        check_whole("n", n, 1, MOST_SAMPLES)
        if resume and output is None:
            raise InputError("resume: without output nothing is kept that could be taken up; give the file's name")
        texts, settings = overrides_of(overrides), settings_of(parameters)
    inputs = () if isinstance(scene, Scene) else (fspath(scene),)
    with keeping("tradeoff", comm, output, on_all_ranks, inputs) as keeper:
        loaded, meshes = scene_and_meshes(scene, Purpose.TRADEOFF, texts, settings, comm)
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
