"""Errors of a run found of itself: its own finer steps, the spread of its start, and all of them in words."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from loose_scenes import worn
from runs import reduced_model, trajectory

from pgmp_petsc.estimates import starts
from pgmp_petsc.estimates.own_error import OwnErrors, large_errors, not_estimated, not_known, of_figures, of_statistics
from pgmp_petsc.estimates.starts import growth_of, spread_remarks
from pgmp_petsc.results import EstimatedErrors, Trajectory
from pgmp_petsc.results.numbers import felt
from pgmp_petsc.texts.models import of_trajectory
from scenes import slider_crank

WORDS = ("mean", "deviation, quantiles")


def told(values: np.ndarray, errors: np.ndarray) -> str:
    """Return what is said of an output in N; all samples are fine."""
    found = of_statistics([("force", values)], {"force": errors}, np.ones(values.size, bool), {"force": "N"}, WORDS)
    return " ".join(f"{remark.kind}: {remark.text}" for remark in found)


def test_a_spread_of_errors_is_told_beside_the_deviation() -> None:
    exact = np.linspace(-1.0, 1.0, 100) * 0.012 / 0.58 + 3.0
    errors = np.where(np.arange(100) < 20, 30.0 * (exact - 3.0), np.nan)
    values = exact + 30.0 * (exact - 3.0)
    said = told(values, errors)
    assert said.startswith("warning: the reduced model's own error is a good part of deviation, quantiles of force: ")
    deviations = values[:20].std(ddof=1), exact[:20].std(ddof=1)
    assert f"20 checked samples have a deviation of {deviations[0]:.3g} N, and of {deviations[1]:.3g} N without" in said


def test_a_mean_of_errors_is_told_beside_the_mean_and_small_errors_are_not() -> None:
    values = np.random.default_rng(1).normal(2.0, 0.5, 50)
    assert "mean of force: about +0.4 N of" in told(values, np.full(50, 0.4))
    assert told(values, np.full(50, 0.01)) == told(values, np.full(50, np.nan)) == ""
    assert "(1 checked sample)" in told(values, np.append(0.4, np.full(49, np.nan)))
    # one tells of no deviation, and its error is named beside that where it is a good part
    assert "deviation, quantiles of force, of 0.445 N" in told(values, np.append(0.4, np.full(49, np.nan)))
    assert "errors up to 0.05 N" in told(values, np.append(0.05, np.full(49, np.nan)))
    assert told(values, np.append(0.02, np.full(49, np.nan))).startswith("note: ")


def test_errors_of_full_order_samples_are_the_steps_and_not_cured_by_full_order_runs() -> None:
    values = np.random.default_rng(1).normal(2.0, 0.5, 50)
    (said,) = of_statistics(
        [("force", values)], {"force": np.full(50, 0.4)}, np.ones(50, bool), {"force": "N"}, WORDS, "full"
    )
    assert "time step" in said.text and "simulation.step" in said.text
    assert "reduced" not in said.text and "--full" not in said.text


def test_figures_are_told_from_a_share_of_their_size_on() -> None:
    (said,) = of_figures([("a", 2.0, 1.0, 2.0), ("b", 2.0, 1.99, 2.0)])
    assert said.kind == "warning" and "a: 2, about 1 without" in said.text and "b:" not in said.text
    (said,) = of_figures([("a", 8e-3, 8e-3 + 1e-9, 1e-9)])  # no more digits than tell both apart
    assert "a: 0.008, about 0.008000001 without" in said.text
    (said,) = of_figures([("b", 2.0, 1.99, 2.0), ("idle", 0.0, 0.0, 0.0)], "the standard errors")
    assert said.kind == "note" and "up to 0.5 % of the standard errors" in said.text


def test_errors_that_are_not_estimated_are_said_to_be_unknown() -> None:
    model = reduced_model(slider_crank())  # without outputs
    assert OwnErrors.of_runs(model, [model.scene.values]) is None
    said = not_known(model, "derivatives")
    assert said.kind == "note" and "errors of the reduced model do to derivatives is not known: errors" in said.text
    model, time = reduced_model(slider_crank("outputs.angle={type='angle', joint='crank_hinge'}")), np.arange(3.0)
    history = time, {"angle": 0.1 * time, "force": np.full(3, np.nan)}
    found = OwnErrors({}, [history], {"angle": ("",), "force": ("two estimates disagree",)})
    assert np.array_equal(found.over(time[1:], ["angle"])["angle"], [0.1, 0.2])
    assert found.over(time, ["angle", "force"]) is None
    assert (
        "is not known: two estimates disagree; compare with" in not_known(model, "it", found, ["angle", "force"]).text
    )


LONG = "simulation.duration=0.1", "joints.pin.clearance.restitution=0.95"


def _growth(monkeypatch, off: float) -> np.ndarray:
    model = reduced_model(worn(*LONG))
    run = trajectory(model)
    eta = np.hstack([run.coordinates, run.modal])
    monkeypatch.setattr(starts, "OFF", off)
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
    # also where outputs take what controllers do
    controlled = (
        "controllers.brake={type='pid',measures='theta',joint='main',gains={p=1.0}}",
        "outputs.force={type='joint_force',joint='main',component='x'}",
    )
    run = trajectory("reduced", worn("simulation.duration=2e-3", *(controlled if room else tight)))
    assert any("difference of the start becomes" in remark.text for remark in run.record.remarks) == room


def test_what_hardly_moves_has_no_range():
    """A motor that has hardly begun: nothing is said, whatever round-off the outputs are beside."""
    scene = worn("simulation.duration=4e-4", "simulation.initial.theta.velocity=0.0")
    run = trajectory("reduced", scene)
    assert not any("difference of the start" in remark.text for remark in run.record.remarks)


@pytest.mark.parametrize(
    "largest, line, warned",
    [
        (0.5, "0.001 m (0.2 % of its largest value)", ""),
        (0.0201, "1 mm (5 % of its largest value)", ""),
        (0.0199, "1 mm (5 % of its largest value)", "tip 5 %"),
        (0.00125, "1 mm (80 % of its largest value)", "tip 80 %"),
        (4e-5, "1 mm (its largest value is 0.04 mm)", "tip more than all of it (40 µm)"),
        (0.0, "1 mm", ""),
    ],
)
def test_a_share_is_told_where_it_says_something(largest: float, line: str, warned: str) -> None:
    errors = EstimatedErrors(np.array([0.0, 1.0]), {"tip": np.array([0.0, -1e-3])}, {"tip": largest})
    assert of_trajectory(errors, {"tip": "m"}, 1.0)[1].endswith(line)
    remarks = large_errors(*errors.of_one_run(), {"tip": "m"})
    assert bool(remarks) == bool(warned)
    assert all(warned in remark.text for remark in remarks)
    assert any("has not converged" in remark.text for remark in remarks) == ("more than all" in warned)


def test_an_ensemble_tells_the_worst_of_its_samples_and_how_many_are_so() -> None:
    """Samples that are not checked, and outputs that are known to 5 %, are not told."""
    errors = {"tip": np.array([0.06, 0.01, np.nan, 0.4]), "angle": np.array([0.05, 0.01, np.nan, 0.02])}
    sizes = {name: np.array([1.0, 1.0, 1.0, 2.0]) for name in errors}
    (remark,) = large_errors(errors, sizes, dict.fromkeys(errors, "1"))
    assert remark.kind == "warning" and "errors of the samples that are checked, as shares" in remark.text
    assert "over the run: tip 20 % at most, beyond 5 % in 2 of 3; a smaller simulation.step" in remark.text
    assert not large_errors({"tip": np.full(4, np.nan)}, sizes, {})


@pytest.mark.parametrize("error, warned", [(1e-10, ""), (7.6e-7, "sway all of it (0.76 ")])
def test_what_vanishes_beside_others_of_its_unit_has_no_share(error: float, warned: str) -> None:
    """Round-off of a symmetric shaker's sway, which was wrong by more than 10,000 %; what a model does not have."""
    sizes = {"lift": np.array([2e-2]), "sway": np.array([1.4e-13])}
    remarks = large_errors({"lift": np.array([1e-5]), "sway": np.array([error])}, sizes, dict.fromkeys(sizes, "m"))
    assert bool(remarks) == bool(warned) and all(warned in remark.text for remark in remarks)
    assert not any("has not converged" in remark.text for remark in remarks)
    assert felt(sizes, dict.fromkeys(sizes, "m"))["sway"] == 0.0 < felt(sizes, dict.fromkeys(sizes, "1"))["sway"]


def test_an_output_without_an_estimate_says_why(tmp_path: Path) -> None:
    """In the terminal, among the remarks and in the file."""
    reason, time = "two estimates disagree", np.array([0.0, 1.0])
    outputs = {"tip": np.full(2, np.nan), "angle": np.zeros(2)}
    errors = EstimatedErrors(time, outputs, {"tip": 1.0, "angle": 1.0}, absent={"tip": reason})
    line, other = of_trajectory(errors, {"tip": "m", "angle": "rad"}, 1.0)[1:]
    assert line.endswith(f"not estimated: {reason}") and reason not in other
    (remark,) = not_estimated(errors, slider_crank())
    assert "errors were not estimated for tip: two estimates disagree; " in remark.text
    run, absent = synthetic.trajectory("reduced", n_frames=0), {"slider_position": reason}
    replace(run, errors=replace(run.errors, absent=absent)).write(tmp_path / "run.h5")
    assert Trajectory.read(tmp_path / "run.h5").errors.absent == absent
