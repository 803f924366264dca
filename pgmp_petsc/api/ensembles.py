"""Many runs of a program: ensembles, their shards and failed samples, and rare events."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from pgmp_petsc.api.arguments import checked, wrong
from pgmp_petsc.api.better import Correction, better_models
from pgmp_petsc.api.keeping import Keeper, keeping
from pgmp_petsc.api.ranks import solving_ranks_of
from pgmp_petsc.api.requests import Request, Stopping, check_whole
from pgmp_petsc.api.result import Result
from pgmp_petsc.api.scenes import Overrides, Parameters, overrides_of
from pgmp_petsc.api.sources import REDUCED, AnySource, Origin
from pgmp_petsc.ensemble.allotment import LARGEST_SEED, MOST_SAMPLES, Plan, Shard
from pgmp_petsc.ensemble.checkpoint import remove_checkpoint
from pgmp_petsc.ensemble.retry import read_earlier
from pgmp_petsc.ensemble.runner import run_ensemble
from pgmp_petsc.ensemble.sample_file import Columns
from pgmp_petsc.ensemble.sampling import refuse_drawn
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.results.rare_event import KIND as RARE_EVENT
from pgmp_petsc.results.shard import read_shard
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.runtime.progress import announce
from pgmp_petsc.scene import Scene

if TYPE_CHECKING:
    from mpi4py import MPI

    from pgmp_petsc.models import FullModel


@checked
def montecarlo(
    source: AnySource,
    n: int | None = None,
    seed: int = 0,
    *,
    sampler: str | None = None,
    samples: str | PathLike[str] | Columns | None = None,
    shard: Shard | None = None,
    correct: Sequence[Correction] = (),
    stopping: Stopping | None = None,
    parameters: Parameters | None = None,
    model: str | None = None,
    overrides: Overrides = (),
    ranks_per_sample: int = 1,
    output: str | PathLike[str] | None = None,
    resume: bool = False,
    on_all_ranks: bool = True,
    comm: MPI.Comm | None = None,
) -> Result:
    """Integrate samples and describe their distributions, as ``pgmp montecarlo``. Collective on `comm`.

    Parameters
    ----------
    source, parameters, model, overrides, on_all_ranks
        As of `simulate`; parameters are those that are not drawn.
    n
        Number of samples; may be left out with `samples`, or with a budget.
    seed
        Of the random streams: the same samples for any number of ranks.
    sampler
        ``random``, ``latin_hypercube``, ``sobol`` or ``saltelli``; otherwise as ``ensemble.sampler`` says.
    samples
        What the samples are from, columns named as parameters, SI units: a CSV or HDF5 file, a DataFrame, or a mapping
        of names to numbers, of which those of the first rank count.
    shard
        Which part of the samples is integrated alone; `merge` joins the files of all.
    correct
        Better models, which run the first samples too.
    stopping
        What ends it before its last sample.
    ranks_per_sample
        Ranks that share one sample of the full-order model.
    output, resume
        File to write, beside which finished samples are kept until then, and whether to take up what a killed run left
        there. Without a file nothing is kept on the way.

    Returns
    -------
    Result
        With the attributes of `results.Ensemble`, or of `results.shard.ShardSamples`. Samples that failed are in it,
        with their reasons.

    Raises
    ------
    InputError, RunError
        As the command.
    """
    start, comm = time.monotonic(), solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        asked = Request.of(n, seed, sampler, samples, shard, correct, stopping, model or REDUCED)
        _check_keeping(output, resume, ranks_per_sample, asked.model)
        origin = Origin.of(source, model, (*overrides_of(overrides), *asked.overrides), parameters)

    def check(scene: Scene) -> None:
        refuse_drawn(scene, origin.settings)
        asked.check_scene(scene)

    with ExitStack() as stack:
        group = stack.enter_context(RankGroup.split(comm, ranks_per_sample, "--ranks-per-sample"))
        keeper = stack.enter_context(keeping(asked.kind, comm, output, on_all_ranks, (origin.path,)))
        place = stack.enter_context(_place_of(keeper))
        prepared = origin.settled(comm, check, many=True)
        _say_if_small(prepared, ranks_per_sample, comm)
        file = on_root(comm, asked.table, prepared, origin.settings)
        with agreed(comm, "looking at what is asked for"):
            asked = asked.with_table(file)
            plan = asked.plan(place, resume, file)
            asked.check_design(prepared.scene, file)
            stop = asked.stopping.stop(prepared.scene, start)
        better = better_models(asked.correct, prepared, origin.name, comm)
        found = run_ensemble(prepared, plan, group, stop, better)
        return _kept(keeper, found, plan, origin, prepared.scene)


@checked
def retry_failed(
    source: AnySource,
    failed: str | PathLike[str],
    *,
    parameters: Parameters | None = None,
    model: str | None = None,
    overrides: Overrides = (),
    ranks_per_sample: int = 1,
    output: str | PathLike[str] | None = None,
    resume: bool = False,
    on_all_ranks: bool = True,
    comm: MPI.Comm | None = None,
) -> Result:
    """Try the failed samples of an ensemble's file further, with smaller steps, and take the others from it, as ``pgmp
    montecarlo --retry-failed``. Collective on `comm`.

    Parameters
    ----------
    source, parameters, model, overrides, ranks_per_sample, output, resume, on_all_ranks
        As of `montecarlo`, and as they were in the run that wrote the file.
    failed
        The file.

    Returns
    -------
    Result
        With the attributes of `results.Ensemble`.

    Raises
    ------
    InputError, RunError
        As the command.
    """
    comm = solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        _check_keeping(output, resume, ranks_per_sample, model or REDUCED)
        origin = Origin.of(source, model, overrides, parameters)

    def check(scene: Scene) -> None:
        refuse_drawn(scene, origin.settings)

    with ExitStack() as stack:
        group = stack.enter_context(RankGroup.split(comm, ranks_per_sample, "--ranks-per-sample"))
        keeper = stack.enter_context(keeping("ensemble", comm, output, on_all_ranks, (origin.path, failed)))
        place = stack.enter_context(_place_of(keeper))
        prepared = origin.settled(comm, check, many=True)
        _say_if_small(prepared, ranks_per_sample, comm)
        earlier = on_root(comm, read_earlier, Path(failed), prepared)
        plan = Plan(earlier.n_samples, earlier.seed, place, resume, earlier.file)
        found = run_ensemble(prepared, plan, group, earlier=earlier)
        return _kept(keeper, found, plan, origin, prepared.scene)


@checked
def rare_event(
    source: AnySource,
    event: str,
    n: int,
    seed: int = 0,
    *,
    parameters: Parameters | None = None,
    model: str | None = None,
    overrides: Overrides = (),
    output: str | PathLike[str] | None = None,
    on_all_ranks: bool = True,
    comm: MPI.Comm | None = None,
) -> Result:
    """Find the probability of a rare event with at most `n` samples, as ``pgmp montecarlo --rare``. Collective on
    `comm`.

    Parameters
    ----------
    source, seed, parameters, model, overrides, output, on_all_ranks
        As of `montecarlo`.
    event
        ``"slider_deformation < -2e-4"``, ``"ever"`` before it for any time in the run, or the label of one of
        ensemble.probabilities.
    n
        Number of samples.

    Returns
    -------
    Result
        With the attributes of `results.rare_event.RareEvent`.

    Raises
    ------
    InputError, RunError
        As the command.
    """
    from pgmp_petsc.ensemble.rare_run import event_of, run_rare_event  # a noticeable time, and few ask for one

    comm = solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        check_whole("n", n, 1, MOST_SAMPLES)
        check_whole("seed", seed, 0, LARGEST_SEED)
        origin = Origin.of(source, model, overrides, parameters)

    def check(scene: Scene) -> None:
        refuse_drawn(scene, origin.settings)
        event_of(event, scene)

    with keeping(RARE_EVENT, comm, output, on_all_ranks, (origin.path,)) as keeper:
        prepared = origin.settled(comm, check, many=True)
        found = run_rare_event(prepared, event_of(event, prepared.scene), n, seed, comm)
        return keeper.result(found, origin.directory, prepared.scene.remarks)


@checked
def merge(
    files: Sequence[str | PathLike[str]],
    *,
    output: str | PathLike[str] | None = None,
    on_all_ranks: bool = True,
    comm: MPI.Comm | None = None,
) -> Result:
    """Join all shards of an ensemble to what one run gives, as ``pgmp merge``. Collective on `comm`.

    Parameters
    ----------
    files
        Of all shards, in any order.
    output, on_all_ranks
        As of `montecarlo`.

    Returns
    -------
    Result
        With the attributes of `results.Ensemble`.

    Raises
    ------
    InputError
        If they are not all shards of one ensemble, each once.
    RunError
        If the system fails to write.
    """
    from pgmp_petsc.ensemble.shards import Shards  # as above

    comm = solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        if not files:
            raise wrong("files", files, "a list of names of shards' files, and not an empty one")
    paths = [Path(file) for file in files]

    def merged(place: Path) -> Ensemble:
        with ExitStack() as opened:
            shards = [opened.enter_context(read_shard(path)) for path in paths]
            return Shards(paths, shards, place.resolve().parent).described(place)

    with keeping("ensemble", comm, output, on_all_ranks, paths) as keeper, _place_of(keeper) as place:
        with agreed(comm, "merging"):
            found = merged(place) if comm.rank == 0 else None
        return keeper.result(found, paths[0].parent)


def _check_keeping(output: object, resume: bool, ranks_per_sample: int, model: str) -> None:
    """Refuse what has no part in a run."""
    if resume and output is None:
        raise InputError("resume: without output nothing is kept that could be taken up; give the file's name")
    if ranks_per_sample > 1 and model != "full":
        what = "component modes" if model == "components" else "a reduced model"
        raise InputError(f"--ranks-per-sample = {ranks_per_sample}: samples of {what} are small; leave it out")


def _say_if_small(model: FullModel, ranks_per_sample: int, comm: MPI.Comm) -> None:
    """Say that samples are too small to be shared among ranks, which wait for each other in every step."""
    if ranks_per_sample == 1:
        return
    from pgmp_petsc.studies.simulate import UNKNOWNS_PER_RANK  # reduced samples never need it

    n = model.kinematics.mechanism.n_dofs
    if n < UNKNOWNS_PER_RANK * ranks_per_sample:
        announce(
            f"--ranks-per-sample = {ranks_per_sample}: a sample has {n} unknowns, less than {UNKNOWNS_PER_RANK} for "
            "each of its ranks, which takes longer than on fewer of them; leave it out, and ranks take their own",
            comm,
        )


def _kept(keeper: Keeper, found: object, plan: Plan, origin: Origin, scene: Scene) -> Result:
    """Return the result, and remove what was kept on the way once it is written, unless a rule is not met yet: then
    more samples may go on from it. Collective on the ranks."""
    result = keeper.result(found, origin.directory, scene.remarks)
    goes_on = isinstance(found, Ensemble) and found.stopping is not None and not all(found.stopping.met)
    if keeper.output is not None and keeper.comm.rank == 0 and not goes_on:
        remove_checkpoint(plan)
    return result


@contextmanager
def _place_of(keeper: Keeper) -> Iterator[Path]:
    """Yield where samples are kept on the way: beside their file, or in a folder of their own, which goes at the end.

    Collective on the ranks; what is kept is the first's.
    """
    if keeper.output is not None:
        yield keeper.output
        return
    folder = on_root(keeper.comm, _temporary_folder)
    try:
        yield folder / "ensemble.h5"
    finally:
        if keeper.comm.rank == 0:
            shutil.rmtree(folder, ignore_errors=True)


def _temporary_folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="pgmp_ensemble_"))
