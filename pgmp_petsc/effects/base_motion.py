"""A base that moves: the ground's points go along a direction as given, and everything is seen from the base.

In the frame of the base every mass m has the force ``-m x''`` of the base's displacement x(t), as in a gravity field of
the acceleration ``-x''``; where bodies and points are, and their speeds, count from the base. A table of accelerations
is linear between its rows and constant beyond them. One of displacements or velocities is a cubic spline at rest beyond
its ends, whose derivatives are exact. The base may have any speed at the start: those of the bodies are against it.

Absolute outputs add x(t) itself, which is integrated exactly: from a table of accelerations or velocities the base
begins at time zero at x = 0, and at rest where accelerations are given; one of displacements is x. A harmonic of any of
these is the harmonic base: its integrals have no constant, and a mean value begins as a table does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.loads import Weights
from pgmp_petsc.effects.time_function import Course, Piece, TimeFunction, amplitude_of, derived, integrated
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import OverTime
from pgmp_petsc.scene.fields import Direction, refusal
from pgmp_petsc.scene.references import harmonic_problems, load_problems

#: What is given, how often it is differentiated to an acceleration, and its unit.
GIVEN = {"acceleration": (0, "m/s2"), "velocity": (1, "m/s"), "displacement": (2, "m")}


class BaseMotion(OverTime):
    """The ground's points move along a direction as given; what is seen is seen from there."""

    type: Literal["base_motion"]
    acts = "forces"
    strength_unit = "m/s2"
    direction: Direction = Field(description="direction (x, y), in space (x, y, z); its length does not matter")
    of: Literal["acceleration", "velocity", "displacement"] = Field(
        "acceleration",
        description="what the table or harmonic is of (m/s2, m/s or m); a table of velocities or displacements is a "
        "cubic spline, at rest beyond its ends",
    )

    @model_validator(mode="after")
    def _a_spline_has_rows(self) -> Self:
        if self.of != "acceleration" and self.table is not None and len(self.table) < 2:
            raise refusal("a motion needs at least two rows", "table")
        return self

    @property
    def unit_of_values(self) -> str:
        """Unit of the values over time."""
        return GIVEN[self.of][1]

    @classmethod
    def if_added(cls, scene: Scene, run: Any, exchanged: float, tolerance: float) -> None:
        """Nobody can say how a base would move."""
        return None

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        """Yield a line if steps do not resolve it."""
        if self.of == "acceleration":
            yield from load_problems(scene, name, self)
        elif self.harmonic is not None:
            yield from harmonic_problems(scene, f"effects.{name}", self)

    def forces(self, name: str, mechanism: Mechanism) -> Weights:
        """Return the inertia forces."""
        return MovingBase(name, self, mechanism)


class MovingBase(Weights):
    """The inertia forces of a base's acceleration: weights that change over time."""

    conservative = False

    def __init__(self, name: str, entry: BaseMotion, mechanism: Mechanism) -> None:
        super().__init__(name, entry.direction, -1.0 * Quantity.of(entry.scale), mechanism)
        self.strength = acceleration_of(entry)


def acceleration_of(entry: BaseMotion) -> TimeFunction:
    """Return the acceleration of a base over time, m/s2; its scale is not in it."""
    pieces = _given(entry)
    for _ in range(GIVEN[entry.of][0]):
        pieces = derived(pieces)
    return TimeFunction(*pieces)


def displacement_of(entry: BaseMotion) -> Course:
    """Return how far a base has gone along its direction over time, m; its scale is not in it."""
    pieces = _given(entry)
    for _ in range(GIVEN[entry.of][0], 2):
        pieces = integrated(pieces)
    return Course(*pieces)


def bases_of(scene: Scene) -> Iterator[tuple[BaseMotion, Course]]:
    """Yield the motions of a scene's base, those whose values name parameters as several with a scale each."""
    for entry in scene.plain_effects.values():
        if isinstance(entry, BaseMotion):
            yield entry, displacement_of(entry)


def _given(entry: BaseMotion) -> Sequence[Piece]:
    """Return the pieces of what is given."""
    order, _ = GIVEN[entry.of]
    if order == 0 or entry.harmonic is not None:
        return amplitude_of(entry).pieces
    from scipy.interpolate import CubicSpline  # takes a noticeable time, and few bases move

    times, values = np.array(entry.table, dtype=float).T
    spline = CubicSpline(times, values, bc_type="clamped")
    between = [Piece(start, start, tuple(c[::-1])) for (start, _), c in zip(pairwise(times), spline.c.T)]
    return [Piece(cubic=(values[0],)), *between, Piece(times[-1], times[-1], (values[-1],))]
