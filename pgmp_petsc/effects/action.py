"""Local effects: a force law on a statement about two frames, or on a combination of statements.

Torques and forces that keep their direction are loads (`effect.Load`); what depends on the state acts locally, on the
frames of two attachments, and is described once for the full-order and the reduced model, in the plane and in space: an
`Action` is a statement s (`mechanism.statements`), the two attachments and a law F(t, s, s') (`law`). With the
statement's gradient g the frames feel ``F g``, and the power is ``F s'`` in every model alike. The full-order model
gives the frames from its unknowns, the reduced one from its coordinates.

A force that hangs on another motion than the one that it acts on is two actions, one after the other: the first one
leads, which is that it measures s and does nothing, and the law of the second one is led by it, ``F(t, s_1, s_1')``
along g_2. With ``k = -dF/ds_1`` and ``c = -dF/ds_1'`` its tangent is ``g_2 (k + gain_v c) g_1^T - F h_2``, which is
not symmetric, and its power ``F s_2'``. Friction of a force that hangs on another motion *rubs*: its law is ``F(s_1,
s_1', s_2')`` along g_2, with s_1' as its amplitude and s_2' as its rate.
"""

from __future__ import annotations

import math
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from pgmp_petsc.bodies.affine import AffineSum, Quantity
from pgmp_petsc.effects.law import TRIED, Law, Laws
from pgmp_petsc.effects.time_function import TimeFunction
from pgmp_petsc.mechanism.joints import Attachment
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.statement_rows import NodeStatements, StatementRows
from pgmp_petsc.mechanism.statements import ANGLE, Combination, Statement, distance
from pgmp_petsc.scene.effects import ActionMismatch
from pgmp_petsc.scene.uses import MEASURED

# Laws of several effects; that of one is in its file, and that of a plugin is another such object. Friction is
# regularised: its force is smooth.

SOURCE = Law("source", ("scale",), force="amplitude * scale")

SPRING_DAMPER = Law(
    "spring_damper",
    ("k", "c", "rest"),
    potential="k * (s - rest)**2 / 2",
    force="elastic - c * rate",
    left_out="it is a damper, and modes are those of undamped vibrations",
)

FRICTION = Law(
    "friction",
    ("limit", "speed"),
    force="-limit * tanh(rate / speed)",
    left_out="it is friction, not linear and without stiffness",
)

# Where a law is tried beside an edge, as shares of s: what is continuous differs less there, the closer it is.
BESIDE = (1e-10, 1e-9)
SMALL = 1e-9  # of a force, what round-off leaves of it
CLOSE, MOST_ITERATIONS = 1e-13, 20  # of s, how near an edge is found, and in how many steps
ALONE, LEADS, LED, BY_LOAD = range(4)  # whose measure a law is of: see `Action.role`
NOTHING = Law("nothing", (), force="0")  # of an action that leads


