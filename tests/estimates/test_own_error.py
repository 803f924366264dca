"""Estimates of errors: when they are evaluated, the reference motion, and what is said of the own error of a run."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from conftest import ROOT
from loose_scenes import worn
from offset_scenes import clamped_beam, offset
from runs import paper_scene, reduced_model, trajectory
from spatial import spatial_slider_crank

import pgmp_petsc as pgmp
import pgmp_petsc.estimates.reference_motion as module
from pgmp_petsc.effects import effects_of
from pgmp_petsc.estimates.checking_model import CheckingModel, SampledLoad
from pgmp_petsc.estimates.error_indicator import Estimate
from pgmp_petsc.estimates.own_error import (
    MOST_NAMED,
    large_errors,
    not_estimated,
    of_figures,
    of_statistics,
)
from pgmp_petsc.estimates.reference_motion import (
    DAMPED,
    FINER,
    LEAST,
    MOST,
    ReferenceMotion,
    differences,
    places_of,
    schedules,
)
from pgmp_petsc.estimates.runs_at_points import RunsAtPoints
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.results import EstimatedErrors, Trajectory
from pgmp_petsc.results.numbers import felt
from pgmp_petsc.scene import Scene, load_scene
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies import reduced_run
from pgmp_petsc.studies.reduced_run import growth_of, spread_remarks
from pgmp_petsc.texts.models import of_trajectory
from scenes import HEADER, kinematics_of, slider_crank, tables

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


def test_figures_that_a_warning_leaves_out_are_counted() -> None:
    for n, words in ((MOST_NAMED + 1, "and of 1 other, by"), (MOST_NAMED + 2, "and of 2 others, by")):
        (said,) = of_figures((f"d x / d p{k}", 1.0, 2.0, 1.0) for k in range(n))
        assert words in str(said)


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
    (said,) = of_figures([(f"c{k}", 2.0, 1.0 + 0.1 * k, 2.0) for k in range(8, -1, -1)])  # the worst ones, by shares
    assert (
        said.text.index("c0: ") < said.text.index("c5: ") < said.text.index("and of 3 others") and "c6" not in said.text
    )
    (said,) = of_figures([("a", 8e-3, 8e-3 + 1e-9, 1e-9)])  # no more digits than tell both apart
    assert "a: 0.008, about 0.008000001 without" in said.text
    (said,) = of_figures([("b", 2.0, 1.99, 2.0), ("idle", 0.0, 0.0, 0.0)], "the standard errors")
    assert said.kind == "note" and "up to 0.5 % of the standard errors" in said.text


def test_errors_that_are_not_estimated_are_said_to_be_unknown() -> None:
    model = reduced_model(slider_crank())  # without outputs
    runs = RunsAtPoints.of(model, [model.scene.values])
    assert runs.errors is None
    said = runs.not_known("derivatives")
    assert said.kind == "note" and "errors of the reduced model do to derivatives is not known: errors" in said.text
    model, time = reduced_model(slider_crank("outputs.angle={type='angle', joint='crank_hinge'}")), np.arange(3.0)
    history = time, {"angle": 0.1 * time, "force": np.full(3, np.nan)}
    found = Estimate({}, {}, [history], {"angle": ("",), "force": ("two estimates disagree",)})
    assert np.array_equal(found.over(time[1:], ["angle"])["angle"], [0.1, 0.2])
    assert found.over(time, ["angle", "force"]) is None
    said = RunsAtPoints(model, found, {}).not_known("it", ["angle", "force"])
    assert "is not known: two estimates disagree; compare with" in said.text


def test_a_run_without_an_estimate_is_named() -> None:
    """One of three leaves the range of its coordinate; the others have estimates."""
    angle, speed = "outputs.angle={type='angle', joint='crank_hinge'}", "parameters.speed.nominal=1.0"
    free = "coordinates.theta.periodic=false", "coordinates.theta.range=[-1.0, 0.5]", "simulation.duration=0.02"
    model = reduced_model(slider_crank(angle, speed, *free, "simulation.initial.theta.velocity='speed'"))
    points = [model.scene.values | {"speed": value} for value in (1.0, 1e3, 2.0)]
    runs = RunsAtPoints.of(model, points)
    assert np.array_equal(np.isfinite(runs.errors.at_end["angle"]), [True, False, True])
    assert "is not known: the run at speed = 1000 rad/s stopped at 0." in runs.not_known("it", ["angle"]).text


def _growth(monkeypatch, off: float) -> np.ndarray:
    model = reduced_model(worn("simulation.duration=0.1", "joints.pin.clearance.restitution=0.95"))
    run = trajectory(model)
    eta = np.hstack([run.coordinates, run.modal])
    monkeypatch.setattr(reduced_run, "OFF", off)
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
    remarks = large_errors(*errors.of_one_run(), {"tip": "m"}, "reduced", slider_crank())
    assert bool(remarks) == bool(warned)
    assert all(warned in remark.text for remark in remarks)
    assert any("has not converged" in remark.text for remark in remarks) == ("more than all" in warned)
    assert not any("impacts" in remark.text for remark in remarks)
    loose = large_errors(*errors.of_one_run(), {"tip": "m"}, "reduced", worn())
    assert any("where impacts make" in remark.text for remark in loose) == ("more than all" in warned)
    for model, dx, told in (("reduced", 1e-3, bool(warned)), ("full", 1e-3, False), ("reduced", 0.0, False)):
        off = large_errors(*errors.of_one_run(), {"tip": "m"}, model, clamped_beam(offset("right", place=[dx, 0.0])))
        assert any("joints.right.offset act in" in one.text for one in off) == told


def test_an_ensemble_tells_the_worst_of_its_samples_and_how_many_are_so() -> None:
    """Samples that are not checked, and outputs that are known to 5 %, are not told."""
    errors = {"tip": np.array([0.06, 0.01, np.nan, 0.4]), "angle": np.array([0.05, 0.01, np.nan, 0.02])}
    sizes = {name: np.array([1.0, 1.0, 1.0, 2.0]) for name in errors}
    (remark,) = large_errors(errors, sizes, dict.fromkeys(errors, "1"), "reduced", slider_crank())
    assert remark.kind == "warning" and "errors of the samples that are checked, as shares" in remark.text
    assert "over the run: tip 20 % at most, beyond 5 % in 2 of 3; a smaller simulation.step" in remark.text
    assert not large_errors({"tip": np.full(4, np.nan)}, sizes, {}, "reduced", slider_crank())


@pytest.mark.parametrize("error, warned", [(1e-10, ""), (7.6e-7, "sway all of it (0.76 ")])
def test_what_vanishes_beside_others_of_its_unit_has_no_share(error: float, warned: str) -> None:
    """Round-off of a symmetric shaker's sway, which was wrong by more than 10,000 %; what a model does not have."""
    sizes = {"lift": np.array([2e-2]), "sway": np.array([1.4e-13])}
    errors, said_of = {"lift": np.array([1e-5]), "sway": np.array([error])}, ("reduced", slider_crank())
    remarks = large_errors(errors, sizes, dict.fromkeys(sizes, "m"), *said_of)
    assert bool(remarks) == bool(warned) and all(warned in remark.text for remark in remarks)
    assert not any("has not converged" in remark.text for remark in remarks)
    assert felt(sizes, dict.fromkeys(sizes, "m"))["sway"] == 0.0
    # a force beside a torque at a length, and the other way round
    for grip, drive in (("N", "N m"), ("N m", "N")):
        carried, units = {"grip": np.array([1e-15]), "drive": np.array([2.0])}, {"grip": grip, "drive": drive}
        assert felt(carried, units)["grip"] > 0.0 == felt(carried, units, 0.4)["grip"]
    # pure numbers are beside 1, as a damage is
    tiny = {"whole": np.array([5.0]), "damage": np.array([1.5e-14, 2e-12])}
    assert felt(tiny, {})["damage"].tolist() == [0.0, 2e-12]
    assert not large_errors({"damage": np.array([1e-14, np.nan])}, {"damage": tiny["damage"]}, {}, *said_of)


