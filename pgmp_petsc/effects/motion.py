"""Prescribed motions of a coordinate: angle, speed and acceleration at any time.

A spin-up to the speed ``Omega`` in the time T is that of Simo and Vu-Quoc (1986),

    theta = Omega / T (t^2 / 2 + (T / 2 pi)^2 (cos(2 pi t / T) - 1)),   then   theta = Omega (t - T / 2),

whose acceleration ``Omega / T (1 - cos(2 pi t / T))`` has no jump. Tables become cubic splines at rest at both ends,
and stay where they end; all others go on for ever. Where an acceleration jumps it is the later one: a run that begins
at a table's first row begins with what the table does then.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pgmp_petsc.effects.time_function import Piece, TimeFunction, harmonic
from pgmp_petsc.scene.effects import PrescribedMotion
from pgmp_petsc.scene.fields import ConstantSpeed, Harmonic, SpinUp, TimeTable


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

    Attributes
    ----------
    angle
        Over time, rad.
    """

    def __init__(self, name: str, entry: PrescribedMotion) -> None:
        self.name = name
        self.coordinate = entry.coordinate
        makers = {"table": _table, "harmonic": _harmonic, "spin_up": _spin_up, "constant_speed": _constant_speed}
        self.angle = next(make(getattr(entry, key)) for key, make in makers.items() if getattr(entry, key) is not None)

    def at(self, time: float | np.ndarray) -> Instant:
        """Return the motion at a time (s), or at each of several."""
        return Instant(*self.angle.with_rates(time))


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

    def at(self, time: float | np.ndarray) -> Instant:
        """Return the angle, at rest."""
        rest = np.zeros_like(time, dtype=float)
        return Instant(rest + self.angle, rest, rest)


def driven(motions: Sequence[Motion | Held], time: float) -> Instant:
    """Return several motions at a time (s)."""
    return Instant(*np.array([motion.at(time) for motion in motions]).reshape(-1, 3).T)


def _table(rows: TimeTable) -> TimeFunction:
    from scipy.interpolate import CubicSpline  # takes a noticeable time, and few motions are tables

    times, angles = np.array(rows, dtype=float).T
    cubics = CubicSpline(times, angles, bc_type="clamped").c[::-1].T
    between = [Piece(*one) for one in zip(times, times, cubics)]
    return TimeFunction(Piece(cubic=(angles[0],)), *between, Piece(times[-1], cubic=(angles[-1],)))


def _harmonic(wave: Harmonic) -> TimeFunction:
    return TimeFunction(harmonic(wave))


def _spin_up(entry: SpinUp) -> TimeFunction:
    end, rate, gain = entry.time, 2.0 * np.pi / entry.time, entry.speed / entry.time
    swing = gain / rate**2
    rising = Piece(cubic=(entry.start - swing, 0.0, 0.5 * gain), wave=(swing, rate, 0.5 * np.pi))
    return TimeFunction(rising, Piece(end, 0.5 * end, (entry.start, entry.speed)))


def _constant_speed(entry: ConstantSpeed) -> TimeFunction:
    return TimeFunction(Piece(cubic=(entry.start, entry.speed)))
