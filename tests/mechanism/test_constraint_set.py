"""Constraints of a mechanism: residuals, derivatives, what is redundant, and their null space."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from pencils import dense_jacobian
from runs import quick_return
from scipy.spatial.transform import Rotation
from slopes import slopes
from spatial import slider_crank_in_space, spatial_slider_crank

from pgmp_petsc.mechanism.constraint_set import ConstraintSet, NullSpace, NullSpaces, null_space
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import (
    ConstraintHessians,
    ConstraintJacobian,
    Mechanism,
    Unknowns,
    constraint_jacobian,
)
from scenes import four_bar, kinematics_of, mechanism_of, pendulum, slider_crank, trammel

SCENES = {
    "slider_crank": slider_crank, "pendulum": pendulum, "four_bar": four_bar, "trammel": trammel,
    "quick_return": quick_return, "in space": spatial_slider_crank,
    "driven in space": lambda: spatial_slider_crank(
        'effects={motor={type="prescribed_motion", coordinate="theta", spin_up={speed=25.0, time=0.2}}}'
    ),
}  # fmt: skip


@pytest.fixture(params=SCENES)
def mechanism(request: pytest.FixtureRequest) -> Mechanism:
    return kinematics_of(SCENES[request.param]()).mechanism


def anywhere(constraints: ConstraintSet) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return states off the constraints: q, v of shape (n_dofs, 1) and multipliers (n_constraints, 1), zero of driven
    angles, whose second derivatives hold on rigid directors alone."""
    random = np.random.default_rng(3)
    q, v, multipliers = (random.normal(size=(n, 1)) for n in (*[constraints.n_dofs] * 2, constraints.n_constraints))
    multipliers[constraints.n_constraints - constraints.n_driven :] = 0.0
    return q, v, multipliers


def held(constraints: ConstraintSet, angle: float = 0.7) -> np.ndarray:
    """Return what driven joints are to have."""
    return np.full(constraints.n_driven, angle)


# Central differences with a step of 1e-6 on numbers of order one: round-off 1e-10, truncation 1e-12.
DIFFERENCE = 2e-9


def test_the_jacobian_is_the_derivative_of_the_residual(mechanism: Mechanism) -> None:
    constraints = ConstraintSet(Unknowns(mechanism))
    q, _, _ = anywhere(constraints)
    rows, columns = constraints.jacobian_pattern
    assert len(set(zip(rows, columns))) == rows.size
    expected = slopes(lambda x: constraints.residual(x[:, None], held(constraints))[:, 0], q[:, 0], 1e-6)
    size = max(1.0, np.abs(constraints.residual(q, held(constraints))).max())  # of squares of directors in space
    np.testing.assert_allclose(dense_jacobian(constraints, q[:, 0]), expected, rtol=0, atol=DIFFERENCE * size)


def test_reactions_change_with_pairs_of_unknowns_that_are_known(mechanism: Mechanism) -> None:
    constraints = ConstraintSet(Unknowns(mechanism))
    q, _, multipliers = anywhere(constraints)
    changes = slopes(lambda x: dense_jacobian(constraints, x).T @ multipliers[:, 0], q[:, 0], 1e-6)
    # every pair of unknowns once: one triangle of each joint, not always that of the whole matrix
    i, j = constraints.curvature_pattern
    pairs = {(min(a, b), max(a, b)) for a, b in zip(i, j)}
    assert len(pairs) == i.size or constraints.n_driven, "a drive has pairs of its joint once more"
    changes[i, j] = changes[j, i] = 0.0
    np.testing.assert_allclose(changes, 0.0, rtol=0, atol=DIFFERENCE)


def test_the_drift_is_what_velocities_leave_of_the_second_derivative(mechanism: Mechanism) -> None:
    constraints = ConstraintSet(Unknowns(mechanism))
    (q, v, _), step, own = anywhere(constraints), 1e-4, slice(constraints.n_constraints - constraints.n_driven)

    def residual(time: float) -> np.ndarray:
        return constraints.residual(q + time * v, held(constraints))

    expected = (residual(step) - 2 * residual(0.0) + residual(-step)) / step**2
    # second difference: round-off 1e-16 / 1e-8, truncation of the order of the step's square times |v|^4
    found = constraints.drift(q, v, held(constraints, 0.0))
    np.testing.assert_allclose(found[own], expected[own], rtol=1e-5, atol=1e-5)


def test_the_rigid_motion_satisfies_them(mechanism: Mechanism) -> None:
    """With its velocities ``C v`` is that of the driven angles, and with its accelerations ``C a + drift = 0``."""
    kinematics, unknowns, h = RigidKinematics(mechanism), Unknowns(mechanism), 1e-5
    constraints = ConstraintSet(unknowns)

    def state(angle: float) -> tuple[np.ndarray, np.ndarray]:
        poses = kinematics.poses(np.array([angle]))
        return unknowns.place(poses[..., 0]), unknowns.place(poses[..., 0], kinematics.rates(poses)[..., 0, 0])

    for theta in (0.4, 2.0, 5.0):
        q, v = state(theta)
        # the closure's own tolerance is 1e-12 of the mechanism's size
        found = constraints.residual(q[:, None], held(constraints, theta))
        np.testing.assert_allclose(found, 0.0, rtol=0, atol=2e-12)
        jacobian, acceleration = dense_jacobian(constraints, q), (state(theta + h)[1] - state(theta - h)[1]) / (2 * h)
        speeds = np.arange(constraints.n_constraints) >= constraints.n_constraints - constraints.n_driven
        np.testing.assert_allclose(jacobian @ v, speeds, rtol=0, atol=1e-11)
        drift = constraints.drift(q[:, None], v[:, None], held(constraints, 0.0))[:, 0]
        np.testing.assert_allclose(jacobian @ acceleration + drift, 0.0, rtol=0, atol=1e-7)


