"""Which uncertain parameters matter: Sobol indices of outputs, with intervals.

The first index of a parameter is the share of an output's variance that its value alone explains,
``S1 = Var(E(y | x_i)) / Var(y)``; the total one what is left when all others are known, ``ST = E(Var(y | x_~i)) /
Var(y)`` (Saltelli et al., Computer Physics Communications 181 (2010) 259-270). Two ways lead to them:

- Samples in Saltelli's blocks: the estimators of SALib for both, intervals from resampled blocks.
- Any samples, one parameter after the other: the first index alone, from the means of the output in slices of equal
  probability, less what chance adds to them (Pearson's correlation ratio, adjusted: Kelley, PNAS 21 (1935) 554-559);
  intervals from resampled samples. It ranks parameters at no further cost.

Intervals are ``index +- z std`` over `RESAMPLES` bootstrap resamples, from a stream of their own, so that a repeated
command repeats them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from pgmp_petsc.results.sensitivity import Sensitivity
from pgmp_petsc.runtime.remarks import Remark, note, warning

RESAMPLES = 100
SEED = 20_100_181  # of the resamples, whatever the samples' own
FEWEST_IN_SLICE, MOST_SLICES = 20, 50
FEWEST_SLICES = 4
MOST_GIVEN = 10_000  # samples that the slices are of, the first ones: their intervals are a percent or two wide
FEWEST_BLOCKS = 16


def of_blocks(values: np.ndarray, names: list[str], confidence: float) -> Sensitivity | None:
    """Return the indices of an output whose samples (N,) are Saltelli's blocks.

    Blocks with a sample that failed (NaN) are left out. None where too few are left, or nothing varies.
    """
    from SALib.analyze.sobol import first_order, total_order

    d = len(names)
    blocks = values.reshape(-1, d + 2)
    blocks = blocks[np.isfinite(blocks).all(axis=1)]
    if len(blocks) < FEWEST_BLOCKS or not _varies(blocks):
        return None
    blocks = (blocks - blocks.mean()) / blocks.std()  # the estimators are biased for outputs far from zero
    a, mixed, b = blocks[:, 0], blocks[:, 1:-1], blocks[:, -1]

    def indices(chosen: np.ndarray | slice) -> np.ndarray:
        estimators = (first_order, total_order)
        return np.array([[f(a[chosen], mixed[chosen, k], b[chosen]) for k in range(d)] for f in estimators])

    (first, total), reach = indices(slice(None)), _reach(indices, len(blocks), confidence)
    return Sensitivity(
        tuple(names), "saltelli", len(blocks), confidence,
        first, _ends(first, reach[0]), total, _ends(total, reach[1]),
    )  # fmt: skip


def of_given(values: np.ndarray, parameters: Mapping[str, np.ndarray], confidence: float) -> Sensitivity | None:
    """Return the first indices of an output from any samples (N,), of the first that are fine.

    None where they are too few, or nothing varies.
    """
    chosen = np.flatnonzero(np.isfinite(values))[:MOST_GIVEN]
    n = chosen.size
    n_slices = min(n // FEWEST_IN_SLICE, MOST_SLICES)
    if n_slices < FEWEST_SLICES or not _varies(values[chosen]):
        return None
    output = (values[chosen] - values[chosen].mean()) / values[chosen].std()
    places = [np.argsort(np.argsort(x[chosen], kind="stable")) * n_slices // n for x in parameters.values()]

    def indices(again: np.ndarray | slice) -> np.ndarray:
        return np.array([_correlation_ratio(output[again], place[again], n_slices) for place in places])

    first, reach = indices(slice(None)), _reach(indices, n, confidence)
    return Sensitivity(tuple(parameters), "given data", n, confidence, first, _ends(first, reach))


def _correlation_ratio(values: np.ndarray, places: np.ndarray, n_slices: int) -> float:
    """Return the share of the variance between slices, less what chance adds."""
    counts = np.bincount(places, minlength=n_slices)
    sums = np.bincount(places, weights=values, minlength=n_slices)
    n, used = values.size, int(np.count_nonzero(counts))
    between = np.sum(sums**2 / np.maximum(counts, 1)) - np.sum(values) ** 2 / n
    total = np.sum(values**2) - np.sum(values) ** 2 / n
    return 1.0 - (1.0 - between / total) * (n - 1) / (n - used) if total > 0.0 and n > used else 0.0


def _reach(indices: Callable[[np.ndarray], np.ndarray], n: int, confidence: float) -> np.ndarray:
    """Return half the widths of the intervals, one resample in memory at a time."""
    from scipy.special import ndtri

    random = np.random.default_rng(SEED)
    resampled = np.array([indices(random.integers(n, size=n)) for _ in range(RESAMPLES)])
    return ndtri(0.5 + 0.5 * confidence) * np.std(resampled, axis=0, ddof=1)


def _ends(values: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return intervals (d, 2)."""
    return np.stack([values - reach, values + reach], axis=-1)


