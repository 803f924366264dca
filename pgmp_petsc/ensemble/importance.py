"""Densities for importance sampling that points in an event make, and design points, where the event is most likely, in
the space of independent standard normal variables u.

Kernels of deviation s about points p_j of weights w_j, drawn towards the means m of clusters of them (West, Journal of
the Royal Statistical Society B 55 (1993) 409-422), make the density

    q(u) = sum_j w_j phi_s(u - c_j),    c_j = m + a (p_j - m),    s^2 = max(1 - a^2, 0.6).

With a = 0 it is one normal density a cluster, or one with the covariance of the cluster's points (`_root`), best where
the border bends towards the origin; with a = 1 it follows the points, but is wider than they are. Best of an event all
around is the standard normal density outside a ball (radial importance sampling: Harbitz, Structural Safety 3 (1986)
109-115), whose weights are all ``P(|u| > r)``.

The mean of ``log(phi / q)`` over points of the event that had no part in q, but for a constant how far q is from
``phi(u) / P`` (the cross-entropy: Rubinstein and Kroese 2004), chooses a, the number of clusters, or the ball. Means
are shrunk beside the slope of g (`_shrunk_mean`), and no point weighs more than sqrt(m) of m (Ionides, Journal of
Computational and Graphical Statistics 17 (2008) 295-311), which moves q alone.

A share of the samples is from kernels about points as they are, with s = 1, and a share from outside the ball (a
defensive mixture, Hesterberg, Technometrics 37 (1995) 185-194). Weights have a finite variance for every s^2 above 1/2.

A design point is the point of ``g(u) = 0`` nearest to the origin (Hasofer and Lind, Journal of the Engineering
Mechanics Division 100 (1974) 111-121), found by steps

    u' = (alpha . u + g / |slope|) alpha,    alpha = -slope / |slope|,

each halved where it turns back by the one before it, which on a border of curvature k it does by ``k beta`` of it, and
while ``|u|^2 / 2 + c |g|`` does not fall (Zhang and Der Kiureghian, Reliability and Optimization of Structural Systems
(1995) 297-305). Of the plane that touches the border there the event has the probability ``Phi(-beta)``
with ``beta = alpha . u``: the first-order reliability method (FORM). Squares of alpha are the shares of the variables.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

DRAWN = (0.0, 0.5, 1.0)  # factors a
FITTED = -1.0  # in place of a factor: one kernel a cluster, with the covariance of its points
CLUSTERS = (1, 2, 4, 8)
LEAST_VARIANCE = 0.6
WIDER = 1.1  # than their points kernels with covariances are: one that is too narrow has a few heavy samples far out
DEFENSIVE = 0.2  # share of samples from kernels about points
OUTSIDE = 0.1  # and from outside the ball
LARGER = 1.2  # probability of outside the ball over that of outside the nearest point, which is not the event's nearest
FEWEST = 10  # points a cluster
APART = 4.0  # deviations between the means of clusters that lie apart
TRIES = 5  # starts of clusters
SHRUNK = 2.0  # squared errors of a mean that are taken from its square; 4 does no better, 0 twice as badly
STRAIGHT = 0.3  # share of the variance of g that a straight line may leave, for its slope to be believed
PER_SLOPE = 3  # points a variable
KERNELS = 120  # about as many of the points; more take time and add little
FURTHEST = 8.0  # of a variable: beyond it a probability is 1 to round-off
PAIRS_AT_ONCE = 2**17  # of points and kernels: 1 MB, which stays in the cache


class Cloud(NamedTuple):
    """Points of an event."""

    points: np.ndarray  # shape (m, d)
    weights: np.ndarray  # how many each represents, shape (m,)
    families: np.ndarray  # numbers of the families of points that are alike, shape (m,)
    values: np.ndarray  # g, whose slope tells where a part of the event lies (`_shrunk_mean`), shape (m,); 0 if unknown

    def of(self, chosen: np.ndarray) -> Cloud:
        """Return some of the points, by a mask or their numbers."""
        return Cloud(*(part[chosen] for part in self))

    def with_further(self, other: Cloud) -> Cloud:
        return Cloud(*map(np.concatenate, zip(self, other)))


@dataclass(frozen=True, eq=False)
class KernelDensity:
    """Normal kernels."""

    centres: np.ndarray  # shape (m, d)
    shares: np.ndarray  # of the kernels, shape (m,), 1 in sum
    deviations: np.ndarray  # of each variable in the kernels, shape (m,)
    #: symmetric roots of the covariances of the first kernels, whose deviations are 1, each of shape (d, d)
    roots: Sequence[np.ndarray] = ()

    def with_further(self, centres: np.ndarray, proportions: np.ndarray, share: float) -> KernelDensity:
        """Return these and kernels of deviation 1 about further centres (n, d), whose share of all kernels is divided
        in proportions (n,), 1 in sum."""
        return KernelDensity(
            np.concatenate([self.centres, centres]),
            np.concatenate([(1.0 - share) * self.shares, share * proportions]),
            np.concatenate([self.deviations, np.ones(len(centres))]),
            self.roots,
        )

    def draw(self, n: int, random: np.random.Generator) -> np.ndarray:
        """Return n independent points, shape (n, d)."""
        chosen = random.choice(len(self.centres), size=n, p=self.shares)
        steps = random.standard_normal((n, self.centres.shape[1]))
        for number, root in enumerate(self.roots):
            own = chosen == number
            steps[own] = np.einsum("nd,de->ne", steps[own], root)
        return self.centres[chosen] + self.deviations[chosen, None] * steps

    def log(self, points: np.ndarray) -> np.ndarray:
        """Return the logarithm of the density at points (n, d), shape (n,)."""
        step, d = max(1, PAIRS_AT_ONCE // len(self.centres)), points.shape[1]
        precisions = self.deviations**-2.0
        factors = np.log(self.shares) - d * np.log(self.deviations * np.sqrt(2.0 * np.pi))
        factors -= 0.5 * precisions * np.sum(self.centres**2, axis=1)
        scaled, parts = precisions[:, None] * self.centres, [np.zeros(0)]
        for first in range(0, len(points), step):
            some = points[first : first + step]
            # |u - c|^2 multiplied out; not by BLAS, whose sums may depend on the number of threads
            exponents = np.einsum("nd,md->nm", some, scaled)
            exponents += factors - 0.5 * np.sum(some**2, axis=1)[:, None] * precisions
            for number, root in enumerate(self.roots):
                inverse, log_of_root = np.linalg.inv(root), np.linalg.slogdet(root)[1]
                steps = np.einsum("nd,de->ne", some - self.centres[number], inverse)
                constant = np.log(self.shares[number]) - 0.5 * d * np.log(2.0 * np.pi) - log_of_root
                exponents[:, number] = constant - 0.5 * np.sum(steps**2, axis=1)
            most = exponents.max(axis=1)
            exponents -= most[:, None]
            parts.append(most + np.log(np.sum(np.exp(exponents, out=exponents), axis=1)))
        return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class Mixture:
    """Kernels, and the standard normal density outside a ball and beyond planes."""

    kernels: KernelDensity  # normal kernels
    outside: float  # probability of outside the ball
    share: float  # of samples from there, of those that are not from beyond planes
    #: alpha, beta: unit vectors (n_planes, d) and distances (n_planes,) of planes ``alpha . u = beta``
    alpha: np.ndarray | None = None
    beta: np.ndarray | None = None
    beyond: float = 0.0  # share of samples from beyond them

    @property
    def _squared_radius(self) -> float:
        return float(_squared_radius(self.outside, self.kernels.centres.shape[1]))

    def with_kernels(self, centres: np.ndarray, share: float) -> Mixture:
        """Return this mixture with kernels of deviation 1 about further centres (n, d), with a share of the kernels."""
        if not len(centres):
            return self
        even = np.full(len(centres), 1.0 / len(centres))
        return replace(self, kernels=self.kernels.with_further(centres, even, share))

    def draw(self, n: int, random: np.random.Generator) -> np.ndarray:
        """Return n independent points, shape (n, d)."""
        d = self.kernels.centres.shape[1]
        n_beyond = int(random.binomial(n, self.beyond)) if self.beyond else 0
        n_outside = int(random.binomial(n - n_beyond, self.share))
        directions = random.standard_normal((n_outside, d))
        directions /= np.sqrt(np.sum(directions**2, axis=1, keepdims=True))
        # 1 - random is never 0, which would be infinitely far
        radii = np.sqrt(_squared_radius(self.outside * (1.0 - random.random(n_outside)), d))
        drawn = [radii[:, None] * directions, self.kernels.draw(n - n_outside - n_beyond, random)]
        if n_beyond:
            chances = scipy.special.ndtr(-self.beta)
            chosen = random.choice(len(chances), size=n_beyond, p=chances / chances.sum())
            along, normals = -scipy.special.ndtri(chances[chosen] * (1.0 - random.random(n_beyond))), self.alpha[chosen]
            points = random.standard_normal((n_beyond, d))
            drawn.append(points + (along - np.sum(points * normals, axis=1))[:, None] * normals)
        return np.concatenate(drawn)

    def log(self, points: np.ndarray) -> np.ndarray:
        """Return the logarithm of the density at points (n, d), shape (n,)."""
        # the points drawn nearest are on the border but for round-off
        normal, beyond = log_normal(points), np.sum(points**2, axis=1) >= (1.0 - 1e-12) * self._squared_radius
        of_outside = np.where(beyond, normal + np.log(self.share / self.outside), -np.inf)
        found = np.logaddexp(of_outside, np.log1p(-self.share) + self.kernels.log(points))
        if not self.beyond:
            return found
        n_beyond = np.sum(np.einsum("nd,kd->nk", points, self.alpha) >= (1.0 - 1e-12) * self.beta, axis=1)
        with np.errstate(divide="ignore"):
            of_planes = normal + np.log(n_beyond * self.beyond / scipy.special.ndtr(-self.beta).sum())
        return np.logaddexp(np.log1p(-self.beyond) + found, of_planes)


def log_normal(points: np.ndarray) -> np.ndarray:
    """Return the logarithm of the standard normal density at points (n, d), shape (n,)."""
    return -0.5 * np.sum(points**2, axis=1) - 0.5 * points.shape[1] * np.log(2.0 * np.pi)


def chosen_density(cloud: Cloud, random: np.random.Generator) -> Mixture:
    """Return the density that is nearest to that of the event's points; a family makes densities or tries them."""
    if len(cloud.points) == 1:  # chains that never moved: it makes densities and tries them
        cloud = cloud.of(np.zeros(2, dtype=int))
    weights = np.minimum(cloud.weights, cloud.weights.mean() * np.sqrt(len(cloud.weights)))
    cloud, points = cloud._replace(weights=weights), cloud.points
    scores: dict[tuple[int, float], float] = {}
    for make, test in _halves(cloud.families, random):
        other, of_other = _some(points[test], weights[test], 2 * KERNELS, random)
        own = cloud.of(make)
        for n_clusters in (n for n in CLUSTERS if n == 1 or make.size >= FEWEST * n):
            clusters = cluster_means(own, n_clusters, random)
            for factor in (*DRAWN, FITTED):
                density = _density(own, clusters, factor, random)
                distance = np.average(log_normal(other) - density.log(other), weights=of_other)
                scores[n_clusters, factor] = scores.get((n_clusters, factor), 0.0) + 0.5 * distance
    outside = outside_of(points)
    broad, of_broad = _some(points, weights, KERNELS, random)
    (n_clusters, factor), least = min(scores.items(), key=lambda item: item[1])
    if np.log(outside) < least:  # all weights are `outside`
        return Mixture(KernelDensity(broad, of_broad, np.ones(len(broad))), outside, 1.0 - DEFENSIVE)
    found = _density(cloud, cluster_means(cloud, n_clusters, random), factor, random)
    return Mixture(found.with_further(broad, of_broad, DEFENSIVE / (1.0 - OUTSIDE)), outside, OUTSIDE)


