"""Rare events of limit states whose probability is known, and what is said where it is not found."""

import numpy as np
import pytest
from mpi4py import MPI
from refusals import refusal
from scipy.integrate import quad, trapezoid
from scipy.stats import binom, chi2, multivariate_normal, norm

from benchmarks.limit_states import limit_states
from pgmp_petsc.api.ensembles import choose
from pgmp_petsc.base.errors import InputError
from pgmp_petsc.ensemble import importance, rare_events
from pgmp_petsc.ensemble.importance import design_points
from pgmp_petsc.ensemble.rare_run import event_of, rare_remarks
from scenes import slider_crank

OF_SUM = 2.6676243  # beta of 6 = exp(0.3 u_1) + exp(0.6 u_2)
ONE_IN_A_THOUSAND = 1e-3
ONE_IN_TEN_THOUSAND = float(norm.isf(1e-4))
OUTPUT = 'outputs.push={type="deformation", point="rod:tip", axis="x"}'


def plane(d: int, distance: float) -> rare_events.LimitState:
    return lambda u: distance - u.sum(axis=1) / np.sqrt(d)


def bowl(d: int, bend: float) -> tuple[rare_events.LimitState, float]:
    """Return ``3 - u_1 + bend/2 sum_2^d u_i^2`` and its probability, by quadrature over the chi-squared law of the
    sum."""
    chance = quad(lambda s: norm.sf(3.0 + 0.5 * bend * s) * chi2.pdf(s, d - 1), 0.0, 80.0, points=[1, 5, 20], limit=200)
    return lambda u: 3.0 - u[:, 0] + 0.5 * bend * np.sum(u[:, 1:] ** 2, axis=1), chance[0]


def circle(u: np.ndarray) -> np.ndarray:
    return np.sqrt(chi2.isf(1e-4, 2)) - np.hypot(u[:, 0], u[:, 1])


def far(d: int, chance: float = 1e-6) -> rare_events.LimitState:
    return plane(d, float(norm.isf(chance)))


#: Parameters, limit state, probability, how many seeds, and how far off the estimates may be: measured half as much.
CASES = {
    "plane, 12 parameters": (12, far(12, 1e-4), 1e-4, 3, 0.2),
    "bowl": (6, *bowl(6, 0.2), 3, 0.2),
    "all around": (2, circle, 1e-4, 3, 0.2),
    # constant nearly everywhere: levels found no threshold below the constant, and gave up after 620 of 5,000 runs
    "indicator": (10, lambda u: np.where(far(10)(u) <= 0.0, -0.5, 0.5), 1e-6, 4, 0.25),
    "plateau": (2, lambda u: np.minimum(far(2)(u), 1.0), 1e-6, 4, 0.25),
    "stairs": (10, lambda u: np.ceil(far(10)(u) / 1.5), 1e-6, 4, 0.25),
    # levels of 620 samples each came to an end at 1e-6, whatever their number in all
    "plane at 1e-9": (2, far(2, 1e-9), 1e-9, 2, 0.3),
    "plane at 1e-9, 50 parameters": (50, far(50, 1e-9), 1e-9, 2, 0.3),
    # bends towards the origin, wider than a standard normal density: with kernels of that width 42 of 50 intervals held
    "paraboloid": (*next(one[1:] for one in limit_states(1e-9) if one[0] == "paraboloid, bend -0.1"), 1e-9, 5, 0.45),
}


@pytest.mark.parametrize("case", CASES)
def test_a_probability_is_known_from_5000_samples(case: str) -> None:
    d, limit_state, exact, n, share = CASES[case]
    found = [rare_events.find(limit_state, d, 5000, seed) for seed in range(n)]
    assert all(one.limit_state.size <= 5000 for one in found)
    # of the stairs 94 of 100; others are bounded
    found = [one for one in found if one.reached]
    assert len(found) >= (n if n < 4 else n - 1)
    estimates = np.array([one.probability for one in found]) / exact
    assert np.sqrt(np.mean((estimates - 1.0) ** 2)) < share
    held = sum(one.interval(0.95)[0] <= exact <= one.interval(0.95)[1] for one in found)
    assert held >= binom(len(found), 0.95).ppf(1e-3 if n > 3 else 1e-4)


def both_sides(u: np.ndarray) -> np.ndarray:
    return norm.isf(0.5 * ONE_IN_A_THOUSAND) - np.abs(u[:, 0])


