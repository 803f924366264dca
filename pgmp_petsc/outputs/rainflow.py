"""Fatigue: cycles of an output, counted by rainflow as a run goes on, and the damage that they do.

A cycle of amplitude a and mean m does the damage 1 / N, N = N_0 (a_0 / a)^k, all together their sum (Miner 1945). With
Goodman's line a is ``a / (1 - max(m, 0) / R)`` with the ultimate strength R: means of compression do not help. A cycle
does 1 at most, as does one whose mean reaches R. The life is ``t / damage``, up to a run-out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.base.units import UnknownUnit, measure
from pgmp_petsc.lanes.rainflow import count
from pgmp_petsc.outputs.readings import AnyReading, OfReading
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.fields import (
    OrFile,
    Pair,
    PositiveNumber,
    PositiveOrParameter,
    Table,
    Unit,
    Use,
    named_numbers,
    refusal,
)
from pgmp_petsc.scene.messages import Finding, doubt
from pgmp_petsc.scene.outputs import OutputEntry, unit_of

Values = Mapping[str, np.ndarray | float]


class Curve(Table):
    """An S-N curve (Woehler): the cycles to failure over the amplitude of a stress."""

    one_of = ("exponent", "table")
    exponent: Annotated[PositiveOrParameter | None, Unit("1")] = Field(
        None, description="k of N = cycles (reference / amplitude)^k"
    )
    reference: Annotated[PositiveOrParameter | None, Unit("Pa")] = Field(
        None, description="amplitude of the stress (Pa), half of its range"
    )
    cycles: Annotated[PositiveOrParameter | None, Unit("1")] = Field(
        None, description="cycles to failure at the reference"
    )
    table: Annotated[tuple[Pair, ...] | None, Unit(), OrFile(True)] = Field(
        None,
        min_length=2,
        description="instead of these rows [amplitude (Pa), cycles to failure], straight lines between them and beyond "
        "the ends where both axes are logarithmic",
    )

    def check_entries(self) -> None:
        for key in ("reference", "cycles"):
            if (getattr(self, key) is None) != (self.table is not None):
                missing = "missing: a curve has exponent, reference and cycles, or a table"
                raise refusal("not given beside a table" if self.table is not None else missing, key)
        for (low, many), (high, few) in pairwise(self.table or ()):
            if not (0.0 < low < high and many > few > 0.0):
                raise refusal(
                    "amplitudes must rise and cycles to failure must fall from row to row, all positive, but "
                    f"({high:g}, {few:g}) follows ({low:g}, {many:g})",
                    "table",
                )


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
        None, description="ultimate strength (Pa) for goodman"
    )
    quantity: Literal["damage", "life"] = Field(
        "damage",
        description="damage: sum of cycles over cycles to failure, the part fails at 1; life: time over damage (s)",
    )
    run_out: Annotated[PositiveNumber | None, Unit("s")] = Field(
        None, description="of a life: the longest that counts (s); what lives longer does not fail"
    )

    def measured(self, entry: str) -> Iterator[Use]:
        return Use.of_rows(f"{entry}.curve.table", self.curve.table, "Pa", "1")

    def check_entries(self) -> None:
        if (self.mean_stress == "goodman") != (self.ultimate is not None):
            words = "missing: goodman takes the ultimate strength" if self.ultimate is None else "for goodman alone"
            raise refusal(f'{words}; give mean_stress = "goodman" and ultimate, or neither', "ultimate")
        if (self.quantity == "life") != (self.run_out is not None):
            words = "missing: a life takes the longest that counts (s)" if self.run_out is None else "for a life alone"
            raise refusal(f'{words}; give quantity = "life" and run_out, or neither', "run_out")

    @property
    def made_of(self) -> Mapping[str, str]:
        return {self.of: "of"}

    def unit_in(self, scene: Scene) -> str:
        return "s" if self.quantity == "life" else "1"

    def uses(self, scene: Scene, entry: str) -> Iterator[Use]:
        yield from super().uses(scene, entry)
        yield from named_numbers(f"{entry}.curve", self.curve)

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
        return Counted(parts[self.of], self)


@dataclass(frozen=True, eq=False)
class Counted(OfReading):
    """A reading of what is counted: its values are those of the other output, until `Counting` takes them over time."""

    entry: Rainflow

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
    """The counts of n samples, by the outputs' names, as a run goes on; values of parameters are numbers or of shape
    (n,)."""

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

    def take(self, values: np.ndarray) -> np.ndarray:
        """Return the damages so far, for further values, both (n_t, n); see `count`."""
        room = int(self._depths.max(initial=0)) + len(values) - self._points.shape[1]
        if room > 0:
            more = ((0, 0), (0, room + 8))
            self._points, self._halves = np.pad(self._points, more), np.pad(self._halves, more)
        damages = np.empty(values.shape)
        count(
            np.require(values, requirements="CW"), self._curve, self._ultimate, self._points, self._halves,
            self._depths, self._closed, damages, np.zeros((0, 3)),
        )  # fmt: skip
        return damages


def counted_after(
    counts: Mapping[str, Counted], times: np.ndarray, found: Mapping[str, np.ndarray], values: Values
) -> dict[str, np.ndarray]:
    """Return outputs of whole runs, (n_t, n) or (n_t,), with those that are counted in place of what they count."""
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
