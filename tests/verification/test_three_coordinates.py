"""Reduced models on a grid of three coordinates against the mesh: a closed loop, a chain in the plane, a SCARA."""

import numpy as np
import pytest
from alike import assert_samples_are_those_alone
from conftest import ROOT
from runs import assert_close, full_model, history, largest_errors, read_meshes, reduced_model, samples, trajectory
from test_many_coordinates import chain

from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.scene import Scene, load_scene, scene_from_toml, scene_to_toml


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
    model = ReducedModel(platform("simulation.duration=0.05"), robot.rom, robot.kinematics)
    assert_samples_are_those_alone(model, (0, 4, 10), radius=np.linspace(2.5e-3, 3.5e-3, 11))


def test_outputs_are_prepared_where_drives_begin() -> None:
    """At zero, where coordinates begin of which a scene says nothing else, the robot does not close."""
    start = {name: state.position for name, state in platform().simulation.initial.items()}
    drives = (
        f'effects.{name}_torque={{type="prescribed_motion", coordinate="{name}", table=[[0, {x}], [1, {x}]]}}'
        for name, x in start.items()
    )
    force = 'outputs.force={type="joint_force", joint="first_pin"}'
    scene = platform("simulation.initial={}", force, *drives)
    kinematics = RigidKinematics(Mechanism.from_scene(scene, read_meshes(scene)))
    assert "force" in OutputSet.of(scene, kinematics).units


@pytest.mark.parametrize(("name", "angles", "share"), [("scara", 5, 5e-3), ("delta_robot", 4, 1e-3)])
def test_a_robot_moves_as_its_mesh(name: str, angles: int, share: float) -> None:
    """Two arms that turn and a quill that slides, on a spring: 0.41 %, of few angles (0.06 % with 7; without terms of
    second order 0.85 and 0.38 %); a closed loop in space, whose rods forces stiffen: 3 % of its deformation without
    such terms, of few modes and angles 4e-4."""
    scene = load_scene(ROOT / "scenes" / f"{name}.toml", ("simulation.duration=0.2", f"reduction.angles={angles}"))
    (_, exact), (_, found) = (history(model(scene), samples(scene, 1), 1) for model in (full_model, reduced_model))
    limits = {name: share if one.type == "deformation" else 1e-5 for name, one in scene.outputs.items()}
    assert_close(exact, found, **limits)


@pytest.mark.parametrize("name", ["platform_3rrr", "scara", "delta_robot"])
def test_a_built_model_is_interpolated_as_its_scene(name: str) -> None:
    """A file names its scene with all defaults: what these are must not hang on who gave them."""
    scene = load_scene(ROOT / "scenes" / f"{name}.toml")
    assert scene_from_toml(scene_to_toml(scene), scene.directory).interpolation == scene.interpolation == "spline"


@pytest.mark.parametrize(
    ("reach", "n"),
    [("[-1.6, 1.6]", 16), ("[-3.1, 3.1]", 22), ("[-2.2, 2.2]", 20), ('["-91 deg", "91 deg"]', 16), ("[0.0, 0.5]", 16)],
)
def test_angles_follow_the_range(reach: str, n: int) -> None:
    """The distance between two of them is that of 22 in a turn; at least 16, whose cost nobody notices."""
    ranges = [f"coordinates.theta{k}.{entry}" for k in range(3) for entry in (f"range={reach}", "periodic=false")]
    assert chain(True, *ranges).reduction.angles == n
    assert chain(True).reduction.angles == 22


@pytest.mark.thorough
def test_a_chain_over_whole_turns_is_as_its_mesh_by_default() -> None:
    """0.73 %, 2.7 % with 16 angles; estimated 1.5 and 2.7 %."""
    starts = [f"simulation.initial.theta{k}.position={start}" for k, start in enumerate((-0.6, 0.3, 0.2))]
    damped = 'effects.damping={type="structural_damping", stiffness=1e-4}'
    scene = chain(True, damped, "reduction.modes=6", "simulation.step=2e-4", *starts)
    model = reduced_model(scene)
    (_, exact), (_, found) = (history(one, samples(scene, 1), 1) for one in (full_model(scene), model))
    error, estimate = largest_errors(exact, found)["bending"], trajectory(model).errors.share("bending")
    assert error < 1e-2
    assert error / 3.0 < estimate < 3.0 * error


@pytest.mark.thorough
def test_undamped_vibrations_keep_their_phase_with_what_stiffens_links() -> None:
    """Forces in the links shift frequencies by 1e-4: 2.6 % of the deformation after tens of periods, and 0.5 % with
    terms of second order."""
    ranges = [
        f"coordinates.theta{k}={{joint='joint{k}', range={reach}, periodic=false}}"
        for k, reach in enumerate(("[-1.65,-0.35]", "[-0.35,0.7]", "[-0.45,0.65]"))
    ]
    starts = [f"simulation.initial.theta{k}.position={start}" for k, start in enumerate((-0.6, 0.3, 0.2))]
    common = (*ranges, *starts, "reduction.modes=6", "reduction.angles=8", "simulation.step=2e-4")
    stiffened = [f'effects.{one}={{type="{one}"}}' for one in ("geometric_stiffening", "mode_inertia")]
    _, exact = history(full_model(chain(True, *common)), samples(chain(True, *common), 1), 1)
    errors = []
    for effects in ((), stiffened):
        scene = chain(True, *common, *effects)
        errors.append(largest_errors(exact, history(reduced_model(scene), samples(scene, 1), 1)[1])["bending"])
    assert errors[0] > 0.02 and errors[1] < 0.01, errors


def test_interpolation_over_three_coordinates_is_of_order_four() -> None:
    """A chain that swings; the error falls with the fourth power of the distances of samples, until that of the modes
    is left."""
    ranges = [
        entry for k, start in enumerate((-0.6, 0.3, 0.2))
        for entry in (f"coordinates.theta{k}.range=[-1.6,1.6]", f"coordinates.theta{k}.periodic=false",
                      f"simulation.initial.theta{k}.position={start}")
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
