"""Rare events and random fields through the command, on one rank and on several."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import run_mpi
from mpi4py import MPI
from runs import PGMP, SMALL, in_turn, paper_scene, pgmp, rom_of

from pgmp_petsc.ensemble import rare_run
from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.rare_run import run_rare_event
from pgmp_petsc.ensemble.sampling import Sampler
from pgmp_petsc.estimates.runs_at_points import RunsAtPoints
from pgmp_petsc.models import ReducedModel
from pgmp_petsc.results.ensemble import RareEvent
from pgmp_petsc.results.summary import json_text, summary_of
from pgmp_petsc.scene.numerics import Event
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.texts.ensemble_table import lines_of_rare_event

UNCERTAIN = (
    *SMALL,
    'parameters.push={nominal=1.0, distribution={name="norm", loc=1.0, scale=0.1}}',
    'effects.motor.scale="push"',
    'fields.soft={body="rod", quantity="E", variation=0.1, length=0.3, terms=2, distribution="uniform"}',
)
EVENT = "crank_angle > 2.4e-3"


@pytest.fixture(scope="module")
def model() -> ReducedModel:
    scene = paper_scene(*UNCERTAIN)
    return ReducedModel(scene, rom_of(scene))


@pytest.fixture(scope="module")
def found(folder: Path, model: ReducedModel) -> tuple[RareEvent, str]:
    model.rom.write(folder / "rom.h5")
    done = pgmp("montecarlo", folder / "rom.h5", "-n", 1000, "--rare", EVENT, "-o", folder / "rare.h5")
    return RareEvent.read(folder / "rare.h5"), done.stdout


def test_the_probability_is_that_of_the_samples_and_the_terminal_says_it(
    found: tuple[RareEvent, str], model: ReducedModel
) -> None:
    event, said = found
    assert "crank_angle above 2.4 mrad at the end" in said and f"{event.estimate:.4g} [" in said
    assert "another --seed looks again" in said
    weighted = event.weight > 0.0
    inside = event.value > 2.4e-3
    assert event.estimate == pytest.approx(np.mean((event.weight * inside)[weighted]), rel=1e-12)
    # random samples know the probability by themselves, to the root of their number
    n = 4000
    angles = run_batch(model, Sampler(model.scene, Plan(n, 2)).draw(0, n)).outputs["crank_angle"]
    chance = np.mean(angles > 2.4e-3)
    assert abs(chance - event.estimate) < 3.0 * np.hypot(np.sqrt(chance / n), event.variation * event.estimate)
    assert np.abs(event.parameters["soft_1"]).max() <= np.sqrt(3.0)


def test_the_design_point_is_on_the_border_and_nearest_to_the_origin(
    found: tuple[RareEvent, str], model: ReducedModel
) -> None:
    event, said = found
    likely = event.most_likely
    assert likely.is_exact and f"beta {likely.beta[0]:.4g}, first-order probability" in said
    values = {name: np.full(1, value) for name, value in model.scene.values.items()}
    values |= {name: column[:1] for name, column in likely.parameters.items()}
    angle = run_batch(model, values).outputs["crank_angle"][0]
    spread = np.std(event.value[:100])
    assert angle == pytest.approx(2.4e-3, abs=1e-3 * spread)
    # there the slope, of which shares are the squares, and the way from the origin have one direction
    np.testing.assert_allclose(likely.shares[0], likely.normal[0] ** 2 / likely.beta[0] ** 2, atol=5e-3)
    assert 0.5 < likely.probability.sum() / event.estimate < 2.0
    summary = json.loads(json_text(summary_of(event)))
    assert summary["most_likely"]["beta"] == [pytest.approx(likely.beta[0])]


def test_any_number_of_ranks_finds_the_same(folder: Path, found: tuple[RareEvent, str]) -> None:
    path = folder / "ranks.h5"
    run_mpi(2, *PGMP, "montecarlo", folder / "rom.h5", "-n", 1000, "--rare", EVENT, "-o", path)
    other, (one, _) = RareEvent.read(path), found
    for name in ("normal", "value", "weight", "threshold", "interval", "status"):
        np.testing.assert_array_equal(getattr(other, name), getattr(one, name), err_msg=name)


def event_of(model: ReducedModel, n: int, when: str = "end") -> RareEvent:
    return run_rare_event(model, Event(output="crank_angle", above=2.4e-3, when=when), n, 1, MPI.COMM_SELF)


def test_an_event_at_any_time_is_at_least_as_likely_as_at_the_end(model: ReducedModel) -> None:
    result, at_end = event_of(model, 500, "ever"), event_of(model, 500)
    assert result.event == "crank_angle above 2.4 mrad at any time" and result.reached
    # the motor drives the angle up all the time: it is largest at the end
    assert result.estimate == pytest.approx(at_end.estimate, rel=1e-9)


def test_what_a_file_holds_is_told_and_drawn_and_what_cannot_be_is_refused(
    folder: Path, found: tuple[RareEvent, str], undrawn: None
) -> None:
    rare, many, other = folder / "rare.h5", ["montecarlo", folder / "rom.h5", "-n"], folder / "other.h5"
    commands = [
        ["info", rare], ["plot", rare, "-o", folder / "pictures"], ["report", rare, "-o", folder / "page.html"],
        [*many, 400, "--rare", EVENT, "-o", other], [*many, 1000, "--rare", "crank_angel > 1", "-o", other],
        [*many, 1000, "--rare", EVENT, "--resume", "-o", other], [*many, 500, "--rare", "crank_angle > 9", "-o", other],
        [*many, 10, "--override", "fields.soft.terms=1", "-o", folder / "third.h5"],
    ]  # fmt: skip
    statuses, done = in_turn(1, commands)
    assert [status or 0 for (status,) in statuses] == [0, 0, 0, 2, 2, 2, 1, 2], (done.stdout, done.stderr)
    assert f"probability             {found[0].estimate:.4g}" in done.stdout
    assert (folder / "pictures" / "rare_event.png").exists()
    page = (folder / "page.html").read_text()
    asked = "-n 1000 --seed 0 --rare &#39;crank_angle &gt; 0.0024&#39;"
    assert all(shown in page for shown in ("Rare events", "design point 1", asked, 'data-path="/most_likely/beta"'))
    assert "-n 400: with --rare at least 500 samples are needed" in done.stderr
    assert "an output or a label of ensemble.probabilities; did you mean 'crank_angle'?" in done.stderr
    assert "--resume with --rare: its samples are not kept on the way" in done.stderr
    assert "the event was not reached by" in done.stdout and "probability             at most" in done.stdout
    assert "most likely at" in done.stdout and "(exact derivatives)" in done.stdout
    assert "--override fields: " in done.stderr
    assert not RareEvent.read(other).reached


def test_one_bound_is_said_everywhere_where_failed_samples_hide_the_event(
    model: ReducedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(*given, **named):
        batch = run_batch(*given, **named)
        failed = batch.outputs["crank_angle"] > 2.3e-3
        batch.outputs["crank_angle"][failed], batch.status[failed] = np.nan, Status.NOT_CONVERGED
        return batch

    monkeypatch.setattr(rare_run, "run_batch", failing)
    result = event_of(model, 500)
    assert not result.reached and result.n_failed
    bound = f"at most {result.interval[1]:.3g} (95 %)"
    assert json.loads(json_text(summary_of(result)))["interval"] == [0.0, pytest.approx(result.interval[1])]
    assert any(bound in line and "not reached" in line for line in lines_of_rare_event(result))
    assert any(bound in remark.text for remark in result.record.remarks)


def test_a_likely_event_is_no_more_than_sure_without_the_errors(
    model: ReducedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    far = SimpleNamespace(at_end={"crank_angle": np.full(8, -1.0)}, histories=())
    monkeypatch.setattr(RunsAtPoints, "of", lambda model, points: RunsAtPoints(model, far, {}))
    result = run_rare_event(model, Event(output="crank_angle", above=2e-3), 500, 1, MPI.COMM_SELF)
    assert 0.01 < result.estimate < 0.9
    assert any("about 1 without the estimated errors" in remark.text for remark in result.record.remarks)


def test_parameters_that_step_have_no_design_point_and_that_is_said(model: ReducedModel) -> None:
    law = '{name="discrete", values=[0.9, 1.0, 1.2], weights=[5, 80, 1]}'
    stepping = f"parameters.push={{nominal=1.0, distribution={law}}}"
    other = ReducedModel(paper_scene(*UNCERTAIN, stepping), model.rom)
    result = event_of(other, 1500)
    assert result.reached and result.most_likely is None
    assert set(result.parameters["push"]) == {0.9, 1.0, 1.2}
    texts = [remark.text for remark in result.record.remarks]
    assert "values of push step, so that the event has no design point, and none was looked for" in texts
    assert any("none found (" in line and "values that step" in line for line in lines_of_rare_event(result))
    n = 20_000
    angles = run_batch(other, Sampler(other.scene, Plan(n, 2)).draw(0, n)).outputs["crank_angle"]
    chance = np.mean(angles > 2.4e-3)
    assert abs(chance - result.estimate) < 3.5 * np.hypot(np.sqrt(chance / n), result.variation * result.estimate)


def test_shares_of_correlated_parameters_add_to_one_and_the_slope_is_that_of_the_runs(model: ReducedModel) -> None:
    correlated = ReducedModel(paper_scene(*UNCERTAIN, "correlation.r1={push=-0.6}"), model.rom)
    likely = event_of(correlated, 1000).most_likely
    assert likely.is_exact and likely.shares.sum(axis=1) == pytest.approx(1.0)
    # thin and pushed hard come together: the event is nearer than without
    alone = event_of(model, 1000).most_likely
    assert likely.beta[0] < 0.95 * alone.beta[0]
