"""Many runs: ensembles, their shards and failed samples, and rare events."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from pgmp_petsc.api.arguments import Range
from pgmp_petsc.api.declared import Argument, command, interface
from pgmp_petsc.api.ranks import solving_ranks_of
from pgmp_petsc.api.requests import Correction, Request, Stopping, better_models, drawn_by, read_budget, read_part
from pgmp_petsc.api.result import Result
from pgmp_petsc.api.scenes import Overrides, Parameters
from pgmp_petsc.api.sources import REDUCED, SOURCE, AnySource, Keeper, Origin, keeping
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.progress import announce
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.ensemble.checkpoint import remove_checkpoint
from pgmp_petsc.ensemble.failures import read_earlier
from pgmp_petsc.ensemble.integration import run_ensemble
from pgmp_petsc.ensemble.plan import LARGEST_SEED, MOST_SAMPLES, SAMPLERS, Plan, Shard
from pgmp_petsc.ensemble.sample_file import Columns
from pgmp_petsc.ensemble.sampling import refuse_drawn
from pgmp_petsc.models import FullModel
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.ranks.groups import UNKNOWNS_PER_RANK, RankGroup
from pgmp_petsc.results.ensemble import Ensemble, ShardSamples, read_shard
from pgmp_petsc.results.statistics import RareEvent
from pgmp_petsc.scene import Scene
from pgmp_petsc.texts.ensemble_table import report as report_of_ensemble
from pgmp_petsc.texts.ensemble_table import report_of_rare_event, report_of_shard

PER_SAMPLE = Argument(
    "With --full: ranks that share one sample, for large meshes; groups of ranks have samples of their own.",
    word="N",
    allowed=Range(1),
)
NUMBER = Argument(
    "Number of samples; with `samples` all that the file has, if not given.", "-n", "N", Range(1, MOST_SAMPLES)
)
SEED = Argument(
    "Random seed; its samples are the same for any number of ranks.", word="S", allowed=Range(0, LARGEST_SEED)
)
SAMPLER = Argument("How samples are chosen; otherwise as ensemble.sampler says.", allowed=SAMPLERS)
# why options of ensembles have no part in the search for a rare event
_FOLLOW = "samples follow from those before them"
_WITHOUT = {
    "sampler": _FOLLOW,
    "samples": _FOLLOW,
    "shard": _FOLLOW,
    "resume": "its samples are not kept on the way, so that a killed run begins anew",
    "ranks_per_sample": "ranks take samples of their own",
    "correct": "better models would have rare events of their own",
    "stopping": "its own rule says when enough is known, and it takes the samples that it is given",
    "failed": "it has no samples to be tried again",
}


@interface(
    "With the attributes of `results.Ensemble`.",
    source=SOURCE,
    failed=Argument(
        "Try the failed samples of an ensemble's FILE further, with smaller steps; take the others from it.",
        "--retry-failed", "FILE", "the file of an ensemble",
    ),
    sampler=SAMPLER,
    ranks_per_sample=PER_SAMPLE,
)  # fmt: skip
def retry_failed(
    source: AnySource,
    failed: str | PathLike[str],
    *,
    sampler: str | None = None,
    parameters: Parameters | None = None,
    model: str | None = None,
    overrides: Overrides = (),
    ranks_per_sample: int = 1,
    output: str | PathLike[str] | None = None,
    resume: bool = False,
    on_all_ranks: bool = True,
    comm: Comm | None = None,
) -> Result:
    """Try the failed samples of an ensemble's file further, with smaller steps, and take the others from it.

    What else is given is as it was in the run that wrote the file.
    """
    comm = solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        _check_sharing(ranks_per_sample, model or REDUCED)
        origin = Origin.of(source, model, (*overrides, *drawn_by(sampler)), parameters)

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


@interface(
    "With the attributes of `results.statistics.RareEvent`.",
    source=SOURCE,
    event=Argument(
        'Find the probability of a rare event with at most N samples: "slider_deformation < -2e-4", "ever" before it '
        "for any time in the run, or the label of one of ensemble.probabilities.", "--rare", "EVENT",
        "a text such as 'slider_deformation < -2e-4'",
    ),
    n=NUMBER,
    seed=SEED,
)  # fmt: skip
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
    comm: Comm | None = None,
) -> Result:
    """Find the probability of a rare event with at most `n` samples."""
    from pgmp_petsc.ensemble.rare_run import event_of, run_rare_event  # a noticeable time, and few ask for one

    comm = solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        origin = Origin.of(source, model, overrides, parameters)

    def check(scene: Scene) -> None:
        refuse_drawn(scene, origin.settings)
        event_of(event, scene)

    with keeping(RareEvent.kind, comm, output, on_all_ranks, (origin.path,)) as keeper:
        prepared = origin.settled(comm, check, many=True)
        found = run_rare_event(prepared, event_of(event, prepared.scene), n, seed, comm)
        return keeper.result(found, origin.directory, prepared.scene.remarks)


def choose(given: Mapping[str, Any], comm: Comm) -> Callable[..., Result]:
    """Return which function samples are integrated by; refuse what has no part in it."""
    if "event" in given:
        for name in _WITHOUT:
            if name in given and (name, given[name]) != ("ranks_per_sample", 1):
                raise InputError(f"{_as_given(name, given[name])} with --rare: {_WITHOUT[name]}; leave it out")
        if "n" not in given:
            raise InputError("-n: missing; give the number of samples that --rare may take at most")
        return rare_event
    if "failed" in given:
        for name in ("n", "seed", "samples", "shard", "correct", "stopping"):
            if name in given:
                option = _as_given(name, given[name]).split()[0]
                why = f"--retry-failed {given['failed']} takes samples and their number from the file"
                raise InputError(f"{option}: {why}; leave one of them out")
        return retry_failed
    return montecarlo


def _as_given(name: str, value: Any) -> str:
    """Return an option with its value as a command line has it."""
    if name == "stopping":
        return f'--until "{value.until[0]}"' if value.until else f"--budget {value.budget:g}s"
    option = montecarlo.declared.get(name, retry_failed.declared.get(name)).called
    shown = value[0].text if name == "correct" else value
    return option if value is True else f"{option} {shown}"


def _report(found: object, path: Path, said: Sequence[object] = ()) -> str:
    of = {RareEvent: report_of_rare_event, ShardSamples: report_of_shard, Ensemble: report_of_ensemble}[type(found)]
    return of(found, path, said)


def exit_status(found: Ensemble | ShardSamples | RareEvent) -> int:
    """Return 1 where samples failed, a rule is not met, or a rare event is not reached."""
    failed = bool(np.any(found.status != 0))
    if isinstance(found, RareEvent):
        failed |= not found.reached
    elif isinstance(found, Ensemble):
        failed |= found.joined is not None and found.joined.n_failed > 0
        failed |= found.stopping is not None and not found.stopping.is_met
    return int(failed)


@command(
    "montecarlo", "Many samples and their distributions.", 70, report=_report, status=exit_status, choose=choose,
    others=(retry_failed, rare_event), source=SOURCE, n=NUMBER, seed=SEED, sampler=SAMPLER, ranks_per_sample=PER_SAMPLE,
    samples=Argument(
        "Take the samples of a CSV or HDF5 file, columns named as parameters, in the scene's units; in a program also "
        "of a DataFrame, or of a mapping of names to numbers.", word="TABLE",
        allowed="a CSV or HDF5 file, a DataFrame, or a mapping of parameters' names to columns of numbers",
    ),
    shard=Argument(
        "Integrate part I of K parts alone; pgmp merge joins their files to the whole.", word="I/K", read=read_part
    ),
    correct=Argument(
        "Run the first K samples with a better MODEL too (full or components; /D: steps D times as short), and give "
        "its mean, deviation and probabilities; K may be auto with --budget.", word="[SCENE:]MODEL[/D]=K",
        read=lambda texts: [Correction.read(text) for text in texts],
    ),
    stopping=Argument(
        made=Stopping,
        parts={
            "until": Argument(
                "Stop when a figure is known well enough, such as 'std(angle) < 1 %' or 'P(angle > 3) +- 0.002'.",
                word="RULE",
            ),
            "budget": Argument(
                "Stop in time: 60s, 10min or 2h from the start of the command.", word="TIME", read=read_budget
            ),
        },
    ),
    gives="With the attributes of `results.Ensemble`, or of `results.ensemble.ShardSamples`. Samples that "
    "failed are in it, with their reasons.",
)  # fmt: skip
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
    comm: Comm | None = None,
) -> Result:
    """Integrate samples of a reduced model (or with `model` of a scene) and describe their distributions.

    Exit status 1 if some samples failed, which are recorded with their reason while the others go on, or if a rule of
    --until is not met.
    """
    start, comm = time.monotonic(), solving_ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        table = Path(samples) if isinstance(samples, (str, PathLike)) else samples
        asked = Request(n, seed, sampler, table, shard, correct, stopping or Stopping(), model or REDUCED).checked()
        _check_sharing(ranks_per_sample, asked.model)
        origin = Origin.of(source, model, (*overrides, *drawn_by(sampler)), parameters)

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


@command(
    "merge", "Join the shards of an ensemble.", 80, report=report_of_ensemble, status=exit_status,
    files=Argument("Files of all shards, in any order.", word="FILE", allowed="a list of names of shards' files"),
    gives="With the attributes of `results.Ensemble`.",
)  # fmt: skip
def merge(
    files: Sequence[str | PathLike[str]],
    *,
    output: str | PathLike[str] | None = None,
    on_all_ranks: bool = True,
    comm: Comm | None = None,
) -> Result:
    """Join all shards of an ensemble (pgmp montecarlo --shard) to the file that one run would have written.

    Exit status 1 if some samples failed.
    """
    from pgmp_petsc.ensemble.shards import Shards  # as above

    comm, found = solving_ranks_of(comm), None
    paths = [Path(file) for file in files]
    with keeping("ensemble", comm, output, on_all_ranks, paths) as keeper, _place_of(keeper) as place:
        with agreed(comm, "merging"), ExitStack() as opened:
            if comm.rank == 0:
                shards = [opened.enter_context(read_shard(path)) for path in paths]
                found = Shards(paths, shards, place.resolve().parent).described(place)
        return keeper.result(found, paths[0].parent)


def _check_sharing(ranks_per_sample: int, model: str) -> None:
    """Refuse several ranks for what is small."""
    if ranks_per_sample > 1 and model != "full":
        what = "component modes" if model == "components" else "a reduced model"
        raise InputError(f"--ranks-per-sample = {ranks_per_sample}: samples of {what} are small; leave it out")


def _say_if_small(model: FullModel, ranks_per_sample: int, comm: Comm) -> None:
    """Say that samples are too small to be shared among ranks, which wait for each other in every step."""
    n = model.kinematics.mechanism.n_dofs
    if 1 < ranks_per_sample and n < UNKNOWNS_PER_RANK * ranks_per_sample:
        few = f"a sample has {n} unknowns, less than {UNKNOWNS_PER_RANK} for each of its ranks"
        cure = "which takes longer than on fewer of them; leave it out, and ranks take their own"
        announce(f"--ranks-per-sample = {ranks_per_sample}: {few}, {cure}", comm)


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
    folder = on_root(keeper.comm, tempfile.mkdtemp, None, "pgmp_ensemble_")
    try:
        yield Path(folder) / "ensemble.h5"
    finally:
        if keeper.comm.rank == 0:
            shutil.rmtree(folder, ignore_errors=True)
