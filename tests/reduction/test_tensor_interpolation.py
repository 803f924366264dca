"""Interpolation over two coordinates: the tensor product of the schemes along each axis."""

import numpy as np
import pytest

from pgmp_petsc.reduction.interpolation import FINE_OF_MORE, Interpolant, interpolant, samples_for
from pgmp_petsc.reduction.sample_grid import SampleGrid

SCHEMES = ["overhauser", "spline", "spectral"]
UPPER = (2 * np.pi, 1.5)  # a revolution, and a limited range
POINTS = np.random.default_rng(3).uniform(size=(200, 2)) * UPPER


def grid_of(scheme: str, n: tuple[int, int]) -> SampleGrid:
    """Return samples of a revolution times a limited range."""
    return SampleGrid(
        (
            samples_for(scheme, 0.0, UPPER[0], n[0], periodic=True),
            samples_for(scheme, 0.0, UPPER[1], n[1], periodic=False),
        )
    )


def smooth(theta: np.ndarray) -> np.ndarray:
    """Return a function that is no product, shape (n, 2)."""
    x, y = theta.T
    return np.stack([np.exp(np.sin(x + y)), np.cos(2 * x - 1.3 * y)], axis=-1)


def slopes(theta: np.ndarray) -> np.ndarray:
    """Return the derivatives of `smooth`, shape (n_theta, n, 2)."""
    x, y = theta.T
    first = np.exp(np.sin(x + y)) * np.cos(x + y)
    return np.stack(
        [np.stack([first, -2 * np.sin(2 * x - 1.3 * y)], -1), np.stack([first, 1.3 * np.sin(2 * x - 1.3 * y)], -1)]
    )


def errors(scheme: str, n: tuple[int, int]) -> np.ndarray:
    """Return the largest errors of value and slopes."""
    grid = grid_of(scheme, n)
    found = interpolant(grid, smooth(grid.theta), scheme)
    wrong = [found(POINTS) - smooth(POINTS), *(found.slope(POINTS, k) - slopes(POINTS)[k] for k in (0, 1))]
    return np.array([np.abs(part).max() for part in wrong])


@pytest.mark.parametrize(("scheme", "order"), [("overhauser", 3), ("spline", 4)])
def test_the_order_is_that_of_one_axis(scheme: str, order: int) -> None:
    found = np.array([errors(scheme, n) for n in ((48, 25), (96, 49))])
    # at points by chance, which lie elsewhere in the cells of the finer grid
    assert np.all(np.log2(found[0] / found[1]) > np.array([order, order - 1, order - 1]) - 0.4)


def test_the_spectral_error_is_that_of_the_fine_grid() -> None:
    step = 2 * np.pi / FINE_OF_MORE
    # derivatives of fourth order are of 16 at most along the revolution, which has the longer step
    assert np.all(errors("spectral", (40, 24)) < 50 * np.array([step**4 / 384, step**3 / 24, step**3 / 24]))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_slopes_are_derivatives_of_the_interpolant(scheme: str) -> None:
    grid = grid_of(scheme, (9, 7))
    found = interpolant(grid, np.random.default_rng(0).normal(size=(grid.n, 2)), scheme)
    for k, axis in enumerate(found.axes):
        step = 1e-4 * axis.step * np.eye(2)[k]
        middle = (np.floor(POINTS / axis.step) + 0.4) * axis.step
        inside = middle[middle[:, 1] < UPPER[1] - axis.step]
        difference = (found(inside + step) - found(inside - step)) / (2 * step[k])
        np.testing.assert_allclose(found.slope(inside, k), difference, rtol=0, atol=1e-4 / axis.step**2)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_function_of_one_coordinate_is_interpolated_as_over_one(scheme: str) -> None:
    grid = grid_of(scheme, (12, 8))
    values = np.random.default_rng(1).normal(size=12)
    alone = interpolant(SampleGrid(grid.axes[:1]), values, scheme)
    found = interpolant(grid, np.repeat(values, 8), scheme)
    # a spectral interpolant of one coordinate has the finer grid
    tolerance = 1e-2 if scheme == "spectral" else 1e-13
    np.testing.assert_allclose(found(POINTS), alone(POINTS[:, 0]), rtol=0, atol=tolerance)


def test_samples_are_reproduced_and_products_are_sums() -> None:
    grid = grid_of("spline", (10, 6))
    random = np.random.default_rng(2)
    table, vectors = random.normal(size=(grid.n, 3, 4)), random.normal(size=(len(POINTS), 3))
    found: Interpolant = interpolant(grid, table, "spline")
    np.testing.assert_allclose(found(grid.theta), table, rtol=0, atol=1e-12)
    expected = np.einsum("ki,kij->kj", vectors, found(POINTS))
    products = found.product(POINTS, vectors)
    np.testing.assert_allclose(products, expected, rtol=0, atol=1e-13)
    for k in range(2):
        slopes = np.einsum("ki,kij->kj", vectors, found.slope(POINTS, k))
        np.testing.assert_allclose(found.product(POINTS, vectors, k), slopes, rtol=0, atol=1e-13 * np.abs(slopes).max())
    # whatever is beside it, in whichever lane: alone, and with others of its own cell, in another order
    for k in range(len(POINTS)):
        np.testing.assert_array_equal(found.product(POINTS[k : k + 1], vectors[k : k + 1])[0], products[k])
    crowd = np.concatenate([np.arange(len(POINTS))[::-1], np.repeat(np.arange(5), 13)])
    np.testing.assert_array_equal(found.product(POINTS[crowd], vectors[crowd]), products[crowd])
