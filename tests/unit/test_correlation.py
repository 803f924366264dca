"""Correlated parameters, and what is refused of correlations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
from scenes import slider_crank

PARAMETERS = (
    'parameters.r1.distribution={name="norm", loc=5.6e-3, scale=0.56e-3}',
    'parameters.E={nominal=2.1e11, distribution={name="lognorm", s=0.2, scale=2.1e11}}',
    'materials.steel.E="E"',
    'parameters.rho={nominal=7800.0, distribution={name="uniform", loc=7000.0, scale=1600.0}}',
    'materials.steel.rho="rho"',
    "parameters.fixed={nominal=1.0}",
    'effects.motor.scale="fixed"',
)


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
    margins = {
        "r1": stats.norm(5.6e-3, 0.56e-3),
        "E": stats.lognorm(0.2, scale=2.1e11),
        "rho": stats.uniform(7000, 1600),
    }
    for name, law in margins.items():
        assert stats.kstest(found[name], law.cdf).pvalue > 1e-3, name


def test_parameters_without_a_correlation_keep_every_bit() -> None:
    free, bound = draw(scene(), 3, 0, 40), draw(scene("correlation.r1={E=0.8}"), 3, 0, 40)
    # E is the first, r1 follows it
    for name in ("E", "rho", "fixed"):
        np.testing.assert_array_equal(bound[name], free[name])
    assert not np.array_equal(bound["r1"], free["r1"])


def test_a_sample_does_not_depend_on_its_batch() -> None:
    correlated = scene("correlation.r1={E=0.8, rho=0.3}")
    whole = draw(correlated, 3, 0, 50)
    for first, last in ((0, 1), (7, 31), (49, 50)):
        for name, values in draw(correlated, 3, first, last).items():
            np.testing.assert_array_equal(values, whole[name][first:last])


def test_a_result_keeps_it() -> None:
    correlated = scene("correlation.r1={E=0.8}")
    assert scene_from_toml(scene_to_toml(correlated), ".").correlation == {"r1": {"E": 0.8}}


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
    with pytest.raises(InputError) as caught:
        scene(*overrides)
    assert message in str(caught.value)


def test_coefficients_that_contradict_each_other_are_refused_with_the_smallest_eigenvalue() -> None:
    coefficients = np.array([[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]])
    smallest = np.linalg.eigvalsh(coefficients)[0]
    assert smallest < 0.0
    with pytest.raises(InputError, match=rf"its smallest eigenvalue is {smallest:.4g}; make some coefficients smaller"):
        scene("correlation.r1={E=0.9, rho=-0.9}", "correlation.E={rho=0.9}")


def test_students_copula_has_the_margins_and_extremes_that_come_together() -> None:
    n, r, freedom = 40_000, 0.5, 3.0
    asked = "correlation.r1={E=0.5}", 'ensemble.copula="student"', "ensemble.copula_freedom=3.0"
    found = draw(scene(*asked), 3, 0, n)
    shares = {
        "r1": stats.norm(5.6e-3, 0.56e-3).cdf(found["r1"]),
        "E": stats.lognorm(0.2, scale=2.1e11).cdf(found["E"]),
    }
    for name, share in shares.items():
        assert stats.kstest(share, "uniform").pvalue > 1e-3, name
    kendall = stats.kendalltau(found["r1"][:4000], found["E"][:4000]).statistic
    assert kendall == pytest.approx(2.0 / np.pi * np.arcsin(r), abs=4.0 * 2.0 / 3.0 / np.sqrt(4000))
    together = np.mean((shares["r1"] > 0.99) & (shares["E"] > 0.99))
    # by integration over the t distribution of both
    exact = stats.multivariate_t(shape=[[1.0, r], [r, 1.0]], df=freedom)
    x = stats.t(freedom).isf(0.01)
    chance = np.mean(np.all(exact.rvs(400_000, random_state=1) > x, axis=1))
    assert together == pytest.approx(chance, abs=4.0 * np.sqrt(chance / n))
    of_normal = draw(scene("correlation.r1={E=0.5}"), 3, 0, n)
    far = stats.norm(5.6e-3, 0.56e-3).isf(0.01), stats.lognorm(0.2, scale=2.1e11).isf(0.01)
    assert np.mean((of_normal["r1"] > far[0]) & (of_normal["E"] > far[1])) < 0.7 * together
    # others are as they were
    np.testing.assert_array_equal(found["rho"], draw(scene(), 3, 0, n)["rho"])


def test_students_copula_joins_three_and_a_sample_does_not_depend_on_its_batch() -> None:
    asked = scene("correlation.r1={E=0.8, rho=0.3}", 'ensemble.copula="student"')
    whole = draw(asked, 3, 0, 3000)
    for name, values in draw(asked, 3, 7, 31).items():
        np.testing.assert_array_equal(values, whole[name][7:31])
    for other, r in (("E", 0.8), ("rho", 0.3)):
        kendall = stats.kendalltau(whole["r1"], whole[other]).statistic
        assert kendall == pytest.approx(2.0 / np.pi * np.arcsin(r), abs=0.05)
    coefficients, many = "correlation.r1={E=0.8, rho=0.3}", "ensemble.copula_freedom=1000"
    with_many = draw(scene(coefficients, 'ensemble.copula="student"', many), 3, 0, 50)
    gaussian = draw(scene(coefficients), 3, 0, 50)
    for name, values in gaussian.items():
        np.testing.assert_allclose(with_many[name], values, rtol=0.02)


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        (('ensemble.copula="student"',), "[correlation] names no parameters that it could join"),
        (('ensemble.copula="clayton"', "correlation.r1={E=0.5}"), "ensemble.copula"),
        (("ensemble.copula_freedom=0.5", "correlation.r1={E=0.5}"), "ensemble.copula_freedom"),
    ],
)
def test_copulas_that_cannot_be_are_refused(overrides: tuple[str, ...], line: str) -> None:
    with pytest.raises(InputError) as caught:
        scene(*overrides)
    assert line in str(caught.value)
