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
IN_VAIN = 2  # times so many searches that may find nothing new; once from points that are not near the border
OF_BATCH = 0.25  # of all evaluations, which searches at once from such points may take
USUAL_STEPS = 4  # that searches take from near the border
HALVES = 0.5 ** np.arange(1, 5)  # of a step that leads no nearer
SETTLED = 2e-3  # length of a step that is none: beta is off by its square over 2 beta, and by what g is left
NEARLY_SETTLED = 0.05  # of a step that improves nothing any more
DIFFERENCE = 1e-3  # of a variable, where there are no exact derivatives
LONGEST, LEAST_PART = 4.0, 0.125  # step, and share of one
ALIKE = 0.99  # cosine between design points that are one
NEAR_PLANE = 0.2  # of a start from a plane on which it lies: rays are followed to a sixth
FARTHER = 2.0  # than the nearest: a design point of no interest, a thousandth as likely at 3.5
EXPLAINED = 0.3  # of the points of an event that lie beyond planes which evaluations can lead to, at least
BEYOND_PLANES = 0.25  # of an event's points, fewer of which lie beyond planes where its border bends
WIDE = 1.0  # distance to the points of a border between which a plane is laid, and in which it is searched for
BISECTED, FINELY = 6, 12  # steps of a bisection, of borders near one that is known, and of others
ON_BORDER = 0.15  # distance between a plane's nearest point and the border


@dataclass(frozen=True, eq=False)
class DesignPoints:
    """Design points, the most likely one first."""

    points: np.ndarray  # u, shape (n_points, d)
    alpha: np.ndarray  # unit vectors along which g falls there, shape (n_points, d)
    n_runs: int  # evaluations of g, and of its derivatives, that were taken
    is_exact: bool  # whether derivatives are exact, not differences
    is_open: bool = False  # whether the last searches still found new ones when evaluations ended

    @property
    def beta(self) -> np.ndarray:
        """Distances from the origin, negative where it is in the event, shape (n_points,)."""
        return np.sum(self.points * self.alpha, axis=1)


class _Tangents:
    """Planes that touch g where its derivatives were taken, as ``g(u) = of + slope . u``."""

    def __init__(self, d: int) -> None:
        self._of, self._slopes = np.zeros(0), np.zeros((0, d))

    def add(self, u: np.ndarray, g: np.ndarray, slope: np.ndarray) -> None:
        """Add those at points (n, d) that have derivatives."""
        known = np.isfinite(g) & np.all(np.isfinite(slope), axis=1) & np.any(slope != 0.0, axis=1)
        u, g, slope = u[known], g[known], slope[known]
        self._of = np.concatenate([self._of, g - np.sum(slope * u, axis=1)])
        self._slopes = np.concatenate([self._slopes, slope])

    def beyond(self, u: np.ndarray, g: np.ndarray) -> np.ndarray:
        """Return how far g at points (n, d), or 0 where it is less, is below all planes, shape (n,); negative where one
        explains it."""
        near = self._of - NEAR_PLANE * np.sqrt(np.sum(self._slopes**2, axis=1))
        least = np.min(np.einsum("nd,md->nm", u, self._slopes) + near, axis=1, initial=np.inf)
        return least - np.maximum(g, 0.0)


