"""Formulas that a scene writes: parsed, never evaluated as Python, and written anew in the language of declarations.

What a formula may have is in `OPERATIONS` and `FUNCTIONS`. What comes out is an expression as of `expressions`: laws
are printed of it (`effects.formula`), outputs evaluate it for values with their derivatives over time (`Series`), and
for the units of what it names (`Dimensions`).

Those in the units of a scene are written anew for SI units (`in_si`). What a formula names is ``10^n`` times larger in
the units of the scene than in SI units: in mm, t and s a length is 1000 times larger, and a force as large. Of what is
named n is known, but not of the numbers in a formula, such as the 500 of ``-3 * (s - 500)``, which are of any unit:
theirs follow from what is added, compared and asked for, as types follow in a program (Kennedy, Types for
units-of-measure, 2010). Here s is a length and so is 500, and the 3 is a stiffness, for the whole to be a force: in SI
units it is ``-3000 * (s - 0.5)``, bit for bit what one would write.

Every n is an unknown of linear equations: those of factors are added up, those of summands are equal. Unknowns that are
left over are zero, and there is one more between the two sides of every sum, which is other than zero only where a
formula adds what does not fit, such as ``t + s``: the factor that makes it what it is in the units of the scene.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache, reduce
from math import comb
from types import MappingProxyType
from typing import Any

import numpy as np

from pgmp_petsc.base.errors import nearest_name, shortened
from pgmp_petsc.base.units import in_powers, times

LONGEST, MOST = 1000, 20_000  # characters, and of what is made of them
#: places at which two formulas are compared, and by what share of their values others beside these they may differ
PLACES, ROUND_OFF = 64, 1e-9
LARGEST_POWER = 20  # whole exponents up to it are products, all others powers of positive numbers
ATAN2 = (  # of {x} and {y}, each case where it is accurate; zero where both are
    "atan({x} / {y}) if {y} > 0 and {y} >= abs({x}) else (1.5707963267948966 - atan({y} / {x}) if {x} > abs({y}) else "
    "(-1.5707963267948966 - atan({y} / {x}) if -{x} > abs({y}) else (atan({x} / {y}) + 3.141592653589793 * (1 if {x} "
    ">= 0 else -1) if {y} < 0 else 0)))"
)
#: Functions of a formula, with the number of their arguments and what they are in a declaration.
FUNCTIONS = {
    **{name: (1, f"{name}({{x}})") for name in ("sin", "cos", "exp", "log", "sqrt", "abs", "tanh")},
    "tan": (1, "(sin({x}) / cos({x}))"),
    "sign": (1, "(1 if {x} > 0 else (-1 if {x} < 0 else 0))"),
    "min": (2, "min({x}, {y})"),
    "max": (2, "max({x}, {y})"),
    "atan2": (2, f"({ATAN2})"),
    "where": (3, "({y} if {condition} else {z})"),
}
#: Functions that bend within little of what they are of.
TURNING = {"abs", "tanh", "sign", "min", "max", "atan2", "where"}
OPERATIONS = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**", ast.USub: "-", ast.UAdd: "+", ast.Lt: "<",
    ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=",
}  # fmt: skip
#: What is worked out where it is of numbers alone, so that none of them is too large for whoever prints it.
ARITHMETIC = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}  # fmt: skip
OF_NUMBERS = {name: getattr(math, name) for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh")} | {"abs": abs}
ALLOWED = f"+ - * / **, the comparisons < <= > >= (1 or 0) and the functions {', '.join(FUNCTIONS)}"


def why_no_name(name: str, taken: Collection[str]) -> str:
    """Return why a name of a scene cannot be one in a formula, which has some of its own; empty where it can."""
    if name.isidentifier() and name.isascii() and name not in taken and name not in FUNCTIONS:
        return ""
    return f"'{name}' cannot be a name in a formula: take letters, digits and _, and no name that it has"


class FormulaError(ValueError):
    """What a formula must not have, and at which of its characters, from 0."""

    def __init__(self, words: str, at: int = 0) -> None:
        super().__init__(words)
        self.at = at


def declared(text: str, names: Mapping[str, str], words: str) -> tuple[str, set[str]]:
    """Return a formula in the language of declarations, and which names it has.

    Given are the names that it may have with what they are in a declaration, and these in words, for messages. Raises
    `FormulaError` where it has what is not allowed.
    """
    allowed = f"a formula has numbers, {words}, {ALLOWED}"
    if len(text) > LONGEST:
        raise FormulaError(f"has {len(text)} characters; at most {LONGEST} are taken")
    if "#" in text:  # Python would read a comment, and leave out what is behind it
        raise FormulaError(f"has '#'; {allowed}", text.index("#"))
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        why = error.msg if isinstance(error, SyntaxError) else "nested too deeply"
        at = (getattr(error, "offset", None) or 1) - 1
        raise FormulaError(f"is no formula ({why}); {allowed}", at) from None
    used: set[str] = set()

    def number(node: ast.expr) -> str:
        found = written(node)
        if len(found) > MOST:
            raise FormulaError("has too many functions within each other")
        return found

    def written(node: ast.expr) -> str:
        value = _literal(node)
        if value is not None:
            return repr(value)
        match node:
            case ast.Name(id=name):
                if name not in names:
                    hint = nearest_name(name, names)
                    raise FormulaError(
                        f"names '{shortened(name, 40)}', which is not known{hint}; {allowed}", node.col_offset
                    )
                used.add(name)
                return names[name]
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return f"({number(left)} ** {exponent(right)})"
            case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATIONS:
                return f"({number(left)} {OPERATIONS[type(op)]} {number(right)})"
            case ast.UnaryOp(op=op, operand=operand) if type(op) in OPERATIONS:
                return f"({OPERATIONS[type(op)]}{number(operand)})"
            case ast.Compare():
                return f"(1 if {condition(node)} else 0)"
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                if name not in FUNCTIONS:
                    hint = nearest_name(name, FUNCTIONS)
                    raise FormulaError(
                        f"calls '{shortened(name, 40)}', which is no function{hint}; {allowed}", node.col_offset
                    )
                n, form = FUNCTIONS[name]
                if len(arguments) != n:
                    raise FormulaError(f"gives {name} {len(arguments)} arguments; it takes {n}", node.col_offset)
                if name == "where":
                    test, *rest = arguments
                    return form.format(condition=condition(test), **dict(zip("yz", map(number, rest))))
                return form.format(**dict(zip("xy", map(number, arguments))))
        raise FormulaError(f"has '{ast.unparse(node)}'; {allowed}", node.col_offset)

    def exponent(node: ast.expr) -> str:
        whole = _literal(node)
        if whole is not None and whole.is_integer() and abs(whole) <= LARGEST_POWER:
            return f"({int(whole)})"
        return number(node)

    def condition(node: ast.expr) -> str:
        if not isinstance(node, ast.Compare):
            value = number(node)
            return f"({value} > 0 or {value} < 0)"
        if not all(type(op) in OPERATIONS for op in node.ops):
            raise FormulaError(f"has '{ast.unparse(node)}'; {allowed}", node.col_offset)
        ends = map(number, (node.left, *node.comparators))
        first = next(ends)
        return f"({first}{''.join(f' {OPERATIONS[type(op)]} {end}' for op, end in zip(node.ops, ends))})"

    try:
        return number(tree), used
    except RecursionError:
        raise FormulaError("is nested too deeply") from None


def turns_at_once(text: str) -> bool:
    """Return whether a formula has a comparison, or a function of `TURNING`."""
    nodes = list(ast.walk(ast.parse(text.strip(), mode="eval")))
    return any(isinstance(node, ast.Compare) or getattr(node, "id", "") in TURNING for node in nodes)


def jumps_with(text: str) -> frozenset[str]:
    """Return which names the comparisons and signs have with which a formula jumps: of ``where(s < a, k * (a - s), 0)``
    and ``sign(v) * v**2`` none, as these are the same on both sides."""
    text, found = " ".join(text.split()), frozenset[str]()
    for node in ast.walk(ast.parse(text, mode="eval")):
        match node:
            case ast.Compare(left=left, comparators=[right]):
                sides, values = (left, right), (1, 0)
            case ast.Call(func=ast.Name(id="sign"), args=[inner]):
                sides, values = (inner, ast.Constant(0)), (1, -1)
            case ast.Compare():
                sides, values = (), ()
            case _:
                continue
        before, behind = text[: node.col_offset], text[node.end_col_offset :]
        if not _meet([f"{before}({value}){behind}" for value in values], sides):
            found |= _names(node)
    return found


def _names(node: ast.AST) -> frozenset[str]:
    return frozenset(one.id for one in ast.walk(node) if isinstance(one, ast.Name)) - set(FUNCTIONS)


def _meet(formulas: Sequence[str], sides: Sequence[ast.expr]) -> bool:
    """Return whether two formulas have the same values wherever two sides do, one of which is a name: at some places,
    drawn at random, of all sizes and both signs. Where that is not known they have not."""
    for side, other in (sides, sides[::-1]) if sides else ():
        if isinstance(side, ast.Name) and side.id not in _names(other):
            break
    else:
        return False
    names = sorted(frozenset().union(*(_names(ast.parse(one)) for one in formulas), _names(other), {side.id}))
    signs, powers = np.random.default_rng(0).uniform(-1.0, 1.0, (2, len(names), PLACES))
    drawn = {name: Series([row]) for name, row in zip(names, np.copysign(1e3**powers, signs))}

    def values(formula: str) -> np.ndarray:
        found = evaluated(declared(formula, dict(zip(names, names)), "")[0], drawn, SeriesAlgebra(0)).parts[0]
        return np.broadcast_to(found, PLACES)

    try:
        with np.errstate(all="ignore"):
            size = np.max(np.abs([values(formula) for formula in formulas]), axis=0)
            drawn[side.id] = Series([values(ast.unparse(other))])
            apart = np.abs(np.subtract(*map(values, formulas)))
    except FormulaError:  # one that divides by the test
        return False
    known = np.isfinite(size) & np.isfinite(apart)
    return bool(known.any() and np.all(apart[known] <= ROUND_OFF * size[known]))


def _literal(node: ast.expr) -> float | None:
    """Return the value of an expression of numbers alone; None of others. Raises `FormulaError` if it is not finite."""
    match node:
        case ast.Constant(value=value) if type(value) in (int, float):
            parts, compute = (value,), float
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
            parts, compute = (_literal(operand),), operator.neg if isinstance(node.op, ast.USub) else operator.pos
        case ast.BinOp(left=left, op=op, right=right) if type(op) in ARITHMETIC:
            parts, compute = (_literal(left), _literal(right)), ARITHMETIC[type(op)]
        case ast.Call(func=ast.Name(id=name), args=[inner], keywords=[]) if name in OF_NUMBERS:
            parts, compute = (_literal(inner),), OF_NUMBERS[name]
        case _:
            return None
    if None in parts:
        return None
    try:
        value = float(compute(*parts))
    except (ArithmeticError, ValueError, TypeError):
        value = math.nan
    if not math.isfinite(value):
        raise FormulaError(f"has {ast.unparse(node)}, which is no finite number", node.col_offset)
    return value


def evaluated(text: str, names: Mapping[str, Any], algebra: Any) -> Any:
    """Return an expression of a declaration for values of its names, in an algebra of numbers, comparisons, conditions,
    cases and functions: `SeriesAlgebra`, `Dimensions`, or one of :mod:`~pgmp_petsc.declare.formulas` or of sympy's."""
    operations = ARITHMETIC | {ast.USub: operator.neg, ast.UAdd: operator.pos}
    ordering = {ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge}

    def read(node: ast.expr) -> Any:
        match node:
            case ast.Name(id=name):
                return names[name]
            case ast.Constant(value=value):
                return algebra.number(value)
            case ast.BinOp(left=left, op=op, right=right):
                return operations[type(op)](read(left), read(right))
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return algebra.joined("not", [read(operand)])
            case ast.UnaryOp(op=op, operand=operand):
                return operations[type(op)](read(operand))
            case ast.BoolOp(op=op, values=values):
                return algebra.joined("and" if isinstance(op, ast.And) else "or", map(read, values))
            case ast.Compare(left=left, ops=ops, comparators=others):
                ends = [read(one) for one in (left, *others)]
                found = [algebra.compared(ordering[type(op)], a, b) for op, a, b in zip(ops, ends, ends[1:])]
                return found[0] if len(found) == 1 else algebra.joined("and", found)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return algebra.chosen(read(test), read(body), read(orelse))
            case ast.Call(func=ast.Name(id=name), args=args):
                return algebra.called(name, *map(read, args))
        raise TypeError(ast.dump(node))  # neither `declared` nor `expressions.check` lets anything else through

    return read(_tree(text))


