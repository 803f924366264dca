"""Loads as a run sees them: at its time steps only.

Between two steps a load may bend or jump. Whatever the integrator makes of it, over a stretch of time the run feels
another impulse than the load has: the difference between the exact integral of the amplitude and the integral of what
is known at the steps, by the trapezoidal rule, which is what the scheme makes of it but for its first steps. Spread
over the stretch, it is added to the amplitude at the instants at which the error of the run is evaluated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects import Action, Effect, Motion
from pgmp_petsc.effects.effect import Load
from pgmp_petsc.effects.motion import Instant

N_PARTS = 16  # of a step, between which an amplitude is taken for linear
Amplitude = Callable[[float | np.ndarray], float | np.ndarray]


class SampledAmplitude:
    """An amplitude over time (s) at the instants of evaluation, with the impulse that the run missed.

    The error is evaluated at steps of increasing numbers, the first 0; evaluation number k has the time ``k interval``.
    """

    def __init__(self, amplitude: Amplitude, steps: np.ndarray, step: float, interval: float) -> None:
        self._interval = interval
        times = step * np.arange(steps[-1] + 1)
        amplitudes = amplitude(times)
        # the integral of the amplitude over every step
        impulses, lengths, parts = np.zeros_like(times), np.diff(times), np.arange(N_PARTS + 1) / N_PARTS
        fine = amplitude((times[:-1] + parts[:, None] * lengths).ravel()).reshape(parts.size, lengths.size)
        for part, of_part in zip(parts, fine):
            impulses[1:] += (1.0 / N_PARTS if 0.0 < part < 1.0 else 0.5 / N_PARTS) * lengths * of_part
        seen = np.concatenate([[0.0], 0.5 * step * np.cumsum(amplitudes[1:] + amplitudes[:-1])])
        missed = np.cumsum(impulses) - seen
        middles = (steps[1:-1] + steps[2:]) / 2.0
        # nothing is evaluated before the first interval ends: it represents the time from the start
        ends = np.interp(np.concatenate([[0.0], middles, [steps[-1]]]), np.arange(times.size), missed)
        self._amplitudes = amplitudes[steps]
        self._amplitudes[1:] += np.diff(ends) / interval

    def __call__(self, time: float | np.ndarray) -> float | np.ndarray:
        """Return the amplitude at the nearest evaluation."""
        return self._amplitudes[np.rint(np.divide(time, self._interval)).astype(int)]


class SampledLoad(Effect):
    """An effect whose strength changes with time, at the instants of evaluation; see `SampledAmplitude`."""

    def __init__(self, effect: Effect, steps: np.ndarray, step: float, interval: float) -> None:
        super().__init__(effect.name)
        self._effect, self._instants = effect, (steps, step, interval)

    def loads(self, matrices: AffineMatrices) -> list[Load]:
        return self._effect.loads(matrices)

    def actions(self) -> list[Action]:
        """Return the actions of the effect with their strength at the instants of evaluation."""
        return self._sampled(self._effect.actions())

    def natural_actions(self) -> list[Action]:
        return self._sampled(self._effect.natural_actions())

    @cached_property
    def amplitude(self) -> SampledAmplitude:
        """The amplitude; effects that are actions alone are not asked for one."""
        return SampledAmplitude(self._effect.amplitude, *self._instants)

    def _sampled(self, actions: Sequence[Action]) -> list[Action]:
        sampled = (
            None if one.amplitude is None else SampledAmplitude(one.amplitude, *self._instants) for one in actions
        )
        return [replace(action, amplitude=amplitude) for action, amplitude in zip(actions, sampled)]


class SampledMotion:
    """A prescribed motion at the instants of evaluation, as `Motion`; parameters as of `SampledAmplitude`."""

    def __init__(self, motion: Motion, steps: np.ndarray, step: float, interval: float) -> None:
        self.name, self.coordinate = motion.name, motion.coordinate
        self._motion, self._times, self._interval = motion, step * steps, interval

    def at(self, time: float | np.ndarray) -> Instant:
        return self._motion.at(self._times[np.rint(np.divide(time, self._interval)).astype(int)])


def sampled_effects(effects: Sequence[Effect], steps: np.ndarray, step: float, interval: float) -> tuple[Effect, ...]:
    """Return effects at the instants of evaluation: those that do not change with time as they are."""
    return tuple(
        SampledLoad(effect, steps, step, interval) if _changes(effect, step * np.arange(steps[-1] + 1)) else effect
        for effect in effects
    )


def _changes(effect: Effect, times: np.ndarray) -> bool:
    sources = [action.amplitude for action in (*effect.actions(), *effect.natural_actions())]
    if any(source is not None for source in sources):
        return True
    # others have the constant one of all effects
    return effect.strength is not Effect.strength and bool(np.ptp(effect.amplitude(times)))
