"""Laws that a scene writes: formulas on a joint's motion or the distance of two points, and tables over a motion.

``force = "A * sin(12 * s) - c * v - m0 * (t > 0.1)"`` is parsed, and never evaluated: what it may have is in
`declare.formulas`. It is written anew in the language of declarations (`declare.expressions`), and from there on it is
a law as all others: compiled, differentiated, printed in C. A comparison is 1 where it holds, else 0; derivatives leave
out its jump, and steps do not end there. The time is the `amplitude` of the law, of which the function of time is t
itself. All of the force is counted as work: the law has no potential, and no part in the stiffness of vibrations.

A load over the motion of a joint is a table of torques or forces over an angle, or over a way. It is linear between the
rows, and constant beyond them; a table over a whole turn of an angle goes on for ever, and so does one over several
turns whose ends are equal, as of an engine of four strokes. The law is printed with its table, and is one law as all
others; all of its force is counted as work. Over the motion of another joint than it acts on, it is led by that
(`effects.action`).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import Field

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.declare.formulas import ALLOWED, FormulaError, declared, in_si, jumps_with, turns_at_once, why_no_name
from pgmp_petsc.effects.action import NOTHING, Action, place_of
from pgmp_petsc.effects.effect import ActionEffect
from pgmp_petsc.effects.law import Law
from pgmp_petsc.effects.time_function import Piece, TimeFunction
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import OnJoint, OverMotion, OverTime
from pgmp_petsc.scene.fields import Connection, NumberOrParameter, Rows, Unit, refusal
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.references import load_problems, over_problems
from pgmp_petsc.scene.units import own_powers
from pgmp_petsc.scene.uses import motion_over, slides, slides_over

TURN = 2.0 * math.pi
CLOSED = 1e-9  # rad that whole turns may be off, and of the largest value that its ends may differ by
PYTHON = '''"""A law over a table: its places, and values and slopes from each of them on."""

from math import floor

import numpy as np

STIFFNESS = ""
PLACES = np.array([{places}])
VALUES = np.array([{values}])
SLOPES = np.array([{slopes}])


def evaluate(p, amplitude, s, rate, about, depths):
{find}
    force = VALUES[low] + SLOPES[low] * (x - PLACES[low])
    return float(p[0] * force), float(-p[0] * SLOPES[low]), 0.0, 0.0, 0.0, float(rate)


def slopes(p, amplitude, s, rate, found):
{find}
    found[0] = VALUES[low] + SLOPES[low] * (x - PLACES[low])
    found[1] = 0.0
    return 0.0


def edges(p, s):
    return ()


C = """static void law_{name}(const double p[], double amplitude, double s, double rate, double about,
                                 double found[]) {{
    static const double places[] = {{{places}}};
    static const double values[] = {{{values}}};
    static const double slopes[] = {{{slopes}}};
    const double x = s - {period} * floor((s - {first}) / {turn});
    int low = 0, high = {n};
    (void)amplitude, (void)about;
    while (high - low > 1) {{
        const int middle = (low + high) / 2;
        if (x >= places[middle]) low = middle;
        else high = middle;
    }}
    found[0] = p[0] * (values[low] + slopes[low] * (x - places[low]));
    found[1] = -p[0] * slopes[low];
    found[2] = 0.0;
    found[3] = rate;
}}"""

COMPLETE = True
'''
FIND = """    x = s - {period} * floor((s - {first}) / {turn})
    low, high = 0, {n}
    while high - low > 1:
        middle = (low + high) // 2
        if x >= PLACES[middle]:
            low = middle
        else:
            high = middle"""


def turns_of(rows: Rows) -> int | None:
    """Return after how many turns a table over an angle begins again, 0 if it does not; None if it is one turn long,
    and its ends differ."""
    (first, value), (last, final) = rows[0], rows[-1]
    turns = round((last - first) / TURN)
    if abs(last - first - turns * TURN) > CLOSED:
        return 0
    closed = value == final
    if not closed and not isinstance(value, str) and not isinstance(final, str):
        closed = abs(final - value) <= CLOSED * max(abs(one) for _, one in rows if not isinstance(one, str))
    return turns if closed else None if turns == 1 else 0


def turns_over(scene: Scene, entry: OverTime) -> int | None:
    """Return the `turns_of` the table of a load over a joint; 0 if what it is over slides."""
    return turns_of(entry.table) if motion_over(scene, entry) == "turning" else 0


class TableLaw(Law):
    """A law over a table, whose code is given."""

    linear_stiffness, bends = "", False

    def _printed(self) -> str:
        return self.text


@cache
def table_law(rows: Rows, turns: int) -> TableLaw:
    """Return the law of a table that begins again after some turns, or does not (0); one for all effects with the
    same."""
    name = f"table_{hashlib.sha256(repr((rows, turns, PYTHON, FIND)).encode()).hexdigest()[:12]}"
    law = TableLaw(name, ("scale",), force="scale", left_out="it is a table over a joint, not linear")
    places, values = [x for x, _ in rows], [y for _, y in rows]
    slopes = [(b - a) / (x - w) for a, b, w, x in zip(values, values[1:], places, places[1:])]
    if not turns:  # before the first row too it is constant
        places, values, slopes = [places[0] - 1.0, *places], [values[0], *values], [0.0, *slopes, 0.0]
    else:
        places, values = places[:-1], values[:-1]
    numbers = (", ".join(map(repr, part)) for part in (places, values, slopes))
    turn = dict(period=turns * TURN, first=rows[0][0], turn=(turns or 1) * TURN, n=len(slopes), name=name)
    text = PYTHON.format(find=FIND.format(**turn), **dict(zip(("places", "values", "slopes"), numbers)), **turn)
    object.__setattr__(law, "text", text)
    return law


def led_over(entry: Any, mechanism: Mechanism, action: Action) -> list[Action]:
    """Return the action of an effect, behind the one that leads it if it is over another motion than it acts on."""
    if entry.over is None:
        return [action]
    motion = motion_over(mechanism.scene, entry)
    if entry.over == entry.joint and (motion == "sliding") == slides(mechanism.scene, entry):
        return [action]
    leading = mechanism.connection(entry.over).motion(motion)
    return [Action(action.effect, law=NOTHING, parameters=(), **leading), replace(action, led=True)]


def load_over_joint(
    name: str, entry: OverTime, mechanism: Mechanism, place: dict[str, Any], scale: Quantity
) -> ActionEffect:
    """Return a load whose table is over the motion of a joint; `place` is what it acts on, as `Action` takes it."""
    law = table_law(entry.table, turns_over(mechanism.scene, entry))
    action = Action(name, law=law, parameters=(scale,), **place)
    return ActionEffect(name, led_over(entry, mechanism, action), mechanism)


def load_over_problems(scene: Scene, name: str, entry: OverTime) -> Iterator[str]:
    """Yield a line for what does not fit a load over time, or over the motion of a joint."""
    found = list(over_problems(scene, f"effects.{name}", entry))
    yield from found
    if entry.over is None:
        yield from load_problems(scene, name, entry)
    elif entry.table is None:
        yield problem(f"effects.{name}.over", "needs a table; a harmonic is over time", entry.over)
    elif not found and turns_over(scene, entry) is None:
        yield problem(f"effects.{name}.table", "is over a whole turn, and its ends differ; it has to close")


#: Names of the state in a formula, and what they are in a law.
STATE = {"s": "s", "v": "rate", "t": "amplitude"}
TIME = TimeFunction(Piece(cubic=(0.0, 1.0)))
WORDS = f"{', '.join(STATE)}, the names of `constants`"


def known(constants: Iterable[str]) -> dict[str, str]:
    """Return the names of a formula, and what they are in its law."""
    return STATE | {name: constant(name) for name in constants}


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
    one_of = ("joint", "points")
    changeable = ("force", "constants")
    strength_unit = "s"  # of what its law has over time, which is the time
    joint: str | None = Field(None, description="name of a joint that turns or slides")
    points: Connection | None = Field(None, description='two points, "body:point" or "ground:point"')
    over: str | None = Field(
        None, description="name of a joint that turns or slides: s and v are of that, in place of what it acts on"
    )
    over_motion: OverMotion = None
    force: str = Field(
        description="formula of the torque (N m) or force (N) that makes s larger, of s in rad or m, its rate v, the "
        f"time t and `constants`; {ALLOWED}"
    )
    constants: dict[str, Annotated[NumberOrParameter, Unit()]] = Field(
        {}, description="names in the formula, each a number or a parameter's name"
    )

    @property
    def jumps_with(self) -> frozenset[str]:
        """Names in its comparisons and signs."""
        return jumps_with(self.force)

    @property
    def edged(self) -> bool:
        """Whether it may turn within a step."""
        return turns_at_once(self.force)

    def check_entries(self) -> None:
        for name in self.constants:
            if why := why_no_name(name, STATE):
                raise refusal(why, "constants")
        try:
            _, used = declared(self.force, known(self.constants), WORDS)
        except FormulaError as error:
            raise refusal(str(error), "force") from None
        unused = [name for name in self.constants if name not in used]
        if unused:
            raise refusal(f"the formula does not name '{unused[0]}'; leave it out", "constants")

    def problems(self, scene: Scene, name: str) -> Iterator[str]:
        return over_problems(scene, f"effects.{name}", self)

    def forces(self, name: str, mechanism: Mechanism) -> ActionEffect:
        """Return the law on the joint's motion, or on the distance, in SI units."""
        scene, acts = mechanism.scene, slides(mechanism.scene, self)
        text, used = declared(self.force, known(self.constants), WORDS)
        power_of, constants = scene.system.power_of, {constant(one): value for one, value in self.constants.items()}
        powers = dict.fromkeys(("s", "rate"), power_of("m" if slides_over(scene, self) else "rad")) | {STATE["t"]: 0}
        found = in_si(
            {"force": text}, powers | own_powers(scene, constants), {"force": power_of("N" if acts else "N m")}
        )
        names = tuple(sorted(self.constants))
        parameters = tuple(Quantity.of(found.number(constant(one), self.constants[one])) for one in names)
        time, place = TIME if "t" in used else None, place_of(mechanism, name, self)
        action = Action(name, law=law_of(found.texts["force"], names), parameters=parameters, amplitude=time, **place)
        return ActionEffect(name, led_over(self, mechanism, action), mechanism)


def not_finite(action: Action, s: float, v: float, values: dict[str, float]) -> str:
    """Return why a formula has no finite force or derivative in a state at time zero; empty where it has."""
    found = action.law.evaluate([float(quantity.at(values)) for quantity in action.parameters], s, v)
    if all(map(math.isfinite, (found.force, found.stiffness, found.damping))):
        return ""
    return "a derivative of it is not finite" if math.isfinite(found.force) else "it is not finite"
