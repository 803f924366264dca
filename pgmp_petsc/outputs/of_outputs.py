"""Outputs of other outputs: how fast they change, and formulas of them, the time and parameters.

A `rate` is the derivative over time of an output, of first or second order: a speed or what an accelerometer shows. It
is exact for the model's own state, of which rates and accelerations follow by the chain rule (`readings`): no instants
are differenced. As runs have q' and q'' to second order in the step, so are rates of both orders.

A `formula` is parsed as a formula of an effect is, and never evaluated as Python. Its derivatives over time follow from
those of what it names (`declare.formulas.Series`); comparisons are 1 or 0, and derivatives leave out their jumps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Literal

import numpy as np
from pydantic import Field

from pgmp_petsc.base.units import UnknownUnit, measure, si_name
from pgmp_petsc.declare.expressions import called_at, check
from pgmp_petsc.declare.formulas import (
    ALLOWED,
    NUMBER,
    DimensionError,
    Dimensions,
    FormulaError,
    Measured,
    Series,
    SeriesAlgebra,
    declared,
    evaluated,
    in_si,
)
from pgmp_petsc.outputs.readings import TIME, AnyReading, Expression, FormulaOf, Jet, Needs, Rate, RateOf, Seen, jet_of
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.outputs import OutputEntry, per_second, unit_of
from pgmp_petsc.scene.units import own_powers
from pgmp_petsc.scene.uses import Use, uses_of

CORNERS = ("abs", "sign", "min", "max", "where", "<", ">", "atan2")  # where a formula is not smooth


class RateOfOutput(OutputEntry):
    """How fast another output changes: its first derivative over time, or its second one."""

    type: Literal["rate"]
    reads = ("outputs",)
    of: str = Field(description="name of another output")
    order: Literal[1, 2] = Field(1, description="1 of its rate (a speed), 2 of that of its rate (an acceleration)")

    @property
    def made_of(self) -> Mapping[str, str]:
        return {self.of: "of"}

    @property
    def derivative(self) -> int:
        return self.order

    def unit_in(self, scene: Scene) -> str:
        unit = unit_of(scene, self.of)
        return per_second(per_second(unit)) if self.order == 2 else per_second(unit)

    def combined(self, name: str, parts: Mapping[str, AnyReading], scene: Scene) -> AnyReading:
        return Rate(parts[self.of], self.order)

    def expression(self, scene: Scene, seen: Callable[[str], Expression]) -> Expression:
        """Return the rate; accelerations are measured by none."""
        return RateOf(seen(self.of))


class FormulaOfOutputs(OutputEntry):
    """A formula of other outputs, of the time t and of parameters."""

    type: Literal["formula"]
    reads = ("outputs", "time", "parameters")
    formula: str = Field(description=f"formula of outputs and parameters by their names, and of the time t; {ALLOWED}")
    unit: str | None = Field(
        None, description="its unit, where that does not follow from those of what it names, or to have it checked"
    )

    def made_in(self, scene: Scene) -> Mapping[str, str]:
        used = self._named(scene)
        return dict.fromkeys((name for name in scene.outputs if name in used), "formula")

    def uses(self, scene: Scene, entry: str) -> Iterator[Use]:
        used = self._named(scene)
        yield from (Use(f"{entry}.formula.{name}", name) for name in scene.parameters if name in used)

    def _named(self, scene: Scene) -> set[str]:
        try:
            return self.in_declarations(scene)[1]
        except FormulaError:  # which `problems` says
            return set()

    def in_declarations(self, scene: Scene) -> tuple[str, set[str]]:
        names = {name: f"of_{name}" for name in (*scene.outputs, *scene.parameters) if name.isidentifier()}
        return declared(self.formula, names | {"t": TIME}, "the names of outputs and parameters, the time t")

    def in_si(self, scene: Scene) -> tuple[str, set[str]]:
        """Return the formula, which is in the units of the scene, of what it names in SI units."""
        text, used = self.in_declarations(scene)
        power_of, named = scene.system.power_of, {f"of_{one}": one for one in scene.parameters if one in used}
        powers = {f"of_{one}": power_of(unit_of(scene, one)) for one in self.made_in(scene)} | {TIME: 0}
        powers |= own_powers(scene, named)
        return in_si({"": text}, powers, {"": power_of(self.unit_in(scene))}).texts[""], used

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        """Yield a line if it is no formula, or its units do not fit."""
        entry = f"outputs.{name}.formula"
        try:
            _, used = self.in_declarations(scene)
        except FormulaError as error:
            yield problem(entry, str(error), self.formula)
            return
        if "t" in used and ("t" in scene.outputs or "t" in scene.parameters):
            yield problem(
                entry, "t is the time in a formula; give the output or parameter t another name", self.formula
            )
        try:
            found = self._measured(scene)
        except DimensionError as error:
            words = f"{error}; units must fit: a number that has a unit is a parameter with it"
            yield problem(entry, words, self.formula)
            return
        yield from self._of_unit(scene, f"outputs.{name}.unit", found)

    def _of_unit(self, scene: Scene, entry: str, found: Measured) -> Iterator[str]:
        given = self.unit
        if given is None:
            if found.dimension is None:
                named = [one for one in scene.parameters if one in self._named(scene)]
                unknown = [one for one in named if _of_parameter(scene, one).dimension is None]
                words = f"missing; that of {', '.join(unknown) or 'what the formula names'} is not known: give it"
                yield problem(entry, f"{words}, or parameters.{unknown[0]}.unit" if unknown else words)
            return
        try:
            factor, dimension = measure(given)
        except UnknownUnit as error:
            yield problem(entry, str(error), given)
            return
        if abs(factor - 1.0) > 1e-12 and abs(factor / scene.system.size(dimension) - 1.0) > 1e-12:
            words = f"outputs are in the units of the scene, here {scene.system.unit(si_name(dimension))}; take that"
            yield problem(entry, words, given)
        elif found.dimension is not None and found.value is None and found.dimension != dimension:
            words = f"the formula is in {found.text}; a number that has a unit is a parameter with it"
            yield problem(entry, words, given)

    def unit_in(self, scene: Scene) -> str:
        if self.unit is not None:
            return self.unit
        try:
            found = self._measured(scene)
        except (FormulaError, DimensionError):
            return "1"
        return found.unit or si_name(found.dimension or NUMBER.dimension)

    def _measured(self, scene: Scene) -> Measured:
        text, used = self.in_declarations(scene)
        names = {TIME: Measured((0.0, 0.0, 1.0), "s")}
        for name in used - {"t"}:
            is_output = name in scene.outputs
            names[f"of_{name}"] = _measured(unit_of(scene, name)) if is_output else _of_parameter(scene, name)
        return evaluated(text, names, Dimensions())

    def kinked_in(self, scene: Scene) -> bool:
        return any(mark in self.formula for mark in CORNERS) or super().kinked_in(scene)

    def combined(self, name: str, parts: Mapping[str, AnyReading], scene: Scene) -> AnyReading:
        text, used = self.in_si(scene)
        return Combined(
            text, {f"of_{one}": part for one, part in parts.items()},
            {f"of_{one}": one for one in scene.parameters if one in used}, "t" in used,
        )  # fmt: skip

    def expression(self, scene: Scene, seen: Callable[[str], Expression]) -> Expression:
        text, used = self.in_si(scene)
        parts = tuple((f"of_{one}", seen(one)) for one in self.made_in(scene))
        return FormulaOf(text, parts, tuple(one for one in scene.parameters if one in used))


def _of_parameter(scene: Scene, name: str) -> Measured:
    """Return what a parameter is measured in: what it says, or what the entries that name it take."""
    if scene.parameters[name].unit:
        return Measured(_measured(scene.parameters[name].unit).dimension)
    units = {use.units for use in uses_of(scene) if use.parameter == name and use.units}
    only = next(iter(units)) if len(units) == 1 else ()
    return _measured(only[0] if len(only) == 1 else "")


def _measured(unit: str) -> Measured:
    if not unit:
        return Measured()
    try:
        return Measured(tuple(float(power) for power in measure(unit)[1]), unit)
    except UnknownUnit:
        return Measured()


@dataclass(frozen=True, eq=False)
class Combined:
    """A formula of readings."""

    text: str  # in the language of declarations
    #: parts, constants: readings, and names of parameters, by what they are there
    parts: Mapping[str, AnyReading]
    constants: Mapping[str, str]
    reads_time: bool = False

    def __post_init__(self) -> None:
        check("Combined", self.text, (*self.parts, *self.constants, TIME), called_at())
        one = SeriesAlgebra(0).number(1.0)
        with np.errstate(all="ignore"):
            evaluated(self.text, dict.fromkeys((*self.parts, *self.constants, TIME), one), SeriesAlgebra(0))

    @property
    def needs(self) -> Needs:
        own = Needs(parameters=frozenset(self.constants.values()), time=self.reads_time)
        return reduce(or_, (part.needs for part in self.parts.values()), own)

    def depth(self, order: int) -> int:
        return max((part.depth(order) for part in self.parts.values()), default=0)

    def jet(self, seen: Seen, order: int) -> Jet:
        n = seen.n_seen
        zero, one = np.zeros(n), np.ones(n)
        jets = {name: jet_of(part, seen, order) for name, part in self.parts.items()}
        jets |= {name: [seen.values[parameter] * one, zero, zero] for name, parameter in self.constants.items()}
        jets[TIME] = [seen.time if self.reads_time else zero, one, zero]
        return [np.broadcast_to(part, n) for part in self._of(jets, order)]

    def change(
        self, parameter: str, outputs: Mapping[str, np.ndarray], changes: Mapping[str, np.ndarray], time: np.ndarray,
        values: Mapping[str, float],
    ) -> np.ndarray:  # fmt: skip
        """Return its derivative with a parameter by the chain rule, (n,), for outputs and their derivatives with it."""
        zero = np.zeros_like(time)
        jets = {name: [of[name.removeprefix("of_")] for of in (outputs, changes)] for name in self.parts}
        jets |= {name: [values[one] + zero, zero + (one == parameter)] for name, one in self.constants.items()}
        return self._of(jets | {TIME: [time, zero]}, 1)[1] + zero

    def _of(self, jets: Mapping[str, Jet], order: int) -> Jet:
        names = {name: Series(jet[: order + 1]) for name, jet in jets.items()}
        with np.errstate(all="ignore"):  # what is no finite number is found where outputs are looked at
            return evaluated(self.text, names, SeriesAlgebra(order)).parts
