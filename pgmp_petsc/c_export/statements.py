"""Points, statements, local effects, controllers and outputs as a model in C takes them: structures of ``tables.h``."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pgmp_petsc.base.units import UnitSystem
from pgmp_petsc.bodies.affine import AffineSum, Monomial, Quantity
from pgmp_petsc.controllers.acting import ACTING_LAW, control_of, rounded
from pgmp_petsc.declare.expressions import printed, symbolic
from pgmp_petsc.declare.forms import in_c
from pgmp_petsc.declare.ideas import refuse
from pgmp_petsc.effects.action import Action
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
MOST_WAITING = 4096  # turning points of a count that wait for their cycle to close

Slots = Mapping[int, int]  # of nodes in the tables
Values = Mapping[str, str | float]  # of parameters: numbers, or what they are in C


class InC(NamedTuple):
    """What a part of a model is in C: numbers of ``sizes.h`` by name, entries of lists by declaration, functions, and
    lines of that which follows from the parameters."""

    sizes: Mapping[str, int | float]
    lists: Mapping[str, Sequence[str | float]]
    code: Sequence[str] = ()
    weighed: Sequence[str] = ()


def number(value: float | str, values: Values | None = None) -> str:
    """Return a number that C reads back to the last bit, infinite ones as the largest there are; of a parameter what
    its values have."""
    if isinstance(value, str) and values is not None:
        value = values[value]
    if isinstance(value, str):
        return value
    return str(int(value)) if isinstance(value, (int, np.integer)) else repr(float(np.clip(value, -1.7e308, 1.7e308)))


def braced(*entries: str | float | Iterable) -> str:
    """Return numbers, what is in C already, and sequences of these, in braces."""
    parts = (number(one) if np.isscalar(one) else braced(*one) for one in entries)
    return f"{{{', '.join(parts)}}}"


def function(head: str, arguments: str, lines: Iterable[str]) -> str:
    """Return a function with such arguments, of which it need not use any."""
    unused = ", ".join(f"(void){name}" for name in arguments.split())
    return "\n    ".join([f"void {head} {{", f"{unused};", *lines]) + "\n}\n"


def monomial_in_c(monomial: Monomial, values: Values) -> str:
    """Return a product of powers of parameters."""
    factors = [f"{values[name]}" if e == 1 else f"pow({values[name]}, {e})" for name, e in monomial.powers]
    return " * ".join(factors) or "1.0"


def quantity_in_c(quantity: AffineSum | Quantity, values: Values) -> str:
    """Return a quantity, or a sum of them."""
    parts = quantity if isinstance(quantity, AffineSum) else (quantity,)
    return " + ".join(f"{number(float(one.coefficient))} * {monomial_in_c(one.monomial, values)}" for one in parts)


NOWHERE = braced(-1, -1, [0.0], [0.0])  # a side that is not looked at


def side_in_c(side: Attachment, slots: Slots) -> str:
    """Return a point of a body or of the ground."""
    return braced(slots.get(side.node, -1), side.body, map(float, side.point), map(float, side.arm))


def statement_in_c(statement: Statement, a: str, b: str, turns: Iterable[float] = (0.0,)) -> str:
    """Return a statement about two points; `turns` is what an angle is near to: offset and slopes over the
    coordinates."""
    return braced(statement.kind, map(float, turns), (map(float, axis) for axis in statement.axes), a, b)


def read_in_c(reading: Reading, slots: Slots) -> str:
    """Return what is read of two points, or of one alone: then of both sides."""
    turns = (0.0,) if reading.turns is None else (reading.turns.offset, *reading.turns.slopes)
    sides = (side_in_c(reading.sides[k], slots) for k in (0, -1))
    return statement_in_c(reading.statement or distance(reading.space.dimension), *sides, turns)


class Terms:
    """Functions of statements in C, and the pieces of all their splines so far."""

    def __init__(self) -> None:
        self.pieces: list[str] = []

    def term(self, row: int, statement: str, function: Function, left: bool = False) -> str:
        """Return a function of a statement, which adds to a row of the closure, or belongs to a multiplier; `left` says
        whether an angle is near to what the others leave of the row's value."""
        first, cubics = len(self.pieces), function.coefficients
        self.pieces += map(braced, map(float, function.breaks[:-1]), map(float, function.breaks[1:]), cubics)
        return braced(row, first, len(cubics), left, float(function.factor), statement)

    def of(self, parts: Sequence[Attached], coordinates: Sequence[Coordinate], slots: Slots) -> list[str]:
        """Return the terms of statements and combinations of them, with what angles are near to."""
        near, found = near_to(parts, {coordinate.statement: k for k, coordinate in enumerate(coordinates)}), []
        for row, (part, sides) in enumerate(parts):
            points = [side_in_c(side, slots) for side in sides]
            for (statement, function), *pair in zip(part.terms, points[::2], points[1::2]):
                k = len(found)
                own, slopes = slice(near.starts[k], near.starts[k + 1]), np.zeros(len(coordinates))
                slopes[near.numbers[own]] = near.slopes[own]
                stated = statement_in_c(statement, *pair, (near.offsets[k], *slopes))
                found.append(self.term(row, stated, function, bool(near.left[k])))
        return found


