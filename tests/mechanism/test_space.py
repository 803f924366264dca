"""Rigid motion in the plane and in space: placed points, their velocities and accelerations, and frames that move."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pgmp_petsc.bodies.component import linear_fields
from pgmp_petsc.mechanism.joints import Attachment, triad
from pgmp_petsc.mechanism.space import PLANE, SPATIAL, directors
from pgmp_petsc.mechanism.statements import angle

SPACES = {"plane": PLANE, "space": SPATIAL}
POINTS = np.random.default_rng(5).normal(size=(4, 3))
IN_THE_PLANE = POINTS * [1.0, 1.0, 0.0]
EPSILON = 1e-14  # round-off of sums of products of numbers of order 1


def at_points(coefficients: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return a linear field (d + d^2, ...) at points (n, d), shape (n, d, ...)."""
    return np.tensordot(linear_fields(points), coefficients, 1).reshape(*points.shape, *coefficients.shape[1:])


def planar(time: np.ndarray) -> np.ndarray:
    """Return poses in the plane over time, shape (3, n)."""
    return np.array([np.sin(time), 0.3 * time**2, 0.4 + 1.5 * time - 0.8 * time**2])


def lifted(poses: np.ndarray) -> np.ndarray:
    """Return poses in the plane (3, ...) as poses in space (12, ...)."""
    x, y, phi = poses
    cos, sin, zero, one = np.cos(phi), np.sin(phi), np.zeros_like(phi), np.ones_like(phi)
    return np.array([x, y, zero, cos, sin, zero, -sin, cos, zero, zero, zero, one])


def spatial(time: np.ndarray) -> np.ndarray:
    """Return poses in space over time, shape (12, n)."""
    spins = np.array([np.sin(time), 0.5 * time, 0.2 + time**2])
    turns = Rotation.from_rotvec(spins.T).as_matrix()
    return np.vstack([np.cos(time), time, -0.5 * time**2, np.swapaxes(turns, 1, 2).reshape(-1, 9).T])


MOTIONS = {"plane": planar, "space": spatial}


@pytest.fixture(params=SPACES)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


