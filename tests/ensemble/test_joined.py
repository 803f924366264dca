"""Figures of the best of several models: against closed forms, repetition by hand, and truths that are known."""

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import minimize

from pgmp_petsc.ensemble import intervals, joined
from pgmp_petsc.ensemble.joined import PILOT, corrected, counts
from pgmp_petsc.ensemble.sampling import sobol

LEVEL = 0.95
REPETITIONS = 400
# of 400 repetitions at 95 %: 1 in 10,000 chances of fewer by luck
FEWEST_HELD = int(stats.binom(REPETITIONS, LEVEL).ppf(1e-4))


def models(random: np.random.Generator, sizes: tuple[int, ...], noise: float = 0.1) -> list[np.ndarray]:
    """Return values of models, each farther from the first, which has mean 0.3, deviation 1 and some noise."""
    x = random.normal(size=sizes[-1])
    best = 0.3 + (x + noise * random.normal(size=x.size)) / np.sqrt(1.0 + noise**2)
    others = [1.0 + 0.5 * k * x + 0.05 * k * random.normal(size=x.size) for k in range(1, len(sizes))]
    return [values[:n] for values, n in zip([best, *others], sizes)]


def test_a_model_that_is_known_from_another_is_known_as_well_as_that() -> None:
    x = np.random.default_rng(0).normal(size=1000)
    found = joined.mean_of([3.0 - 2.0 * x[:20], x])
    assert found.value == pytest.approx(3.0 - 2.0 * x.mean(), rel=1e-12)
    # what is left is the spread of 1000 values: in two strata of their own, 1 / 20 more of the first
    assert np.sqrt(found.variance) == pytest.approx(2.0 * x.std(ddof=1) / np.sqrt(1000), rel=0.02)
    np.testing.assert_allclose([found.coefficients[0], found.correlations[0]], [-2.0, -1.0], rtol=1e-12)


def test_with_two_models_it_is_the_regression_at_the_mean_of_all() -> None:
    y, x = models(np.random.default_rng(1), (30, 500))
    found = joined.mean_of([y, x])
    slope, intercept = np.polyfit(x[:30], y, 1)
    assert found.value == pytest.approx(intercept + slope * x.mean(), rel=1e-12)
    found = joined.mean_of([y, np.full(300, 7.0)])  # a constant model tells nothing
    assert (found.value, found.coefficients[0], found.correlations[0]) == (y.mean(), 0.0, 0.0)
    assert found.variance == pytest.approx(y.var(ddof=1) / 30, rel=1e-10)


@pytest.mark.parametrize("sizes", [(12, 100), (12, 12), (10, 40, 400), (10, 10, 41), (10, 40, 41)])
def test_the_variance_is_that_of_repetitions_without_each_sample(sizes: tuple[int, ...]) -> None:
    """Every sample is left out in turn, the strata keeping their weights, by a loop that knows nothing of formulas."""
    values = models(np.random.default_rng(2), sizes)
    edges = [0, *sizes]

    def estimate(strata: list[list[np.ndarray]]) -> float:
        """Strata hold the values of all models that have them; means of a model are weighted by full sizes."""

        def mean(model: int, last: int) -> float:
            of = [
                (np.mean(strata[j][model]), edges[j + 1] - edges[j]) for j in range(last + 1) if strata[j][model].size
            ]
            return sum(m * n for m, n in of) / sum(n for _, n in of)

        first = strata[0]
        total = mean(0, 0)
        for i in range(1, len(sizes)):
            cov = np.cov(first[0], first[i])
            total += cov[0, 1] / cov[1, 1] * (mean(i, i) - mean(i, i - 1))
        return total

    strata = [
        [values[i][edges[j] : edges[j + 1]] if i >= j else np.zeros(0) for i in range(len(sizes))]
        for j in range(len(sizes))
    ]
    found = joined.mean_of(values)
    assert found.value == pytest.approx(estimate(strata), rel=1e-10)
    variance = 0.0
    for j, stratum in enumerate(strata):
        n = edges[j + 1] - edges[j]
        if n < 2:
            continue
        repeated = []
        for left_out in range(n):
            changed = [np.delete(one, left_out) if one.size else one for one in stratum]
            repeated.append(estimate([*strata[:j], changed, *strata[j + 1 :]]))
        variance += (n - 1) / n * np.sum((repeated - np.mean(repeated)) ** 2)
    if 1 in np.diff(edges):  # one sample alone has the spread of the first stratum
        assert found.variance > variance
    else:
        assert found.variance == pytest.approx(variance, rel=1e-8)


