"""A sample that fails in the middle of a batch: the others must not change by a bit."""

from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest
from mechanisms import accurate, run_for, start
from runs import full_model, rom_of, run_model, still, trajectory

from pgmp_petsc.ensemble.integration import run_batch
from pgmp_petsc.ensemble.sampling import draw
from pgmp_petsc.ensemble.watchers import RangeWatch
from pgmp_petsc.full.systems import FullBatch
from pgmp_petsc.models import Model, ReducedModel
from pgmp_petsc.stepping.alpha_step import CAREFUL_ITERATIONS
from pgmp_petsc.stepping.generalised_alpha import Attempt, Run
from pgmp_petsc.stepping.second_order_system import State
from pgmp_petsc.stepping.status import Status
from pgmp_petsc.studies.single_run import RunPart
from scenes import RADIUS

N = 35  # more than one block of lanes in either model
MOTOR = 'effects.motor={type="torque", joint="crank_hinge", scale="push", table=[[0.0, 0.0], [0.02, 1.0]]}'
SCENE = ("parameters.push.nominal=1.0", MOTOR, *run_for(0.06, 1e-3))
RANGE = ("coordinates.theta.range=[0.0, 1.0]", "coordinates.theta.periodic=false", *start(0.5))


@lru_cache(maxsize=None)
def model_of(name: str, *overrides: str) -> Model:
    scene = accurate(*SCENE, *overrides, angles=24)
    return full_model(scene) if name == "full" else ReducedModel(scene, rom_of(scene))


