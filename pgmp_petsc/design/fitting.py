"""Least squares: parameters of a scene from a measured history, a table of instants and outputs in a CSV file.

The first line of the file has the names: ``time`` (s) and outputs of the scene, in their units. Other columns have no
part. A cell that is empty, or ``nan``, is a gap: sensors may measure at instants of their own.

With outputs y_k at n_k instants, sigma_k the deviation of their noise and p the parameters, the sum of the squares of

    r_ki(p) = (y_k(t_i; p) - measured_ki) / sigma_k

is made as small as it becomes (`scipy.optimize.least_squares`, with bounds: Branch, Coleman and Li, SIAM J. Sci.
Comput. 21 (1999) 1-23), with the exact Jacobian of the reduced run. Deviations that are not given follow from what is
left, in turn with p: those of maximum likelihood for independent normal noise. Standard errors and correlations are
those of the covariance at the end,

    (J^T J)^-1 J^T R J (J^T J)^-1,

where R has the correlations of what is left of an output with its own later values (`autocorrelation`): a sandwich
(Newey and West, Econometrica 55 (1987) 703-708), which is ``(J^T J)^-1`` where noise is independent.
"""

from __future__ import annotations

import csv
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import scipy

from pgmp_petsc.base.errors import (
    InputError,
    PgmpError,
    Remark,
    gathered,
    nearest_name,
    note,
    plain_reason,
    shortened,
    warning,
)
from pgmp_petsc.base.progress import progress
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.base.units import SI, UnitSystem, times
from pgmp_petsc.design.derivatives import (
    TurnedBack,
    chosen_parameters,
    contact_remarks,
    difference_remarks,
    step_remarks,
)
from pgmp_petsc.estimates.own_error import of_figures
from pgmp_petsc.estimates.runs_at_points import RunsAtPoints
from pgmp_petsc.files.hdf5 import RunRecord, csv_table
from pgmp_petsc.gradients.differences import announce_runs
from pgmp_petsc.gradients.differentiated import DifferentiatedRun, differentiate
from pgmp_petsc.models import ReducedModel, of_samples
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.ranks.ending import search_at
from pgmp_petsc.results.gradients import Fit, FittedOutput, FittedParameter
from pgmp_petsc.results.numbers import plain, with_unit
from pgmp_petsc.scene import scene_to_toml
from pgmp_petsc.scene.fields import LARGEST
from pgmp_petsc.scene.parameters import OUTERMOST, spanning_values, uncertain_names
from pgmp_petsc.scene.units import own_values, result_units, to_own, values_text
from pgmp_petsc.scene.uses import length_names

TIME = "time"
GAPS = ("", "nan")
LARGE = 1_000_000  # bytes of a file that is read at once
MOST_ORDER = 20  # of the autoregression of what is left
NOTHING = 1e-6  # correlation that is none
REMEMBERED = 0.5  # correlation of what is left with a later measurement, beyond which it is no noise
LAGS = 10  # later measurements that are looked at: a vibration that is off may leave nothing at the next one
BY_CHANCE = 3.5  # times 1 / sqrt(n), the deviation of correlations of n independent values: 1 of 200 such fits


