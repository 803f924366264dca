"""What accuracy costs in time: errors and times of many settings, all measured in one run.

Rounds: first the scene's own setting, lines through it and a tensor, while other ranks begin the reference; then lines
through the best settings found; then the reference is refined until it is good enough for the smallest error. Last all
times are taken, round after round over all settings, so that what else the machine does meanwhile hits all alike. Tasks
are dealt to ranks, and each rank works by itself. What is decided on the way is decided on the first rank and from
errors, never from times: errors do not depend on the number of ranks.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from mpi4py import MPI

from pgmp_petsc.mechanism.constraints import constraint_jacobian
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.null_space import null_space
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.results.tradeoff import MeshErrors, References, Times, Tradeoff
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.errors import InputError, RunError
from pgmp_petsc.runtime.files import RunRecord
from pgmp_petsc.runtime.progress import progress, without_progress
from pgmp_petsc.runtime.timings import Timings
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.studies.tradeoff_advice import advise
from pgmp_petsc.studies.tradeoff_dealing import Dealer, ReferenceRun, Task, tasks_of
from pgmp_petsc.studies.tradeoff_history import largest_errors
from pgmp_petsc.studies.tradeoff_measurement import FAILURES, Bench, Measured
from pgmp_petsc.studies.tradeoff_reference import ReferenceSequence
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


def measure_tradeoff(
    scene: Scene, meshes: Mapping[str, LineMesh], sweep: Sweep, n_samples: int, quick: bool, comm: MPI.Comm
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

    Returns
    -------
    Tradeoff or None
        On the first rank, None elsewhere.

    Raises
    ------
    InputError
        If the scene has no outputs, or its mechanism cannot be closed.
    RunError
        If the full-order model fails at a test value, so that there is nothing to compare with.
    """
    timings = Timings()
    with timings.phase("preparation"), agreed(comm, "preparing the study"), without_progress():
        outputs, n_dofs, limits = _examine(scene, meshes)
        bench = Bench(scene, meshes, sweep.few_repeats)
        bench.warm_up(own_setting(scene))
    study = _Study(scene, sweep, bench, limits)
    dealer = Dealer(comm.size, n_dofs, bench.batch, sweep.repeats)
    with timings.phase("settings and references"):
        for title, plan in (("first settings", study.first), ("further settings", study.further)):
            study.take(_work(bench, dealer.deal(on_root(comm, plan)), title, comm))
        while tasks := on_root(comm, study.references):
            study.take(_work(bench, dealer.deal(tasks), "reference", comm))
    with timings.phase("times"):
        times = _times(bench, sweep.repeats, comm)
        waiting = comm.allreduce(bench.waiting, op=MPI.MAX)
    timings = timings.maximum(comm)
    if comm.rank > 0:
        return None
    record = RunRecord(scene_to_toml(scene), scene.values, None, comm.size, timings.as_dict(), scene.remarks)
    result = study.result(record, outputs.units, times)
    result = replace(result, samples=n_samples, quick=quick, waiting=waiting)
    return replace(result, advice=advise(result))


def _examine(scene: Scene, meshes: Mapping[str, LineMesh]) -> tuple[OutputSet, int, Limits]:
    """Check that there is something to measure; return the outputs, the nodal unknowns and what the scene allows."""
    if not scene.outputs:
        raise InputError(
            "outputs: the scene has none, so there is no error to measure; give one, such as "
            '[outputs.angle] type = "angle", joint = "<a revolute joint>"'
        )
    mechanism = Mechanism.from_scene(scene, meshes)
    kinematics = RigidKinematics(mechanism)
    outputs = OutputSet.of(scene, kinematics)
    pose = kinematics.poses([kinematics.coordinate.lower])[..., 0]
    independent = null_space(constraint_jacobian(mechanism, pose)).independent.size
    return outputs, mechanism.n_dofs, Limits(independent - kinematics.n_coordinates, len(scene.effects))


def _work(
    bench: Bench, dealt: Sequence[Sequence[Task]], title: str, comm: MPI.Comm
) -> dict[Setting | ReferenceRun, Measured] | None:
    """Do this rank's tasks; return what came of all tasks on the first rank. Collective on `comm`."""
    own: dict[Setting | ReferenceRun, Measured] = {}
    works = [work for task in dealt[comm.rank] for work in task.work]
    with agreed(comm, title), progress(len(works), title, comm) as bar, without_progress():
        for work in works:
            own[work] = bench.make_ready(work) if isinstance(work, Setting) else _reference(bench, work)
            bar.update()
    gathered = comm.gather(own)
    return None if gathered is None else {work: found for part in gathered for work, found in part.items()}


def _reference(bench: Bench, run: ReferenceRun) -> Measured:
    """Do a full-order run; a failure is returned, not raised."""
    try:
        return Measured(bench.reference(run.refinement, run.n_steps))
    except FAILURES as error:
        return Measured(None, reason=str(error))


def _times(bench: Bench, repeats: int, comm: MPI.Comm) -> dict[Setting, np.ndarray]:
    """Take the times of all settings in turns; on the first rank return those of all ranks. Collective on `comm`."""
    with (
        agreed(comm, "taking times"),
        progress(repeats * len(bench.ready), "times", comm) as bar,
        without_progress(),
    ):
        for turn in range(1, repeats + 1):
            for setting in bench.ready:
                bench.take_times(setting, turn)
                bar.update()
    gathered = comm.gather({setting: bench.times(setting) for setting in bench.ready})
    return {setting: times for part in gathered or () for setting, times in part.items()}


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

    def __post_init__(self) -> None:
        n, halvings = own_steps(self.scene), self.sweep.reference_halvings
        # where errors fall by 4 with each halving, a step of an eighth of the finest one is the first that can settle;
        # on refined meshes no setting has a finer step than the scene's
        finest = {1: n * 2**self.sweep.finer} | dict.fromkeys(self.sweep.refinements, n)
        self._sequences = {
            refinement: ReferenceSequence(4 * steps, n * 2 ** halvings[refinement > 1])
            for refinement, steps in finest.items()
        }

    def first(self) -> list[Task]:
        """Return the first tasks."""
        finest = ReferenceRun(self.sweep.finest, own_steps(self.scene))
        self._asked = first_settings(self.scene, self.sweep, self.limits)
        return tasks_of(self._asked, [finest, *self._missing(1)])

    def further(self) -> list[Task]:
        """Return the lines through the best settings of the first tasks, and runs that the references still need.

        Raises
        ------
        RunError
            If there is no reference on the scene's meshes.
        """
        if not self._sequences[1].usable:
            raise RunError(f"the full-order reference: {self._sequences[1].failure}")
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
        return largest_errors(history, sequence.history)

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
        refinements = [1, *self.sweep.refinements, self.sweep.finest]
        n, exact = own_steps(self.scene), self._meshes[self.sweep.finest].history
        rows = []
        for refinement in refinements:
            run = self._measured.get(Setting("full", n, refinement), self._meshes.get(refinement))
            known = exact is not None and run.history is not None
            rows.append(largest_errors(run.history, exact) if known else np.full(n_outputs, np.nan))
        cells = [self.bench.n_cells(refinement) for refinement in refinements]
        return MeshErrors(np.array(refinements), np.array(cells), np.array(rows))


def _flags(setting: Setting, scene: Scene) -> str:
    """Return the options of ``pgmp`` that turn the scene into the setting, quoted for a shell."""
    words = ["--full"] if setting.family == "full" else []
    for override in setting.overrides(scene):
        words += ["--override", shlex.quote(override)]
    return " ".join(words)
