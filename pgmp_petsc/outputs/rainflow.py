"""Fatigue: cycles of an output, counted by rainflow as a run goes on, and the damage that they do.

Turning points are kept on a stack whose first one is the start S of the count (ASTM E1049-85, section 5.4.4). With X
the range between the last two and Y the one before it, as long as X >= Y: if Y begins at S, it is half a cycle and S
moves on to its end, otherwise it is a cycle and both of its ends are dropped. What is left over are half cycles.
The last turning point is the present value as long as it goes on in the same direction: X only grows until it turns, so
that what is closed by then is closed at the turning point too, and the damage so far is that of the history up to now.
It is continuous and never falls.

A cycle of amplitude a and mean m does the damage 1 / N, N = N_0 (a_0 / a)^k, all together their sum (Miner 1945). With
Goodman's line a is ``a / (1 - max(m, 0) / R)`` with the ultimate strength R: means of compression do not help. A cycle
does 1 at most, as does one whose mean reaches R. The life is ``t / damage``, up to a run-out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from pgmp_petsc.base.units import UnknownUnit, measure
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.outputs.readings import AnyReading, Jet, Needs, Seen
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.fields import (
    Pair,
    PositiveNumber,
    PositiveOrParameter,
    Table,
    Unit,
    exactly_one,
    named_numbers,
    refusal,
)
from pgmp_petsc.scene.messages import Finding, doubt
from pgmp_petsc.scene.outputs import OutputEntry, unit_of
from pgmp_petsc.scene.uses import Use

Values = Mapping[str, np.ndarray | float]


def _falls(table: tuple[tuple[float, float], ...]) -> None:
    for (low, many), (high, few) in pairwise(table):
        if not (0.0 < low < high and many > few > 0.0):
            raise refusal(
                "amplitudes must rise and cycles to failure must fall from row to row, all positive, but "
                f"({high:g}, {few:g}) follows ({low:g}, {many:g})",
                "table",
            )


class Curve(Table):
    """An S-N curve (Woehler): the cycles to failure over the amplitude of a stress."""

    exponent: Annotated[PositiveOrParameter | None, Unit("1")] = Field(
        None, description="k of N = cycles (reference / amplitude)^k, or a parameter's name"
    )
    reference: Annotated[PositiveOrParameter | None, Unit("Pa")] = Field(
        None, description="amplitude of the stress (Pa), half of its range, or a parameter's name"
    )
    cycles: Annotated[PositiveOrParameter | None, Unit("1")] = Field(
        None, description="cycles to failure at the reference, or a parameter's name"
    )
    table: tuple[Pair, ...] | None = Field(
        None,
        min_length=2,
        description="instead of these rows [amplitude (Pa), cycles to failure], straight lines between them and beyond "
        "the ends where both axes are logarithmic",
    )

    @model_validator(mode="after")
    def _one_curve(self) -> Self:
        exactly_one(self, "exponent", "table")
        for key in ("reference", "cycles"):
            if (getattr(self, key) is None) != (self.table is not None):
                given = "not given beside a table" if self.table is not None else "missing: a curve has exponent, "
                raise refusal(given if self.table is not None else f"{given}reference and cycles, or a table", key)
        if self.table is not None:
            _falls(self.table)
        return self


class Rainflow(OutputEntry):
    """Fatigue: the damage that cycles of a stress did so far, counted by rainflow (ASTM E1049-85), or a part's life."""

    type: Literal["rainflow"]
    reads = ("outputs", "history")
    of: str = Field(description="name of another output, a stress")
    curve: Curve = Field(description="S-N curve: {exponent, reference, cycles} or {table}")
    mean_stress: Literal["none", "goodman"] = Field(
        "none", description="none: amplitudes alone count; goodman: those at a mean stress, by the ultimate strength"
    )
    ultimate: Annotated[PositiveOrParameter | None, Unit("Pa")] = Field(
        None, description="ultimate strength (Pa) for goodman, or a parameter's name"
    )
    quantity: Literal["damage", "life"] = Field(
        "damage",
        description="damage: sum of cycles over cycles to failure, the part fails at 1; life: time over damage (s)",
    )
    run_out: Annotated[PositiveNumber | None, Unit("s")] = Field(
        None,
        description="of a life: from which life on (s) a part counts as one that does not fail; lives are that at most",
    )

    @model_validator(mode="after")
    def _strength(self) -> Self:
        if (self.mean_stress == "goodman") != (self.ultimate is not None):
            words = "missing: goodman takes the ultimate strength" if self.ultimate is None else "for goodman alone"
            raise refusal(f'{words}; give mean_stress = "goodman" and ultimate, or neither', "ultimate")
        if (self.quantity == "life") != (self.run_out is not None):
            words = "missing: a life takes the longest that counts (s)" if self.run_out is None else "for a life alone"
            raise refusal(f'{words}; give quantity = "life" and run_out, or neither', "run_out")
        return self

    @property
    def made_of(self) -> Mapping[str, str]:
        """The output, by its entry."""
        return {self.of: "of"}

    def unit_in(self, scene: Scene) -> str:
        """Return that of its quantity."""
        return "s" if self.quantity == "life" else "1"

    def uses(self, scene: Scene, entry: str) -> Iterator[Use]:
        """Yield its numbers and those of its curve."""
        yield from super().uses(scene, entry)
        for key, *use in named_numbers(self.curve):
            yield Use(f"{entry}.curve.{key}", *use)

    def kinked_in(self, scene: Scene) -> bool:
        """Damages grow in parts."""
        return True

    def doubts(self, scene: Scene, name: str) -> Iterator[Finding]:
        """Yield a line if it counts what is no stress."""
        unit = unit_of(scene, self.of)
        try:
            is_stress = measure(unit)[1] == measure("Pa")[1]
        except UnknownUnit:
            is_stress = False
        if not is_stress:
            words = f"it is in {unit or 'an unknown unit'}, and S-N curves are of stresses (Pa); name a stress"
            yield doubt(f"outputs.{name}.of", words, self.of)

    def combined(self, name: str, parts: Mapping[str, AnyReading], scene: Scene) -> AnyReading:
        """Return what is counted, and how."""
        return Counted(parts[self.of], self)


