"""Vibrations on springs: closed forms, dense pencils with stiffness from differences, preload, reduced models."""

from collections.abc import Sequence

import numpy as np
import pytest
import scipy.linalg
from mpi4py import MPI
from pencils import dense_of, matrices_of
from runs import ONE_RANK, full_model, history, rom_of
from scipy.optimize import brentq
from slopes import slopes
from spatial import slider_crank_in_space
from spatial_beams import pendulum_in_space, slider_crank_of_beams
from spring_measures import measure_of
from two_coordinates import double_pendulum

from pgmp_petsc.components.condensing import condensed
from pgmp_petsc.effects import actions_of, effects_of
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism, constraint_jacobian
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.modes.static_modes import VibrationProblem, frequencies_of
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.studies.modes_table import springs_of, tabulate_modes
from scenes import CRANK, RADIUS, ROD, SLIDER_CRANK, kinematics_of, meshes_of, pendulum, slider_crank

G = 9.80665
AREA = np.pi * RADIUS**2
LINE = 7800.0 * AREA  # kg/m
PLACES = (0.4, 1.1, 2.9)
SLIDER = 'effects.s={{type="spring_damper",points=["ground:far","rod:tip"],stiffness={0},rest={1}}}'
FAR = "ground.points.far=[-1.0,0.0]"  # behind the crank's hinge, on the line of the slider
STIFF = "materials.steel.E=210e15"  # rigid but for a share of 1e-6 of the frequencies
PRELOAD = "reduction.preload=true"
DOWN = 'effects.weight={type="gravity",direction=[0.0,-1.0,0.0]}'
GRAVITY = 'effects.weight={type="gravity"}'


