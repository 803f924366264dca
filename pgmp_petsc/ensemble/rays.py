"""Where rays enter an event: one point of every part that any level of subset simulation has seen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pgmp_petsc.ensemble.importance import CLUSTERS, FEWEST, _clusters

ALIKE = 0.8
MOST = 16
STEPS = 6
RARER = 1e-3


def directions_of(points, families, random):
    n_clusters = max(1, min(CLUSTERS[-1], len(points) // FEWEST))
    means, _ = _clusters(points, np.ones(len(points)), families, n_clusters, random)
    norms = np.sqrt(np.sum(means**2, axis=1))
    return means[norms > 0.0] / norms[norms > 0.0, None]


def unlike(directions):
    kept = []
    for one in directions:
        if len(kept) < MOST and all(np.sum(one * other) < ALIKE for other in kept):
            kept.append(one)
    return np.array(kept).reshape(-1, directions.shape[1])


def entries(evaluate, directions, probability):
    from scipy.special import ndtri

    reach = -float(ndtri(RARER * probability))
    low, high = np.zeros(len(directions)), np.full(len(directions), reach)
    inside = evaluate(high[:, None] * directions) <= 0.0
    directions, low, high = directions[inside], low[inside], high[inside]
    for _ in range(STEPS - 1):
        if not len(directions):
            break
        middle = 0.5 * (low + high)
        within = evaluate(middle[:, None] * directions) <= 0.0
        low, high = np.where(within, low, middle), np.where(within, middle, high)
    return high[:, None] * directions
