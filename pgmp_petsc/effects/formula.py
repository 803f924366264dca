"""A law that a scene writes as a formula: on the motion in a joint, or on the distance of two points.

``force = "A * sin(12 * s) - c * v - m0 * (t > 0.1)"`` is parsed, and never evaluated: what it may have is in
`OPERATIONS` and `FUNCTIONS`. It is written anew in the language of declarations (`declare.expressions`), and from there
on it is a law as all others: compiled, differentiated, printed in C. A comparison is 1 where it holds, else 0;
derivatives leave out its jump, and steps do not end there. The time is the `amplitude` of the law, of which the
function of time is t itself. All of the force is counted as work: the law has no potential, and no part in the
stiffness of vibrations.
"""

from __future__ import annotations

import ast
import hashlib
import math
import operator
from collections.abc import Iterator
from functools import cache
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from pgmp_petsc.base.errors import nearest_name, shortened
from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.joint_effects import place_of
from pgmp_petsc.effects.law import Law
from pgmp_petsc.effects.over_joint import led_over
from pgmp_petsc.effects.time_function import Piece, TimeFunction
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import OnJoint, OverMotion
from pgmp_petsc.scene.fields import Connection, NumberOrParameter, Unit, exactly_one, refusal
from pgmp_petsc.scene.references import over_problems
from pgmp_petsc.scene.uses import Use

#: Names of the state in a formula, and what they are in a law.
STATE = {"s": "s", "v": "rate", "t": "amplitude"}
LONGEST, MOST = 1000, 20_000  # characters, and of what is made of them
LARGEST_POWER = 20  # whole exponents up to it are products, all others powers of positive numbers
TIME = TimeFunction(Piece(cubic=(0.0, 1.0)))
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
ALLOWED = (
    f"a formula has numbers, {', '.join(STATE)}, the names of `constants`, + - * / **, the comparisons < <= > >= and "
    f"the functions {', '.join(FUNCTIONS)}"
)


class FormulaError(ValueError):
    """What a formula must not have."""


def declared(text: str, names: tuple[str, ...]) -> tuple[str, set[str]]:
    """Return a formula in the language of declarations, and which names it has.

    Raises `FormulaError` where it has what is not allowed.
    """
    if len(text) > LONGEST:
        raise FormulaError(f"has {len(text)} characters; at most {LONGEST} are taken")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        why = error.msg if isinstance(error, SyntaxError) else "nested too deeply"
        raise FormulaError(f"is no formula ({why}); {ALLOWED}") from None
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
                if name not in STATE and name not in names:
                    hint = nearest_name(name, (*STATE, *names))
                    raise FormulaError(f"names '{shortened(name, 40)}', which is not known{hint}; {ALLOWED}")
                used.add(name)
                return STATE.get(name) or constant(name)
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
                    raise FormulaError(f"calls '{shortened(name, 40)}', which is no function{hint}; {ALLOWED}")
                n, form = FUNCTIONS[name]
                if len(arguments) != n:
                    raise FormulaError(f"gives {name} {len(arguments)} arguments; it takes {n}")
                if name == "where":
                    test, *rest = arguments
                    return form.format(condition=condition(test), **dict(zip("yz", map(number, rest))))
                return form.format(**dict(zip("xy", map(number, arguments))))
        raise FormulaError(f"has '{ast.unparse(node)}'; {ALLOWED}")

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
            raise FormulaError(f"has '{ast.unparse(node)}'; {ALLOWED}")
        ends = map(number, (node.left, *node.comparators))
        first = next(ends)
        return f"({first}{''.join(f' {OPERATIONS[type(op)]} {end}' for op, end in zip(node.ops, ends))})"

    try:
        return number(tree), used
    except RecursionError:
        raise FormulaError("is nested too deeply") from None


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
        raise FormulaError(f"has {ast.unparse(node)}, which is no finite number")
    return value


def constant(name: str) -> str:
    """Return what a constant is called in a law."""
    return f"of_{name}"


