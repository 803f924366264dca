"""Coordinates that slide, or are distances: in every model, against independent integrations and closed forms."""

from pathlib import Path

import numpy as np
import pytest
from exported import assert_same_in_c, needs_compiler
from machine_scenes import MODELS, RAIL_MASS, RIGID, CartAndPole, cart, rail, run
from runs import assert_close, motion, reduced_model

from pgmp_petsc.c_export.constants import constants_of
from pgmp_petsc.c_export.fmu import variables_of
from pgmp_petsc.studies.check import summary_of_scene
from scenes import meshes_of, pendulum

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
    errors = []
    for step in (4e-3, 2e-3, 1e-3):
        scene = cart(*RIGID, *START, *PUSHED, *DAMPED, f"simulation.step={step}")
        times, found = run(scene, "full")
        exact = CartAndPole().motion(times, (0.0, 0.0, 0.3, -2.0), push)
        errors.append([np.abs(found["x"] - exact[0]).max(), np.abs(found["swing"] - exact[1]).max()])
    ratios = np.array(errors[:-1]) / errors[1:]
    np.testing.assert_allclose(ratios, 4.0, atol=0.3)
    assert np.all(errors[-1] < np.array([1.5e-6, 3e-5]))


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
        for name in one:
            np.testing.assert_allclose(other[name], one[name], rtol=0, atol=allowed * np.abs(one[name]).max())


def test_files_and_summaries_have_the_coordinate_in_metres() -> None:
    scene = cart("simulation.duration=0.01")
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
@pytest.mark.parametrize("scene", ["cart", "rail"])
def test_a_model_in_c_slides(scene: str, tmp_path: Path) -> None:
    stopped = EFFECTS["stop"], "simulation.initial.x.velocity=0.5"
    model = reduced_model(cart(*START, *PUSHED, *DAMPED, "reduction.angles=6") if scene == "cart" else rail(*stopped))
    assert_same_in_c(model, tmp_path)