def piece_in_c(piece: Piece) -> str:
    """Return a piece of a function of time."""
    return braced(float(piece.begin), float(piece.origin), [*piece.cubic, *(0.0,) * 5][:5], piece.wave)


def closure_in_c(kinematics: RigidKinematics, terms: Terms) -> InC:
    """Return what holds the rigid bodies together, and the values that its rows have."""
    mechanism = kinematics.mechanism
    origin = np.zeros(mechanism.space.dimension)
    parts, wanted = mechanism.holding([Attachment(k, -1, origin, origin) for k in range(len(mechanism.bodies))])
    found, wanted = terms.of(parts, kinematics.coordinates, {}), list(map(float, wanted))
    return InC(
        {"N_CLOSURE": len(wanted), "N_CLOSURE_TERMS": len(found)},
        {"const struct term closure[]": found, "const double closure_wanted[]": wanted},
    )


def actions_in_c(
    actions: Sequence[Action], nodes: Sequence[int], slots: Slots, strengths: Sequence[str],
    windings: Iterator[np.ndarray], values: Values, terms: Terms,
) -> InC:  # fmt: skip
    """Return local effects; `nodes` are those of all of them, `strengths` the names of what acts over time, and
    `windings` what the angle of each part grows by with the coordinates."""
    listed, parts, weighed, n_edges = [], [], [], 0
    for k, action in enumerate(actions):
        first, law = len(parts), action.law
        for (statement, function), sides in zip(action.statement.terms, action.pairs):
            stated = statement_in_c(statement, *(side_in_c(side, slots) for side in sides))
            held = (-1 if side.on_ground else nodes.index(side.node) for side in sides)
            parts.append(braced(*held, map(float, next(windings)), terms.term(k, stated, function)))
        strength = -1 if action.amplitude is None else strengths.index(action.effect)
        numbers = (first, len(parts), strength, n_edges, len(law.edges), action.role, law is ACTING_LAW, law.bends)
        listed.append(braced(*map(int, numbers), f"law_{law.name}"))
        weighed += (f"laws[{k}][{i}] = {quantity_in_c(one, values)};" for i, one in enumerate(action.parameters))
        n_edges += len(law.edges)
    sizes = {
        "N_ACTIONS": len(listed),
        "N_ACTION_NODES": len(nodes),
        "N_PARTS": len(parts),
        "N_LAW": max([1, *(len(action.parameters) for action in actions)]),
        "N_EDGES": n_edges,
        "MOST_EDGES": max([1, *(len(action.law.edges) for action in actions)]),  # an array in C has at least one
    }
    lists = {
        "const struct action actions[]": listed,
        "const struct part action_parts[]": parts,
        "const int action_nodes[]": [slots[node] for node in nodes],
    }
    return InC(sizes, lists, [action.law.code.C for action in actions], weighed)


def controls_in_c(scene: Scene, values: Values, step: float, functions: list[Sequence[Piece]]) -> InC:
    """Return the controllers; their references are added to the functions of time."""
    listed, laws, weighed, column, row, most = [], [], [], 0, 0, 0
    for k, entry in enumerate(scene.controllers.values()):
        law, own, reference, takes_rate = control_of(scene, entry)
        changes = entry.reference.constant is None
        functions.append((rounded(reference, step) if takes_rate else reference).pieces if changes else ())
        given = [*own.values(), 0.0 if changes else reference]
        weighed += (f"controls[{k}][{i}] = {number(value, values)};" for i, value in enumerate(given))
        every, over_time = round(entry.sample_time / step), len(functions) - 1 if changes else -1
        numbers = (len(law.states), law.n_motions, column, row, every, over_time, len(given) - 1)
        listed.append(braced(*numbers, f"control_{law.name}", f"start_{law.name}"))
        column, row, most = column + 3 * len(law.states) + 1, row + max(1, law.n_motions), max(most, len(given))
        laws.append(law)
    sizes = {
        "N_CONTROLS": len(laws),
        "N_CONTROL": most,
        "N_BESIDE": column,
        "MOST_MOTIONS": max((law.n_motions for law in laws), default=0),
        "MOST_STATES": max((len(law.states) for law in laws), default=0),
    }
    return InC(sizes, {"const struct control controls[]": listed}, [law.code.C for law in laws], weighed)


class Combiner:
    """Writes what makes outputs of readings: arrays of a value, its rate and its acceleration; for motions of the base,
    and values of the parameters that are numbers, or what they are in C."""

    def __init__(self, outputs: OutputSet, values: Values, n_carried: int) -> None:
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