@pytest.mark.parametrize("sizes", [(20, 1000), (100, 1000), (20, 100, 1000)])
def test_intervals_hold_as_often_as_they_say(sizes: tuple[int, ...]) -> None:
    random, held, widths = np.random.default_rng(3), 0, []
    for _ in range(REPETITIONS):
        values = models(random, sizes)
        low, high = joined.mean_of(values).interval(LEVEL)
        held += low <= 0.3 <= high
        widths.append((high - low) / np.ptp(intervals.of_mean(values[0], LEVEL)))
    assert FEWEST_HELD <= held <= REPETITIONS
    # sqrt(1 - rho^2 + rho^2 m / N) of the interval of the best alone, rho^2 = 1 / 1.01 of the first, less its noise
    best = np.sqrt(0.02 + sizes[0] / sizes[-1])
    assert np.median(widths) < 1.25 * best


def test_intervals_of_replicates_hold_and_are_narrow() -> None:
    """Two functions of two parameters at scrambled Sobol points: the cheap one's mean is known far better than of
    independent samples, and what the best one has besides, too."""
    held, widths, held_std = 0, [], 0
    true = np.array([1.0 + 0.1 / 3.0, np.nan])  # E(u + v + 0.1 u^2)
    fine = (np.arange(2000) + 0.5) / 2000
    u, v = np.meshgrid(fine, fine)
    true[1] = (u + v + 0.1 * u**2).std()
    for seed in range(100):
        u, v = sobol(seed, 2, 8)(0, 1024).T
        best, cheap, replicates = u + v + 0.1 * u**2, u + 0.9 * v, np.arange(1024) % 8
        values = [best[:64], cheap]
        found = joined.mean_of(values, replicates)
        low, high = found.interval(LEVEL)
        held += low <= true[0] <= high
        of_std = joined.deviation_of(values, found, LEVEL, replicates)[1]
        held_std += of_std[0] <= true[1] <= of_std[1]
        widths.append((high - low) / np.ptp(joined.mean_of(values).interval(LEVEL)))
    fewest = stats.binom(100, LEVEL).ppf(1e-4)
    assert held >= fewest and held_std >= fewest and np.median(widths) < 0.25


def test_intervals_of_deviations_hold_where_the_best_model_is_curved_and_skew() -> None:
    """Of ``y + y^2 / 20`` with y exponential, of variance ``1 + 0.4 + 0.05``."""
    random, held, repetitions = np.random.default_rng(8), 0, 200
    for _ in range(repetitions):
        cheap = random.exponential(size=4000)
        found = corrected([(cheap + 0.05 * cheap**2)[:200], cheap], LEVEL).figures["std"]
        held += found.interval[0] <= np.sqrt(1.45) <= found.interval[1]
    # fewer once in 100 times; without the parabola 180
    assert held >= stats.binom(repetitions, LEVEL).ppf(0.01)


def test_a_cheaper_model_counts_through_the_parabola_that_fits() -> None:
    random = np.random.default_rng(9)
    x = random.normal(3.0, 0.2, 500)
    best = 2.0 - x + 0.3 * x**2
    for n in (joined.FEWEST, 20):
        found = joined.mean_of(joined.calibrated([best[:n], x]))
        assert found.value == pytest.approx(best.mean(), rel=1e-12)
    noisy = best[:40] + 0.002 * random.normal(size=40)
    by_hand = np.polyval(np.polyfit(x[:40], noisy, 2), x)
    # but for what all have in common, which no figure knows of
    assert np.ptp(joined.calibrated([noisy, x])[1] - by_hand) < 1e-9


def test_a_curvature_that_explains_little_is_none() -> None:
    random = np.random.default_rng(10)
    x = random.normal(size=300)
    two = np.where(x > 0.0, 1.0, 0.0)
    for best, cheap in (
        (x[:100] + random.normal(size=100), x),
        (x[:100] + 0.05 * x[:100] ** 2 + 0.1 * random.normal(size=100), x),  # 5 standard errors, a third of the error
        # a quarter of the error of a straight line is not little enough with so few
        (x[:19] + 0.2 * x[:19] ** 2 + 0.12 * random.normal(size=19), x),
        (x[:100], np.full(300, 7.0)),
        (x[:100], two),
    ):
        assert joined.calibrated([best, cheap])[1] is cheap


def test_a_parabola_is_taken_by_its_predictions_of_each_sample_from_the_others() -> None:
    """Against polynomials that are fitted anew without each sample."""
    random, taken = np.random.default_rng(12), []
    for curvature in np.linspace(0.02, 0.3, 15):
        x = random.exponential(size=200)
        best = x[:40] + curvature * x[:40] ** 2 + 0.1 * random.normal(size=40)
        off = np.zeros(2)
        for k in range(40):
            others = np.arange(40) != k
            for degree in (1, 2):
                fit = np.polyfit(x[:40][others], best[others], degree)
                off[degree - 1] += (best[k] - np.polyval(fit, x[k])) ** 2
        taken.append(off[1] < joined.HALF * off[0])
        assert (joined.calibrated([best, x])[1] is not x) == taken[-1]
    assert any(taken) and not all(taken)


