"""Joints that couple motions, rigid and elastic: closed forms, other integrators, all models; ratios, radii and leads
as parameters."""

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import exported
import numpy as np
import pytest
from alike import assert_alike, assert_order
from coupled_scenes import CAM, CAM_TABLE, GEARED, RACK, ROTORS, ROTORS_IN_SPACE, ROW_IN_SPACE, SCREW, SHAFTS, SPINDLES
from differences import compare, differences
from exported import assert_equal, compiled, needs_compiler, outputs_of
from machine_scenes import MODELS, errors_of, run
from mpi4py import MPI
from pencils import modal_problem
from refusals import cases, check_said, refusal
from runs import assert_close, history, motion, reduced_model, rom_of, samples
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh
from scipy.optimize import brentq

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bench.reference import component_model
from pgmp_petsc.estimates.own_error import why_not_of_full_order
from pgmp_petsc.gradients.differentiated import differentiate
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.mechanism.kinematics import JointTurns, RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import ReducedModel, SeparateLengths, of_samples
from pgmp_petsc.modes.static_modes import VibrationProblem, frequencies_of
from pgmp_petsc.reduction import tables as tables_of_reduction
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.studies.inputs import with_meshes
from pgmp_petsc.studies.modes_table import reduced_vibrations, springs_of
from pgmp_petsc.studies.plausibility import plausibility
from scenes import HEADER, kinematics_of, meshes_of, of_text, tables

RATIO = -0.37


def swing(t: np.ndarray, r: float) -> np.ndarray:
    """Return the angle of the pinion on a rack that a spring holds."""
    rate = np.sqrt(200.0 * r**2 / (0.02 + 3.0 * r**2))
    return 40.0 / rate * np.sin(rate * t)


TURNS = 2.0 * np.pi / 0.5  # of a screw over 1 m
BOTH = 0.5 * 0.7 / (0.02 + RATIO**2 * 0.5)  # T = (I_1 + r^2 I_2) phi''
ROW = 0.5 * 3.5 / (0.02 + RATIO**2 * (0.5 + 1.7**2 * 0.9))
#: A scene, steps, the coordinate and its motion, what is tied to it and how, how closely, and the models for which the
#: scheme is exact: in the plane and in joint coordinates accelerations of an angle are constant, and of no director.
#: Then how large the error is with the smaller step, as a share of the motion.
COUPLED_MOTIONS = {
    "gear": (ROTORS, (4e-3, 2e-3), "one", lambda t: BOTH * t**2,
             lambda found: found["two"] - 0.4 - RATIO * found["one"], 1e-8, ("full", "components"), 1e-4),
    "gear in space": (ROTORS_IN_SPACE, (4e-3, 2e-3), "one", lambda t: BOTH * t**2,
                      lambda found: found["two"] - RATIO * found["one"], 1e-8, ("components",), 1e-4),
    "gears in a row in space": (ROW_IN_SPACE, (4e-3, 2e-3), "one", lambda t: ROW * t**2,
                                lambda found: found["three"] + 1.7 * found["two"], 1e-8, ("components",), 1e-4),
    # (rate step)^2 / 12 of rate times duration, 1e-4 of 9.4 rad
    "rack": (RACK, (2e-3, 1e-3), "phi", lambda t: swing(t, 0.05),
             lambda found: found["x"] - 0.05 * found["phi"], 1e-9, (), 1e-4 / 9.4),
    # F = (m + I (2 pi / lead)^2) x''
    "screw": (SCREW, (4e-3, 2e-3), "x", lambda t: 2.0 / (3.0 + 0.02 * TURNS**2) * t**2,
              lambda found: found["phi"] - TURNS * found["x"], 1e-8, ("components",), 2e-4),
}  # fmt: skip


@pytest.mark.parametrize("model", ["full", "components"])
@pytest.mark.parametrize("name", COUPLED_MOTIONS)
def test_coupled_bodies_move_as_one_with_both_inertias(name: str, model: str) -> None:
    """Over several turns, from the placements on."""
    text, steps, output, motion_of, left, closely, even, bound = COUPLED_MOTIONS[name]
    errors = []
    for step in steps:
        times, found = run(scene_from_toml(text, ".", [f"simulation.step={step}"]), model)
        exact = motion_of(times)
        assert np.abs(exact).max() * (TURNS if name == "screw" else 1.0) > (2.0 if name == "rack" else 4.0) * np.pi
        np.testing.assert_allclose(left(found), 0.0, rtol=0, atol=closely)  # what Newton's method leaves
        errors.append(np.abs(found[output] - exact).max() / np.abs(exact).max())
    if model in even:
        assert max(errors) < 1e-7
    else:
        assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.3) and errors[1] < bound


@pytest.mark.parametrize("model", ["full", "components"])
@pytest.mark.parametrize("crossed", [False, True])
@pytest.mark.parametrize("text", [ROTORS, ROTORS_IN_SPACE], ids=["plane", "space"])
def test_a_belt_makes_one_of_two_rotors_with_both_inertias(text: str, crossed: bool, model: str) -> None:
    """``T = (I_1 + (r_1 / r_2)^2 I_2) phi''``, of rotors that turn the same way or against one another."""
    belt = f"joints.mesh={{type='belt',joints=['input','output'],radii=[0.02,0.05],crossed={str(crossed).lower()}}}"
    across = ("joints.output.axis=[0.0,0.0,1.0]",) if text is ROTORS_IN_SPACE else ()
    inertia = 0.7 if across else 0.5  # of the second rotor about the axis
    times, found = run(scene_from_toml(text, ".", (belt, *across, "simulation.duration=1.0")), model)
    exact = 0.5 * 0.7 / (0.02 + 0.4**2 * inertia) * times**2
    # what steps of 2 ms leave of directors in space (the test above has the order), and nothing in the plane
    np.testing.assert_allclose(found["one"], exact, rtol=0, atol=(1e-4 if across else 1e-7) * exact[-1])
    placed = 0.4 if text is ROTORS else 0.0
    np.testing.assert_allclose(found["two"] - placed, (-0.4 if crossed else 0.4) * found["one"], rtol=0, atol=1e-8)


CROSSED = "radii=[0.003,0.003],crossed=true"


@pytest.mark.parametrize(("model", "over"), [*((model, CROSSED) for model in MODELS), ("full", "ratio=-1")])
def test_a_crossed_belt_over_equal_pulleys_is_a_gear(model: str, over: str) -> None:
    """On flexible cranks, in every model."""
    short = ("simulation.duration=0.05", "reduction.angles=24", "reduction.second_order=false")
    belt = f"joints.mesh={{type='belt',joints=['input','output'],{over}}}"
    gear, found = (run(scene_from_toml(GEARED, ".", own), model)[1] for own in (short, (*short, belt)))
    assert_alike(gear, found, 1e-9)