@pytest.mark.parametrize(
    "size, error, warned",
    [
        (4.6e-8, 7e-7, ""),  # of bearings beside 66 mN m: more than all of it
        (0.0, 7e-7, ""),
        (4.6e-8, 2e-5, "mx all of it (20 µN m, where the run has none)"),
        (2e-5, 5e-6, ""),
        (2e-5, 1e-5, "mx 50 %"),
    ],
)
def test_components_of_what_a_joint_carries_are_seen_beside_the_others(size: float, error: float, warned: str) -> None:
    """Those of another joint, and of another unit, are not: `far` is wrong by more than all of it beside them."""
    outputs = (f"outputs.m{axis} = {{type='joint_torque', joint='crank_hinge', component='{axis}'}}" for axis in "xy")
    far = "outputs.far = {type='joint_torque', joint='guide', component='x'}"
    scene, units = spatial_slider_crank(*outputs, far), dict.fromkeys(("mx", "my", "far"), "N m")
    sizes = {"mx": np.array([size, 1.0]), "my": np.array([0.0663, 1e-6]), "far": np.array([4.6e-8, 1.0])}
    errors = {"mx": np.array([error, 0.0]), "my": np.array([5e-7, 0.0]), "far": np.array([7e-7, 0.0])}
    (remark,) = large_errors(errors, sizes, units, "reduced", scene)
    assert ("mx" in remark.text) == bool(warned) and warned in remark.text
    assert "far more than all of it" in remark.text and "my" not in remark.text