def run(model: Model, radii: np.ndarray, pushes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return final coordinates (n_samples, ...), status and time of failure of every sample."""
    system, result = run_model(model, radii.size, {"r1": radii, "push": pushes})
    q = system.unpack(result.state.q).T if isinstance(system, FullBatch) else result.state.q
    return q, result.status, result.failure_time


def healthy() -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(7)
    return RADIUS * random.uniform(0.8, 1.2, N), random.uniform(0.5, 1.5, N)


# a push of 1000 Nm bends the crank round its hinge after 26 to 32 ms; the others fail at the first step
@pytest.mark.parametrize(("at", "push"), [(3, 1e3), (34, 1e6), (3, 1e300), (34, np.nan)])
@pytest.mark.parametrize("name", ["full", "reduced"])
def test_a_sample_that_diverges_leaves_the_others_alone(name: str, at: int, push: float) -> None:
    model, (radii, pushes) = model_of(name), healthy()
    expected, fine, _ = run(model, radii, pushes)
    np.testing.assert_array_equal(fine, Status.FINE)
    q, status, time = run(model, np.insert(radii, at, RADIUS), np.insert(pushes, at, push))
    # a load that is no number leaves no finite acceleration to start from; only the reduced model keeps it as its state
    assert status[at] == (Status.NOT_FINITE if np.isnan(push) and name == "reduced" else Status.NOT_CONVERGED)
    assert 0.01 < time[at] < 0.06 if push == 1e3 else time[at] == pytest.approx(1e-3)
    assert np.isfinite(q[at]).all()  # it stays where it was before the step
    np.testing.assert_array_equal(np.delete(status, at), Status.FINE)
    np.testing.assert_array_equal(np.delete(q, at, axis=0), expected)


def test_an_absurd_load_is_given_up_at_once() -> None:
    """Its corrections were halved a thousand times each, of `CAREFUL_ITERATIONS` an attempt."""
    _, done = run_model(model_of("full"), 1, {"r1": np.array([RADIUS]), "push": np.array([1e300])})
    assert done.status[0] == Status.NOT_CONVERGED and done.counted[0] < CAREFUL_ITERATIONS


def test_a_sample_that_leaves_the_sampled_range_leaves_the_others_alone() -> None:
    model, (radii, pushes) = model_of("reduced", *RANGE), healthy()
    expected, fine, _ = run(model, radii, pushes)
    np.testing.assert_array_equal(fine, Status.FINE)
    q, status, time = run(model, np.insert(radii, 5, RADIUS), np.insert(pushes, 5, 60.0))
    assert status[5] == Status.LEFT_RANGE
    assert 0.01 < time[5] < 0.06
    np.testing.assert_array_equal(np.delete(q, 5, axis=0), expected)


# pushes forth and twice as hard back, to where it began, within 30 ms
BACK = MOTOR.replace("[[0.0, 0.0], [0.02, 1.0]]", "[[0.0, 1.0], [0.01, 1.0], [0.011, -2.0], [1.0, -2.0]]")
NARROW = ("coordinates.theta.range=[0.0, 0.55]", *RANGE[1:])
AWAY = (BACK, *NARROW, *run_for(0.03, 5e-4), 'parameters.push.distribution={name="uniform", loc=0.5, scale=1.0}')


@pytest.mark.parametrize("bands", [0, 11])
def test_a_full_order_sample_that_leaves_the_range_and_comes_back_has_failed(bands: int) -> None:
    """Its deformation is not known out there, so that none of its extremes is; nobody may count it as fine."""
    model = model_of("full", *AWAY, f"ensemble.bands={bands}")
    values = {name: np.full(5, value) for name, value in model.scene.nominal.items()}
    values["push"] = np.array([1.0, 0.5, 60.0, 1.5, 1.2])
    batch = run_batch(model, values)
    np.testing.assert_array_equal(batch.status, np.where(values["push"] == 60.0, Status.LEFT_RANGE, Status.FINE))
    assert 0.005 < batch.failure_time[2] < 0.015
    assert np.isnan(batch.outputs["bent"][2]) and np.isfinite(batch.outputs["bent"][3])


def test_a_single_run_beyond_the_range_says_so_and_goes_on_without_deformations() -> None:
    alone = trajectory(model_of("full", *AWAY, "parameters.push.nominal=60.0"))
    assert alone.status == Status.LEFT_RANGE and alone.record.remarks[0].text.startswith("full simulation stopped at")
    assert "widen the coordinate" in alone.record.remarks[0].text
    angle = 'outputs={angle={type="angle", joint="crank_hinge"}}'
    further = trajectory(model_of("full", *AWAY, "parameters.push.nominal=60.0", angle))
    assert further.status == Status.FINE and further.outputs["angle"].max() > 0.61


@pytest.mark.parametrize("name", ["full", "reduced"])
def test_an_ensembles_batch_with_samples_that_are_not_physical(name: str) -> None:
    """Radii that are not positive are records; the others have the outputs that they have alone."""
    model = model_of(name, 'parameters.r1.distribution={name="norm", loc=5.6e-3, scale=6e-3}')
    batch = run_batch(model, draw(model.scene, 3, 0, N))
    positive = batch.parameters["r1"] > 0.0
    assert 2 < (~positive).sum() < N - 5
    np.testing.assert_array_equal(batch.status == Status.UNPHYSICAL, ~positive)
    some = int(np.flatnonzero(batch.status == Status.FINE)[-1])
    alone = run_batch(model, draw(model.scene, 3, some, some + 1), some)
    for output, values in batch.outputs.items():
        np.testing.assert_allclose(values[some], alone.outputs[output][0], rtol=1e-9, err_msg=output)
        assert np.isnan(values[batch.status != Status.FINE]).all()


def test_bounds_truncate_and_lose_no_sample() -> None:
    law = 'parameters.r1.distribution={name="norm", loc=5.6e-3, scale=5.6e-4}'
    model = model_of("reduced", law, "parameters.r1.bounds=[5.3e-3, 6.0e-3]")
    batch = run_batch(model, draw(model.scene, 3, 0, N))
    np.testing.assert_array_equal(batch.status, Status.FINE)
    assert np.all((batch.parameters["r1"] >= 5.3e-3) & (batch.parameters["r1"] <= 6.0e-3))


# 150 rad/s in steps of 10 ms, see test_extremes; and a start from which the same steps are no trouble
FAST = (*run_for(0.1, 1e-2), *start(0.3, 150.0))
DRAWN = 'parameters.r1.distribution={name="uniform", loc=5.5e-3, scale=2e-4}'


@pytest.mark.parametrize("name", ["full", "reduced"])
def test_a_sample_that_a_large_step_loses_is_tried_with_smaller_ones(name: str) -> None:
    """Its outputs are those of a run with that step, to the last bit, whatever batch it is in."""
    model = model_of(name, DRAWN, *FAST)
    batch = run_batch(model, draw(model.scene, 1, 0, 3))
    divisors = batch.numerics["steps_divided"]
    assert np.all(batch.status == Status.FINE) and np.all(np.isin(divisors, [2, 4, 8]))
    for k, divisor in enumerate(divisors):
        finer = model_of(name, DRAWN, *FAST, f"simulation.step={1e-2 / divisor}")
        alone = run_batch(finer, draw(finer.scene, 1, k, k + 1), k)
        assert alone.numerics["steps_divided"][0] == 1
        for output, values in batch.outputs.items():
            np.testing.assert_allclose(values[k], alone.outputs[output][0], rtol=1e-9, atol=1e-12, err_msg=output)


@pytest.mark.parametrize("name", ["full", "reduced"])
def test_a_single_run_that_a_large_step_loses_is_tried_with_smaller_ones(name: str) -> None:
    """It is the run with that step, and says so."""
    run = trajectory(model_of(name, *FAST))
    assert run.status == Status.FINE and run.steps_divided in (2, 4, 8)
    said = next(remark.text for remark in run.record.remarks if "integrated again" in remark.text)
    assert "with simulation.step = 0.01 s the run stopped at 0.0" in said and f"1/{run.steps_divided} of it" in said
    alone = trajectory(model_of(name, *FAST, f"simulation.step={1e-2 / run.steps_divided}"))
    assert alone.steps_divided == 1 and alone.time.size == run.time.size
    for output, values in run.outputs.items():
        np.testing.assert_allclose(values, alone.outputs[output], rtol=1e-9, atol=1e-12, err_msg=output)


@pytest.mark.parametrize("name", ["full", "reduced"])
def test_a_single_run_at_an_absurd_speed_is_a_failure(name: str) -> None:
    """As fast as a scene may ask for: never NaN in a run that is fine."""
    run = trajectory(model_of(name, *run_for(0.01, 1e-3), *start(0.3, 1e29)))
    assert run.status != Status.FINE
    assert run.record.remarks[0].kind == "warning" and "simulation stopped at" in run.record.remarks[0].text
    # of a full-order run those of the step, and those of the mesh
    n_absent = {"full": 2, "reduced": 1}[name]
    assert len([remark for remark in run.record.remarks if remark.text.startswith("errors")]) == n_absent


@pytest.mark.parametrize(("lost", "status", "failed"), [(2, Status.FINE, np.nan), (1, Status.NOT_CONVERGED, 3e-3)])
def test_a_part_ends_where_an_output_is_no_finite_number(lost: int, status: Status, failed: float) -> None:
    """Also one that fails later."""
    model, times = model_of("reduced"), [0.0, 1e-3, 2e-3, 3e-3]
    outputs = model.observed_of(0.0, still(np.tile([0.3, *np.zeros(model.terms.layout.n_eta - 1)], (4, 1))), {})
    outputs[..., lost] = np.nan
    done = Run(None, np.array([status]), np.array([failed]), 3, 0)
    attempt = Attempt(np.array([0]), np.array([True]), model.scene.simulation, 1)
    part = RunPart.of(model, done, attempt, times, outputs, energies=times)
    assert part.run.status[0] == Status.NOT_FINITE and part.reach == times[lost]
    assert part.time.tolist() == part.recorded["energies"] == times[:lost]
    assert all(np.isfinite(values).all() for values in part.outputs.values())


def test_a_sample_that_left_the_range_before_it_failed_left_the_range() -> None:
    """As a single run; one that fails first has failed."""
    leaving = SimpleNamespace(left_range=lambda system, state: np.array([True, True, True, False]))
    watch = RangeWatch(leaving, SimpleNamespace(n_samples=4))
    watch.over(np.array([1]), np.array([0.1]), State(*np.zeros((5, 1, 4, 1))))
    lost, fine = Status.NOT_CONVERGED, Status.FINE
    found = watch.judged(Run(None, np.array([lost, fine, lost, lost]), np.array([0.5, np.nan, 0.05, 0.5]), 9, 0))
    assert found.status.tolist() == [Status.LEFT_RANGE, Status.LEFT_RANGE, lost, lost]
    assert found.failure_time.tolist() == [0.1, 0.1, 0.05, 0.5]


def test_samples_are_the_same_in_batches_of_any_size() -> None:
    """With neighbours that fail, or need smaller steps, or are no trouble: to the last bit."""
    pushed = 'parameters.push={nominal=1.0, distribution={name="loguniform", a=0.1, b=2e3}}'
    model, n = model_of("reduced", DRAWN, pushed), 20
    whole = run_batch(model, draw(model.scene, 1, 0, n))
    assert {Status.FINE} < set(whole.status) and 0 < np.sum(whole.numerics["steps_divided"] > 1) < n
    for size in (1, 3, 7):
        ends = [(first, min(first + size, n)) for first in range(0, n, size)]
        parts = [run_batch(model, draw(model.scene, 1, *of), of[0]) for of in ends]
        np.testing.assert_array_equal(np.concatenate([part.status for part in parts]), whole.status)
        for name, values in whole.outputs.items():
            np.testing.assert_array_equal(np.concatenate([part.outputs[name] for part in parts]), values, err_msg=name)
