"""Laws of controllers: states z' = g(z, y, y', r, r', t) and a force u = h(z, y, y', r, r', t), within limits.

A `ControlLaw` is declared by expressions (`declare.expressions`), as force laws are; sympy prints g, h and their
slopes, and kernels know it by the address of its compiled function. y is the measure, y' its rate, r the reference.
What is measured is made of motions s_i of the mechanics and their rates (`Measured`): slopes are by these.

In a step of the generalised-alpha scheme for states of first order (Jansen, Whiting and Hulbert 2000), with the
coefficients of the mechanics and Z' the auxiliary rates,

    (1 - alpha_m) Z'_{n+1} + alpha_m Z'_n = (1 - alpha_f) z'_{n+1} + alpha_f z'_n,
    z_{n+1} = z_n + h ((1 - gamma) Z'_n + gamma Z'_{n+1}),

the states at the end of a step are ``z = c + kappa g(z, y, ..)`` with kappa = h gamma (1 - alpha_f) / (1 - alpha_m),
and c known when the step begins. `respond` solves this small block at given s and s', and condenses it: what is left is
a force on a joint with its slopes by s and s', for the Newton matrix of the mechanics. gamma = 1/2 + alpha_f - alpha_m
holds for both orders, so that states and mechanics are of second order together.

What a controller measures is an expression of motions s_i (what an output of its own reads: an angle, a way, a
distance, a place), their rates v_i, time and parameters. Outputs of outputs, `rate` and `formula`, are expressions of
these, so that slopes and rates of what they are follow by the chain rule.
"""

from __future__ import annotations

import functools
import hashlib
import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import intrinsic

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.declare import expressions
from pgmp_petsc.declare.expressions import Printed, Statements, called_at, check, check_names, kept, symbolic
from pgmp_petsc.declare.formulas import InSi, in_si
from pgmp_petsc.effects.law import calling
from pgmp_petsc.lanes.compiled import native_address, njit, text_mark
from pgmp_petsc.lanes.lane_items import eliminate
from pgmp_petsc.outputs.readings import Expression, OfMotion, in_law, rate_of
from pgmp_petsc.scene import Scene


@dataclass(frozen=True)
class Measured:
    """What the measures of a controller are made of."""

    #: names of the outputs whose motions these are, in their order
    motions: tuple[str, ...]
    seen: tuple[tuple[str, Expression], ...]  # what is measured, by its name in the law
    constants: Mapping[str, str]  # parameters of the scene, by what they are called in the law

    @classmethod
    def of(cls, scene: Scene, outputs: Mapping[str, str]) -> Measured:
        """Return what outputs are made of, given by their names in the law."""
        motions: dict[str, int] = {}

        def seen(name: str) -> Expression:
            found = scene.outputs[name].expression(scene, seen)
            if found is None:
                found = OfMotion(motions.setdefault(name, len(motions)), scene.outputs[name].derivative)
            return found

        found = tuple((name, seen(output)) for name, output in outputs.items())
        constants = {in_law(parameter): parameter for _, one in found for parameter in one.parameters}
        return cls(tuple(motions), found, constants)


#: What expressions may name beside what is measured, the states and parameters: time, reference and its rate.
GIVEN = ("t", "r", "reference_rate")
#: In rates, the force before and after the limits.
FORCES = ("free", "limited")
LIMITS = ("lower", "upper")
WHOLE = "unlimited"  # name of the force before it is limited
_NUMBER, _NUMBERS = types.float64, types.CPointer(types.float64)
_TAKES = _NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS
MOST_ITERATIONS = 30
CLOSE = 1e-14  # of the states, and of the terms that make them, where their iteration ends
PYTHON = '''"""The law of the controller {name}, printed from its declaration."""

from math import atan, cos, exp, log, sin, sqrt, tanh


def evaluate(_p, _x, _z, _found):
{evaluate}
    return 0.0


def initial(_p, _x, _z, _found):
{initial}
    return 0.0


C = """{c}"""

COMPLETE = True
'''