def test_an_output_without_an_estimate_says_why(tmp_path: Path) -> None:
    """In the terminal, among the remarks and in the file."""
    reason, time = "two estimates disagree", np.array([0.0, 1.0])
    outputs = {"tip": np.full(2, np.nan), "angle": np.zeros(2)}
    errors = EstimatedErrors(time, outputs, {"tip": 1.0, "angle": 1.0}, absent={"tip": reason})
    line, other = of_trajectory(errors, {"tip": "m", "angle": "rad"}, 1.0)[1:]
    assert line.endswith(" not estimated") and "not estimated" not in other  # a note has the reason
    (remark,) = not_estimated(errors, slider_crank())
    assert "errors were not estimated for tip: two estimates disagree; " in remark.text
    run, absent = synthetic.trajectory("reduced", n_frames=0), {"slider_position": reason}
    replace(run, errors=replace(run.errors, absent=absent)).write(tmp_path / "run.h5")
    assert Trajectory.read(tmp_path / "run.h5").errors.absent == absent


@pytest.mark.parametrize("n_steps", [1, 2, 201, 1000, 1009, MOST, MOST + 1, 3 * MOST - 7, 10 * MOST])
def test_schedules_are_even_and_end_with_the_run(n_steps: int) -> None:
    """Intervals are whole numbers of steps and all the same, but the first may be short."""
    found = schedules(n_steps, 3.0)
    kept = np.unique(np.concatenate([one.steps for one in found]))
    assert [one.steps.size for one in found] == sorted(one.steps.size for one in found)
    for one in found:
        assert (one.steps[0], one.steps[-1]) == (0, FINER * n_steps) and one.steps.size <= MOST + 1
        np.testing.assert_array_equal(kept[one.places], one.steps)
        np.testing.assert_array_equal(one.told, one.steps % FINER == 0)
        stride = one.interval / (3.0 / n_steps) * FINER
        assert stride == pytest.approx(round(stride), rel=1e-12)
        assert np.all(np.diff(one.steps)[1:] == round(stride)) and 0 < one.steps[1] <= round(stride)
    places = places_of(kept)
    assert np.all(places[kept] == np.arange(kept.size)) and np.sum(places < 0) == FINER * n_steps + 1 - kept.size


