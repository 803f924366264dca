"""Statements about two frames in both dimensions: derivatives against differences, and what each of them means."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from slopes import slopes

from pgmp_petsc.mechanism import statements
from pgmp_petsc.mechanism.statements import ANGLE, FOLLOWING, Statement, evaluate, n_frame

RANDOM = np.random.default_rng(3)
BEGUN = RANDOM.bit_generator.state
STEPS = (1e-2, 5e-3)


def triad(d: int) -> np.ndarray:
    return np.linalg.qr(RANDOM.normal(size=(d, d)))[0]


def made(name: str, d: int) -> Statement:
    u, w = (part / np.linalg.norm(part) for part in RANDOM.normal(size=(2, d)))
    return {
        "meet": lambda: statements.meet(u), "perpendicular": lambda: statements.perpendicular(u, w),
        "along": lambda: statements.along(u), "angle": lambda: statements.angle(triad(d), triad(d)),
        "distance": lambda: statements.distance(d), "following": lambda: statements.following(w),
        "fading": lambda: statements.fading(8.0 * u, w), "bulging": lambda: statements.bulging(8.0 * u, w, triad(d)[0]),
    }[name]()  # fmt: skip


NAMES = ("meet", "perpendicular", "along", "angle", "distance", "following", "fading", "bulging")


def halves(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return z[: len(z) // 2], z[len(z) // 2 :]


@pytest.fixture(autouse=True)
def the_same_numbers_whatever_ran_before() -> None:
    RANDOM.bit_generator.state = BEGUN


def falls_at_order_two(function, exact: np.ndarray, z: np.ndarray) -> None:
    """Say that differences go to the derivative with the square of the step, or are exact."""
    coarse, fine = (np.abs(slopes(function, z, step) - exact).max() for step in STEPS)
    assert coarse < 1e-11 or 3.5 < coarse / fine < 4.5, (coarse, fine)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_the_limits_of_differences(name: str, d: int) -> None:
    statement = made(name, d)
    for _ in range(3):
        # frames need not be orthonormal
        z = RANDOM.normal(size=2 * n_frame(d)) + 2.0 * np.eye(2 * n_frame(d))[0]
        if name != "following":
            falls_at_order_two(lambda z: statement.value(*halves(z)), statement.gradient(*halves(z)), z)
        falls_at_order_two(lambda z: statement.gradient(*halves(z)), statement.hessian(*halves(z)), z)
        hessian = statement.hessian(*halves(z))
        assert np.allclose(hessian, hessian.T, rtol=0, atol=1e-12) == (name != "following")


@pytest.mark.parametrize("d", [2, 3])
def test_what_the_statements_are(d: int) -> None:
    turn = triad(d) if d == 3 else np.array([[0.6, -0.8], [0.8, 0.6]])
    p_a, p_b, u, w = RANDOM.normal(size=(4, d))
    a, b = np.concatenate([p_a, turn.T.ravel()]), np.concatenate([p_b, np.eye(d).ravel()])
    assert statements.meet(u).value(a, b) == pytest.approx(u @ (p_b - p_a))
    assert statements.perpendicular(u, w).value(a, b) == pytest.approx((turn @ u) @ w)
    assert statements.along(u).value(a, b) == pytest.approx((turn @ u) @ (p_b - p_a) / np.linalg.norm(u))
    assert statements.distance(d).value(a, b) == pytest.approx(np.linalg.norm(p_b - p_a))
    gradient = statements.following(u).gradient(b, a)
    expected = np.zeros(2 * n_frame(d))
    expected[n_frame(d) : n_frame(d) + d] = turn @ u / np.linalg.norm(u)
    assert made("following", d).fixed_in_bodies and made("following", d).kind == FOLLOWING
    np.testing.assert_allclose(gradient, expected, rtol=0, atol=1e-15)


def test_the_angle_about_an_axis_in_space_counts_turns() -> None:
    in_a, in_b, frame_of_b = triad(3), triad(3), triad(3)
    for wanted in (0.3, -2.9, 3.4, 11.0, -40.0):
        # b's triad is a's, turned by the angle about their first axis
        about = Rotation.from_rotvec(wanted * in_a[:, 0] * np.linalg.det(in_a)).as_matrix()
        turn = frame_of_b @ about @ in_a @ in_b.T
        a, b = (np.concatenate([np.zeros(3), m.T.ravel()]) for m in (frame_of_b, turn))
        z, statement = np.concatenate([a, b]), statements.angle(in_a, in_b)
        found = evaluate(
            ANGLE, statement.axes, z, wanted + 0.9 * np.pi, True, np.empty(24), np.empty((24, 24)), np.empty(24)
        )
        assert found == pytest.approx(wanted, abs=1e-12)
        assert -np.pi <= statement.value(a, b) <= np.pi


def test_the_angle_in_the_plane_is_the_difference_of_the_frames_angles() -> None:
    def frame(phi: float) -> np.ndarray:
        return np.array([0.3, -0.1, np.cos(phi), np.sin(phi), -np.sin(phi), np.cos(phi)])

    statement = statements.angle(np.eye(2), np.eye(2))
    assert statement.value(frame(0.4), frame(1.5)) == pytest.approx(1.1)
    # and it has no second derivative along rotations of the frames
    tangents = np.zeros((12, 2))
    for column, (first, phi) in enumerate(((0, 0.4), (6, 1.5))):
        tangents[first + 2 : first + 6, column] = -np.sin(phi), np.cos(phi), -np.cos(phi), -np.sin(phi)
    np.testing.assert_allclose(statement.gradient(frame(0.4), frame(1.5)) @ tangents, [-1.0, 1.0], rtol=0, atol=1e-15)
    bent = tangents.T @ statement.hessian(frame(0.4), frame(1.5)) @ tangents
    np.testing.assert_allclose(bent, 0.0, atol=1e-15)


@pytest.mark.parametrize("d", [2, 3])
def test_two_points_that_meet_pull_nowhere(d: int) -> None:
    frame = RANDOM.normal(size=n_frame(d))
    statement = statements.distance(d)
    assert statement.value(frame, frame) == 0.0
    assert not statement.gradient(frame, frame).any() and np.isfinite(statement.hessian(frame, frame)).all()
