"""Rules that say when an ensemble has samples enough: the text behind ``--until``, read and checked.

    rule    = figure precision
    figure  = ("mean" | "std") "(" quantity ")"  |  "P" "(" label ")"  |  "P" "(" quantity ("<" | ">") number ")"
    precision = "<" number "%"  |  ("+-" | "±") number ["%"]

A quantity is an output, or ``<output>.max`` and ``<output>.min`` where the scene asks for extremes; a label is that of
an event of ``ensemble.probabilities``. The precision is half the width of the figure's confidence interval: a share of
the figure, or in its own unit.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from pgmp_petsc.results.ensemble import DESCRIBED
from pgmp_petsc.runtime.errors import InputError, nearest_name
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.ensemble import Event
from pgmp_petsc.scene.fields import LARGEST, SMALLEST

OPTION = "--until"
EXAMPLES = "'std(angle) < 1 %', 'mean(angle) +- 1e-4' or 'P(deformation < -1.5e-4) +- 0.002'"
MOMENTS = ("mean", "std")
TOKEN = re.compile(
    r"\s*(?:(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?![\w.])|(?P<name>[A-Za-z_][\w.-]*)"
    r"|(?P<sign>\+-|±|[()<>%]))"
)


@dataclass(frozen=True)
class Rule:
    """When a figure is known well enough.

    Attributes
    ----------
    text
        As it was given.
    kind
        ``mean``, ``std`` or ``P``.
    quantity
        Of a moment: name of the quantity. Of a probability: label of a scene's event, or empty.
    event
        Of a probability of the end of the run that the rule itself gives.
    wanted
        Half the width of the interval at most.
    relative
        Whether it is a share of the figure.
    """

    text: str
    kind: str
    quantity: str
    event: Event | None
    wanted: float
    relative: bool

    @property
    def precision(self) -> str:
        """The precision in words: ``1 %``, or ``0.002``."""
        return f"{100 * self.wanted:g} %" if self.relative else f"{self.wanted:g}"


def read_rule(text: str, scene: Scene) -> Rule:
    """Read a rule.

    Raises
    ------
    InputError
        If it is none, with the place marked, or names what the scene does not have.
    """
    return _Reader(text, scene).rule()


class _Reader:
    """Takes a rule apart, from left to right."""

    def __init__(self, text: str, scene: Scene) -> None:
        self._text, self._scene, self._place = text, scene, 0

    def rule(self) -> Rule:
        kind = self._name("mean, std or P", (*MOMENTS, "P"))
        self._sign("(")
        quantity, event = self._quantity() if kind in MOMENTS else "", None
        if kind == "P":
            quantity, event = self._event()
        self._sign(")")
        relative = self._sign("<", "+-", "±") == "<"
        place = self._place
        wanted = self._number()
        if not wanted > 0.0:
            self._refuse("a positive precision", place)
        if relative:
            self._sign("%")
        elif self._text[self._place :].strip() == "%":
            self._sign("%")
            relative = True
        if self._text[self._place :].strip():
            self._refuse("the end")
        return Rule(self._text, kind, quantity, event, 0.01 * wanted if relative else wanted, relative)

    def _quantity(self) -> str:
        known = list(self._scene.outputs)
        if self._scene.ensemble.extremes:
            known += [f"{name}.{which}" for name in self._scene.outputs for which in DESCRIBED]
        return self._name("the name of an output", known)

    def _event(self) -> tuple[str, Event | None]:
        """Read a label, or an output beyond a level."""
        labels = self._scene.ensemble.probabilities
        name = self._name("an output or a label of ensemble.probabilities", [*self._scene.outputs, *labels])
        if name in labels:
            return name, None
        side = "above" if self._sign("<", ">") == ">" else "below"
        return "", Event(output=name, **{side: self._number()})

    def _name(self, expected: str, known: list[str] | tuple[str, ...]) -> str:
        place = self._place
        name = self._take("name")
        if name is None:
            self._refuse(expected)
        if name not in known:
            self._refuse(f"{expected}{nearest_name(name, known)}", place)
        return name

    def _number(self) -> float:
        place, number = self._place, self._take("number")
        if number is None:
            self._refuse("a number")
        if float(number) and not SMALLEST <= abs(float(number)) <= LARGEST:
            self._refuse(f"0 or a magnitude from {SMALLEST:g} to {LARGEST:g}", place)
        return float(number)

    def _sign(self, *allowed: str) -> str:
        place = self._place
        sign = self._take("sign")
        if sign not in allowed:
            self._refuse(" or ".join(f"'{one}'" for one in allowed if one != "±"), place)
        return sign

    def _take(self, kind: str) -> str | None:
        """Return the next word where it is of a kind, and go on behind it."""
        found = TOKEN.match(self._text, self._place)
        if found is None or found[kind] is None:
            return None
        self._place = found.end()
        return found[kind]

    def _refuse(self, expected: str, place: int | None = None) -> None:
        """Raise an error that marks a place, by default the present one."""
        place = self._place if place is None else place
        place += len(self._text[place:]) - len(self._text[place:].lstrip())
        raise InputError(
            f'{OPTION} "{self._text}": expected at character {place + 1}: {expected}; rules are such as {EXAMPLES}\n'
            f"  {self._text}\n  {' ' * place}^"
        )
