"""Statistics of ensembles, with their sampling errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from pgmp_petsc.results.ensemble import Statistics


def describe(values: np.ndarray, bins: int, probabilities: Sequence[float]) -> Statistics:
    """Describe a sample.

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
    """
    probabilities = np.asarray(probabilities, dtype=float)
    n = values.size
    if n == 0:
        nan = float("nan")
        return Statistics(
            nan, nan, nan, nan, np.empty(0), np.empty(0), np.full(probabilities.size, nan), probabilities
        )
    pdf, edges = _density(values, bins)
    std = float(np.std(values, ddof=1)) if n > 1 else 0.0
    spread = 0.0
    if std > 1e-12 * float(np.max(np.abs(values))):
        fourth = float(stats.moment(values, moment=4))
        spread = np.sqrt(max(fourth - std**4, 0.0) / n) / (2 * std)
    return Statistics(
        mean=float(np.mean(values)),
        std=std,
        mean_standard_error=std / np.sqrt(n),
        std_standard_error=float(spread),
        pdf=pdf,
        edges=edges,
        quantiles=np.quantile(values, probabilities),
        probabilities=probabilities,
    )


def _density(values: np.ndarray, bins: int) -> tuple[np.ndarray, np.ndarray]:
    """Return density and edges; a sample without spread gets one bin's width from its own size."""
    lowest, highest = float(values.min()), float(values.max())
    if not highest - lowest > 1e-12 * max(abs(lowest), abs(highest)):
        margin = max(abs(lowest), 1.0) * 1e-6
        lowest, highest = lowest - margin, highest + margin
    return np.histogram(values, bins=bins, range=(lowest, highest), density=True)
