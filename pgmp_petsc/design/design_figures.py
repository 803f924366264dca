"""Goal and constraints over designs, with exact derivatives: nominal, or robust over samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.base.errors import InputError, PgmpError, RunError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.design.fitting import ends_of, limits_of
from pgmp_petsc.design.goals import Constraint, Dual, Goal, Outcome, TurnedBack
from pgmp_petsc.ensemble.intervals import of_mean_and_deviations
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.sampling import Sampler
from pgmp_petsc.gradients.differences import Off
from pgmp_petsc.gradients.differentiated import DifferentiatedRun, differentiate
from pgmp_petsc.models import ReducedModel, of_samples
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.ranks.ending import search_at
from pgmp_petsc.scene.border import own_values, to_own, values_text
from pgmp_petsc.scene.parameters import uncertain_names


@dataclass(frozen=True)
class Question:
    """Goal, constraints and parameters of a design."""

    goal: Goal  # goal, constraints: what is wanted
    constraints: tuple[Constraint, ...]
    names: tuple[str, ...]  # parameters of the design
    deviations: float | None = None  # k of robust figures; None for nominal ones
    n_samples: int = 64  # n_samples, seed: of robust figures
    seed: int = 1


class DesignFigures:
    """Goal and constraints over designs, of which each makes `n_samples` runs.

    Start, scale and limits are values, sizes and limits of the parameters, (n_parameters,) twice and (n_parameters, 2);
    `narrowed` is, by parameters whose limits it narrows, the spread of the samples, what it leaves, and where the
    search begins if not where it was to, in words. Designs that were asked for and could be run are `tried`, with the
    `goals` there, which are minimised; others are `turned_back`. `count` is called with a number of runs after they
    were made. `off` is how far the derivatives of runs may be off where they are differences; `of_samples` are
    goal and constraints of every sample of the last design that could be run, (n_samples, n_figures).
    """

    def __init__(self, model: ReducedModel, question: Question, comm: Comm) -> None:
        self.scene = scene = model.scene
        self._question, self._comm = question, comm
        drawn = uncertain_names(scene) if question.deviations is not None else []
        self._model = of_samples(model, [*question.names, *drawn])
        self.limits = np.array([limits_of(model, name) for name in question.names])
        self._ends = {name: ends_of(model, name) for name in question.names}
        self.start = np.array([scene.values[name] for name in question.names])
        self.scale = np.where(self.start != 0.0, np.abs(self.start), np.ptp(self.limits, axis=1))
        self._offsets = self._drawn()
        self.narrowed: dict[str, tuple[str, str, str]] = {}
        self._make_room()
        self.n_samples = 1 if self._offsets is None else question.n_samples
        self.tried: list[np.ndarray] = []
        self.goals: list[float] = []
        self.missed: list[list[float]] = []  # by how much those tried miss each constraint
        self.turned_back = TurnedBack()
        self._known: dict[bytes, list[Dual]] = {}
        self._sides: list[float] = []
        self.count: Callable[[int], object] = lambda n: None
        self.off = Off()
        self.of_samples = np.zeros((0, 1 + len(question.constraints)))

    def _drawn(self) -> dict[str, np.ndarray] | None:
        """Return the samples: deviations of designed parameters from the design, values of the others, (n_samples,)."""
        question, scene = self._question, self._model.scene
        if question.deviations is None:
            return None
        values = Sampler(scene, Plan(question.n_samples, question.seed)).draw(0, question.n_samples)
        for name in question.names:
            uncertain = scene.parameters[name].distribution is not None
            values[name] = values[name] - scene.nominal[name] if uncertain else np.zeros(question.n_samples)
        return values

    def _make_room(self) -> None:
        """Narrow the limits so that samples stay between those of the parameters, and begin between them."""
        if self._offsets is None:
            return
        scene = self._model.scene
        for name, start, limits in zip(self._question.names, self.start, self.limits):
            drawn, bounds, low, high = self._offsets[name], self._ends[name], *limits
            if bounds is not None:
                low, high = max(low, bounds[0] - drawn.min()), min(high, bounds[1] - drawn.max())
            elif name in scene.parameters_not_negative:
                low = max(low, low - drawn.min())
            own = to_own(scene, name)
            spread = f"from {own * drawn.min():+.4g} to {own * drawn.max():+.4g}"
            if (low, high) != tuple(limits):
                begins = np.clip(start, low, high)
                began = "" if begins == start else f", from {own * begins:.6g} on and not from {own * start:.6g}"
                self.narrowed[name] = spread, f"[{own * low:.6g}, {own * high:.6g}]", began
            if low >= high:
                raise InputError(
                    f"parameters.{name}: its samples vary {spread} about a design, which leaves no room in "
                    f"[{own * limits[0]:g}, {own * limits[1]:g}]; widen its bounds"
                )
            limits[:] = low, high
        self.start = np.clip(self.start, *self.limits.T)

    def _values_of(self, design: np.ndarray, sample: int) -> dict[str, float]:
        at = dict(zip(self._question.names, map(float, design)))
        if self._offsets is None:
            return self._model.scene.values | at
        own = {name: float(values[sample]) for name, values in self._offsets.items()}
        return own | {name: value + own[name] for name, value in at.items()}

    def at(self, design: np.ndarray) -> list[Dual]:
        """Return the goal, which is minimised, and what is to be no more than 0. Collective on all ranks.

        The goal is infinite, so that a search turns back, where a run stops on the way; where it stops at the first
        design, that is an error.
        """
        design = self._comm.bcast(design)  # the same to the last bit
        key = design.tobytes()
        if key not in self._known:
            found = self._evaluated(design)
            if isinstance(found, PgmpError):
                if not self.tried:
                    leave = f"let bounds leave it out (--override parameters.{self._question.names[0]}.bounds=[...])"
                    cure = f"; or begin elsewhere (--set), or {leave}" if isinstance(found, RunError) else ""
                    raise type(found)(f"{found}{cure}")
                self.turned_back.add(found)
                zeros = np.zeros(design.size)
                found = [Dual(np.inf, zeros), *(Dual(0.0, zeros) for _ in self._question.constraints)]
            else:
                search_at(own_values(self.scene, dict(zip(self._question.names, map(float, design)))))
                self.tried.append(design.copy())
                self.goals.append(found[0].value)
                self.missed.append([dual.value for dual in found[1:]])
            self._known = {key: found}
        return self._known[key]

    def _evaluated(self, design: np.ndarray) -> list[Dual] | PgmpError:
        """Return the figures of a design, or why the first of its samples that cannot be run stops."""
        comm, mine = self._comm, []
        with agreed(comm, "runs of a design"):
            for sample in range(comm.rank, self.n_samples, comm.size):
                try:
                    mine.append((sample, self._of_sample(design, sample)))
                except PgmpError as error:
                    mine.append((sample, error))
                    break
                self.count(min(comm.size, self.n_samples - sample))
        found = dict(pair for part in comm.allgather(mine) for pair in part)
        self.off = max(comm.allgather(self.off))
        stopped = [sample for sample in sorted(found) if isinstance(found[sample], PgmpError)]
        if stopped:
            return found[stopped[0]]
        rows = [found[sample] for sample in range(self.n_samples)]
        self.of_samples = np.array([[dual.value for dual in row] for row in rows])
        return [self._robust([row[k] for row in rows]) for k in range(len(rows[0]))]

    def _of_sample(self, design: np.ndarray, sample: int) -> list[Dual]:
        question, values = self._question, self._values_of(design, sample)
        outcome = Outcome(self._run(values, sample), values, question.names)
        if sample == 0:  # of rank 0
            self._sides = [abs(constraint.right(outcome).value) for constraint in question.constraints]
        found = [_signed(question.goal.sense, question.goal.expression(outcome))]
        for constraint in question.constraints:
            left, right = constraint.left(outcome), constraint.right(outcome)
            with np.errstate(invalid="ignore"):  # of what is no finite number, as below
                found.append(_signed(constraint.sense, Dual(left.value - right.value, left.slope - right.slope)))
        for what, dual in zip((question.goal, *question.constraints), found):
            if not (np.isfinite(dual.value) and np.isfinite(dual.slope).all()):
                where = values_text(self.scene, {name: values[name] for name in question.names})
                raise RunError(
                    f"at {where}: '{what.text}' or its derivative is no finite number; write it so that it is one "
                    "between the limits of all parameters"
                )
        return found

    def _run(self, values: Mapping[str, float], sample: int) -> DifferentiatedRun:
        names = self._question.names
        try:
            run = differentiate(self._model, values, names)
            self.off = max(self.off, run.off)
            return run
        except PgmpError as error:
            where = values_text(self.scene, {name: values[name] for name in names}) + (
                "" if self._offsets is None else f", sample {sample}"
            )
            raise type(error)(f"at {where}: {error}") from error

    def _robust(self, duals: Sequence[Dual]) -> Dual:
        """Return mean and deviations of the samples' numbers, in the order of the samples."""
        if self._offsets is None:
            return duals[0]
        values, slopes = np.array([dual.value for dual in duals]), np.array([dual.slope for dual in duals])
        mean, std = float(values.mean()), float(values.std(ddof=1))
        times = self._question.deviations
        spread = (values - mean) @ slopes / ((values.size - 1) * std) if std > 0.0 else np.zeros(slopes.shape[1])
        return Dual(mean + times * std, slopes.mean(axis=0) + times * spread)

    def intervals(self, confidence: float) -> np.ndarray:
        """Return the intervals of goal and constraints of the last design over other samples, independent ones by
        whichever sampler, (n_figures, 2); NaN of nominal ones."""
        if self._offsets is None:
            return np.full((self.of_samples.shape[1], 2), np.nan)
        times = self._question.deviations
        return np.array([of_mean_and_deviations(one, times, confidence) for one in self.of_samples.T])

    def sizes(self, duals: Sequence[Dual]) -> np.ndarray:
        """Return the sizes of constraints at the last design: of their right-hand sides, or of what is missed there."""
        sides = self._comm.bcast(self._sides)
        return np.array([size or abs(dual.value) or 1.0 for size, dual in zip(sides, duals)])

    def nominal_run(self, design: np.ndarray, comm: Comm) -> DifferentiatedRun:
        """Return the run of a design without deviations. Collective on `comm`."""
        values = self._model.scene.values | dict(zip(self._question.names, map(float, design)))
        with agreed(comm, "run of the design"):
            return differentiate(self._model, values, ())


def _signed(sense: float, dual: Dual) -> Dual:
    return Dual(sense * dual.value, sense * dual.slope)
