"""Goals and constraints of a design, as users write them, with their derivatives.

    goal        = ("minimise" | "maximise") sum              ("minimize", "maximize" as well)
    constraint  = sum ("<=" | ">=") sum
    sum         = product {("+" | "-") product}
    product     = power {("*" | "/") power}
    power       = ["-"] factor ["^" number]
    factor      = number | parameter | figure | "(" sum ")"
    figure      = ("max" | "min" | "mean" | "rms" | "start" | "end") "(" history ")"
    history     = output | "abs" "(" output ")"

A figure is that of an output over a run: its largest and smallest value, by parabolas through the ends of steps
(`results/gradients.py`: no jump of the slope where another end of a step comes to be nearest), the mean and the root of
the mean square over time (trapezoids), and its values at time zero and at the end. Numbers are in the scene's units;
searches are in SI units (:mod:`~pgmp_petsc.declare.own_units`), so that the design is the same to the last digit in
whichever units the scene is written.

A search turns back from places on its way whose runs stop before their end, and says so.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import reduce
from operator import add
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from pgmp_petsc.base.errors import InputError, PgmpError, Remark, gathered, nearest_name, warning
from pgmp_petsc.base.units import SI, UnitSystem, dimension_of, si_name
from pgmp_petsc.declare.formulas import DimensionError, Dimensions, Measured, Series, SeriesAlgebra, evaluated
from pgmp_petsc.declare.own_units import in_si, shifted
from pgmp_petsc.gradients.differentiated import DifferentiatedRun
from pgmp_petsc.results.gradients import Vertex, vertex

_TOKEN = re.compile(r"\s*(?:(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|([A-Za-z_][A-Za-z0-9_-]*)|(<=|>=|.))")
SENSES = {"minimise": 1.0, "minimize": 1.0, "maximise": -1.0, "maximize": -1.0}

LONGEST, DEEPEST = 800, 30  # of texts: characters, and parentheses in each other


class Dual(NamedTuple):
    """A number and its derivatives with the parameters, shape (n_parameters,); inf or nan where there is none."""

    value: float
    slope: np.ndarray


@dataclass(frozen=True, eq=False)
class Outcome:
    """Source of an expression's value: a run and the values of the parameters that it is differentiated with."""

    run: DifferentiatedRun
    values: Mapping[str, float]
    names: tuple[str, ...]

    def slopes(self, output: str) -> np.ndarray:
        """Return the derivatives of an output, shape (n_parameters, n_t)."""
        rows = [self.run.derivatives[output][name] for name in self.names]
        return np.array(rows).reshape(len(rows), self.run.time.size)


@dataclass(frozen=True, eq=False)
class Expression:
    """A sum of a goal or a constraint, in SI units."""

    text: str  # in the language of declarations
    parts: Mapping[str, Callable[[Outcome], Dual]]  # what it names: figures and parameters
    outputs: frozenset[str]  # of which these figures are

    def __call__(self, outcome: Outcome) -> Dual:
        parts = {name: Series([np.array(one) for one in part(outcome)]) for name, part in self.parts.items()}
        with np.errstate(all="ignore"):  # what has no value, such as 1 / 0, is refused by whoever evaluates
            value, slope = evaluated(self.text, parts, SeriesAlgebra(1)).parts
        return Dual(float(value), np.broadcast_to(slope, len(outcome.names)))