def test_intervals_of_deviations_hold_where_curvature_is_slight() -> None:
    """Of ``exp(0.3 x)`` and nearly that; with parabolas wherever they are significant 372 of 400."""
    random, held, true = np.random.default_rng(13), 0, np.sqrt(np.exp(0.18) - np.exp(0.09))
    for _ in range(REPETITIONS):
        x = random.normal(size=4000)
        found = corrected([np.exp(0.3 * x[:200]), np.exp(0.28 * x) + 0.05 * np.sin(3.0 * x)], LEVEL).figures["std"]
        held += found.interval[0] <= true <= found.interval[1]
    assert held >= stats.binom(REPETITIONS, LEVEL).ppf(0.01)


def test_the_variance_of_replicates_is_that_of_repetitions_without_each() -> None:
    random, numbers = np.random.default_rng(11), np.arange(400) % 4
    y, x = models(random, (40, 400))
    without = []
    for number in range(4):
        of_y, of_x = y[numbers[:40] != number], x[numbers != number]
        slope, intercept = np.polyfit(of_x[:30], of_y, 1)
        without.append(intercept + slope * of_x.mean())
    found = joined.mean_of([y, x], numbers)
    assert found.variance == pytest.approx(3.0 / 4.0 * np.sum((without - np.mean(without)) ** 2), rel=1e-9)
    assert found.freedom == 2  # four replicates, a mean and a coefficient
    assert joined.mean_of([y, x], numbers, 1).freedom == 1 == joined.mean_of([y, x], numbers % 2).freedom


def test_few_samples_have_no_interval_of_the_deviation() -> None:
    values = models(np.random.default_rng(5), (joined.FEWEST_OF_DEVIATION - 1, 500))
    value, ends = joined.deviation_of(values, joined.mean_of(values), LEVEL)
    assert 0.7 < value < 1.3 and np.isnan(ends).all()


def test_a_variance_that_comes_out_negative_is_not_known() -> None:
    """Where squares are x^2 - 1, and all further x are 0, the straight line leads below zero."""
    x = np.tile([1.0, -1.0, 3.0, -3.0], 15)
    values = [np.sign(x) * np.sqrt(x**2 - 1.0), np.concatenate([x, np.zeros(5000)])]
    value, ends = joined.deviation_of(values, joined.mean_of(values), LEVEL)
    assert np.isnan(value) and np.isnan(ends).all()


@pytest.mark.parametrize("sizes", [(200, 2000), (100, 400, 2000)])
def test_probabilities_hold_and_are_nearer_than_those_of_differences(sizes: tuple[int, ...]) -> None:
    random, held, limit, repetitions, off = np.random.default_rng(6), 0, stats.norm.isf(0.1), 200, []
    for _ in range(repetitions):
        best, *others = models(random, sizes, 0.5)
        true = [best - 0.3 > limit, *((one - 1.0) / (0.5 * k) > limit for k, one in enumerate(others, 1))]
        value, ends = joined.probability_of(true, LEVEL)
        held += ends[0] <= 0.1 <= ends[1]
        by_differences = np.mean(true[-1]) + sum(np.mean(a) - np.mean(b[: a.size]) for a, b in zip(true, true[1:]))
        off.append([value - 0.1, by_differences - 0.1])
    assert held >= stats.binom(repetitions, LEVEL).ppf(1e-4)
    errors = np.sqrt(np.mean(np.square(off), axis=0))
    assert errors[0] < errors[1]


def test_a_probability_is_the_likeliest_of_double_samples() -> None:
    """Against the maximum of the likelihood of all counts over the three probabilities (Tenenbein 1970)."""
    random = np.random.default_rng(14)
    cheap = random.random(1000) < 0.2
    best = np.where(random.random(100) < 0.1, ~cheap[:100], cheap[:100])

    def log_likelihood(logits: np.ndarray) -> float:
        p, a, b = 1.0 / (1.0 + np.exp(-logits))
        of_best = np.where(cheap[:100], np.where(best, a, 1.0 - a), np.where(best, b, 1.0 - b))
        return np.sum(np.log(np.where(cheap, p, 1.0 - p))) + np.sum(np.log(of_best))

    fine = {
        "xatol": 1e-8,
        "fatol": 1e-12,
    }  # by values alone: differences leave 1e-5 of it, less or more by the processor
    found = minimize(lambda x: -log_likelihood(x), np.zeros(3), method="Nelder-Mead", options=fine)
    p, a, b = 1.0 / (1.0 + np.exp(-found.x))
    assert joined.probability_of([best, cheap], LEVEL)[0] == pytest.approx(a * p + b * (1.0 - p), rel=1e-5)


