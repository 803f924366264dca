"""Figures of the best of several models, from few samples of it and many of cheaper ones on the same draws
(docs/uncertainty.md, better models on the same draws).

Multi-fidelity Monte Carlo (Peherstorfer, Willcox, Gunzburger, SIAM Journal on Scientific Computing 38 (2016)
A3163-A3194): with models i = 1 .. k, the best first, of the first ``m_1 <= ... <= m_k`` samples,

    mean = ybar_1(m_1) + sum_i alpha_i (ybar_i(m_i) - ybar_i(m_(i-1))),    alpha_i = cov(y_1, y_i) / var(y_i).

Its variance is a sum over strata of samples that are alike (those between m_(i-1) and m_i): of the first one the
jackknife's (Efron and Stein, Annals of Statistics 9 (1981) 586-596), of the others the sample variance. Student's t has
the freedom of Satterthwaite (Biometrics Bulletin 2 (1946) 110-114), that of each stratum from its kurtosis
(`intervals.freedom_of`). Coefficients take a degree of freedom each (Lavenberg and Welch, Management Science 27 (1981)
322-335).

The variance is the mean of squared distances from the corrected mean, with those of the cheap models as controls; its
interval is that of its logarithm. A probability is ``p_1 = a p_2 + b (1 - p_2)`` of the next cheaper model's, a and b
shares of the common samples (Tenenbein, Journal of the American Statistical Association 65 (1970) 1350-1361), whose
intervals are put together by squares (MOVER: Zou and Donner, Statistics in Medicine 27 (2008) 1693-1702).

For a budget of time the numbers of samples are those of the least variance that it pays for (`allocation`), from costs
and correlations of a pilot of every model's first samples (`integration.allot`), which are used too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from pgmp_petsc.base.errors import Remark, RunError, gathered, note, warning
from pgmp_petsc.ensemble import intervals
from pgmp_petsc.ensemble.checkpoint import Checkpoint, Columns
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.statistics import came_true, is_constant, parts_of_tails, quantities, quantity
from pgmp_petsc.files.claims import pieces_path
from pgmp_petsc.models import Model
from pgmp_petsc.results.ensemble import Corrected, Ensemble, Figure, Joined
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import Event
from pgmp_petsc.stepping.status import Status

FEWEST = 8  # samples of the best model: coefficients, and a jackknife of them
FEWEST_OF_PARABOLA = 20  # samples that a cheaper model's curvature is estimated from, if the parabola is not nearly all
HALF = 0.5  # of the squared error of a straight line's predictions, which a parabola has to be better than
TENTH = 0.1  # of that, with fewer samples
FEWEST_OF_DEVIATION = 50  # below, measured intervals of the deviation are short: 77 to 94 % at 95 %
FEW_DISAGREEMENTS = 5  # below, measured intervals of probabilities hold in 97 to 100 % at 95 %


@dataclass(frozen=True)
class Estimate:
    """A mean with its variance."""

    value: float  # value, variance: the estimate and the variance of its error
    variance: float
    freedom: float  # degrees of freedom of the variance
    coefficients: np.ndarray  # coefficients, correlations: of the cheaper models with the best one, each (k - 1,)
    correlations: np.ndarray
    #: of replicates: the estimate as of independent samples, and the part that its interval has (`parts_of_tails`)
    apart: tuple[Estimate, float] | None = None

    def reach(self, confidence: float) -> float:
        """Return half the width of the interval."""
        own = float(scipy.special.stdtrit(self.freedom, 0.5 + 0.5 * confidence) * np.sqrt(self.variance))
        return own if self.apart is None else float(np.hypot(own, self.apart[1] * self.apart[0].reach(confidence)))

    def interval(self, confidence: float) -> np.ndarray:
        return self.value + self.reach(confidence) * np.array([-1.0, 1.0])


def calibrated(values: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return values of all models, as `mean_of` takes them, cheaper ones through the parabola that fits the best one on
    their common samples.

    Only where it predicts each of these from the others with less than `HALF` of the squared error of a straight line,
    below `FEWEST_OF_PARABOLA` samples `TENTH` (PRESS: Allen, Technometrics 16 (1974) 125-127). What is taken is no more
    than a model that is another function of the parameters, so that whatever follows keeps its expectation.
    """
    return [values[0], *(_calibrated(values[0], other) for other in values[1:])]


