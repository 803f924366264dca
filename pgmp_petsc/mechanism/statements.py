"""Scalar statements about two frames, in the plane and in space: what joints, coordinates and effects are made of.

A frame is ``zeta = (p, d_1 .. d_d)``, a position and the directors of a body: 6 numbers in the plane, 12 in space. With
directions ``u_a = sum_k u_k d_k`` that are fixed in a frame, a statement s of two frames a and b is one of `KINDS`.
Zero is what a joint demands; a law of s and s' (`effects.law`) is a force on it. What couples several is a
`Combination` of functions of them, each about two frames of its own.

A kind is one expression, from which compiled code and C are printed, of products ``dot(x, y)`` of vectors that are
linear in the frames: ``p_b - p_a``, a direction ``u_a`` that is fixed in a frame, or ``u`` in the ground. With
``s = f(q_0, ..)`` of such products q the derivatives in the 2 d (d + 1) numbers of both frames are

    ds = sum_m f_m dq_m,    d2s = sum_m f_m d2q_m + sum_mn f_mn dq_m dq_n^T,

where dq and d2q are loops that all products have in common, and sympy gives f_m and f_mn. What is local along a line
has a first product that counts within 0 and 1 alone: beyond, f is what it is there, its derivatives in it are zero.
"""

from __future__ import annotations

import ast
import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import scipy

from pgmp_petsc.declare.expressions import kept
from pgmp_petsc.declare.forms import in_c, indented
from pgmp_petsc.lanes.compiled import njit, text_mark

APART = "p_b - p_a"
LOCAL = {  # of Hermite's interpolation between 0 and 1, with slopes that are zero at both
    "fade": lambda x: 1 - 3 * x**2 + 2 * x**3,
    "bulge": lambda x: 2 * x**2 * (1 - x) ** 2,
}
ARRAYS = ("gradient", "spare")  # that hold the derivatives of products
TURN = "6.283185307179586"
TAKES = "axes, z, turned, second, gradient, hessian, spare"
PYTHON = '''"""Statements about two frames, printed from their kinds."""

import numpy as np

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import angle_of, beyond, nearest_whole, select, square_root

{functions}

@njit(cache=True, apart=lambda kind, axes, z, *_: z.dtype, error_model="numpy")
def evaluate(kind, {takes}):
    """Evaluate a statement, of numbers or of vectors (`lane_items`), and return it.

    Parameters
    ----------
    kind, axes
        As in `Statement`.
    z
        Both frames, shape (2 d (d + 1),): m and 1.
    turned
        What an angle is nearest to, rad.
    second
        Whether second derivatives are wanted.
    gradient, hessian
        Results: g, shape (2 d (d + 1),), and ``dg_i/dz_j``; symmetric but for a pull.
    spare
        Work array, shape (2 d (d + 1),).
    """
    for i in range(z.shape[0]):
        gradient[i] = 0.0
        for j in range(z.shape[0] if second else 0):
            hessian[i, j] = 0.0
{cases}
    return 0.0 * z[0]


C = """{c}"""

COMPLETE = True
'''
C = """#define square_root(x) sqrt(x)
#define angle_of(y, x) atan2(y, x)
#define nearest_whole(x) floor((x) + 0.5)
#define select(which, x, y) ((which) ? (x) : (y))
#define beyond(x, y) (!((x) <= (y)))

{functions}
/* Value of a statement; gradient (2 N_FRAME) and, unless it is NULL, Hessian are filled. */
double evaluate_statement(const struct statement *of, const double z[2 * N_FRAME], double turned, double gradient[],
                          double (*hessian)[2 * N_FRAME]) {{
    double spare[2 * N_FRAME];
    memset(gradient, 0, 2 * N_FRAME * sizeof(double));
    if (hessian) memset(hessian, 0, 4 * N_FRAME * N_FRAME * sizeof(double));
{cases}
    return 0.0;
}}
"""