@pytest.mark.parametrize("n_steps", [MOST + 1, 3 * MOST, 10 * MOST])
def test_long_strides_have_no_common_factor_and_no_memory(n_steps: int) -> None:
    found = schedules(n_steps, 1.0)
    strides = [round(one.interval * n_steps) for one in found]
    assert len(strides) == 2 and min(strides) > 1 and math.gcd(*strides) == 1
    assert {one.spectral_radius for one in found} == {0.0}


def test_every_step_is_evaluated_and_smaller_ones_where_that_is_not_enough() -> None:
    found = schedules(1000, 1.0)
    assert [one.steps.size - 1 for one in found] == [1000, 2000, 4000]
    assert {one.spectral_radius for one in found} == {DAMPED}
    assert [one.steps.size - 1 for one in schedules(1000, 1.0, most=1999)] == [500, 1000]
    # however dear: so many are needed to see anything
    assert schedules(1000, 1.0, most=1)[-1].steps.size - 1 == LEAST


def test_factors_by_which_estimates_differ() -> None:
    one = {"a": np.array([1.0, 1.0, 2.0, np.nan, 1e-12, 1.0])}
    other = {"a": np.array([1.0, 2.0, 1.0, 1.0, 1e-15, 0.0])}
    # what is below the floor, as an output that is zero but for round-off, is that
    np.testing.assert_allclose(differences(one, other, {"a": 1e-10})["a"], [1.0, 2.0, 2.0, np.nan, 1.0, 1e10])


