"""Rigid bodies by their mass properties: closed forms, Euler's equations, the same body of beams, in every model."""

import numpy as np
import pytest
from alike import assert_alike
from runs import MODELS, history, samples
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.studies.check import describe_scene, summary_of_scene
from pgmp_petsc.studies.plausibility import plausibility
from scenes import HEADER, SLIDER_CRANK, meshes_of, of_text, tables

G = 9.80665


def run(
    scene: Scene, model: str = "full", n: int = 1, **values: np.ndarray
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return times and outputs, shape (n_t, n) each."""
    return history(MODELS[model](scene), samples(scene, n, **values), n)


PENDULUM = HEADER + tables("""
parameters.m: nominal = 2.0; unit = "kg"; distribution = { name = "uniform", loc = 1.0, scale = 3.0 }
parameters.izz: nominal = 0.03; unit = "kg m2"; distribution = { name = "uniform", loc = 0.01, scale = 0.05 }
bodies.drum: rigid = { mass = "m", centre = [0.1, 0.02], inertia = "izz", points = { hub = [0, 0], rim = [0.3, 0.0] } }
joints.hinge: type = "revolute"; connect = ["ground:origin", "drum:hub"]
coordinates.phi: joint = "hinge"; range = [0.0, 6.283185307179586]; periodic = true
effects.weight: type = "gravity"
simulation: duration = 1.0; step = 1e-3
simulation.initial.phi: position = -1.3
outputs.phi: type = "angle"; joint = "hinge"
outputs.x: type = "position"; point = "drum:rim"; axis = "x"
""")


def test_a_physical_pendulum_swings_as_its_equation_says() -> None:
    scene = scene_from_toml(PENDULUM, ".")
    masses, moments = np.array([2.0, 1.5]), np.array([0.03, 0.05])
    time, found = run(scene, n=2, m=masses, izz=moments)
    arm, off = np.hypot(0.1, 0.02), np.arctan2(0.02, 0.1)
    for k, (mass, moment) in enumerate(zip(masses, moments)):
        about = moment + mass * arm**2

        def swing(_, y, mass=mass, about=about):
            return [y[1], -mass * G * arm * np.cos(y[0] + off) / about]

        exact = solve_ivp(swing, (0, 1), [-1.3, 0.0], "DOP853", time, rtol=1e-10, atol=1e-12).y[0]
        # the step's error: a swing of 1.4 Hz in steps of 1 ms
        np.testing.assert_allclose(found["phi"][:, k], exact, rtol=0, atol=2e-5)
        np.testing.assert_allclose(found["x"][:, k], 0.3 * np.cos(found["phi"][:, k]), rtol=0, atol=1e-10)


# A heavy top in gimbals of 1e-7 kg: coordinates are Euler's angles about z, x, z.
INERTIA = (0.02, 0.03, 0.025, 0.003, -0.002, 0.004)
GIMBAL = "rigid = { mass = 1e-7, inertia = [1e-10, 1e-10, 1e-10, 0, 0, 0] }"
TOP = HEADER + tables(
    f"""
parameters.a: nominal = {INERTIA[0]}
parameters.c: nominal = {INERTIA[3]}
bodies.outer: {GIMBAL}
bodies.inner: {GIMBAL}
bodies.top: rigid = {{ mass = 2.0, centre = [0.05, 0.0, 0.1], inertia = ["a", 0.03, 0.025, "c", -0.002, 0.004],
    points = {{ foot = [0, 0, 0], tip = [0, 0, 0.3] }} }}
joints.first: type = "revolute"; connect = ["ground:origin", "outer:centre"]; axis = [0.0, 0.0, 1.0]
joints.second: type = "revolute"; connect = ["outer:centre", "inner:centre"]; axis = [1.0, 0.0, 0.0]
joints.third: type = "revolute"; connect = ["inner:centre", "top:foot"]; axis = [0.0, 0.0, 1.0]
coordinates.alpha: joint = "first"; range = [-7.0, 7.0]
coordinates.beta: joint = "second"; range = [-7.0, 7.0]
coordinates.gamma: joint = "third"; range = [-7.0, 49.0]
effects.weight: type = "gravity"; direction = [0.0, 0.0, -1.0]
simulation: duration = 0.5; step = 2.5e-4
simulation.initial.alpha: position = 0.2
simulation.initial.beta: position = 0.9
simulation.initial.gamma: velocity = 30.0
outputs.x: type = "position"; point = "top:tip"; axis = "x"
outputs.y: type = "position"; point = "top:tip"; axis = "y"
outputs.z: type = "position"; point = "top:tip"; axis = "z"
""".replace("\n    points", " points")
)
top = of_text(TOP)


def tensor(moments) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = moments
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def moments_of(tensor: np.ndarray) -> list[float]:
    return tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist()


def of_point(mass: float, place: np.ndarray) -> np.ndarray:
    """Return the inertia of a point mass about the origin."""
    return mass * (place @ place * np.eye(3) - np.outer(place, place))


def top_motion(time: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Return where the tip is, shape (n_t, 3), by Euler's equations about the foot."""
    mass, centre = 2.0, np.array([0.05, 0.0, 0.1])
    about = inertia + of_point(mass, centre)
    turn = Rotation.from_euler("ZXZ", [0.2, 0.9, 0.0]).as_matrix()

    def rates(_, y):
        r, w = y[:9].reshape(3, 3), y[9:]
        torque = np.cross(centre, r.T @ [0.0, 0.0, -mass * G])
        spin = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.concatenate([(r @ spin).ravel(), np.linalg.solve(about, torque - np.cross(w, about @ w))])

    start = np.concatenate([turn.ravel(), [0.0, 0.0, 30.0]])
    found = solve_ivp(rates, (0, time[-1]), start, "DOP853", time, rtol=1e-11, atol=1e-12).y[:9].reshape(3, 3, -1)
    return 0.3 * found[:, 2].T


def test_a_top_with_products_of_inertia_obeys_eulers_equations() -> None:
    a, c = np.array([0.02, 0.027]), np.array([0.003, -0.005])
    errors = []
    for step in (5e-4, 2.5e-4):
        time, found = run(top(f"simulation.step={step}"), n=2, a=a, c=c)
        places = np.stack([found[key] for key in "xyz"], axis=-1)
        exact = [top_motion(time, tensor((a[k], *INERTIA[1:3], c[k], *INERTIA[4:]))) for k in range(2)]
        errors.append([np.abs(places[:, k] - exact[k]).max() for k in range(2)])
    # turning at 30 rad/s: (w h)^2 / 12 a radian, 0.5 s long
    assert np.max(errors[1]) < 3e-4
    np.testing.assert_allclose(np.divide(*errors), 4.0, rtol=0.15)


# The spatial slider-crank with a rigid box as its rod, whose section is turned by 45 degrees about its axis.
LENGTH, HEIGHT, BREADTH, DENSITY = 0.3, 0.03, 0.01, 7800.0
LINE = (
    'line={length=0.3,elements=2}, element="beam3d", material="steel", orientation=[0.0,1.0,1.0], flexible=false, '
    'section={shape="rectangle",width=0.01,height=0.03}'
)
SPATIAL = HEADER + tables("""
ground.points: bearing = [0.0, 0.1, 0.12]
bodies.crank: line = { length = 0.1, elements = 4 }; element = "beam3d"; material = "steel";
    section = { shape = "rectangle", width = 0.006, height = 0.008 }; orientation = [0.0, 1.0, 0.0];
    placement = { origin = [0.0, 0.1, 0.12], rotation = [0.0, 1.5707963267948966, 0.0] }
bodies.slider: line = { length = 0.05, elements = 1 }; element = "beam3d"; material = "steel"; flexible = false;
    section = { shape = "circle", radius = 0.01 }; placement = { origin = [0.282, 0.0, 0.0] }
joints.crank_hinge: type = "revolute"; connect = ["ground:bearing", "crank:hinge"]; axis = [1.0, 0.0, 0.0]
joints.ball: type = "spherical"; connect = ["crank:tip", "rod:hinge"]
joints.cross: type = "universal"; connect = ["slider:hinge", "rod:tip"]; axis = [0.0, 1.0, 0.0];
    second_axis = [0.0, 0.0, 1.0]
joints.guide: type = "prismatic"; connect = ["ground:origin", "slider:tip"]; axis = [1.0, 0.0, 0.0]
coordinates.theta: joint = "crank_hinge"; range = [0.0, 6.283185307179586]; periodic = true
effects.weight: type = "gravity"; direction = [0.0, -1.0, 0.0]
reduction: modes = 4; static_modes = true; inertia_modes = true; angles = 32
simulation: duration = 0.1; step = 2.5e-4
simulation.initial.theta: velocity = 30.0
outputs.theta: type = "angle"; joint = "crank_hinge"
outputs.bent: type = "deformation"; point = "crank:tip"; axis = "z"; frame = "body"
outputs.tip: type = "position"; point = "rod:tip"; axis = "x"
""")
PLACED = "placement={origin=[0.0,0.1,0.02],rotation=[0.0,0.07,-0.34]}"


def box() -> tuple[float, list[float]]:
    """Return mass and inertia of the box, by ``m (h^2 + b^2) / 12``, turned by 45 degrees about x."""
    mass = DENSITY * LENGTH * HEIGHT * BREADTH
    own = mass / 12.0 * np.diag([HEIGHT**2 + BREADTH**2, LENGTH**2 + BREADTH**2, LENGTH**2 + HEIGHT**2])
    turn = Rotation.from_euler("x", 45.0, degrees=True).as_matrix()
    return mass, moments_of(turn @ own @ turn.T)


def with_rod(mass: object, inertia: object, *more: str) -> Scene:
    """Return the scene with a rod of mass properties, numbers or parameters' names in TOML."""
    points = f"points={{hinge=[0.0,0.0,0.0],tip=[{LENGTH},0.0,0.0]}}"
    rod = f"bodies.rod={{rigid={{mass={mass},centre=[0.15,0.0,0.0],inertia={inertia},{points}}},{PLACED}}}"
    return scene_from_toml(SPATIAL, ".", (rod, *more))


@pytest.mark.parametrize("model", MODELS)
def test_a_box_by_its_mass_properties_is_the_box_of_beams(model: str) -> None:
    mass, moments = box()
    assert abs(moments[5]) > 0.01 * moments[0]
    _, given = run(with_rod(mass, moments), model)
    _, of_beams = run(scene_from_toml(SPATIAL, ".", (f"bodies.rod={{{LINE},{PLACED}}}",)), model)
    assert_alike(of_beams, given, 1e-8)


def test_a_built_model_takes_other_masses_and_inertias_as_a_new_build_does() -> None:
    mass, moments = box()
    names = dict(zip(("m", "xx", "yy", "zz", "yz"), (mass, *moments[:3], moments[5])))
    changed = {"m": 1.3 * mass, "xx": 8 * moments[0], "yy": 1.5 * moments[1], "zz": 1.45 * moments[2], "yz": 0.0}
    parameters = [f"parameters.{name}={{nominal={value}}}" for name, value in names.items()]
    scene = with_rod('"m"', '["xx","yy","zz",0.0,0.0,"yz"]', *parameters)
    values = {name: np.array([value]) for name, value in changed.items()}
    there = with_rod(changed["m"], [changed["xx"], changed["yy"], changed["zz"], 0.0, 0.0, 0.0])
    _, exact = run(there, "full")
    _, same = run(scene, "full", **values)
    _, built_there = run(there, "reduced")
    _, found = run(scene, "reduced", **values)
    for name, values in exact.items():
        np.testing.assert_allclose(same[name], values, rtol=0, atol=1e-9 * np.abs(values).max())
        # as near as a model that is built there: 2 % of the deformation, of modes that are left out
        error, least = (np.abs(part[name] - values).max() for part in (found, built_there))
        assert error < 1.2 * least < 0.03 * np.abs(values).max(), name


# A shaft that a motor turns at constant speed, with a disc whose products of inertia bend it.
ROTOR = HEADER + tables("""
ground.points: right = [0.5, 0.0, 0.0]
parameters.ixz: nominal = 0.0; distribution = { name = "norm", loc = 0.0, scale = 1e-4 }
bodies.shaft: line = { length = 0.5, elements = 6 }; element = "beam3d"; material = "steel";
    section = { shape = "circle", radius = 0.006 }
bodies.disc: rigid = { mass = 1.0, inertia = [5e-3, 2.6e-3, 2.6e-3, 0.0, "ixz", 0.0] };
    placement = { origin = [0.3333333333333333, 0.0, 0.0] }
joints.left: type = "revolute"; connect = ["ground:origin", "shaft:hinge"]; axis = [1.0, 0.0, 0.0]
joints.hub: type = "fixed"; connect = ["shaft:4", "disc:centre"]
joints.right: type = "point_on_line"; connect = ["ground:right", "shaft:tip"]; direction = [1.0, 0.0, 0.0]
coordinates.theta: joint = "left"; range = [0.0, 6.283185307179586]; periodic = true
effects.drive: type = "prescribed_motion"; coordinate = "theta"; spin_up = { speed = 60.0, time = 0.3 }
reduction: modes = 5; static_modes = true; inertia_modes = true; angles = 12
simulation: duration = 0.35; step = 5e-4
outputs.bent: type = "deformation"; point = "shaft:4"; axis = "z"; frame = "body"
""")


def test_an_imbalance_that_is_a_parameter_bends_the_shaft() -> None:
    scene, values = scene_from_toml(ROTOR, "."), {"ixz": np.array([2e-4, -1e-4])}
    full, of_components, reduced = (run(scene, model, 2, **values)[1]["bent"] for model in MODELS)
    largest = np.abs(full).max(axis=0)
    np.testing.assert_allclose(largest[0], 2 * largest[1], rtol=1e-3)
    # a shaft that is clamped on the left and supported on the right, with the couple M = w^2 I_xz at the place a:
    # M / (E I) (a^2 / 2 - (3 / l^3) (a^2 / 2 + a (l - a)) (3 l a^2 - a^3) / 6); the disc resists tilting with 3 % of it
    bending = 210e9 * np.pi / 4 * 0.006**4
    a, l = 1 / 3, 0.5  # noqa: E741
    couple = a**2 / 2 - 3 / l**3 * (a**2 / 2 + a * (l - a)) * (3 * l * a**2 - a**3) / 6
    np.testing.assert_allclose(largest[0], abs(60.0**2 * 2e-4 * couple / bending), rtol=0.05)
    assert np.abs(of_components - full).max() < 1e-3 * largest[0]
    assert np.abs(reduced - full).max() < 0.035 * largest[0]
    stiffened = scene_from_toml(ROTOR, ".", ("reduction.second_order=true",))
    assert np.abs(run(stiffened, "reduced", 2, **values)[1]["bent"] - full).max() < 0.01 * largest[0]


def test_a_flywheel_is_a_mass_with_its_inertia() -> None:
    """A wheel that is fixed to the crank's end, and a point mass there."""
    wheel = (
        'bodies.wheel={rigid={mass=0.5,inertia="izz",points={hub=[0.0,0.0]}},placement={origin=[0.3,0.0]}}',
        'joints.hub={type="fixed",connect=["crank:tip","wheel:hub"]}',
    )
    lump = ('effects.wheel={type="point_mass",point="crank:tip",mass=0.5,inertia="izz"}',)
    spread = ('parameters.izz={nominal=2e-3,distribution={name="uniform",loc=1e-3,scale=4e-3}}',)
    text = SLIDER_CRANK.replace("0.0:0.3:5", "").replace("0.3:1.0:5", "")
    text = text.replace('mesh = ""', "line = { length = 0.3, elements = 5 }", 1)
    text = text.replace('mesh = ""', "line = { length = 0.7, elements = 5, start = 0.3 }")
    outputs = (
        'outputs.theta={type="angle",joint="crank_hinge"}',
        'outputs.bent={type="deformation",point="crank:tip",axis="y",frame="body"}',
        "simulation={duration=0.2,step=1e-3}",
    )
    values = {"izz": np.array([2e-3, 4.5e-3])}
    for model in MODELS:
        found, expected = (
            run(scene_from_toml(text, ".", (*spread, *what, *outputs)), model, 2, **values)[1] for what in (wheel, lump)
        )
        assert_alike(expected, found, 1e-6)


def test_a_thin_disc_carries_a_point_mass() -> None:
    """A flat body has nothing to lend of what a real body must keep; the motion is that of one body with both."""
    load = 'effects.load={type="point_mass",point="top:tip",mass=0.3}'
    disc = "bodies.top={{rigid={{mass={},centre={},inertia={},points={{foot=[0.0,0.0,0.0],tip=[0.0,0.0,0.3]}}}}}}"
    apart, mass = np.array([0.05, 0.0, 0.1]), 2.0
    total, at = mass + 0.3, np.array([0.0, 0.0, 0.3])
    centre = (mass * apart + 0.3 * at) / total
    together = np.diag([0.01, 0.01, 0.02]) + of_point(mass, apart - centre) + of_point(0.3, at - centre)
    scenes = (
        (disc.format(mass, apart.tolist(), [0.01, 0.01, 0.02, 0.0, 0.0, 0.0]), load),
        (disc.format(total, centre.tolist(), moments_of(together)),),
    )
    carrying, one = (top("simulation.duration=0.2", *more) for more in scenes)
    assert "load:mass" in describe_scene(carrying, meshes_of(carrying))
    (_, expected), (_, found) = run(one), run(carrying)
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=0, atol=1e-8)


