"""Correlated parameters, and what is refused of correlations."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import slider_crank
from scipy import stats

from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml

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
