"""Many runs: what an ensemble is asked for, its shards, failed samples and better models, and rare events."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from pgmp_petsc.api.arguments import Range, began
from pgmp_petsc.api.declared import Argument, command, interface
from pgmp_petsc.api.ranks import solving_ranks_of
from pgmp_petsc.api.result import Result
from pgmp_petsc.api.scenes import Overrides, Parameters
from pgmp_petsc.api.sources import (
    PURPOSES,
    REDUCED,
    SOURCE,
    AnySource,
    Keeper,
    Origin,
    keeping,
    kind_of,
    mesh_model,
    place_on_the_way,
)
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.progress import announce
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.ensemble.checkpoint import Shards, remove_checkpoint
from pgmp_petsc.ensemble.description import describe_shards
from pgmp_petsc.ensemble.integration import read_earlier, run_ensemble, samples_for
from pgmp_petsc.ensemble.plan import LARGEST_SEED, MOST_SAMPLES, SAMPLERS, Plan, SampleFile, Shard, called
from pgmp_petsc.ensemble.sampling import FEW_OF_BETTER, refuse_drawn, unit_of_better
from pgmp_petsc.ensemble.stopping import Stop, read_rule
from pgmp_petsc.mechanism.capabilities import check_capabilities
from pgmp_petsc.mechanism.mechanism import TABLES
from pgmp_petsc.mesh.meshes import LineMesh
from pgmp_petsc.models import FullModel, Model
from pgmp_petsc.models.component_file import ComponentsFile
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.ranks.groups import UNKNOWNS_PER_RANK, RankGroup
from pgmp_petsc.results.ensemble import Ensemble, RareEvent, ShardSamples, read_shard
from pgmp_petsc.results.numbers import Arrays
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.studies.inputs import read_scene, with_meshes
from pgmp_petsc.texts.ensemble_table import report as report_of_ensemble
from pgmp_petsc.texts.ensemble_table import report_of_rare_event, report_of_shard

if TYPE_CHECKING:
    from pgmp_petsc.ensemble.joined import Better

MODELS = ("reduced", "components", "full")  # from worse to better
MOST_DIVISOR = 1000
FORM = re.compile(r"(?:(?P<scene>.+):)?(?P<model>[a-z]+)(?:/(?P<divisor>\d{1,4}))?=(?P<count>\d{1,9}|auto)")
ALLOWED = "[SCENE:]MODEL[/D]=K with full, components or reduced, steps D times as short, and K samples or auto"


@dataclass(frozen=True)
class Correction:
    """A better model, which runs the first samples of an ensemble too."""

    model: str  # ``full``, ``components`` or ``reduced``
    n: int | None  # number of samples; None where measured costs and correlations are to decide, within a budget
    divisor: int = 1  # by what its step is divided
    #: scene file that its meshes are from; None for those of the ensemble's own model
    scene: str | PathLike[str] | None = None

    @classmethod
    def read(cls, text: str) -> Self:
        """Return what a text like ``full/2=100`` asks for; raises `InputError` where it is none of the kind."""
        parts = FORM.fullmatch(text.strip())
        if parts is None or parts["model"] not in MODELS or not 1 <= int(parts["divisor"] or 1) <= MOST_DIVISOR:
            raise InputError(f"--correct {text}: allowed are {ALLOWED}, such as full=200, components=500 or full/4=50")
        count = None if parts["count"] == "auto" else int(parts["count"])
        return cls(parts["model"], count, int(parts["divisor"] or 1), parts["scene"])

    @property
    def name(self) -> str:
        """Name of the model in results."""
        return self.model if self.divisor == 1 else f"{self.model}/{self.divisor}"

    @property
    def text(self) -> str:
        """Words of a command line that ask for it."""
        ahead = "" if self.scene is None else f"{fspath(self.scene)}:"
        return f"{ahead}{self.name}={'auto' if self.n is None else self.n}"

    @property
    def rank(self) -> tuple[int, int]:
        """Better models have larger ones."""
        return MODELS.index(self.model), self.divisor


def in_order(wanted: Sequence[Correction], own: str, n_samples: int | None) -> list[Correction]:
    """Return better models than the ensemble's `own`, the best first; `n_samples` is None where it is to be chosen.
    Raises `InputError` if models or numbers are in no order that makes sense. The same on all ranks."""
    if not wanted:
        return []
    from pgmp_petsc.ensemble.joined import FEWEST as fewest  # most ensembles are of one model

    for one in wanted:
        Correction.read(one.text)  # of a program's own making
    found = sorted(wanted, key=lambda one: one.rank, reverse=True)
    for one, other in zip(found, found[1:]):
        if one.rank == other.rank:
            raise InputError(f"--correct {other.text}: {one.name} is there twice; give it once")
    for one in found:
        if one.rank <= (MODELS.index(own), 1):
            why = f"{one.name} is no better than the ensemble's own model, {own}"
            cure = f"give a better one, or {own}/2 for steps half as long"
            raise InputError(f"--correct {one.text}: {why}; {cure}")
        if one.n is not None and one.n < fewest:
            raise InputError(f"--correct {one.text}: at least {fewest} samples, or the interval would rest on nothing")
    known = [(one.name, one.n) for one in found if one.n is not None]
    known += [(own, n_samples)] if n_samples is not None else []
    for (better, few), (worse, many) in zip(known, known[1:]):
        if few > many:
            what = f"{few} samples of {better} and {many} of {worse}, which is worse"
            why = "a worse model needs as many samples at least, since those of a better one are the first of its own"
            raise InputError(f"--correct {better}={few}: {what}; {why}")
    return found


def better_models(wanted: Sequence[Correction], own: Model, origin: Origin, comm: Comm) -> list[Better]:
    """Return the models that are asked for beside the ensemble's own one, from its origin. Collective on `comm`. Raises
    `InputError` if meshes are not at hand, or a model cannot have what the scene has."""
    if not wanted:
        return []
    from pgmp_petsc.ensemble.joined import Better  # as above

    return [Better(one.name, _model(one, own, origin, comm), one.n) for one in wanted]


def _model(one: Correction, own: Model, origin: Origin, comm: Comm) -> Model:
    scene = own.scene.with_entries(
        simulation={"step": own.scene.simulation.step / one.divisor},
        # what is described of the ensemble's own model alone
        ensemble={"checked_share": 0.0, "bands": 0, "balance": False},
    )
    if one.model == own.name and one.scene is None:
        with agreed(comm, f"preparing the {own.title} model"):
            return own.in_scene(scene)
    if one.model == "components" and kind_of(one.scene or "") == one.model:
        built = on_root(comm, ComponentsFile.read, Path(one.scene))
        with agreed(comm, f"preparing {one.name}"):
            origin_of_bodies = scene_from_toml(built.record.scene_toml, Path(one.scene).parent)
            _check_same(one, origin_of_bodies, own.scene, origin.name)
            built.check_bodies(origin_of_bodies, scene, one.scene)
            return built.model(scene)
    meshes = _meshes(one, own, origin, comm)
    from pgmp_petsc.outputs.stress import check_stresses  # as above

    with agreed(comm, f"preparing {one.name}"):
        check_capabilities(scene, PURPOSES[one.model], meshes)
        check_stresses(scene, meshes)
    return mesh_model(scene, meshes, one.model, comm)


def _check_same(one: Correction, scene: Scene, own: Scene, source: object) -> None:
    """Refuse a scene that gives bodies of another mechanism than an ensemble's own."""
    for table in TABLES:
        if getattr(scene, table) != getattr(own, table):
            what = f"[{table}] of '{one.scene}' differs from that of '{source}'"
            raise InputError(f"--correct {one.text}: {what}; give the scene that it was built from")


