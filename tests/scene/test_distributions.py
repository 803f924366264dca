"""Distributions beside those of scipy.stats: discrete, empirical, mixtures, tables of slow ones; what is refused."""

from pathlib import Path

import numpy as np
import pytest
from refusals import refusal
from scipy import stats

from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
from pgmp_petsc.scene.distributions import Discrete, Empirical, Mixture, Tabulated, _table, quick
from pgmp_petsc.scene.parameters import MOST_VALUES, Parameter
from scenes import slider_crank

MEASURED = (5.1e-3, 5.6e-3, 5.5e-3, 5.6e-3, 6.2e-3)
TWO = '{name="norm", loc=5.2e-3, scale=1e-4}, {name="uniform", loc=5.8e-3, scale=4e-4}'


def scene_of(law: str, more: str = "") -> Scene:
    return slider_crank(f"parameters.r1={{nominal=5.6e-3, distribution={law}{more}}}")


def r1_of(law: str, more: str = "") -> Parameter:
    return scene_of(law, more).parameters["r1"]


def test_discrete_values_come_as_often_as_their_weights_say() -> None:
    scene = scene_of('{name="discrete", values=[6e-3, 5e-3, 5.5e-3], weights=[1, 2, 5]}')
    n = 4000
    values, counts = np.unique(draw(scene, 1, 0, n)["r1"], return_counts=True)
    np.testing.assert_array_equal(values, [5e-3, 5.5e-3, 6e-3])
    assert stats.chisquare(counts, n * np.array([2, 5, 1]) / 8).pvalue > 1e-3
    parameter = scene.parameters["r1"]
    x = np.array([5e-3, 5.5e-3, 6e-3])
    mean = np.average(x, weights=[2, 5, 1])
    assert parameter.deviation == pytest.approx(np.sqrt(np.average((x - mean) ** 2, weights=[2, 5, 1])), rel=1e-12)
    assert parameter.distribution.support == (5e-3, 6e-3) and not parameter.distribution.is_continuous
    law = parameter.distribution.frozen
    assert (law.median(), law.cdf(5.5e-3), law.below(5.5e-3), law.sf(5.5e-3)) == (5.5e-3, 0.875, 0.25, 0.125)
    assert law.isf(0.99) == 5e-3 and law.cdf(-np.inf) == 0.0 and law.cdf(np.inf) == 1.0


def test_bounds_cut_values_off_and_keep_those_at_their_ends() -> None:
    parameter = r1_of('{name="discrete", values=[5e-3, 5.5e-3, 6e-3]}', ", bounds=[5.5e-3, 7e-3]")
    drawn = parameter.quantiles(np.linspace(1e-9, 1.0 - 1e-9, 1001))
    np.testing.assert_array_equal(np.unique(drawn), [5.5e-3, 6e-3])
    assert np.mean(drawn == 6e-3) == pytest.approx(0.5, abs=2e-3)
    assert parameter.cut_off == pytest.approx((1.0 / 3.0, 0.0))


def test_measured_values_are_joined_by_straight_lines_and_keep_their_mean() -> None:
    parameter = r1_of(f'{{name="empirical", values={list(MEASURED)}}}')
    law, ordered = parameter.distribution.frozen, np.sort(MEASURED)
    shares = np.linspace(0.0, 1.0, 200_001)
    drawn = parameter.quantiles(shares)
    # the trapezoid rule over probabilities, exact but for the corners
    assert np.trapz(drawn, shares) == pytest.approx(np.mean(MEASURED), rel=1e-8)
    assert np.trapz((drawn - drawn.mean()) ** 2, shares) ** 0.5 == pytest.approx(parameter.deviation, rel=1e-4)
    np.testing.assert_allclose(parameter.quantiles((np.arange(5) + 0.5) / 5), ordered, rtol=1e-14)
    np.testing.assert_allclose(law.ppf(law.cdf(drawn[40_000:60_000])), drawn[40_000:60_000], rtol=1e-12)
    assert law.cdf(5.6e-3) == pytest.approx(0.7) and law.below(5.6e-3) == pytest.approx(0.5)
    assert (law.cdf(5e-3), law.cdf(6.2e-3), law.below(5.1e-3), law.sf(7e-3)) == (0.0, 1.0, 0.0, 0.0)
    assert parameter.distribution.support == (5.1e-3, 6.2e-3) and parameter.distribution.is_continuous
    assert law.isf(0.5) == law.median() == 5.6e-3


def test_many_measured_values_are_drawn_as_they_are_distributed() -> None:
    given = stats.gumbel_r(5.6e-3, 1e-4).rvs(2000, random_state=3)
    drawn = draw(scene_of(f'{{name="empirical", values={given.tolist()}}}'), 2, 0, 3000)["r1"]
    assert stats.ks_2samp(drawn, given).pvalue > 1e-3