@dataclass(frozen=True, eq=False)
class Action:
    """A force law on a statement about two attachments.

    Raises `ActionMismatch` if it is about other frames than are given, or the law has other parameters; with the file
    and line of who makes the action.
    """

    effect: str  # name of the effect that it belongs to
    statement: Statement | Combination  # what is measured
    #: a, b: the attachments whose frames are measured, by a combination those of its first term
    a: Attachment
    b: Attachment
    law: Law  # the law
    parameters: tuple[Quantity | AffineSum, ...]  # of the law, in its order
    amplitude: TimeFunction | None = None  # of a source over time, s; None for other laws
    further: tuple[Attachment, ...] = ()  # a pair for each further term of a combination
    led: bool = False  # whether its law is of the measure of the action before it
    by_load: bool = False  # whether its law is of the measure and the rate of the action before it, and of its own rate

    def __post_init__(self) -> None:
        law, given = self.law, self.parameters
        what, dimensions = f"law {law.name} ({law.place})", set()
        if isinstance(self.a, Attachment):
            dimensions = {side.point.size for side in self.sides} | {s.axes.shape[1] for s, _ in self.statement.terms}
        if len(given) != len(law.parameters):
            why = f"{what} has the parameters {', '.join(law.parameters)}, and is given {len(given)}; give one for each"
        elif odd := [one for one in given if not isinstance(one, (Quantity, AffineSum))]:
            why = f"{what} is given {odd[0]!r}; a parameter is a Quantity, such as Quantity.of(self.stiffness)"
        elif len(dimensions) > 1:
            why = "directions have 2 numbers in the plane, 3 in space; mechanism.space.dimension says where it is"
        elif dimensions and len(self.sides) != 2 * len(self.statement.terms):
            why = f"{len(self.statement.terms)} terms are about {len(self.sides)} points; give two for each (further)"
        else:
            return
        maker = sys._getframe(2)
        while maker.f_back is not None and maker.f_globals.get("__name__") == "pgmp_petsc.effects.effect":
            maker = maker.f_back  # of who has them made of laws
        raise ActionMismatch(f"{maker.f_code.co_filename}:{maker.f_lineno}: effects.{self.effect}: {why}")

    @property
    def sides(self) -> tuple[Attachment, ...]:
        """Both attachments, of a combination a pair for each term."""
        return self.a, self.b, *self.further

    @property
    def pairs(self) -> list[tuple[Attachment, Attachment]]:
        """The attachments of each term."""
        return list(zip(self.sides[::2], self.sides[1::2]))

    @property
    def leads(self) -> bool:
        """Whether it does nothing but measure, for the law of the action behind it."""
        return self.law is NOTHING

    @property
    def role(self) -> int:
        """`ALONE`, `LEADS`, `LED` or `BY_LOAD`."""
        return LEADS if self.leads else LED if self.led else BY_LOAD if self.by_load else ALONE

    @property
    def stiffness(self) -> Quantity | None:
        """That of a law that is linear, whatever its damping; None where there is none."""
        name = "" if self.led else self.law.linear_stiffness
        found = self.parameters[self.law.parameters.index(name)] if name else None
        return found if found is not None and found.coefficient != 0.0 else None

    @cached_property
    def reads_rate(self) -> bool:
        """Whether its force hangs on the rate of its measure: that of a linear spring without a damper does not."""
        if not self.law.linear_stiffness:
            return True
        anything = defaultdict(np.random.default_rng(0).random)  # a number for each name: none cancels another
        return self.law.evaluate([parameter.at(anything) for parameter in self.parameters], 0.0).damping != 0.0


#: what jumps, by the part of `Found`, and what follows
JUMPS = {
    "force": (
        "force",
        "errors then fall as the step, not as its square, and derivatives may have no value there; let what sets in "
        "grow from zero, such as a damping with the depth",
    ),
    "stored": ("potential", "energies are then out of balance; let its parts meet there"),
}


def jump_of(action: Action, p: Sequence[float]) -> str:
    """Return at which of its edges the force or the potential of a law, with parameters p, jumps, in words, and what
    follows; "" where neither does anywhere."""
    law = action.law
    for number, edge in enumerate(law.edges):
        s = _place_of(law, number, p)
        for rate in TRIED if s is not None else ():
            near, far = (
                [law.evaluate(p, s + side * way * max(1.0, abs(s)), rate, 1.0) for side in (-1.0, 1.0)]
                for way in BESIDE
            )
            for part, (what, follows) in JUMPS.items():
                (low, high), (before, behind) = ([getattr(one, part) for one in pair] for pair in (near, far))
                if abs(high - low) > max(0.5 * abs(behind - before), SMALL * max(abs(low), abs(high))):
                    where = f"at the edge '{edge}' = 0 of its law {law.name} ({law.place}), s = {s:.6g}"
                    jump = f"its {what} jumps from {low:.6g} to {high:.6g} at a rate of {rate:g} (SI units)"
                    return f"{where}, {jump}; {follows}"
    return ""


def _place_of(law: Law, number: int, p: Sequence[float]) -> float | None:
    """Return a measure at which an edge of a law is, by Newton's method; None if none is found."""
    for s in (0.0, *p, *(-x for x in p)):
        for _ in range(MOST_ITERATIONS):
            depth, slope = law.depths(p, s)[number], law.edge_slopes(number, p, s)[0]
            if not (slope and math.isfinite(depth / slope)):
                break
            if abs(depth) <= CLOSE * abs(slope) * max(1.0, abs(s)):
                return s
            s -= depth / slope
    return None


