"""Body frames: there and back, rigid velocities, constraint Jacobians, constant matrices."""

import numpy as np
import pytest
from frames import to_inertial

from pgmp_petsc.bodies.matrices import assemble, weighted_sum
from pgmp_petsc.mechanism.body_frames import constraint_jacobian, linear_motion, rigid_velocities, to_body
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from scenes import RADIUS, four_bar, kinematics_of, slider_crank, trammel


@pytest.fixture(params=[slider_crank, four_bar, trammel])
def kinematics(request: pytest.FixtureRequest) -> RigidKinematics:
    return kinematics_of(request.param())


@pytest.mark.parametrize("trailing", [(), (1,), (2, 3)])
def test_there_and_back(kinematics: RigidKinematics, trailing: tuple[int, ...]) -> None:
    mechanism = kinematics.mechanism
    poses = kinematics.poses(np.array([1.2]))[..., 0]
    vectors = np.random.default_rng(0).normal(size=(mechanism.n_dofs, *trailing))
    turned = to_body(mechanism, poses, vectors)
    assert turned.shape == vectors.shape
    np.testing.assert_allclose(to_inertial(mechanism, poses, turned), vectors, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.sum(turned**2, axis=0), np.sum(vectors**2, axis=0), rtol=1e-13)


def test_rigid_velocities_are_the_derivative_of_the_placed_nodes(kinematics: RigidKinematics) -> None:
    mechanism, theta, step = kinematics.mechanism, 0.9, 1e-3
    place = {k: mechanism.place(kinematics.poses(np.array([theta + k * step])))[:, 0] for k in (-2, -1, 1, 2)}
    slope = (8 * (place[1] - place[-1]) - (place[2] - place[-2])) / (12 * step)
    poses = kinematics.poses(np.array([theta]))
    rigid = rigid_velocities(mechanism, poses[..., 0], kinematics.rates(poses)[..., 0])
    # fourth order, 1e-12, and poses solved to 1e-12 over the step
    np.testing.assert_allclose(to_inertial(mechanism, poses[..., 0], rigid)[:, 0], slope, rtol=0, atol=1e-8)


def test_rigid_velocities_satisfy_the_constraints_and_strain_nothing(kinematics: RigidKinematics) -> None:
    mechanism = kinematics.mechanism
    poses = kinematics.poses(np.array([2.3]))
    rigid = rigid_velocities(mechanism, poses[..., 0], kinematics.rates(poses)[..., 0])
    constraints = constraint_jacobian(mechanism, poses[..., 0])
    np.testing.assert_allclose(constraints @ rigid, 0.0, rtol=0, atol=1e-11)
    terms = assemble(mechanism.bodies, range(mechanism.n_dofs)).stiffness
    stiffness = weighted_sum(terms, {"r1": RADIUS})
    np.testing.assert_allclose(stiffness @ rigid, 0.0, rtol=0, atol=1e-13 * np.abs(stiffness.data).max())


def test_accelerations_of_bodies_are_the_second_derivative_of_the_placed_nodes(kinematics: RigidKinematics) -> None:
    mechanism, theta, step = kinematics.mechanism, 0.9, 1e-3
    places = mechanism.place(kinematics.poses(theta + step * np.arange(-1, 2)))
    second = (places[:, 0] - 2 * places[:, 1] + places[:, 2]) / step**2
    poses = kinematics.poses(np.array([theta]))
    result = linear_motion(mechanism, kinematics.motion(np.array([theta])).accelerations)
    assert result.shape == (mechanism.n_dofs, 1, 1)
    # second order, 1e-6 times the fourth derivative over 12, and poses solved to 1e-12 over the square of the step
    np.testing.assert_allclose(to_inertial(mechanism, poses[..., 0], result)[:, 0, 0], second, rtol=0, atol=1e-5)
