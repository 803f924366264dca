"""Closed loops with three coordinates: the scene platform_3rrr against rigid body equations, and against the mesh."""

import numpy as np
import pytest
from conftest import ROOT
from runs import assert_close, components_model, full_model, history, read_meshes, samples
from scipy.integrate import solve_ivp

from pgmp_petsc.outputs.readings import poses_where_closed
from pgmp_petsc.scene import Scene, load_scene

NAMES = ("first", "second", "third")
WAYS = np.radians([90.0, 210.0, 330.0])  # from the middle to the motors; to the pins 30 degrees more
BASES = 0.5 * np.array([np.cos(WAYS), np.sin(WAYS)]).T
PINS = 0.12 * np.array([np.cos(WAYS + np.pi / 6.0), np.sin(WAYS + np.pi / 6.0)]).T
CRANK, BAR, SPOKE, DENSITY, TOOL = 0.25, 0.3, 0.12, 2700.0, 0.3
TORQUES = ((0.3, 3.0), (-0.25, 4.0), (0.2, 5.0))  # Nm and Hz
BEARING = 0.05


def platform(*overrides: str) -> Scene:
    """Return the scene."""
    return load_scene(ROOT / "scenes" / "platform_3rrr.toml", overrides)


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


def test_flexible_it_moves_as_its_mesh() -> None:
    scene = platform("simulation.duration=0.25")
    meshes = read_meshes(scene)
    (_, exact), (_, found) = (
        history(model, samples(scene, 1), 1) for model in (full_model(scene, meshes), components_model(scene, meshes))
    )
    assert_close(exact, found, x=1e-4, y=1e-4, turn=1e-4, deformation=1e-2)


def test_configurations_that_cannot_close_leave_the_others_alone() -> None:
    """A bent platform goes where the rigid one cannot: its deformation is no number there, and nothing else ends."""
    kinematics = full_model(platform()).kinematics
    theta = np.repeat([[-0.876359184978, 1.218035917415, 3.312431019808]], 5, axis=0)
    theta[3] = [-1.14237, -0.572915, 3.12684]
    poses = poses_where_closed(kinematics, theta)
    fine = np.delete(np.arange(5), 3)
    assert np.isnan(poses[..., 3]).all()
    np.testing.assert_array_equal(poses[..., fine], kinematics.poses(theta[fine]))
