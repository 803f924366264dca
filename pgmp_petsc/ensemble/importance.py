"""Densities for importance sampling that points in an event make, in the space of standard normal variables.

Kernels of deviation s about points p_j of weights w_j, drawn towards the means m of clusters of them (West, Journal of
the Royal Statistical Society B 55 (1993) 409-422), make the density

    q(u) = sum_j w_j phi_s(u - c_j),    c_j = m + a (p_j - m),    s^2 = max(1 - a^2, 0.6).

With a = 0 it is one normal density a cluster, best of an event with a nearly plane border; with a = 1 it follows the
points, however the event is shaped, but is wider than they are, the more so in many dimensions. Points of the event are
distributed as ``phi(u) / P``, so that their mean of ``phi / q`` foretells the variance of the weights: it chooses a and
the number of clusters, on points that had no part in q. A share of the samples is from kernels about all points as they
are, with s = 1 (a defensive mixture, Hesterberg, Technometrics 37 (1995) 185-194): what the choice has missed then has
no large weight. Weights have a finite variance for every s^2 above 1/2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

DRAWN = (0.0, 0.35, 0.6, 1.0)  # factors a
CLUSTERS = (1, 2, 4, 8)
LEAST_VARIANCE = 0.6
DEFENSIVE = 0.25  # share of samples from kernels about all points
FEWEST = 10  # points a cluster
FURTHEST = 8.0  # of a variable: beyond it a probability is 1 to round-off
AT_ONCE = 4_000_000  # numbers of differences between points


@dataclass(frozen=True, eq=False)
class KernelDensity:
    """Normal kernels.

    Attributes
    ----------
    centres
        Shape (m, d).
    shares
        Of the kernels, shape (m,), 1 in sum.
    deviations
        Of each variable in the kernels, shape (m,).
    """

    centres: np.ndarray
    shares: np.ndarray
    deviations: np.ndarray

    def draw(self, n: int, random: np.random.Generator) -> np.ndarray:
        """Return n independent points, shape (n, d)."""
        chosen = random.choice(len(self.centres), size=n, p=self.shares)
        steps = random.standard_normal((n, self.centres.shape[1]))
        return self.centres[chosen] + self.deviations[chosen, None] * steps

    def log(self, points: np.ndarray) -> np.ndarray:
        """Return the logarithm of the density at points (n, d), shape (n,)."""
        step, d = max(1, AT_ONCE // self.centres.size), points.shape[1]
        factors = np.log(self.shares) - d * np.log(self.deviations * np.sqrt(2.0 * np.pi))
        parts = [np.zeros(0)]
        for first in range(0, len(points), step):
            apart = (points[first : first + step, None] - self.centres) / self.deviations[:, None]
            exponents = factors - 0.5 * np.sum(apart**2, axis=2)
            most = exponents.max(axis=1)
            parts.append(most + np.log(np.sum(np.exp(exponents - most[:, None]), axis=1)))
        return np.concatenate(parts)


def log_normal(points: np.ndarray) -> np.ndarray:
    """Return the logarithm of the standard normal density at points (n, d), shape (n,)."""
    return -0.5 * np.sum(points**2, axis=1) - 0.5 * points.shape[1] * np.log(2.0 * np.pi)


def chosen_density(points: np.ndarray, weights: np.ndarray, random: np.random.Generator) -> KernelDensity:
    """Return the density that foretells the least variance of weights.

    Parameters
    ----------
    points, weights
        Points of the event, shape (m, d), and how many each stands for, shape (m,); two points at least.
    random
        Which points try the densities that others make.
    """
    order = random.permutation(len(points))
    (one, of_one), (other, of_other) = ((points[k], weights[k]) for k in (order[::2], order[1::2]))
    best, choice = np.inf, (CLUSTERS[0], DRAWN[-1])
    for n_clusters, factor, density in _densities(one, of_one, random):
        second_moment = np.average(np.exp(log_normal(other) - density.log(other)), weights=of_other)
        if second_moment < best:
            best, choice = second_moment, (n_clusters, factor)
    found = _density(points, weights, _cluster_means(points, weights, choice[0], random), choice[1])
    broad = weights / weights.sum()
    return KernelDensity(
        np.concatenate([found.centres, points]),
        np.concatenate([(1.0 - DEFENSIVE) * found.shares, DEFENSIVE * broad]),
        np.concatenate([found.deviations, np.ones(len(points))]),
    )


def _densities(
    points: np.ndarray, weights: np.ndarray, random: np.random.Generator
) -> Iterator[tuple[int, float, KernelDensity]]:
    """Yield all densities that are tried, with the number of clusters and the factor."""
    for n_clusters in CLUSTERS:
        if n_clusters == 1 or len(points) >= FEWEST * n_clusters:
            means = _cluster_means(points, weights, n_clusters, random)
            for factor in DRAWN:
                yield n_clusters, factor, _density(points, weights, means, factor)


def _density(points: np.ndarray, weights: np.ndarray, means: np.ndarray, factor: float) -> KernelDensity:
    drawn, place = np.unique(means + factor * (points - means), axis=0, return_inverse=True)
    shares = np.bincount(place.reshape(-1), weights=weights, minlength=len(drawn))
    deviation = np.sqrt(max(1.0 - factor**2, LEAST_VARIANCE))
    return KernelDensity(drawn, shares / shares.sum(), np.full(len(drawn), deviation))


def _cluster_means(points: np.ndarray, weights: np.ndarray, n_clusters: int, random: np.random.Generator) -> np.ndarray:
    """Return the mean of every point's cluster, shape (m, d)."""
    from scipy.cluster.vq import kmeans2

    labels = np.zeros(len(points), dtype=int)
    if n_clusters > 1:
        labels = kmeans2(points, n_clusters, minit="++", seed=random)[1]
    sums = np.zeros((n_clusters, points.shape[1]))
    np.add.at(sums, labels, weights[:, None] * points)
    return (sums / np.maximum(np.bincount(labels, weights=weights, minlength=n_clusters), 1e-300)[:, None])[labels]
