"""Laws of local effects: derivatives against differences, and what each of them means."""

from __future__ import annotations

import numpy as np
import pytest

from pgmp_petsc.effects.laws import FRICTION, SOURCE, SPRING_DAMPER, STOP, law

STEP = 1e-6  # central differences of functions of order 1: 1e-12 by truncation, 1e-10 by round-off
ATOL = 1e-9

SPRING = np.array([3.0, 0.4, 0.2, 0.0])
UPPER, LOWER = np.array([50.0, 0.3, 0.5, 1.0]), np.array([50.0, 0.3, -0.5, -1.0])
# law, parameters, amplitude, measure, rate
STATES = {
    "source": (SOURCE, np.array([2.0, 0.0, 0.0, 0.0]), 1.5, 0.3, 0.7),
    "spring": (SPRING_DAMPER, SPRING, 0.0, 0.9, -0.7),
    "friction": (FRICTION, np.array([2.0, 0.5, 0.0, 0.0]), 0.0, 0.3, 0.2),
    "upper stop, going in": (STOP, UPPER, 0.0, 0.6, 0.9),
    "upper stop, coming out": (STOP, UPPER, 0.0, 0.6, -0.9),
    "upper stop, not reached": (STOP, UPPER, 0.0, 0.4, 0.9),
    "lower stop, going in": (STOP, LOWER, 0.0, -0.6, -0.9),
    "lower stop, torn out": (STOP, LOWER, 0.0, -0.6, 9.0),
}


@pytest.mark.parametrize("name", STATES)
def test_derivatives_of_a_law(name: str) -> None:
    kind, parameters, amplitude, s, rate = STATES[name]
    _, stiffness, damping, elastic, _ = law(kind, parameters, amplitude, s, rate)

    def at(ds: float, drate: float) -> tuple:
        return law(kind, parameters, amplitude, s + ds, rate + drate)

    for found, (one, other) in (
        (stiffness, (at(-STEP, 0.0)[0], at(STEP, 0.0)[0])),
        (damping, (at(0.0, -STEP)[0], at(0.0, STEP)[0])),
        (elastic, (at(-STEP, 0.0)[4], at(STEP, 0.0)[4])),
    ):
        # the stop's stiffness of 50 times the round-off over the step
        assert found == pytest.approx((one - other) / (2 * STEP), rel=0, abs=50 * ATOL)


@pytest.mark.parametrize("name", STATES)
def test_what_is_not_elastic_takes_energy_unless_it_is_a_source(name: str) -> None:
    kind, parameters, amplitude, s, rate = STATES[name]
    force, _, _, elastic, stored = law(kind, parameters, amplitude, s, rate)
    assert stored >= 0.0
    if kind != SOURCE:
        assert (force - elastic) * rate <= 0.0


def test_a_stop_never_pulls() -> None:
    speeds = np.linspace(-20.0, 20.0, 81)
    assert all(law(STOP, UPPER, 0.0, 0.6, speed)[0] <= 0.0 for speed in speeds)
    assert all(law(STOP, LOWER, 0.0, -0.6, speed)[0] >= 0.0 for speed in speeds)


def test_three_quarters_of_friction_at_its_speed() -> None:
    force, *_ = law(FRICTION, np.array([2.0, 0.5, 0.0, 0.0]), 0.0, 0.0, 0.5)
    assert force == pytest.approx(-2.0 * 0.76, rel=3e-3)
