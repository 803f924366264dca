"""Correlated parameters, and what is refused of correlations."""

import numpy as np
import pytest
from refusals import refusal
from scipy import stats
from scipy.integrate import quad

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.ensemble.sampling import draw, mixing_of, theta_of
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
from scenes import slider_crank

PARAMETERS = (
    'parameters.r1.distribution={name="norm", loc=5.6e-3, scale=0.56e-3}',
    'parameters.E={nominal=2.1e11, distribution={name="lognorm", s=0.2, scale=2.1e11}}', 'materials.steel.E="E"',
    'parameters.rho={nominal=7800.0, distribution={name="uniform", loc=7000.0, scale=1600.0}}',
    'materials.steel.rho="rho"', "parameters.fixed={nominal=1.0}", 'effects.motor.scale="fixed"',
)  # fmt: skip
MARGINS = {
    "r1": stats.norm(5.6e-3, 0.56e-3), "E": stats.lognorm(0.2, scale=2.1e11), "rho": stats.uniform(7000.0, 1600.0)
}  # fmt: skip


def scene(*overrides: str) -> Scene:
    return slider_crank(*PARAMETERS, *overrides)


def test_rank_correlations_and_margins_are_those_asked_for() -> None:
    n, asked = 4000, {"r1": ("E", 0.8), "rho": ("E", -0.5)}
    found = draw(scene("correlation.r1={E=0.8}", "correlation.rho={E=-0.5}"), 3, 0, n)
    for one, (other, coefficient) in asked.items():
        # Kruskal 1958: Spearman's coefficient of a Gaussian copula; its standard error is below 1 / sqrt(n)
        spearman = 6.0 / np.pi * np.arcsin(coefficient / 2.0)
        assert stats.spearmanr(found[one], found[other]).statistic == pytest.approx(spearman, abs=4.0 / np.sqrt(n))
    assert abs(stats.spearmanr(found["r1"], found["rho"]).statistic) < 4.0 / np.sqrt(n)
    for name, law in MARGINS.items():
        assert stats.kstest(found[name], law.cdf).pvalue > 1e-3, name


def test_parameters_without_a_correlation_keep_every_bit() -> None:
    correlated = scene("correlation.r1={E=0.8}")
    free, bound = draw(scene(), 3, 0, 40), draw(correlated, 3, 0, 40)
    assert scene_from_toml(scene_to_toml(correlated), ".").correlation == {"r1": {"E": 0.8}}
    # E is the first, r1 follows it
    for name in ("E", "rho", "fixed"):
        np.testing.assert_array_equal(bound[name], free[name])
    assert not np.array_equal(bound["r1"], free["r1"])


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["correlation.r2={E=0.5}"], "correlation.r2: there is no such parameter; known: E, fixed, r1, rho"),
        (["correlation.r1={G=0.5}"], "correlation.r1.G: there is no such parameter; known: E, fixed, r1, rho"),
        (["correlation.r1={fixed=0.5}"], "correlation.r1.fixed: parameters.fixed has no distribution"),
        (["correlation.r1={r1=0.5}"], "correlation.r1.r1 = 0.5: a parameter is fully correlated with itself"),
        (["correlation.r1={E=1.0}"], "correlation.r1.E = 1.0: must lie between -1 and 1, both excluded"),
        (["correlation.r1={E=0.5}", "correlation.E={r1=0.5}"], "correlation.E.r1 = 0.5: correlation.r1.E is the same"),
        (['correlation.r1={E="much"}'], 'correlation.r1.E = "much": a number is needed'),
        (["correlation.r1=0.5"], "correlation.r1 = 0.5: a table is needed"),
        (["correlation.r1={E=0.5}", 'ensemble.sampler="saltelli"'], "Sobol indices are of independent parameters"),
    ],
)
def test_what_is_no_correlation_is_refused(overrides: list[str], message: str) -> None:
    assert message in refusal(scene, *overrides)


