"""Forces in joints against Newton's law, statics and balances of energy; what is not determined is refused."""

import re
from collections.abc import Callable

import numpy as np
import pytest
from alike import assert_groups_alike, assert_samples_are_those_alone
from conftest import ROOT
from differences import SHARES, ToRoundOff, compare
from offset_scenes import clamped_beam, clamped_stiffness, offset
from runs import full_model, motion, reduced_model, rom_of, trajectory, watched
from scipy.integrate import cumulative_trapezoid, solve_ivp
from spatial_beams import slider_crank_of_beams

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.figures import solids
from pgmp_petsc.figures.motion import motion_of
from pgmp_petsc.figures.trajectories import Load, arrows_of, joint_forces, loads
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.scene import Scene, load_scene, scene_from_toml
from scenes import HEADER, four_bar, of_text, pendulum, slider_crank, tables, trammel

GRAVITY = 9.80665
FORCE, MOMENT = ('outputs.{0}={{type="joint_%s", joint="{1}"{2}}}' % kind for kind in ("force", "torque"))


def outputs(joint: str, kind: str = FORCE, **components: str) -> tuple[str, ...]:
    """Return overrides of outputs of a joint, by their names and entries."""
    return tuple(kind.format(name, joint, entries and f", {entries}") for name, entries in components.items())


def along(*axes: str, more: str = "") -> dict[str, str]:
    """Return the entries of components, by their names."""
    return {axis: f'component="{axis}"{more}' for axis in axes}


def held(coordinate: str, at: float = 0.0) -> str:
    return f'effects.hold={{type="prescribed_motion", coordinate="{coordinate}", table=[[0.0, {at}], [1.0, {at}]]}}'


STILL = ("initial.equilibrium=true", "simulation.duration=0.01", "simulation.step=1e-3")
PENDULUM = HEADER + tables("""
bodies.arm: rigid = { mass = 2.0, centre = [0.4, 0.0], inertia = 0.05, points = { hinge = [0.0, 0.0] } }
joints.hinge: type = "revolute"; connect = ["ground:origin", "arm:hinge"]
coordinates.phi: joint = "hinge"; range = [-3.2, 3.2]
effects.weight: type = "gravity"
simulation: duration = 1.0; step = 1e-3
simulation.initial.phi: position = 0.3; velocity = 2.0
""")
swinging = of_text(PENDULUM)


def test_a_drive_whose_table_ends_with_the_run_takes_what_it_does_there() -> None:
    """``J phi''`` of a clamped spline of one piece, -6 J / T^2 at its end: none was said there, at rest behind it."""
    driven = (
        'effects={drive={type="prescribed_motion", coordinate="phi", table=[[0.0, 0.0], [0.3, 1.0]]}}',
        "simulation={duration=0.3, step=1e-3}", 'outputs.drive={type="drive_torque", joint="hinge"}',
    )  # fmt: skip
    found = motion(full_model(swinging(*driven))).outputs["drive"]
    wanted = (0.05 + 2.0 * 0.4**2) * 6.0 / 0.3**2
    np.testing.assert_allclose(found[[0, -1]], [wanted, -wanted], rtol=1e-9)


@pytest.mark.parametrize("radius", [0.8, 1.0])
def test_a_pendulum_to_second_order_from_the_first_step_on(radius: float) -> None:
    """``m a - m g`` of a solution by scipy, in the ground's axes and the body's, on both bodies."""
    mass, arm, inertia = 2.0, 0.4, 0.05
    wanted = outputs(
        "hinge", **along("x", "y"), size='component="magnitude"', first='component="y", of="first"',
        body='component="y", frame="body"',
    )  # fmt: skip

    def swing(_: float, y: np.ndarray) -> list[float]:
        return [y[1], -mass * GRAVITY * arm * np.cos(y[0]) / (inertia + mass * arm**2)]

    errors = []
    for step in (4e-3, 2e-3, 1e-3):
        settings = (f"simulation.step={step}", f"simulation.spectral_radius={radius}")
        run = motion("full", swinging(*wanted, *settings))
        found = solve_ivp(swing, (0.0, 1.0), [0.3, 2.0], t_eval=run.time, rtol=1e-11, atol=1e-12).y
        (angle, speed), (_, turning) = found, swing(0.0, found)
        away = np.array([np.cos(angle), np.sin(angle)])
        x, y = mass * arm * (turning * np.array([-away[1], away[0]]) - speed**2 * away) + [[0.0], [mass * GRAVITY]]
        exact = {"x": x, "y": y, "size": np.hypot(x, y), "first": -y, "body": -x * away[1] + y * away[0]}
        errors.append([np.abs(run.outputs[name] - values).max() for name, values in exact.items()])
    first, second, third = np.array(errors)
    assert (third < 2e-4 * 30.0).all(), third  # 30 N is the largest force
    np.testing.assert_allclose([first / second, second / third], 4.0, rtol=0.1)


