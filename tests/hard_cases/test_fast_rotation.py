"""Bodies that turn fast: generalised-alpha with constraints that turn is stable up to about 0.8 (1 - spectral radius)
rad a step, beyond which velocities leave the constraints, and iterations may converge all the same."""

from pathlib import Path

import numpy as np
import pytest
from conftest import run_mpi
from runs import PGMP, overridden, pgmp, trajectory

from pgmp_petsc.results import Ensemble, Trajectory
from pgmp_petsc.stepping.status import Status
from scenes import of_text, tables

WHEEL = tables("""
scene: name = "wheel"
parameters.speed: nominal = 200.0; unit = "rad/s"; distribution = { name = "uniform", loc = 100.0, scale = 150.0 }
bodies.wheel: rigid = { mass = 1.2, inertia = [3e-3, 1.6e-3, 1.6e-3, 0.0, 0.0, 0.0] }
joints.spin: type = "revolute"; connect = ["ground:origin", "wheel:centre"]; axis = [1.0, 0.0, 0.0]
coordinates.spin: joint = "spin"; range = [0.0, 6.283185307179586]; periodic = true
simulation: duration = 0.5; initial = { spin = { velocity = "speed" } }
outputs.roll: type = "angle"; joint = "spin"
""")


@pytest.mark.parametrize(("radius", "stable"), [(0.95, 0.04), (0.9, 0.08), (0.8, 0.16)])
def test_how_far_bodies_may_turn_in_a_step(radius: float, stable: float) -> None:
    """A point on a circle, by the eigenvalues of a step in the frame that turns: they leave the unit circle at 0.04,
    0.08 and 0.16 rad a step. Growth from round-off takes some hundred steps."""
    for share, is_stable in ((0.85, True), (1.35, False)):
        given = ("simulation.duration=2.0", f"simulation.spectral_radius={radius}")
        found = trajectory("full", of_text(WHEEL, *given, f"parameters.speed.nominal={1e3 * share * stable}")())
        assert (found.steps_divided == 1) == is_stable, share
        assert found.status == Status.FINE


def test_a_wheel_turns_on(tmp_path: Path) -> None:
    """Without a check its energy grew from 60 to 2,147 J in a second, and it stood at 92 rad in place of 200. On two
    ranks, which share it, too."""
    path = tmp_path / "wheel.toml"
    path.write_text(WHEEL)
    pgmp("montecarlo", path, "--full", "-n", "12", "-o", tmp_path / "many.h5")
    many = Ensemble.read(tmp_path / "many.h5")
    assert (many.status == Status.FINE).all() and set(many.steps_divided) == {1, 2}
    np.testing.assert_allclose(many.outputs["roll"], 0.5 * many.parameters["speed"], rtol=4e-3)
    run_mpi(2, *PGMP, "simulate", path, "--full", "-o", tmp_path / "one.h5")
    one = Trajectory.read(tmp_path / "one.h5")
    assert one.steps_divided == 2 and one.outputs["roll"][-1] == pytest.approx(100.0, rel=2e-3)
    assert any(Status.UNSTABLE.meaning in remark.text for remark in one.record.remarks)


def test_one_that_no_step_helps_says_so(tmp_path: Path) -> None:
    path, out = tmp_path / "wheel.toml", tmp_path / "one.h5"
    path.write_text(WHEEL)
    said = pgmp("simulate", path, "--full", "-o", out, *overridden("parameters.speed.nominal=5e3"), status=1).stderr
    assert Status.UNSTABLE.meaning in said and "a smaller simulation.spectral_radius" in said


@pytest.mark.parametrize(("radius", "named"), [(0.98, True), (0.8, False)])
def test_an_iteration_that_fails_names_the_damping(radius: float, named: bool) -> None:
    """Of a bar at 200 rad/s on a hinge at its end, which fails with an eighth of the step too."""
    cure = Status.NOT_CONVERGED.cure("full", of_text(WHEEL, f"simulation.spectral_radius={radius}")().beyond_steps)
    assert cure.startswith("take a smaller simulation.step")
    assert ("a smaller simulation.spectral_radius" in cure) == named
