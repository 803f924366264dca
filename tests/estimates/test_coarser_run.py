"""The error of a time step from a coarser run: free vibrations, whose exact and scheme's motion are known."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT
from mpi4py import MPI
from runs import PAPER_SCENE, motion, trajectory

from pgmp_petsc.estimates import coarser_run
from pgmp_petsc.estimates.own_error import step_remarks, too_few_steps
from pgmp_petsc.mechanism.capabilities import Purpose
from pgmp_petsc.models import FullModel, OutputRecord
from pgmp_petsc.scene import load_scene
from pgmp_petsc.stepping.alpha_step import AlphaStep
from pgmp_petsc.stepping.generalised_alpha import GeneralisedAlpha
from pgmp_petsc.stepping.second_order_system import Moment, SecondOrderSystem, StepsTaken
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies.inputs import read_scene
from scenes import tables

N_STEPS, STEP = 1000, 1e-3
RADIUS = 0.8  # spectral radius of the scene


def on_rail(more: str) -> str:
    """Return the text of a scene of a mass on a rail with more tables."""
    return tables("""
scene: name = "carriage"
bodies.mass: rigid = { mass = 1.0, inertia = 1.0, points = { c = [0.0, 0.0] } }
joints.rail: type = "prismatic"; connect = ["ground:origin", "mass:c"]; axis = [1.0, 0.0]
coordinates.x: joint = "rail"; range = [-3.0, 3.0]
""" + more + """
outputs.x: type = "sliding"; joint = "rail"
""")  # fmt: skip


def ratios(path: Path, step: float, times: int, *entries: str) -> dict[str, float]:
    """Return estimated over true errors of outputs of a full-order run, the true ones against one with so many steps
    in one of its own."""
    found = trajectory("full", load_scene(path, [*entries, f"simulation.step={step}"]))
    exact = motion("full", load_scene(path, [*entries, f"simulation.step={step / times}"]))
    return {
        name: np.abs(errors).max() / np.abs(found.outputs[name] - exact.outputs[name][::times]).max()
        for name, errors in found.errors.outputs.items()
    }


def test_without_numerical_damping_the_scheme_is_the_trapezoidal_rule() -> None:
    """Whose vibrations turn by 2 atan(omega h / 2) in a step (Hughes 2000, section 9.1)."""
    turns = np.array([0.01, 0.5, 2.0, 30.0])
    rates = coarser_run.amplification(1.0, turns)
    np.testing.assert_allclose(rates.imag, 2.0 * np.arctan(0.5 * turns), rtol=1e-9)
    np.testing.assert_allclose(rates.real, 0.0, atol=1e-12)


def test_numerical_damping_is_that_of_the_spectral_radius_at_infinite_frequency() -> None:
    assert coarser_run.amplification(RADIUS, np.array([1e6])).real[0] == pytest.approx(np.log(RADIUS), rel=1e-2)


def runs(omega: float, amplitude: float = 1.0, reach: int | None = None, n_steps: int = N_STEPS) -> tuple:
    """Return time, outputs, the exact output, and the coarser run: a slow rise with a vibration on it."""
    time, at = STEP * np.arange(n_steps + 1), coarser_run.TIMES * STEP * np.arange(n_steps // coarser_run.TIMES + 1)
    reach = at.size - 1 if reach is None else reach

    def as_computed(times: np.ndarray, step: float) -> np.ndarray:
        rate = coarser_run.amplification(RADIUS, np.array([omega * step]))[0] / step
        return amplitude * np.real(np.exp(rate * times))

    values, coarse = time + as_computed(time, STEP), at + as_computed(at, coarser_run.TIMES * STEP)
    fine, status, failure = reach == at.size - 1, np.zeros(1, dtype=int), np.full(1, np.nan)
    if not fine:
        status[0], failure[0] = Status.NOT_CONVERGED, at[reach + 1]
        coarse[reach + 1 :] = np.nan
    return time, {"x": values}, time + amplitude * np.cos(omega * time), coarser_run.CoarserRun(
        coarser_run.TIMES * STEP, at, {"x": coarse[:, None]}, status, failure, np.zeros(1), *np.full((2, 1), np.inf), {}
    )  # fmt: skip


def sizes(outputs: Mapping[str, np.ndarray]) -> dict[str, float]:
    return {name: float(np.abs(values).max()) for name, values in outputs.items()}


@pytest.mark.parametrize("omega", [10.0, 30.0, 100.0, 200.0, 400.0, 800.0])
@pytest.mark.parametrize("amplitude", [1.0, 1e-3])
def test_resolved_or_lost_a_vibration_is_estimated_within_a_factor_of_three(omega: float, amplitude: float) -> None:
    """From 600 steps a period, with an error of 1e-5, to 8, where the run and the coarser one have lost its phase."""
    time, outputs, exact, other = runs(omega, amplitude)
    found = coarser_run.step_errors(load_scene(PAPER_SCENE), time, outputs, sizes(outputs), other)
    true = np.abs(outputs["x"] - exact).max()
    assert 1 / 3 < np.abs(found.outputs["x"]).max() / true < 3
    np.testing.assert_array_equal(found.time, other.time)
    assert not found.unsure and np.isfinite(found.lost_hz) == (true > 0.1 and omega > 100.0)
    if np.isfinite(found.lost_hz):  # bands are 1 / 62 of the steps' frequency wide
        assert found.lost_hz == pytest.approx(omega / (2.0 * np.pi), abs=20.0)


@pytest.mark.parametrize("omega", [10.0, 30.0, 100.0, 200.0, 400.0])
def test_a_vibration_is_lost_in_an_output_too_that_jumps_at_samplings(omega: float) -> None:
    """Of a force across a rail, whose servo is sampled, 1.1 % was estimated where the step was wrong by 50 %."""
    servo = 'type="pid",joint="crank_hinge",measures="crank_angle",reference=1.0,gains={p=1.0},sample_time=5e-3'
    force = 'outputs.x={type="joint_force",joint="crank_hinge",component="x"}'
    scene = load_scene(PAPER_SCENE, [f"controllers.servo={{{servo}}}", force])
    assert scene.outputs["x"].jumps_in(scene)
    time, outputs, exact, other = runs(omega)
    held = 0.5 * np.random.default_rng(1).normal(size=other.time.size)
    outputs["x"] += np.repeat(held, coarser_run.TIMES)[: time.size]
    other.outputs["x"][:, 0] += held
    found = coarser_run.step_errors(scene, time, outputs, sizes(outputs), other)
    true = np.abs(outputs["x"] - np.repeat(held, coarser_run.TIMES)[: time.size] - exact).max()
    assert 1 / 3 < np.abs(found.outputs["x"]).max() / true < 3
    assert np.isfinite(found.lost_hz) == (omega > 100.0)


@pytest.mark.parametrize("n_steps", [1000, 5000, 20000])
@pytest.mark.parametrize("omega", [50.0, 85.0, 115.0, 150.0, 250.0])
def test_phases_that_meet_again_after_whole_turns_are_lost_all_the_same(omega: float, n_steps: int) -> None:
    """Of 20,000 steps at 115 rad/s, in which the coarser run loses ten turns, a seventh of the error was estimated."""
    time, outputs, exact, other = runs(omega, n_steps=n_steps)
    found = np.abs(coarser_run.step_errors(load_scene(PAPER_SCENE), time, outputs, sizes(outputs), other).outputs["x"])
    true = np.abs(outputs["x"] - exact)
    assert 1 / 3 < found.max() / true.max() < 3
    assert found[-1] > true[-round(2.0 * np.pi / (omega * STEP)) :].max() / 3  # of the last period


@pytest.mark.parametrize("omega", [100.0, 200.0, 400.0, 800.0, 1600.0])
@pytest.mark.parametrize("damping", [0.0, 0.005, 0.02, 0.1])
def test_errors_of_a_vibration_fade_as_its_damping_has_it(tmp_path: Path, omega: float, damping: float) -> None:
    """A mass on a spring is kicked: ``x = v exp(-D omega t) sin(omega' t) / omega'`` (share D of critical damping).

    Without what damping takes of an error it was 4 times too large at 100 rad/s; and half of it, capped by how far the
    runs are apart, where the coarser one has no vibration left (1600 rad/s).
    """
    (path := tmp_path / "oscillator.toml").write_text(on_rail(f"""
effects.spring: type = "spring_damper"; joint = "rail"; stiffness = {omega**2}; damping = {2.0 * damping * omega}
simulation: duration = 1.0; step = 1e-3; initial = {{ x = {{ velocity = 1.0 }} }}
"""))  # fmt: skip
    found, damped = trajectory("full", load_scene(path)), omega * np.sqrt(1.0 - damping**2)
    exact = np.exp(-damping * omega * found.time) * np.sin(damped * found.time) / damped
    assert 0.8 < np.abs(found.errors.outputs["x"]).max() / np.abs(found.outputs["x"] - exact).max() < 2.8


@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
def test_a_vibration_counts_that_the_coarser_run_has_not(step: float) -> None:
    """Of 280 Hz, which the bend of a torque's table sets off: a third of its error was estimated."""
    found = ratios(ROOT / "scenes" / "slider_crank.toml", step, round(step / 1.5625e-5))
    assert 0.5 < found["slider_deformation"] < 2.0


def test_short_runs_are_compared_with_half_of_their_steps() -> None:
    """Of a crane over 80 steps, with 16 in the coarser run 0.4 of the error was estimated."""
    for name, ratio in ratios(ROOT / "scenes" / "bridge_crane.toml", 5e-3, 16, "simulation.duration=0.4").items():
        assert 0.5 < ratio < 2.0, name


def test_an_estimate_ends_a_tenth_before_the_coarser_run_does() -> None:
    time, outputs, _, other = runs(30.0, reach=60)
    found = coarser_run.step_errors(load_scene(PAPER_SCENE), time, outputs, sizes(outputs), other)
    assert found.time[-1] == pytest.approx(0.265) and np.isfinite(found.outputs["x"]).all()
    said = [remark.text for remark in step_remarks(_Model(), time, outputs, other, found)]
    assert len(said) == 1 and said[0].startswith("errors of the time step were estimated up to 0.265 s of 1 s: ")
    assert "stopped at 0.305 s (Newton's iteration did not converge" in said[0]


def test_an_estimate_ends_before_the_coarser_run_runs_away_by_itself() -> None:
    """As that of a fan in soft bearings, which grew by an eighth from step to step: 440 N were said of 0.4 N."""
    time, outputs, _, other = runs(10.0)
    grown = 1e-6 * 1.133 ** np.arange(other.time.size)
    away = replace(other, outputs={"x": other.outputs["x"] + grown[:, None]})
    found = coarser_run.step_errors(load_scene(PAPER_SCENE), time, outputs, sizes(outputs), away)
    left = np.argmax(grown > coarser_run.ASTRAY * outputs["x"].max())
    assert 0.5 * left < found.time.size < 0.91 * left
    assert np.abs(found.outputs["x"]).max() < 0.01 * np.abs(outputs["x"]).max()
    said = [one.text for one in step_remarks(_Model(), time, outputs, away, found)]
    assert any("ran away from this one by itself (outputs.x)" in text for text in said)


def test_too_little_tells_nothing() -> None:
    time, outputs, _, other = runs(30.0, reach=coarser_run.FEWEST - 1)
    assert coarser_run.step_errors(load_scene(PAPER_SCENE), time, outputs, sizes(outputs), other) is None
    said = [remark.text for remark in step_remarks(_Model(), time, outputs, other, None)]
    assert len(said) == 1 and said[0].startswith("errors of the time step were not estimated: ")
    assert "--override simulation.step=0.0005" in said[0]
    # a run that failed was integrated again with half of the scene's step, which is no better one to compare with
    (said,) = step_remarks(_Model(), 0.5 * time, outputs, replace(other, step=0.5 * other.step), None)
    assert "--override simulation.step=0.00025" in said.text
    # of a run of one step fewer than ten of the coarser one take
    n, scene = coarser_run.fewest_steps(coarser_run.TIMES), load_scene(PAPER_SCENE)
    few = {name: values[:n] for name, values in outputs.items()}
    (few_said,) = step_remarks(_Model(), time[:n], few, other, None)
    assert f"the run has {n - 1} steps, the estimate needs {n} or more" in few_said.text and not too_few_steps(n, scene)


def test_no_coarser_run_is_taken_that_tells_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a solid with 44,000 unknowns it took 30 s, and its run of 10 steps 100 s."""
    monkeypatch.setattr(coarser_run, "run_coarser", None)
    said = trajectory("full", load_scene(PAPER_SCENE, ["simulation.duration=0.01"])).record.remarks
    assert any("the run has 10 steps, the estimate needs " in remark.text for remark in said)


@pytest.mark.parametrize(
    ("entries", "turning"),
    [
        ('type="joint_friction", limit=0.01, speed=0.1', True),
        ('type="law", force="-0.01 * tanh(v / 0.1)"', True),
        ('type="law", force="-0.01 * max(s, 0)"', True),
        ('type="law", force="-0.01 * v * (s > 0)"', True),
        # the lift of a governor, whose spring and damper are written so, was "3.5 times" its error, and unsure
        ('type="law", force="-0.01 * v - 0.2 * sin(s)"', False),
        ('type="joint_damping", coefficient=0.01', False),
    ],
)
def test_what_turns_at_once_beside_a_lost_vibration_makes_it_unsure(entries: str, turning: bool) -> None:
    time, outputs, _, other = runs(400.0)
    scene = load_scene(PAPER_SCENE, [f'effects.brake={{joint="crank_hinge", {entries}}}'])
    found = coarser_run.step_errors(scene, time, outputs, sizes(outputs), other)
    assert ("turn at once (effects.brake)" in found.unsure) == turning and bool(found.unsure) == turning
    said = [remark.text for remark in step_remarks(_Model(), time, outputs, other, found)]
    assert any(text.startswith("estimated errors of the time step are unsure") for text in said) == turning


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"shortest": np.full(1, 9.0 * coarser_run.TIMES * STEP)}, "a contact lasts 0.045 s"),
        ({"divided": np.full(1, 0.25)}, "25 % of the coarser steps failed"),
    ],
)
def test_brief_contacts_and_steps_that_failed_make_it_unsure(changes: dict, why: str) -> None:
    """A contact of fewer than ten coarser steps, and what the coarser run took with the steps of the run itself."""
    time, outputs, _, other = runs(10.0)
    sure, found = (
        coarser_run.step_errors(load_scene(PAPER_SCENE), time, outputs, sizes(outputs), run)
        for run in (other, replace(other, **changes))
    )
    assert not sure.unsure and found.unsure.startswith(why)
    many = replace(other, shortest=np.full(1, 11.0 * coarser_run.TIMES * STEP))  # contacts of many steps are resolved
    assert not coarser_run.step_errors(load_scene(PAPER_SCENE), time, outputs, sizes(outputs), many).unsure
    order = np.sqrt(24.0 * 2.0) * (1.0 - changes.get("divided", np.zeros(1))[0])
    # where no vibration is lost, the difference counts by the order alone
    np.testing.assert_allclose(found.outputs["x"] * order, sure.outputs["x"] * (coarser_run.TIMES**2 - 1.0), rtol=1e-12)


@pytest.mark.parametrize(
    ("entries", "jumps"),
    [
        ('type="law", force="0.5 * (t < 0.3)"', True),
        ('type="torque", table=[[0.0, 0.5], [0.3, 0.5], [0.3001, -0.4]]', True),
        ('type="torque", table=[[0.0, 0.5], [0.3, 0.5], [0.3001, 0.45]]', False),
        ('type="torque", table=[[0.0, 0.5], [0.3, 0.5], [0.4, -0.4]]', False),
        ('type="torque", harmonic={amplitude=0.5, frequency_hz=3.0}', False),
    ],
)
def test_errors_fall_as_the_step_where_a_force_jumps(entries: str, jumps: bool) -> None:
    time, outputs, _, other = runs(10.0)
    motor = [f'effects.motor={{joint="crank_hinge", {entries}}}']
    sure, found = (
        coarser_run.step_errors(load_scene(PAPER_SCENE, more), time, outputs, sizes(outputs), other)
        for more in ((), motor)
    )
    assert not sure.unsure and ("where a force jumps (effects.motor)" in found.unsure) == jumps
    r = coarser_run.TIMES
    order = r - 1.0 if jumps else r**2 - 1.0
    np.testing.assert_allclose(found.outputs["x"] * order, sure.outputs["x"] * (r**2 - 1.0), rtol=1e-12)


CARRIAGE = on_rail("""
controllers.servo: type = "pid"; measures = "x"; joint = "rail"; reference = 1.0; gains = { p = 40.0 };
    sample_time = 0.02
effects.oil: type = "joint_damping"; joint = "rail"; coefficient = 4.0
effects.rubs: type = "joint_friction"; joint = "rail"; limit = 3.0; speed = 0.05
simulation: duration = 0.5
""")


@pytest.mark.parametrize("step", [1e-2, 5e-3, 2.5e-3])
def test_friction_turns_at_once_with_a_force_that_is_held(tmp_path: Path, step: float) -> None:
    """With two or four steps in a coarser one, a sixth of the error was estimated."""
    path = tmp_path / "carriage.toml"
    path.write_text(CARRIAGE)
    assert 1 / 3 < ratios(path, step, round(step / 1.25e-4))["x"] < 3.0


RISE = "-0.3 * (1 + tanh((s - {at}) / {width}))"


@pytest.mark.parametrize(("width", "unsure"), [(0.1, False), (3e-3, True)])
@pytest.mark.parametrize("written", ["table", "law", "law over", "law between points"])
def test_a_force_that_bends_within_a_step_of_the_coarser_run(
    tmp_path: Path, written: str, width: float, unsure: bool
) -> None:
    """A mass is slowed down on some millimetres: the coarser run, of 10 mm a step, knows little of that. The true
    motion follows from the work that is done, ``t = int dx / v``."""
    x = np.linspace(0.0, 2.2, 400001)
    rows = np.array([[0.313, 0.0], [0.313 + 3 * width, -1.2], [0.313 + 6 * width, 0.0]])
    force = np.interp(x, *rows.T) if written == "table" else -0.3 * (1.0 + np.tanh((x - 0.313) / width))
    press = {
        "table": f'type = "force"; joint = "rail"; over = "rail"; table = {rows.tolist()}',
        "law": f'type = "law"; joint = "rail"; force = "{RISE.format(at=0.313, width="w")}"; constants.w = {width}',
        "law over": f'type = "law"; joint = "rail"; over = "rail"; force = "{RISE.format(at=0.313, width=width)}"',
        "law between points": 'type = "law"; points = ["ground:far", "mass:c"]; '
        f'force = "{RISE.format(at=1.313, width=width)}"',
    }[written]
    (path := tmp_path / "bends.toml").write_text(
        on_rail(f"""
ground.points: far = [-1.0, 0.0]
effects.press: {press}
simulation: duration = 1.0; step = 1e-3; initial = {{ x = {{ velocity = 2.0 }} }}
""")
    )
    found = trajectory("full", load_scene(path))
    work = np.append(0.0, np.cumsum(0.5 * (force[1:] + force[:-1]))) * x[1]
    pace = 1.0 / np.sqrt(4.0 + 2.0 * work)
    exact = np.interp(found.time, np.append(0.0, np.cumsum(0.5 * (pace[1:] + pace[:-1]))) * x[1], x)
    ratio = np.abs(found.errors.outputs["x"]).max() / np.abs(found.outputs["x"] - exact).max()
    said = [one for one in found.record.remarks if "a force bends within a step of the coarser run" in one.text]
    assert [("(effects.press)" in one.text) for one in said] == [True] * unsure
    assert unsure or 1 / 3 < ratio < 3


@pytest.mark.parametrize("ratio", [2.0, 3.0, 4.0, 5.0])
def test_what_is_unsure_counts_more_than_what_is_resolved(ratio: float) -> None:
    """Of a run with two steps in a coarser one, it counted less than half of it."""
    assert 0.5 * (ratio - 1.0) < coarser_run.rough(ratio) < 0.5 * (ratio**2 - 1.0)


def test_round_off_has_no_vibration_that_is_lost() -> None:
    """Of a motion that a symmetric machine does not do something is left in both runs, and alike in neither."""
    time, outputs, _, other = runs(10.0, amplitude=1e-6)
    random = np.random.default_rng(0)
    outputs["y"] = 1e-17 * random.normal(size=time.size)
    other.outputs["y"] = 1e-17 * random.normal(size=(other.time.size, 1))
    grown = replace(other, outputs=other.outputs | {"y": 1e-19 * np.exp(np.minimum(other.time, 1.0) * 30.0)[:, None]})
    for size, felt in ((0.0, False), (np.abs(outputs["y"]).max(), True)):
        largest = sizes(outputs) | {"y": size}
        found = coarser_run.step_errors(load_scene(PAPER_SCENE), time, outputs, largest, other)
        assert np.isfinite(found.lost_hz) == felt
        found = coarser_run.step_errors(load_scene(PAPER_SCENE), time, outputs, largest, grown)
        assert (found is None or found.time[-1] < other.time[-1]) == felt
    unsure = replace(other, shortest=np.full(1, STEP))
    found = coarser_run.step_errors(load_scene(PAPER_SCENE), time, outputs, sizes(outputs) | {"y": 0.0}, unsure)
    (said,) = step_remarks(_Model(), time, {"x": outputs["x"]}, unsure, found)
    assert said.kind == "note" and "are unsure" in said.text


def test_what_is_unsure_is_a_note_where_it_is_small() -> None:
    time, outputs, _, other = runs(10.0, amplitude=1e-6)
    found = coarser_run.step_errors(
        load_scene(PAPER_SCENE), time, outputs, sizes(outputs), replace(other, shortest=np.full(1, STEP))
    )
    (said,) = step_remarks(_Model(), time, outputs, other, found)
    assert said.kind == "note" and "are unsure" in said.text


class _Model:
    """What remarks take of a model."""

    scene = load_scene(PAPER_SCENE)


def test_a_step_that_fails_is_taken_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where all do, the coarser run is one with the steps of the run itself, but for what starts every five of them."""
    scene, meshes = read_scene(PAPER_SCENE, ("simulation.duration=0.2",), (), MPI.COMM_SELF, Purpose.FULL)
    model, alive = FullModel(scene, meshes), np.ones(1, dtype=bool)
    take, retry = AlphaStep.take, AlphaStep.retry

    def angle(system: SecondOrderSystem, n_steps: int, parts: int) -> np.ndarray:
        record = OutputRecord(model, system)
        stepper = GeneralisedAlpha(system, RADIUS, 0.2, n_steps, alive, np.array([0, n_steps]), record, None, parts)
        stepper.advance()
        assert stepper.status[0] == Status.FINE and len(stepper.divided) == (n_steps if parts > 1 else 0)
        return record.outputs()[1]["crank_angle"][:: n_steps // 40, 0]

    def failing(self: AlphaStep, moment: Moment, ends: np.ndarray, *given: object) -> StepsTaken:
        taken = take(self, moment, ends[:1], *given)
        return taken if self._patient else replace(taken, lost=alive.copy())

    def failing_again(self: AlphaStep, moment: Moment, *given: object) -> tuple[Moment, np.ndarray]:
        return retry(self, moment, *given) if self._patient else (moment, alive.copy())

    with model.single(scene.values, MPI.COMM_SELF) as system:
        fine, coarse = angle(system, 200, 1), angle(system, 40, 1)
        monkeypatch.setattr(AlphaStep, "take", failing)
        monkeypatch.setattr(AlphaStep, "retry", failing_again)
        divided = angle(system, 40, coarser_run.TIMES)
    # measured: a twentieth
    assert np.abs(divided - fine).max() < 0.1 * np.abs(coarse - fine).max()


def test_an_estimate_ends_where_most_coarser_steps_begin_to_fail() -> None:
    """Of three samples: one that fails now and then, one from step 30 on, one at its end only."""
    fails = np.zeros((50, 3), dtype=bool)
    fails[::3, 0] = fails[30:, 1] = fails[-5:, 2] = True
    steps = [(k, row) for k, row in enumerate(fails) if row.any()]
    run = SimpleNamespace(n_done=50, status=np.zeros(3), divided=steps, instants=0.1 * np.arange(51))
    until, share = coarser_run._taken_in_parts(run)
    # the first ten steps of which more than half failed begin with four that did not
    np.testing.assert_allclose(until, [np.inf, 2.6, np.inf])
    np.testing.assert_allclose(share, [17 / 50, 0.0, 5 / 50])
    time, outputs, _, other = runs(10.0, reach=50)
    other = replace(other, status=np.zeros(1, dtype=int), until=other.time[50:51])
    found = coarser_run.step_errors(_Model.scene, time, outputs, sizes(outputs), other)
    (said,) = step_remarks(_Model(), time, outputs, other, found)
    assert "up to 0.22 s of 1 s" in said.text and "failed in most of its steps from 0.25 s on" in said.text


def test_kinks_of_a_largest_value_are_no_lost_vibration() -> None:
    """With other points taking over, stresses of the coupler were estimated at 19 times their error."""
    largest = 'outputs.worst={type="stress", body="coupler", quantity="stress_max"}'
    found = ratios(ROOT / "scenes" / "four_bar.toml", 1e-3, 8, largest, "simulation.duration=0.5")
    assert 1 / 3 < found["worst"] < 3.0
