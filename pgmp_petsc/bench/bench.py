"""The test bench: settings, which are models with a step, run at cases, which are samples under loads.

The cases of a training are dealt to the ranks, and a model is made by all of them; what a case leaves stays on its
rank, and only errors are gathered, so that every rank decides on the same figures and the number of ranks has no part
in them. A bench of one rank alone (`timed`) makes models from nothing and takes times.

Times are taken by the wall and by the processor, of this process alone. *Offline* is what comes before the first
sample: condensing, building and preparing the model, or the runs at a response surface's nodes. *Online* is what a
sample costs after that, as an ensemble does it; a sample alone is a batch of one. A run that is predicted to take
longer than `TIMED` is timed with fewer samples, and then by its first steps: a step costs what the others do.

Of reduced models the latest stay in memory, as many as fit; histories of what has run are kept, and are small.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from time import perf_counter, process_time
from typing import Self

import numpy as np

from pgmp_petsc.base.errors import InputError, PgmpError, RunError
from pgmp_petsc.base.progress import Progress, without_progress
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bench import history as histories
from pgmp_petsc.bench import prices
from pgmp_petsc.bench.history import OWN, Case, Errors, History, Pulse, ResponseSurface, Setting, Training, Trial
from pgmp_petsc.bench.reference import Reference, Subject, component_model
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.lanes.vectors import LANES
from pgmp_petsc.mesh.meshes import LineMesh, refined
from pgmp_petsc.models import FullModel, Model, ReducedModel
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.ranks.groups import UNKNOWNS_PER_RANK, RankGroup, first_ranks
from pgmp_petsc.reduction.build import FEW_VECTORS, build_rom
from pgmp_petsc.reduction.checkpoint import Arrays, Finished
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene.numerics import Reduction
from pgmp_petsc.scene.parameters import uncertain_names
from pgmp_petsc.stepping.alpha_step import LENGTHS
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.status import Status

SMALL = 2.5e-4  # s of a step of a sample of the reference, for runs that are not needed for the choice itself
BATCH = 256  # samples, for processor times
# What one setting may fail with while the others go on: errors meant for the user, and those of numerical libraries
# (PETSc's and MPI's are RuntimeErrors); a mistake of the program ends the study.
FAILURES = (PgmpError, RuntimeError, ArithmeticError, np.linalg.LinAlgError, MemoryError)
MOST_TIMED_TOGETHER = 128
TIMED = 2.0  # s of processor time of one run that is timed, predicted
FEWEST_STEPS = 8  # that a longer run is timed by
OF_BUDGET = 0.1  # of reference.budget, for runs of the mesh where it is not the reference
LONG = 2.0  # s; a build that takes longer, or a run that did, is timed once
WARM_UP_STEPS, WARM_UP_ANGLES = 2, 6
#: Of all models on the shelf together; tables of second order grow with the third power of the flexible coordinates.
MOST_BYTES = 2**29
OF_HISTORY = "history."  # names of kept arrays that are parts of a history


@dataclass(frozen=True)
class Measured:
    """Measurements of a setting at a case; they are sent to the first rank, and kept."""

    history: History | None  # outputs; None where the setting failed, or its runs cost too much
    n_coordinates: int = 0  # unknowns: reduced, nodal or component coordinates, or nodes of a surface
    cosine: float = 1.0  # smallest cosine between neighbouring spaces of modes; 1 where there are none
    reason: str = ""  # why there is no history; empty where there is one
    # wall and processor time of what comes before the first sample, shape (2,), s; NaN where it failed
    offline: tuple[float, float] = (np.nan, np.nan)

    @property
    def arrays(self) -> Arrays:
        arrays = {name: np.array(value) for name, value in vars(self).items() if name != "history"}
        parts = {} if self.history is None else self.history.arrays
        return arrays | {f"{OF_HISTORY}{name}": value for name, value in parts.items()}

    @classmethod
    def of_arrays(cls, arrays: Arrays) -> Self:
        whole = {name.removeprefix(OF_HISTORY): value for name, value in arrays.items() if name.startswith(OF_HISTORY)}
        kinds = {"n_coordinates": int, "cosine": float, "reason": str, "offline": lambda pair: tuple(map(float, pair))}
        history = History.of_arrays(whole) if whole else None
        return cls(history, **{name: kind(arrays[name]) for name, kind in kinds.items()})


class Bench:
    """Runs what is to be compared; methods are collective on `comm`, whose ranks share the loads, unless they say
    otherwise.

    Errors are measured against the reference, any model where its own steps alone are compared; the training has the
    samples, and loads, to run. The subject is the scene and its bodies, condensed for all settings, None where only the
    reference runs, the group ranks that share an eigenproblem. The bar counts the runs. Results are kept where an
    earlier run of the program left some (`finished`).

    Where it is `timed` each model is made from nothing, and kept for its times; `comm` is this rank alone then.
    Processor times, s, of what was done once for all settings, of families by name, are to be added: condensing the
    bodies for ``reduced`` ones, preparing the reference for a ``surface``.
    """

    def __init__(
        self,
        reference: Reference,
        training: Training,
        comm: Comm,
        subject: Subject | None = None,
        group: RankGroup | None = None,
        bar: Progress | None = None,
        finished: Finished | None = None,
        timed: Mapping[str, float] | None = None,
    ) -> None:
        self.reference, self.training, self.comm, self.group = reference, training, comm, group
        self.scene, self.full_model = reference.model.scene if subject is None else subject.scene, reference.model
        self._subject, self._bar, self._finished, self._timed = subject, bar, finished, timed
        self.remarks = list(training.remarks)
        self.spent = 0.0  # s of processor time, that candidates so far were predicted to take
        self.outputs = tuple(self.full_model.outputs.functions)
        with agreed(comm, "preparing training runs"):
            self.floors = histories.floors_of(self.full_model)
        self.batch = min(self.scene.ensemble.batch, MOST_TIMED_TOGETHER)
        self.pulse: Pulse = lambda n: None  # while a setting is measured
        self._histories: dict[tuple[Case, Setting], History] = {}
        self._ran: set[tuple[Case, Setting]] = set()  # the same on all ranks
        self._shelf = Shelf(self.build)
        self._models: dict[tuple, tuple[Model | ResponseSurface, int, float]] = {}
        self._offline: dict[tuple, list[np.ndarray]] = {}
        self._online: dict[tuple[Setting, int], np.ndarray] = {}
        self._steps: dict[Setting, float] = {}  # s of a step of a sample, of the runs at the test values
        self.spent_on: dict[Setting, np.ndarray] = {}  # wall and processor time of timed runs, shape (2,), s

    def predicted(self, setting: Setting) -> float:
        """Return the processor time that a setting is predicted to take at the test values, s; not collective."""
        scene, mechanism = self.scene, self._subject.kinematics.mechanism
        n_steps = setting.n_steps * (setting.nodes or self.training.n_samples)
        if setting.component_modes:
            return n_steps * prices.component_step(
                mechanism, prices.amplitudes(scene, mechanism, setting.component_modes)
            )
        if setting.reduction is None:
            return n_steps * setting.refinement * self.reference.price.step
        scene = scene.with_entries(reduction=setting.reduction)
        sizes = setting.reduction.modes, len(scene.coordinates)
        step = prices.reduced_step(*sizes, scene.second_order, prices.n_local(scene))
        return prices.build_seconds(scene, mechanism) + n_steps * step

    # models of settings

    def build(self, reduction: Reduction) -> ReducedOrderModel:
        """Build a reduced model of the scene and give it to all ranks."""
        scene = self.scene.with_entries(reduction=reduction)
        with without_progress():
            rom = build_rom(scene, self._subject.shapes, self.group)
        return self.comm.bcast(rom)

    def rom_of(self, trial: Trial) -> ReducedOrderModel:
        """Return the reduced model of a trial that could be built, on all ranks; built again where it was let go."""
        return self._shelf.take(trial.reduction)

    def _model(self, setting: Setting) -> tuple[Model | ResponseSurface, int, float]:
        """Return what a setting runs with, its number of coordinates, and the smallest cosine; see `Measured`."""
        if setting.family == "components":
            model = component_model(self.scene, self._subject.meshes, self.comm, setting.component_modes)
            return model, sum(model.n_amplitudes.values()), 1.0
        families = {"reduced": self._reduced, "reference": self._full, "full": self._full, "surface": self._surface}
        return families[setting.family](setting)

    def _reduced(self, setting: Setting) -> tuple[ReducedModel, int, float]:
        scene = self.scene.with_entries(reduction=setting.reduction)
        if self._timed is None:
            rom, kinematics = self._shelf.take(setting.reduction), self._subject.kinematics
        else:
            step = histories.step_of(scene.simulation.duration, setting.n_steps)
            scene = scene.with_entries(simulation={"step": step})
            shapes = self._subject.shapes if setting.refinement == 1 else self._refined(setting.refinement)
            rom, kinematics = build_rom(scene, shapes, self.group), None
        n_coordinates = rom.tables.n_coordinates + rom.tables.n_modes
        return ReducedModel(scene, rom, kinematics), n_coordinates, float(rom.cosines.min())

    def _full(self, setting: Setting) -> tuple[Model, int, float]:
        if setting.family == "reference" and setting.refinement == 1:
            model = self.reference.model
        else:
            meshes = self._subject.meshes if setting.refinement == 1 else self._refined(setting.refinement)
            model = FullModel(self.scene, meshes)
        return model, model.kinematics.mechanism.n_dofs, 1.0

    def _surface(self, setting: Setting) -> tuple[ResponseSurface, int, float]:
        nodes = histories.node_values(self.scene, setting.nodes)
        values = histories.at_values(self.scene, nodes)
        runs = histories.run_history(self.reference.model, values, setting.nodes, setting.n_steps, pulse=self.pulse)
        runs.require_fine(self.scene, values)
        return ResponseSurface(nodes, dict(zip(self.outputs, runs.outputs))), setting.nodes, 1.0

    def _refined(self, parts: int) -> dict[str, BodyShape]:
        lines = {name: mesh for name, mesh in self._subject.meshes.items() if isinstance(mesh, LineMesh)}
        return {name: refined(mesh, parts) for name, mesh in lines.items()}

    # runs and their errors

    def errors(
        self,
        names: Sequence[str],
        found: Setting,
        exact: Setting,
        of: Callable[[Case], Case] = lambda case: case,
        factor: float = 1.0,
    ) -> Errors:
        """Return how far two settings are apart under some loads, times a factor, in cases made `of` these."""
        cases = [of(self.training.case(self.scene, name, factor)) for name in names]
        for setting in (exact, found):
            self._run(cases, setting)
        mine = {}
        with agreed(self.comm, "comparing training runs"):
            for case in self._own(cases):
                one, other = (self._histories[case, setting] for setting in (found, exact))
                apart = histories.errors_between(one, other, self.floors)
                mine[case.load] = apart, histories.round_off_of(other, self.floors)
        every = {name: item for part in self.comm.allgather(mine) for name, item in part.items()}
        values, round_off = (np.array([every[name][k] for name in names]) for k in (0, 1))
        return Errors(values, round_off, tuple(names), self.outputs, self.training)

    def _run(self, cases: Sequence[Case], setting: Setting) -> None:
        """Do the runs that are missing; what candidates are compared with has no numbers of samples that leave the
        range of their coordinate."""
        todo = [case for case in cases if (case, setting) not in self._ran]
        if not todo:
            return
        model = self._model(setting)[0]
        large = self.full_model.kinematics.mechanism.n_dofs >= 2 * UNKNOWNS_PER_RANK
        alone = self._subject is None and self.training.n_cases == 1  # the only run; nothing is reduced then
        if alone and large and not isinstance(self.full_model, ReducedModel):
            with first_ranks(self.comm, self.comm.size) as workers, agreed(self.comm, "training runs"):
                with model.distributed(self.scene.values, workers) as system:
                    self._histories[todo[0], setting] = histories.integrated(model, system, setting.n_steps)
        else:
            with agreed(self.comm, f"{setting.family} training runs"):
                for case in self._own(todo):
                    self._histories[case, setting] = self._history(case, setting, model)
        self._ran.update((case, setting) for case in todo)

    def _history(self, case: Case, setting: Setting, model: Model) -> History:
        """Run a case on this rank, or take up what an earlier run of the program has of the reference."""
        if setting.family != "reference":
            history = history_of(case, setting, model)
        else:
            key = (self.full_model.name, case, setting)
            history = self._kept("reference", key, lambda: Measured(history_of(case, setting, model))).history
        if self._subject is not None:  # a candidate cannot follow them there
            history.outputs[..., ~history.inside] = np.nan
        return history

    def _kept(self, kind: str, key: object, make: Callable[[], Measured]) -> Measured:
        """Return what an earlier run of the program left of a task, or do it and keep it."""
        kept = None if self._finished is None else self._finished.get(kind, key)
        if kept is not None:
            return Measured.of_arrays(kept)
        measured = make()
        if self._finished is not None:
            self._finished.put(kind, key, measured.arrays)
        return measured

    def _own(self, cases: Sequence[Case]) -> list[Case]:
        """Return the cases of this rank; those of a load have the same rank throughout."""
        return [case for case in cases if self.training.names.index(case.load) % self.comm.size == self.comm.rank]

    # what is asked of candidates for a tolerance

    def moved(self, coarse: int, fine: int, loads: tuple[str, ...] | None = None) -> Errors:
        """Return how far runs of the reference with two numbers of steps are apart."""
        found = self.errors(loads or self.training.names, Setting("reference", coarse), Setting("reference", fine))
        if self._bar is not None:
            self._bar.update()
        return found

    def check_references(self, n_steps: int, loads: tuple[str, ...] | None = None) -> None:
        """Note which training cases do not count; raises `RunError` if the scene itself, at nominal parameters, cannot
        be run."""
        names, title, setting = loads or self.training.names, self.full_model.title, Setting("reference", n_steps)
        cases = [self.training.case(self.scene, name) for name in names]
        self._run(cases, setting)
        mine = {}
        for case in self._own(cases):
            history = self._histories[case, setting]
            failed = history.status != Status.FINE
            mine[case.load] = (failed, ~failed & ~history.inside, Status(history.status[0]).meaning)
        every = {name: item for part in self.comm.allgather(mine) for name, item in part.items()}
        for k, name in enumerate(names):
            failed, outside, meaning = every[name]
            if k == 0 and (failed[0] or outside[0]):
                reason = meaning if failed[0] else "the coordinate leaves its range"
                raise RunError(f"training run of the {title} model at nominal parameters, own loads: {reason}")
            for mask, what in ((failed, "fails"), (outside, "leaves the range of the coordinate")):
                if mask.any():
                    of = f"{mask.sum()} of {mask.size} samples"
                    self.remarks.append(f"load '{name}': the {title} model {what} in {of}; they do not count")

    def try_out(self, reduction: Reduction, n_steps: int, loads: tuple[str, ...] | None = None) -> Trial:
        """Build a candidate, run it under some loads (all, by default) and compare it with the full-order model."""
        start, given = perf_counter(), "parameter_modes" in self.scene.reduction.model_fields_set
        try:
            rom = self._shelf.take(reduction)
            if rom.points.n_vectors < reduction.parameter_modes and not given:
                # beside many modes fewer of other parameter values are independent: it is the model that asks for these
                reduction = reduction.model_copy(update={"parameter_modes": rom.points.n_vectors})
                remarks = tuple(one for one in rom.record.remarks if not one.text.startswith(FEW_VECTORS))
                self._shelf.take(reduction, replace(rom, record=replace(rom.record, remarks=remarks)))
            reason = rom.indefinite
        except PgmpError as error:
            # what the scene gives itself is wrong whatever is chosen beside it; a candidate of ours is just no use
            if isinstance(error, InputError) and given:
                raise
            reason = str(error)
        self._bar.update()
        seconds = self.comm.bcast(perf_counter() - start)
        return self.go_on(Trial(reduction, n_steps, self._endless(()), reason, seconds, not reason), loads)

    def go_on(self, trial: Trial, loads: tuple[str, ...] | None = None) -> Trial:
        """Run a candidate under further loads."""
        start, exact = perf_counter(), trial.exact
        names = tuple(dict.fromkeys((*trial.errors.loads, *(loads or self.training.names))))
        if names == trial.errors.loads:
            return trial
        self._run([self.training.case(self.scene, name) for name in names], exact)
        errors, reason = self._endless(names), trial.reason
        if trial.built:
            try:
                errors = self.errors(names, trial.setting, exact)
                if not np.isfinite(errors.largest):
                    reason = reason or self._failures(names, trial.setting)
            except RunError as error:
                trial, reason = replace(trial, built=False), str(error)
        seconds = trial.seconds + self.comm.bcast(perf_counter() - start)
        return replace(trial, errors=errors, reason=reason, seconds=seconds)

    def apart(self, one: Trial, other: Trial) -> Errors:
        """Return how far two candidates that ran with the same step are apart, under the loads that both ran with."""
        names = tuple(name for name in one.errors.loads if name in other.errors.loads)
        if not (one.built and other.built):
            return replace(one.errors, values=np.full_like(one.errors.values, np.inf))
        errors = self.errors(names, one.setting, other.setting)
        # where the other one failed there is no number; what does not count against the full-order model does not here
        counts = ~np.isnan(one.errors.values[[one.errors.loads.index(name) for name in names]])
        values = np.where(np.isnan(errors.values), np.inf, errors.values)
        return replace(errors, values=np.where(counts, values, np.nan))

    def from_rest(self, trial: Trial, load: str, sample: int) -> tuple[np.ndarray, np.ndarray]:
        """Return what halving the step moves of one full-order sample that starts at rest where the loads pull it, and
        the candidate's error from there; each of shape (n_outputs,), infinite where there is no such start."""
        exact, finer = trial.exact, Setting("reference", 2 * trial.n_steps)
        try:
            found = [
                self.errors((load,), one, exact, lambda case: case.from_rest(sample)).values[0, :, 0]
                for one in (finer, trial.setting)
            ]
        except PgmpError:
            return tuple(np.full((2, len(self.outputs)), np.inf))
        return tuple(np.where(np.isnan(one), np.inf, one) for one in found)

    def finer_meshes(self, n_steps: int) -> Errors | None:
        """Return how far the scene's own runs are from those with cells cut in two; None where that is not known: of
        large meshes and of those of continuum cells."""
        lines = all(isinstance(mesh, LineMesh) for mesh in self._subject.meshes.values())
        if not (lines and self.reference.is_mesh and self.reference.price.step <= SMALL):
            return None
        return self.errors(self.training.names[:1], Setting("reference", n_steps), Setting("full", n_steps, 2))

    @property
    def most_steps(self) -> float:
        """Steps of a run up to which all runs with halved steps, of the loads that the step is found with, are within
        ``reference.budget``; no limit where the reference was named, whatever it takes, and of a reduced model."""
        cases = self.training.n_samples * sum(load.for_step for load in self.training.loads)
        # runs of n, n / 2, n / 4 ... steps are 2 n of them
        return self.budget / (2.0 * cases * self.reference.price.step) if self.reference.price.step else np.inf

    @property
    def budget(self) -> float:
        """Processor time that runs may be predicted to take (s); no limit where the reference was named."""
        return self.scene.reference.budget if self.scene.reference.model == "auto" else np.inf

    def _endless(self, names: tuple[str, ...]) -> Errors:
        shape = (len(names), len(self.outputs), self.training.n_samples)
        return Errors(np.full(shape, np.inf), np.zeros(shape), names, self.outputs, self.training)

    def _failures(self, names: Sequence[str], setting: Setting) -> str:
        """Return why samples of a candidate failed, empty where none did."""
        own = self._own([self.training.case(self.scene, name) for name in names])
        found = {status for case in own for status in self._histories[case, setting].status if status != Status.FINE}
        meanings = {Status(status).meaning for status in found}
        return "; ".join(sorted({text for part in self.comm.allgather(meanings) for text in part}))

    # times

    def processor_times(self, trial: Trial, n_reduced: int, n_full: int) -> tuple[float, float]:
        """Return the processor time of a reduced and of a reference sample under the scene's own loads, s.

        Both are run in batches of `BATCH` samples, as far as they take so many: lanes are then full.
        """
        models, times = [self._model(trial.setting)[0], self.full_model], ()
        with agreed(self.comm, "runs for the processor time"):
            if self.comm.rank == 0:
                for model, n_steps in zip(models, (n_reduced, n_full)):
                    # the first time loads what is compiled
                    times = (*times, min(float(self.seconds(model, n_steps, BATCH)[1]) for _ in range(2)))
        return self.comm.bcast(times)

    def seconds(self, model: Model | ResponseSurface, n_steps: int, n_samples: int, known: float = 0.0) -> np.ndarray:
        """Return wall and processor time of a sample in a batch of n, shape (2,), s; by this rank.

        The samples of the training are repeated until there are n, and their outputs evaluated at the end. Of a step of
        a sample a processor time may be known, s.
        """
        n = n_samples
        if isinstance(model, ResponseSurface):
            points, start = self._points, _now()
            model.evaluate(np.resize(points, (n, points.shape[1])))
            return (_now() - start) / n
        step, taken = max(step_price(model), known), n_steps
        n = min(n, model.largest_batch)
        if n * n_steps * step > TIMED:
            n = min(n, max(LANES, int(TIMED / (n_steps * step))))
        if n * n_steps * step > TIMED:
            taken = min(taken, max(FEWEST_STEPS, int(TIMED / (n * step))))
        simulation = model.scene.simulation.in_steps(n_steps)
        if taken < n_steps:
            simulation = simulation.in_steps(taken, simulation.duration * taken / n_steps)
        values = {name: np.resize(column, n) for name, column in self.training.values.items()}
        start = _now()
        with closing(model.batch(values, n)) as system:
            begun = _now()
            run = integrate(system, simulation)
            model.outputs.evaluate(model.observed(system, run.state, simulation.duration))
            first = len(LENGTHS)  # steps that a run begins with: of the few that are timed they are no small share
            return (begun - start + (_now() - begun) * (first + n_steps) / (first + taken)) / n

    # what is measured of settings, on this rank alone

    @property
    def ready(self) -> list[Setting]:
        """Settings that were measured here and did not fail."""
        return list(self.spent_on)

    def warm_up(self, setting: Setting, second_order: bool) -> None:
        """Load and compile what the first measurement would otherwise pay for."""
        if setting.reduction is not None:
            setting = setting.with_reduction(
                modes=1, parameter_modes=0, angles=WARM_UP_ANGLES, second_order=second_order, interpolation="spline",
                sampling_tolerance=None,
            )  # fmt: skip
        for warm in (setting, Setting("full", setting.n_steps)):
            try:
                model = self._model(warm)[0]
                simulation = self.scene.simulation
                short = simulation.in_steps(WARM_UP_STEPS, simulation.duration * WARM_UP_STEPS / setting.n_steps)
                for n in {min(self.training.n_samples, model.largest_batch), 1}:
                    values = {name: column[:n] for name, column in self.training.values.items()}
                    with closing(model.batch(values, n)) as system:
                        integrate(system, short)
            except FAILURES:
                continue  # whatever is wrong will be met again, with its reason

    def measure(self, setting: Setting) -> Measured:
        """Make a setting ready and run it at the scene's own loads, or take up what an earlier run of the program found
        out about it; a failure is returned, not raised."""
        measured = self._kept("task", setting, lambda: self._measured(setting))
        if setting.family != "reference" and np.isfinite(measured.offline[0]):
            self.spent_on.setdefault(setting, np.zeros(2))
            self._offline.setdefault(setting.build, [np.array(measured.offline)])
        return measured

    def _measured(self, setting: Setting) -> Measured:
        case, history = self.training.case(self.scene, self.training.names[0]), None
        try:
            model, n_coordinates, cosine = self._ready(setting)
            reason = self._too_dear(setting, model)
            if isinstance(model, ResponseSurface):
                found, n, n_steps = model.evaluate(self._points), self.training.n_samples, setting.n_steps
                outputs = np.array([found[name] for name in self.outputs])
                fine, inside = np.full(n, Status.FINE), np.ones(n, dtype=bool)
                history = History(n_steps, histories.spacing(n_steps), outputs, fine, inside, np.full(n, np.nan))
            elif not reason:
                begin = process_time()
                history = history_of(case, setting, model, self.pulse).require_fine(case.scene, case.values)
                self._steps[setting] = (process_time() - begin) / (case.n_samples * setting.n_steps)
        except FAILURES as error:
            reason = str(error) if isinstance(error, PgmpError) else f"{type(error).__name__}: {error}"
            return Measured(None, reason=" ".join(reason.split()))
        wall, processor = self._offline[setting.build][0]
        return Measured(history, n_coordinates, cosine, reason, (float(wall), float(processor)))

    def _ready(self, setting: Setting) -> tuple[Model | ResponseSurface, int, float]:
        """Prepare a setting, or return what was prepared for one with the same build."""
        if setting.build not in self._models:
            self._models[setting.build], seconds = self._prepared(setting)
            self._offline.setdefault(setting.build, [seconds])
        return self._models[setting.build]

    def _prepared(self, setting: Setting) -> tuple[tuple[Model | ResponseSurface, int, float], np.ndarray]:
        start = _now()
        made = self._model(setting)
        shared = self._timed.get(setting.family, 0.0) if setting.refinement == 1 else 0.0
        return made, shared + _now() - start

    def _too_dear(self, setting: Setting, model: Model | ResponseSurface) -> str:
        """Return why a setting is not run at the test values; empty where it is."""
        if setting.family != "full" or self.reference.is_mesh:
            return ""
        price = self.training.n_samples * setting.n_steps * step_price(model)
        allowed = OF_BUDGET * self.scene.reference.budget
        if price <= allowed:
            return ""
        return (
            f"too dear to be run at the test values: {prices.duration_text(price)} of processor time are predicted, "
            f"{prices.duration_text(allowed)} are a tenth of reference.budget; its times are those of its first steps"
        )

    @property
    def _points(self) -> np.ndarray:
        """Values of the uncertain parameters, shape (n_samples, n_uncertain)."""
        return np.column_stack([self.training.values[name] for name in uncertain_names(self.scene)])

    def take_times(self, setting: Setting, turn: int, few_repeats: int) -> None:
        """Take the times of a setting that is ready, for the `turn`-th time; the least of all turns counts.

        Single samples are timed, and builds, in the first `few_repeats` turns alone; what is long once.
        """
        model = self._ready(setting)[0]
        for n in (self.batch, 1) if turn <= few_repeats else (self.batch,):
            if n * self._online.get((setting, n), np.zeros(2))[1] >= LONG:
                continue
            seconds = self.seconds(model, setting.n_steps, n, self._steps.get(setting, 0.0))
            self.spent_on[setting] = self.spent_on[setting] + n * seconds
            self._online[setting, n] = np.minimum(seconds, self._online.get((setting, n), np.inf))
        taken = self._offline[setting.build]
        if len(taken) < min(turn, few_repeats) and taken[0][0] < LONG:
            taken.append(self._prepared(setting)[1])

    def times(self, setting: Setting) -> np.ndarray:
        """Return the times of a setting: offline, of a sample in a batch, of one alone; shape (3, 2), wall first, s."""
        offline = np.min(self._offline[setting.build], axis=0)
        return np.array([offline, self._online[setting, self.batch], self._online[setting, 1]])

    def n_cells(self, refinement: int) -> int:
        return refinement * sum(mesh.n_cells for mesh in self._subject.meshes.values())


