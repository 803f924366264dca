"""Loads that set in at once on the light nodes of joints: steps that do not resolve these do not throw them about."""

import numpy as np
import pytest
from runs import MODELS, motion, trajectory

from pgmp_petsc.results import Balance
from pgmp_petsc.scene import scene_from_toml
from pgmp_petsc.studies.simulate import balance_remarks
from scenes import HEADER, meshes_of, tables

# the rotation of a node vibrates with some 200 kHz (GA l / 4 over rho I l / 3), 200 periods a step
ARM = HEADER + tables("""
bodies.arm: mesh = "0.0:0.5:5"; element = "beam2d"; material = "steel";
    section = { shape = "rectangle", width = 0.02, height = 0.006 }
joints.hinge: type = "revolute"; connect = ["ground:origin", "arm:hinge"]
coordinates.theta: joint = "hinge"; range = [0.0, 6.283185307179586]; periodic = true
effects.motor: type = "torque"; joint = "hinge"; table = [[0.0, 1.0], [1.0, 1.0]]
effects.loss: type = "structural_damping"; stiffness = 3e-5
reduction: modes = 4; static_modes = true
simulation: duration = 0.1; step = 1e-3
outputs.angle: type = "angle"; joint = "hinge"
outputs.moment: type = "stress"; body = "arm"; quantity = "bending_moment"; at = [0.05, 0.0]
""")


@pytest.mark.parametrize("model", MODELS)
def test_a_motor_that_is_switched_on_bends_the_arm_no_more_than_it_can(model: str) -> None:
    """Of the bending moment beside a torque of 1 Nm 1.14 Nm are reached with steps of 10 us; it was 6.3 with 1 ms."""
    scene = scene_from_toml(ARM, ".")
    run = motion(MODELS[model](scene, meshes_of(scene)))
    assert np.abs(run.outputs["moment"]).max() == pytest.approx(1.14, rel=0.15)
    assert run.outputs["angle"][-1] == pytest.approx(0.12999, rel=1e-2)
    assert np.abs(run.balance.residual).max() < 3e-3 * run.balance.exchanged  # 1.3e-3
    assert not [remark for remark in run.record.remarks if "out of balance" in remark.text]


def balance(work: float, *, stored: float = 0.0) -> Balance:
    """Return a balance of 1 J that comes to be, and work done by a motor, beside much energy that stays."""
    rising = np.linspace(0.0, 1.0, 5)
    return Balance(stored + rising, 0.0 * rising, 0.0 * rising, {"motor": work * rising})


def test_energies_out_of_balance_are_warned_of() -> None:
    (remark,) = balance_remarks(balance(0.8), 1e-3)
    assert remark.kind == "warning"
    assert "out of balance by up to 0.2 J, of 0.9 J" in remark.text and "steps of 0.001 s" in remark.text
    assert "smaller simulation.step" in remark.text


def test_energies_in_balance_and_the_round_off_of_what_rests_are_not() -> None:
    assert not balance_remarks(balance(0.99), 1e-3)
    assert not balance_remarks(balance(0.0, stored=1e10), 1e-3)


def vibration(loss: float, *, steps: int, turns: int = 100) -> Balance:
    """Return a free vibration of 1 J with so many steps a turn, in all of which together a share of it is lost."""
    time = np.linspace(0.0, float(turns), turns * steps + 1)
    left = 1.0 - loss * time / turns
    return Balance(left * np.cos(np.pi * time) ** 2, left * np.sin(np.pi * time) ** 2, 0.0 * time, {})


def test_what_is_left_over_of_a_long_run_may_add_up() -> None:
    """A tenth of a percent a turn is no alarm; most of the energy is, and a vibration that steps do not resolve."""
    assert not balance_remarks(vibration(0.1, steps=40), 1e-3)
    assert balance_remarks(vibration(0.8, steps=40), 1e-3)
    assert balance_remarks(vibration(0.1, steps=3), 1e-3)
    # what is lost at once is no less wrong where the run goes on for long
    free = vibration(0.0, steps=40)
    kept = np.where(np.arange(free.kinetic.size) > 20, 0.8, 1.0)
    assert balance_remarks(Balance(kept * free.kinetic, kept * free.strain, free.potential, {}), 1e-3)


def test_a_run_whose_steps_are_far_too_long_says_so() -> None:
    """A stiff spring that is let go swings the arm and bends it, in steps of 5 ms."""
    stop = '[effects.stop]\ntype = "spring_damper"\njoint = "hinge"\nstiffness = 2e3\nrest = 0.3\n'
    scene = scene_from_toml(ARM + stop, ".", ["simulation.step=5e-3"])
    run = trajectory("full", scene)
    assert [remark.kind for remark in run.record.remarks if "out of balance" in remark.text] == ["warning"]
