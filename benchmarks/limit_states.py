"""Limit states whose probabilities are known, for rare events: g(u) <= 0 of independent standard normal variables u.

============================== ====================================================================================
plane                          ``b - sum(u) / sqrt(d)``
two sides                      ``b - |u_1|``
series of four                 ``b - max(u_1, .., u_4)``: four parts, with probabilities of their own
ball                           ``b - |u|``: all around (Katafygiotis and Zuev, Probabilistic Engineering Mechanics 23
                               (2008) 208-218)
four branches                  ``min(b + (u_1 - u_2)^2 / 10 -+ (u_1 + u_2) / sqrt(2), +-(u_1 - u_2) + c)``, with
                               ``c = 7 b / (3 sqrt(2))``, which is 7 / sqrt(2) at the b = 3 of Waarts (Structural
                               reliability using finite element methods, Delft 2000)
paraboloid                     ``b - u_1 + bend / 2 (u_2^2 + .. + u_d^2)``
sides of two                   ``min(b - u_1, 1.05 b + u_2)``: two parts that are not as likely
box                            ``b - max(|u_1|, .., |u_d|)``: two parts a variable
wedge                          ``b - min(u_1, u_2)``: both have to fail
sum of exponentials            ``b + ln Phi(-u_1) + .. + ln Phi(-u_d)``: curved (Rackwitz, Structural Safety 23 (2001)
                               365-395)
indicator                      of a plane, -1 or 1
============================== ====================================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import exp, pi, sqrt

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import gamma as gamma_function
from scipy.special import log_ndtr, ndtr
from scipy.stats import chi2, gamma, norm

LimitState = Callable[[np.ndarray], np.ndarray]
BENDS = ((6, 0.2), (12, 0.1), (6, -0.1))


def limit_states(probability: float) -> Iterator[tuple[str, int, LimitState]]:
    """Yield limit states of a probability: a name, the number of variables, and g."""
    for d in (1, 2, 6, 12, 20):
        yield "plane", d, lambda u, b=norm.isf(probability), d=d: b - u.sum(axis=1) / np.sqrt(d)
    for d in (2, 6, 20):
        yield "two sides", d, lambda u, b=norm.isf(0.5 * probability): b - np.abs(u[:, 0])
    of_each = -np.expm1(0.25 * np.log1p(-probability))
    for d in (4, 10):
        yield "series of four", d, lambda u, b=norm.isf(of_each): b - u[:, :4].max(axis=1)
    for d in (2, 6, 20):
        yield "ball", d, lambda u, b=np.sqrt(chi2.isf(probability, d)): b - np.sqrt(np.sum(u**2, axis=1))
    b = _distance(_of_branches, probability)
    yield "four branches", 2, lambda u, b=b: _branches(u, b)
    for d, bend in BENDS:
        b = _distance(lambda b, d=d, bend=bend: _of_paraboloid(b, d, bend), probability)
        name = f"paraboloid, bend {bend:g}"
        yield name, d, lambda u, b=b, bend=bend: b - u[:, 0] + 0.5 * bend * np.sum(u[:, 1:] ** 2, axis=1)
    b = _distance(lambda b: norm.sf(b) + norm.cdf(b) * norm.sf(1.05 * b), probability)
    yield "sides of two", 20, lambda u, b=b: np.minimum(b - u[:, 0], 1.05 * b + u[:, 1])
    for d in (4, 10):
        of_each = -np.expm1(np.log1p(-probability) / d)
        yield "box", d, lambda u, b=norm.isf(0.5 * of_each): b - np.abs(u).max(axis=1)
    yield "wedge", 6, lambda u, b=norm.isf(np.sqrt(probability)): b - u[:, :2].min(axis=1)
    for d in (5, 20):
        yield "sum of exponentials", d, lambda u, b=gamma.isf(probability, d): b + log_ndtr(-u).sum(axis=1)
    for d in (10, 50):
        b = norm.isf(probability) * np.sqrt(d)
        yield "indicator", d, lambda u, b=b: np.where(u.sum(axis=1) >= b, -1.0, 1.0)


def _distance(of_distance: Callable[[float], float], probability: float) -> float:
    """Return the distance b at which a limit state has a probability."""
    return brentq(lambda b: np.log(of_distance(b) / probability), 1.0, 9.0)


def _branches(u: np.ndarray, b: float) -> np.ndarray:
    along, across = (u[:, 0] + u[:, 1]) / np.sqrt(2.0), u[:, 0] - u[:, 1]
    return np.minimum(b + 0.1 * across**2 - np.abs(along), 7.0 * b / (3.0 * np.sqrt(2.0)) - np.abs(across))


def _of_branches(b: float) -> float:
    """Return the probability of four branches: with ``t = (u_1 - u_2) / sqrt(2)`` beyond the straight ones, or not."""
    straight = 7.0 * b / 6.0
    bent = quad(lambda t: exp(-0.5 * t**2) * ndtr(-b - 0.2 * t**2), -straight, straight, epsrel=1e-10)[0]
    bent *= sqrt(2.0 / pi)
    return 2.0 * norm.sf(straight) + bent


def _of_paraboloid(b: float, d: int, bend: float) -> float:
    """Return the probability of a paraboloid, over the chi-squared law of the sum of squares."""

    def density(s: float) -> float:
        return ndtr(-b - 0.5 * bend * s) * s ** (half - 1.0) * exp(-0.5 * s)

    half = 0.5 * (d - 1)
    return quad(density, 0.0, 120.0, points=[1, 5, 20], limit=200)[0] / (2.0**half * gamma_function(half))
