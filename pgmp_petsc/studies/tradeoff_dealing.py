"""Which rank does what: tasks of known estimated length, the longest first to the rank with the least to do.

The estimates are rough and come from no measurement (`experiments.price`), so that every rank finds the same
distribution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from pgmp_petsc.studies.tradeoff_settings import Setting

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