@pytest.mark.parametrize("text, masses", zip(SPINDLES, ([3.0], [5.0, 1.0])), ids=["one", "two"])
def test_spindles_of_a_fine_lead_turn_often(text: str, masses: list[float]) -> None:
    """T k = (m + I k^2) x'', k = 2 pi / lead: tens of turns from where bodies are placed to the ends of the range."""
    times, found = run(scene_from_toml(text, ".", ["simulation.initial={x={position=0.007}}"]), "components")
    turns = 2.0 * np.pi / 0.01
    for name, torque, mass in zip("xy", (0.5, -0.3), masses):
        exact = 0.5 * torque * turns / (mass + 1e-4 * turns**2) * times**2 + 0.007 * (name == "x")
        # the scheme is exact for coordinates that turn and slide evenly
        np.testing.assert_allclose(found[name], exact, rtol=0, atol=1e-7 * np.abs(exact).max())


@pytest.mark.parametrize("model", ["full", "components"])
def test_a_nut_placed_whole_turns_along_its_spindle_has_the_force_of_one_at_the_end(model: str) -> None:
    """Of stiffness 1e5 N/m its force was off by 5e4 N, a lead times that, from half a lead on; a rigid one was closed
    whole turns away."""
    force = 'outputs.f={type="joint_force",joint="thread",component="axial",of="first"}'
    for way in ("elastic={stiffness=1e5}", None):
        gives = (f"joints.thread.{way}",) if way else ()
        found = [
            run(scene_from_toml(SCREW, ".", (
                f"bodies.nut.placement={{origin=[0.0,0.0,{z}]}}", f"simulation.initial.x.position={z}",
                "simulation.duration=0.5", force, *gives,
            )), model)[1]
            for z in (0.0, 0.4)
        ]  # fmt: skip
        np.testing.assert_allclose(found[1]["x"] - 0.4, found[0]["x"], rtol=0, atol=1e-9)
        np.testing.assert_allclose(found[1]["f"], found[0]["f"], rtol=0, atol=1e-6 * np.abs(found[0]["f"]).max())
        assert 0.1 < np.abs(found[0]["f"]).max() < 10.0


def test_a_motor_turns_a_thousand_times_as_far_as_the_coordinate() -> None:
    """What of the coordinate's own row the gear leaves is one thousandth, and no singular position."""
    scene = scene_from_toml(ROTORS_IN_SPACE, ".", ["joints.mesh.ratio=1000.0", "coordinates.phi.range=[-0.1, 0.3]"])
    kinematics, phi = kinematics_of(scene), np.array([[-0.0703], [0.2501]])
    turned = kinematics.poses(phi)[1, 3:].reshape(3, 3, 2)
    np.testing.assert_allclose(turned[1, 1], np.cos(1000.0 * phi[:, 0]), rtol=0, atol=1e-9)
    np.testing.assert_allclose(turned[1, 2], np.sin(1000.0 * phi[:, 0]), rtol=0, atol=1e-9)


LIFT = CubicSpline(*np.array(CAM_TABLE).T, bc_type="periodic")


