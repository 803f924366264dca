"""When errors are evaluated: strides that have nothing in common, and how far two estimates are apart."""

import math

import numpy as np
import pytest

from pgmp_petsc.estimates.reference_motion import (
    DAMPED,
    FINER,
    LEAST,
    MOST,
    differences,
    kept_steps,
    places_of,
    schedules,
)


@pytest.mark.parametrize("n_steps", [1, 2, 201, 1000, 1009, MOST, MOST + 1, 3 * MOST - 7, 10 * MOST])
def test_schedules_are_even_and_end_with_the_run(n_steps: int) -> None:
    """Intervals are whole numbers of steps and all the same, but the first may be short."""
    found = schedules(n_steps, 3.0)
    kept = kept_steps([one.steps for one in found])
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