class Actions(NamedTuple):
    """Local effects of a batch of samples, as compiled functions take them."""

    statements: NodeStatements  # what they measure, term after term
    laws: Laws  # the laws
    parameters: np.ndarray  # of the laws, shape (n_actions, n_samples, n_parameters), those of the law that has most
    roles: np.ndarray  # `Action.role` of each, shape (n_actions,)
    firsts: np.ndarray  # first term of each, shape (n_actions + 1,): a measure is the sum of its terms


def compile_actions(
    actions: Sequence[Action], values: Mapping[str, np.ndarray], n_samples: int, dimension: int
) -> Actions:
    """Evaluate the parameters of actions in 2 or 3 dimensions for samples with values of shape (n_samples,)."""
    most = max((len(action.parameters) for action in actions), default=0)
    parameters = np.zeros((len(actions), n_samples, most))
    for action, table in zip(actions, parameters):
        for k, quantity in enumerate(action.parameters):
            table[:, k] = quantity.at(values)
    parts, functions = zip(*(term for action in actions for term in action.statement.terms)) if actions else ((), ())
    every = [side for action in actions for side in action.sides]
    return Actions(
        NodeStatements.of(parts, list(zip(every[::2], every[1::2])), dimension, functions),
        Laws.of([action.law for action in actions]),
        parameters,
        np.array([action.role for action in actions], dtype=np.int64),
        first_terms(actions),
    )


def first_terms(actions: Sequence[Action]) -> np.ndarray:
    """Return the number of each action's first term among those of all, and how many there are, (n_actions + 1,)."""
    return np.cumsum([0, *(len(action.statement.terms) for action in actions)])


def counted_from(action: Action, kinematics: RigidKinematics, theta: np.ndarray) -> np.ndarray:
    """Return what the angles of an action's terms are counted from at coordinates (n_theta, n), rad, shape (n_terms,
    n): that of one which is no coordinate, among several, is what the others leave of a coupling's value."""
    terms, mechanism = action.statement.terms, kinematics.mechanism
    known = {coordinate.statement: line for coordinate, line in zip(mechanism.coordinates, theta)}
    for s, line in action.statement.lines.items():
        known[s] = line.offset + sum(slope * known[one] for one, slope in line.slopes.items())
    near = np.array([known[s] if s in known else np.zeros(theta.shape[1]) for s, _ in terms])
    if len(terms) == 1:
        return near
    rows = StatementRows.on_poses(
        [(Combination((term,)), pair) for term, pair in zip(terms, action.pairs)], mechanism.space
    )
    values = rows.values(kinematics.poses(theta.T).reshape(-1, theta.shape[1]), near)
    value = next((one.value for one in mechanism.couplings if one.combination is action.statement), 0.0)
    for k in turning_freely(action.statement, mechanism):
        near[k] = (value - values.sum(axis=0) + values[k]) / terms[k][1].factor
    return near


def turning_freely(combination: Combination | Statement, mechanism: Mechanism) -> list[int]:
    """Return the numbers of the terms that are angles of which nothing but the others tells the turns."""
    known = {*combination.lines, *(coordinate.statement for coordinate in mechanism.coordinates)}
    terms = enumerate(combination.terms)
    return [k for k, (part, own) in terms if part.kind == ANGLE and part not in known and not own.breaks.size]


def amplitudes_over(actions: Sequence[Action], times: np.ndarray) -> np.ndarray:
    """Return the amplitudes of actions at times (n,), 0 where one is no source, shape (n, n_actions)."""
    result = np.zeros((times.size, len(actions)))
    for column, action in zip(result.T, actions):
        if action.amplitude is not None:
            column[:] = action.amplitude(times)
    return result


def joint_measure(mechanism: Mechanism, entry: Any) -> dict[str, Any]:
    """Return statement and attachments of an effect's joint, as `Action` takes them; it may act at a point as well."""
    scene, asked = mechanism.scene, getattr(entry, "motion", None)
    found = scene.joints[entry.joint].motion_of(asked, getattr(entry, "joints", MEASURED), scene.dimension)
    return mechanism.connection(entry.joint).motion("sliding" if found == "sliding" else "turning")


def place_of(mechanism: Mechanism, name: str, entry: Any) -> dict[str, Any]:
    """Return what an effect by a name acts on, as `Action` takes it: the motion in its joint, or the distance of its
    two points."""
    if entry.points is None:
        return joint_measure(mechanism, entry)
    return mechanism.between(distance(mechanism.space.dimension), entry.points, f"effects.{name}.points")
