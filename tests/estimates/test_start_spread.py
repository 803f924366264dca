"""By how much impacts make a difference of the start larger, and that chaotic runs are said to be."""

import numpy as np
import pytest
from loose_scenes import worn
from runs import reduced_model, trajectory

from pgmp_petsc.estimates import coarser_run
from pgmp_petsc.estimates.coarser_run import growth_of, spread_remarks

LONG = "simulation.duration=0.1", "joints.pin.clearance.restitution=0.95"


def _growth(monkeypatch, off: float) -> np.ndarray:
    model = reduced_model(worn(*LONG))
    run = trajectory(model)
    eta = np.hstack([run.coordinates, run.modal])
    monkeypatch.setattr(coarser_run, "OFF", off)
    found = growth_of(model, model.scene.simulation, eta, run.outputs)
    assert found.shape == run.time.shape
    return found


def test_growth_is_that_of_any_small_difference(monkeypatch):
    """Of 1e-9 and of 1e-8 within a factor of two, as long as neither is large; and it grows with the impacts."""
    small, large = (_growth(monkeypatch, off) for off in (1e-9, 1e-8))
    linear = large * 1e-8 < 1e-3
    assert np.abs(np.log(large / small)[linear][1:]).max() < np.log(2.0)
    assert small[-1] > 20.0 * small[len(small) // 10] > 0.0


def test_a_chaotic_run_is_said_to_be():
    times, growth = np.linspace(0.0, 1.0, 5), np.array([1.0, 10.0, 100.0, 2e3, 5e4])
    (remark,) = spread_remarks(times, growth)
    assert "chaotic" in remark.text and "from 0.75 s on" in remark.text and "5e+04 times" in remark.text
    (quiet,) = spread_remarks(times, growth / 1e3)
    assert "chaotic" not in quiet.text and "becomes 50 times as large" in quiet.text
    assert not spread_remarks(times, None)


@pytest.mark.parametrize("room", [True, False])
def test_runs_with_clearance_alone_say_it(room):
    tight = ("joints.pin={type='revolute',connect=['crank:tip','rod:hinge']}",)
    run = trajectory("reduced", worn("simulation.duration=2e-3", *(() if room else tight)))
    assert any("difference of the start becomes" in remark.text for remark in run.record.remarks) == room


def test_what_hardly_moves_has_no_range():
    """A motor that has hardly begun: nothing is said, whatever round-off the outputs are beside."""
    scene = worn("simulation.duration=4e-4", "simulation.initial.theta.velocity=0.0")
    run = trajectory("reduced", scene)
    assert not any("difference of the start" in remark.text for remark in run.record.remarks)