def outside_of(points: np.ndarray) -> float:
    """Return the probability of outside the ball that reaches nearly to the nearest of the points (m, d)."""
    nearest = float(np.min(np.sum(points**2, axis=1)))
    return min(1.0, LARGER * float(scipy.special.gammaincc(0.5 * points.shape[1], 0.5 * nearest)))


def _halves(families: np.ndarray, random: np.random.Generator) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Return points in two halves of whole families, in both orders; of one family, halves of that."""
    numbers, own = np.unique(families, return_inverse=True)
    if numbers.size == 1:
        own = np.arange(families.size)
    order = random.permutation(own.max() + 1)
    sizes = np.bincount(own)[order]
    second = np.zeros(order.size, dtype=bool)
    second[order] = (np.cumsum(sizes) - 0.5 * sizes) > 0.5 * families.size
    parts = np.flatnonzero(~second[own]), np.flatnonzero(second[own])
    return parts, parts[::-1]


def _squared_radius(outside: np.ndarray | float, d: int) -> np.ndarray:
    """Return the squared radius of the balls that standard normal points are outside of with these probabilities."""
    return 2.0 * scipy.special.gammainccinv(0.5 * d, outside)


def _some(
    points: np.ndarray, weights: np.ndarray, n: int, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return at most n of the points and their shares: drawn by their weights at equal steps (systematic sampling)."""
    if len(points) <= n:
        return points, weights / weights.sum()
    sums = np.cumsum(weights)
    drawn = np.searchsorted(sums, (random.random() + np.arange(n)) / n * sums[-1])
    chosen, counts = np.unique(np.minimum(drawn, len(points) - 1), return_counts=True)
    return points[chosen], counts / n


