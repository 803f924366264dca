"""Statistics of samples against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from pgmp_petsc.ensemble.statistics import Peaks, describe, holds_to, is_constant, of_given, quantile_bounds
from pgmp_petsc.results import Chance
from pgmp_petsc.scene.numerics import Event

PROBABILITIES = (0.25, 0.5, 0.75)


def test_numbers_that_can_be_worked_out_by_hand() -> None:
    found = describe(np.array([1.0, 2.0, 3.0, 4.0]), 3, PROBABILITIES)
    assert found.mean == 2.5
    assert found.std == pytest.approx(np.sqrt(5 / 3), rel=1e-15)
    assert found.mean_standard_error == pytest.approx(np.sqrt(5 / 3) / 2, rel=1e-15)
    # fourth moment (1.5^4 + 0.5^4) / 2 = 2.5625 is below s^4 = 25/9: such a sample does not spread its own variance
    assert found.std_standard_error == 0.0
    np.testing.assert_allclose(found.quantiles, [1.75, 2.5, 3.25])
    np.testing.assert_allclose(found.edges, [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(found.pdf, [0.25, 0.25, 0.5])
    np.testing.assert_array_equal(found.probabilities, PROBABILITIES)


def test_errors_and_density_of_a_normal_sample() -> None:
    n = 20000
    values = np.random.default_rng(1).normal(3.0, 0.5, n)
    found = describe(values, 40, (0.025, 0.975))
    assert abs(found.mean - 3.0) < 4 * 0.5 / np.sqrt(n)
    assert found.mean_standard_error == pytest.approx(0.5 / np.sqrt(n), rel=0.05)
    assert found.std_standard_error == pytest.approx(0.5 / np.sqrt(2 * n), rel=0.05)  # var(s) = s^2 / (2 n)
    np.testing.assert_allclose(found.quantiles, [3 - 0.98, 3 + 0.98], atol=0.03)
    assert np.sum(found.pdf * np.diff(found.edges)) == pytest.approx(1.0, rel=1e-12)
    assert (found.edges[0], found.edges[-1]) == (values.min(), values.max())
    middle = 0.5 * (found.edges[1:] + found.edges[:-1])
    normal = np.exp(-0.5 * ((middle - 3.0) / 0.5) ** 2) / (0.5 * np.sqrt(2 * np.pi))
    np.testing.assert_allclose(found.pdf, normal, atol=0.06)


def test_the_standard_errors_are_the_spread_of_repeated_samples() -> None:
    random = np.random.default_rng(2)
    repeated = [describe(random.exponential(1.0, 400), 5, PROBABILITIES) for _ in range(400)]
    for name in ("mean", "std"):
        spread = np.std([getattr(one, name) for one in repeated])
        estimated = np.mean([getattr(one, f"{name}_standard_error") for one in repeated])
        # 400 repetitions know their own spread to 3.5 %; the skew law's fourth moment is underestimated a little
        assert estimated == pytest.approx(spread, rel=0.2)


@pytest.mark.filterwarnings("error")  # a warning of numpy or scipy would reach the user's terminal
@pytest.mark.parametrize("value", [0.0, 5.6e-3, -1e9])
@pytest.mark.parametrize("n", [1, 7])
def test_a_constant_sample_has_no_spread_and_a_density_of_one(value: float, n: int) -> None:
    found = describe(np.full(n, value), 10, PROBABILITIES)
    # of one value neither spread nor standard error are known; 0 would be a claim
    spread = np.nan if n == 1 else 0.0
    assert (found.mean, found.count) == (value, n)
    np.testing.assert_array_equal([found.std, found.mean_standard_error, found.std_standard_error], spread)
    np.testing.assert_array_equal(found.quantiles, value)
    assert np.all(np.diff(found.edges) > 0) and found.edges[0] < value < found.edges[-1]
    assert np.isfinite(found.pdf).all()
    assert np.sum(found.pdf * np.diff(found.edges)) == pytest.approx(1.0, rel=1e-9)


def test_an_empty_sample_is_no_number() -> None:
    found = describe(np.empty(0), 10, PROBABILITIES)
    assert np.isnan([found.mean, found.std, found.mean_standard_error, found.std_standard_error]).all()
    assert np.isnan(found.quantiles).all() and found.quantiles.shape == (3,)
    assert found.pdf.size == found.edges.size == found.count == 0
    np.testing.assert_array_equal(describe(np.empty(0), 10, PROBABILITIES, 5).quantile_bounds, [[-np.inf, np.inf]] * 3)


@pytest.mark.parametrize("n_missing", [0, 1, 7, 30, 59])
@pytest.mark.parametrize("n", [60, 61])
def test_quantiles_of_all_lie_in_their_bounds_whatever_the_missing_values_are(n: int, n_missing: int) -> None:
    """And the bounds are reached: by missing values that are all small, or all large."""
    random = np.random.default_rng(n_missing)
    probabilities = np.array([0.0, 0.025, 0.25, 0.5, 0.75, 0.9, 1.0])
    known = random.normal(0.0, 1.0, n - n_missing)
    bounds = quantile_bounds(known, probabilities, n_missing)
    for loc in (-20.0, -1.0, 0.0, 2.0, 20.0):
        quantiles = np.quantile(np.concatenate([known, random.normal(loc, 1.0, n_missing)]), probabilities)
        assert np.all((bounds[:, 0] - 1e-12 <= quantiles) & (quantiles <= bounds[:, 1] + 1e-12))
        extreme = bounds[:, 0] if loc < -10.0 else bounds[:, 1]
        reached = np.isfinite(extreme) & (abs(loc) > 10.0)
        np.testing.assert_allclose(quantiles[reached], extreme[reached], rtol=1e-12)
    assert np.isfinite(bounds).all() == (n_missing == 0)


@pytest.mark.parametrize("n", [16, 100, 1000, 20000])
def test_a_density_has_as_many_bins_as_its_sample_tells(n: int) -> None:
    """Between Sturges's and what the width of Freedman and Diaconis makes, as numpy's rule has; few for few samples."""
    values = np.random.default_rng(1).normal(size=n)
    found = describe(values, None, (0.5,))
    assert found.pdf.size == np.histogram_bin_edges(values, "auto").size - 1
    assert np.sum(found.pdf * np.diff(found.edges)) == pytest.approx(1.0)


def test_heavy_tails_and_samples_of_one_value_have_bins_too() -> None:
    values = np.random.default_rng(1).standard_cauchy(100_000)
    assert describe(values, None, (0.5,)).pdf.size == 200
    assert 1 <= describe(np.full(50, 3.0), None, (0.5,)).pdf.size <= 10
    assert describe(np.array([2.0]), None, (0.5,)).pdf.size == 1


def test_what_varies_by_round_off_is_constant() -> None:
    """An angle that ends at zero, a coordinate that others dwarf, values that differ in their last bits."""
    noise = np.random.default_rng(3).normal(size=200)
    outputs = {"angle": 1e-15 * noise, "across": 1e-17 * noise, "along": 0.4 + 1e-3 * noise}
    outputs["same"] = 5.0 + 1e-15 * noise
    units = {"angle": "rad", "across": "m", "along": "m", "same": "N"}
    sizes = Peaks(outputs, {}, {}).sizes(units, np.ones(200, dtype=bool))
    for name, values in outputs.items():
        found = describe(values, 10, PROBABILITIES, size=sizes[name], replicates=np.arange(200) % 8)
        assert found.constant == (name != "along") and is_constant(values, sizes[name]) == found.constant, name
        if found.constant:
            assert found.std == 0.0 and np.ptp(found.quantiles) == 0.0
            np.testing.assert_array_equal(found.std_interval, [0.0, 0.0])
    assert not describe(outputs["angle"], 10, PROBABILITIES).constant  # of nothing else is known how large it is
    alone = Peaks({"across": outputs["across"]}, {}, {}).sizes(units, np.ones(200, dtype=bool), length=0.3)
    assert is_constant(outputs["across"], alone["across"])  # beside the mechanism
    assert of_given(outputs["same"], {"a": noise, "b": noise[::-1]}, 0.95) is None


def test_the_size_of_an_output_is_that_of_its_run() -> None:
    """At rest at the end, and far from it before: from extremes, else from the bands of the first samples."""
    fine, end = np.ones(3, dtype=bool), np.array([1e-16, 3e-16, -1e-16])
    extremes = {"x/max": np.array([1.0, 2.0, 3.0]), "x/min": np.array([-4.0, 0.0, 0.0])}
    of_extremes = Peaks({"x": end}, extremes, {})
    np.testing.assert_array_equal(of_extremes.largest("x"), [4.0, 2.0, 3.0])
    of_bands = Peaks({"x": end}, {}, {"x": np.array([[-0.5, 0.0], [0.1, 0.2]])})
    np.testing.assert_array_equal(of_bands.largest("x"), [0.5, 0.2, 0.35])
    assert of_bands.sizes({"x": "m"}, fine) == {"x": 0.5, "x.max": 0.5, "x.min": 0.5}
    np.testing.assert_array_equal(of_extremes.excess(Event(output="x", above=2.5, when="ever")), [-1.5, -0.5, 0.5])
    np.testing.assert_array_equal(of_bands.excess(Event(output="x", below=0.0, when="ever"))[:2], [0.5, 0.0])


def test_an_event_within_the_error_is_not_decided() -> None:
    """512 samples from 3 to 5.6 against a level of 12: in doubt from an error of 12 / 5.6 - 1 on, and four samples,
    which are more than the interval of none is wide, 0.72 %."""
    values = np.linspace(3.0, 5.6, 512)
    limit = holds_to(values - 12.0, values, 0.0072, 0.0)
    assert limit == pytest.approx(12.0 / values[-4] - 1.0, rel=1e-12)
    of = {"count": 0, "n": 512, "estimate": 0.0, "interval": np.array([0.0, 0.007]), "confidence": 0.95}
    chance = Chance("x above 12 at any time", **of, model_error=1.0, holds_to=limit)
    assert chance.is_decided() and not chance.is_decided(1.3)
    said = chance.doubt(1.3)
    assert "not decided by this model" in said and "'pgmp montecarlo SCENE --full -n 512'" in said
    unknown = replace(chance, model_error=np.nan)
    assert not unknown.is_decided() and unknown.is_decided(1.0) and "its error is not known" in unknown.doubt()
    assert "samples lie on the level itself" in replace(chance, holds_to=0.0).doubt()
    # where too many samples failed no model error decides, and no other model is sure to help
    hidden = replace(chance, estimate=np.nan, interval=np.array([0.3, 1.0]), model_error=0.0)
    assert not hidden.is_decided() and hidden.decided_by == ""
    assert not Chance("y", **of, model_error=0.0).is_decided() and "no sample tells" in Chance("y", **of).doubt(0.0)
    # half of the samples in the event: it holds as long as no more than the interval's width is in doubt, or a twentieth
    halves = np.linspace(-1.0, 1.0, 512)
    assert holds_to(halves, np.ones(512), 0.09, 0.5) == pytest.approx(0.09, abs=0.003)
    assert holds_to(halves, np.ones(512), 0.01, 0.5) == pytest.approx(0.05, abs=0.003)
    assert np.isnan(holds_to(np.zeros(0), np.zeros(0), np.nan, 0.0))
    assert holds_to(np.full(9, -1.0), np.zeros(9), 0.3, 0.0) == np.inf
    # an error of the mesh is that of every model: no other one decides
    assert chance.doubt(1.3, of_mesh=1.2).startswith("not decided with this mesh") and not chance.is_of_mesh(0.1)