class Formula(Law):
    """The law of a formula; where it is finite depends on its constants, and is looked at with a scene."""

    linear_stiffness = ""

    def _check_finite(self, code: Any) -> None:
        """Any formula is fine here."""


@cache
def law_of(force: str, constants: tuple[str, ...]) -> Formula:
    """Return the law of a formula in the language of declarations; one for all effects with the same."""
    mark = hashlib.sha256(repr((force, constants)).encode()).hexdigest()[:12]
    left_out = "it is a formula, whose force is no stiffness of vibrations; a spring_damper has one"
    return Formula(f"formula_{mark}", tuple(map(constant, constants)), force=force, left_out=left_out)


class FormulaEffect(OnJoint):
    """A torque or force by a formula of the motion in a joint, or of the distance of two points, and of the time; or of
    the motion in another joint.
    """

    type: Literal["law"]
    acts = "forces"
    joints = ("turning", "sliding")
    changeable = ("force", "constants")
    strength_unit = "s"  # of what its law has over time, which is the time
    local = True
    edged = True
    joint: str | None = Field(None, description="name of a joint that turns or slides")
    points: Connection | None = Field(None, description='two points, "body:point" or "ground:point"')
    over: str | None = Field(
        None, description="name of a joint that turns or slides: s and v are of that, in place of what it acts on"
    )
    over_motion: OverMotion = None
    force: str = Field(
        description="formula of the torque (N m) or force (N) that makes s larger: s (rad or m), its rate v, the time "
        "t (s) and `constants`; + - * / **, comparisons (1 or 0), sin cos tan exp log sqrt abs tanh sign min max atan2 "
        "where"
    )
    constants: dict[str, Annotated[NumberOrParameter, Unit()]] = Field(
        {}, description="names in the formula, each a number or a parameter's name"
    )

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        exactly_one(self, "joint", "points")
        return self

    @model_validator(mode="after")
    def _is_formula(self) -> Self:
        for name in self.constants:
            if not (name.isidentifier() and name.isascii()) or name in STATE or name in FUNCTIONS:
                words = f"'{name}' cannot be a name in a formula: take letters, digits and _, and no name that it has"
                raise refusal(words, "constants")
        try:
            _, used = declared(self.force, tuple(self.constants))
        except FormulaError as error:
            raise refusal(str(error), "force") from None
        unused = [name for name in self.constants if name not in used]
        if unused:
            raise refusal(f"the formula does not name '{unused[0]}'; leave it out", "constants")
        return self

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        """Yield a line if there is no such joint as its s is of."""
        return over_problems(scene, f"effects.{name}", self)

    def uses(self, entry: str, turns: bool) -> Iterator[Use]:
        """Yield the constants, which may be of any unit."""
        for name, value in self.constants.items():
            yield Use(f"{entry}.constants.{name}", value, "any", ())

    def forces(self, name: str, mechanism: Mechanism) -> ActionEffect:
        """Return the law on the joint's motion, or on the distance."""
        text, used = declared(self.force, tuple(self.constants))
        names = tuple(sorted(self.constants))
        parameters = tuple(Quantity.of(self.constants[one]) for one in names)
        time, place = TIME if "t" in used else None, place_of(mechanism, name, self)
        action = Action(name, law=law_of(text, names), parameters=parameters, amplitude=time, **place)
        return ActionEffect(name, led_over(self, mechanism, action), mechanism)


def not_finite(action: Action, s: float, v: float, values: dict[str, float]) -> str:
    """Return why a formula has no finite force or derivative in a state at time zero; empty where it has."""
    try:
        found = action.law.evaluate([float(quantity.at(values)) for quantity in action.parameters], s, v)
    except ZeroDivisionError:
        return "it divides by zero"
    except (ArithmeticError, ValueError, TypeError):
        return "it is not finite"
    numbers = (found.force, found.stiffness, found.damping)
    fine = all(isinstance(one, float) and math.isfinite(one) for one in numbers)
    return "" if fine else "it, or a derivative of it, is not finite"
