"""The reduced equations of motion: kernel against numpy, and both against the Lagrangian and the flexible mechanism."""

from __future__ import annotations

import numpy as np
import pytest
from runs import quick_return, reduced_model, rom_of, run_model, samples
from scenes import meshes_of, slider_crank

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.bodies.matrices import assemble, weighted_sum
from pgmp_petsc.dynamics.generalised_alpha import Scheme, State
from pgmp_petsc.dynamics.reduced_kernel import combine, factorise, multiply, substitute
from pgmp_petsc.dynamics.reduced_system import ReducedSystem, coupling_of, displacement_scale, pack
from pgmp_petsc.effects import effects_of
from pgmp_petsc.mechanism.body_frames import rigid_velocities, to_inertial
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction.interpolation import interpolate, interpolate_slope
from pgmp_petsc.reduction.tables import ReducedTables

GRAVITY = 'effects.weight={type="gravity"}'
TIME = 0.1  # s; the torque is 0.2 Nm


@pytest.fixture(scope="module", params=[slider_crank, quick_return])
def model(request: pytest.FixtureRequest) -> ReducedModel:
    return reduced_model(request.param(GRAVITY))


@pytest.fixture(scope="module")
def tables(model: ReducedModel) -> ReducedTables:
    return model._tables


def packed(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return a random positive definite matrix, whole and packed."""
    factor = np.random.default_rng(seed).normal(size=(n, n))
    matrix = factor @ factor.T + np.eye(n)
    return matrix, pack(matrix)


@pytest.mark.parametrize("n", [1, 2, 5, 16])
def test_packed_matrices_multiply_factorise_and_solve(n: int) -> None:
    matrix, entries = packed(n)
    x = np.random.default_rng(1).normal(size=n)
    product = np.empty(n)
    multiply(entries, x, product)
    np.testing.assert_allclose(product, matrix @ x, rtol=1e-13, atol=1e-13)
    assert factorise(entries, n)
    np.testing.assert_allclose(entries, pack(np.linalg.cholesky(matrix)), rtol=1e-11, atol=1e-12)
    substitute(entries, product)
    np.testing.assert_allclose(product, x, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("wrong", [-1.0, 0.0, np.nan])
def test_a_matrix_that_is_not_positive_definite_is_refused(wrong: float) -> None:
    matrix, _ = packed(4)
    matrix[2, 2] = wrong if np.isnan(wrong) else matrix[2, 2] * wrong
    assert not factorise(pack(matrix), 4)


def test_tables_are_combined_over_rows_and_terms() -> None:
    random = np.random.default_rng(2)
    table, rows = random.normal(size=(7, 3, 5)), np.array([6, 0, 1, 2])
    factors, weights, result = random.normal(size=4), random.normal(size=3), np.empty(5)
    combine(table, rows, factors, weights, result)
    np.testing.assert_allclose(result, np.einsum("r,t,rte->e", factors, weights, table[rows]), rtol=0, atol=1e-13)


class At:
    """The reduced quantities at one theta (not inside the last digits of a grid point), for one sample."""

    def __init__(self, tables: ReducedTables, values: dict[str, float], amplitudes: np.ndarray, theta: float) -> None:
        of_mass, of_stiffness, of_load = (
            evaluate_weights(weights, values)
            for weights in (tables.mass_weights, tables.stiffness_weights, tables.load_weights)
        )
        grid, at = tables.grid, np.array([theta])

        def weighted(weights: np.ndarray, table: np.ndarray, slope: bool = False) -> np.ndarray:
            return np.tensordot(weights, (interpolate_slope if slope else interpolate)(grid, table, at)[0], axes=1)

        coupling = coupling_of(tables)
        self.mass, self.mass_slope = (weighted(of_mass, tables.mass, slope) for slope in (False, True))
        self.coupling, self.coupling_slope = (weighted(of_mass, coupling, slope) for slope in (False, True))
        self.load, self.load_slope = (weighted(of_load * amplitudes, tables.load, slope) for slope in (False, True))
        self.stiffness, self.stiffness_slope = (
            weighted(of_stiffness, tables.stiffness, slope) for slope in (False, True)
        )

    def residual(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Return r as the kernel's docstring writes it."""
        delta, rate, speed = q[1:], v[1:], v[0]
        r = self.mass @ a + speed * self.mass_slope @ v - self.load
        r[0] -= 0.5 * v @ self.mass_slope @ v
        r[0] += 2 * self.coupling @ delta * a[0] + 2 * self.coupling @ rate * speed
        r[0] += self.coupling_slope @ delta * speed**2
        r[0] += 0.5 * delta @ self.stiffness_slope @ delta - self.load_slope[1:] @ delta
        r[1:] += self.stiffness @ delta - self.coupling * speed**2
        return r


def anywhere(n_eta: int, n_samples: int, seed: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return states with deformations of a size that happens."""
    random = np.random.default_rng(seed)
    size = np.concatenate([[1.0], np.full(n_eta - 1, 1e-3)])
    q, v, a = (random.normal(size=(n_samples, n_eta)) * size * factor for factor in (1.0, 5.0, 100.0))
    q[:, 0] = random.uniform(-3.0, 9.0, n_samples)
    return q, v, a


def system_of(model: ReducedModel, n: int, **given: object) -> ReducedSystem:
    return model.batch(samples(model.scene, n, **given), n)


def amplitudes_of(model: ReducedModel, time: float) -> np.ndarray:
    by_name = {effect.name: effect for effect in effects_of(model.scene, model.kinematics.mechanism)}
    return np.array([by_name[name].amplitude(time) for name in model._tables.load_effects])


def residual_of(system: ReducedSystem, q: np.ndarray, v: np.ndarray, a: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Return the kernel's residual: with a gain beyond all measure, a correction of a is ``-M^-1 r``."""
    state = State(q.copy(), v.copy(), a.copy(), np.zeros(0))
    only_mass = Scheme(0.0, 0.0, 0.0, 0.0, gain_v=0.0, gain_a=1e30)
    system.correct(TIME, state, only_mass, np.ones(len(q), dtype=bool), True)
    return np.einsum("nij,nj->ni", mass, a - state.a)


def test_the_kernel_evaluates_the_documented_residual(model: ReducedModel, tables: ReducedTables) -> None:
    radii = np.array([5.6e-3, 4.5e-3, 7e-3])
    q, v, a = anywhere(tables.n_modes + 1, 3)
    amplitudes = amplitudes_of(model, TIME)
    at = [At(tables, {"r1": r}, amplitudes, x[0]) for r, x in zip(radii, q)]
    found = residual_of(system_of(model, 3, r1=radii), q, v, a, np.array([one.mass for one in at]))
    expected = np.array([one.residual(*state) for one, *state in zip(at, q, v, a)])
    # a differs from its correction by round-off of a, which the mass matrix (of order 1 in modal units) passes on
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max())


def lagrangian(
    tables: ReducedTables, values: dict[str, float], amplitudes: np.ndarray, q: np.ndarray, v: np.ndarray
) -> float:
    """Return T - V without the rigid work of the loads."""
    at, delta = At(tables, values, amplitudes, q[0]), q[1:]
    kinetic = 0.5 * v @ at.mass @ v + v[0] ** 2 * at.coupling @ delta
    return kinetic - 0.5 * delta @ at.stiffness @ delta + at.load[1:] @ delta


def test_the_residual_is_that_of_a_lagrangian(model: ReducedModel, tables: ReducedTables) -> None:
    """``d/dt dL/dv - dL/dq`` along the motion that q, v and a begin, by central differences."""
    (q,), (v,), (a,) = anywhere(tables.n_modes + 1, 1)
    q[0] = 20.3 * tables.grid.step  # away from the samples, where the interpolant's second derivative jumps
    values, amplitudes = {"r1": 5e-3}, amplitudes_of(model, TIME)
    here = At(tables, values, amplitudes, q[0])

    def value(q: np.ndarray, v: np.ndarray) -> float:
        return lagrangian(tables, values, amplitudes, q, v)

    size = np.concatenate([[1.0], np.full(q.size - 1, 1e-3)])

    def gradient(function, x: np.ndarray, h: float) -> np.ndarray:
        moved = [(function(x + h * e) - function(x - h * e)) / (2 * h) for e in np.diag(size)]
        return np.array(moved) / size

    def momentum(time: float) -> np.ndarray:
        moved, speed = q + v * time + 0.5 * a * time**2, v + a * time
        # L is quadratic in v: central differences with any step are exact
        return gradient(lambda x: value(moved, x), speed, 1.0)

    dt = 1e-5
    rate = (momentum(dt) - momentum(-dt)) / (2 * dt)
    expected = rate - gradient(lambda x: value(x, v), q, 1e-5)
    expected[0] -= here.load[0]
    found = here.residual(q, v, a)
    # relative to the largest single force: differences of 1e-5 leave 1e-10 of truncation and 1e-11 of round-off
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


def test_the_kinetic_energy_is_that_of_the_flexible_mechanism_to_first_order(model: ReducedModel) -> None:
    """``1/2 q'^T M q'`` of the reconstructed nodes; what the tables lack is quadratic in the deformation."""
    tables, scene = model._tables, model.scene
    mechanism = Mechanism.from_scene(scene, meshes_of(scene))
    matrices = assemble(mechanism.bodies, range(mechanism.n_dofs))
    mass = weighted_sum(matrices.mass, {"r1": 5e-3})
    grid = tables.grid
    theta = grid.theta[7] + 0.4 * grid.step
    random = np.random.default_rng(8)
    delta, rate = random.normal(size=(2, tables.n_modes)) * 1e-3
    speed, dt = 6.0, 1e-6

    def nodes(time: float, share: float) -> np.ndarray:
        eta = np.concatenate([[theta + speed * time], share * (delta + rate * speed * time)])
        return model.frames_of(eta[None])[..., 0].ravel()

    at = At(tables, {"r1": 5e-3}, np.zeros(len(tables.load_effects)), theta)

    def missing(share: float) -> float:
        velocity = (nodes(dt, share) - nodes(-dt, share)) / (2 * dt)
        v = np.concatenate([[speed], share * rate * speed])
        reduced = 0.5 * v @ at.mass @ v + speed**2 * at.coupling @ (share * delta)
        return 0.5 * velocity @ (mass @ velocity) - reduced

    rigid = missing(0.0)
    first = (missing(1.0) - missing(-1.0)) / 2
    first_order = speed**2 * at.coupling @ delta
    # both are errors of interpolation between samples 0.26 rad apart, against the inertia terms' own size
    assert abs(rigid) < 2e-3 * 0.5 * speed**2 * at.mass[0, 0]
    assert abs(first) < 0.1 * abs(first_order) + 1e-6 * 0.5 * speed**2 * at.mass[0, 0]
    assert abs(first_order) > 0


def test_the_coupling_is_what_the_modes_change_makes_with_the_rigid_motion() -> None:
    """b against ``v^T M (dPsi/dtheta + spin x Psi)`` from differences of fine tables."""
    scene = slider_crank("reduction.angles=256", "reduction.modes=3")
    rom = rom_of(scene)
    grid = rom.tables.grid
    mechanism = Mechanism.from_scene(scene, meshes_of(scene))
    kinematics = RigidKinematics(mechanism)
    mass = weighted_sum(assemble(mechanism.bodies, range(mechanism.n_dofs)).mass, scene.nominal)
    poses = kinematics.poses(grid.theta)
    rates = kinematics.rates(poses)
    turned = [to_inertial(mechanism, poses[..., k], rom.projection[k]) for k in range(grid.n)]
    weights = evaluate_weights(rom.tables.mass_weights, scene.nominal)
    coupling = np.einsum("t,nti->ni", weights, coupling_of(rom.tables))
    expected = np.empty_like(coupling)
    for k in range(grid.n):
        near, far = (turned[(k + d) % grid.n] - turned[k - d] for d in (1, 2))
        slope = (8 * near - far) / (12 * grid.step)
        velocity = rigid_velocities(mechanism, poses[..., k], rates[..., k])
        expected[k] = (to_inertial(mechanism, poses[..., k], velocity).T @ (mass @ slope))[0]
    # fourth-order differences over 0.025 rad of modes that turn within about 0.3 rad
    np.testing.assert_allclose(coupling, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


def test_the_start_balances_the_loads_at_rest_and_in_motion(model: ReducedModel, tables: ReducedTables) -> None:
    system = system_of(model, 2, r1=np.array([5e-3, 6e-3]))
    state = system.start()
    amplitudes = amplitudes_of(model, 0.0)
    for k, radius in enumerate((5e-3, 6e-3)):
        at = At(tables, {"r1": radius}, amplitudes, state.q[k, 0])
        r = at.residual(state.q[k], state.v[k], state.a[k])
        np.testing.assert_allclose(r, 0.0, rtol=0, atol=1e-9 * np.abs(at.mass @ state.a[k]).max())
    np.testing.assert_array_equal(state.q[:, 1:], 0.0)
    np.testing.assert_array_equal(state.v[:, 1:], 0.0)


def test_samples_do_not_touch_each_other(model: ReducedModel) -> None:
    """Permuted, split, and beside a sample that fails, every sample ends with the same bits."""
    n = 11
    radii = np.random.default_rng(9).uniform(4e-3, 8e-3, n)
    scene = model.scene
    scene = scene.model_copy(update={"simulation": scene.simulation.model_copy(update={"duration": 0.05})})
    model = ReducedModel(scene, rom_of(scene))
    together = run_model(model, n, {"r1": radii})[1].state
    order = np.random.default_rng(10).permutation(n)
    permuted = run_model(model, n, {"r1": radii[order]})[1].state
    np.testing.assert_array_equal(permuted.q, together.q[order])
    np.testing.assert_array_equal(permuted.v, together.v[order])
    for part in (slice(0, 4), slice(4, 5), slice(5, n)):
        alone = run_model(model, len(radii[part]), {"r1": radii[part]})[1].state
        np.testing.assert_array_equal(alone.q, together.q[part])
        np.testing.assert_array_equal(alone.a, together.a[part])
    spoilt = radii.copy()
    spoilt[3] = np.nan
    run = run_model(model, n, {"r1": spoilt})[1]
    others = np.arange(n) != 3
    np.testing.assert_array_equal(run.status != 0, ~others)
    np.testing.assert_array_equal(run.state.q[others], together.q[others])


def test_the_scale_measures_displacements() -> None:
    projection = np.zeros((2, 6, 2))
    projection[0, 1, 0], projection[1, 5, 1], projection[1, 0, 1] = -0.4, 0.3, 0.1
    np.testing.assert_allclose(displacement_scale(projection, 2.0), [0.2, 0.3])


def test_only_a_limited_range_can_be_left() -> None:
    turning = reduced_model(slider_crank("reduction.angles=8", "reduction.modes=2"))
    limited = reduced_model(
        slider_crank("reduction.angles=8", "reduction.modes=2", "coordinates.theta.range=[-0.1, 1.0]",
                     "coordinates.theta.periodic=false")
    )
    for model, expected in ((turning, [False] * 3), (limited, [True, False, True])):
        system = system_of(model, 3)
        state = system.start()
        state.q[:, 0] = [-0.2, 0.5, 1.01]
        np.testing.assert_array_equal(system.outside(state), expected)
