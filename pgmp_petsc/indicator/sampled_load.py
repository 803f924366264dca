"""Loads as a run sees them: at its time steps only.

Between two steps a load may bend or jump. Whatever the integrator makes of it, over a stretch of time the run feels
another impulse than the load has: the difference between the exact integral of the amplitude and the integral of what
is known at the steps (`quadrature`). Spread over the stretch, it is added to the amplitude at the instants at which the
error of the run is evaluated.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects import Action, Effect
from pgmp_petsc.effects.load import Load
from pgmp_petsc.indicator.quadrature import integrals

N_PARTS = 16  # of a step, between which an amplitude is taken for linear


class SampledLoad(Effect):
    """An effect at the instants of evaluation, with the impulse that the run missed.

    Parameters
    ----------
    effect
        The effect.
    steps
        Numbers of the steps at which the error is evaluated, the first 0, increasing.
    step
        s.
    interval
        Time between two evaluations, s; the evaluation number k has the time ``k interval``.
    """

    def __init__(self, effect: Effect, steps: np.ndarray, step: float, interval: float) -> None:
        super().__init__(effect.name)
        self._effect = effect
        self._interval = interval
        times = step * np.arange(steps[-1] + 1)
        amplitudes = effect.amplitude(times)
        missed = np.cumsum(_impulses(effect, times)) - integrals(amplitudes, step)
        middles = (steps[1:-1] + steps[2:]) / 2.0
        # nothing is evaluated before the first interval ends: it stands for the time from the start
        ends = np.interp(np.concatenate([[0.0], middles, [steps[-1]]]), np.arange(times.size), missed)
        self._amplitudes = amplitudes[steps]
        self._amplitudes[1:] += np.diff(ends) / interval

    def loads(self, matrices: AffineMatrices) -> list[Load]:
        """Return the load terms of the effect."""
        return self._effect.loads(matrices)

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return the patterns of the effect."""
        return self._effect.patterns(matrices)

    def turning_patterns(self) -> list[Action]:
        """Return the turning patterns of the effect."""
        return self._effect.turning_patterns()

    def amplitude(self, time: float | np.ndarray) -> float | np.ndarray:
        """Return the amplitude at the nearest evaluation."""
        return self._amplitudes[np.rint(np.divide(time, self._interval)).astype(int)]


def _impulses(effect: Effect, times: np.ndarray) -> np.ndarray:
    """Return the integral of the amplitude over every step, 0 first, shape (n_t,)."""
    result = np.zeros_like(times)
    steps = np.diff(times)
    for part in range(N_PARTS + 1):
        weight = 1.0 / N_PARTS if 0 < part < N_PARTS else 0.5 / N_PARTS
        result[1:] += weight * steps * effect.amplitude(times[:-1] + part / N_PARTS * steps)
    return result
