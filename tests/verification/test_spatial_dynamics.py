"""Full-order models in space: bars by Lagrange's equations, against reduced models, balances of energy."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
import pytest
import spatial
from alike import assert_order, balances, orders, shares_left
from equations import load_vectors
from mpi4py import MPI
from numpy.polynomial import Chebyshev
from runs import assert_close, full_model, motion, rom_of
from scipy.integrate import cumulative_trapezoid, solve_ivp
from scipy.spatial.transform import Rotation
from slopes import slopes
from spatial import WIDTH, arm, part_of_arm, slider_crank_in_space, spatial_slider_crank

from pgmp_petsc.effects import effects_of, motions_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism, Unknowns
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.results import Trajectory
from pgmp_petsc.scene import Scene
from scenes import slider_crank

GRAVITY = 9.81
Place = tuple[np.ndarray, np.ndarray]  # rotation (3, 3) and origin (3,)
RANGE = [-0.8, 2.6]  # rad of the crank


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
        if n == 1:  # its mass by a polynomial, to the 1e-8 of the derivatives that it is made of
            mass = Chebyshev.interpolate(lambda every: [self.mass(np.array([at]))[0, 0] for at in every], 80, RANGE)
            slope = mass.deriv()

        def rates_of_one(time: float, state: np.ndarray) -> np.ndarray:
            theta, speed = state[:1], state[1:]
            return np.concatenate([speed, (forces(time, theta) - 0.5 * slope(theta) * speed**2) / mass(theta)])

        def rates(time: float, state: np.ndarray) -> np.ndarray:
            theta, speed = state[:n], state[n:]
            changes = derivative(lambda at: self.mass(at).ravel(), theta).reshape(n, n, n)
            carried = np.einsum("kij,k,j->i", changes, speed, speed)
            carried -= 0.5 * np.einsum("kij,i,j->k", changes, speed, speed)
            return np.concatenate([speed, np.linalg.solve(self.mass(theta), forces(time, theta) - carried)])

        found = rates_of_one if n == 1 else rates
        solved = solve_ivp(found, (times[0], times[-1]), start, "DOP853", times, rtol=1e-8, atol=1e-10)
        return solved.y[:n].T


def derivative(function: Callable[[np.ndarray], np.ndarray], theta: np.ndarray) -> np.ndarray:
    """Return the derivatives of a function (m,) in the coordinates, shape (n_theta, m), to 1e-8."""
    return slopes(function, theta, 5e-3, order=4).T


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
    upper = Rotation.from_rotvec([0.0, 0.0, theta[0]]).as_matrix()
    lower = upper @ Rotation.from_rotvec(theta[1] * spatial.SECOND_AXIS).as_matrix()
    return [(upper, np.zeros(3)), (lower, spatial.UPPER * upper[:, 0])]


ARM = RigidBars((spatial.UPPER, spatial.LOWER), arm_places)
NO_STATIC = ("reduction.static_modes=false", "reduction.inertia_modes=false")
STIFF = ("materials.steel.E=2.1e14", "reduction.modes=2", *NO_STATIC)
# a part of the revolution, in which the runs stay
WITHIN = (
    f"coordinates.theta.range={RANGE}", "coordinates.theta.periodic=false", "reduction.angles=33",
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
    return spatial.spatial_slider_crank(*EFFECTS, "parameters.E1={nominal=2.1e14}", *STIFF, *WITHIN, *overrides)


@lru_cache(maxsize=1)
def stiff_model() -> tuple[ReducedOrderModel, RigidKinematics]:
    scene = stiff_scene()
    return (rom := rom_of(scene)), RigidKinematics(Mechanism.from_scene(scene, rom.meshes))


def run_stiff(*overrides: str) -> Trajectory:
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
    "nothing": ((), nothing, 0.3, 6.0), "force on the crank": ((PULL,), of_pull, 0.0, 0.0),
    "torque, gravity and a force on the slider": ((MOTOR, WEIGHT, PUSH), of_all, 0.4, 3.0),
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
    if WEIGHT in effects:
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

    with_mass, start = WithMass(SPATIAL.lengths, spatial_places), np.zeros(1)
    assert with_mass.mass(start)[0, 0] > 1.5 * SPATIAL.mass(start)[0, 0]
    expected = with_mass.motion(found.time, np.zeros(2), of_motor)
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
    *part_of_arm(1.1),
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
    return motion(ReducedModel(spatial.arm(*ARM_STIFF, *overrides), *stiff_arm()))


def of_both(time: float, theta: np.ndarray) -> np.ndarray:
    weight = derivative(lambda at: np.array([ARM.weight(at, (0.0, -0.6, 0.8))]), theta)[:, 0]
    return np.array([0.0, np.interp(time, [0.0, 0.1], [0.0, 0.3])]) - weight


ARM_LOADS = {
    "nothing": ((), lambda time, theta: np.zeros(2), (0.8, -2.0)),
    "torque and gravity": ((ELBOW, "parameters.g.value=9.81", "simulation.duration=0.15"), of_both, (0.0, 0.0)),
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


def test_the_balance_of_energy_holds() -> None:
    found = balances("reduced", lambda step: spatial_slider_crank(*ELASTIC, FALLING, step), 5e-4, 2.5e-4)
    assert all(balance.exchanged > 0.1 and balance.strain.max() > 1e-6 for balance in found)
    shares = shares_left(found)
    # the crank reaches 25 rad/s in 0.2 s: measured 3.4e-6 and 0.7e-6
    assert shares[0] < 1e-5
    assert_order(shares, within=0.3)


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


TORQUE = 'effects.motor={type="torque", joint="crank_hinge", table=[[0.0, 0.0], [0.05, 2.0], [1.0, 2.0]]}'
HEAVY = 'effects.weight={type="gravity", direction=[0.0, -1.0, 0.3]}'
DRIVEN = 'effects.motor={type="prescribed_motion", coordinate="theta", spin_up={speed=25.0, time=0.2}}'
ACCURATE = (
    "reduction.angles=48", "reduction.static_modes=true", "reduction.inertia_modes=true",
    'reduction.interpolation="spline"',
)  # fmt: skip


def outputs(joint: str, point: str, axis: str) -> str:
    parts = {
        "angle": f'{{type="angle", joint="{joint}"}}',
        "position": f'{{type="position", point="{point}", axis="x"}}',
        "deformation": f'{{type="deformation", point="{point}", axis="{axis}"}}',
    }
    return f"outputs={{{', '.join(f'{name}={entry}' for name, entry in parts.items())}}}"


LIMITED = tuple(
    f"coordinates.{name}.{entry}" for name in ("theta1", "theta2") for entry in ("range=[-0.4, 0.4]", "periodic=false")
)
SLIDER = outputs("crank_hinge", "rod:tip", "x")


def over(duration: float, step: float = 1e-3) -> tuple[str, str]:
    return f"simulation.duration={duration}", f"simulation.step={step}"


@pytest.mark.parametrize(
    ("scene", "limits"),
    [
        # measured: 2.9e-5, 1.5e-7, 0.5 %; of the spatial one 3.8e-5, 6e-7, 0.1 %; of the arm 2.7e-4, 4e-6, 7 %
        (lambda: slider_crank_in_space(*over(0.1), TORQUE, SLIDER, *ACCURATE), (1e-4, 1e-6, 0.02)),
        (lambda: spatial_slider_crank(*over(0.05), outputs("crank_hinge", "slider:tip", "x")), (1e-4, 2e-6, 0.01)),
        (
            lambda: spatial_slider_crank(
                *over(0.05), "bodies.slider.flexible=false", outputs("crank_hinge", "slider:tip", "x")
            ),
            (1e-4, 2e-6, 0.01),
        ),
        (
            lambda: arm(*over(0.06), HEAVY, *LIMITED, "reduction.angles=5", "reduction.static_modes=true",
                        'reduction.interpolation="spline"', outputs("shoulder", "lower:tip", "y")),
            (1e-3, 3e-5, 0.15),
        ),
    ],
    ids=["slider-crank", "spatial slider-crank", "with a rigid slider", "arm with two coordinates"],
)  # fmt: skip
@pytest.mark.usefixtures("coarse")
def test_the_reduced_run_is_that_of_the_full_order_model(
    scene: Callable[[], Scene], limits: tuple[float, float, float]
) -> None:
    made = scene()
    full, reduced = (motion(kind, made) for kind in ("full", "reduced"))
    assert_close(full.outputs, reduced.outputs, **dict(zip(full.outputs, limits)))
    # the full-order coordinates are measured at the joints' frames, the reduced ones are those of rigid motion
    np.testing.assert_allclose(full.outputs["angle"], full.coordinates[:, 0], atol=1e-12)


RAMP = "table=[[0.0, 0.0], [0.05, 5.0], [1.0, 5.0]]"
ACTING = (
    f"effects={{pull={{type='force', point='rod:tip', direction=[1.0, 0.0, 1.0], {RAMP}}},"
    f"push={{type='force', point='crank:tip', direction=[0.0, 0.0, 1.0], {RAMP}}},"
    "knob={type='point_mass', point='rod:tip', mass=0.2, inertia=1e-4},"
    "friction={type='structural_damping', stiffness=1e-4, mass=2.0},"
    "motor={type='torque', joint='crank_hinge', table=[[0.0, 0.0], [0.05, 2.0], [1.0, 2.0]]}}"
)


def test_effects_together() -> None:
    """Forces across the plane and on the guided point, a point mass with inertia, both dampings and a torque; balance
    within the step's error."""
    made = slider_crank_in_space(*over(0.07), ACTING, outputs("crank_hinge", "crank:tip", "z"), *ACCURATE)
    full, reduced = (motion(kind, made) for kind in ("full", "reduced"))
    assert_close(full.outputs, reduced.outputs, angle=3e-4, position=5e-6, deformation=0.05)
    assert np.abs(full.balance.residual).max() < 1e-3 * full.balance.exchanged


