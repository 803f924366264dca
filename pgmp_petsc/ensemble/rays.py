"""Where rays enter an event: points of its parts that some level of subset simulation has seen and a later one lost.

Chains of a level are in all parts of an event for which chance has left seeds. A part that chance takes away is still
known from the levels before: clusters of their points lie in its direction, though not as far out. Rays from the origin
through the means of the clusters of all levels enter the event near the design points of its parts, which importance
sampling of events with several parts takes for centres (Au, Papadimitriou and Beck, Structural Safety 21 (1999)
113-133).

A part beyond a plane at the distance r has the probability ``P(u > r)``: rays are followed to where that is `RARER` of
the event's, and one that is not in the event there is left. Between the origin and there the event begins once, or
bisection finds one of its beginnings.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pgmp_petsc.ensemble.importance import CLUSTERS, FEWEST, cluster_means

ALIKE = 0.8  # cosine of the angle between rays to the same part
MOST = 16
STEPS = 6  # evaluations of g on a ray: of 5.6 deviations a sixth of one is left
PART_OF_SAMPLES = 8  # rays take one of so many samples that are left, at most
RARER = 1e-3  # probability of a part over that of the event


def directions_of(
    points: np.ndarray, families: np.ndarray, values: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Return unit vectors to the means of clusters of a level's points (m, d), shape (n_clusters, d) at most.

    `families` and `values`, each (m,), are as in :func:`~pgmp_petsc.ensemble.importance.chosen_density`.
    """
    n_clusters = max(1, min(CLUSTERS[-1], len(points) // FEWEST))
    means, _ = cluster_means(points, np.ones(len(points)), families, values, n_clusters, random)
    norms = np.sqrt(np.sum(means**2, axis=1))
    return means[norms > 0.0] / norms[norms > 0.0, None]


def unlike(directions: np.ndarray) -> list[int]:
    """Return the numbers of the directions (n, d) that are far from those before them."""
    kept: list[int] = []
    for number, direction in enumerate(directions):
        if all(direction @ directions[one] < ALIKE for one in kept):
            kept.append(number)
    return kept


def most_rays(n_left: int) -> int:
    """Return how many rays samples that are left can follow."""
    return min(MOST, n_left // (PART_OF_SAMPLES * STEPS))


def apart(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the points (n, d) that are in none of the directions of others (m, d)."""
    units = [one / np.sqrt(np.sum(one**2, axis=1, keepdims=True)) for one in (points, others)]
    return points[np.all(np.einsum("nd,md->nm", *units) < ALIKE, axis=1)]


def entrances(
    limit_state: Callable[[np.ndarray], np.ndarray], directions: np.ndarray, probability: float
) -> np.ndarray:
    """Return points in the event near where rays enter it, shape (n_entrances, d); of rays that do not, none.

    Parameters
    ----------
    limit_state
        g of points (n, d), shape (n,); all rays are followed at once.
    directions
        Unit vectors, shape (n, d).
    probability
        Of the event, as nearly as it is known.
    """
    from scipy.special import ndtri

    far = -float(ndtri(RARER * probability))
    if len(directions):
        directions = directions[limit_state(far * directions) <= 0.0]
    before, within = np.zeros((len(directions), 1)), np.full((len(directions), 1), far)
    for _ in range(STEPS - 1 if len(directions) else 0):
        middle = 0.5 * (before + within)
        inside = limit_state(middle * directions)[:, None] <= 0.0
        before, within = np.where(inside, before, middle), np.where(inside, middle, within)
    return within * directions