@lru_cache(maxsize=256)
def _tree(text: str) -> ast.expr:
    """Return a formula that is evaluated often, parsed."""
    return ast.parse(text, mode="eval").body


@dataclass(frozen=True, eq=False)
class Series:
    """A value and its derivatives over time, up to the second one, each of shape (n,); or, of the first order, a value
    and its derivatives with n parameters."""

    parts: Sequence[np.ndarray]

    def __add__(self, other: Series) -> Series:
        return Series([a + b for a, b in zip(self.parts, other.parts)])

    def __sub__(self, other: Series) -> Series:
        return self + -other

    def __neg__(self) -> Series:
        return Series([-a for a in self.parts])

    def __pos__(self) -> Series:
        return self

    def __mul__(self, other: Series) -> Series:
        x, y = self.parts, other.parts
        return Series([sum(comb(n, k) * x[k] * y[n - k] for k in range(n + 1)) for n in range(len(x))])

    def __truediv__(self, other: Series) -> Series:
        u = other.parts[0]
        return self * other.through(lambda: (1.0 / u, -1.0 / u**2, 2.0 / u**3))

    def __pow__(self, other: Series) -> Series:
        u, p = self.parts[0], other.parts[0]
        if all(np.all(part == 0.0) for part in other.parts[1:]):

            def power(k: int) -> np.ndarray:  # a factor of zero ends it: 0 ** -1 is not asked for
                factor = math.prod((p - j for j in range(k)), start=np.ones_like(p))
                return np.where(factor == 0.0, 0.0, factor * u ** np.where(factor == 0.0, 1.0, p - k))

            return self.through(lambda: (power(0), power(1), power(2)))
        return (other * self.through(lambda: FUNCTIONS_OF["log"](u))).through(lambda: (lambda e: (e, e, e))(u**p))

    def through(self, function: Callable[[], tuple[np.ndarray, ...]]) -> Series:
        """Return a function of it, of which value and derivatives are given."""
        f = function()
        found = [f[0], *(f[1] * part for part in self.parts[1:])]
        if len(found) > 2:
            found[2] = found[2] + f[2] * self.parts[1] ** 2
        return Series(found)