def test_the_estimated_variation_is_that_of_repeated_runs() -> None:
    found = [rare_events.find(both_sides, 2, 1000, seed) for seed in range(20)]
    np.testing.assert_array_equal(found[3].points, rare_events.find(both_sides, 2, 1000, 3).points)
    assert found[3].probability != found[4].probability
    np.testing.assert_allclose(found[0].design.beta, norm.isf(0.5e-3), rtol=1e-3)
    assert sorted(np.sign(found[0].design.points[:, 0])) == [-1.0, 1.0]
    spread = np.std([one.probability for one in found], ddof=1) / ONE_IN_A_THOUSAND
    # the deviation of 20 values is known to 16 %, three times that
    assert np.sqrt(np.mean([one.variation**2 for one in found])) == pytest.approx(spread, rel=0.49)
    mean = np.mean([one.probability for one in found])
    assert mean == pytest.approx(ONE_IN_A_THOUSAND, rel=3 * spread / np.sqrt(20))
    ends = np.array([one.interval(0.95) for one in found])
    held = np.sum((ends[:, 0] <= ONE_IN_A_THOUSAND) & (ONE_IN_A_THOUSAND <= ends[:, 1]))
    assert held >= binom(20, 0.95).ppf(1e-4)


def test_rounds_but_the_first_make_the_probability() -> None:
    found = rare_events.find(plane(2, 3.0), 2, 1001, 4)
    n_levels = 1001 - sum(found.rounds) - min(found.rounds)
    assert len(found.rounds) == 3 and found.weights.size == sum(found.rounds)
    np.testing.assert_array_equal(found.contributions > 0.0, found.limit_state[-found.weights.size :] <= 0.0)
    # square roots of their numbers: weights phi / q are the same but for 1, sqrt(2), sqrt(3)
    each = np.split(found.contributions, np.cumsum(found.rounds)[:-1])
    roots = np.sqrt([1.0, 2.0, 3.0]) / np.average(np.sqrt([1.0, 2.0, 3.0]), weights=found.rounds)
    estimates = np.array([one.mean() for one in each]) / roots
    errors = np.array([one.std() / np.sqrt(one.size) for one in each]) / roots
    assert np.all(np.abs(estimates - norm.sf(3.0)) < 4.0 * errors) and n_levels > 0
    variance = np.sum((roots * found.rounds / sum(found.rounds) * errors) ** 2)
    assert found.variation * found.probability == pytest.approx(np.sqrt(variance), rel=0.02)  # ddof of 60 and more


def test_an_event_that_is_not_rare_is_weighed_as_well() -> None:
    found = rare_events.find(plane(2, 0.5), 2, 1000, 3)
    assert abs(found.probability - norm.sf(0.5)) < 4.0 * found.variation * found.probability
    assert len(found.levels) == 1 and found.interval(0.95)[1] <= 1.0
    sure = [rare_events.find(plane(1, -9.0), 1, 1000, seed) for seed in range(4)]
    assert max(one.contributions.mean() for one in sure) > 1.0  # but none is more than sure
    assert max(one.probability for one in sure) == max(one.at_most for one in sure) == 1.0


def test_an_impossible_event_is_bounded_with_all_runs() -> None:
    for limit_state in (lambda u: np.ones(len(u)), lambda u: 1.0 + np.abs(u[:, 0])):
        found = rare_events.find(limit_state, 2, 1000, 1)
        assert not found.reached and np.isnan(found.probability) and found.limit_state.size <= 1000
        low, high = found.interval(0.95)
        assert low == 0.0 < high < 0.04  # of 125 samples at least, none of which is in it
        said = rare_remarks(found, np.zeros(1000), True)
        assert f"at most {high:.3g} (95 %)" in said[0].text and said[0].kind == "warning"
        by_first = not found.is_plain and high >= found.of_first(0.95)
        assert by_first == ("120 plain random samples, before the first of them, bound its" in said[0].text)
    beyond = rare_events.find(lambda u: np.where(u[:, 0] < 6.0, 9.0 - np.ceil(2.0 * u[:, 0]) / 2.0, 1.0), 2, 1000, 1)
    assert not beyond.reached and beyond.levels and beyond.design is None  # those of a level are not the event's
    assert not rare_events.find(lambda u: np.full(len(u), np.nan), 2, 1000, 1).limit_state.size > 700
    nothing = rare_events.RareSamples((), np.zeros((2, 1)), np.full(2, np.nan), np.zeros(0), ())
    said = rare_remarks(nothing, np.ones(2), True)[0].text
    assert "not reached by 0 levels of subset simulation: it is rarer" in said


