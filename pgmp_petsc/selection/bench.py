"""The test bench: references and candidates, each run under all training loads.

Each load is one batch of all samples. Loads are dealt to the ranks, and a candidate is built by all of them; what a
load leaves stays on its rank, and only errors are gathered, so that every rank decides on the same figures and the
number of ranks has no part in them.

Reduced models of candidates: the latest stay in memory, as many as fit; an earlier one is built again when it is
wanted. Few are: errors and histories are kept with the trials themselves, and are small.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from time import perf_counter, process_time

import numpy as np

from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.experiments.finished import Finished
from pgmp_petsc.experiments.history import History, errors_between, floors_of, round_off_of, run_history
from pgmp_petsc.experiments.reference import Reference, Subject
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.refinement import refined
from pgmp_petsc.models import FullModel, ReducedModel
from pgmp_petsc.reduction.build import build_rom
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.errors import InputError, PgmpError, RunError
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.runtime.progress import Progress, without_progress
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import Initial, Reduction
from pgmp_petsc.selection.training import Load, Training, with_softer_stops
from pgmp_petsc.selection.trial import Errors, Trial

SMALL = 2.5e-4  # s of a step of a sample of the reference, for runs that are not needed for the choice itself
BATCH = 256  # samples, for processor times
TIMED_SECONDS, FEWEST_TIMED = 1.0, 16  # s, predicted, and steps of the reference that its time is taken of


class Bench:
    """Runs what is to be compared; all methods are collective on ``group.world``.

    Parameters
    ----------
    subject
        The scene and its bodies, condensed for all candidates.
    group
        Ranks that share an eigenproblem.
    training
        What to run.
    reference
        What to compare with.
    bar
        Counts the runs.
    finished
        Runs of the reference that an earlier run of the program left, and where they are kept; None where nothing is.
    """

    def __init__(
        self,
        subject: Subject,
        group: RankGroup,
        training: Training,
        reference: Reference,
        bar: Progress,
        finished: Finished | None = None,
    ) -> None:
        self._finished = finished
        self._bar, self._subject = bar, subject
        self.scene, self.group, self.training, self.reference = subject.scene, group, training, reference
        self.comm = group.world
        self.remarks = list(training.remarks)
        self.spent = 0.0  # s of processor time, that candidates so far were predicted to take
        self.full_model = reference.model
        self.outputs = tuple(self.full_model.outputs.functions)
        with agreed(self.comm, "preparing training runs"):
            self._floors = floors_of(self.full_model)
        self._full: dict[tuple[str, int], History] = {}
        self._shelf = Shelf(self.build)

    def moved(self, coarse: int, fine: int, loads: tuple[str, ...] | None = None) -> Errors:
        """Return how far full-order runs with two numbers of steps are apart."""
        names = self._names(loads)
        for n_steps in (coarse, fine):
            self._run_full(names, n_steps)
        self._bar.update()
        return self._gather(names, lambda name: (self._full[name, coarse], self._full[name, fine]))

    def check_references(self, n_steps: int, loads: tuple[str, ...] | None = None) -> None:
        """Note which training cases do not count.

        Raises
        ------
        RunError
            If the scene itself, at nominal parameters, cannot be run.
        """
        names, title = self._names(loads), self.full_model.title
        self._run_full(names, n_steps)
        mine = {}
        for name in self._own(names):
            history = self._full[name, n_steps]
            failed = history.status != Status.FINE
            mine[name] = (failed, ~failed & ~history.inside, Status(history.status[0]).meaning)
        every = {name: item for part in self.comm.allgather(mine) for name, item in part.items()}
        for k, name in enumerate(names):
            failed, outside, meaning = every[name]
            if k == 0 and (failed[0] or outside[0]):
                reason = meaning if failed[0] else "the coordinate leaves its range"
                raise RunError(f"training run of the {title} model at nominal parameters, own loads: {reason}")
            for mask, what in ((failed, "fails"), (outside, "leaves the range of the coordinate")):
                if mask.any():
                    cases = f"{mask.sum()} of {mask.size} samples"
                    self.remarks.append(f"load '{name}': the {title} model {what} in {cases}; they do not count")

    def build(self, reduction: Reduction) -> ReducedOrderModel:
        """Build a reduced model of the scene and give it to all ranks."""
        scene = self.scene.model_copy(update={"reduction": reduction})
        with without_progress():
            rom = build_rom(scene, self._subject.shapes, self.group)
        return self.comm.bcast(rom)

    def rom_of(self, trial: Trial) -> ReducedOrderModel:
        """Return the reduced model of a trial that could be built, on all ranks; built again where it was let go."""
        return self._shelf.take(trial.reduction)

    def try_out(self, reduction: Reduction, n_steps: int, loads: tuple[str, ...] | None = None) -> Trial:
        """Build a candidate, run it under some loads (all, by default) and compare it with the full-order model."""
        names, start = self._names(loads), perf_counter()
        try:
            rom = self.build(reduction)
            reason = rom.indefinite
            if not reason:
                self._shelf.put(reduction, rom)
        except PgmpError as error:
            # what the scene gives itself is wrong whatever is chosen beside it; a candidate of ours is just no use
            if isinstance(error, InputError) and "parameter_modes" in self.scene.reduction.model_fields_set:
                raise
            reason = str(error)
        self._bar.update()
        seconds = self.comm.bcast(perf_counter() - start)
        return self.go_on(Trial(reduction, n_steps, self._endless(()), reason, seconds, not reason, {}), names)

    def go_on(self, trial: Trial, loads: tuple[str, ...] | None = None) -> Trial:
        """Run a candidate under further loads."""
        start, n_steps = perf_counter(), trial.n_steps
        names = tuple(name for name in self._names(loads) if name not in trial.errors.loads)
        if not names:
            return trial
        self._run_full(names, n_steps)
        errors, histories, reason = self._endless(names), {}, trial.reason
        if trial.built:
            try:
                histories = self._run_reduced(trial.reduction, names, n_steps)
                errors = self._gather(names, lambda name: (histories[name], self._full[name, n_steps]))
                if not np.isfinite(errors.largest):
                    reason = reason or self._failures(histories)
            except RunError as error:
                trial, reason = replace(trial, built=False), str(error)
        together = replace(
            errors,
            values=np.concatenate([trial.errors.values, errors.values]),
            round_off=np.concatenate([trial.errors.round_off, errors.round_off]),
            loads=(*trial.errors.loads, *names),
        )
        seconds = trial.seconds + self.comm.bcast(perf_counter() - start)
        return replace(
            trial, errors=together, reason=reason, seconds=seconds, histories={**trial.histories, **histories}
        )

    def run_again(self, trial: Trial, n_steps: int, loads: tuple[str, ...]) -> Errors:
        """Compare a candidate with the full-order model at another step."""
        self._run_full(loads, n_steps)
        histories = self._run_reduced(trial.reduction, loads, n_steps)
        return self._gather(loads, lambda name: (histories[name], self._full[name, n_steps]))

    def moved_reduced(self, trial: Trial, coarse: int, fine: int, loads: tuple[str, ...]) -> Errors:
        """Return how far runs of a candidate with two numbers of steps are apart."""
        one, other = (self._run_reduced(trial.reduction, loads, n_steps) for n_steps in (coarse, fine))
        return self._gather(loads, lambda name: (one[name], other[name]))

    def apart(self, one: Trial, other: Trial) -> Errors:
        """Return how far two candidates that ran with the same step are apart, under the loads that both ran with."""
        names = tuple(name for name in one.errors.loads if name in other.errors.loads)
        if not (one.built and other.built):
            return replace(one.errors, values=np.full_like(one.errors.values, np.inf))

        errors = self._gather(names, lambda name: (one.histories[name], other.histories[name]))
        # where the other one failed there is no number; what does not count against the full-order model does not here
        counts = ~np.isnan(one.errors.values[[one.errors.loads.index(name) for name in names]])
        values = np.where(np.isnan(errors.values), np.inf, errors.values)
        return replace(errors, values=np.where(counts, values, np.nan))

    def weakened(self, trial: Trial, load: str, factor: float) -> Errors:
        """Return the errors of a candidate under one load times a factor."""
        return self._errors_in(trial, load, self._load(load).of(self.scene, factor))

    def softened(self, trial: Trial, load: str, factor: float) -> Errors:
        """Return the errors of a candidate under one load, its end stops a factor as stiff."""
        return self._errors_in(trial, load, with_softer_stops(self._load(load).of(self.scene), factor))

    def from_rest(self, trial: Trial, load: str, sample: int) -> tuple[np.ndarray, np.ndarray]:
        """Return what halving the step moves of one full-order sample that starts at rest where the loads pull it, and
        the candidate's error from there; each of shape (n_outputs,), infinite where there is no such start."""
        endless = np.full((2, len(self.outputs)), np.inf)
        rest = {"initial": Initial(equilibrium=True, coordinates="free")}
        scene = self._load(load).of(self.scene).model_copy(update=rest)
        values = {name: column[sample : sample + 1] for name, column in self.training.values.items()}
        found, rom, n_steps = endless, self.rom_of(trial), trial.n_steps
        try:
            with agreed(self.comm, "runs from rest"):
                if load in self._own((load,)):
                    full = self.full_model.with_loads(scene)
                    reduced = self._reduced_model(rom, trial.reduction).with_loads(scene)
                    exact = run_history(full, values, 1, n_steps)
                    others = run_history(full, values, 1, 2 * n_steps), run_history(reduced, values, 1, n_steps)
                    found = np.array([errors_between(other, exact, self._floors)[:, 0] for other in others])
        except PgmpError:
            return tuple(endless)
        every = self.comm.allgather(np.where(np.isnan(found), np.inf, found))
        return tuple(np.min(every, axis=0))

    def _errors_in(self, trial: Trial, load: str, scene: Scene) -> Errors:
        """Return the errors of a candidate under one load as another scene has it, and its local effects."""
        found: dict[str, tuple[History, History]] = {}
        rom = self.rom_of(trial)
        with agreed(self.comm, "runs under another load"):
            if load in self._own((load,)):
                full = self._history(self.full_model.with_loads(scene), trial.n_steps)
                reduced = self._reduced_model(rom, trial.reduction).with_loads(scene)
                found[load] = (self._history(reduced, trial.n_steps), full)
        return self._gather((load,), found.__getitem__)

    def _load(self, name: str) -> Load:
        return next(load for load in self.training.loads if load.name == name)

    @property
    def most_steps(self) -> float:
        """Steps of a run up to which all runs with halved steps, of the loads that the step is found with, are within
        ``reference.budget``; no limit where the reference was named, whatever it takes."""
        cases = self.training.n_samples * sum(load.for_step for load in self.training.loads)
        # runs of n, n / 2, n / 4 ... steps are 2 n of them
        return self.budget / (2.0 * cases * self.reference.price.step)

    @property
    def budget(self) -> float:
        """Processor time that runs may be predicted to take (s); no limit where the reference was named."""
        return self.scene.reference.budget if self.scene.reference.model == "auto" else np.inf

    @property
    def mechanism(self) -> Mechanism:
        """What candidates are made of: bodies of cells are condensed."""
        return self._subject.kinematics.mechanism

    def finer_meshes(self, n_steps: int) -> Errors | None:
        """Return how far the scene's own runs are from those with cells cut in two; None where that is not known: of
        large meshes and of those of continuum cells."""
        lines = all(isinstance(mesh, LineMesh) for mesh in self._subject.meshes.values())
        if not (lines and self.reference.is_mesh and self.is_small):
            return None
        name = self.training.loads[0].name
        found: dict[str, tuple[History, History]] = {}
        self._run_full((name,), n_steps)
        with agreed(self.comm, "runs on finer meshes"):
            if name in self._own((name,)):
                model = FullModel(self.scene, {body: refined(mesh, 2) for body, mesh in self._subject.meshes.items()})
                found[name] = (self._full[name, n_steps], self._history(model, n_steps))
        return self._gather((name,), found.__getitem__)

    def processor_times(self, trial: Trial, n_reduced: int, n_full: int) -> tuple[float, float]:
        """Return the processor time of a reduced and of a reference sample under the scene's own loads, s.

        Both are run in batches of `BATCH` samples at least, the reference if it is not large: lanes are then full. Of
        its steps a few are taken, and the others counted.
        """
        n_own = self.training.n_samples
        copies, times, rom = -(-BATCH // n_own), (0.0, 0.0), self.rom_of(trial)
        values = {name: np.tile(column, copies) for name, column in self.training.values.items()}
        with agreed(self.comm, "runs for the processor time"):
            if self.comm.rank == 0:
                begin = process_time()
                run_history(self._reduced_model(rom, trial.reduction), values, copies * n_own, n_reduced)
                reduced = (process_time() - begin) / (copies * n_own)
                times = (reduced, n_full * self._seconds_of_step(values, copies * n_own, n_full))
        return self.comm.bcast(times)

    def _seconds_of_step(self, values: Mapping[str, np.ndarray], n_samples: int, n_steps: int) -> float:
        """Return the processor time of a step of a sample of the reference, from some steps; on this rank."""
        if not self.is_small:
            values, n_samples = {name: column[:1] for name, column in values.items()}, 1
        affordable = int(TIMED_SECONDS / (n_samples * self.reference.price.step))
        taken = min(n_steps, max(FEWEST_TIMED, affordable))
        simulation = self.scene.simulation
        short = {"duration": simulation.duration * taken / n_steps}
        scene = self.scene.model_copy(update={"simulation": simulation.model_copy(update=short)})
        begin = process_time()
        run_history(self.full_model.with_loads(scene), values, n_samples, taken)
        return (process_time() - begin) / (taken * n_samples)

    @property
    def is_small(self) -> bool:
        """Whether further runs of the reference take no time to speak of."""
        return self.reference.price.step <= SMALL

    def _endless(self, names: tuple[str, ...]) -> Errors:
        """Return infinite errors."""
        shape = (len(names), len(self.outputs), self.training.n_samples)
        return Errors(np.full(shape, np.inf), np.zeros(shape), names, self.outputs, self.training)

    def _names(self, loads: tuple[str, ...] | None) -> tuple[str, ...]:
        return tuple(load.name for load in self.training.loads) if loads is None else loads

    def _own(self, names: tuple[str, ...]) -> list[str]:
        """Return the loads of this rank; every load has the same rank throughout."""
        order = [load.name for load in self.training.loads]
        return [name for name in names if order.index(name) % self.comm.size == self.comm.rank]

    def _history(self, model: FullModel | ReducedModel, n_steps: int) -> History:
        return run_history(model, self.training.values, self.training.n_samples, n_steps)

    def _run_full(self, names: tuple[str, ...], n_steps: int) -> None:
        """Do the full-order runs that are missing."""
        with agreed(self.comm, "full-order training runs"):
            for name in self._own(names):
                if (name, n_steps) not in self._full:
                    history = self._reference_run(name, n_steps)
                    history.outputs[..., ~history.inside] = np.nan
                    self._full[name, n_steps] = history

    def _reference_run(self, name: str, n_steps: int) -> History:
        """Run the reference under a load, or take up what an earlier run of the program has of it."""
        task = (self.full_model.name, name, n_steps)
        kept = None if self._finished is None else self._finished.get("reference", task)
        if kept is not None:
            return History.of_arrays(kept)
        history = self._history(self.full_model.with_loads(self._load(name).of(self.scene)), n_steps)
        if self._finished is not None:
            self._finished.put("reference", task, history.arrays)
        return history

    def _reduced_model(self, rom: ReducedOrderModel, reduction: Reduction) -> ReducedModel:
        scene = self.scene.model_copy(update={"reduction": reduction})
        return ReducedModel(scene, rom, self._subject.kinematics)

    def _run_reduced(self, reduction: Reduction, names: tuple[str, ...], n_steps: int) -> dict[str, History]:
        histories, rom = {}, self._shelf.take(reduction)
        with agreed(self.comm, "reduced training runs"):
            own = self._own(names)
            if own:
                model = self._reduced_model(rom, reduction)
                for load in self.training.loads:
                    if load.name in own:
                        histories[load.name] = self._history(model.with_loads(load.of(self.scene)), n_steps)
        return histories

    def _failures(self, histories: Mapping[str, History]) -> str:
        """Return why samples of a candidate failed, empty where none did."""
        meanings = sorted({Status(s).meaning for item in histories.values() for s in item.status if s != Status.FINE})
        return "; ".join(sorted({text for part in self.comm.allgather(meanings) for text in part}))

    def _gather(self, names: tuple[str, ...], of: Callable[[str], tuple[History, History]]) -> Errors:
        """Gather the errors between the two histories that `of` returns for each of this rank's loads."""
        mine = {}
        with agreed(self.comm, "comparing training runs"):
            for name in self._own(names):
                found, exact = of(name)
                mine[name] = errors_between(found, exact, self._floors), round_off_of(exact, self._floors)
        every = {name: item for part in self.comm.allgather(mine) for name, item in part.items()}
        values, round_off = (np.array([every[name][k] for name in names]) for k in (0, 1))
        return Errors(values, round_off, names, self.outputs, self.training)


#: Of all models on the shelf together; tables of second order grow with the third power of the flexible coordinates.
MOST_BYTES = 2**29


class Shelf:
    """Models by their reduction. The same on all ranks, which put and take the same models in the same order.

    Parameters
    ----------
    build
        Builds a model; collective.
    most_bytes
        That all models may have together; the latest one stays, however large.
    """

    def __init__(self, build: Callable[[Reduction], ReducedOrderModel], most_bytes: int = MOST_BYTES) -> None:
        self._build, self._most = build, most_bytes
        self._models: dict[str, tuple[ReducedOrderModel, int]] = {}

    def put(self, reduction: Reduction, rom: ReducedOrderModel) -> None:
        """Keep a model, and let the oldest ones go."""
        self._models[_key(reduction)] = rom, bytes_of(rom)
        while len(self._models) > 1 and sum(size for _, size in self._models.values()) > self._most:
            del self._models[next(iter(self._models))]

    def take(self, reduction: Reduction) -> ReducedOrderModel:
        """Return a model that was put here before. Collective where it has to be built again."""
        kept = self._models.pop(_key(reduction), None)
        rom = self._build(reduction) if kept is None else kept[0]
        self.put(reduction, rom)
        return rom


def bytes_of(item: object) -> int:
    """Return the bytes of all arrays in dataclasses, mappings and sequences within an object."""
    if isinstance(item, np.ndarray):
        return item.nbytes
    if isinstance(item, Mapping):
        return sum(map(bytes_of, item.values()))
    if isinstance(item, (tuple, list)):
        return sum(map(bytes_of, item))
    return sum(map(bytes_of, vars(item).values())) if hasattr(item, "__dict__") else 0


def _key(reduction: Reduction) -> str:
    return reduction.model_dump_json()
