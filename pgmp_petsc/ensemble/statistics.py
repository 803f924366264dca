"""Statistics of ensembles, with their sampling errors and confidence intervals.

Their quantities are outputs at the end and their extremes, whether events came true, and by how much they did or did
not. Sobol indices are ``S1 = Var(E(y | x_i)) / Var(y)`` and ``ST = E(Var(y | x_~i)) / Var(y)``; docs/uncertainty.md
(which parameters matter) says how they are found. What lines in slices leave is adjusted for their coefficients
(Kelley, PNAS 21 (1935) 554-559), and errors of such an index are, to the first order, means of ``(1 - S1) (y - mean)^2
/ Var(y) - r^2 / Var(y)`` (the influence of a sample: Da Veiga and Gamboa, Journal of Nonparametric Statistics 25 (2013)
573-595), r what the lines leave. Of replicates pseudo-values of a jackknife make the interval.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from pgmp_petsc.base.errors import Remark, gathered, note, warning
from pgmp_petsc.base.units import Units, UnitSystem
from pgmp_petsc.ensemble import intervals
from pgmp_petsc.results.ensemble import DESCRIBED, Sensitivity, Statistics
from pgmp_petsc.results.numbers import ROUND_OFF, Arrays, sizes_of, with_unit
from pgmp_petsc.scene.numerics import Event


def quantities(outputs: Arrays, extremes: Arrays) -> Iterator[tuple[str, np.ndarray]]:
    """Yield outputs at the end, and over time where their extremes are known; one in memory at a time."""
    yield from outputs.items()
    for key in extremes:
        name, _, which = key.rpartition("/")
        if which in DESCRIBED:
            yield f"{name}.{which}", extremes[key]


def quantity(name: str, outputs: Arrays, extremes: Arrays) -> np.ndarray:
    return outputs[name] if name in outputs else extremes["/".join(name.rsplit(".", 1))]


def came_true(event: Event, label: str, outputs: Arrays, passages: Arrays) -> np.ndarray:
    """Return in which samples an event came true, bool (N,); those that failed have none."""
    if event.when == "ever":
        return np.isfinite(passages[label])
    return event.sign * (outputs[event.output] - event.level) > 0.0


def in_words(event: Event, unit: str, system: UnitSystem) -> str:
    """Return what comes true: ``angle above 3 rad at the end``; `unit` is that of the output."""
    side = "above" if event.above is not None else "below"
    when = "at the end" if event.when == "end" else "at any time"
    return f"{event.output} {side} {with_unit(*system.named(event.level, unit), 6)} {when}"


@dataclass(frozen=True, eq=False)
class Peaks:
    """How far outputs go in each sample."""

    outputs: Arrays  # at the end, (N,)
    extremes: Arrays  # over time, ``<output>/max`` and ``min``, (N,), where these are known
    #: smallest and largest values at the instants of the bands, (2, n_known), of the first samples
    ends: Arrays

    def over_time(self, output: str, which: str) -> np.ndarray:
        """Return ``max`` or ``min`` of an output over time, (N,); NaN where it is not known."""
        if f"{output}/{which}" in self.extremes:
            return self.extremes[f"{output}/{which}"]
        found = np.full(self.outputs[output].size, np.nan)
        if output in self.ends:
            of_bands = self.ends[output][int(which == "max")]
            found[: of_bands.size] = of_bands
        return found

    def largest(self, output: str) -> np.ndarray:
        """Return the largest size of an output in each sample, (N,); of those of which it is not known the median of
        the others, and where it is of none, the largest size at the end."""
        found = np.fmax(np.abs(self.over_time(output, "max")), np.abs(self.over_time(output, "min")))
        known = np.isfinite(found)
        others = found[known] if known.any() else np.abs(self.outputs[output])
        others = others[np.isfinite(others)]
        stand_in = np.nan if not others.size else np.median(others) if known.any() else others.max()
        return np.where(known, found, stand_in)

    def sizes(self, units: Units, fine: np.ndarray, length: float = 0.0) -> dict[str, float]:
        """Return beside what each quantity may vary by round-off: `sizes_of` the outputs, and a length of the
        mechanism's in m."""
        sizes = sizes_of({output: self.largest(output)[fine] for output in self.outputs}, units, length)
        return sizes | {f"{output}.{which}": size for output, size in sizes.items() for which in DESCRIBED}

    def excess(self, event: Event) -> np.ndarray:
        """Return how far the output of an event is beyond its level, (N,): negative where it is not."""
        at_end = event.when == "end"
        values = self.outputs[event.output] if at_end else self.over_time(event.output, event.extreme)
        return event.sign * (values - event.level)