@dataclass(frozen=True, eq=False)
class Counted:
    """A reading of what is counted: its values are those of the other output, until `Counting` takes them over time."""

    of: AnyReading
    entry: Rainflow

    @property
    def needs(self) -> Needs:
        """Those of what is counted."""
        return self.of.needs

    def depth(self, order: int) -> int:
        """Return that of what is counted."""
        return self.of.depth(order)

    def jet(self, seen: Seen, order: int) -> Jet:
        """Return what is counted."""
        return self.of.jet(seen, order)

    def curve(self, values: Values, n: int) -> np.ndarray:
        """Return amplitude, cycles and exponent of the parts of the curve, shape (n, n_parts, 3); the first one and the
        last one go on beyond."""
        curve = self.entry.curve
        if curve.table is None:
            numbers = (_of(key, values) for key in (curve.reference, curve.cycles, curve.exponent))
            return np.stack([np.broadcast_to(number, n) for number in numbers], axis=-1)[:, None].copy()
        parts = [
            (low, many, math.log(many / few) / math.log(high / low))
            for (low, many), (high, few) in pairwise(curve.table)
        ]
        return np.broadcast_to(np.array(parts), (n, len(parts), 3)).copy()

    def ultimate(self, values: Values, n: int) -> np.ndarray:
        """Return the ultimate strength, shape (n,); infinite where means do not count."""
        own = self.entry.ultimate
        return np.broadcast_to(np.inf if own is None else _of(own, values), n).astype(float)


def _of(value: float | str, values: Values) -> np.ndarray | float:
    return values[value] if isinstance(value, str) else value


