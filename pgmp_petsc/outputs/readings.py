"""Readings of a motion for outputs, with their derivatives over time.

A reading is a number that is read of frames of nodes: a statement about two points, a place, a rotation, or a place
from that of the rigid mechanism. `Rate` and `Absolute` read a reading. All have a `jet`: value, rate and acceleration,
made by the chain rule of those of the frames, which are the model's own: no instants are differenced. Models in C
evaluate the same readings (`c_export.statements`). What controllers measure is an expression of motions and
their rates, of which their laws have exact slopes.

Frames are ``(x, y, phi)`` in the plane, and in space position, directors and the rigid coordinates, which say how often
a joint has turned; rates of the last are not needed. A deformation is the position less that of the rigid mechanism at
the same measured coordinates, e.g. the same rotation of the hinge node, which in a free-free basis is not theta itself.
It is not a number (NaN) where a measured coordinate is far outside a limited range, because the rigid mechanism may not
exist there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal, NamedTuple, Protocol, Self, get_args

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.declare.expressions import called_at, check, symbolic
from pgmp_petsc.declare.ideas import PACKAGE, refuse
from pgmp_petsc.effects.time_function import TimeFunction
from pgmp_petsc.mechanism.joints import Attachment, Connection
from pgmp_petsc.mechanism.kinematics import JointTurns, RigidKinematics
from pgmp_petsc.mechanism.mechanism import Coordinate
from pgmp_petsc.mechanism.space import SPATIAL, Space, leibniz
from pgmp_petsc.mechanism.statements import Statement

Kind = Literal["MEASURE", "POSITION", "ROTATION", "DEFORMATION"]
AXES = {"x": 0, "y": 1, "z": 2}
Frames = dict[int, np.ndarray]  # node -> frame, shape (n_frame, n)
HIGHEST = 2  # derivative over time of what models know: they have accelerations
#: A value and its derivatives over time, as many as are asked for, each of shape (n,).
Jet = list[np.ndarray]


@dataclass(frozen=True, eq=False)
class Seen:
    """A motion at n instants, as a model shows it."""

    frames: tuple[Frames, ...]  # of nodes, and as far as outputs read them their rates and accelerations (n_pose, n)
    rigid: RigidReference | None = None  # the rigid mechanism that deformations are taken from
    poses: np.ndarray | None = None  # its poses, shape (n_bodies, n_pose, n)
    #: stresses and other outputs by their name, (n,), and what forces are made of, (n_parts, n)
    of_model: Mapping[str, np.ndarray] = field(default_factory=dict)
    time: np.ndarray | None = None  # s, shape (n,)
    values: Mapping[str, np.ndarray | float] = field(default_factory=dict)  # of parameters, each (n,) or the same
    bases: Sequence[Base] = ()  # motions of the base
    n: int = 1
    multipliers: np.ndarray | None = None  # of joints and prescribed coordinates, shape (n_held + n_driven, n)
    #: force and moment that outputs have found in joints, by their names and whether for the moment, of other rows
    wrenches: dict[tuple[str, bool], tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    @property
    def n_seen(self) -> int:
        """Number of instants: of frames, where any are seen."""
        return next(iter(self.frames[0].values())).shape[1] if self.frames[0] else self.n


class Base(NamedTuple):
    """A motion of the base: unit direction (d,), factor, and how far along it the base has gone over time, m."""

    direction: np.ndarray
    factor: Quantity
    course: TimeFunction


@dataclass(frozen=True)
class Needs:
    """Parts of a motion that a reading takes."""

    nodes: frozenset[int] = frozenset()  # whose frames are read
    of_coordinates: frozenset[int] = frozenset()  # of these, at which the rigid mechanism of deformations is measured
    parameters: frozenset[str] = frozenset()
    stresses: frozenset[str] = frozenset()  # names of stress outputs
    multipliers: frozenset[str] = frozenset()  # names of outputs of multipliers
    time: bool = False
    base: bool = False

    def __or__(self, other: Needs) -> Needs:
        return Needs(*(getattr(self, one.name) | getattr(other, one.name) for one in fields(self)))


class AnyReading(Protocol):
    """A reading: value and derivatives over time of a part of a motion."""

    needs: Needs

    def depth(self, order: int) -> int:
        """Return which derivative of frames its own derivative of an order takes, `HIGHEST` at most.

        Raises `InputError` if models do not know that.
        """

    def jet(self, seen: Seen, order: int) -> Jet:
        """Return its value and derivatives over time up to an order."""


def jet_of(reading: AnyReading, seen: Seen, order: int) -> Jet:
    """Return the jet of a reading. Raises `InputError` if one of a plugin's class is none, with file and line."""
    found = reading.jet(seen, order)
    if type(reading).__module__.startswith(PACKAGE):
        return found
    wanted = (seen.n_seen,)
    parts = [np.asarray(part) for part in (found if isinstance(found, (list, tuple)) else [found])]
    if len(parts) <= order or any(part.shape != wanted or part.dtype.kind != "f" for part in parts):
        given = ", ".join(f"{part.dtype} of shape {part.shape}" for part in parts) or "none"
        asked = f"{order + 1} arrays of floats, as many as instants: here of shape {wanted}"
        raise refuse(type(reading), f"jet returns a list of {asked}, and not {given}")
    return found


