"""Histories of both models, and errors between two: shares of the largest value, what failed, instants in common."""

import numpy as np
import pytest
from runs import full_model, reduced_model, samples
from tradeoffs import OUTPUTS

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.bench.history import (
    MOST_INSTANTS,
    History,
    errors_between,
    floors_of,
    largest_errors,
    run_history,
    spacing,
)
from pgmp_petsc.scene import Scene, scene_from_toml
from pgmp_petsc.stepping.status import Status
from scenes import SLIDER_CRANK

FLOORS = np.array([1e-10])


def history(values: np.ndarray, n_steps: int | None = None, status: tuple[int, ...] | None = None) -> History:
    """Return a history of one output; values have shape (n_kept, n_samples)."""
    n_samples = values.shape[1]
    n_steps = len(values) - 1 if n_steps is None else n_steps
    states = np.array(status or (Status.FINE,) * n_samples)
    outputs = values[None].copy()
    outputs[..., states != Status.FINE] = np.nan
    inside, never = np.ones(n_samples, dtype=bool), np.full(n_samples, np.nan)
    return History(n_steps, spacing(n_steps), outputs, states, inside, never)


@pytest.mark.parametrize(
    ("exact", "off", "expected"),
    [
        # shares of a sample's own largest value, or of the floor; instants without a number do not count
        ([[0.0, 0.0], [2.0, -200.0], [1.0, 100.0]], [[0.0, 0.0], [0.1, 1.0], [-0.2, 0.0]], [[0.1, 0.005]]),
        ([[0.0]] * 3, [[1e-13]] * 3, [[1e-3]]),
        ([[1.0], [np.nan], [2.0]], [[0.0], [7.0], [0.2]], [[0.1]]),
    ],
)
def test_errors_between_histories(exact: list, off: list, expected: list) -> None:
    exact = np.array(exact)
    found = np.nan_to_num(exact) + off
    np.testing.assert_allclose(errors_between(history(found), history(exact), FLOORS), expected)


@pytest.mark.parametrize(
    ("of_found", "of_exact", "expected"), [(2, 0, np.inf), (0, 2, np.nan), (2, 2, np.nan), (0, 0, 0.0)]
)
def test_failures(of_found: int, of_exact: int, expected: float) -> None:
    """A failure of the candidate alone is an infinite error; a case without a reference does not count."""
    values = np.ones((3, 1))
    errors = errors_between(history(values, status=(of_found,)), history(values, status=(of_exact,)), FLOORS)
    np.testing.assert_array_equal(errors, [[expected]])


@pytest.mark.parametrize(("coarse", "fine"), [(64, 128), (257, 2056), (1000, 2000), (1500, 12000), (1595, 6380)])
def test_runs_with_other_steps_are_compared_at_the_instants_of_both(coarse: int, fine: int) -> None:
    def ramp(n_steps: int) -> History:
        return history((np.arange(0, n_steps + 1, spacing(n_steps)) / n_steps)[:, None], n_steps)

    assert errors_between(ramp(coarse), ramp(fine), FLOORS)[0, 0] < 1e-14
    assert errors_between(ramp(fine), ramp(coarse), FLOORS)[0, 0] < 1e-14
    assert len(ramp(fine).outputs[0]) <= MOST_INSTANTS + 1


def scene(*overrides: str) -> Scene:
    return scene_from_toml(SLIDER_CRANK + OUTPUTS, ".", ("simulation.duration=0.02", *overrides))


@pytest.mark.parametrize("make", [full_model, reduced_model])
def test_histories_have_their_instants_in_common(make) -> None:
    model = make(scene())
    values, floors = samples(model.scene, 3, r1=np.array([5e-3, 5.6e-3, 6e-3])), floors_of(model)
    coarse, own, fine = (run_history(model, values, 3, n) for n in (10, 20, 80))
    assert coarse.outputs.shape == (2, 11, 3) and fine.outputs.shape == (2, 81, 3)
    (own_angle, _), (coarse_angle, _) = (largest_errors(run, fine, floors) for run in (own, coarse))
    assert 0.0 < own_angle < coarse_angle < 0.05
    one = run_history(model, {name: column[:1] for name, column in values.items()}, 1, 20)
    # samples do not feel each other
    np.testing.assert_allclose(one.outputs[..., 0], own.outputs[..., 0], rtol=1e-9, atol=1e-15)


def test_samples_beyond_a_batch_are_run_one_batch_after_the_other() -> None:
    values = samples(scene(), 3, r1=np.array([5e-3, 5.6e-3, 6e-3]))
    together, one_by_one = (
        run_history(full_model(scene(*more)), values, 3, 20) for more in ((), ("ensemble.batch=1",))
    )
    np.testing.assert_allclose(one_by_one.outputs, together.outputs, rtol=1e-9, atol=1e-15)
    assert one_by_one.status.shape == one_by_one.inside.shape == (3,)


def test_a_sample_that_fails_is_named() -> None:
    limited = scene(
        "coordinates.theta.range=[0.0, 2.0]",
        "coordinates.theta.periodic=false",
        "simulation.initial.theta.velocity=200.0",
    )
    values = samples(limited, 2, r1=np.array([5e-3, 6e-3]))
    found = run_history(reduced_model(limited), values, 2, 20)
    with pytest.raises(RunError, match=r"2 of 2 samples failed, the first \(r1 = 0.005\) at 0.01.* a coordinate left"):
        found.require_fine(limited, values)
    full = run_history(full_model(limited), values, 2, 200)
    assert not full.inside.any() and full.require_fine(limited, values) is full, "the full-order model goes on"


def test_the_largest_error_is_none_where_numbers_are_missing() -> None:
    nan = np.nan
    exact = history(np.array([[1.0], [2.0], [nan]]))
    assert largest_errors(history(np.array([[1.0], [1.0], [nan]])), exact, FLOORS) == [0.5]
    assert largest_errors(history(np.array([[1.0], [1.0], [7.0]])), exact, FLOORS) == [0.5]
    assert np.isnan(largest_errors(history(np.array([[1.0], [nan], [7.0]])), exact, FLOORS))
    assert np.isnan(largest_errors(exact, history(np.full((3, 1), nan)), FLOORS))
    long = history(np.ones((21, 1)))
    one_of_many = history(np.append(np.full((20, 1), 1.5), [[nan]], axis=0))
    assert largest_errors(one_of_many, long, FLOORS) == [0.5]
    assert errors_between(history(np.array([[1.0], [nan], [7.0]])), exact, FLOORS) == [[np.inf]]


def test_what_is_zero_to_round_off_in_both_has_no_error() -> None:
    """Of two samples one is zero: it counts from the floor on, as a share of that."""
    exact = history(np.array([[1.0, 0.0], [1.0, 0.4 * FLOORS[0]]]))
    for least, expected in ((0.9, 0.0), (3.0, 2.6)):
        found = history(np.array([[1.0, 0.0], [1.0, least * FLOORS[0]]]))
        assert largest_errors(found, exact, FLOORS) == pytest.approx([expected], abs=1e-12)
    assert errors_between(found, exact, FLOORS)[0, 1] == pytest.approx(2.6)
