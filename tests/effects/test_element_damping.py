"""Kelvin-Voigt damping of the beam element against differences of its strains."""

import numpy as np
import pytest
from compiled_elements import damped_beam2d

LENGTH, ALPHA, BETA, GAIN_V = 0.7, 0.4, 0.03, 250.0
SECTION = np.array([3.0, 2.0, 0.5])
STEP = 1e-6


def strains(u: np.ndarray) -> np.ndarray:
    """Return (eps, gamma, kappa) of one element, as the docstring of `beam2d` states them."""
    dx, dy, psi = u[3] - u[0], u[4] - u[1], 0.5 * (u[2] + u[5]) + ALPHA
    stretch, across = np.cos(psi) * dx + np.sin(psi) * dy, np.cos(psi) * dy - np.sin(psi) * dx
    return np.array([stretch - LENGTH, across, u[5] - u[2]]) / LENGTH


def damped(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return force (6,), full tangent (6, 6) and power of one element."""
    return damped_beam2d(u, v, LENGTH, ALPHA, SECTION, BETA, GAIN_V)


def states() -> list[tuple[np.ndarray, np.ndarray]]:
    """Return strongly deformed states and their rates."""
    rng = np.random.default_rng(4)
    return [
        (np.array([0.1, -0.2, 0.3, 0.85, 0.15, -0.4]) + rng.normal(0, 0.3, 6), rng.normal(size=6)) for _ in range(5)
    ]


def test_stresses_follow_the_rate_of_the_strains() -> None:
    for u, v in states():
        slopes = np.array([(strains(u + STEP * unit) - strains(u - STEP * unit)) / (2 * STEP) for unit in np.eye(6)])
        rates = (strains(u + STEP * v) - strains(u - STEP * v)) / (2 * STEP)
        force, _, power = damped(u, v)
        # central differences: round-off over the step, 1e-10
        np.testing.assert_allclose(force, LENGTH * slopes @ (BETA * SECTION * rates), rtol=0, atol=1e-9)
        assert power == pytest.approx(-LENGTH * BETA * SECTION @ rates**2, rel=0, abs=1e-9)
        assert power == pytest.approx(-force @ v, rel=1e-12)


def test_the_tangent_is_that_of_the_rates() -> None:
    for u, v in states():
        _, tangent, _ = damped(u, v)
        columns = [(damped(u, v + STEP * unit)[0] - damped(u, v - STEP * unit)[0]) / (2 * STEP) for unit in np.eye(6)]
        np.testing.assert_allclose(tangent, GAIN_V * np.array(columns).T, rtol=0, atol=GAIN_V * 1e-9)


def test_a_rigid_motion_is_not_damped_however_deformed_the_element_is() -> None:
    for u, _ in states():
        turning = 1.7 * np.array([-u[1], u[0], 1.0, -u[4], u[3], 1.0]) + np.array([0.4, -0.3, 0, 0.4, -0.3, 0])
        force, _, power = damped(u, turning)
        np.testing.assert_allclose(force, 0.0, atol=1e-14)
        assert power == pytest.approx(0.0, abs=1e-15)