@dataclass(frozen=True)
class Kind:
    """A kind of statement."""

    name: str  # in code
    measure: str = ""  # the expression
    unit: str = "m"  # of the measure: m, 1 or rad
    periodic: bool = False  # whether it is an angle, of which the turn is taken that is nearest to one that is known
    singular: bool = False  # whether derivatives are taken as zero where its product is
    pull: str = ""  # no measure, but a force: the vector that pulls at the point of b
    sweep: bool = False  # no measure, but a force: the measure has two products, along ``q0 dq1 - q1 dq0``
    fixed: bool = False  # whether the gradient keeps its direction in the frames, however they stand
    limited: bool = False  # whether its first product counts within 0 and 1 alone
    generic: str = ""  # the kind with derivatives everywhere that this one has within limits

    def lines(self) -> list[str]:
        """Return the body of the function that evaluates it; ``let`` begins what C declares."""
        if self.pull:
            one = _Vector(self.pull)
            return [
                "for c in range(d):",
                *indented(one.component("x")),
                "    gradient[n + c] = x",
                "    if second:",
                *(f"        {loop}hessian[n + c, {at}] = {factor}" for loop, at, factor in one.entries("k")),
                "return 0.0 * z[0]",
            ]
        if self.sweep:
            return self._swept()
        products, outer = self._parts()
        touched = sorted({part for pair in products for one in pair for part in one.touched}) if outer else []
        lines = _first(products, touched)
        lines += self._outer(outer, len(products)) if outer else ["let s = q0"]
        curved = _second(products, touched)
        lines += ["if second:", *indented(curved)] if len(curved) > 1 else []
        for first, n_first in touched:
            mixed = " + ".join(f"f{m} * {ARRAYS[m]}[{first} + i]" for m in range(len(products)))
            lines += [f"for i in range({n_first}): gradient[{first} + i] = {mixed}"]
        turned = f" + {TURN} * nearest_whole((turned - s) / {TURN})" if self.periodic else ""
        return [*lines, f"return s{turned}"]

    def _swept(self) -> list[str]:
        """Return the body of the function of a pull along ``q0 dq1 - q1 dq0``, whose Hessian has a skew part."""
        products, _ = self._parts()
        touched = sorted({part for pair in products for one in pair for part in one.touched})
        lines = [*_first(products, touched), "let f0 = -q1", "let f1 = q0"]
        curved = _second(products, touched, outer=False)
        for (first, n_first), (then, n_then) in itertools.product(touched, repeat=2):
            one, other = f"{first} + i", f"{then} + j"
            skew = f"spare[{one}] * gradient[{other}] - gradient[{one}] * spare[{other}]"
            curved += [
                f"for i in range({n_first}):",
                f"    for j in range({n_then}): hessian[{one}, {other}] += {skew}",
            ]
        lines += ["if second:", *indented(curved)]
        for first, count in touched:
            mixed = f"f0 * gradient[{first} + i] + f1 * spare[{first} + i]"
            lines += [f"for i in range({count}): gradient[{first} + i] = {mixed}"]
        return [*lines, "return 0.0 * z[0]"]

    def _parts(self) -> tuple[list[tuple[_Vector, _Vector]], Any]:
        """Return the products, and the function of them in sympy's form; None where it is the only product itself."""
        import sympy as sp

        products: list[tuple[_Vector, _Vector]] = []

        def read(node: ast.expr) -> Any:
            if isinstance(node, ast.BinOp):
                return read(node.left) * read(node.right)
            if node.func.id == "dot":
                products.append(tuple(_Vector(ast.unparse(one)) for one in node.args))
                return sp.Symbol(f"q{len(products) - 1}", real=True)
            return {"sqrt": sp.sqrt, "atan2": sp.atan2, **LOCAL}[node.func.id](*map(read, node.args))

        outer = read(ast.parse(self.measure, mode="eval").body)
        return products, None if outer.is_Symbol else outer

    def _outer(self, outer: Any, n_products: int) -> Iterator[str]:
        """Yield the function of the products and its derivatives: s, f0, f1, f00, f01, .."""
        import sympy as sp

        q, s = sp.symbols(f"q:{n_products}", real=True), sp.Symbol("s", positive=True)
        named = {f"f{m}": sp.diff(outer, one) for m, one in enumerate(q)}
        pairs = itertools.combinations_with_replacement(range(n_products), 2)
        named |= {f"f{m}{k}": sp.diff(outer, q[m], q[k]) for m, k in pairs}
        if self.limited:
            yield "let within = select(beyond(q0, 0.0), select(beyond(q0, 1.0), 0.0, 1.0), 0.0)"
            yield "q0 = select(beyond(q0, 0.0), select(beyond(q0, 1.0), 1.0, q0), 0.0)"
        yield f"let s = {_text(outer)}"
        if outer.is_Pow:  # of a root, so that powers are whole
            named = {name: one.subs(q[0], s**2) for name, one in named.items()}
        shared, left = sp.cse([sp.simplify(one) for one in named.values()], sp.numbered_symbols("y"))
        yield from (f"let {name} = {_text(one)}" for name, one in shared)
        for name, one in zip(named, left):
            if self.singular:
                yield f"let {name} = select(beyond(q0, 0.0), {_text(one)}, 0.0)"
            else:
                yield f"let {name} = {'within * ' * (self.limited and '0' in name)}({_text(one)})"


