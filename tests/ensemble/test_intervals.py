"""Confidence intervals: known numbers, and how often they hold the true figures of samples whose law is known."""

import numpy as np
import pytest
from scipy import stats

from pgmp_petsc.ensemble import intervals
from pgmp_petsc.ensemble.description import FEWEST_OF_TAIL, tail_remarks
from pgmp_petsc.ensemble.statistics import describe, of_event

LAWS = {"norm": stats.norm(3.0, 0.5), "expon": stats.expon(), "uniform": stats.uniform(), "beta": stats.beta(2.0, 5.0)}
PROBABILITIES = np.array([0.05, 0.5, 0.9])
LEVEL, REPETITIONS, N = 0.95, 200, 400
# A count of 200 draws with probability 0.95 leaves these limits once in 10,000 times; Bonett's interval of a skew law
# is short by a percent.
FEWEST, MOST = stats.binom(REPETITIONS, LEVEL - 0.01).ppf(1e-4), stats.binom(REPETITIONS, LEVEL + 0.01).ppf(1.0 - 1e-4)


@pytest.mark.parametrize("name", LAWS)
def test_intervals_hold_the_true_figures_as_often_as_they_say(name: str) -> None:
    law, random = LAWS[name], np.random.default_rng(7)
    limit = float(law.ppf(0.9))
    true = np.array([law.mean(), law.std(), *law.ppf(PROBABILITIES), 0.1])
    held = np.zeros(true.size, dtype=int)
    for _ in range(REPETITIONS):
        values = law.rvs(N, random_state=random)
        found = describe(values, 5, PROBABILITIES, confidence=LEVEL)
        chance = intervals.of_probability(int(np.sum(values > limit)), N, LEVEL)
        ends = np.array([found.mean_interval, found.std_interval, *found.quantile_intervals, chance])
        held += (ends[:, 0] <= true) & (true <= ends[:, 1])
    assert np.all((held >= FEWEST) & (held <= MOST)), f"{held} of {REPETITIONS}, {FEWEST} to {MOST} allowed"


def test_the_mean_of_a_sample_worked_out_by_hand() -> None:
    # t of 3 degrees of freedom at 0.975 is 3.18245, the deviation sqrt(5 / 3)
    reach = 3.182446305284263 * np.sqrt(5.0 / 3.0) / 2.0
    found = intervals.of_mean(np.array([1.0, 2.0, 3.0, 4.0]), 0.95)
    np.testing.assert_allclose(found, [2.5 - reach, 2.5 + reach], rtol=1e-12)


def test_deviations_of_100_skew_values_hold() -> None:
    """With the normal quantile in place of Student's 91.5 %, 1,830 of 2,000."""
    drawn, true, held = np.random.default_rng(5).exponential(size=(2000, 100)), 1.0, 0
    for values in drawn:
        low, high = intervals.of_deviation(values, LEVEL)
        held += low <= true <= high
    assert held >= stats.binom(2000, LEVEL - 0.01).ppf(1e-3)


def test_the_freedom_of_a_variance_is_that_of_its_spread() -> None:
    """The variance of n normal values has n - 1; of exponential ones, of kurtosis 9, 2 n / 8."""
    random = np.random.default_rng(6)
    assert intervals.freedom_of(random.normal(size=100_000), 99_999) == pytest.approx(100_000, rel=0.05)
    assert intervals.freedom_of(random.exponential(size=200_000), 199_999) == pytest.approx(50_000, rel=0.15)
    one = np.zeros(50)
    one[0] = 1.0
    assert 2.0 < intervals.freedom_of(one, 49) < 2.2  # one value that decides
    assert intervals.freedom_of(np.array([1.0, -1.0] * 5), 9) == intervals.freedom_of(np.ones(10), 9) == 9.0


def test_a_deviation_that_few_values_decide_on_is_told() -> None:
    random, chosen = np.random.default_rng(9), np.ones(400, dtype=bool)
    normal, heavy = random.normal(size=400), random.normal(size=400)
    heavy[:2] = 40.0, np.nan
    said = tail_remarks([("calm", normal), ("wild", heavy)], chosen)
    assert len(said) == 1 and "the deviation of wild rests on a few samples" in said[0].text
    chosen[0] = False
    assert tail_remarks([("wild", heavy), ("same", np.ones(400))], chosen) == ()
    assert tail_remarks([("few", heavy)], np.arange(400) < FEWEST_OF_TAIL) == ()
    assert tail_remarks([("none", np.full(400, np.nan))], chosen) == ()
    # evenly spread values of a heavy law, as Sobol points have them: none of them decides alone
    even = stats.lognorm(0.8).ppf((np.arange(400) + 0.5) / 400)
    assert tail_remarks([("even", even)], np.ones(400, dtype=bool)) == ()
    assert len(tail_remarks([("even", even)], np.ones(400, dtype=bool), np.arange(400) % 8)) == 1


