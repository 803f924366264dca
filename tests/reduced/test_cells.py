"""Polynomials in the cells of a table, worked out before or made on the way, against the interpolant."""

import numpy as np
import pytest

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.reduced.cells import N_HELD, Cells, place_of
from pgmp_petsc.reduced.terms import grid_of
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.sample_grid import SampleGrid, Samples

LOWER, UPPER, PERIODIC = (0.0, -0.3, 0.2), (2 * np.pi, 0.9, 1.7), (True, False, False)


@njit(entry=True)
def asked(cells: Cells, cell: int) -> int:
    """Return where the polynomials of a cell are."""
    return place_of(cells, cell)


def sampled(n: tuple[int, ...]) -> SampleGrid:
    """Return a grid with so many samples along the coordinates."""
    return SampleGrid(tuple(Samples.uniform(*ends, k, turns) for *ends, k, turns in zip(LOWER, UPPER, n, PERIODIC)))


@pytest.mark.parametrize("scheme", ["overhauser", "spline"])
@pytest.mark.parametrize("n", [(9,), (9, 7), (9, 7, 6)])
@pytest.mark.parametrize("n_powers", [4, 8])
def test_the_polynomials_of_cells_are_the_interpolant(scheme: str, n: tuple[int, ...], n_powers: int) -> None:
    """More cells are asked for than are held, some of them again."""
    grid, r = sampled(n), len(n)
    found = interpolant(grid, np.random.default_rng(0).normal(size=(grid.n, 2, 3)), scheme)
    axes = grid_of(found)
    cells = Cells.of(found, axes, n_powers)
    for theta in np.random.default_rng(1).uniform(LOWER[:r], UPPER[:r], size=(4 * N_HELD, r)).repeat(2, axis=0):
        number, powers = 0, np.ones(1)
        for x, axis in zip(theta, axes):
            cell = int((x - axis.lower) / axis.step)
            place = x - axis.lower - cell * axis.step
            number, powers = (
                number * axis.n_cells + cell,
                np.multiply.outer(powers, place ** np.arange(n_powers)).ravel(),
            )
        of_cell = cells.polynomials[asked(cells, number)].reshape(2, 3, -1)
        np.testing.assert_allclose(of_cell @ powers, found(theta[None])[0], rtol=0, atol=1e-10)


@pytest.mark.parametrize(("scheme", "order"), [("overhauser", 3), ("spline", 4)])
def test_the_order_over_three_coordinates(scheme: str, order: int) -> None:
    def exact(theta: np.ndarray) -> np.ndarray:
        return np.sin(theta[:, 0] + 2.0 * theta[:, 1]) * np.exp(theta[:, 2] - theta[:, 1])

    theta, errors = np.random.default_rng(2).uniform(LOWER, UPPER, size=(400, 3)), []
    for n in (12, 24):
        grid = sampled((2 * n, n + 1, n + 1))
        errors.append(np.abs(interpolant(grid, exact(grid.theta), scheme)(theta) - exact(theta)).max())
    assert np.log2(errors[0] / errors[1]) > order - 0.4