@cache
def turned_by_cam(end: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return what gives angle and speed of a cam up to an end, s: (I + m f'^2) phi'' + m f' f'' phi'^2 + k f f' = 0."""

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        f, slope, bend = (LIFT(y[0], k) for k in range(3))
        return np.array([y[1], -(2.0 * slope * bend * y[1] ** 2 + 300.0 * f * slope) / (0.02 + 2.0 * slope**2)])

    return solve_ivp(rates, (0.0, end), (0.3, 20.0), "DOP853", rtol=1e-11, atol=1e-12, dense_output=True).sol


@pytest.mark.parametrize("model", ["full", "components"])
def test_a_cam_lifts_its_follower(model: str) -> None:
    def exact(times: np.ndarray) -> dict[str, np.ndarray]:
        turned = turned_by_cam(round(times[-1], 9))(times)[0]
        assert np.ptp(turned) > 2.0 * np.pi
        return {"phi": turned, "x": LIFT(turned)}

    errors = errors_of(of_text(CAM), model, exact, 2e-3, 1e-3)
    # where pieces of the spline meet, accelerations have a kink
    np.testing.assert_allclose(errors[0] / errors[1], 4.0, atol=0.6)
    assert np.all(errors[1] < [1e-3, 5e-5])


# a motor drives a camshaft by gears, and that a disc; a servo with limits holds the motor's speed
BETWEEN_GEARS = HEADER + tables(f"""
ground.points: shaft = [0.2, 0.0]; end = [0.4, 0.0]; rail = [0.2, 0.1]
bodies.motor.rigid: mass = 1.0; inertia = 1.5e-3; points = {{ hub = [0.0, 0.0] }}
bodies.camshaft: rigid = {{ mass = 2.0, inertia = 4e-3, points = {{ hub = [0.0, 0.0] }} }};
    placement = {{ origin = [0.2, 0.0], angle = 0.0 }}
bodies.disc: rigid = {{ mass = 1.0, inertia = 2e-3, points = {{ hub = [0.0, 0.0] }} }};
    placement = {{ origin = [0.4, 0.0], angle = 0.0 }}
bodies.follower: rigid = {{ mass = 0.8, inertia = 1e-4, points = {{ foot = [0.0, 0.0] }} }};
    placement = {{ origin = [0.2, 0.1], angle = 0.0 }}
joints.motor: type = "revolute"; connect = ["ground:origin", "motor:hub"]
joints.shaft: type = "revolute"; connect = ["ground:shaft", "camshaft:hub"]
joints.end: type = "revolute"; connect = ["ground:end", "disc:hub"]
joints.rail: type = "prismatic"; connect = ["ground:rail", "follower:foot"]; axis = [0.0, 1.0]
joints.first: type = "gear"; joints = ["motor", "shaft"]; ratio = -0.5
joints.cam: type = "cam"; joints = ["shaft", "rail"]; table = {CAM_TABLE}
joints.last: type = "gear"; joints = ["shaft", "end"]; ratio = 3.0
coordinates.phi: joint = "shaft"; range = [0.0, 6.283185307179586]; periodic = true
effects.weight: type = "gravity"; acceleration = 9.81
effects.spring: type = "law"; joint = "rail"; force = "-300.0 * s"
effects.load: type = "joint_damping"; joint = "end"; coefficient = 0.01
controllers.speed: type = "pid"; measures = "speed"; joint = "motor"; limits = [-3.0, 3.0];
    reference = {{ table = [[0.0, 0.0], [0.2, -40.0]] }}; gains = {{ p = 0.5, i = 6.0 }}
simulation: duration = 0.4; step = 1e-3
outputs.phi: type = "angle"; joint = "shaft"
outputs.speed: type = "speed"; joint = "motor"
outputs.x: type = "position"; point = "follower:foot"; axis = "y"
outputs.lifting: type = "joint_force"; joint = "cam"; component = "axial"
outputs.turning: type = "joint_torque"; joint = "cam"; component = "axial"; of = "first"
outputs.first: type = "joint_torque"; joint = "first"; component = "axial"
outputs.last: type = "joint_torque"; joint = "last"; component = "axial"
""")


def between_gears(times: np.ndarray) -> dict[str, np.ndarray]:
    """Return the outputs by the equation of the camshaft's angle, with the servo's integral."""
    first, last, mass = -0.5, 3.0, 0.8

    def servo(t: float, y: np.ndarray) -> tuple[float, float]:
        error = -200.0 * min(t, 0.2) - y[1] / first
        force = float(np.clip(0.5 * error + y[2], -3.0, 3.0))
        return force, 6.0 * error + (force - 0.5 * error - y[2]) * 6.0 / 0.5

    def rates(t: float, y: np.ndarray) -> list[float]:
        f, slope, bend = (LIFT(y[0], k) for k in range(3))
        force, change = servo(t, y)
        turning = -slope * (mass * (bend * y[1] ** 2 + 9.81) + 300.0 * f) + force / first - 0.01 * last**2 * y[1]
        return [y[1], turning / (1.5e-3 / first**2 + 4e-3 + 2e-3 * last**2 + mass * slope**2), change]

    y = solve_ivp(rates, (0.0, times[-1]), (0.0, 0.0, 0.0), t_eval=times, rtol=1e-11, atol=1e-12, max_step=1e-3).y
    phi, speed = y[:2]
    turned, forces = (np.array([f(*one)[k] for one in zip(times, y.T)]) for f, k in ((rates, 1), (servo, 0)))
    f, slope, bend = (LIFT(phi, k) for k in range(3))
    lifting = mass * (bend * speed**2 + slope * turned + 9.81) + 300.0 * f
    return {
        "phi": phi, "speed": speed / first, "x": 0.1 + f, "lifting": lifting, "turning": -slope * lifting,
        "first": (forces - 1.5e-3 * turned / first) / first, "last": 2e-3 * last * turned + 0.01 * last * speed,
    }  # fmt: skip


@pytest.mark.parametrize("model", ["full", "components"])
def test_a_cam_between_gears_under_a_servo(model: str) -> None:
    """Motion, and what cam and gears carry, beside scipy's integrator; of order two but where the servo meets its
    limit within a step."""
    errors = errors_of(of_text(BETWEEN_GEARS), model, between_gears, 1e-3, 2.5e-4)
    assert np.all(errors[1] < [2e-5, 1e-3, 1e-6, 1e-3, 1e-4, 1e-3, 1e-3]), errors
    assert np.all(errors[0] > 8.0 * errors[1]), errors


def test_a_sum_of_motions_is_a_gear() -> None:
    _, gear = run(scene_from_toml(ROTORS, "."), "full")
    terms = "joints.mesh={type='coupling',terms={output=2.0,input=0.74}}"
    _, summed = run(scene_from_toml(ROTORS, ".", [terms]), "full")
    assert_alike(gear, summed, 1e-9)


def _geared_arm(ratio: float, *overrides: str) -> Scene:
    """An arm of two links in space with a motor behind a gear at its shoulder, and a spring on the motor."""
    return scene_from_toml(
        HEADER
        + tables(f"""
bodies.upper: line = {{ length = 0.5, elements = 1 }}; element = "beam3d"; material = "steel";
    section = {{ shape = "circle", radius = 0.02 }}
bodies.lower: line = {{ length = 0.4, elements = 1 }}; element = "beam3d"; material = "steel";
    section = {{ shape = "circle", radius = 0.02 }}
bodies.rotor: rigid = {{ mass = 0.1, inertia = [1e-6, 1e-6, 1e-6, 0, 0, 0], points = {{ hub = [0.0, 0.0, 0.0] }} }}
joints.shoulder: type = "revolute"; connect = ["ground:origin", "upper:hinge"]; axis = [0.0, 0.0, 1.0]
joints.elbow: type = "revolute"; connect = ["upper:tip", "lower:hinge"]; axis = [0.0, 0.0, 1.0]
joints.motor: type = "revolute"; connect = ["ground:origin", "rotor:hub"]; axis = [0.0, 0.0, 1.0]
joints.drive: type = "gear"; joints = ["shoulder", "motor"]; ratio = {ratio}
coordinates.shoulder: joint = "shoulder"; range = [-0.6, 0.6]
coordinates.elbow: joint = "elbow"; range = [-0.4, 0.4]
effects.hold: type = "spring_damper"; joint = "motor"; stiffness = 1e-3
reduction: modes = 2; angles = 4
outputs.motor: type = "angle"; joint = "motor"
"""),
        ".",
        overrides,
    )


def test_turns_behind_a_gear_are_counted_between_places_far_apart() -> None:
    """Over two coordinates places are 0.1 rad apart, 12 rad of the motor."""
    scene = _geared_arm(120.0)
    kinematics = RigidKinematics(Mechanism.from_scene(scene, meshes_of(scene)), over_range=True)
    (motor,) = (one for one in kinematics.mechanism.connections if one.name == "motor")
    turns = JointTurns.of(motor, kinematics, np.array([0.0, 0.1]))
    np.testing.assert_allclose([*turns.slopes, turns.offset], [120.0, 0.0, 0.0], rtol=0, atol=1e-9)


@pytest.mark.usefixtures("coarse")
def test_effects_on_motors_that_turn_too_far_between_places_are_warned_of() -> None:
    remarks = [remark.text for remark in rom_of(_geared_arm(37.5)).record.remarks]
    (found,) = (text for text in remarks if "from one place to the next" in text)
    assert re.search(r"body 'rotor' turns by 0.94 rad .* may be off by 0.2 %", found)


def test_a_spring_on_a_motor_is_one_on_the_slow_side_of_its_gear(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between places 0.42 rad of the motor apart directors err by 8e-5, to both sides: less than a hundredth acts."""
    monkeypatch.setattr(tables_of_reduction, "N_FINE_OF_MORE", 96)  # of half the range
    moving = ("simulation={duration=0.2,step=1e-3,initial={shoulder={velocity=2.0}}}",
              "coordinates.shoulder.range=[-0.1,0.5]",
              "effects.elbow={type='spring_damper',joint='elbow',stiffness=2e4}")  # fmt: skip
    slow = "effects.hold={type='spring_damper',joint='shoulder',stiffness=40.0}"
    quick = _geared_arm(120.0, *moving, f"effects.hold.stiffness={40.0 / 120.0**2!r}")
    (_, found), (_, exact) = run(quick, "reduced"), run(_geared_arm(120.0, *moving, slow), "reduced")
    assert np.ptp(exact["motor"]) > 40.0
    np.testing.assert_allclose(found["motor"], exact["motor"], rtol=0, atol=5e-7 * np.ptp(exact["motor"]))
    assert not any("from one place to the next" in remark.text for remark in rom_of(quick).record.remarks)


GENTLY = ("effects.motor.table=[[0.0,0.0],[0.2,0.3],[1.0,0.3]]",)
# what a component run leaves out: forces in the legs that stiffen them, and their foreshortening
OF_SECOND_ORDER = ("effects.stiff={type='geometric_stiffening'}", "effects.inertia={type='mode_inertia'}")


def test_models_of_a_geared_five_bar_agree() -> None:
    """To 1 % of the deformation; both cranks keep their ratio."""
    scene = scene_from_toml(GEARED, ".", GENTLY)
    (_, full), (_, found) = (run(scene, one) for one in ("full", "components"))
    assert full["input"][-1] > 1.0
    for one, allowed in ((full, 1e-8), (found, 1e-3)):  # that of flexible cranks is their joints'
        np.testing.assert_allclose(one["output"] - one["output"][0], -one["input"], rtol=0, atol=allowed)
    # the place follows the angle, which is of 7 rad
    assert_close(full, found, input=1e-4, output=1e-4, x=3e-4, bending=0.01)


def test_what_component_runs_of_a_geared_five_bar_leave_out_is_of_second_order() -> None:
    """3.4 % of the bending: four times as stiff, a quarter of it, as of the forces in the legs over those that buckle
    them; with these terms a fiftieth is left."""

    def share(*overrides: str) -> float:
        scene = scene_from_toml(GEARED, ".", ("simulation.step=5e-4", *overrides))
        (_, found), (_, full) = (run(scene, model) for model in ("components", "full"))
        return float(np.abs(found["bending"] - full["bending"]).max() / np.abs(full["bending"]).max())

    off, stiffer, with_it = share(), share("materials.steel.E=840e9"), share(*OF_SECOND_ORDER)
    assert off == pytest.approx(0.034, rel=0.1)
    assert off / stiffer == pytest.approx(4.0, rel=0.2)
    assert with_it < 0.03 * off


#: Geared five-bars: one that runs freely, and one whose mesh gives way under its motor.
EXCHANGING = {
    "freely": ("effects={}", "simulation.initial.phi.velocity=8.0"),
    "in an elastic mesh": ("reduction.second_order=false", "joints.mesh.elastic={stiffness=3e3,damping=1.0}"),
}


@pytest.mark.parametrize("model", ["full", "reduced"])
@pytest.mark.parametrize("own", EXCHANGING.values(), ids=EXCHANGING)
def test_nothing_is_lost_between_coupled_joints(own: tuple[str, ...], model: str) -> None:
    """What a mesh stores and loses is in the balance of energy."""
    run = "simulation.spectral_radius=0.99", "simulation.duration=0.2", "simulation.step=2.5e-4"
    balance = motion(model, scene_from_toml(GEARED, ".", (*own, *run))).balance
    # the square of the step, of the shortest vibrations that the run begins with
    assert np.abs(balance.residual).max() < 1e-3 * balance.kinetic.max()


def test_a_turn_that_does_not_bring_a_geared_body_back_says_so() -> None:
    turn = ("coordinates.phi.range=[0.0, 6.283185307179586]", "coordinates.phi.periodic=true")
    with pytest.raises(InputError, match="a part of a turn.; give a range that is not periodic, or as"):
        scene = scene_from_toml(ROTORS, ".", turn)
        kinematics_of(scene)


COUPLED = "joints.mesh={type='coupling',terms={output=2.0,input=0.74}}"
RIGID = {
    # scene and entry, values, the coordinate's motion
    "gear": (ROTORS, "joints.mesh.ratio", (-0.41, 0.6), lambda t, r: 0.35 / (0.02 + r**2 * 0.5) * t**2, "one"),
    "coupling": (
        ROTORS, "joints.mesh.terms.input", (0.5, -2.0), lambda t, r: 0.35 / (0.02 + r**2 / 8.0) * t**2, "one"),
    "screw": (
        SCREW, "joints.thread.lead", (0.3, -0.7), lambda t, r: 2.0 / (3.0 + 0.02 * (2.0 * np.pi / r) ** 2) * t**2, "x"),
    "rack": (RACK, "joints.teeth.radius", (0.05,), swing, "phi"),
}  # fmt: skip


@pytest.mark.parametrize("model", ["full", "components"])
@pytest.mark.parametrize("kind", list(RIGID))
def test_each_sample_has_its_own_ratio(kind: str, model: str) -> None:
    """From rest under a constant force, or against a spring: motions whose factors hang on the ratio or the radius."""
    text, entry, values, motion_of, output = RIGID[kind]
    for value in values:
        span = sorted((0.8 * value, 1.2 * value))
        given = (f"{entry}='r'", f"parameters.r={{nominal={value},bounds={span}}}", "simulation.duration=0.4")
        scene = scene_from_toml(text, ".", (*((COUPLED,) if kind == "coupling" else ()), *given))
        of_each = of_samples(MODELS[model](scene), ["r"])
        assert isinstance(of_each, SeparateLengths)
        for own in (value, 1.07 * value, 1.16 * value)[: 3 if kind == "rack" else 2]:
            times, found = history(of_each, samples(scene, 1, r=own), 1)
            exact = {output: motion_of(times, own)[:, None]}
            if kind == "rack":
                exact["x"] = own * exact["phi"]
            # steps over 0.4 s, of directors in space: to (rate step)^2 / 12, of the rack's rate times duration too
            assert_close(exact, found, **dict.fromkeys(exact, 1e-4 if kind == "rack" else 1e-3))


OF_RATIO = (
    "joints.mesh.ratio='ratio'", "parameters.ratio={nominal=-1.0,bounds=[-1.03,-0.96]}",
    "coordinates.phi.range=[0.0,1.2]", "coordinates.phi.periodic=false", "reduction.angles=20", "reduction.modes=4",
    "reduction.second_order=false", "reduction.length_points=6", "simulation.duration=0.15", "simulation.step=1e-3",
)  # fmt: skip
OTHER = -0.973


def geared(*overrides: str) -> Scene:
    """Return a geared five-bar whose ratio is a parameter, over a part of a turn."""
    return scene_from_toml(GEARED, ".", (*OF_RATIO, *overrides))


def numbered(*overrides: str) -> Scene:
    return geared(f"joints.mesh.ratio={OTHER}", "parameters={}", *overrides)


@pytest.fixture(scope="module")
def rom() -> ReducedOrderModel:
    return rom_of(geared())


@pytest.mark.parametrize("model", ["full", "components"])
def test_a_sample_of_flexible_bodies_is_the_model_that_has_its_ratio(model: str) -> None:
    scene = geared()
    found = history(of_samples(MODELS[model](scene), ["ratio"]), samples(scene, 1, ratio=OTHER), 1)[1]
    assert_alike(history(MODELS[model](numbered()), {}, 1)[1], found, 1e-12)


def test_a_reduced_model_with_another_ratio_is_the_one_that_is_built_with_it(rom: ReducedOrderModel) -> None:
    scene, built = geared(), MODELS["reduced"](numbered())
    model = ReducedModel(scene, rom)
    own = model.at_lengths(scene.with_values({"ratio": OTHER}))
    tables, exact = own.rom.tables, built.rom.tables
    for place in range(0, 20, 4):
        found, wanted = (
            eigh(of.stiffness[place, 0], of.mass[place, 0][1:, 1:], eigvals_only=True) for of in (tables, exact)
        )
        np.testing.assert_allclose(found, wanted, rtol=1e-6)
    asked = (built, {}), (own, samples(own.scene, 1)), (of_samples(model, ["ratio"]), samples(scene, 1, ratio=OTHER))
    runs = [history(one, values, 1)[1] for one, values in asked]
    # stiffness between angles, in bases that are turned against each other, leaves 3e-5 of the deformation, as two
    # builds with other angles do
    for found in runs[1:]:
        assert_close(runs[0], found, input=1e-7, output=1e-7, x=1e-7, bending=1e-4)
    of_nominal = history(model, samples(scene, 1), 1)[1]
    assert np.abs(of_nominal["bending"] - runs[0]["bending"]).max() > 0.01 * np.abs(runs[0]["bending"]).max()


def test_derivatives_with_a_ratio_are_central_differences(rom: ReducedOrderModel) -> None:
    scene = geared("simulation.duration=0.05")
    lanes = of_samples(ReducedModel(scene, rom), ["ratio"])
    done = differentiate(lanes, scene.values, ["ratio"])
    for name, expected in differences(lanes, "ratio", 1e-3).items():
        size = max(np.abs(expected).max(), 1e-7 * np.abs(done.outputs[name]).max())
        assert np.abs(done.derivatives[name]["ratio"] - expected).max() < 1e-6 * size, name


@needs_compiler
def test_a_model_in_c_has_the_ratio_of_its_export(rom: ReducedOrderModel, tmp_path: Path) -> None:
    scene = geared()
    model = ReducedModel(scene.with_values({"ratio": OTHER}), rom)
    assert_equal(outputs_of(compiled(model, tmp_path)), motion(model).outputs)
    assert '"ratio"' not in (tmp_path / "steps.c").read_text()


def test_a_ratio_that_does_not_bring_bodies_back_says_so() -> None:
    turn = ("coordinates.phi.range=[0.0,6.283185307179586]", "coordinates.phi.periodic=true")
    with pytest.raises(InputError, match="at ratio = .*joints.mesh a body moved by a part of a turn"):
        rom_of(geared(*turn, "reduction.angles=8", "reduction.length_points=2"))


def test_component_runs_of_samples_say_what_is_not_estimated() -> None:
    scene = geared()
    model = component_model(*with_meshes(scene, Purpose.COMPONENTS), MPI.COMM_SELF)
    said = [remark.text for remark in why_not_of_full_order(of_samples(model, ["ratio"]))]
    assert said[0].startswith("errors of the component modes")


TORQUE, FIRST, SECOND = 0.7, 0.02, 0.5  # of the rotors: N m, kg m2


def rotors(times: np.ndarray, stiffness: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the angles (n_t,) of two rotors from rest, ``e'' = -k (1 / I_2 + r^2 / I_1) e - r T / I_1`` of what the
    second is off, while ``I_1 s_1'' + r I_2 s_2'' = T``."""
    rate = np.sqrt(stiffness * (1.0 / SECOND + RATIO**2 / FIRST))
    off = -RATIO * TORQUE / FIRST / rate**2 * (1.0 - np.cos(rate * times))
    one = (0.5 * TORQUE * times**2 - RATIO * SECOND * off) / (FIRST + RATIO**2 * SECOND)
    return one, RATIO * one + off


@pytest.mark.parametrize("model", ["full", "components"])
@pytest.mark.parametrize(("text", "placed"), [(ROTORS, 0.4), (ROTORS_IN_SPACE, 0.0)], ids=["plane", "space"])
def test_two_rotors_on_an_elastic_mesh_vibrate_as_their_closed_form(text: str, placed: float, model: str) -> None:
    def exact(times: np.ndarray) -> dict[str, np.ndarray]:
        one, two = rotors(times, 200.0)
        return {"one": one, "two": placed + two}

    scene = of_text(text, "joints.mesh.elastic={stiffness=200.0}", "simulation.duration=0.4")
    errors = errors_of(scene, model, exact, 1e-3, 5e-4).sum(axis=1)
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.1)
    assert errors[1] < 2e-5 * rotors(np.array([0.4]), 200.0)[0][0]


def test_samples_have_their_own_stiffness_and_many_turns() -> None:
    """Over several turns in space, from a start that is a turn away."""
    own = (
        "joints.mesh.elastic={stiffness='k'}", "parameters.k={nominal=200.0, unit='N m/rad'}",
        "simulation.initial={phi={position=7.0}}", "simulation.duration=1.5",
    )  # fmt: skip
    scene = scene_from_toml(ROTORS_IN_SPACE, ".", own)
    times, found = history(MODELS["full"](scene), samples(scene, 2, k=[100.0, 400.0]), 2)
    for number, stiffness in enumerate((100.0, 400.0)):
        one, two = rotors(times, stiffness)
        assert one[-1] > 2.0 * np.pi
        # (rate step)^2 / 24 of what the first one vibrates by, and as much of the path
        for name, first, exact in (("one", 7.0, one), ("two", RATIO * 7.0, two)):
            np.testing.assert_allclose(found[name][:, number], first + exact, rtol=0, atol=1e-3 * one[-1])


@pytest.mark.parametrize("model", ["full", "components", "reduced"])
def test_a_stiff_mesh_is_a_rigid_gear_to_the_first_order_of_its_compliance(model: str) -> None:
    """What flexible linkages are off by falls with one over the stiffness, to the rigid coupling; of reduced models as
    far as bases of six modes with and without the motion in the mesh miss the same."""
    smooth = (
        "reduction.second_order=false", "effects.motor.table=[[0.0,0.0],[0.1,0.3],[0.2,0.3]]",
        "simulation.duration=0.1", "simulation.step=5e-4",
    )  # fmt: skip
    _, rigid = run(scene_from_toml(GEARED, ".", smooth), model)
    off = []
    for stiffness in (1e4, 1e5, 1e6):
        mesh = f"joints.mesh.elastic={{stiffness={stiffness},damping={stiffness * 1e-3}}}"
        _, found = run(scene_from_toml(GEARED, ".", (*smooth, mesh)), model)
        off.append([np.abs(found[name] - rigid[name]).max() for name in ("output", "x")])
    ratios = np.array(off[:-1]) / off[1:]
    np.testing.assert_allclose(ratios, 10.0, rtol=0.1 if model != "reduced" else 0.15)


def linear(mass: np.ndarray, stiffness: np.ndarray, damping: np.ndarray, force: np.ndarray, times: np.ndarray, start):
    """Return the path (n, n_t) of ``M q'' + C q' + K q = f`` from a start, positions and velocities."""
    n = len(force)

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[n:], np.linalg.solve(mass, force - stiffness @ y[:n] - damping @ y[n:])])

    return solve_ivp(rates, (0.0, times[-1]), start, "DOP853", times, rtol=1e-10, atol=1e-12).y[:n]


def test_an_elastic_rack_and_its_pinion_are_two_masses_on_springs() -> None:
    own = ("joints.teeth.elastic={stiffness=2000.0,damping=3.0}", "simulation.duration=0.3")
    times, found = run(scene_from_toml(RACK, ".", own), "full")
    teeth = np.outer([-0.05, 1.0], [-0.05, 1.0])  # of phi and x
    start = (0.0, 0.0, 40.0, 0.05 * 40.0)
    path = linear(np.diag([0.02, 3.0]), 2000.0 * teeth + np.diag([0.0, 200.0]), 3.0 * teeth, np.zeros(2), times, start)
    assert_alike(dict(zip(("phi", "x"), path)), found, 1e-4)  # (rate step)^2 / 12 of a vibration at 26 rad/s


def test_an_elastic_cam_lifts_its_follower_through_its_spring() -> None:
    """``I phi'' = k e f'``, ``m x'' + s x = -k e`` with ``e = x - f(phi)``: the force turns with the cam's slope."""

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        off = y[1] - LIFT(y[0])
        return np.array([*y[2:], 3e4 * off * LIFT(y[0], 1) / 0.02, -(300.0 * y[1] + 3e4 * off) / 2.0])

    def exact(times: np.ndarray) -> dict[str, np.ndarray]:
        start = (0.3, float(LIFT(0.3)), 20.0, 20.0 * float(LIFT(0.3, 1)))
        path = solve_ivp(rates, (0.0, times[-1]), start, "DOP853", times, rtol=1e-11, atol=1e-13).y
        return dict(zip(("phi", "x"), path))

    own = ("joints.lift.elastic={stiffness=3e4}", "simulation.duration=0.4", "simulation.spectral_radius=0.99")
    assert_order(errors_of(of_text(CAM, *own), "full", exact, 1e-3, 5e-4), within=0.2)


# two wheels in mesh on an arm that turns: both joints are on the arm
PLANETS = HEADER + tables("""
bodies.arm: rigid = { mass = 1.0, inertia = 0.05, points = { hub = [0.0, 0.0], near = [0.1, 0.0], far = [0.3, 0.0] } }
bodies.one: rigid = { mass = 0.5, inertia = 0.01, points = { hub = [0.0, 0.0] } }; placement = { origin = [0.1, 0.0] }
bodies.two: rigid = { mass = 0.8, inertia = 0.03, points = { hub = [0.0, 0.0] } }; placement = { origin = [0.3, 0.0] }
joints.pivot: type = "revolute"; connect = ["ground:origin", "arm:hub"]
joints.input: type = "revolute"; connect = ["arm:near", "one:hub"]
joints.output: type = "revolute"; connect = ["arm:far", "two:hub"]
joints.mesh: type = "gear"; joints = ["input", "output"]; ratio = -0.5; elastic = { stiffness = 80.0, damping = 0.02 }
coordinates.swing: joint = "pivot"; range = [-3.0, 3.0]
coordinates.phi: joint = "input"; range = [-29.0, 29.0]
effects.motor: type = "torque"; joint = "input"; table = [[0.0, 0.5], [2.0, 0.5]]
simulation: duration = 0.4; step = 5e-4
outputs.swing: type = "angle"; joint = "pivot"
outputs.one: type = "angle"; joint = "input"
outputs.two: type = "angle"; joint = "output"
""")


@pytest.mark.parametrize("model", ["full", "components"])
def test_wheels_in_an_elastic_mesh_turn_their_arm(model: str) -> None:
    """A linear system of the angles of the arm and of both wheels, whose masses go round with the arm."""
    times, found = run(scene_from_toml(PLANETS, "."), model)
    mesh = np.array([-1.5, 0.5, 1.0])  # s_2 + s_1 / 2 in the angles
    mass = np.diag([0.05 + 0.5 * 0.1**2 + 0.8 * 0.3**2, 0.01, 0.03])
    force = np.array([-0.5, 0.5, 0.0])
    path = linear(mass, 80.0 * np.outer(mesh, mesh), 0.02 * np.outer(mesh, mesh), force, times, np.zeros(6))
    exact = {"swing": path[0], "one": path[1] - path[0], "two": path[2] - path[0]}
    assert_alike(exact, found, 3e-4)  # (rate step)^2 / 12 of a vibration at 80 rad/s


# two shafts, each a spring between its disc and its wheel; the wheels are in mesh
TORSION = HEADER + tables("""
ground.points: right = [0.3, 0.0]
bodies.wheel: rigid = { mass = 1.0, inertia = 0.004, points = { hub = [0.0, 0.0] } }
bodies.disc: rigid = { mass = 1.0, inertia = 0.02, points = { hub = [0.0, 0.0] } }
bodies.pinion: rigid = { mass = 1.0, inertia = 0.001, points = { hub = [0.0, 0.0] } };
    placement = { origin = [0.3, 0.0] }
bodies.drum: rigid = { mass = 1.0, inertia = 0.03, points = { hub = [0.0, 0.0] } }; placement = { origin = [0.3, 0.0] }
joints.input: type = "revolute"; connect = ["ground:origin", "wheel:hub"]
joints.first: type = "revolute"; connect = ["wheel:hub", "disc:hub"]
joints.output: type = "revolute"; connect = ["ground:right", "pinion:hub"]
joints.second: type = "revolute"; connect = ["pinion:hub", "drum:hub"]
joints.mesh: type = "gear"; joints = ["input", "output"]; ratio = -2.0; elastic = { stiffness = 400.0 }
coordinates.phi: joint = "input"; range = [-9.0, 9.0]
coordinates.twist: joint = "first"; range = [-3.0, 3.0]
coordinates.twist2: joint = "second"; range = [-3.0, 3.0]
effects.shaft: type = "spring_damper"; joint = "first"; stiffness = 300.0
effects.shaft2: type = "spring_damper"; joint = "second"; stiffness = 120.0
simulation: duration = 0.8; step = 1e-4; spectral_radius = 0.99
outputs.wheel: type = "angle"; joint = "input"
""")


def test_two_geared_shafts_in_torsion_vibrate_as_their_matrices_do() -> None:
    """Wheel, disc, pinion and drum, with ``k (phi_p + 2 phi_w)^2 / 2`` in the mesh: a sum of modes ``sin(rate t) /
    rate``, from velocities as with the mesh locked."""
    mass = np.diag([0.004, 0.02, 0.001, 0.03])
    springs = ((300.0, [-1.0, 1.0, 0.0, 0.0]), (120.0, [0.0, 0.0, -1.0, 1.0]), (400.0, [2.0, 0.0, 1.0, 0.0]))
    rates, shapes = np.linalg.eig(np.linalg.solve(mass, sum(k * np.outer(v, v) for k, v in springs)))
    rates, start = np.sqrt(np.abs(rates)), np.array([1.0, 0.0, -2.0, 0.0])
    weights = np.linalg.solve(shapes, start) * shapes[0]

    def exact(times: np.ndarray) -> dict[str, np.ndarray]:
        # one of the four is the motion as a rigid mechanism
        return {"wheel": sum(w * (np.sin(r * times) / r if r > 1.0 else times) for w, r in zip(weights, rates))}

    given = "simulation.initial={phi={velocity=1.0}, twist={velocity=-1.0}, twist2={velocity=2.0}}"
    errors = errors_of(of_text(TORSION, given), "full", exact, 2e-4, 1e-4)[:, 0]
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.2)
    # phases of the fastest, (rate step)^2 / 12 of rate times duration
    assert errors[1] < 3e-3 * np.abs(exact(np.arange(0.0, 0.8, 1e-4))["wheel"]).max()


