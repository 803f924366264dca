"""A sample that fails in the middle of a batch: the others must not change by a bit."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from mechanisms import accurate, run_for, start
from runs import full_model, rom_of, run_model
from scenes import RADIUS

from pgmp_petsc.dynamics.full_batch import FullBatch
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.ensemble.runner import run_batch
from pgmp_petsc.models import Model, ReducedModel

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
@pytest.mark.parametrize("push", [1e3, 1e6, 1e300, np.nan])
@pytest.mark.parametrize("at", [3, 34])
@pytest.mark.parametrize("name", ["full", "reduced"])
def test_a_sample_that_diverges_leaves_the_others_alone(name: str, at: int, push: float) -> None:
    model, (radii, pushes) = model_of(name), healthy()
    expected, fine, _ = run(model, radii, pushes)
    np.testing.assert_array_equal(fine, Status.FINE)
    q, status, time = run(model, np.insert(radii, at, RADIUS), np.insert(pushes, at, push))
    assert status[at] == Status.NOT_CONVERGED
    assert 0.01 < time[at] < 0.06 if push == 1e3 else time[at] == pytest.approx(1e-3)
    assert np.isfinite(q[at]).all()  # it stays where it was before the step
    np.testing.assert_array_equal(np.delete(status, at), Status.FINE)
    np.testing.assert_array_equal(np.delete(q, at, axis=0), expected)


def test_a_sample_that_leaves_the_sampled_range_leaves_the_others_alone() -> None:
    model, (radii, pushes) = model_of("reduced", *RANGE), healthy()
    expected, fine, _ = run(model, radii, pushes)
    np.testing.assert_array_equal(fine, Status.FINE)
    q, status, time = run(model, np.insert(radii, 5, RADIUS), np.insert(pushes, 5, 60.0))
    assert status[5] == Status.LEFT_RANGE
    assert 0.01 < time[5] < 0.06
    np.testing.assert_array_equal(np.delete(q, 5, axis=0), expected)


@pytest.mark.parametrize("name", ["full", "reduced"])
def test_an_ensembles_batch_with_samples_out_of_bounds(name: str) -> None:
    """Samples drawn beyond the bounds are records; those inside have the outputs of a run without bounds."""
    drawn = 'parameters.r1.distribution={name="norm", loc=5.6e-3, scale=5.6e-4}'
    free, bound = (model_of(name, drawn, *bounds) for bounds in ((), ("parameters.r1.bounds=[5.3e-3, 6.0e-3]",)))
    with_all, with_some = (run_batch(model, 3, 0, N) for model in (free, bound))
    np.testing.assert_array_equal(with_some.parameters["r1"], with_all.parameters["r1"])
    inside = (with_all.parameters["r1"] >= 5.3e-3) & (with_all.parameters["r1"] <= 6.0e-3)
    assert 5 < inside.sum() < N - 5
    np.testing.assert_array_equal(with_some.status, np.where(inside, Status.FINE, Status.OUT_OF_BOUNDS))
    for output, values in with_some.outputs.items():
        np.testing.assert_array_equal(values[inside], with_all.outputs[output][inside], err_msg=output)
        assert np.isnan(values[~inside]).all()