def _first(products: Sequence[tuple[_Vector, _Vector]], touched: Sequence[tuple[str, str]]) -> list[str]:
    """Return what makes the products q0, .. and their derivatives, one in each of `ARRAYS`, all that is `touched`."""
    lines = [f"let q{m} = 0.0 * z[0]" for m in range(len(products))]
    for pair, array in zip(products, ARRAYS):
        others = [part for part in touched if not any(part in one.touched for one in pair)]
        lines += [f"for i in range({count}): {array}[{first} + i] = 0.0" for first, count in others]
    components = {one: f"x{k}" for k, one in enumerate(dict.fromkeys(itertools.chain(*products)))}
    body = [line for one, component in components.items() for line in one.component(component)]
    filled = set()
    for m, (pair, array) in enumerate(zip(products, ARRAYS)):
        body += [f"q{m} += {components[pair[0]]} * {components[pair[1]]}"]
        for one, other in dict.fromkeys((pair, pair[::-1])):
            for loop, at, factor in one.entries("k"):
                value = _times("2.0" if one == other else "1.0", factor, components[other])
                body += [f"{loop}{array}[{at}] {'+=' if (array, at) in filled else '='} {value}"]
                filled.add((array, at))
    return [*lines, "for c in range(d):", *indented(body)]


def _second(
    products: Sequence[tuple[_Vector, _Vector]], touched: Sequence[tuple[str, str]], outer: bool = True
) -> list[str]:
    """Return what adds up the second derivatives: those of products, and for functions of them what is `touched`."""
    lines, numbers = ["for c in range(d):"], range(len(products))
    for m, (x, y) in enumerate(products):
        pairs, factor = itertools.product(x.entries("k"), y.entries("j")), "1.0"
        if x == y:
            pairs, factor = itertools.combinations_with_replacement(x.entries("k"), 2), "2.0"
        for (loop, at, one), (inner, other, two) in pairs:
            value = _times(factor, one, two, f"f{m}" if touched else "1.0")
            lines += [f"    {loop}{inner}{_both(at, other, value, len(lines))}"]
    for (first, n_first), (then, n_then) in itertools.combinations_with_replacement(touched if outer else (), 2):
        lines += [f"for i in range({n_first}):"]
        for m in numbers:
            mixed = " + ".join(f"f{min(m, k)}{max(m, k)} * {ARRAYS[k]}[{first} + i]" for k in numbers)
            lines += [f"    let g{m} = {mixed}"]
        below, above = (" + ".join(f"g{m} * {ARRAYS[m]}[{then} + {at}]" for m in numbers) for at in "ij")
        if first == then:
            lines += [f"    {_both(f'{first} + i', f'{first} + i', below, len(lines))}"]
        both = _both(f"{first} + i", f"{then} + j", above, len(lines))
        lines += [f"    for j in range({'i' if first == then else n_then}): {both}"]
    return lines


