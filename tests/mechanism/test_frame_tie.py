"""What ties frames to meshes: derivatives, rest, large rotation, and the constraints of a mechanism on meshes."""

from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest
from frames import to_inertial
from solid_scenes import solid_meshes, solid_slider_crank
from solids import mesh_of

from pgmp_petsc.bodies.solid import FaceFrame
from pgmp_petsc.mechanism.body_frames import constraint_jacobian, to_body
from pgmp_petsc.mechanism.constraint_set import ConstraintSet
from pgmp_petsc.mechanism.frame_ties import FrameTies
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism, Unknowns
from pgmp_petsc.mesh.solid_mesh import PLANE_KINDS, reference_element

STEP, ATOL = 1e-6, 1e-8  # central differences: round-off of values of order 1 over the step, and the step's square
KIND = "quad8"
N_TIES = 3


def crooked(kind: str = KIND) -> tuple[np.ndarray, FaceFrame]:
    """Return the nodes of a bent rectangle and the frame of two of its sides."""
    mesh = mesh_of(kind, (3, 2), (0.8, 0.5))
    x, y = mesh.nodes.T
    places = np.column_stack([x + 0.3 * y**2 + 0.1, y - 0.4 * x * (0.8 - x) - 0.2])
    faces = np.vstack([mesh.groups["right"], mesh.groups["top"]])
    return places, FaceFrame.of(places, faces, reference_element(kind).face_kind)


def tie_of(places: np.ndarray, frame: FaceFrame) -> FrameTies:
    """Return the tie of a frame whose unknowns come before those of the nodes."""
    faces = {"faces": frame}
    body = SimpleNamespace(face_frames=faces, first_node=0, first_internal=N_TIES, blocks=lambda kind: ())
    n_dofs = N_TIES + places.size
    return FrameTies.of(
        SimpleNamespace(dimension=2, n_dofs=n_dofs, bodies=(body,), frame=lambda node: np.arange(N_TIES))
    )


def jacobian_of(tie: FrameTies, q: np.ndarray) -> np.ndarray:
    """Return the Jacobian from its entries, shape (3, n, ...)."""
    full = np.zeros((N_TIES, *q.shape))
    np.add.at(full, tie.jacobian_pattern, tie.jacobian_values(q))
    return full


