"""Reduced models on a grid of three coordinates against the mesh: a closed loop, a chain in the plane, a SCARA."""

import numpy as np
import pytest
from conftest import ROOT
from runs import assert_close, full_model, history, reduced_model, samples
from test_many_coordinates import chain

from pgmp_petsc.models import ReducedModel
from pgmp_petsc.scene import Scene, load_scene, scene_from_toml

SCARA = """
[scene]
name = "scara"
[materials.aluminium]
E = 70e9
nu = 0.33
rho = 2700.0
[bodies.upper]
line = { length = 0.35, elements = 4 }
element = "beam3d"
material = "aluminium"
section = { shape = "rectangle", width = 0.02, height = 0.03 }
orientation = [0.0, 0.0, 1.0]
[bodies.fore]
line = { length = 0.3, elements = 4 }
element = "beam3d"
material = "aluminium"
section = { shape = "rectangle", width = 0.015, height = 0.025 }
orientation = [0.0, 0.0, 1.0]
[bodies.quill]
placement = { origin = [0.65, 0.0, 0.0] }
[bodies.quill.rigid]
mass = 1.0
centre = [0.0, 0.0, -0.1]
inertia = [4e-3, 4e-3, 2e-4, 0.0, 0.0, 0.0]
points = { nut = [0.0, 0.0, 0.0], tool = [0.0, 0.0, -0.2] }
[joints.shoulder]
type = "revolute"
connect = ["ground:origin", "upper:hinge"]
axis = [0.0, 0.0, 1.0]
[joints.elbow]
type = "revolute"
connect = ["upper:tip", "fore:hinge"]
axis = [0.0, 0.0, 1.0]
[joints.spindle]
type = "prismatic"
connect = ["fore:tip", "quill:nut"]
axis = [0.0, 0.0, 1.0]
[coordinates.shoulder]
joint = "shoulder"
range = [-0.8, 0.8]
[coordinates.elbow]
joint = "elbow"
range = [0.2, 1.8]
[coordinates.lift]
joint = "spindle"
range = [-0.1, 0.1]
[effects.first_motor]
type = "torque"
joint = "shoulder"
harmonic = { amplitude = 1.0, frequency_hz = 3.0 }
[effects.second_motor]
type = "torque"
joint = "elbow"
harmonic = { amplitude = -0.3, frequency_hz = 4.0 }
[effects.counterweight]
type = "spring_damper"
joint = "spindle"
stiffness = 2000.0
damping = 20.0
[effects.weight]
type = "gravity"
direction = [0.0, 0.0, -1.0]
[effects.material_damping]
type = "structural_damping"
stiffness = 5.0e-5
[reduction]
modes = 8
static_modes = true
angles = 5
[simulation]
duration = 0.3
step = 5e-4
[simulation.initial.elbow]
position = 0.8
[outputs.x]
type = "position"
point = "quill:tool"
axis = "x"
[outputs.sag]
type = "deformation"
point = "quill:tool"
axis = "z"
[outputs.sway]
type = "deformation"
point = "quill:tool"
axis = "y"
"""


def platform(*overrides: str) -> Scene:
    """Return the planar robot 3-RRR."""
    return load_scene(ROOT / "scenes" / "platform_3rrr.toml", ("simulation.duration=0.25", *overrides))


@pytest.fixture(scope="module")
def robot() -> ReducedModel:
    return reduced_model(platform())


def test_a_closed_loop_moves_as_its_mesh(robot: ReducedModel) -> None:
    """With the scene's own settings; what is left is the truncation of the modes, 1e-4."""
    scene = platform()
    (_, exact), (_, found) = (history(model, samples(scene, 1), 1) for model in (full_model(scene), robot))
    assert_close(exact, found, x=1e-6, y=1e-6, turn=1e-6, deformation=1e-3)


def test_samples_of_a_batch_are_those_alone(robot: ReducedModel) -> None:
    """Bit for bit, whatever cells the others are in."""
    scene = platform("simulation.duration=0.05")
    model, values = ReducedModel(scene, robot.rom, robot.kinematics), {"radius": np.linspace(2.5e-3, 3.5e-3, 11)}
    _, together = history(model, values, 11)
    for k in (0, 4, 10):
        _, alone = history(model, {"radius": values["radius"][[k]]}, 1)
        for name, one in alone.items():
            np.testing.assert_array_equal(one[:, 0], together[name][:, k])


def test_a_scara_moves_as_its_mesh() -> None:
    """Two arms that turn and a quill that slides, on a spring; five places of each suffice."""
    scene = scene_from_toml(SCARA, ".")
    (_, exact), (_, found) = (history(model(scene), samples(scene, 1), 1) for model in (full_model, reduced_model))
    assert_close(exact, found, x=1e-5, sag=1e-2, sway=1e-2)


def test_interpolation_over_three_coordinates_is_of_order_four() -> None:
    """A chain that swings; the error falls with the fourth power of the distances of samples, until that of the modes
    is left."""
    ranges = [
        entry
        for k, start in enumerate((-0.6, 0.3, 0.2))
        for entry in (
            f"coordinates.theta{k}.range=[-1.6,1.6]", f"coordinates.theta{k}.periodic=false",
            f"simulation.initial.theta{k}.position={start}",
        )
    ]  # fmt: skip
    common = (*ranges, "reduction.modes=6", "simulation.duration=0.2", "simulation.step=5e-4")
    scene = chain(True, *common)
    _, exact = history(full_model(scene), samples(scene, 1), 1)
    errors = []
    for angles in (6, 11):
        _, found = history(reduced_model(chain(True, *common, f"reduction.angles={angles}")), samples(scene, 1), 1)
        errors.append(np.abs(found["theta2"] - exact["theta2"]).max())
    assert errors[1] < 1e-4
    assert np.log2(errors[0] / errors[1]) > 3.0