def test_a_mixture_has_the_shares_of_its_parts() -> None:
    parameter = r1_of(f'{{name="mixture", of=[{TWO}], weights=[3, 1]}}')
    parts = stats.norm(5.2e-3, 1e-4), stats.uniform(5.8e-3, 4e-4)
    law = parameter.distribution.frozen
    shares = np.array([1e-9, 0.01, 0.3, 0.74, 0.7500001, 0.9, 0.999])
    values = parameter.quantiles(shares)
    found = 0.75 * parts[0].cdf(values) + 0.25 * parts[1].cdf(values)
    np.testing.assert_allclose(found, shares, rtol=1e-9)
    np.testing.assert_allclose(law.isf(law.sf(values[1:])), values[1:], rtol=1e-6)
    mean = 0.75 * 5.2e-3 + 0.25 * 6e-3
    variance = 0.75 * (1e-8 + (5.2e-3 - mean) ** 2) + 0.25 * (16e-8 / 12 + (6e-3 - mean) ** 2)
    assert parameter.deviation == pytest.approx(np.sqrt(variance), rel=1e-9) and law.mean() == pytest.approx(mean)
    assert parameter.distribution.support == (-np.inf, np.inf) and parameter.distribution.is_continuous
    assert law.ppf(0.0) == -np.inf and law.ppf(1.0) == np.inf
    n = 4000
    drawn = draw(scene_of(f'{{name="mixture", of=[{TWO}], weights=[3, 1]}}'), 1, 0, n)["r1"]
    assert stats.kstest(drawn, law.cdf).pvalue > 1e-3


def test_a_mixture_may_have_values_of_its_own_and_parts_within_parts() -> None:
    law = '{name="mixture", of=[{name="discrete", values=[5e-3]}, {name="mixture", of=[%s]}]}' % TWO
    parameter = r1_of(law)
    drawn = parameter.quantiles(np.linspace(0.001, 0.999, 999))
    assert np.mean(drawn == 5e-3) == pytest.approx(0.5, abs=0.03)
    assert not parameter.distribution.is_continuous
    two = "mixture(norm(loc=0.0052, scale=0.0001), uniform(loc=0.0058, scale=0.0004))"
    assert parameter.distribution.text == f"mixture(discrete(1 values from 0.005 to 0.005), {two})"
    exact = parameter.distribution.frozen
    shares = np.linspace(0.001, 0.999, 999)
    assert np.all(exact.below(drawn) <= shares + 1e-12) and np.all(exact.cdf(drawn) >= shares - 1e-12)


def test_a_scene_carries_the_values_of_a_file_in_si(tmp_path: Path) -> None:
    (tmp_path / "radii.csv").write_text('\ufeff"radius [mm]"\n5.1\n\n5.6\n6.2\n')
    text = scene_to_toml(slider_crank())
    head = 'parameters.r1={nominal=5.6, unit="mm", distribution='
    own = '{name="discrete", values="radii.csv"}'
    for law in ('{name="empirical", values="radii.csv"}', f'{{name="mixture", of=[{own}]}}'):
        scene = scene_from_toml(text, tmp_path, [f"{head}{law}}}"])
        found = scene.parameters["r1"].distribution
        values = found.values or found.of[0].values
        np.testing.assert_allclose(values, [5.1e-3, 5.6e-3, 6.2e-3], rtol=1e-15)
        again = scene_from_toml(scene_to_toml(scene), tmp_path / "elsewhere")
        assert again.parameters["r1"] == scene.parameters["r1"]


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (None, "the file cannot be read (No such file or directory); it is sought in"),
        (b"\xff\xfe\x00", "no text file in UTF-8"), (b"r\n1\nx\n", "line 3 is 'x'; one number is needed in each line"),
        (b"1,2\n", "line 1 is '1,2'; one number is needed in each line"), (b"1e40\n2\n", "1e+30"),
        (b"r [mm]\n5\n6\n", "its column is in mm, the parameter in "),
        (b"r (read off)\n5\n6\n", "are no unit of its numbers: no such unit"),
        (b"nan\n2\n", "finite"), (b"r\n", "2 to 10,000 are needed, and 0 are given"),
    ],
)  # fmt: skip
def test_files_that_have_no_values_are_refused(tmp_path: Path, content: bytes | None, line: str) -> None:
    if content is not None:
        (tmp_path / "bad.csv").write_bytes(content)
    text = scene_to_toml(slider_crank())
    message = refusal(
        scene_from_toml, text, tmp_path, ['parameters.r1.distribution={name="empirical", values="bad.csv"}']
    )
    assert "parameters.r1.distribution.values" in message and line in message