def test_a_planar_mechanism_moves_in_space_as_beams_do_in_the_plane() -> None:
    """Quadratic elements six times as long as wide against beams of the same square section."""
    square = f'section={{shape="rectangle", width={WIDTH}, height={WIDTH}}}'
    bodies = [
        f'bodies.{name}={{mesh="{mesh}", element="beam2d", material="steel", {square}}}'
        for name, mesh in (("crank", "0.0:0.3:20"), ("rod", "0.3:1.0:20"))
    ]
    torque = TORQUE.partition("=")[2]
    plane = slider_crank(
        "parameters={}", *bodies, *over(0.08), f"effects={{motor={torque}}}", SLIDER, "reduction.parameter_modes=0"
    )
    expected = motion("full", plane)
    finer = ('bodies.crank.mesh="0.0:0.3:5"', 'bodies.rod.mesh="0.3:1.0:9"')
    found = motion("full", slider_crank_in_space(*over(0.08), TORQUE, SLIDER, *finer))
    assert_close(expected.outputs, found.outputs, angle=1e-3, position=1e-4, deformation=0.03)


def test_energy_is_balanced_with_the_square_of_the_step() -> None:
    short = "simulation.duration=0.01", "simulation.spectral_radius=0.99"
    shares = shares_left(balances("full", lambda step: spatial_slider_crank(*short, step), 1e-3, 5e-4, 2.5e-4))
    assert np.all(orders(shares) > 1.7), shares


