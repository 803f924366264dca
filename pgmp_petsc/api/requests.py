"""Better models of an ensemble's scene, and how many samples of each (``pgmp montecarlo --correct``).

What an ensemble is asked for, and what of it does not fit together.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Self

from pgmp_petsc.api.sources import PURPOSES, mesh_model
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.ensemble.plan import MOST_SAMPLES, Plan, SampleFile, Shard
from pgmp_petsc.ensemble.sample_file import Columns, called, read_samples
from pgmp_petsc.ensemble.stopping import Stop, read_rule
from pgmp_petsc.mechanism.capabilities import check_capabilities
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.models import Model, ReducedModel
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.reduction.rom import outside_of, refuse_beyond
from pgmp_petsc.scene import Scene
from pgmp_petsc.studies.inputs import read_scene, with_meshes

if TYPE_CHECKING:
    from pgmp_petsc.ensemble.correction import Better


MODELS = ("reduced", "components", "full")  # from worse to better
MOST_DIVISOR = 1000
FORM = re.compile(r"(?:(?P<scene>.+):)?(?P<model>[a-z]+)(?:/(?P<divisor>\d{1,4}))?=(?P<count>\d{1,9}|auto)")
ALLOWED = "[SCENE:]MODEL[/D]=K with full, components or reduced, steps D times as short, and K samples or auto"
# what has to be the same in a scene that gives meshes
OF_MESHES = ("ground", "materials", "bodies", "joints", "coordinates")


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
    """Return better models, the best first; the same on all ranks.

    Raises `InputError` if models or numbers are in no order that makes sense.

    Parameters
    ----------
    wanted
        In any order.
    own
        Name of the ensemble's own model.
    n_samples
        Number of its samples, None where it is to be chosen.
    """
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


def better_models(wanted: Sequence[Correction], own: Model, source: object, comm: Comm) -> list[Better]:
    """Return the models that are asked for. Collective on `comm`.

    Raises `InputError` if meshes are not at hand, or a model cannot have what the scene has.

    Parameters
    ----------
    own
        The ensemble's own model.
    source
        What messages call that which it is from.
    """
    if not wanted:
        return []
    from pgmp_petsc.ensemble.correction import Better  # as above

    return [Better(one.name, _model(one, own, source, comm), one.n) for one in wanted]


def _model(one: Correction, own: Model, source: object, comm: Comm) -> Model:
    scene = _scene_of(own.scene, one.divisor)
    if one.model == "reduced":
        with agreed(comm, "preparing the reduced model"):
            return ReducedModel(scene, own.rom, own.kinematics)
    meshes = _meshes(one, own, source, comm)
    from pgmp_petsc.outputs.stress import check_stresses  # as above

    with agreed(comm, f"preparing {one.name}"):
        check_capabilities(scene, PURPOSES[one.model], meshes)
        check_stresses(scene, meshes)
    return mesh_model(scene, meshes, one.model, comm)


def _scene_of(scene: Scene, divisor: int) -> Scene:
    """Return the scene with shorter steps, and without what is described of the ensemble's own model alone."""
    simulation = scene.simulation.model_copy(update={"step": scene.simulation.step / divisor})
    ensemble = scene.ensemble.model_copy(update={"checked_share": 0.0, "bands": 0, "balance": False})
    return scene.model_copy(update={"simulation": simulation, "ensemble": ensemble})


def _meshes(one: Correction, own: Model, source: object, comm: Comm) -> Mapping[str, BodyShape]:
    """Return the meshes of a model: those of its scene, or that the ensemble's model came with."""
    purpose = PURPOSES[one.model]
    if one.scene is not None:
        scene, meshes = read_scene(Path(one.scene), (), (), comm, purpose)
        for table in OF_MESHES:
            if getattr(scene, table) != getattr(own.scene, table):
                what = f"[{table}] of '{one.scene}' differs from that of '{source}'"
                raise InputError(f"--correct {one.text}: {what}; give the scene that it was built from")
        return meshes
    if not isinstance(own, ReducedModel):
        return on_root(comm, with_meshes, own.scene, purpose)[1]
    condensed = [name for name, mesh in own.rom.meshes.items() if not isinstance(mesh, LineMesh)]
    if condensed:
        what = f"'{source}' has no mesh of {', '.join(condensed)}, only what was condensed of it"
        cure = f"give the scene too, --correct SCENE.toml:{one.text}"
        raise InputError(f"--correct {one.text}: {what}; {cure}")
    return own.rom.meshes


