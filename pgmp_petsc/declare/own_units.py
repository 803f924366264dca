"""Formulas that are written in the units of a scene, written anew for SI units.

What a formula names is ``10^n`` times larger in the units of the scene than in SI units: in mm, t and s a length is
1000 times larger, and a force as large. Of what is named n is known, but not of the numbers in a formula, such as the
500 of ``-3 * (s - 500)``, which are of any unit: theirs follow from what is added, compared and asked for, as types
follow in a program (Kennedy, Types for units-of-measure, 2010). Here s is a length and so is 500, and the 3 is a
stiffness, for the whole to be a force: in SI units it is ``-3000 * (s - 0.5)``, bit for bit what one would write.

Every n is an unknown of linear equations: those of factors are added up, those of summands are equal. Unknowns that are
left over are zero, and there is one more between the two sides of every sum, which is other than zero only where a
formula adds what does not fit, such as ``t + s``: the factor that makes it what it is in the units of the scene.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from types import MappingProxyType
from typing import Any

from pgmp_petsc.base.units import times
from pgmp_petsc.declare.formulas import evaluated

#: In which order unknowns are made what equations ask for: those of names and of 0, of numbers, of 1, between sides.
OF_NAMES, OF_NUMBERS, OF_ONE, BETWEEN = range(4)
SIGNS = {operator.lt: "<", operator.le: "<=", operator.gt: ">", operator.ge: ">="}

Unknown = tuple[int, int]  # when it is made what equations ask for: its kind and its number
#: A sum of unknowns, each times its factor, and of a number.
Power = dict[Unknown | None, Fraction]
Solution = Mapping[Unknown, Fraction]


def shifted(value: float, power: float) -> float:
    """Return ``10^power`` times a number, through decimals."""
    return times(value, 10.0 ** float(power))


def _times(text: str, power: float) -> str:
    if not power:
        return text
    size = 10.0 ** abs(float(power))
    return f"({size!r} * {text})" if power > 0 else f"({text} / {size!r})"  # whose powers are exact


def _sum(a: Power, b: Power, factor: Fraction | int = 1) -> Power:
    return {key: a.get(key, Fraction(0)) + factor * b.get(key, Fraction(0)) for key in {**a, **b}}


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a formula: by which power of ten it is larger as it was written, and how it is written in SI units."""

    system: OwnUnits
    power: Power
    write: Callable[[Solution], str]
    value: float | None = None  # of a number

    def at(self, power: Power) -> Callable[[Solution], str]:
        """Return how it is written where it is to be larger by another power, which it should be."""
        between = self.system.unknown(BETWEEN)
        self.system.equal(_sum(self.power, power, -1), between)
        return lambda found: _times(self.write(found), self.system.solved(between, found))

    def joined(self, sign: str, other: Part, power: Power, right: Callable[[Solution], str] | None = None) -> Part:
        right = right or other.write
        return Part(self.system, power, lambda found: f"({self.write(found)} {sign} {right(found)})")

    def __add__(self, other: Part) -> Part:
        return self.joined("+", other, self.power, other.at(self.power))

    def __sub__(self, other: Part) -> Part:
        return self.joined("-", other, self.power, other.at(self.power))

    def __mul__(self, other: Part) -> Part:
        return self.joined("*", other, _sum(self.power, other.power))

    def __truediv__(self, other: Part) -> Part:
        return self.joined("/", other, _sum(self.power, other.power, -1))

    def __pow__(self, other: Part) -> Part:
        if other.value is None:  # of numbers alone
            base, exponent = self.at({}), other.at({})
            return Part(self.system, {}, lambda found: f"({base(found)} ** {exponent(found)})")
        power = {key: factor * Fraction(other.value) for key, factor in self.power.items()}
        exponent = int(other.value) if other.value.is_integer() else other.value  # products are of whole ones
        return Part(self.system, power, lambda found: f"({self.write(found)} ** ({exponent!r}))")

    def __neg__(self) -> Part:
        value = None if self.value is None else -self.value
        return Part(self.system, self.power, lambda found: f"(-{self.write(found)})", value)

    def __pos__(self) -> Part:
        return self


