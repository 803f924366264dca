"""Probabilities of rare events: subset simulation finds where an event is, importance sampling says how likely.

Samples are of independent standard normal variables u, of which distributions make parameters. The event is ``g(u) <=
0``. Subset simulation (Au and Beck, Probabilistic Engineering Mechanics 16 (2001) 263-277) lowers a threshold on g so
that a tenth of each level's samples pass it, and from these goes on by conditional sampling (Papaioannou, Betz,
Zwirglmaier and Straub, Probabilistic Engineering Mechanics 41 (2015) 89-103): ``v = rho u + sqrt(1 - rho^2) w`` with
w standard normal, kept where it passes the threshold. Chains of the last level are in the event, in all parts of it
that were found.

These points make the density q that further, independent samples are drawn from (`importance`), in rounds: the samples
of every round that are in the event make the density of the next one. In the chains, parts of an event that lie apart
have the shares that chance gave their ancestors, none at last where a level's seeds miss one; so a share of the samples
is from where rays through the clusters of all levels enter the event (`rays`). Weighted samples give parts their own
shares. The first round does no more than that. Of each later one the mean of ``1[g <= 0] phi(u) / q(u)`` is the
probability: unbiased wherever the points are, as rounds before are given, so that the rounds are uncorrelated and their
variances add. They count as the square roots of their numbers (Owen and Zhou, arXiv 1903.11908), which needs no
estimate of how much the later ones are better. The interval is that of the central limit theorem. What it rests on is
that no part of the event is far from all points: in many variables a part that no level has seen has no part in the
interval either.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.ensemble.designs import OF_RARE, stream
from pgmp_petsc.ensemble.importance import OUTSIDE, chosen_density, levelled, lie_apart, log_normal, outside_of
from pgmp_petsc.ensemble.intervals import freedom_of
from pgmp_petsc.ensemble.rays import directions_of, entrances, unlike

SHARE = 10  # one of so many samples of a level passes its threshold, and begins a chain of as many samples
LEAST_OF_LEVEL = 100
PART_OF_LEVEL = 8  # of all samples a level has one of so many: with fewer, chains lose parts of an event
MOST_LEVELS = 30  # 1e-30 would be no statement about any real thing
AT_ENTRANCES = (0.5, 0.1, 0.1, 0.1)  # share of the kernels of every round that are where rays enter the event
ROUNDS = len(AT_ENTRANCES)  # of importance sampling, the first of which has no part in the probability
ENOUGH = 20  # samples in the event, to make a density
ACCEPTED = 0.44  # share of the steps of chains that are best accepted (Papaioannou et al. 2015)

LimitState = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Level:
    """What a level of subset simulation found.

    Attributes
    ----------
    threshold
        On g, 0 of the last one.
    share
        Of the samples before that pass it.
    accepted
        Share of the steps of its chains that were accepted.
    before
        g of the samples before, shape (n,); infinite where the run failed.
    """

    threshold: float
    share: float
    accepted: float
    before: np.ndarray


@dataclass(frozen=True, eq=False)
class RareSamples:
    """Samples and what follows from them.

    Attributes
    ----------
    levels
        Of subset simulation; the last one's threshold is 0 where the event was reached.
    points
        u of all samples in the order in which they were evaluated, shape (n, d).
    limit_state
        g of them, shape (n,); NaN where the run failed.
    weights
        Of those of importance sampling that count, which are the last ones, shape (n_weighted,): ``phi / q`` by the
        weight of the round.
    rounds
        Numbers of samples of the rounds that count; their sum is n_weighted.
    """

    levels: tuple[Level, ...]
    points: np.ndarray
    limit_state: np.ndarray
    weights: np.ndarray
    rounds: tuple[int, ...]

    @property
    def reached(self) -> bool:
        """Whether the event was reached and weighed."""
        return self.weights.size > 0

    @property
    def by_levels(self) -> float:
        """The probability that the levels alone give: their product, which has no interval."""
        return float(np.prod([level.share for level in self.levels]))

    def curve(self) -> tuple[np.ndarray, np.ndarray]:
        """Return g from large to small and the probabilities of no more, as the levels know them, each (n_points,)."""
        found, probability = [np.zeros((2, 0))], 1.0
        for level in self.levels:
            values = np.sort(level.before)[::-1]
            shares = probability * np.arange(values.size, 0, -1) / values.size
            found.append(np.array([values, shares])[:, np.isfinite(values) & (values >= level.threshold)])
            probability *= level.share
        values, shares = np.concatenate(found, axis=1)
        return values, shares

    @property
    def contributions(self) -> np.ndarray:
        """Of every weighted sample, shape (n_weighted,): their mean is the probability; failed ones count as not in the
        event."""
        own = self.limit_state[self.limit_state.size - self.weights.size :]
        return np.where(own <= 0.0, self.weights, 0.0)

    @property
    def _of_rounds(self) -> list[np.ndarray]:
        return np.split(self.contributions, np.cumsum(self.rounds)[:-1])

    @property
    def probability(self) -> float:
        """The probability; NaN where the event was not reached."""
        return float(self.contributions.mean()) if self.reached else np.nan

    @property
    def at_most(self) -> float:
        """The probability if all weighted samples whose runs failed had been in the event."""
        own = self.limit_state[self.limit_state.size - self.weights.size :]
        return float(np.where(own > 0.0, 0.0, self.weights).mean()) if self.reached else np.nan

    @property
    def variation(self) -> float:
        """Coefficient of variation of the probability, estimated."""
        found = self.contributions
        if not found.any():
            return np.nan
        return float(np.sqrt(sum(one.size * one.var(ddof=1) for one in self._of_rounds)) / found.sum())

    @property
    def n_effective(self) -> float:
        """Number of equally weighted samples in the event that would be as good."""
        found = self.contributions
        return float(found.sum() ** 2 / np.sum(found**2)) if found.any() else 0.0

    @property
    def may_have_lost_parts(self) -> bool:
        """Whether the event has parts that lie apart, and nothing has looked for further ones.

        Rays lead to parts that a level has seen, and levels miss parts by chance. Samples from outside the ball find a
        part as likely as the event is, where that is less than once to be expected, hardly ever: in many variables
        nearly everything is outside.
        """
        found, points = self.contributions, self.points[self.points.shape[0] - self.weights.size :]
        inside = found > 0.0
        if not inside.any():
            return False
        looked = OUTSIDE * found.size * self.probability / outside_of(points[inside])
        return bool(looked < 1.0 and lie_apart(points[inside], found[inside], stream(0, OF_RARE, 0)))

    def interval(self, confidence: float) -> np.ndarray:
        """Return a confidence interval of the probability, shape (2,): of its logarithm, which is nearer to normal.

        Student's t, with the freedom of as many samples as the weighted ones are worth, or that their kurtosis leaves
        their variance (`intervals.freedom_of`): a few large weights decide on it.
        """
        from scipy.special import stdtrit

        if not np.isfinite(self.variation):
            return np.full(2, np.nan)
        freedom = freedom_of(np.concatenate([one - one.mean() for one in self._of_rounds]), self.n_effective - 1.0)
        reach = float(stdtrit(max(freedom, 1.0), 0.5 + 0.5 * confidence))
        spread = np.sqrt(np.log1p(self.variation**2)) * reach
        return np.minimum(self.probability * np.exp([-spread, spread]), 1.0)


def level_size(n_samples: int) -> int:
    """Return how many samples a level of subset simulation has."""
    return max(LEAST_OF_LEVEL, n_samples // PART_OF_LEVEL) // SHARE * SHARE


def find(limit_state: LimitState, d: int, n_samples: int, seed: int) -> RareSamples:
    """Find and weigh the event ``g <= 0``.

    Parameters
    ----------
    limit_state
        g of points (n, d), shape (n,); NaN where it is not known.
    d
        Number of variables.
    n_samples
        Evaluations of g at most; those that subset simulation leaves are weighted. At least as many as `level_size`
        three times.
    seed
        Of all random numbers.
    """
    size = level_size(n_samples)
    chains = _Chains(limit_state, seed, d)
    points, g = chains.begin(size)
    levels: list[Level] = []
    directions: list[np.ndarray] = []
    own = families = np.arange(size)  # the chains of this level that points are of, and those of the one before
    while len(levels) < MOST_LEVELS:
        g = np.where(np.isnan(g), np.inf, g)
        threshold = max(0.0, float(np.sort(g)[size // SHARE - 1]))
        passed = np.flatnonzero(g <= threshold)
        stuck = not np.isfinite(threshold) or (levels and threshold >= levels[-1].threshold) or passed.size == size
        if (stuck and threshold > 0.0) or chains.n + size > n_samples - size:
            break  # no nearer to the event, or what would be left is too little to be weighed
        before, families = g, own[passed][np.arange(size) % passed.size]
        points, g, accepted = chains.go_on(points[passed], g[passed], threshold, size)
        own = np.arange(size) % passed.size
        directions.append(directions_of(points, own, g, chains.random()))
        levels.append(Level(threshold, passed.size / size, accepted, before))
        if threshold == 0.0:
            break
    weights: list[np.ndarray] = []
    if levels and levels[-1].threshold == 0.0:
        # those of the last level first, which know them best
        rays = unlike(np.concatenate(directions[::-1]), n_samples - chains.n)
        centres = entrances(chains.evaluate, rays, float(np.prod([level.share for level in levels])))
        weights = chains.weigh(points, g, families, centres, n_samples - chains.n)
    return RareSamples(
        tuple(levels),
        np.concatenate(chains.points),
        np.concatenate(chains.values),
        np.concatenate([np.zeros(0), *weights]),
        tuple(of_round.size for of_round in weights),
    )


class _Chains:
    """Evaluates g, and keeps all points."""

    def __init__(self, limit_state: LimitState, seed: int, d: int) -> None:
        self._limit_state, self._seed, self._d = limit_state, seed, d
        self.points: list[np.ndarray] = []
        self.values: list[np.ndarray] = []
        self._spread = 0.6  # of a step over the deviation of the points
        self._number = 0

    @property
    def n(self) -> int:
        """Number of evaluations."""
        return sum(part.size for part in self.values)

    def begin(self, size: int) -> tuple[np.ndarray, np.ndarray]:
        """Return independent points and g."""
        points = self.random().standard_normal((size, self._d))
        return points, self.evaluate(points)

    def go_on(
        self, seeds: np.ndarray, g: np.ndarray, threshold: float, size: int
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Return points (size, d) that pass a threshold, their g, and the share of accepted steps."""
        random, deviation = self.random(), np.minimum(seeds.std(axis=0), 1.0)
        current, value = seeds, g
        points, values, accepted = [seeds], [g], []
        while sum(map(len, points)) < size:
            left = size - sum(map(len, points))
            current, value = current[:left], value[:left]
            sigma = np.minimum(self._spread * deviation, 1.0)
            candidate = np.sqrt(1.0 - sigma**2) * current + sigma * random.standard_normal(current.shape)
            found = self.evaluate(candidate)
            better = found <= threshold
            current, value = np.where(better[:, None], candidate, current), np.where(better, found, value)
            accepted.append(better.mean())
            self._spread *= np.exp((accepted[-1] - ACCEPTED) / np.sqrt(len(accepted)))
            points.append(current)
            values.append(value)
        return np.concatenate(points)[:size], np.concatenate(values)[:size], float(np.mean(accepted or [1.0]))

    def weigh(
        self, points: np.ndarray, g: np.ndarray, families: np.ndarray, entrances: np.ndarray, n: int
    ) -> list[np.ndarray]:
        """Evaluate n points from densities that points of the event make, and return the weights of all rounds but one.

        The first round is left out: its density is from points of chains, which are not independent, and half of it is
        about where rays enter the event. Points of all rounds make the next density, each with the weight of the
        mixture of all densities so far (the balance heuristic: Owen and Zhou, Journal of the American Statistical
        Association 95 (2000) 135-143), which is never much larger than that of the best of them.
        """
        centres, first, counts = np.unique(points, axis=0, return_index=True, return_counts=True)
        alike, values = families[first], g[first]
        known = levelled(centres, counts.astype(float), self.random())
        sizes = np.full(ROUNDS, n // ROUNDS)
        sizes[-1] += n % ROUNDS
        weights, densities, inside, g_inside = [], [], np.zeros((0, points.shape[1])), np.zeros(0)
        for size, share in zip(sizes, AT_ENTRANCES):
            random = self.random()
            density = chosen_density(centres, known, random, alike, values).with_kernels(entrances, share)
            densities.append(density)
            drawn = density.draw(size, random)
            found = self.evaluate(drawn)
            within = found <= 0.0
            weights.append(np.exp(log_normal(drawn) - density.log(drawn)))
            inside, g_inside = np.concatenate([inside, drawn[within]]), np.concatenate([g_inside, found[within]])
            if len(inside) >= ENOUGH:
                drawn_so_far = [np.log(m) + one.log(inside) for m, one in zip(sizes, densities)]
                centres, alike, values = inside, None, g_inside
                known = np.exp(log_normal(inside) - np.logaddexp.reduce(drawn_so_far, axis=0))
        roots = np.sqrt(np.arange(1, ROUNDS))
        roots /= np.average(roots, weights=sizes[1:])  # so that the mean of all weighted samples is the probability
        return [root * of_round for root, of_round in zip(roots, weights[1:])]

    def random(self) -> np.random.Generator:
        """Return the next stream."""
        self._number += 1
        return stream(self._seed, OF_RARE, self._number)

    def evaluate(self, points: np.ndarray) -> np.ndarray:
        """Return g of points (n, d), shape (n,), and keep both."""
        found = self._limit_state(points)
        self.points.append(points)
        self.values.append(found)
        return found