def placed(places: np.ndarray, frame: FaceFrame, angle: float, shift: tuple[float, float]) -> np.ndarray:
    """Return the unknowns after a rigid motion, shape (3 + 2 n,)."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.concatenate([turn @ frame.centre + shift, [angle], (places @ turn.T + shift).ravel()])


def anywhere(n: int, *samples: int) -> np.ndarray:
    """Return unknowns that do not obey the constraints."""
    return np.random.default_rng(1).normal(0.0, 0.7, (n, *samples))


@pytest.fixture
def tie() -> FrameTies:
    return tie_of(*crooked())


@pytest.fixture
def n() -> int:
    return N_TIES + crooked()[0].size


@pytest.mark.parametrize("kind", PLANE_KINDS)
def test_at_rest_the_frame_moves_as_its_functionals_say(kind: str) -> None:
    places, frame = crooked(kind)
    tie = tie_of(places, frame)
    q = placed(places, frame, 0.0, (0.0, 0.0))
    full = jacobian_of(tie, q)
    # round-off of sums over a few dozen nodes
    np.testing.assert_allclose(full[:, :N_TIES], np.eye(N_TIES), rtol=0, atol=1e-14)
    np.testing.assert_allclose(full[:, N_TIES:], -frame.functionals(len(places)).toarray(), rtol=0, atol=1e-14)


@pytest.mark.parametrize(("angle", "shift"), [(0.0, (0.0, 0.0)), (2.5, (3.0, -4.0)), (-20.0, (-1.0, 0.5))])
def test_the_tie_holds_after_any_rigid_motion_and_turns_with_it(angle: float, shift: tuple[float, float]) -> None:
    places, frame = crooked()
    tie = tie_of(places, frame)
    q = placed(places, frame, angle, shift)
    np.testing.assert_allclose(tie.values(q), 0.0, rtol=0, atol=1e-13)
    # in the body's frame the Jacobian is the same everywhere
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    jacobian, at_rest = (jacobian_of(tie, state) for state in (q, placed(places, frame, 0.0, (0.0, 0.0))))
    nodes = jacobian[:, N_TIES:].reshape(N_TIES, -1, 2) @ turn
    nodes[:2] = np.einsum("ji,jnk->ink", turn, nodes[:2])
    np.testing.assert_allclose(nodes, at_rest[:, N_TIES:].reshape(nodes.shape), rtol=0, atol=1e-13)
    np.testing.assert_allclose(jacobian[:, :N_TIES], np.eye(N_TIES), rtol=0, atol=1e-12)


def test_the_third_constraint_is_the_frame_s_angle_less_the_mean_rotation() -> None:
    """To first order in the deformation, whatever the angle of both."""
    places, frame = crooked()
    tie = tie_of(places, frame)
    for angle in (0.0, 1.9):
        for less in (1e-3, 1e-6):
            q = placed(places, frame, angle, (0.4, 0.2))
            q[2] += less
            assert tie.values(q)[2] == pytest.approx(np.sin(less), rel=1e-9)
        # a deformation of the nodes: the mean rotation of `FaceFrame`, turned along
        q, moved = placed(places, frame, angle, (0.0, 0.0)), np.random.default_rng(2).normal(0.0, 1e-3, places.shape)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        q[N_TIES:] += (moved @ turn.T).ravel()
        # linear in the places of the nodes: round-off of the places over the size of the motion
        expected = -(frame.functionals(len(places)) @ moved.ravel())
        expected[:2] = turn @ expected[:2]
        np.testing.assert_allclose(tie.values(q), expected, rtol=0, atol=1e-13)


def test_the_jacobian_is_the_derivative_of_the_residual(tie: FrameTies, n: int) -> None:
    q = anywhere(n)
    full = jacobian_of(tie, q)
    for column, unit in enumerate(np.eye(n)):
        slope = (tie.values(q + STEP * unit) - tie.values(q - STEP * unit)) / (2 * STEP)
        np.testing.assert_allclose(full[:, column], slope, rtol=0, atol=ATOL)


def test_the_curvature_is_the_derivative_of_the_jacobian(tie: FrameTies, n: int) -> None:
    q, multipliers = anywhere(n), np.array([0.7, -1.3, 2.1])
    lower = np.zeros((n, n))
    np.add.at(lower, tie.curvature_pattern, tie.curvature_values(q, multipliers))
    full = lower + np.tril(lower, -1).T
    for column, unit in enumerate(np.eye(n)):
        step = STEP * unit
        slope = multipliers @ (jacobian_of(tie, q + step) - jacobian_of(tie, q - step)) / (2 * STEP)
        np.testing.assert_allclose(full[column], slope, rtol=0, atol=ATOL * 10)
    # entries in the row and the column of phi alone
    assert not np.any(np.delete(np.delete(full, 2, axis=0), 2, axis=1)) and np.any(full[2])


def test_the_drift_is_the_second_rate_of_the_residual_without_acceleration(tie: FrameTies, n: int) -> None:
    q, v = anywhere(n), np.random.default_rng(3).normal(size=n)
    steps = 1e-3 * np.arange(-2, 3)
    values = np.array([tie.values(q + step * v) for step in steps])
    second = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) @ values / (12 * steps[-2] ** 2)
    # fourth order: the step's fourth power, and round-off over its square
    np.testing.assert_allclose(tie.drift(q, v), second, rtol=0, atol=1e-8)
    assert abs(second[2]) > 0.1
    rate = (jacobian_of(tie, q + STEP * v) - jacobian_of(tie, q - STEP * v)) / (2 * STEP) @ v
    np.testing.assert_allclose(tie.drift(q, v), rate, rtol=0, atol=1e-7)


def test_many_samples_at_once_are_those_one_by_one(tie: FrameTies, n: int) -> None:
    q, v, multipliers = anywhere(n, 3), anywhere(n, 3) + 0.1, np.random.default_rng(4).normal(size=(N_TIES, 3))
    for k in range(3):
        for many, one in (
            (tie.values(q), tie.values(q[:, k])),
            (tie.jacobian_values(q), tie.jacobian_values(q[:, k])),
            (tie.curvature_values(q, multipliers), tie.curvature_values(q[:, k], multipliers[:, k])),
            (tie.drift(q, v), tie.drift(q[:, k], v[:, k])),
        ):
            # sums in another order
            np.testing.assert_allclose(many[..., k], one, rtol=0, atol=1e-14)


@lru_cache(maxsize=1)
def mechanism() -> Mechanism:
    return Mechanism.from_scene(solid_slider_crank(), solid_meshes(KIND, 10))


def entries(constraints: ConstraintSet, values: np.ndarray, n_dofs: int) -> np.ndarray:
    """Return the Jacobian from its entries."""
    full = np.zeros((constraints.n_constraints, n_dofs))
    np.add.at(full, constraints.jacobian_pattern, values)
    return full


@pytest.mark.parametrize("theta", [0.0, 0.9, 4.0])
def test_constraints_of_a_mechanism_on_meshes_are_those_of_its_body_frames(theta: float) -> None:
    """Ties come after the joints; their rows are turned along with the bodies, which changes no null space."""
    meshed, kinematics = mechanism(), RigidKinematics(mechanism())
    poses = kinematics.poses(np.array([theta]))[..., 0]
    q, constraints = meshed.place(poses), ConstraintSet(Unknowns(meshed))
    assert constraints.n_constraints == meshed.n_constraints + 4 * N_TIES
    assert not constraints.linear
    # the closure of the rigid mechanism is 1e-12 of its size, 1 m
    np.testing.assert_allclose(constraints.residual(q), 0.0, rtol=0, atol=2e-12)
    inertial = entries(constraints, constraints.jacobian_values(q), meshed.n_dofs)
    in_bodies = constraint_jacobian(meshed, poses).toarray()
    assert inertial.shape == in_bodies.shape
    turned = to_body(meshed, poses, inertial.T).T
    first = meshed.n_constraints
    np.testing.assert_allclose(turned[:first], in_bodies[:first], rtol=0, atol=1e-12)
    for number, body in enumerate(meshed.bodies):
        angle = poses[number, 2]
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        for row in first + N_TIES * (body.first_node + np.arange(body.n_nodes)):
            rows = slice(row, row + N_TIES)
            np.testing.assert_allclose(turn.T @ turned[rows], in_bodies[rows], rtol=0, atol=1e-11)


def test_nodes_of_a_mesh_turn_with_their_body() -> None:
    meshed = mechanism()
    poses = RigidKinematics(meshed).poses(np.array([0.9]))[..., 0]
    vectors = np.random.default_rng(6).normal(size=(meshed.n_dofs, 2))
    np.testing.assert_allclose(to_body(meshed, poses, to_inertial(meshed, poses, vectors)), vectors, rtol=0, atol=1e-14)
    body = meshed.bodies[1]
    x, y = to_inertial(meshed, poses, vectors)[body.first_internal : body.first_internal + 2, 0]
    u, w = vectors[body.first_internal : body.first_internal + 2, 0]
    cos, sin = np.cos(poses[1, 2]), np.sin(poses[1, 2])
    np.testing.assert_allclose([x, y], [cos * u - sin * w, sin * u + cos * w], rtol=0, atol=1e-15)
