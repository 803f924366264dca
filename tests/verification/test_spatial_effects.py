"""Effects in space in the full-order model: closed forms, scipy, the same scene in the plane, the energy balance."""

import numpy as np
import pytest
from effect_scenes import turning
from runs import motion, with_step
from scipy.spatial.transform import Rotation
from spatial import WIDTH, assembled, table

from pgmp_petsc.results import Trajectory
from pgmp_petsc.scene import Scene, scene_from_toml
from scenes import HEADER, STEEL, tables

LENGTH = 0.5
AXIS = np.array([0.48, -0.6, 0.64])  # of the hinge; the bar is at a right angle to it
MASS = STEEL["rho"] * WIDTH**2 * LENGTH
INERTIA = MASS * (LENGTH**2 / 3 + WIDTH**2 / 12)
ALONG = np.cross(AXIS, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(AXIS, [0.0, 0.0, 1.0]))
TURN = np.column_stack([ALONG, np.cross(AXIS, ALONG), AXIS])  # of the bar at angle 0


def bar(duration: float, step: float, *more: str, **initial: float) -> Scene:
    """Return a rigid bar on a hinge whose axis is along no axis of the ground."""
    rotation = Rotation.from_matrix(TURN).as_rotvec()
    return assembled(
        f'[bodies.bar]\nmesh = "0.0:{LENGTH}:1"\nelement = "solid3d"\nmaterial = "steel"\nflexible = false\n',
        table("bodies.bar.placement", origin=(0.0, 0.0, 0.0), rotation=rotation),
        table("ground.points", anchor=(0.3, 0.4, -0.2)),
        table("joints.drive", type="revolute", connect=["ground:origin", "bar:hinge"], axis=AXIS),
        table("simulation", duration=duration, step=step, spectral_radius=1.0),
        table("simulation.initial.theta", **initial), table("outputs.angle", type="angle", joint="drive"),
        table("outputs.length", type="distance", points=["ground:anchor", "bar:tip"]), *more,
    )  # fmt: skip


def run(scene: Scene) -> Trajectory:
    return motion("full", scene)


def tip(angle: float) -> np.ndarray:
    return LENGTH * (np.cos(angle) * TURN[:, 0] + np.sin(angle) * TURN[:, 1])


def test_a_torsional_oscillator_about_an_axis_in_space() -> None:
    """``J theta'' + c theta' + k (theta - rest) = 0``, from beyond a whole turn: angles count turns."""
    k, c, rest, start = 40.0, 0.3, 6.0, 7.5
    spring = table("effects.extra", type="spring_damper", joint="drive", stiffness=k, damping=c, rest=rest)
    found = run(bar(1.0, 1e-3, spring, position=start))
    decay = c / (2 * INERTIA)
    omega = np.sqrt(k / INERTIA - decay**2)
    t = found.time
    expected = rest + (start - rest) * np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
    # the trapezoidal rule: (omega h)^2 / 12 of the phase, over 10 rad
    np.testing.assert_allclose(found.outputs["angle"], expected, rtol=0, atol=3e-3)


EFFECTS = {
    "damping": (table("effects.extra", type="joint_damping", joint="drive", coefficient=0.4),
        lambda t, angle, speed: -0.4 * speed,),
    "friction": (table("effects.extra", type="joint_friction", joint="drive", limit=0.5, speed=0.3),
        lambda t, angle, speed: -0.5 * np.tanh(speed / 0.3),),
    "spring between points": (
        table("effects.extra", type="spring_damper", points=["ground:anchor", "bar:tip"], stiffness=60.0, damping=2.0,
        rest=0.2), lambda t, angle, speed: _pull(angle, speed, 60.0, 2.0, 0.2),),
    **{
        f"stop with a damping of {damping}": (
            table("effects.extra", type="end_stop", joint="drive", upper=0.5, stiffness=500.0, damping=damping),
            lambda t, angle, speed, c=damping: -500.0 * max(angle - 0.5, 0.0) * max(1.0 + c * speed, 0.0),
        )
        for damping in (0.0, 0.2)
    },
    "following force": (
        table("effects.extra", type="force", point="bar:tip", direction=(0.3, 1.0, 0.0), table=[[0, 2.0], [1, 2.0]])
        .replace("[effects.extra]\n", "[effects.extra]\nfollows = true\n"),
        lambda t, angle, speed: 2.0 * LENGTH / np.hypot(0.3, 1.0),),
    "pulling force": (
        table("effects.extra", type="force", point="bar:tip", towards="ground:anchor", table=[[0, 2.0], [1, 2.0]]),
        lambda t, angle, speed: _pull(angle, 0.0, 0.0, 0.0, 0.0, 2.0),),
    "force on a point of a rigid body": (
        table("effects.extra", type="force", point="bar:tip", direction=(0.0, 3.0, 0.0), table=[[0, 2.0], [1, 2.0]]),
        lambda t, angle, speed: AXIS @ np.cross(tip(angle), [0.0, 2.0, 0.0]),),
    "torque": (table("effects.extra", type="torque", joint="drive", table=[[0, 1.0], [1, 1.0]]),
        lambda t, angle, speed: 1.0,),
    "bushing": (table("effects.extra", type="bushing", points=["ground:anchor", "bar:tip"],
        reference=[[1.0, 0.2, 0.0], [0.0, 1.0, 0.5]], stiffness=(6.0, 12.0, 3.0), damping=(0.5, 0.0, 1.0)),
        lambda t, angle, speed: _mount(angle, speed),),
}  # fmt: skip
ANCHOR = np.array([0.3, 0.4, -0.2])


