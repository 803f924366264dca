"""Derivatives of functions by central differences."""

from collections.abc import Callable

import numpy as np


def slopes(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray, step: float, order: int = 2) -> np.ndarray:
    """Return the derivatives of a function in all entries of `at` (n,), along the last axis; of order 2 or 4."""
    found = []
    for unit in step * np.eye(len(at)):
        slope = (function(at + unit) - function(at - unit)) / (2 * step)
        if order == 4:
            slope = (4 * slope - (function(at + 2 * unit) - function(at - 2 * unit)) / (4 * step)) / 3
        found.append(slope)
    return np.stack(found, axis=-1)


def characteristic_roots(residual: Callable[[np.ndarray], np.ndarray], state: np.ndarray, step: float) -> np.ndarray:
    """Return the roots of ``det(M s^2 + C s + K) = 0`` about a state (3, n) of a residual (n,) of positions, velocities
    and accelerations."""
    n = state.shape[1]
    matrices = slopes(lambda at: residual(at.reshape(3, n)), state.ravel(), step)
    stiffness, damping, mass = np.split(matrices, 3, axis=1)
    below = [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]
    return np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], below]))
