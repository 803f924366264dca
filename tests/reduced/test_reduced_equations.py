"""The reduced equations: terms and kernels against the Lagrangian of full tensors, kinematics and interpolants."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from frames import to_inertial
from runs import place_in, quick_return, rom_of, watched
from scipy.spatial.transform import Rotation

from pgmp_petsc.bodies.affine import Monomial, evaluate_weights
from pgmp_petsc.bodies.matrices import AffineMatrices, weighted_sum
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import rigid_velocities
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduced import cells as cells_module
from pgmp_petsc.reduced.action_frames import factors_of, rotation_of, spin_of
from pgmp_petsc.reduced.arrays import Layout
from pgmp_petsc.reduced.cells import FEWEST_HELD, Cells
from pgmp_petsc.reduced.lagrangian import least_stiffness, reduced_energy
from pgmp_petsc.reduced.system import ReducedSystem
from pgmp_petsc.reduced.terms import (
    WIDEST,
    ReducedDamping,
    ReducedTerms,
    coupling_of,
    grid_of,
    pack,
    pack_cubic,
)
from pgmp_petsc.reduction.interpolation import Interpolant, interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.sample_grid import SampleGrid, Samples
from pgmp_petsc.reduction.tables import ReducedTables, fine_grid
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import Simulation
from pgmp_petsc.stepping.generalised_alpha import Run
from pgmp_petsc.stepping.second_order_system import Scheme, State
from pgmp_petsc.studies.reduced_run import lost_definiteness
from scenes import four_bar, kinematics_of, mechanism_of, slider_crank, trammel

N_THETA, N_DELTA = 2, 3
N_ETA = N_THETA + N_DELTA
UNIT = Monomial(())
GRID = SampleGrid((Samples.uniform(0.0, 2 * np.pi, 20, True), Samples.uniform(-1.0, 1.5, 14, False)))


class Pull:
    """An effect with a constant amplitude."""

    name = "pull"

    def amplitude(self, time: float) -> float:
        return 1.3


def wave(theta: np.ndarray, shape: tuple[int, ...], seed: int) -> np.ndarray:
    """Return smooth functions of (theta_1, theta_2) with random phases, shape (n, *shape)."""
    random = np.random.default_rng(seed)
    phase, other = random.uniform(0.0, 6.0, (2, *shape))
    x, y = theta.T.reshape(2, -1, *(1,) * len(shape))
    return np.sin(x + phase) * np.cos(0.7 * y + other) + 0.4 * np.cos(2 * x - y + phase)


def symmetric(matrices: np.ndarray) -> np.ndarray:
    return 0.5 * (matrices + np.swapaxes(matrices, -1, -2))


def made_up(theta: np.ndarray) -> dict[str, np.ndarray]:
    """Return mass, inertia, stiffness and load at configurations theta (n, 2), one term each."""
    mass = 0.1 * symmetric(wave(theta, (1, N_ETA, N_ETA), 1)) + np.diag([2.0, 1.5, 1.0, 1.0, 1.0])
    inertia = np.moveaxis(symmetric(wave(theta, (1, N_DELTA, 2, 2), 2)), 2, -1)
    stiffness = symmetric(wave(theta, (1, N_DELTA, N_DELTA), 3)) + np.diag([40.0, 90.0, 150.0])
    return {"mass": mass, "inertia": inertia, "stiffness": stiffness, "load": wave(theta, (1, N_ETA), 4)}


def of_second_order(theta: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return V, c_kl (k >= l), A_k, P_k and B at configurations, one term each."""
    cubic = wave(theta, (1, N_DELTA, N_DELTA, N_DELTA), 5)
    cubic = sum(cubic.transpose(0, 1, *(2 + np.array(order))) for order in itertools.permutations(range(3)))
    swing = symmetric(wave(theta, (1, 3, N_DELTA, N_DELTA), 6))
    skew = wave(theta, (1, 2, N_DELTA, N_DELTA), 7)
    driven = symmetric(wave(theta, (1, 2, N_DELTA, N_DELTA), 9))
    bent = symmetric(wave(theta, (1, N_DELTA, N_DELTA), 8))
    return cubic, swing, skew - np.swapaxes(skew, -1, -2), driven, bent