def force_in_c(
    force: ForceOutput, gaps: Sequence[int], slots: Slots, actions: Sequence[Action], terms: Terms, first: int
) -> tuple[str, list[str]]:
    """Return a component of what a joint does, and its terms, which stand from `first` on; `gaps` are the numbers of
    the constraints that have one, behind which the forces of actions stand, of those that a joint gives way by."""
    gaps, sides, axis, whole = list(gaps), (NOWHERE, NOWHERE), [0.0], (0, 0, 1.0)

    def behind(*pulls: Pull) -> list[int]:
        own = {pull.action.effect for pull in pulls}
        return [len(gaps) + k for k, one in enumerate(actions) if one.effect in own]

    if isinstance(force, OfCoupling):
        (row,) = map(gaps.index, force.rows) if force.pull is None else behind(force.pull)
        component, found = "size" if force.is_size else "along", []
        found.append(terms.term(row, read_in_c(force.reading, slots), force.function))
    elif isinstance(force, OfConnection):
        entry, joint, component, found = force.entry, force.connection, force.entry.component, []
        a, b = sides = [side_in_c(side, slots) for side in (joint.a, joint.b)]
        for row, (part, own) in zip(force.rows, force.held):
            for (statement, function), side in zip(part.terms, own[::2]):
                stated = statement_in_c(statement, side_in_c(side, slots), b)
                found.append(terms.term(gaps.index(row), stated, function))
        for row, pull in zip(behind(*force.pulls), force.pulls):
            for statement, function in pull.action.statement.terms:
                found.append(terms.term(row, statement_in_c(statement, a, b), function))
        if component in ("axial", "radial"):
            axis = joint.axes[0][:, 0].tolist()
        whole = entry.turning, entry.frame == "body", -1.0 if entry.of == "first" else 1.0
    else:
        raise refuse(type(force), f"{NO_CODE}; make it of classes in outputs.multipliers, or build without it")
    which = first, first + len(found), COMPONENTS.index(component)
    return braced(*which, *whole, axis, *sides), found


def curve_of(counted: Counted) -> list[list[float | str]]:
    """Return amplitude, cycles and exponent of the parts of a count's curve, numbers or names of parameters."""
    curve = counted.entry.curve
    if curve.table is None:
        return [[curve.reference, curve.cycles, curve.exponent]]
    return counted.curve({}, 1)[0].tolist()


def outputs_in_c(
    outputs: OutputSet, carried: Sequence[ForceOutput], slots: Slots, values: Values, gaps: Sequence[int],
    actions: Sequence[Action], system: UnitSystem, n_steps: int, terms: Terms,
) -> InC:  # fmt: skip
    """Return outputs in units of a system, and before their forces those that friction hangs on, `carried`; see
    `outputs.readings`, and for `gaps` and `actions` `force_in_c`."""
    combiner, made, counts, weighed = Combiner(outputs, values, len(carried)), [], [], []
    curves = {name: curve_of(counted) for name, counted in outputs.counts.items()}
    sizes = map(system.size_of, outputs.units.values())
    for k, ((name, reading), size) in enumerate(zip(outputs.functions.items(), sizes)):
        if not isinstance(reading, Counted):
            made.append(f"outputs[{k}] = {'' if size == 1.0 else f'{1.0 / size!r} * '}{combiner.of(reading)}[0];")
            continue
        n, entry = len(counts), reading.entry
        made.append(f"counted[{n}] = {combiner.of(reading.of)}[0];")
        for part, numbers in enumerate(curves[name]):
            weighed += (f"curves[{n}][{part}][{i}] = {number(value, values)};" for i, value in enumerate(numbers))
        ultimate = "HUGE_VAL" if entry.ultimate is None else number(entry.ultimate, values)
        weighed.append(f"ultimates[{n}] = {ultimate};")
        counts.append(braced(k, len(curves[name]), float(entry.run_out or 0.0)))
    readings = [
        braced(one.kind, one.axis, one.in_body, float(one.origin), read_in_c(one, slots)) for one in combiner.readings
    ]
    forces, of_forces = [], []
    for one in (*carried, *outputs.forces):
        if not isinstance(one, OfPrescribed):
            force, own = force_in_c(one, gaps, slots, actions, terms, len(of_forces))
            forces.append(force)
            of_forces += own
    arrays = "double (*bases)[3], double (*readings)[3], double (*acting)[3], double outputs[], double counted[]"
    combine = f"combine(double time, const double *p, {arrays})", "time p bases readings acting outputs counted"
    weigh = "weigh_counts(const double *p, double (*curves)[MOST_PARTS][3], double ultimates[])", "p curves ultimates"
    return InC(
        {
            "N_OUTPUTS": len(outputs.functions),
            "N_READINGS": len(readings),
            "N_BASES": len(outputs.bases),
            "N_FORCES": len(forces),
            "DRIVES": int(any(isinstance(one, OfPrescribed) for one in outputs.forces)),
            "DEPTH": outputs.order,
            "N_COUNTS": len(counts),
            "MOST_PARTS": max(map(len, curves.values()), default=1),
            "N_WAITING": min(n_steps + 2, MOST_WAITING) if counts else 1,
        },
        {
            "const struct reading readings[]": readings,
            "const struct force forces[]": forces,
            "const struct term force_terms[]": of_forces,
            "const struct count counts[]": counts,
        },
        [function(*combine, [*combiner.lines, *made]), function(*weigh, weighed)],
    )