def _at(place: Callable[[np.ndarray], Vertex]) -> Callable[[np.ndarray, np.ndarray, np.ndarray], Dual]:
    def figure(time: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> Dual:
        at = place(values)
        return Dual(float(at.of(values)), at.of(slopes))

    return figure


def _mean(time: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> Dual:
    weights = np.gradient(time)  # of trapezoids, but at the ends
    weights[[0, -1]] *= 0.5
    weights /= weights.sum()
    return Dual(float(values @ weights), slopes @ weights)


def _rms(time: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> Dual:
    square = _mean(time, values**2, 2.0 * values * slopes)
    root = np.sqrt(square.value)
    return Dual(float(root), square.slope / (2.0 * root) if root > 0.0 else np.zeros_like(square.slope))


FIGURES = {
    "max": _at(lambda values: vertex(values, 1.0)),
    "min": _at(lambda values: vertex(values, -1.0)),
    "mean": _mean,
    "rms": _rms,
    "start": _at(lambda values: Vertex(0, 0.0)),
    "end": _at(lambda values: Vertex(-1, 0.0)),
}


@dataclass(frozen=True, eq=False)
class Goal:
    """A goal: what is made as small as it becomes is ``sense`` times the expression."""

    text: str  # as it was written
    sense: float  # 1, or -1 of what is maximised
    expression: Expression
    size: float  # times which it is in the units of the scene
    unit: str  # among these; 1 where it is not known


@dataclass(frozen=True, eq=False)
class Constraint:
    """A constraint: ``sense (left - right) <= 0``."""

    text: str  # as it was written
    sense: float  # 1 of ``<=``, -1 of ``>=``
    left: Expression
    right: Expression
    size: float  # times which both sides are in the units of the scene
    unit: str  # among these; 1 where it is not known


#: SI units of outputs, and of parameters behind ``parameters.``; empty of those of any unit, 1 where none is given.
Units = Mapping[str, str]
_NO_UNITS: Units = MappingProxyType({})


def read_goal(
    text: str, outputs: Collection[str], parameters: Collection[str], units: Units = _NO_UNITS, system: UnitSystem = SI
) -> Goal:
    """Read a goal in the units of a system; raises `InputError` with the position marked."""
    parser = _Parser("goal", text, outputs, parameters, units, system)
    word = parser.token
    if word not in SENSES:
        parser.refuse("a goal begins with minimise or maximise")
    parser.advance()
    read, parts, of = parser.expression()
    parser.end()
    found = in_si({"goal": read}, parser.powers)
    size = shifted(1.0, found.of_texts["goal"])
    return Goal(text, SENSES[word], Expression(found.texts["goal"], parts, of), size, parser.unit_of(read))


def read_constraint(
    text: str, outputs: Collection[str], parameters: Collection[str], units: Units = _NO_UNITS, system: UnitSystem = SI
) -> Constraint:
    """Read a constraint; as `read_goal`."""
    parser = _Parser("--subject-to", text, outputs, parameters, units, system)
    left, *of_left = parser.expression()
    relation = parser.token
    if relation not in ("<=", ">="):
        parser.refuse("<= or >= is needed")
    parser.advance()
    right, *of_right = parser.expression()
    parser.end()
    found = in_si({"left": left, "right": right}, parser.powers, {"left": "both", "right": "both"})
    sides = Expression(found.texts["left"], *of_left), Expression(found.texts["right"], *of_right)
    size = shifted(1.0, found.powers.get("both", 0))
    return Constraint(text, 1.0 if relation == "<=" else -1.0, *sides, size, parser.unit_of(left, right))


class _Parser:
    """Reads one text, token by token, and writes its sums in the language of declarations."""

    def __init__(
        self, entry: str, text: str, outputs: Collection[str], parameters: Collection[str], units: Units,
        system: UnitSystem,
    ) -> None:  # fmt: skip
        self._given, self._system = units, system
        self._units: dict[str, str] = {}  # SI units of what sums name
        self._written: list[str] = []
        self._parts: dict[str, Callable[[Outcome], Dual]] = {}
        self._entry, self._text, self._outputs, self._parameters = entry, text, outputs, parameters
        self._end = self._depth = 0
        if len(text) > LONGEST:
            raise InputError(f"{entry}: {len(text)} characters; at most {LONGEST} are read. Use parameters for numbers")
        self.advance()

    def advance(self) -> None:
        """Go to the next token; an empty one is the end."""
        found = _TOKEN.match(self._text, self._end)
        if found is None:
            self._begin = self._end = len(self._text)
            self.token, self._kind = "", "end"
            return
        place = next(k for k in (1, 2, 3) if found[k] is not None)
        self.token, self._kind = found[place], ("", "number", "name", "sign")[place]
        self._begin, self._end = found.start(place), found.end(place)

    def refuse(self, reason: str) -> None:
        """Raise an error with the position of this token marked."""
        raise InputError(f"{self._entry}: {reason}\n  {self._text}\n  {' ' * self._begin}^")

    def end(self) -> None:
        if self.token:
            self.refuse(f"'{self.token}' is too much; an operator or the end is needed")

    @property
    def powers(self) -> dict[str, int | None]:
        """By which powers of ten what sums name is larger in the units of the scene; None of what is of any unit."""
        return {name: self._system.power_of(unit) if unit else None for name, unit in self._units.items()}

    def unit_of(self, *sums: str) -> str:
        """Return the unit of sums that are added or compared; 1 where they do not fit, or it is not known."""
        names = {name: Measured(dimension_of(unit), unit) if unit else Measured() for name, unit in self._units.items()}
        with suppress(DimensionError):
            found = reduce(add, (evaluated(text, names, Dimensions()) for text in sums))
            if found.dimension is not None:
                return self._system.unit(found.unit or si_name(found.dimension))
        return "1"

    def expression(self) -> tuple[str, Mapping[str, Callable[[Outcome], Dual]], frozenset[str]]:
        """Read a sum; return it as it is written anew, what it names, and the outputs among that."""
        self._written, self._parts, self._named = [], {}, set()
        self._sum()
        return " ".join(self._written), self._parts, frozenset(self._named)

    def _sum(self) -> None:
        self._with_signs("+-", lambda: self._with_signs("*/", self._power))

    def _with_signs(self, signs: str, part: Callable[[], None]) -> None:
        """Read parts with signs between them."""
        part()
        while self.token and self.token in signs:
            self._written.append(self.token)
            self.advance()
            part()

    def _power(self) -> None:
        is_negative = False
        while self.token == "-":
            is_negative = not is_negative
            self.advance()
        if is_negative:
            self._written.append("-")
        self._factor()
        if self.token != "^":
            return
        self.advance()
        sign = -1.0 if self.token == "-" else 1.0
        if sign < 0.0:
            self.advance()
        if self._kind != "number":
            self.refuse("a number is needed as exponent")
        self._written.append(f"** ({sign * self._value()!r})")

    def _value(self) -> float:
        value = float(self.token)
        if not np.isfinite(value):
            self.refuse(f"{self.token} is no finite number")
        self.advance()
        return value

    def _factor(self) -> None:
        if self._kind == "number":
            self._written.append(repr(self._value()))
            return
        if self.token == "(":
            self._depth += 1
            if self._depth > DEEPEST:
                self.refuse(f"at most {DEEPEST} parentheses are in each other")
            self._written.append("(")
            self.advance()
            self._sum()
            self._depth -= 1
            self._expect(")")
            self._written.append(")")
            return
        if self._kind != "name":
            self.refuse("a number, a parameter, a figure such as max(...) or ( is needed")
        name = self.token
        if name in FIGURES and self._text[self._end :].lstrip().startswith("("):
            self.advance()
            self._figure(FIGURES[name])
            return
        if name in self._outputs:
            self.refuse(f"{name} is an output over time; take a figure of it, such as max({name}) or end({name})")
        if name not in self._parameters:
            self.refuse(f"there is no such parameter or figure{nearest_name(name, [*self._parameters, *FIGURES])}")
        self.advance()
        self._part(
            f"parameters.{name}",
            lambda outcome: Dual(outcome.values[name], np.array([float(name == one) for one in outcome.names])),
        )

    def _figure(self, figure: Callable[[np.ndarray, np.ndarray, np.ndarray], Dual]) -> None:
        self._expect("(")
        absolute = self.token == "abs"
        if absolute:
            self.advance()
            self._expect("(")
        output = self.token
        if output not in self._outputs:
            self.refuse(f"there is no such output{nearest_name(output, self._outputs)}")
        self._named.add(output)
        self.advance()
        self._expect(")")
        if absolute:
            self._expect(")")

        def of(outcome: Outcome) -> Dual:
            values, slopes = outcome.run.outputs[output], outcome.slopes(output)
            if absolute:
                values, slopes = np.abs(values), np.sign(values) * slopes
            return figure(outcome.run.time, values, slopes)

        self._part(output, of)

    def _part(self, name: str, part: Callable[[Outcome], Dual]) -> None:
        """Write what an expression names."""
        own = f"part_{len(self._units)}"
        self._parts[own], self._units[own] = part, self._given.get(name, "1")
        self._written.append(own)

    def _expect(self, sign: str) -> None:
        if self.token != sign:
            self.refuse(f"{sign} is needed")
        self.advance()


@dataclass
class TurnedBack:
    """Places from which a search turned back."""

    count: int = 0  # how often
    first: str = ""  # the first place and the reason, in words

    def add(self, error: PgmpError) -> None:
        self.count, self.first = self.count + 1, self.first or str(error)

    @property
    @gathered
    def remarks(self) -> Iterator[Remark]:
        """Remarks for the reader of a result."""
        if not self.count:
            return
        often = "once" if self.count == 1 else f"{self.count} times"
        yield warning(
            f"the search turned back {often} from where no run comes to its end, first {self.first}; what lies "
            "beyond was not searched, and what was found may stand at its edge: begin there (--set), or let bounds "
            "leave such places out"
        )
