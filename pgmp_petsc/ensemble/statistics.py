"""Statistics of ensembles, with their sampling errors and confidence intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgmp_petsc.ensemble import intervals
from pgmp_petsc.results.statistics import Statistics

MOST_BINS = 200


def describe(
    values: np.ndarray,
    bins: int | None,
    probabilities: Sequence[float],
    n_missing: int = 0,
    confidence: float = 0.95,
    replicates: np.ndarray | None = None,
) -> Statistics:
    """Describe a sample, of which some values may be missing.

    The standard error of the standard deviation s takes the sample's own fourth moment,
    ``var(s) = (mu4 - s^4) / (4 s^2 N)``. Where the sample consists of independent replicates, standard errors and
    intervals of mean and deviation follow from the spread between these; those of quantiles take all values for
    independent ones, which makes them wider rather than narrower.

    Parameters
    ----------
    values
        Shape (N,), all finite; an empty sample gives NaN and no bins.
    bins
        Number of equal bins of the density over the sample's range; None for as many as the sample tells.
    probabilities
        Of the quantiles.
    n_missing
        How many more values there would be if no sample had failed; they have no part but in the bounds of the
        quantiles.
    confidence
        Level of the intervals; see `intervals`.
    replicates
        Numbers of the replicates that the values belong to, shape (N,); None where values are independent.
    """
    probabilities = np.asarray(probabilities, dtype=float)
    ordered = np.sort(values)
    pdf, edges = _density(values, bins) if values.size else (np.empty(0), np.empty(0))
    mean = float(np.mean(values)) if values.size else float("nan")
    std = float(np.std(values, ddof=1)) if values.size > 1 else float("nan")
    if replicates is None:
        errors = (float(std / np.sqrt(max(values.size, 1))), _error_of_deviation(values, std))
        of_mean = intervals.of_mean(values, confidence)
        of_deviation = intervals.of_deviation(values, confidence)
    else:
        errors, of_mean, of_deviation = _between(values, replicates, mean, std, confidence)
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
        quantile_intervals=intervals.of_quantiles(ordered, probabilities, confidence),
        confidence=confidence,
    )


def _error_of_deviation(values: np.ndarray, std: float) -> float:
    """Return the standard error of the standard deviation of independent values."""
    if values.size < 2:
        return float("nan")
    if not std > 1e-12 * float(np.max(np.abs(values))):
        return 0.0
    fourth = float(np.mean((values - np.mean(values)) ** 4))
    return float(np.sqrt(max(fourth - std**4, 0.0) / values.size) / (2 * std))


def _between(
    values: np.ndarray, replicates: np.ndarray, mean: float, std: float, confidence: float
) -> tuple[tuple[float, float], np.ndarray, np.ndarray]:
    """Return standard errors and intervals of mean and deviation from the spread between replicates.

    NaN where a replicate has less than two values, or there is only one.
    """
    parts = [values[replicates == number] for number in np.unique(replicates)]
    if len(parts) < 2 or min(part.size for part in parts) < 2:
        return (float("nan"), float("nan")), intervals.UNKNOWN, intervals.UNKNOWN
    figures = np.array([[np.mean(part), np.std(part, ddof=1)] for part in parts])
    errors = np.std(figures, axis=0, ddof=1) / np.sqrt(len(parts))
    found = intervals.of_replicates(np.array([mean, std]), figures, confidence)
    return (float(errors[0]), float(errors[1])), found[0], np.maximum(found[1], 0.0)


def quantile_bounds(values: np.ndarray, probabilities: np.ndarray, n_missing: int) -> np.ndarray:
    """Return bounds of the quantiles of a sample of which some values are not known, shape (n_quantiles, 2).

    The smallest that a quantile can be is that of the sample with all missing values below the known ones, the largest
    that with all above; infinite where such a value has a part in it. A quantile is interpolated between neighbours,
    as `numpy.quantile` does.
    """
    ordered, n = np.sort(values), values.size + n_missing
    bounds = np.full((len(probabilities), 2), [-np.inf, np.inf])
    for row, probability in zip(bounds, probabilities if n else ()):
        at = probability * (n - 1)
        below, above = int(np.floor(at)), int(np.ceil(at))
        share = at - below
        if below >= n_missing:
            row[0] = (1 - share) * ordered[below - n_missing] + share * ordered[above - n_missing]
        if above < values.size:
            row[1] = (1 - share) * ordered[below] + share * ordered[above]
    return bounds


def _density(values: np.ndarray, bins: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Return density and edges; a sample without spread gets one bin's width from its own size.

    Without a number of bins it is the larger one of Freedman and Diaconis's, of the width ``2 IQR / n^(1/3)``, and
    Sturges's ``1 + log2(n)``, up to `MOST_BINS`, as heavy tails have bins without number.
    """
    lowest, highest = float(values.min()), float(values.max())
    if not highest - lowest > 1e-12 * max(abs(lowest), abs(highest)):
        margin = max(abs(lowest), 1.0) * 1e-6
        lowest, highest = lowest - margin, highest + margin
    if bins is None:
        low, high = np.quantile(values, (0.25, 0.75))
        by_width = (highest - lowest) * values.size ** (1.0 / 3.0) / (2.0 * (high - low)) if high > low else 0.0
        bins = int(np.ceil(np.clip(max(by_width, 1.0 + np.log2(values.size)), 1, MOST_BINS)))
    return np.histogram(values, bins=bins, range=(lowest, highest), density=True)
