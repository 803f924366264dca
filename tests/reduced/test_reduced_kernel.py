"""The reduced equations of motion: kernel against numpy, and both against the Lagrangian and the flexible mechanism."""

import itertools

import numpy as np
import pytest
from frames import to_inertial
from runs import quick_return, reduced_model, rom_of, run_model, samples

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.bodies.matrices import assemble, weighted_sum
from pgmp_petsc.effects import effects_of
from pgmp_petsc.mechanism.body_frames import rigid_velocities
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.reduced.terms import ReducedTerms, coupling_of, displacement_scale
from pgmp_petsc.stepping.second_order_system import Scheme, State
from scenes import meshes_of, slider_crank

GRAVITY = 'effects.weight={type="gravity"}'
TIME = 0.1  # s; the torque is 0.2 Nm


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


def whole(entries: np.ndarray) -> np.ndarray:
    """Unpack a symmetric matrix."""
    n = int(np.sqrt(2 * entries.size))
    matrix = np.zeros((n, n))
    rows, columns = np.tril_indices(n)
    matrix[rows, columns] = matrix[columns, rows] = entries
    return matrix


def whole_cubic(entries: np.ndarray, m: int) -> np.ndarray:
    """Unpack a symmetric tensor of third order."""
    tensor = np.empty((m, m, m))
    i, j, k = np.indices(tensor.shape).reshape(3, -1)
    chosen = (i >= j) & (j >= k)
    for order in itertools.permutations((i[chosen], j[chosen], k[chosen])):
        tensor[order] = entries
    return tensor


def whole_skew(entries: np.ndarray, m: int) -> np.ndarray:
    """Unpack a skew matrix."""
    matrix = np.zeros((m, m))
    matrix[np.tril_indices(m, -1)] = entries
    return matrix - matrix.T


