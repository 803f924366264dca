"""The sparse null space: C N = 0, rank, sparsity, redundant rows."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

from pgmp_petsc.mechanism.body_frames import ConstraintJacobian, constraint_jacobian
from pgmp_petsc.mechanism.constraint_set import NullSpace, NullSpaces, null_space
from scenes import four_bar, kinematics_of, slider_crank, trammel


def check(constraints: np.ndarray) -> NullSpace:
    """Check every property of a null space and return it."""
    result = null_space(sp.csr_matrix(constraints))
    n_rows, n_dofs = constraints.shape
    rank = np.linalg.matrix_rank(constraints) if n_rows else 0
    matrix = result.matrix.toarray()
    assert matrix.shape == (n_dofs, n_dofs - rank)
    assert result.n_redundant == n_rows - rank
    size = max(1.0, np.abs(constraints).max(initial=0.0) * np.abs(matrix).max(initial=0.0))
    np.testing.assert_allclose(constraints @ matrix, 0.0, rtol=0, atol=1e-13 * size)
    np.testing.assert_array_equal(matrix[result.independent], np.eye(n_dofs - rank))
    assert np.all(np.diff(result.independent) > 0)
    return result


@pytest.mark.parametrize(("n_rows", "n_dofs"), [(1, 1), (1, 5), (3, 8), (6, 6), (10, 40)])
@pytest.mark.parametrize("seed", [0, 1])
def test_random_dense_matrices(n_rows: int, n_dofs: int, seed: int) -> None:
    check(np.random.default_rng(seed).normal(size=(n_rows, n_dofs)))


@pytest.mark.parametrize("seed", range(5))
def test_random_sparse_matrices(seed: int) -> None:
    random = np.random.default_rng(seed)
    matrix = random.normal(size=(12, 60)) * (random.random((12, 60)) < 0.08)
    check(matrix[np.any(matrix, axis=1)])


@pytest.mark.parametrize("seed", range(3))
def test_redundant_rows_are_dropped_and_counted(seed: int) -> None:
    random = np.random.default_rng(seed)
    rows = random.normal(size=(4, 20))
    result = check(np.vstack([rows, random.normal(size=(3, 4)) @ rows]))
    assert result.n_redundant == 3


@pytest.mark.parametrize(
    ("rows", "n_redundant"),
    [
        ([[0.0, 1.0, -1.0, 0.0], [0.0, -3.0, 3.0, 0.0]], 1),
        ([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0]], 1),
        (np.eye(8, 9) - np.eye(8, 9, k=1), 0),
    ],
    ids=["a repeated row", "a row of zeros", "a chain of rows"],
)
def test_rows_that_are_known(rows: list[list[float]], n_redundant: int) -> None:
    assert check(np.array(rows)).n_redundant == n_redundant


def test_orthogonal_rows_that_share_unknowns_are_eliminated_together() -> None:
    result = check(np.array([[1.0, 1.0, 0.0, 0.0], [1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 2.0]]))
    np.testing.assert_array_equal(result.independent, [2])


def test_unknowns_without_constraints_are_columns_of_their_own() -> None:
    matrix = np.zeros((2, 1000))
    matrix[0, [3, 700]], matrix[1, [5, 6]] = [1.0, -1.0], [0.6, 0.8]
    result = check(matrix)
    assert result.matrix.nnz == 1000  # a unit row an independent unknown, one entry a dependent one


def test_the_scale_of_rows_does_not_change_the_rank() -> None:
    rows = np.random.default_rng(0).normal(size=(4, 12))
    assert check(1e-6 * rows).n_redundant == check(1e6 * rows).n_redundant == 0


@pytest.mark.parametrize(("scene", "n_redundant"), [(slider_crank(), 0), (four_bar(), 0), (trammel(), 1)])
def test_the_null_space_of_a_mechanism(scene: object, n_redundant: int) -> None:
    kinematics = kinematics_of(scene)
    for theta in np.linspace(0.1, 6.0, 7):
        constraints = constraint_jacobian(kinematics.mechanism, kinematics.poses(np.array([theta]))[..., 0])
        result = check(constraints.toarray())
        assert result.n_redundant <= n_redundant
        dense = scipy.linalg.null_space(constraints.toarray())
        # the same space: the projection of one on the other loses nothing
        basis = np.linalg.qr(result.matrix.toarray())[0]
        np.testing.assert_allclose(dense @ (dense.T @ basis), basis, rtol=0, atol=1e-12)
        assert result.matrix.nnz <= kinematics.mechanism.n_dofs + 12


@pytest.mark.parametrize("scene", [slider_crank(), trammel()])
def test_one_pattern_serves_all_configurations(scene: object) -> None:
    """Unknowns that a joint happens not to feel, as where a body lies along an axis, are not eliminated."""
    kinematics = kinematics_of(scene)
    mechanism = kinematics.mechanism
    jacobian = ConstraintJacobian(mechanism, mechanism.coordinates)
    spaces = NullSpaces(jacobian.pattern)
    for theta in [0.0, 0.7, np.pi / 2, np.pi]:
        poses = kinematics.poses(np.array([theta]))[..., 0]
        constraints = jacobian.at(poses).toarray()
        found = spaces.of(jacobian.values(poses))
        alone = check(np.where(np.abs(constraints) > 1e-14, constraints, 0.0))
        assert found.n_redundant == alone.n_redundant
        matrix, other = found.matrix.toarray(), alone.matrix.toarray()
        np.testing.assert_array_equal(found.weights, matrix[found.dependent])
        np.testing.assert_allclose(constraints @ matrix, 0.0, rtol=0, atol=1e-13 * np.abs(matrix).max())
        basis = np.linalg.qr(other)[0]
        np.testing.assert_allclose(basis @ (basis.T @ matrix), matrix, rtol=0, atol=1e-12 * np.abs(matrix).max())
