"""Reduced runs in space: the rigid limit by Lagrange's equations of solid bars, the balance of energy, conservation."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
import pytest
import spatial
from runs import motion, rom_of
from scipy.integrate import cumulative_trapezoid, solve_ivp
from scipy.spatial.transform import Rotation

from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results import Trajectory
from pgmp_petsc.scene import Scene

GRAVITY = 9.81


Place = tuple[np.ndarray, np.ndarray]  # rotation (3, 3) and origin (3,)


class RigidBars:
    """Square bars of steel along their own x axes, that go with coordinates as closed forms say.

    A bar's kinetic energy is ``1/2 m |c'|^2 + 1/2 tr(R' J R'^T)``, c its centre and ``J = m/12 diag(L^2, w^2, w^2)``.
    `places` leads from coordinates (n_theta,) to the place of every bar.
    """

    def __init__(self, lengths: Sequence[float], places: Callable[[np.ndarray], list[Place]]) -> None:
        self.lengths, self.places = lengths, places
        self.masses = [spatial.DENSITY * spatial.WIDTH**2 * length for length in lengths]

    def positions(self, theta: np.ndarray) -> np.ndarray:
        """Return ``sqrt(m) c`` and ``R sqrt(J)`` of all bars: half their rates' square is the kinetic energy."""
        parts = []
        for mass, length, (turn, origin) in zip(self.masses, self.lengths, self.places(theta)):
            parts.append(np.sqrt(mass) * (origin + 0.5 * length * turn[:, 0]))
            parts.append((turn * np.sqrt(mass / 12.0) * [length, spatial.WIDTH, spatial.WIDTH]).ravel())
        return np.concatenate(parts)

    def mass(self, theta: np.ndarray) -> np.ndarray:
        """Return M(theta), shape (n_theta, n_theta)."""
        rates = derivative(self.positions, theta)
        return rates @ rates.T

    def weight(self, theta: np.ndarray, direction: Sequence[float]) -> float:
        """Return the potential energy in gravity along a unit vector, J."""
        moment = np.zeros(3)
        for mass, length, (turn, origin) in zip(self.masses, self.lengths, self.places(theta)):
            moment += mass * (origin + 0.5 * length * turn[:, 0])
        return -GRAVITY * moment @ np.array(direction)

    def motion(
        self, times: np.ndarray, start: np.ndarray, forces: Callable[[float, np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """Return theta over time, (n, n_theta), by ``d/dt (M theta') - 1/2 dM/dtheta theta' theta' = Q(t, theta)``."""
        n = start.size // 2

        def rates(time: float, state: np.ndarray) -> np.ndarray:
            theta, speed = state[:n], state[n:]
            slopes = derivative(lambda at: self.mass(at).ravel(), theta).reshape(n, n, n)
            carried = np.einsum("kij,k,j->i", slopes, speed, speed)
            carried -= 0.5 * np.einsum("kij,i,j->k", slopes, speed, speed)
            return np.concatenate([speed, np.linalg.solve(self.mass(theta), forces(time, theta) - carried)])

        solved = solve_ivp(rates, (times[0], times[-1]), start, "DOP853", times, rtol=1e-8, atol=1e-10)
        return solved.y[:n].T


def derivative(function: Callable[[np.ndarray], np.ndarray], theta: np.ndarray) -> np.ndarray:
    """Return the derivatives of a function (m,) in the coordinates, shape (n_theta, m); of fourth order, to 1e-8."""
    found, step = [], 5e-3
    for unit in step * np.eye(theta.size):
        near, far = (function(theta + k * unit) - function(theta - k * unit) for k in (1, 2))
        found.append((8 * near - far) / (12 * step))
    return np.array(found)


def spatial_places(theta: np.ndarray) -> list[Place]:
    """Return the places of crank, rod and slider of the spatial slider-crank."""
    tip, along = spatial.crank_tip(theta)[:, 0], spatial.slider_place(theta)[0]
    cos, sin = np.cos(theta[0]), np.sin(theta[0])
    # the crank is placed along -z, with its own z along x, and turns about x
    crank = np.array([[0.0, 0.0, 1.0], [sin, cos, 0.0], [-cos, sin, 0.0]])
    rod = (np.array([along, 0.0, 0.0]) - tip) / spatial.ROD
    # the universal joint: the direction v that was z in the rod as it is placed is at a right angle to y, still near z
    v = Rotation.from_rotvec([0.0, 0.07, -0.34]).as_matrix().T @ [0.0, 0.0, 1.0]
    normal = np.array([rod[2], -rod[0]]) / np.hypot(rod[0], rod[2])  # across the rod in the plane of x and z
    flat = np.array([rod[0], rod[2]]) * v[0] / (rod[0] ** 2 + rod[2] ** 2)
    flat -= normal * np.sqrt(1.0 - flat @ flat)
    held = np.array([flat[0], 0.0, flat[1]])
    turn = _frame(rod, held) @ _frame(np.array([1.0, 0.0, 0.0]), v).T
    return [
        (crank, spatial.crank_tip(theta)[:, 0] - spatial.CRANK * crank[:, 0]),
        (turn, tip),
        (np.eye(3), np.array([along, 0.0, 0.0])),
    ]


def _frame(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return an orthonormal frame: its first column is a unit vector, its second is nearest to another vector."""
    across = second - first * (first @ second)
    across /= np.linalg.norm(across)
    return np.column_stack([first, across, np.cross(first, across)])


SPATIAL = RigidBars((spatial.CRANK, spatial.ROD, 0.05), spatial_places)


def arm_places(theta: np.ndarray) -> list[Place]:
    """Return the places of both bars of the arm."""
    upper = Rotation.from_rotvec([0.0, 0.0, theta[0]]).as_matrix()
    lower = upper @ Rotation.from_rotvec(theta[1] * spatial.SECOND_AXIS).as_matrix()
    return [(upper, np.zeros(3)), (lower, spatial.UPPER * upper[:, 0])]


ARM = RigidBars((spatial.UPPER, spatial.LOWER), arm_places)


NO_STATIC = ("reduction.static_modes=false", "reduction.inertia_modes=false")
STIFF = ("materials.steel.E=2.1e14", "reduction.modes=2", *NO_STATIC)
# a part of the revolution, in which the runs stay
WITHIN = (
    "coordinates.theta.range=[-0.8,2.6]", "coordinates.theta.periodic=false", "reduction.angles=33",
    "simulation.duration=0.3", "simulation.step=5e-4",
)  # fmt: skip
STILL, GRAVITY_AXIS, OBLIQUE = "[[0.0,0.0],[1.0,0.0]]", (0.6, 0.0, -0.8), np.array([1.0, 2.0, 2.0]) / 3.0
# everything that may act, without strength; runs give some of it one
EFFECTS = (
    "effects={}",
    f'effects.motor={{type="torque",joint="crank_hinge",table={STILL}}}',
    f'effects.gravity={{type="gravity",acceleration="g",direction={list(GRAVITY_AXIS)}}}',
    f'effects.push={{type="force",point="slider:tip",direction=[-1.0,0.0,0.0],table={STILL}}}',
    f'effects.pull={{type="force",point="crank:tip",direction={OBLIQUE.tolist()},table={STILL}}}',
    "parameters.g={nominal=9.81,value=0.0}",
)
MOTOR, WEIGHT = "effects.motor.table=[[0.0,0.0],[0.1,0.06],[1.0,0.06]]", "parameters.g.value=9.81"
PUSH, PULL = (f"effects.{name}.table=[[0.0,1.0],[1.0,1.0]]" for name in ("push", "pull"))


def stiff_scene(*overrides: str) -> Scene:
    """Return the spatial slider-crank of stiff bars."""
    return spatial.spatial_slider_crank(*EFFECTS, "parameters.E1={nominal=2.1e14}", *STIFF, *WITHIN, *overrides)


@lru_cache(maxsize=1)
def stiff_model() -> tuple[ReducedOrderModel, RigidKinematics]:
    """Return its reduced-order model, which serves all its runs, and its kinematics."""
    scene = stiff_scene()
    return (rom := rom_of(scene)), RigidKinematics(Mechanism.from_scene(scene, rom.meshes))


def run_stiff(*overrides: str) -> Trajectory:
    """Run the stiff slider-crank."""
    return motion(ReducedModel(stiff_scene(*overrides), *stiff_model()))


def nothing(time: float, theta: np.ndarray) -> np.ndarray:
    return np.zeros(1)


def of_motor(time: float, theta: np.ndarray) -> np.ndarray:
    return np.array([np.interp(time, [0.0, 0.1], [0.0, 0.06])])


def of_weight(time: float, theta: np.ndarray) -> np.ndarray:
    return -derivative(lambda at: np.array([SPATIAL.weight(at, GRAVITY_AXIS)]), theta)[:, 0]


def of_push(time: float, theta: np.ndarray) -> np.ndarray:
    return -derivative(spatial.slider_place, theta)[:, 0]


def of_pull(time: float, theta: np.ndarray) -> np.ndarray:
    return derivative(lambda at: spatial.crank_tip(at)[:, 0], theta) @ OBLIQUE


def of_all(time: float, theta: np.ndarray) -> np.ndarray:
    return of_motor(time, theta) + of_weight(time, theta) + of_push(time, theta)


# what acts, the generalised force of it, and where the run begins: position (rad) and velocity (rad/s)
LOADS = {
    "nothing": ((), nothing, 0.3, 6.0), "torque": ((MOTOR,), of_motor, 0.0, 0.0),
    "gravity": ((WEIGHT,), of_weight, 0.3, 0.0), "force on the slider": ((PUSH,), of_push, 0.2, 1.0),
    "force on the crank": ((PULL,), of_pull, 0.0, 0.0), "all": ((MOTOR, WEIGHT, PUSH), of_all, 0.4, 3.0),
}  # fmt: skip
# of the time step, second order: 6e-6 at 0.5 ms at most, a quarter of it at half the step
RIGID = 1e-5


@pytest.mark.parametrize("name", LOADS)
def test_stiff_bars_move_as_rigid_ones(name: str) -> None:
    effects, force, position, velocity = LOADS[name]
    found = run_stiff(*effects, f"simulation.initial.theta={{position={position},velocity={velocity}}}")
    expected = SPATIAL.motion(found.time, np.array([position, velocity]), force)
    assert np.ptp(expected) > 0.3
    np.testing.assert_allclose(found.coordinates, expected, rtol=0, atol=RIGID)
    np.testing.assert_allclose(found.outputs["crank_angle"], expected[:, 0], rtol=0, atol=RIGID)
    place = spatial.slider_place(expected[:, 0])
    np.testing.assert_allclose(found.outputs["slider_position"], place, rtol=0, atol=spatial.CRANK * RIGID)
    # what is stored is what bars of this mass store
    mass = np.array([SPATIAL.mass(theta)[0, 0] for theta in expected[::60]])
    speed = np.gradient(expected[:, 0], found.time, edge_order=2)[::60]
    # differences over 0.5 ms: 1e-7 times the third derivative of the angle, some 1e3 1/s3
    np.testing.assert_allclose(found.balance.kinetic[::60], 0.5 * mass * speed**2, rtol=1e-3, atol=1e-7)
    if name == "gravity":
        weights = [SPATIAL.weight(theta, GRAVITY_AXIS) for theta in found.coordinates]
        # along the run that was found: of the bars' strain, 1e-6 of their weight, and of the trapezoidal rule
        np.testing.assert_allclose(found.balance.potential, weights, rtol=0, atol=1e-5 * np.ptp(weights))


def test_braked_stiff_bars() -> None:
    """A medium brakes all momentum: ``M theta'' + 1/2 M' theta'^2 = -alpha M theta'``."""
    alpha, position, velocity = 5.0, 0.3, 6.0
    brake = f'effects.medium={{type="structural_damping",mass={alpha}}}'
    found = run_stiff(brake, f"simulation.initial.theta={{position={position},velocity={velocity}}}")
    # the same path as without it, in another time: tau = (1 - exp(-alpha t)) / alpha
    slowed = (1.0 - np.exp(-alpha * found.time)) / alpha
    expected = SPATIAL.motion(slowed, np.array([position, velocity]), nothing)
    np.testing.assert_allclose(found.coordinates, expected, rtol=0, atol=RIGID)


def test_stiff_bars_without_the_forces_by_velocities() -> None:
    """Left out, nothing remains of the inertia but ``M theta''``: without a load the speed stays as it is."""
    left_out = 'effects.simple={type="gyroscopic",keep=false}'
    found = run_stiff(left_out, "simulation.initial.theta={position=0.3,velocity=6.0}")
    np.testing.assert_allclose(found.coordinates[:, 0], 0.3 + 6.0 * found.time, rtol=0, atol=1e-9)


def test_a_point_mass_on_stiff_bars() -> None:
    mass, inertia = 0.3, 2e-3
    point = f'effects.ball={{type="point_mass",point="crank:tip",mass={mass},inertia={inertia}}}'
    scene = stiff_scene(point, MOTOR, "coordinates.theta.range=[-0.1,1.1]", "reduction.angles=13")
    found = motion("reduced", scene)

    class WithMass(RigidBars):
        def positions(self, theta: np.ndarray) -> np.ndarray:
            turn = self.places(theta)[0][0]
            # one moment of inertia about every axis: an isotropic J of half of it
            ball = [np.sqrt(mass) * spatial.crank_tip(theta)[:, 0], np.sqrt(0.5 * inertia) * turn.ravel()]
            return np.concatenate([super().positions(theta), *ball])

    expected = WithMass(SPATIAL.lengths, spatial_places).motion(found.time, np.zeros(2), of_motor)
    without = SPATIAL.motion(found.time, np.zeros(2), of_motor)
    assert np.abs(expected - without).max() > 0.1
    np.testing.assert_allclose(found.coordinates, expected, rtol=0, atol=RIGID)


def test_a_prescribed_motion_of_stiff_bars() -> None:
    """What drives the crank does the work that its bars take up."""
    # begins and ends without a jump of the acceleration
    driven = 'effects.drive={type="prescribed_motion",coordinate="theta",spin_up={speed=10.0,time=0.3}}'
    scene = stiff_scene("effects={}", driven, "coordinates.theta.range=[-0.1,1.6]", "reduction.angles=17")
    found = motion("reduced", scene)
    rate = 2 * np.pi / 0.3
    theta = 10.0 / 0.3 * (0.5 * found.time**2 + (np.cos(rate * found.time) - 1.0) / rate**2)
    speed = 10.0 / 0.3 * (found.time - np.sin(rate * found.time) / rate)
    np.testing.assert_allclose(found.coordinates[:, 0], theta, rtol=0, atol=1e-12)
    kinetic = 0.5 * np.array([SPATIAL.mass(np.array([at]))[0, 0] for at in theta]) * speed**2
    # the bars' own motion, which is coupled to the prescribed one, and the trapezoidal rule
    np.testing.assert_allclose(found.balance.kinetic, kinetic, rtol=0, atol=1e-5 * kinetic.max())
    np.testing.assert_allclose(found.balance.work["drive"], kinetic, rtol=0, atol=1e-5 * kinetic.max())


ARM_STIFF = (
    "materials.steel.E=2.1e14", "reduction.modes=2", "reduction.angles=12", 'reduction.interpolation="spline"',
    *(f"coordinates.theta{k}.{entry}" for k in (1, 2) for entry in ("range=[-1.1,1.1]", "periodic=false")),
    f'effects.motor={{type="torque",joint="elbow",table={STILL}}}',
    'effects.gravity={type="gravity",acceleration="g",direction=[0.0,-0.6,0.8]}',
    "parameters.g={nominal=9.81,value=0.0}",
    "simulation.duration=0.2", "simulation.step=5e-4",
)  # fmt: skip
ELBOW = "effects.motor.table=[[0.0,0.0],[0.1,0.3],[1.0,0.3]]"


@lru_cache(maxsize=1)
def stiff_arm() -> tuple[ReducedOrderModel, RigidKinematics]:
    """Return the reduced-order model of an arm of two stiff bars, and its kinematics."""
    scene = spatial.arm(*ARM_STIFF)
    return (rom := rom_of(scene)), RigidKinematics(Mechanism.from_scene(scene, rom.meshes))


def run_arm(*overrides: str) -> Trajectory:
    """Run the arm."""
    return motion(ReducedModel(spatial.arm(*ARM_STIFF, *overrides), *stiff_arm()))


def of_elbow(time: float, theta: np.ndarray) -> np.ndarray:
    return np.array([0.0, np.interp(time, [0.0, 0.1], [0.0, 0.3])])


def of_arms_weight(time: float, theta: np.ndarray) -> np.ndarray:
    return -derivative(lambda at: np.array([ARM.weight(at, (0.0, -0.6, 0.8))]), theta)[:, 0]


ARM_LOADS = {
    "nothing": ((), lambda time, theta: np.zeros(2), (0.8, -2.0)),
    "torque": ((ELBOW,), of_elbow, (0.0, 0.0)),
    "gravity": (("parameters.g.value=9.81",), of_arms_weight, (0.0, 0.0)),
}


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("name", ARM_LOADS)
def test_an_arm_of_stiff_bars_moves_as_a_rigid_one(name: str) -> None:
    effects, forces, speeds = ARM_LOADS[name]
    start = [f"simulation.initial.theta{k}={{position=0.0,velocity={speed}}}" for k, speed in enumerate(speeds, 1)]
    found = run_arm(*effects, *start)
    expected = ARM.motion(found.time, np.array([0.0, 0.0, *speeds]), forces)
    assert np.ptp(expected, axis=0).min() > 0.05
    # of the time step and of the load between its samples, which are 0.2 rad apart: measured 1.1e-5
    np.testing.assert_allclose(found.coordinates, expected, rtol=0, atol=3e-5)


@pytest.mark.usefixtures("coarse")
def test_a_torque_between_two_moving_bodies_is_action_and_reaction() -> None:
    """It does no work on a rotation of the whole, whose momentum therefore stays zero."""
    rom, _ = stiff_arm()
    motor = rom.tables.load_effects.index("motor")
    # work on a motion of the shoulder, which turns both bars as one, and on that of the elbow
    np.testing.assert_allclose(rom.tables.load[:, motor, 0], 0.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rom.tables.load[:, motor, 1], 1.0, rtol=0, atol=1e-12)
    found = run_arm(ELBOW)
    rates = np.gradient(found.coordinates, found.time, axis=0, edge_order=2)
    turning = [ARM.mass(theta) @ rate for theta, rate in zip(found.coordinates[::25], rates[::25])]
    shoulder, elbow = np.array(turning).T
    # of the differences and of the step: 1e-6 of what the elbow has
    assert np.abs(elbow).max() > 0.05
    np.testing.assert_allclose(shoulder, 0.0, rtol=0, atol=1e-4 * np.abs(elbow).max())
    # the work is the torque's on the angle between the bars; trapezoidal rules over time and over the angle
    torque = np.interp(found.time, [0.0, 0.1], [0.0, 0.3])
    work = cumulative_trapezoid(torque, found.coordinates[:, 1], initial=0.0)
    np.testing.assert_allclose(found.balance.work["motor"], work, rtol=0, atol=3e-5 * work.max())


ELASTIC = (
    *WITHIN, "reduction.modes=5", "simulation.duration=0.2", "effects={}",
    'effects.motor={type="torque",joint="crank_hinge",table=[[0.0,0.0],[0.1,0.3],[1.0,0.3]]}',
)  # fmt: skip
FALLING = 'effects.gravity={type="gravity",acceleration=9.81,direction=[0.0,-1.0,0.0]}'


@pytest.mark.parametrize("effects", [(), (FALLING,)], ids=["motor", "motor and gravity"])
def test_the_balance_of_energy_holds(effects: tuple[str, ...]) -> None:
    scene = spatial.spatial_slider_crank(*ELASTIC, *effects)
    model = ReducedModel(scene, rom_of(scene))
    shares = []
    for step in (5e-4, 2.5e-4):
        finer = spatial.spatial_slider_crank(*ELASTIC, *effects, f"simulation.step={step}")
        balance = motion(model.with_loads(finer)).balance
        assert balance.exchanged > 0.1 and balance.strain.max() > 1e-6
        shares.append(np.abs(balance.residual).max() / balance.exchanged)
    # the crank reaches 25 rad/s in 0.2 s: measured 7.7e-5 and 1.9e-5, with gravity 3.4e-6 and 0.7e-6
    assert shares[0] < 1e-4
    assert np.log2(shares[0] / shares[1]) == pytest.approx(2.0, abs=0.3)


def test_energy_is_conserved_without_loads() -> None:
    """At spectral radius 1 the scheme does not dissipate: what is missing comes and goes, and falls with its order."""
    free = (
        "effects={}", "simulation.spectral_radius=1.0", *NO_STATIC, "reduction.angles=24",
        "simulation.initial.theta={position=0.5,velocity=6.0}",
    )  # fmt: skip
    scene = spatial.spatial_slider_crank(*free)
    model = ReducedModel(scene, rom_of(scene))
    changes = []
    for step, duration in ((5e-4, 1.0), (1e-3, 1.0), (1e-3, 2.0)):
        longer = spatial.spatial_slider_crank(*free, f"simulation.step={step}", f"simulation.duration={duration}")
        found = motion(model.with_loads(longer))
        balance = found.balance
        total = balance.kinetic + balance.strain
        # the bars vibrate from the start
        assert balance.strain.max() > 1e-5 * total[0]
        changes.append(np.abs(total - total[0]).max() / total[0])
    fine, coarser, longest = changes
    assert coarser < 2e-5  # measured 1.1e-5 in one revolution
    assert np.log2(coarser / fine) == pytest.approx(2.0, abs=0.3)
    # no drift: two revolutions change no more of it than one
    assert longest < 1.5 * coarser
    # the hinge's angle counts them, though directors do not; bent by the vibrations alone
    assert np.ptp(found.coordinates) > 4 * np.pi - 1.0
    np.testing.assert_allclose(found.outputs["crank_angle"], found.coordinates[:, 0], rtol=0, atol=1e-3)


def test_damping_within_the_bars_takes_energy_out() -> None:
    """Kelvin and Voigt, and modal ratios of the free bars, by a run that begins with a jolt."""
    jolted = (
        *ELASTIC, FALLING, *NO_STATIC, "reduction.angles=17",
        "coordinates.theta.range=[-0.4,1.2]", "simulation.duration=0.03", "simulation.step=5e-5",
        "simulation.spectral_radius=1.0",
    )  # fmt: skip
    rom = rom_of(spatial.spatial_slider_crank(*jolted))
    for damping in ("stiffness=2e-5", "ratios=[0.02,0.02,0.02,0.02]"):
        damped = spatial.spatial_slider_crank(*jolted, f'effects.damping={{type="structural_damping",{damping}}}')
        balance = motion(ReducedModel(damped, rom)).balance
        lost = -balance.work["damping"]
        assert np.all(np.diff(lost) > -1e-15) and lost[-1] > 1e-7
        # the scheme does not dissipate here, and what the trapezoidal rule leaves is small beside it
        assert np.abs(balance.residual).max() < 0.05 * lost[-1]