@pytest.mark.parametrize("times", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("name", LAWS)
def test_means_and_deviations_of_a_robust_design_hold(name: str, times: float) -> None:
    """Of 64 samples, as many as a robust design has where nothing is said."""
    law, random, repetitions = LAWS[name], np.random.default_rng(13), 400
    true, held = law.mean() + times * law.std(), 0
    for _ in range(repetitions):
        low, high = intervals.of_mean_and_deviations(law.rvs(64, random_state=random), times, LEVEL)
        held += low <= true <= high
    # of exponential values three deviations hold in 92 %, as their deviation in 92 to 95 %
    assert held >= stats.binom(repetitions, LEVEL - (0.03 if name == "expon" else 0.01)).ppf(1e-4)
    values = law.rvs(64, random_state=random)
    np.testing.assert_allclose(
        intervals.of_mean_and_deviations(values, 0.0, LEVEL), intervals.of_mean(values, LEVEL), rtol=1e-12
    )
    assert np.isnan(intervals.of_mean_and_deviations(values[:1], times, LEVEL)).all()
    np.testing.assert_allclose(intervals.of_mean_and_deviations(np.full(9, 2.0), times, LEVEL), [2.0, 2.0])


def test_whole_ranks_are_those_of_the_binomial_distribution() -> None:
    """At a level that fits, the interval of the median ends at order statistics, whose chance is a binomial sum."""
    n, rank = 20, 6
    values = np.random.default_rng(1).normal(size=n)
    tail = stats.binom(n, 0.5).cdf(rank - 1)  # less than 6 values lie below the median
    found = intervals.of_quantiles(np.sort(values), [0.5], 1.0 - 2.0 * tail)[0]
    np.testing.assert_allclose(found, np.sort(values)[[rank - 1, n - rank]], rtol=1e-6)


@pytest.mark.parametrize("size", [3e7, 1e10])
def test_quantiles_of_sobol_sequences_are_worth_many_independent_values(size: float) -> None:
    """Ranks beyond 4e6, whose neighbouring numbers are more than 1e-9 apart, were searched for ever."""
    values = np.arange(1.0, 20_001.0) / 20_001.0
    found = intervals.of_quantiles(values, PROBABILITIES, LEVEL, np.full(PROBABILITIES.size, size))
    reach = stats.norm.ppf(0.975) * np.sqrt(PROBABILITIES * (1.0 - PROBABILITIES) / size)
    # the binomial distribution is skewed by a part of 1 / sqrt(size); beyond that shares are rounded to 1e-16
    expected = PROBABILITIES[:, None] + np.outer(reach, [-1.0, 1.0])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3 * reach.min())


def test_few_values_leave_ends_of_quantiles_open() -> None:
    found = intervals.of_quantiles(np.arange(10.0), [0.025, 0.5, 0.975], 0.95)
    assert found[0, 0] == -np.inf and found[2, 1] == np.inf
    assert np.isfinite([found[0, 1], *found[1], found[2, 0]]).all()
    np.testing.assert_array_equal(intervals.of_quantiles(np.empty(0), [0.5], 0.95), [[-np.inf, np.inf]])
    np.testing.assert_array_equal(intervals.of_quantiles(np.array([1.0]), [0.5], 0.95), [[-np.inf, np.inf]])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("n", [0, 1, 2, 3, 4, 5, 6])
@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.9999])
def test_what_too_few_values_do_not_say_is_unknown(n: int, confidence: float) -> None:
    values = np.random.default_rng(n).normal(size=n)
    assert np.isnan(intervals.of_mean(values, confidence)).all() == (n < 2)
    deviation = intervals.of_deviation(values, confidence)
    assert np.isnan(deviation).all() == (n < 5)
    assert n < 5 or deviation[0] <= np.std(values, ddof=1) <= deviation[1]


def test_a_probability_of_nothing_seen_is_not_known_to_be_nothing() -> None:
    low, high = intervals.of_probability(0, 50, 0.95)
    assert low == 0.0 and high == pytest.approx(1.0 - 0.025 ** (1 / 50), rel=1e-12)
    assert np.isnan(intervals.of_probability(0, 0, 0.95)).all()


@pytest.mark.filterwarnings("ignore:divide by zero")  # in scipy's test of a share of one half
@pytest.mark.parametrize(("count", "n"), [(0, 7), (3, 10_000), (66, 1847), (512, 512)])
def test_probabilities_have_the_exact_interval(count: int, n: int) -> None:
    exact = stats.binomtest(count, n).proportion_ci(LEVEL, "exact")
    np.testing.assert_allclose(intervals.of_probability(count, n, LEVEL), exact, rtol=1e-9)


def test_failed_samples_are_in_the_interval_both_ways() -> None:
    """Half of an event of probability 0.1 fails: the interval of the others is of 0.053, and holds never."""
    random, held, held_of_others = np.random.default_rng(11), 0, 0
    for _ in range(REPETITIONS):
        values = random.uniform(size=N)
        true, failed = values > 0.9, values > 0.95
        count, n, (low, high) = of_event(true & ~failed, ~failed, failed, None, LEVEL)
        assert (count, n) == (int(np.sum(true & ~failed)), int(np.sum(~failed)))
        held += low <= 0.1 <= high
        low, high = intervals.of_probability(count, n, LEVEL)
        held_of_others += low <= 0.1 <= high
    assert held >= FEWEST and held_of_others < REPETITIONS // 10
    np.testing.assert_allclose(
        intervals.of_probability(3, 90, LEVEL, 10),
        [stats.binomtest(k, 100).proportion_ci(LEVEL, "exact")[end] for end, k in enumerate((3, 13))],
        rtol=1e-9,
    )
    assert np.array_equal(intervals.of_probability(0, 0, LEVEL, 4), [0.0, 1.0])