def terms_of(
    grid: SampleGrid = GRID,
    quadratic: bool = True,
    damping: float = 0.0,
    mass: float = 0.0,
    second: bool = False,
    driven: float = 1.0,
) -> ReducedTerms:
    """Return interpolated terms; the rigid inertia is the table's own, on its grid."""
    found = made_up(grid.theta)
    tables = ReducedTables(grid, (UNIT,), (UNIT,), (UNIT,), ("pull",), **found)
    coupling = coupling_of(tables, "spline")
    n, load = grid.n, tables.load
    parts = [pack(tables.mass), coupling, pack(tables.stiffness)]
    if second:
        cubic, swing, skew, momenta, bent = of_second_order(grid.theta)
        across = pack(swing), pack(skew, -1), pack(driven * momenta)
        parts += [pack_cubic(cubic), *(part.reshape(n, 1, -1) for part in across)]
        load = np.concatenate([load, pack(bent)], axis=2)
    else:
        parts += [np.zeros((n, 1, 0))] * 4
    ends = [int(end) for end in np.cumsum([part.shape[2] for part in parts])]
    if damping:
        parts.append(damping * parts[0])
    end = sum(part.shape[2] for part in parts)
    return ReducedTerms(
        tables=tables, weights=(UNIT,), rigid=interpolant(grid, pack(tables.mass[:, :, :2, :2]), "spline"),
        terms=interpolant(grid, np.concatenate(parts, axis=2), "spline"),
        layout=Layout((0, 1), N_ETA, *ends, end, load.shape[2], quadratic), load=interpolant(grid, load, "spline"),
        scale=np.ones(N_ETA), damping=ReducedDamping("damper", mass, (UNIT,), damping * tables.mass),
    )  # fmt: skip


def system_of(terms: ReducedTerms, n: int = 1, start=(0.3, 0.2), speed=(0.0, 0.0), **given: object) -> ReducedSystem:
    return ReducedSystem(terms, [Pull()], {}, (np.array(start), np.array(speed)), n, **given)