@dataclass(frozen=True, eq=False)
class Reading:
    """A number that is read of frames."""

    #: ``MEASURE`` of a statement, ``POSITION`` of a point along an axis, ``ROTATION`` of its node in the plane, or
    #: ``DEFORMATION``: the position from that in the rigid mechanism
    kind: Kind
    sides: tuple[Attachment, ...]  # the attachments: two of a statement, else the point
    statement: Statement | None = None  # of a measure
    space: Space = SPATIAL  # of the mechanism
    turns: JointTurns | None = None  # what an angle in space is near to; None of other readings
    #: axis, origin: of a position: its number, and what counts as zero, m
    axis: int = 0
    origin: float = 0.0
    in_body: bool = False  # whether the axis of a deformation is one of the body
    of_coordinates: frozenset[int] = frozenset()  # nodes that the rigid mechanism of a deformation is measured at

    def __post_init__(self) -> None:
        kinds, n_sides = get_args(Kind), 1 + (self.kind == "MEASURE")
        if self.kind not in kinds:
            raise ValueError(f"a reading is of {', '.join(kinds)}, and not {self.kind!r}")
        if len(self.sides) != n_sides or (self.kind == "MEASURE") != (self.statement is not None):
            raise ValueError(f"{self.kind} is read of {n_sides} of the sides, and a statement of two of MEASURE")
        if all(side.on_ground for side in self.sides):
            raise ValueError("all that it reads is fixed to the ground")
        if not isinstance(self.statement, Statement | None):
            raise TypeError(f"a reading is of a Statement, and not a {type(self.statement).__name__}; a Combined adds")
        if self.statement is not None and self.statement.axes.shape[1] != self.space.dimension:
            raise ValueError("directions have 2 numbers in the plane, 3 in space; space is that of the mechanism")

    @classmethod
    def of_coordinate(cls, coordinate: Coordinate, kinematics: RigidKinematics) -> Self:
        """Return what measures a coordinate."""
        if coordinate.turns:
            return cls.of_angle(coordinate.connection, kinematics)
        return cls("MEASURE", coordinate.sides, coordinate.statement, kinematics.mechanism.space)

    @classmethod
    def of_angle(cls, connection: Connection, kinematics: RigidKinematics, start: np.ndarray | None = None) -> Self:
        """Return the relative rotation b - a of a joint, which counts turns.

        In space that of a coordinate is near the coordinate, that of another joint in (-pi, pi] at the start,
        coordinates (n_theta,); see `JointTurns`.
        """
        space = kinematics.mechanism.space
        start = np.zeros(kinematics.n_coordinates) if start is None else start
        turns = JointTurns.of(connection, kinematics, start) if space is SPATIAL else None
        return cls("MEASURE", connection.sides, connection.angle, space, turns)

    @classmethod
    def at_point(
        cls, kind: Literal["POSITION", "ROTATION", "DEFORMATION"], point: str, name: str, kinematics: RigidKinematics,
        axis: int = 0,
    ) -> Self:  # fmt: skip
        """Return what is read of ``"body:point"``; `name` is the output's, for messages."""
        mechanism = kinematics.mechanism
        return cls(kind, (mechanism.attachment(point, f"{name}.point"),), space=mechanism.space, axis=axis)

    @property
    def nodes(self) -> frozenset[int]:
        """The nodes whose frames are read."""
        return frozenset(side.node for side in self.sides if not side.on_ground) | self.of_coordinates

    @property
    def needs(self) -> Needs:
        return Needs(self.nodes, self.of_coordinates)

    def depth(self, order: int) -> int:
        if order > HIGHEST:
            raise InputError("its rate is asked for after accelerations, which are the last that models have")
        return order

    def jet(self, seen: Seen, order: int) -> Jet:
        return [self.value(seen.frames[0], seen.poses), *(self._changes(seen, order)[1:] if order else ())]

    def value(self, frames: Frames, rigid: np.ndarray | None = None) -> np.ndarray:
        """Return the number, shape (n,), for frames, and poses of the rigid mechanism (n_bodies, n_pose, n)."""
        if self.kind == "MEASURE":
            return self._measure(frames)
        (point,) = self.sides
        if self.kind == "ROTATION":
            return frames[point.node][2]
        frame = point.frame_of(frames[point.node])
        if self.kind == "POSITION":
            return frame[self.axis] - self.origin if self.origin else frame[self.axis]
        d = self.space.dimension
        moved = frame[:d] - point.frame_of_pose(rigid)[:d]
        return self.space.to_body(rigid[point.body], moved)[self.axis] if self.in_body else moved[self.axis]

    def _measure(self, frames: Frames) -> np.ndarray:
        first = next(frames[side.node] for side in self.sides if not side.on_ground)
        sides = [
            side.ground_frame(first.shape[1:]) if side.on_ground else side.frame_of(frames[side.node])
            for side in self.sides
        ]
        near = 0.0 if self.turns is None else self.turns.near(first[SPATIAL.n_pose :])
        return self.space.measure(self.statement, *sides, near)

    def _changes(self, seen: Seen, order: int) -> Jet:
        """Return what has the derivatives of the number; its first entry is not the number itself."""
        point = self.sides[0]
        if self.kind == "ROTATION":
            return [frames[point.node][2] for frames in seen.frames[: order + 1]]
        sides = [self._moving(side, seen, order) for side in self.sides]
        if self.kind == "POSITION":
            return [part[self.axis] for part in sides[0]]
        if self.kind == "DEFORMATION":
            d, poses = self.space.dimension, seen.rigid.jet(seen, order)
            rigid = point.on_pose().natural_jet([part[point.body] for part in poses])
            moved = [part[:d] - own[:d] for part, own in zip(sides[0], rigid)]
            if not self.in_body:
                return [part[self.axis] for part in moved]
            axis = slice(d + d * self.axis, d + d * self.axis + d)
            return leibniz(lambda x, y: np.sum(x * y, axis=0), [part[axis] for part in rigid], moved)
        z = [np.concatenate(parts) for parts in zip(*sides)]
        gradient = self.statement.gradient(*(side[0] for side in sides))
        found = [z[0][0], *(np.einsum("cn,cn->n", gradient, part) for part in z[1:])]
        if order == 2:
            bend = self.statement.hessian(*(side[0] for side in sides))
            found[2] = found[2] + np.einsum("cen,cn,en->n", bend, z[1], z[1])
        return found

    def _moving(self, side: Attachment, seen: Seen, order: int) -> Jet:
        """Return position and directors of an attachment with their derivatives, each (n_natural, n)."""
        if side.on_ground:
            n = next(iter(seen.frames[0].values())).shape[1:]
            z = self.space.natural(side.ground_frame(n))
            return [z, *(np.zeros_like(z) for _ in range(order))]
        return side.natural_jet([frames[side.node] for frames in seen.frames[: order + 1]])


