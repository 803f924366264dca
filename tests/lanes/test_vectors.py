"""Samples side by side in registers: arithmetic, polynomials, cells and bordered matrices, each against numpy."""

import numpy as np
import pytest
from numpy.polynomial import polynomial as series

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import absolute, floor
from pgmp_petsc.lanes.vectors import (
    EVERY_LANE,
    LANES,
    N_POWERS,
    aligned_zeros,
    beyond,
    count_lanes,
    differing,
    equal,
    first_lane,
    larger,
    load,
    load_rows,
    polynomial,
    select,
    spread,
    store,
)
from pgmp_petsc.reduced.arrays import Matrix
from pgmp_petsc.reduced.bordered import eliminate, solve
from pgmp_petsc.reduced.cells import Cells, Grid, enter_cells, refill
from pgmp_petsc.reduced.terms import pack

RANDOM = np.random.default_rng(0)


def vectors(values: np.ndarray) -> np.ndarray:
    """Return an aligned copy of (n, LANES)."""
    result = aligned_zeros(values.shape)
    result[:] = values
    return result


@njit(error_model="numpy")
def computed(x, result):
    a, b = load(x, 0), load(x, 1)
    store(result, 0, (a + b) * a - b / (2.0 + a * a))
    store(result, 1, -a + 3.0)
    store(result, 2, absolute(b))
    store(result, 3, floor(a))
    store(result, 4, larger(a, b))
    store(result, 5, select(beyond(a, b), a, spread(7.0)))


@njit(error_model="numpy")
def compared(x):
    a, b = load(x, 0), load(x, 1)
    more = beyond(a, b)
    return more, differing(a, b), equal(a, b), count_lanes(more), first_lane(more)


def test_arithmetic_is_that_of_every_lane() -> None:
    x, result = vectors(RANDOM.normal(size=(2, LANES))), aligned_zeros((6, LANES))
    computed(x, result)
    a, b = x
    expected = [
        (a + b) * a - b / (2.0 + a * a), 3.0 - a, abs(b), np.floor(a), np.maximum(a, b),
        np.where(a > b, a, 7.0),
    ]  # fmt: skip
    np.testing.assert_allclose(result, expected, rtol=1e-14, atol=1e-14)


def test_sets_of_lanes_know_what_is_no_number() -> None:
    x = vectors(np.array([np.arange(LANES), np.full(LANES, 4.0)], dtype=float))
    x[0, 6] = np.nan
    more, other, same, count, first = compared(x)
    assert (more, other, same, count, first) == (0b11100000 | 0b01000000, 0b11101111, 0b00010000, 3, 5)


@njit(error_model="numpy")
def evaluated(kept, entry, places, like, values):
    place = load_rows(places, 0, 1, like)
    value, slopes = polynomial(kept, entry, place)
    store(values, 0, value)
    for k in range(len(slopes)):
        store(values, 1 + k, slopes[k])


@pytest.mark.parametrize("r", [1, 2, 3])
def test_polynomials_of_any_number_of_coordinates(r: int) -> None:
    coefficients, places = RANDOM.normal(size=(2, 4**r, LANES)), vectors(RANDOM.normal(size=(r, LANES)))
    values = aligned_zeros((1 + r, LANES))
    evaluated(vectors(coefficients.reshape(-1, LANES)), 1, places, tuple(range(r)), values)
    for lane in range(LANES):
        whole = coefficients[1, :, lane].reshape((4,) * r)

        def value(c: np.ndarray) -> float:
            for s in places[:, lane]:
                c = series.polyval(s, c)
            return float(c)

        expected = [value(whole), *(value(series.polyder(whole, axis=k)) for k in range(r))]
        np.testing.assert_allclose(values[:, lane], expected, rtol=1e-11, atol=1e-11)


@njit(error_model="numpy")
def locate(theta, grid, cells, places):
    return enter_cells(theta, grid, places, cells, 0)