@dataclass
class OwnUnits:
    """The powers of what some formulas have together; an algebra of :func:`~pgmp_petsc.declare.formulas.evaluated`."""

    n_unknown: int = 0
    equations: list[Power] = field(default_factory=list)  # which are zero

    def unknown(self, kind: int) -> Power:
        self.n_unknown += 1
        return {(kind, self.n_unknown): Fraction(1)}

    def equal(self, a: Power, b: Power) -> None:
        self.equations.append(_sum(a, b, -1))

    def named(self, name: str, power: Power, is_own: bool) -> Part:
        """Return what has a name; `is_own` if its value is in the units of the formulas."""
        return Part(self, power, lambda found: _times(name, -self.solved(power, found)) if is_own else name)

    def number(self, value: float) -> Part:
        power = self.unknown({0.0: OF_NAMES, 1.0: OF_ONE}.get(abs(value), OF_NUMBERS))
        return Part(self, power, lambda found: repr(shifted(float(value), -self.solved(power, found))), float(value))

    def compared(self, ordering: Callable[..., Any], a: Part, b: Part) -> Part:
        return a.joined(SIGNS[ordering], b, {}, b.at(a.power))

    def joined(self, word: str, tests: Iterable[Part]) -> Part:
        """Return conditions with ``and`` or ``or`` between them, or one with ``not``."""
        tests = list(tests)
        if word == "not":
            return Part(self, {}, lambda found: f"(not {tests[0].write(found)})")
        return Part(self, {}, lambda found: f"({f' {word} '.join(test.write(found) for test in tests)})")

    def chosen(self, test: Part, body: Part, orelse: Part) -> Part:
        other = orelse.at(body.power)
        return Part(self, body.power, lambda f: f"({body.write(f)} if {test.write(f)} else {other(f)})")

    def called(self, name: str, *given: Part) -> Part:
        first, powers = given[0], {"sqrt": Fraction(1, 2), "abs": Fraction(1), "max": Fraction(1), "min": Fraction(1)}
        keeps = name in powers
        power = {key: powers[name] * factor for key, factor in first.power.items()} if keeps else {}
        writes = [first.write if keeps else first.at({}), *(other.at(first.power) for other in given[1:])]
        return Part(self, power, lambda found: f"{name}({', '.join(write(found) for write in writes)})")

    def solved(self, power: Power, found: Solution) -> Fraction:
        """Return a power, given all unknowns that are not zero."""
        return sum((n * (Fraction(1) if key is None else found.get(key, 0)) for key, n in power.items()), Fraction(0))

    def solution(self) -> Solution:
        """Solve the equations (Gauss), each for its first unknown; unknowns that are left over are 0."""
        rows: dict[Unknown, Power] = {}
        for equation in self.equations:
            while own := min((key for key, factor in equation.items() if factor and key is not None), default=None):
                if own not in rows:
                    rows[own] = {key: factor / equation[own] for key, factor in equation.items() if factor}
                    break
                equation = _sum(equation, rows[own], -equation[own])
        found: dict[Unknown, Fraction] = {}
        for own in sorted(rows, reverse=True):
            found[own] = -self.solved({key: factor for key, factor in rows[own].items() if key != own}, found)
        return found


@dataclass(frozen=True)
class InSi:
    """Formulas in SI units, by their keys, and by which power of ten their names and they are larger as written."""

    texts: dict[str, str]
    powers: dict[str, Fraction]
    of_texts: dict[str, Fraction]

    def number(self, name: str, value: float | str) -> float | str:
        """Return what a name has in SI units, of a number as it was written; the name of a parameter as it is."""
        return value if isinstance(value, str) else shifted(value, -self.powers.get(name, Fraction(0)))


def in_si(
    texts: Mapping[str, str],
    known: Mapping[str, float | None],
    wanted: Mapping[str, float | str] = MappingProxyType({}),
) -> InSi:
    """Write formulas in the language of declarations anew for SI units; those of which no number changes stay.

    Known is by which power of ten what has a name is larger in the units of the formulas; None of a value that is of
    any unit as well, and stays in these. All other names are numbers of any unit, the same in all formulas. Wanted is
    the same of the formulas, or the name of what they are to be as; without an entry it follows.
    """
    if not any(known.values()) and not any(power for power in wanted.values() if not isinstance(power, str)):
        return InSi(dict(texts), {}, dict.fromkeys(texts, Fraction(0)))
    system = OwnUnits()
    powers = {name: {None: Fraction(power)} for name, power in known.items() if power is not None}

    class Names(dict):
        def __missing__(self, name: str) -> Part:
            power = powers.setdefault(name, system.unknown(OF_NAMES))
            return system.named(name, power, name in known and known[name] is None)

    parts, names = {}, Names()
    for key, text in texts.items():
        part, asked = evaluated(text, names, system), wanted.get(key)
        if asked is not None:
            power = names[asked].power if isinstance(asked, str) else {None: Fraction(asked)}
            part = Part(system, power, part.at(power))
        parts[key] = part
    found = system.solution()
    of_names = {name: system.solved(power, found) for name, power in powers.items()}
    numbers = [power for key, power in found.items() if key[0] != OF_NAMES]
    own = [of_names.get(name, 0) for name, power in known.items() if power is None]
    kept = not any(numbers + own)
    written = {key: texts[key] if kept else part.write(found) for key, part in parts.items()}
    return InSi(written, of_names, {key: system.solved(part.power, found) for key, part in parts.items()})