@pytest.mark.parametrize("stiffness", [200.0, 2e5, np.inf])
def test_a_flexible_shaft_with_a_disc_and_a_geared_wheel_twists_at_the_rate_of_its_closed_form(
    stiffness: float,
) -> None:
    """A rod in torsion, phi = cos b x + A sin b x, with I of the disc at its end, and at its beginning ``r^2 I k / (k -
    rate^2 I)`` of a wheel on a spring; of a stiff and of a rigid mesh, the wheel itself."""
    shear, area_moment = 210e9 / 2.6, 0.5 * np.pi * 0.005**4
    wave, rod = np.sqrt(shear / 7800.0), shear * area_moment

    def gap(rate: float) -> float:
        b, eased = rate / wave, 1.0 - rate**2 * 0.02 / stiffness
        a = -(rate**2) * 0.08 / (rod * b)
        end, slope = eased * np.cos(0.5 * b) + a * np.sin(0.5 * b), b * (a * np.cos(0.5 * b) - eased * np.sin(0.5 * b))
        return rod * slope - rate**2 * 0.01 * end

    trials = np.linspace(20.0, 600.0, 400)
    gaps = [gap(rate) for rate in trials]
    (end,) = (k for k in range(len(gaps) - 1) if gaps[k] * gaps[k + 1] < 0.0)
    exact = brentq(gap, trials[end], trials[end + 1]) / (2.0 * np.pi)
    rigid = np.isinf(stiffness)
    scene = scene_from_toml(SHAFTS, ".", () if rigid else (f"joints.mesh.elastic={{stiffness={stiffness}}}",))
    kinematics = kinematics_of(scene)
    if rigid:
        with modal_problem(kinematics, scene.nominal, 8) as problem:
            found = problem.solve(0.7).frequencies_hz
    else:
        springs, _ = springs_of(scene, kinematics)
        with VibrationProblem(springs, scene.nominal, 8, MPI.COMM_SELF) as problem:
            found = frequencies_of(problem.eigenvalues(np.array([0.7])))
    # eight elements of modes that are almost linear
    assert np.abs(found - exact).min() < (1e-6 if rigid else 1e-5) * exact