N_SEQUENCES = 8


def sobol_points(n: int, d: int, random: np.random.Generator) -> np.ndarray:
    """Return n points of scrambled sequences in turn, (n, d)."""
    points = np.empty((n, d))
    for number in range(N_SEQUENCES):
        sequence = stats.qmc.Sobol(d, scramble=True, bits=30, seed=random)
        points[number::N_SEQUENCES] = sequence.random(n // N_SEQUENCES) + 0.5**31
    return points


def test_sobol_points_know_quantiles_and_probabilities_better_and_hold() -> None:
    """A sum of two normal variables; intervals of independent samples hold in all but a few, and are twice as wide."""
    random, n, places = np.random.default_rng(4), 512, np.arange(512) % N_SEQUENCES
    true, limit = stats.norm.ppf(PROBABILITIES), stats.norm.ppf(0.9)
    held, widths, known = np.zeros(4, dtype=int), np.zeros(4), np.ones(n, dtype=bool)
    for _ in range(REPETITIONS):
        values = stats.norm.ppf(sobol_points(n, 2, random)).sum(axis=1) / np.sqrt(2.0)
        for factor, replicates in ((1, places), (0, None)):
            found = describe(values, 1, PROBABILITIES, replicates=replicates).quantile_intervals
            ends = np.array([*found, of_event(values > limit, known, ~known, replicates, LEVEL)[2]])
            held += factor * ((ends[:, 0] <= [*true, 0.1]) & ([*true, 0.1] <= ends[:, 1]))
            widths += np.log(np.ptp(ends, axis=1)) * (1 if replicates is None else -1)
    assert np.all(held >= FEWEST), held
    assert np.all(np.exp(widths / REPETITIONS) > [1.1, 2.0, 1.6, 1.6])


def test_sobol_points_of_heavy_tails_are_not_sure_of_the_deviation() -> None:
    """Of a lognormal variable with s = 1 the spread between replicates alone holds in 72 % of samples of 512; the true
    deviation of a uniform one in 36 % where the variance of the mean is taken for that of independent values."""
    random, places, law = np.random.default_rng(8), np.arange(512) % N_SEQUENCES, stats.lognorm(1.0)
    held = np.zeros(3, dtype=int)
    for _ in range(REPETITIONS):
        uniform = sobol_points(512, 1, random)[:, 0]
        for k, (values, true) in enumerate(
            ((law.ppf(uniform), law.std()), (uniform, 12.0**-0.5), (stats.norm.ppf(uniform), 1.0))
        ):
            low, high = describe(values, 1, (), replicates=places).std_interval
            held[k] += low <= true <= high
    assert np.all(held >= FEWEST), held


def test_replicates_that_agree_leave_room_for_one_sample() -> None:
    """Eight times 3 of 64: counts may be 3 or 4 with a chance of 0.37 that eight replicates do not show."""
    low, high = intervals.of_probability(np.full(8, 3), np.full(8, 64), LEVEL)
    assert low < 3 / 64 - 0.3 / 64 and high > 3 / 64 + 0.3 / 64 and high - low < 1.0 / 64
    none = intervals.of_probability(np.zeros(8, dtype=int), np.full(8, 64), LEVEL)
    np.testing.assert_allclose(none, intervals.of_probability(0, 512, LEVEL))
    low, high = intervals.of_probability(np.full(8, 3), np.full(8, 64), LEVEL, np.full(8, 10))
    assert low < 3 / 74 and high > 13 / 74


def test_the_spread_between_replicates_is_that_of_the_mean() -> None:
    """Two replicates that hardly differ: the interval knows it, that of independent values does not."""
    half = np.linspace(0.0, 1.0, 101)
    values, numbers = np.concatenate([half, half + 1e-3]), np.repeat([0, 1], 101)
    found = describe(values, 5, [0.5], replicates=numbers)
    # mean 0.5005, spread of two means 1e-3 / sqrt(2), t of one degree of freedom 12.706
    np.testing.assert_allclose(found.mean_interval, 0.5005 + 12.706204736 * 0.5e-3 * np.array([-1.0, 1.0]), rtol=1e-9)
    assert found.mean_standard_error == pytest.approx(0.5e-3, rel=1e-9)
    assert describe(values, 5, [0.5]).mean_standard_error > 0.02
    for lone in (np.zeros(202), np.arange(202)):
        unknown = describe(values, 5, [0.5], replicates=lone)
        assert np.isnan([*unknown.mean_interval, *unknown.std_interval, unknown.mean_standard_error]).all()
