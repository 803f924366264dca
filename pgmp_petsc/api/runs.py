"""Single runs of a program: over time, and with derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING

from pgmp_petsc.api.arguments import checked
from pgmp_petsc.api.keeping import keeping
from pgmp_petsc.api.ranks import solving_ranks_of
from pgmp_petsc.api.result import Result, Rom, StoppedRun
from pgmp_petsc.api.scenes import Overrides, Parameters
from pgmp_petsc.api.sources import AnySource, Origin
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.studies.sensitivities import sensitivities as differentiated
from pgmp_petsc.studies.simulate import simulate as simulated

if TYPE_CHECKING:
    from mpi4py import MPI


@checked
def simulate(
    source: AnySource,
    parameters: Parameters | None = None,
    *,
    model: str | None = None,
    overrides: Overrides = (),
    output: str | PathLike[str] | None = None,
    on_all_ranks: bool = True,
    comm: MPI.Comm | None = None,
) -> Result:
    """Run a model over time, as ``pgmp simulate``. Collective on `comm`.

    Parameters
    ----------
    source
        A reduced model, or its file; or, with `model`, a scene or its file.
    parameters
        Values of parameters in this run, SI units; as in `load`.
    model
        ``"full"`` or ``"components"`` with a scene; ``"reduced"`` or nothing with a reduced model.
    overrides
        Entries of the scene, as in `load`; with a reduced model those that its tables do not depend on.
    output
        File to write; a table where its name ends in .csv. A run that stops before its end is written too.
    on_all_ranks
        Whether all ranks get the result; else the first alone has its data.

    Returns
    -------
    Result
        With the attributes of `results.Trajectory`.

    Raises
    ------
    StoppedRun
        If the run stops before its end; it holds what was computed.
    InputError, RunError
        As the command.
    """
    comm = solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        origin = Origin.of(source, model, overrides, parameters)
    with keeping("trajectory", comm, output, on_all_ranks, (origin.path,)) as keeper:
        prepared = origin.settled(comm)
        data = simulated(prepared, comm)
        # why it stopped, the first of its remarks, is the error
        reason = data.record.remarks[:1] if data is not None and data.why_stopped else ()
        run = keeper.result(data, origin.directory, (*prepared.scene.remarks, *reason))
    why = comm.bcast("" if data is None else data.why_stopped)
    if why:
        holds = "the error's result" if output is None else output
        raise StoppedRun(f"{why}; {holds} holds the run up to there", run)
    return run


@checked
def sensitivities(
    rom: Rom | str | PathLike[str],
    names: Sequence[str] = (),
    *,
    parameters: Parameters | None = None,
    overrides: Overrides = (),
    output: str | PathLike[str] | None = None,
    on_all_ranks: bool = True,
    comm: MPI.Comm | None = None,
) -> Result:
    """Differentiate the outputs of a run with parameters, as ``pgmp sensitivities``. Collective on `comm`.

    Parameters
    ----------
    rom
        A reduced model, or its file.
    names
        Parameters to differentiate with; all of the scene where none is named.
    parameters, overrides, output, on_all_ranks
        As of `simulate`.

    Returns
    -------
    Result
        With the attributes of `results.Derivatives`.

    Raises
    ------
    InputError, RunError
        As the command.
    """
    comm = solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        origin = Origin.of(rom, None, overrides, parameters)
    with keeping("sensitivities", comm, output, on_all_ranks, (origin.path,)) as keeper:
        model = origin.settled(comm)
        return keeper.result(differentiated(model, tuple(names), comm), origin.directory, model.scene.remarks)
