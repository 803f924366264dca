"""Rigid bodies by their mass: as bodies of lines with the same properties, against closed forms."""

import numpy as np
import pytest
from alike import assert_alike
from machine_scenes import MODELS, RAIL, RAIL_MASS, cart, run
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from pgmp_petsc.scene import scene_from_toml
from scenes import HEADER, tables

MASS, ROTARY = 7800.0 * 0.2 * 0.05**2, 7800.0 * 0.2 * 0.05**2 * (0.2**2 + 0.05**2) / 12.0
BY_MASS = (
    f"bodies.cart={{rigid={{mass={MASS!r},centre=[0.1,0.0],inertia={ROTARY!r},points={{hinge=[0,0],tip=[0.2,0]}}}}}}"
)


@pytest.mark.parametrize("model", MODELS)
def test_a_cart_by_its_mass_is_the_cart_of_lines(model: str) -> None:
    start = ("simulation.initial.x.velocity=0.3", "simulation.initial.swing.velocity=-2.0")
    (_, lines), (_, mass) = (run(scene, model) for scene in (cart(*start), cart(*start, BY_MASS)))
    assert_alike(lines, mass, 1e-9)


FLYWHEEL = HEADER + tables("""
bodies.wheel: rigid = { mass = "m", inertia = "j", points = { hub = [0.0, 0.0], rim = [0.3, 0.0] } }
joints.axle: type = "revolute"; connect = ["ground:origin", "wheel:hub"]
coordinates.turn: joint = "axle"; range = [0.0, 6.283185307179586]; periodic = true
parameters.m: nominal = 5.0; unit = "kg"
parameters.j: nominal = 0.2; unit = "kg m2"
effects.motor: type = "torque"; joint = "axle"; table = [[0.0, 0.6]]
effects.weight: type = "gravity"
simulation: duration = 0.5; step = 1e-3
outputs.turn: type = "angle"; joint = "axle"
outputs.rim: type = "position"; point = "wheel:rim"; axis = "y"
""")


def test_a_flywheel_is_accelerated() -> None:
    """phi = T / (2 J) t^2; its weight hangs on the axle through the centre of mass."""
    times, found = run(scene_from_toml(FLYWHEEL, "."), "full")
    np.testing.assert_allclose(found["turn"], 1.5 * times**2, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found["rim"], 0.3 * np.sin(found["turn"]), rtol=0, atol=1e-12)


TOP = HEADER + tables("""
bodies.top: rigid.mass = 1.5; rigid.centre = [0.1, 0.05, -0.02];
    rigid.inertia = [0.02, 0.03, 0.04, 0.002, -0.001, 0.003]; rigid.points = { foot = [0.0, 0.0, 0.0] }
joints.foot: type = "revolute"; connect = ["ground:origin", "top:foot"]; axis = [1.0, 2.0, 2.0]
coordinates.turn: joint = "foot"; range = [-3.0, 3.0]
effects.weight: type = "gravity"; direction = [0.0, 0.0, -1.0]
simulation: duration = 0.6; step = 5e-4
outputs.turn: type = "angle"; joint = "foot"
""")


def test_a_body_in_space_swings_about_an_oblique_axis() -> None:
    """J phi'' is the moment of its weight, with the inertia about the axis by Steiner's theorem."""

    scene = scene_from_toml(TOP, ".")
    times, found = run(scene, "full")
    axis, centre = np.array([1.0, 2.0, 2.0]) / 3.0, np.array([0.1, 0.05, -0.02])
    tensor = scene.bodies["top"].rigid.tensor(scene.number)
    inertia = axis @ tensor @ axis + 1.5 * np.sum(np.cross(axis, centre) ** 2)

    def rates(t: float, y: np.ndarray) -> list[float]:
        turned = Rotation.from_rotvec(y[0] * axis).apply(centre)
        return [y[1], axis @ np.cross(turned, [0.0, 0.0, -1.5 * 9.80665]) / inertia]

    exact = solve_ivp(rates, (0.0, times[-1]), [0.0, 0.0], "DOP853", times, rtol=1e-10, atol=1e-12).y[0]
    np.testing.assert_allclose(found["turn"], exact, rtol=0, atol=1e-5 * np.abs(exact).max())


CARRIAGE = RAIL.replace(
    "[joints.rail]",
    "[bodies.carriage]\nrigid = { mass = 2.0, inertia = [0.01, 0.01, 0.01, 0.0, 0.0, 0.0], points = { on = [0.0, 0.0, "
    '0.0] } }\n[joints.held]\ntype = "fixed"\nconnect = ["carriage:on", "arm:hinge"]\n[joints.rail]',
).replace('"arm:hinge"]\naxis', '"carriage:on"]\naxis')


@pytest.mark.parametrize("model", MODELS)
def test_a_carriage_carries_an_arm(model: str) -> None:
    """Pushed by a force, the carriage and the stiff arm go as one mass."""
    scene = scene_from_toml(CARRIAGE, ".", [
        'effects.push={type="force",joint="rail",table=[[0.0,4.0]]}', "materials.steel.E=2e13",
    ])  # fmt: skip
    times, found = run(scene, model)
    exact = 0.5 * 4.0 / (2.0 + RAIL_MASS) * times**2
    np.testing.assert_allclose(found["x"], exact, rtol=0, atol=1e-4 * exact.max())