def test_an_event_that_nothing_leads_to_is_counted_by_plain_samples() -> None:
    """Of a thin slab near the origin samples from farther out find less than plain ones."""
    exact = float(np.diff(norm.cdf([0.5, 0.508]))[0])
    found = [
        rare_events.find(lambda u: np.where(np.abs(u[:, 0] - 0.504) < 0.004, -1.0, 1.0), 3, 3000, seed)
        for seed in range(5)
    ]
    ends = np.array([one.interval(0.95) for one in found])
    assert np.sum((ends[:, 0] <= exact) & (exact <= ends[:, 1])) >= 4
    assert all(one.limit_state.size > 2990 for one in found)
    for one in [one for one in found if one.is_plain and one.reached]:
        assert one.probability == np.mean(one.contributions)
        assert "plain random samples are in it" in rare_remarks(one, np.zeros(3000), True)[0].text


def test_an_event_that_is_worth_nothing_is_bounded() -> None:
    """An indicator in 50 variables whose values step, so that it has no design points: few samples weigh all."""
    beyond = plane(50, float(norm.isf(1e-6)))
    event = lambda u: np.where(beyond(u) <= 0.0, -1.0, 1.0)  # noqa: E731
    found = [rare_events.find(event, 50, 5000, seed, has_design=False) for seed in range(2)]
    weak = [one for one in found if one.is_weak]
    assert weak and all(one.interval(0.95)[0] == 0.0 < 1e-6 < one.interval(0.95)[1] < 0.01 for one in weak)
    said = rare_remarks(weak[0], np.zeros(5000), True)[0].text
    assert said.startswith("the event was found, but its") and "of which no probability follows" in said


def test_the_border_of_an_indicator_in_50_variables_is_found_by_bisection() -> None:
    """Without it samples told nothing: the event was bounded by 0.006."""
    turned = np.linalg.qr(np.random.default_rng(3).standard_normal((50, 50)))[0]
    for parts in (1, 2):
        b = norm.isf(1e-9 / parts)
        along = (lambda u: u @ turned[:, 0]) if parts == 1 else (lambda u: np.abs(u @ turned[:, 0]))
        found = [rare_events.find(lambda u: np.where(along(u) >= b, -1.0, 1.0), 50, 8000, seed) for seed in range(2)]
        for one in (each for each in found if each.reached):
            np.testing.assert_allclose(one.design.beta, b, atol=0.35)
            assert abs(one.probability / 1e-9 - 1.0) < 4.0 * max(one.variation, 0.05)
        assert any(one.reached for one in found)


def test_all_of_twenty_parts_are_found_and_more_than_can_be_are_not_decided() -> None:
    """Of a box in 10 variables 9 to 15 parts were found, and 39 of 100 intervals held."""
    turned = np.linalg.qr(np.random.default_rng(4).standard_normal((20, 20)))[0]
    for d, n_samples in ((10, 5000), (20, 3000)):
        b = float(norm.isf(-0.5 * np.expm1(np.log1p(-1e-9) / d)))
        one = rare_events.find(lambda u: b - np.abs(u @ turned[:d, :d] if d == 20 else u).max(axis=1), d, n_samples, 11)
        low, high = one.interval(0.95)
        assert low < 1e-9 < high
        if d == 10:
            assert one.design.beta.size == 20 and one.variation < 0.1 and one.reached
        else:
            assert one.may_have_lost_parts and not one.reached and np.isnan(one.probability)
            assert rare_remarks(one, np.zeros(n_samples), True)[0].text.startswith("not decided: the event has parts")


@pytest.mark.parametrize("exact", [True, False])
def test_design_points_are_the_nearest_ones_of_the_border(exact: bool) -> None:
    """Of a paraboloid that bends away, of a plane in 20 variables, and of a lognormal sum whose point another program
    (OpenTURNS 1.27, AbdoRackwitz) gives."""

    def searched(g, slope, starts, most=4000):
        return design_points(g, (lambda u: (g(u), slope(u))) if exact else None, np.atleast_2d(starts), most)

    for bend in (0.3, -0.1):

        def bent(u, bend=bend):
            return 3.0 - u[:, 0] + 0.5 * bend * np.sum(u[:, 1:] ** 2, axis=1)

        def of_bent(u, bend=bend):
            return np.column_stack([-np.ones(len(u)), bend * u[:, 1:]])

        found = searched(bent, of_bent, [3.2, 1.0, -0.5])
        np.testing.assert_allclose(found.points[0], [3.0, 0.0, 0.0], atol=0.02)
        assert found.beta[0] == pytest.approx(3.0, abs=1e-3) and found.is_exact == exact
        np.testing.assert_allclose(found.alpha[0], [1.0, 0.0, 0.0], atol=0.01)
    far = searched(plane(20, 6.0), lambda u: np.full(u.shape, -1.0 / np.sqrt(20.0)), np.ones(20))
    assert far.beta[0] == pytest.approx(6.0, rel=1e-6) and far.n_runs <= (2 if exact else 42) + 21

    def total(u):
        return 6.0 - np.exp(0.3 * u[:, 0]) - np.exp(0.6 * u[:, 1])

    def of_total(u):
        return -np.column_stack([0.3 * np.exp(0.3 * u[:, 0]), 0.6 * np.exp(0.6 * u[:, 1])])

    found = searched(total, of_total, [1.0, 2.0])
    assert found.beta[0] == pytest.approx(OF_SUM, abs=2e-4)
    assert searched(total, lambda u: np.zeros(u.shape), [[np.nan, 1.0]]) is None
    assert searched(lambda u: np.ones(len(u)), lambda u: np.zeros(u.shape), [[1.0, 1.0]]) is None
    assert searched(total, lambda u: np.zeros(u.shape), [[1.0, 1.0]], most=3) is None


