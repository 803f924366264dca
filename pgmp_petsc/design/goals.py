"""Goals and constraints of a design, as users write them, with their derivatives.

    goal        = ("minimise" | "maximise") sum              ("minimize", "maximize" as well)
    constraint  = sum ("<=" | ">=") sum
    figure      = ("max" | "min" | "mean" | "rms" | "start" | "end") "(" history ")"
    history     = output | "abs" "(" output ")"

A sum is a formula (:mod:`~pgmp_petsc.declare.formulas`) of numbers, parameters and figures, in which ``^`` is ``**``
too.

A figure is that of an output over a run: its largest and smallest value, by parabolas through the ends of steps
(`results/gradients.py`: no jump of the slope where another end of a step comes to be nearest), the mean and the root of
the mean square over time (trapezoids), and its values at time zero and at the end. Numbers are in the scene's units;
searches are in SI units (:mod:`~pgmp_petsc.declare.formulas`), so that the design is the same to the last digit in
whichever units the scene is written.

A search turns back from places on its way whose runs stop before their end, and says so.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import reduce
from itertools import accumulate
from operator import add
from types import MappingProxyType
from typing import NamedTuple, NoReturn

import numpy as np

from pgmp_petsc.base.errors import InputError, PgmpError, Remark, gathered, nearest_name, warning
from pgmp_petsc.base.units import SI, Units, UnitSystem, dimension_of, si_name
from pgmp_petsc.declare import formulas
from pgmp_petsc.declare.formulas import in_si, shifted
from pgmp_petsc.gradients.differentiated import DifferentiatedRun
from pgmp_petsc.results.gradients import Vertex, vertex

SENSES = {"minimise": 1.0, "minimize": 1.0, "maximise": -1.0, "maximize": -1.0}
WORDS = "parameters, figures of outputs (max, min, mean, rms, start and end of OUTPUT or of abs(OUTPUT))"


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
        parts = {name: formulas.Series([np.array(one) for one in part(outcome)]) for name, part in self.parts.items()}
        with np.errstate(all="ignore"):  # what has no value, such as 1 / 0, is refused by whoever evaluates
            value, slope = formulas.evaluated(self.text, parts, formulas.SeriesAlgebra(1)).parts
        return Dual(float(value), np.broadcast_to(slope, len(outcome.names)))


#: Makes a figure of times, values and their derivatives.
Figure = Callable[[np.ndarray, np.ndarray, np.ndarray], Dual]


def _at(place: Callable[[np.ndarray], Vertex]) -> Figure:
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
_NAME = "[A-Za-z_][A-Za-z0-9_-]*"
_TOKEN = re.compile(
    rf"(?P<figure>{'|'.join(FIGURES)})\s*\(\s*(?P<abs>abs\s*\(\s*)?(?P<output>{_NAME})\s*\)(?(abs)\s*\))"
    rf"|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>{_NAME})|(?P<relation>[<>]=?)|(?P<sign>\*\*|[-+*/^(),])|\S"
)


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
_NO_UNITS: Units = MappingProxyType({})


def read_goal(
    text: str, outputs: Collection[str], parameters: Collection[str], units: Units = _NO_UNITS, system: UnitSystem = SI
) -> Goal:
    """Read a goal in the units of a system; raises `InputError` with the position marked."""
    reader = _Reader("goal", text, outputs, parameters, units, system)
    word = re.match(r"\s*(\w*)", text)
    if word[1] not in SENSES:
        reader.refuse("a goal begins with minimise or maximise", word.start(1))
    (tokens, *_), relations = reader.sums(word.end())
    for relation in relations:
        reader.refuse(f"'{relation[0]}' is too much; an operator or the end is needed", relation.start())
    read = reader.expression(tokens, len(text))
    found = in_si({"goal": read.text}, reader.powers)
    size = shifted(1.0, found.of_texts["goal"])
    return Goal(text, SENSES[word[1]], replace(read, text=found.texts["goal"]), size, reader.unit_of(read))


def read_constraint(
    text: str, outputs: Collection[str], parameters: Collection[str], units: Units = _NO_UNITS, system: UnitSystem = SI
) -> Constraint:
    """Read a constraint; as `read_goal`."""
    reader = _Reader("--subject-to", text, outputs, parameters, units, system)
    sums, relations = reader.sums()
    signs = [relation[0] for relation in relations]
    if signs not in (["<="], [">="]):
        reader.refuse("<= or >= is needed, once", relations[-1].start() if relations else len(text))
    left, right = map(reader.expression, sums, (relations[0].start(), len(text)))
    found = in_si({"left": left.text, "right": right.text}, reader.powers, {"left": "both", "right": "both"})
    sides = replace(left, text=found.texts["left"]), replace(right, text=found.texts["right"])
    size = shifted(1.0, found.powers.get("both", 0))
    return Constraint(text, 1.0 if signs == ["<="] else -1.0, *sides, size, reader.unit_of(left, right))


class _Reader:
    """Reads the sums of one text, and writes them in the language of declarations."""

    def __init__(
        self, entry: str, text: str, outputs: Collection[str], parameters: Collection[str], units: Units,
        system: UnitSystem,
    ) -> None:  # fmt: skip
        if len(text) > formulas.LONGEST:  # as of formulas: no line could mark a position
            raise InputError(
                f"{entry}: {len(text)} characters; at most {formulas.LONGEST} are read. Use parameters for numbers"
            )
        self._given, self._system = units, system
        self._units: dict[str, str] = {}  # SI units of what sums name
        self._entry, self._text, self._outputs, self._parameters = entry, text, outputs, parameters

    def refuse(self, reason: str, place: int) -> NoReturn:
        """Raise an error with a position marked."""
        raise InputError(f"{self._entry}: {reason}\n  {self._text}\n  {' ' * place}^")

    @property
    def powers(self) -> dict[str, int | None]:
        """By which powers of ten what sums name is larger in the units of the scene; None of what is of any unit."""
        return {name: self._system.power_of(unit) if unit else None for name, unit in self._units.items()}

    def unit_of(self, *sums: Expression) -> str:
        """Return the unit of sums that are added or compared; 1 where they do not fit, or it is not known."""
        names = {
            name: formulas.Measured(dimension_of(unit), unit) if unit else formulas.Measured()
            for name, unit in self._units.items()
        }
        with suppress(formulas.DimensionError):
            found = reduce(add, (formulas.evaluated(one.text, names, formulas.Dimensions()) for one in sums))
            if found.dimension is not None:
                return self._system.unit(found.unit or si_name(found.dimension))
        return "1"

    def sums(self, begin: int = 0) -> tuple[list[list[re.Match[str]]], list[re.Match[str]]]:
        """Return the tokens of the sums from a character on, and the relations between them."""
        sums, relations, depth = [[]], [], 0
        for token in _TOKEN.finditer(self._text, begin):
            depth += (token[0] == "(") - (token[0] == ")")
            if token["relation"] and depth == 0:
                relations.append(token)
                sums.append([])
            else:
                sums[-1].append(token)
        return sums, relations

    def expression(self, tokens: Sequence[re.Match[str]], end: int) -> Expression:
        """Return a sum that ends before a character, its text in the units of the scene."""
        if not tokens:
            self.refuse(f"a sum is missing there, of numbers, {WORDS}", end)
        parts: dict[str, Callable[[Outcome], Dual]] = {}
        written = [self._written(token, parts) for token in tokens]
        try:
            text, _ = formulas.declared(" ".join(written), {name: name for name in parts}, WORDS)
        except formulas.FormulaError as error:
            begins = [*accumulate((len(one) + 1 for one in written), initial=0)]
            places = [*(token.start() for token in tokens), tokens[-1].end()]
            self.refuse(f"it {error}", places[bisect_right(begins, error.at) - 1])
        return Expression(text, parts, frozenset(token["output"] for token in tokens if token["output"]))

    def _written(self, token: re.Match[str], parts: dict[str, Callable[[Outcome], Dual]]) -> str:
        """Return a token in the language of formulas; add what it names to the parts."""
        text, name, output = token[0], token["name"], token["output"]
        if token["number"]:
            if not np.isfinite(float(text)):
                self.refuse(f"{text} is no finite number", token.start())
            return repr(float(text))
        if output:
            if output not in self._outputs:
                self.refuse(f"there is no such output{nearest_name(output, self._outputs)}", token.start("output"))
            return self._part(parts, output, _figure_of(output, FIGURES[token["figure"]], bool(token["abs"])))
        is_called = name in formulas.FUNCTIONS and re.match(r"\s*\(", self._text[token.end() :])
        if token["sign"] or token["relation"] or is_called:
            return "**" if text == "^" else text
        if not name:
            self.refuse(f"'{text}' has no place in a formula", token.start())
        if name in self._outputs:
            needed = f"take a figure of it, such as max({name}) or end({name})"
            self.refuse(f"{name} is an output over time; {needed}", token.start())
        if name in FIGURES and name not in self._parameters:
            needed = f"{name}(OUTPUT) or {name}(abs(OUTPUT)); of more declare an output of type formula"
            self.refuse(f"{name} is a figure of one output or of its abs: {needed}", token.start())
        if name not in self._parameters:
            hint = nearest_name(name, dict.fromkeys((*self._parameters, *FIGURES, *formulas.FUNCTIONS)))
            apart = "; for a difference leave spaces around -, which names may have in them" if "-" in name else ""
            self.refuse(f"there is no parameter, figure or function '{name}'{apart}{hint}", token.start())
        return self._part(
            parts, f"parameters.{name}",
            lambda outcome: Dual(outcome.values[name], np.array([float(name == one) for one in outcome.names])),
        )  # fmt: skip

    def _part(self, parts: dict[str, Callable[[Outcome], Dual]], name: str, part: Callable[[Outcome], Dual]) -> str:
        """Return what a sum calls what it names."""
        own = f"part_{len(self._units)}"
        parts[own], self._units[own] = part, self._given.get(name, "1")
        return own


def _figure_of(output: str, figure: Figure, absolute: bool) -> Callable[[Outcome], Dual]:
    def of(outcome: Outcome) -> Dual:
        values, slopes = outcome.run.outputs[output], outcome.slopes(output)
        if absolute:
            values, slopes = np.abs(values), np.sign(values) * slopes
        return figure(outcome.run.time, values, slopes)

    return of


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
