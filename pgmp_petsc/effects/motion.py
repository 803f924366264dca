"""Motions that are given: of a coordinate, with value, speed and acceleration at any time, and of the base.

A spin-up to the speed ``Omega`` in the time T is that of Simo and Vu-Quoc (1986),

    theta = Omega / T (t^2 / 2 + (T / 2 pi)^2 (cos(2 pi t / T) - 1)),   then   theta = Omega (t - T / 2),

whose acceleration ``Omega / T (1 - cos(2 pi t / T))`` has no jump. Tables become cubic splines at rest at both ends,
and stay where they end; all others go on for ever. Where an acceleration jumps it is that of the table: a run that
begins at its first row, or ends at its last one, does so with what the table does then.

Where the base moves, the ground's points go along a direction as given, and everything is seen from the base. In its
frame every mass m has the force ``-m x''`` of the base's displacement x(t), as in a gravity field of the acceleration
``-x''``; where bodies and points are, and their speeds, count from the base, which may have any speed at the start.
What its tables and harmonics are, and where it begins, is in docs/effects.md (a base that moves); a table of
accelerations is constant beyond its rows. Absolute outputs add x(t) itself, integrated exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.loads import Weights
from pgmp_petsc.effects.time_function import Motion, Piece, TimeFunction, amplitude_of, derived, harmonic, integrated
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import Driving, OverTime
from pgmp_petsc.scene.fields import ConstantSpeed, Direction, Harmonic, LoadTable, SpinUp, TimeTable, refusal
from pgmp_petsc.scene.messages import Finding, doubt, problem, unknown
from pgmp_petsc.scene.references import harmonic_problems, load_problems
from pgmp_petsc.scene.uses import Use, slides

N_LOOKED_AT = 33  # instants between two rows
BEHIND = 1e-9  # of its last interval, from where on behind a spline it rests: steps end there but for round-off
RESTS = 0.02  # of the whole way of a table, by which its spline may move between rows that are the same


class PrescribedMotion(Driving):
    """A coordinate that moves as given, whatever it takes."""

    type: Literal["prescribed_motion"]
    one_of = ("table", "harmonic", "spin_up", "constant_speed")
    acts = "mechanism"
    changeable = ("table", "harmonic", "spin_up", "constant_speed")
    cause = True
    coordinate: str = Field(description="name of a coordinate")
    table: TimeTable | None = Field(
        None,
        description="rows [time (s), angle (rad) or displacement (m)]; cubic spline, at rest at both ends and beyond; "
        "or a CSV file, as of a load",
    )
    harmonic: Harmonic | None = Field(None, description="{ amplitude, frequency_hz, phase = 0, mean = 0 }")
    spin_up: SpinUp | None = Field(None, description="{ speed, time, start = 0 }: from rest to a constant speed")
    constant_speed: ConstantSpeed | None = Field(None, description="{ speed, start = 0 }")

    def check_entries(self) -> None:
        if self.table is not None and len(self.table) < 2:
            raise refusal("a motion needs at least two rows", "table")

    def measured(self, scene: Scene, entry: str) -> Iterator[Use]:
        """Yield what it is of the coordinate, and the times of its rows."""
        moved = scene.coordinates.get(self.coordinate)
        own = "m" if moved is not None and slides(scene, moved) else "rad"
        yield from Use.of_rows(f"{entry}.table", self.table, "s", own)
        for key in ("harmonic.amplitude", "harmonic.mean", "spin_up.start", "constant_speed.start"):
            yield Use(f"{entry}.{key}", units=(own,))
        for key in ("spin_up.speed", "constant_speed.speed"):
            yield Use(f"{entry}.{key}", units=(f"{own}/s",))

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        """Yield a line if there is no such coordinate, something else moves it, or steps do not resolve it."""
        if self.harmonic is not None:
            yield from harmonic_problems(scene, f"effects.{name}", self)
        entry = f"effects.{name}.coordinate"
        if self.coordinate not in scene.coordinates:
            yield unknown(entry, "coordinate", self.coordinate, scene.coordinates)
            return
        moved = scene.coordinates[self.coordinate]
        joint, slid = moved.joint, slides(scene, moved)
        for other, rival in scene.effects.items():
            on_joint = joint is not None and getattr(rival, "joint", None) == joint
            if rival.cause and on_joint and slides(scene, rival) == slid:
                yield problem(
                    entry,
                    f"contradicts effects.{other}, of type {rival.type} on the same joint {joint}: a prescribed motion "
                    f"takes whatever {'force' if slid else 'torque'} it needs; leave one of them out",
                    self.coordinate,
                )
            if other < name and isinstance(rival, Driving) and rival.coordinate == self.coordinate:
                yield problem(entry, f"effects.{other} prescribes the same coordinate", self.coordinate)
        if self.coordinate in scene.simulation.initial:
            yield problem(
                f"simulation.initial.{self.coordinate}",
                f"effects.{name} prescribes this coordinate from the start on; leave one of them out",
            )

    def doubts(
        self, scene: Scene, entry: str, frequencies: Mapping[str, float], first: Callable[[], float | None]
    ) -> Iterator[Finding]:
        """Yield a table that begins after the run, or whose spline moves between rows that say that it rests."""
        duration = scene.simulation.duration
        yield from _restless(entry, self.table or ())
        if self.table is not None and self.table[0][0] > duration:
            late = f"begins at {self.table[0][0]:g} s, but the run ends at simulation.duration = {duration:g} s"
            yield doubt(f"{entry}.table", f"{late}; nothing moves")

    @property
    def adds(self) -> str:
        return f"drives {self.coordinate}"

    @property
    def fastest(self) -> tuple[str, float, tuple[float, ...]]:
        """The entry that says how fast it becomes, how fast, and the entry's value if that is the speed."""
        if self.harmonic is not None:
            return "harmonic", 2 * np.pi * self.harmonic.frequency_hz * self.harmonic.amplitude, ()
        for key in ("spin_up", "constant_speed"):
            if getattr(self, key) is not None:
                speed = getattr(self, key).speed
                return f"{key}.speed", speed, (speed,)
        return "table", max(abs((b[1] - a[1]) / (b[0] - a[0])) for a, b in pairwise(self.table)), ()

    def motion(self, name: str) -> Motion:
        makers = {
            "table": lambda rows: TimeFunction(*_spline(rows)),
            "harmonic": lambda wave: TimeFunction(harmonic(wave)),
            "spin_up": _spin_up,
            "constant_speed": lambda given: TimeFunction(Piece(cubic=(given.start, given.speed))),
        }
        angle = next(make(getattr(self, key)) for key, make in makers.items() if getattr(self, key) is not None)
        return Motion(name, self.coordinate, angle)


