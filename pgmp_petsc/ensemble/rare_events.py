"""Probabilities of rare events: subset simulation finds where an event is, importance sampling says how likely
(docs/uncertainty.md, rare events, has the way from one to the other and what it rests on).

Samples are of independent standard normal variables u, of which distributions make parameters. The event is ``g(u) <=
0``. Each level's threshold on g is passed by a tenth of its samples (Au and Beck, Probabilistic Engineering Mechanics
16 (2001) 263-277), from which conditional sampling goes on (Papaioannou, Betz, Zwirglmaier and Straub, the same 41
(2015) 89-103): ``v = rho u + sqrt(1 - rho^2) w`` with w standard normal, kept where it passes. Where most samples have
the same g, those of larger deviations look for what is below it (sequential Monte Carlo: Del Moral, Doucet and Jasra,
Journal of the Royal Statistical Society B 68 (2006) 411-436; `_Chains.from_afar`).

Rounds of independent samples follow, of a density q that the rounds before make (`importance`), about where rays enter
the event (`entrances`; Au, Papadimitriou and Beck, Structural Safety 21 (1999) 113-133), about design points, and from
beyond the planes there, with the sum of their probabilities over the number of planes that a sample is beyond as weight
(Owen, Maximov and Chertkov, Electronic Journal of Statistics 13 (2019) 231-254). Of each round but the first the mean
of ``1[g <= 0] phi(u) / q(u)`` is unbiased given those before, so that variances add; rounds count as the square roots
of their numbers (Owen and Zhou, arXiv 1903.11908). The interval is that of the central limit theorem; where searches
for design points still found new ones at their end it goes on to what the levels alone leave open.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.special import ndtr, ndtri

from pgmp_petsc.ensemble import importance
from pgmp_petsc.ensemble.importance import DesignPoints, LimitState, Slopes, bisected_design_points, design_points
from pgmp_petsc.ensemble.intervals import of_probability, of_weighted, variation_of
from pgmp_petsc.ensemble.sampling import OF_RARE, stream

SHARE = 10  # one of so many samples of a level passes its threshold, and begins a chain of as many samples
LEAST_OF_LEVEL = 100
MOST_OF_LEVEL = 2000
PART_OF_LEVEL = 8  # of the samples that are left a level has one of so many: with fewer, chains lose parts of an event
PART_WEIGHED = 8  # of all samples one of so many is left to be weighed, at least
MOST_LEVELS = 30  # 1e-30 would be no statement about any real thing
OF_DESIGN = 2 / 3  # of the samples that are left searches for design points have, at most
SCANNED = (1.5, 2.0, 3.0)  # deviations of samples that see whether there is more than levels have seen
PART_SCANNED = 80  # of the samples that are left one of so many is of each of these
BEYOND = 0.1  # of a design point, where the event is
FEWEST_SEEDS = 5  # points below a plateau that a level begins from
AFAR = (1.5, 2.0, 3.0, 4.5)  # deviations of samples that look for what is below a plateau
LEAST_CHANCE = 1e-15  # of what they find
FOUND = 10  # of them, which are enough
OF_WORTH = 0.5  # share of their number that samples are worth after a step of their deviation
AT_ENTRANCES = (0.5, 0.1, 0.1, 0.1)  # share of the kernels of every round that are where rays enter the event
AT_DESIGN = 0.5  # where they are at design points, which are known better than by rays
LEVELS_APART = 10.0  # factor between what levels and weights say, beyond which parts are missing
VARY = 30.0  # how much more weights vary before the planes of design points than beyond them
ROUNDS = len(AT_ENTRANCES)  # of importance sampling, the first of which has no part in the probability
MOST_FACTOR = 20.0  # logarithm of what a shift of g may make of a probability
WEAK = 15.0  # equally weighted samples in the event, below which its probability is bounded only
ENOUGH = 20  # samples in the event, to make a density
ACCEPTED = 0.44  # share of the steps of chains that are best accepted (Papaioannou et al. 2015)


@dataclass(frozen=True, eq=False)
class Level:
    """A level of subset simulation."""

    threshold: float  # on g, 0 of the last one
    share: float  # of the samples before that pass it
    accepted: float  # share of the steps of its chains that were accepted
    before: np.ndarray  # g of the samples before, shape (n,); infinite where the run failed
    #: whether its first points are from samples of larger deviations, of which the share is a guess
    is_afar: bool = False
    variation: float = np.nan  # coefficient of variation of the share, from its chains; NaN of a guess


@dataclass(frozen=True, eq=False)
class RareSamples:
    """Samples and what follows from them."""

    levels: tuple[Level, ...]  # of subset simulation; the last one's threshold is 0 where the event was reached
    points: np.ndarray  # u of all samples in the order in which they were evaluated, shape (n, d)
    limit_state: np.ndarray  # g of them, shape (n,); NaN where the run failed
    #: of those of importance sampling that count, which are the last ones, shape (n_weighted,): ``phi / q`` by the
    #: weight of the round
    weights: np.ndarray
    rounds: tuple[int, ...]  # numbers of samples of the rounds that count; their sum is n_weighted
    #: threshold on g of what was weighed: above 0 where the event was not reached, and the level before it was
    weighed: float = 0.0
    design: DesignPoints | None = None  # design points of the event; None where none was looked for

    @property
    def reached(self) -> bool:
        if self.is_plain:
            return bool(self.contributions.any())
        is_open = self.design is not None and self.may_have_lost_parts
        return self.weights.size > 0 and not (self.weighed > 0.0 or self.is_weak or is_open)

    @property
    def is_weak(self) -> bool:
        """Whether weighted samples of levels are worth too few to say anything: a heavier one may still come."""
        return bool(self.levels) and not self.is_plain and self.n_effective < WEAK

    @property
    def is_plain(self) -> bool:
        """Whether weighted samples are plain ones, as nothing led to the event."""
        return len(self.rounds) == 1 and bool(np.all(self.weights == 1.0))

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
        return np.where(own <= self.weighed, self.weights, 0.0)

    @property
    def _of_rounds(self) -> list[np.ndarray]:
        return np.split(self.contributions, np.cumsum(self.rounds)[:-1])

    @property
    def probability(self) -> float:
        """The probability; NaN where the event was not reached."""
        return min(float(self.contributions.mean()), 1.0) if self.reached else np.nan

    @property
    def at_most(self) -> float:
        """The probability if all weighted samples whose runs failed had been in the event."""
        own = self.limit_state[self.limit_state.size - self.weights.size :]
        return min(float(np.where(own > 0.0, 0.0, self.weights).mean()), 1.0) if self.reached else np.nan

    @property
    def variation(self) -> float:
        return variation_of(self._of_rounds)

    @property
    def n_effective(self) -> float:
        """Number of equally weighted samples in the event that would be as good."""
        found = self.contributions
        return float(found.sum() ** 2 / np.sum(found**2)) if found.any() else 0.0

    def factor_of(self, shift: float) -> float:
        """Return how many times as probable the event would be if g were less by `shift`.

        ``exp(h shift)``, h how quickly weighted samples thin out from the border into the event: of depths that are
        exponential, of which those beyond the shift, or their median, count as deeper alone (Epstein and Sobel, Journal
        of the American Statistical Association 48 (1953) 486-502).
        """
        found = self.contributions
        inside = found > 0.0
        depth, weight = -self.limit_state[self.limit_state.size - found.size :][inside], found[inside]
        order = np.argsort(depth)
        sums = np.cumsum(weight[order])
        median = depth[order][np.searchsorted(sums, 0.5 * sums[-1])]
        deep = max(abs(shift), float(median))
        of_all = float(np.sum(weight * np.minimum(depth, deep)))
        hazard = float(weight[depth < deep].sum()) / of_all if of_all > 0.0 else 0.0
        return float(np.exp(np.clip(hazard * shift, -MOST_FACTOR, MOST_FACTOR)))

    @cached_property
    def may_have_lost_parts(self) -> bool:
        """Whether the event has parts that lie apart, and nothing shows that there are no further ones.

        Searches for design points show it, where they ended as they found nothing new. So do samples from outside the
        ball, which find a part as likely as the event is, where that is once to be expected.
        """
        found, points = self.contributions, self.points[self.points.shape[0] - self.weights.size :]
        inside = found > 0.0
        if self.is_plain or self.is_weak or self.weighed > 0.0 or not inside.any():
            return False
        if not (self.design is None or self.design.is_open):
            return False
        if importance.OUTSIDE * found.sum() / importance.outside_of(points[inside]) >= 1.0:
            return False
        if self.design is not None:
            return self.design.beta.size > 1 or self.by_levels > LEVELS_APART * found.mean()
        return importance.lie_apart(points[inside], found[inside], stream(0, OF_RARE, 0))

    def interval(self, confidence: float) -> np.ndarray:
        """Return a confidence interval of the probability, shape (2,) (`intervals.of_weighted`).

        Of an event that was not reached it is from 0 to the upper end of that of the level before it, or of the first
        samples: the smaller one, each of which holds with half of the doubt. Where parts may
        have been lost it goes on to the upper end of what the levels alone say.
        """
        if self.is_plain:
            return of_probability(int(np.count_nonzero(self.contributions)), self.weights.size, confidence)
        if self.levels and (self.is_weak or not self.contributions.any()):
            return np.array([0.0, self.of_first(confidence)])
        ends = of_weighted(self._of_rounds, confidence)
        if self.weighed > 0.0:
            return np.array([0.0, min(ends[1], self.of_first(confidence))])
        return np.array([ends[0], max(ends[1], self._of_levels(confidence))]) if self.may_have_lost_parts else ends

    def _of_levels(self, confidence: float) -> float:
        """Return the upper end of what the levels alone say: of the logarithm of their product, whose shares are off
        all alike at most (Au and Beck 2001)."""
        variation = float(np.sum([level.variation for level in self.levels]))
        if not np.isfinite(variation):
            return self.of_first(confidence)
        reach = np.sqrt(np.log1p(variation**2)) * float(ndtri(0.5 + 0.5 * confidence))
        return min(self.by_levels * float(np.exp(reach)), 1.0)

    def of_first(self, confidence: float) -> float:
        """Return what the first samples, which are independent, bound the probability by."""
        first = self.levels[0].before
        return float(of_probability(int(np.sum(first <= 0.0)), first.size, confidence)[1])


def level_size(n_left: int) -> int:
    """Return how many samples a level of subset simulation has, of those that are left."""
    return min(max(LEAST_OF_LEVEL, n_left // PART_OF_LEVEL), MOST_OF_LEVEL) // SHARE * SHARE


def find(
    limit_state: LimitState, d: int, n_samples: int, seed: int, slopes: Slopes | None = None, has_design: bool = True
) -> RareSamples:
    """Find and weigh the event ``g <= 0`` of d variables, with random numbers of a seed.

    The limit state is g of points (n, d), shape (n,); NaN where it is not known. It is evaluated at most `n_samples`
    times, at least 500, with those of `slopes`; those that subset simulation leaves are weighted. Slopes are g and its
    derivatives, for design points; None: from differences, where samples allow them. Without `has_design` no design
    points are looked for, which events of variables that step have none of.
    """
    chains = _Chains(limit_state, seed, d, n_samples, slopes, has_design)
    levels, directions, last = _levels(chains)
    design, weights, weighed = None, [], 0.0
    if levels:
        # those of the last level first, which know them best
        rays = np.concatenate([*directions[::-1], np.eye(d), -np.eye(d), *(-one for one in directions[::-1])])
        rays = rays[unlike(rays, NEARLY_ALIKE)][: chains.left // (2 * PART_OF_SAMPLES)]  # of STEPS one is followed
        chance = float(np.prod([level.share for level in levels]))
        weighed = levels[-1].threshold
        centres = entrances(lambda u: chains.evaluate(u) - weighed, rays, chance)
        nearest = last.points[np.argsort(np.sum(last.points**2, axis=1))[:1]]
        design = chains.design(np.concatenate([nearest, centres]), weighed) if has_design else None
        if design is not None and weighed > 0.0:
            beyond = chains.beyond(design)
            if beyond is not None:
                levels.append(Level(0.0, min(1.0, float(ndtr(-design.beta).sum()) / chance), beyond[2], last.values))
                n = len(beyond[0])
                last, weighed = importance.Cloud(beyond[0], np.ones(n), np.arange(n), beyond[1]), 0.0
                centres = centres[:0]
        if design is not None:
            centres = np.concatenate([design.points, apart(centres, design.points)])
        weights = chains.weigh(last, centres, weighed, design)
    elif np.isfinite(np.concatenate(chains.values)).any() and chains.left > 0:
        chains.evaluate(chains.random().standard_normal((chains.left, d)))
        weights = [np.ones(chains.values[-1].size)]
    found = RareSamples(
        tuple(levels),
        np.concatenate(chains.points),
        np.concatenate(chains.values),
        np.concatenate([np.zeros(0), *weights]),
        tuple(of_round.size for of_round in weights),
        weighed,
        design if weighed == 0.0 else None,  # else of the last level, not of the event
    )
    for level in levels[::-1] if weighed > 0.0 else ():
        found = replace(found, weighed=level.threshold)
        if found.n_effective >= ENOUGH:
            break  # of levels before the event the last one that enough samples are in bounds it
    return found


def _levels(chains: _Chains) -> tuple[list[Level], list[np.ndarray], importance.Cloud]:
    """Return the levels, the directions of the parts that they have seen, and the points of the last one, whose
    families are the chains of the level before that they stem from."""
    size = level_size(chains.left)
    least_left = max(LEAST_OF_LEVEL, chains.left // PART_WEIGHED)
    points = chains.random().standard_normal((size, chains.d))
    g = chains.evaluate(points)
    levels: list[Level] = []
    directions: list[np.ndarray] = []
    own = families = np.arange(size)  # the chains of this level that points are of, and those of the one before
    while len(levels) < MOST_LEVELS:
        size, g = level_size(chains.left), np.where(np.isnan(g), np.inf, g)
        if chains.left - size < least_left:
            break  # what would be left is too little to be weighed
        threshold, before = max(0.0, float(np.sort(g)[g.size // SHARE - 1])), g
        known = float(np.prod([level.share for level in levels]))
        passed, share, is_afar = np.flatnonzero(g <= threshold), None, False
        last = levels[-1].threshold if levels else np.inf
        if threshold > 0.0 and (threshold >= last or passed.size == g.size):
            passed = np.flatnonzero(g < threshold)
            if passed.size < FEWEST_SEEDS:
                afar = chains.from_afar(threshold, least_left)
                if afar is None:
                    break  # no nearer to the event
                points, g, own, chance = afar
                passed, is_afar = np.arange(len(points)), True
                share = min(max(chance, LEAST_CHANCE) / known, 1.0)
                if chains.left - size < least_left:
                    size = len(points)
            threshold = max(0.0, float(g[passed].max()))
        variation = np.nan
        if share is None:
            share = passed.size / before.size
            sums = np.bincount(own, weights=np.isin(np.arange(own.size), passed) - share)
            variation = float(np.sqrt(np.sum(sums**2)) / passed.size)
        families = own[passed][np.arange(size) % passed.size]
        points, g, accepted = chains.go_on(points[passed], g[passed], threshold, size)
        own = np.arange(size) % passed.size
        directions.append(directions_of(importance.Cloud(points, np.ones(size), own, g), chains.random()))
        levels.append(Level(threshold, share, accepted, before, is_afar, variation))
        if threshold == 0.0:
            break
    return levels, directions, importance.Cloud(points, np.ones(len(points)), families, g)


@dataclass(eq=False)
class _Chains:
    """Evaluates g, and keeps all points."""

    limit_state: LimitState
    seed: int
    d: int
    n_samples: int
    slopes: Slopes | None = None
    has_design: bool = True
    points: list[np.ndarray] = field(default_factory=list)
    values: list[np.ndarray] = field(default_factory=list)
    explained: DesignPoints | None = None  # design points that explain all samples from afar
    spread: float = 0.6  # of a step over the deviation of the points
    number: int = 0  # of the last random stream
    n_differentiated: int = 0

    @property
    def left(self) -> int:
        return self.n_samples - sum(part.size for part in self.values) - self.n_differentiated

    def go_on(
        self, seeds: np.ndarray, g: np.ndarray, threshold: float, size: int
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Return points (size, d) that pass a threshold, their g, and the share of accepted steps."""
        random = self.random()
        deviation = np.minimum(seeds.std(axis=0), 1.0) if len(seeds) >= FEWEST_SEEDS else np.ones(self.d)
        current, value = seeds, g
        points, values, accepted = [seeds], [g], []
        while sum(map(len, points)) < size:
            left = size - sum(map(len, points))
            current, value = current[:left], value[:left]
            sigma = np.minimum(self.spread * deviation, 1.0)
            candidate = np.sqrt(1.0 - sigma**2) * current + sigma * random.standard_normal(current.shape)
            found = self.evaluate(candidate)
            better = found <= threshold
            current, value = np.where(better[:, None], candidate, current), np.where(better, found, value)
            accepted.append(better.mean())
            self.spread *= np.exp((accepted[-1] - ACCEPTED) / np.sqrt(len(accepted)))
            points.append(current)
            values.append(value)
        return np.concatenate(points)[:size], np.concatenate(values)[:size], float(np.mean(accepted or [1.0]))

    def design(self, starts: np.ndarray, level: float) -> DesignPoints | None:
        """Return the design points that searches from some points lead to, with a part of the samples that are left;
        from differences where exact derivatives lead to none, and of a level on g by bisection where nor those do."""
        if self.explained is not None:
            return self.explained
        n_scanned, random = self.left // PART_SCANNED, self.random()
        self.evaluate(
            np.repeat(SCANNED, n_scanned)[:, None] * random.standard_normal((len(SCANNED) * n_scanned, self.d))
        )
        nearest = starts[np.argsort(np.sum(starts**2, axis=1))]
        units = nearest / np.maximum(np.sqrt(np.sum(nearest**2, axis=1, keepdims=True)), 1e-300)
        nearest, found = nearest[unlike(units)], None
        for slopes in (None,) if self.slopes is None else (self._differentiated, None):
            most, others = int(OF_DESIGN * self.left), (np.concatenate(self.points), np.concatenate(self.values))
            found = found or design_points(self.evaluate, slopes, nearest, most, others)
        if found is None:
            points, g = (np.concatenate(part) for part in (self.points, self.values))
            found = self._bisected(points[g <= level], level, self.left)
        return found

    def _bisected(self, inside: np.ndarray, level: float, n: int) -> DesignPoints | None:
        """Return the design points of a level on g by bisection from points within, with a part of n samples."""
        inside = inside[np.argsort(np.sum(inside**2, axis=1))]
        return bisected_design_points(lambda u: self.evaluate(u) <= level, inside, int(OF_DESIGN * n))

    def _differentiated(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return g and its derivatives, each of which counts as a sample."""
        self.n_differentiated += len(points)
        return self.slopes(points)

    def beyond(self, design: DesignPoints) -> tuple[np.ndarray, np.ndarray, float] | None:
        """Return points of the event from design points on, their g, and the share of accepted steps; None where the
        event does not lie there. At least half of the samples that are left is left to be weighed."""
        size = min(max(LEAST_OF_LEVEL, self.left // PART_OF_LEVEL), self.left // 2)
        seeds = self._beyond(design) if len(design.points) <= size else None
        return seeds and self.go_on(*seeds, 0.0, size)

    def _beyond(self, design: DesignPoints) -> tuple[np.ndarray, np.ndarray] | None:
        """Return points of the event beyond design points, and their g; None where there are none."""
        seeds = design.points + BEYOND * design.alpha
        g = self.evaluate(seeds)
        inside = g <= 0.0
        return (seeds[inside], g[inside]) if inside.any() else None

    def from_afar(self, level: float, to_be_left: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float] | None:
        """Return normal points with g below a level, shape (m, d), their g, the numbers of those they stem from, and
        the probability of that.

        None where samples of no deviation find any. Points that stem from the same one compete with each other alone:
        of parts of an event none is lost on the way. In d variables a step of the deviation by ``0.6 / sqrt(d)`` of it
        leaves about half of the samples their worth.
        """
        random, d = self.random(), self.d
        n = self.left - to_be_left
        best: tuple[float, np.ndarray, np.ndarray, int] | None = None
        of_event = np.zeros((0, d))
        for deviation in AFAR:
            each = min(max(LEAST_OF_LEVEL // 2, n // (3 * len(AFAR))), self.left)
            drawn = deviation * random.standard_normal((each, d))
            g = self.evaluate(drawn)
            below = g < level
            if below.any() and (best is None or len(best[1]) < min(FOUND, below.sum())):
                best = deviation, drawn[below], g[below], each
            of_event = np.concatenate([of_event, drawn[g <= 0.0]])
            if len(of_event) >= FOUND:
                break
        if best is None:
            return None
        if len(of_event) and self.has_design:
            found = self._bisected(of_event, 0.0, self.left - to_be_left)
            seeds = self._beyond(found) if found is not None and not found.is_open else None
            if seeds is not None:
                self.explained = found
                return *seeds, np.arange(len(seeds[0])), float(min(1.0, ndtr(-found.beta).sum()))
        deviation, points, g, each = best
        n_steps = 1.0 + np.log(deviation) * np.sqrt(d) / 0.6
        m = int(np.clip((self.left - to_be_left) / (2.0 * n_steps), LEAST_OF_LEVEL // 2, MOST_OF_LEVEL))
        points, g = points[:m], g[:m]
        n_first = len(points)
        chances = np.full(n_first, len(best[1]) / each)
        copies = max(1, m // n_first)
        points, g, m = np.repeat(points, copies, axis=0), np.repeat(g, copies), n_first * copies
        spread = self.spread
        while deviation > 1.0:
            if self.left < m:
                return None
            squares, smaller = np.sum(points**2, axis=1), _next_deviation(deviation, points)
            logs = d * np.log(deviation / smaller) - 0.5 * squares * (smaller**-2.0 - deviation**-2.0)
            worth = np.exp(logs - logs.max()).reshape(n_first, copies)
            chances *= worth.mean(axis=1) * np.exp(logs.max())
            sums = np.cumsum(worth, axis=1)
            places = (random.random((n_first, 1)) + np.arange(copies)) / copies * sums[:, -1:]
            drawn = np.sum(places[:, :, None] > sums[:, None, :-1], axis=2) + copies * np.arange(n_first)[:, None]
            deviation, points, g = smaller, points[drawn.ravel()], g[drawn.ravel()]
            sigma = min(spread, 1.0)
            candidate = np.sqrt(1.0 - sigma**2) * points + sigma * deviation * random.standard_normal(points.shape)
            found = self.evaluate(candidate)
            better = found < level
            points, g = np.where(better[:, None], candidate, points), np.where(better, found, g)
            spread = float(np.clip(spread * np.exp(better.mean() - ACCEPTED), 0.05, 1.0))
        return points, g, np.repeat(np.arange(n_first), copies), float(chances.mean())

    def weigh(
        self, last: importance.Cloud, entrances: np.ndarray, level: float, design: DesignPoints | None
    ) -> list[np.ndarray]:
        """Evaluate all points that are left from densities that the last points, of the event or of a level on g, make,
        and return the weights of all rounds but one.

        The first round is left out. Points of all rounds make the next density, each with the weight of the mixture of
        all densities so far (the balance heuristic: Owen and Zhou, Journal of the American Statistical Association 95
        (2000) 135-143). None where fewer than two samples a round are left.
        """
        if self.left < 2 * ROUNDS:
            return []
        centres, first, counts = np.unique(last.points, axis=0, return_index=True, return_counts=True)
        known = importance.levelled(centres, counts.astype(float), self.random())
        cloud = importance.Cloud(centres, known, last.families[first], last.values[first])
        of_chains = cloud._replace(weights=known / known.sum())
        sizes = np.full(ROUNDS, self.left // ROUNDS)
        sizes[-1] += self.left % ROUNDS
        before = 1.0 / np.unique(last.families).size  # share of the event not beyond the planes of design points
        weights, densities, inside, g_inside = [], [], np.zeros((0, self.d)), np.zeros(0)
        for size, share in zip(sizes, AT_ENTRANCES):
            random = self.random()
            density = importance.chosen_density(cloud, random)
            if design is not None:
                outside = ~np.any(cloud.points @ design.alpha.T >= design.beta, axis=1)
                now = float(np.average(outside, weights=cloud.weights))
                share += (AT_DESIGN - share) * (1.0 - now)
                before = max(before, now)
            density = density.with_kernels(entrances, share)
            if design is not None:
                share = (1.0 - before) / (1.0 - before + VARY * before)
                density = replace(density, alpha=design.alpha, beta=design.beta, beyond=share)
            densities.append(density)
            drawn = density.draw(size, random)
            found = self.evaluate(drawn)
            within = found <= level
            weights.append(np.exp(importance.log_normal(drawn) - density.log(drawn)))
            inside, g_inside = np.concatenate([inside, drawn[within]]), np.concatenate([g_inside, found[within]])
            if len(inside) >= ENOUGH:
                drawn_so_far = [np.log(m) + one.log(inside) for m, one in zip(sizes, densities)]
                own = np.exp(importance.log_normal(inside) - np.logaddexp.reduce(drawn_so_far, axis=0))
                own *= own.sum() / np.sum(own**2)  # how many equally weighted ones they are worth
                cloud = importance.Cloud(inside, own, len(last.points) + np.arange(len(inside)), g_inside)
                if own.sum() < ENOUGH:  # chains supply what is missing
                    cloud = cloud.with_further(of_chains._replace(weights=(ENOUGH - own.sum()) * of_chains.weights))
        roots = np.sqrt(np.arange(1, ROUNDS))
        roots /= np.average(roots, weights=sizes[1:])  # so that the mean of all weighted samples is the probability
        return [root * of_round for root, of_round in zip(roots, weights[1:])]

    def random(self) -> np.random.Generator:
        self.number += 1
        return stream(self.seed, OF_RARE, self.number)

    def evaluate(self, points: np.ndarray) -> np.ndarray:
        """Return g of points (n, d), shape (n,), and keep both."""
        found = self.limit_state(points) if len(points) else np.zeros(0)
        self.points.append(points)
        self.values.append(found)
        return found


def _next_deviation(deviation: float, points: np.ndarray) -> float:
    """Return the next smaller deviation, 1 at least, at which points are worth `OF_WORTH` of their number."""
    squares, precision = np.sum(points**2, axis=1), deviation**-2.0

    def is_enough(other: float) -> bool:
        worth = np.exp(-0.5 * (other - precision) * (squares - squares.min()))
        return bool(np.sum(worth) ** 2 >= OF_WORTH * len(points) * np.sum(worth**2))

    if is_enough(1.0):
        return 1.0
    low, high = precision, 1.0
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_enough(middle) else (low, middle)
    return high**-0.5


ALIKE = 0.8  # cosine of the angle between rays to the same part
NEARLY_ALIKE = 0.95  # between rays of which one sees what the other does
STEPS = 6  # evaluations of g on a ray: of 5.6 deviations a sixth of one is left
PART_OF_SAMPLES = 8  # rays take one of so many samples that are left, at most
RARER = 1e-3  # probability of a part over that of the event


def directions_of(cloud: importance.Cloud, random: np.random.Generator) -> np.ndarray:
    """Return unit vectors to the means of clusters of a level's points, shape (n_clusters, d) at most."""
    n_clusters = max(1, min(importance.CLUSTERS[-1], len(cloud.points) // importance.FEWEST))
    several, one = (importance.cluster_means(cloud, n, random)[0] for n in (n_clusters, 1))
    means = np.concatenate([one, several])
    norms = np.sqrt(np.sum(means**2, axis=1))
    return means[norms > 0.0] / norms[norms > 0.0, None]


def unlike(directions: np.ndarray, alike: float = ALIKE) -> list[int]:
    """Return the numbers of the directions (n, d) that are far from those before them: by the cosine `alike`."""
    kept: list[int] = []
    for number, direction in enumerate(directions):
        if all(direction @ directions[one] < alike for one in kept):
            kept.append(number)
    return kept


def apart(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the points (n, d) that are in none of the directions of others (m, d)."""
    units = [one / np.sqrt(np.sum(one**2, axis=1, keepdims=True)) for one in (points, others)]
    return points[np.all(np.einsum("nd,md->nm", *units) < ALIKE, axis=1)]


def entrances(
    limit_state: Callable[[np.ndarray], np.ndarray], directions: np.ndarray, probability: float
) -> np.ndarray:
    """Return points in the event near where rays along unit vectors (n, d) enter it, shape (n_entrances, d); of rays
    that do not, none.

    `limit_state` gives g of points (n, d), shape (n,), of all rays at once; the probability is that of the event, as
    nearly as it is known.
    """
    far = -float(ndtri(RARER * probability))
    if len(directions):
        most = -(-len(directions) // STEPS)
        directions = directions[limit_state(far * directions) <= 0.0]
        directions = directions[unlike(directions)][: max(most, 1)]
    before, within = np.zeros((len(directions), 1)), np.full((len(directions), 1), far)
    for _ in range(STEPS - 1 if len(directions) else 0):
        middle = 0.5 * (before + within)
        inside = limit_state(middle * directions)[:, None] <= 0.0
        before, within = np.where(inside, before, middle), np.where(inside, middle, within)
    return within * directions
