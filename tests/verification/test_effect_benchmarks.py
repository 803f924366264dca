"""Rotating beams, singular positions, welds and all effects together in the full-order model."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cantilevers import PUBLISHED
from conftest import ROOT
from effect_scenes import CANTILEVER, STEP, linear_mode, recorded, run_batch, run_of, scene_of
from scipy.optimize import curve_fit

from pgmp_petsc.scene import load_scene
from scenes import tables


@pytest.mark.parametrize(("spin", "expected"), PUBLISHED)
def test_the_frequency_of_a_rotating_beam(spin: float, expected: float) -> None:
    """In the plane of rotation, in units of sqrt(EI / rho A L^4), from a short free vibration."""
    scene = scene_of(
        CANTILEVER, "[simulation]\nduration = 2.5\nstep = 5e-3\nspectral_radius = 0.6\n",
        f"effects.hold.constant_speed.speed={spin}", "bodies.beam.line.elements=16",
    )  # fmt: skip
    _, shape = linear_mode(scene, [0, 1, 2], 0)
    run = run_batch(scene, 1, 1e-3 * shape)
    x, y = run.frames[:, -1, 0], run.frames[:, -1, 1]
    across = y * np.cos(spin * run.time) - x * np.sin(spin * run.time)

    def swing(t: np.ndarray, omega: float, cos: float, sin: float, decay: float) -> np.ndarray:
        return np.exp(-decay * t) * (cos * np.cos(omega * t) + sin * np.sin(omega * t))

    fitted, _ = curve_fit(swing, run.time, across, p0=(expected, 0.0, across.max(), 0.0))
    # 16 elements: 1e-3; steps: (spin h)^2 at the highest spin, 2.5e-3
    assert fitted[0] == pytest.approx(expected, rel=5e-3)


def test_the_double_four_bar_goes_through_its_singular_positions() -> None:
    """All rods in one line, twice a turn; the scene's whole 10 s keep the energy to 1e-5 with its step of 0.5 ms."""
    wrong = []
    for step in (8e-3, 4e-3):
        scene = load_scene(
            ROOT / "scenes" / "double_four_bar.toml", ["simulation.duration=2.0", f"simulation.step={step}"]
        )
        run = run_batch(scene, 1)
        assert run.status == 0
        energy = run.balance.kinetic + run.balance.potential
        wrong.append(np.abs(energy - energy[0]).max() / energy[0])
        directions = run.frames[:, :, 2]
        assert directions[-1, 0] < -np.pi, "beyond the singular positions at 0 and -pi"
        # it stays a parallelogram: no other branch is taken
        np.testing.assert_allclose(directions[:, :3], directions[:, :1].repeat(3, axis=1), rtol=0, atol=1e-9)
        np.testing.assert_allclose(directions[:, 3:], 0.0, rtol=0, atol=1e-9)
    # 64 times what the scene's step leaves
    assert wrong[1] < 64 * 1e-5
    assert 3.5 < wrong[0] / wrong[1] < 4.5


def test_a_beam_welded_to_a_held_hub_is_a_clamped_one() -> None:
    push = tables("""
effects.push: type = "force"; point = "beam:tip"; direction = [0.0, 1.0]; table = [[0.0, 1.0], [1.0, 1.0]]
""") + run_of(0.5, 5e-3)
    clamped = recorded(scene_of(CANTILEVER, push), alone=True)
    welded = recorded(
        scene_of(
            CANTILEVER.replace('"ground:origin", "beam:hinge"', '"ground:origin", "hub:hinge"'),
            tables("""
bodies.hub: line = { length = 0.2, elements = 1 }; element = "beam2d"; flexible = false;
    section = { shape = "coefficients", axial = 1.0, shear = 1.0, bending = 1.0, line_density = 1.0 };
    placement = { angle = 0.7 }
joints.weld: type = "fixed"; connect = ["hub:hinge", "beam:hinge"]
""")
            + push,
            "effects.hold.constant_speed.start=0.7",
        ),
        alone=True,
    )
    np.testing.assert_allclose(welded.point("beam:tip"), clamped.point("beam:tip"), rtol=0, atol=1e-9)
    np.testing.assert_allclose(welded.balance.strain, clamped.balance.strain, rtol=0, atol=1e-9)
    assert np.abs(clamped.point("beam:tip")[:, 1]).max() > 0.3