def sampled(table: str, n_steps: int = 100, n_evaluations: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """Return instants of evaluation and amplitudes of a torque in a run of 1 s."""
    scene = slider_crank(f"effects.motor.table={table}")
    (effect,) = effects_of(scene, kinematics_of(scene).mechanism)
    steps = np.linspace(0, n_steps, n_evaluations + 1).round().astype(int)
    load = SampledLoad(effect, steps, 1.0 / n_steps, 1.0 / n_evaluations)
    time = np.arange(n_evaluations + 1) / n_evaluations
    np.testing.assert_array_equal(load.amplitude(time), [load.amplitude(float(t)) for t in time])
    assert load.name == effect.name
    return time, load.amplitude(time)


def test_a_load_that_the_steps_resolve_is_what_it_is() -> None:
    time, found = sampled("[[0.0, 1.0], [1.0, 3.0]]")
    np.testing.assert_allclose(found, 1.0 + 2.0 * time, rtol=1e-12)


@pytest.mark.parametrize("jump", [0.302, 0.3051, 0.309])
def test_the_impulse_between_steps_is_not_lost(jump: float) -> None:
    """Steps see the torque from the next one on, by the trapezoidal rule; its impulse up to the end is exact."""
    time, found = sampled(f"[[0.0, 0.0], [{jump}, 0.0], [{jump + 1e-9}, 2.0], [1.0, 2.0]]")
    plain = np.where(time > jump, 2.0, 0.0)
    seen = np.trapz(np.where(np.arange(101) / 100 > jump, 2.0, 0.0), dx=0.01)
    assert (found - plain).sum() * 0.1 == pytest.approx(2.0 * (1.0 - jump) - seen, abs=2e-3 * 2.0 / 16 * 10)
    np.testing.assert_allclose(found[np.abs(time - jump) > 0.1], plain[np.abs(time - jump) > 0.1], rtol=0, atol=1e-12)


def test_gravity_does_not_change() -> None:
    scene = paper_scene('effects.weight={type="gravity"}')
    weight = effects_of(scene, kinematics_of(slider_crank()).mechanism)[1]
    load = SampledLoad(weight, np.arange(0, 101, 10), 0.01, 0.1)
    np.testing.assert_allclose(load.amplitude(np.linspace(0.0, 1.0, 11)), 1.0, rtol=1e-12)


@pytest.mark.parametrize(
    ("n_steps", "every", "most", "strides"),
    [
        (1000, 1000, MOST, [4, 2, 1]), (1003, 1003, MOST, [4, 2, 1]), (1000, 5, 2000, [20, 4, 2]),
        (1000, 2, 999, []), (9000, 3, MOST, []), (9000, 6, MOST, [24, 12, 8]), (1000, 1, 1000, []),
    ],
)  # fmt: skip
def test_samplings_are_at_evaluations(n_steps: int, every: int, most: int, strides: list[int]) -> None:
    """Samplings after every so many steps; where two strides are not left, nothing is estimated."""
    found = schedules(n_steps, 1.0, most, every)
    assert [round(one.interval * FINER * n_steps) for one in found] == strides
    for one in found:
        assert not np.ptp(np.diff(one.steps)) and one.steps.size <= most + 1
        assert np.isin(np.arange(0, FINER * n_steps, FINER * every), one.steps).all()


@pytest.fixture(scope="module")
def model() -> ReducedModel:
    return reduced_model(paper_scene("reduction.modes=4", "reduction.angles=24", 'reduction.interpolation="spline"'))


def states_of(model: ReducedModel, n_instants: int = 6, n_samples: int = 3, bent: float = 1.0) -> np.ndarray:
    """Return made-up states, (n_instants, 4, n_samples, n_eta): speeds from rest to fast, and bending of 1e-4 m."""
    states = np.random.default_rng(1).normal(size=(n_instants, 4, n_samples, 1 + model.terms.tables.n_modes))
    states[..., 1:] *= bent * 1e-5
    states[:, 1] *= np.linspace(0.0, 30.0, n_instants)[:, None, None]
    states[:, 2] *= 50.0
    states[:, 3] *= 1e-3
    return states


def motion_of(model: ReducedModel, states: np.ndarray) -> ReferenceMotion:
    checking = CheckingModel(model)
    n_dofs = checking.full.kinematics.mechanism.n_dofs
    return ReferenceMotion(checking.unknowns_of, n_dofs, states, 1, np.full(3, 3e-3), checking.rotations)


@pytest.mark.parametrize("turning", [0.0, 5.0])
def test_accelerations_of_bodies_that_are_shaken_hard(turning: float) -> None:
    """Loads that bend bodies at once lead not off the path: J eta'' + d^2 q / d tau^2 along eta', of second order."""
    basis = ("reduction.modes=4", "reduction.angles=24", 'reduction.interpolation="spline"')
    model = reduced_model(paper_scene(*basis, "reduction.second_order=true"))
    states = states_of(model)
    states[:, 1, :, 0] = turning
    states[:, 2, :, 0] = 1e3
    states[:, 2, :, 1:] *= 1e9
    motion = motion_of(model, states)
    checking = CheckingModel(model)

    def unknowns(eta: np.ndarray) -> np.ndarray:
        return checking.unknowns_of(eta[None])[:, 0]

    rotations = checking.rotations
    tau = module.TURN / np.sqrt(module.TURN * 1e3 + turning**2)
    assert np.max(tau**2 * np.abs(states[:, 2, :, 1:]) @ rotations) > 30.0
    for number, (q, v, a, _) in enumerate(states):
        far = 1e-3 / np.abs(a[:, 1:] @ np.diag(rotations)).sum(axis=1)
        pushed = (unknowns(q + far[:, None] * a) - unknowns(q - far[:, None] * a)) / (2.0 * far)
        curved = (unknowns(q + 1e-4 * v) - 2.0 * unknowns(q) + unknowns(q - 1e-4 * v)) / 1e-8
        scale = np.abs(pushed).max()
        # BEND by which bodies bend on the path, times the turn meanwhile, 1e-4 rad; the mechanism's turn alone sets
        # a path on which it is 0.03 to 3
        np.testing.assert_allclose(motion.over(number, 1)[2, 0], pushed + curved, rtol=0, atol=5e-5 * scale)


def test_instants_do_not_depend_on_what_is_computed_together(model: ReducedModel, monkeypatch) -> None:
    states = states_of(model)
    together = motion_of(model, states)
    expected = [together.over(number, 1)[:, 0] for number in range(len(states))]
    monkeypatch.setattr(module, "LARGEST", 1)
    alone = motion_of(model, states)
    for number in (0, 1, 5, 2):
        found = alone.over(number, 1)[:, 0]
        np.testing.assert_array_equal(found[0], expected[number][0])
        np.testing.assert_allclose(found[2], expected[number][2], rtol=1e-12)
    np.testing.assert_array_equal(alone.over(1, 4)[0], [expected[number][0] for number in range(1, 5)])
    np.testing.assert_array_equal(alone.over(3, 2)[2], alone.over(2, 4)[2, 1:3])


def swinging_out(*overrides: str) -> Scene:
    """Return a double pendulum whose elbow leaves its range at 0.96 s."""
    narrow = "coordinates.elbow_angle.range=[-0.6, 0.6]", "reduction.angles=12"
    return load_scene(ROOT / "scenes" / "double_pendulum.toml", (*narrow, *overrides))


@pytest.mark.parametrize("model", ["reduced", "full", "components"])
def test_a_run_that_stops_has_the_errors_of_one_that_ends_before(model: str) -> None:
    """Nine tenths of it as a run of its own."""
    run = trajectory(model, swinging_out())
    assert run.status == Status.LEFT_RANGE
    n = int(0.9 * (run.time.size - 1))
    until, what = run.time[n], {"reduced": "errors"}.get(model, "errors of the time step")
    assert f"{what} were estimated up to {until:.4g} s: the run stopped before its end" in warnings_and_notes(run)
    shorter = trajectory(model, swinging_out(f"simulation.duration={until}"))
    assert shorter.status == Status.FINE and run.errors.time[-1] == pytest.approx(until)
    for name, errors in shorter.errors.outputs.items():
        np.testing.assert_allclose(run.errors.outputs[name], errors, atol=1e-6 * np.abs(errors).max())
    assert run.errors.largest == pytest.approx(shorter.errors.largest, rel=1e-9)
    assert f"up to {until:.4g} s only" in of_trajectory(run.errors, run.units, run.time[-1])[0]


def test_a_run_that_stops_in_its_first_steps_has_no_errors() -> None:
    start = "simulation.initial.elbow_angle={position=0.5999, velocity=20.0}"
    for model, what in (("reduced", "errors"), ("full", "errors of the time step")):
        run = trajectory(model, swinging_out(start))
        assert run.status == Status.LEFT_RANGE and run.time.size < 20 and run.errors is None
        assert f"{what} were not estimated: the run stopped before its end" in warnings_and_notes(run)


def warnings_and_notes(run: Trajectory) -> str:
    return "\n".join(remark.text for remark in run.record.remarks)


def test_ensembles_warn_of_no_displacement_that_is_round_off_beside_the_mechanism(tmp_path: Path) -> None:
    """A rod that is pulled along itself bends by 1e-17 m, of which the errors that are estimated are ten times as
    large."""
    (tmp_path / "pulled.toml").write_text(
        HEADER
        + tables("""
parameters.mass: nominal = 0.5; distribution = { name = "uniform", loc = 0.4, scale = 0.2 }
bodies.rod: line = { length = 0.2, elements = 3 }; element = "beam2d"; material = "steel";
    section = { shape = "circle", radius = 0.004 }; placement = { angle = 0.3 }
joints.guide: type = "prismatic"; connect = ["ground:origin", "rod:hinge"]; axis = [0.955336489125606, 0.29552020666134]
coordinates.x: joint = "guide"; range = [-1.0, 1.0]
effects.pull: type = "force"; joint = "guide"; table = [[0.0, 0.0], [0.02, 1.0]]
effects.load: type = "point_mass"; point = "rod:tip"; mass = "mass"
outputs.bend: type = "deformation"; point = "rod:tip"; axis = "y"; frame = "body"
simulation: duration = 0.05; step = 1e-3
""")
    )
    found = pgmp.montecarlo(tmp_path / "pulled.toml", 3, model="full")
    assert 0.0 < np.abs(found.outputs["bend"]).max() < 1e-14
    alone = pgmp.montecarlo(tmp_path / "pulled.toml", 1, model="full")  # of one sample nothing is constant
    for text in (remark.text for one in (found, alone) for remark in one.record.remarks):
        assert "large estimated errors" not in text and "good part" not in text
