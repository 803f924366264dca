"""The cost of accuracy in time: errors and times of many settings, all measured in one run.

After the choice of the reference rounds follow (docs/method.md, what accuracy costs): the scene's own setting, lines
through it and a tensor, while other ranks begin the reference; lines through the best settings found; then the
reference is refined until it is good enough for the smallest error. Last all times are taken, round after round over
all settings. Tasks are dealt to ranks as these get through them, and each rank works by itself; what it has finished is
kept for a run that is resumed. What is decided on the way is decided on the first rank and from errors and numbers of
operations, never from times: the settings are the same in every run, on any number of ranks.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from time import process_time

import numpy as np

from pgmp_petsc.base.errors import InputError, RunError, note
from pgmp_petsc.base.progress import doing, progress, without_progress
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm, alone
from pgmp_petsc.bench.advice import Sizes, advise
from pgmp_petsc.bench.bench import Bench, Measured
from pgmp_petsc.bench.history import Setting, Training, errors_of_samples, held_out, largest_errors, sizes_of, step_of
from pgmp_petsc.bench.prices import Limits
from pgmp_petsc.bench.reference import (
    MORE_MODES,
    Demand,
    Reference,
    ReferenceSequence,
    Said,
    Subject,
    choose_reference,
    distance_from_mesh,
)
from pgmp_petsc.bodies.shape import Shapes
from pgmp_petsc.estimates.reference_motion import steps_between_samplings
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.mechanism.capabilities import why_no_grid
from pgmp_petsc.mechanism.kinematics import MOST_COORDINATES
from pgmp_petsc.mesh.meshes import LineMesh
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.ranks.groups import Pulse, RankGroup, deal
from pgmp_petsc.reduction.checkpoint import Arrays, Finished
from pgmp_petsc.results.tradeoff import MeshErrors, References, Times, Tradeoff
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.numerics import Reduction
from pgmp_petsc.scene.parameters import uncertain_names
from pgmp_petsc.scene.units import own_values, result_units, values_text
from pgmp_petsc.scene.uses import count_builds, length_names, with_numbers

COARSER = 2  # doublings of the scene's step, for the distance of the component model from the mesh
AS_GOOD = 1.5  # how far above the smallest error a setting is still as good, if it is cheaper
GOOD_ENOUGH = 0.01  # an error for which the cheapest setting is a second best one
# power of the angles of one coordinate that are taken along each of several: 48 become 15 of two, 8 of three
ALONG_EACH = {2: 0.7, 3: 0.55}


@dataclass(frozen=True)
class Sweep:
    """How far each line goes."""

    modes: tuple[int, ...]  # of the lines through the best settings, as are angles and schemes of interpolation
    angles: tuple[int, ...]
    schemes: tuple[str, ...]
    parameter_modes: tuple[int, ...]  # of the line through the best setting, where a parameter is uncertain
    own_modes: tuple[float, ...]  # factors on the scene's own number, of the line through its setting
    own_angles: tuple[int, ...]  # of that line
    own_others: bool  # whether lines of static modes and interpolation go through the scene's setting too
    finer: int  # halvings of the scene's step, of the reduced and the full-order model
    coarser: int  # doublings
    tensor_modes: tuple[int, ...]  # with and without static modes, with the scene's step and the one twice as long
    tensor_angles: int  # at most, and no more than the scene's own
    refinements: tuple[int, ...]  # parts of every cell that both models are run with
    finest: int  # parts of every cell of the mesh that tells the others' discretisation errors
    component_modes: tuple[int, ...]  # that the component model's bodies serve; the last one's steps are varied
    surfaces: int  # number of response surfaces
    repeats: int  # how often times are taken: of batches
    few_repeats: int  # and of builds and single samples
    reference_halvings: tuple[int, int]  # of the scene's step that the reference may take, also on refined meshes

    def over(self, n_coordinates: int) -> Sweep:
        """Return the sweep for a number of coordinates: of several, angles along each of them and fewer."""
        if n_coordinates == 1:
            return self
        along = ALONG_EACH[min(n_coordinates, MOST_COORDINATES)]
        few, own = (tuple(dict.fromkeys(round(n**along) for n in angles)) for angles in (self.angles, self.own_angles))
        schemes = tuple(scheme for scheme in self.schemes if scheme != "spectral")
        tensor = round(self.tensor_angles**along)
        return replace(self, angles=few, own_angles=own, tensor_angles=tensor, schemes=schemes)


FULL = Sweep(
    modes=(2, 3, 5, 7, 10, 15, 22), angles=(16, 24, 32, 64, 96), schemes=("overhauser", "spline", "spectral"),
    parameter_modes=(0, 1, 2), own_modes=(0.5, 1.5), own_angles=(48, 96), own_others=True, finer=2, coarser=3,
    tensor_modes=(4, 7, 12), tensor_angles=48, refinements=(2, 4), finest=8, component_modes=(4, 10, 22), surfaces=4,
    repeats=3, few_repeats=2, reference_halvings=(7, 5),
)  # fmt: skip
QUICK = Sweep(
    modes=(2,), angles=(24,), schemes=(), parameter_modes=(2,), own_modes=(), own_angles=(), own_others=False, finer=0,
    coarser=3, tensor_modes=(4, 8), tensor_angles=48, refinements=(2,), finest=4, component_modes=(4, 12), surfaces=3,
    repeats=2, few_repeats=1, reference_halvings=(3, 3),
)  # fmt: skip


def measure_tradeoff(
    scene: Scene, meshes: Shapes, sweep: Sweep, n_samples: int, comm: Comm, say: Said, finished: Finished | None = None
) -> Tradeoff | None:
    """Measure errors and times of the settings of a sweep, on the first rank; None elsewhere. Collective on `comm`.

    The advice is for so many samples. What errors are measured against, and what that is predicted to take, goes to
    `say` before it is run; what an earlier run finished is in `finished`, where further tasks are kept.

    Raises `InputError` if the scene has no outputs, its mechanism cannot be closed, or there is no reference within the
    budget; `RunError` if the reference fails at a test value, so that there is nothing to compare with.
    """
    if not scene.outputs:
        raise InputError(
            "outputs: the scene has none, so there is no error to measure; give one, such as "
            '[outputs.angle] type = "angle", joint = "<a revolute joint>"'
        )
    scene = _of_one_mechanism(scene)
    timings, quick, sweep = Timings(), sweep != FULL, sweep.over(len(scene.coordinates))
    training = Training.of_own_loads(scene, *held_out(scene))
    with RankGroup.split(alone(), 1) as own:
        with timings.phase("preparation"), without_progress():
            subject, reference, shared = _prepared(scene, meshes, training, sweep, comm, say)
            with agreed(comm, "preparing the study"):
                limits = Limits.of(scene, subject.kinematics, subject.n_modes)
                lines = all(isinstance(mesh, LineMesh) for mesh in meshes.values())
                bench = Bench(reference, training, alone(), subject, own, finished=finished, timed=shared)
                bench.warm_up(own_setting(scene, limits.gridded), limits.second_order)
        study = _Study(scene, sweep, bench, replace(limits, refinable=lines and reference.is_mesh))
        with timings.phase("settings and references"):
            for title, plan in (("first settings", study.first), ("further settings", study.further)):
                study.take(_work(bench, tasks_of(on_root(comm, plan)), title, comm))
            while settings := on_root(comm, study.references):
                study.take(_work(bench, tasks_of(settings), "reference", comm))
        with timings.phase("times"):
            times, waiting = _times(bench, sweep, finished, comm)
    timings = timings.maximum(comm)
    if comm.rank > 0:
        return None
    no_grid = "" if limits.gridded else why_no_grid(scene, subject.kinematics.mechanism)
    without = (note(f"no reduced model is compared: {no_grid}"),) if no_grid else ()
    remarks = (*scene.remarks, *without, *(() if finished is None else finished.remarks))
    record = RunRecord(scene_to_toml(scene), own_values(scene), None, comm.size, timings.as_dict(), remarks)
    result = study.result(record, reference.model.outputs.units, times)
    result = replace(result, samples=n_samples, quick=quick, waiting=waiting)
    return replace(result, advice=advise(result, reference.from_mesh, study.sizes()))


def _of_one_mechanism(scene: Scene) -> Scene:
    """Return a scene whose lengths, places and ratios are numbers, those of its run, with what that means for the
    figures."""
    names = length_names(scene)
    if not names:
        return scene
    lengths = {name: scene.values[name] for name in names}
    said = note(
        f"settings are compared at {values_text(scene, lengths)}, other values with --set; over all lengths a build is "
        f"{count_builds(scene)} of those that are timed here, and samples take somewhat longer "
        "(docs/uncertainty.md, lengths, places and ratios)"
    )
    return with_numbers(scene, lengths).with_remarks((*scene.remarks, said))


def _prepared(
    scene: Scene, meshes: Shapes, training: Training, sweep: Sweep, comm: Comm, say: Said
) -> tuple[Subject, Reference, dict[str, float]]:
    """Condense bodies and choose the reference; return the processor times of both by what they are for."""
    modes, n = scene.reduction.modes, scene.simulation.n_steps
    most = max(*sweep.modes, *sweep.tensor_modes, *(round(f * modes) for f in (1.0, *sweep.own_modes)), 1)
    with RankGroup.split(comm, 1) as group:
        begin = process_time()
        subject = Subject.of(scene, meshes, group, most)
        condensing = comm.allreduce(process_time() - begin)
    begin = process_time()
    # two runs with small steps, and the surfaces' nodes
    demand = Demand(
        "pgmp tradeoff", float(3 * 4 * n * 2**sweep.finer * training.n_samples), f"{training.n_samples} test values",
        "shorten simulation.duration, or take a larger simulation.step",
        round(MORE_MODES * max(most, *sweep.component_modes, 1)),
    )  # fmt: skip
    reference = choose_reference(scene, meshes, subject.kinematics, demand, comm)
    preparing = comm.allreduce(process_time() - begin)
    say(reference.why)
    coarse = _steps(scene, 0, COARSER)[-1]
    reference = distance_from_mesh(reference, meshes, training.values, training.n_samples, coarse, comm)
    return subject, reference, {"reduced": condensing, "surface": preparing}


def _work(bench: Bench, tasks: Sequence[Task], title: str, comm: Comm) -> dict[Setting, Measured]:
    """Do tasks on all ranks; return what came of them on the first rank, nothing elsewhere. Collective on `comm`."""
    found: dict[Setting, Measured] = {}
    seconds = [sum(map(bench.predicted, task)) for task in tasks]
    bar = progress(sum(map(len, tasks)), title, comm, work=sum(seconds))
    with agreed(comm, title), bar, without_progress():

        def work(number: int, pulse: Pulse) -> dict[Setting, Measured]:
            bench.pulse = lambda n_steps: pulse()
            found = {}
            for setting in tasks[number]:
                with doing(f"{setting.title}, {bench.training.n_samples} test values"):
                    found[setting] = bench.measure(setting)
            return found

        def take(number: int, measured: dict[Setting, Measured]) -> None:
            found.update(measured)
            bar.update(len(measured), seconds[number])

        deal(comm, len(tasks), work, take)
    return found


def _times(
    bench: Bench, sweep: Sweep, finished: Finished | None, comm: Comm
) -> tuple[dict[Setting, np.ndarray], float]:
    """Take the times of all settings in turns; on the first rank return those of all ranks, and their wall time over
    their processor time: 1 on a quiet machine, 0 where nothing was timed. Collective on `comm`."""
    known: dict[Setting, Arrays] = {}
    if finished is not None:
        kept = {setting: finished.get("times", setting) for setting in bench.ready}
        known = {setting: arrays for setting, arrays in kept.items() if arrays is not None}
    todo = [setting for setting in bench.ready if setting not in known]
    with agreed(comm, "taking times"), progress(sweep.repeats * len(todo), "times", comm) as bar:
        with without_progress():
            for turn in range(1, sweep.repeats + 1):
                for setting in todo:
                    with doing(setting.title):
                        bench.take_times(setting, turn, sweep.few_repeats)
                    bar.update()
        for setting in todo:
            known[setting] = {"times": bench.times(setting), "spent": bench.spent_on[setting]}
            if finished is not None:
                finished.put("times", setting, known[setting])
    every = {setting: arrays for part in comm.gather(known) or () for setting, arrays in part.items()}
    wall, processor = sum((arrays["spent"] for arrays in every.values()), np.zeros(2))
    times = {setting: arrays["times"] for setting, arrays in every.items()}
    return times, float(wall / processor) if processor else 0.0


@dataclass
class _Study:
    """Measurements so far and those that come next; used on the first rank."""

    scene: Scene
    sweep: Sweep
    bench: Bench
    limits: Limits
    _asked: list[Setting] = field(default_factory=list)
    _measured: dict[Setting, Measured] = field(default_factory=dict)
    _finest: Measured | None = None  # on the finest mesh
    _sequences: dict[int, ReferenceSequence] = field(init=False)

    def __post_init__(self) -> None:
        n, halvings = self.scene.simulation.n_steps, self.sweep.reference_halvings
        # where errors fall by 4 with each halving, a step of an eighth of the finest one is the first that can settle;
        # on refined meshes no setting has a finer step than the scene's
        refinements = self.sweep.refinements if self.limits.refinable else ()
        finest = {1: n * 2**self.sweep.finer} | dict.fromkeys(refinements, n)
        self._sequences = {
            refinement: ReferenceSequence(4 * steps, self._most(n * 2 ** halvings[refinement > 1]), self.bench.floors)
            for refinement, steps in finest.items()
        }

    def _most(self, n_steps: int) -> int:
        """Return the most steps of the reference that are within its budget, if that is fewer."""
        while n_steps > self.bench.most_steps:
            n_steps //= 2
        return n_steps

    def first(self) -> list[Setting]:
        finest = (
            [Setting("reference", self.scene.simulation.n_steps, self.sweep.finest)] if self.limits.refinable else []
        )
        self._asked = first_settings(self.scene, self.sweep, self.limits)
        return [*finest, *self._missing(1), *self._asked]

    def further(self) -> list[Setting]:
        """Return the lines through the best settings of the first tasks, and runs that the references still need;
        raises `RunError` if there is no reference on the scene's meshes."""
        if not self._sequences[1].usable:
            raise RunError(f"the {self.bench.reference.model.title} reference: {self._sequences[1].failure}")
        worst = [float(np.max(self._errors(setting))) for setting in self._asked]
        n_coordinates = [self._measured[setting].n_coordinates for setting in self._asked]
        best = best_settings(self._asked, worst, n_coordinates)
        around = settings_around(best, self.scene, self.sweep, self.limits)
        new = [setting for setting in around if setting not in self._measured]
        self._asked += new
        return [*self.references(), *new]

    def references(self) -> list[Setting]:
        return [run for refinement in self._sequences for run in self._missing(refinement)]

    def take(self, found: Mapping[Setting, Measured]) -> None:
        runs = []
        for setting, measured in found.items():
            if setting.family != "reference":
                self._measured[setting] = measured
            elif setting.refinement in self._sequences:
                runs.append(setting)
            else:
                self._finest = measured
        for run in sorted(runs, key=lambda run: run.n_steps):
            sequence, measured = self._sequences[run.refinement], found[run]
            if measured.history is None:
                sequence.failure = measured.reason
            elif not sequence.failure:
                sequence.add(run.n_steps, measured.history)

    def result(self, record: RunRecord, units: dict[str, str], times: Mapping[Setting, np.ndarray]) -> Tradeoff:
        """Put everything together; the settings are in the order in which they were asked for, on any rank."""
        settings = self._asked
        errors = np.array([self._errors(setting) for setting in settings])
        seconds = np.array([times.get(setting, np.full((3, 2), np.nan)) for setting in settings])
        columns = columns_of(settings, self.scene)
        for name, attribute in (("coordinates", "n_coordinates"), ("cosine", "cosine")):
            columns[name] = np.array([getattr(self._measured[setting], attribute) for setting in settings])
        return Tradeoff(
            record=record,
            units=units,
            test_values=self.bench.training.values,
            parameter_units=result_units(self.scene),
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

    def _missing(self, refinement: int) -> list[Setting]:
        wanted = self._sequences[refinement].wanted(self._smallest(refinement))
        return [Setting("reference", n_steps, refinement) for n_steps in wanted]

    def _errors(self, setting: Setting) -> np.ndarray:
        """Return the errors of a setting against the finest reference so far; NaN where there is nothing to compare."""
        history, sequence = self._measured[setting].history, self._sequences[setting.refinement]
        if history is None or not sequence.usable:
            return np.full(len(self.scene.outputs), np.nan)
        return largest_errors(history, sequence.history, self.bench.floors)

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
        n, exact = self.scene.simulation.n_steps, self._finest.history
        rows = []
        for refinement in refinements:
            run = self._measured.get(Setting("full", n, refinement), self._finest)
            known = exact is not None and run.history is not None
            rows.append(largest_errors(run.history, exact, self.bench.floors) if known else np.full(n_outputs, np.nan))
        cells = [self.bench.n_cells(refinement) for refinement in refinements]
        return MeshErrors(np.array(refinements), np.array(cells), np.array(rows))

    def sizes(self) -> Sizes:
        """Return how large outputs are, and what meshes change, in their units."""
        found = sizes_of(self._sequences[1].history)
        apart, runs = None, (self._measured.get(Setting("full", self.scene.simulation.n_steps, 1)), self._finest)
        if all(run is not None and run.history is not None for run in runs):
            own, exact = (run.history for run in runs)
            shares = errors_of_samples(own, exact, self.bench.floors)
            worst = np.argmax(np.nan_to_num(shares, nan=-1.0, posinf=-1.0), axis=1)
            apart = shares * np.maximum(sizes_of(exact), self.bench.floors[:, None])
            apart = tuple((int(at), float(row[at])) for at, row in zip(worst, apart))
        return Sizes(np.where(found > self.bench.floors[:, None], found, 0.0), apart)


def _flags(setting: Setting, scene: Scene) -> str:
    """Return the options of ``pgmp`` that turn the scene into the setting, quoted for a shell."""
    words = {"full": ["--full"], "components": ["--components"]}.get(setting.family, [])
    for override in setting.overrides(scene):
        words += ["--override", shlex.quote(override)]
    return " ".join(words)


Task = tuple[Setting, ...]  # what one rank does in one go: settings with the same build


def tasks_of(settings: Sequence[Setting]) -> list[Task]:
    """Put settings with the same build together, but for runs of the reference, each of which goes to any rank; those
    that take longest come first: of the mesh before reduced ones, and by their steps."""
    together: dict[tuple, list[Setting]] = {}
    for setting in settings:
        own = (setting.n_steps,) if setting.family == "reference" else ()
        together.setdefault((*setting.build, *own), []).append(setting)

    def place(task: Task) -> tuple[bool, int]:
        return task[0].reduction is not None, -sum(one.n_steps * one.refinement for one in task)

    return sorted(map(tuple, together.values()), key=place)


def own_setting(scene: Scene, gridded: bool = True) -> Setting:
    """Return what the scene says: its reduced model, or where no grid goes over its coordinates its component model."""
    if not gridded:
        return Setting("components", scene.simulation.n_steps, component_modes=scene.reduction.modes)
    return Setting("reduced", scene.simulation.n_steps, reduction=scene.reduction)


def first_settings(scene: Scene, sweep: Sweep, limits: Limits) -> list[Setting]:
    """Return the scene's own setting, first, the lines through it, the tensor, the full order and the surfaces."""
    own = own_setting(scene, limits.gridded)
    n = scene.simulation.n_steps
    settings = [own, *(_reduced_settings(own, scene, sweep, limits) if limits.gridded else ())]
    settings += [Setting("full", steps) for steps in _steps(scene, sweep.finer, sweep.coarser)]
    settings += [Setting("full", n, refinement) for refinement in (sweep.refinements if limits.refinable else ())]
    settings += [Setting("components", n, component_modes=modes) for modes in sweep.component_modes]
    last = Setting("components", n, component_modes=sweep.component_modes[-1]) if sweep.component_modes else None
    settings += [replace(last, n_steps=steps) for steps in _steps(scene, sweep.finer, sweep.coarser) if last]
    settings += [Setting("surface", n, nodes=k) for k in node_counts(len(uncertain_names(scene)), sweep.surfaces)]
    return list(dict.fromkeys(settings))


def _reduced_settings(own: Setting, scene: Scene, sweep: Sweep, limits: Limits) -> list[Setting]:
    """Return the lines of reduced models through the scene's own setting, and the tensor."""
    static = _static(limits)
    settings = [own.with_reduction(modes=round(factor * own.reduction.modes)) for factor in sweep.own_modes]
    if sweep.own_others:
        settings += [own.with_reduction(static_modes=value) for value in static]
        settings += _sampled(own, sweep.own_angles, sweep.schemes)
    settings += [replace(own, n_steps=steps) for steps in _steps(scene, sweep.finer - 1, 1)]
    few = own  # with a tolerance angles are added until it holds, which splines alone can do
    if own.reduction.sampling_tolerance is None:
        few = own.with_reduction(angles=min(sweep.tensor_angles, own.reduction.angles), interpolation="spline")
    for modes, value, steps in product(_within(sweep.tensor_modes, limits), static, _steps(scene, 0, 1)):
        plain = {"inertia_modes": False, "parameter_modes": 0}
        settings.append(replace(few, n_steps=steps).with_reduction(modes=modes, static_modes=value, **plain))
    return settings


def settings_around(best: Sequence[Setting], scene: Scene, sweep: Sweep, limits: Limits) -> list[Setting]:
    """Return lines through the best settings, the best one's first; those of another are of modes and steps alone."""
    settings: list[Setting] = []
    for number, setting in enumerate(best):
        # what modes at other parameters add to one number of modes need not be independent of another's
        plain = setting.with_reduction(parameter_modes=0)
        settings += [plain.with_reduction(modes=modes) for modes in _within(sweep.modes, limits)]
        settings += [replace(setting, n_steps=steps) for steps in _steps(scene, sweep.finer, sweep.coarser)]
        if number > 0:
            continue
        if limits.second_order:
            settings.append(setting.with_reduction(second_order=not setting.reduction.second_order))
        settings += [setting.with_reduction(static_modes=value) for value in _static(limits)]
        settings.append(setting.with_reduction(inertia_modes=not setting.reduction.inertia_modes))
        of_parameters = sweep.parameter_modes if uncertain_names(scene) else ()
        settings += [setting.with_reduction(inertia_modes=True, parameter_modes=n) for n in of_parameters]
        settings += _sampled(setting, sweep.angles, sweep.schemes)
        if limits.refinable:
            settings += [replace(setting, refinement=refinement) for refinement in sweep.refinements]
    return list(dict.fromkeys(settings))


def best_settings(
    settings: Sequence[Setting], worst_errors: Sequence[float], n_coordinates: Sequence[int]
) -> list[Setting]:
    """Return the best reduced settings on the scene's meshes: one as good as any, then one that is good enough; none
    where every one failed.

    Errors are the largest of any output, NaN where a setting failed; numbers of coordinates are those of reduced ones.
    """
    points = [
        (error, setting.n_steps * n**2, setting)
        for setting, error, n in zip(settings, worst_errors, n_coordinates)
        if setting.family == "reduced" and setting.refinement == 1 and error == error
    ]
    if not points:
        return []
    as_good = AS_GOOD * min(error for error, _, _ in points)
    best = []
    for limit in (as_good, max(GOOD_ENOUGH, as_good)):
        among = [(cost, setting.reduction.angles, setting) for error, cost, setting in points if error <= limit]
        best.append(min(among, key=lambda one: one[:2])[2])  # the fewest operations; of equals, the fewest angles
    return list(dict.fromkeys(best))


def columns_of(settings: Sequence[Setting], scene: Scene) -> dict[str, np.ndarray]:
    """Return what was set, by name, each of shape (n_settings,); 0, false or empty where it has no meaning."""
    duration = scene.simulation.duration
    columns = {
        "step": np.array([step_of(duration, setting.n_steps) for setting in settings]),
        "refinement": np.array([setting.refinement for setting in settings]),
        "nodes": np.array([setting.nodes for setting in settings]),
        "component_modes": np.array([setting.component_modes for setting in settings]),
    }
    for key in Reduction.model_fields:
        values = [None if setting.reduction is None else getattr(setting.reduction, key) for setting in settings]
        kind = next((type(value) for value in values if value is not None), float)
        filled = [kind() if value is None else value for value in values]
        plain = kind in (bool, int, float)
        columns[key] = np.array(filled if plain else [str(value) for value in filled], dtype=kind if plain else object)
    return columns


def _sampled(setting: Setting, angles: Sequence[int], schemes: Sequence[str]) -> list[Setting]:
    """Return other ways to sample and interpolate the tables."""
    tolerance = setting.reduction.sampling_tolerance
    if tolerance is not None:
        return [setting.with_reduction(sampling_tolerance=other) for other in (10.0 * tolerance, tolerance / 10.0)]
    return [
        *(setting.with_reduction(angles=n) for n in angles),
        *(setting.with_reduction(interpolation=scheme) for scheme in schemes),
    ]


def _static(limits: Limits) -> tuple[bool, ...]:
    """Return the choices of static modes that differ: without loads there are none."""
    return (False, True) if limits.n_static else (False,)


def _within(modes: Sequence[int], limits: Limits) -> list[int]:
    return [n for n in modes if n <= limits.n_modes]


def _steps(scene: Scene, finer: int, coarser: int) -> list[int]:
    """Return the number of a scene's steps, its doubles, and its halves as far as they are whole, with samplings of
    controllers at ends of steps."""
    n, every = scene.simulation.n_steps, steps_between_samplings(scene, scene.simulation)
    coarse = [n // 2**k for k in range(1, coarser + 1) if every % 2**k == 0]
    return [n, *(n * 2**k for k in range(1, finer + 1)), *coarse]


def node_counts(n_uncertain: int, steps: int) -> list[int]:
    """Return numbers of nodes that are worth a try, the fewest first: 3, 5, 9, ... or multiples of 2 n + 1."""
    if n_uncertain == 0:
        return []
    if n_uncertain == 1:
        return [2**k + 1 for k in range(1, steps + 1)]
    return [(2 * n_uncertain + 1) * 2**k for k in range(steps)]