@dataclass(frozen=True, eq=False)
class ControlLaw(Printed):
    """The law of a controller. Raises `InputError` if an expression is none, or names what is not declared."""

    name: str  # of the law
    parameters: tuple[str, ...]  # names of its parameters, beside those of the limits
    #: expressions of the rates of its states, by their names: of states, what is measured, `GIVEN`, `FORCES` and
    #: parameters
    states: Mapping[str, str]
    force: str  # expression of the same but for `FORCES`
    starts: Mapping[str, str] = field(default_factory=dict)  # states at the start, expressions without states; else 0
    #: what is measured, by its name in the expressions, and which has a `rate` there; and of how many motions it is
    measured: tuple[tuple[str, Expression], ...] = (("y", OfMotion(0)),)
    rate_of: str = "y"
    n_motions: int = 1
    limits: tuple[str, str] = LIMITS  # expressions of the lowest and the highest force, of themselves
    place: str = ""  # file and line of the declaration

    def __post_init__(self) -> None:
        place = self.place or called_at()
        object.__setattr__(self, "place", place)
        entry, named = f"controller {self.name}", (*GIVEN, *(name for name, _ in self.measured), "rate")
        given = (*named, *self.parameters)
        check_names(entry, (self.name,), (), place)
        check_names(entry, (*self.parameters, *self.states), (*named, *FORCES, *LIMITS), place)
        check(f"{entry}: force", self.force, (*self.states, *given), place)
        for state, text in self.states.items():
            check(f"{entry}: {state}", text, (*self.states, *given, *FORCES), place)
        for state, text in self.starts.items():
            if state not in self.states:
                known = f"its states are {', '.join(self.states)}" if self.states else "it has none"
                raise InputError(f"{place}: {entry}: a start is given for '{state}', which is no state of it; {known}")
            check(f"{entry}: start of {state}", text, given, place)
        self.enter()

    def reads(self, name: str) -> bool:
        """Return whether an expression names something."""
        return name in re.findall(r"\w+", " ".join((self.force, *self.states.values(), *self.starts.values())))

    def measuring(
        self, measured: Sequence[tuple[str, Expression]], n_motions: int, parameters: Sequence[str]
    ) -> ControlLaw:
        """Return the law of what is measured by the names it has, with parameters of that behind its own."""
        same = tuple(measured) == self.measured and n_motions == self.n_motions
        return self if same else _measuring(self, tuple(measured), n_motions, tuple(parameters))

    def in_si(self, known: Mapping[str, int], force: int) -> tuple[ControlLaw, InSi]:
        """Return the law in SI units, whose expressions are in those of a scene, and what numbers are there; `known`
        says by which power of ten what is measured and named, but no number, is larger in the units of the scene,
        `force` the same of the force."""
        starts = {f"start of {state}": text for state, text in self.starts.items()}
        limits = dict(zip(("lowest", "highest"), self.limits))
        texts = {"force": self.force, "change": "reference_rate"} | limits | dict(self.states) | starts
        wanted = dict.fromkeys(("force", *limits), force) | {"change": "r"}
        wanted |= {state: state for state in self.states} | {start: start.removeprefix("start of ") for start in starts}
        given = dict.fromkeys(FORCES, force) | {"t": 0} | ({"rate": known[self.rate_of]} if self.rate_of else {})
        found = in_si(texts, given | known, wanted)
        if found.texts == texts:
            return self, found
        return _written(self, tuple(found.texts.items())), found

    @property
    def n_found(self) -> int:
        """How many numbers its function fills: u, its slopes by every s and s' and the states; then those of each
        rate."""
        return (1 + len(self.states)) * (1 + 2 * self.n_motions + len(self.states))

    @functools.cached_property
    def code(self) -> ModuleType:
        """The module that is printed from the declaration."""
        declaration = [getattr(self, one.name) for one in fields(self) if one.name != "place"]
        key = repr((text_mark(__name__, "pgmp_petsc.outputs.readings", *expressions.MARKED), declaration))
        return kept(f"control_{self.name}", key, Path(self.file), self._printed)

    @functools.cached_property
    def address(self) -> int:
        """Where its compiled function is."""
        return native_address(self.code.evaluate, _NUMBER, _TAKES)

    @functools.cached_property
    def address_of_start(self) -> int:
        """Where the compiled function is that fills the first states."""
        return native_address(self.code.initial, _NUMBER, _TAKES)

    def _printed(self) -> str:
        import sympy as sp

        given = (*GIVEN, *self.states, *self.parameters, *LIMITS)
        names = {name: sp.Symbol(name, real=True) for name in given}
        states, (lower, upper) = [names[one] for one in self.states], (symbolic(one, names) for one in self.limits)
        pairs = [tuple(sp.Symbol(f"{name}_{k}", real=True) for name in "sv") for k in range(self.n_motions)]
        motions = list(itertools.chain(*pairs))
        # what is measured, and the force, have names of their own: where they have cases, comparisons of them are no
        # expressions of sympy
        seen = {name: one.symbolic(pairs, names) for name, one in self.measured}
        seen["rate"] = rate_of(seen[self.rate_of], pairs, names["t"]) if self.rate_of else sp.Integer(0)
        slopes = {(name, by): sp.diff(one, by) for name, one in seen.items() for by in motions}
        slope_names = {key: sp.Symbol(f"{key[0]}_by_{key[1]}", real=True) for key, one in slopes.items() if one != 0}
        names |= {name: sp.Symbol(name, real=True) for name in seen}
        free, whole = symbolic(self.force, names), sp.Symbol(WHOLE, real=True)
        limited = sp.Piecewise((lower, whole < lower), (upper, whole > upper), (free, True))
        rates = [symbolic(text, names | {"free": free, "limited": limited}) for text in self.states.values()]

        def slope(one: Any, by: Any) -> Any:
            parts = (sp.diff(one, names[name]) * slope_names[name, by] for name in seen if (name, by) in slope_names)
            return sum(parts, sp.Integer(0))

        found = [
            part
            for one in (limited, *rates)
            for part in (one, *(slope(one, by) for by in motions), *(sp.diff(one, state) for state in states))
        ]
        starts = [symbolic(self.starts.get(one, "0"), names) for one in self.states]
        measures = dict(zip([*seen, *map(str, slope_names.values())], [*seen.values(), *map(slopes.get, slope_names)]))
        given = {"_p": (*self.parameters, *LIMITS), "_x": (*GIVEN, *map(str, motions)), "_z": tuple(self.states)}

        def function(values: Sequence[Any], of_start: bool, for_c: bool = False) -> str:
            """Return the body of a function that fills values, of the first states or of rates and force."""
            of, arrays = Statements(for_c), ("_p", "_x") if of_start else tuple(given)
            known = {name: f"{array}[{k}]" for array in arrays for k, name in enumerate(given[array])}
            forces = {} if of_start else {WHOLE: free}
            lines = [f"let {name} = {value}" for name, value in known.items()]
            for part in (measures, forces):
                lines += of.of([f"let {name}" for name in part], list(part.values()))
            lines += of.of([f"_found[{k}]" for k in range(len(values))], values)
            return of.text([*lines, *(f"(void){name}" for name in (*known, *measures) if for_c)])

        takes = "(const double _p[], const double _x[], const double _z[], double _found[]) {"
        unused = "    (void)_p, (void)_x, (void)_z, (void)_found;"
        c = [f"static void control_{self.name}{takes}", unused, function(found, False, for_c=True), "}", ""]
        c += [f"static void start_{self.name}{takes}", unused, function(starts, True, for_c=True), "}"]
        return PYTHON.format(
            name=self.name, evaluate=function(found, False), initial=function(starts, True), c="\n".join(c)
        )