def test_constraints_that_follow_from_others_are_left_out(mechanism: Mechanism) -> None:
    constraints = ConstraintSet(Unknowns(mechanism))
    q = Unknowns(mechanism).place(RigidKinematics(mechanism).poses(np.array([0.7]))[..., 0])
    kept = constraints.independent(q)
    for of in (constraints, kept):
        assert np.linalg.matrix_rank(dense_jacobian(of, q), tol=1e-9) == kept.n_constraints <= of.n_constraints


def test_only_a_line_on_a_moving_body_and_space_make_them_nonlinear() -> None:
    found = {name: ConstraintSet(Unknowns(mechanism_of(scene()))).linear for name, scene in SCENES.items()}
    assert {name for name, linear in found.items() if not linear} == {"quick_return", "in space", "driven in space"}
    linear = ConstraintSet(Unknowns(mechanism_of(slider_crank())))
    assert linear.curvature_pattern[0].size == 0
    assert np.all(linear.drift(*(np.ones((36, 2)),) * 2) == 0.0)


@pytest.mark.parametrize(
    ("kinematics", "curved"),
    [
        (lambda: kinematics_of(slider_crank_in_space()), 2),
        (lambda: kinematics_of(spatial_slider_crank()), 3),
        (lambda: kinematics_of(slider_crank_in_space("bodies.crank.flexible=false")), 2),
    ],
    ids=["hinges", "ball, cross and guide", "rigid crank"],
)
def test_the_hessians_of_joints_in_space_are_second_differences(kinematics, curved: int) -> None:
    """Along displacements and rotation vectors of the nodes; with the arms of a rigid body, too."""
    kinematics = kinematics()
    mechanism, space = kinematics.mechanism, kinematics.mechanism.space
    poses = kinematics.poses(np.array([0.9]))[..., 0]
    u, step = np.random.default_rng(4).normal(size=mechanism.n_dofs), 1e-3
    by_rows = {hessian.rows.start: hessian for hessian in ConstraintHessians(mechanism).at(poses)}
    n_curved = 0
    for connection in mechanism.connections:

        def values(size: float, connection=connection) -> np.ndarray:
            frames = []
            for side in connection.sides:
                if side.on_ground:
                    frames.append(side.ground_frame(()))
                    continue
                own, pose = size * u[mechanism.node_dofs(side.node)], poses[side.body]
                turn = pose[3:].reshape(3, 3).T
                frame = space.place(pose, (side.point - side.arm)[None])[0]
                frame[:3] += turn @ own[:3]
                frame[3:] = (turn @ Rotation.from_rotvec(own[3:]).as_matrix()).T.ravel()
                frames.append(side.frame_of(frame))
            return np.array([part.value(*frames) for part in connection.statements])

        expected = (values(step) + values(-step) - 2 * values(0.0)) / step**2
        hessian = by_rows[connection.rows.start]
        found = np.einsum("cij,i,j->c", hessian.values, u[hessian.dofs], u[hessian.dofs])
        # the square of the step times fourth derivatives of order ten, and round-off
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5 * max(1.0, np.abs(expected).max()))
        n_curved += bool(np.abs(found).max() > 1e-3)
    assert n_curved == curved


def test_some_of_them_are_the_same_statements(mechanism: Mechanism) -> None:
    constraints = ConstraintSet(Unknowns(mechanism))
    q = anywhere(constraints)[0]
    every = np.arange(constraints.n_constraints)
    for chosen in (every, every[1::2]):
        own = constraints.rows_among(chosen)
        joints = own.motions < 0
        found = own.rows.values(q)[joints, 0] - own.wanted[joints]
        expected = constraints.residual(q, held(constraints))[chosen[own.places[joints]], 0]
        np.testing.assert_array_equal(found, expected)
    whole = constraints.rows_among(every).rows
    rows, columns = constraints.jacobian_pattern
    own = ~constraints.of_ties  # which are no statements
    wanted = (np.cumsum(own) - 1)[rows[own[rows]]], columns[own[rows]]
    for found, expected in zip(whole.jacobian_pattern, wanted):
        np.testing.assert_array_equal(found, expected)


def check(constraints: np.ndarray) -> NullSpace:
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
        found = spaces.of(jacobian.at(poses).data)
        alone = check(np.where(np.abs(constraints) > 1e-14, constraints, 0.0))
        assert found.n_redundant == alone.n_redundant
        matrix, other = found.matrix.toarray(), alone.matrix.toarray()
        np.testing.assert_array_equal(found.weights, matrix[found.dependent])
        np.testing.assert_allclose(constraints @ matrix, 0.0, rtol=0, atol=1e-13 * np.abs(matrix).max())
        basis = np.linalg.qr(other)[0]
        np.testing.assert_allclose(basis @ (basis.T @ matrix), matrix, rtol=0, atol=1e-12 * np.abs(matrix).max())
