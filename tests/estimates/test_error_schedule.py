"""Loads at the instants at which errors are evaluated."""

import numpy as np
import pytest
from runs import paper_scene

from pgmp_petsc.effects import effects_of
from pgmp_petsc.estimates.sampled_load import SampledLoad
from scenes import kinematics_of, slider_crank


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
