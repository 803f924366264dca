"""When errors are evaluated: strides that have nothing in common, and estimates that agree."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pgmp_petsc.indicator.schedule import (
    AGREED,
    MOST,
    N_EVALUATIONS,
    IN_CONTACT,
    SHAKEN,
    TURN,
    agree,
    choose,
    longest_intervals,
    schedules,
)


@pytest.mark.parametrize("n_steps", [1, 2, 150, 200, 201, 1000, 1009, 5000, 10_000])
def test_schedules_are_even_nested_and_end_with_the_run(n_steps: int) -> None:
    """Intervals are whole numbers of steps and all the same, but the first may be short."""
    found = schedules(n_steps, 3.0)
    kept = found[-1].steps
    assert kept.size - 1 == -(-n_steps // -(-n_steps // MOST)) <= MOST
    assert [one.steps.size for one in found] == sorted(one.steps.size for one in found)
    for one in found:
        assert (one.steps[0], one.steps[-1]) == (0, n_steps)
        np.testing.assert_array_equal(kept[one.places], one.steps)
        stride = one.interval / (3.0 / n_steps)
        assert stride == pytest.approx(round(stride), rel=1e-12)
        assert np.all(np.diff(one.steps)[1:] == round(stride)) and 0 < one.steps[1] <= round(stride)
        assert one.complete == (one.steps.size == n_steps + 1)


@pytest.mark.parametrize("n_steps", [201, 300, 1000, 1009, 5000, 10_000])
def test_neighbouring_schedules_have_no_common_stride(n_steps: int) -> None:
    """But for that of the finest, and the second is the coarsest with enough evaluations."""
    found = schedules(n_steps, 1.0)
    finest = -(-n_steps // MOST)
    strides = [round(one.interval * n_steps) // finest for one in found]
    assert strides[-1] == 1
    assert all(math.gcd(one, other) == 1 for one, other in zip(strides, strides[1:]))
    counts = [n_steps / (stride * finest) for stride in strides]
    assert counts[0] < N_EVALUATIONS <= counts[1]


@pytest.mark.parametrize("n_steps", [1, 150, 200])
def test_short_runs_are_evaluated_at_every_step(n_steps: int) -> None:
    (only,) = schedules(n_steps, 1.0)
    assert only.complete
    np.testing.assert_array_equal(choose([only], np.array([1e-9, np.inf])), [0, 0])


def test_a_sample_is_evaluated_as_often_as_it_turns_and_shakes() -> None:
    choices = schedules(1000, 1.0)
    assert [one.steps.size - 1 for one in choices] == [77, 125, 200, 334, 500, 1000]
    slow = TURN / 0.008
    speeds = np.array([0.0, slow, 1.01 * slow, 2 * slow, 1e9, 0.0, 0.0])
    shaken = SHAKEN * np.array([0.0, 0.0, 0.9, 0.9, 0.9, 0.9, 1.1])
    longest = longest_intervals(speeds, shaken, np.full(7, 0.003), np.full(7, np.inf))
    np.testing.assert_array_equal(choose(choices, longest), [1, 1, 2, 3, 5, 1, 3])
    contacts = IN_CONTACT * np.array([np.inf, 0.008, 0.0079, 0.1, 0.1, 0.001, 0.0029])
    longest = longest_intervals(speeds, shaken, np.full(7, 0.003), contacts)
    np.testing.assert_array_equal(choose(choices, longest), [1, 1, 2, 3, 5, 5, 4])


def test_estimates_agree_in_all_outputs_or_not() -> None:
    one = {"a": np.array([1.0, 1.0, 1.0, np.nan, 0.0, 1.0]), "b": np.full(6, 2.0)}
    other = {"a": np.array([0.99 * AGREED, 1.01 * AGREED, 1 / (1.01 * AGREED), 1.0, 0.0, 1.0]), "b": np.full(6, 2.0)}
    other["b"][-1] *= 1.01 * AGREED
    expected = [True, False, False, False, True, False]
    np.testing.assert_array_equal(agree(one, other), expected)
    np.testing.assert_array_equal(agree(other, one), expected)
