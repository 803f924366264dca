"""Measures and laws of local effects: derivatives against differences, and what each of them means."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from pgmp_petsc.effects.action import Actions, evaluate_actions
from pgmp_petsc.effects.laws import FRICTION, N_PARAMETERS, SOURCE, SPRING_DAMPER, STOP, law
from pgmp_petsc.effects.measures import COLUMNS, DISTANCE, FOLLOWING, ROTATION, SLIDE, measure

KINDS = {"rotation": ROTATION, "slide": SLIDE, "distance": DISTANCE, "following": FOLLOWING}
DIRECTION = np.array([0.6, -0.8])
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


def evaluated(kind: int, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return measure, gradient and its derivative."""
    gradient, hessian = np.full(6, np.nan), np.full((6, 6), np.nan)
    return measure(kind, DIRECTION, z, gradient, hessian), gradient, hessian


def frames() -> list[np.ndarray]:
    """Return pairs of frames in general position."""
    return list(np.random.default_rng(5).normal(size=(8, 6)))


@pytest.mark.parametrize("name", ["rotation", "slide", "distance"])
def test_the_gradient_is_the_derivative_of_the_measure(name: str) -> None:
    for z in frames():
        _, gradient, _ = evaluated(KINDS[name], z)
        slopes = [
            (evaluated(KINDS[name], z + STEP * unit)[0] - evaluated(KINDS[name], z - STEP * unit)[0]) / (2 * STEP)
            for unit in np.eye(6)
        ]
        np.testing.assert_allclose(gradient, slopes, rtol=0, atol=ATOL)


@pytest.mark.parametrize("name", KINDS)
def test_the_hessian_is_the_derivative_of_the_gradient(name: str) -> None:
    for z in frames():
        _, gradient, hessian = evaluated(KINDS[name], z)
        for j, unit in enumerate(np.eye(6)):
            ahead, behind = evaluated(KINDS[name], z + STEP * unit)[1], evaluated(KINDS[name], z - STEP * unit)[1]
            # curvatures grow with the inverse of the distance
            np.testing.assert_allclose(hessian[:, j], (ahead - behind) / (2 * STEP), rtol=1e-7, atol=ATOL)
        assert np.array_equal(hessian, hessian.T) == (name != "following")
        moved = np.flatnonzero(gradient)
        assert set(moved) <= set(COLUMNS[KINDS[name]]), "columns that the kind says it depends on"


def test_what_the_measures_are() -> None:
    z = np.array([1.0, 2.0, 0.3, 1.0 + 3.0 * np.cos(0.3), 2.0 + 3.0 * np.sin(0.3), 1.1])
    gradient, hessian = np.empty(6), np.empty((6, 6))
    assert measure(ROTATION, DIRECTION, z, gradient, hessian) == pytest.approx(0.8)
    assert measure(DISTANCE, DIRECTION, z, gradient, hessian) == pytest.approx(3.0)
    assert measure(SLIDE, np.array([1.0, 0.0]), z, gradient, hessian) == pytest.approx(3.0)
    assert measure(SLIDE, np.array([0.0, 1.0]), z, gradient, hessian) == pytest.approx(0.0, abs=1e-15)
    measure(FOLLOWING, np.array([1.0, 0.0]), z, gradient, hessian)
    np.testing.assert_allclose(gradient, [0, 0, 0, np.cos(1.1), np.sin(1.1), 0], rtol=0, atol=1e-15)


def test_two_points_that_meet_pull_nowhere() -> None:
    z = np.array([1.0, 2.0, 0.3, 1.0, 2.0, 1.1])
    length, gradient, hessian = evaluated(DISTANCE, z)
    assert length == 0.0
    assert np.isfinite(hessian).all() and not gradient.any()


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


@pytest.mark.parametrize(
    ("kind", "name"),
    [(FOLLOWING, "source"), *product((ROTATION, SLIDE, DISTANCE), ("source", "spring", "friction"))],
)
def test_the_tangent_of_an_action_is_minus_the_derivative_of_its_force(kind: int, name: str) -> None:
    which, parameters, amplitude, _, _ = STATES[name]
    actions = Actions(
        np.array([kind]), np.array([which]), DIRECTION[None], np.broadcast_to(parameters, (1, 1, N_PARAMETERS)).copy()
    )

    def forces(z: np.ndarray, rates: np.ndarray, gain_v: float) -> tuple[np.ndarray, np.ndarray]:
        force, tangent, rest = np.empty((1, 6, 1)), np.empty((1, 6, 6, 1)), [np.empty((1, 1)) for _ in range(3)]
        evaluate_actions(
            actions, np.array([amplitude]), z[None, :, None], rates[None, :, None], gain_v, force, tangent, *rest
        )
        return force[0, :, 0], tangent[0, :, :, 0]

    gain_v = 3.0
    for z in frames()[:3]:
        # at rest the change of the gradient does not change the rate, which the tangent leaves out
        _, tangent = forces(z, np.zeros(6), gain_v)
        for j, unit in enumerate(np.eye(6)):
            ahead, behind = (forces(z + d * unit, gain_v * d * unit, gain_v)[0] for d in (STEP, -STEP))
            np.testing.assert_allclose(tangent[:, j], -(ahead - behind) / (2 * STEP), rtol=1e-6, atol=100 * ATOL)