def _meshes(one: Correction, own: Model, origin: Origin, comm: Comm) -> Mapping[str, BodyShape]:
    """Return the meshes of a model: those of its scene, or that the ensemble's model came with."""
    purpose = PURPOSES[one.model]
    if one.scene is not None:
        scene, meshes = read_scene(Path(one.scene), (), (), comm, purpose)
        _check_same(one, scene, own.scene, origin.name)
        return meshes
    if not origin.is_built:
        return on_root(comm, with_meshes, own.scene, purpose)[1]
    shapes = own.rom.meshes if origin.model == REDUCED else own.meshes
    condensed = [name for name, mesh in shapes.items() if not isinstance(mesh, LineMesh)]
    if condensed:
        what = f"'{origin.name}' has no mesh of {', '.join(condensed)}, only what was condensed of it"
        cure = f"give the scene too, --correct SCENE.toml:{one.text}"
        raise InputError(f"--correct {one.text}: {what}; {cure}")
    return shapes


LONGEST = 1e8  # s, of a budget


@dataclass(frozen=True)
class Stopping:
    """When an ensemble ends before its last sample."""

    #: rules, such as ``"std(angle) < 1 %"`` or ``"P(angle > 3) +- 0.002"``; it ends when all are met
    until: Sequence[str] = ()
    budget: float | None = None  # wall time from the start of the call, s

    def __bool__(self) -> bool:
        return bool(self.until) or self.budget is not None

    def stop(self, scene: Scene, start: float) -> Stop | None:
        """Return what ends an ensemble of a scene; raises `InputError` where a rule is none."""
        return Stop(tuple(read_rule(rule, scene) for rule in self.until), self.budget, start) if self else None