class Lagrangian:
    """The Lagrangian of the interpolated tables, without the work of the loads on the rigid coordinates."""

    def __init__(self, terms: ReducedTerms) -> None:
        self._terms = terms

    def parts(self, theta: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return mass, b (2, 2, n_delta), stiffness, load, and V, c (2, 2, ...), A + P (2, ...) and B at one theta."""
        layout, m = self._terms.layout, N_DELTA
        entries = self._terms.terms(theta[None])[0, 0].copy()
        entries[: layout.n_rigid] = self._terms.rigid(theta[None])[0, 0]
        mass, coupling, stiffness, cubic, swing, skew, driven, _ = np.split(entries, layout[2:9])
        pairs = np.array([[0, 1], [1, 2]])
        load, bent = np.split(1.3 * self._terms.load(theta[None])[0, 0], [N_ETA])
        if not layout.second_order:
            second = np.zeros((m, m, m)), np.zeros((2, 2, m, m)), np.zeros((2, m, m)), np.zeros((m, m))
        else:
            c = np.array([whole(part) for part in swing.reshape(3, -1)])[pairs]
            across = [whole_skew(a) + whole(p) for a, p in zip(skew.reshape(2, -1), driven.reshape(2, -1))]
            second = whole_cubic(cubic), c, np.array(across), whole(bent)
        return whole(mass), coupling.reshape(3, m)[pairs], whole(stiffness), load, *second

    def inertia(self, q: np.ndarray) -> np.ndarray:
        """Return the mass of eta' in a deformed state."""
        mass, b, _, _, _, c, skew, _ = self.parts(q[:2])
        mass, delta = mass.copy(), q[2:]
        mass[:2, :2] += 2.0 * b @ delta - np.einsum("klij,i,j", c, delta, delta)
        across = np.einsum("kij,i->kj", skew, delta)
        mass[:2, 2:] += across
        mass[2:, :2] += across.T
        return mass

    def __call__(self, q: np.ndarray, v: np.ndarray) -> float:
        _, _, stiffness, load, cubic, _, _, bent = self.parts(q[:2])
        delta = q[2:]
        strain = 0.5 * delta @ stiffness @ delta + np.einsum("ijk,i,j,k", cubic, delta, delta, delta) / 6.0
        return 0.5 * v @ self.inertia(q) @ v - strain + load[2:] @ delta + 0.5 * delta @ bent @ delta

    def momentum(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return self.inertia(q) @ v


def whole(entries: np.ndarray) -> np.ndarray:
    n = int(np.sqrt(2 * entries.size))
    matrix = np.zeros((n, n))
    i, j = np.tril_indices(n)
    matrix[i, j] = matrix[j, i] = entries
    return matrix


def whole_cubic(entries: np.ndarray) -> np.ndarray:
    tensor = np.empty((N_DELTA,) * 3)
    i, j, k = np.indices(tensor.shape).reshape(3, -1)
    chosen = (i >= j) & (j >= k)
    for order in itertools.permutations((i[chosen], j[chosen], k[chosen])):
        tensor[order] = entries
    return tensor


def whole_skew(entries: np.ndarray) -> np.ndarray:
    matrix = np.zeros((N_DELTA, N_DELTA))
    matrix[np.tril_indices(N_DELTA, -1)] = entries
    return matrix - matrix.T


def anywhere(n: int, seed: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return states inside cells of the grid."""
    random = np.random.default_rng(seed)
    q, v, a = random.normal(size=(3, n, N_ETA))
    q[:, 2:] *= 0.3
    cells = random.integers(0, 12, (n, 2)) + random.uniform(0.2, 0.8, (n, 2))
    q[:, :2] = [0.0, -1.0] + cells * [2 * np.pi / 20, 2.5 / 13]
    return q, v, a


@pytest.mark.parametrize("second", [False, True], ids=["first order", "second order"])
@pytest.mark.parametrize("quadratic", [True, False])
def test_the_residual_is_that_of_the_lagrangian(quadratic: bool, second: bool) -> None:
    """``d/dt dL/dv - dL/dq - Q_theta`` by central differences along the motion that q, v and a begin."""
    terms = terms_of(quadratic=quadratic, second=second)
    lagrangian = Lagrangian(terms)
    q, v, a = anywhere(5)
    found = system_of(terms, 5).residual(0.0, State(q, v, a, np.zeros(0)))
    if not quadratic:
        # at rest there is nothing to leave out
        v = np.zeros_like(v)
    h = 1e-4
    for k in range(5):
        moved = [lagrangian.momentum(q[k] + v[k] * t + 0.5 * a[k] * t**2, v[k] + a[k] * t) for t in (h, -h)]
        gradient = [(lagrangian(q[k] + h * e, v[k]) - lagrangian(q[k] - h * e, v[k])) / (2 * h) for e in np.eye(N_ETA)]
        expected = (moved[0] - moved[1]) / (2 * h) - gradient
        expected[:2] -= lagrangian.parts(q[k, :2])[3][:2]
        np.testing.assert_allclose(found[k], expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_damping_takes_its_share_of_the_momentum() -> None:
    terms = terms_of()
    q, v, a = anywhere(4)
    state = State(q, v, a, np.zeros(0))
    plain = system_of(terms, 4).residual(0.0, state)
    damped = system_of(terms_of(mass=0.5), 4).residual(0.0, state)
    momenta = np.array([Lagrangian(terms).momentum(x, y) for x, y in zip(q, v)])
    # the rigid inertia's polynomials of degree 7 keep twelve digits of a residual below 100
    np.testing.assert_allclose(damped - plain, 0.5 * momenta, rtol=0, atol=1e-10)
    terms = terms_of(damping=0.1)
    structural = system_of(terms, 4).residual(0.0, state) - plain
    mass = np.array([whole(terms.terms(x[None, :2])[0, 0, terms.layout.damping :]) for x in q])
    np.testing.assert_allclose(structural, np.einsum("nij,nj->ni", mass, v), rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    "settings",
    [{}, {"damping": 0.01, "mass": 0.3}, {"quadratic": False}, {"second": True, "driven": 0.0}],
    ids=["all", "structural damping", "slow", "second order"],
)
def test_newton_converges_at_once(settings: dict) -> None:
    """The correction's own residual falls by what the matrix leaves out: second derivatives, of order step squared.

    Of second order that is what one refinement leaves of the gyroscopic part too: the square of 2 %, its size beside
    gain_v here. The matrix has no border by P_k, as the rows of
    prescribed coordinates are not solved. Deformations are then so small that their cubic energy is beside the point.
    """
    first, then = (1e-3, 1e-6) if "second" in settings else (1e-4, 1e-8)
    terms = terms_of(**settings)
    q, v, a = anywhere(4)
    if "second" in settings:
        q[:, 2:] *= 0.1
    system = system_of(terms, 4)
    scheme = Scheme.of(0.8, 2e-3)
    state = State(q, v, a, np.zeros(0))
    before = np.abs(system.residual(0.0, state)).max()
    system.correct(0.0, state, scheme, np.ones(4, dtype=bool), True)
    assert np.abs(system.residual(0.0, state)).max() < first * before
    system.correct(0.0, state, scheme, np.ones(4, dtype=bool), True)
    assert np.abs(system.residual(0.0, state)).max() < then * before


def simulate(
    system: ReducedSystem, duration: float, step: float, radius: float = 1.0
) -> tuple[Run, list[State], list[float]]:
    simulation = Simulation(duration=duration, step=step, spectral_radius=radius)
    run, seen = watched(system, simulation, lambda time, state: (state.copy(), time))
    return run, *map(list, zip(*seen))


def energies(terms: ReducedTerms, states: list[State]) -> np.ndarray:
    q, v = (np.array([getattr(state, name)[0] for state in states]) for name in "qv")
    kinetic, strain = reduced_energy(terms, {}, q, v)
    work = np.einsum("ni,ni->n", 1.3 * terms.load(q[:, :2])[:, 0, 2:], q[:, 2:])
    return kinetic + strain - work


@pytest.mark.parametrize("second", [False, True], ids=["first order", "second order"])
def test_energies_are_those_of_the_full_tensors(second: bool) -> None:
    terms = terms_of(second=second)
    lagrangian, (q, v, _) = Lagrangian(terms), anywhere(5)
    kinetic, strain = reduced_energy(terms, {}, q, v)
    for k in range(5):
        _, _, stiffness, _, cubic, *_ = lagrangian.parts(q[k, :2])
        delta = q[k, 2:]
        assert kinetic[k] == pytest.approx(0.5 * v[k] @ lagrangian.inertia(q[k]) @ v[k], rel=1e-12)
        stored = 0.5 * delta @ stiffness @ delta + np.einsum("ijk,i,j,k", cubic, delta, delta, delta) / 6.0
        assert strain[k] == pytest.approx(stored, rel=1e-12)


def unloaded_terms() -> ReducedTerms:
    terms = terms_of()
    load = terms.tables.load.copy()
    load[:, :, :2] = 0.0
    return ReducedTerms(**{**terms.__dict__, "load": interpolant(GRID, load, "spline")})


def test_energy_is_conserved_over_a_long_run() -> None:
    """Without loads on the rigid coordinates; both turn, and the second one stays in its range."""
    terms = unloaded_terms()
    drifts = []
    for step in (2e-3, 1e-3):
        run, states, _ = simulate(system_of(terms, speed=(2.0, 0.03)), 4.0, step)
        assert run.status[0] == 0
        total = energies(terms, states)
        drifts.append(np.abs(total - total[0]).max() / np.abs(total[0]))
        assert np.ptp([state.q[0, 0] for state in states]) > 5.0
    assert drifts[1] < 1e-4 and drifts[0] / drifts[1] > 3.0


def test_the_motion_is_that_of_the_exact_lagrangian() -> None:
    """Against scipy's solver with the analytic functions themselves, by differences of their Lagrangian."""
    from scipy.integrate import solve_ivp

    fine = SampleGrid((Samples.uniform(0.0, 2 * np.pi, 64, True), Samples.uniform(-1.0, 1.5, 40, False)))
    terms = terms_of(fine)
    (q,), (v,) = np.array([[0.3, 0.2, 0.0, 0.0, 0.0]]), np.array([[1.0, -0.2, 0.0, 0.0, 0.0]])
    h = 1e-3

    def exact(theta: np.ndarray) -> tuple[np.ndarray, ...]:
        at = made_up(np.array([theta, *(theta + s * h * e for e in np.eye(2) for s in (1, -1))]))
        mass, inertia = at["mass"][:, 0], at["inertia"][0, 0]
        slopes = [(mass[1 + 2 * k] - mass[2 + 2 * k]) / (2 * h) for k in (0, 1)]
        b = np.array([[0.5 * (slopes[j][k, 2:] + slopes[k][j, 2:]) - inertia[k, j] for j in (0, 1)] for k in (0, 1)])
        return mass[0], b, at["stiffness"][0, 0], 1.3 * at["load"][0, 0]

    def value(q: np.ndarray, v: np.ndarray) -> float:
        mass, b, stiffness, load = exact(q[:2])
        kinetic = 0.5 * v @ mass @ v + np.einsum("k,l,kli,i", v[:2], v[:2], b, q[2:])
        return kinetic - 0.5 * q[2:] @ stiffness @ q[2:] + load[2:] @ q[2:]

    def inertia(q: np.ndarray) -> np.ndarray:
        mass, b, *_ = exact(q[:2])
        mass = mass.copy()
        mass[:2, :2] += 2.0 * b @ q[2:]
        return mass

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        q, v = np.split(y, 2)
        gradient = np.array([(value(q + h * e, v) - value(q - h * e, v)) / (2 * h) for e in np.eye(N_ETA)])
        turning = (inertia(q + h * v) - inertia(q - h * v)) / (2 * h) @ v
        force = gradient - turning
        force[:2] += exact(q[:2])[3][:2]
        return np.concatenate([v, np.linalg.solve(inertia(q), force)])

    expected = solve_ivp(rate, (0.0, 0.5), np.concatenate([q, v]), "DOP853", rtol=1e-8, atol=1e-9).y[:, -1]
    run, _, _ = simulate(system_of(terms, start=q[:2], speed=v[:2]), 0.5, 2.5e-4)
    # differences of h^2 = 1e-6, and steps of 2.5e-4 beside a period of 0.5 s
    np.testing.assert_allclose(run.state.q[0], expected[:N_ETA], rtol=0, atol=5e-6)
    np.testing.assert_allclose(run.state.v[0], expected[N_ETA:], rtol=0, atol=5e-5)


class Turning:
    """theta(t) = 0.2 + 0.5 (1 - cos 3 t)."""

    def at(self, time: float) -> tuple[float, float, float]:
        return 0.2 + 0.5 * (1 - np.cos(3 * time)), 1.5 * np.sin(3 * time), 4.5 * np.cos(3 * time)


def test_a_prescribed_coordinate_moves_as_it_is_told_and_its_drive_does_the_work() -> None:
    terms = unloaded_terms()
    system = system_of(terms, speed=(1.0, 0.0), motions={1: Turning()})
    run, states, times = simulate(system, 1.5, 5e-4)
    assert run.status[0] == 0
    for state, time in zip(states, times):
        found = (state.q[0, 1], state.v[0, 1], state.a[0, 1])
        np.testing.assert_allclose(found, Turning().at(time), rtol=0, atol=1e-14)
    residuals = np.array([system.residual(time, state)[0] for state, time in zip(states, times)])
    free = [0, 2, 3, 4]
    assert np.abs(residuals[:, free]).max() < 1e-6 * np.abs(residuals[:, 1]).max()
    power = residuals[:, 1] * [state.v[0, 1] for state in states]
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(times))])
    gained = energies(terms, states)
    gained -= gained[0]
    assert np.ptp(gained) > 1.0
    np.testing.assert_allclose(gained, work, rtol=0, atol=1e-4 * np.ptp(gained))


