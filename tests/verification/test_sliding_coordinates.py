"""What slides: coordinates of joints that slide, and a mass that rides on a beam that bends."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import pytest
from alike import assert_alike
from conftest import ROOT
from exported import assert_same_in_c, needs_compiler
from machine_scenes import MODELS, RAIL_MASS, cart, cart_errors, rail, run
from refusals import cases, check_said, refusal
from runs import assert_close, motion, reduced_model
from scipy.integrate import solve_ivp

from pgmp_petsc.c_export.constants import constants_of
from pgmp_petsc.c_export.fmu import variables_of
from pgmp_petsc.scene import Scene, load_scene, scene_from_toml
from pgmp_petsc.studies.check import summary_of_scene
from scenes import meshes_of, pendulum, tables

START = ("simulation.initial.x.velocity=0.3", "simulation.initial.swing.velocity=-2.0")
PUSHED = ('effects.push={type="force",joint="rail",table=[[0.0,0.0],[0.1,8.0],[0.2,-4.0]]}',)
DAMPED = (
    'effects.rub={type="joint_damping",joint="rail",coefficient=3.0}',
    'effects.held={type="spring_damper",joint="rail",stiffness=60.0}',
)


def push(t: float, x: float, phi: float, v: float, w: float) -> float:
    return float(np.interp(t, [0.0, 0.1, 0.2], [0.0, 8.0, -4.0])) - 3.0 * v - 60.0 * x


def test_a_rigid_cart_and_pole_follow_their_equations_of_motion() -> None:
    """Both coordinates, with a force along the rail, a damper and a spring; errors fall as the square of the step."""
    errors = cart_errors((*START, *PUSHED, *DAMPED), (0.0, 0.0, 0.3, -2.0), push)(4e-3, 2e-3, 1e-3)
    np.testing.assert_allclose(errors[:-1] / errors[1:], 4.0, atol=0.3)
    assert np.all(errors[-1] < [1.5e-6, 3e-5])


def test_all_models_agree_on_a_flexible_pole() -> None:
    scene = cart(*START, *PUSHED, *DAMPED)
    (_, full), (_, components), (_, reduced) = (run(scene, model) for model in MODELS)
    # in a basis with the static answers of the pole
    assert_close(full, reduced, components, x=1e-4, swing=1e-4, bent=0.02)
    assert np.abs(full["bent"]).max() > 1e-5


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("model", MODELS)
def test_a_rail_with_a_spring_and_a_damper_is_an_oscillator(model: str, dimension: int) -> None:
    """A stiff arm of mass m: x = v / w sin(w t) exp(-d t)."""
    scene = rail(
        'effects.held={type="spring_damper",joint="rail",stiffness=400.0,damping=4.0}',
        "simulation.initial.x.velocity=1.0", "materials.steel.E=2e13", "simulation.step=5e-4",
        "simulation.duration=0.2", dimension=dimension,
    )  # fmt: skip
    times, found = run(scene, model)
    decay = 4.0 / (2.0 * RAIL_MASS)
    rate = np.sqrt(400.0 / RAIL_MASS - decay**2)
    exact = np.exp(-decay * times) * np.sin(rate * times) / rate
    # (w h)^2 / 12 of w t, and the arm's first bending, 2e3 times as stiff
    np.testing.assert_allclose(found["x"], exact, rtol=0, atol=2e-4 * np.abs(exact).max())
    np.testing.assert_allclose(np.gradient(found["x"], times)[2:-2], found["v"][2:-2], rtol=0, atol=2e-3)


EFFECTS = {
    "force": 'effects.one={type="force",joint="rail",harmonic={amplitude=20.0,frequency_hz=4.0}}',
    "friction": 'effects.one={type="joint_friction",joint="rail",limit=6.0,speed=0.02}',
    "stop": 'effects.one={type="end_stop",joint="rail",upper=0.03,stiffness=2e4,damping=0.2}',
    "driven": 'effects.one={type="prescribed_motion",coordinate="x",harmonic={amplitude=0.1,frequency_hz=5.0}}',
}


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("effect", EFFECTS)
def test_effects_act_on_what_slides(effect: str, dimension: int) -> None:
    moving = () if effect == "driven" else ("simulation.initial.x.velocity=0.5",)
    scene = rail(EFFECTS[effect], *moving, "simulation.step=5e-4", "simulation.duration=0.2", dimension=dimension)
    (_, full), (_, components), (_, reduced) = (run(scene, model) for model in MODELS)
    assert_close(full, reduced, components, x=1e-4, tip=0.02 if effect == "stop" else 0.01)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("coordinates", ["free", "held"])
def test_what_slides_hangs_in_equilibrium(model: str, coordinates: str) -> None:
    """Free on a spring it hangs at -m g / k; held it stays, and falls when it is let go."""
    scene = rail(
        'effects.held={type="spring_damper",joint="rail",stiffness=200.0}',
        'effects.weight={type="gravity",direction=[0.0,-1.0,0.0]}',
        f'initial={{equilibrium=true,coordinates="{coordinates}"}}', "simulation.duration=0.05",
    )  # fmt: skip
    _, found = run(scene, model)
    hanging = -RAIL_MASS * 9.80665 / 200.0
    if coordinates == "free":
        np.testing.assert_allclose(found["x"], hanging, rtol=1e-6)
    else:
        assert abs(found["x"][0]) < 1e-8
        rate = np.sqrt(200.0 / RAIL_MASS)
        np.testing.assert_allclose(found["x"][-1], hanging * (1.0 - np.cos(rate * 0.05)), rtol=5e-3)
    assert np.abs(found["tip"][0]) > 1e-6


def test_the_distance_of_two_points_is_a_coordinate() -> None:
    """A bar that a cylinder would lift: the same motion as with the angle of its hinge."""
    own = (
        "bodies.arm.section.radius=5e-3", 'effects.weight={type="gravity"}', "simulation.duration=0.2",
        "reduction.angles=24", "reduction.static_modes=true", 'outputs.angle={type="angle",joint="hinge"}',
        'outputs.tip={type="position",point="arm:tip",axis="y"}', "ground.points={foot=[0.2,-0.6]}",
    )  # fmt: skip
    angle = pendulum("coordinates={phi={joint='hinge',range=[-0.8,0.6]}}", *own)
    cylinder = pendulum(
        "coordinates={length={points=['ground:foot','arm:tip'],range=[0.5,1.4]}}",
        "simulation.initial={length={position=1.0}}", *own,
    )  # fmt: skip
    for model, allowed in (("full", 1e-9), ("reduced", 2e-3)):
        (_, one), (_, other) = (run(scene, model) for scene in (angle, cylinder))
        assert_alike(one, other, allowed)


def test_files_and_summaries_have_the_coordinate_in_metres() -> None:
    scene = cart("simulation.duration=0.01", "reduction.angles=6")
    reduced = reduced_model(scene)
    full = motion("full", scene)
    for trajectory in (full, motion(reduced)):
        assert trajectory.coordinate_units == {"x": "m", "swing": "rad"}
    units = {name: one["unit"] for name, one in summary_of_scene(scene, meshes_of(scene))["coordinates"].items()}
    assert units == trajectory.coordinate_units
    variables = {one.name: one.unit for one in variables_of(constants_of(reduced, "it"))}
    assert [variables[name] for name in ("states.x", "rates.x", "der(rates.x)", "states.swing")] == [
        "m", "m/s", "m/s2", "rad"
    ]  # fmt: skip


@needs_compiler
@pytest.mark.usefixtures("short_tables")
def test_a_model_in_c_slides(tmp_path: Path) -> None:
    assert_same_in_c(reduced_model(rail(EFFECTS["stop"], "simulation.initial.x.velocity=0.5")), tmp_path)


LENGTH, WIDTH, HEIGHT, E, RHO, MASS, INERTIA, BASE, GRAVITY = 2.0, 0.04, 0.02, 210e9, 7800.0, 5.0, 1e-4, 0.04, 9.81
# places of both wheels; what makes y and r of the trolley of theirs, and masses and pulls of these
WHEELS, OF_WHEELS = np.array([[0.0], [BASE]]), np.array([[0.5, 0.5], [-1.0 / BASE, 1.0 / BASE]])
MASSES, PULLS = np.array([MASS, INERTIA]), np.array([GRAVITY, 0.0])
PLANE = tables("""
scene: name = "moving_mass"
ground.points: left = [0.0, 0.0]; right = [2.0, 0.0]
materials.steel: E = 210e9; nu = 0.3; rho = 7800.0
bodies.beam: line = { length = 2.0, elements = 16 }; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.04, height = 0.02 }
bodies.trolley: placement = { origin = [0.3, 0.0] };
    rigid = { mass = 5.0, centre = [0.0, 0.0], inertia = 1e-4, points = { rear = [-0.02, 0.0], front = [0.02, 0.0] } }