@dataclass(frozen=True)
class Request:
    """An ensemble that is asked for; every method is called by every rank alike, and raises `InputError`."""

    #: n, seed, sampler, samples, shard, correct, stopping: as of `api.ensembles.montecarlo`
    n: int | None
    seed: int
    sampler: str | None
    samples: Path | Arrays | None
    shard: Shard | None
    correct: Sequence[Correction]
    stopping: Stopping
    model: str  # name of the ensemble's own model

    @property
    def kind(self) -> str:
        return "ensemble" if self.shard is None else "shard"

    def checked(self) -> Request:
        """Return the request with better models in order; refuse what does not fit together."""
        if self.shard is not None:
            whole = all(isinstance(value, int) for value in (self.shard.number, self.shard.count))
            if not whole or not 1 <= self.shard.number <= self.shard.count:
                raise InputError(f"--shard {self.shard}: allowed are I/K with I from 1 to K, such as 2/8")
        wanted, rules, seconds = self.correct, self.stopping.until, self.stopping.budget
        free = [one for one in wanted if one.n is None]
        why = ""
        if self.samples is None and self.n is None and seconds is None:
            why = "-n: missing; give the number of samples, a file of samples with --samples, or a time with --budget"
        elif self.samples is not None and self.sampler is not None:
            why = f"--sampler {self.sampler}: the samples are those of {called(self.samples)}; give one of them"
        elif self.shard is not None and (wanted or self.stopping):
            option = "--correct" if wanted else "--until" if rules else "--budget"
            why = f"--shard {self.shard}: {option} goes by all samples, and a shard has some; leave one of them out"
        elif wanted and rules:
            why = f'--until "{rules[0]}" and --correct: rules go by the figures of one model; give numbers of samples'
            why += ", or --correct MODEL=auto with --budget, which gets most out of a time"
        elif free and seconds is None:
            why = f"--correct {free[0].text}: what decides on the number is missing; give --budget, such as 60s"
        elif wanted and seconds is not None and not free:
            why = f"--budget: --correct {wanted[0].text} gives the number of samples, and nothing is left to choose"
            why += f"; take {wanted[0].name}=auto, or leave --budget out"
        if why:
            raise InputError(why)
        return replace(self, correct=in_order(wanted, self.model, self.n))

    def check_scene(self, scene: Scene) -> None:
        """Refuse scenes whose shards would not be parts of one ensemble."""
        if scene.simulation.tolerance is not None and self.shard is not None:
            why = "with simulation.tolerance every shard would measure a step of its own"
            raise InputError(f"--shard {self.shard}: {why}; build with the tolerance, or give simulation.step")

    def table(self, model: Model, settings: Sequence[str]) -> SampleFile | None:
        """Return the samples of the file, None where there is none. By one process."""
        if self.samples is None:
            return None
        file = samples_for(model, self.samples, self.n)
        for setting in settings:
            name = setting.partition("=")[0].strip()
            if name in file.values:
                why = f"every sample takes '{name}' from {called(self.samples)}"
                raise InputError(f"--set {setting}: {why}; leave one of them out")
        return file

    def with_table(self, file: SampleFile | None) -> Request:
        """Return the request with the number of samples that a file gives."""
        if file is None:
            return self
        n = len(next(iter(file.values.values())))
        return replace(self, n=n, correct=in_order(self.correct, self.model, n))

    def plan(self, output: Path, resume: bool, file: SampleFile | None) -> Plan:
        """Return which samples are integrated, and where they are kept."""
        if self.shard is not None and self.shard.count > self.n:
            what = f"{self.shard.count} shards of {self.n} samples"
            raise InputError(f"--shard {self.shard}: {what}; take no more shards than samples")
        n = MOST_SAMPLES if self.n is None else self.n
        return Plan(n, self.seed, output, resume, file, self.shard, self.n is not None)

    def check_design(self, scene: Scene, file: SampleFile | None) -> None:
        """Refuse designs whose samples are no parts of each other."""
        sampler = "random" if file is not None else scene.ensemble.sampler
        if self.stopping and sampler == "latin_hypercube":
            why = "each of its samples depends on how many there are; take random or sobol"
            raise InputError(f"--until and --budget with the sampler latin_hypercube: {why}")
        if self.correct and sampler not in ("random", "sobol"):
            why = "intervals of several models are those of independent samples, or of replicates of Sobol sequences"
            raise InputError(f"--correct with the sampler {sampler}: {why}; take random or sobol")
        replicates = scene.ensemble.replicates
        unit = unit_of_better(replicates)
        for one in self.correct if sampler == "sobol" else ():
            if one.n is not None and one.n % unit:
                each = f"every one of {replicates} sequences (ensemble.replicates) needs as many samples"
                why = f"with the sampler sobol {each}, and {FEW_OF_BETTER} at least"
                raise InputError(f"--correct {one.text}: {why}; give a multiple of {unit}")


