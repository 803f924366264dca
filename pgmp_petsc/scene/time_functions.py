"""Functions of time that a scene gives: tables, harmonics, and the motions of a driven coordinate."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

from pydantic import AfterValidator, Field

from pgmp_petsc.scene.fields import Angle, Number, Pair, Table, refusal


def _times_increase(table: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    for earlier, later in pairwise(table):
        if not earlier[0] < later[0]:
            raise refusal(f"times must increase strictly, but {later[0]} s follows {earlier[0]} s")
    return table


#: Rows [time (s), value] with increasing times.
TimeTable = Annotated[tuple[Pair, ...], Field(min_length=1), AfterValidator(_times_increase)]


class Harmonic(Table):
    """``mean + amplitude sin(2 pi frequency_hz t + phase)``."""

    amplitude: Number = Field(description="amplitude, in the unit of what it drives")
    frequency_hz: Number = Field(gt=0.0, description="frequency (Hz)")
    phase: Angle = Field(0.0, description="phase at time 0 (rad)")
    mean: Number = Field(0.0, description="mean value")


class SpinUp(Table):
    """From rest to a constant speed without a jump of the acceleration (Simo and Vu-Quoc 1986, section 5)."""

    speed: Number = Field(description="speed at the end (rad/s)")
    time: Number = Field(gt=0.0, description="time it takes (s)")
    start: Angle = Field(0.0, description="angle at time 0 (rad)")


class ConstantSpeed(Table):
    """A rotation at constant speed."""

    speed: Number = Field(description="speed (rad/s)")
    start: Angle = Field(0.0, description="angle at time 0 (rad)")