def _calibrated(best: np.ndarray, other: np.ndarray) -> np.ndarray:
    n = best.size
    centre, scale = np.mean(other[:n]), np.std(other[:n])
    if not scale > 1e-12 * np.max(np.abs(other)):
        return other
    line = (other - centre) / scale
    parabola = line**2 - 1.0 - np.mean(line[:n] ** 3) * line  # orthogonal to 1 and the line over the first n
    first, square = parabola[:n], np.sum(parabola[:n] ** 2)
    if not square > 1e-12 * n:  # two values alone have no curvature
        return other
    slope, curvature = np.mean(line[:n] * best), first @ best / square
    residual, leverage = best - np.mean(best) - slope * line[:n], (1.0 + line[:n] ** 2) / n
    straight = np.sum((residual / np.maximum(1.0 - leverage, 1e-12)) ** 2)
    residual, leverage = residual - curvature * first, leverage + first**2 / square
    curved = np.sum((residual / np.maximum(1.0 - leverage, 1e-12)) ** 2)
    limit = HALF if n >= FEWEST_OF_PARABOLA else TENTH
    return slope * line + curvature * parabola if curved < limit * straight else other


def mean_of(
    values: Sequence[np.ndarray], replicates: np.ndarray | None = None, n_curved: int = 0, part: float = 0.0
) -> Estimate:
    """Return the mean of the best model, from values of every model, the best first: shapes (m_1,) to (m_k,), each the
    first samples of the next; m_1 at least `FEWEST`.

    Replicates are the numbers of the independent ones that samples belong to, shape (m_k,), each with one of the first
    m_1 at least; None where samples are independent. The variance is then the jackknife's over replicates, each left
    out in turn with the coefficients of the others, and `part` that the interval as of independent samples has in that
    of replicates. `n_curved` models `calibrated` has taken through a parabola: one more coefficient each.
    """
    best, others = values[0], values[1:]
    m = np.array([value.size for value in values])
    first = best.size
    known, centred, of_best, squares, products = _moments(values)
    coefficients = np.where(known, products / squares, 0.0)
    sizes = np.sqrt(squares * np.sum(of_best**2))
    correlations = np.where(known & (sizes > 0.0), products / np.where(sizes > 0.0, sizes, 1.0), 0.0)
    value = _mean(values, coefficients)
    if replicates is not None:
        each = []
        for number in np.unique(replicates):
            some = [value_of[replicates[: value_of.size] != number] for value_of in values]
            known_of, _, _, squares_of, products_of = _moments(some)
            each.append(_mean(some, np.where(known_of, products_of / squares_of, 0.0)))
        # every coefficient takes a degree, as of independent samples
        parts, freedoms = [(len(each) - 1) * np.var(each)], [max(len(each) - len(values) - n_curved, 1)]
    else:
        gains = np.array([np.mean(one) - np.mean(one[:n]) for one, n in zip(others, m)])
        weights = 1.0 / m[1:] - 1.0 / m[:-1]  # of a sample that both means of a gain have
        # the first stratum: everything once more, without each of its samples in turn
        left = squares[:, None] - first / (first - 1) * centred**2
        left = np.where(left > 0.0, left, np.inf)  # without one sample there may be nothing left
        without = np.where(known[:, None], (products[:, None] - first / (first - 1) * centred * of_best) / left, 0.0)
        moved = gains[:, None] - first * weights[:, None] * centred / (first - 1)
        repeated = np.mean(best) - of_best / (first - 1) + np.sum(without * moved, axis=0)
        parts = [(first - 1) / first * np.sum((repeated - repeated.mean()) ** 2)]
        freedoms = [intervals.freedom_of(repeated, max(first - len(values) - n_curved, 1))]
        for j in range(len(others)):
            n = int(m[j + 1] - m[j])
            if n:
                # what each sample of the stratum adds; of one alone, without a spread, those of the first stratum
                of = slice(m[j], m[j + 1]) if n > 1 else slice(0, m[0])
                each = coefficients[j] * others[j][of] / m[j + 1]
                for i in range(j + 1, len(others)):
                    each = each + coefficients[i] * weights[i] * others[i][of]
                parts.append(n * float(np.var(each, ddof=1)))
                freedoms.append(intervals.freedom_of(each, max(n - 1, 1)))
    variance, sums = float(np.sum(parts)), float(np.sum(np.array(parts) ** 2 / np.array(freedoms)))
    freedom = variance**2 / sums if sums > 0.0 else float(freedoms[0])
    apart = (mean_of(values, None, n_curved), part) if replicates is not None and part > 0.0 else None
    return Estimate(value, variance, freedom, coefficients, correlations, apart)


