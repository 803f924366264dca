"""Laws of controllers: states z' = g(z, y, y', r, r', t) and a force u = h(z, y, y', r, r', t), within limits.

A `ControlLaw` is declared by expressions (`declare.expressions`), as force laws are; sympy prints g, h and their
slopes, and kernels know it by the address of its compiled function. y is the measure, y' its rate, r the reference.

In a step of the generalised-alpha scheme for states of first order (Jansen, Whiting and Hulbert 2000), with the
coefficients of the mechanics and Z' the auxiliary rates,

    (1 - alpha_m) Z'_{n+1} + alpha_m Z'_n = (1 - alpha_f) z'_{n+1} + alpha_f z'_n,
    z_{n+1} = z_n + h ((1 - gamma) Z'_n + gamma Z'_{n+1}),

the states at the end of a step are ``z = c + kappa g(z, y, ..)`` with kappa = h gamma (1 - alpha_f) / (1 - alpha_m),
and c known when the step begins. `respond` solves this small block at given y and y', and condenses it: what is left is a
force on a joint with its slopes by y and y', for the Newton matrix of the mechanics. gamma = 1/2 + alpha_f - alpha_m
holds for both orders, so that states and mechanics are of second order together.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Mapping
from dataclasses import astuple, dataclass, field
from pathlib import Path
from types import ModuleType

import numpy as np
from numba import types
from numba.extending import intrinsic

from pgmp_petsc.declare.expressions import Printed, check, check_names, kept, printed, symbolic
from pgmp_petsc.effects.law import calling
from pgmp_petsc.lanes.compiled import native_address, njit, text_mark

#: What expressions may name beside the states and parameters: time, measure and its rate, reference and its rate.
MEASURED = ("t", "y", "rate", "r", "reference_rate")
#: In rates, the force before and after the limits.
FORCES = ("free", "limited")
LIMITS = ("lower", "upper")
_NUMBER, _NUMBERS = types.float64, types.CPointer(types.float64)
_TAKES = _NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS
MOST_ITERATIONS = 30
CLOSE = 1e-14  # of the states, where their iteration ends
PYTHON = '''"""The law of the controller {name}, printed from its declaration."""

from math import atan, cos, exp, log, sin, sqrt, tanh


def evaluate(_p, _x, _z, _found):
{taken}
{evaluate}
    return 0.0


def initial(_p, _x):
{of_start}
{initial}


COMPLETE = True
'''


@dataclass(frozen=True, eq=False)
class ControlLaw(Printed):
    """The law of a controller. Raises `InputError` if an expression is none, or names what is not declared."""

    name: str  # of the law
    parameters: tuple[str, ...]  # names of its parameters, beside those of the limits
    #: expressions of the rates of its states, by their names: of states, `MEASURED`, `FORCES` and parameters
    states: Mapping[str, str]
    force: str  # expression of states, `MEASURED` and parameters
    starts: Mapping[str, str] = field(default_factory=dict)  # states at the start, of `MEASURED` and parameters; else 0
    place: str = field(init=False)  # file and line of the declaration

    def __post_init__(self) -> None:
        caller = sys._getframe(2)
        place = f"{caller.f_code.co_filename}:{caller.f_lineno}"
        object.__setattr__(self, "place", place)
        entry, given = f"controller {self.name}", (*MEASURED, *self.parameters)
        check_names(entry, (self.name,), (), place)
        check_names(entry, (*self.parameters, *self.states), (*MEASURED, *FORCES, *LIMITS), place)
        check(f"{entry}: force", self.force, (*self.states, *given), place)
        for state, text in self.states.items():
            check(f"{entry}: {state}", text, (*self.states, *given, *FORCES), place)
        for state, text in self.starts.items():
            check(f"{entry}: start of {state}", text, given, place)
        self.enter()

    @property
    def n_found(self) -> int:
        """How many numbers its function fills: u, its slopes by y, y' and the states; then those of each rate."""
        return (1 + len(self.states)) * (3 + len(self.states))

    @functools.cached_property
    def code(self) -> ModuleType:
        """The module that is printed from the declaration."""
        *declaration, place = astuple(self)
        key = repr((text_mark(__name__, "pgmp_petsc.declare.expressions"), declaration))
        return kept(f"control_{self.name}", key, Path(self.file), self._printed)

    @functools.cached_property
    def address(self) -> int:
        """Where its compiled function is."""
        return native_address(self.code.evaluate, _NUMBER, _TAKES)

    def _printed(self) -> str:
        import sympy as sp

        names = {name: sp.Symbol(name, real=True) for name in (*MEASURED, *self.states, *self.parameters, *LIMITS)}
        states, lower, upper = [names[one] for one in self.states], names["lower"], names["upper"]
        free = symbolic(self.force, names)
        limited = sp.Piecewise((lower, free < lower), (upper, free > upper), (free, True))
        rates = [symbolic(text, names | {"free": free, "limited": limited}) for text in self.states.values()]
        by = [names["y"], names["rate"], *states]
        found = [part for one in (limited, *rates) for part in (one, *(sp.diff(one, name) for name in by))]
        starts = [symbolic(self.starts.get(one, "0"), names) for one in self.states]
        lines, values = printed(found)
        of_start, initial = printed(starts) if starts else ([], [])
        parameters = [f"{name} = _p[{k}]" for k, name in enumerate((*self.parameters, *LIMITS))]
        measured = [f"{name} = _x[{k}]" for k, name in enumerate(MEASURED)]

        def text(rows: list[str]) -> str:
            return "\n".join(f"    {row}" for row in rows)

        return PYTHON.format(
            name=self.name,
            taken=text([*parameters, *measured, *(f"{name} = _z[{k}]" for k, name in enumerate(self.states))]),
            evaluate=text([*lines, *(f"_found[{k}] = {value}" for k, value in enumerate(values))]),
            of_start=text([*parameters, *measured]),
            initial=text([*of_start, f"return ({''.join(f'{one}, ' for one in initial)})"]),
        )