FLYWHEEL = HEADER + tables(
    """
bodies.wheel: rigid = { mass = 3.0, centre = [0.2, 0.01, 0.0], inertia = [0.02, 0.03, 0.03, 0.0, 0.0, 0.0];
    points = { hub = [0.0, 0.0, 0.0] } }
joints.bearing: type = "revolute"; connect = ["ground:origin", "wheel:hub"]; axis = [1.0, 0.0, 0.0]
coordinates.phi: joint = "bearing"; range = [0.0, 6.283185307179586]; periodic = true
effects.drive: type = "prescribed_motion"; coordinate = "phi"; constant_speed = { speed = 30.0 }
effects.weight: type = "gravity"; direction = [0.0, -1.0, 0.0]
simulation: duration = 0.3; step = 2.5e-4
outputs.drive: type = "drive_torque"; joint = "bearing"
outputs.power: type = "power"; coordinate = "phi"
""".replace("0.0];\n    points", "0.0], points")
)
flywheel = of_text(FLYWHEEL)


@pytest.mark.parametrize(("kind", "begun"), [("full", 0.0), ("components", 4.0)])
def test_a_flywheel_out_of_balance_in_space(kind: str, begun: float) -> None:
    """It turns at a constant speed: its centre of mass has the acceleration ``e W^2``, and nothing turns about it. It
    begins beyond half a turn too."""
    mass, e, b, speed = 3.0, 0.01, 0.2, 30.0
    start = f"effects.drive.constant_speed.start={begun}"
    wanted = outputs("bearing", **along("radial", "axial"), y='component="y"', body='component="y", frame="body"')
    moments = outputs("bearing", MOMENT, moment="", mz='component="z", frame="body"')
    run = motion(kind, flywheel(*wanted, *moments, start))
    angle, zero = begun + speed * run.time, 0.0 * run.time
    cos, sin = np.cos(angle), np.sin(angle)
    force = np.array([zero, mass * (GRAVITY - e * speed**2 * cos), -mass * e * speed**2 * sin])
    moment = np.cross([b + zero, e * cos, e * sin], force, axis=0)  # about the bearing
    torque = -moment[0]  # of all that acts about the axis, which is in balance
    exact = {
        "radial": np.hypot(force[1], force[2]), "axial": zero, "y": force[1], "body": force[1] * cos + force[2] * sin,
        "moment": np.hypot(moment[1], moment[2]), "mz": moment[2] * cos - moment[1] * sin,
        "drive": -torque, "power": -torque * speed,
    }  # fmt: skip
    for name, values in exact.items():
        # second order in W h = 0.0075, of 56 N
        np.testing.assert_allclose(run.outputs[name], values, rtol=0, atol=8e-4, err_msg=name)
    assert [run.units[name] for name in ("y", "moment", "drive", "power")] == ["N", "N m", "N m", "W"]


@pytest.mark.parametrize("kind", ["full", "components"])
def test_statics_of_a_beam_and_of_a_truss(kind: str) -> None:
    """A beam that is held level, and a crank that holds a rod, which a force pushes: a truss of two bars."""
    weight = 7800.0 * np.pi * 2e-2**2 * GRAVITY
    scene = pendulum(
        "bodies.arm.section.radius=2e-2", held("phi"), 'effects.weight={type="gravity"}',
        'outputs.drive={type="drive_torque", joint="hinge"}', *STILL, *outputs("hinge", **along("x", "y")),
    )  # fmt: skip
    found = motion(kind, scene).outputs
    for name, exact in {"x": 0.0, "y": weight, "drive": 0.5 * weight}.items():
        # the sag of 0.2 mm moves the centre of mass back by 1e-7 of the length
        np.testing.assert_allclose(found[name], exact, rtol=0, atol=2e-7 * weight, err_msg=name)
    angle, crank, rod, push = 0.7, 0.3, 0.7, 5e-3  # of N: bars that hardly bend
    scene = slider_crank(
        held("theta", angle).replace("hold", "motor"),
        f'effects.push={{type="force", point="rod:tip", direction=[1.0, 0.0], table=[[0.0, {-push}], [1.0, {-push}]]}}',
        *STILL, *outputs("elbow", **along("x", "y")), *outputs("slider", normal='component="y"'),
        'outputs.drive={type="drive_torque", coordinate="theta"}',
    )  # fmt: skip
    tilt = np.arcsin(crank * np.sin(angle) / rod)
    moved = -crank * np.sin(angle) * (1.0 + crank * np.cos(angle) / (rod * np.cos(tilt)))  # dx / dtheta
    exact = {"x": push, "y": -push * np.tan(tilt), "normal": push * np.tan(tilt), "drive": push * moved}
    found = motion(kind, scene).outputs
    for name, value in exact.items():
        np.testing.assert_allclose(found[name], value, rtol=0, atol=2e-6 * push, err_msg=name)