def test_failed_draws_are_in_the_interval_of_a_probability_both_ways() -> None:
    """Half of the event fails in both models, and some of the better one's runs besides; the truth is 0.1."""
    random, held, held_of_others, repetitions = np.random.default_rng(15), 0, 0, 200
    limit, far = stats.norm.isf([0.1, 0.05])
    for _ in range(repetitions):
        x, e = random.normal(size=(2, 2000))
        best = (x + 0.05 * e)[:200] / np.sqrt(1.0 + 0.05**2)
        known = [(best < far) & (random.random(200) < 0.97), x < far]
        true = [(best > limit) & known[0], (x > limit) & known[1]]
        value, ends = joined.probability_with_failed(true, known, LEVEL)
        held += ends[0] <= 0.1 <= ends[1]
        each = known[0] & known[1][:200], np.concatenate([known[0] & known[1][:200], known[1][200:]])
        without = joined.probability_of([one[of] for one, of in zip(true, each)], LEVEL)
        held_of_others += without[1][0] <= 0.1 <= without[1][1]
        assert value == without[0]
    assert held >= stats.binom(repetitions, LEVEL).ppf(1e-4) and held_of_others < 0.9 * repetitions
    fine = [np.ones(one.size, dtype=bool) for one in true]
    plain = joined.probability_of(true, LEVEL)
    np.testing.assert_array_equal(joined.probability_with_failed(true, fine, LEVEL)[1], plain[1])


def test_agreement_of_few_samples_proves_little() -> None:
    same = np.zeros(10_000, dtype=bool)
    value, ends = joined.probability_of([same[:50], same], LEVEL)
    none_of_50 = 1.0 - 0.05 ** (1 / 50)
    assert value == 0.0 and ends[0] == 0.0 and ends[1] >= 0.999 * none_of_50
    # none of the few samples came true in the cheaper model: what it would be in the better one is not known
    value, ends = joined.probability_of([same[:50], np.arange(10_000) >= 9_000], LEVEL)
    assert value == 0.1 and ends[0] < 0.01 and ends[1] >= 0.1 + 0.9 * none_of_50 - 0.02


def test_a_share_has_the_interval_of_jeffreys() -> None:
    # Brown, Cai and DasGupta 2001: quantiles of the posterior of a Beta(1/2, 1/2)
    np.testing.assert_allclose(intervals.of_share(3, 20, 0.95), stats.beta(3.5, 17.5).ppf([0.025, 0.975]), rtol=1e-9)
    # none of 20 comes true with 5 % at the upper end
    low, high = intervals.of_share(0, 20, 0.95)
    assert low == 0.0 and (1.0 - high) ** 20 == pytest.approx(0.05, rel=1e-12)
    np.testing.assert_allclose(intervals.of_share(20, 20, 0.95), [1.0 - high, 1.0], rtol=1e-12)
    np.testing.assert_array_equal(intervals.of_share(0, 0, 0.95), [0.0, 1.0])


def test_the_allocation_is_the_best_that_a_budget_buys() -> None:
    """Against a search for the least variance of Peherstorfer et al. over all numbers of samples."""
    costs, rho = np.array([1.0, 0.05, 1e-3]), np.array([1.0, 0.995, 0.95])

    def variance(logs: np.ndarray) -> float:
        m = np.exp(logs) / (costs @ np.exp(logs))
        return 1.0 / m[0] - np.sum((1.0 / m[:-1] - 1.0 / m[1:]) * rho[1:] ** 2)

    shares = joined.allocation(costs, rho)
    best = minimize(variance, np.zeros(3), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-10})
    assert variance(np.log(shares)) == pytest.approx(best.fun, rel=1e-6)


def test_numbers_of_samples_for_a_budget() -> None:
    costs, rho = np.array([1.0, 1e-3]), np.array([1.0, 0.999])
    free = counts(costs, rho, [None, None], 200.0, 10**9)
    assert costs @ free == pytest.approx(200.0, rel=0.02) and free[0] > PILOT
    np.testing.assert_array_equal(counts(costs, rho, [None, 50_000], 200.0, 50_000), [150, 50_000])
    np.testing.assert_array_equal(counts(costs, rho, [40, None], 200.0, 10**9), [40, 160_000])
    assert counts(costs, rho, [None, 300_000], 200.0, 300_000) is None
    assert counts(costs, rho, [None, None], 1.0, 10**9) is None
    # where it takes a tenth of the budget, the deviation has an interval too, and the rest goes to the others
    cheap = counts(np.array([0.4, 1e-3]), np.array([1.0, 0.9999999]), [None, None], 200.0, 10**9)
    np.testing.assert_array_equal(cheap, [joined.FEWEST_OF_DEVIATION, 180_000])
    # no better model has more samples than a cheaper one
    np.testing.assert_array_equal(counts(costs, rho, [None, 20], 200.0, 20), [20, 20])