def located(theta: np.ndarray, grid: tuple[Grid, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells of theta (n_theta, LANES), (LANES,), and the places in them, (n_theta, LANES)."""
    cells, places = vectors(np.full((1, LANES), -1.0)), aligned_zeros((len(grid), LANES))
    assert locate(theta, grid, cells, places) == EVERY_LANE
    assert locate(theta, grid, cells, places) == 0
    return cells[0], places


def cells_of(table: np.ndarray) -> Cells:
    """Return cells with polynomials (n_cells, n_terms, n_coefficients)."""
    return Cells.none(1)._replace(polynomials=table, held=np.arange(len(table)), room=np.empty((2, table[0].size)))


def test_what_is_out_of_all_measure_has_a_cell() -> None:
    theta = vectors(np.array([[np.nan, np.inf, -np.inf, 1e10, 0.5, 2.3, 0.4, 1.0]]))
    cells, places = located(theta, (Grid.even(0.5, 0.25, 7, False),))
    np.testing.assert_array_equal(cells, [0, 0, 0, 0, 0, 6, 0, 2])
    np.testing.assert_allclose(places[0], [0, 0, 0, 0, 0, 0.3, -0.1, 0.0], rtol=0, atol=1e-15)


def test_places_are_in_the_cell_in_which_a_polynomial_begins() -> None:
    """Thetas in three turns of a range of six cells, of which the second to the fourth have one polynomial."""
    theta = vectors(np.array([[0.1, 0.6, 1.1, 1.9, 2.1, -0.1, 3.6, -1.6]]))
    cells, places = located(theta, (Grid(0.0, 0.5, 6, True, np.array([0.0, 1.0, 1.0, 1.0, 4.0, 5.0])),))
    np.testing.assert_array_equal(cells, [0, 1, 1, 1, 4, 5, 1, 1])
    np.testing.assert_allclose(places[0], [0.1, 0.1, 0.6, 1.4, 0.1, 0.4, 0.1, 0.9], rtol=0, atol=1e-15)


@pytest.mark.parametrize("periodic", [True, False])
def test_a_cell_gives_the_weighted_sum_of_its_terms(periodic: bool) -> None:
    """Two groups of coefficients, of which the first ones of each are left alone; thetas beyond a revolution."""
    grid = Grid.even(0.5, 0.25, 7, periodic)
    table, weights = RANDOM.normal(size=(7, 3, 20)), vectors(RANDOM.normal(size=(3, LANES)))
    slots, kept = np.array([0, 1, 1]), aligned_zeros((2 * 20, LANES))
    theta = vectors(RANDOM.uniform(-2.0, 5.0, (1, LANES)) if periodic else RANDOM.uniform(0.5, 2.25, (1, LANES)))
    cells, places = located(theta, (grid,))
    assert np.all((places >= 0.0) & (places <= 0.25))
    np.testing.assert_array_equal(cells, np.floor((theta[0] - 0.5) / 0.25) % 7)
    refill(cells_of(table), cells, EVERY_LANE, weights, slots, N_POWERS, kept)
    for lane, cell in enumerate(cells.astype(int)):
        for group in range(2):
            chosen = slots == group
            expected = weights[chosen, lane] @ table[cell, chosen]
            found = kept.reshape(2, 20, LANES)[group, :, lane]
            np.testing.assert_allclose(found[N_POWERS:], expected[N_POWERS:], rtol=0, atol=1e-14)
            assert not found[:N_POWERS].any()


def test_lanes_that_enter_a_cell_together_get_what_each_gets_alone() -> None:
    table, weights, slots = RANDOM.normal(size=(2, 3, 20)), vectors(RANDOM.normal(size=(3, LANES))), np.array([0, 0, 1])
    all_lanes, some, alone = (aligned_zeros((2 * 20, LANES)) for _ in range(3))
    cells, numbers = cells_of(table), vectors(np.ones((1, LANES)))[0]
    refill(cells, numbers, EVERY_LANE, weights, slots, 0, all_lanes)
    refill(cells, numbers, 0b10110010, weights, slots, 0, some)
    for lane in range(LANES):
        refill(cells, numbers, 1 << lane, weights, slots, 0, alone)
    np.testing.assert_array_equal(all_lanes, alone)
    np.testing.assert_array_equal(some[:, [1, 4, 5, 7]], alone[:, [1, 4, 5, 7]])
    assert not some[:, [0, 2, 3, 6]].any()


def bordered(m: int, r: int, skew: float, random: np.random.Generator) -> tuple[np.ndarray, Matrix, np.ndarray]:
    """Return what solves bordered systems (r + m, LANES), the matrices and their right-hand sides.

    The flexible block has a skew part of a size; none if it is 0.
    """
    factor, odd = random.normal(size=(LANES, m, m)), skew * np.tril(random.normal(size=(LANES, m, m)), -1)
    even = factor @ np.swapaxes(factor, 1, 2) + np.eye(m)
    whole = random.normal(size=(LANES, r + m, r + m))
    whole[:, :r, :r] += 10.0 * m * np.eye(r)
    whole[:, r:, r:] = even + odd - np.swapaxes(odd, 1, 2)
    parts = (whole[:, :r, :r], np.swapaxes(whole[:, r:, :r], 1, 2), whole[:, :r, r:])
    packed_skew = vectors(pack(odd).T) if skew else aligned_zeros((0, LANES))
    matrix = Matrix(vectors(pack(even).T), *(vectors(part.reshape(LANES, -1).T) for part in parts), packed_skew)
    x = random.normal(size=(r + m, LANES))
    return x, matrix, vectors(np.einsum("lij,jl->il", whole, x))


@njit(error_model="numpy")
def solved(matrix, r, m, x, scratch):
    """Call what runs have compiled, which Python would have compiled once more."""
    eliminate(matrix, r, m)
    solve(matrix, r, m, x, scratch)


@pytest.mark.parametrize("wrong", [-1.0, np.nan])
def test_a_matrix_that_is_not_positive_definite_spoils_its_own_lane(wrong: float) -> None:
    (good, right), (bad, wrong_right) = (bordered(4, 1, 1e-2, np.random.default_rng(3))[1:] for _ in range(2))
    bad.factor[5, 3] *= wrong  # the diagonal of row 2
    for matrix, x in ((good, right), (bad, wrong_right)):
        solved(matrix, 1, 4, x, aligned_zeros((1, LANES)))
    assert np.isnan(wrong_right[:, 3]).all()
    others = np.arange(LANES) != 3
    np.testing.assert_array_equal(wrong_right[:, others], right[:, others])


@pytest.mark.parametrize("r", [1, 2, 3])
@pytest.mark.parametrize("m", [1, 2, 3, 4, 7, 15])
@pytest.mark.parametrize("skew", [0.0, 1e-2])
def test_bordered_matrices_are_solved(m: int, r: int, skew: float) -> None:
    x, matrix, right = bordered(m, r, skew, RANDOM)
    solved(matrix, r, m, right, aligned_zeros((r, LANES)))
    np.testing.assert_allclose(right, x, rtol=1e-9, atol=1e-9)