GEARS = HEADER + tables("""
ground.points: right = [0.5, 0.0]
bodies.input: rigid = { mass = 1.0, centre = [0.0, 0.0], inertia = 0.02, points = { hub = [0.0, 0.0] } }
bodies.output: rigid = { mass = 2.0, centre = [0.0, 0.0], inertia = 0.3, points = { hub = [0.0, 0.0] } };
    placement = { origin = [0.5, 0.0] }
joints.first: type = "revolute"; connect = ["ground:origin", "input:hub"]
joints.second: type = "revolute"; connect = ["ground:right", "output:hub"]
joints.mesh: type = "gear"; joints = ["first", "second"]; ratio = -0.25
coordinates.phi: joint = "first"; range = [-1.0, 6.0]
effects.motor: type = "torque"; joint = "first"; table = [[0.0, 2.0], [1.0, 2.0]]
effects.load: type = "torque"; joint = "second"; table = [[0.0, 1.0], [1.0, 1.0]]
simulation: duration = 0.2; step = 1e-3
""")
gears = of_text(GEARS)
OF_WHEELS = {name: f'component="axial", of="{name}"' for name in ("first", "second")}


@pytest.mark.parametrize("elastic", [False, True])
def test_torques_of_a_gear(elastic: bool) -> None:
    """The equations of two wheels with the ratio -1/4; an elastic gear vibrates about them until it is damped."""
    give = ("joints.mesh.elastic={ stiffness = 1e5, damping = 20.0 }",) if elastic else ()
    found = motion("full", gears(*outputs("mesh", MOMENT, **OF_WHEELS), *give)).outputs
    spin = (2.0 - 0.25) / (0.02 + 0.3 / 16.0)
    second = -0.25 * 0.3 * spin - 1.0
    for name, exact in {"second": second, "first": 0.25 * second}.items():
        np.testing.assert_allclose(found[name][-1 if elastic else slice(None)], exact, rtol=1e-5 if elastic else 1e-11)


def test_torques_of_an_elastic_cam() -> None:
    """What turns the second wheel beside its load, and its share by the slope of the table on the first one."""
    table = [[0.0, 0.0], [1.0, 0.1], [3.0, 0.2], [5.0, 0.1], [6.283185307179586, 0.0]]
    cam = f'{{ type = "cam", joints = ["first", "second"], table = {table}, elastic = {{ stiffness = 1e3 }} }}'
    turning = [f'outputs.{name}_angle={{type="angle", joint="{name}"}}' for name in OF_WHEELS]
    turning += [f'outputs.{name}_turning={{type="rate", of="{name}_angle", order=2}}' for name in OF_WHEELS]
    found = motion("full", gears(f"joints.mesh={cam}", *outputs("mesh", MOMENT, **OF_WHEELS), *turning)).outputs
    largest = np.abs(found["second"]).max()
    for name, inertia, load in (("first", 0.02, 2.0), ("second", 0.3, 1.0)):
        left = inertia * found[f"{name}_turning"] - load - found[name]
        assert np.abs(left).max() < 1e-8 * largest, name


def test_an_elastic_joint_has_the_force_of_its_springs() -> None:
    """A mount that is rigid along x and gives way otherwise, with parameters; it carries two bodies at rest."""
    scene = swinging(
        "bodies.base.rigid={ mass = 4.0, centre = [0.0, 0.0], inertia = 0.1, points = { foot = [0.0, 0.0] } }",
        'parameters.k={ nominal = 2e4, unit = "N/m" }', 'joints.hinge.connect=["base:foot", "arm:hinge"]',
        'joints.mount={ type = "fixed", connect = ["ground:origin", "base:foot"], elastic = { '
        'reference = [[1.0, 0.0]], stiffness = [inf, "k"], damping = [0.0, 400.0], turning_stiffness = [500.0], '
        'turning_damping = [5.0] } }',
        "simulation.initial={}", held("phi"), *STILL, *outputs("mount", **along("x", "y")),
        *outputs("mount", MOMENT, moment='component="z"'),
    )  # fmt: skip
    found, turned = motion("full", scene).outputs, 0.0
    for _ in range(20):
        turned = -2.0 * GRAVITY * 0.4 * np.cos(turned) / 500.0
    for name, exact in {"x": 0.0, "y": 6.0 * GRAVITY, "moment": -500.0 * turned}.items():
        np.testing.assert_allclose(found[name], exact, rtol=0, atol=1e-7, err_msg=name)


RIGID = "bodies.{0}.rigid={{mass=1.0, centre=[{1}, 0.0, 0.0], inertia=[0.01, 0.05, 0.05, 0.0, 0.0, 0.0], points={2}}}"