REFUSED = """
joints.mesh.elastic={} -> joints.mesh.elastic.stiffness: missing
joints.mesh.elastic={stiffness=0.0} -> joints.mesh.elastic.stiffness = 0.0: a positive number or the name of a parameter
joints.mesh.elastic={stiffness=inf} -> joints.mesh.elastic.stiffness
joints.mesh.elastic={stiffness=-5.0} -> joints.mesh.elastic.stiffness = -5.0: a positive number
joints.mesh.elastic={stiffness=5.0, damping=-1.0} -> joints.mesh.elastic.damping = -1.0: a number that is not negative
joints.mesh.elastic={stiffness="k"} -> joints.mesh.elastic.stiffness = "k": there is no such parameter
joints.mesh.elastic={stiffness="5 N/mm"} -> joints.mesh.elastic.stiffness = "5 N/mm":
joints.mesh.elastic={stiffness=5.0, reference=[[1.0, 0.0]]} -> joints.mesh.elastic.reference | unknown key
joints.mesh.elastic={stiffness=5.0} & effects.mesh={type="gravity"} -> effects.mesh: joints.mesh has elastic, and its
"""


@pytest.mark.parametrize(("override", "said"), cases(REFUSED))
def test_an_elastic_coupling_is_refused(override: str, said: str) -> None:
    check_said(refusal(scene_from_toml, ROTORS, ".", override.split(" & ")), said, override)


