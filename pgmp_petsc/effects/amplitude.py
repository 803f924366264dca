"""Strengths over time: tables, linear between their rows, and harmonics."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from pgmp_petsc.effects.time_function import Piece, TimeFunction
from pgmp_petsc.scene.effects import Force, Torque
from pgmp_petsc.scene.time_functions import Harmonic, LoadHarmonic, LoadTable


def amplitude_of(entry: Torque | Force) -> TimeFunction:
    """Return the strength of a torque (N m) or force (N) as a function of time (s); its scale is not in it.

    Its values are numbers (`scene.load_parts`).
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