@functools.cache
def _measuring(
    law: ControlLaw, measured: tuple[tuple[str, Expression], ...], n_motions: int, parameters: tuple[str, ...]
) -> ControlLaw:
    mark = hashlib.sha256(repr((measured, n_motions, parameters)).encode()).hexdigest()[:12]
    return replace(
        law, name=f"{law.name}_{mark}", measured=measured, n_motions=n_motions,
        parameters=(*law.parameters, *parameters),
    )  # fmt: skip


@functools.cache
def _written(law: ControlLaw, given: tuple[tuple[str, str], ...]) -> ControlLaw:
    """Return a law with other expressions."""
    mark, texts = hashlib.sha256(repr(given).encode()).hexdigest()[:12], dict(given)
    return replace(
        law, name=f"{law.name}_{mark}", force=texts["force"], limits=(texts["lowest"], texts["highest"]),
        states={state: texts[state] for state in law.states},
        starts={state: texts[f"start of {state}"] for state in law.starts},
    )  # fmt: skip


@intrinsic
def _evaluate(typing, address, p, x, z, found):
    """Call the function of a law by its address."""
    return _NUMBER(types.int64, p, x, z, found), calling(_NUMBER, _TAKES)


class Room(NamedTuple):
    """Room for the response of one sample with n states, of k slopes by motions and their rates."""

    found: np.ndarray  # what the law finds, (n_found,) or more
    #: matrix, right: of the states, (n, n) and (n, 1 + k), or more
    matrix: np.ndarray
    right: np.ndarray

    @classmethod
    def of(cls, laws: Sequence[ControlLaw]) -> Room:
        """Return room for any of some laws."""
        sizes = [(w.n_found, len(w.states), 1 + 2 * w.n_motions) for w in laws] or [(0, 0, 0)]
        n_found, n, k = map(max, zip(*sizes))
        return cls(np.zeros(n_found), np.empty((n, n)), np.empty((n, k)))