# a scene of each kind, its coupling, where it carries an arm that bends, of which elements, the stiffness, and more
ON_ARMS = {
    "gear": (ROTORS, "mesh", "two:hub", "beam2d", 200.0, ()),
    "gears in a row in space, from turns away": (
        ROW_IN_SPACE, "mesh", "three:hub", "beam3d", 200.0,
        ("simulation.initial={phi={position=17.0}}", "effects.motor.table=[[0.0,0.7],[2.0,0.7]]",
         "joints.again.elastic={stiffness=300.0}"),
    ),
    "rack": (RACK, "teeth", "carriage:left", "beam2d", 2e3, ("bodies.arm.placement={angle=1.2}",)),
    "screw": (SCREW, "thread", "nut:hub", "beam3d", 2e3, ()),
    "cam": (CAM, "lift", "follower:foot", "beam2d", 3e5, ("reduction.angles=256",)),
}  # fmt: skip


def with_arm(kind: str, *overrides: str, loose: str = "") -> Scene:
    """Return a scene whose coupling is elastic, with stiffness and damping that are parameters, or has a clearance, and
    with an arm."""
    text, joint, point, beam, stiffness, own = ON_ARMS[kind]
    if beam == "beam3d":
        own = (*own, "bodies.arm.orientation=[0.0,1.0,0.0]")
    text += tables(f"""
parameters.k: nominal = {stiffness}
parameters.c: nominal = 0.5
bodies.arm: line = {{ length = 0.3, elements = 4 }}; element = "{beam}"; material = "steel";
    section = {{ shape = "rectangle", width = 0.01, height = 0.004 }}
joints.clamp: type = "fixed"; connect = ["{point}", "arm:hinge"]
outputs.bent: type = "deformation"; point = "arm:tip"; axis = "y"
reduction: modes = 4; angles = 16; static_modes = true
""")
    gives_way = f"clearance={{{loose}}}" if loose else "elastic={stiffness='k',damping='c'}"
    return scene_from_toml(text, ".", (*own, f"joints.{joint}.{gives_way}", "simulation.duration=0.3", *overrides))


