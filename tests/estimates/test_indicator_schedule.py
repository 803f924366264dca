"""When errors are evaluated: strides that have nothing in common, and how far two estimates are apart."""

import math

import numpy as np
import pytest
from runs import paper_scene

from pgmp_petsc.effects import effects_of
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
from pgmp_petsc.estimates.sampled_load import SampledLoad
from scenes import kinematics_of, slider_crank


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
