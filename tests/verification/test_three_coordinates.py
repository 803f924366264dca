"""Three coordinates: a loop against rigid equations and the mesh; a chain in the plane, a SCARA, a delta robot."""

import numpy as np
import pytest
from alike import assert_samples_are_those_alone
from conftest import ROOT
from runs import assert_close, components_model, full_model, history, largest_errors, reduced_model, samples, trajectory
from scipy.integrate import solve_ivp
from test_many_coordinates import chain

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.scene import Scene, load_scene, scene_from_toml, scene_to_toml
from scenes import kinematics_of


def platform(*overrides: str) -> Scene:
    """Return the planar robot 3-RRR."""
    return load_scene(ROOT / "scenes" / "platform_3rrr.toml", ("simulation.duration=0.25", *overrides))


@pytest.fixture(scope="module")
def robot() -> ReducedModel:
    return reduced_model(platform())


def test_a_closed_loop_moves_as_its_mesh(robot: ReducedModel) -> None:
    """With the scene's own settings; what is left is the truncation of the modes, 1e-4 of the reduced model."""
    scene = platform()
    models = full_model(scene), robot, components_model(scene)
    (_, exact), (_, found), (_, in_components) = (history(model, samples(scene, 1), 1) for model in models)
    assert_close(exact, found, x=1e-6, y=1e-6, turn=1e-6, deformation=1e-3)
    assert_close(exact, in_components, x=1e-4, y=1e-4, turn=1e-4, deformation=1e-2)


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
    kinematics = kinematics_of(scene)
    assert "force" in OutputSet.of(scene, kinematics).units


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
    adaptive = chain(True, "reduction.sampling_tolerance=0.1").reduction
    assert adaptive.angles == 22 and adaptive.max_angles >= 44**3  # distances are halved at least once


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


NAMES = ("first", "second", "third")
WAYS = np.radians([90.0, 210.0, 330.0])  # from the middle to the motors; to the pins 30 degrees more
BASES = 0.5 * np.array([np.cos(WAYS), np.sin(WAYS)]).T
PINS = 0.12 * np.array([np.cos(WAYS + np.pi / 6.0), np.sin(WAYS + np.pi / 6.0)]).T
CRANK, BAR, SPOKE, DENSITY, TOOL = 0.25, 0.3, 0.12, 2700.0, 0.3
TORQUES = ((0.3, 3.0), (-0.25, 4.0), (0.2, 5.0))  # Nm and Hz
BEARING = 0.05


def rod(length: float, radius: float) -> tuple[float, float]:
    """Return mass and moment of inertia about the middle of a rod with rotary inertia of its sections."""
    mass = DENSITY * np.pi * radius**2 * length
    return mass, mass * length**2 / 12.0 + DENSITY * np.pi * radius**4 / 4.0 * length


class RigidPlatform:
    """The robot of rigid rods in the place (x, y) and the turn of its platform: M q'' + ... by Lagrange, legs solved in
    closed form, derivatives of M by differences."""

    def legs(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the crank angles' derivatives (3, 3), and M (3, 3)."""
        (crank, of_crank), (bar, of_bar), (spoke, of_spoke) = rod(CRANK, 5e-3), rod(BAR, 3e-3), rod(SPOKE, 8e-3)
        middle = 3.0 * (of_spoke + spoke * (SPOKE / 2.0) ** 2)
        mass = np.diag([3.0 * spoke + TOOL, 3.0 * spoke + TOOL, middle])
        cos, sin = np.cos(q[2]), np.sin(q[2])
        turn, turned = np.array([[cos, -sin], [sin, cos]]), np.array([[-sin, -cos], [cos, -sin]])
        rates = []
        for base, pin in zip(BASES, PINS):
            place = q[:2] + turn @ pin
            of_place = np.column_stack([np.eye(2), turned @ pin])
            reach = np.linalg.norm(place - base)
            elbow = np.arccos((CRANK**2 + reach**2 - BAR**2) / (2.0 * CRANK * reach))
            angle = np.arctan2(*(place - base)[::-1]) + elbow
            along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
            rest = place - base - CRANK * along
            rate = rest @ of_place / (CRANK * rest @ across)  # the bar keeps its length
            of_elbow = CRANK * np.outer(across, rate)
            spin = (rest[0] * (of_place - of_elbow)[1] - rest[1] * (of_place - of_elbow)[0]) / BAR**2
            centre = 0.5 * (of_place + of_elbow)
            mass += (of_crank + crank * CRANK**2 / 4.0) * np.outer(rate, rate) + of_bar * np.outer(spin, spin)
            mass += bar * centre.T @ centre
            rates.append(rate)
        return np.array(rates), mass

    def slopes(self, time: float, state: np.ndarray) -> np.ndarray:
        """Return the rates of (q, q')."""
        (q, v), h = np.split(state, 2), 1e-5
        rates, mass = self.legs(q)
        changes = [(self.legs(q + step)[1] - self.legs(q - step)[1]) / (2.0 * h) for step in h * np.eye(3)]
        forces = [size * np.sin(2.0 * np.pi * frequency * time) for size, frequency in TORQUES] - BEARING * rates @ v
        drift = np.einsum("kij,k,j->i", changes, v, v) - 0.5 * np.einsum("kij,i,j->k", changes, v, v)
        return np.concatenate([v, np.linalg.solve(mass, rates.T @ forces - drift)])

    def run(self, times: np.ndarray) -> np.ndarray:
        """Return x, y and the turn (3, n_t) from rest in the middle."""
        start = np.zeros(6)
        return solve_ivp(self.slopes, (0.0, times[-1]), start, "DOP853", times, rtol=1e-10, atol=1e-12).y[:3]


def test_rigid_it_obeys_its_own_equations() -> None:
    """Two loops and three motors; of order two in the step."""
    bodies = [f"bodies.{name}_{part}.flexible=false" for name in NAMES for part in ("crank", "bar")]
    exact, errors = None, []
    for step in (2e-3, 1e-3):
        scene = platform(*bodies, "parameters={}", *(f"bodies.{name}_bar.section.radius=3e-3" for name in NAMES),
                         'outputs.deformation={type="position", point="first_spoke:hinge", axis="x"}',
                         "effects.material_damping={type='gyroscopic'}",
                         "simulation.duration=0.3", f"simulation.step={step}")  # fmt: skip
        times, found = history(full_model(scene), samples(scene, 1), 1)
        exact = RigidPlatform().run(times)
        found["turn"] = found["turn"] - found["turn"][0]
        errors.append([np.abs(found[name][:, 0] - exact[k]).max() for k, name in enumerate(("x", "y", "turn"))])
    assert np.abs(exact).max(axis=1).min() > 5e-3, "it moves and turns"
    assert max(errors[1]) < 1e-4
    assert np.log2(np.array(errors[0]) / errors[1]) == pytest.approx(2.0, abs=0.1)


def test_configurations_that_cannot_close_leave_the_others_alone() -> None:
    """A bent platform goes where the rigid one cannot: its deformation is no number there, and nothing else ends."""
    kinematics = full_model(platform()).kinematics
    theta = np.repeat([[-0.876359184978, 1.218035917415, 3.312431019808]], 5, axis=0)
    theta[3] = [-1.14237, -0.572915, 3.12684]
    poses = kinematics.poses(theta, missing=True)
    fine = np.delete(np.arange(5), 3)
    assert np.isnan(poses[..., 3]).all()
    np.testing.assert_array_equal(poses[..., fine], kinematics.poses(theta[fine]))
    with pytest.raises(InputError, match="cannot close"):
        kinematics.poses(theta)