@dataclass(frozen=True, eq=False)
class OfReading:
    """A reading of another one, and the same as that where subclasses do not say otherwise."""

    of: AnyReading

    @property
    def needs(self) -> Needs:
        return self.of.needs

    def depth(self, order: int) -> int:
        return self.of.depth(order)

    def jet(self, seen: Seen, order: int) -> Jet:
        return jet_of(self.of, seen, order)


@dataclass(frozen=True, eq=False)
class Rate(OfReading):
    """How fast a reading changes: its derivative over time of an order."""

    order: int = 1

    def depth(self, order: int) -> int:
        return self.of.depth(order + self.order)

    def jet(self, seen: Seen, order: int) -> Jet:
        return jet_of(self.of, seen, order + self.order)[self.order :]


@dataclass(frozen=True, eq=False)
class Absolute(OfReading):
    """A place along an axis of the ground, and how far the base has gone along it."""

    of: Reading
    from_start: bool = False  # whether it is less the place at the start of the run, where the base may be anywhere

    @property
    def needs(self) -> Needs:
        return self.of.needs | Needs(time=True, base=True)

    def jet(self, seen: Seen, order: int) -> Jet:
        found = self.of.jet(seen, order)
        for direction, factor, course in seen.bases:
            share, gone = direction[self.of.axis] * factor.at(seen.values), course.jet(seen.time, order)
            if self.from_start:
                gone[0] = gone[0] - course.at_start
            found = [x + share * y for x, y in zip(found, gone)]
        return found


@dataclass(frozen=True, eq=False)
class ModelReading:
    """A stress or a force in a joint, which models observe by themselves."""

    name: str  # of the output
    needs: Needs
    order: int = 0  # derivative of frames that it takes
    made: Callable[[np.ndarray], np.ndarray] | None = None  # makes it of what models observe, where that is not itself

    def depth(self, order: int) -> int:
        """Return its own: models do not know how fast it changes."""
        if order:
            raise InputError(
                f"the rate of {self.name} is asked for, and models know stresses and forces, not how fast they change; "
                "take the rate of a deformation or of a position"
            )
        return self.order

    def jet(self, seen: Seen, order: int) -> Jet:
        found = seen.of_model[self.name]
        return [found if self.made is None else self.made(found)]


