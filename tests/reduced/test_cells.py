"""Polynomials in the cells of a table, made when they are asked for, against the interpolant."""

import numpy as np
import pytest
from runs import place_in

from pgmp_petsc.reduced import cells as cells_module
from pgmp_petsc.reduced.cells import FEWEST_HELD, Cells
from pgmp_petsc.reduced.terms import grid_of
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.sample_grid import SampleGrid, Samples

LOWER, UPPER, PERIODIC = (0.0, -0.3, 0.2), (2 * np.pi, 0.9, 1.7), (True, False, False)


def sampled(n: tuple[int, ...]) -> SampleGrid:
    """Return a grid with so many samples along the coordinates."""
    return SampleGrid(tuple(Samples.uniform(*ends, k, turns) for *ends, k, turns in zip(LOWER, UPPER, n, PERIODIC)))


@pytest.mark.parametrize("scheme", ["overhauser", "spline"])
@pytest.mark.parametrize("n", [(9,), (9, 7), (9, 7, 6)])
@pytest.mark.parametrize("n_powers", [4, 8])
@pytest.mark.parametrize("most_held", [0, 2**22])
def test_the_polynomials_of_cells_are_the_interpolant(
    scheme: str, n: tuple[int, ...], n_powers: int, most_held: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All cells are held, or more are asked for than are held, some of them again."""
    monkeypatch.setattr(cells_module, "MOST_HELD", most_held)
    grid, r = sampled(n), len(n)
    found = interpolant(grid, np.random.default_rng(0).normal(size=(grid.n, 2, 3)), scheme)
    axes = grid_of(found)
    cells = Cells.of(found, axes, n_powers)
    for theta in np.random.default_rng(1).uniform(LOWER[:r], UPPER[:r], size=(4 * FEWEST_HELD, r)).repeat(2, axis=0):
        number, powers = 0, np.ones(1)
        for x, axis in zip(theta, axes):
            cell = int((x - axis.lower) / axis.step)
            place = x - axis.lower - cell * axis.step
            number, powers = (
                number * axis.n_cells + cell,
                np.multiply.outer(powers, place ** np.arange(n_powers)).ravel(),
            )
        of_cell = cells.polynomials[place_in(cells, number)].reshape(2, 3, -1)
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
