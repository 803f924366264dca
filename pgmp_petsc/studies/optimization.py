"""Designs: values of parameters that meet a goal best under constraints.

The goal f and constraints g <= 0 are figures of reduced runs with exact derivatives. With K deviations (robust) each is

    mean_s f_s + K std_s f_s,     d/dx:  mean_s f_s' + K sum_s (f_s - mean) f_s' / ((N - 1) std)

over N samples s whose deviations from the design are drawn once, so that values and derivatives are those of one smooth
function of the design. Designs are found by sequential quadratic programming (SLSQP: Kraft, DFVLR-FB 88-28, 1988;
`scipy.optimize.minimize`). Every rank runs it on the same numbers; samples are dealt to the ranks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING
from warnings import catch_warnings, filterwarnings

import numpy as np

from pgmp_petsc.ensemble.batch import Plan
from pgmp_petsc.ensemble.sampling import Sampler
from pgmp_petsc.gradients.differentiated import DifferentiatedRun, differentiate
from pgmp_petsc.models import ReducedModel, of_samples
from pgmp_petsc.results.design import Design, DesignConstraint, DesignParameter
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.errors import InputError, PgmpError, RunError, nearest_name
from pgmp_petsc.runtime.files import RunRecord
from pgmp_petsc.runtime.progress import progress
from pgmp_petsc.runtime.remarks import Remark, note, warning
from pgmp_petsc.runtime.timings import Timings
from pgmp_petsc.scene import Scene, scene_to_toml
from pgmp_petsc.scene.spanning_values import uncertain_names
from pgmp_petsc.studies.fitting import ends_of, limits_of
from pgmp_petsc.studies.goals import Constraint, Dual, Goal, Outcome
from pgmp_petsc.studies.sensitivities import contact_remarks

if TYPE_CHECKING:
    from mpi4py import MPI

MOST_ITERATIONS = 200
PRECISE = 1e-7  # of goal and constraints, in units of their sizes: what iterations of runs leave stays below
MET = 1e-6  # of a constraint's size that it may be missed by
AT_LIMIT = 1e-6  # of the width of the limits
DESCENT_ENDED = 8  # SLSQP's status where no step along its direction makes the goal smaller


@dataclass(frozen=True)
class Question:
    """What is to be designed.

    Attributes
    ----------
    goal, constraints
        What is wanted.
    names
        Parameters of the design.
    deviations
        K of robust figures; None for nominal ones.
    n_samples, seed
        Of robust figures.
    """

    goal: Goal
    constraints: tuple[Constraint, ...]
    names: tuple[str, ...]
    deviations: float | None = None
    n_samples: int = 64
    seed: int = 1


def designed_parameters(scene: Scene, asked: Sequence[str]) -> tuple[str, ...]:
    """Return the parameters of a design: those asked for, or all with bounds or a distribution.

    Raises
    ------
    InputError
        If there is none, or none of a name.
    """
    for name in asked:
        if name not in scene.parameters:
            raise InputError(f"--parameter {name}: there is no such parameter{nearest_name(name, scene.parameters)}")
    known = [n for n, p in scene.parameters.items() if p.bounds is not None or p.distribution is not None]
    names = tuple(dict.fromkeys(asked)) or tuple(known)
    if not names:
        raise InputError(
            "parameters: none has bounds or a distribution, so it is not known which to design; name them, with "
            "--parameter NAME"
        )
    return names


def optimize(model: ReducedModel, question: Question, comm: MPI.Comm) -> Design:
    """Find a design. Collective on `comm`; the same on all ranks.

    Raises
    ------
    InputError
        If robust figures are asked for and nothing varies, or too much for the limits.
    RunError
        If a run stops before its end.
    """
    from scipy.optimize import minimize  # takes a noticeable time, and other commands have no use for it

    timings = Timings()
    with agreed(comm, "samples"):
        figures = _Figures(model, question, comm)
    with timings.phase("design"), progress(None, "runs of designs", comm) as bar:
        figures.count = bar.update
        scale, start = figures.scale, figures.start
        first = figures.at(start)
        goal_size = abs(first[0].value) or 1.0
        ends = figures.limits.T / scale  # rounded once
        sizes = np.array([figures.size_of(k, start) for k in range(len(question.constraints))])

        def goal(x: np.ndarray) -> tuple[float, np.ndarray]:
            found = figures.at(x * scale)[0]
            return found.value / goal_size, found.slope * scale / goal_size

        constraints = [
            {
                "type": "ineq",
                "fun": lambda x, k=k: -figures.at(x * scale)[1 + k].value / sizes[k],
                "jac": lambda x, k=k: -figures.at(x * scale)[1 + k].slope * scale / sizes[k],
            }
            for k in range(len(question.constraints))
        ]
        with catch_warnings():
            # steps that round-off takes past a limit are taken back
            filterwarnings("ignore", "Values in x were outside bounds", RuntimeWarning)
            done = minimize(
                goal, np.clip(start / scale, *ends), jac=True, method="SLSQP", bounds=ends.T,
                constraints=constraints, options={"maxiter": MOST_ITERATIONS, "ftol": PRECISE},
            )  # fmt: skip
        best = np.clip(done.x * scale, *figures.limits.T)
        last = figures.at(best)
    missed = [k for k in range(len(sizes)) if last[1 + k].value > MET * sizes[k]]
    converged = done.status in (0, DESCENT_ENDED) and not missed
    begun, ended = (figures.nominal_run(x, comm) for x in (start, best))
    remarks = (
        *_of_end(done, question, last, missed, sizes), *_of_limits(question, figures, best),
        *_of_robust(question, figures), *contact_remarks(ended), *model.scene.remarks,
    )  # fmt: skip
    sense = question.goal.sense
    described = [
        DesignConstraint(
            constraint.text, float(first[1 + k].value), float(last[1 + k].value),
            bool(abs(last[1 + k].value) <= 1e-4 * sizes[k]),
        )
        for k, constraint in enumerate(question.constraints)
    ]  # fmt: skip
    scene = model.scene
    parameters = [
        DesignParameter(name, scene.parameters[name].unit or "1", *map(float, row))
        for name, *row in zip(question.names, start, best, *figures.limits.T)
    ]
    values = scene.values | dict(zip(question.names, map(float, best)))
    return Design(
        RunRecord(scene_to_toml(scene), values, question.seed if question.deviations is not None else None, comm.size,
                  timings.as_dict(), remarks),
        question.goal.text, sense * first[0].value, sense * last[0].value, tuple(parameters), tuple(described),
        np.array(figures.tried), sense * np.array(figures.goals), question.deviations, figures.n_samples,
        ended.time, begun.outputs, ended.outputs, dict(model.outputs.units), converged,
    )  # fmt: skip


class _Figures:
    """Goal and constraints over designs.

    Attributes
    ----------
    start, scale, limits
        Values at the start, sizes and limits of the parameters, (n_parameters,) twice and (n_parameters, 2).
    narrowed
        Spread of the samples and what it leaves of the limits, in words, by parameters whose limits it narrows.
    n_samples
        Runs of every design.
    tried, goals
        Designs that were asked for, and the goal there, which is minimised.
    count
        Called with a number of runs after they were made.
    """

    def __init__(self, model: ReducedModel, question: Question, comm: MPI.Comm) -> None:
        scene, self._question, self._comm = model.scene, question, comm
        drawn = uncertain_names(scene) if question.deviations is not None else []
        self._model = of_samples(model, [*question.names, *drawn])
        self.limits = np.array([limits_of(model, name) for name in question.names])
        self._ends = {name: ends_of(model, name) for name in question.names}
        self.start = np.array([scene.values[name] for name in question.names])
        self.scale = np.where(self.start != 0.0, np.abs(self.start), np.ptp(self.limits, axis=1))
        self._offsets = self._drawn()
        self.narrowed: dict[str, tuple[str, str]] = {}
        self._make_room()
        self.n_samples = 1 if self._offsets is None else question.n_samples
        self.tried: list[np.ndarray] = []
        self.goals: list[float] = []
        self._known: dict[bytes, list[Dual]] = {}
        self.count: Callable[[int], object] = lambda n: None

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
        for name, limits in zip(self._question.names, self.limits):
            drawn, bounds, low, high = self._offsets[name], self._ends[name], *limits
            if bounds is not None:
                low, high = max(low, bounds[0] - drawn.min()), min(high, bounds[1] - drawn.max())
            elif name in scene.parameters_not_negative:
                low = max(low, low - drawn.min())
            if (low, high) != tuple(limits):
                self.narrowed[name] = f"from {drawn.min():+.4g} to {drawn.max():+.4g}", f"[{low:.6g}, {high:.6g}]"
            if low >= high:
                raise InputError(
                    f"parameters.{name}: its samples vary from {drawn.min():+.4g} to {drawn.max():+.4g} about a "
                    f"design, which leaves no room in [{limits[0]:g}, {limits[1]:g}]; widen its bounds"
                )
            limits[:] = low, high
        self.start = np.clip(self.start, *self.limits.T)

    def _values_of(self, design: np.ndarray, sample: int) -> dict[str, float]:
        """Return the values of all parameters of a sample; of a nominal design there is one."""
        at = dict(zip(self._question.names, map(float, design)))
        if self._offsets is None:
            return self._model.scene.values | at
        own = {name: float(values[sample]) for name, values in self._offsets.items()}
        return own | {name: value + own[name] for name, value in at.items()}

    def at(self, design: np.ndarray) -> list[Dual]:
        """Return the goal, which is minimised, and what is to be no more than 0. Collective on all ranks."""
        design = self._comm.bcast(design)  # the same to the last bit
        key = design.tobytes()
        if key not in self._known:
            self._known = {key: self._evaluated(design)}
            self.tried.append(design.copy())
            self.goals.append(self._known[key][0].value)
        return self._known[key]

    def _evaluated(self, design: np.ndarray) -> list[Dual]:
        comm, mine = self._comm, []
        with agreed(comm, "runs of a design"):
            for sample in range(comm.rank, self.n_samples, comm.size):
                mine.append((sample, self._of_sample(design, sample)))
                self.count(min(comm.size, self.n_samples - sample))
        found = dict(pair for part in comm.allgather(mine) for pair in part)
        rows = [found[sample] for sample in range(self.n_samples)]
        return [self._robust([row[k] for row in rows]) for k in range(len(rows[0]))]

    def _of_sample(self, design: np.ndarray, sample: int) -> list[Dual]:
        """Return the goal and the constraints of one sample."""
        question, values = self._question, self._values_of(design, sample)
        outcome = Outcome(self._run(values, sample), values, question.names)
        found = [_signed(question.goal.sense, question.goal.expression(outcome))]
        for constraint in question.constraints:
            found.append(_signed(constraint.sense, constraint.left(outcome) - constraint.right(outcome)))
        for what, dual in zip((question.goal, *question.constraints), found):
            if not (np.isfinite(dual.value) and np.isfinite(dual.slope).all()):
                raise RunError(
                    f"at {_shown(question.names, values)}: '{what.text}' or its derivative is no finite number; write "
                    "it so that it is one between the limits of all parameters"
                )
        return found

    def _run(self, values: Mapping[str, float], sample: int) -> DifferentiatedRun:
        names = self._question.names
        try:
            return differentiate(self._model, values, names)
        except PgmpError as error:
            where = _shown(names, values) + ("" if self._offsets is None else f", sample {sample}")
            cure = f"; or let bounds leave such designs out (--override parameters.{names[0]}.bounds=[...])"
            raise type(error)(f"at {where}: {error}{cure if isinstance(error, RunError) else ''}") from error

    def _robust(self, duals: Sequence[Dual]) -> Dual:
        """Return mean and deviations of the samples' numbers, in the order of the samples."""
        if self._offsets is None:
            return duals[0]
        values, slopes = np.array([dual.value for dual in duals]), np.array([dual.slope for dual in duals])
        mean, std = float(values.mean()), float(values.std(ddof=1))
        times = self._question.deviations
        spread = (values - mean) @ slopes / ((values.size - 1) * std) if std > 0.0 else np.zeros(slopes.shape[1])
        return Dual(mean + times * std, slopes.mean(axis=0) + times * spread)

    def size_of(self, number: int, design: np.ndarray) -> float:
        """Return the size of a constraint: that of its right-hand side at a design, or of what it misses."""
        question, values = self._question, self._values_of(design, 0)
        size = 0.0
        with agreed(self._comm, "size of a constraint"):
            run = self._run(values, 0)
            size = abs(question.constraints[number].right(Outcome(run, values, question.names)).value)
        return size or abs(self.at(design)[1 + number].value) or 1.0

    def nominal_run(self, design: np.ndarray, comm: MPI.Comm) -> DifferentiatedRun:
        """Return the run of a design without deviations. Collective on `comm`."""
        values = self._model.scene.values | dict(zip(self._question.names, map(float, design)))
        with agreed(comm, "run of the design"):
            run = differentiate(self._model, values, ())
        return run