@njit(cache=True, error_model="numpy")
def respond(address, n, n_slopes, p, x, c, kappa, z, rates, force, room):
    """Solve ``z = c + kappa g(z)`` for a sample by the law with an address and n states z, which are a first guess and
    the result; with kappa 0 they are c. Fill the rates g, (n,), and the force with its slopes by motions and their
    rates, (1 + n_slopes,), not a number where no states are found. Parameters p have shape (n_parameters,), and x, what
    is `GIVEN` with the motions and their rates, (3 + n_slopes,)."""
    found, matrix, right = room.found, room.matrix, room.right
    width, converged = 1 + n_slopes + n, False
    for _ in range(MOST_ITERATIONS):
        _evaluate(address, p, x, z, found)
        largest, change = 0.0, 0.0
        for i in range(n):
            row = width * (1 + i)
            right[i, 0] = c[i] + kappa * found[row] - z[i]
            # of a state, or of an error, that is small between large numbers only the digits of these are known
            size = abs(c[i]) + abs(kappa * found[row])
            for k in range(n_slopes):
                right[i, 1 + k] = kappa * found[row + 1 + k]
                size += abs(right[i, 1 + k] * x[len(GIVEN) + k])
            for j in range(n):
                share = kappa * found[row + 1 + n_slopes + j]
                matrix[i, j] = (i == j) - share
                size += abs(share * z[j])
            largest = max(largest, size)
        eliminate(n, 1 + n_slopes, matrix, right)
        for i in range(n):
            z[i] += right[i, 0]
            largest, change = max(largest, abs(z[i])), max(change, abs(right[i, 0]))
        if change <= CLOSE * largest:
            converged = True
            break
    for k in range(1 + n_slopes):
        force[k] = found[k] if converged else np.nan
        for i in range(n):
            force[k] += found[1 + n_slopes + i] * right[i, k]
    for i in range(n):
        rates[i] = found[width * (1 + i)]


@njit(cache=True, error_model="numpy")
def begin_all(address, p, x, z):
    """Fill the first states of all samples."""
    for sample in range(len(z)):
        _evaluate(address, p[sample], x[sample], z[sample], z[sample])


@njit(cache=True, error_model="numpy")
def respond_all(address, n, n_slopes, p, x, c, kappa, z, rates, force, room):
    """Let all samples respond, each a row."""
    for sample in range(len(z)):
        respond(
            address, n, n_slopes, p[sample], x[sample], c[sample], kappa, z[sample], rates[sample], force[sample], room
        )  # fmt: skip