def history_of(case: Case, setting: Setting, model: Model, pulse: Pulse = lambda n: None) -> History:
    """Run a case with a model of a setting, on this rank."""
    loaded = model if case.name == OWN else model.with_loads(case.scene)
    return histories.run_history(loaded, case.values, case.n_samples, setting.n_steps, pulse=pulse)


def step_price(model: Model) -> float:
    """Return the predicted processor time of a step of a sample, s; none of a reduced model."""
    return 0.0 if isinstance(model, ReducedModel) else prices.step_seconds(model.kinematics.mechanism)


def _now() -> np.ndarray:
    return np.array([perf_counter(), process_time()])


class Shelf:
    """Models by their reduction. The same on all ranks, which take the same models in the same order; they may have
    `most_bytes` together, and the latest one stays, however large."""

    def __init__(self, build: Callable[[Reduction], ReducedOrderModel], most_bytes: int = MOST_BYTES) -> None:
        self._build, self._most = build, most_bytes
        self._models: dict[Reduction, tuple[ReducedOrderModel, int]] = {}

    def take(self, reduction: Reduction, made: ReducedOrderModel | None = None) -> ReducedOrderModel:
        """Return a model, which is built where it is neither at hand nor `made`, and let the oldest ones go.
        Collective."""
        kept = self._models.pop(reduction, None)
        rom = kept[0] if kept is not None else self._build(reduction) if made is None else made
        self._models[reduction] = rom, bytes_of(rom)
        while len(self._models) > 1 and sum(size for _, size in self._models.values()) > self._most:
            del self._models[next(iter(self._models))]
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
