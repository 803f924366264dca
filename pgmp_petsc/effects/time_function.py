"""Functions of time: on each of their pieces a cubic polynomial and a sinusoid,

    f(t) = c_0 + c_1 s + c_2 s^2 + c_3 s^3 + a sin(w t + p),     s = t - origin of the piece,

which is what tables, harmonics, splines and spin-ups are made of. They are compiled, so that an integrator evaluates
them at any instant within a step. Loads have tables, linear between their rows, and harmonics (`amplitude_of`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.scene.effects import OverTime
from pgmp_petsc.scene.fields import Harmonic, LoadHarmonic, LoadTable


class TimeFunctions(NamedTuple):
    """Several functions of time, the pieces of one behind those of the other."""

    firsts: np.ndarray  # number of the first piece of each function, and the number of all, shape (n + 1,)
    #: from which instant on a piece holds, s; minus infinity for the first one of a function, shape (n_pieces,)
    begins: np.ndarray
    origins: np.ndarray  # from where a piece counts time, s, shape (n_pieces,)
    cubics: np.ndarray  # c_0 to c_3 of each piece, shape (n_pieces, 4); of a higher degree for `TimeFunction.jet` alone
    waves: np.ndarray  # a, w (rad/s) and p (rad) of each piece, shape (n_pieces, 3)


class Piece(NamedTuple):
    """A piece of a function; see `TimeFunctions`."""

    begin: float = -np.inf
    origin: float = 0.0
    cubic: tuple[float, ...] = ()
    wave: tuple[float, float, float] = (0.0, 0.0, 0.0)


class TimeFunction:
    """A function of time (s) of pieces, one after the other; the first one begins at minus infinity."""

    def __init__(self, *pieces: Piece) -> None:
        self.pieces = pieces

    @classmethod
    def constant(cls, value: float) -> TimeFunction:
        """Return a constant."""
        return cls(Piece(cubic=(value,)))

    def __call__(self, time: float | np.ndarray) -> np.ndarray:
        """Return the value at a time, or at each of several."""
        return self.with_rates(time)[0]

    def with_rates(self, time: float | np.ndarray) -> np.ndarray:
        """Return value, first and second derivative at times of shape (...), shape (3, ...)."""
        times = np.array(time, dtype=float)
        found = np.empty((3, times.size))
        fill(self._alone, times.ravel(), found)
        return found.reshape(3, *times.shape)

    def jet(self, time: np.ndarray, order: int) -> list[np.ndarray]:
        """Return value and derivatives up to an order at times (n,), each (n,); polynomials may have any degree."""
        _, begins, origins, cubics, waves = self._alone
        at = np.maximum(np.searchsorted(begins, time, side="right") - 1, 0)
        c, s, (amplitude, rate, phase) = cubics[at].T, time - origins[at], waves[at].T
        found = []
        for k in range(order + 1):
            smooth = sum((c[j] * s**j for j in range(len(c))), np.zeros_like(s))
            found.append(smooth + amplitude * rate**k * np.sin(rate * time + phase + 0.5 * np.pi * k))
            c = np.arange(1, len(c))[:, None] * c[1:]
        return found

    @property
    def at_start(self) -> float:
        """Its value at time 0."""
        return float(self.with_rates(0.0)[0])

    @cached_property
    def _alone(self) -> TimeFunctions:
        return joined([self])


def derived(pieces: Sequence[Piece]) -> list[Piece]:
    """Return the pieces of the derivative of a function."""
    return [Piece(p.begin, p.origin, tuple(j * c for j, c in enumerate(p.cubic))[1:], _wave(p.wave, 1)) for p in pieces]


def integrated(pieces: Sequence[Piece]) -> list[Piece]:
    """Return the pieces of an integral: that of a wave without a mean, that of all else zero at time zero."""
    found: list[Piece] = []
    for p in pieces:
        c = [0.0, *(one / (j + 1) for j, one in enumerate(p.cubic))]
        if found:
            c[0] = _at(found[-1], p.begin) - _at(Piece(p.begin, p.origin, tuple(c)), p.begin)
        found.append(Piece(p.begin, p.origin, tuple(c), _wave(p.wave, -1)))
    at_zero = _at([p for p in found if p.begin <= 0.0][-1], 0.0)
    return [p._replace(cubic=(p.cubic[0] - at_zero, *p.cubic[1:])) for p in found]


def _at(piece: Piece, time: float) -> float:
    return sum(c * (time - piece.origin) ** j for j, c in enumerate(piece.cubic))


def _wave(wave: tuple[float, float, float], order: int) -> tuple[float, float, float]:
    """Return a derivative of a sinusoid, of order -1 an integral."""
    amplitude, rate, phase = wave
    return (amplitude * rate**order, rate, phase + 0.5 * np.pi * order) if amplitude else wave


def joined(functions: Sequence[TimeFunction]) -> TimeFunctions:
    """Return several functions as compiled code takes them."""
    pieces = [piece for function in functions for piece in function.pieces]
    counts = [len(function.pieces) for function in functions]
    cubics = np.zeros((len(pieces), max((4, *(len(piece.cubic) for piece in pieces)))))
    for row, piece in zip(cubics, pieces):
        row[: len(piece.cubic)] = piece.cubic
    return TimeFunctions(
        np.cumsum([0, *counts]),
        np.array([piece.begin for piece in pieces], dtype=float),
        np.array([piece.origin for piece in pieces], dtype=float),
        cubics,
        np.array([piece.wave for piece in pieces], dtype=float).reshape(-1, 3),
    )


@njit(error_model="numpy", counted=False)
def evaluate(functions, number, time):
    """Return value, first and second derivative of a function at a time."""
    piece, behind = functions.firsts[number], functions.firsts[number + 1]
    while behind - piece > 1:
        middle = (piece + behind) // 2
        if time >= functions.begins[middle]:
            piece = middle
        else:
            behind = middle
    s, c = time - functions.origins[piece], functions.cubics[piece]
    value = c[0] + s * (c[1] + s * (c[2] + s * c[3]))
    first, second = c[1] + s * (2.0 * c[2] + 3.0 * s * c[3]), 2.0 * c[2] + 6.0 * s * c[3]
    amplitude, rate, phase = functions.waves[piece]
    if amplitude != 0.0:
        wave, slope = amplitude * np.sin(rate * time + phase), amplitude * np.cos(rate * time + phase)
        value, first, second = value + wave, first + rate * slope, second - rate * rate * wave
    return value, first, second


@njit(cache=True, entry=True, error_model="numpy")
def fill(functions, times, found):
    """Evaluate the first of some functions and its derivatives at times (n,), (3, n)."""
    for k in range(times.size):
        found[0, k], found[1, k], found[2, k] = evaluate(functions, 0, times[k])


def amplitude_of(entry: OverTime) -> TimeFunction:
    """Return the strength of a torque (N m) or force (N) as a function of time (s); its scale is not in it.

    Its values are numbers (`Scene.plain_effects`).
    """
    return TimeFunction(harmonic(entry.harmonic)) if entry.harmonic is not None else _table(entry.table)


def harmonic(wave: Harmonic | LoadHarmonic) -> Piece:
    """Return what a harmonic is at any time."""
    return Piece(cubic=(wave.mean,), wave=(wave.amplitude, 2.0 * np.pi * wave.frequency_hz, wave.phase))


def _table(rows: LoadTable) -> TimeFunction:
    """Return what is linear between the rows of a table, and constant before and after."""
    (_, value), (last, final) = rows[0], rows[-1]
    between = [
        Piece(time, time, (here, (there - here) / (then - time))) for (time, here), (then, there) in pairwise(rows)
    ]
    return TimeFunction(Piece(cubic=(value,)), *between, Piece(last, cubic=(final,)))


class Instant(NamedTuple):
    """A motion at an instant, or several, each entry then of shape (n_motions,), rad or m."""

    angle: float | np.ndarray
    speed: float | np.ndarray
    acceleration: float | np.ndarray


@dataclass(eq=False)
class Motion:
    """The motion of a coordinate that an effect prescribes, or that holds it where it is."""

    name: str  # of the effect
    coordinate: str
    angle: TimeFunction  # rad or m

    def at(self, time: float | np.ndarray) -> Instant:
        """Return the motion at a time (s), or at each of several."""
        return Instant(*self.angle.with_rates(time))


def driven(motions: Sequence[Motion], time: float) -> Instant:
    """Return several motions at a time (s)."""
    return Instant(*np.array([motion.at(time) for motion in motions]).reshape(-1, 3).T)
