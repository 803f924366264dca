"""Design points: where an event ``g(u) <= 0`` is most likely, of independent standard normal variables u.

The point of ``g(u) = 0`` nearest to the origin (Hasofer and Lind, Journal of the Engineering Mechanics Division 100
(1974) 111-121), found by steps

    u' = (alpha . u + g / |slope|) alpha,    alpha = -slope / |slope|,

each halved while ``|u|^2 / 2 + c |g|`` does not fall (Zhang and Der Kiureghian, Reliability and Optimization of
Structural Systems (1995) 297-305). Of the plane that touches the border there the event has the probability ``Phi(-beta)``
with ``beta = alpha . u``: the first-order reliability method (FORM). Squares of alpha are the shares of the variables.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

LimitState = Callable[[np.ndarray], np.ndarray]
Slopes = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]

MOST_STARTS, MOST_STEPS = 4, 40
USUAL_STEPS = 4  # that searches take from near the border
HALVES = 0.5 ** np.arange(1, 5)  # of a step that leads no nearer
SETTLED = 2e-3  # length of a step that is none: beta is off by its square over 2 beta, and by what g is left
NEARLY_SETTLED = 0.05  # of a step that improves nothing any more
DIFFERENCE = 1e-3  # of a variable, where there are no exact derivatives
LONGEST = 4.0  # step
ALIKE = 0.99  # cosine between design points that are one
FARTHER = 2.0  # than the nearest: a design point of no interest, a thousandth as likely at 3.5


@dataclass(frozen=True, eq=False)
class DesignPoints:
    """Design points, the most likely one first.

    Attributes
    ----------
    points
        u, shape (n_points, d).
    alpha
        Unit vectors along which g falls there, shape (n_points, d).
    n_runs
        Evaluations of g, and of its derivatives, that were taken.
    is_exact
        Whether derivatives are exact, not differences.
    """

    points: np.ndarray
    alpha: np.ndarray
    n_runs: int
    is_exact: bool

    @property
    def beta(self) -> np.ndarray:
        """Distances from the origin, negative where it is in the event, shape (n_points,)."""
        return np.sum(self.points * self.alpha, axis=1)


def cost_of(d: int, slopes: Slopes | None) -> int:
    """Return the evaluations that a search from one start takes as a rule, where the border is nearly plane."""
    return USUAL_STEPS * (1 if slopes is not None else d + 1)


def design_points(evaluate: LimitState, slopes: Slopes | None, starts: np.ndarray, most: int) -> DesignPoints | None:
    """Return the design points that searches from some points lead to; None where none settles.

    Parameters
    ----------
    evaluate
        g of points (n, d), shape (n,); NaN where it is not known.
    slopes
        g and its derivatives of points (n, d), shapes (n,) and (n, d), NaN where there are none; None: from
        differences.
    starts
        Shape (n, d), the best first; there are as many searches as evaluations allow.
    most
        Evaluations at most, of g or of its derivatives.
    """
    d, used = starts.shape[1], 0

    def differences(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        steps = np.concatenate([np.zeros((1, d)), DIFFERENCE * np.eye(d)])
        g = evaluate((u[:, None] + steps).reshape(-1, d)).reshape(len(u), d + 1)
        return g[:, 0], (g[:, 1:] - g[:, :1]) / DIFFERENCE

    gradient, cost = (differences, d + 1) if slopes is None else (slopes, 1)
    u = starts[: min(MOST_STARTS, max(most // (2 * cost_of(d, slopes)), int(most >= cost_of(d, slopes))))]
    if not len(u):
        return None
    found: list[tuple[np.ndarray, np.ndarray]] = []
    g, slope = gradient(u)
    used += cost * len(u)
    for _ in range(MOST_STEPS):
        norm = np.sqrt(np.sum(slope**2, axis=1))
        fine = np.isfinite(g) & np.isfinite(norm) & (norm > 0.0)
        u, g, slope, norm = u[fine], g[fine], slope[fine], norm[fine]
        alpha = -slope / norm[:, None]
        step = (np.sum(alpha * u, axis=1) + g / norm)[:, None] * alpha - u
        length = np.sqrt(np.sum(step**2, axis=1))
        settled = length < SETTLED
        found += list(zip((u + step)[settled], alpha[settled]))
        u, g, norm, step, length, alpha = (part[~settled] for part in (u, g, norm, step, length, alpha))
        if not len(u) or used + cost * len(u) > most:
            break
        step *= np.minimum(1.0, LONGEST / length)[:, None]
        weight = 2.0 * np.sqrt(np.sum((u + step) ** 2, axis=1)) / norm + 1.0 / norm
        merit = _merit(u, g, weight)
        trial = u + step
        g_trial, slope_trial = gradient(trial)
        used += cost * len(u)
        worse = ~(_merit(trial, g_trial, weight) < merit)
        if worse.any():
            n_worse = int(worse.sum())
            if used + (len(HALVES) + cost) * n_worse > most:
                break
            halved = u[worse, None] + HALVES[:, None] * step[worse, None]
            g_halved = evaluate(halved.reshape(-1, d)).reshape(n_worse, -1)
            merits = np.array([_merit(*one) for one in zip(halved, g_halved, weight[worse])])
            best = np.argmin(np.where(np.isnan(merits), np.inf, merits), axis=1)
            trial[worse] = halved[np.arange(n_worse), best]
            g_trial[worse], slope_trial[worse] = gradient(trial[worse])
            lost = np.flatnonzero(worse)[~(merits[np.arange(n_worse), best] < merit[worse])]
            g_trial[lost] = np.nan
            # as near as derivatives from differences lead
            near = lost[length[lost] < NEARLY_SETTLED]
            found += list(zip((u + step)[near], alpha[near]))
            used += (len(HALVES) + cost) * n_worse
        u, g, slope = trial, g_trial, slope_trial
    return _described(found, used, slopes is not None)


def _merit(u: np.ndarray, g: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return 0.5 * np.sum(u**2, axis=-1) + weight * np.abs(g)


def _described(found: list[tuple[np.ndarray, np.ndarray]], used: int, is_exact: bool) -> DesignPoints | None:
    """Return different design points, the nearest first, without those that are much farther."""
    kept: list[tuple[np.ndarray, np.ndarray]] = []
    for point, alpha in sorted(found, key=lambda one: float(np.sum(one[0] ** 2))):
        far = kept and point @ alpha > abs(kept[0][0] @ kept[0][1]) + FARTHER
        if not far and all(alpha @ other < ALIKE for _, other in kept):
            kept.append((point, alpha))
    return DesignPoints(*(np.array(part) for part in zip(*kept)), used, is_exact) if kept else None