#: Value, first and second derivative of functions.
FUNCTIONS_OF: dict[str, Callable[[np.ndarray], tuple[np.ndarray, ...]]] = {
    "abs": lambda u: (np.abs(u), np.where(u < 0.0, -1.0, 1.0), 0.0 * u),
    "atan": lambda u: (np.arctan(u), 1.0 / (1.0 + u**2), -2.0 * u / (1.0 + u**2) ** 2),
    "cos": lambda u: (np.cos(u), -np.sin(u), -np.cos(u)),
    "exp": lambda u: (np.exp(u), np.exp(u), np.exp(u)),
    "log": lambda u: (np.log(u), 1.0 / u, -1.0 / u**2),
    "sin": lambda u: (np.sin(u), np.cos(u), -np.sin(u)),
    "sqrt": lambda u: (np.sqrt(u), 0.5 / np.sqrt(u), -0.25 / np.sqrt(u) ** 3),
    "tanh": lambda u: (
        np.tanh(u), 1.0 - np.tanh(u) ** 2, -2.0 * np.tanh(u) * (1.0 - np.tanh(u) ** 2)
    ),
}  # fmt: skip


@dataclass(frozen=True)
class SeriesAlgebra:
    """Formulas of `Series` with so many derivatives."""

    order: int

    def number(self, value: float) -> Series:
        return Series([np.array(float(value)), *(np.zeros(()) for _ in range(self.order))])

    def compared(self, ordering: Callable[..., Any], a: Series, b: Series) -> np.ndarray:
        return ordering(a.parts[0], b.parts[0])

    def joined(self, word: str, tests: Iterable[np.ndarray]) -> np.ndarray:
        joins = {"and": np.logical_and, "or": np.logical_or}
        return reduce(joins[word], tests) if word in joins else np.logical_not(*tests)

    def chosen(self, test: np.ndarray, body: Series, orelse: Series) -> Series:
        return Series([np.where(test, a, b) for a, b in zip(body.parts, orelse.parts)])

    def called(self, name: str, *given: Series) -> Series:
        if name in ("max", "min"):
            a, b = given
            return self.chosen((a.parts[0] > b.parts[0]) == (name == "max"), a, b)
        return given[0].through(lambda: FUNCTIONS_OF[name](given[0].parts[0]))


