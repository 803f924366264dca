"""Points, statements, local effects and outputs as a model in C takes them."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.base.units import UnitSystem
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.controllers.acting import ACTING_LAW, control_of, rounded
from pgmp_petsc.controllers.law import ControlLaw
from pgmp_petsc.declare.expressions import printed, symbolic
from pgmp_petsc.declare.forms import in_c
from pgmp_petsc.declare.ideas import refuse
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.law import Law
from pgmp_petsc.effects.time_function import Piece
from pgmp_petsc.mechanism.joints import Attached, Attachment
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Coordinate
from pgmp_petsc.mechanism.statement_rows import near_to
from pgmp_petsc.mechanism.statements import Function, Statement, distance
from pgmp_petsc.outputs.multipliers import ForceOutput, OfConnection, OfCoupling, OfPrescribed, Pull
from pgmp_petsc.outputs.of_outputs import Combined
from pgmp_petsc.outputs.outputs import OutputSet
from pgmp_petsc.outputs.rainflow import Counted
from pgmp_petsc.outputs.readings import TIME, Absolute, AnyReading, ModelReading, Rate, Reading
from pgmp_petsc.scene import Scene

NO_CODE = "a model in C has no code for it"
COMPONENTS = ("x", "y", "z", "axial", "radial", "magnitude", "along", "size")


@dataclass(frozen=True)
class Side:
    """A point of a body or of the ground: slot of its node, number of its body, and its place, `Attachment`."""

    slot: int
    body: int
    point: tuple[float, ...]
    arm: tuple[float, ...]

    @classmethod
    def of(cls, side: Attachment, slots: Mapping[int, int]) -> Side:
        """Return an attachment; `slots` are those of the nodes in the tables."""
        return cls(slots.get(side.node, -1), side.body, *(tuple(map(float, part)) for part in (side.point, side.arm)))


@dataclass(frozen=True, eq=False)
class StatementInC:
    """A statement about two points; `turns` is what an angle is near to: offset and slopes over the coordinates."""

    statement: Statement
    a: Side
    b: Side
    turns: tuple[float, ...] = (0.0,)

    @classmethod
    def of_reading(cls, reading: Reading, slots: Mapping[int, int]) -> StatementInC:
        """Return what is read of two points, or of one alone: then of both sides."""
        a, b = (Side.of(reading.sides[k], slots) for k in (0, -1))
        turns = (0.0,) if reading.turns is None else (reading.turns.offset, *map(float, reading.turns.slopes))
        return cls(reading.statement or distance(reading.space.dimension), a, b, turns)


@dataclass(frozen=True, eq=False)
class TermInC:
    """A function of a statement, and the row of the closure that it adds to, or the number of a multiplier."""

    row: int
    statement: StatementInC
    function: Function
    left: bool = False  # whether an angle is near to what the others leave of the row's value


@dataclass(frozen=True, eq=False)
class PartInC:
    """A term of what a local effect measures, and the numbers of its nodes among those of all effects."""

    term: TermInC
    nodes: tuple[int, int]
    winding: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class ActionInC:
    """A local effect: its parts, numbers of its strength, -1 where it has none, and of the first edge of its law among
    those of all, and whose measure the law is of."""

    parts: tuple[PartInC, ...]
    law: Law
    strength: int
    edge: int
    role: int  # `effects.action.Action.role`
    controlled: bool  # whether a controller gives its force


@dataclass(frozen=True, eq=False)
class ControlInC:
    """A controller."""

    law: ControlLaw
    parameters: Sequence[float | str]  # of its law, limits and the reference: numbers, or names of parameters
    reference: Sequence[Piece]  # pieces over time; none where it is a parameter
    column: int  # first of its numbers beside
    row: int  # first of its actions among those of all controllers
    every: int  # steps between two samples, 0 of a continuous one


@dataclass(frozen=True, eq=False)
class ReadingInC:
    """A reading: kind, statement or point (side b), axis, whether that is one of the body, and what counts as zero."""

    kind: str
    statement: StatementInC
    axis: int = 0
    in_body: bool = False
    origin: float = 0.0


@dataclass(frozen=True, eq=False)
class ForceInC:
    """A component of what a joint does: functions of statements and multipliers; which component, whether of a moment
    and in the axes of a body; on which body, 1 on b's; the joint's first axis; and its points."""

    terms: Sequence[TermInC]
    component: int
    turning: bool
    in_body: bool
    sign: float
    axis: tuple[float, ...]
    a: Side
    b: Side

    @classmethod
    def of(
        cls, force: OfConnection | OfCoupling, gaps: Sequence[int], slots: Mapping[int, int], actions: Sequence[Action]
    ) -> ForceInC:  # fmt: skip
        """Return an output; `gaps` are the numbers of the constraints that have one, behind which the forces of actions
        stand, of those that a joint gives way by."""
        gaps, nowhere = list(gaps), Side(-1, -1, (0.0,), (0.0,))

        def behind(*pulls: Pull) -> list[int]:
            own = {pull.action.effect for pull in pulls}
            return [len(gaps) + k for k, one in enumerate(actions) if one.effect in own]

        if isinstance(force, OfCoupling):
            (number,) = map(gaps.index, force.rows) if force.pull is None else behind(force.pull)
            read, along = StatementInC.of_reading(force.reading, slots), "size" if force.is_size else "along"
            terms = [TermInC(number, read, force.function)]
            return cls(terms, COMPONENTS.index(along), False, False, 1.0, (0.0,), nowhere, nowhere)
        if not isinstance(force, OfConnection):
            raise refuse(type(force), f"{NO_CODE}; make it of classes in outputs.multipliers, or build without it")
        entry, joint, terms = force.entry, force.connection, []
        a, b = Side.of(joint.a, slots), Side.of(joint.b, slots)
        for row, (part, own) in zip(force.rows, force.held):
            for (statement, function), first in zip(part.terms, own[::2]):
                terms.append(TermInC(gaps.index(row), StatementInC(statement, Side.of(first, slots), b), function))
        for number, pull in zip(behind(*force.pulls), force.pulls):
            for statement, function in pull.action.statement.terms:
                terms.append(TermInC(number, StatementInC(statement, a, b), function))
        axis = tuple(map(float, joint.axes[0][:, 0])) if entry.component in ("axial", "radial") else (0.0,)
        sign = -1.0 if entry.of == "first" else 1.0
        return cls(
            terms, COMPONENTS.index(entry.component), entry.turning, entry.frame == "body", sign, axis, a, b
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class CountInC:
    """An output that is counted over a run: its number; amplitude, cycles and exponent of each part of its curve, and
    the ultimate strength, in C; and the longest life (s), 0 of a damage."""

    output: int
    curve: Sequence[Sequence[str]]
    ultimate: str
    run_out: float

    @classmethod
    def of(cls, output: int, counted: Counted, values: Mapping[str, str | float]) -> CountInC:
        """Return a count under a curve whose numbers are those of `values`, or what these are in C."""

        def number(value: float | str) -> str:
            found = values[value] if isinstance(value, str) else value
            return found if isinstance(found, str) else repr(float(found))

        entry, curve = counted.entry, counted.entry.curve
        if curve.table is None:
            parts = [[number(one) for one in (curve.reference, curve.cycles, curve.exponent)]]
        else:
            parts = [list(map(number, part)) for part in counted.curve({}, 1)[0].tolist()]
        ultimate = "HUGE_VAL" if entry.ultimate is None else number(entry.ultimate)
        return cls(output, parts, ultimate, entry.run_out or 0.0)


@dataclass(frozen=True, eq=False)
class OutputsInC:
    """What outputs are made of."""

    readings: Sequence[ReadingInC]
    forces: Sequence[ForceInC]
    courses: Sequence[Sequence[Piece]]  # pieces over time of how far each base has gone
    combined: str  # body of the function that makes outputs of readings
    depth: int  # derivatives of readings that are read
    counts: Sequence[CountInC]


class Combiner:
    """Writes what makes outputs of readings: arrays of a value, its rate and its acceleration; for motions of the base,
    and values of the parameters that are numbers, or what they are in C."""

    def __init__(self, outputs: OutputSet, values: Mapping[str, str | float], n_carried: int) -> None:
        self._bases, self._values = outputs.bases, values
        self._forces = {force.name: force for force in outputs.forces}
        self._in_joints = [force.name for force in outputs.forces if not isinstance(force, OfPrescribed)]
        self._of_controllers = {name: number - n_carried for name, number in outputs.beside.items()}
        self.readings: list[Reading] = []
        self.lines: list[str] = []
        self._names: dict[AnyReading, str] = {}

    def of(self, reading: AnyReading) -> str:
        if isinstance(reading, Rate):
            return f"({self.of(reading.of)} + {reading.order})"
        if reading not in self._names:
            self._names[reading] = self._made(reading)
        return self._names[reading]

    def _made(self, reading: AnyReading) -> str:
        name = f"y{len(self._names)}"
        match reading:
            case Reading():
                self.readings.append(reading)
                return f"readings[{len(self.readings) - 1}]"
            case ModelReading(name=of) if of in self._in_joints:
                return f"acting[{self._in_joints.index(of)}]"
            case ModelReading(name=of) if of in self._of_controllers:
                return f"acting[{len(self._in_joints)} + R + {self._of_controllers[of]}]"
            case ModelReading(name=of) if of in self._forces:
                force = self._forces[of]
                drive = f"acting[{len(self._in_joints) + force.coordinate}][0]"
                speed = "" if force.speed is None else f" * {self.of(Rate(force.speed))}[0]"
                self.lines.append(f"double {name}[3] = {{{drive}{speed}}};")
                return name
            case Absolute(of=place):
                parts = [self.of(place) + "[j]"]
                for k, (direction, factor, course) in enumerate(self._bases):
                    share, begun = float(direction[place.axis] * factor.coefficient), course.at_start
                    gone = f"(bases[{k}][j] - (j ? 0.0 : {begun!r}))" if reading.from_start else f"bases[{k}][j]"
                    parts.append(f"{share!r} * {monomial_in_c(factor.monomial, self._values)} * {gone}")
                self.lines.append(f"double {name}[3];")
                self.lines.append(f"for (int j = 0; j < 3; j++) {name}[j] = {' + '.join(parts)};")
                return name
            case Combined():
                self._formula(name, reading)
                return name
        made = "make outputs of classes in outputs.readings and outputs.of_outputs"
        raise refuse(type(reading), f"{NO_CODE}; {made}, or build without it")

    def _formula(self, name: str, reading: Combined) -> None:
        """Write a formula with as many derivatives as its parts have."""
        import sympy as sp  # takes half a second, and few models have formulas

        t, order = sp.Symbol("time"), max(2 - reading.depth(0), 0)
        own, read, given = {TIME: t}, {}, {}
        for k, (part, inner) in enumerate(reading.parts.items()):
            own[part] = sp.Function(f"u{k}")(t)
            array = self.of(inner)
            for j in range(order + 1):
                symbol = read[sp.Derivative(own[part], (t, j)) if j else own[part]] = sp.Symbol(f"u{k}_{j}")
                given[symbol] = f"{array}[{j}]"
        for k, (part, parameter) in enumerate(reading.constants.items()):
            own[part] = sp.Symbol(f"c{k}")
            given[own[part]] = self._values[parameter]
        found = [symbolic(reading.text, own)]
        for _ in range(order):
            found.append(sp.diff(found[-1], t))
        found = [one.subs(list(reversed(read.items()))) for one in found]
        used = set().union(*(one.free_symbols for one in found))
        lines = [f"const double {symbol} = {value};" for symbol, value in given.items() if symbol in used]
        shared, values = printed(found, for_c=True)
        lines += in_c([*shared, *(f"{name}[{j}] = {value}" for j, value in enumerate(values))])
        self.lines += [f"double {name}[3] = {{0.0}};", "{", *lines, "}"]


def closure_of(kinematics: RigidKinematics) -> tuple[list[TermInC], list[float]]:
    """Return the terms of what holds the rigid bodies together, and the values that its rows have."""
    mechanism = kinematics.mechanism
    origin = np.zeros(mechanism.space.dimension)
    parts, wanted = mechanism.holding([Attachment(k, -1, origin, origin) for k in range(len(mechanism.bodies))])
    return terms_of(parts, kinematics.coordinates, {}), [float(value) for value in wanted]


def terms_of(parts: Sequence[Attached], coordinates: Sequence[Coordinate], slots: Mapping[int, int]) -> list[TermInC]:
    """Return the terms of statements and combinations of them, with what angles are near to."""
    near, found = near_to(parts, {coordinate.statement: k for k, coordinate in enumerate(coordinates)}), []
    for row, (part, sides) in enumerate(parts):
        points = [Side.of(side, slots) for side in sides]
        for (statement, function), *pair in zip(part.terms, points[::2], points[1::2]):
            k = len(found)
            own, slopes = slice(near.starts[k], near.starts[k + 1]), np.zeros(len(coordinates))
            slopes[near.numbers[own]] = near.slopes[own]
            line = (float(near.offsets[k]), *map(float, slopes))
            found.append(TermInC(row, StatementInC(statement, *pair, line), function, bool(near.left[k])))
    return found


def action_in_c(
    number: int, action: Action, edge: int, nodes: Sequence[int], slots: Mapping[int, int], strengths: Sequence[str],
    windings: Iterator[np.ndarray],
) -> ActionInC:  # fmt: skip
    """Return a local effect by its number; `nodes` are those of all of them, `strengths` the names of what acts over
    time, and `windings`, of which it takes its own, go over the parts of all."""
    parts = []
    for (statement, function), (a, b) in zip(action.statement.terms, action.pairs):
        term = TermInC(number, StatementInC(statement, Side.of(a, slots), Side.of(b, slots)), function)
        held = tuple(-1 if side.on_ground else nodes.index(side.node) for side in (a, b))
        parts.append(PartInC(term, held, tuple(map(float, next(windings)))))
    strength = -1 if action.amplitude is None else strengths.index(action.effect)
    return ActionInC(tuple(parts), action.law, strength, edge, action.role, action.law is ACTING_LAW)


def controls_in_c(scene: Scene, tunable: Container[str], step: float) -> list[ControlInC]:
    """Return the controllers, whose parameters are numbers but for those that a model in C takes, `tunable`."""
    found, column, row = [], 0, 0
    for entry in scene.controllers.values():
        law, own, reference, takes_rate = control_of(scene, entry)
        changes = entry.reference.constant is None
        pieces = (rounded(reference, step) if takes_rate else reference).pieces if changes else ()
        given = [*own.values(), 0.0 if changes else reference]
        parameters = [v if not isinstance(v, str) or v in tunable else scene.values[v] for v in given]
        found.append(ControlInC(law, parameters, pieces, column, row, round(entry.sample_time / step)))
        column, row = column + 3 * len(law.states) + 1, row + max(1, law.n_motions)
    return found


def outputs_in_c(
    outputs: OutputSet, carried: Sequence[ForceOutput], slots: Mapping[int, int], values: Mapping[str, str | float],
    gaps: Sequence[int], actions: Sequence[Action], system: UnitSystem,
) -> OutputsInC:  # fmt: skip
    """Return outputs in units of a system, and before their forces those that friction hangs on, `carried`; see
    `outputs.readings`, and for `gaps` and `actions` `ForceInC.of`."""
    combiner = Combiner(outputs, values, len(carried))
    of_units = (
        f"{1.0 / size!r} * " if (size := system.size_of(unit)) != 1.0 else "" for unit in outputs.units.values()
    )
    made, counts = [], []
    for k, (reading, factor) in enumerate(zip(outputs.functions.values(), of_units)):
        if isinstance(reading, Counted):
            made.append(f"counted[{len(counts)}] = {combiner.of(reading.of)}[0];")
            counts.append(CountInC.of(k, reading, values))
        else:
            made.append(f"outputs[{k}] = {factor}{combiner.of(reading)}[0];")
    readings = [
        ReadingInC(one.kind, StatementInC.of_reading(one, slots), one.axis, one.in_body, one.origin)
        for one in combiner.readings
    ]
    in_joints = (one for one in (*carried, *outputs.forces) if not isinstance(one, OfPrescribed))
    forces = [ForceInC.of(one, gaps, slots, actions) for one in in_joints]
    courses, combined = [base.course.pieces for base in outputs.bases], "\n    ".join([*combiner.lines, *made])
    return OutputsInC(readings, forces, courses, combined, outputs.order, counts)


def monomial_in_c(monomial: Monomial, values: Mapping[str, str | float]) -> str:
    """Return a product of powers of parameters in C, whose values are numbers or what they are in C."""
    factors = [f"{values[name]}" if e == 1 else f"pow({values[name]}, {e})" for name, e in monomial.powers]
    return " * ".join(factors) or "1.0"


def braced(values: np.ndarray | float) -> str:
    """Return nested braces around the numbers of an array in C."""
    return f"{{{', '.join(map(braced, values))}}}" if np.ndim(values) else repr(float(values))