FEW = 4  # samples of a better model to each Sobol sequence
LONGEST = 1e8  # s, of a budget


@dataclass(frozen=True)
class Stopping:
    """When an ensemble ends before its last sample."""

    #: rules, such as ``"std(angle) < 1 %"`` or ``"P(angle > 3) +- 0.002"``; it ends when all are met
    until: Sequence[str] = ()
    budget: float | None = None  # wall time from the start of the call, s

    def __bool__(self) -> bool:
        return bool(self.until) or self.budget is not None

    def check(self) -> None:
        """Refuse what are no rules, and no time."""
        if isinstance(self.until, str) or not all(isinstance(rule, str) for rule in self.until):
            raise InputError(f"until = {self.until!r}: allowed is a list of rules, such as ['std(angle) < 1 %']")
        number = isinstance(self.budget, (int, float)) and not isinstance(self.budget, bool)
        if self.budget is not None and not (number and 0.0 < self.budget < LONGEST):
            raise InputError(f"budget = {self.budget!r}: allowed is a time in seconds, of less than three years")

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
    samples: Path | Columns | None
    shard: Shard | None
    correct: Sequence[Correction]
    stopping: Stopping
    model: str  # name of the ensemble's own model

    @property
    def kind(self) -> str:
        """Of the result."""
        return "ensemble" if self.shard is None else "shard"

    def checked(self) -> Request:
        """Return the request with better models in order; refuse what does not fit together."""
        if self.shard is not None:
            whole = all(isinstance(value, int) for value in (self.shard.number, self.shard.count))
            if not whole or not 1 <= self.shard.number <= self.shard.count:
                raise InputError(f"--shard {self.shard}: allowed are I/K with I from 1 to K, such as 2/8")
        self.stopping.check()
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
        file = read_samples(self.samples, model.scene, self.n)
        for setting in settings:
            name = setting.partition("=")[0].strip()
            if name in file.values:
                why = f"every sample takes '{name}' from {called(self.samples)}"
                raise InputError(f"--set {setting}: {why}; leave one of them out")
        if isinstance(model, ReducedModel):
            refuse_beyond(model.served, file.values, called(self.samples))
            said = outside_of(model.served, file.values, called(self.samples))
            file = replace(file, remarks=(*file.remarks, *said))
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
        for one in self.correct if sampler == "sobol" else ():
            if one.n is None or one.n % (FEW * replicates):
                each = f"every one of {replicates} sequences (ensemble.replicates) needs as many samples, and {FEW}"
                cure = f"give a multiple of {FEW * replicates}"
                raise InputError(f"--correct {one.text}: with the sampler sobol {each} at least; {cure}")


def drawn_by(sampler: str | None) -> tuple[str, ...]:
    """Return what a sampler changes of a scene."""
    return () if sampler is None else (f'ensemble.sampler="{sampler}"',)


def read_part(shard: str) -> Shard:
    """Return which part of the samples a text means; raises `InputError`."""
    found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", shard)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise InputError(f"--shard {shard}: allowed are I/K with I from 1 to K, such as 2/8")
    return Shard(int(found[1]), int(found[2]))


def read_budget(text: str) -> float:
    """Return a time in seconds; raises `InputError` unless it is a positive number with s, min or h."""
    found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*(s|min|h)?\s*", text)
    seconds = float(found[1]) * {"s": 1.0, None: 1.0, "min": 60.0, "h": 3600.0}[found[2]] if found else 0.0
    if not 0.0 < seconds < LONGEST:
        raise InputError(f"--budget {text}: allowed is a time such as 60s, 10min or 2h, of less than three years")
    return seconds