@dataclass(frozen=True)
class _Vector:
    """A vector that is linear in the frames: ``p_b - p_a``, ``u_a`` or ``u``."""

    name: str

    @property
    def _direction(self) -> tuple[str, str, str]:
        """A direction's row among `axes`, its frame, and where that begins."""
        row, _, frame = self.name.partition("_")
        return f"axes[{'uvw'.index(row)}", frame, {"a": "0 + ", "b": "n + ", "": ""}[frame]

    @property
    def touched(self) -> list[tuple[str, str]]:
        """First number and count of what it depends on."""
        if self.name == APART:
            return [("0", "d"), ("n", "d")]
        _, frame, begin = self._direction
        return [(f"{begin}d", "d * d")] if frame else []

    def component(self, into: str) -> list[str]:
        """Return what makes its component c."""
        if self.name == APART:
            return [f"let {into} = z[n + c] - z[c]"]
        row, frame, begin = self._direction
        if not frame:
            return [f"let {into} = {row}, c]"]
        return [f"let {into} = 0.0 * z[0]", f"for k in range(d): {into} += {row}, k] * z[{begin}d + d * k + c]"]

    def entries(self, k: str) -> list[tuple[str, str, str]]:
        """Return a loop, the number that its component c depends on, and the factor of that."""
        if self.name == APART:
            return [("", "n + c", "1.0"), ("", "c", "-1.0")]
        row, frame, begin = self._direction
        return [(f"for {k} in range(d): ", f"{begin}d + d * {k} + c", f"{row}, {k}]")] if frame else []


def _both(one: str, other: str, value: str, number: int) -> str:
    """Return what adds a value to both sides of the diagonal."""
    if one == other:
        return f"hessian[{one}, {one}] += {value}"
    return f"let h{number} = {value}; hessian[{one}, {other}] += h{number}; hessian[{other}, {one}] += h{number}"


def _times(*factors: str) -> str:
    """Return a product of factors, some of which may be 1.0 or -1.0."""
    left = " * ".join(factor for factor in factors if factor not in ("1.0", "-1.0")) or "1.0"
    return f"-{left}" if factors.count("-1.0") % 2 else left


def _text(expression: Any) -> str:
    """Return an expression of numbers or vectors: no powers, no whole numbers."""
    from sympy.printing.pycode import PythonCodePrinter

    class Printer(PythonCodePrinter):
        def _print_Integer(self, one: Any) -> str:
            return f"{int(one)}.0"

        def _print_Rational(self, one: Any) -> str:
            return repr(float(one))

        def _print_Pow(self, one: Any, rational: bool = False) -> str:
            if float(one.exp) == 0.5:  # of sympy 1.13 and later no rational number is equal to 0.5
                return f"square_root({self._print(one.base)})"
            base = self._print(one.base)
            product = " * ".join([base if one.base.is_Symbol else f"({base})"] * abs(int(one.exp)))
            return f"({product})" if one.exp > 0 else f"1.0 / ({product})"

        def _print_atan2(self, one: Any) -> str:
            return f"angle_of({', '.join(map(self._print, one.args))})"

    return Printer().doprint(expression)


def _expanded(lines: Sequence[str]) -> Iterator[str]:
    """Yield lines with a loop in each line of its own."""
    for line in lines:
        depth = len(line) - len(line.lstrip())
        while loop := re.match(r"\s*(for \w+ in range\([^)]*\):) (.+)", line):
            yield " " * depth + loop[1]
            depth += 4
            line = loop[2]
        yield from (" " * depth + part.strip() for part in line.split("; "))


def _in_c(lines: Sequence[str]) -> Iterator[str]:
    for line in in_c(lines):
        line = re.sub(r"\[([^\[\],]+), ([^\[\]]+)\]", r"[\1][\2]", line)
        line = re.sub(r"\bd\b", "D", re.sub(r"\bn\b", "N_FRAME", line))
        yield line.replace("if (second)", "if (hessian)")