def _signed(sense: float, dual: Dual) -> Dual:
    return Dual(sense * dual.value, sense * dual.slope)


def _shown(names: Sequence[str], values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {values[name]:.6g}" for name in names)


def _of_end(done, question: Question, last: Sequence[Dual], missed: Sequence[int], sizes: np.ndarray) -> list[Remark]:
    """Return how the search ended."""
    remarks = [
        note(
            "the design is the nearest optimum from where the search began (--set); another start may find a better one"
        )
    ]
    for k in missed:
        remarks.append(
            warning(
                f"'{question.constraints[k].text}' is missed by {last[1 + k].value:.4g}: no design between the limits "
                "was found that meets all constraints; widen the limits, or ask for less"
            )
        )
    if done.status == DESCENT_ENDED and not missed:
        remarks.append(
            note(
                "the search ended where no step makes the goal better, but not by its own test: as a rule where two "
                "peaks of a largest value are equally high"
            )
        )
    elif done.status not in (0, DESCENT_ENDED):
        remarks.append(warning(f"the search did not converge: {done.message}; begin nearer (--set)"))
    return remarks


def _of_limits(question: Question, figures: _Figures, best: np.ndarray) -> list[Remark]:
    """Return which parameters end at their limits."""
    remarks = []
    for name, value, (low, high) in zip(question.names, best, figures.limits):
        near = AT_LIMIT * (high - low)
        if value <= low + near or value >= high - near:
            end = "lower" if value <= low + near else "upper"
            remarks.append(note(f"{name} ends at the {end} limit, {value:.6g} of [{low:g}, {high:g}]"))
    return remarks


def _of_robust(question: Question, figures: _Figures) -> list[Remark]:
    """Return what robust figures are of."""
    if question.deviations is None:
        return []
    return [
        note(
            f"every figure is its mean and {question.deviations:g} deviations on the unfavourable side, over "
            f"{figures.n_samples} samples (seed {question.seed}), the same of every design; parameters of the design "
            "vary about it as their distributions do about their nominal values. Sampling leaves an error that a "
            "larger --samples makes smaller"
        ),
        *(
            note(
                f"{name}: its samples vary {spread} about the design and stay between its limits, so that the design "
                f"was searched in {room} alone; wider bounds give it more room"
            )
            for name, (spread, room) in figures.narrowed.items()
        ),
    ]