def test_samples_beyond_the_range_are_outside() -> None:
    system = system_of(terms_of(), 3)
    q = np.zeros((3, N_ETA))
    q[:, :2] = [[9.0, 0.0], [0.0, 1.6], [0.0, -1.0]]
    np.testing.assert_array_equal(system.outside(State(q, q, q, np.zeros(0))), [False, True, False])


PART = (
    "coordinates.theta.range=[0.2,1.4]",
    "coordinates.theta.periodic=false",
    "simulation.initial.theta.position=0.2",
)


@pytest.fixture(scope="module")
def rom() -> ReducedOrderModel:
    return rom_of(slider_crank())


def terms_of_scene(rom: ReducedOrderModel, scene: Scene, scheme: str) -> ReducedTerms:
    return ReducedTerms.of(rom, kinematics_of(scene), scene.with_entries(reduction={"interpolation": scheme}))


def rigid_of(rom: ReducedOrderModel) -> Interpolant:
    return interpolant(fine_grid(rom.tables.samples), rom.rigid_inertia, "spline")


def direct_inertia(scene: Scene, theta: float) -> dict:
    """Return ``(d rho/d theta)^T M_i (d rho/d theta)`` of every term, from matrices and velocities."""
    kinematics = kinematics_of(scene)
    mechanism = kinematics.mechanism
    poses = kinematics.poses(np.array([theta]))
    velocity = rigid_velocities(mechanism, poses[..., 0], kinematics.rates(poses)[..., 0])[:, 0]
    mass = AffineMatrices(mechanism.bodies, range(mechanism.n_dofs)).mass
    return {weight: float(velocity @ (mass[weight] @ velocity)) for weight in mechanism.mass_weights}