joints.left: type = "revolute"; connect = ["ground:left", "beam:hinge"]
joints.right: type = "point_on_line"; connect = ["ground:right", "beam:tip"]; direction = [1.0, 0.0]
joints.rear: type = "point_on_beam"; connect = ["beam:hinge", "trolley:rear"]; direction = [1.0, 0.0]
joints.front: type = "point_on_beam"; connect = ["beam:hinge", "trolley:front"]; direction = [1.0, 0.0]
coordinates.x: joint = "rear"; motion = "sliding"; range = [0.05, 1.9]
effects.weight: type = "gravity"; acceleration = 9.81; direction = [0.0, -1.0]
effects.stiffening: type = "geometric_stiffening"
effects.shapes: type = "mode_inertia"
reduction: modes = 4; angles = 40; static_modes = true; inertia_modes = true; interpolation = "spline"
simulation: duration = 0.33; step = 5.5e-4
outputs.middle: type = "position"; point = "beam:middle"; axis = "y"
outputs.wheel: type = "position"; point = "trolley:rear"; axis = "y"
outputs.way: type = "position"; point = "trolley:rear"; axis = "x"
""")
# in space a third point holds the trolley upright, and the hinge holds the beam's turning about itself
SPACE = (
    PLANE.replace("0.0]", "0.0, 0.0]")
    .replace("beam2d", "beam3d")
    .replace('steel"\nsection', 'steel"\norientation = [0.0, 1.0, 0.0]\nsection')
    .replace("direction = [0.0, -1.0]", "direction = [0.0, -1.0, 0.0]")
    .replace("inertia = 1e-4", "inertia = [1e-4, 1e-4, 1e-4, 0.0, 0.0, 0.0]")
    .replace("points = { rear", "points = { arm = [0.0, 0.1, 0.0], rear")
    .replace('type = "revolute"', 'type = "revolute"\naxis = [0.0, 0.0, 1.0]')
) + tables("""
joints.upright: type = "point_on_plane"; connect = ["beam:hinge", "trolley:arm"]; normal = [0.0, 0.0, 1.0]
""")
STARTED = ("simulation.initial.x={position=0.1,velocity=5.0}",)


def moving(*overrides: str, space: bool = False) -> Scene:
    return scene_from_toml(SPACE if space else PLANE, ".", overrides)


@dataclass(frozen=True)
class Supported:
    """The beam in n sine shapes, with shear and rotary inertia to their first order, and the trolley."""

    n: int = 9

    @cached_property
    def wave(self) -> np.ndarray:
        return np.arange(1, self.n + 1) * np.pi / LENGTH

    @cached_property
    def mass(self) -> np.ndarray:
        return RHO * WIDTH * HEIGHT * LENGTH / 2 * (1 + self.wave**2 * HEIGHT**2 / 12)

    @cached_property
    def stiffness(self) -> np.ndarray:
        bending, shear = E * WIDTH * HEIGHT**3 / 12, 5 / 6 * E / 2.6 * WIDTH * HEIGHT
        return bending * self.wave**4 * LENGTH / 2 / (1 + bending * self.wave**2 / shear)

    @cached_property
    def weight(self) -> np.ndarray:
        return -RHO * WIDTH * HEIGHT * GRAVITY * (1 - np.cos(self.wave * LENGTH)) / self.wave

    @cached_property
    def inertia(self) -> np.ndarray:
        return np.diag(np.append(self.mass, MASS))

    def at(self, x: float) -> np.ndarray:
        """Return y and r with their first and second derivatives in x for units of q, shape (2, 3, n)."""
        k, places = self.wave, self.wave * (x + WHEELS)
        sines = np.sin(places)
        return (OF_WHEELS @ np.hstack([sines, k * np.cos(places), -k * k * sines])).reshape(2, 3, self.n)

    def static(self, x: float) -> np.ndarray:
        return (self.weight - MASS * GRAVITY * self.at(x)[0][0]) / self.stiffness

    def rates(self, _: float, state: np.ndarray) -> np.ndarray:
        q, p, (x, v), n = state[: self.n], state[self.n : 2 * self.n], state[-2:], self.n
        shapes, first, second = self.at(x).swapaxes(0, 1)
        slopes = np.column_stack([shapes, first @ q])
        force = np.append(self.weight - self.stiffness * q, 0.0)
        force -= (MASSES * (PULLS + 2 * v * (first @ p) + v * v * (second @ q))) @ slopes
        found = np.linalg.solve(self.inertia + (MASSES * slopes.T) @ slopes, force)
        return np.concatenate([p, found[:n], [v, found[n]]])

    def motion(self, times: np.ndarray) -> dict[str, np.ndarray]:
        start = np.concatenate([np.zeros(2 * self.n), [0.1, 5.0]])
        # to 1e-7 of the sag: these equations are stiff, and this is the method of fewest evaluations
        found = solve_ivp(self.rates, (0.0, times[-1]), start, method="DOP853", t_eval=times, rtol=1e-6, atol=1e-8).y
        wheel = np.array([np.sin(self.wave * x) @ q for x, q in zip(found[-2], found[: self.n].T)])
        return {"middle": np.sin(self.wave * LENGTH / 2) @ found[: self.n], "wheel": wheel, "way": found[-2]}


@lru_cache(maxsize=None)
def exact_motion(end: float, n: int) -> dict[str, np.ndarray]:
    """Return the motion at n instants up to an end, which all runs here share."""
    return Supported().motion(np.linspace(0.0, end, n))


@lru_cache(maxsize=None)
def errors(model: str, elements: int, space: bool = False) -> dict[str, float]:
    """Return the largest errors of a run over those of the outputs, of the way as a part of the deflection too."""
    # in space two of the first six modes are across the plane
    enough = ("reduction.modes=6", "reduction.angles=80") if space else ()
    scene = moving(*STARTED, f"bodies.beam.line.elements={elements}", *enough, space=space)
    times, found = run(scene, model)
    exact = exact_motion(times[-1], len(times))
    sag = np.abs(exact["middle"]).max()
    return {name: np.abs(found[name] - exact[name]).max() / sag for name in exact}


@pytest.mark.parametrize("model", MODELS)
def test_the_trolley_bends_the_beam_at_every_place(model: str) -> None:
    """Errors fall with the square of the elements' length, wherever in an element the wheels are."""
    shares = []
    for elements in (8, 16):
        shares.append([])
        for x in (0.3, 0.71, 0.96875, 1.333):
            scene = moving(
                "initial={equilibrium=true,coordinates='held'}", f"simulation.initial.x.position={x}",
                f"bodies.beam.line.elements={elements}", "simulation.duration=1e-3", "simulation.step=5e-4",
            )  # fmt: skip
            _, found = run(scene, model)
            q = Supported(200).static(x)
            exact = {s: np.sin(Supported(200).wave * s) @ q for s in (LENGTH / 2, x)}
            shares[-1] += [found["middle"][0] / exact[LENGTH / 2] - 1, found["wheel"][0] / exact[x] - 1]
    coarse, fine = np.abs(shares)
    np.testing.assert_allclose(coarse / fine, 4.0, atol=0.3)
    assert fine.max() < 7e-3