def print_kinds(kinds: Sequence[Kind]) -> str:
    """Return the module that evaluates statements of these kinds, with the text in C."""
    functions, in_c = [], []
    for kind in kinds:
        lines = [re.sub(r"\b0 \+ ", "", line) for line in indented(list(_expanded(kind.lines())))]
        name = kind.name.lower()
        head = ["    d = axes.shape[1]", "    n = d * (d + 1)"]
        body = [line.replace("let ", "", 1) for line in lines]
        # of several products is much code that few mechanisms call
        apart = "apart=lambda axes, z, *_: z.dtype, " * (kind.measure.count("dot(") > 1)
        top = ["", f'@njit(cache=True, {apart}error_model="numpy")', f"def _{name}({TAKES}):"]
        functions.append("\n".join([*top, *head, *body, ""]))
        takes = (
            "const double (*axes)[D], const double z[], double turned, double gradient[],\n"
            "    double (*hessian)[2 * N_FRAME], double spare[]"
        )
        unused = "    (void)axes, (void)turned, (void)gradient, (void)hessian, (void)spare;"
        in_c.append("\n".join([f"static double of_{name}({takes}) {{", unused, *_in_c(lines), "}", ""]))
    cases = [f"    if kind == {k}:\n        return _{kind.name.lower()}({TAKES})" for k, kind in enumerate(kinds)]
    of = "of->axes, z, turned, gradient, hessian, spare"
    cases_in_c = [f"    if (of->kind == {kind.name}) return of_{kind.name.lower()}({of});" for kind in kinds]
    c = C.format(functions="\n".join(in_c), cases="\n".join(cases_in_c))
    return PYTHON.format(functions="\n".join(functions), takes=TAKES, cases="\n".join(cases), c=c)


KINDS = (
    Kind("MEET", "dot(u, p_b - p_a)"),
    Kind("PERPENDICULAR", "dot(u_a, w_b)", unit="1"),
    Kind("WITHIN", "dot(v_b, w_b)", unit="1"),
    Kind("ALONG", "dot(u_a, p_b - p_a)"),
    Kind("ANGLE", "atan2(dot(v_a, w_b), dot(u_a, w_b))", unit="rad", periodic=True, fixed=True),
    Kind("DISTANCE", "sqrt(dot(p_b - p_a, p_b - p_a))", singular=True),
    Kind("FOLLOWING", pull="w_b", fixed=True),
    Kind("FADING", "fade(dot(u_a, p_b - p_a)) * dot(v_a, p_b - p_a)", limited=True, generic="FADING_EVERYWHERE"),
    Kind("BULGING", "bulge(dot(u_a, p_b - p_a)) * dot(v_a, w_b)", limited=True, generic="BULGING_EVERYWHERE"),
    Kind("FADING_EVERYWHERE", "dot(u_a, p_b - p_a) * dot(v_a, p_b - p_a)"),
    Kind("BULGING_EVERYWHERE", "dot(u_a, p_b - p_a) * dot(v_a, w_b)"),
    Kind("SWEEPING", "dot(u_a, p_b - p_a) * dot(v_a, p_b - p_a)", sweep=True),
)
NAMES = [kind.name for kind in KINDS]
MEET, PERPENDICULAR, WITHIN, ALONG, ANGLE, DISTANCE, FOLLOWING, FADING, BULGING, _, _, SWEEPING = range(len(KINDS))
U, V, W = range(3)  # rows of a statement's directions
_MARK = text_mark(*(f"pgmp_petsc.{name}" for name in ("mechanism.statements", "declare.forms", "declare.expressions")))
CODE = kept("statements", repr((_MARK, KINDS)), Path(__file__), lambda: print_kinds(KINDS))
evaluate = CODE.evaluate