def _pull(angle: float, speed: float, k: float, c: float, rest: float, force: float = 0.0) -> float:
    away = tip(angle) - ANCHOR
    e = away / np.linalg.norm(away)
    rate = e @ np.cross(AXIS * speed, tip(angle))
    size = k * (np.linalg.norm(away) - rest) + c * rate + force
    return float(AXIS @ np.cross(tip(angle), -size * e))


def _mount(angle: float, speed: float) -> float:
    first = np.array([1.0, 0.2, 0.0]) / np.hypot(1.0, 0.2)
    second = np.array([0.0, 1.0, 0.5]) - first * (first @ [0.0, 1.0, 0.5])
    second /= np.linalg.norm(second)
    axes = np.array([first, second, np.cross(first, second)])
    away, rate = axes @ (tip(angle) - ANCHOR), axes @ np.cross(AXIS * speed, tip(angle))
    return float(AXIS @ np.cross(tip(angle), -axes.T @ ([6.0, 12.0, 3.0] * away + [0.5, 0.0, 1.0] * rate)))


@pytest.mark.parametrize("name", EFFECTS)
def test_effects_on_a_bar_about_an_axis_in_space(name: str) -> None:
    effect, torque = EFFECTS[name]
    errors, balances = [], []
    for step in (2e-3, 1e-3) if "stop" in name else (4e-3, 2e-3):
        found = run(bar(0.3, step, effect, position=0.4, velocity=3.0))
        expected = turning(torque, found.time, 0.4, 3.0, INERTIA)
        errors.append(np.abs(found.outputs["angle"] - expected).max())
        balances.append(np.abs(found.balance.residual).max() / found.balance.exchanged)
        lengths = [np.linalg.norm(tip(angle) - ANCHOR) for angle in found.outputs["angle"]]
        np.testing.assert_allclose(found.outputs["length"], lengths, rtol=1e-9)
    assert errors[1] < 2e-3
    for coarse, fine in (errors, balances):
        assert fine < 1e-9 or 3.5 < coarse / fine < (5.0 if "stop" in name else 4.5), (errors, balances)
    assert name == "torque" or np.abs(found.balance.work["extra"]).max() > 1e-3


CRANK, ROD = 0.3, 0.7
DENSITY = STEEL["rho"] * WIDTH**2
ALL = {
    "motor": 'type="torque", joint="crank_hinge", table=[[0.0, 0.0], [0.1, 3.0]]',
    "oil": 'type="joint_damping", joint="elbow", coefficient=0.1',
    "rub": 'type="joint_friction", joint="slider", limit=1.0, speed=0.3',
    "spring": 'type="spring_damper", joint="slider", stiffness=100.0, damping=0.5, rest=0.8',
    "coil": 'type="spring_damper", joint="elbow", stiffness=1.0, rest=-0.5',
    "rope": 'type="spring_damper", points=["ground:post", "rod:tip"], stiffness=50.0, rest=0.8',
    "stop": 'type="end_stop", joint="slider", lower=0.85, stiffness=3e4, damping=0.1',
    "jet": 'type="force", point="crank:tip", direction=[0.3, 1.0], follows=true, table=[[0.0, 0.0], [0.1, 4.0]]',
    "pull": 'type="force", point="crank:tip", towards="ground:post", table=[[0.0, 1.0], [1.0, 1.0]]',
    "push": 'type="force", point="rod:tip", direction=[-1.0, 0.5], table=[[0.0, 1.0], [1.0, 1.0]]',
    "mount": 'type="bushing", points=["ground:post", "crank:tip"], reference=[[1.0, 0.5]], stiffness=[30.0, 10.0], '
             'damping=[0.1, 0.2]',
    "weight": 'type="gravity", direction=[0.0, -1.0]',
}  # fmt: skip
IN_SPACE = {
    "direction=[0.3, 1.0]": "direction=[0.3, 1.0, 0.0]", "direction=[-1.0, 0.5]": "direction=[-1.0, 0.5, 0.0]",
    "direction=[0.0, -1.0]": "direction=[0.0, -1.0, 0.0]",
    "reference=[[1.0, 0.5]]": "reference=[[1.0, 0.5, 0.0], [-0.5, 1.0, 0.0]]", "[30.0, 10.0]": "[30.0, 10.0, 7.0]",
    "damping=[0.1, 0.2]": "damping=[0.1, 0.2, 3.0], turning_stiffness=[2.0, 3.0, 0.0]",
}  # fmt: skip
OUTPUTS = tables("""
outputs.angle: type = "angle"; joint = "crank_hinge"
outputs.elbow: type = "angle"; joint = "elbow"
outputs.slide: type = "sliding"; joint = "slider"
outputs.length: type = "distance"; points = ["ground:post", "rod:tip"]
coordinates.theta: joint = "crank_hinge"; range = [0.0, 6.283185307179586]; periodic = true
simulation: duration = 0.05; step = 1e-3; spectral_radius = 0.99
simulation.initial.theta: position = 0.3; velocity = 2.0
""")
BODIES = {
    2: 'line = {{ length = {0}, elements = 2 }}; element = "beam2d"; section = {{ shape = "coefficients", axial = 1.0, '
    f"shear = 1.0, bending = 1.0, line_density = {DENSITY}, rotary_density = {DENSITY * WIDTH**2 / 12} }}}}",
    3: 'mesh = "0.0:{0}:2"; element = "solid3d"; material = "steel"',
}