def drawn_by(sampler: str | None) -> tuple[str, ...]:
    """Return what a sampler changes of a scene."""
    return () if sampler is None else (f'ensemble.sampler="{sampler}"',)


def read_part(shard: str) -> Shard:
    """Return which part of the samples a text means; raises `InputError`."""
    found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", shard)
    if found is None:
        raise InputError(f"--shard {shard}: allowed are I/K with I from 1 to K, such as 2/8")
    return Shard(int(found[1]), int(found[2]))


def read_budget(text: str) -> float:
    """Return a time in seconds; raises `InputError` unless it is a positive number with s, min or h."""
    found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*(s|min|h)?\s*", text)
    seconds = float(found[1]) * {"s": 1.0, None: 1.0, "min": 60.0, "h": 3600.0}[found[2]] if found else 0.0
    if not 0.0 < seconds < LONGEST:
        raise InputError(f"--budget {text}: allowed is a time such as 60s, 10min or 2h, of less than three years")
    return seconds


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
    origin = Origin.of(comm, source, model, (*overrides, *drawn_by(sampler)), parameters)
    _check_sharing(ranks_per_sample, origin.model)

    def check(scene: Scene) -> None:
        refuse_drawn(scene, origin.settings)

    with ExitStack() as stack:
        group = stack.enter_context(RankGroup.split(comm, ranks_per_sample, "--ranks-per-sample"))
        keeper = stack.enter_context(keeping("ensemble", comm, output, on_all_ranks, (origin.path, failed)))
        place = stack.enter_context(place_on_the_way(comm, keeper.output))
        prepared = origin.settled(comm, check, many=True)
        _say_if_small(prepared, ranks_per_sample, comm)
        earlier = on_root(comm, read_earlier, Path(failed), prepared)
        plan = Plan(earlier.n_samples, earlier.seed, place, resume, earlier.file)
        return _kept(keeper, run_ensemble(prepared, plan, group, earlier=earlier), plan, prepared.scene)