def four_bar_in_space(*overrides: str) -> Scene:
    """Return a rigid four-bar in the plane z = 0 of space, whose parallel axes hold more than is needed."""
    text = HEADER + tables("""
ground.points: pivot = [1.0, 0.0, 0.0]
coordinates.theta: joint = "crank_hinge"; range = [0.0, 6.283185307179586]; periodic = true
effects.drive: type = "prescribed_motion"; coordinate = "theta"; spin_up = { speed = 10.0, time = 0.2 }
simulation: duration = 0.5; step = 1e-3
outputs.power: type = "power"; joint = "crank_hinge"
""")
    bodies = {"crank": (0.3, 0.0, 0.0), "coupler": (0.9, 0.3, 0.8), "rocker": (0.7, 1.0, 1.5)}
    joints = {"crank_hinge": ("ground:origin", "crank:hinge"), "elbow": ("crank:tip", "coupler:hinge"),
              "knee": ("coupler:tip", "rocker:tip"), "rocker_hinge": ("ground:pivot", "rocker:hinge")}  # fmt: skip
    made = []
    for name, (length, x, angle) in bodies.items():
        made.append(RIGID.format(name, length / 2, f"{{ hinge = [0.0, 0.0, 0.0], tip = [{length}, 0.0, 0.0] }}"))
        made.append(f"bodies.{name}.placement={{ origin = [{x}, 0.0, 0.0], rotation = [0.0, 0.0, {angle}] }}")
    for name, points in joints.items():
        made.append(
            f'joints.{name}={{ type="revolute", connect={list(points)}, axis=[0.0, 0.0, 1.0] }}'.replace("'", '"')
        )
    return scene_from_toml(text, ".", (*made, *overrides))


def test_what_redundant_joints_determine_and_the_work_of_a_drive() -> None:
    """In the plane the forces are determined, and equal to those of a planar mechanism; across it their differences."""
    run = motion("full", four_bar_in_space(*outputs("elbow", **along("x", "y", "radial"))))
    np.testing.assert_allclose(np.hypot(run.outputs["x"], run.outputs["y"]), run.outputs["radial"], rtol=1e-12)
    work, gained = cumulative_trapezoid(run.outputs["power"], run.time), run.balance.kinetic - run.balance.kinetic[0]
    np.testing.assert_allclose(work, gained[1:], rtol=0, atol=2e-4 * gained.max())  # of second order in the step
    for entries in ('component="z"', 'component="axial"', ""):
        with pytest.raises(InputError, match=r"outputs.bad.joint: .*crank_hinge, elbow, .*that of elbow - crank_hinge"):
            full_model(four_bar_in_space(*outputs("elbow", bad=entries)))
    with pytest.raises(InputError, match="outputs.bad.joint: constraints of crank_hinge, elbow, knee, rocker_hinge"):
        full_model(four_bar_in_space(*outputs("elbow", MOMENT, bad='component="x"')))
    twice = outputs("twin", bad="", good='component="x"')
    with pytest.raises(InputError, match="outputs.bad.joint: constraints of elbow, twin .*that of twin . elbow"):
        full_model(four_bar('joints.twin={type="revolute", connect=["crank:tip", "coupler:hinge"]}', *twice))