def test_coefficients_that_contradict_each_other_are_refused_with_the_smallest_eigenvalue() -> None:
    smallest = np.linalg.eigvalsh(np.array([[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]]))[0]
    assert smallest < 0.0
    with pytest.raises(InputError, match=rf"its smallest eigenvalue is {smallest:.4g}; make some coefficients smaller"):
        scene("correlation.r1={E=0.9, rho=-0.9}", "correlation.E={rho=0.9}")


def test_students_copula_has_the_margins_and_extremes_that_come_together() -> None:
    n, r, freedom = 40_000, 0.5, 3.0
    asked = "correlation.r1={E=0.5}", 'ensemble.copula="student"', "ensemble.copula_freedom=3.0"
    found = draw(scene(*asked), 3, 0, n)
    shares = {name: MARGINS[name].cdf(found[name]) for name in ("r1", "E")}
    for name, share in shares.items():
        assert stats.kstest(share, "uniform").pvalue > 1e-3, name
    kendall = stats.kendalltau(found["r1"][:4000], found["E"][:4000]).statistic
    assert kendall == pytest.approx(2.0 / np.pi * np.arcsin(r), abs=4.0 * 2.0 / 3.0 / np.sqrt(4000))
    together = np.mean((shares["r1"] > 0.99) & (shares["E"] > 0.99))
    # by integration over the t distribution of both
    exact = stats.multivariate_t(shape=[[1.0, r], [r, 1.0]], df=freedom)
    chance = np.mean(np.all(exact.rvs(400_000, random_state=1) > stats.t(freedom).isf(0.01), axis=1))
    assert together == pytest.approx(chance, abs=4.0 * np.sqrt(chance / n))
    of_normal = draw(scene("correlation.r1={E=0.5}"), 3, 0, n)
    far = np.all([of_normal[name] > MARGINS[name].isf(0.01) for name in ("r1", "E")], axis=0)
    assert np.mean(far) < 0.7 * together
    # others are as they were
    np.testing.assert_array_equal(found["rho"], draw(scene(), 3, 0, n)["rho"])


@pytest.mark.parametrize("copula", [(), ('ensemble.copula="student"',)])
def test_three_are_joined_and_a_sample_does_not_depend_on_its_batch(copula: tuple[str, ...]) -> None:
    asked = scene("correlation.r1={E=0.8, rho=0.3}", *copula)
    whole = draw(asked, 3, 0, 3000)
    for first, last in ((0, 1), (7, 31)):
        for name, values in draw(asked, 3, first, last).items():
            np.testing.assert_array_equal(values, whole[name][first:last])
    for other, r in (("E", 0.8), ("rho", 0.3)):
        kendall = stats.kendalltau(whole["r1"], whole[other]).statistic
        assert kendall == pytest.approx(2.0 / np.pi * np.arcsin(r), abs=0.05)
    coefficients, many = "correlation.r1={E=0.8, rho=0.3}", "ensemble.copula_freedom=1000"
    with_many = draw(scene(coefficients, 'ensemble.copula="student"', many), 3, 0, 50)
    for name, values in draw(scene(coefficients), 3, 0, 50).items():
        np.testing.assert_allclose(with_many[name], values, rtol=0.02)


ALL_ALIKE = "correlation.r1={E=0.6, rho=0.6}", "correlation.E={rho=0.6}"


