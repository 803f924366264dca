"""The lane-vectorised factorisation against dense linear algebra."""

import functools

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from pgmp_petsc.full import batched_ldl
from pgmp_petsc.full.batched_ldl import Symbolic, analyse, factorise, substitute
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import items, width_of
from pgmp_petsc.lanes.vectors import LANES


def saddle_points(seed: int, n: int = 17, n_constraints: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Return random saddle-point matrices of one pattern, shape (LANES, n, n), and the numbers of the multipliers.

    The unknowns are numbered at random, so that multipliers stand anywhere.
    """
    random = np.random.default_rng(seed)
    pattern = np.tril(random.random((n, n)) < 0.2)
    constraint = np.zeros((n_constraints, n), dtype=bool)
    for row in constraint:
        row[random.choice(n, 3, replace=False)] = True
    total = n + n_constraints
    matrices = np.zeros((LANES, total, total))
    for matrix in matrices:
        factor = np.where(pattern, random.normal(size=(n, n)), 0.0)
        matrix[:n, :n] = np.eye(n) + factor @ factor.T
        matrix[n:, :n] = np.where(constraint, random.normal(size=constraint.shape), 0.0)
        matrix[:n, n:] = matrix[n:, :n].T
    shuffled = random.permutation(total)
    where = np.argsort(shuffled)
    return matrices[:, shuffled][:, :, shuffled], where[n:]


@njit(error_model="numpy")
def solved(starts, rows, products, width, matrix, x):
    factorise(starts, rows, products, items(matrix, width))
    substitute(starts, rows, items(matrix, width), items(x, width))


def stored(symbolic: Symbolic, matrices: np.ndarray) -> np.ndarray:
    """Return the diagonal and the entries below it as the factorisation takes them, (n + n_entries, n_lanes)."""
    n_lanes, n = matrices.shape[:2]
    matrix = np.zeros((n + symbolic.rows.size, n_lanes))
    i, j = np.nonzero(np.tril(np.any(matrices != 0.0, axis=0)))
    for place, values in zip(symbolic.position(i, j), matrices[:, i, j].T):
        matrix[-1 - place if place < 0 else n + place] += values
    return matrix


def solve(symbolic: Symbolic, matrices: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve in all lanes; right and result have shape (n_lanes, n)."""
    x = np.ascontiguousarray(right[:, symbolic.order].T)
    width, matrix = width_of(len(matrices)), stored(symbolic, matrices)
    solved(symbolic.starts, symbolic.rows, symbolic.products, width, matrix, x)
    result = np.empty_like(right)
    result[:, symbolic.order] = x.T
    return result


def analysed(matrices: np.ndarray, multipliers: np.ndarray) -> Symbolic:
    levels = np.zeros(matrices.shape[1], dtype=int)
    levels[multipliers] = 1
    return analyse(sp.csr_matrix(np.any(matrices != 0.0, axis=0).astype(float)), levels)


@pytest.mark.parametrize("seed", range(6))
def test_it_solves_as_dense_linear_algebra_does_in_every_lane(seed: int) -> None:
    matrices, multipliers = saddle_points(seed)
    right = np.random.default_rng(100 + seed).normal(size=matrices.shape[:2])
    found = solve(analysed(matrices, multipliers), matrices, right)
    expected = np.linalg.solve(matrices, right[..., None])[..., 0]
    # no pivoting: the growth of these matrices leaves some digits of 1e-16 times their condition number (up to 1e4)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(3))
def test_the_pattern_is_that_of_dense_elimination(seed: int) -> None:
    matrices, multipliers = saddle_points(seed)
    symbolic = analysed(matrices, multipliers)
    filled = np.any(matrices != 0.0, axis=0)[np.ix_(symbolic.order, symbolic.order)]
    n = len(filled)
    for k in range(n):
        below = np.flatnonzero(filled[k + 1 :, k]) + k + 1
        filled[np.ix_(below, below)] = True
    for k in range(n):
        rows = symbolic.rows[symbolic.starts[k] : symbolic.starts[k + 1]]
        np.testing.assert_array_equal(rows, np.flatnonzero(filled[k + 1 :, k]) + k + 1)
    assert symbolic.n == n
    assert sorted(symbolic.order) == list(range(n))


@pytest.mark.parametrize("seed", range(3))
def test_multipliers_come_after_the_unknowns_they_act_on(seed: int) -> None:
    matrices, multipliers = saddle_points(seed)
    symbolic = analysed(matrices, multipliers)
    place = np.argsort(symbolic.order)
    for multiplier in multipliers:
        coupled = np.flatnonzero(matrices[0, multiplier])
        assert place[multiplier] > place[coupled].max()


def test_bulky_bodies_are_eliminated_by_minimum_degree_and_slender_ones_from_end_to_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for shape, is_bulky in (((12, 12, 12), True), ((5, 5, 120), False)):
        parts = [sp.diags([-1.0, 2.1, -1.0], [-1, 0, 1], shape=(n, n)) for n in shape]
        grid = functools.reduce(sp.kronsum, parts)
        matrix = sp.bmat([[grid, sp.eye(grid.shape[0], 3)], [sp.eye(3, grid.shape[0]), None]], format="csr")
        levels = np.repeat([0, 1], [grid.shape[0], 3])
        found = analyse(matrix, levels)
        monkeypatch.setattr(batched_ldl, "MANY", np.inf)
        from_end_to_end = analyse(matrix, levels)
        monkeypatch.undo()
        share = found.n_products.sum() / from_end_to_end.n_products.sum()
        assert share < 0.7 if is_bulky else share == 1.0
        assert from_end_to_end.n_products.sum() > batched_ldl.MANY
        right = np.random.default_rng(0).normal(size=(1, matrix.shape[0]))
        solution = solve(found, matrix.toarray()[None], right)[0]
        np.testing.assert_allclose(solution, spsolve(matrix.tocsc(), right[0]), rtol=0, atol=1e-12)


def test_positions_are_symmetric_and_different() -> None:
    matrices, multipliers = saddle_points(0)
    symbolic = analysed(matrices, multipliers)
    i, j = np.nonzero(np.tril(np.any(matrices != 0.0, axis=0)))
    places = symbolic.position(i, j)
    np.testing.assert_array_equal(places, symbolic.position(j, i))
    assert np.unique(places).size == places.size
    np.testing.assert_array_equal(places < 0, i == j)


@pytest.mark.parametrize("spoilt", [0, 3, LANES - 1])
@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 1e300])
def test_a_lane_does_not_touch_the_others(spoilt: int, value: float) -> None:
    matrices, multipliers = saddle_points(1)
    right = np.random.default_rng(5).normal(size=matrices.shape[:2])
    symbolic = analysed(matrices, multipliers)
    expected = solve(symbolic, matrices, right)
    wrong, wrong_right = matrices.copy(), right.copy()
    wrong[spoilt][wrong[spoilt] != 0.0] = value
    wrong_right[spoilt] = value
    others = np.arange(LANES) != spoilt
    found = solve(symbolic, wrong, wrong_right)
    np.testing.assert_array_equal(found[others], expected[others])
    assert not np.array_equal(found[~others], expected[~others])


def test_a_sample_gives_the_same_in_any_lane_and_alone_to_the_last_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many products there are."""
    matrices, multipliers = saddle_points(3)
    right, order = np.random.default_rng(8).normal(size=matrices.shape[:2]), np.random.default_rng(7).permutation(LANES)
    together = solve(analysed(matrices, multipliers), matrices, right)
    for most_listed in (batched_ldl.MOST_LISTED, 0):  # products one by one, and in stretches
        monkeypatch.setattr(batched_ldl, "MOST_LISTED", most_listed)
        symbolic = analysed(matrices, multipliers)
        assert (symbolic.products[0].size == 0) is (most_listed == 0)
        np.testing.assert_array_equal(solve(symbolic, matrices, right), together)
        np.testing.assert_array_equal(solve(symbolic, matrices[order], right[order]), together[order])
        alone = [solve(symbolic, matrices[k : k + 1], right[k : k + 1])[0] for k in range(LANES)]
        np.testing.assert_array_equal(alone, together)