@pytest.mark.parametrize(
    ("scene", "override", "message"),
    [
        (four_bar, outputs("elbw", bad="")[0], r"outputs.bad.joint = .elbw.: there is no such joint; .*elbow"),
        (four_bar, outputs("elbow", **along("z"))[0], "outputs.z.component = .z.: a force in the plane has x and y"),
        (four_bar, outputs("elbow", **along("axial"))[0], "outputs.axial.component = .axial.: elbow is revolute"),
        (four_bar, outputs("elbow", MOMENT, **along("x"))[0], "outputs.x.component = .x.: a moment in the plane"),
        (four_bar, outputs("elbow", MOMENT, bad="")[0], "outputs.bad.joint = .elbow.: .*holds no turning"),
        (four_bar, 'outputs.bad={type="power", joint="elbow"}', "outputs.bad.joint = .elbow.: no prescribed motion"),
        (four_bar, 'outputs.bad={type="power", coordinate="theta"}', "outputs.bad.coordinate = .theta.: no prescribed"),
        (four_bar, 'outputs.bad={type="power", coordinate="thta"}', "outputs.bad.coordinate = .thta.: there is no"),
        (four_bar, 'outputs.bad={type="power", joint="elbw"}', "outputs.bad.joint = .elbw.: there is no such joint"),
        (four_bar, 'outputs.bad={type="power"}', "outputs.bad.joint: "),
        (four_bar_in_space, 'outputs.bad={type="power", joint="elbow"}', "no prescribed motion moves it; one moves th"),
        (gears, outputs("mesh", **along("axial"))[0], "axial.of = .*torque"),
        (gears, outputs("mesh", MOMENT, **along("z"))[0], "mesh is gear"),
    ],
)  # fmt: skip
def test_what_is_refused(scene: Callable[..., Scene], override: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        full_model(scene(override))


#: Bodies of Andrews' squeezing mechanism (Hairer and Wanner 1996, section VII.7): mass, centre, inertia, points, angle
#: at the start, and the body whose tip it begins at or the ground's point.
SQUEEZER = {
    "crank": (0.04325, (92e-5, 0.0), 2.194e-6, {"tip": (7e-3, 0.0)}, -0.0617138900142764496, "origin"),
    "coupler": (0.00365, (-115e-4, 0.0), 4.410e-7, {"tip": (-28e-3, 0.0)}, -0.0617138900142764496, "crank"),
    "wing": (0.02373, (1043e-5, -1874e-5), 5.255e-6, {"tip": (0.0, -35e-3), "pulled": (2e-2, -18e-3)},
             0.455279819163070380, "b"),
    "arm": (0.07050, (2308e-5, 916e-5), 1.169e-5, {"tip": (4e-2, 0.0)}, 0.487364979543842550, "a"),
    "link": (0.00706, (0.0, -579e-5), 5.667e-7, {"tip": (0.0, -2e-2)}, 0.710033369709727224, "arm"),
    "fork": (0.05498, (-449e-5, -1228e-5), 1.912e-5, {"tip": (0.0, -4e-2)}, 1.230547444549821192, "a"),
    "bar": (0.00706, (579e-5, 0.0), 5.667e-7, {"tip": (2e-2, 0.0)}, 1.007879054383935308, "fork"),
}  # fmt: skip
SQUEEZED = {"a": (-0.06934, -0.00227), "b": (-0.03635, 0.03273), "c": (0.014, 0.072)}


def squeezer(*overrides: str) -> Scene:
    """Return Andrews' squeezing mechanism of seven rigid bodies; wing, link and bar are pinned to the coupler's tip."""
    places, entries = {name: np.array(place) for name, place in SQUEEZED.items()} | {"origin": np.zeros(2)}, []
    entries += [f"ground.points.{name}={list(place)}" for name, place in SQUEEZED.items()]
    for name, (mass, centre, inertia, points, angle, begin) in SQUEEZER.items():
        own = ", ".join(f"{point} = {list(place)}" for point, place in {"start": (0.0, 0.0), **points}.items())
        entries.append(
            f"bodies.{name}={{ rigid = {{ mass = {mass}, centre = {list(centre)}, inertia = {inertia}, "
            f"points = {{ {own} }} }}, placement = {{ origin = {places[begin].tolist()}, angle = {angle} }} }}"
        )
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        places[name] = places[begin] + turn @ points["tip"]
        first = f"{begin}:tip" if begin in SQUEEZER else f"ground:{begin}"
        entries.append(f'joints.{name}={{ type = "revolute", connect = ["{first}", "{name}:start"] }}')
    for name in ("wing", "link", "bar"):
        pin = f'type = "revolute", connect = ["coupler:tip", "{name}:tip"]'
        entries += [f"joints.at_{name}={{ {pin} }}", *outputs(f"at_{name}", **{
            f"{name}_{axis}": f'component="{axis}"' for axis in "xy"
        })]  # fmt: skip
    spring = 'points = ["ground:c", "wing:pulled"], stiffness = 4530.0, rest = 0.07785'
    entries += [
        'coordinates.beta={ joint = "crank", range = [0.0, 6.283185307179586], periodic = true }',
        f"simulation.initial.beta.position={SQUEEZER['crank'][4]}", "simulation.duration=0.03",
        'effects.motor={ type = "torque", joint = "crank", table = [[0.0, 0.033], [1.0, 0.033]] }',
        f'effects.spring={{ type = "spring_damper", {spring} }}', 'outputs.beta={ type = "angle", joint = "crank" }',
    ]  # fmt: skip
    return scene_from_toml(HEADER, ".", (*entries, *overrides))


def test_the_multipliers_of_andrews_squeezing_mechanism() -> None:
    """Those that the Test Set for IVP Solvers (Mazzia and Magherini 2008, problem "andrews") prints at 0.03 s, to
    second order; its constraints are the places of the coupler's tip less those of the others', as the forces on
    these are."""
    printed = {
        "wing_x": 199.1753333731910, "wing_y": -29.75531228015052, "link_x": 23.06654119098399,
        "link_y": 31.45271365475927, "bar_x": 22.64249232082739, "bar_y": 11.61740700019673,
        "beta": 15.81077119629904,
    }  # fmt: skip
    errors = []
    for step in (1e-5, 5e-6):
        found = motion("full", squeezer(f"simulation.step={step}")).outputs
        errors.append([abs(found[name][-1] - value) for name, value in printed.items()])
    coarse, fine = np.array(errors)
    assert fine.max() < 3e-3, fine  # of 200 N; at 2.5e-6 s it is 5e-4
    np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.1)