@pytest.mark.parametrize(
    ("law", "line"),
    [
        ('{name="discrete"}', "distribution.values: missing; discrete needs it"),
        ('{name="mixture"}', "distribution.of: missing; mixture needs it"),
        ('{name="empirical", values=[1.0]}', "2 to 10,000 are needed, and 1 are given"),
        ('{name="empirical", values=[1.0, 1.0]}', "all values are the same, so nothing is drawn"),
        ('{name="empirical", values=[1.0, 2.0], weights=[1, 2]}', "weights = [1, 2]: no key of empirical"),
        ('{name="norm", loc=5.6e-3, scale=1e-4, values=[1.0]}', "no key of norm; discrete, empirical, mixture have it"),
        ('{name="discrete", values=[1.0], scale=2.0}', "scale = 2.0: no key of discrete; its keys are values, weights"),
        ('{name="discrete", values=[1.0, 2.0], weights=[1]}', "2 are needed, one for each of values; 1 are given"),
        ('{name="discrete", values=[1.0, 2.0], weights=[0, 0]}', "numbers above 0 are needed"),
        ('{name="discrete", values=[1.0, 2.0], weights=[-1, 2]}', "numbers above 0 are needed"),
        ('{name="mixture", of=[{name="norm"}], weights=[0]}', "numbers above 0 are needed"),
        ('{name="mixture", of=[{name="norn"}]}', 'distribution.of[0].name = "norn": no continuous distribution'),
        ('{name="mixture", of=[]}', "1 to 10,000 are needed, and 0 are given"),
        ('{name="empirical", values=[]}', "2 to 10,000 are needed, and 0 are given"),
        ('{name="emprical", values=[1.0, 2.0]}', "values = [1.0, 2.0]: no key of emprical"),
        ('{name="discrete", values=[5e-3]}, bounds=[5.5e-3, 6e-3]', "gives no samples inside the parameter's bounds"),
    ],
)
def test_what_is_no_distribution_is_refused_with_its_name(law: str, line: str) -> None:
    message = refusal(scene_of, law)
    assert line in message and "parameters.r1.distribution" in message
    assert MOST_VALUES == 10_000


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("exponnorm", {"K": 1.5, "loc": 5.6e-3, "scale": 1e-4}),
        ("norminvgauss", {"a": 1.25, "b": 0.5, "loc": 1.0}),
        ("argus", {"chi": 1.0, "scale": 2e11}),
    ],
)
def test_quantiles_that_scipy_searches_for_are_tabulated(name: str, arguments: dict[str, float]) -> None:
    exact = getattr(stats, name)(**arguments)
    law = quick(exact)
    assert isinstance(law, Tabulated) and law.std() == exact.std()
    shares = np.array([1e-12, 1e-6, 0.02, 0.5, 0.7, 0.999, 1.0 - 1e-7])
    np.testing.assert_allclose(exact.cdf(law.ppf(shares)), shares, rtol=1e-3)
    random = np.random.default_rng(1).random(300)
    # of norminvgauss scipy's own integral is off by 3e-10
    np.testing.assert_allclose(exact.cdf(law.ppf(random)), random, atol=1e-9)
    np.testing.assert_allclose(exact.sf(law.isf(shares)), shares, rtol=2e-3)
    assert np.all(np.diff(law.ppf(np.linspace(0.0, 1.0, 2001)[1:-1])) > 0.0)


def test_what_is_quick_or_cannot_be_tabulated_stays_as_it_is() -> None:
    weibull = stats.weibull_min(2.0)
    assert quick(weibull) is weibull
    turning = stats.vonmises(kappa=3.99)
    assert quick(turning) is turning
    assert _table("vonmises", (("kappa", 3.99),)) is None


def test_laws_agree_with_scipy_where_it_has_them() -> None:
    weights = np.array([1.0, 2.0, 3.0])
    own, theirs = Discrete(np.array([1.0, 2.0, 4.0]), weights), stats.rv_discrete(values=([1, 2, 4], weights / 6.0))
    for x in (0.0, 1.0, 1.5, 4.0, 5.0):
        assert own.cdf(x) == pytest.approx(theirs.cdf(x)) and own.sf(x) == pytest.approx(theirs.sf(x))
    for share in (0.1, 1.0 / 6.0 + 1e-9, 0.5 + 1e-9, 0.99):
        assert own.ppf(share) == theirs.ppf(share)
    assert own.mean() == pytest.approx(theirs.mean()) and own.std() == pytest.approx(theirs.std())
    twice = Mixture([stats.norm(), stats.norm()], np.ones(2))
    assert twice.ppf(0.975) == pytest.approx(stats.norm.ppf(0.975), rel=1e-12)
    assert Empirical(np.array([0.0, 1.0])).std() == pytest.approx(np.sqrt(0.25 - 0.25 * 2.0 / 3.0 * 0.5), rel=1e-12)