@dataclass(frozen=True, eq=False)
class Function:
    """A function f of a statement s: a factor times s, or times a cubic spline of s that closes on itself.

    On piece k, from ``x = breaks[k]`` on, the spline is ``sum_j coefficients[k, j] (s - x)^j``, of s within the period
    that the breaks span; with a period of 0 it is one polynomial, of any s.
    """

    factor: float = 1.0
    breaks: np.ndarray = field(default_factory=lambda: np.zeros(0))  # shape (n + 1,), rad; none where it is linear
    coefficients: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))  # shape (n, 4)

    @classmethod
    def square(cls) -> Function:
        """Return the square of s."""
        return cls(1.0, np.zeros(2), np.array([[0.0, 0.0, 1.0, 0.0]]))

    @classmethod
    def through(cls, factor: float, table: Sequence[tuple[float, float]]) -> Function:
        """Return a factor times the spline through points, the last of which is the first one after a period."""
        x, y = np.array(table, dtype=float).T
        found = scipy.interpolate.CubicSpline(x, np.append(y[:-1], y[0]), bc_type="periodic")
        return cls(factor, x, np.ascontiguousarray(found.c[::-1].T))

    def at(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray | float]:
        """Return f and df/ds at values of s (n,)."""
        if not self.breaks.size:
            return self.factor * s, self.factor
        first, period = self.breaks[0], self.breaks[-1] - self.breaks[0]
        within = first + (s - first) % period if period else s
        piece = np.searchsorted(self.breaks[1:-1], within, side="right")
        c, x = self.factor * self.coefficients[piece].T, within - self.breaks[piece]
        return c[0] + x * (c[1] + x * (c[2] + x * c[3])), c[1] + x * (2.0 * c[2] + x * 3.0 * c[3])

    @property
    def generic(self) -> Function:
        """A function none of whose derivatives is zero where this one's may be other than zero."""
        bent = np.zeros_like(self.coefficients)
        bent[:, 1:3] = 1.0
        return Function(1.0, self.breaks, bent)


IDENTITY = Function()


@dataclass(frozen=True)
class Line:
    """A motion (rad or m) as a line over others: ``offset + sum_k slope_k s_k``."""

    offset: float
    slopes: Mapping[Statement, float]


@dataclass(frozen=True, eq=False)
class Combination:
    """``sum_i f_i(s_i)`` of statements, each about a pair of frames of its own, one pair after the other."""

    terms: tuple[tuple[Statement, Function], ...]
    #: what motions that follow from the coordinates are near to, as those behind a row of gears
    lines: Mapping[Statement, Line] = field(default_factory=dict)

    @property
    def is_length(self) -> bool:
        """Whether it is measured in m, as its first term is."""
        return self.terms[0][0].is_length

    @property
    def fixed_in_bodies(self) -> bool:
        """Whether its gradient keeps its direction in the frames of all its terms, however they stand."""
        return all(part.fixed_in_bodies and not function.breaks.size for part, function in self.terms)