@pytest.mark.parametrize(
    "scene",
    [slider_crank, quick_return, lambda: four_bar(), lambda: trammel(*PART)],
    ids=["slider-crank", "quick return", "two turns", "limited"],
)
def test_the_rigid_inertia_is_that_of_the_kinematics(scene: Callable[..., Scene]) -> None:
    scene = scene()
    tables, inertia = rom_of(scene).tables, rigid_of(rom_of(scene))
    samples = tables.samples.axes[0]
    # neither samples nor points of the fine grid
    for theta in samples.lower + (samples.upper - samples.lower) * np.array([0.0, 0.1234567, 0.5, 0.7654321, 0.9998]):
        expected = direct_inertia(scene, theta)
        size = max(expected.values())
        found = inertia(np.array([theta]))[0, :, 0]
        for weight, value in zip(tables.mass_weights, found):
            assert value == pytest.approx(expected[weight], abs=1e-9 * size), (theta, weight)
    # at the samples it is the table's own, which knows it from the modes' basis; over two turns the step is double
    of_tables = tables.mass[:, :, 0, 0]
    np.testing.assert_allclose(inertia(samples.theta)[:, :, 0], of_tables, rtol=0, atol=4e-9 * of_tables.max())


def test_loads_are_absent_where_the_scene_has_none() -> None:
    bare = slider_crank("effects={}", "reduction.angles=8", "reduction.modes=2")
    assert terms_of_scene(rom_of(bare), bare, "spline").load(np.array([0.1, 0.2])).shape == (2, 0, 3)


