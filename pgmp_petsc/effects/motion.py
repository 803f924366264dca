"""Prescribed motions of a coordinate: angle, speed and acceleration at any time.

A spin-up to the speed ``Omega`` in the time T is that of Simo and Vu-Quoc (1986),

    theta = Omega / T (t^2 / 2 + (T / 2 pi)^2 (cos(2 pi t / T) - 1)),   then   theta = Omega (t - T / 2),

whose acceleration ``Omega / T (1 - cos(2 pi t / T))`` has no jump. Tables become cubic splines at rest at both ends,
and stay where they end; all others go on for ever.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from pgmp_petsc.scene.effects import PrescribedMotion
from pgmp_petsc.scene.time_functions import ConstantSpeed, Harmonic, SpinUp, TimeTable

Numbers = tuple[float, float, float]


class Instant(NamedTuple):
    """A motion at an instant, or several, each entry then of shape (n_motions,): rad, rad/s, rad/s2."""

    angle: float | np.ndarray
    speed: float | np.ndarray
    acceleration: float | np.ndarray


class Motion:
    """The motion of a coordinate that an effect prescribes.

    Parameters
    ----------
    name
        Name of the effect.
    entry
        What the scene says.
    """

    def __init__(self, name: str, entry: PrescribedMotion) -> None:
        self.name = name
        self.coordinate = entry.coordinate
        makers = {"table": _table, "harmonic": _harmonic, "spin_up": _spin_up, "constant_speed": _constant_speed}
        self._at = next(make(getattr(entry, key)) for key, make in makers.items() if getattr(entry, key) is not None)

    def at(self, time: float) -> Instant:
        """Return the motion at a time (s)."""
        return Instant(*self._at(time))


class Held:
    """A coordinate that is held where it is, as `Motion`.

    Attributes
    ----------
    angle
        Where, rad.
    """

    name = "held"

    def __init__(self, angle: float) -> None:
        self.angle = angle

    def at(self, time: float) -> Instant:
        """Return the angle, at rest."""
        return Instant(self.angle, 0.0, 0.0)


def driven(motions: Sequence[Motion | Held], time: float) -> Instant:
    """Return several motions at a time (s)."""
    return Instant(*np.array([motion.at(time) for motion in motions]).reshape(-1, 3).T)


def _table(rows: TimeTable) -> Callable[[float], Numbers]:
    from scipy.interpolate import CubicSpline  # takes a noticeable time, and few motions are tables

    times, angles = np.array(rows, dtype=float).T
    spline = CubicSpline(times, angles, bc_type="clamped")

    def at(time: float) -> Numbers:
        if time <= times[0] or time >= times[-1]:
            return float(angles[0] if time <= times[0] else angles[-1]), 0.0, 0.0
        return float(spline(time)), float(spline(time, 1)), float(spline(time, 2))

    return at


def _harmonic(wave: Harmonic) -> Callable[[float], Numbers]:
    rate = 2.0 * np.pi * wave.frequency_hz

    def at(time: float) -> Numbers:
        sin, cos = np.sin(rate * time + wave.phase), np.cos(rate * time + wave.phase)
        swing = wave.amplitude
        return wave.mean + swing * sin, swing * rate * cos, -swing * rate**2 * sin

    return at


def _spin_up(entry: SpinUp) -> Callable[[float], Numbers]:
    end, rate = entry.time, 2.0 * np.pi / entry.time

    def at(time: float) -> Numbers:
        if time >= end:
            return entry.start + entry.speed * (time - 0.5 * end), entry.speed, 0.0
        gain = entry.speed / end
        angle = gain * (0.5 * time**2 + (np.cos(rate * time) - 1.0) / rate**2)
        return entry.start + angle, gain * (time - np.sin(rate * time) / rate), gain * (1.0 - np.cos(rate * time))

    return at


def _constant_speed(entry: ConstantSpeed) -> Callable[[float], Numbers]:
    return lambda time: (entry.start + entry.speed * time, entry.speed, 0.0)