@intrinsic
def _evaluate(typing, address, p, x, z, found):
    """Call the function of a law by its address."""
    return _NUMBER(types.int64, p, x, z, found), calling(_NUMBER, _TAKES)


@njit(cache=True, error_model="numpy")
def respond(address, p, x, c, kappa, z, found, rates, force):
    """Solve ``z = c + kappa g(z)`` for every sample, and find the force with its slopes by the measure and its rate.

    Parameters
    ----------
    address
        Of the compiled law.
    p, x
        Parameters (n_samples, n_parameters) and what is `MEASURED`, (n_samples, 5).
    c, kappa
        Of the step, (n_samples, n_states) and a number; with kappa 0 states are c.
    z
        The states, (n_samples, n_states); a first guess, and the result.
    found
        Room for what the law finds, (n_found,).
    rates, force
        Results: g, (n_samples, n_states), and force with slopes, (n_samples, 3).
    """
    n_samples, n = z.shape
    width = 3 + n
    matrix, right = np.empty((n, n)), np.empty((n, 3))
    for sample in range(n_samples):
        converged = False
        for _ in range(MOST_ITERATIONS):
            _evaluate(address, p[sample], x[sample], z[sample], found)
            largest, change = 0.0, 0.0
            for i in range(n):
                row = width * (1 + i)
                right[i, 0] = c[sample, i] + kappa * found[row] - z[sample, i]
                right[i, 1], right[i, 2] = kappa * found[row + 1], kappa * found[row + 2]
                for j in range(n):
                    matrix[i, j] = (i == j) - kappa * found[row + 3 + j]
            _solve(matrix, right)
            for i in range(n):
                z[sample, i] += right[i, 0]
                largest, change = max(largest, abs(z[sample, i])), max(change, abs(right[i, 0]))
            if change <= CLOSE * largest:
                converged = True
                break
        for k in range(3):
            force[sample, k] = found[k] if converged else np.nan
        for i in range(n):
            rates[sample, i] = found[width * (1 + i)]
            force[sample, 0] += found[3 + i] * right[i, 0]
            force[sample, 1] += found[3 + i] * right[i, 1]
            force[sample, 2] += found[3 + i] * right[i, 2]


@njit(error_model="numpy")
def _solve(matrix, right):
    """Eliminate with row pivoting, in place: `right` becomes the solutions."""
    n = len(matrix)
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[best, k]):
                best = i
        for j in range(n):
            matrix[k, j], matrix[best, j] = matrix[best, j], matrix[k, j]
        for j in range(right.shape[1]):
            right[k, j], right[best, j] = right[best, j], right[k, j]
        for i in range(n):
            if i != k:
                factor = matrix[i, k] / matrix[k, k]
                for j in range(k, n):
                    matrix[i, j] -= factor * matrix[k, j]
                for j in range(right.shape[1]):
                    right[i, j] -= factor * right[k, j]
    for k in range(n):
        for j in range(right.shape[1]):
            right[k, j] /= matrix[k, k]
