"""Strengths over time: tables, linear between their rows, and harmonics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pgmp_petsc.scene.effects import Force, Torque


def amplitude_of(entry: Torque | Force) -> Callable[[float | np.ndarray], float | np.ndarray]:
    """Return the strength of a torque (N m) or force (N) as a function of time (s); its scale is not in it."""
    if entry.harmonic is not None:
        wave = entry.harmonic
        rate = 2.0 * np.pi * wave.frequency_hz
        return lambda time: wave.mean + wave.amplitude * np.sin(rate * np.asarray(time) + wave.phase)
    times, values = np.array(entry.table, dtype=float).T
    return lambda time: np.interp(time, times, values)