@dataclass(frozen=True, eq=False)
class MeasuredHistory:
    """Measured outputs over time."""

    time: np.ndarray  # increasing, shape (n,), s
    outputs: dict[str, np.ndarray]  # by name, each of shape (n,); NaN where it was not measured
    remarks: tuple[Remark, ...] = ()  # what is to be said of the file

    def there(self, output: str) -> np.ndarray:
        """Return at which instants an output was measured, shape (n,)."""
        return np.isfinite(self.outputs[output])

    def of(self, output: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the instants (n_k,), s, at which an output was measured, and what was."""
        there = self.there(output)
        return self.time[there], self.outputs[output][there]

    def counts(self) -> dict[str, int]:
        return {name: int(self.there(name).sum()) for name in self.outputs}


def read_history(path: Path, outputs: OutputSet, duration: float, system: UnitSystem = SI) -> MeasuredHistory:
    """Read a file in the units of a system, and check that it fits the outputs of a scene and a run of some duration
    (s); return it in SI units. Raises `InputError` naming line and column."""
    try:
        with open(path, encoding="utf-8-sig", newline="") as stream:
            names, rows = csv_table(
                stream, f"'{path}'", {TIME: "s", **{name: system.unit(unit) for name, unit in outputs.units.items()}}
            )
            used = _used(path, names, outputs)
            places = {name: names.index(name) for name in used}
            table, lines = _all_at_once(path, len(names), list(places.values()), duration), []
            rows = rows if table is None else ()
            table = [] if table is None else table
            for line, row in rows:
                where = f"'{path}': line {line}"
                table.append([_number(row[place], where, name) for name, place in places.items()])
                lines.append(line)
    except UnicodeError as error:
        text = f"measured history '{path}' is no text in UTF-8; take a CSV file, as pgmp export makes of a run"
        raise InputError(text) from error
    except (OSError, csv.Error) as error:
        raise InputError(f"measured history '{path}' cannot be read: {plain_reason(error) or error}") from error
    if not len(table):
        raise InputError(f"'{path}': there are no measurements in it, only a first line of names")
    columns = dict(zip(used, np.array(table).T))
    time = columns.pop(TIME)
    if lines:
        _check_times(path, time, lines, duration)
    for name, values in columns.items():
        if np.isnan(values).all():
            raise InputError(f"'{path}': the column '{name}' has no measurement at all; leave it out")
    others = [name for name in names if name not in used]
    remarks = (note(f"columns of '{path}' that are no outputs have no part: {', '.join(others)}"),) if others else ()
    found = {name: times(values, system.size_of(outputs.units[name])) for name, values in columns.items()}
    return MeasuredHistory(time, found, remarks)


def _all_at_once(path: Path, n_columns: int, places: list[int], duration: float) -> np.ndarray | None:
    """Return the columns of a file without any fault, shape (n, n_columns); None where reading line by line has to say
    what is wrong, or is as quick."""
    if path.stat().st_size < LARGE:
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of a file without rows
            table = np.loadtxt(path, delimiter=",", skiprows=1, encoding="utf-8-sig", ndmin=2, comments=None)
    except (ValueError, OSError):
        return None
    if table.shape[1] != n_columns or not len(table):
        return None
    found, time = table[:, places], table[:, places[0]]
    fine = np.all(np.abs(found) <= LARGEST) and np.all(np.diff(time) > 0.0)
    return found if fine and time[0] >= 0.0 and time[-1] <= duration * (1.0 + 1e-12) else None


def _used(path: Path, names: list[str], outputs: OutputSet) -> list[str]:
    if TIME not in names:
        hint = nearest_name(TIME, names) if names else "; it has none at all"
        raise InputError(f"'{path}': there is no column '{TIME}' (s) in its first line{hint}")
    used = [TIME, *(name for name in dict.fromkeys(names) if name in outputs.functions)]
    if len(used) == 1:
        raise InputError(
            f"'{path}': none of its columns is an output of the scene{nearest_name('', outputs.functions)}"
        )
    return used


def _number(text: str, where: str, name: str) -> float:
    if name != TIME and text.strip().lower() in GAPS:
        return np.nan
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not abs(value) <= LARGEST:
        shown = f"'{shortened(text.strip(), 40)}'" if text.strip() else "nothing"
        gaps = "" if name == TIME else " (or nothing, for a gap)"
        raise InputError(
            f"{where}: {name} = {shown}; a finite number is needed, of a magnitude up to {LARGEST:g}{gaps}"
        )
    return value


def _check_times(path: Path, time: np.ndarray, lines: list[int], duration: float) -> None:
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size:
        row = int(back[0]) + 1
        raise InputError(
            f"'{path}': line {lines[row]}: {TIME} = {time[row]:g} s comes after {time[row - 1]:g} s; times must "
            "increase"
        )
    outside = np.flatnonzero((time < 0.0) | (time > duration * (1.0 + 1e-12)))
    if outside.size:
        row = int(outside[0])
        raise InputError(
            f"'{path}': line {lines[row]}: {TIME} = {time[row]:g} s is not in the run, [0, {duration:g}] s; give a "
            "longer one (--override simulation.duration=...), or leave these lines out"
        )


def remembered(left: np.ndarray) -> tuple[int, float]:
    """Return how many measurements later what is left, (n,), is most like itself, and the correlation; 0 for noise."""
    size = float(np.sum(left**2))
    lags = range(1, min(LAGS, left.size // 4) + 1)
    if size == 0.0 or not lags:
        return 0, 0.0
    found = np.array([np.sum(left[lag:] * left[:-lag]) for lag in lags]) / size
    if found[0] > REMEMBERED:
        return 1, float(found[0])
    most = int(np.argmax(np.abs(found)))
    is_noise = abs(found[most]) <= max(REMEMBERED, BY_CHANCE / np.sqrt(left.size))
    return (0, 0.0) if is_noise else (most + 1, float(found[most]))


def autocorrelation(left: np.ndarray) -> np.ndarray:
    """Return the correlations of what is left, (n,), with later values, from 1 of none later to where they end.

    Those of the autoregression whose order has the least information criterion (Schwarz, Annals of Statistics 6 (1978)
    461-464), by Yule and Walker's equations: 1 alone for independent noise. Its first correlations are what was found,
    and later ones follow without their noise (den Haan and Levin, Handbook of Statistics 15 (1997) 299-342). Of the
    first order the bias of few values is taken off (Kendall, Biometrika 41 (1954) 403-404).
    """
    n, size = left.size, float(np.sum(left**2))
    most = min(MOST_ORDER, n // 10)
    if not size > 0.0 or most < 1:
        return np.ones(1)
    found = np.array([1.0, *(np.sum(left[lag:] * left[:-lag]) / size for lag in range(1, most + 1))])
    best, least = np.zeros(0), 0.0
    for order in range(1, most + 1):
        weights = scipy.linalg.solve_toeplitz(found[:order], found[1 : order + 1])
        rest = 1.0 - weights @ found[1 : order + 1]
        criterion = n * np.log(max(rest, 1e-300)) + order * np.log(n)
        if criterion < least:
            best, least = weights, criterion
    if best.size == 1:
        best = found[1:2] = np.minimum(best + (1.0 + 3.0 * best) / n, 1.0 - 1.0 / n)
    correlations = list(found[: best.size + 1])
    while best.size and len(correlations) < n and max(np.abs(correlations[-best.size :])) > NOTHING:
        correlations.append(float(best @ correlations[: -best.size - 1 : -1]))
    return np.array(correlations)


MOST_ROUNDS, SETTLED = 8, 1e-3  # of deviations that follow from what is left; their shares of one another that stay
WIDE = 100.0  # times the value and its hundredth, of a parameter without distribution and bounds
HARDLY_APART = 0.98  # correlation beyond which two parameters are hardly told apart
NO_DIRECTION = 1e-9  # of the largest singular value: smaller ones are rounding
TIED = 1e-6  # of a direction that residuals do not feel: so much of the product of two parameters' shares ties them
DENSE = 20  # measurements a step of a run, from which they are condensed
MANY = 10_000  # rows of a matrix that is factorised before its singular values are looked for
LEAST_FREEDOM = 0.1  # of values that are worth hardly more independent ones than there are parameters
LEAST_NOISE = 1e-9  # of the largest measured value; iterations of runs leave some 1e-11
OF_STANDARD_ERROR = 0.5  # what the model's own error may move an estimate by before it is said


@dataclass(frozen=True)
class _Solution:
    values: dict[str, float]
    run: DifferentiatedRun
    converged: bool
    reason: str


def fit(
    model: ReducedModel, history: MeasuredHistory, asked: Sequence[str], noise: Mapping[str, float], comm: Comm
) -> Fit | None:
    """Fit parameters, all with a distribution where none are asked for; one rank does, the others wait, and have None.
    Collective on `comm`.

    The deviation of the noise of outputs is given where it is known. Raises `InputError` if a name is unknown, or there
    are fewer measurements than parameters; `RunError` if a run stops before its end where the search begins; it turns
    back from others.
    """
    found = None
    with agreed(comm, "fit"):
        why = "none has a distribution, so it is not known which to fit; name them, with --parameter NAME"
        names = chosen_parameters(model.scene, asked, uncertain_names(model.scene), why)
        for output in noise:
            if output not in history.outputs:
                near = nearest_name(output, history.outputs)
                raise InputError(f"--noise {output}: it is no column of the history{near}")
        if (n := sum(history.counts().values())) <= len(names):
            raise InputError(
                f"the history has {n} measurements for {len(names)} parameters ({', '.join(names)}); more are needed "
                "than parameters"
            )
        if comm.rank == 0:
            announce_runs(model, names, "each step of the fit", comm)
            with progress(None, "runs of the fit", comm) as bar:
                found = _Fitting(model, history, names, noise, bar.update).result(comm.size)
    return found


def ends_of(model: ReducedModel, name: str) -> tuple[float, float] | None:
    """Return what is served of a length, a place or a ratio, else the bounds of a parameter; None where it has none."""
    served = model.served.get(name)
    if served is not None and served.is_sharp:
        return served.least, served.most
    return model.scene.parameters[name].bounds


def limits_of(model: ReducedModel, name: str) -> tuple[float, float]:
    """Return between what a parameter is searched: its ends, else the distribution's span of three deviations, else
    from a hundredth to a hundred times its value; no further than the reduced model serves, but from its value on."""
    scene, ends = model.scene, ends_of(model, name)
    parameter, value = scene.parameters[name], scene.values[name]
    if ends is not None:
        low, high = (float(end) for end in ends)
    elif parameter.distribution is not None:
        values, _ = spanning_values(scene, [name])
        low, high = float(values[name].min()), float(values[name].max())
    else:
        ends = value / WIDE, value * WIDE
        low, high = (min(ends), max(ends)) if value else (-1.0, 1.0)
    served = model.served.get(name)
    if served is not None:
        low, high = max(low, served.low), min(high, served.high)
    if name in scene.positive_parameters:
        low = max(low, 1e-3 * abs(scene.nominal[name]))
    elif name in scene.parameters_not_negative:
        low = max(low, 0.0)
    return min(low, value), max(high, value)


@gathered
def served_remarks(model: ReducedModel, names: Sequence[str]) -> Iterator[Remark]:
    """Return which parameters are searched between single values of their distributions, and which bounds are wider
    than what the model serves, within which parameters are searched, with the cure."""
    ranges = model.served
    for name in names:
        law, bounds = model.scene.parameters[name].distribution, model.scene.parameters[name].bounds
        served = ranges.get(name)
        if law is not None and not law.is_continuous:
            yield note(
                f"{name} is searched over all numbers between its limits, also between single values that its "
                "distribution has: compare runs at those next to what is found (--set)"
            )
        if bounds is None or served is None or served.is_sharp:
            continue
        low, high = max(bounds[0], served.low), min(bounds[1], served.high)
        if (low, high) != tuple(bounds):
            yield note(
                f"{name} is searched in {served.between(low, high)}, the range that the reduced model was built for, "
                f"and not in all of its bounds {served.between(*bounds)}: for these build with a distribution that "
                f"spans them, or without one (pgmp build SCENE)"
            )


class _Fitting:
    """One fit; `count` is called after every run."""

    def __init__(
        self,
        model: ReducedModel,
        history: MeasuredHistory,
        names: Sequence[str],
        noise: Mapping[str, float],
        count: Callable[[], object],
    ) -> None:
        self._count = count
        self._history, self._names, self._noise = history, tuple(names), noise
        self._served, self._model, scene = model, of_samples(model, names), model.scene
        self._limits = np.array([limits_of(model, name) for name in names])
        self._lengths = set(length_names(scene))
        self._start = np.array([scene.values[name] for name in names])
        self._scale = np.where(self._start != 0.0, np.abs(self._start), np.ptp(self._limits, axis=1))
        self._n = history.counts()
        largest = np.array([np.nanmax(np.abs(values)) for values in history.outputs.values()])
        self._least = LEAST_NOISE * np.maximum(largest, 1e-300)  # deviation of what may be noise, of every output
        self._condensations: dict[str, tuple[bytes, _Condensed]] = {}
        # of the scene's own: runs with smaller steps have more, and residuals are as many in all
        self._least_steps = 1 + scene.simulation.n_steps
        self._run_at = lru_cache(maxsize=4)(self._new_run)
        self._turned_back = TurnedBack()
        self.n_runs = 0

    def result(self, n_ranks: int) -> Fit:
        timings = Timings()
        with timings.phase("fit"):
            begin = self._run(self._start)
            sigma, solution = self._solved()
        parts = [self._apart(solution.run, name) for name in self._history.outputs]
        left = [part[:, 0] for part in parts]
        lasting = [autocorrelation(row) for row in left]
        slopes = [part[:, 1:] / one for part, one in zip(parts, sigma)]
        errors, correlation, tied = uncertainty(slopes, self._scale, lasting)
        estimate = np.array([solution.values[name] for name in self._names])
        scene, history = self._model.scene, self._history
        own = RunsAtPoints.of(self._model, [scene.values | solution.values])
        known = None if own.errors is None else own.errors.over(history.time, self._n)
        if known is not None:
            known = {name: known[name][history.there(name)] for name in self._n}
        why = f"the fit did not converge: {solution.reason}; begin nearer (--set)"
        ended = [] if solution.converged else [warning(why)]
        near = note(
            "the fit is the nearest minimum from where it began (--set); another start may find another one, and "
            "standard errors know of noise alone, not of what the model is off"
        )
        remarks = (
            *history.remarks, *ended, near, *self._turned_back.remarks,
            *self._of_own_error(solution, slopes, sigma, errors, own, known), *own.beyond(),
            *served_remarks(self._served, self._names),
            *self._of_limits(estimate, errors, tied, correlation),
            *self._of_noise(left, sigma, lasting, known),
            *difference_remarks(self._model, solution.run.off), *step_remarks(self._model, solution.run),
            *contact_remarks(solution.run), *scene.remarks,
        )  # fmt: skip
        parameters = [
            FittedParameter(name, result_units(scene)[name], *map(float, row))
            for name, *row in zip(self._names, self._start, estimate, errors, *self._limits.T)
        ]
        outputs = {
            name: FittedOutput(
                self._model.outputs.units[name], history.outputs[name],
                *(self._at(run, name, history.time)[:, 0] for run in (solution.run, begin)), float(sigma[k]),
                name in self._noise,
            )
            for k, name in enumerate(history.outputs)
        }  # fmt: skip
        values = own_values(scene, scene.values | solution.values)
        record = RunRecord(scene_to_toml(scene), values, None, n_ranks, timings.as_dict(), remarks)
        return Fit(record, history.time, outputs, tuple(parameters), correlation, self.n_runs, solution.converged)

    def _solved(self) -> tuple[np.ndarray, _Solution]:
        """Return the deviations of the noise of every output, and the solution."""
        history, known, n = self._history, self._noise, sum(self._n.values())
        size = self._size(self._run(self._start))
        sigma = np.array([known.get(name, size[k]) for k, name in enumerate(history.outputs)], dtype=float)
        sigma, at = np.maximum(sigma, self._least), self._start
        for _ in range(1 if len(known) == len(sigma) else MOST_ROUNDS):
            solution = self._minimum(at, sigma)
            at = np.array([solution.values[name] for name in self._names])
            found = self._size(solution.run) / np.sqrt(1.0 - at.size / n)  # the share of freedom that is left
            found = np.maximum([known.get(name, found[k]) for k, name in enumerate(history.outputs)], self._least)
            ratios, sigma = found / sigma, found
            # weights of the same shares, or of what runs leave by themselves: another search ends where this one did
            settled = np.ptp(ratios) <= SETTLED * ratios.max() or np.all(found <= self._least)
            if settled and solution.converged:
                break
        return sigma, solution

    def _minimum(self, at: np.ndarray, sigma: np.ndarray) -> _Solution:
        lower, upper = self._limits.T / self._scale
        room = 1e-10 * (upper - lower)  # the method begins inside
        begin = np.clip(at / self._scale, lower + room, upper - room)
        first, slopes = self._equations(self._run(begin * self._scale), sigma)
        # along what nothing depends on the method would go to the end of its region in every step
        felt = slopes.any(axis=0) | (not slopes.any())

        def values_at(x: np.ndarray) -> np.ndarray:
            whole = begin.copy()
            whole[felt] = x
            return whole * self._scale

        def residuals(x: np.ndarray) -> np.ndarray:
            try:
                return self._equations(self._run(values_at(x)), sigma)[0]
            except PgmpError as error:
                self._turned_back.add(error)
                return np.full(first.shape, np.nan)  # from which the method turns back

        done = scipy.optimize.least_squares(
            residuals, begin[felt],
            lambda x: (self._equations(self._run(values_at(x)), sigma)[1] * self._scale)[:, felt],
            bounds=(lower[felt], upper[felt]), xtol=1e-10, ftol=1e-10, gtol=1e-12,
        )  # fmt: skip
        values = values_at(done.x)
        found = dict(zip(self._names, map(float, values)))
        return _Solution(found, self._run(values), done.status > 0, str(done.message))

    def _run(self, at: np.ndarray) -> DifferentiatedRun:
        """Return the run at values of the parameters, which is kept for whoever asks again."""
        return self._run_at(tuple(map(float, at)))

    def _new_run(self, at: tuple[float, ...]) -> DifferentiatedRun:
        values = self._model.scene.values | dict(zip(self._names, at))
        try:
            run = differentiate(self._model, values, self._names)
        except PgmpError as error:
            where = values_text(self._model.scene, {name: values[name] for name in self._names})
            raise type(error)(f"at {where}: {error}") from error
        search_at(own_values(self._model.scene, {name: values[name] for name in self._names}))
        self.n_runs += 1
        self._count()
        return run

    def _spline(self, run: DifferentiatedRun, output: str) -> scipy.interpolate.CubicSpline:
        rows = [run.outputs[output], *(run.derivatives[output][name] for name in self._names)]
        return scipy.interpolate.CubicSpline(run.time, np.array(rows).T)

    def _at(self, run: DifferentiatedRun, output: str, time: np.ndarray) -> np.ndarray:
        """Return an output and its derivatives at times (n,), by a cubic spline: shape (n, n_parameters + 1)."""
        return self._spline(run, output)(np.minimum(time, run.time[-1]))

    def _apart(self, run: DifferentiatedRun, output: str) -> np.ndarray:
        """Return what an output differs by from what was measured, and its derivatives, (n_k, n_parameters + 1)."""
        time, measured = self._history.of(output)
        found = self._at(run, output, time)
        found[:, 0] -= measured
        return found

    def _rows(self, run: DifferentiatedRun, output: str) -> tuple[np.ndarray, float]:
        """Return as many rows of `_apart`, or of those that its measurements are condensed to, and the sum of squares
        that is left besides."""
        if self._n[output] < DENSE * run.time.size:
            return self._apart(run, output), 0.0
        key, (known, condensed) = run.time.tobytes(), self._condensations.get(output, (b"", None))
        if condensed is None or known != key:
            condensed = _Condensed(*self._history.of(output), run.time)
            self._condensations[output] = key, condensed
        return condensed.rows(self._spline(run, output)), condensed.rest

    def _size(self, run: DifferentiatedRun) -> np.ndarray:
        parts = [(*self._rows(run, name), n) for name, n in self._n.items()]
        return np.sqrt([(np.sum(rows[:, 0] ** 2) + rest) / n for rows, rest, n in parts])

    def _equations(self, run: DifferentiatedRun, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return weighted residuals (m,) and their derivatives (m, n_parameters): of all measurements, or as many as
        there are parameters and one, with the same products (their factor R), where some may be condensed."""
        rows = np.concatenate([self._rows(run, name)[0] / one for name, one in zip(self._n, sigma)])
        if max(self._n.values()) < DENSE * self._least_steps:
            return rows[:, 0], rows[:, 1:]
        factor = np.linalg.qr(np.roll(rows, -1, axis=1), mode="r")
        return factor[:, -1], factor[:, :-1]

    @gathered
    def _of_limits(
        self, estimate: np.ndarray, errors: np.ndarray, tied: np.ndarray, correlation: np.ndarray
    ) -> Iterator[Remark]:
        """Return which parameters end at their limits, or are not identifiable, alone or with those that they are tied
        to, or beyond what the basis spans; and which pairs are hardly told apart."""
        scene, ranges = self._model.scene, self._served.served
        for name, value, error, (low, high), with_it in zip(self._names, estimate, errors, self._limits, tied):
            near, own = 1e-6 * (high - low), to_own(scene, name)
            if with_it.any() or error > high - low:
                what = f"its standard error, {own * error:.3g}, is larger than the range that it is searched in"
                others = " and ".join(one for one, is_tied in zip(self._names, with_it) if is_tied and one != name)
                only = f"outputs depend on it only together with {others}" if others else "no output depends on it"
                yield warning(
                    f"{name} is not identifiable from this history: {only if with_it.any() else what}; its value is "
                    f"none, and {'one of them' if others else 'it'} is better held (--parameter with the others)"
                )
            elif value < low + near or value > high - near:
                end = "lower" if value < low + near else "upper"
                widening = "build with wider" if name in self._lengths else "widen"
                yield warning(
                    f"{name} ends at the {end} limit of its search, [{own * low:g}, {own * high:g}]; standard errors "
                    f"do not hold there: {widening} parameters.{name}.bounds if that makes sense"
                )
            elif name in ranges and scene.parameters[name].distribution is not None:
                spanned = spanning_values(scene, [name])[0][name]
                low, high = spanned.min(), spanned.max()
                if not low <= value <= high:
                    yield warning(
                        f"{name} = {own * value:.5g} lies outside {ranges[name].between(low, high)}, which the reduced "
                        f"basis spans: all but {200.0 * OUTERMOST:.2g} % of its distribution; build again with a "
                        "nominal value near it, and fit again"
                    )
        for j, k in zip(*np.nonzero(np.tril(np.abs(correlation) > HARDLY_APART, -1))):
            yield warning(
                f"{self._names[j]} and {self._names[k]} are hardly told apart (correlation {correlation[j, k]:.4f}): "
                "measure more outputs, or hold one of them"
            )

    def _of_own_error(
        self, solution: _Solution, slopes: Sequence[np.ndarray], sigma: np.ndarray, errors: np.ndarray,
        own: RunsAtPoints, known: Mapping[str, np.ndarray] | None,
    ) -> tuple[Remark, ...]:  # fmt: skip
        """Return what errors of the model do to the estimates, by a step of the fit: `slopes` are its Jacobians over
        the noise, (n_k, n_parameters) of each output, standard errors are (n_parameters,). Its errors where outputs
        were measured, (n_k,) each, are `known` of its `own` run, or None."""
        if known is None:
            return (own.not_known("the estimates", self._n),)
        row = np.concatenate([known[name] / one for name, one in zip(self._n, sigma)])
        moved = np.linalg.lstsq(np.concatenate(slopes) * self._scale, row, rcond=NO_DIRECTION)[0] * self._scale
        # y - e follows the data with values that differ by the step that e asks for
        figures = []
        for name, step, error in zip(self._names, moved, errors):
            if np.isfinite(error):
                size = to_own(self._model.scene, name)
                value, step, error = (size * float(x) for x in (solution.values[name], step, error))
                figures.append((f"{name} (standard error {plain(error)})", value, value + step, error))
        return of_figures(figures, "the standard errors", OF_STANDARD_ERROR) if figures else ()

    @gathered
    def _of_noise(
        self, left: Sequence[np.ndarray], sigma: np.ndarray, lasting: Sequence[np.ndarray],
        known: Mapping[str, np.ndarray] | None,
    ) -> Iterator[Remark]:  # fmt: skip
        """Return in which outputs what is left is no independent noise, or not of the size that was given; the model's
        errors are `known` as of `_of_own_error`."""
        for k, (name, row) in enumerate(zip(self._history.outputs, left)):
            size = float(np.sum(row**2))
            if size <= row.size * self._least[k] ** 2:
                continue  # of what iterations leave nothing is to be told
            lag, after = remembered(row)
            if lag and known is not None and size <= float(np.sum(known[name] ** 2)):
                yield note(
                    f"what is left of {name} is no more than the run's own error: whether the model differs from what "
                    "was measured is not to be told"
                )
            elif lag:
                where = "from one measurement to the next" if lag == 1 else f"with the measurement {lag} later"
                yield warning(
                    f"what is left of {name} is no independent noise (correlation {after:.2f} {where}): the model "
                    "differs from what was measured, or a better minimum lies elsewhere (--set begins there): "
                    "standard errors allow for the correlation, but not for a wrong model"
                )
            elif lasting[k].size > 1:
                yield note(
                    f"what is left of {name} is correlated ({lasting[k][1]:.2f} from one measurement to the next): "
                    "standard errors allow for it (a sandwich with an autoregression of what is left)"
                )
            if name in self._noise and size > 2.0 * row.size * sigma[k] ** 2:
                named, unit = self._model.scene.system.named, self._model.outputs.units[name]
                larger, noise = (with_unit(*named(float(one), unit), 3) for one in (np.sqrt(size / row.size), sigma[k]))
                yield warning(f"what is left of {name}, {larger}, is more than its noise, {noise} (--noise)")


class _Condensed:
    """Measurements (n,) of an output between two instants of a run, where it is a cubic, as four equations for that.

    With ``V c`` the values of the cubic of coefficients c at the measured instants, ``V = Q R``, and m the measurements
    ``|V c - m|^2 = |R c - Q^T m|^2 + |m|^2 - |Q^T m|^2``. `rest` is the sum of squares that no cubic takes away.
    """

    def __init__(self, instants: np.ndarray, measured: np.ndarray, time: np.ndarray) -> None:
        self._steps = np.diff(time)
        place = np.clip(np.searchsorted(time, instants, side="right") - 1, 0, time.size - 2)
        inside = np.minimum((instants - time[place]) / self._steps[place], 1.0)
        ends = np.searchsorted(place, np.arange(time.size))
        self._factors, self._measured = np.zeros((time.size - 1, 4, 4)), np.zeros((time.size - 1, 4))
        self.rest = 0.0
        for k, (first, last) in enumerate(zip(ends[:-1], ends[1:])):
            if first == last:
                continue
            q, r = np.linalg.qr(np.vander(inside[first:last], 4))
            own = q.T @ measured[first:last]
            self._factors[k, : len(r)], self._measured[k, : len(own)] = r, own
            self.rest += float(np.sum((measured[first:last] - q @ own) ** 2))

    def rows(self, spline: scipy.interpolate.CubicSpline) -> np.ndarray:
        """Return what the cubics of the output differ by from what was measured, and its derivatives, shape (4 n_steps,
        n_parameters + 1)."""
        scaled = spline.c * self._steps[:, None] ** np.arange(3, -1, -1)[:, None, None]
        found = np.einsum("kij,jkp->kip", self._factors, scaled)
        found[:, :, 0] -= self._measured
        return found.reshape(-1, found.shape[2])


def uncertainty(
    jacobians: Sequence[np.ndarray], scale: np.ndarray, lasting: Sequence[np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return standard errors of parameters, shape (n_parameters,), infinite where one is not identifiable,
    correlations, shape (n_parameters, n_parameters), NaN there, and which parameters are tied, of the same shape: those
    that the residuals do not tell apart, true on the diagonal where one is not identifiable.

    Jacobians are those of the weighted residuals of each output, shape (n_k, n_parameters), and scales are the sizes of
    the parameters. `lasting` has for each output the correlations of its residuals with later ones, 1 first; None:
    there are none.
    """
    scaled = [jacobian * scale for jacobian in jacobians]
    matrix = np.concatenate(scaled)
    n = len(matrix)
    if len(matrix) > MANY:
        matrix = np.linalg.qr(matrix, mode="r")
    _, sizes, directions = np.linalg.svd(matrix, full_matrices=False)
    lost = sizes <= NO_DIRECTION * max(sizes[0], 1e-300)
    tied = np.abs(directions[lost].T @ directions[lost]) > TIED
    blind = tied.diagonal()
    inverse = np.where(lost, 0.0, 1.0 / np.where(lost, 1.0, sizes))
    root = directions.T * inverse
    covariance = root @ root.T
    if lasting is not None and any(one.size > 1 for one in lasting):
        covariance = covariance @ sum(_correlated(*one) for one in zip(scaled, lasting)) @ covariance
        # parameters take more freedom from values that are worth fewer independent ones, of which deviations follow
        worth = sum(len(part) / (2.0 * sum(one) - 1.0) for part, one in zip(scaled, lasting))
        covariance *= (1.0 - len(scale) / n) / max(1.0 - len(scale) / worth, LEAST_FREEDOM)
    errors = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(errors, errors)
    correlation[blind], correlation[:, blind] = np.nan, np.nan
    return np.where(blind, np.inf, errors * scale), correlation, tied


def _correlated(jacobian: np.ndarray, lasting: np.ndarray) -> np.ndarray:
    """Return ``J^T R J`` of an output, whose matrix R has the correlations with later values along its diagonals."""
    if lasting.size == 1:
        return jacobian.T @ jacobian
    both_sides = np.concatenate([lasting[:0:-1], lasting])
    return jacobian.T @ scipy.signal.oaconvolve(jacobian, both_sides[:, None], mode="same", axes=0)