def _mean(values: Sequence[np.ndarray], coefficients: np.ndarray) -> float:
    gains = [np.mean(cheaper) - np.mean(cheaper[: better.size]) for better, cheaper in zip(values, values[1:])]
    return float(np.mean(values[0]) + coefficients @ np.array(gains))


def _moments(values: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Return of the first samples of the cheaper models: whether they vary, their distances and those of the best
    one from the means, sums of squares (1 where they do not vary) and of products with the best one."""
    best, others = values[0], values[1:]
    rest = np.array([value[: best.size] for value in others]).reshape(len(others), best.size)
    centred, of_best = rest - rest.mean(axis=1, keepdims=True), best - best.mean()
    squares = np.sum(centred**2, axis=1)
    known = squares > best.size * (1e-12 * np.max(np.abs(rest), axis=1, initial=0.0)) ** 2  # not a constant
    return known, centred, of_best, np.where(known, squares, 1.0), centred @ of_best


def deviation_of(
    values: Sequence[np.ndarray],
    mean: Estimate,
    confidence: float,
    replicates: np.ndarray | None = None,
    n_curved: int = 0,
    part: float = 0.0,
) -> tuple[float, np.ndarray]:
    """Return the standard deviation of the best model and its interval (2,); arguments are as `mean_of` takes and gives
    them.

    Both are NaN where the variance is not positive, the interval below `FEWEST_OF_DEVIATION` samples.
    """
    n_taken = n_curved + (replicates is not None)  # of few replicates the mean takes one more degree
    centres = [mean.value, *(float(np.mean(value)) for value in values[1:])]
    squares = mean_of([(value - centre) ** 2 for value, centre in zip(values, centres)], replicates, n_taken, part)
    variance = squares.value + mean.variance  # squares about the mean of the same samples are too small by that
    if not variance > 0.0:
        return float("nan"), intervals.UNKNOWN
    if values[0].size < FEWEST_OF_DEVIATION:
        return float(np.sqrt(variance)), intervals.UNKNOWN
    z, n = scipy.special.ndtri(0.5 + 0.5 * confidence), values[0].size
    reach = squares.reach(confidence) / variance * n / (n - z)  # Bonett's correction of the logarithm
    return float(np.sqrt(variance)), np.sqrt(variance) * np.exp(0.5 * reach * np.array([-1.0, 1.0]))


def probability_of(came_true: Sequence[np.ndarray], confidence: float) -> tuple[float, np.ndarray]:
    """Return the probability of an event in the best model and its interval (2,), from whether it came true in each
    model, bool, as `mean_of` takes values."""
    value = float(np.mean(came_true[-1]))
    low, high = intervals.of_probability(int(came_true[-1].sum()), came_true[-1].size, confidence)
    for better, cheaper in reversed(list(zip(came_true, came_true[1:]))):
        given = cheaper[: better.size]
        # where there is no such sample, none disagrees
        kept, of_kept = _share(better[given], 1.0, confidence)
        gained, of_gained = _share(better[~given], 0.0, confidence)
        ends = (low, high) if kept >= gained else (high, low)
        steps = np.array(
            [value * (of_kept - kept), (1.0 - value) * (of_gained - gained), (kept - gained) * (np.array(ends) - value)]
        )
        value = kept * value + gained * (1.0 - value)
        low, high = value + np.array([-1.0, 1.0]) * np.sqrt(np.sum(steps**2, axis=0))
    return value, np.clip([low, high], 0.0, 1.0)


def probability_with_failed(
    came_true: Sequence[np.ndarray], known: Sequence[np.ndarray], confidence: float
) -> tuple[float, np.ndarray]:
    """Return the probability of an event over the draws that are known in all models, and an interval (2,) in which the
    others are outside the event in every model at its lower end, and in it at the upper one.

    Both arguments are bool of every model, as `mean_of` takes values; draws that are not known did not come true.
    """
    each = [known[-1][: one.size] for one in came_true]
    for one in known[:-1]:
        each = [of & np.concatenate([one, np.ones(max(of.size - one.size, 0), dtype=bool)])[: of.size] for of in each]
    value, ends = probability_of([one[of] for one, of in zip(came_true, each)], confidence)
    if all(of.all() for of in known):
        return value, ends
    low = probability_of([one & of for one, of in zip(came_true, known)], confidence)[1][0]
    high = probability_of([one | ~of for one, of in zip(came_true, known)], confidence)[1][1]
    return value, np.array([min(low, ends[0]), max(high, ends[1])])


def _share(true: np.ndarray, of_none: float, confidence: float) -> tuple[float, np.ndarray]:
    """Return the share of trials (n,) that came true, `of_none` without any, and its interval (2,)."""
    share = float(np.mean(true)) if true.size else of_none
    return share, intervals.of_share(int(true.sum()), true.size, confidence)


def allocation(costs: np.ndarray, correlations: np.ndarray) -> np.ndarray:
    """Return how many samples models have for one of the best, (k,), the least variance for the costs of a sample,
    (k,), the best first.

    Theorem 3.4 of Peherstorfer et al.: ``r_i = sqrt(w_1 (rho_i^2 - rho_(i+1)^2) / (w_i (1 - rho_2^2)))``, rho the
    correlations with the best one, (k,), 1 of itself. Where models are not in the order of their correlations, or a
    cheaper one would have fewer samples, r_i is that of the one before.
    """
    squared = np.append(np.minimum(correlations**2, 1.0 - 1e-12), 0.0)
    squared[0] = 1.0
    gains = np.maximum(squared[:-1] - squared[1:], 0.0)
    return np.maximum.accumulate(np.sqrt(costs[0] * gains / (costs * gains[0])))


PILOT = 16  # samples of every better model
PILOT_OF_OWN = 256  # of the ensemble's own, which is as a rule faster in large batches
FOR_DEVIATIONS = 0.1  # of the budget, for samples enough for an interval of the deviation
OVERDRAWN = 1.5  # by the least numbers of samples, before a budget is refused
ROUNDS = (0.1, 0.4, 1.0)  # shares of what is chosen that are integrated before costs are taken anew


def counts(
    costs: np.ndarray, correlations: np.ndarray, given: Sequence[int | None], budget: float, most: int
) -> np.ndarray | None:
    """Return the numbers of samples of all models, the best first, that a budget (s) pays for; None where there are
    none.

    Costs of a sample (s) and correlations with the best model are of shape (k,). Numbers that are `given` are not
    chosen, None are; the cheapest model has so many at `most`.
    """
    shares = allocation(costs, correlations)
    enough = FEWEST_OF_DEVIATION
    least = np.where(enough * costs <= FOR_DEVIATIONS * budget, enough, PILOT)
    free = np.array([n is None for n in given])
    found = np.array([most if n is None else n for n in given])
    behind = np.minimum.accumulate(found[::-1])[::-1]  # no more than any cheaper model has
    while free.any():
        left = budget - float(costs @ np.where(free, 0, found))
        if left <= 0.0:
            return None
        wanted = left * shares / float(np.sum((costs * shares)[free]))
        few = free & (wanted < least)
        # what is raised to the least number is given, and what is left is divided anew
        chosen = few if few.any() else free
        found = np.where(chosen, np.maximum(wanted, least).astype(int), found)
        free = free & ~chosen
    found = np.minimum(np.maximum.accumulate(found), behind)
    return found if costs @ found <= OVERDRAWN * budget else None


def correlations_of(kept: Sequence[Checkpoint], n: int) -> np.ndarray:
    """Return the correlations of all models with the best, (k,), of the output for which the next one's is least."""
    columns = [one.columns() for one in kept]
    fine = np.all([one["status"][:n] == Status.FINE for one in columns], axis=0)
    found = []
    for name in columns[0].of("outputs"):
        values = np.array([one.of("outputs")[name][:n][fine] for one in columns])
        if values.shape[1] >= FEWEST and np.all(np.ptp(values, axis=1) > 0.0):
            found.append(np.corrcoef(values)[0])
    if not found:
        raise RunError(
            f"--correct MODEL=auto: of the pilot's {n} samples {int(fine.sum())} are fine in all models, and no output "
            "varies in all of them; give numbers, such as --correct full=200"
        )
    return min(found, key=lambda one: abs(one[1]))


@dataclass(frozen=True)
class Better:
    """A better model than that of an ensemble, and how many samples of it are wanted."""

    name: str  # as it was asked for: ``full``, ``full/4``
    model: Model  # its scene is that of the ensemble, but for the step
    count: int | None  # none where measured costs and correlations are to decide

    @property
    def key(self) -> str:
        """The name without a slash, which makes groups in files and folders of paths."""
        return self.name.replace("/", ":")


def plan_of(plan: Plan, better: Better) -> Plan:
    """Return the plan of a better model's samples, whose checkpoint lies within that of the ensemble."""
    output = pieces_path(plan.output) / better.key
    return replace(plan, n_samples=plan.n_samples if better.count is None else better.count, output=output)


class Levels:
    """The samples of all models, the best first, as far as they are fine in their own model and in all cheaper ones.

    `columns` are those of every model by its name, the ensemble's own last, as many samples as each has, `replicates`,
    (N,), what these belong to, None where they are independent. `names` are those of the models, `n_lost` the number of
    draws that failed in a better model, though not in the ensemble's own.
    """

    def __init__(self, columns: Mapping[str, Columns], replicates: np.ndarray | None) -> None:
        self.names, self.columns = tuple(columns), list(columns.values())
        self._replicates = replicates
        status = [one["status"] for one in self.columns]
        fine = status[-1] == Status.FINE
        self._usable = fine.copy()
        for of_model in status[-2::-1]:
            self._usable[: of_model.size] &= of_model == Status.FINE
        self.n_lost = int(np.sum(fine & ~self._usable))
        self._sizes = [one.size for one in status]

    @property
    def counts(self) -> np.ndarray:
        """Number of samples of each model that can be used."""
        return np.array([int(self._usable[:n].sum()) for n in self._sizes])

    def values(self, of: Callable[[Columns], np.ndarray]) -> tuple[list[np.ndarray], np.ndarray | None]:
        """Return a quantity of every model, of the samples that can be used and have one in all models, and the
        replicates that these belong to; None where they are independent."""
        each = [of(one) for one in self.columns]
        usable = self._usable.copy()
        for values in each:
            usable[: values.size] &= np.isfinite(values) if values.dtype.kind == "f" else True
        replicates = None if self._replicates is None else self._replicates[usable]
        return [values[usable[: values.size]] for values in each], replicates

    def probability(self, label: str, event: Event, confidence: float) -> Corrected:
        """Return that of an event, over the samples of every model of which it is known."""
        known = [one["status"] == Status.FINE for one in self.columns]
        true = [came_true(event, label, one.of("outputs"), one.of("first_passages")) for one in self.columns]
        true = [one & of for one, of in zip(true, known)]
        value, ends = probability_with_failed(true, known, confidence)
        count, n, n_failed = int(true[0].sum()), int(known[0].sum()), int(np.sum(~known[0]))
        alone = intervals.of_probability(count, n, confidence, n_failed)
        figures = {"estimate": Figure(value, ends, count / n if n else np.nan, alone)}
        return Corrected(figures, np.array([int(one.sum()) for one in known]), np.zeros(0), np.zeros(0))


def with_better(
    ensemble: Ensemble, scene: Scene, columns: Mapping[str, Columns], replicates: np.ndarray | None
) -> Ensemble:
    """Return an ensemble with the figures of the best model, of every quantity and every event, and what is to be said
    of them; columns and replicates are as of `Levels`."""
    levels, record = Levels(columns, replicates), ensemble.record
    level, figures = scene.ensemble.confidence, {}
    *better, own = levels.columns
    for name in [name for name, _ in quantities(own.of("outputs"), own.of("extremes"))]:
        values, replicates = levels.values(lambda one: quantity(name, one.of("outputs"), one.of("extremes")))
        n = values[0].size
        in_all = replicates is None or np.unique(replicates[:n]).size == np.unique(replicates).size > 1
        if n >= FEWEST and in_all:
            figures[name] = corrected(values, level, replicates)
    for label, event in scene.ensemble.probabilities.items():
        if levels.counts[0] >= FEWEST:
            figures[label] = levels.probability(label, event, level)
    outputs = {name: dict(columns.of("outputs").items()) for name, columns in zip(levels.names, better)}
    status = {name: columns["status"].astype(int) for name, columns in zip(levels.names, better)}
    found = Joined(levels.names, level, figures, outputs, status)
    remarks = (*record.remarks, *joined_remarks(scene, found, levels))
    return replace(ensemble, joined=found, record=replace(record, remarks=remarks))


def corrected(values: Sequence[np.ndarray], confidence: float, replicates: np.ndarray | None = None) -> Corrected:
    """Return mean, deviation and bias from values of all models, as `mean_of` takes them."""
    best, own = values[0], values[-1]
    nearer = calibrated(values)
    n_curved = sum(one is not other for one, other in zip(nearer, values))
    parts = parts_alone = (0.0, 0.0)
    if replicates is not None and not is_constant(own):
        n_replicates = np.unique(replicates).size
        parts, parts_alone = (parts_of_tails(nearer[-1], n / n_replicates) for n in (own.size, best.size))
    mean = mean_of(nearer, replicates, n_curved, parts[0])
    # half of the part: the many values of the cheapest model know of the tails
    deviation, of_deviation = deviation_of(nearer, mean, confidence, replicates, n_curved, 0.5 * parts[1])
    # the cheapest model less the best, with the same controls
    bias = mean_of([own[: best.size] - best, *values[1:]], replicates)
    if replicates is None:
        alone = intervals.of_mean(best, confidence), intervals.of_deviation(best, confidence)
    else:
        of_best = mean_of([best], replicates[: best.size], part=parts_alone[0])
        squares = deviation_of([best], of_best, confidence, replicates[: best.size], part=parts_alone[1])[1]
        alone = of_best.interval(confidence), squares
    figures = {
        "mean": Figure(mean.value, mean.interval(confidence), float(best.mean()), alone[0]),
        "std": Figure(deviation, of_deviation, float(best.std(ddof=1)), alone[1]),
        "bias": Figure(bias.value, bias.interval(confidence)),
    }
    return Corrected(figures, np.array([one.size for one in values]), mean.correlations, mean.coefficients)


@gathered
def joined_remarks(scene: Scene, found: Joined, levels: Levels) -> Iterator[Remark]:
    """Return what corrected figures rest on, what is left out of them, and the events of which models disagree so
    seldom that intervals are of what few samples cannot show."""
    best, counts = found.models[0], levels.counts
    which = ", ".join(f"{n} of {name}" for name, n in zip(found.models, counts))
    yield note(
        f"/corrected: figures of {best} from samples of several models on the same draws ({which}); their "
        f"intervals carry the error of {' and '.join(found.models[1:])} against {best}. A cheaper model in which "
        f"{best} is clearly curved counts through the parabola that fits. Quantiles, densities, bands and "
        f"Sobol indices are of {found.models[-1]} alone"
    )
    if "/" not in best:
        yield note(
            f"{best} has the steps of the ensemble, so that /corrected knows nothing of their error; "
            f"--correct {best}/2=K has steps half as long"
        )
    if counts[0] < FEWEST:
        yield warning(f"{counts[0]} samples of {best} are fine: too few for /corrected, which takes {FEWEST}")
    elif counts[0] < FEWEST_OF_DEVIATION:
        yield note(
            f"corrected deviations have no interval: it takes {FEWEST_OF_DEVIATION} samples of {best}, and "
            f"there are {counts[0]}"
        )
    if FEWEST <= counts[0] < FEWEST_OF_PARABOLA:
        yield note(
            f"{counts[0]} samples of {best} show whether it is curved in the others only where it is that nearly "
            f"alone; where it is curved and noisy, intervals of corrected means are short: take "
            f"{FEWEST_OF_PARABOLA} or more"
        )
    if found.n_failed or levels.n_lost:
        yield warning(
            f"{found.n_failed} samples of better models failed (/better/<model>/status); /corrected is without "
            f"{levels.n_lost} draws that failed in one model and not in the ensemble's own, and may be biased; "
            "intervals of probabilities count all failed ones both ways"
        )
    for label, event in scene.ensemble.probabilities.items():
        known, _ = levels.values(lambda one: came_true(event, label, one.of("outputs"), one.of("first_passages")))
        best, cheaper = known[:2]
        n = best.size
        count = int(np.sum(best != cheaper[:n]))
        if n >= FEWEST and count < FEW_DISAGREEMENTS:
            more = f"; about {FEW_DISAGREEMENTS * n // count} samples would show it" if count else ""
            which = f"{levels.names[0]} and {levels.names[1]} disagree in {count} of {n} samples"
            room = f"its interval leaves room for what {n} samples do not show, and holds more often than it says"
            yield note(f"/corrected/{label}: {which}: {room}{more}")
