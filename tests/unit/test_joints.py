"""Joints: Jacobians and Hessians against differences, and what the constraints mean."""

from __future__ import annotations

import numpy as np
import pytest

from pgmp_petsc.mechanism.joints import Joint, PointOnLine, Revolute

JOINTS = {
    "revolute": Revolute(),
    "fixed_line": PointOnLine((3.0, 4.0), turning=False),
    "turning_line": PointOnLine((-1.0, 2.0), turning=True),
}


@pytest.fixture(params=JOINTS)
def joint(request: pytest.FixtureRequest) -> Joint:
    return JOINTS[request.param]


def pairs(n: int = 7) -> np.ndarray:
    """Return n pairs of frames, shape (6, n)."""
    return np.random.default_rng(3).normal(size=(6, n))


def test_the_jacobian_is_the_derivative_of_the_residual(joint: Joint) -> None:
    ab = pairs()
    jacobian = joint.jacobian(ab[:3], ab[3:])
    assert jacobian.shape == (joint.n_constraints, 6, 7)
    for i, unit in enumerate(np.eye(6)):
        complex_ab = ab + 1e-30j * unit[:, None]
        slope = joint.residual(complex_ab[:3], complex_ab[3:]).imag / 1e-30
        np.testing.assert_allclose(jacobian[:, i], slope, rtol=0, atol=1e-14)


def test_the_hessian_is_the_derivative_of_the_jacobian(joint: Joint) -> None:
    ab, step = pairs(), 1e-5
    hessian = joint.hessian(ab[:3], ab[3:])
    assert hessian.shape == (joint.n_constraints, 6, 6, 7)
    np.testing.assert_array_equal(hessian, np.swapaxes(hessian, 1, 2))
    for i, unit in enumerate(np.eye(6)):
        ahead, behind = ab + step * unit[:, None], ab - step * unit[:, None]
        slope = (joint.jacobian(ahead[:3], ahead[3:]) - joint.jacobian(behind[:3], behind[3:])) / (2 * step)
        # second order, 1e-10, and the round-off of values of order 1 over the step, 1e-11
        np.testing.assert_allclose(hessian[:, :, i], slope, rtol=0, atol=1e-9)


def test_linear_joints_have_no_hessian_and_a_constant_jacobian(joint: Joint) -> None:
    ab = pairs()
    constant = not np.any(joint.hessian(ab[:3], ab[3:])) and not np.any(np.ptp(joint.jacobian(ab[:3], ab[3:]), axis=2))
    assert joint.linear == constant


def test_one_pair_needs_no_trailing_axis(joint: Joint) -> None:
    ab = pairs()
    for function in (joint.residual, joint.jacobian, joint.hessian):
        np.testing.assert_array_equal(function(ab[:3, 2], ab[3:, 2]), function(ab[:3], ab[3:])[..., 2])


def test_a_fixed_line_does_not_turn_with_the_angle_of_its_frame() -> None:
    joint = PointOnLine((3.0, 4.0), turning=False)
    on_line = np.array([1.0 + 2 * 0.6, 2.0 + 2 * 0.8, 0.3])
    assert joint.residual(np.array([1.0, 2.0, 5.0]), on_line) == pytest.approx([0.0], abs=1e-15)
    # the residual is the distance, whatever the length of the direction
    off_line = on_line + [-0.8, 0.6, 0.0]
    assert joint.residual(np.array([1.0, 2.0, 5.0]), off_line) == pytest.approx([1.0], rel=1e-14)


def test_a_turning_line_goes_with_its_body() -> None:
    joint, angle = PointOnLine((1.0, 0.0), turning=True), 0.7
    carrier = np.array([1.0, 2.0, angle])
    point = carrier + [3 * np.cos(angle), 3 * np.sin(angle), 9.0]
    assert joint.residual(carrier, point) == pytest.approx([0.0], abs=1e-15)


def test_a_revolute_joint_leaves_the_rotation_free() -> None:
    gap = Revolute().residual(np.array([1.0, 2.0, 3.0]), np.array([1.5, 2.0, -8.0]))
    np.testing.assert_array_equal(gap, [0.5, 0.0])