MOST_BINS = 200
SMALLEST_SIZE = 1e-200  # of values whose size says how wide a bin of constant ones is
# Of one sample of its outermost slice of the parameters each, replicates know little of what tails do there. So the
# interval as of independent values has a part in theirs: of a deviation from the kurtosis of a normal law on, all of it
# at HEAVY; of a mean so many times the root of the samples of a replicate, and that in full at a skewness of SKEW
NORMAL, HEAVY, SKEW, OF_MEAN = 3.0, 6.0, 2.0, 1.6
MATTERS = 0.1  # of a probability: less of it is not worth a better model


def is_constant(values: np.ndarray, size: float = 0.0) -> bool:
    """Return whether values (n,) vary by round-off alone, of themselves or of the size that the quantity has."""
    return not np.ptp(values) > ROUND_OFF * max(size, float(np.max(np.abs(values)))) if values.size else True


def describe(
    values: np.ndarray,
    bins: int | None,
    probabilities: Sequence[float],
    n_missing: int = 0,
    confidence: float = 0.95,
    replicates: np.ndarray | None = None,
    size: float = 0.0,
) -> Statistics:
    """Describe a sample, values of shape (N,), all finite, of which `n_missing` more may be missing.

    The standard error of the standard deviation s takes the sample's own fourth moment, ``var(s) = (mu4 - s^4) / (4 s^2
    N)``. Where the sample consists of independent replicates, standard errors and intervals follow from the spread
    between these. An empty sample gives NaN and no bins.

    The density has so many equal bins over the sample's range; None for as many as the sample tells. Values that are
    missing, as samples failed, have no part but in the bounds of the quantiles of these probabilities. The confidence
    is the level of the intervals; see `intervals`. Replicates are the numbers of those that the values belong to, shape
    (N,); None where values are independent. Beside the `size` of the quantity variation may be round-off
    (`is_constant`); what is constant has no deviation.
    """
    constant = values.size > 1 and is_constant(values, size)
    if constant:
        values = np.full(values.size, np.mean(values))
    probabilities = np.asarray(probabilities, dtype=float)
    ordered = np.sort(values)
    pdf, edges = _density(values, bins) if values.size else (np.empty(0), np.empty(0))
    mean = float(np.mean(values)) if values.size else float("nan")
    std = float(np.std(values, ddof=1)) if values.size > 1 else float("nan")
    sizes = None
    if constant:
        mean, std, errors = float(values[0]), 0.0, (0.0, 0.0)
        of_mean, of_deviation = np.full(2, mean), np.zeros(2)
    elif replicates is None:
        of_std = float("nan") if values.size < 2 else 0.0
        if std > 1e-12 * float(np.max(np.abs(values), initial=0.0)):
            fourth = float(np.mean((values - np.mean(values)) ** 4))
            of_std = float(np.sqrt(max(fourth - std**4, 0.0) / values.size) / (2 * std))
        errors = (float(std / np.sqrt(max(values.size, 1))), of_std)
        of_mean = intervals.of_mean(values, confidence)
        of_deviation = intervals.of_deviation(values, confidence)
    else:
        errors, of_mean, std, of_deviation = _between(values, replicates, mean, std, confidence)
        if values.size:  # how many independent values are as good at each quantile
            places = np.unique(replicates, return_inverse=True)[1]
            counts = np.bincount(places).astype(float)
            below = (np.bincount(places, values <= limit) for limit in np.quantile(ordered, probabilities))
            sizes = np.array([intervals.equivalent_size(of, counts, confidence) for of in below])
    return Statistics(
        count=values.size,
        mean=mean,
        std=std,
        mean_standard_error=errors[0],
        std_standard_error=errors[1],
        pdf=pdf,
        edges=edges,
        quantiles=np.quantile(ordered, probabilities) if values.size else np.full(probabilities.size, np.nan),
        quantile_bounds=quantile_bounds(ordered, probabilities, n_missing),
        probabilities=probabilities,
        mean_interval=of_mean,
        std_interval=of_deviation,
        quantile_intervals=intervals.of_quantiles(ordered, probabilities, confidence, sizes),
        confidence=confidence,
        constant=constant,
    )