def design_points(
    evaluate: LimitState,
    slopes: Slopes | None,
    starts: np.ndarray,
    most: int,
    others: tuple[np.ndarray, np.ndarray] | None = None,
) -> DesignPoints | None:
    """Return the design points that searches from some points lead to; None where none settles.

    `evaluate` gives g of points (n, d), shape (n,), NaN where it is not known, `slopes` g and its derivatives, shapes
    (n,) and (n, d), NaN where there are none; without it they are from differences. `most` evaluations of either are
    made.

    A few searches at a time, until several have found nothing new, begin from `starts`, shape (n, d), near the border,
    the best first. Where a point is explained by a plane that touches g at a point of a search before, none begins.
    Those that are explained least come first. After them searches begin from `others`, points (m, d) from anywhere with
    their g (m,); but where few of them that are in the event lie beyond planes at the design points that starts lead
    to, as the border bends or the event is all around, none does.
    """
    d, used, found, in_vain, is_bent = starts.shape[1], 0, [], 0, False
    tangents = _Tangents(d)
    cost = USUAL_STEPS * (1 if slopes is not None else d + 1)  # of a search as a rule, where the border is nearly plane
    points, g = (np.zeros((0, d)), np.zeros(0)) if others is None else others
    points, g = points[np.isfinite(g)], g[np.isfinite(g)]
    inside = points[g <= 0.0]
    while in_vain < IN_VAIN:
        if found:
            starts = starts[tangents.beyond(starts, np.zeros(len(starts))) > 0.0]
            explained = np.any([inside @ alpha >= u @ alpha for u, alpha in found], axis=0)
            is_bent = bool(not len(starts) and len(inside) and np.mean(explained) < BEYOND_PLANES)
            if is_bent:
                break
            if not len(starts):
                beyond = tangents.beyond(points, g)
                points, g, beyond = (of_all[beyond > 0.0] for of_all in (points, g, beyond))
        at_most = most - used if len(starts) else min(most - used, max(int(OF_BATCH * most), cost))
        n_at_once, is_other = min(AT_ONCE, max(at_most // (2 * cost), 1)), not len(starts)
        chosen, starts = starts[:n_at_once], starts[n_at_once:]
        if found and not len(chosen):
            order = np.argsort(-beyond, kind="stable")
            chosen, rest = points[order[:n_at_once]], order[n_at_once:]
            points, g = points[rest], g[rest]
        if not len(chosen) or most - used < cost:
            break
        known = len(found)
        searches = _Searches(evaluate, slopes, tangents)
        found = _different(found + searches.settled(chosen, at_most))
        used += searches.used
        in_vain = 0 if len(found) > known else in_vain + (IN_VAIN if is_other else 1)
    if not found:
        return None
    is_open = is_bent or (in_vain == 0 and bool(len(chosen)))
    return DesignPoints(*(np.array(part) for part in zip(*found)), used, slopes is not None, is_open)


@dataclass(eq=False)
class _Searches:
    """Searches for design points side by side."""

    evaluate: LimitState
    slopes: Slopes | None
    tangents: _Tangents
    used: int = 0  # evaluations

    def gradient(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return g and its derivatives at points (n, d), from differences where there are no exact ones."""
        n, d = u.shape
        self.used += self.cost(d) * n
        if self.slopes is not None:
            g, slope = self.slopes(u)
        else:
            steps = np.concatenate([np.zeros((1, d)), DIFFERENCE * np.eye(d)])
            of_all = self.evaluate((u[:, None] + steps).reshape(-1, d)).reshape(n, d + 1)
            g, slope = of_all[:, 0], (of_all[:, 1:] - of_all[:, :1]) / DIFFERENCE
        self.tangents.add(u, g, slope)
        return g, slope

    def cost(self, d: int) -> int:
        """Return how many evaluations a gradient takes."""
        return d + 1 if self.slopes is None else 1

    def settled(self, u: np.ndarray, most: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the points, each with its alpha, at which searches from u (n, d) settle, at most so many evaluations.

        Of starts that lie on the tangent of another one, that one is followed.
        """
        found: list[tuple[np.ndarray, np.ndarray]] = []
        cost = self.cost(u.shape[1])
        g, slope = self.gradient(u)
        before, part = np.zeros(u.shape), np.ones(len(u))  # the last step, and how much of one is taken
        for _ in range(MOST_STEPS):
            norm = np.sqrt(np.sum(slope**2, axis=1))
            fine = np.isfinite(g) & np.isfinite(norm) & (norm > 0.0)
            fine &= [not _explained(u, g, slope, k) for k in range(len(u))]
            u, g, slope, norm, before, part = (of_all[fine] for of_all in (u, g, slope, norm, before, part))
            alpha = -slope / norm[:, None]
            step = (np.sum(alpha * u, axis=1) + g / norm)[:, None] * alpha - u
            length = np.sqrt(np.sum(step**2, axis=1))
            ends = length < SETTLED
            found += list(zip((u + step)[ends], alpha[ends]))
            u, g, norm, step, length, alpha, before, part = (
                of_all[~ends] for of_all in (u, g, norm, step, length, alpha, before, part)
            )
            if not len(u) or self.used + cost * len(u) > most:
                break
            turns = np.sum(step * before, axis=1)
            part = np.clip(part * np.where(turns < 0.0, 0.5, np.where(turns > 0.0, 2.0, 1.0)), LEAST_PART, 1.0)
            before = step
            step = step * (part * np.minimum(1.0, LONGEST / length))[:, None]
            weight = 2.0 * np.sqrt(np.sum((u + step) ** 2, axis=1)) / norm + 1.0 / norm
            merit = _merit(u, g, weight)
            trial = u + step
            g_trial, slope = self.gradient(trial)
            worse = np.flatnonzero(~(_merit(trial, g_trial, weight) < merit))
            if worse.size:
                if self.used + (len(HALVES) + cost) * worse.size > most:
                    break
                trial[worse], merits = self._shortened(u[worse], step[worse], weight[worse])
                g_trial[worse], slope[worse] = self.gradient(trial[worse])
                lost = worse[~(merits < merit[worse])]
                g_trial[lost] = np.nan
                # as near as derivatives from differences lead
                near = lost[length[lost] < NEARLY_SETTLED]
                found += list(zip((u + step)[near], alpha[near]))
            u, g = trial, g_trial
        return found

    def _shortened(self, u: np.ndarray, step: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the best of the points (n, d) to which parts of steps lead, and its merit, NaN where none has one."""
        n, d = u.shape
        halved = u[:, None] + HALVES[:, None] * step[:, None]
        g = self.evaluate(halved.reshape(-1, d)).reshape(n, -1)
        self.used += len(HALVES) * n
        merits = np.array([_merit(*one) for one in zip(halved, g, weight)])
        best = np.arange(n), np.argmin(np.where(np.isnan(merits), np.inf, merits), axis=1)
        return halved[best], merits[best]


def _explained(u: np.ndarray, g: np.ndarray, slope: np.ndarray, k: int) -> bool:
    """Return whether the k-th of points (n, d) lies on the plane that touches g at one before it, and the reverse."""
    steps, size = u[k] - u[:k], np.sqrt(np.sum(slope[: k + 1] ** 2, axis=1))
    of_before = np.abs(g[:k] + np.sum(slope[:k] * steps, axis=1) - g[k]) < NEAR_PLANE * size[:k]
    of_this = np.abs(g[k] - steps @ slope[k] - g[:k]) < NEAR_PLANE * size[k]
    return bool(np.any(of_before & of_this))


def bisected_design_points(inside: LimitState, starts: np.ndarray, most: int) -> DesignPoints | None:
    """Return the design points of an event of which only points tell whether they are in it; None where there are none.

    On the ray from the origin through a point of the event bisection finds the border; so it does on rays through
    points at the distance `WIDE` from there along each variable. The plane through those borders (least squares) has a
    nearest point, whose ray is the next one: it is a design point where the border is on it, too. An error of ``WIDE /
    2^BISECTED`` of every border turns the plane by a few hundredths.

    `inside` says of points (n, d), shape (n,), whether they are in the event; `starts`, shape (n, d), are, the best
    first. At `most` so many evaluations are made.
    """
    d, used, found, in_vain = starts.shape[1], 0, [], 0
    each, n_starts = d * BISECTED + 2 * FINELY, len(starts)

    def border(units: np.ndarray, low: np.ndarray, high: np.ndarray, steps: int) -> np.ndarray:
        """Return the distances at which rays, each (n,), enter the event between two others."""
        for _ in range(steps):
            middle = 0.5 * (low + high)
            within = inside(middle[:, None] * units)
            low, high = np.where(within, low, middle), np.where(within, middle, high)
        return 0.5 * (low + high)

    while len(starts) and in_vain < 2 * IN_VAIN and most - used >= each:
        unit, reach, starts = starts[0] / np.sqrt(starts[0] @ starts[0]), np.sqrt(starts[0] @ starts[0]), starts[1:]
        radius = border(unit[None], np.zeros(1), np.array([reach]), FINELY)[0]
        used, new = used + FINELY, None
        while new is None and most - used >= each:
            near = radius * unit + WIDE * np.eye(d)
            sizes = np.sqrt(np.sum(near**2, axis=1))
            rays = near / sizes[:, None]
            on = np.concatenate([[radius], border(rays, sizes - 2.0 * WIDE, sizes + 2.0 * WIDE, BISECTED)])
            points = on[:, None] * np.concatenate([unit[None], rays])
            plane = np.linalg.lstsq(points, np.ones(d + 1), rcond=None)[0]
            beta = 1.0 / np.sqrt(plane @ plane)
            before, unit = radius, beta * plane
            radius = border(unit[None], np.array([0.5 * beta]), np.array([1.5 * beta]), FINELY)[0]
            used += d * BISECTED + FINELY
            if abs(radius - beta) < ON_BORDER:
                new = radius * unit, unit
            elif not radius < before:
                break
        known = len(found)
        found = _different(found + ([] if new is None else [new]))
        in_vain = 0 if len(found) > known else in_vain + 1
        for point, alpha in found:
            starts = starts[starts @ alpha < point @ alpha - NEAR_PLANE]
        if (1.0 - len(starts) / n_starts) * most < EXPLAINED * used:
            break
    if not found:
        return None
    return DesignPoints(*(np.array(part) for part in zip(*found)), used, False, bool(len(starts)))


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