@pytest.mark.parametrize("copula", ["clayton", "gumbel", "frank"])
def test_archimedean_copulas_have_their_closed_forms(copula: str) -> None:
    """Margins, Kendall's coefficient, and how often all three are low or high, by ``C(u, u, u)``."""
    n, tau = 20_000, 2.0 / np.pi * np.arcsin(0.6)
    found = draw(scene(*ALL_ALIKE, f'ensemble.copula="{copula}"'), 3, 0, n)
    shares = np.array([law.cdf(found[name]) for name, law in MARGINS.items()])
    for one, other in ((0, 1), (0, 2), (1, 2)):
        assert stats.kstest(shares[one], "uniform").pvalue > 1e-3
        # Kendall's coefficient of n pairs is off by less than 2 / (3 sqrt(n)) (1 - tau^2)^(1/2) 2; four times
        measured = stats.kendalltau(shares[one][:4000], shares[other][:4000]).statistic
        assert measured == pytest.approx(tau, abs=4.0 * 2.0 / 3.0 / np.sqrt(4000))
    theta = theta_of(copula, tau)

    def together(u: float, m: int) -> float:
        if copula == "clayton":
            return float((m * u**-theta - m + 1.0) ** (-1.0 / theta))
        if copula == "gumbel":
            return float(u ** (m ** (1.0 / theta)))
        return float(-np.log1p(np.expm1(-theta * u) ** m / np.expm1(-theta) ** (m - 1)) / theta)

    u = 0.02
    low = together(u, 3)
    # all above 1 - u: inclusion and exclusion
    high = 1.0 - 3.0 * (1.0 - u) + 3.0 * together(1.0 - u, 2) - together(1.0 - u, 3)
    for share, exact in ((np.all(shares < u, axis=0), low), (np.all(shares > 1.0 - u, axis=0), high)):
        assert share.mean() == pytest.approx(exact, abs=4.0 * np.sqrt(exact / n))
    dependent = {"clayton": low > 3.0 * high, "gumbel": high > 1.5 * low, "frank": max(low, high) < 0.02 * u}
    assert dependent[copula]


def test_theta_is_the_inverse_of_kendalls_coefficient() -> None:
    """Of Frank's, with Debye's function by integration: 5.736 at a half (Nelsen, An Introduction to Copulas)."""
    assert theta_of("frank", 0.5) == pytest.approx(5.736, abs=5e-4)
    for tau in (0.05, 0.3, 0.8):
        theta = theta_of("frank", tau)
        debye = quad(lambda t: t / np.expm1(t), 0.0, theta)[0] / theta
        assert 1.0 - 4.0 * (1.0 - debye) / theta == pytest.approx(tau, abs=1e-9)
    assert (theta_of("clayton", 0.5), theta_of("gumbel", 0.5)) == (2.0, 2.0)


@pytest.mark.parametrize("copula", ["clayton", "gumbel", "frank"])
@pytest.mark.parametrize("r", [0.05, 0.6, 0.97])
def test_archimedean_transforms_go_out_to_eight_deviations(copula: str, r: float) -> None:
    asked = f"correlation.r1={{E={r}, rho={r}}}", f"correlation.E={{rho={r}}}", f'ensemble.copula="{copula}"'
    mixing = mixing_of(scene(*asked), ["E", "r1", "rho"])
    grid = stats.norm.cdf(np.array(np.meshgrid(*3 * [[-8.0, -5.0, 0.0, 5.0, 8.0]])).reshape(3, -1).T)
    found = mixing.applied(grid)
    assert np.all((found > 0.0) & (found <= 1.0)) and np.all(np.isfinite(found))
    np.testing.assert_array_equal(found[:, 0], grid[:, 0])
    # a sample does not depend on its batch, and a share rises with its own number
    np.testing.assert_array_equal(mixing.applied(grid[7:9]), found[7:9])
    numbers = np.column_stack([np.full((99, 2), 0.3), np.linspace(0.01, 0.99, 99)])
    assert np.all(np.diff(mixing.applied(numbers)[:, 2]) > 0.0)


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        (('ensemble.copula="student"',), "[correlation] names no parameters that it could join"),
        (('ensemble.copula="joe"', "correlation.r1={E=0.5}"), "ensemble.copula"),
        (('ensemble.copula="clayton"', "correlation.r1={E=-0.5}"), "are from -0.5 to -0.5: give every pair the same"),
        (('ensemble.copula="frank"', "correlation.r1={E=0.98}"), "above 0 and at most 0.97"),
        (('ensemble.copula="gumbel"', "correlation.r1={E=0.5, rho=0.5}"), "those of E, r1, rho are from 0 to 0.5"),
        (("ensemble.copula_freedom=0.5", "correlation.r1={E=0.5}"), "ensemble.copula_freedom"),
    ],
)
def test_copulas_that_cannot_be_are_refused(overrides: tuple[str, ...], line: str) -> None:
    assert line in refusal(scene, *overrides)