@interface(
    "With the attributes of `results.ensemble.RareEvent`.",
    source=SOURCE,
    event=Argument(
        'Find the probability of a rare event with at most N samples: "slider_deformation < -0.2 mm", "ever" before it '
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
    origin = Origin.of(comm, source, model, overrides, parameters)

    def check(scene: Scene) -> None:
        refuse_drawn(scene, origin.settings)
        event_of(event, scene)

    with keeping(RareEvent.kind, comm, output, on_all_ranks, (origin.path,)) as keeper:
        prepared = origin.settled(comm, check, many=True)
        return keeper.result(run_rare_event(prepared, event_of(event, prepared.scene), n, seed, comm), prepared.scene)


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
    then="pgmp report {file} -o report.html",
    ending=lambda given: None if {"shard", "failed"} & {*given} else "rare" if "event" in given else "samples",
    others=(retry_failed, rare_event), source=SOURCE, n=NUMBER, seed=SEED, sampler=SAMPLER, ranks_per_sample=PER_SAMPLE,
    samples=Argument(
        "Take the samples of a CSV or HDF5 file, columns named as parameters, in the scene's units; in a program also "
        "of a DataFrame, a Dataset, or a mapping of names to numbers.", word="TABLE",
        allowed="a CSV or HDF5 file, a DataFrame, a Dataset, or a mapping of parameters' names to columns of numbers",
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
                word="RULE", allowed="a list of rules, such as ['std(angle) < 1 %']",
            ),
            "budget": Argument(
                "Stop in time: 60s, 10min or 2h from the start of the command.", word="TIME", read=read_budget,
                allowed=Range(0.0, LONGEST, above=True, unit="s"),
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
    samples: str | PathLike[str] | Arrays | None = None,
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
    start, comm = began(), solving_ranks_of(comm)
    origin = Origin.of(comm, source, model, (*overrides, *drawn_by(sampler)), parameters)
    with agreed(comm, "looking at the arguments"):
        table = Path(samples) if isinstance(samples, (str, PathLike)) else samples
        asked = Request(n, seed, sampler, table, shard, correct, stopping or Stopping(), origin.model).checked()
        _check_sharing(ranks_per_sample, asked.model)

    def check(scene: Scene) -> None:
        refuse_drawn(scene, origin.settings)
        asked.check_scene(scene)

    with ExitStack() as stack:
        group = stack.enter_context(RankGroup.split(comm, ranks_per_sample, "--ranks-per-sample"))
        keeper = stack.enter_context(keeping(asked.kind, comm, output, on_all_ranks, (origin.path,)))
        place = stack.enter_context(place_on_the_way(comm, keeper.output))
        prepared = origin.settled(comm, check, many=True)
        _say_if_small(prepared, ranks_per_sample, comm)
        file = on_root(comm, asked.table, prepared, origin.settings)
        with agreed(comm, "looking at what is asked for"):
            asked = asked.with_table(file)
            plan = asked.plan(place, resume, file)
            asked.check_design(prepared.scene, file)
            stop = asked.stopping.stop(prepared.scene, start)
        better = better_models(asked.correct, prepared, origin, comm)
        return _kept(keeper, run_ensemble(prepared, plan, group, stop, better), plan, prepared.scene)


@command(
    "merge", "Join the shards of an ensemble.", 80, report=report_of_ensemble, status=exit_status,
    ending=lambda _: "samples", then="pgmp report {file} -o report.html",
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
    comm, found = solving_ranks_of(comm), None
    paths = [Path(file) for file in files]
    with ExitStack() as stack:
        keeper = stack.enter_context(keeping("ensemble", comm, output, on_all_ranks, paths))
        place = stack.enter_context(place_on_the_way(comm, keeper.output))
        with agreed(comm, "merging"), ExitStack() as opened:
            if comm.rank == 0:
                shards = [opened.enter_context(read_shard(path)) for path in paths]
                found = describe_shards(Shards(paths, shards, place.resolve().parent), place)
        # no run before this one has said the scene's remarks
        scene = on_root(comm, lambda: scene_from_toml(found.record.scene_toml, paths[0].parent).with_remarks(()))
        return keeper.result(found, scene)


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


def _kept(keeper: Keeper, found: object, plan: Plan, scene: Scene) -> Result:
    """Return the result, and remove what was kept on the way once it is written, unless a rule is not met yet: then
    more samples may go on from it. Collective on the ranks."""
    result = keeper.result(found, scene)
    goes_on = isinstance(found, Ensemble) and found.stopping is not None and not all(found.stopping.met)
    if keeper.output is not None and keeper.comm.rank == 0 and not goes_on:
        remove_checkpoint(plan)
    return result
