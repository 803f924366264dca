"""Functions of time that a scene gives: tables, harmonics, and the motions of a driven coordinate."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

from pydantic import AfterValidator, Field

from pgmp_petsc.scene.fields import Angle, Number, NumberOrParameter, Pair, Row, Table, no_parameter, refusal

Rows = tuple[tuple[float, float | str], ...]
_OF_MOTIONS = no_parameter(
    "a prescribed motion is a constraint, one for all samples; run once for each value (--override), or drive the "
    "coordinate by a torque, whose amplitude may be a parameter"
)
_OF_TIME = no_parameter(
    "loads are affine in their parameters, which frequencies and phases are not; two harmonics of one frequency a "
    "quarter of a turn apart have any phase, by their amplitudes; run once for each frequency (--override)"
)


def _times_increase(table: Rows) -> Rows:
    for earlier, later in pairwise(table):
        if not earlier[0] < later[0]:
            raise refusal(f"times must increase strictly, but {later[0]} s follows {earlier[0]} s")
    return table


#: Rows [time (s), value] with increasing times.
TimeTable = Annotated[tuple[Pair, ...], Field(min_length=1), AfterValidator(_times_increase), _OF_MOTIONS]
#: Rows [time (s), value] of a load, whose values may be parameters.
LoadTable = Annotated[tuple[Row, ...], Field(min_length=1), AfterValidator(_times_increase)]


class Harmonic(Table):
    """``mean + amplitude sin(2 pi frequency_hz t + phase)`` of a coordinate."""

    amplitude: Annotated[Number, _OF_MOTIONS] = Field(description="amplitude (rad)")
    frequency_hz: Annotated[Number, _OF_MOTIONS] = Field(gt=0.0, description="frequency (Hz)")
    phase: Annotated[Angle, _OF_MOTIONS] = Field(0.0, description="phase at time 0 (rad)")
    mean: Annotated[Number, _OF_MOTIONS] = Field(0.0, description="mean value (rad)")


class LoadHarmonic(Table):
    """``mean + amplitude sin(2 pi frequency_hz t + phase)`` of a torque (N m) or force (N)."""

    amplitude: NumberOrParameter = Field(description="amplitude (N m) or (N), a number or a parameter's name")
    frequency_hz: Annotated[Number, _OF_TIME] = Field(gt=0.0, description="frequency (Hz)")
    phase: Annotated[Angle, _OF_TIME] = Field(0.0, description="phase at time 0 (rad)")
    mean: NumberOrParameter = Field(0.0, description="mean value (N m) or (N), a number or a parameter's name")


class SpinUp(Table):
    """From rest to a constant speed without a jump of the acceleration (Simo and Vu-Quoc 1986, section 5)."""

    speed: Annotated[Number, _OF_MOTIONS] = Field(description="speed at the end (rad/s)")
    time: Annotated[Number, _OF_MOTIONS] = Field(gt=0.0, description="time it takes (s)")
    start: Annotated[Angle, _OF_MOTIONS] = Field(0.0, description="angle at time 0 (rad)")


class ConstantSpeed(Table):
    """A rotation at constant speed."""

    speed: Annotated[Number, _OF_MOTIONS] = Field(description="speed (rad/s)")
    start: Annotated[Angle, _OF_MOTIONS] = Field(0.0, description="angle at time 0 (rad)")