EVERYTHING = (
    CANTILEVER.split("[effects.hold]")[0]
    + tables("""
ground.points: anchor = [0.4, 0.9]
bodies.pendant: line = { length = 0.4, elements = 2 }; element = "beam2d"; flexible = false;
    section = { shape = "coefficients", axial = 1.0, shear = 1.0, bending = 1.0, line_density = 1.0 };
    placement = { origin = [1.0, 0.0], angle = -0.5 }
[bodies.tail]
line = { length = 0.4, elements = 3 }
element = "beam2d"
section = { shape = "coefficients", axial = 1e4, shear = 1e4, bending = 5.0, line_density = 1.0, rotary_density = 1e-4 }
placement = { origin = [1.351, -0.1918], angle = -0.9 }
joints.weld: type = "fixed"; connect = ["beam:tip", "pendant:hinge"]
joints.second_weld: type = "fixed"; connect = ["pendant:tip", "tail:hinge"]
effects.motor: type = "torque"; joint = "hub"; harmonic = { amplitude = 2.0, frequency_hz = 3.0 }
effects.jet: type = "force"; point = "pendant:tip"; direction = [0.0, 1.0]; follows = true;
    table = [[0.0, 0.0], [0.2, 1.0]]
effects.rope: type = "force"; point = "beam:tip"; towards = "ground:anchor"; table = [[0.0, 0.5], [0.2, 0.5]]
effects.weight: type = "gravity"
effects.bob: type = "point_mass"; point = "pendant:tip"; mass = 0.2
effects.lump: type = "point_mass"; point = "beam:middle"; mass = 0.3; inertia = 0.01
effects.oil: type = "joint_damping"; joint = "hub"; coefficient = 0.1
effects.rub: type = "joint_friction"; joint = "hub"; limit = 0.1; speed = 0.2
effects.spring: type = "spring_damper"; points = ["ground:anchor", "tail:tip"]; stiffness = 3.0; damping = 0.1;
    rest = 0.5
effects.loss: type = "structural_damping"; bodies = ["beam"]; stiffness = 1e-3; mass = 0.2; ratios = [0.05, 0.02]
effects.stop: type = "end_stop"; joint = "hub"; lower = -0.05; stiffness = 300.0; damping = 0.2
""")
    + run_of(0.2, STEP, 0.8)
)

ON_RANKS = """
import sys
import numpy as np
from mpi4py import MPI
from effect_scenes import line_model
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.scene import load_scene
comm = MPI.COMM_WORLD
scene = load_scene(sys.argv[1])
with line_model(scene).distributed({}, comm) as system:
    found = []
    def record(step, time, state):
        energies = system.energies(time, state)
        parts = [energies.kinetic, energies.strain, *energies.potential.values(), *energies.powers.values()]
        found.append(np.concatenate([np.ravel(part)[:1] for part in parts]))
    run = integrate(system, scene.simulation, observer=record)
    q = system.unpack(run.state.q)[:, 0]
if comm.rank == 0:
    np.savez(sys.argv[2], q=q, energies=np.array(found), status=run.status)
"""


@pytest.mark.parametrize("n_ranks", [3])
def test_all_effects_together_on_several_ranks(mpirun: Callable, tmp_path: Path, n_ranks: int) -> None:
    path = tmp_path / "everything.toml"
    path.write_text(EVERYTHING)
    one = recorded(load_scene(path))
    assert set(one.balance.work) == {"motor", "jet", "rope", "weight", "oil", "rub", "spring", "loss", "stop"}
    assert one.balance.work["stop"][-1] < 0.0, "the stop is hit"
    mpirun(n_ranks, "-c", ON_RANKS, path, tmp_path / "found.npz")
    found = np.load(tmp_path / "found.npz")
    assert found["status"][0] == 0
    np.testing.assert_allclose(found["q"], one.frames[-1].ravel(), rtol=0, atol=1e-8)
    np.testing.assert_allclose(found["energies"][:, 0], one.balance.kinetic, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found["energies"][:, 1], one.balance.strain, rtol=0, atol=1e-6)
    assert np.abs(one.balance.residual).max() < 0.02 * one.balance.exchanged