def test_slopes_that_are_given_count_as_samples_and_differences_stand_in_where_they_fail() -> None:
    asked: list[int] = []

    def slopes(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked.append(len(u))
        return plane(3, 4.0)(u), np.full(u.shape, -1.0 / np.sqrt(3.0))

    found = rare_events.find(plane(3, 4.0), 3, 1000, 1, slopes)
    assert found.design.is_exact and asked and found.limit_state.size + sum(asked) == 1000
    without = rare_events.find(plane(3, 4.0), 3, 1000, 1, lambda u: (np.full(len(u), np.nan), np.full(u.shape, np.nan)))
    assert not without.design.is_exact and without.design.beta[0] == pytest.approx(4.0, rel=1e-3)


@pytest.mark.parametrize("chance", [1e-2, 1e-5])
def test_what_a_shift_of_the_border_makes_of_a_probability_is_known(chance: float) -> None:
    """Along the curve of few levels it was taken for 0.2 to 3 times as much."""
    beta, radius = norm.isf(chance), np.sqrt(chi2.isf(chance, 6))
    cases = (
        (plane(6, beta), lambda p: beta - norm.isf(p)),
        (lambda u: radius - np.sqrt(np.sum(u**2, axis=1)), lambda p: radius - np.sqrt(chi2.isf(p, 6))),
        (lambda u: np.exp(beta) - np.exp(u[:, 0]), lambda p: np.exp(beta) - np.exp(norm.isf(p))),
    )
    for limit_state, shift in cases:
        found = [rare_events.find(limit_state, 6, 1500, seed) for seed in range(3)]
        for times in (0.5, 1.2, 2.0):
            said = np.mean([np.log(one.factor_of(shift(times * chance))) for one in found])
            # hazards that rise or fall beyond the border: 4 to 15 %, and 5 % of three runs
            assert said == pytest.approx(np.log(times), rel=0.25)
    assert rare_events.find(plane(2, 3.0), 2, 1500, 1).factor_of(1e9) == pytest.approx(np.exp(20.0))
    steps = rare_events.find(lambda u: np.where(plane(2, 3.0)(u) <= 0.0, -0.5, 0.5), 2, 1500, 1)
    assert steps.factor_of(0.2) == steps.factor_of(-0.2) == 1.0


@pytest.mark.parametrize(("d", "n"), [(2, 500), (5, 500), (10, 600), (20, 1000)])
def test_few_samples_for_many_parameters_end_with_a_bound(d: int, n: int) -> None:
    """From a design point beyond the last level more samples were taken than were left."""
    for seed in range(3):
        one = rare_events.find(plane(d, float(norm.isf(1e-9))), d, n, seed)
        low, high = one.interval(0.95)
        assert one.limit_state.size <= n and low < 1e-9 < high

    def steps(u: np.ndarray) -> np.ndarray:
        assert len(u)  # as runs have it: samples that look for steps may leave none
        return np.round(plane(d, 4.0)(u))

    assert rare_events.find(steps, d, n, 1).limit_state.size <= n
    assert not rare_events._Chains(plane(2, 3.0), 1, 2, 7).weigh(
        importance.Cloud(np.ones((3, 2)), np.ones(3), np.arange(3), np.ones(3)), np.ones((0, 2)), 0.0, None
    )


def test_failed_samples_count_as_not_in_the_event_and_bound_it() -> None:
    def limit_state(u: np.ndarray) -> np.ndarray:
        return np.where(u[:, 1] > 0.5, np.nan, plane(2, 3.5)(u))

    found = rare_events.find(limit_state, 2, 3000, 2)
    assert np.isnan(found.limit_state).any() and found.probability < norm.sf(3.5) < found.at_most


def test_the_curve_of_the_levels_falls_along_the_true_one() -> None:
    values, probabilities = rare_events.find(plane(1, ONE_IN_TEN_THOUSAND), 1, 5000, 1).curve()
    assert np.all(np.diff(values) <= 0.0) and probabilities[0] == 1.0
    # each level of 500 samples adds 13 % (0.3 / sqrt(500) / 0.1), chains somewhat more
    exact = norm.sf(ONE_IN_TEN_THOUSAND - values[::50])
    assert np.all(np.abs(np.log(probabilities[::50] / exact)) < 1.0)


def test_kernels_with_covariances_have_their_density_and_draw_by_it() -> None:
    root = np.array([[1.5, 0.4], [0.4, 0.9]])
    density = importance.KernelDensity(
        np.array([[2.0, 1.0], [-4.0, 0.0]]), np.array([0.6, 0.4]), np.ones(2), root[None]
    )
    both = multivariate_normal([2.0, 1.0], root @ root), multivariate_normal([-4.0, 0.0], np.eye(2))
    points = np.random.default_rng(1).normal(0.0, 3.0, (50, 2))
    exact = 0.6 * both[0].pdf(points) + 0.4 * both[1].pdf(points)
    np.testing.assert_allclose(np.exp(density.log(points)), exact, rtol=1e-12)
    drawn = density.draw(40_000, np.random.default_rng(2))
    own = drawn[drawn[:, 0] > 4.0]
    # of the share beyond a line four standard errors
    share = 0.6 * norm.sf(2.0 / np.sqrt((root @ root)[0, 0]))
    assert len(own) / 40_000 == pytest.approx(share, abs=4.0 * np.sqrt(share / 40_000))


def test_all_design_points_of_a_series_in_10_variables_are_found_at_1e_9() -> None:
    """Four searches went to the nearest entrances, two of which were often of the same part."""
    name, d, limit_state = next(one for one in limit_states(1e-9) if one[:2] == ("series of four", 10))
    turned = np.linalg.qr(np.random.default_rng(7).standard_normal((d, d)))[0]
    for seed in range(3):
        assert rare_events.find(lambda u: limit_state(u @ turned), d, 5000, seed).design.beta.size == 4


def cloud_of(points: np.ndarray, families: np.ndarray | None = None) -> importance.Cloud:
    """Return points that count alike, of independent families unless these are given, whose g is not known."""
    n = len(points)
    return importance.Cloud(points, np.ones(n), np.arange(n) if families is None else families, np.zeros(n))


def test_the_chosen_density_wastes_little_on_a_plane_and_on_a_ring() -> None:
    random = np.random.default_rng(4)
    beyond = random.standard_normal((400, 6))
    beyond[:, 0] = ONE_IN_TEN_THOUSAND + random.exponential(1.0 / ONE_IN_TEN_THOUSAND, 400)
    angle, radius = random.uniform(0.0, 2.0 * np.pi, 400), np.sqrt(chi2.isf(1e-4, 2))
    ring = (radius + random.exponential(0.25, 400))[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    events = ((beyond, lambda u: u[:, 0] > ONE_IN_TEN_THOUSAND), (ring, lambda u: np.hypot(*u.T) > radius))
    for points, inside in events:
        density = importance.chosen_density(cloud_of(points), random)
        drawn = density.draw(4000, random)
        weights = np.where(inside(drawn), np.exp(importance.log_normal(drawn) - density.log(drawn)), 0.0)
        assert weights.mean() == pytest.approx(1e-4, rel=4.0 * weights.std() / weights.mean() / np.sqrt(4000))
        # a normal density about the nearest point of a plane has 1.9 (square root of sqrt(2 pi) 3.7 / 2 - 1)
        assert weights.std() / weights.mean() < 4.0


def test_outside_of_a_ball_is_drawn_from_where_it_is_all_of_the_event() -> None:
    """Weights are the probability of outside then, but for the defensive kernels: a plain share of 0.8."""
    random, d, chance = np.random.default_rng(6), 6, 1e-4
    radii = np.sqrt(chi2.isf(chance * (1.0 - random.random(400)), d))
    directions = random.standard_normal((400, d))
    points = radii[:, None] * directions / np.linalg.norm(directions, axis=1)[:, None]
    density = importance.chosen_density(cloud_of(points), random)
    assert density.share == pytest.approx(0.8) and density.outside >= chance
    drawn = density.draw(4000, random)
    within = np.sum(drawn**2, axis=1) >= chi2.isf(chance, d)
    weights = np.where(within, np.exp(importance.log_normal(drawn) - density.log(drawn)), 0.0)
    assert weights.mean() == pytest.approx(chance, rel=4.0 * weights.std() / weights.mean() / np.sqrt(4000))
    assert weights.max() <= 1.0000001 * density.outside / density.share and weights.std() < weights.mean()


def test_two_sides_in_20_variables_are_known_and_their_variation_too() -> None:
    """With means as they come, and clusters as large as chains left them, errors were 39 % and 22 % were said."""
    found = [rare_events.find(lambda u: norm.isf(0.5e-4) - np.abs(u[:, 0]), 20, 5000, seed) for seed in range(3)]
    estimates = np.array([one.probability for one in found]) / 1e-4
    # measured 2 % with either said; a side that is missed is half
    assert np.median(np.abs(estimates - 1.0)) < 0.12
    assert 0.01 < np.median([one.variation for one in found]) < 0.12


def test_rays_enter_an_event_near_its_border_or_not_at_all() -> None:
    evaluated = []

    def limit_state(u: np.ndarray) -> np.ndarray:
        evaluated.append(len(u))
        return np.where(u[:, 1] < -3.0, np.nan, norm.isf(1e-4) - np.abs(u[:, 0]))

    slanted = np.array([0.79, np.sqrt(1.0 - 0.79**2)])
    rays = np.array([[1.0, 0.0], [-1.0, 0.0], slanted, [0.0, 1.0], [0.0, -1.0]])
    # one of six is followed, none in the direction of another
    found = rare_events.entrances(limit_state, np.concatenate([rays[:3], 10 * [rays[3]], 5 * [rays[4]]]), 1e-4)
    distances = norm.isf(1e-4) * np.array([1.0, 1.0, 1.0 / 0.79])
    # bisection leaves a 32nd of the way to where a plane has a thousandth of the probability
    off = np.linalg.norm(found, axis=1) - distances
    assert np.all(off >= 0.0) and np.all(off <= norm.isf(1e-7) / 32)
    np.testing.assert_allclose(found / np.linalg.norm(found, axis=1)[:, None], rays[:3], rtol=1e-12)
    assert evaluated == [18, 3, 3, 3, 3, 3]
    # a level that is farther than a part of a thousandth is left
    assert rare_events.entrances(plane(2, 5.5), np.eye(2), 1e-4).shape == (0, 2)
    assert rare_events.entrances(limit_state, np.zeros((0, 2)), 1e-4).shape == (0, 2) and len(evaluated) == 6


def test_all_parts_of_a_series_in_10_variables_have_their_shares() -> None:
    """Chains alone lost one of the four in a quarter of the runs, and left another to a few heavy samples."""
    for seed in range(2):
        found = rare_events.find(lambda u: norm.isf(2.5e-6) - u[:, :4].max(axis=1), 10, 5000, seed)
        part = found.points[-found.weights.size :, :4].argmax(axis=1)
        shares = np.bincount(part, weights=found.contributions, minlength=4) / found.contributions.sum()
        # a quarter each, known to about a fifth of that
        assert shares.min() > 0.1 and found.limit_state.size <= 5000


def test_events_in_parts_that_nothing_has_looked_for_are_warned_of() -> None:
    series = norm.isf(2.5e-5)
    lost = rare_events.find(lambda u: series - u[:, :4].max(axis=1), 10, 3000, 1, has_design=False)
    assert lost.may_have_lost_parts and lost.reached
    assert any("parts that lie apart" in one.text for one in rare_remarks(lost, np.zeros(3000), True))
    # in two variables samples from farther out have looked; of one part there is no sign that there are more
    assert not rare_events.find(both_sides, 2, 2000, 1).may_have_lost_parts
    assert not rare_events.find(plane(12, ONE_IN_TEN_THOUSAND), 12, 3000, 1).may_have_lost_parts
    nothing = rare_events.RareSamples((), np.zeros((2, 1)), np.array([1.0, 2.0]), np.array([0.1, 0.1]), (2,))
    assert nothing.probability == nothing.n_effective == 0.0 and np.isnan(nothing.variation)
    assert not nothing.may_have_lost_parts


def test_spread_is_believed_as_far_as_it_is_no_noise() -> None:
    random = np.random.default_rng(3)
    steps = random.standard_normal((400, 5))
    # of normal points nothing is left of the noise but round the target
    variances = np.linalg.eigvalsh(importance._root(steps, np.ones(400), np.arange(400))) ** 2
    assert np.all(np.abs(variances - 1.0) < 0.2)  # deviations of 400 points: sqrt(2 / 400) = 0.07
    steps[:, 1:] *= 2.0
    variances = np.linalg.eigvalsh(importance._root(steps, np.ones(400), np.arange(400))) ** 2
    np.testing.assert_allclose(variances, [1.0, 4.0, 4.0, 4.0, 4.0], rtol=0.3)
    # 400 points of 10 families know next to nothing of 5 variables
    families = np.repeat(np.arange(10), 40)
    alike = np.repeat(random.standard_normal((10, 5)) * [4.0, 1.0, 1.0, 1.0, 1.0], 40, axis=0)
    spread = np.ptp(np.linalg.eigvalsh(importance._root(alike, np.ones(400), families)))
    assert spread < np.ptp(np.linalg.eigvalsh(importance._root(alike, np.ones(400), np.arange(400))))
    np.testing.assert_array_equal(importance._root(steps[:0], np.ones(0), np.arange(0)), np.eye(5))


def test_families_are_not_torn_apart_and_both_halves_have_some() -> None:
    random = np.random.default_rng(7)
    for families in (np.repeat(np.arange(9), 5), np.repeat([3, 8], [90, 4]), np.arange(7), np.full(6, 4)):
        (make, test), (other, back) = importance._halves(families, random)
        np.testing.assert_array_equal(np.sort([*make, *test]), np.arange(families.size))
        np.testing.assert_array_equal(make, back)
        np.testing.assert_array_equal(test, other)
        assert make.size and test.size
        assert np.unique(families).size == 1 or not set(families[make]) & set(families[test])


def test_means_are_shrunk_by_what_their_families_leave_open() -> None:
    points = np.tile([4.0, 0.2, -0.3], (10, 1))
    # of five families of two each the squared error is 1 / 5
    found = importance._shrunk_mean(cloud_of(points, np.repeat(np.arange(5), 2)))
    np.testing.assert_allclose(found, [4.0 * (1.0 - 2.0 / 5.0 / 16.0), 0.0, 0.0], rtol=1e-12)
    alone = importance._shrunk_mean(cloud_of(points, np.zeros(10, dtype=int)))
    np.testing.assert_allclose(alone, [4.0 * (1.0 - 2.0 / 16.0), 0.0, 0.0], rtol=1e-12)


def test_of_a_plane_border_the_slope_tells_the_mean_and_of_a_round_one_it_does_not() -> None:
    random, d = np.random.default_rng(9), 20
    normal = np.full(d, 1.0 / np.sqrt(d))
    points = random.standard_normal((70, d))
    points += np.outer(4.0 + random.exponential(0.25, 70) - points @ normal, normal)
    found = importance._shrunk_mean(cloud_of(points)._replace(values=4.0 - points @ normal))
    # without the slope the mean is off by sqrt(d / 70) = 0.5; what passes for signal beside it is 0.2 to 0.3 of that
    along = found @ normal
    assert along == pytest.approx(np.mean(points @ normal), rel=1e-6)
    unknown = importance._shrunk_mean(cloud_of(points))
    assert np.linalg.norm(found - along * normal) < 0.8 * np.linalg.norm(unknown - unknown @ normal * normal)
    np.testing.assert_allclose(importance._slope(points, 4.0 - points @ normal), -normal, atol=1e-6)
    around = random.standard_normal((200, 2))
    for some, values in (
        (around, 3.0 - np.hypot(*around.T)),  # bent, not straight
        (points[:62], points[:62] @ normal),  # fewer than three a variable and one
        (np.ones((70, d)), np.arange(70.0)),  # one point
        (points, np.ones(70)),  # level
    ):
        np.testing.assert_array_equal(importance._slope(some, values), np.zeros(some.shape[1]))


def test_rays_alike_are_followed_once_and_no_more_than_samples_allow() -> None:
    angles = np.radians([0.0, 20.0, 90.0, 100.0, 180.0])
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    assert rare_events.unlike(directions) == [0, 2, 4] and rare_events.unlike(directions[:0]) == []
    assert rare_events.unlike(directions, 0.95) == [0, 1, 2, 4]
    np.testing.assert_array_equal(rare_events.apart(2.0 * directions, 5.0 * directions[1:2]), 2.0 * directions[2:])


def test_directions_are_those_of_the_parts_of_an_event() -> None:
    random = np.random.default_rng(10)
    points = random.standard_normal((600, 10))
    points[np.arange(600), np.arange(600) % 4] = 3.0 + random.exponential(0.3, 600)
    cloud = cloud_of(points)._replace(values=3.0 - points[:, :4].max(axis=1))
    found = rare_events.directions_of(cloud, random)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=1e-12)
    assert np.all(found[:, :4].max(axis=0) > 0.8)
    # the mean of points all around is shrunk to nothing
    assert rare_events.directions_of(cloud_of(np.array([[1.0, 0.0], [-1.0, 0.0]] * 4)), random).shape == (0, 2)


def test_a_small_cluster_counts_as_much_as_others() -> None:
    random = np.random.default_rng(8)
    points = random.standard_normal((400, 6))
    points[:, 0] += np.where(np.arange(400) < 8, -20.0, 4.0)
    weights = importance.levelled(points, np.ones(400), random)
    assert weights.sum() == pytest.approx(importance.CLUSTERS[-1])  # of each cluster 1
    assert weights[:8].sum() >= 1.0 - 1e-9
    np.testing.assert_array_equal(importance.levelled(points[:9], np.full(9, 2.0), random), np.full(9, 1.0 / 9.0))


def test_parts_that_lie_apart_are_told_from_one_that_does_not() -> None:
    random = np.random.default_rng(3)
    for d in (4, 20):
        part = random.standard_normal((600, d))
        part[:, 0] = 4.0 + random.exponential(0.25, 600)
        assert not importance.lie_apart(part, np.ones(600), random)
        two, four = part.copy(), part.copy()
        two[::5, 0] *= -1.0
        for k in range(1, 4):
            four[k::4, [0, k]] = four[k::4, [k, 0]]
        assert importance.lie_apart(two, np.ones(600), random) and importance.lie_apart(four, np.ones(600), random)
    assert not importance.lie_apart(part[:19], np.ones(19), random)


def test_mixtures_have_mass_one_and_draw_what_they_say() -> None:
    kernels = importance.KernelDensity(np.array([[-3.0], [4.0]]), np.array([0.6, 0.4]), np.array([1.0, 0.8]))
    mixture = importance.Mixture(kernels, float(2.0 * norm.sf(2.0)), 0.3)
    assert mixture.with_kernels(np.zeros((0, 1)), 0.5) is mixture
    mixture = mixture.with_kernels(np.array([[5.0], [-6.0]]), 0.25)
    np.testing.assert_allclose(mixture.kernels.shares, [0.45, 0.3, 0.125, 0.125])
    x = np.linspace(-12.0, 12.0, 480_001)
    values = np.exp(mixture.log(x[:, None]))
    # it jumps at -2 and 2, by half a step of the trapezoid rule each
    assert trapezoid(values, x) == pytest.approx(1.0, abs=1e-4)
    drawn = mixture.draw(20_000, np.random.default_rng(2))[:, 0]
    for low, high in ((-12.0, -2.0), (-2.0, 2.0), (2.0, 12.0)):
        chance = trapezoid(values * ((x >= low) & (x < high)), x)
        assert np.mean((drawn >= low) & (drawn < high)) == pytest.approx(chance, abs=4 * np.sqrt(0.25 / 20_000))


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("push", "character 5: '<' or '>'; an event is an output, < or >, and a number"),
        ("push <= 1", "character 7: a number"),
        ("push < 1e", "character 8: a number"),
        ("pash < 1.0", "character 1: an output or a label of ensemble.probabilities; did you mean 'push'?"),
        ("", "character 1: an output or a label of ensemble.probabilities"),
        ("ever far", "character 6: an output; known: push"),
        (
            "push < 1 m/s",
            "character 10: a unit of push, or none ('m/s' is the unit of a speed; needed is a length (m))",
        ),
        ("push < 1 m < 2", "character 10: the end"),
        ("push < 1 m ever", "character 12: 'ever' before push, and nothing there"),
        ("push < 1e999", "character 8: 0 or a magnitude from 1e-30 to 1e+30"),
        ("push < -1e300", "character 8: 0 or a magnitude from 1e-30 to 1e+30"),
        ("push > 1e-40", "character 8: 0 or a magnitude from 1e-30 to 1e+30"),
    ],
)
def test_what_is_no_event_is_refused(text: str, line: str) -> None:
    scene = slider_crank(OUTPUT, 'ensemble.probabilities.far={output="push", above=1e-3, when="ever"}')
    with pytest.raises(InputError, match="--rare") as error:
        event_of(text, scene)
    assert line in str(error.value)
    for same in ("push < -2e-4", "push < -0.2 mm"):
        event = event_of(same, scene)
        assert (event.output, event.below, event.above, event.when) == ("push", -2e-4, None, "end")
    assert event_of(" ever push>.5 ", scene).when == "ever"
    assert event_of("far", scene) is scene.ensemble.probabilities["far"]


@pytest.mark.parametrize(
    ("option", "line"),
    [
        ({"sampler": "sobol"}, "--sampler sobol with --rare: samples follow from those before them; leave it out"),
        ({"resume": True}, "--resume with --rare: its samples are not kept on the way"),
        ({"ranks_per_sample": 2}, "--ranks-per-sample 2 with --rare: ranks take samples of their own"),
    ],
)
def test_what_ensembles_alone_have_is_refused(option: dict, line: str) -> None:
    assert line in refusal(choose, {"event": "push < 1.0", "n": 500, **option}, MPI.COMM_SELF)
