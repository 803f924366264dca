"""What a controller measures, as an expression of motions s_i of the mechanics, their rates v_i, time and parameters.

A motion is what an output of its own reads: an angle, a way, a distance, a place. Outputs of outputs, `rate` and
`formula`, are expressions of these, so that slopes and rates of what they are follow by the chain rule.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from pgmp_petsc.declare.expressions import symbolic
from pgmp_petsc.outputs.of_outputs import TIME, FormulaOfOutputs, RateOfOutput
from pgmp_petsc.scene import Scene

Motions = Sequence[tuple[Any, Any]]  # sympy's symbols of every motion and of its rate


class Seen(Protocol):
    """What is measured."""

    def symbolic(self, motions: Motions, names: Mapping[str, Any]) -> Any:
        """Return it in sympy's form; `names` has the time t and parameters."""


@dataclass(frozen=True)
class OfMotion:
    """A motion by its number, or its rate."""

    number: int
    derivative: int = 0

    def symbolic(self, motions: Motions, names: Mapping[str, Any]) -> Any:
        """Return its symbol."""
        return motions[self.number][self.derivative]


@dataclass(frozen=True)
class RateOf:
    """How fast something changes."""

    of: Seen

    def symbolic(self, motions: Motions, names: Mapping[str, Any]) -> Any:
        """Return the rate."""
        return rate_of(self.of.symbolic(motions, names), motions, names["t"])


@dataclass(frozen=True)
class Formula:
    """A formula in the language of declarations, of what is seen and of parameters by their names there."""

    text: str
    parts: tuple[tuple[str, Seen], ...]
    constants: tuple[tuple[str, str], ...]  # what parameters are called there, and in the law

    def symbolic(self, motions: Motions, names: Mapping[str, Any]) -> Any:
        """Return the formula."""
        own = {name: part.symbolic(motions, names) for name, part in self.parts}
        return symbolic(self.text, {TIME: names["t"], **{name: names[law] for name, law in self.constants}, **own})


def rate_of(seen: Any, motions: Motions, t: Any) -> Any:
    """Return the rate of an expression of motions and t; of one of rates, which nobody asks for, what is known."""
    import sympy as sp

    return sp.diff(seen, t) + sum((sp.diff(seen, s) * v for s, v in motions), sp.Integer(0))


@dataclass(frozen=True)
class Measured:
    """What the measures of a controller are made of."""

    #: names of the outputs whose motions these are, in their order
    motions: tuple[str, ...]
    seen: tuple[tuple[str, Seen], ...]  # what is measured, by its name in the law
    constants: Mapping[str, str]  # parameters of the scene, by what they are called in the law

    @classmethod
    def of(cls, scene: Scene, outputs: Mapping[str, str]) -> Measured:
        """Return what outputs are made of, given by their names in the law."""
        motions: dict[str, int] = {}
        constants: dict[str, str] = {}

        def seen(name: str) -> Seen:
            entry = scene.outputs[name]
            if isinstance(entry, RateOfOutput):
                return RateOf(seen(entry.of))
            if isinstance(entry, FormulaOfOutputs):
                text, used = entry.in_si(scene)
                named = [one for one in scene.parameters if one in used]
                constants.update({f"seen_{one}": one for one in named})
                parts = tuple((f"of_{one}", seen(one)) for one in entry.made_in(scene))
                return Formula(text, parts, tuple((f"of_{one}", f"seen_{one}") for one in named))
            return OfMotion(motions.setdefault(name, len(motions)), entry.derivative)

        found = tuple((name, seen(output)) for name, output in outputs.items())
        return cls(tuple(motions), found, constants)
