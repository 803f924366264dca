"""A force law ``F(t, s, s')`` on a scalar measure s of the motion: declared once, known to all languages.

A `Law` is declared (`laws`) by expressions (`declare.expressions`) of s, its rate and the law's parameters: the
potential V of its elastic part, and its force, in which ``elastic`` is ``-dV/ds`` and ``amplitude`` a function of time.
Their derivatives, code for the kernels and in C, and whether the law is linear follow. Kernels know a law by the
address of its compiled function, so that they are the same for all laws, and a new one does not compile them again.

Where a law has an edge, an expression that changes its sign, steps end there. The force has to be continuous there.

On a light node Newton's iteration jumps between both branches of friction: from either of them, where the force hardly
changes, it goes far beyond the other. The forces of a step, ``b``, and the inertia in it, ``A v``, meet friction where
``A v + F(v) = b``. For v > 0 this is concave: an iterate from zero on never goes too far. One that has crossed the rate
at which the force changes fastest (`steepest_rates`), between two at which it changes less than half as fast, is
therefore taken up from there, as circuit simulators limit the voltage at a junction (Nagel 1975, SPICE2, section 5.2),
and what follows is monotonic. Where friction falls with the rate, a balance in which inertia does not make up for that
is none to stay at. The slope is taken for zero there, but where it was much the same about the iterate before: from the
second one of a step on they go to a balance on either side, or have come near to one.
"""

from __future__ import annotations

import functools
import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import astuple, dataclass, field
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, NamedTuple, Self

import numpy as np
from numba import types
from numba.extending import intrinsic

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.declare import expressions
from pgmp_petsc.declare.expressions import Printed, Statements, called_at, check, check_names, kept, printed, symbolic
from pgmp_petsc.declare.forms import indented
from pgmp_petsc.lanes.compiled import native_address, njit, text_mark
from pgmp_petsc.lanes.vectors import data_of

STATE = ("s", "rate", "amplitude")
_NUMBER, _NUMBERS = types.float64, types.CPointer(types.float64)
_EVALUATE = _NUMBERS, *(_NUMBER,) * 4, _NUMBERS
_SLOPES = _NUMBERS, *(_NUMBER,) * 3, _NUMBERS
TRIED = (-1.0, 0.0, 1.0)  # measures and rates at which a law has to be finite
PYTHON = '''"""The law {name}, printed from its declaration."""

from math import atan, cos, exp, log, sin, sqrt, tanh

STIFFNESS = {stiffness}
BENDS = {bends}


def evaluate(p, amplitude, s, rate, about, depths):
{parameters}
{evaluate}


def slopes(p, amplitude, s, rate, found):
{parameters}
{slopes}


def edges(p, s):
{parameters}
{edges}


C = """{c}"""

COMPLETE = True
'''
LARGEST_EXPONENT = 300  # of exp in slopes, of which a square is finite
FOUND = "_force", "_stiffness", "_damping", "_elastic", "_stored"
AT, CENTRE, ABOUT = "_at", "_centre", "_about"
STEEPER = 2.0  # times that a slope is steeper where iterates are taken up from than about both of them
ALIKE = 0.005  # of a slope, by which that at the iterate before differs at most where it is gone by


class Found(NamedTuple):
    """A law in a state."""

    #: force, stiffness, damping: f, ``-dF/ds`` and ``-dF/ds'``
    force: float
    stiffness: float
    damping: float
    #: elastic, stored: of its elastic part the force ``-dV/ds`` and the potential energy V, J
    elastic: float
    stored: float
    about: float  # rate about which it is linearised, infinite where that was not the iterate's own


_FOUND = types.NamedUniTuple(_NUMBER, len(Found._fields), Found)