SIMEON = HEADER + tables(
    """
materials.bar: E = 2e11; nu = 0.3; rho = 7870.0
bodies.crank: rigid = { mass = 0.36, centre = [0.075, 0.0], inertia = 7.02e-4, points = { hinge = [0.0, 0.0],
    tip = [0.15, 0.0] } }
bodies.rod: line = { length = 0.3, elements = 16 }; element = "beam2d"; material = "bar"
bodies.rod.section: shape = "rectangle"; width = 8e-3; height = 8e-3
bodies.block: rigid = { mass = 0.075552, centre = [0.0, 0.0], inertia = 1e-5, points = { pin = [0.0, 0.0] } }
joints.shaft: type = "revolute"; connect = ["ground:origin", "crank:hinge"]
joints.elbow: type = "revolute"; connect = ["crank:tip", "rod:hinge"]
joints.pin: type = "revolute"; connect = ["rod:tip", "block:pin"]
joints.guide: type = "prismatic"; connect = ["ground:origin", "block:pin"]; axis = [1.0, 0.0]
coordinates.theta: joint = "shaft"; range = [0.0, 6.283185307179586]; periodic = true
effects.motor: type = "prescribed_motion"; coordinate = "theta"; constant_speed = { speed = 150.0 }
reduction: modes = 2; angles = 64; interpolation = "spline"
simulation: duration = 0.1; step = 2e-5
outputs.guide: type = "joint_force"; joint = "guide"; component = "y"
outputs.pin: type = "joint_force"; joint = "pin"; component = "x"
outputs.drive: type = "drive_torque"; coordinate = "theta"
""".replace("0.0],\n    tip", "0.0], tip")
)


def test_the_multipliers_of_simeons_flexible_slider_crank() -> None:
    """Those that the Test Set for IVP Solvers (problem "crank", linear stiffness, no damping) prints at 0.1 s, of two
    sines across the rod and an element with a quadratic field along it.

    Its mass matrix along the rod is 15 times that of such an element; with this one they change by 1.2 %, which is how
    much its answers can say. The rod starts with the speed of the first sine.
    """
    printed = {"guide": 62.32893262533717, "pin": 163.7910131687472, "drive": -25.29853213732781}
    largest = {"guide": 211.7, "pin": 382.8, "drive": 69.2}  # of an integration of its equations by scipy
    model = reduced_model(scene_from_toml(SIMEON, "."))
    mechanism = model.kinematics.mechanism
    (number,) = (k for k, body in enumerate(mechanism.bodies) if body.name == "rod")
    rod, before = mechanism.bodies[number], sum(body.n_nodes for body in mechanism.bodies[:number])
    place = rod.mesh.nodes[:, 0] / 0.3
    local = model.local_displacements(np.eye(3)[1:], {})[:, before : before + rod.n_nodes, 1]
    rates = 0.444896105 * np.sin(np.pi * place) + 0.463434311e-2 * np.sin(2.0 * np.pi * place)
    system = model.batch({}, 1)
    system.begun = np.zeros((1, 3)), np.array([[150.0, *np.linalg.lstsq(local.T, rates, rcond=None)[0]]])
    _, kept = watched(system, model.scene.simulation, lambda *seen: seen)
    found = model.outputs.evaluate(model.observed_of(*kept[-1], {}))
    for name, value in printed.items():
        assert abs(found[name][0] - value) < 6e-3 * largest[name], (name, found[name])


BASIS = (
    "reduction.static_modes=true", "reduction.inertia_modes=true", 'reduction.interpolation="spline"',
    "reduction.angles=64", "reduction.modes=4", "simulation.duration=1.0", "simulation.step=5e-4",
)  # fmt: skip
ALL = (*outputs("crank_hinge", **{f"pin_{axis}": f'component="{axis}"' for axis in "xy"}), *outputs("slider", n=""),
       *outputs("elbow", **along("x", "y")))  # fmt: skip