@dataclass(frozen=True, eq=False)
class Statement:
    """A statement about two frames."""

    kind: int  # its number among `KINDS`
    #: the directions u, v and w, shape (3, d), in the frames that the kind says; zero where it has none
    axes: np.ndarray
    lines: ClassVar[Mapping[Statement, Line]] = {}  # as of a `Combination`

    @property
    def terms(self) -> tuple[tuple[Statement, Function], ...]:
        """Itself, as the only term of a `Combination`."""
        return ((self, IDENTITY),)

    @property
    def generic(self) -> Statement:
        """A statement none of whose derivatives is zero where this one's may be other than zero."""
        generic = KINDS[self.kind].generic
        return Statement(NAMES.index(generic), self.axes) if generic else self

    @property
    def is_length(self) -> bool:
        """Whether it is measured in m; others are cosines or rad."""
        return KINDS[self.kind].unit == "m"

    @property
    def fixed_in_bodies(self) -> bool:
        """Whether its gradient keeps its direction in the frames, however they stand."""
        return KINDS[self.kind].fixed

    def value(self, a: np.ndarray, b: np.ndarray, turned: np.ndarray | float = 0.0) -> np.ndarray:
        """Return s, shape (...), m, 1 or rad, for frames of shape (d (d + 1) or more, ...).

        An angle is nearest to `turned`, which broadcasts against s, rad.
        """
        return self._evaluated(a, b, 0, turned)[0]

    def gradient(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return ds/d(a, b), shape (2 d (d + 1), ...)."""
        return self._evaluated(a, b, 1)[1]

    def hessian(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the derivative of the gradient, shape (2 d (d + 1), 2 d (d + 1), ...)."""
        return self._evaluated(a, b, 2)[2]

    def _evaluated(
        self, a: np.ndarray, b: np.ndarray, order: int, turned: np.ndarray | float = 0.0
    ) -> tuple[np.ndarray, ...]:
        """Return s and its derivatives up to `order`."""
        n, trailing = n_frame(self.axes.shape[1]), a.shape[1:]
        z = np.concatenate([a[:n].reshape(n, -1), b[:n].reshape(n, -1)]).astype(float, order="C")
        turned, m = np.full(trailing, turned, dtype=float).reshape(-1), z.shape[1]
        parts = np.empty(m), np.empty((2 * n, m * (order > 0))), np.empty((2 * n, 2 * n, m * (order > 1)))
        _evaluate_all(self.kind, self.axes, z, turned, *parts)
        return tuple(part.reshape((*part.shape[:-1], *trailing)) for part in parts[: order + 1])


def n_frame(dimension: int) -> int:
    """Return how many numbers a frame has in 2 or 3 dimensions."""
    return dimension * (dimension + 1)


def meet(axis: np.ndarray) -> Statement:
    """Return how far b is from a along an axis (d,) of the ground."""
    return _statement(MEET, u=axis)


def perpendicular(u: np.ndarray, w: np.ndarray) -> Statement:
    """Return the cosine between unit directions (d,) in a and in b."""
    return _statement(PERPENDICULAR, u=u, w=w)


def within(v: np.ndarray, w: np.ndarray) -> Statement:
    """Return the product of two directions (d,) in b."""
    return _statement(WITHIN, v=v, w=w)


def along(axis: np.ndarray) -> Statement:
    """Return how far b is from a along an axis (d,) that is fixed in a; its length does not matter."""
    return _statement(ALONG, u=np.asarray(axis, dtype=float) / np.linalg.norm(axis))


def fading(reach: np.ndarray, v: np.ndarray) -> Statement:
    """Return how far b is from a along a direction v (d,) in a, times a weight that falls from 1 to 0 as b moves from a
    to the end of a vector (d,) in a: Hermite's, ``1 - 3 x^2 + 2 x^3``."""
    return _statement(FADING, u=reach / (reach @ reach), v=v)


def bulging(reach: np.ndarray, v: np.ndarray, w: np.ndarray) -> Statement:
    """Return the cosine between unit directions (d,) in a and in b, times ``2 x^2 (1 - x)^2``, x as in `fading`."""
    return _statement(BULGING, u=reach / (reach @ reach), v=v, w=w)


def angle(in_a: np.ndarray, in_b: np.ndarray) -> Statement:
    """Return how far b is turned against a about the first axis of triads (3, 3), one axis a column.

    In the plane the triads are the axes x and y, (2, 2).
    """
    second, third = in_a[:, -2], in_a[:, -1]
    return _statement(ANGLE, u=second, v=third, w=in_b[:, -2])


def distance(dimension: int) -> Statement:
    return _statement(DISTANCE, u=np.zeros(dimension))


def following(axis: np.ndarray) -> Statement:
    """Return a direction (d,) that turns with b; its length does not matter."""
    return _statement(FOLLOWING, w=np.asarray(axis, dtype=float) / np.linalg.norm(axis))


def sweeping(u: np.ndarray, v: np.ndarray) -> Statement:
    """Return a pull across the way from a to b in the plane of directions u and v (d,) in a, times that way: its rate
    is twice the area that b sweeps in a second."""
    return _statement(SWEEPING, u=u, v=v)


def _statement(kind: int, **directions: np.ndarray) -> Statement:
    axes = np.zeros((3, len(next(iter(directions.values())))))
    for name, direction in directions.items():
        axes["uvw".index(name)] = direction
    return Statement(kind, axes)


@njit(cache=True, entry=True, error_model="numpy")
def _evaluate_all(kind, axes, z, turned, values, gradients, hessians):
    """Evaluate a statement at pairs of frames, the columns of z; derivatives without columns are not wanted."""
    gradient, hessian, spare = np.empty(z.shape[0]), np.empty((z.shape[0], z.shape[0])), np.empty(z.shape[0])
    first, second = gradients.shape[1] > 0, hessians.shape[2] > 0
    n = gradient.size
    for k in range(z.shape[1]):
        values[k] = evaluate(kind, axes, z[:, k].copy(), turned[k], second, gradient, hessian, spare)
        # number by number: what an array put into another would say of their shapes takes seconds to compile
        for i in range(n if first else 0):
            gradients[i, k] = gradient[i]
            for j in range(n if second else 0):
                hessians[i, j, k] = hessian[i, j]
