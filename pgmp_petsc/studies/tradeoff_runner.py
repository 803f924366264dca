"""Doing the tasks of a trade-off study on all ranks, but for those that an earlier run has finished.

Which rank does what: tasks of known estimated length, the longest first to the rank with the least to do.

The estimates are rough and come from no measurement (`experiments.price`), so that every rank finds the same
distribution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.experiments.finished import Arrays, Finished
from pgmp_petsc.experiments.history import History
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.progress import progress, without_progress
from pgmp_petsc.studies.tradeoff_measurement import FAILURES, Bench, Measured
from pgmp_petsc.studies.tradeoff_settings import Setting

if TYPE_CHECKING:
    from mpi4py import MPI


# s, on a common processor: of an angle and of a model, of a step of a batch whatever its size, of a step of a sample
ANGLE, MODEL = 0.01, 0.6
STEP, HISTORY_STEP = 1.0e-4, 3.0e-4
REDUCED_SAMPLE, REDUCED_ENTRY = 1.0e-6, 2.0e-8
N_VALUES = 8  # test values of a history


@dataclass(frozen=True)
class ReferenceRun:
    """A run of the reference at the test values: its mesh and number of steps."""

    refinement: int
    n_steps: int


@dataclass(frozen=True)
class Task:
    """What one rank does in one go: settings with the same build, or one run of a reference."""

    work: tuple[Setting | ReferenceRun, ...]

    @property
    def build(self) -> tuple | None:
        """The build that the settings share; None for a run."""
        first = self.work[0]
        return first.build if isinstance(first, Setting) else None


def tasks_of(settings: Sequence[Setting], runs: Sequence[ReferenceRun]) -> list[Task]:
    """Put settings with the same build together."""
    together: dict[tuple, list[Setting]] = {}
    for setting in settings:
        together.setdefault(setting.build, []).append(setting)
    return [Task((run,)) for run in runs] + [Task(tuple(group)) for group in together.values()]


@dataclass(frozen=True)
class Prices:
    """Predicted processor time of a step of a sample on the scene's meshes, s.

    Attributes
    ----------
    full, components, reference
        Of the mesh, of component modes, and of what errors are measured against.
    timed
        Most processor time of one run that is timed, s; longer ones are timed by their first steps.
    """

    full: float
    components: float
    reference: float
    timed: float

    def of(self, work: Setting | ReferenceRun) -> float:
        """Return what a step of a sample takes."""
        if isinstance(work, ReferenceRun) or work.family == "surface":
            return work.refinement * self.reference
        if work.reduction is not None:
            return REDUCED_SAMPLE + REDUCED_ENTRY * work.reduction.modes**2
        return work.refinement * (self.components if work.family == "components" else self.full)


@dataclass
class Dealer:
    """Deals tasks to ranks, round after round; a build that a rank has done stays with it.

    Attributes
    ----------
    n_ranks
        Number of ranks.
    prices
        What steps take.
    batch, repeats
        Samples timed together, and how often.
    n_coordinates
        Rigid coordinates, along each of which a setting has its angles.
    """

    n_ranks: int
    prices: Prices
    batch: int
    repeats: int
    n_coordinates: int = 1
    _loads: list[float] = field(init=False)
    _builds: dict[tuple, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._loads = [0.0] * self.n_ranks

    def deal(self, tasks: Sequence[Task]) -> list[list[Task]]:
        """Return the tasks of every rank, in the order in which they are to be done."""
        dealt: list[list[Task]] = [[] for _ in range(self.n_ranks)]
        for task in sorted(tasks, key=self.seconds, reverse=True):
            rank = self._builds.get(task.build, min(range(self.n_ranks), key=self._loads.__getitem__))
            if task.build is not None:
                self._builds[task.build] = rank
            self._loads[rank] += self.seconds(task)
            dealt[rank].append(task)
        return dealt

    def seconds(self, task: Task) -> float:
        """Estimate how long a task takes, its share of the times included."""
        builds = {work.build for work in task.work if isinstance(work, Setting)}
        angles = [reduction.angles**self.n_coordinates for *_, reduction in builds if reduction]
        return MODEL * len(builds) + ANGLE * sum(angles) + sum(self._run(work) for work in task.work)

    def _run(self, work: Setting | ReferenceRun) -> float:
        step = self.prices.of(work)
        history = work.n_steps * (HISTORY_STEP + N_VALUES * step)
        if isinstance(work, ReferenceRun):
            return history
        if work.family == "surface":
            return history * work.nodes / N_VALUES
        timed = work.n_steps * (2 * STEP + self.batch * step)
        return history + self.repeats * min(timed, 2 * self.prices.timed)


OF_HISTORY = "history."  # names of arrays that are parts of a history


@dataclass(frozen=True)
class Runner:
    """Does tasks, and takes times.

    Attributes
    ----------
    bench
        This rank's.
    comm
        All ranks.
    finished
        What is kept; None where nothing is.
    """

    bench: Bench
    comm: MPI.Comm
    finished: Finished | None

    def work(self, dealt: Sequence[Sequence[Task]], title: str) -> dict[Setting | ReferenceRun, Measured] | None:
        """Do this rank's tasks; return what came of all tasks on the first rank. Collective on the ranks."""
        own: dict[Setting | ReferenceRun, Measured] = {}
        works = [work for task in dealt[self.comm.rank] for work in task.work]
        with agreed(self.comm, title), progress(len(works), title, self.comm) as bar, without_progress():
            for work in works:
                own[work] = self._done(work)
                bar.update()
        gathered = self.comm.gather(own)
        return None if gathered is None else {work: found for part in gathered for work, found in part.items()}

    def times(self, repeats: int) -> tuple[dict[Setting, np.ndarray], float]:
        """Take the times of all settings in turns; on the first rank return those of all ranks, and their wall time
        over their processor time: 1 on a quiet machine, 0 where nothing was timed. Collective."""
        known: dict[Setting, Arrays] = {}
        if self.finished is not None:
            kept = {setting: self.finished.get("times", setting) for setting in self.bench.ready}
            known = {setting: arrays for setting, arrays in kept.items() if arrays is not None}
        todo = [setting for setting in self.bench.ready if setting not in known]
        with agreed(self.comm, "taking times"), progress(repeats * len(todo), "times", self.comm) as bar:
            with without_progress():
                for turn in range(1, repeats + 1):
                    for setting in todo:
                        self.bench.take_times(setting, turn)
                        bar.update()
            for setting in todo:
                known[setting] = {"times": self.bench.times(setting), "spent": self.bench.spent(setting)}
                if self.finished is not None:
                    self.finished.put("times", setting, known[setting])
        every = {setting: arrays for part in self.comm.gather(known) or () for setting, arrays in part.items()}
        wall, processor = sum((arrays["spent"] for arrays in every.values()), np.zeros(2))
        times = {setting: arrays["times"] for setting, arrays in every.items()}
        return times, float(wall / processor) if processor else 0.0

    def _done(self, work: Setting | ReferenceRun) -> Measured:
        """Return what came of a task, done now or before."""
        kept = None if self.finished is None else self.finished.get("task", work)
        if kept is not None:
            measured = _measured(kept)
            if isinstance(work, Setting):
                self.bench.take_up(work, measured)
            return measured
        measured = self.bench.make_ready(work) if isinstance(work, Setting) else _reference(self.bench, work)
        if self.finished is not None:
            self.finished.put("task", work, _arrays(measured))
        return measured


def _reference(bench: Bench, run: ReferenceRun) -> Measured:
    """Do a run of the reference; a failure is returned, not raised."""
    try:
        return Measured(bench.run_reference(run.refinement, run.n_steps))
    except FAILURES as error:
        return Measured(None, reason=str(error))


def _arrays(measured: Measured) -> Arrays:
    """Return what was measured as arrays, to be kept."""
    arrays = {
        "n_coordinates": np.array(measured.n_coordinates),
        "cosine": np.array(measured.cosine),
        "reason": np.array(measured.reason),
        "offline": np.array(measured.offline),
    }
    if measured.history is not None:
        arrays |= {f"{OF_HISTORY}{name}": value for name, value in measured.history.arrays.items()}
    return arrays


def _measured(arrays: Arrays) -> Measured:
    """Return what was kept by `_arrays`."""
    whole = {name.removeprefix(OF_HISTORY): value for name, value in arrays.items() if name.startswith(OF_HISTORY)}
    history = History.of_arrays(whole) if whole else None
    wall, processor = arrays["offline"]
    return Measured(
        history,
        int(arrays["n_coordinates"]),
        float(arrays["cosine"]),
        str(arrays["reason"]),
        (float(wall), float(processor)),
    )