def test_the_slope_of_the_rigid_inertia_is_twice_velocity_times_acceleration(rom: ReducedOrderModel) -> None:
    scene, step = slider_crank(), 1e-4
    weights, inertia = rom.tables.mass_weights, rigid_of(rom)
    for theta in (0.3, 2.0, 4.4):
        ahead, behind = direct_inertia(scene, theta + step), direct_inertia(scene, theta - step)
        expected = np.array([(ahead[w] - behind[w]) / (2 * step) for w in weights])
        np.testing.assert_allclose(
            inertia(np.array([theta]), 0)[0, :, 0], expected, rtol=0, atol=1e-7 * max(ahead.values())
        )


@pytest.mark.parametrize("angles", [9, 24, 60])
def test_the_polynomials_of_the_rigid_inertia_are_as_good_as_its_spline(angles: int) -> None:
    """The coefficients, in rad from the lower end of a cell, against the spline at any theta."""
    scene = slider_crank(f"reduction.angles={angles}")
    terms = terms_of_scene(rom_of(scene), scene, "spline")
    (grid,) = terms.grid
    assert grid.step <= WIDEST * (1 + 1e-9) and grid.n_cells % angles == 0
    for theta in np.linspace(0.0, 2 * np.pi, 77, endpoint=False):
        cell, place = divmod(theta - grid.lower, grid.step)
        # one packed entry, its eight coefficients
        found = terms.cells.rigid.polynomials[place_in(terms.cells.rigid, int(cell))] @ place ** np.arange(8.0)
        expected = terms.rigid(np.array([theta]))[0, :, 0]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("second_order", ["true", "false"])