def test_the_moving_mass_follows_its_modal_equations() -> None:
    """Of second order in the elements' length, full-order; the way of the trolley, which the slope drives, too."""
    found = [errors("full", elements) for elements in (8, 16, 32)]
    for name, share in (("middle", 8e-3), ("wheel", 5e-3), ("way", 5e-4)):
        ratios = [coarse[name] / fine[name] for coarse, fine in zip(found, found[1:])]
        # what the modal equations leave out, shear and rotary inertia beyond their first order, is a tenth of the last
        assert all(3.4 < ratio < 5.2 for ratio in ratios), (name, ratios)
        assert found[-1][name] < share


@pytest.mark.parametrize(("model", "space"), [(m, space) for space in (False, True) for m in MODELS])
def test_all_models_agree_on_the_moving_mass(model: str, space: bool) -> None:
    """With the same elements, what the models differ by is hundredths of the mesh's own error."""
    elements = 8 if space else 16
    full, found = errors("full", elements), errors(model, elements, space)
    for name in full:
        assert found[name] == pytest.approx(full[name], abs=1e-3), name


@pytest.mark.parametrize("model", MODELS)
def test_the_wheels_carry_the_trolley(model: str) -> None:
    """Half of its weight each at rest, whichever nodes they press on."""
    pressed = (f'outputs.{name}={{type="joint_force",joint="{name}",component="y"}}' for name in ("rear", "front"))
    held = ("initial={equilibrium=true,coordinates='held'}", "simulation.initial.x.position=0.71")
    _, found = run(moving(*held, *pressed, "simulation.duration=1e-3", "reduction.angles=16"), model)
    for name in ("rear", "front"):
        # the trolley is let go on a slope of 4e-3, whose square is what changes
        np.testing.assert_allclose(found[name][0], MASS * GRAVITY / 2, rtol=5e-5)


