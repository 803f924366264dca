"""Test values and nodes: quantiles inside the bounds, apart from each other; response surfaces exact on polynomials."""

import numpy as np
import pytest
from scipy import stats

from pgmp_petsc.bench.candidates import ResponseSurface, node_counts
from pgmp_petsc.bench.cases import box, held_out, node_values, quantiles
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.scene.parameters import uncertain_names
from scenes import SLIDER_CRANK

NORMAL = 'parameters.r1.distribution={name="norm", loc=5.6e-3, scale=0.56e-3}'
DENSITY = 'parameters.rho={nominal=7800.0, distribution={name="uniform", loc=7700.0, scale=200.0}}'
LAW = stats.norm(5.6e-3, 0.56e-3)


def scene(*overrides: str) -> Scene:
    return scene_from_toml(SLIDER_CRANK, ".", overrides)


def test_without_distributions_there_is_the_value_of_the_run() -> None:
    assert held_out(scene())[0] == {"r1": np.array([5.6e-3])}
    assert uncertain_names(scene()) == [] and node_counts(0, 4) == []
    no_parameters = scene("parameters={}", "bodies.crank.section.radius=5e-3")
    assert held_out(no_parameters)[0] == {}
    assert (node_counts(1, 4), node_counts(3, 3)) == ([3, 5, 9, 17], [7, 14, 28])
    wide = scene('parameters.r1.distribution={name="norm", loc=5.6e-3, scale=5.6e-3}')
    assert quantiles(wide, np.array([[0.001], [0.01]])).min() > 0.0


def test_one_parameter_takes_quantiles_at_equal_distances() -> None:
    values = held_out(scene(NORMAL))[0]["r1"]
    np.testing.assert_allclose(LAW.cdf(values), np.linspace(0.01, 0.99, 8), rtol=1e-9)
    nodes = node_values(scene(NORMAL), 5)[:, 0]
    np.testing.assert_allclose(nodes, np.linspace(LAW.ppf(0.001), LAW.ppf(0.999), 5), rtol=1e-9)


@pytest.mark.parametrize("n", node_counts(1, 4))
def test_test_values_are_no_nodes(n: int) -> None:
    nodes, values = node_values(scene(NORMAL), n)[:, 0], held_out(scene(NORMAL))[0]["r1"]
    assert np.min(np.abs(nodes[:, None] - values)) > 1e-3 * np.ptp(nodes) / n


def test_bounds_cut_the_distribution_off() -> None:
    values = held_out(scene(NORMAL, "parameters.r1.bounds=[5.6e-3, 7.0e-3]"))[0]["r1"]
    assert values.min() > 5.6e-3 and values.max() < 7.0e-3
    share = (LAW.cdf(values) - 0.5) / (LAW.cdf(7.0e-3) - 0.5)
    np.testing.assert_allclose(share, np.linspace(0.01, 0.99, 8), rtol=1e-9)


def test_several_parameters_fill_a_latin_hypercube() -> None:
    both = scene(NORMAL, DENSITY, 'materials.steel.rho="rho"')
    values = held_out(both)[0]
    for name, law in (("r1", LAW), ("rho", stats.uniform(7700.0, 200.0))):
        np.testing.assert_allclose(np.sort(law.cdf(values[name])), np.linspace(0.01, 0.99, 8), rtol=1e-6)
    assert not np.array_equal(np.argsort(values["r1"]), np.argsort(values["rho"]))
    nodes, (low, high) = node_values(both, 20), box(both)
    assert nodes.shape == (20, 2) and (nodes >= low).all() and (nodes <= high).all()
    np.testing.assert_array_equal(node_values(both, 20), nodes)


@pytest.mark.parametrize(("n", "degree"), [(3, 2), (5, 3), (9, 3)])
def test_one_parameter_is_exact_on_polynomials(n: int, degree: int) -> None:
    coefficients = np.array([[1.0, -2.0, 0.5, 3.0], [0.0, 1.0, -1.0, 2.0]])[:, : degree + 1]

    def exact(x: np.ndarray) -> dict[str, np.ndarray]:
        powers = np.array([(1e3 * x) ** k for k in range(degree + 1)])
        return {"a": coefficients @ powers, "b": -coefficients @ powers}

    nodes, points = np.linspace(4e-3, 7e-3, n), np.array([4.1e-3, 5.5e-3, 6.999e-3])
    found = ResponseSurface(nodes[:, None], exact(nodes)).evaluate(points[:, None])
    for name, values in exact(points).items():
        # nodes of some 1e2 in a cubic of a few 1e2: round-off only
        np.testing.assert_allclose(found[name], values, rtol=1e-11, atol=1e-9)


@pytest.mark.parametrize(("n", "degree"), [(5, 1), (10, 2), (20, 2)])
def test_several_parameters_are_exact_on_polynomials(n: int, degree: int) -> None:
    random = np.random.default_rng(3)
    nodes, points = random.uniform([1.0, 7700.0], [2.0, 7900.0], (n, 2)), np.array([[1.5, 7800.0], [1.2, 7850.0]])

    def exact(x: np.ndarray) -> dict[str, np.ndarray]:
        u, v = x[:, 0], (x[:, 1] - 7800.0) / 100.0
        linear = 1.0 + 2.0 * u - v
        return {"a": np.array([linear, linear + (u * v + v**2 if degree == 2 else 0.0)])}

    found = ResponseSurface(nodes, exact(nodes)).evaluate(points)
    np.testing.assert_allclose(found["a"], exact(points)["a"], rtol=1e-9)
    with pytest.raises(ValueError, match="at least 4"):
        ResponseSurface(np.eye(3)[:, :2], {"a": np.zeros((1, 3))})


def test_where_a_run_has_no_number_the_surface_has_none() -> None:
    nodes = np.linspace(0.0, 1.0, 5)
    outputs = {"a": np.array([nodes, np.where(nodes > 0.9, np.nan, nodes)]), "b": np.array([nodes**2, nodes**3])}
    found = ResponseSurface(nodes[:, None], outputs).evaluate(np.array([[0.3], [0.6]]))
    np.testing.assert_allclose(found["a"], [[0.3, 0.6], [np.nan, np.nan]], rtol=1e-12)
    np.testing.assert_allclose(found["b"], [[0.09, 0.36], [0.027, 0.216]], rtol=1e-12)