def test_stiffness_that_interpolation_made_indefinite_has_no_share(second_order: str) -> None:
    """There it is said where, in place of an error of the factors; before the end of a run as well as there."""
    scene = slider_crank(f"reduction.second_order={second_order}")
    rom = rom_of(scene)
    model = ReducedModel(scene, rom)
    q = np.zeros((3, model.terms.layout.n_eta))
    q[:, 0] = 0.2, 0.4, 0.6
    np.testing.assert_allclose(least_stiffness(model.terms, scene.values, q), 1.0, rtol=1e-12)
    time = np.arange(3.0)
    assert lost_definiteness(model, scene.values, time, q) == ""
    # tables that change their sign in the second half of a turn
    stiffness = rom.tables.stiffness.copy()
    stiffness[rom.tables.samples.theta.ravel() > np.pi] *= -1.0
    negated = replace(rom.tables, stiffness=stiffness)
    model = ReducedModel(scene, replace(rom, tables=negated))
    q[2, 0] = 4.0
    share = least_stiffness(model.terms, scene.values, q)
    np.testing.assert_array_equal(np.isnan(share), [False, False, True])
    why = lost_definiteness(model, scene.values, time, q)
    assert "is not positive definite at theta = 4 rad; build with more reduction.angles" in why
    assert lost_definiteness(model, scene.values, time, q[[0, 2, 1]]) == why


LOWER, UPPER, PERIODIC = (0.0, -0.3, 0.2), (2 * np.pi, 0.9, 1.7), (True, False, False)


def sampled(n: tuple[int, ...]) -> SampleGrid:
    """Return a grid with so many samples along the coordinates."""
    return SampleGrid(tuple(Samples.uniform(*ends, k, turns) for *ends, k, turns in zip(LOWER, UPPER, n, PERIODIC)))