class At:
    """The reduced quantities at one theta (not inside the last digits of a grid point), for one sample."""

    def __init__(self, terms: ReducedTerms, values: dict[str, float], amplitudes: np.ndarray, theta: float) -> None:
        weights = evaluate_weights(terms.weights, values)
        of_load = evaluate_weights(terms.tables.load_weights, values) * amplitudes
        at, layout = np.array([theta]), terms.layout

        def parts(slope: bool) -> tuple[np.ndarray, ...]:
            rigid, entries, load = (
                (part.slope if slope else part)(at)[0] for part in (terms.rigid, terms.terms, terms.load)
            )
            entries = weights @ entries
            entries[0] = weights @ rigid[:, 0]
            ends = [layout.coupling, layout.stiffness, layout.cubic, layout.swing, layout.gyroscopic]
            mass, coupling, stiffness, cubic, swing, gyroscopic = np.split(entries, ends)
            load, bent = np.split(of_load @ load, [layout.n_eta])
            m = coupling.size
            if not layout.second_order:
                return whole(mass), coupling, whole(stiffness), load, *self._nothing(m)
            return (
                whole(mass), coupling, whole(stiffness), load,
                whole_cubic(cubic, m), whole(swing), whole_skew(gyroscopic, m), whole(bent),
            )  # fmt: skip

        self.mass, self.coupling, self.stiffness, self.load, *second = parts(False)
        self.mass_slope, self.coupling_slope, self.stiffness_slope, self.load_slope, *second_slopes = parts(True)
        self.cubic, self.swing, self.gyroscopic, self.bent = second
        self.cubic_slope, self.swing_slope, self.gyroscopic_slope, self.bent_slope = second_slopes

    @staticmethod
    def _nothing(m: int) -> tuple[np.ndarray, ...]:
        return np.zeros((m, m, m)), np.zeros((m, m)), np.zeros((m, m)), np.zeros((m, m))

    def inertia(self, q: np.ndarray) -> np.ndarray:
        """Return dr/da: the mass with the change of the rigid inertia by the deformation."""
        mass = self.mass.copy()
        delta = q[1:]
        mass[0, 0] += 2 * self.coupling @ delta - delta @ self.swing @ delta
        mass[0, 1:] += delta @ self.gyroscopic
        mass[1:, 0] += delta @ self.gyroscopic
        return mass

    def residual(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Return r as the kernel's docstring writes it."""
        delta, rate, speed = q[1:], v[1:], v[0]
        r = self.mass @ a + speed * self.mass_slope @ v - self.load
        r[0] -= 0.5 * v @ self.mass_slope @ v
        r[0] += 2 * self.coupling @ delta * a[0] + 2 * self.coupling @ rate * speed
        r[0] += self.coupling_slope @ delta * speed**2
        r[0] += 0.5 * delta @ self.stiffness_slope @ delta - self.load_slope[1:] @ delta
        r[1:] += self.stiffness @ delta - self.coupling * speed**2
        return r + self.second_order(delta, rate, a, speed)

    def second_order(self, delta: np.ndarray, rate: np.ndarray, a: np.ndarray, speed: float) -> np.ndarray:
        """Return the Lagrange derivatives of L_2, term by term."""
        swing, skew = self.swing, self.gyroscopic
        of_delta = 0.5 * np.einsum("ijk,j,k", self.cubic, delta, delta) - self.bent @ delta + speed**2 * swing @ delta
        of_delta -= a[0] * skew @ delta + speed**2 * self.gyroscopic_slope @ delta + 2 * speed * skew @ rate
        of_theta = np.einsum("ijk,i,j,k", self.cubic_slope, delta, delta, delta) / 6
        of_theta -= 0.5 * delta @ self.bent_slope @ delta
        of_theta -= a[0] * delta @ swing @ delta + 2 * speed * delta @ swing @ rate
        of_theta -= 0.5 * speed**2 * delta @ self.swing_slope @ delta
        of_theta += delta @ skew @ a[1:]
        return np.concatenate([[of_theta], of_delta])


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
    return np.array([by_name[name].amplitude(time) for name in model.terms.tables.load_effects])


def residual_of(system: ReducedSystem, q: np.ndarray, v: np.ndarray, a: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Return the kernel's residual: with a gain beyond all measure, a correction of a is ``-M^-1 r``."""
    state = State(q.copy(), v.copy(), a.copy(), np.zeros(0))
    only_mass = Scheme(0.0, 0.0, 0.0, 0.0, gain_v=0.0, gain_a=1e30)
    system.correct(TIME, state, only_mass, np.ones(len(q), dtype=bool), True)
    return np.einsum("nij,nj->ni", mass, a - state.a)


def test_the_kernel_evaluates_the_documented_residual(model: ReducedModel, terms: ReducedTerms) -> None:
    radii = np.array([5.6e-3, 4.5e-3, 7e-3])
    q, v, a = anywhere(terms.tables.n_modes + 1, 3)
    amplitudes = amplitudes_of(model, TIME)
    at = [At(terms, {"r1": r}, amplitudes, x[0]) for r, x in zip(radii, q)]
    found = residual_of(system_of(model, 3, r1=radii), q, v, a, np.array([one.inertia(x) for one, x in zip(at, q)]))
    expected = np.array([one.residual(*state) for one, *state in zip(at, q, v, a)])
    # a differs from its correction by round-off of a, which the mass matrix (of order 1 in modal units) passes on
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-10 * np.abs(expected).max())


def lagrangian(
    terms: ReducedTerms, values: dict[str, float], amplitudes: np.ndarray, q: np.ndarray, v: np.ndarray
) -> float:
    """Return T - V without the rigid work of the loads."""
    at, delta = At(terms, values, amplitudes, q[0]), q[1:]
    kinetic = 0.5 * v @ at.mass @ v + v[0] ** 2 * at.coupling @ delta
    kinetic += v[0] * delta @ at.gyroscopic @ v[1:] - 0.5 * v[0] ** 2 * delta @ at.swing @ delta
    strain = 0.5 * delta @ at.stiffness @ delta + np.einsum("ijk,i,j,k", at.cubic, delta, delta, delta) / 6
    return kinetic - strain + at.load[1:] @ delta + 0.5 * delta @ at.bent @ delta


def test_the_residual_is_that_of_a_lagrangian(model: ReducedModel, terms: ReducedTerms) -> None:
    """``d/dt dL/dv - dL/dq`` along the motion that q, v and a begin, by central differences."""
    (q,), (v,), (a,) = anywhere(terms.tables.n_modes + 1, 1)
    q[0] = 20.3 * terms.terms.axes[0].step  # away from the samples, where the interpolant's second derivative jumps
    values, amplitudes = {"r1": 5e-3}, amplitudes_of(model, TIME)
    here = At(terms, values, amplitudes, q[0])

    def value(q: np.ndarray, v: np.ndarray) -> float:
        return lagrangian(terms, values, amplitudes, q, v)

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

    at = At(terms, {"r1": 5e-3}, np.zeros(len(terms.tables.load_effects)), theta)

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
    samples = rom.tables.samples.axes[0]
    n, step = samples.n, 2 * np.pi / samples.n
    mechanism = Mechanism.from_scene(scene, meshes_of(scene))
    kinematics = RigidKinematics(mechanism)
    mass = weighted_sum(assemble(mechanism.bodies, range(mechanism.n_dofs)).mass, scene.nominal)
    poses = kinematics.poses(samples.theta)
    rates = kinematics.rates(poses)
    turned = [to_inertial(mechanism, poses[..., k], rom.projection[k]) for k in range(n)]
    weights = evaluate_weights(rom.tables.mass_weights, scene.nominal)
    coupling = np.einsum("t,nti->ni", weights, coupling_of(rom.tables, "overhauser"))
    expected = np.empty_like(coupling)
    for k in range(n):
        near, far = (turned[(k + d) % n] - turned[k - d] for d in (1, 2))
        slope = (8 * near - far) / (12 * step)
        velocity = rigid_velocities(mechanism, poses[..., k], rates[..., k])
        expected[k] = (to_inertial(mechanism, poses[..., k], velocity).T @ (mass @ slope))[0]
    # fourth-order differences over 0.025 rad of modes that turn within about 0.3 rad
    np.testing.assert_allclose(coupling, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


def test_the_start_balances_the_loads_at_rest_and_in_motion(model: ReducedModel, terms: ReducedTerms) -> None:
    system = system_of(model, 2, r1=np.array([5e-3, 6e-3]))
    state = system.start()
    amplitudes = amplitudes_of(model, 0.0)
    for k, radius in enumerate((5e-3, 6e-3)):
        at = At(terms, {"r1": radius}, amplitudes, state.q[k, 0])
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
        slider_crank(
            "reduction.angles=8",
            "reduction.modes=2",
            "coordinates.theta.range=[-0.1, 1.0]",
            "coordinates.theta.periodic=false",
        )
    )
    for model, expected in ((turning, [False] * 3), (limited, [True, False, True])):
        system = system_of(model, 3)
        state = system.start()
        state.q[:, 0] = [-0.2, 0.5, 1.01]
        np.testing.assert_array_equal(system.outside(state), expected)
