"""Statistics of ensembles, with their sampling errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgmp_petsc.results.ensemble import Statistics


def describe(values: np.ndarray, bins: int, probabilities: Sequence[float], n_missing: int = 0) -> Statistics:
    """Describe a sample, of which some values may be missing.

    The standard error of the standard deviation s takes the sample's own fourth moment,
    ``var(s) = (mu4 - s^4) / (4 s^2 N)``.

    Parameters
    ----------
    values
        Shape (N,), all finite; an empty sample gives NaN and no bins.
    bins
        Number of equal bins of the density over the sample's range.
    probabilities
        Of the quantiles.
    n_missing
        How many more values there would be if no sample had failed; they have no part but in the bounds of the
        quantiles.
    """
    probabilities = np.asarray(probabilities, dtype=float)
    n = values.size
    if n == 0:
        nan = float("nan")
        return Statistics(
            0, nan, nan, nan, nan, np.empty(0), np.empty(0), np.full(probabilities.size, nan),
            quantile_bounds(values, probabilities, n_missing), probabilities,
        )  # fmt: skip
    pdf, edges = _density(values, bins)
    std = float(np.std(values, ddof=1)) if n > 1 else float("nan")
    spread = 0.0 if n > 1 else std
    if std > 1e-12 * float(np.max(np.abs(values))):
        fourth = float(np.mean((values - np.mean(values)) ** 4))
        spread = np.sqrt(max(fourth - std**4, 0.0) / n) / (2 * std)
    return Statistics(
        count=n,
        mean=float(np.mean(values)),
        std=std,
        mean_standard_error=float(std / np.sqrt(n)),
        std_standard_error=float(spread),
        pdf=pdf,
        edges=edges,
        quantiles=np.quantile(values, probabilities),
        quantile_bounds=quantile_bounds(values, probabilities, n_missing),
        probabilities=probabilities,
    )


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


def _density(values: np.ndarray, bins: int) -> tuple[np.ndarray, np.ndarray]:
    """Return density and edges; a sample without spread gets one bin's width from its own size."""
    lowest, highest = float(values.min()), float(values.max())
    if not highest - lowest > 1e-12 * max(abs(lowest), abs(highest)):
        margin = max(abs(lowest), 1.0) * 1e-6
        lowest, highest = lowest - margin, highest + margin
    return np.histogram(values, bins=bins, range=(lowest, highest), density=True)