def vibrations(scene: Scene, kinematics: RigidKinematics, theta: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the frequencies (n, n_modes) at configurations (n,) or (n, n_theta), Hz."""
    springs, _ = springs_of(scene, kinematics)
    with VibrationProblem(springs, scene.values, scene.reduction.modes, MPI.COMM_SELF) as problem:
        return frequencies_of(np.array([problem.eigenvalues(np.atleast_1d(at)) for at in theta]))


def dense(scene: Scene, kinematics: RigidKinematics, theta: float | np.ndarray) -> np.ndarray:
    """Return all frequencies of the dense pencil with the second differences of the springs' energy, Hz.

    The displacements of a node are put on its place and directors exactly, by rotation matrices; the energy is that of
    the springs' extensions, without force at the configuration.
    """
    mechanism = kinematics.mechanism
    poses = kinematics.poses(np.atleast_1d(theta))[..., 0]
    stiffness, mass = dense_of(mechanism, scene.values)
    stiffness += spring_stiffness(scene, kinematics, poses)
    clamped = [coordinate for coordinate in kinematics.coordinates if coordinate.prescribed]
    null = scipy.linalg.null_space(constraint_jacobian(mechanism, poses, clamped).toarray())
    values = scipy.linalg.eigvalsh(null.T @ stiffness @ null, null.T @ mass @ null)
    return np.sign(values) * np.sqrt(np.abs(values)) / (2 * np.pi)


def spring_stiffness(scene: Scene, kinematics: RigidKinematics, poses: np.ndarray) -> np.ndarray:
    """Return the springs' stiffness (n_dofs, n_dofs) at poses (n_bodies, n_pose), from differences of measures."""
    mechanism = kinematics.mechanism
    stiffness = np.zeros((mechanism.n_dofs, mechanism.n_dofs))
    for action in (a for a in actions_of(effects_of(scene, mechanism)) if a.stiffness):
        dofs, measure = measure_of(action, mechanism, poses)
        slope = slopes(measure, np.zeros(dofs.size), 1e-5)
        stiffness[np.ix_(dofs, dofs)] += action.parameters[0].at(scene.values) * np.outer(slope, slope)
    return stiffness


def rigid_slider_crank(theta: float) -> tuple[float, float, float]:
    """Return inertia (kg m2) and first and second derivative of the slider's place (m) of rigid uniform rods."""

    def place(t: float) -> float:
        return CRANK * np.cos(t) + np.sqrt(ROD**2 - (CRANK * np.sin(t)) ** 2)

    step = 1e-4
    first = (place(theta + step) - place(theta - step)) / (2 * step)
    second = (place(theta + step) - 2 * place(theta) + place(theta - step)) / step**2
    sin = CRANK * np.sin(theta) / ROD
    turning = -CRANK * np.cos(theta) / (ROD * np.sqrt(1 - sin**2))  # of the rod, a radian of the crank
    elbow = CRANK * np.array([-np.sin(theta), np.cos(theta)])
    centre = 0.5 * (elbow + [first, 0.0])
    m_crank, m_rod = LINE * CRANK, LINE * ROD
    return m_crank * CRANK**2 / 3 + m_rod * (centre @ centre + ROD**2 * turning**2 / 12), first, second


@pytest.mark.parametrize("loaded", [False, True])
@pytest.mark.parametrize("theta", PLACES)
def test_a_rigid_slider_crank_on_a_spring(theta: float, loaded: bool) -> None:
    scene = slider_crank(FAR, SLIDER.format(50.0, 1.5), STIFF, *((PRELOAD,) if loaded else ()))
    inertia, slope, curvature = rigid_slider_crank(theta)
    length = 1.0 + CRANK * np.cos(theta) + np.sqrt(ROD**2 - (CRANK * np.sin(theta)) ** 2)
    stiffness = 50.0 * slope**2 + loaded * 50.0 * (length - 1.5) * curvature
    exact = np.sign(stiffness) * np.sqrt(abs(stiffness) / inertia) / (2 * np.pi)
    # differences leave 1e-8, the bodies' elasticity and rotary inertia of the sections 1e-4
    assert vibrations(scene, kinematics_of(scene), [theta])[0, 0] == pytest.approx(exact, rel=2e-4)


def spring(stiffness: float, *far: float) -> tuple[str, ...]:
    """Return a spring from a point of the ground to the arm's tip."""
    ends = 'points=["ground:far","arm:tip"]'
    return f"ground.points.far={list(far)}", f'effects.s={{type="spring_damper",{ends},stiffness={stiffness},rest=0.4}}'


#: A pendulum, its spring and where that is fixed, the weight, and what is allowed: in space the hinge's axis is z, the
#: spring pulls the tip out of the plane of the motion too, and the section has rotary inertia.
SPRUNG = {
    "in the plane": (pendulum, 0.02, (1.0, 0.7), (), 1e-4),
    "in space": (pendulum_in_space, 30.0, (1.0, 0.7, 0.5), (DOWN,), 2e-4),
}  # fmt: skip


@pytest.mark.parametrize("name", SPRUNG)
def test_a_spring_across_a_pendulum_with_its_force(name: str) -> None:
    """A spring that is oblique to the bar: both its force's parts, of the statement and of the motion, count."""
    make, k, far, weight, share = SPRUNG[name]
    scene = make(*spring(k, *far), *weight, STIFF, PRELOAD)
    kinematics, step = kinematics_of(scene), 1e-4
    mechanism = kinematics.mechanism
    along = np.zeros(mechanism.n_dofs)
    mechanism.by_node(along)[:, 0] = 1.0
    whole = along @ matrices_of(mechanism, scene.values)[1] @ along

    def energy(t: float) -> float:
        away = np.array([np.cos(t), np.sin(t), 0.0])[: len(far)] - far
        return 0.5 * k * (np.linalg.norm(away) - 0.4) ** 2 + bool(weight) * whole * G * 0.5 * np.sin(t)

    for theta, frequency in zip((0.3, 1.0, 2.5), vibrations(scene, kinematics, (0.3, 1.0, 2.5))[:, 0]):
        stiffness = (energy(theta + step) - 2 * energy(theta) + energy(theta - step)) / step**2
        exact = np.sign(stiffness) * np.sqrt(abs(stiffness) / (whole / 3)) / (2 * np.pi)
        assert frequency == pytest.approx(exact, rel=share)


def test_a_pendulum_under_its_weight() -> None:
    """Hanging it swings with ``sqrt(3 g / 2 L)``; upright it falls at the same rate, and that is said."""
    scene = pendulum(GRAVITY, STIFF, PRELOAD)
    exact = np.sqrt(1.5 * G) / (2 * np.pi)
    found = vibrations(scene, kinematics_of(scene), [-0.5 * np.pi, 0.5 * np.pi, 0.3])[:, 0]
    np.testing.assert_allclose(found[:2], [exact, -exact], rtol=1e-5)
    assert found[2] == pytest.approx(-exact * np.sqrt(np.sin(0.3)), rel=1e-5)
    table = tabulate_modes(scene, meshes_of(scene), None, 4, ONE_RANK)
    assert any("unstable on its springs" in str(remark) for remark in table.record.remarks)
    assert any("loaded by weight" in str(remark) for remark in table.record.remarks)


@pytest.mark.parametrize("stiffness", [1e-2, 1.0, 1e4])
def test_a_beam_on_springs_at_both_ends(stiffness: float) -> None:
    """Hinged with a couple's spring c and held at its tip by a transverse spring k: Euler's beam in closed form."""
    couple = 0.3
    scene = pendulum(
        'bodies.arm.mesh="0.0:1.0:100"',
        f'effects.c={{type="spring_damper",joint="hinge",stiffness={couple}}}',
        'effects.k={type="bushing",points=["ground:end","arm:tip"],reference=[[1.0,0.0]],'
        f"stiffness=[0.0,{stiffness}]}}",
        "ground.points.end=[1.0,0.0]",
        "bodies.arm.section.radius=2e-3",
        "reduction.modes=3",
    )
    bending, line = 210e9 * np.pi * 2e-3**4 / 4, 7800.0 * np.pi * 2e-3**2

    def determinant(beta: float) -> float:
        c, s, ch, sh = np.cos(beta), np.sin(beta), np.cosh(beta), np.sinh(beta)
        # w = A cos + B sin + C cosh + D sinh of beta x: w(0) = 0, EI w'' = c w' at 0, w'' = 0 and EI w''' = k w at 1
        rows = [
            [1.0, 0.0, 1.0, 0.0], [-bending * beta**2, -couple * beta, bending * beta**2, -couple * beta],
            [-c, -s, ch, sh],
            [bending * beta**3 * s - stiffness * c, -bending * beta**3 * c - stiffness * s,
             bending * beta**3 * sh - stiffness * ch, bending * beta**3 * ch - stiffness * sh],
        ]  # fmt: skip
        sizes = np.array([1.0, bending * beta, ch, bending * beta**3 * ch])
        return float(np.linalg.det(np.array(rows) / sizes[:, None]))

    grid = np.linspace(0.05, 12.0, 4000)
    signs = np.sign([determinant(beta) for beta in grid])
    roots = [brentq(determinant, grid[k], grid[k + 1]) for k in np.flatnonzero(signs[1:] != signs[:-1])][:3]
    exact = np.array(roots) ** 2 * np.sqrt(bending / line) / (2 * np.pi)
    # the mesh leaves (beta h)^2 / 12 or so, shear and rotary inertia (beta r)^2
    np.testing.assert_allclose(vibrations(scene, kinematics_of(scene), [0.0])[0], exact, rtol=2e-3)


BUSHING = (
    'effects.b={type="bushing",points=["ground:post","crank:tip"],reference=[[1.0,0.4]],'
    "stiffness=[2e4,5e3],turning_stiffness=[40.0]}"
)
RIGID_CRANK = (
    "ground.points.post=[0.2,0.1]", "bodies.crank.flexible=false", "parameters={}",
    "bodies.crank.section.radius=5.6e-3",
)  # fmt: skip
SPATIAL = (
    "ground.points.far=[-1.0,0.3,0.2]",
    'effects.s={type="spring_damper",points=["ground:far","rod:tip"],stiffness=3e4,rest=1.0}',
    'effects.b={type="bushing",points=["crank:hinge","rod:hinge"],reference=[[1.0,0.0,0.0],[0.0,1.0,0.0]],'
    "stiffness=[1e3,2e3,3e3],turning_stiffness=[5.0,6.0,7.0]}",
    'effects.t={type="spring_damper",joint="elbow",stiffness=11.0}',
)


def solids(scene: Scene) -> RigidKinematics:
    return RigidKinematics(Mechanism.from_scene(scene, condensed(scene, meshes_of(scene), ONE_RANK)))


DRIVE = 'effects.d={type="prescribed_motion",coordinate="theta",constant_speed={speed=1.0}}'
ON_ELBOW = 'effects.t={type="spring_damper",joint="elbow",stiffness=2.0}'
#: Scene, kinematics, configurations, and how many rigid motions are free of the springs and left out.
PENCILS = {
    "bushing and rigid crank": (lambda: slider_crank(BUSHING, *RIGID_CRANK), kinematics_of, PLACES, 0),
    "beams in space": (lambda: slider_crank_of_beams(*SPATIAL), kinematics_of, PLACES, 0),
    "condensed solids": (lambda: slider_crank_in_space(*SPATIAL), solids, PLACES, 0),
    "two coordinates, one on a spring": (
        lambda: double_pendulum(ON_ELBOW, "reduction.modes=4"), kinematics_of, np.array([[0.3, 0.5], [1.0, -0.7]]), 1,
    ),
    **{
        f"in the plane, {k} N/m": (lambda k=k: slider_crank(FAR, SLIDER.format(k, 1.0)), kinematics_of, PLACES, 0)
        for k in (10.0, 1e3, 1e5, 1e7, -1e3)
    },
    # no rigid motion is left, and the spring holds the bent bodies alone
    "driven": (lambda: slider_crank("effects={}", FAR, SLIDER.format(1e5, 1.0), DRIVE), kinematics_of, PLACES, 0),
}  # fmt: skip


@pytest.mark.parametrize("name", PENCILS)
def test_the_dense_pencil(name: str) -> None:
    make, kinematics_for, places, left_out = PENCILS[name]
    scene = make()
    kinematics = kinematics_for(scene)
    for theta, found in zip(places, vibrations(scene, kinematics, places)):
        expected = dense(scene, kinematics, theta)[left_out:]
        # the dense solver's round-off is that of its largest eigenvalue: up to 1e-4 of the softest spring's frequency
        round_off = 4.0 * np.finfo(float).eps * expected[-1] ** 2
        squares = (expected * abs(expected))[: found.size]
        np.testing.assert_allclose(found * abs(found), squares, rtol=2e-6, atol=round_off)


def test_a_dead_centre_has_the_frequency_zero() -> None:
    scene = slider_crank(FAR, SLIDER.format(1e4, 1.0))
    assert vibrations(scene, kinematics_of(scene), [0.0])[0, 0] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("preload", [False, True])
def test_reduced_frequencies_for_any_value_of_the_stiffness(preload: bool) -> None:
    """The stiffness is a parameter; the basis of the nominal one holds for a hundredth and for a hundred times it."""
    # what the preload does by the curvature of the rigid motion acts as the motor's couple does
    given = (
        FAR, SLIDER.format('"k"', 1.4), "parameters.k={nominal=1e3}", 'reduction.interpolation="spectral"',
        f"reduction.preload={str(preload).lower()}", f"reduction.static_modes={str(preload).lower()}",
    )  # fmt: skip
    rom = rom_of(slider_crank(*given))
    # with more than some 400 N of preload the bodies would have buckled
    for stiffness in (1e1, 1e3) if preload else (1e2, 1e4, 1e6):
        scene = scene_from_toml(SLIDER_CRANK, ".", given, (f"k={stiffness}",))
        table = tabulate_modes(scene, meshes_of(scene), rom, 24, ONE_RANK)
        full, reduced = table.full_hz, table.reduced_hz[:, :5]
        assert full.shape == (24, 5)
        some = np.abs(full[:, 0]) > 1e-3 * np.abs(full[:, 0]).max()  # but for dead centres
        np.testing.assert_allclose(reduced[some, :3], full[some, :3], rtol=1e-6)


def test_without_its_answer_the_basis_says_so() -> None:
    scene = slider_crank(FAR, SLIDER.format(1e5, 1.0), "reduction.spring_modes=false")
    rom = rom_of(scene)
    assert rom.tables.n_modes == 5
    assert any("reduction.spring_modes = false" in str(remark) for remark in rom.record.remarks)
    with_answer = rom_of(slider_crank(FAR, SLIDER.format(1e5, 1.0)))
    assert with_answer.tables.n_modes == 6
    errors = []
    for model in (rom, with_answer):
        table = tabulate_modes(scene, meshes_of(scene), model, 24, ONE_RANK)
        errors.append(np.max(np.abs(table.reduced_hz[1:12, 1] / table.full_hz[1:12, 1] - 1)))
    assert errors[0] > 1e-4 > 1e-7 > errors[1]


def test_what_is_left_out_is_said() -> None:
    scene = slider_crank(
        FAR, SLIDER.format(1e3, 1.0), 'effects.stop={type="end_stop",joint="elbow",upper=3.0,stiffness=10.0}',
        'effects.rub={type="joint_friction",joint="elbow",limit=0.1,speed=0.1}',
        'effects.oil={type="joint_damping",joint="elbow",coefficient=0.1}',
    )  # fmt: skip
    table = tabulate_modes(scene, meshes_of(scene), None, 4, ONE_RANK)
    said = " ".join(map(str, table.record.remarks))
    assert "linear springs in the stiffness: s" in said
    for name, why in (("stop", "one-sided"), ("rub", "friction"), ("oil", "damper")):
        assert f"effects.{name} is not in the stiffness: it is" in said and why in said


@pytest.mark.parametrize(("stiffness", "gain"), [(2e3, 1.5), (1e6, 10.0)])
def test_runs_with_the_answer_are_closer_to_the_full_order_model(stiffness: float, gain: float) -> None:
    """A couple of 0.1 Nm on the crank against a spring at the slider that is without force at first.

    Measured: 2.8e-5, 5.4e-4 and 0.11 without the answer, 4.8e-6, 4.7e-5 and 7.0e-4 with it beside the same modes.
    """
    length = 1.0 + CRANK * np.cos(1.0) + np.sqrt(ROD**2 - (CRANK * np.sin(1.0)) ** 2)
    given = (
        FAR, SLIDER.format(stiffness, length), "effects.motor.table=[[0.0,0.0],[0.002,0.1]]",
        "simulation={duration=0.05,step=1e-4,spectral_radius=0.8,initial={theta={position=1.0}}}",
        'outputs.place={type="position",point="rod:tip",axis="x"}', "reduction.angles=64",
        'reduction.interpolation="spline"',
    )  # fmt: skip
    values = {"r1": np.array([RADIUS])}
    scene = slider_crank(*given)
    full = history(full_model(scene), values, 1)[1]["place"].ravel()
    errors = []
    for basis in (("reduction.spring_modes=false",), (), ("reduction.modes=4",)):
        scene = slider_crank(*given, *basis)
        found = history(ReducedModel(scene, rom_of(scene)), values, 1)[1]["place"].ravel()
        errors.append(np.max(np.abs(found - full)) / np.ptp(full))
    assert max(errors[1:]) < errors[0] / gain, errors
