"""What controllers measure, as expressions of motions and their rates, of which laws have exact slopes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from pgmp_petsc.declare.expressions import called_at, check, symbolic

TIME = "time"  # what t is called in a declared formula
Motions = Sequence[tuple[Any, Any]]  # sympy's symbols of every motion that a controller measures, and of its rate


class Expression(Protocol):
    """A measure of a controller, made of motions; its law prints it."""

    parameters: tuple[str, ...]  # of the scene, that it names

    def symbolic(self, motions: Motions, names: Mapping[str, Any]) -> Any:
        """Return it in sympy's form; `names` has the time t, and parameters as of `in_law`."""


def in_law(parameter: str) -> str:
    """Return what a parameter of the scene is called in the law of a controller."""
    return f"seen_{parameter}"


@dataclass(frozen=True)
class OfMotion:
    """A motion by its number, or its rate."""

    number: int
    derivative: int = 0
    parameters: tuple[str, ...] = ()

    def symbolic(self, motions: Motions, names: Mapping[str, Any]) -> Any:
        return motions[self.number][self.derivative]


@dataclass(frozen=True)
class RateOf:
    """How fast something changes."""

    of: Expression

    @property
    def parameters(self) -> tuple[str, ...]:
        return self.of.parameters

    def symbolic(self, motions: Motions, names: Mapping[str, Any]) -> Any:
        return rate_of(self.of.symbolic(motions, names), motions, names["t"])


@dataclass(frozen=True)
class FormulaOf:
    """A formula in the language of declarations, of expressions by their names there, and parameters of its own."""

    text: str
    parts: tuple[tuple[str, Expression], ...]
    own: tuple[str, ...]  # names of parameters, which are called ``of_NAME`` in the formula

    def __post_init__(self) -> None:
        names = (*(name for name, _ in self.parts), *(f"of_{one}" for one in self.own), TIME)
        check("FormulaOf", self.text, names, called_at())

    @property
    def parameters(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(one for part in (self.own, *(p.parameters for _, p in self.parts)) for one in part))

    def symbolic(self, motions: Motions, names: Mapping[str, Any]) -> Any:
        parts = {name: part.symbolic(motions, names) for name, part in self.parts}
        constants = {f"of_{one}": names[in_law(one)] for one in self.own}
        return symbolic(self.text, {TIME: names["t"], **constants, **parts})


def rate_of(seen: Any, motions: Motions, t: Any) -> Any:
    """Return the rate of an expression of motions and t; of one of rates, which nobody asks for, what is known."""
    import sympy as sp

    return sp.diff(seen, t) + sum((sp.diff(seen, s) * v for s, v in motions), sp.Integer(0))