class Counting:
    """The counts of n samples, as a run goes on.

    Parameters
    ----------
    counts
        What is counted, by the outputs' names.
    values
        Values of parameters, numbers or of shape (n,).
    """

    def __init__(self, counts: Mapping[str, Counted], values: Values, n: int) -> None:
        self._counts, self._stacks = counts, {name: _Stacks(one, values, n) for name, one in counts.items()}

    def over(self, times: np.ndarray, found: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return outputs (n_t, n) at the next instants (n_t,), s, with those that are counted in place of what they
        count."""
        result = dict(found)
        for name, stacks in self._stacks.items():
            damage = stacks.take(found[name])
            longest = self._counts[name].entry.run_out
            result[name] = damage
            if longest is not None:
                falls_short = damage * longest > times[:, None]
                life = np.divide(times[:, None], damage, out=np.full(damage.shape, longest), where=falls_short)
                result[name] = np.where(np.isnan(damage), damage, life)
        return result


class _Stacks:
    """Turning points of n samples that are not counted yet."""

    def __init__(self, counted: Counted, values: Values, n: int) -> None:
        self._curve, self._ultimate = counted.curve(values, n), counted.ultimate(values, n)
        self._points, self._halves = np.zeros((n, 8)), np.zeros((n, 8))
        self._depths, self._closed = np.zeros(n, dtype=np.int64), np.zeros(n)

    def take(self, values: np.ndarray, kept: np.ndarray | None = None) -> np.ndarray:
        """Return the damages so far, for further values, both (n_t, n); see `count`."""
        room = int(self._depths.max(initial=0)) + len(values) - self._points.shape[1]
        if room > 0:
            more = ((0, 0), (0, room + 8))
            self._points, self._halves = np.pad(self._points, more), np.pad(self._halves, more)
        kept = np.zeros((0, 3)) if kept is None else kept
        damages, values = np.empty(values.shape), np.ascontiguousarray(values)
        count(
            values, self._curve, self._ultimate, self._points, self._halves, self._depths, self._closed, damages, kept
        )
        return damages

    @property
    def left(self) -> np.ndarray:
        """The turning points of the first sample that are left over."""
        return self._points[0, : self._depths[0]]


def counted_after(
    counts: Mapping[str, Counted], times: np.ndarray, found: Mapping[str, np.ndarray], values: Values
) -> dict[str, np.ndarray]:
    """Return outputs of whole runs, (n_t, n) or (n_t,), with those that are counted in place of what they count."""
    if not counts:
        return dict(found)
    rows = {name: column.reshape(times.size, -1) for name, column in found.items()}
    counting = Counting(counts, values, next(iter(rows.values())).shape[1])
    return {name: part.reshape(found[name].shape) for name, part in counting.over(times, rows).items()}


STEP = 1e-6  # share by which what is counted, or a parameter, is changed; rounding leaves 1e-10


def counted_changes(
    counts: Mapping[str, Counted], times: np.ndarray, found: Mapping[str, np.ndarray],
    changes: Mapping[str, np.ndarray], values: Values, name: str,
) -> dict[str, np.ndarray]:  # fmt: skip
    """Return the derivatives of outputs with a parameter over a run, each (n_t,): of those that are counted, which come
    with the derivatives of what they count, central differences of counts."""
    result = dict(changes)
    for output, counted in counts.items():
        largest = np.abs(found[output]).max(initial=np.finfo(float).tiny)
        fastest = max(np.abs(changes[output]).max(initial=0.0) / largest, 1.0 / (abs(values[name]) or np.inf))
        far = STEP / fastest if fastest else STEP
        sides = [
            counted_after(
                {output: counted}, times, {output: found[output] + way * changes[output]},
                {**values, name: values[name] + way},
            )[output]
            for way in (far, -far)
        ]  # fmt: skip
        result[output] = (sides[0] - sides[1]) / (2.0 * far)
    return result


def cycles(history: np.ndarray) -> np.ndarray:
    """Return the cycles of a history (n_t,), shape (n, 3): their ends, and 1 or, of half cycles, 1/2."""
    plain = Rainflow(type="rainflow", of="", curve=Curve(exponent=1.0, reference=1.0, cycles=1.0))
    stacks, kept = _Stacks(Counted(None, plain), {}, 1), np.zeros((history.size, 3))
    stacks.take(history[:, None], kept)
    left = stacks.left
    halves = np.column_stack([left[:-1], left[1:], np.full(max(left.size - 1, 0), 0.5)])
    return np.concatenate([kept[kept[:, 2] > 0.0], halves])


@njit(error_model="numpy", counted=False)
def _damage(first, second, curve, ultimate):
    """Return the damage of a cycle between two turning points; curve of shape (n_parts, 3)."""
    amplitude, mean = 0.5 * abs(first - second), 0.5 * (first + second)
    if mean > 0.0:
        if not mean < ultimate:
            return 1.0
        amplitude /= 1.0 - mean / ultimate
    part = 0
    while part + 1 < curve.shape[0] and amplitude >= curve[part + 1, 0]:
        part += 1
    return min((amplitude / curve[part, 0]) ** curve[part, 2] / curve[part, 1], 1.0)


@njit(cache=True, entry=True, error_model="numpy")
def count(values, curve, ultimate, points, halves, depths, closed, damages, kept):
    """Count the cycles of some samples further.

    Parameters
    ----------
    values
        At the next instants, shape (n_t, n). From the first that is no number on a sample has no damage.
    curve, ultimate
        Of every sample, shapes (n, n_parts, 3) and (n,).
    points, halves
        Stacks of turning points, and the damage of the half cycles up to each, shape (n, most); advanced in place, as
        are their depths and the damage of cycles that are closed, shape (n,).
    damages
        Takes the damages so far, shape (n_t, n).
    kept
        Takes the ends of cycles that are closed, and how much each counts, shape (n_t, 3); without rows it does not.
    """
    n_t, n = values.shape
    for k in range(n):
        point, half, n_kept = points[k], halves[k], 0
        depth, total = depths[k], closed[k]
        for t in range(n_t):
            value = values[t, k]
            if value != value:
                total = math.nan
            elif depth < 2:
                if depth == 0 or value != point[0]:
                    point[depth] = value
                    depth += 1
            elif (value - point[depth - 1]) * (point[depth - 1] - point[depth - 2]) >= 0.0:
                point[depth - 1] = value
            else:
                point[depth] = value
                depth += 1
            while depth > 2 and abs(point[depth - 1] - point[depth - 2]) >= abs(point[depth - 2] - point[depth - 3]):
                share = 0.5 if depth == 3 else 1.0
                total += share * _damage(point[depth - 3], point[depth - 2], curve[k], ultimate[k])
                if kept.shape[0]:
                    kept[n_kept, 0], kept[n_kept, 1], kept[n_kept, 2] = point[depth - 3], point[depth - 2], share
                    n_kept += 1
                if depth == 3:
                    point[0], point[1] = point[1], point[2]
                    depth = 2
                else:
                    point[depth - 3] = point[depth - 1]
                    depth -= 2
            if depth > 1:
                last = 0.5 * _damage(point[depth - 2], point[depth - 1], curve[k], ultimate[k])
                half[depth - 1] = half[depth - 2] + last
            else:
                half[0] = 0.0
            damages[t, k] = total + half[max(depth, 1) - 1]
        depths[k], closed[k] = depth, total