def along(motion, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a motion at a time and its first and second derivatives, each of shape (n_pose,)."""
    step = 1e-3
    z = motion(time + step * np.arange(-2, 3))
    first = (8 * (z[:, 3] - z[:, 1]) - (z[:, 4] - z[:, 0])) / (12 * step)
    second = (16 * (z[:, 3] + z[:, 1]) - (z[:, 4] + z[:, 0]) - 30 * z[:, 2]) / (12 * step**2)
    return z[:, 2], first, second


# what `along` errs by: fourth order, 1e-12 times the next derivatives, and round-off over the step and over its square
FIRST, SECOND = 1e-10, 1e-8


# --- the plane within space ------------------------------------------------------------------------------------------


def test_placed_points_agree_for_motions_in_the_plane() -> None:
    poses = planar(np.linspace(-1.0, 1.0, 5))
    flat, deep = PLANE.place(poses, IN_THE_PLANE[:, :2]), SPATIAL.place(lifted(poses), IN_THE_PLANE)
    np.testing.assert_allclose(deep[:, :2], flat[:, :2], rtol=0, atol=EPSILON)
    np.testing.assert_array_equal(deep[:, 2], 0.0)
    # the frames have the same direction
    np.testing.assert_allclose(deep, np.moveaxis(lifted(np.moveaxis(flat, 1, 0)), 0, 1), rtol=0, atol=EPSILON)


# --- each of them ----------------------------------------------------------------------------------------------------


def test_velocities_and_accelerations_are_those_of_placed_points(name: str) -> None:
    """The fields are in the body's frame; turned back, they are the derivatives of the points' positions."""
    space, time, step = SPACES[name], 0.4, 1e-3
    d, points = space.dimension, POINTS[:, : space.dimension]
    pose, rate, curvature = along(MOTIONS[name], time)
    places = space.place(MOTIONS[name](time + step * np.arange(-2, 3)), points)[:, :d]
    slope = (8 * (places[..., 3] - places[..., 1]) - (places[..., 4] - places[..., 0])) / (12 * step)
    bend = (16 * (places[..., 3] + places[..., 1]) - (places[..., 4] + places[..., 0]) - 30 * places[..., 2]) / (
        12 * step**2
    )
    turn = space.rotation(pose)[:d, :d]
    velocity = at_points(space.velocity_field(pose, rate[:, None])[:, 0], points)
    acceleration = at_points(space.acceleration_field(pose, rate[:, None], curvature[:, None, None])[:, 0, 0], points)
    np.testing.assert_allclose(velocity @ turn.T, slope, rtol=0, atol=FIRST)
    np.testing.assert_allclose(acceleration @ turn.T, bend, rtol=0, atol=SECOND)


def test_accelerations_of_two_coordinates(name: str) -> None:
    """Of second derivatives in two coordinates, the mixed one too, from poses over both."""
    space, step = SPACES[name], 1e-4
    d, points = space.dimension, POINTS[:, : space.dimension]

    def motion(first: float, second: float) -> np.ndarray:
        return MOTIONS[name](np.array([0.3 + first + 0.7 * second + first * second]))[:, 0]

    def derivatives(function) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        at = {(i, j): function(i * step, j * step) for i in (-1, 0, 1) for j in (-1, 0, 1)}
        rates = [(at[1, 0] - at[-1, 0]) / (2 * step), (at[0, 1] - at[0, -1]) / (2 * step)]
        mixed = (at[1, 1] - at[1, -1] - at[-1, 1] + at[-1, -1]) / (4 * step**2)
        own = [(at[1, 0] - 2 * at[0, 0] + at[-1, 0]) / step**2, (at[0, 1] - 2 * at[0, 0] + at[0, -1]) / step**2]
        return at[0, 0], np.stack(rates, axis=-1), np.stack([own[0], mixed, mixed, own[1]], axis=-1)

    pose, rates, curvatures = derivatives(motion)
    _, _, expected = derivatives(lambda i, j: space.place(motion(i, j), points)[:, :d])
    field = space.acceleration_field(pose, rates, curvatures.reshape(-1, 2, 2))
    assert field.shape == (d + d * d, 2, 2)
    turn = space.rotation(pose)[:d, :d]
    found = np.einsum("ij,njkl->nikl", turn, at_points(field, points)).reshape(len(points), d, 4)
    # second order, 1e-8 times the fourth derivatives, and round-off over the square of the step, 1e-7
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-6)


def test_a_frame_changes_with_its_displacement_as_its_gradient_says(name: str) -> None:
    space, step = SPACES[name], 1e-5
    pose = MOTIONS[name](np.array([0.4]))[:, 0]
    gradient = space.frame_gradient(pose)
    assert gradient.shape == (space.n_pose, space.n_dofs)

    def moved(displacement: np.ndarray) -> np.ndarray:
        if name == "plane":
            return pose + PLANE.rotation(pose) @ displacement
        turn = directors(pose)
        turned = turn @ Rotation.from_rotvec(displacement[3:]).as_matrix()
        return np.concatenate([pose[:3] + turn @ displacement[:3], turned.T.ravel()])

    for k, unit in enumerate(np.eye(space.n_dofs)):
        slope = (moved(step * unit) - moved(-step * unit)) / (2 * step)
        # second order, 1e-10 over 6, and round-off over the step, 1e-11
        np.testing.assert_allclose(gradient[:, k], slope, rtol=0, atol=1e-10)


def test_angles_count_turns_in_the_plane_and_are_nearest_to_what_is_known_in_space() -> None:
    theta = np.array([-7.0, -3.0, 0.2, 3.5, 4 * np.pi + 0.1])
    a, b = planar(np.zeros(5)), planar(np.zeros(5))
    a[2], b[2] = 0.3, 0.3 + theta
    turn = angle(np.eye(2), np.eye(2))
    np.testing.assert_allclose(PLANE.angle(turn, a, b), theta, rtol=0, atol=10 * EPSILON)
    turn, (a, b) = angle(triad(np.array([0.0, 0.0, 1.0])), triad(np.array([0.0, 0.0, 1.0]))), (lifted(a), lifted(b))
    principal = np.angle(np.exp(1j * theta))
    np.testing.assert_allclose(SPATIAL.angle(turn, a, b), principal, rtol=0, atol=10 * EPSILON)
    np.testing.assert_allclose(SPATIAL.angle(turn, a, b, theta + 2.0), theta, rtol=0, atol=10 * EPSILON)


def test_turns_and_windings() -> None:
    step = np.zeros((2, 12, 3))
    step[1, 7, 2], step[0, 1, 0] = -0.4, 5.0
    np.testing.assert_array_equal(SPATIAL.turns(step), [[0.0, 0.0, 0.0], [0.0, 0.0, 0.4]])
    np.testing.assert_array_equal(PLANE.turns(np.array([[[1.0], [2.0], [-0.3]]])), [[0.3]])
    # directors come back after a turn, angles count it
    change = np.array([[0.0, 0.0, -4 * np.pi], [0.1, 0.0, 0.2]])
    np.testing.assert_array_equal(PLANE.winding(change), [-2.0, 0.0])
    np.testing.assert_array_equal(SPATIAL.winding(np.ones((2, 12))), [0.0, 0.0])
    poses = spatial(np.array([0.1, 0.2]))[None]
    np.testing.assert_array_equal(SPATIAL.turned(poses.copy(), np.ones((1, 2))), poses)
    flat = planar(np.array([0.1, 0.2]))[None]
    turned = PLANE.turned(flat.copy(), np.array([[1.0, -2.0]]))
    np.testing.assert_allclose((turned - flat)[0, 2], [2 * np.pi, -4 * np.pi], rtol=1e-14)


# --- points of bodies ------------------------------------------------------------------------------------------------


def test_an_attachment_with_an_arm_goes_with_its_node() -> None:
    arm = np.array([0.1, -0.3, 0.2])
    poses = spatial(np.linspace(-1.0, 1.0, 4))[None]
    node, side = Attachment(0, 2, POINTS[0], np.zeros(3)), Attachment(0, 2, POINTS[0] + arm, arm)
    assert node.at_node and not side.at_node
    expected = side.frame_of_pose(poses)
    np.testing.assert_allclose(side.frame_of(node.frame_of_pose(poses)), expected, rtol=0, atol=EPSILON)
    # further rows stay
    longer = np.vstack([node.frame_of_pose(poses), np.arange(4.0)])
    np.testing.assert_array_equal(side.frame_of(longer)[12], np.arange(4.0))
    # small motions of the point from those of the node: a rigid field about the node
    velocity, spin = np.array([0.4, 0.1, -0.2]), np.array([0.3, -0.5, 0.7])
    moved = SPATIAL.natural_gradient(SPATIAL.identity, arm) @ np.concatenate([velocity, spin])
    turned = np.cross(spin, np.eye(3)).ravel()
    np.testing.assert_allclose(moved, [*(velocity + np.cross(spin, arm)), *turned], rtol=0, atol=EPSILON)