def largest_difference(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> float:
    """Return the largest difference of outputs as a share of each one's range."""
    return max(np.abs(one[name] - other[name]).max() / (np.ptp(one[name]) or 1.0) for name in one)


@pytest.mark.parametrize("kind", ON_ARMS)
def test_reduced_runs_are_those_of_full_order_and_of_c(kind: str, tmp_path: Path) -> None:
    """Models of first order: of a cam with 64 angles 9e-3, with 128 2e-3, as tables follow the breaks of its spline."""
    scene = with_arm(kind, "simulation.step=5e-4")
    model = reduced_model(scene)
    found = motion(model).outputs
    assert largest_difference(run(scene, "full")[1], found) < 2e-3
    if exported.COMPILER:
        exported.assert_equal(exported.outputs_of(exported.compiled(model, tmp_path)), found)


PLAY = "radius='k',stiffness=1e9,restitution=0.7,restitution_speed=0.02"
SHORT = ("parameters.k.nominal=1e-4", "simulation.duration=0.05", "simulation.step=5e-5")


@pytest.mark.parametrize("kind", ["rack", "screw", "cam"])
def test_backlash_in_reduced_and_component_runs_in_c_and_in_derivatives(kind: str, tmp_path: Path) -> None:
    """Against full order; measured over twice the time: 6e-4 of the rack, 8e-5 of the screw, 2e-3 of the cam, whose rigid
    mesh is 0.4, 0.9 and 0.09 off."""
    scene = with_arm(kind, *SHORT, loose=PLAY)
    model, (_, full) = reduced_model(scene), run(scene, "full")
    found = motion(model).outputs
    assert largest_difference(full, run(scene, "components")[1]) < 5e-4
    assert largest_difference(full, found) < 4e-3
    if exported.COMPILER:
        exported.assert_equal(exported.outputs_of(exported.compiled(model, tmp_path)), found)
    compare(model)


SLOWLY = (  # a motor that turns the cam by a quarter of what it turns
    "bodies.motor={rigid={mass=1.0,inertia=0.01}};joints.motor={type='revolute',connect=['ground:origin','motor:centre']};"
    "joints.mesh={type='gear',joints=['motor','axle'],ratio=-0.25};coordinates.phi={joint='motor',range=[0.0,6.0]}"
)


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("reduction={angles=256}", False),
        ("reduction={angles=64}", True),
        ("reduction={sampling_tolerance=1e-3,interpolation='spline'}", False),
        (f"reduction={{angles=64}};{SLOWLY}", False),
    ],
)
def test_few_angles_of_a_cam_are_warned_of(override: str, said: bool) -> None:
    """Its table has a few points alone; with a tolerance the build adds angles itself. Turns are those of the cam."""
    few = [remark.text for remark in plausibility(with_arm("cam", *override.split(";")))]
    assert any(text.startswith("reduction.angles = 64: few beside joints.lift") for text in few) == said


