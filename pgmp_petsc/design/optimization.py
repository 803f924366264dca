"""Designs: values of parameters that meet a goal best under constraints.

The goal f and constraints g <= 0 are figures of reduced runs with exact derivatives, with controllers by
differences of runs. With K deviations (robust) each is

    mean_s f_s + K std_s f_s,     d/dx:  mean_s f_s' + K sum_s (f_s - mean) f_s' / ((N - 1) std)

over N samples s whose deviations from the design are drawn once, so that values and derivatives are those of one smooth
function of the design. Designs are found by sequential quadratic programming (SLSQP: Kraft, DFVLR-FB 88-28, 1988;
`scipy.optimize.minimize`). Every rank runs it on the same numbers; samples are dealt to the ranks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from warnings import catch_warnings, filterwarnings

import numpy as np
import scipy

from pgmp_petsc.base.errors import InputError, PgmpError, Remark, RunError, counted, gathered, note, warning
from pgmp_petsc.base.progress import Progress, doing, progress
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.base.units import behind
from pgmp_petsc.design.derivatives import (
    SENSE,
    Constraint,
    Dual,
    Expression,
    Goal,
    Outcome,
    TurnedBack,
    chosen_parameters,
    contact_remarks,
    difference_remarks,
    step_remarks,
)
from pgmp_petsc.design.fitting import ends_of, limits_of, served_remarks
from pgmp_petsc.ensemble.intervals import of_mean_and_deviations
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.sampling import Sampler
from pgmp_petsc.estimates.own_error import of_figures
from pgmp_petsc.estimates.runs_at_points import RunsAtPoints
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.gradients.differences import Off, announce_runs
from pgmp_petsc.gradients.differentiated import DifferentiatedRun, differentiate
from pgmp_petsc.models import ReducedModel, of_samples
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.ranks.ending import search_at
from pgmp_petsc.results.gradients import Design, DesignConstraint, DesignParameter
from pgmp_petsc.results.numbers import interval_text, percent, with_unit
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.parameters import uncertain_names
from pgmp_petsc.scene.units import own_values, result_units, to_own, values_text

MOST_ITERATIONS = 200
PRECISE = 1e-7  # of goal and constraints, in units of their sizes: what iterations of runs leave stays below
GAINED = 1e-5  # of the goal's size, from which on a search from where another one ended goes on
ACTIVE = 1e-4  # of a constraint's size that it may have to spare, and stands in the way all the same
MET = 1e-6  # of a constraint's size that it may be missed by
AT_LIMIT = 1e-6  # of the width of the limits
BESIDE = 1e-3  # of a parameter's size, to either side of a design: more than what printed digits leave out
PATIENCE = 2  # times the parameters and one: iterations in which a search shows whether it gets nearer to constraints
BALANCED = 0.1  # what slopes of length 1 that contradict one another leave in sum: derivatives may be off by so much
STUCK = -2  # status of a search that gets no nearer to constraints that it has not met
OTHER = -1  # status of a search that ended where constraints are missed, though a design was tried that meets them
DESCENT_ENDED = 8  # SLSQP's status where no step along its direction makes the goal smaller
STALLED = -3  # status of a search that finds no better design that meets all constraints
ENDED = (0, DESCENT_ENDED, STALLED)  # status of searches that end at a design that none nearby is better than


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
    `goals` there, which are minimised; others are `turned_back`. Runs are counted by `progress`, which has
    what was found so far. `off` is how far the derivatives of runs may be off where they are differences; `of_samples`
    are goal and constraints of every sample of the last design that could be run, (n_samples, n_figures).
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
        self.progress = Progress()
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
                self.progress.found = self._words_of(found)
            self._known = {key: found}
        return self._known[key]

    def _words_of(self, found: Sequence[Dual]) -> str:
        """Return what is known of the last design that was tried. Collective."""
        goal = self._question.goal
        value = with_unit(goal.sense * goal.size * found[0].value, goal.unit, 3)
        missed = sum(dual.value > MET * size for dual, size in zip(found[1:], self.sizes(found[1:])))
        constraints = f", {missed} of {counted(len(found) - 1, 'constraint')} missed" if len(found) > 1 else ""
        return f"design {len(self.tried)}: {goal.text[re.match(SENSE, goal.text).end() :]} = {value}{constraints}"

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
                self.progress.update(min(comm.size, self.n_samples - sample))
        found = dict(pair for part in comm.allgather(mine) for pair in part)
        self.off = max(comm.allgather(self.off))
        stopped = [sample for sample in sorted(found) if isinstance(found[sample], PgmpError)]
        if stopped:
            return found[stopped[0]]
        rows = [found[sample] for sample in range(self.n_samples)]
        self.of_samples = np.array([[dual.value for dual in row] for row in rows])
        return [self.robust([row[k] for row in rows]) for k in range(len(rows[0]))]

    def values(self, design: np.ndarray, sample: int) -> dict[str, float]:
        """Return the values of all parameters in a sample of a design."""
        at = dict(zip(self._question.names, map(float, design)))
        if self._offsets is None:
            return self._model.scene.values | at
        drawn = {name: float(own[sample]) for name, own in self._offsets.items()}
        return drawn | {name: value + drawn[name] for name, value in at.items()}

    def _of_sample(self, design: np.ndarray, sample: int) -> list[Dual]:
        question, values = self._question, self.values(design, sample)
        of = "" if self._offsets is None else f", sample {sample}"
        outcome = Outcome(self._run(values, question.names, of), values, question.names)
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

    def _run(self, values: Mapping[str, float], names: Sequence[str], of: str = "") -> DifferentiatedRun:
        try:
            run = differentiate(self._model, values, names)
            self.off = max(self.off, run.off)
            return run
        except PgmpError as error:
            where = values_text(self.scene, {name: values[name] for name in self._question.names})
            raise type(error)(f"at {where}{of}: {error}") from error

    def robust(self, duals: Sequence[Dual]) -> Dual:
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

    def nominal_run(self, design: np.ndarray) -> DifferentiatedRun:
        """Return the run of a design without deviations."""
        return self._run(self._model.scene.values | dict(zip(self._question.names, map(float, design))), ())

    def stopped_beside(self, design: np.ndarray) -> list[PgmpError]:
        """Return why runs stop that have one parameter a little to either side of a design, between its limits; of
        robust ones samples tell. Collective."""
        steps = np.diag(BESIDE * np.where(design != 0.0, design, self.scale))
        moved = [] if self._offsets is not None else [design + step for one in steps for step in (-one, one)]
        near = [one for one in moved if np.all((self.limits[:, 0] <= one) & (one <= self.limits[:, 1]))]
        comm, mine = self._comm, []
        with agreed(comm, "runs beside the design"):
            for k in range(comm.rank, len(near), comm.size):
                try:
                    self.nominal_run(near[k])
                except PgmpError as error:
                    mine.append((k, error))
        return [error for _, error in sorted(pair for part in comm.allgather(mine) for pair in part)]


def _signed(sense: float, dual: Dual) -> Dual:
    return Dual(sense * dual.value, sense * dual.slope)


def designed_parameters(scene: Scene, asked: Sequence[str]) -> tuple[str, ...]:
    """Return the parameters of a design: those asked for, or all with bounds or a distribution; raises as
    `chosen_parameters`."""
    known = [n for n, p in scene.parameters.items() if p.varies]
    why = "none has bounds or a distribution, so it is not known which to design; name them, with --parameter NAME"
    return chosen_parameters(scene, asked, known, why)


def optimize(model: ReducedModel, question: Question, comm: Comm) -> Design:
    """Find a design. Collective on `comm`; the same on all ranks. Raises `InputError` if robust figures are asked for
    and nothing varies, or too much for the limits; `RunError` if a run stops before its end where the search begins. It
    turns back from others."""
    timings = Timings()
    with agreed(comm, "samples"):
        figures = DesignFigures(model, question, comm)
        each = "each sample of a design" if figures.n_samples > 1 else "each design"
        announce_runs(model, question.names, each, comm)
    with timings.phase("design"), progress(None, "runs of designs", comm) as figures.progress:
        start = figures.start
        first = figures.at(start)
        sizes = figures.sizes(first[1:])
        done, best = _searched(figures, abs(first[0].value) or 1.0, sizes)
        last = figures.at(best)
    missed = [k for k in range(len(sizes)) if last[1 + k].value > MET * sizes[k]]
    converged = done.status in ENDED and not missed
    confidence = model.scene.ensemble.confidence
    ends = figures.intervals(confidence)
    with agreed(comm, "runs of the design"):
        begun, ended = map(figures.nominal_run, (start, best))
    values = model.scene.values | dict(zip(question.names, map(float, best)))
    with timings.phase("errors"), doing("errors of the design"), agreed(comm, "errors of the design"):
        own = _of_own_error(model, question, figures, best, ended) if comm.rank == 0 else ()
    with timings.phase("runs beside the design"):
        beside = figures.stopped_beside(best)
    contradicting = _contradicting(question, figures, best, last, sizes)
    astray = {
        "derivatives jump where contacts come and go": ended.contacts,
        "runs stopped on its way": figures.turned_back.count,
    }
    remarks = (
        *_of_end(done, question, last, missed, contradicting, astray), *comm.bcast(own),
        *served_remarks(model, question.names),
        *figures.turned_back.remarks, *_of_edge(beside),
        *_of_limits(question, figures, best, [*first, *last]),
        *_of_robust(question, figures, ends, confidence), *difference_remarks(model, figures.off),
        *step_remarks(model, ended), *contact_remarks(ended), *model.scene.remarks,
    )  # fmt: skip
    size = question.goal.sense * question.goal.size
    (_, at_begin), (time, at_end) = (run.at_steps_of_scene() for run in (begun, ended))
    parameters = [
        DesignParameter(name, result_units(model.scene)[name], *map(float, row))
        for name, *row in zip(question.names, start, best, *figures.limits.T)
    ]
    constraints = [
        DesignConstraint(
            one.text, float(one.size * begins.value), float(one.size * found.value),
            bool(abs(found.value) <= ACTIVE * side),
            None if question.deviations is None else tuple(map(float, one.size * own)), one.unit,
        )
        for one, begins, found, side, own in zip(question.constraints, first[1:], last[1:], sizes, ends[1:])
    ]  # fmt: skip
    return Design(
        RunRecord(scene_to_toml(model.scene), own_values(model.scene, values),
                  question.seed if question.deviations is not None else None, comm.size, timings.as_dict(), remarks),
        question.goal.text, size * first[0].value, size * last[0].value, tuple(parameters),
        tuple(constraints), np.array(figures.tried), size * np.array(figures.goals),
        question.deviations, figures.n_samples, time, at_begin, at_end, dict(model.outputs.units), converged,
        np.sort(size * ends[0]), confidence, question.goal.unit,
    )  # fmt: skip


def _searched(
    figures: DesignFigures, goal_size: float, sizes: np.ndarray
) -> tuple[scipy.optimize.OptimizeResult, np.ndarray]:
    """Return how the search from the start ended, and the best design that can be run; `sizes` are of constraints.

    A search ends where the goal hardly changes from one iteration to the next, which it also does where its matrix of
    second derivatives is of the other side of a kink, as that of a largest value. It begins again there, as long as
    that gains something. Where it meets no constraints at all it begins again from the design that misses them least.
    """
    scale = figures.scale
    ends = figures.limits.T / scale  # rounded once

    def goal(x: np.ndarray) -> tuple[float, np.ndarray]:
        found = figures.at(x * scale)[0]
        return found.value / goal_size, found.slope * scale / goal_size

    def missed(x: np.ndarray) -> float:
        return sum(max(dual.value / size, 0.0) for dual, size in zip(figures.at(x * scale)[1:], sizes))

    def met() -> list[int]:
        return [k for k, missed_by in enumerate(figures.missed) if np.all(np.array(missed_by) <= MET * sizes)]

    constraints = [
        {
            "type": "ineq",
            "fun": lambda x, k=k: -figures.at(x * scale)[1 + k].value / sizes[k],
            "jac": lambda x, k=k: -figures.at(x * scale)[1 + k].slope * scale / sizes[k],
        }
        for k in range(len(sizes))
    ]
    done, best = _search(goal, missed, np.clip(figures.start / scale, *ends), ends, constraints, MOST_ITERATIONS)
    if missed(best) > MET and not met():
        best = _least_missed(goal, np.append(best, missed(best)), ends, constraints)
        if missed(best) <= MET:
            done, best = _search(goal, missed, best, ends, constraints, MOST_ITERATIONS)
    off, n_iterations = missed(best), done.nit
    while done.status != STUCK and np.isfinite(done.fun) and n_iterations < MOST_ITERATIONS:
        again, found = _search(goal, missed, best, ends, constraints, MOST_ITERATIONS - n_iterations)
        further = missed(found)
        if not (again.fun < done.fun - GAINED and further <= max(off, MET)):
            break
        done, best, off, n_iterations = again, found, further, n_iterations + again.nit
    best = np.clip(best * scale, *figures.limits.T)
    if not np.isfinite(figures.at(best)[0].value):  # where it was to turn back; the design before
        best = figures.tried[-1]
    if missed(best / scale) > MET and met():
        best = figures.tried[min(met(), key=lambda k: figures.goals[k])]
        kept = "the design is the best one tried that meets all constraints"
        done.status, done.message = OTHER, f"{done.message}; {kept}"
    return done, best


class _Stuck(Exception):  # noqa: N818 - it ends a search, and is no error
    """A search gets no nearer to constraints that it has not met, or to a better design that meets them."""


def _search(
    goal: Callable[[np.ndarray], tuple[float, np.ndarray]], missed: Callable[[np.ndarray], float], start: np.ndarray,
    ends: np.ndarray, constraints: Sequence[dict], most: int,
) -> tuple[scipy.optimize.OptimizeResult, np.ndarray]:  # fmt: skip
    """Search from a start within ends (2, n) in so many iterations at most; return how it ended, and where.

    Of n parameters, n + 1 iterations show a search all slopes. It ends where twice as many bring it no nearer to
    constraints that it has not met, by their sum `missed`, than as many before; or where they are met, and as many
    bring no better design, as between kinks.
    """
    seen: list[float] = []
    goals = [np.inf]  # the best after each iteration of designs that meet all constraints
    each, last, best = PATIENCE * (start.size + 1), start, start

    def look(x: np.ndarray) -> None:
        nonlocal last, best
        last = x
        seen.append(missed(x))
        value = goal(x)[0] if seen[-1] <= MET else np.inf
        best = x.copy() if value < goals[-1] else best
        goals.append(min(goals[-1], value))
        if len(seen) >= 2 * each and MET < min(seen) and min(seen[-each:]) >= min(seen[-2 * each : -each]) - GAINED:
            raise _Stuck
        # one that comes nearer to constraints from outside has no better design yet, and goes on
        if len(goals) > each and min(seen[-each:]) <= MET and goals[-1] > goals[-1 - each] - GAINED:
            raise _Stuck

    with catch_warnings(), suppress(_Stuck):
        # steps that round-off takes past a limit are taken back
        filterwarnings("ignore", "Values in x were outside bounds", RuntimeWarning)
        done = scipy.optimize.minimize(
            goal, start, jac=True, method="SLSQP", bounds=ends.T, constraints=constraints,
            options={"maxiter": most, "ftol": PRECISE}, callback=look,
        )  # fmt: skip
        return done, np.clip(done.x, *ends)
    status, reason = STUCK, f"its last {each} iterations brought it no nearer to the constraints"
    if np.isfinite(goals[-1]):
        last, status, reason = best, STALLED, f"its last {each} iterations brought no better design"
    done = scipy.optimize.OptimizeResult(fun=goal(last)[0], status=status, message=reason, nit=len(seen))
    return done, np.clip(last, *ends)


def _least_missed(
    goal: Callable[[np.ndarray], tuple[float, np.ndarray]], start: np.ndarray, ends: np.ndarray,
    constraints: Sequence[dict],
) -> np.ndarray:  # fmt: skip
    """Return the design near a start that misses constraints ``g <= 0`` least: t is smallest under ``g <= t``, which a
    large t meets at every design. The start is a design and t behind it; designs that cannot be run have no goal."""
    wider = [
        {
            "type": "ineq",
            "fun": lambda z, one=one: one["fun"](z[:-1]) + z[-1],
            "jac": lambda z, one=one: np.append(one["jac"](z[:-1]), 1.0),
        }
        for one in constraints
    ]

    def most_missed(z: np.ndarray) -> tuple[float, np.ndarray]:
        return (z[-1] if np.isfinite(goal(z[:-1])[0]) else np.inf), np.eye(z.size)[-1]

    wide = np.column_stack([ends, [0.0, np.inf]])
    return _search(most_missed, lambda z: 0.0, start, wide, wider, MOST_ITERATIONS)[1][:-1]


def _contradicting(
    question: Question, figures: DesignFigures, best: np.ndarray, last: Sequence[Dual], sizes: np.ndarray
) -> list[str]:
    """Return which constraints and limits of parameters contradict one another at a design: no small step meets all of
    them better, as slopes s_k of length 1 add up to ``sum w_k s_k = 0`` with ``w_k >= 0``, ``sum w_k = 1`` (Farkas)."""
    slopes = {
        f"'{constraint.text}'": dual.slope * figures.scale
        for constraint, dual, size in zip(question.constraints, last[1:], sizes)
        if dual.value > -ACTIVE * size
    }
    for k, end in _at_limits(figures, best):
        outwards = 1.0 if end == "upper" else -1.0
        slopes[f"the {end} limit of {question.names[k]}"] = outwards * np.eye(best.size)[k]
    if len(slopes) < 2:
        return []
    rows = np.array([[*slope / (np.linalg.norm(slope) or 1.0), 1.0] for slope in slopes.values()])
    weights, off = scipy.optimize.nnls(rows.T, np.eye(best.size + 1)[-1])
    found = [name for name, weight in zip(slopes, weights) if weight > BALANCED]
    return found if off < BALANCED and len(found) > 1 else []


@gathered
def _of_end(
    done: scipy.optimize.OptimizeResult, question: Question, last: Sequence[Dual], missed: Sequence[int],
    contradicting: Sequence[str], astray: Mapping[str, object],
) -> Iterator[Remark]:  # fmt: skip
    if not missed and done.status in ENDED:
        before = " and ".join(why for why, is_so in astray.items() if is_so)
        ended = f"the search found no better design nearby, but may have ended before an optimum, as {before}"
        ended = ended if before else "the design is the nearest optimum from where the search began (--set)"
        yield note(f"{ended}; another start{' (--set)' if before else ''} may find a better one")
    for k in missed:
        constraint = question.constraints[k]
        by = with_unit(constraint.size * last[1 + k].value, constraint.unit, 4)
        yield warning(
            f"'{constraint.text}' is missed by {by}: no design between the limits was found that meets all "
            "constraints; widen the limits, ask for less, or begin elsewhere (--set)"
        )
    if missed and contradicting:
        yield warning(
            f"{' and '.join(contradicting)} contradict one another there: no small step of the design brings it "
            "much nearer to one of them and not further from another; leave one out, or ask less of it"
        )
    if done.status in (DESCENT_ENDED, STALLED) and not missed:
        yield note(
            "the search ended where no step makes the goal better, but not by its own test: as a rule where two peaks "
            "of a largest value are equally high"
        )
    elif done.status not in ENDED:
        cure = "" if done.status == STUCK else "; begin nearer (--set)"  # as above, of what is missed
        yield warning(f"the search did not converge: {done.message}{cure}")


def _of_own_error(
    model: ReducedModel, question: Question, figures: DesignFigures, best: np.ndarray, nominal: DifferentiatedRun
) -> tuple[Remark, ...]:
    """Return what errors of the model do to the goal and to the constraints of a design, and how far it leaves what the
    model holds for, over all of its samples, or of its `nominal` run where that is all."""
    points = [figures.values(best, sample) for sample in range(figures.n_samples)]
    checked = RunsAtPoints.of(of_samples(model, question.names), points)
    errors, beyond = checked.errors, checked.beyond("samples of the design")
    sides = {question.goal: (question.goal.expression,)} | {one: (one.left, one.right) for one in question.constraints}
    names = sorted({name for parts in sides.values() for part in parts for name in part.outputs})
    each = [nominal] if question.deviations is None else (differentiate(model, point, ()) for point in points)
    runs = [] if errors is None else list(each)
    known = [errors.over(run.time, names, sample) for sample, run in enumerate(runs)]
    if not known or any(one is None for one in known):
        return (checked.not_known("the goal and the constraints", names), *beyond)
    better = [
        replace(run, outputs={name: run.outputs[name] - own[name] for name in names}) for run, own in zip(runs, known)
    ]

    def figure(part: Expression, sense: float, of: Sequence[DifferentiatedRun]) -> float:
        each = [part(Outcome(run, point, ())).value for run, point in zip(of, points)]
        return sense * figures.robust([Dual(sense * value, np.empty(0)) for value in each]).value

    told = []
    for what, parts in sides.items():
        here, there = ([what.size * figure(part, what.sense, of) for part in parts] for of in (runs, better))
        told.append((f"'{what.text}'", here[0], there[0], max(map(abs, here))))
    return (*of_figures(told), *beyond)


@gathered
def _of_edge(stopped: Sequence[PgmpError]) -> Iterator[Remark]:
    """Return that runs stop beside a design, and why the first of them does."""
    if stopped:
        named = counted(len(stopped), "run")
        yield warning(
            f"the design is at the edge of what can be run: {percent(BESIDE)} to one side of it "
            f"{'a run stops' if len(stopped) == 1 else f'{named} stop'}, first {stopped[0]}; keep away from there by "
            "narrower bounds or one more constraint, as values with fewer digits may stop as well"
        )


def _at_limits(figures: DesignFigures, best: np.ndarray) -> Iterator[tuple[int, str]]:
    """Return which parameters of a design are at their limits, and at which."""
    for k, (value, (low, high)) in enumerate(zip(best, figures.limits)):
        near = AT_LIMIT * (high - low)
        if value <= low + near or value >= high - near:
            yield k, "lower" if value <= low + near else "upper"


@gathered
def _of_limits(question: Question, figures: DesignFigures, best: np.ndarray, duals: Sequence[Dual]) -> Iterator[Remark]:
    """Return which parameters end at their limits, and on which nothing depends, by what was found at two designs."""
    for k, end in _at_limits(figures, best):
        name, (low, high) = question.names[k], figures.limits[k]
        own = to_own(figures.scene, name)
        yield note(f"{name} ends at the {end} limit, {own * best[k]:.6g} of [{own * low:g}, {own * high:g}]")
    for name, column in zip(question.names, np.array([dual.slope for dual in duals]).T):
        if not column.any():
            yield note(f"{name}: neither the goal nor a constraint depends on it, at the first and at the last design")


@gathered
def _of_robust(question: Question, figures: DesignFigures, ends: np.ndarray, confidence: float) -> Iterator[Remark]:
    """Return what robust figures are of, and which constraints these samples do not show to be met, by the intervals of
    goal and constraints, (n_figures, 2)."""
    if question.deviations is None:
        return
    met = [(constraint, constraint.size * own) for constraint, own in zip(question.constraints, ends[1:])]
    open_ones = [
        f"'{constraint.text}' (missed by {interval_text(of)}{behind(constraint.unit)})"
        for constraint, of in met
        if of[0] <= 0.0 < of[1]
    ]
    if open_ones:
        what = f"{figures.n_samples} samples leave open whether the design meets {', '.join(open_ones)}"
        cure = "take a larger --samples, or ask for more room"
        yield note(f"{what}, {percent(confidence)} interval: {cure}")
    yield note(
        f"every figure is its mean and {question.deviations:g} deviations on the unfavourable side, over "
        f"{figures.n_samples} samples (seed {question.seed}), the same of every design; parameters of the design "
        "vary about it as their distributions do about their nominal values. Intervals are those of other samples "
        "of this design; as it was chosen on its own samples, its goal is rather too good"
    )
    for name, (spread, room, began) in figures.narrowed.items():
        yield note(
            f"{name}: its samples vary {spread} about the design and stay between its limits, so that the design "
            f"was searched in {room} alone{began}; wider bounds give it more room"
        )
