"""The reduced equations of built models: coupling of modes that change with the rigid motion, rotations by a vector."""

import numpy as np
import pytest
from frames import to_inertial
from runs import quick_return, reduced_model, rom_of
from scipy.spatial.transform import Rotation

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.bodies.matrices import assemble, weighted_sum
from pgmp_petsc.mechanism.body_frames import rigid_velocities
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduced.action_frames import factors_of, rotation_of, spin_of
from pgmp_petsc.reduced.terms import coupling_of
from scenes import mechanism_of, slider_crank

GRAVITY = 'effects.weight={type="gravity"}'


@pytest.fixture(
    scope="module",
    params=[(), ("reduction.second_order=true", "reduction.static_modes=true", "reduction.modes=3")],
    ids=["first order", "second order"],
)
def settings(request: pytest.FixtureRequest) -> tuple[str, ...]:
    return request.param


@pytest.fixture(scope="module", params=[slider_crank, quick_return])
def model(request: pytest.FixtureRequest, settings: tuple[str, ...]) -> ReducedModel:
    return reduced_model(request.param(GRAVITY, *settings))


def test_the_coupling_is_what_the_modes_change_makes_with_the_rigid_motion() -> None:
    """b against ``v^T M (dPsi/dtheta + spin x Psi)`` from differences of fine tables."""
    scene = slider_crank("reduction.angles=256", "reduction.modes=3")
    rom = rom_of(scene)
    samples = rom.tables.samples.axes[0]
    n, step = samples.n, 2 * np.pi / samples.n
    mechanism = mechanism_of(scene)
    kinematics = RigidKinematics(mechanism)
    mass = weighted_sum(assemble(mechanism.bodies, range(mechanism.n_dofs)).mass, scene.nominal)
    poses = kinematics.poses(samples.theta)
    rates = kinematics.rates(poses)
    turned = [to_inertial(mechanism, poses[..., k], rom.projection[k]) for k in range(n)]
    weights = evaluate_weights(rom.tables.mass_weights, scene.nominal)
    expected = np.empty((n, rom.tables.n_modes))
    for k in range(n):
        near, far = (turned[(k + d) % n] - turned[k - d] for d in (1, 2))
        slope = (8 * near - far) / (12 * step)
        velocity = rigid_velocities(mechanism, poses[..., k], rates[..., k])
        expected[k] = (to_inertial(mechanism, poses[..., k], velocity).T @ (mass @ slope))[0]
    # fourth-order differences over 0.025 rad of modes that turn within about 0.3 rad
    for scheme in ("overhauser", "spline", "spectral"):
        coupling = np.einsum("t,nti->ni", weights, coupling_of(rom.tables, scheme))
        np.testing.assert_allclose(coupling, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


def rotation(phi: np.ndarray) -> np.ndarray:
    turn = np.empty((3, 3))
    rotation_of(phi, factors_of(phi), turn)
    return turn


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.0999, 0.1001, 1.3, 3.0])
def test_rotation_and_spin(angle: float) -> None:
    phi = angle * np.array([0.48, -0.6, 0.64])
    rate, h, spin = np.array([0.3, 0.7, -0.2]), 1e-6, np.empty(3)
    np.testing.assert_allclose(rotation(phi), Rotation.from_rotvec(phi).as_matrix(), rtol=0, atol=1e-15)
    spin_of(phi, factors_of(phi), rate, spin)
    change = rotation(phi).T @ (rotation(phi + h * rate) - rotation(phi - h * rate)) / (2 * h)
    np.testing.assert_allclose(spin, [change[2, 1], change[0, 2], change[1, 0]], rtol=0, atol=1e-9)