def test_the_bridge_crane_reduced_and_full_order() -> None:
    """Trolley, girder and load over the first 3 s; of the stress the nodes' own forces are the rest."""
    scene = load_scene(ROOT / "scenes" / "bridge_crane.toml", ("simulation.duration=3.0",))
    full, reduced = motion("full", scene), motion(reduced_model(scene))
    assert_close(full.outputs, reduced.outputs, sag=1e-3, trolley=1e-3, swing=1e-3, stress=1e-2)


SHORT = "simulation.duration=0.1", "coordinates.x.range=[0.05,0.8]", "reduction.angles=32"  # as near as 80 of the beam


def test_reduced_runs_in_space_are_those_of_the_plane() -> None:
    """The first six modes in space have the plane's four among them, and the other two do not move: round-off is left,
    80 configurations being enough for both sets to be continued alike."""
    plane = motion("reduced", moving(*STARTED, *SHORT)).outputs
    space = motion("reduced", moving(*STARTED, *SHORT, "reduction.modes=6", space=True)).outputs
    sag = np.abs(plane["middle"]).max()
    for name, own in plane.items():
        np.testing.assert_allclose(space[name], own, rtol=0, atol=1e-8 * sag, err_msg=name)


def test_an_oblique_weight_bends_the_beam_both_ways() -> None:
    """Reduced against full order, whose difference is of the modes that are left out."""
    aside = 'outputs.aside={type="position",point="trolley:rear",axis="z"}'
    weight = "effects.weight.direction=[0.1,-0.8,0.6]"
    oblique = *STARTED, *SHORT, weight, "reduction.modes=7", "bodies.beam.line.elements=8", aside
    full, reduced = (motion(model, moving(*oblique, space=True)).outputs for model in ("full", "reduced"))
    assert min(np.abs(full[name]).max() for name in ("middle", "wheel", "aside")) > 1e-4
    assert_close(full, reduced, middle=3e-3, wheel=3e-3, aside=3e-3)


REFUSED = """
joints.rear.connect=["ground:left", "trolley:rear"] -> = ["ground:left", "trolley:rear"]: a point of a beam | ground
joints.rear.connect=["trolley:rear", "beam:hinge"] -> = ["trolley:rear", "beam:hinge"]: a point of a beam is needed
joints.rear.elastic={reference=[[1.0, 0.0]], stiffness=[0.0, 1e6]} -> joints.rear.elastic: this joint is rigid
joints.rear.offset={place=[0.0, 1e-4]} -> joints.rear.offset: this joint is rigid and where it should be
joints.rear.direction=[1.0, 1.0] -> joints.rear: no nodes of beams are beside this point of beam
coordinates.x.range=[0.05, 2.1] -> = [0.05, 2.1]: must be within the run of nodes, 0 to 2 m from the first point
coordinates.x.range=[-0.1, 1.5] -> = [-0.1, 1.5]: must be within the run of nodes
"""


@pytest.mark.parametrize(("asked", "said"), cases(REFUSED))
def test_what_cannot_be_ridden_is_refused(asked: str, said: str) -> None:
    check_said(refusal(lambda: MODELS["full"](moving(*STARTED, asked))), said, asked)
