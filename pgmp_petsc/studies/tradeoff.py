"""What accuracy costs in time: errors and times of many settings, all measured in one run.

First the reference is chosen: the mesh, or the component model where the mesh is too dear (`experiments.reference`).
Then rounds: the scene's own setting, lines through it and a tensor, while other ranks begin the reference; lines
through the best settings found; then the reference is refined until it is good enough for the smallest error. Last all
times are taken, round after round over all settings, so that what else the machine does meanwhile hits all alike. Tasks
are dealt to ranks, and each rank works by itself; what it has finished is kept for a run that is resumed. What is
decided on the way is decided on the first rank and from errors, never from times: errors do not depend on the number of
ranks.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from time import process_time
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.bodies.floating import PAIR_SECONDS
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.experiments.finished import Finished, step_seconds
from pgmp_petsc.experiments.history import floors_of, largest_errors
from pgmp_petsc.experiments.reference import Demand, Reference, Subject, choose_reference, distance_from_mesh
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.models import FullModel
from pgmp_petsc.results.tradeoff import MeshErrors, References, Times, Tradeoff
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.errors import InputError, RunError, note
from pgmp_petsc.runtime.files import RunRecord
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.runtime.progress import without_progress
from pgmp_petsc.runtime.timings import Timings
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.lengths import length_names, with_numbers
from pgmp_petsc.selection.ladder import Limits as Basis
from pgmp_petsc.studies.tradeoff_advice import advise
from pgmp_petsc.studies.tradeoff_measurement import TIMED, Bench, Measured, ReferenceSequence, held_out
from pgmp_petsc.studies.tradeoff_runner import Dealer, Prices, ReferenceRun, Runner, Task, tasks_of
from pgmp_petsc.studies.tradeoff_settings import (
    Limits,
    Setting,
    Sweep,
    best_settings,
    columns_of,
    first_settings,
    own_setting,
    own_steps,
    settings_around,
)

if TYPE_CHECKING:
    from mpi4py import MPI

MORE_MODES = 1.5  # of the component model as a reference, for each that a basis or another component model has
COARSER = 4  # of the scene's steps, for the distance of the component model from the mesh
FRAME_FIELDS = 12  # amplitudes of a body beside its modes, for a rough price


def measure_tradeoff(
    scene: Scene,
    meshes: Mapping[str, BodyShape],
    sweep: Sweep,
    n_samples: int,
    quick: bool,
    comm: MPI.Comm,
    finished: Finished | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Tradeoff | None:
    """Measure errors and times of the settings of a sweep. Collective on `comm`.

    Parameters
    ----------
    scene, meshes
        The scene, with outputs.
    sweep
        How many settings.
    n_samples
        Number of samples that the advice is for.
    quick
        Whether the sweep is the short one; for the record.
    comm
        Ranks that share the settings.
    finished
        What an earlier run finished, and where finished tasks are kept.
    say
        Gets what errors are measured against and what that is predicted to take, before it is run.

    Returns
    -------
    Tradeoff or None
        On the first rank, None elsewhere.

    Raises
    ------
    InputError
        If the scene has no outputs, its mechanism cannot be closed, or there is no reference within the budget.
    RunError
        If the reference fails at a test value, so that there is nothing to compare with.
    """
    if not scene.outputs:
        raise InputError(
            "outputs: the scene has none, so there is no error to measure; give one, such as "
            '[outputs.angle] type = "angle", joint = "<a revolute joint>"'
        )
    scene = _of_one_mechanism(scene)
    timings, sweep = Timings(), sweep.over(len(scene.coordinates))
    with timings.phase("preparation"), without_progress():
        subject, reference, shared = _prepared(scene, meshes, sweep, comm, say)
        with agreed(comm, "preparing the study"):
            limits = _limits(subject, reference)
            bench = Bench(subject, reference, sweep.few_repeats, shared)
            bench.warm_up(own_setting(scene), limits.second_order)
            dealer = Dealer(comm.size, _prices(subject, reference, sweep), bench.batch, sweep.repeats)
            dealer.n_coordinates = len(scene.coordinates)
    study = _Study(scene, sweep, bench, limits)
    runner = Runner(bench, comm, finished)
    with timings.phase("settings and references"):
        for title, plan in (("first settings", study.first), ("further settings", study.further)):
            study.take(runner.work(dealer.deal(on_root(comm, plan)), title))
        while tasks := on_root(comm, study.references):
            study.take(runner.work(dealer.deal(tasks), "reference"))
    with timings.phase("times"):
        times, waiting = runner.times(sweep.repeats)
    timings = timings.maximum(comm)
    if comm.rank > 0:
        return None
    remarks = (*scene.remarks, *(() if finished is None else finished.remarks))
    record = RunRecord(scene_to_toml(scene), scene.values, None, comm.size, timings.as_dict(), remarks)
    result = study.result(record, reference.model.outputs.units, times)
    result = replace(result, samples=n_samples, quick=quick, waiting=waiting)
    return replace(result, advice=advise(result))


def _of_one_mechanism(scene: Scene) -> Scene:
    """Return a scene whose lengths and places are numbers, those of its run, with what that means for the figures."""
    names = length_names(scene)
    if not names:
        return scene
    lengths = {name: scene.values[name] for name in names}
    n_builds = scene.reduction.length_points ** len(names) + 1
    said = note(
        f"settings are compared at {', '.join(f'{name} = {value:.6g}' for name, value in lengths.items())}, other "
        f"values with --set; over all lengths a build is {n_builds} of those that are timed here, and samples take "
        "somewhat longer (docs/uncertainty.md, lengths and places)"
    )
    return with_numbers(scene, lengths).with_remarks((*scene.remarks, said))


def _prepared(
    scene: Scene, meshes: Mapping[str, BodyShape], sweep: Sweep, comm: MPI.Comm, say: Callable[[str], None]
) -> tuple[Subject, Reference, dict[str, float]]:
    """Condense bodies and choose the reference; return the processor times of both by what they are for."""
    modes = scene.reduction.modes
    factors = (1.0, *sweep.own_modes)
    most = max(*sweep.modes, *sweep.tensor_modes, *(round(f * modes) for f in factors), 1)
    with RankGroup.split(comm, 1) as group:
        begin = process_time()
        subject = Subject.of(scene, meshes, group, most)
        condensing = comm.allreduce(process_time() - begin)
    begin = process_time()
    reference = choose_reference(scene, meshes, subject.kinematics, _demand(scene, sweep, most), comm)
    preparing = comm.allreduce(process_time() - begin)
    say(reference.why)
    values = held_out(scene)
    n_values = next((len(column) for column in values.values()), 1)
    coarse = max(own_steps(scene) // COARSER, 1)
    reference = distance_from_mesh(reference, meshes, values, n_values, coarse, comm)
    return subject, reference, {"reduced": condensing, "surface": preparing}


def _demand(scene: Scene, sweep: Sweep, most: int) -> Demand:
    """Return what the reference has to run, at least: two runs with small steps, and the surfaces' nodes."""
    n, n_values = own_steps(scene), next((len(column) for column in held_out(scene).values()), 1)
    steps = 3 * 4 * n * 2**sweep.finer * n_values
    cases = f"{n_values} test values"
    cure = "shorten simulation.duration, or take a larger simulation.step"
    return Demand("pgmp tradeoff", float(steps), cases, cure, round(MORE_MODES * max(most, *sweep.component_modes, 1)))