def test_many_turns_of_a_motor_that_is_geared_are_no_degrees() -> None:
    turns = "coordinates.phi.periodic=false", "coordinates.phi.range=[-1.0,60.0]"
    assert not any("degrees" in remark.text for remark in plausibility(with_arm("cam", *turns, *SLOWLY.split(";")[:3])))


@pytest.mark.parametrize("kind", ON_ARMS)
def test_derivatives_by_stiffness_and_damping_are_central_differences(kind: str) -> None:
    """With steps of which the run's own iteration leaves 2e-7 of a cam: 9e-6 with four times as long ones."""
    compare(reduced_model(with_arm(kind, "simulation.duration=0.05", "simulation.step=2.5e-4")))


def test_a_ratio_is_that_of_the_run_and_not_of_samples() -> None:
    alike = (
        "joints.mesh.elastic={stiffness=3e3,damping=1.0}", "simulation.duration=0.05",
        "coordinates.phi.periodic=false", "coordinates.phi.range=[-1.0,1.0]", "reduction.angles=24",
    )  # fmt: skip
    any_ratio = (
        "parameters.r={nominal=-1.0,bounds=[-1.1,-0.9]}", 'joints.mesh.ratio="r"', "reduction.length_points=3",
    )  # fmt: skip
    scene = scene_from_toml(GEARED, ".", (*alike, *any_ratio), ("r=-0.95",))
    own, wanted = reduced_model(scene), reduced_model(scene_from_toml(GEARED, ".", (*alike, "joints.mesh.ratio=-0.95")))
    found, exact = (motion(model).outputs for model in (own, wanted))
    assert_alike(exact, found, 3e-4)  # what three ratios leave: as much as frequencies are off between them
    with pytest.raises(InputError, match=r"joints.mesh: acts on a ratio .* that r change"):
        of_samples(own, ["r"])


@exported.needs_compiler
def test_a_geared_linkage_has_terms_of_second_order_beside_its_elastic_mesh(tmp_path: Path) -> None:
    """Against the full-order run, and in C: the torque of the mesh is a stiffness times a small difference of turns, of
    which iterations of both leave 1e-8."""
    carried = (
        'outputs.knee={type="joint_force",joint="knee",component="x"}',
        *(f'outputs.{name}={{type="joint_torque",joint="mesh",component="{name}"}}' for name in ("axial", "magnitude")),
    )
    elastic = "joints.mesh.elastic={stiffness=3e3,damping=1.0}"
    scene = scene_from_toml(GEARED, ".", (elastic, "simulation.duration=0.2", *carried))
    model = reduced_model(scene)
    assert model.rom.curvature is not None
    found, exact = exported.assert_same_in_c(model, tmp_path, 1e-7), run(scene, "full")[1]
    assert largest_difference({name: exact[name] for name in ("input", "output", "x", "bending")}, found) < 0.01


def test_reduced_frequencies_on_an_elastic_mesh_are_those_of_its_linkage() -> None:
    """The lowest ones to round-off: the motion in the mesh and the static answer to its spring are in the basis."""
    own = ("reduction.second_order=false", "joints.mesh.elastic={stiffness=2e4}")
    scene = scene_from_toml(GEARED, ".", own)
    rom = rom_of(scene)
    springs, _ = springs_of(scene, kinematics_of(scene))
    theta = rom.tables.samples.theta[[5]]
    found = reduced_vibrations(rom, springs, scene.interpolation, scene.values, theta)
    with VibrationProblem(springs, scene.values, 6, MPI.COMM_SELF) as problem:
        exact = frequencies_of(problem.eigenvalues(theta[0]))
    np.testing.assert_allclose(found[0, :2], exact[:2], rtol=1e-8)


def test_a_stiffness_of_a_built_model_is_that_of_a_new_build() -> None:
    scene, other = with_arm("gear"), with_arm("gear", "parameters.k.nominal=900.0")
    assert largest_difference(run(scene, "reduced", k=900.0)[1], run(other, "reduced")[1]) < 1e-6