def test_check_warns_of_inertia_that_samples_may_have_and_no_body_has() -> None:
    wide = 'parameters.c.distribution={name="norm",loc=0.003,scale=0.01}'
    for overrides, n in (((wide,), 1), ((), 0)):
        scene = top(*overrides)
        found = [one for one in plausibility(scene, meshes_of(scene)) if "which samples may have" in one.text]
        assert len(found) == n
        assert all(one.text.startswith("bodies.top.rigid.inertia = [") for one in found)
        assert all("at c = -0.027, which samples may have, is not positive definite" in one.text for one in found)


def test_check_says_the_mass_properties() -> None:
    scene = top()
    meshes = meshes_of(scene)
    said = describe_scene(scene, meshes)
    assert (
        "top: rigid, 2 kg, centre of mass (0.05, 0, 0.1) m, inertia about it (ixx, iyy, izz, ixy, ixz, iyz) "
        "0.02, 0.03, 0.025, 0.003, -0.002, 0.004 kg m2, weights of its mass 1, a, c" in said
    )
    body = summary_of_scene(scene, meshes)["bodies"]["top"]
    assert body["element"] == "rigid" and body["mass"] == 2.0 and body["centre"] == [0.05, 0.0, 0.1]
    np.testing.assert_allclose(body["inertia"], tensor(INERTIA), rtol=1e-12, atol=1e-18)