@pytest.mark.parametrize("scheme", ["overhauser", "spline"])
@pytest.mark.parametrize("n", [(9,), (9, 7), (9, 7, 6)])
@pytest.mark.parametrize("n_powers", [4, 8])
@pytest.mark.parametrize("most_held", [0, 2**22])
def test_the_polynomials_of_cells_are_the_interpolant(
    scheme: str, n: tuple[int, ...], n_powers: int, most_held: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All cells are held, or more are asked for than are held, some of them again."""
    monkeypatch.setattr(cells_module, "MOST_HELD", most_held)
    grid, r = sampled(n), len(n)
    found = interpolant(grid, np.random.default_rng(0).normal(size=(grid.n, 2, 3)), scheme)
    axes = grid_of(found)
    cells = Cells.of(found, axes, n_powers)
    for theta in np.random.default_rng(1).uniform(LOWER[:r], UPPER[:r], size=(4 * FEWEST_HELD, r)).repeat(2, axis=0):
        number, powers = 0, np.ones(1)
        for x, axis in zip(theta, axes):
            cell = int((x - axis.lower) / axis.step)
            place = x - axis.lower - cell * axis.step
            number, powers = (
                number * axis.n_cells + cell,
                np.multiply.outer(powers, place ** np.arange(n_powers)).ravel(),
            )
        of_cell = cells.polynomials[place_in(cells, number)].reshape(2, 3, -1)
        np.testing.assert_allclose(of_cell @ powers, found(theta[None])[0], rtol=0, atol=1e-10)


@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize("n_powers", [4, 8])
@pytest.mark.parametrize(("most", "widths"), [(1, {1}), (2, {1, 2}), (8, {1, 2, 4})])
def test_cells_from_sample_to_sample_have_one_polynomial(
    periodic: bool, n_powers: int, most: int, widths: set[int]
) -> None:
    """Of 12 intervals some are halved, and one half once more; polynomials hold in all cells that they are for."""
    even = Samples.uniform(0.0, 3.0, 12 + (not periodic), periodic)
    samples = Samples(np.union1d(even.theta, [0.125, 0.875, 0.9375]), 0.0, 3.0, periodic)
    found = interpolant(samples, np.random.default_rng(0).normal(size=(samples.n, 2, 3)), "spline")
    (axis,) = grid_of(found, 1, most)
    assert axis.n_cells == 48 and set(np.unique(np.bincount(axis.begins.astype(int)))) - {0} == widths
    cells = Cells.of(found, (axis,), n_powers)
    for theta in np.random.default_rng(1).uniform(0.0, 3.0, 100):
        number = int(theta / axis.step)
        for first in (number, int(axis.begins[number])):
            powers = (theta - first * axis.step) ** np.arange(n_powers)
            of_cell = cells.polynomials[place_in(cells, first)].reshape(2, 3, -1)
            np.testing.assert_allclose(of_cell @ powers, found(np.array([[theta]]))[0], rtol=0, atol=1e-11)


@pytest.mark.parametrize(("scheme", "order"), [("overhauser", 3), ("spline", 4)])
def test_the_order_over_three_coordinates(scheme: str, order: int) -> None:
    def exact(theta: np.ndarray) -> np.ndarray:
        return np.sin(theta[:, 0] + 2.0 * theta[:, 1]) * np.exp(theta[:, 2] - theta[:, 1])

    theta, errors = np.random.default_rng(2).uniform(LOWER, UPPER, size=(400, 3)), []
    for n in (12, 24):
        grid = sampled((2 * n, n + 1, n + 1))
        errors.append(np.abs(interpolant(grid, exact(grid.theta), scheme)(theta) - exact(theta)).max())
    assert np.log2(errors[0] / errors[1]) > order - 0.4


def test_the_coupling_is_what_the_modes_change_makes_with_the_rigid_motion() -> None:
    """b against ``v^T M (dPsi/dtheta + spin x Psi)`` from differences of fine tables."""
    scene = slider_crank("reduction.angles=256", "reduction.modes=3")
    rom = rom_of(scene)
    samples = rom.tables.samples.axes[0]
    n, step = samples.n, 2 * np.pi / samples.n
    mechanism = mechanism_of(scene)
    kinematics = RigidKinematics(mechanism)
    mass = weighted_sum(AffineMatrices(mechanism.bodies, range(mechanism.n_dofs)).mass, scene.nominal)
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