def _limits(subject: Subject, reference: Reference) -> Limits:
    """Return what the scene allows."""
    basis = Basis.of(subject.scene, subject.kinematics, subject.n_modes)
    lines = all(isinstance(mesh, LineMesh) for mesh in subject.meshes.values())
    return Limits(basis.n_modes, len(subject.scene.effects), basis.second_order, lines and reference.is_mesh)


def _prices(subject: Subject, reference: Reference, sweep: Sweep) -> Prices:
    """Return what steps of the families are predicted to take."""
    full = FullModel(subject.scene, subject.meshes, subject.kinematics)
    n = max((*sweep.component_modes, 1)) + FRAME_FIELDS
    flexible = sum(body.flexible for body in subject.scene.bodies.values())
    components = PAIR_SECONDS * n**2 * flexible if reference.is_mesh else reference.price.step
    return Prices(step_seconds(full.kinematics.mechanism), components, reference.price.step, TIMED)


@dataclass
class _Study:
    """What was measured so far and what comes next; used on the first rank."""

    scene: Scene
    sweep: Sweep
    bench: Bench
    limits: Limits
    _asked: list[Setting] = field(default_factory=list)
    _measured: dict[Setting, Measured] = field(default_factory=dict)
    _meshes: dict[int, Measured] = field(default_factory=dict)
    _sequences: dict[int, ReferenceSequence] = field(init=False)
    _floors: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        n, halvings = own_steps(self.scene), self.sweep.reference_halvings
        self._floors = floors_of(self.bench.reference.model)
        # where errors fall by 4 with each halving, a step of an eighth of the finest one is the first that can settle;
        # on refined meshes no setting has a finer step than the scene's
        refinements = self.sweep.refinements if self.limits.refinable else ()
        finest = {1: n * 2**self.sweep.finer} | dict.fromkeys(refinements, n)
        self._sequences = {
            refinement: ReferenceSequence(4 * steps, self._most(n * 2 ** halvings[refinement > 1]), self._floors)
            for refinement, steps in finest.items()
        }

    def _most(self, n_steps: int) -> int:
        """Return the most steps of the reference that are within its budget, if that is fewer."""
        reference, entry = self.bench.reference, self.scene.reference
        n_values = next((len(column) for column in self.bench.values.values()), 1)
        while entry.model == "auto" and 2.0 * n_values * n_steps * reference.price.step > entry.budget:
            n_steps //= 2
        return n_steps

    def first(self) -> list[Task]:
        """Return the first tasks."""
        finest = [ReferenceRun(self.sweep.finest, own_steps(self.scene))] if self.limits.refinable else []
        self._asked = first_settings(self.scene, self.sweep, self.limits)
        return tasks_of(self._asked, [*finest, *self._missing(1)])

    def further(self) -> list[Task]:
        """Return the lines through the best settings of the first tasks, and runs that the references still need.

        Raises
        ------
        RunError
            If there is no reference on the scene's meshes.
        """
        if not self._sequences[1].usable:
            raise RunError(f"the {self.bench.reference.model.title} reference: {self._sequences[1].failure}")
        worst = [float(np.max(self._errors(setting))) for setting in self._asked]
        n_coordinates = [self._measured[setting].n_coordinates for setting in self._asked]
        best = best_settings(self._asked, worst, n_coordinates)
        around = settings_around(best, self.scene, self.sweep, self.limits)
        new = [setting for setting in around if setting not in self._measured]
        self._asked += new
        return tasks_of(new, self._all_missing())

    def references(self) -> list[Task]:
        """Return the runs that the references still need."""
        return tasks_of([], self._all_missing())

    def take(self, found: Mapping[Setting | ReferenceRun, Measured] | None) -> None:
        """Take in what tasks gave; None on all ranks but the first."""
        for work, measured in (found or {}).items():
            if isinstance(work, Setting):
                self._measured[work] = measured
            elif work.refinement == self.sweep.finest:
                self._meshes[work.refinement] = measured
        runs = [work for work in found or {} if isinstance(work, ReferenceRun) and work.refinement in self._sequences]
        for run in sorted(runs, key=lambda run: run.n_steps):
            sequence, measured = self._sequences[run.refinement], found[run]
            if measured.history is None:
                sequence.give_up(measured.reason)
            elif not sequence.failure:
                sequence.add(run.n_steps, measured.history)

    def result(self, record: RunRecord, units: dict[str, str], times: Mapping[Setting, np.ndarray]) -> Tradeoff:
        """Put everything together; the settings stand in the order in which they were asked for, whoever had them."""
        settings = self._asked
        errors = np.array([self._errors(setting) for setting in settings])
        seconds = np.array([times.get(setting, np.full((3, 2), np.nan)) for setting in settings])
        columns = columns_of(settings, self.scene)
        for name, attribute in (("coordinates", "n_coordinates"), ("cosine", "cosine")):
            columns[name] = np.array([getattr(self._measured[setting], attribute) for setting in settings])
        return Tradeoff(
            record=record,
            units=units,
            test_values=self.bench.values,
            parameter_units={name: parameter.unit or "1" for name, parameter in self.scene.parameters.items()},
            families=tuple(setting.family for setting in settings),
            columns=columns,
            flags=tuple(_flags(setting, self.scene) for setting in settings),
            reasons=tuple(self._reason(setting, row) for setting, row in zip(settings, errors)),
            errors=errors,
            wall=Times(*seconds[:, :, 0].T),
            processor=Times(*seconds[:, :, 1].T),
            references=self._references(),
            mesh=self._mesh_errors(len(units)),
            batch=self.bench.batch,
            repeats=self.sweep.repeats,
            reference=self.bench.reference.why,
            reference_model=self.bench.reference.model.name,
            rigid_coordinates=len(self.scene.coordinates),
        )

    def _missing(self, refinement: int) -> list[ReferenceRun]:
        wanted = self._sequences[refinement].wanted(self._smallest(refinement))
        return [ReferenceRun(refinement, n_steps) for n_steps in wanted]

    def _all_missing(self) -> list[ReferenceRun]:
        return [run for refinement in self._sequences for run in self._missing(refinement)]

    def _errors(self, setting: Setting) -> np.ndarray:
        """Return the errors of a setting against the finest reference so far; NaN where there is nothing to compare."""
        history, sequence = self._measured[setting].history, self._sequences[setting.refinement]
        if history is None or not sequence.usable:
            return np.full(len(self.scene.outputs), np.nan)
        return largest_errors(history, sequence.history, self._floors)

    def _smallest(self, refinement: int) -> np.ndarray:
        """Return the smallest error of every output on a mesh; infinite where there is none."""
        rows = [self._errors(setting) for setting in self._measured if setting.refinement == refinement]
        known = np.array([np.full(len(self.scene.outputs), np.inf), *rows])
        return np.where(np.isnan(known), np.inf, known).min(axis=0)

    def _reason(self, setting: Setting, errors: np.ndarray) -> str:
        measured, sequence = self._measured[setting], self._sequences[setting.refinement]
        if measured.reason:
            return measured.reason
        if not sequence.usable:
            return f"no reference on this mesh: {sequence.failure}"
        names = [name for name, error in zip(self.scene.outputs, errors) if np.isnan(error)]
        return f"no number where the reference is one: {', '.join(names)}" if names else ""

    def _references(self) -> References:
        usable = {refinement: each for refinement, each in self._sequences.items() if each.usable}
        return References(
            refinement=np.array(list(usable), dtype=int),
            step=np.array([self.scene.simulation.duration / each.n_steps for each in usable.values()]),
            moved=np.array([each.moved for each in usable.values()]).reshape(len(usable), len(self.scene.outputs)),
            reason=tuple(each.reason(self._smallest(refinement)) for refinement, each in usable.items()),
        )

    def _mesh_errors(self, n_outputs: int) -> MeshErrors:
        """Compare full-order runs with the scene's step on all meshes with that on the finest."""
        if not self.limits.refinable:
            return MeshErrors(np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros((0, n_outputs)))
        refinements = [1, *self.sweep.refinements, self.sweep.finest]
        n, exact = own_steps(self.scene), self._meshes[self.sweep.finest].history
        rows = []
        for refinement in refinements:
            run = self._measured.get(Setting("full", n, refinement), self._meshes.get(refinement))
            known = exact is not None and run.history is not None
            errors = largest_errors(run.history, exact, self._floors) if known else np.full(n_outputs, np.nan)
            rows.append(errors)
        cells = [self.bench.n_cells(refinement) for refinement in refinements]
        return MeshErrors(np.array(refinements), np.array(cells), np.array(rows))


def _flags(setting: Setting, scene: Scene) -> str:
    """Return the options of ``pgmp`` that turn the scene into the setting, quoted for a shell."""
    words = {"full": ["--full"], "components": ["--components"]}.get(setting.family, [])
    for override in setting.overrides(scene):
        words += ["--override", shlex.quote(override)]
    return " ".join(words)