@dataclass(frozen=True, eq=False)
class Law(Printed):
    """A force law on a measure s.

    Raises `InputError` if an expression is none, or names what is not declared.
    """

    name: str  # of the law
    parameters: tuple[str, ...]  # names of its parameters
    force: str  # expression of s, rate, amplitude, elastic and the parameters
    potential: str = "0"  # of the elastic part, expression of s and the parameters
    edges: tuple[str, ...] = ()  # expressions of s and the parameters that are positive beyond an edge
    #: why a force of this law is not in the stiffness of vibrations; empty where it does not hang on the motion
    left_out: str = ""
    #: whether its first parameter is the force that the effect's joint carries, found between corrections of a step or,
    #: where that is read back, its amplitude: printed as the sum of both
    loaded: bool = False
    place: str = field(init=False)  # file and line of the declaration

    def __post_init__(self) -> None:
        place = called_at()
        object.__setattr__(self, "place", place)
        entry, of_s = f"law {self.name}", ("s", *self.parameters[self.loaded :])
        state = ("s", "rate") if self.loaded else STATE
        check_names(entry, (self.name,), (), place)
        check_names(entry, self.parameters, (*STATE, "elastic", "about", "depths", "found", "p"), place)
        check(f"{entry}: force", self.force, (*state, "elastic", *self.parameters), place)
        check(f"{entry}: potential", self.potential, of_s, place)
        for number, edge in enumerate(self.edges):
            check(f"{entry}: edges[{number}]", edge, of_s, place)
        names = set(re.findall(r"\w+", self.force))
        if ("elastic" in names) != (self.potential != "0"):
            left_out = f"leaves it out, and the potential is '{self.potential}'"
            has = left_out if self.potential != "0" else "names it, and there is no potential"
            raise InputError(f"{place}: {entry}: elastic is -dV/ds of the potential V, and force '{self.force}' {has}")
        if not self.left_out and {"s", "rate", "elastic"} & names:
            object.__setattr__(self, "left_out", "it is no linear spring")
        if self.loaded and not self.parameters:
            raise InputError(f"{place}: {entry}: it is loaded; its first parameter is the force that the joint carries")
        self.enter()

    @functools.cached_property
    def code(self) -> ModuleType:
        """The module that is printed from the declaration. Raises `InputError` if the force is not finite."""
        *declaration, place = astuple(self)
        key = repr((text_mark(__name__, *expressions.MARKED), declaration))
        found = kept(self.name, key, Path(self.file), self._printed)
        self._check_finite(found)
        return found

    @property
    def bends(self) -> bool:
        """Whether its damping changes with the rate, as that of friction, and of contacts that never pull."""
        return self.code.BENDS

    @property
    def linear_stiffness(self) -> str:
        """Name of the parameter that is the stiffness of a law that is linear, empty for others."""
        return self.code.STIFFNESS

    @functools.cached_property
    def address(self) -> int:
        """Where its compiled function is."""
        return native_address(self.code.evaluate, types.UniTuple(_NUMBER, len(Found._fields)), _EVALUATE)

    @functools.cached_property
    def address_of_slopes(self) -> int:
        """Where the compiled function is that gives the derivatives of the force with parameters and amplitude."""
        return native_address(self.code.slopes, _NUMBER, _SLOPES)

    def evaluate(
        self, p: Sequence[float], s: float, rate: float = 0.0, amplitude: float = 0.0, about: float = math.nan
    ) -> Found:
        """Evaluate the law in Python; `about` is the rate of the iterate before in the same step, NaN for the first."""
        return Found(*_called(self.code.evaluate, p, amplitude, s, rate, about, [0.0] * len(self.edges)))

    def forces(
        self, p: np.ndarray, s: np.ndarray, rates: np.ndarray | float = 0.0, amplitudes: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """Return the forces (n,) at measures (n,) and rates, for parameters (n, n_parameters)."""
        found = np.zeros(s.shape)
        state = (np.array(np.broadcast_to(part, s.shape), order="C") for part in (s, rates, amplitudes))
        _fill(self.address, np.ascontiguousarray(p), *state, np.zeros(len(self.edges)), found)
        return found

    def depths(self, p: Sequence[float], s: float) -> list[float]:
        """Return how far each edge is crossed, negative where it is not."""
        found = [0.0] * len(self.edges)
        _called(self.code.evaluate, p, 0.0, s, 0.0, math.nan, found)
        return found

    def edge_slopes(self, number: int, p: Sequence[float], s: float) -> tuple[float, float, np.ndarray]:
        """Return the derivatives of how far an edge is crossed: first and second with s, and with the parameters."""
        first, second, *others = _called(self.code.edges, p, s)[number]
        return first, second, np.array(others)

    def _check_finite(self, code: ModuleType) -> None:
        """Raise `InputError` where it is not finite with all parameters 1, nor with 1, 2, 3 and so on, as what divides
        by the way between two places has it; there what they are is tried too."""
        apart = [1.0 + k for k in range(len(self.parameters))]
        first = self._not_finite(code, [1.0] * len(apart), TRIED)
        if first is not None and self._not_finite(code, apart, [*TRIED, *apart, *(-x for x in apart)]) is not None:
            s, rate = first
            raise InputError(
                f"{self.place}: law {self.name}: force or a derivative of it is not finite at s = {s:g}, rate = "
                f"{rate:g} with all parameters 1, and not everywhere with 1, 2, 3 and so on; a law has to be finite at "
                "rest and in motion: write cases ('a if b else c') around such places"
            )

    def _not_finite(self, code: ModuleType, p: Sequence[float], at: Sequence[float]) -> tuple[float, float] | None:
        """Return a measure, of some, and a rate at which it is not finite with parameters p, None where it always
        is."""
        for s, rate in itertools.product(at, TRIED):
            slopes = [0.0] * (len(p) + 1)
            found = _called(code.evaluate, p, 1.0, s, rate, math.nan, [0.0] * len(self.edges))[:-1]
            _called(code.slopes, p, 1.0, s, rate, slopes)
            if not np.isfinite([*found, *slopes]).all():
                return s, rate
        return None

    def _printed(self) -> str:
        import sympy as sp

        names = {name: sp.Symbol(name, real=True) for name in (*STATE, *self.parameters)}
        s, rate, amplitude, *p = names.values()
        potential = symbolic(self.potential, names)
        elastic = -sp.diff(potential, s)
        known = {**names, "elastic": elastic} | ({self.parameters[0]: p[0] + amplitude} if self.loaded else {})
        force = symbolic(self.force, known)
        edges = [symbolic(edge, names) for edge in self.edges]
        found = [force, -_slope(force, s), -_slope(force, rate), elastic, potential]
        limits = _Limits.of(found, rate)
        slopes = [_slope(force, one) for one in (*p, amplitude)]
        of_edges = [[sp.diff(edge, s), sp.diff(edge, s, 2), *(sp.diff(edge, one) for one in p)] for edge in edges]
        constant = all(sp.diff(one, two) == 0 for one in found[1:3] for two in (s, rate, amplitude))
        stiffness = str(found[1]) if constant and found[1] in p else ""

        of = Statements()
        shared, values = printed(sum(of_edges, []))
        return PYTHON.format(
            name=self.name,
            stiffness=repr(stiffness),
            bends=rate in found[2].free_symbols,
            parameters=of.text(f"{name} = p[{k}]" for k, name in enumerate(self.parameters)),
            evaluate=self._evaluation(found, edges, limits),
            slopes=of.text([*of.of([f"found[{k}]" for k in range(len(slopes))], slopes), "return 0.0"]),
            edges=of.text([*shared, f"return {_rows(values, len(p) + 2)}"]),
            c=self._in_c(found[:3], edges, limits),
        )

    def _in_c(self, found: Sequence[Any], edges: Sequence[Any], limits: _Limits) -> str:
        """Return the function that gives force, stiffness, damping, about and how far edges are crossed in C."""
        takes = "const double p[], double amplitude, double s, double rate, double about, double found[]"
        lines = [f"static void law_{self.name}({takes}) {{"]
        lines.append("    (void)p, (void)amplitude, (void)s, (void)about;")
        lines += [f"    const double {name} = p[{k}];" for k, name in enumerate(self.parameters)]
        lines += [f"    (void){name};" for name in self.parameters]
        return "\n".join([*lines, self._evaluation(found, edges, limits, for_c=True), "}"])

    def _evaluation(self, found: Sequence[Any], edges: Sequence[Any], limits: _Limits, for_c: bool = False) -> str:
        """Return what evaluates the law, in Python or in C: of what is `Found` as much as is asked for, and `about`."""
        size, larger, infinite = ("fabs", "fmax", "INFINITY") if for_c else ("abs", "max", "float('inf')")
        of, names, damping = Statements(for_c), FOUND[: len(found)], FOUND[2]
        depths = [f"found[{len(found) + 1 + k}]" if for_c else f"depths[{k}]" for k in range(len(edges))]
        lines = of.of([*(f"let {name}" for name in names), *depths], [*found, *edges])
        lines.append(f"let {ABOUT} = rate")
        lines += [f"let {AT} = rate", f"let {CENTRE} = rate"] if limits.rates else []
        for at, dampings in limits.steepest():
            lines += [
                *of.of([CENTRE], [at]),
                f"if (about - {CENTRE}) * (rate - {CENTRE}) < 0.0 and {size}({CENTRE} - about) < {size}({AT} - about):",
                *indented(of.of(["let _there", "let _before"], dampings)),
                f"    if _there > {STEEPER} * {larger}({size}(_before), {size}({damping})):",
                f"        {AT} = {CENTRE}",
            ]
        if limits.rates:
            lines += [
                f"if {AT} != rate:",
                *indented(of.of(names, limits.linearised[: len(found)])),
                f"    {ABOUT} = {infinite}",
                # of the first iterate `about` is no number
                f"if {AT} == rate and about == about and {damping} < 0.0:",
                *indented(of.of(["let _before"], [limits.before])),
                f"    let _own = {damping}",
                f"    {damping} = 0.0",
                f"    if {size}(_before - _own) <= {ALIKE} * {size}(_own):",
                f"        {damping} = _own",
            ]
        given = [*names, ABOUT]
        end = [f"found[{k}] = {name}" for k, name in enumerate(given)] if for_c else [f"return {', '.join(given)}"]
        return of.text([*lines, *end])


def _slope(force: Any, variable: Any) -> Any:
    """Return the derivative of a force, which is continuous, with a variable.

    Where a sign is zero, as in ``(1 - exp(-abs(v) / u)) * sign(v)`` at rest, it is that of one side. It is finite where
    exp overflows, as in ``1 / (1 + exp(-v / u))``.
    """
    import sympy as sp

    def is_sign(part: Any) -> bool:
        if not part.is_Piecewise or not isinstance(part.args[0].cond, sp.Gt):
            return False
        otherwise = part.args[1].expr
        return otherwise.is_Piecewise and otherwise.args[0].cond == sp.Lt(*part.args[0].cond.args)

    both_sides = force.replace(is_sign, lambda x: sp.Piecewise(x.args[1].expr.args[0], (x.args[0].expr, True)))
    found = sp.diff(both_sides, variable)
    if not any(one.exp.is_negative and one.base.has(sp.exp) for one in found.atoms(sp.Pow)):
        return found
    return found.replace(sp.exp, lambda u: sp.exp(sp.Piecewise((u, u < LARGEST_EXPONENT), (LARGEST_EXPONENT, True))))


class _Limits(NamedTuple):
    """Where an iterate that has crossed is taken up from."""

    rates: list[Any]  # see `steepest_rates`
    damping: Any  # at a rate `AT`, as it is called there
    before: Any  # damping at the rate of the iterate before
    linearised: list[Any]  # what is `Found` about it, at the iterate's own rate

    @classmethod
    def of(cls, found: Sequence[Any], rate: Any) -> Self:
        """Make them of what is `Found` at a rate, a symbol."""
        import sympy as sp

        at, about = (sp.Symbol(name, real=True) for name in (AT, "about"))
        there = [one.subs(rate, at) for one in found]
        before = there[2].subs(at, about)
        return cls(steepest_rates(found[0], rate), there[2], before, [there[0] - there[2] * (rate - at), *there[1:]])

    def steepest(self) -> Iterator[tuple[Any, list[Any]]]:
        """Yield each rate, and the damping there, in which it is called `CENTRE`, and at the iterate before."""
        import sympy as sp

        at, centre = (sp.Symbol(name, real=True) for name in (AT, CENTRE))
        for one in self.rates:
            yield one, [self.damping.subs(at, centre), self.before]


MOST_CORNERS = 4  # between which a force is looked at


def steepest_rates(force: Any, rate: Any) -> list[Any]:
    """Return at which rates, a symbol, parts of a force may change fastest that change less and less on both sides:
    where the argument of tanh, atan or exp is zero, what is divided by least, as in ``v / sqrt(v**2 + e**2)`` or ``v /
    (abs(v) + e)``, and halfway between two corners, as of ``max(-a, min(a, c * v))``."""
    import sympy as sp

    def zeros(expressions: Iterable[Any]) -> set[Any]:
        """Return where those that are linear in the rate, or cases of them, vanish."""
        folded = [sp.piecewise_fold(one) for one in expressions]
        cases = [case for one in folded for case in ([x for x, _ in one.args] if one.is_Piecewise else [one])]
        slopes = [(one, sp.diff(one, rate)) for one in cases]
        return {-one.subs(rate, 0) / by for one, by in slopes if by != 0 and rate not in by.free_symbols}

    def corners(expression: Any) -> set[Any]:
        return zeros(test.lhs - test.rhs for test in expression.atoms(sp.core.relational.Relational))

    found = zeros(one.args[0] for one in force.atoms(sp.tanh, sp.atan, sp.exp))
    for one in force.atoms(sp.Pow):
        if one.exp.is_negative and rate in one.base.free_symbols:
            found |= zeros([sp.diff(one.base, rate)]) | corners(one.base)
    places = corners(force)
    if len(places) <= MOST_CORNERS:
        found |= {(one + other) / 2 for one, other in itertools.combinations(places, 2)}
    return sorted(found, key=sp.default_sort_key)


def _everywhere(of_numbers: Callable, of_any: Callable) -> Callable:
    """Return a function of numbers that has numpy's value where Python's has none, and raises."""

    def function(x: float) -> np.float64:
        try:
            return np.float64(of_numbers(x))
        except (ValueError, OverflowError):
            return of_any(x)

    return function


#: What printed code calls.
IEEE = {
    name: _everywhere(getattr(math, name), getattr(np, name.replace("atan", "arctan")))
    for name in ("atan", "cos", "exp", "log", "sin", "sqrt", "tanh")
} | {"float": np.float64}


def _called(function: FunctionType, p: Sequence[float], *arguments: Any) -> Any:
    """Call a printed function with the arithmetic of compiled ones: a case that is not taken may divide by zero."""
    numbers = (np.float64(one) if isinstance(one, (int, float)) else one for one in arguments)
    with np.errstate(all="ignore"):
        return FunctionType(function.__code__, function.__globals__ | IEEE)(np.asarray(p, dtype=float), *numbers)


def _rows(values: Sequence[str], n: int) -> str:
    """Return the text of a tuple of tuples of n values."""
    rows = [f"({', '.join(values[k : k + n])}), " for k in range(0, len(values), n)]
    return f"({''.join(rows)})"


class Laws(NamedTuple):
    """The laws of some actions, as compiled functions take them."""

    addresses: np.ndarray  # of their functions, shape (n_actions,)
    bend: np.ndarray  # `Law.bends`, (n_actions,)
    edges: np.ndarray  # number of the first edge of each among those of all, (n_actions + 1,)

    @classmethod
    def of(cls, laws: Sequence[Law]) -> Laws:
        """Make them of laws."""
        return cls(
            np.array([law.address for law in laws], dtype=np.int64),
            np.array([law.bends for law in laws], dtype=bool),
            np.cumsum([0, *(len(law.edges) for law in laws)]),
        )


@intrinsic
def obey(typing, address, p, amplitude, s, rate, about, depths):
    """Evaluate the law whose function is at an address, with parameters p, the amplitude of a source now, a measure s
    and its rate; return what is `Found`. The rate `about` which the iterate before was linearised in the same step is
    NaN for the first one, and outside of iterations. Fill in `depths` how far each edge is crossed, negative where it
    is not."""
    return _FOUND(types.int64, p, *(_NUMBER,) * 4, depths), calling(_FOUND, _EVALUATE)


@intrinsic
def differentiate(typing, address, p, amplitude, s, rate, found):
    """Fill the derivatives of a law's force with its parameters and, behind them, with the amplitude."""
    return _NUMBER(types.int64, p, *(_NUMBER,) * 3, found), calling(_NUMBER, _SLOPES)


def calling(result: types.Type, takes: tuple[types.Type, ...]) -> Any:
    """Return what builds the call of a function by its address, with arrays handed over by where they begin."""

    def build(context, builder, sig, args):
        convention = context.call_conv
        kind = convention.get_function_type(result, takes).as_pointer()
        parts = [
            data_of(context, builder, of, part) if isinstance(of, types.Array) else part
            for of, part in zip(sig.args, args)
        ]
        return convention.call_function(builder, builder.inttoptr(parts[0], kind), result, takes, parts[1:])[1]

    return build


@njit(cache=True, entry=True, error_model="numpy")
def _fill(address, p, s, rates, amplitudes, depths, found):
    """Fill the forces of the law whose function is at an address."""
    for k in range(s.size):
        found[k] = obey(address, p[k], amplitudes[k], s[k], rates[k], np.nan, depths).force


@njit(error_model="numpy")
def any_bend(laws):
    """Return whether any law bends: how a step's iteration contracts says nothing of the next one there."""
    for one in laws.bend:
        if one:
            return True
    return False
