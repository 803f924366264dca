"""What the samples that failed do to the figures of an ensemble: how many, why, where, and what holds all the same.

Samples rarely fail at random. Where they fail mostly at large torques, mean, deviation and density of the others are
those of small torques: biased, by an amount that nobody knows. Which parameters tell failed samples from fine ones is
asked by rank statistics, which assume no distribution: the test of Mann and Whitney (1947) for a side, and the same
test on the distance from the median for both ends or the middle.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.runtime.errors import Remark, note, warning

SIGNIFICANT = 0.01  # for all parameters and sides together
NAMED = 3  # parameters, the clearest first


def failure_remarks(
    status: np.ndarray,
    parameters: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    hidden: float = 1.0,
    may_be_retried: bool = True,
) -> tuple[Remark, ...]:
    """Return what is to be said of failed samples; nothing where all are fine.

    Parameters
    ----------
    status
        Shape (N,).
    parameters
        Drawn values by name, each of shape (N,).
    units
        Of the parameters.
    hidden
        Largest share of failed samples that the others are described without.
    may_be_retried
        Whether a further try takes any of them with steps that were not tried.
    """
    failed = status != Status.FINE
    n, n_failed = failed.size, int(failed.sum())
    if not n_failed:
        return ()
    remarks = []
    for code in np.unique(status[failed]):
        reason, count = Status(code), int(np.sum(status == code))
        remarks.append(
            warning(f"{count} of {n} samples failed (status {int(code)}): {reason.meaning}; cure: {reason.cure}")
        )
    if n_failed == n:
        return (*remarks, warning("no sample is fine, so the outputs have no statistics"))
    where = _where(failed, parameters, units)
    if n_failed > hidden * n:
        retry = "--retry-failed with this file tries them with smaller steps"
        cure = retry if may_be_retried else "that of the reason above"
        remarks.append(
            warning(
                f"{n_failed} of {n} samples failed, more than ensemble.failed_share = {hidden:g} of them: outputs have "
                f"no mean, deviation, density, probability, band or index, which would hide that"
                f"{''.join(f'; {words}' for words in where)}. Their quantile_bounds hold, and "
                f"intervals of probabilities. Cure: {cure}; "
                "--override ensemble.failed_share=1.0 describes the others"
            )
        )
        return tuple(remarks)
    bias = (
        f"and are biased: {'; '.join(where)}"
        if where
        else ("and may be biased: no parameter alone tells failed samples from fine ones, which does not rule it out")
    )
    remarks.append(
        warning(
            f"mean, deviation and density of the outputs are those of the {n - n_failed} samples that are fine {bias}; "
            f"no bounds hold for them. Quantiles of all {n} samples lie between their quantile_bounds, "
            f"whatever the failed ones would have been, and intervals of probabilities count these both ways. "
            f"Parameters are described over all {n} samples"
        )
    )
    return tuple(remarks)


def step_remarks(status: np.ndarray, divisors: np.ndarray, step: float) -> tuple[Remark, ...]:
    """Return which samples needed smaller steps (s), and that failed ones were tried with them; shapes (N,)."""
    remarks = []
    saved = (status == Status.FINE) & (divisors > 1)
    if saved.any():
        counts = [f"{int(np.sum(saved & (divisors == d)))} with 1/{d} of it" for d in np.unique(divisors[saved])]
        remarks.append(
            note(
                f"{int(saved.sum())} of {status.size} samples failed with simulation.step = {step:g} s and were "
                f"integrated again with smaller ones: {', '.join(counts)} (/steps_divided); they are fine, but the "
                "step is large for this ensemble"
            )
        )
    given_up = (status != Status.FINE) & (divisors > 1)
    if given_up.any():
        smallest = int(divisors[given_up].max())
        remarks.append(
            note(
                f"{int(given_up.sum())} of the samples that failed were tried with steps down to 1/{smallest} of "
                f"simulation.step = {step:g} s before they were given up (/steps_divided)"
            )
        )
    return tuple(remarks)


def _where(failed: np.ndarray, parameters: Mapping[str, np.ndarray], units: Mapping[str, str]) -> list[str]:
    """Return in words which parameters tell failed samples from fine ones, the clearest first."""
    found = []
    for name, values in parameters.items():
        known = np.isfinite(values)
        lost, fine = values[known & failed], values[known & ~failed]
        if not lost.size or not fine.size or np.ptp(values[known]) == 0.0:
            continue
        unit = "" if units.get(name, "1") == "1" else f" {units[name]}"
        middle = float(np.median(values[known]))
        medians = f"median {np.median(lost):.4g} against {np.median(fine):.4g}{unit}"
        aside = _significance(lost, fine)
        apart = _significance(np.abs(lost - middle), np.abs(fine - middle))
        if aside[0] <= apart[0]:
            found.append((aside[0], f"they fail mostly at {'high' if aside[1] else 'low'} {name} ({medians}, "))
        else:
            place = "at both ends of" if apart[1] else "in the middle of"
            found.append((apart[0], f"they fail mostly {place} {name} ({medians}, "))
    limit = SIGNIFICANT / max(2 * len(parameters), 1)
    clear = sorted(item for item in found if item[0] < limit)
    return [f"{words}p = {p:.1g})" for p, words in clear[:NAMED]]


def _significance(lost: np.ndarray, fine: np.ndarray) -> tuple[float, bool]:
    """Return the probability of such ranks by chance, and whether those of `lost` are the larger ones."""
    from scipy import stats  # a noticeable time, which a run without failures need not wait for

    test = stats.mannwhitneyu(lost, fine, alternative="two-sided")
    return float(test.pvalue), bool(test.statistic > 0.5 * lost.size * fine.size)
