"""Design points: where an event ``g(u) <= 0`` is most likely, of independent standard normal variables u.

The point of ``g(u) = 0`` nearest to the origin (Hasofer and Lind, Journal of the Engineering Mechanics Division 100
(1974) 111-121), found by steps

    u' = (alpha . u + g / |slope|) alpha,    alpha = -slope / |slope|,

each halved where it turns back by the one before it, which on a border of curvature k it does by ``k beta`` of it, and
while ``|u|^2 / 2 + c |g|`` does not fall (Zhang and Der Kiureghian, Reliability and Optimization of Structural Systems
(1995) 297-305). Of the plane that touches the border there the event has the probability ``Phi(-beta)``
with ``beta = alpha . u``: the first-order reliability method (FORM). Squares of alpha are the shares of the variables.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

LimitState = Callable[[np.ndarray], np.ndarray]
Slopes = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]

AT_ONCE, MOST_STEPS = 4, 40  # searches
IN_VAIN = 2  # times so many searches that may find nothing new
USUAL_STEPS = 4  # that searches take from near the border
HALVES = 0.5 ** np.arange(1, 5)  # of a step that leads no nearer
SETTLED = 2e-3  # length of a step that is none: beta is off by its square over 2 beta, and by what g is left
NEARLY_SETTLED = 0.05  # of a step that improves nothing any more
DIFFERENCE = 1e-3  # of a variable, where there are no exact derivatives
LONGEST, LEAST_PART = 4.0, 0.125  # step, and share of one
ALIKE = 0.99  # cosine between design points that are one
NEAR_PLANE = 0.2  # of a start from a plane on which it lies: rays are followed to a sixth
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

    A few searches at a time, until several have found nothing new. A start that lies on one of the planes that touch
    the border at design points needs none.

    Parameters
    ----------
    evaluate
        g of points (n, d), shape (n,); NaN where it is not known.
    slopes
        g and its derivatives of points (n, d), shapes (n,) and (n, d), NaN where there are none; None: from
        differences.
    starts
        Shape (n, d), near the border, the best first; there are as many searches as evaluations allow.
    most
        Evaluations at most, of g or of its derivatives.
    """
    d, used, found, in_vain = starts.shape[1], 0, [], 0
    cost = cost_of(d, slopes)
    while len(starts) and in_vain < IN_VAIN and most - used >= cost:
        n_at_once = min(AT_ONCE, max((most - used) // (2 * cost), 1))
        known = len(found)
        settled, of_search = _search(evaluate, slopes, starts[:n_at_once], most - used)
        found, used, starts = _different(found + settled), used + of_search, starts[n_at_once:]
        in_vain = 0 if len(found) > known else in_vain + 1
        for point, alpha in found:
            on_plane = np.abs(starts @ alpha - point @ alpha) < NEAR_PLANE
            starts = starts[~on_plane]
    if not found:
        return None
    return DesignPoints(*(np.array(part) for part in zip(*found)), used, slopes is not None)


def _search(
    evaluate: LimitState, slopes: Slopes | None, u: np.ndarray, most: int
) -> tuple[list[tuple[np.ndarray, np.ndarray]], int]:
    """Return the points, each with its alpha, at which searches from u (n, d) settle, and how many evaluations."""
    d, used = u.shape[1], 0

    def differences(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        steps = np.concatenate([np.zeros((1, d)), DIFFERENCE * np.eye(d)])
        g = evaluate((u[:, None] + steps).reshape(-1, d)).reshape(len(u), d + 1)
        return g[:, 0], (g[:, 1:] - g[:, :1]) / DIFFERENCE

    gradient, cost = (differences, d + 1) if slopes is None else (slopes, 1)
    found: list[tuple[np.ndarray, np.ndarray]] = []
    g, slope = gradient(u)
    used += cost * len(u)
    before, part = np.zeros(u.shape), np.ones(len(u))  # the last step, and how much of one is taken
    for _ in range(MOST_STEPS):
        norm = np.sqrt(np.sum(slope**2, axis=1))
        fine = np.isfinite(g) & np.isfinite(norm) & (norm > 0.0)
        u, g, slope, norm, before, part = (of_all[fine] for of_all in (u, g, slope, norm, before, part))
        alpha = -slope / norm[:, None]
        step = (np.sum(alpha * u, axis=1) + g / norm)[:, None] * alpha - u
        length = np.sqrt(np.sum(step**2, axis=1))
        settled = length < SETTLED
        found += list(zip((u + step)[settled], alpha[settled]))
        u, g, norm, step, length, alpha, before, part = (
            of_all[~settled] for of_all in (u, g, norm, step, length, alpha, before, part)
        )
        if not len(u) or used + cost * len(u) > most:
            break
        turns = np.sum(step * before, axis=1)
        part = np.clip(part * np.where(turns < 0.0, 0.5, np.where(turns > 0.0, 2.0, 1.0)), LEAST_PART, 1.0)
        before = step
        step = step * (part * np.minimum(1.0, LONGEST / length))[:, None]
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
    return found, used


def _merit(u: np.ndarray, g: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return 0.5 * np.sum(u**2, axis=-1) + weight * np.abs(g)


def _different(found: list[tuple[np.ndarray, np.ndarray]]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return different design points, the nearest first, without those that are much farther."""
    kept: list[tuple[np.ndarray, np.ndarray]] = []
    for point, alpha in sorted(found, key=lambda one: float(np.sum(one[0] ** 2))):
        far = kept and point @ alpha > abs(kept[0][0] @ kept[0][1]) + FARTHER
        if not far and all(alpha @ other < ALIKE for _, other in kept):
            kept.append((point, alpha))
    return kept