def _between(
    values: np.ndarray, replicates: np.ndarray, mean: float, std: float, confidence: float
) -> tuple[tuple[float, float], np.ndarray, float, np.ndarray]:
    """Return standard errors, the mean's interval, the deviation and its interval from the spread between replicates.

    The variance is the mean of squared distances from the mean, and the mean's own variance, by which they are too
    small; its interval is that of its logarithm. NaN where a replicate has less than two values, or there is only one.
    """
    numbers, places, counts = np.unique(replicates, return_inverse=True, return_counts=True)
    if numbers.size < 2 or counts.min() < 2:
        return (float("nan"), float("nan")), intervals.UNKNOWN, std, intervals.UNKNOWN
    squares = (values - mean) ** 2
    means, variances = (np.bincount(places, of) / counts for of in (values, squares))
    error, spread = (float(np.std(of, ddof=1) / np.sqrt(numbers.size)) for of in (means, variances))
    variance = float(np.mean(squares)) + error**2
    freedom = intervals.freedom_of(variances, numbers.size - 1)
    low, high = intervals.of_replicates(0.0, variances / variance, confidence, freedom)
    skewed, heavy = parts_of_tails(values, values.size / numbers.size)
    alone, reach = intervals.of_deviation(values, confidence), 0.5 * (high - low)
    reach = float(np.hypot(reach, heavy * np.log(alone[1] / alone[0]))) if heavy > 0.0 else reach
    std = float(np.sqrt(variance))
    reaches = [0.5 * np.ptp(intervals.of_replicates(mean, means, confidence))]
    reaches.append(skewed * 0.5 * np.ptp(intervals.of_mean(values, confidence)))
    of_mean = mean + np.hypot(*reaches) * np.array([-1.0, 1.0])
    return (error, spread / (2.0 * std)), of_mean, std, std * np.exp(0.5 * reach * np.array([-1.0, 1.0]))


def parts_of_tails(values: np.ndarray, of_replicate: float) -> tuple[float, float]:
    """Return the parts that intervals as of independent values (n,) have in those of replicates, of so many samples
    each: of the mean, and of the deviation."""
    scaled = values - np.mean(values)
    scaled /= np.std(values)
    squares = scaled**2
    skewness, kurtosis = float(np.mean(squares * scaled)), float(np.mean(squares**2))
    of_mean = OF_MEAN / np.sqrt(of_replicate) * min(abs(skewness) / SKEW, 1.0)
    return min(of_mean, 1.0), float(np.clip((kurtosis - NORMAL) / (HEAVY - NORMAL), 0.0, 1.0))


def of_event(
    true: np.ndarray, known: np.ndarray, failed: np.ndarray, replicates: np.ndarray | None, confidence: float
) -> tuple[int, int, np.ndarray]:
    """Return in how many samples an event came true, of how many that is known, and the probability's interval.

    Arguments are bool (N,): whether it came true, whether that is known, and whether it is not because the sample
    failed; and the numbers of the replicates that samples belong to, (N,), None of independent ones.
    """
    places = np.zeros(true.size, dtype=int) if replicates is None else np.unique(replicates, return_inverse=True)[1]
    n = int(places.max(initial=0)) + 1
    count, sizes, lost = (np.bincount(places[of], minlength=n) for of in (true & known, known, failed))
    return int(count.sum()), int(sizes.sum()), intervals.of_probability(count, sizes, confidence, lost)


def holds_to(excess: np.ndarray, largest: np.ndarray, width: float, probability: float) -> float:
    """Return up to which error of an output a probability holds, as a share of the output's size in each sample.

    With a larger one the event is in doubt in so many samples that its interval, of some width, which all of them
    widen, gets wider by more than it is, and by more than `MATTERS` of the probability. NaN of no samples. Arguments
    (N,) are by how much the output is beyond the level, and its largest size.
    """
    if not (n := excess.size):
        return float("nan")
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.abs(excess) / largest
    shares[np.isnan(shares)] = np.inf
    place = int(n * max(width, MATTERS * probability))  # of the first sample too many
    return float(np.partition(shares, place)[place]) if place < n else np.inf