def _restless(entry: str, rows: TimeTable | LoadTable) -> Iterator[Finding]:
    """Yield the rows of an effect's table between which its spline moves although they say that it rests."""
    pairs = [pair for pair in pairwise(rows) if pair[0][1] == pair[1][1]]
    spline, travel = TimeFunction(*_spline(rows)) if pairs else None, np.ptp([value for _, value in rows] or [0.0])
    for (begins, value), (ends, _) in pairs:
        off = np.max(np.abs(spline(np.linspace(begins, ends, N_LOOKED_AT)) - value))
        if off > RESTS * travel:
            moves = f"from {begins:g} to {ends:g} s the spline moves by {100 * off / travel:.2g} % of its whole way"
            yield doubt(f"{entry}.table", f"{moves}, where both rows are the same; more rows there let it rest")


def _spline(rows: TimeTable | LoadTable) -> list[Piece]:
    """Return a cubic spline through rows, at rest at both ends and beyond."""
    from scipy.interpolate import CubicSpline  # takes a noticeable time, and few motions are tables

    times, values = np.array(rows, dtype=float).T
    cubics = CubicSpline(times, values, bc_type="clamped").c[::-1].T
    between = [Piece(start, start, tuple(c)) for start, c in zip(times, cubics)]
    behind = times[-1] + BEHIND * (times[-1] - times[-2])
    return [Piece(cubic=(values[0],)), *between, Piece(behind, times[-1], (values[-1],))]


def _spin_up(entry: SpinUp) -> TimeFunction:
    end, rate, gain = entry.time, 2.0 * np.pi / entry.time, entry.speed / entry.time
    swing = gain / rate**2
    rising = Piece(cubic=(entry.start - swing, 0.0, 0.5 * gain), wave=(swing, rate, 0.5 * np.pi))
    return TimeFunction(rising, Piece(end, 0.5 * end, (entry.start, entry.speed)))


#: What is given, how often it is differentiated to an acceleration, and its unit.
GIVEN = {"acceleration": (0, "m/s2"), "velocity": (1, "m/s"), "displacement": (2, "m")}


class BaseMotion(OverTime):
    """The ground's points move along a direction as given; what is seen is seen from there."""

    type: Literal["base_motion"]
    strength_unit = "m/s2"
    direction: Direction = Field(description="direction (x, y), in space (x, y, z); its length does not matter")
    of: Literal["acceleration", "velocity", "displacement"] = Field(
        "acceleration",
        description="what the table or harmonic is of (m/s2, m/s or m); a table of velocities or displacements is a "
        "cubic spline, at rest beyond its ends",
    )

    def check_entries(self) -> None:
        if self.of != "acceleration" and self.table is not None and len(self.table) < 2:
            raise refusal("a motion needs at least two rows", "table")

    @property
    def unit_of_values(self) -> str:
        return GIVEN[self.of][1]

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        if self.of == "acceleration":
            yield from load_problems(scene, name, self)
        elif self.harmonic is not None:
            yield from harmonic_problems(scene, f"effects.{name}", self)

    def doubts(
        self, scene: Scene, entry: str, frequencies: Mapping[str, float], first: Callable[[], float | None]
    ) -> Iterator[Finding]:
        """Yield what is doubtful of a load, and a spline that moves between rows that say that it rests."""
        yield from super().doubts(scene, entry, frequencies, first)
        rows = self.table or ()
        if self.of != "acceleration" and not any(isinstance(value, str) for _, value in rows):
            yield from _restless(entry, rows)

    def course(self) -> TimeFunction:
        """Return how far the base has gone."""
        pieces = _given(self)
        for _ in range(GIVEN[self.of][0], 2):
            pieces = integrated(pieces)
        return TimeFunction(*pieces)

    def forces(self, name: str, mechanism: Mechanism) -> Weights:
        return Weights(name, self.direction, -1.0 * Quantity.of(self.scale), mechanism, acceleration_of(self))


def acceleration_of(entry: BaseMotion) -> TimeFunction:
    """Return the acceleration of a base over time, m/s2; its scale is not in it."""
    pieces = _given(entry)
    for _ in range(GIVEN[entry.of][0]):
        pieces = derived(pieces)
    return TimeFunction(*pieces)


def _given(entry: BaseMotion) -> Sequence[Piece]:
    order, _ = GIVEN[entry.of]
    return amplitude_of(entry).pieces if order == 0 or entry.harmonic is not None else _spline(entry.table)