def _varies(values: np.ndarray) -> bool:
    return bool(np.ptp(values) > 1e-12 * np.max(np.abs(values)))


def sensitivities(
    quantities: Iterable[tuple[str, np.ndarray]],
    parameters: Mapping[str, np.ndarray],
    names: list[str],
    fine: np.ndarray,
    kind: str,
    confidence: float,
) -> dict[str, Sensitivity]:
    """Return the indices of all quantities that have them.

    Parameters
    ----------
    quantities
        Names and columns (N,); one is in memory at a time.
    parameters, names
        Columns (N,), and which of them are drawn.
    fine
        Which samples are fine, (N,).
    kind
        Of the sampler.
    """
    if kind == "saltelli":
        found = {name: of_blocks(np.where(fine, values, np.nan), names, confidence) for name, values in quantities}
    elif len(names) < 2:
        found = {}
    else:
        n = _needed(fine)
        first = {name: parameters[name][:n].copy() for name in names}
        found = {
            name: of_given(np.where(fine[:n], values[:n], np.nan), first, confidence) for name, values in quantities
        }
    return {name: one for name, one in found.items() if one is not None}


def _needed(fine: np.ndarray) -> int:
    """Return how many samples hold the first `MOST_GIVEN` that are fine."""
    places = np.flatnonzero(fine)
    return int(places[MOST_GIVEN - 1]) + 1 if places.size > MOST_GIVEN else fine.size


def sensitivity_remarks(
    found: Mapping[str, Sensitivity], kind: str, n_parameters: int, fine: np.ndarray, correlated: bool
) -> tuple[Remark, ...]:
    """Return what is to be said of the indices: of what they are, and why there are none."""
    n_fine = int(fine.sum())
    if kind == "saltelli":
        size = n_parameters + 2
        lost = int(np.sum(~fine.reshape(-1, size).all(axis=1)))
        remarks = []
        if lost:
            remarks.append(
                warning(
                    f"Sobol indices are of the {fine.size // size - lost} of {fine.size // size} blocks without a "
                    "failed sample, and are biased where samples do not fail at random"
                )
            )
        if fine.size // size - lost < FEWEST_BLOCKS:
            few = f"{fine.size // size - lost} blocks of samples are too few for Sobol indices"
            remarks.append(note(f"{few}, which take {FEWEST_BLOCKS}; give at least -n {FEWEST_BLOCKS * size}"))
        return tuple(remarks)
    if n_parameters < 2:
        return ()
    fewest = FEWEST_IN_SLICE * FEWEST_SLICES
    if n_fine < fewest:
        return (note(f"{n_fine} samples are too few to rank parameters by first Sobol indices, which takes {fewest}"),)
    if not found:
        return ()
    count = max(one.count for one in found.values())
    text = f"first Sobol indices are estimated from {count} samples in slices of each parameter"
    if correlated:
        return (note(f"{text}; parameters are correlated, so that shares overlap and may sum to more than 1"),)
    return (note(f"{text}; total ones, which know of parameters that act together, take the sampler saltelli"),)