class DimensionError(ValueError):
    """Quantities of other dimensions than a formula may have there."""


@dataclass(frozen=True)
class Measured:
    """What a part of a formula is measured in: exponents of kg, m and s; a unit that is kept; or the number that it is.

    A number alone may be added to anything; what is not known may be anything.
    """

    dimension: tuple[float, ...] | None = None
    unit: str = ""
    value: float | None = None

    @property
    def text(self) -> str:
        """The unit, in words."""
        return self.unit or in_powers(self.dimension) or "a number"

    def with_(self, other: Measured) -> Measured:
        """Return what both are, that are added or compared."""
        if self.value is not None or other.value is not None:
            one = other if self.value is not None else self
            return Measured() if one.value is not None else one
        if self.dimension is None or other.dimension is None:
            return other if self.dimension is None else self
        if self.dimension != other.dimension:
            raise DimensionError(f"adds or compares {self.text} and {other.text}")
        return self if self.unit == other.unit else Measured(self.dimension)

    def __add__(self, other: Measured) -> Measured:
        both = self.with_(other)
        return Measured((0.0, 0.0, 0.0), value=0.0) if both == Measured() and self.value is not None else both

    __sub__ = __add__

    def __neg__(self) -> Measured:
        return self if self.value is None else Measured(self.dimension, value=-self.value)

    def __pos__(self) -> Measured:
        return self

    def __mul__(self, other: Measured, sign: int = 1) -> Measured:
        if self.dimension is None or other.dimension is None:
            return Measured()
        if self.value is not None and other.value is not None:
            return self
        if other.value is not None:
            return self
        if self.value is not None and sign > 0:
            return other
        return Measured(tuple(a + sign * b for a, b in zip(self.dimension, other.dimension)))

    def __truediv__(self, other: Measured) -> Measured:
        return self.__mul__(other, -1)

    def __pow__(self, other: Measured) -> Measured:
        if self.value is not None:
            return NUMBER if other.value is None else self
        if self.dimension is None:
            return self
        if other.value is None:
            if any(self.dimension) or any(other.dimension or ()):
                raise DimensionError(f"raises {self.text} to a power that is no constant number")
            return self
        return self if other.value == 1.0 else Measured(tuple(other.value * a for a in self.dimension))


