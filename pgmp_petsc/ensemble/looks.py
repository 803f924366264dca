"""Looks at an ensemble that goes on until figures are known well enough, and intervals that hold all the same.

One looks after n, 2 n, 4 n, ... samples, n the same for whoever looks, and stops where the intervals are narrow enough.
Widths are estimates of numbers that fall with the square root of the samples: as the precision that is asked for gets
finer, the stop is more and more surely at the look where the true width first is small enough, or, where the true width
just is what is asked for, at this look or the next (Anscombe, Mathematical Proceedings of the Cambridge Philosophical
Society 48 (1952) 600-607; Chow and Robbins, Annals of Mathematical Statistics 36 (1965) 457-462).

Errors at n and 2 n samples, Z_1 and Z_2 in deviations of their own, are jointly normal with the correlation ``1 /
sqrt(2)``. Widths at n are jointly normal with Z_1 too, in whatever way, and know nothing of the samples after n. One
stops where they all are small enough, a convex set, so that the share s(z) of the ensembles with ``Z_1 = z`` that stop
is log-concave (Prekopa, Acta Scientiarum Mathematicarum 34 (1973) 335-343), a mixture of intervals of z. The interval
at the stop misses with the probability

    P(|Z_2| > z) + E[s(Z_1) (1[|Z_1| > z] - P(|Z_2| > z | Z_1))],

and no interval of Z_1 makes more of that than ``Z_1 > z``: with ``P(|Z| > z) = a`` it is at most

    a + a / 2 - P(Z_1 > z, |Z_2| > z) = alpha,

which gives the level ``1 - a`` of the intervals at every look. The stopped interval holds with a probability between
``1 - alpha`` (the widths are the error itself: those that are off to one side stop, all others go on) and ``1 - a``
(widths and errors have nothing in common): 95 and 96.3 % at 95 %. This goes for every figure of the ensemble, those
that decide or not, and for several rules, which stop at the last one's look.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np

FIRST = 64  # samples at the first look, at least


@cache
def level_of_each(confidence: float) -> float:
    """Return the level of the intervals at every look, so that the one at the stop has `confidence`."""
    from scipy.optimize import brentq
    from scipy.special import ndtr, ndtri

    alpha = 1.0 - confidence
    points, weights = np.polynomial.legendre.leggauss(64)

    def excess(a: float) -> float:
        z = -ndtri(0.5 * a)
        # P(|Z_1| > z, |Z_2| > z): Z_2 = (Z_1 + Z') / sqrt(2), over Z_1 from z to where nothing is left
        x = z + 5.0 * (points + 1.0)
        tails = ndtr(x - np.sqrt(2.0) * z) + ndtr(-x - np.sqrt(2.0) * z)
        both = 2.0 * 5.0 * np.sum(weights * np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi) * tails)
        return 1.5 * a - 0.5 * both - alpha

    return 1.0 - float(brentq(excess, 0.5 * alpha, alpha, xtol=1e-14))


def looks(unit: int, most: int) -> Iterator[int]:
    """Yield the numbers of samples at which one looks.

    Parameters
    ----------
    unit
        Of which all but the last are multiples.
    most
        The last.
    """
    n = unit
    while n < FIRST:
        n *= 2
    while n < most:
        yield n
        n *= 2
    yield most