def test_a_prescribed_coordinate_turns_as_prescribed_and_counts_its_turns() -> None:
    made = slider_crank_in_space(*over(0.4, 4e-3), f"effects={{{DRIVEN[8:]}}}", SLIDER)
    run = motion("full", made)
    (driven,) = motions_of(made, full_model(made).kinematics.mechanism).values()
    expected = np.array([driven.at(t)[0] for t in run.time])
    assert expected[-1] > 2 * np.pi
    # the constraint is met at every step, to the Newton iteration's tolerance
    np.testing.assert_allclose(run.coordinates[:, 0], expected, atol=1e-8)
    np.testing.assert_allclose(run.outputs["angle"], expected, atol=1e-8)
    reach = 0.3 * np.cos(expected) + np.sqrt(0.7**2 - (0.3 * np.sin(expected)) ** 2)
    # the slender bars bend by 3 mm
    np.testing.assert_allclose(run.outputs["position"], reach, atol=4e-3)
    assert np.abs(run.balance.residual).max() < 1e-2 * run.balance.exchanged


def test_effects_find_their_vectors() -> None:
    """The weight is that of the whole mass, whatever it is spread over; its work is that of the fall of the centre of
    mass."""
    made = spatial_slider_crank()
    model = full_model(made)
    with model.distributed(made.values, MPI.COMM_SELF) as system:
        unknowns = Unknowns(model.kinematics.mechanism)
        vectors = load_vectors(system._equations)  # noqa: SLF001
        up = np.zeros(unknowns.n_dofs)
        unknowns.frames(up)[:, 1] = 1.0
        up[unknowns.frames(up).size :].reshape(-1, 3)[:, 1] = 1.0
        volume = (0.1 + 0.3 + 0.05) * WIDTH**2
        assert vectors["gravity"] @ up == pytest.approx(-7800.0 * 9.81 * volume, rel=1e-12)
    assert {effect.name for effect in effects_of(made, model.kinematics.mechanism)} == {"motor", "gravity"}