NUMBER = Measured((0.0, 0.0, 0.0))


class Dimensions:
    """Formulas of `Measured`."""

    def number(self, value: float) -> Measured:
        return Measured((0.0, 0.0, 0.0), value=value)

    def compared(self, ordering: Callable[..., Any], a: Measured, b: Measured) -> bool:
        a.with_(b)
        return True

    def joined(self, word: str, tests: Iterable[bool]) -> bool:
        return all(tests)

    def chosen(self, test: bool, body: Measured, orelse: Measured) -> Measured:
        return body + orelse

    def called(self, name: str, *given: Measured) -> Measured:
        """Return what a function gives; raises `DimensionError` if it takes numbers and angles alone."""
        if name in ("max", "min"):
            return given[0] + given[1]
        if name in ("abs", "sqrt"):
            return given[0] if name == "abs" else given[0] ** Measured((0.0, 0.0, 0.0), value=0.5)
        if any(given[0].dimension or ()):
            raise DimensionError(f"gives {name} {given[0].text}, which takes numbers and angles")
        return NUMBER


#: In which order unknowns are made what equations ask for: those of names and of 0, of numbers, of 1, between sides.
OF_NAMES, OF_WRITTEN, OF_ONE, BETWEEN = range(4)
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
        power = self.unknown({0.0: OF_NAMES, 1.0: OF_ONE}.get(abs(value), OF_WRITTEN))
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