def quantile_bounds(values: np.ndarray, probabilities: np.ndarray, n_missing: int) -> np.ndarray:
    """Return bounds of the quantiles of a sample of which some values are not known, shape (n_quantiles, 2).

    The smallest that a quantile can be is that of the sample with all missing values below the known ones, the largest
    that with all above; infinite where such a value has a part in it. A quantile is interpolated between neighbours by
    `numpy.quantile`, so that its bounds are the same to the last bit.
    """
    ordered, n = np.sort(values), values.size + n_missing
    bounds = np.full((len(probabilities), 2), [-np.inf, np.inf])
    for row, probability in zip(bounds, probabilities if n else ()):
        at = probability * (n - 1)
        below, above = int(np.floor(at)), int(np.ceil(at))
        share = at - below
        if below >= n_missing:
            row[0] = np.quantile(ordered[[below - n_missing, above - n_missing]], share)
        if above < values.size:
            row[1] = np.quantile(ordered[[below, above]], share)
    return bounds


def _density(values: np.ndarray, bins: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Return density and edges; a sample without spread gets one bin's width from its own size.

    Without a number of bins it is the larger one of Freedman and Diaconis's, of the width ``2 IQR / n^(1/3)``, and
    Sturges's ``1 + log2(n)``, up to `MOST_BINS`, as heavy tails have bins without number.
    """
    lowest, highest = float(values.min()), float(values.max())
    if is_constant(values):
        margin = 1e-6 * (abs(lowest) if abs(lowest) > SMALLEST_SIZE else 1.0)
        lowest, highest = lowest - margin, highest + margin
    if bins is None:
        low, high = np.quantile(values, (0.25, 0.75))
        by_width = (highest - lowest) * values.size ** (1.0 / 3.0) / (2.0 * (high - low)) if high > low else 0.0
        bins = int(np.ceil(np.clip(max(by_width, 1.0 + np.log2(values.size)), 1, MOST_BINS)))
    return np.histogram(values, bins=bins, range=(lowest, highest), density=True)


IN_SLICE, FEWEST_IN_SLICE = 40, 20  # samples: as many as that, fewer where there are few slices
FEWEST_SLICES, FEW_SLICES, MOST_SLICES = 4, 8, 25
FEWEST_REPLICATES = 3  # of Sobol sequences, whose jackknife leaves pairs
MOST_GIVEN = 10_000  # samples that the slices are of, the first ones: their intervals are a percent or two wide
FEWEST_OF_REPLICATE = 4  # blocks
FEW_OF_REPLICATE = 16  # blocks, below which measured intervals are short: 89 to 97 % at 95 %


def of_blocks(values: np.ndarray, names: list[str], confidence: float, n_replicates: int) -> Sensitivity | None:
    """Return the indices of an output whose samples (N,) are Saltelli's blocks, of so many independent Sobol sequences
    in turn.

    Blocks with a sample that failed (NaN) are left out. None where too few are left of a replicate, or one does not
    vary.
    """
    blocks = values.reshape(-1, len(names) + 2)
    known = np.isfinite(blocks).all(axis=1)
    parts = [k + n_replicates * np.flatnonzero(known[k::n_replicates]) for k in range(n_replicates)]
    if min(map(len, parts)) < FEWEST_OF_REPLICATE or any(is_constant(blocks[part]) for part in parts):
        return None
    # the estimators are biased for outputs far from zero
    scaled = (blocks - blocks[known].mean()) / blocks[known].std()

    def indices(chosen: np.ndarray) -> np.ndarray:
        # Saltelli et al. 2010, table 2: (b) of first indices, (f) of total ones, which is Jansen's
        a, mixed, b = scaled[chosen, :1], scaled[chosen, 1:-1], scaled[chosen, -1:]
        parts = np.mean(b * (mixed - a), axis=0), 0.5 * np.mean((a - mixed) ** 2, axis=0)
        return np.array(parts) / np.concatenate([a, b]).var()

    found = indices(known)
    ends = intervals.of_replicates(found, np.array([indices(part) for part in parts]), confidence)
    return Sensitivity(
        tuple(names), "saltelli", int(known.sum()), confidence, found[0], ends[0], found[1], ends[1]
    )  # fmt: skip


def of_given(
    values: np.ndarray, parameters: Arrays, confidence: float, replicates: np.ndarray | None = None
) -> Sensitivity | None:
    """Return the first indices of an output from any samples (N,), of the first that are fine; None where they, or the
    replicates of Sobol sequences that they belong to, (N,), are too few, or nothing varies."""
    chosen = np.flatnonzero(np.isfinite(values))[:MOST_GIVEN]
    n = chosen.size
    n_slices = min(n // FEWEST_IN_SLICE, max(n // IN_SLICE, FEW_SLICES), MOST_SLICES)
    if n_slices < FEWEST_SLICES or is_constant(values[chosen]):
        return None
    output = (values[chosen] - values[chosen].mean()) / values[chosen].std()
    slices = [_Slices.of(x[chosen], n_slices) for x in parameters.values()]
    if replicates is None:
        first, errors = np.array([_explained(output[part.order], part) for part in slices]).T
        ends = first[:, None] + scipy.special.ndtri(0.5 + 0.5 * confidence) * errors[:, None] * np.array([-1.0, 1.0])
    else:
        numbers = np.unique(replicates[chosen], return_inverse=True)[1]
        if numbers.max() + 1 < FEWEST_REPLICATES:
            return None
        found = [_explained_alike(output[part.order], numbers[part.order], part) for part in slices]
        first = np.array([share for share, _ in found])
        ends = intervals.of_replicates(first, np.transpose([figures for _, figures in found]), confidence)
    return Sensitivity(tuple(parameters), "given data", n, confidence, first, ends)


@dataclass(frozen=True, eq=False)
class _Slices:
    """Slices of the samples in the order of a parameter, as many in each, and lines over its values there.

    Over ranks, the tails of a normal parameter left 1.5 % of what is linear in it.
    """

    order: np.ndarray  # numbers of the samples, shape (n,)
    places: np.ndarray  # slice of each one in this order, shape (n,)
    counts: np.ndarray  # samples in each slice
    across: np.ndarray  # lines in the slices, of mean 0 and norm 1 in each; 0 where the parameter has one value

    @classmethod
    def of(cls, values: np.ndarray, n_slices: int) -> _Slices:
        order = np.argsort(values, kind="stable")
        places = np.arange(order.size) * n_slices // order.size
        counts, ordered = np.bincount(places), values[order]
        across = ordered - (np.bincount(places, ordered) / counts)[places]
        norms = np.sqrt(np.bincount(places, across**2))[places]
        return cls(order, places, counts, np.divide(across, norms, out=np.zeros(order.size), where=norms > 0.0))


def _explained(ordered: np.ndarray, slices: _Slices) -> tuple[float, float]:
    """Return the share of the variance that straight lines in slices explain, less what chance adds, and its error.

    `ordered` are values (n,) of mean 0 and variance 1, in the order of the parameter.
    """
    n, places, across = ordered.size, slices.places, slices.across
    means, slopes = np.bincount(places, ordered) / slices.counts, np.bincount(places, ordered * across)
    left = (ordered - means[places] - slopes[places] * across) ** 2
    n_lines = np.count_nonzero(np.bincount(places, across != 0.0))
    share = 1.0 - np.sum(left) / (n - slices.counts.size - n_lines) * (n - 1) / n
    # without the leverage of a sample what a line leaves of it is too small; nothing is left of one that has a line
    left /= np.maximum(1.0 - 1.0 / slices.counts[places] - across**2, ROUND_OFF)
    return float(share), float(np.std((1.0 - share) * ordered**2 - left) / np.sqrt(n))


def _explained_alike(ordered: np.ndarray, numbers: np.ndarray, slices: _Slices) -> tuple[float, np.ndarray]:
    """Return the share of the variance that lines in slices explain alike in independent replicates, and pseudo-values
    of its jackknife, (n_replicates,).

    `ordered` are values (n,) of mean 0 and variance 1, in the order of the parameter, `numbers` their replicates.
    """
    counts, n_slices = np.bincount(numbers), slices.counts.size
    across, n = slices.across * np.sqrt(slices.counts)[slices.places], counts.size  # of norm 1, as the constant is
    places = numbers * n_slices + slices.places
    sums = [np.bincount(places, of, n * n_slices) for of in (ordered, ordered * across)]
    lines = np.sqrt(n_slices) * np.hstack([one.reshape(n, -1) for one in sums]) / counts[:, None]
    products = lines @ lines.T
    np.fill_diagonal(products, 0.0)
    whole, of_each = products.sum(), products.sum(axis=0)
    share, without = whole / (n * (n - 1)), (whole - 2.0 * of_each) / ((n - 1) * (n - 2))
    return float(share), n * share - (n - 1) * without


def sensitivities(
    quantities: Iterable[tuple[str, np.ndarray]],
    parameters: Arrays,
    names: list[str],
    fine: np.ndarray,
    n_replicates: int | None,
    confidence: float,
    replicates: np.ndarray | None = None,
) -> dict[str, Sensitivity]:
    """Return the indices of all quantities that have them, of names and columns (N,), one in memory at a time.

    `names` are those of the parameters, columns (N,), that are drawn; `fine`, (N,), the samples that are.
    `n_replicates` Sobol sequences are what Saltelli's blocks are of in turn; None of other samples, which belong to
    `replicates` (N,), None where they are independent.
    """
    if n_replicates is None and len(names) < 2:
        return {}
    places, n = np.flatnonzero(fine), fine.size
    if n_replicates is None:
        n = int(places[MOST_GIVEN - 1]) + 1 if places.size > MOST_GIVEN else n  # those hold the first that are fine
        first = {name: parameters[name][:n].copy() for name in names}
        replicates = None if replicates is None else replicates[:n]
    found = {}
    for name, values in quantities:
        known = np.where(fine[:n], values[:n], np.nan)
        if n_replicates is None:
            found[name] = of_given(known, first, confidence, replicates)
        else:
            found[name] = of_blocks(known, names, confidence, n_replicates)
    return {name: one for name, one in found.items() if one is not None}


@gathered
def sensitivity_remarks(
    found: Mapping[str, Sensitivity],
    n_replicates: int | None,
    n_parameters: int,
    fine: np.ndarray,
    correlated: bool,
    replicates: np.ndarray | None = None,
) -> Iterator[Remark]:
    """Return what is to be said of the indices: of what they are, and why there are none; see `sensitivities`."""
    n_fine, fewest = int(fine.sum()), FEWEST_IN_SLICE * FEWEST_SLICES
    n_sequences = np.inf if replicates is None else np.unique(replicates[fine]).size
    if n_replicates is not None:
        yield from _remarks_of_blocks(fine.reshape(-1, n_parameters + 2), n_replicates)
    elif n_parameters < 2:
        return
    elif n_fine < fewest:
        few = "1 sample is" if n_fine == 1 else f"{n_fine} samples are"
        yield note(f"{few} too few to rank parameters by first Sobol indices, which takes {fewest}")
    elif n_sequences < FEWEST_REPLICATES:
        least = f"of Sobol sequences they take {FEWEST_REPLICATES} that are independent"
        yield note(f"there are no first Sobol indices: {least}, ensemble.replicates = {n_sequences}")
    elif found:
        count = max(one.count for one in found.values())
        about = "total ones, which know of parameters that act together, take the sampler saltelli"
        about = "parameters are correlated, so that shares overlap and may sum to more than 1" if correlated else about
        yield note(f"first Sobol indices are estimated from {count} samples in slices of each parameter; {about}")


@gathered
def _remarks_of_blocks(fine: np.ndarray, n_replicates: int) -> Iterator[Remark]:
    """Return what is to be said of blocks with these fine samples, (n_blocks, d + 2)."""
    known, size = fine.all(axis=1), fine.shape[1]
    if not known.all():
        yield warning(
            f"Sobol indices are of the {known.sum()} of {known.size} blocks without a failed sample, and are "
            "biased where samples do not fail at random"
        )
    least = min(int(known[k::n_replicates].sum()) for k in range(n_replicates))
    if least < FEWEST_OF_REPLICATE:
        few = f"{known.sum()} blocks of samples are too few for Sobol indices, which take {FEWEST_OF_REPLICATE}"
        what = f"{few} of each of {n_replicates} Sobol sequences (ensemble.replicates)"
        yield note(f"{what}; give at least -n {FEWEST_OF_REPLICATE * n_replicates * size}")
    elif least < FEW_OF_REPLICATE:
        few = f"intervals of Sobol indices follow from {n_replicates} Sobol sequences of {least} blocks"
        enough = f"from -n {FEW_OF_REPLICATE * n_replicates * size} on they hold as often as they say"
        yield note(f"{few} each, and may be short of such few; {enough}")
