"""The reduced equations of built models: kinetic energy, coupling, start, scale and range; rotations by a vector."""

import numpy as np
import pytest
from frames import to_inertial
from runs import quick_return, reduced_model, rom_of, samples
from scipy.spatial.transform import Rotation

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.bodies.matrices import assemble, weighted_sum
from pgmp_petsc.mechanism.body_frames import rigid_velocities
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduced.action_frames import factors_of, rotation_of, spin_of
from pgmp_petsc.reduced.lagrangian_terms import reduced_energy
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.reduced.terms import ReducedTerms, coupling_of, displacement_scale
from pgmp_petsc.stepping.second_order_system import State
from scenes import meshes_of, slider_crank

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


@pytest.fixture(scope="module")
def terms(model: ReducedModel) -> ReducedTerms:
    return model.terms


def system_of(model: ReducedModel, n: int, **given: object) -> ReducedSystem:
    return model.batch(samples(model.scene, n, **given), n)


def test_the_kinetic_energy_is_that_of_the_flexible_mechanism_to_first_order(model: ReducedModel) -> None:
    """``1/2 q'^T M q'`` of the reconstructed nodes; what the tables lack is quadratic in the deformation."""
    terms, scene = model.terms, model.scene
    mechanism = Mechanism.from_scene(scene, meshes_of(scene))
    matrices = assemble(mechanism.bodies, range(mechanism.n_dofs))
    mass = weighted_sum(matrices.mass, {"r1": 5e-3})
    theta = 7.4 * terms.terms.axes[0].step
    random = np.random.default_rng(8)
    delta, rate = random.normal(size=(2, terms.tables.n_modes)) * 1e-3
    speed, dt = 6.0, 1e-6

    def nodes(time: float, share: float) -> np.ndarray:
        eta = np.concatenate([[theta + speed * time], share * (delta + rate * speed * time)])
        return model.frames_of(eta[None])[..., 0].ravel()

    def reduced(share: float) -> float:
        q, v = np.concatenate([[theta], share * delta]), np.concatenate([[speed], share * rate * speed])
        return float(reduced_energy(terms, {"r1": np.array([5e-3])}, q[None], v[None])[0][0])

    def missing(share: float) -> float:
        velocity = (nodes(dt, share) - nodes(-dt, share)) / (2 * dt)
        return 0.5 * velocity @ (mass @ velocity) - reduced(share)

    rigid = missing(0.0)
    first = (missing(1.0) - missing(-1.0)) / 2
    first_order = (reduced(1.0) - reduced(-1.0)) / 2
    # both are errors of interpolation between samples 0.26 rad apart, against the inertia terms' own size
    assert abs(rigid) < 2e-3 * reduced(0.0)
    assert abs(first) < 0.1 * abs(first_order) + 1e-6 * reduced(0.0)
    assert abs(first_order) > 0


def test_the_coupling_is_what_the_modes_change_makes_with_the_rigid_motion() -> None:
    """b against ``v^T M (dPsi/dtheta + spin x Psi)`` from differences of fine tables."""
    scene = slider_crank("reduction.angles=256", "reduction.modes=3")
    rom = rom_of(scene)
    samples = rom.tables.samples.axes[0]
    n, step = samples.n, 2 * np.pi / samples.n
    mechanism = Mechanism.from_scene(scene, meshes_of(scene))
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


def test_the_start_balances_the_loads_at_rest_and_in_motion(model: ReducedModel) -> None:
    system = system_of(model, 2, r1=np.array([5e-3, 6e-3]))
    state = system.start()
    np.testing.assert_array_equal([state.q[:, 1:], state.v[:, 1:]], 0.0)
    balance = system.residual(0.0, state)
    still = system.residual(0.0, State(state.q, state.v, np.zeros_like(state.a), np.zeros(0)))
    np.testing.assert_allclose(balance, 0.0, rtol=0, atol=1e-9 * np.abs(still).max())


def test_the_scale_measures_displacements() -> None:
    projection = np.zeros((2, 6, 2))
    projection[0, 1, 0], projection[1, 5, 1], projection[1, 0, 1] = -0.4, 0.3, 0.1
    np.testing.assert_allclose(displacement_scale(projection, 2.0), [0.2, 0.3])


def test_only_a_limited_range_can_be_left() -> None:
    turning = reduced_model(slider_crank("reduction.angles=8", "reduction.modes=2"))
    part = "coordinates.theta.range=[-0.1, 1.0]", "coordinates.theta.periodic=false"
    limited = reduced_model(slider_crank("reduction.angles=8", "reduction.modes=2", *part))
    for model, expected in ((turning, [False] * 3), (limited, [True, False, True])):
        system = system_of(model, 3)
        state = system.start()
        state.q[:, 0] = [-0.2, 0.5, 1.01]
        np.testing.assert_array_equal(system.outside(state), expected)


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