def _density(
    cloud: Cloud, clusters: tuple[np.ndarray, np.ndarray], factor: float, random: np.random.Generator
) -> KernelDensity:
    (points, weights, families, _), (means, shares) = cloud, clusters
    if factor == FITTED:
        own = np.argmin(np.sum((points[:, None] - means) ** 2, axis=2), axis=1)
        parts = (own == k for k in range(len(means)))
        roots = np.array([_root(points[part] - m, weights[part], families[part]) for part, m in zip(parts, means)])
        return KernelDensity(means, shares, np.ones(len(means)), WIDER * roots)
    deviation = np.sqrt(max(1.0 - factor**2, LEAST_VARIANCE))
    if factor > 0.0:
        some, shares = _some(points, weights, KERNELS, random)
        own = means[np.argmin(np.sum((some[:, None] - means) ** 2, axis=2), axis=1)]
        means = own + factor * (some - own)
    return KernelDensity(means, shares, np.full(len(means), deviation))


def _root(steps: np.ndarray, weights: np.ndarray, families: np.ndarray) -> np.ndarray:
    """Return the symmetric root of the covariance of steps (m, d) from a mean, drawn towards one variance for all
    variables by what may be noise.

    By as much as makes the expected error of the matrix least (Ledoit and Wolf, Journal of Multivariate Analysis 88
    (2004) 365-411). That variance is 1 at least, which it is beyond a plane; where the border bends towards the origin
    points spread farther. No variance is below `LEAST_VARIANCE`.
    """
    d = steps.shape[1]
    if not len(steps):
        return np.eye(d)
    shares = weights / weights.sum()
    matrix = np.einsum("n,nd,ne->de", shares, steps, steps)
    target = max(1.0, np.trace(matrix) / d) * np.eye(d)
    beyond = np.sum((matrix - target) ** 2)
    order, noise = np.argsort(families, kind="stable"), 0.0
    starts = np.unique(families[order], return_index=True)[1]
    some, of_some = steps[order], shares[order]
    of_families = np.add.reduceat(of_some, starts)[:, None]
    for row, along in zip(matrix, some.T):  # of the part of every family
        part = np.add.reduceat((of_some * along)[:, None] * some, starts)
        noise += np.sum((part - of_families * row) ** 2)
    believed = max(0.0, 1.0 - noise / beyond) if beyond > 0.0 else 0.0
    variances, axes = np.linalg.eigh(target + believed * (matrix - target))
    return np.einsum("dk,k,ek->de", axes, np.sqrt(np.maximum(variances, LEAST_VARIANCE)), axes)