class RigidReference:
    """The rigid mechanism at the coordinates that joints of the flexible one have, measured at its `nodes`."""

    def __init__(self, kinematics: RigidKinematics) -> None:
        self._kinematics = kinematics
        self._angles = [Reading.of_coordinate(coordinate, kinematics) for coordinate in kinematics.coordinates]
        self.nodes = frozenset().union(*(angle.nodes for angle in self._angles))

    def reached(self, frames: Frames) -> np.ndarray:
        """Return where it can be placed, shape (n,)."""
        return self._kinematics.within_reach(self._measured(frames))

    def poses(self, frames: Frames) -> np.ndarray:
        """Return its poses (n_bodies, n_pose, n), not a number where it cannot be placed."""
        return self._poses(self._measured(frames))

    def jet(self, seen: Seen, order: int) -> Jet:
        """Return its poses at what is seen and their derivatives, each (n_bodies, n_pose, n)."""
        measured = [np.stack(parts, axis=1) for parts in zip(*(angle.jet(seen, order) for angle in self._angles))]
        found = [seen.poses]
        if order:
            known = np.isfinite(seen.poses).all(axis=(0, 1))
            found += [np.full_like(seen.poses, np.nan) for _ in range(order)]
            moving = self._kinematics.jets(seen.poses[..., known], [part[known] for part in measured[1 : order + 1]])
            for whole, part in zip(found[1:], moving):
                whole[..., known] = part
        return found

    def near(self, frames: Frames) -> Callable[[Frames], np.ndarray]:
        """Return what gives its poses for frames next to these, for central differences."""
        measured = self._measured(frames)
        poses = self._kinematics.near(measured, self._poses(measured))
        return lambda beside: poses(self._measured(beside))

    def _measured(self, frames: Frames) -> np.ndarray:
        return np.stack([angle.value(frames) for angle in self._angles], axis=1)

    def _poses(self, measured: np.ndarray) -> np.ndarray:
        inside = self._kinematics.within_reach(measured)
        if inside.all():
            return self._kinematics.poses(measured, missing=True)
        mechanism = self._kinematics.mechanism
        poses = np.full((len(mechanism.bodies), mechanism.space.n_pose, len(measured)), np.nan)
        poses[..., inside] = self._kinematics.poses(measured[inside], missing=True)
        return poses


TIME = "time"  # what t is called in a declared formula
Motions = Sequence[tuple[Any, Any]]  # sympy's symbols of every motion that a controller measures, and of its rate


class Expression(Protocol):
    """A measure of a controller, made of motions; its law prints it."""

    parameters: tuple[str, ...]  # of the scene, that it names

    def symbolic(self, motions: Motions, names: Mapping[str, Any]) -> Any:
        """Return it in sympy's form; `names` has the time t, and parameters as of `in_law`."""


def in_law(parameter: str) -> str:
    """Return what a parameter of the scene is called in the law of a controller."""
    return f"seen_{parameter}"


@dataclass(frozen=True)
class OfMotion:
    """A motion by its number, or its rate."""

    number: int
    derivative: int = 0
    parameters: tuple[str, ...] = ()

    def symbolic(self, motions: Motions, names: Mapping[str, Any]) -> Any:
        return motions[self.number][self.derivative]


@dataclass(frozen=True)
class RateOf:
    """How fast something changes."""

    of: Expression

    @property
    def parameters(self) -> tuple[str, ...]:
        return self.of.parameters

    def symbolic(self, motions: Motions, names: Mapping[str, Any]) -> Any:
        return rate_of(self.of.symbolic(motions, names), motions, names["t"])


@dataclass(frozen=True)
class FormulaOf:
    """A formula in the language of declarations, of expressions by their names there, and parameters of its own."""

    text: str
    parts: tuple[tuple[str, Expression], ...]
    own: tuple[str, ...]  # names of parameters, which are called ``of_NAME`` in the formula

    def __post_init__(self) -> None:
        names = (*(name for name, _ in self.parts), *(f"of_{one}" for one in self.own), TIME)
        check("FormulaOf", self.text, names, called_at())

    @property
    def parameters(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(one for part in (self.own, *(p.parameters for _, p in self.parts)) for one in part))

    def symbolic(self, motions: Motions, names: Mapping[str, Any]) -> Any:
        parts = {name: part.symbolic(motions, names) for name, part in self.parts}
        constants = {f"of_{one}": names[in_law(one)] for one in self.own}
        return symbolic(self.text, {TIME: names["t"], **constants, **parts})


def rate_of(seen: Any, motions: Motions, t: Any) -> Any:
    """Return the rate of an expression of motions and t; of one of rates, which nobody asks for, what is known."""
    import sympy as sp

    return sp.diff(seen, t) + sum((sp.diff(seen, s) * v for s, v in motions), sp.Integer(0))