def rigid_slider_crank(dimension: int) -> Scene:
    """Return a rigid slider-crank under all of these effects, in the plane or given in space."""
    space = dimension == 3
    away, axis = ([0.0], "; axis = [0.0, 0.0, 1.0]") if space else ([], "")
    text = HEADER + tables(f"""
ground.points: post = {[0.1, 0.4, *away]}
bodies.crank: {BODIES[dimension].format(CRANK)}; flexible = false
bodies.rod: {BODIES[dimension].format(ROD)}; flexible = false; placement = {{ origin = {[CRANK, 0.0, *away]} }}
joints.crank_hinge: type = "revolute"; connect = ["ground:origin", "crank:hinge"]{axis}
joints.elbow: type = "revolute"; connect = ["crank:tip", "rod:hinge"]{axis}
joints.slider: type = "point_on_line"; connect = ["ground:origin", "rod:tip"]; direction = {[1.0, 0.0, *away]}
""")
    effects = "\n[effects]\n" + "".join(f"{name} = {{ {entries} }}\n" for name, entries in ALL.items())
    for before, after in IN_SPACE.items() if space else ():
        effects = effects.replace(before, after)
    return scene_from_toml(text + effects + OUTPUTS, ".")


def test_a_planar_scene_given_in_space_moves_as_in_the_plane() -> None:
    """Steps in angles and in directors differ by the square of the step, which is extrapolated away."""
    plane, space, names = rigid_slider_crank(2), rigid_slider_crank(3), list(ALL)
    away: dict[str, list[np.ndarray]] = {}
    for step, every in ((5e-4, 1), (2.5e-4, 2)):
        expected, found = (run(with_step(scene, step)) for scene in (plane, space))
        for name, values in expected.outputs.items():
            away.setdefault(name, []).append((found.outputs[name] - values)[::every])
        for name in names:
            work = found.balance.work[name] - expected.balance.work[name]
            away.setdefault(f"work of {name}", []).append(work[::every])
    for name, (coarse, fine) in away.items():
        np.testing.assert_allclose(4.0 / 3.0 * fine - coarse / 3.0, 0.0, atol=1e-8, err_msg=name)
    assert np.ptp(expected.outputs["angle"]) > 0.05


@pytest.mark.parametrize("number", range(3))
def test_a_bushing_resists_rotations_about_all_its_axes(number: int) -> None:
    """The hinge's axis is each axis of the reference in turn: the couple is that of the sine of the angle."""
    reference = np.roll(TURN, number + 1, axis=1)  # the hinge's axis is the last column of TURN
    stiffness, damping = 3.0 * np.eye(3)[number], 0.05 * np.eye(3)[number]
    mount = table("effects.extra", type="bushing", points=["ground:origin", "bar:hinge"], reference=reference.T[:2],
                  turning_stiffness=stiffness, turning_damping=damping)  # fmt: skip
    found = run(bar(0.3, 1e-3, mount, position=0.8))
    expected = turning(
        lambda t, s, v: -np.cos(s) * (3.0 * np.sin(s) + 0.05 * np.cos(s) * v), found.time, 0.8, 0.0, INERTIA
    )
    assert np.ptp(expected) > 0.8
    np.testing.assert_allclose(found.outputs["angle"], expected, rtol=0, atol=2e-3)