def cluster_means(cloud: Cloud, n_clusters: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return the means of clusters, shape (n_clusters, d) or fewer where some are empty, and their shares."""
    labels = _labels(cloud.points, cloud.weights, n_clusters, random)
    parts = [cloud.of(labels == number) for number in np.unique(labels)]
    totals = np.array([part.weights.sum() for part in parts])
    return np.array([_shrunk_mean(part) for part in parts]), totals / totals.sum()


def _shrunk_mean(cloud: Cloud) -> np.ndarray:
    """Return the mean of points, shape (d,), nearer to 0 in every variable that may be noise alone.

    As James and Stein's estimator (Berkeley Symposium 4 (1961) I 361-379), by variable: variables that have no part in
    the event have the mean 0 and, as nearly all others, a variance of 1 at most, over as many families as there are by
    their weights. What is left of the mean beside the slope of g is shrunk, as beyond a plane all of it is noise.
    """
    shares = cloud.weights / cloud.weights.sum()
    mean = np.sum(shares[:, None] * cloud.points, axis=0)  # not by BLAS, as in `KernelDensity.log`
    error = np.sum(np.bincount(np.unique(cloud.families, return_inverse=True)[1], weights=shares) ** 2)
    slope = _slope(cloud.points, cloud.values)
    along = np.sum(mean * slope) * slope
    rest = mean - along
    return along + rest * np.maximum(1.0 - SHRUNK * error / np.maximum(rest**2, 1e-300), 0.0)


def _slope(points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the unit vector along which g rises at points (m, d), by least squares; 0 where no straight line fits.

    Its error is what g bends, while that of the mean is 1 over the points in every variable: of a plane it has none.
    """
    m, d = points.shape
    if m < PER_SLOPE * (d + 1) or not np.ptp(values) > 0.0:
        return np.zeros(d)
    steps, rises = points - points.mean(axis=0), values - values.mean()
    matrix = np.einsum("ni,nj->ij", steps, steps)
    matrix.flat[:: d + 1] += 1e-9 * np.trace(matrix)  # points may lie in a plane, or be one point
    slope = np.linalg.solve(matrix, np.einsum("ni,n->i", steps, rises)) if matrix[0, 0] > 0.0 else np.zeros(d)
    left = np.sum((rises - np.sum(steps * slope, axis=1)) ** 2) / (m - d) / (np.sum(rises**2) / m)
    return slope / np.sqrt(np.sum(slope**2)) if left < STRAIGHT else np.zeros(d)


def levelled(points: np.ndarray, weights: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return weights (m,) with which each of the most clusters of points counts the same.

    Of points of chains, whose shares are those that chance gave their ancestors.
    """
    n_clusters = max(1, min(CLUSTERS[-1], len(points) // FEWEST))
    labels = _labels(points, weights, n_clusters, random)
    return weights / np.bincount(labels, weights=weights, minlength=n_clusters)[labels]


def lie_apart(points: np.ndarray, weights: np.ndarray, random: np.random.Generator) -> bool:
    """Return whether points (m, d) of weights (m,) are in clusters with little between them.

    One of two or four clusters is, along the lines through their means, farther than `APART` of their deviations from
    every other (Ashman, Bird and Zepf, Astronomical Journal 108 (1994) 2348-2361, take 2 for two normal laws; halves of
    one normal law are 2.65 apart).
    """
    for n_clusters in (2, 4):
        if len(points) < FEWEST * n_clusters:
            return False
        labels = _labels(points, weights, n_clusters, random)
        parts = [(points[own], weights[own]) for own in (labels == k for k in range(n_clusters)) if own.sum() > 1]
        means = [np.average(some, axis=0, weights=of_some) for some, of_some in parts]
        distances = np.full((len(parts), len(parts)), np.inf)
        for i, j in zip(*np.triu_indices(len(parts), 1)):
            line = means[i] - means[j]
            spread = sum(np.average(((parts[k][0] - means[k]) @ line) ** 2, weights=parts[k][1]) for k in (i, j))
            distances[i, j] = distances[j, i] = np.sum(line**2) / np.sqrt(0.5 * max(spread, 1e-300))
        if len(parts) > 1 and distances.min(axis=1).max() > APART:
            return True
    return False


def _labels(points: np.ndarray, weights: np.ndarray, n_clusters: int, random: np.random.Generator) -> np.ndarray:
    if n_clusters == 1:
        return np.zeros(len(points), dtype=int)
    some, shares = _some(points, weights, 4 * KERNELS, random)
    with warnings.catch_warnings(), np.errstate(invalid="ignore"):  # of points that are all one
        warnings.simplefilter("ignore", UserWarning)  # an empty cluster, which is left out by who asks
        tries = [
            scipy.cluster.vq.kmeans2(some, n_clusters, minit="++", seed=random, check_finite=False)
            for _ in range(TRIES)
        ]
    centres = min(tries, key=lambda one: np.sum(shares * np.sum((some - one[0][one[1]]) ** 2, axis=1)))[0]
    return np.argmin(np.sum((points[:, None] - centres) ** 2, axis=2), axis=1)


LimitState = Callable[[np.ndarray], np.ndarray]
Slopes = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]

SEARCHES_AT_ONCE, MOST_STEPS = 4, 40  # steps of each
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
        n_at_once, is_other = min(SEARCHES_AT_ONCE, max(at_most // (2 * cost), 1)), not len(starts)
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
