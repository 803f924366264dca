"""Confidence intervals of the figures of an ensemble: between which the true ones lie, with a given probability.

docs/uncertainty.md (intervals) says which, and how often they hold: Student's t; Bonett, Computational Statistics &
Data Analysis 50 (2006) 775-782, with the sample's own fourth moment about a trimmed mean (`freedom_of`); Hutson,
Journal of Applied Statistics 26 (1999) 343-353: the r-th of n values has a share below it that follows Beta(r, n + 1 -
r); Clopper and Pearson, Biometrika 26 (1934) 404-413. Of a share that is a part of another figure they are Jeffreys'
(Brown, Cai and DasGupta, Statistical Science 16 (2001) 101-133), from 0 and 1 no farther than it has to be; quantiles
and probabilities of replicates take as many independent samples as would spread as these do (`equivalent_size`).

They know of the error of sampling alone, not of that of the model; samples that failed have a part in those of
probabilities only. What too few values leave open is infinite, or NaN where nothing at all is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import scipy

UNKNOWN = np.full(2, np.nan)


def of_mean(values: np.ndarray, confidence: float) -> np.ndarray:
    """Return the interval (low, high) of the mean of independent values (n,); NaN of less than two."""
    if values.size < 2:
        return UNKNOWN
    reach = _student(confidence, values.size - 1) * np.std(values, ddof=1) / np.sqrt(values.size)
    return np.mean(values) + np.array([-reach, reach])


def of_deviation(values: np.ndarray, confidence: float) -> np.ndarray:
    """Return the interval (low, high) of the standard deviation of independent values (n,); NaN of less than five.

    ``c s^2 exp(-+ t c sqrt((g - (n - 3) / n) / (n - 1)))``, ``c = n / (n - z)``, with the kurtosis g about the mean
    without the ``1 / (2 sqrt(n - 4))`` outermost share of the values at either end, z the normal quantile and t
    Student's, of the freedom that the variance of squares about that mean has.
    """
    n = values.size
    if n < 5:
        return UNKNOWN
    variance = np.var(values, ddof=1)
    if not variance > (1e-12 * np.max(np.abs(values))) ** 2:  # round-off of equal values
        return np.full(2, np.sqrt(variance))
    # in place: of a million samples every copy would be a thirtieth of the memory of a rank
    scaled = values - np.mean(values)
    scaled /= np.sqrt(variance)
    scaled.sort()
    second = np.einsum("i,i->", scaled, scaled)
    z = scipy.special.ndtri(0.5 + 0.5 * confidence)
    correction = n / (n - z) if n > z else np.inf
    # as scipy.stats.trim_mean, whose import takes a quarter of a second of every ensemble
    cut = int(n * min(0.5 / np.sqrt(n - 4), 0.5 - 0.5 / n))
    scaled -= np.mean(scaled[cut : n - cut])
    scaled *= scaled
    kurtosis = n * np.einsum("i,i->", scaled, scaled) / second**2
    student = _student(confidence, freedom_of(scaled, n - 1))
    spread = student * correction * np.sqrt(max(kurtosis - (n - 3) / n, 0.0) / (n - 1))
    return np.sqrt(correction * variance * np.exp([-spread, spread]))


def of_mean_and_deviations(values: np.ndarray, times: float, confidence: float) -> np.ndarray:
    """Return the interval (low, high) of the mean of independent values (n,) and so many of their deviations together.

    Both intervals are put together by squares, with the correlation of the two estimates, ``mu_3 / (s sqrt(mu_4 -
    s^4))`` (MOVER: Zou and Donner, Statistics in Medicine 27 (2008) 1693-1702). NaN of less than five values.
    """
    mean, deviation = np.mean(values), np.std(values, ddof=1) if values.size > 1 else np.nan
    ends = np.array([of_mean(values, confidence) - mean, times * (of_deviation(values, confidence) - deviation)])
    scaled = (values - mean) / deviation if deviation > 0.0 else np.zeros(values.size)
    spread = np.mean(scaled**4) - 1.0
    correlation = np.clip(np.mean(scaled**3) / np.sqrt(spread), -1.0, 1.0) if spread > 0.0 else 0.0
    squares = np.sum(ends**2, axis=0) + 2.0 * correlation * ends[0] * ends[1]
    return mean + times * deviation + np.array([-1.0, 1.0]) * np.sqrt(np.maximum(squares, 0.0))


def of_quantiles(
    ordered: np.ndarray, probabilities: np.ndarray, confidence: float, sizes: np.ndarray | None = None
) -> np.ndarray:
    """Return the intervals of quantiles of values (n,), sorted; shape (n_quantiles, 2).

    An end is infinite where not even the smallest, or largest, value lies beyond the quantile with enough probability.
    `sizes`, (n_quantiles,), say how many independent values are as good at each quantile (Woodruff, Journal of the
    American Statistical Association 47 (1952) 635-646); None of independent ones: n.
    """
    n, tail = ordered.size, 0.5 * (1.0 - confidence)
    found = np.full((len(probabilities), 2), [-np.inf, np.inf])
    for row, probability, size in zip(found, probabilities, np.full(len(found), float(n)) if sizes is None else sizes):
        for end, beyond in enumerate((1.0 - tail, tail)):
            rank = _rank(float(size), float(probability), beyond)
            rank = None if rank is None else rank * (n + 1.0) / (size + 1.0)
            if rank is not None and 1.0 <= rank <= n:
                below = min(int(rank), n - 1)  # ranks are from 1; between neighbours values are interpolated
                share = rank - below
                row[end] = (1.0 - share) * ordered[below - 1] + share * ordered[below]
    return found


@lru_cache(maxsize=4096)
def _rank(n: float, probability: float, beyond: float) -> float | None:
    """Return the rank r, 1 to n and no whole number, whose share below exceeds `probability` with chance 1 - `beyond`.

    None where there is none.
    """

    def excess(rank: float) -> float:
        return scipy.special.betainc(rank, n + 1.0 - rank, probability) - beyond

    if n < 2 or excess(1.0) < 0.0 or excess(float(n)) > 0.0:
        return None
    # bisection is quick enough; scipy.optimize takes a twentieth of the start of an ensemble
    low, high = 1.0, float(n)
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if excess(middle) > 0.0 else (low, middle)
    return middle


def of_probability(
    count: np.ndarray | int, n: np.ndarray | int, confidence: float, n_failed: np.ndarray | int = 0
) -> np.ndarray:
    """Return the interval (low, high) of a probability of which `count` of `n` trials came true.

    They are numbers of independent trials; or of those of each independent replicate, (n_replicates,). Of `n_failed`
    further trials it is not known: none of them came true at the lower end, all at the upper one. As
    `scipy.stats.binomtest`, but for numbers that need not be whole (Korn and Graubard, Survey Methodology 24 (1998)
    193-201).
    """
    count, failed = np.atleast_1d(count).astype(float), np.atleast_1d(n_failed).astype(float)
    sizes = np.atleast_1d(n) + failed
    if not sizes.sum() > 0.0:
        return UNKNOWN
    tail, ends = 0.5 * (1.0 - confidence), (count, count + failed)
    n_low, n_high = (equivalent_size(true, sizes, confidence) for true in ends)
    low, high = (n * float(true.sum() / sizes.sum()) for n, true in zip((n_low, n_high), ends))
    low = scipy.special.betaincinv(low, n_low - low + 1.0, tail) if low > 0.0 else 0.0
    return np.array([low, scipy.special.betaincinv(high + 1.0, n_high - high, 1.0 - tail) if high < n_high else 1.0])


def equivalent_size(count: np.ndarray, sizes: np.ndarray, confidence: float) -> float:
    """Return how many independent trials tell as much of a probability as those of replicates do, of whose `sizes` so
    many came true, each (n_replicates,).

    ``n = p (1 - p) / v (z / t)^2``, v the variance of the share p between replicates, t Student's quantile of their
    freedom and z the normal one. Where replicates agree their counts may still differ by one, with a chance that as
    many replicates as there are would not have shown: v is no smaller than that leaves open. All trials where none or
    all came true, and of one replicate.
    """
    n, n_replicates, share = float(sizes.sum()), count.size, float(count.sum() / sizes.sum())
    if n_replicates < 2 or not 0.0 < share < 1.0:
        return n
    tail, student = 0.5 * (1.0 - confidence), _student(confidence, n_replicates - 1)
    ratio = scipy.special.ndtri(1.0 - tail) / student
    unseen = n_replicates * -np.expm1(np.log(tail) / n_replicates) / student
    spread = n_replicates / (n_replicates - 1.0) * np.sum((count - share * sizes) ** 2)
    return float(n**2 * share * (1.0 - share) / max(spread, unseen**2) * ratio**2)


def of_share(count: int, n: int, confidence: float) -> np.ndarray:
    """Return Jeffreys' interval (low, high) of a share of which `count` of `n` independent trials came true.

    Where none came true it is from 0 to ``1 - (1 - confidence)^(1 / n)``, as all of the probability is on one side (the
    rule of three: Hanley and Lippman-Hand, JAMA 249 (1983) 1743-1745), and of all likewise. 0 and 1 of no trials.
    """
    if n < 1:
        return np.array([0.0, 1.0])
    of_none = -np.expm1(np.log1p(-confidence) / n)
    if count in (0, n):
        return np.array([0.0, of_none]) if count == 0 else np.array([1.0 - of_none, 1.0])
    tail = 0.5 * (1.0 - confidence)
    return scipy.special.betaincinv(count + 0.5, n - count + 0.5, [tail, 1.0 - tail])


def of_replicates(
    centre: np.ndarray | float, figures: np.ndarray, confidence: float, freedom: float | None = None
) -> np.ndarray:
    """Return the interval about figures (...) of all samples, from those of independent replicates (n_replicates, ...).

    Shape (..., 2); NaN of less than two replicates, or where one has no such figure. `freedom` is that of the spread
    between replicates, where it is not that of normal figures.
    """
    n = len(figures)
    if n < 2:
        return np.full((*np.shape(centre), 2), np.nan)
    student = _student(confidence, n - 1 if freedom is None else freedom)
    reach = student * np.std(figures, axis=0, ddof=1) / np.sqrt(n)
    return np.asarray(centre)[..., None] + np.asarray(reach)[..., None] * np.array([-1.0, 1.0])


def of_weighted(rounds: Sequence[np.ndarray], confidence: float) -> np.ndarray:
    """Return the interval (low, high) of a mean of weights (n,) in independent rounds, of its logarithm.

    Student's t has the freedom of as many samples as the weighted ones are worth, or that their kurtosis leaves their
    variance: a few large weights decide on it. NaN where all are zero.
    """
    every = np.concatenate(rounds)
    if not every.any():
        return UNKNOWN
    worth = every.sum() ** 2 / np.sum(every**2)
    freedom = freedom_of(np.concatenate([one - one.mean() for one in rounds]), worth - 1.0)
    reach = np.sqrt(np.log1p(variation_of(rounds) ** 2)) * _student(confidence, max(freedom, 1.0))
    return np.minimum(every.mean() * np.exp([-reach, reach]), 1.0)


def variation_of(rounds: Sequence[np.ndarray]) -> float:
    """Return the coefficient of variation of a mean of weights (n,) in independent rounds; NaN where all are zero."""
    total = sum(float(one.sum()) for one in rounds)
    return float(np.sqrt(sum(one.size * one.var(ddof=1) for one in rounds)) / total) if total > 0.0 else np.nan


def freedom_of(values: np.ndarray, most: float) -> float:
    """Return the degrees of freedom of the sample variance of independent values (n,), `most` of normal ones.

    A variance of n values with the kurtosis k is off by ``sqrt((k - 1) / n)`` of itself, as chi-squared of ``2 n / (k -
    1)`` degrees (Box, Biometrika 40 (1953) 318-335): n of normal values, few where one value decides.
    """
    squares = values - np.mean(values)
    squares *= squares
    total = np.sum(squares)
    if not total > 0.0:
        return float(most)
    squares /= total
    excess = values.size * np.einsum("i,i->", squares, squares) - 1.0
    return float(min(most, 2.0 * values.size / excess)) if excess > 0.0 else float(most)


def _student(confidence: float, freedom: float) -> float:
    """Return between which +- a variable of Student's distribution lies with probability `confidence`."""
    return float(scipy.special.stdtrit(freedom, 0.5 + 0.5 * confidence))
