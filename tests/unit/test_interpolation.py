"""Overhauser interpolation: order, exactness, continuity, slopes, ends of the range."""

from __future__ import annotations

import numpy as np
import pytest

from pgmp_petsc.reduction.interpolation import N_ROWS, interpolate, interpolate_slope, stencil
from pgmp_petsc.reduction.tables import Grid

PERIODIC = [True, False]


def smooth(theta: np.ndarray) -> np.ndarray:
    """Return a function of period 2 pi, with trailing axes, shape (n, 2)."""
    return np.stack([np.exp(np.sin(theta)), np.cos(2 * theta + 0.3)], axis=-1)


def smooth_slope(theta: np.ndarray) -> np.ndarray:
    """Return the derivative of `smooth`."""
    return np.stack([np.cos(theta) * np.exp(np.sin(theta)), -2 * np.sin(2 * theta + 0.3)], axis=-1)


def grid_of(n: int, periodic: bool) -> Grid:
    """Return a grid over one revolution."""
    return Grid.over(0.4, 0.4 + 2 * np.pi, n if periodic else n + 1, periodic)


@pytest.mark.parametrize("periodic", PERIODIC)
@pytest.mark.parametrize(
    ("function", "exact", "order"), [(interpolate, smooth, 3), (interpolate_slope, smooth_slope, 2)]
)
def test_the_order_of_value_and_slope(periodic: bool, function, exact, order: int) -> None:
    theta = np.linspace(0.4, 0.4 + 2 * np.pi, 2003)
    errors = []
    for n in (40, 80, 160):
        grid = grid_of(n, periodic)
        errors.append(np.max(np.abs(function(grid, smooth(grid.theta), theta) - exact(theta))))
    observed = np.log2(np.array(errors[:-1]) / errors[1:])
    # the next term of the error is a step smaller, so 0.1 is left at these grids
    np.testing.assert_allclose(observed, order, rtol=0, atol=0.15)


@pytest.mark.parametrize("cell", ["first", "last"])
def test_the_end_cells_of_a_range_are_of_the_same_order(cell: str) -> None:
    errors = []
    for n in (40, 80, 160):
        grid = grid_of(n, periodic=False)
        start = grid.lower if cell == "first" else grid.upper - grid.step
        theta = start + grid.step * np.linspace(0.0, 1.0, 101)
        errors.append(np.max(np.abs(interpolate(grid, smooth(grid.theta), theta) - smooth(theta))))
    assert np.all(np.log2(np.array(errors[:-1]) / errors[1:]) > 2.8)


@pytest.mark.parametrize("periodic", PERIODIC)
def test_samples_are_reproduced(periodic: bool) -> None:
    grid = grid_of(12, periodic)
    table = np.random.default_rng(0).normal(size=(grid.n, 3, 2))
    # theta of a sample is a sum and a product: s is round-off and not zero
    np.testing.assert_allclose(interpolate(grid, table, grid.theta), table, rtol=0, atol=1e-13)


@pytest.mark.parametrize("periodic", PERIODIC)
def test_the_slope_is_the_derivative_of_the_interpolant(periodic: bool) -> None:
    grid, step = grid_of(9, periodic), 1e-4
    table = np.random.default_rng(0).normal(size=(grid.n, 2))
    theta = grid.lower + grid.step * (np.arange(9)[:, None] + np.array([0.01, 0.3, 0.5, 0.9, 0.99])).ravel()
    ahead, behind = interpolate(grid, table, theta + step), interpolate(grid, table, theta - step)
    # a cubic's central difference errs by step^2 times its third derivative over 6
    np.testing.assert_allclose(interpolate_slope(grid, table, theta), (ahead - behind) / (2 * step), atol=1e-6)


@pytest.mark.parametrize("n", [3, 4, 7])
def test_quadratics_are_exact_up_to_the_ends_of_a_range(n: int) -> None:
    grid = Grid.over(-1.0, 2.0, n, periodic=False)
    theta = np.linspace(-1.0, 2.0, 61)
    table = 2.0 - 3.0 * grid.theta + 0.5 * grid.theta**2
    np.testing.assert_allclose(interpolate(grid, table, theta), 2.0 - 3.0 * theta + 0.5 * theta**2, atol=1e-13)
    np.testing.assert_allclose(interpolate_slope(grid, table, theta), -3.0 + theta, rtol=0, atol=1e-12)


@pytest.mark.parametrize("periodic", PERIODIC)
def test_value_and_slope_are_continuous_at_the_samples(periodic: bool) -> None:
    grid, tiny = grid_of(8, periodic), 1e-9
    table = np.random.default_rng(0).normal(size=grid.n)
    knots = grid.theta if periodic else grid.theta[1:-1]
    for function in (interpolate, interpolate_slope):
        left, right = function(grid, table, knots - tiny), function(grid, table, knots + tiny)
        # what changes over 2e-9 with second derivatives of order 10
        np.testing.assert_allclose(left, right, rtol=0, atol=1e-6)


def test_the_tangent_at_a_sample_is_the_central_difference() -> None:
    # (20) of the paper is misprinted: its tangent would scale with the step
    grid = grid_of(10, periodic=True)
    table = np.random.default_rng(0).normal(size=10)
    central = (np.roll(table, -1) - np.roll(table, 1)) / (2 * grid.step)
    np.testing.assert_allclose(interpolate_slope(grid, table, grid.theta), central, rtol=0, atol=1e-11)


@pytest.mark.parametrize("turns", [-3, -1, 1, 40])
def test_a_periodic_table_goes_on_for_ever(turns: int) -> None:
    grid = grid_of(11, periodic=True)
    table = np.random.default_rng(0).normal(size=(11, 2))
    theta = np.linspace(0.4, 0.4 + 2 * np.pi, 50)
    for function in (interpolate, interpolate_slope):
        np.testing.assert_allclose(
            function(grid, table, theta + 2 * np.pi * turns), function(grid, table, theta), rtol=0, atol=1e-10
        )


def test_a_range_that_is_not_periodic_ends_at_its_last_sample() -> None:
    grid = grid_of(11, periodic=False)
    table = np.random.default_rng(0).normal(size=grid.n)
    ends = np.array([grid.lower, grid.upper])
    np.testing.assert_allclose(interpolate(grid, table, ends), table[[0, -1]], rtol=0, atol=1e-12)


@pytest.mark.parametrize("periodic", PERIODIC)
@pytest.mark.parametrize("n", [4, 5, 9])
def test_weights_sum_to_one_and_slopes_to_zero_on_rows_that_exist(periodic: bool, n: int) -> None:
    rows = np.empty(N_ROWS, dtype=np.int64)
    weights, slopes = np.empty(N_ROWS), np.empty(N_ROWS)
    for theta in np.linspace(0.0, 1.0, 37):
        stencil(theta, 0.0, 1.0 / (n if periodic else n - 1), n, periodic, rows, weights, slopes)
        assert rows.min() >= 0 and rows.max() < n
        assert weights.sum() == pytest.approx(1.0, abs=1e-14)
        assert slopes.sum() == pytest.approx(0.0, abs=1e-12)