STIFFENED = ('effects.x={type="geometric_stiffening"}', 'effects.y={type="mode_inertia"}')
DRIVEN = (
    'effects.motor={type="prescribed_motion", coordinate="theta", spin_up={speed=2.0, time=0.3}}',
    'outputs.drive={type="drive_torque", joint="crank_hinge"}', 'outputs.power={type="power", coordinate="theta"}',
)  # fmt: skip
CASES = {
    "driven, with terms of second order": ((*DRIVEN, *STIFFENED), 1e-3),
    "on a spring": (("joints.crank_hinge.elastic={ reference=[[1.0, 0.0]], stiffness=[inf, 1e5] }",), 5e-3),
    "rigid crank": (("bodies.crank.flexible=false",), 1.5e-3),
    "damped, with friction and weight": (
        ('effects.x={type="structural_damping", stiffness=1e-4, mass=0.3}', 'effects.g={type="gravity"}',
         'effects.f={type="joint_friction", joint="elbow", limit=0.05, speed=0.1}'), 4e-3,
    ),
    "at another radius": (("parameters.r1.value=6e-3",), 2e-3),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_reduced_model_against_the_full_order_one(case: str) -> None:
    """Within 1.5e-3 of the largest force in a joint, where corners of the torque set axial vibrations off; where the
    reduced motion itself is further off, as far as that."""
    added, allowed = CASES[case]
    scene = slider_crank(*BASIS, *ALL, *added)
    driven = [("drive",), ("power",)] if "driven" in case else []
    both = (motion(kind, scene).outputs for kind in ("full", "reduced"))
    assert_groups_alike(*both, allowed, ("pin_x", "pin_y"), ("x", "y"), ("n",), *driven)


@pytest.mark.parametrize("added", [(), STIFFENED])
def test_derivatives_of_forces_are_central_differences(added: tuple[str, ...]) -> None:
    loads = ("parameters.pull={nominal=1.0}", 'effects.motor.scale="pull"', "simulation.duration=0.05")
    model = reduced_model(slider_crank(*BASIS, *ALL, *added, *loads, "reduction.angles=16"))
    # axial accelerations have what Newton's iteration leaves, which terms of second order see
    model.batch = lambda *given, batch=model.batch: ToRoundOff(batch(*given))
    compare(model, SHARES, "pull", "r1")


@pytest.mark.parametrize("kind", ["full", "components", "reduced"])
def test_a_clamped_beam_whose_end_is_off_carries_the_closed_form(kind: str) -> None:
    """Two clamps hold it three times more than is needed; what its end carries is built in."""
    d, phi = 1e-6, 2e-6
    wanted = (*outputs("right", **along("x", "y")), *outputs("right", MOMENT, moment='component="z"'))
    found = motion(kind, clamped_beam(offset("right", place=[0.0, d], turn=[phi]), *wanted)).outputs
    force, moment = clamped_stiffness() @ [d, phi]
    # four elements of first order; the axial force is of second order in the offset,
    # 0.5 % of the other here
    exact = {"x": (0.0, 0.02 * force), "y": (force, 0.1 * force), "moment": (moment, 0.1 * moment)}
    for name, (value, allowed) in exact.items():
        np.testing.assert_allclose(found[name], value, rtol=0, atol=abs(allowed), err_msg=name)


def test_forces_and_moments_of_reduced_models_in_space() -> None:
    """Beams in space under a force that is oblique to their plane and swells."""
    pull = 'effects.w={type="force", point="rod:hinge", direction=[0.1, 0.2, -1.0], table=[[0.0, 0.0], [0.15, 3.0]]}'
    wanted = (*outputs("crank_hinge", **along("x", "y", "z")), *outputs("elbow", radial='component="radial"'))
    moments = outputs("crank_hinge", MOMENT, about_x='component="x", frame="body"', about_y='component="y"')
    short = ("reduction.angles=32", "simulation.duration=0.15", pull)
    scene = slider_crank_of_beams(*BASIS, *short, *wanted, *moments)
    both = (motion(kind, scene).outputs for kind in ("full", "reduced"))
    assert_groups_alike(*both, 5e-3, ("x", "y", "z", "radial"), ("about_x", "about_y"))


def test_polar_diagrams_of_runs() -> None:
    run = motion("full", swinging(*outputs("hinge", **along("x", "y")), "simulation.duration=0.1"))
    assert joint_forces(run) == [Load("hinge", ("x", "y"))]
    axes = loads(run, "forces").axes[0]
    assert axes.get_title(loc="left") == "hinge (N)"
    angle, size = axes.lines[0].get_data()
    np.testing.assert_allclose(size * np.cos(angle), run.outputs["x"], rtol=0, atol=1e-12)
    first = outputs("hinge", **along("x", "y"), a='component="x", of="first"', b='component="y", of="first"')
    both = motion("full", swinging(*first, "simulation.duration=0.01"))
    assert joint_forces(both) == [Load("x, y", ("x", "y")), Load("a, b", ("a", "b"))]
    with pytest.raises(InputError, match="no joint has its forces along x and y"):
        loads(motion("full", swinging("simulation.duration=0.01")), "forces")


def test_arrows_of_forces_in_films() -> None:
    """A pendulum's arrows begin at its hinge and are as long as the legend says; what has none is said."""
    wanted = outputs("hinge", **along("x", "y"), body='component="x", frame="body"', first='component="x", of="first"')
    run = trajectory("full", swinging(*wanted, "simulation.duration=0.1", "simulation.frames=11"))
    (arrow,), without = arrows_of(run)
    assert (arrow.joint, arrow.body) == ("hinge", "arm")
    np.testing.assert_allclose(arrow.place, 0.0, rtol=0, atol=1e-12)
    exact = np.transpose([run.outputs[name][::10] for name in "xy"])
    np.testing.assert_allclose(arrow.force[:, :2], exact, rtol=0, atol=1e-9)
    assert ["body: no arrow of it, as it is" in without[0], "takes outputs x, y" in without[1]] == [True, True]
    shown = motion_of(run, "none")
    number, unit = re.search(r"hinge on arm\): an arrow of ([\d.]+) mm is ([\d.]+) N", shown.forces).groups()
    length = np.linalg.norm(shown.end(arrow) - arrow.place, axis=1)
    np.testing.assert_allclose(length * 1e3 * float(unit) / float(number), np.linalg.norm(exact, axis=1), rtol=1e-9)
    assert 0.05 * 0.4 < length.max() < 0.5 * 0.4 and set(without) <= set(shown.notes)
    red = np.array([int(solids.FORCE[k : k + 2], 16) for k in (1, 3, 5)])
    seen = [np.sum(np.abs(picture - red).max(axis=2) < 12) for picture in solids.images(shown, np.array([10]))]
    assert seen[0] > 200
    # where bodies have points of meshes, the joint is where both always are; a guide's place is not known
    wanted = outputs("elbow", **along("x", "y")) + outputs("slider", sx='component="x"', sy='component="y"')
    short = ("simulation.duration=0.02", "simulation.frames=5")
    run = trajectory("full", load_scene(ROOT / "scenes" / "slider_crank.toml", (*wanted, *short)))
    (elbow,), (why,) = arrows_of(run)
    np.testing.assert_allclose(elbow.place[:, :2], run.frames.positions["rod"][:, 0], rtol=0, atol=1e-9)
    assert why.startswith("slider: no arrow of its force, as the run does not say where")


@pytest.mark.parametrize("named", ['joint="hinge"', 'coordinate="phi"'])
def test_torques_over_speed_are_those_of_a_spin_up(named: str) -> None:
    """Inertia and weight of a pendulum over the speed of its coordinate, the largest marked."""
    spin = 'effects.spin={type="prescribed_motion", coordinate="phi", spin_up={speed=2.0, time=0.4}}'
    drive = f'outputs.drive={{type="drive_torque", {named}}}'
    short = ("simulation.duration=0.5", "simulation.step=2e-3", "simulation.initial={}")
    run = motion("full", swinging(spin, drive, *short))
    curve, largest = loads(run, "torques").axes[0].lines[:2]
    speed, torque = curve.get_data()
    turning = np.gradient(speed, run.time)
    expected = (0.05 + 2.0 * 0.4**2) * turning + 2.0 * GRAVITY * 0.4 * np.cos(run.coordinates[:, 0])
    assert speed[-1] == pytest.approx(2.0, rel=1e-3)
    # a second difference beside a jerk of 300 rad/s3
    np.testing.assert_allclose(torque[1:-1], expected[1:-1], rtol=0, atol=2e-3 * np.abs(torque).max())
    assert largest.get_ydata()[0] == pytest.approx(torque.max(), rel=1e-12)
    with pytest.raises(InputError, match="no output of type drive_torque"):
        loads(motion("full", swinging("simulation.duration=0.01")), "torques")


def test_a_redundant_crank_in_a_reduced_model() -> None:
    """An elliptic trammel with a crank that its guides make redundant: bodies share out what is across it. Along the
    bars the force is of second order in their bending, which a reduced model does not know of joints."""
    scene = trammel(
        *BASIS[:4], "reduction.modes=6", "simulation.duration=0.2", "simulation.step=5e-4",
        *outputs("along_x", guide='component="y"'), *outputs("middle", **along("y")),
        'effects.motor={type="torque", joint="crank_hinge", table=[[0.0, 0.0], [0.1, 1e-3], [1.0, 1e-3]]}',
    )  # fmt: skip
    exact, found = motion("full", scene).outputs, motion("reduced", scene).outputs
    assert_groups_alike(exact, found, 2e-4, [*exact])


def test_estimated_errors_and_lanes_of_forces() -> None:
    """Estimates are within a factor 3 of the error against a full-order run with a tenth of the step; samples side by
    side have what each has by itself, to the last digit but for the order of sums."""
    few = ("simulation.step=1e-3", "simulation.duration=0.3")
    scene = slider_crank(*BASIS, *few, *ALL)
    run = trajectory("reduced", scene)
    exact = motion("full", slider_crank(*BASIS, *few, *ALL, "simulation.step=1e-4")).outputs
    for name, errors in run.errors.outputs.items():
        true = np.abs(run.outputs[name] - exact[name][::10]).max()
        assert true / 3.0 < np.abs(errors).max() < 3.0 * true, (name, true)
    assert_samples_are_those_alone(reduced_model(scene), [7], 1e-10, r1=np.linspace(5.2e-3, 6.0e-3, 11))


def test_models_without_forces_refuse_them() -> None:
    """Without such outputs nothing of them is in a model, and its tables are the same numbers."""
    with_forces, without = rom_of(slider_crank(*BASIS, *ALL)), rom_of(slider_crank(*BASIS))
    assert without.gaps is None
    for name in ("mass", "inertia", "stiffness", "load"):
        np.testing.assert_array_equal(getattr(with_forces.tables, name), getattr(without.tables, name))
    scene = slider_crank(*BASIS, *ALL, "simulation.duration=0.01")
    with pytest.raises(InputError, match=r"outputs.pin_x: .*built without.*pgmp build again"):
        ReducedModel(scene, without)
