"""Ground points, what a scene may say of joints, and the coordinates that describe the rigid motion.

A joint is one class: its entries, what it holds, and what it leaves free. The joints themselves are in `joints`.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, GetJsonSchemaHandler, field_validator
from pydantic_core import CoreSchema

from pgmp_petsc.declare.ideas import JOINTS, PACKAGE, Found, refuse
from pgmp_petsc.scene.fields import (
    AnyScene,
    Connection,
    Direction,
    Interval,
    Name,
    NotNegativeOrParameter,
    NumberOrParameter,
    Place,
    PositiveOrParameter,
    Quantified,
    StiffnessOrParameter,
    Table,
    Unit,
    Use,
    directions_of,
    notes_on,
    quantities_of,
    refusal,
    tried,
)
from pgmp_petsc.scene.messages import problem, unknown

ORIGIN = "origin"
MEASURED = ("turning", "sliding")
MOTIONS = (*MEASURED, "spin")
PARALLEL = 1e-6  # sine of the angle between two axes that are taken for one


def are_parallel(first: Sequence[float], second: Sequence[float]) -> bool:
    """Whether two axes (x, y, z) have one direction."""
    return bool(np.linalg.norm(np.cross(first, second)) < PARALLEL * np.linalg.norm(first) * np.linalg.norm(second))


#: Rotations that a frame has, and what a scene moves in.
TURNS = {2: 1, 3: 3}
WHERE = {2: "in the plane", 3: "in space"}
#: Stiffness of what is along the axes and about them, with the damping beside it.
SPRINGS = ("stiffness", "damping", "turning_stiffness", "turning_damping")
DAMPED_BY = {"stiffness": "damping", "turning_stiffness": "turning_damping"}


class Elastic(Table):
    """A table ``elastic`` of a joint: how stiff it is in the directions that it holds.

    The rigid mechanism closes with the joint locked, and has as many coordinates as without. In the motion the joint
    holds the directions whose stiffness is infinite, and gives way in the others (`mechanism.composition`).
    """

    reference: tuple[Direction, ...] = Field(
        description="first axis, and in space a second one, of the frame in which it is elastic, in the frame of the "
        "first point's owner; their lengths do not matter"
    )
    stiffness: Annotated[tuple[StiffnessOrParameter, ...], Unit("N/m")] = Field(
        (),
        description="along each axis, the last completes the frame (N/m): inf stays rigid, 0 is held by nothing, or a "
        "parameter's name; 0 along an axis that the joint leaves free; without it all that it holds stay rigid",
    )
    damping: Annotated[tuple[NotNegativeOrParameter, ...], Unit("N s/m")] = Field(
        (), description="along each axis (N s/m), numbers or parameters' names; 0 where it is rigid or free"
    )
    turning_stiffness: Annotated[tuple[StiffnessOrParameter, ...], Unit("N m/rad")] = Field(
        (), description="about each axis, in the plane one number (N m/rad), as stiffness"
    )
    turning_damping: Annotated[tuple[NotNegativeOrParameter, ...], Unit("N m s/rad")] = Field(
        (), description="about each axis (N m s/rad), as damping"
    )

    @property
    def structure(self) -> tuple[Any, ...]:
        """Entries that a built model depends on: the axes, and which directions are rigid, held by a spring or damper,
        or by none."""
        keys = chain(*DAMPED_BY.items())
        return self.reference, *(tuple(x if x in (0.0, math.inf) else 1.0 for x in getattr(self, key)) for key in keys)

    def are_all(self, turning: bool) -> bool:
        """Whether springs carry all forces of the joint, or all moments."""
        stiffness = self.turning_stiffness if turning else self.stiffness
        return bool(stiffness) and math.inf not in stiffness

    def problems(self, dimension: int, entry: str) -> Iterator[str]:
        """Yield a line if its axes make no frame, it has not as many numbers as axes, or damps what stays rigid."""
        yield from frame_problems(self, dimension, entry)
        for key, damped in DAMPED_BY.items():
            stiffness, damping = getattr(self, key), getattr(self, damped)
            if not stiffness and any(damping):
                words = f"what it holds stays rigid without {entry}.{key}, and has no damping"
                yield problem(f"{entry}.{damped}", words, list(damping))
            elif any(k == math.inf and c for k, c in zip(stiffness, damping)):
                words = f"what is rigid (inf in {entry}.{key}) has no damping: 0 is needed there"
                yield problem(f"{entry}.{damped}", words, list(damping))


#: Speed of an impact (m/s) of which the restitution comes out where a scene says none.
IMPACT_SPEED = 1.0


class Contact(Table):
    """A table ``clearance``: how much room there is, and what happens where parts touch (`effects.clearance`)."""

    radius: Annotated[PositiveOrParameter, Unit("rad", "m")]
    stiffness: Annotated[PositiveOrParameter, Unit()]
    exponent: Annotated[PositiveOrParameter, Unit("1")] = Field(
        1.5, description="of the depth, at least 1: 1.5 of Hertz for points, about 1 for lines"
    )
    restitution: Annotated[PositiveOrParameter, Unit("1")] = Field(
        description="speed after an impact over that before it, above 0 and at most 1, of an impact at "
        "restitution_speed; slower ones lose less"
    )
    restitution_speed: Annotated[PositiveOrParameter | None, Unit("rad/s", "m/s")] = None
    damping: Literal["hunt_crossley", "hysteresis"] = Field(
        "hunt_crossley",
        description="how impacts lose: by a damper that grows with the depth, with which faster ones lose more, or by "
        "a hysteresis, with which those at restitution_speed and faster ones lose alike",
    )

    def of_stiffness(self, entry: str, slides: bool) -> Iterator[Use]:
        """Yield the stiffness with its unit, as `JointTable.measured`; none where samples have their own exponents."""
        if not isinstance(self.exponent, str):
            unit = f"N/m^{self.exponent:g}" if slides else "N m"
            yield Use(f"{entry}.clearance.stiffness", self.stiffness, "any", (unit,))

    @property
    def structure(self) -> tuple[Any, ...]:
        """Entries that a built model depends on: that there is a clearance, its damping, and whether it rubs."""
        return ("clearance", self.damping)

    def problems(self, scene: AnyScene, entry: str) -> Iterator[str]:
        """Yield a line if exponent or restitution, or a value that a parameter of them has, is none that can be."""
        if not scene.system.is_si and (isinstance(self.exponent, str) or self.exponent >= 10.0):
            words = "a number below 10 is needed in a scene in mm, where N/mm^exponent is the unit of the stiffness"
            yield problem(f"{entry}.exponent", f"{words}; or give the scene in SI units", self.exponent)
        for key, low, high, words in (
            ("exponent", 1.0, math.inf, "must be at least 1, so that the force begins without a jump of its slope"),
            ("restitution", 0.0, 1.0, "must be above 0 and at most 1: no impact makes anything faster"),
        ):
            given = getattr(self, key)
            if not isinstance(given, str):
                values = {f"{entry}.{key}": given}
            elif given in scene.parameters:
                parameter, where = scene.parameters[given], f"parameters.{given}"
                values = {f"{where}.nominal": parameter.nominal, f"{where}.value": parameter.current}
                if parameter.bounds is not None or parameter.distribution is not None:
                    least, most = parameter.range
                    values[f"{where}.bounds"] = least if least < low else most
            else:
                continue
            for where, value in values.items():
                if not low <= value <= high:
                    of = "" if where.startswith(entry) else f"{entry}.{key}: "
                    yield problem(where, of + words, value)
                    break


class Clearance(Contact):
    """A table ``clearance`` of a joint.

    The rigid mechanism closes with the joint locked, and has as many coordinates as without. In the motion the pin is
    free within its room, and beyond that a force acts on it that hangs on how deep it is.
    """

    radius: Annotated[PositiveOrParameter, Unit("m")] = Field(
        description="how far the pin moves from the middle until it touches (m): bore's radius less the pin's, in a "
        "guide half of its play"
    )
    stiffness: Annotated[PositiveOrParameter, Unit()] = Field(
        description="K of the normal force K depth^exponent (N/m^exponent)"
    )
    restitution_speed: Annotated[PositiveOrParameter | None, Unit("m/s")] = Field(
        None, description="speed of the impact that restitution is of (m/s), 1 m/s if not given"
    )
    friction: Annotated[NotNegativeOrParameter, Unit("1")] = Field(
        0.0, description="coefficient of Coulomb's friction in contact"
    )
    friction_speed: Annotated[PositiveOrParameter | None, Unit("m/s")] = Field(
        None,
        description="speed (m/s) up to which friction grows: friction N tanh(v / friction_speed); needed with friction",
    )

    def check_entries(self) -> None:
        if self.friction and self.friction_speed is None:
            raise refusal("friction needs the speed up to which it grows (m/s), such as 1e-3", "friction_speed")
        if self.friction_speed is not None and not self.friction:
            raise refusal("without effect, as there is no friction; leave it out", "friction_speed")

    @property
    def structure(self) -> tuple[Any, ...]:
        return (*super().structure, bool(self.friction))


class Backlash(Contact):
    """A table ``clearance`` of a coupling: its backlash.

    The rigid mechanism closes with the teeth in mesh. In the motion what the coupled motion is off, of the second joint
    of two, the first of terms, is free within half of the backlash, and beyond that a torque or force acts on it as
    that of a contact.
    """

    radius: Annotated[PositiveOrParameter, Unit("rad", "m")] = Field(
        description="half of the backlash, of the motion of the second joint, the first of terms (rad or m)"
    )
    stiffness: Annotated[PositiveOrParameter, Unit()] = Field(
        description="K of K depth^exponent (N m/rad^exponent or N/m^exponent)"
    )
    restitution_speed: Annotated[PositiveOrParameter | None, Unit("rad/s", "m/s")] = Field(
        None, description="speed of the impact that restitution is of, 1 rad/s or 1 m/s if not given"
    )


class Offset(Table):
    """A table ``offset`` of a joint: how far it is from where it should be.

    The rigid mechanism closes without it, and has as many coordinates. In the motion the joint holds the moved point
    and the turned axes of its first body, and bodies give way where redundant joints then do not agree.
    """

    place: Annotated[tuple[NumberOrParameter, ...], Unit("m")] = Field(
        (), description="(x, y), in space (x, y, z), by which the first point is off (m), numbers or parameters' names"
    )
    turn: Annotated[tuple[NumberOrParameter, ...], Unit("rad")] = Field(
        (),
        description="how far its axes are turned there: one angle in the plane, in space axis times angle (rad); "
        "numbers or parameters' names",
    )

    def has(self, name: str | None) -> bool:
        """Return whether an entry names a parameter; of None, whether one is a number but 0."""
        entries = (*self.place, *self.turn)
        return name in entries if name is not None else any(x for x in entries if not isinstance(x, str))

    def part(self, sizes: Mapping[str | None, float]) -> Self:
        """Return the offset at some values of the parameters, 0 of others; under None is what its numbers are times."""

        def of(value: float | str) -> float:
            return sizes.get(value, 0.0) if isinstance(value, str) else sizes.get(None, 0.0) * value

        return self.model_copy(update={"place": tuple(map(of, self.place)), "turn": tuple(map(of, self.turn))})

    def problems(self, dimension: int, entry: str) -> Iterator[str]:
        """Yield a line if it has nothing, or not as many numbers as directions or turns."""
        if not self.place and not self.turn:
            yield problem(entry, "place or turn is needed, such as { place = [0.0, 0.0, 1e-4] }", {})
        yield from _count_problems(self, entry, dimension, place=dimension, turn=TURNS[dimension])


def _count_problems(table: Any, entry: str, dimension: int, each: str = "", **counts: int) -> Iterator[str]:
    """Yield a line for each list of numbers that is there, and has not as many as are counted."""
    for key, count in counts.items():
        numbers = getattr(table, key)
        if numbers and len(numbers) != count:
            what = "one number is" if count == 1 else f"{count} numbers{each} are"
            yield problem(f"{entry}.{key}", f"{what} needed {WHERE[dimension]}", list(numbers))


def frame_problems(springs: Any, dimension: int, entry: str) -> Iterator[str]:
    """Yield a line if the axes of springs and dampers make no frame, or these are not as many as axes."""
    n = dimension
    wanted = "two axes of three numbers, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]" if n == 3 else "one axis, [[1.0, 0.0]]"
    given = [list(axis) for axis in springs.reference]
    if len(given) != n - 1 or any(len(axis) != n for axis in given):
        yield problem(f"{entry}.reference", f"{wanted} for example, is needed {WHERE[n]}", given)
    elif n == 3 and are_parallel(*given):
        yield problem(f"{entry}.reference", "the axes must not be parallel; the second one is at a right angle", given)
    counts = dict(zip(SPRINGS, (n, n, TURNS[n], TURNS[n])))
    yield from _count_problems(springs, entry, n, ", one for each axis,", **counts)


class Ground(Table):
    """Points fixed in space; ``ground:origin`` at (0, 0) is always there."""

    points: dict[Name, Place] = Field(
        {ORIGIN: (0.0, 0.0)},
        description="position (x, y) of each point (m), (x, y, z) in space; each a number or a parameter's name",
    )

    @property
    def positions(self) -> dict[str, tuple[float | str, ...]]:
        """Position of every ground point (m, or names of parameters), the origin included."""
        return {ORIGIN: (0.0, 0.0), **self.points}

    @field_validator("points")
    @classmethod
    def _origin_stays(cls, points: dict[str, tuple[float | str, ...]]) -> dict[str, tuple[float | str, ...]]:
        if any(points.get(ORIGIN, ())):
            raise refusal("the ground's origin is always at [0, 0]; give the point another name", ORIGIN)
        return points


class JointTable(Table):
    """A table ``[joints.NAME]``: a joint that holds two points (`JointEntry`), or one that couples the motions of
    others (`CouplingEntry`)."""

    #: Where it can be: 2 in the plane, 3 in space.
    dimensions: ClassVar[tuple[int, ...]]
    #: Motions that it leaves free and that are measured: ``turning`` about its first axis, ``sliding`` along it, or
    #: ``spin`` about several axes.
    motions: ClassVar[tuple[str, ...]] = ()
    #: Another that it leaves free in the plane, where coordinates, effects and outputs say which one they mean.
    also_in_plane: ClassVar[tuple[str, ...]] = ()
    #: Where it may have a clearance: "across" its first axis, "everywhere", between the "teeth" of couplings, or none.
    loose: ClassVar[str] = ""
    #: Whether in the motion it holds to the run of nodes along its first axis, as they bend.
    rides: ClassVar[bool] = False

    @property
    def gives_way(self) -> str:
        """The entry by which it releases directions in the motion, empty where it is rigid."""
        return "elastic" if self.elastic is not None else "clearance" if self.clearance is not None else ""

    @classmethod
    def motions_in(cls, dimension: int) -> tuple[str, ...]:
        """Return the motions that it leaves free in the plane or in space, that which effects mean first."""
        return cls.motions + (cls.also_in_plane if dimension == 2 else ())

    def motion_of(self, said: str | None, allowed: Sequence[str], dimension: int) -> str | None:
        """Return the one of the allowed motions that an entry means that says one, or none; None where it has to."""
        free = [one for one in self.motions if one in allowed]
        free = free or [one for one in self.motions_in(dimension) if one in allowed]
        return said or (free[0] if len(free) == 1 else None)

    def n_constraints(self, dimension: int) -> int:
        """Return the number of statements in the plane or in space."""
        raise NotImplementedError

    def measured(self, scene: AnyScene, entry: str) -> Iterator[Use]:
        """Yield entries whose unit hangs on the rest of the scene; `entry` is the joint's."""
        yield from ()

    def problems(self, scene: AnyScene, name: str) -> Iterator[str]:
        """Yield a line for each entry that does not fit the rest of the scene."""
        yield from ()


class JointEntry(JointTable):
    """A table ``[joints.NAME]``. A joint is a subclass with ``type: Literal["..."]``, its entries, and `statements`.

    It holds two points of different bodies, or of a body and the ground.
    """

    connect: Connection = Field(description='the two points, "body:point" or "ground:point"')
    elastic: Elastic | None = Field(None, description="how it gives way in the directions that it holds")
    offset: Offset | None = Field(
        None, description="how far it is from where it should be, in the frame of the first point's owner"
    )
    clearance: Clearance | None = Field(None, description="how much room it has across its axis, and contact beyond")

    @classmethod
    def __pydantic_init_subclass__(cls, **arguments: Any) -> None:
        if not JOINTS.take(cls):
            return
        dimensions = getattr(cls, "dimensions", ())
        if not dimensions or not {*dimensions} <= {2, 3}:
            raise refuse(cls, "a joint says where it can be: dimensions = (2, 3), in the plane and in space, or one")
        if not {*cls.motions, *cls.also_in_plane} <= {*MOTIONS}:
            raise refuse(cls, f"motions that a joint leaves free are {', '.join(MOTIONS)}")
        if cls.statements is JointEntry.statements:
            raise refuse(cls, "a joint has the method statements(self, in_a, in_b), which returns what it holds")
        named = [key for key, field in cls.model_fields.items() if notes_on(field, Quantified)]
        if named:
            why = "may name a parameter, and what a joint holds has numbers alone"
            raise refuse(cls, f'{named[0]} {why}: write Annotated[float, Unit("m")]')
        if not cls.__module__.startswith(PACKAGE):
            try_statements(cls)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        found = handler(schema)
        where = " and ".join(WHERE[d] for d in cls.dimensions)
        free = f"; {' and '.join(cls.motions)} can be acted on and measured" if {*cls.motions} & {*MEASURED} else ""
        free += f", in the plane {' and '.join(cls.also_in_plane)} too" if cls.also_in_plane else ""
        of = handler.resolve_ref_schema(found)
        of["description"] = f"{of['description']} {where.capitalize()}{free}."
        return found

    def measured(self, scene: AnyScene, entry: str) -> Iterator[Use]:
        if self.clearance is not None:
            yield from self.clearance.of_stiffness(entry, True)

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """How the joint stands, none, one or two directions in the frame of the first point's owner: its entries that
        are directions."""
        given = (getattr(self, key) for key in directions_of(type(self)))
        return tuple(axis for axis in given if axis is not None)

    def statements(self, in_a: np.ndarray, in_b: np.ndarray) -> Sequence[Any]:
        """Return what is to be zero, `mechanism.statements` about the frames a and b of its points.

        The joint's axes, an orthonormal triad along `axes`, are given in the frame of a, and the same directions, as
        assembled, in the frame of b, shape (d, d) each, one axis a column.
        """
        raise NotImplementedError

    def n_constraints(self, dimension: int) -> int:
        return len(self.statements(np.eye(dimension), np.eye(dimension)))

    def without_spin(self, axes: np.ndarray) -> str:
        """Return the entries of a joint in its place that holds what this one leaves free between two such joints.

        That is an idle spin of a body about the line through both, across which `axes` (3, 2) are, one a column, in the
        frame of a. Empty where it holds that.
        """
        return ""


def try_statements(cls: type[JointEntry]) -> None:
    """Refuse a joint that does not return statements where it says that it can be."""
    for d in cls.dimensions:
        try:
            held = tried(cls).statements(np.eye(d), np.eye(d))
            terms = [getattr(part, "terms", None) for part in held or ()]
            if not terms or None in terms or any(own.axes.shape != (3, d) for part in terms for own, _ in part):
                raise TypeError(f"a list of mechanism.statements in {d} dimensions is needed")
        except Exception as error:
            if not isinstance(getattr(error, "obj", None), cls) or error.name not in cls.model_fields:
                raise refuse(cls, f"statements: {type(error).__name__}: {error}") from error


class ElasticCoupling(Table):
    """A table ``elastic`` of a coupling: how stiff it is, as teeth in mesh or a belt are.

    The rigid mechanism closes with the coupling rigid, and has as many coordinates. In the motion a spring and a damper
    act on what the sum is off, in units of the motion of its first share.
    """

    stiffness: Annotated[PositiveOrParameter, Unit("N m/rad", "N/m")] = Field(
        description="of what the coupled motion is off, of the second joint of two, the first of terms (N m/rad where "
        "it turns, N/m where it slides)"
    )
    damping: Annotated[NotNegativeOrParameter, Unit("N m s/rad", "N s/m")] = Field(
        0.0, description="damping (N m s/rad or N s/m)"
    )

    def are_all(self, turning: bool) -> bool:
        """Whether springs carry all of it: there is one."""
        return True


@dataclass(frozen=True)
class Share:
    """The share of the motion of one joint in a coupling: a factor, a number or a parameter's name, times a number, and
    the points of a spline (rad, and rad or m) that both are of, where they are not of the motion itself."""

    joint: str
    motion: str | None  # turning or sliding; None where the joint has both and the scene says neither
    entry: str  # that names the joint, behind the coupling's own name
    factor: float | str = 1.0
    times: float = 1.0
    table: tuple[tuple[float, float], ...] = ()


class CouplingEntry(JointTable):
    """A table ``[joints.NAME]`` that couples the motions of other joints: the sum of its shares keeps its value.

    A coupling is a subclass with ``type: Literal["..."]``, its entries, and `shares`.
    """

    loose = "teeth"
    #: Whether the sum keeps the value that it has as the bodies are placed; it is zero otherwise.
    from_placements: ClassVar[bool] = True
    offset: ClassVar[None] = None
    connect: ClassVar[tuple[str, ...]] = ()  # the points that it holds
    elastic: ElasticCoupling | None = Field(None, description="how it gives way in the motion")
    clearance: Backlash | None = Field(None, description="backlash; a belt has none")

    @classmethod
    def __pydantic_init_subclass__(cls, **arguments: Any) -> None:
        if JOINTS.take(cls) and cls.shares is CouplingEntry.shares:
            raise refuse(cls, "a coupling has the method shares(self, motion), which returns what it couples")

    def n_constraints(self, dimension: int) -> int:
        return 1

    def shares(self, motion: Callable[[str, str | None], str | None]) -> list[Share]:
        """Return what is added; `motion` gives that of a joint by its name, of several the one that is said."""
        raise NotImplementedError

    def with_numbers(self, values: Mapping[str, float]) -> Self:
        """Return the coupling with numbers in place of parameters, by their names."""

        def number(given: Any) -> Any:
            if isinstance(given, dict):
                return {name: number(one) for name, one in given.items()}
            return tuple(map(number, given)) if isinstance(given, tuple) else values.get(given, given)

        return self.model_copy(update={key: number(getattr(self, key)) for key in quantities_of(type(self))})

    def shares_in(self, scene: AnyScene) -> list[Share]:
        """Return what is added in a scene whose joints it has."""

        def motion(joint: str, said: str | None = None) -> str | None:
            found = scene.joints.get(joint)
            return said if found is None else found.motion_of(said, MEASURED, scene.dimension)

        return self.shares(motion)

    def measured(self, scene: AnyScene, entry: str) -> Iterator[Use]:
        if self.clearance is not None:
            yield from self.clearance.of_stiffness(entry, self.shares_in(scene)[0].motion == "sliding")

    def problems(self, scene: AnyScene, name: str) -> Iterator[str]:
        """Yield a line for each joint that there is not, or that does not move as is needed."""
        found = self.shares_in(scene)
        for share in found:
            entry, joint = f"joints.{name}.{share.entry}", scene.joints.get(share.joint)
            moving = [other for other, one in scene.joints.items() if {*one.motions_in(scene.dimension)} & {*MEASURED}]
            if joint is None:
                yield unknown(entry, "joint", share.joint, moving)
                continue
            free = [one for one in joint.motions_in(scene.dimension) if one in MEASURED]
            if share.motion is None and len(free) > 1:
                words = f"{share.joint} is {joint.type}, which turns and slides; couple it by a gear, a rack or a screw"
                yield problem(entry, words, share.joint)
            elif share.motion not in free:
                needed = f"has the motion {share.motion}" if share.motion else "turns or slides"
                moves = f"this one is {joint.type}" + (f", which has {' and '.join(free)}" if free else "")
                yield problem(entry, f"a joint that {needed} is needed; {moves}", share.joint)
        if scene.dimension == 3:
            yield from self._turns_unknown(scene, name, found)
        moved = [(share.joint, share.motion) for share in found]
        for k, share in enumerate(found):
            if moved[k] in moved[:k]:
                yield problem(f"joints.{name}.{share.entry}", "the same joint is named twice", share.joint)

    def _turns_unknown(self, scene: AnyScene, name: str, found: Sequence[Share]) -> Iterator[str]:
        """Yield a line if turns of more than one angle are not known: directors tell angles up to turns."""
        known = coordinate_motions(scene) | followed(scene).keys()
        turning = [share for share in found if share.motion == "turning" and not share.table]
        loose = [share for share in turning if (share.joint, share.motion) not in known]
        if len(loose) > 1:
            why = (
                "in space turns are counted from the coordinates: all but one of the joints that turn must be those of "
                "coordinates, or follow from them by other couplings"
            )
            cure = f"couple each of these with one: {', '.join(share.joint for share in loose)}"
            yield problem(f"joints.{name}.{loose[0].entry}", f"{why}; {cure}")


def coordinate_motions(scene: AnyScene) -> set[tuple[str | None, str]]:
    """Return joints and motions, turning or sliding, that coordinates of a scene may be."""
    own = scene.coordinates.values()
    return {(one.joint, motion) for one in own for motion in MEASURED if one.motion in (None, motion)}


def followed(scene: AnyScene) -> dict[tuple[str, str], str]:
    """Return joints and motions that follow from the coordinates by couplings, as those behind a row of gears, each by
    the name of its coupling, behind those that it follows from."""
    known, found = coordinate_motions(scene), {}
    rest = {name: one.shares_in(scene) for name, one in scene.joints.items() if isinstance(one, CouplingEntry)}
    for _ in range(len(rest)):
        for name in [one for one in rest if one not in found.values()]:
            loose = [(share.joint, share.motion) for share in rest[name] if (share.joint, share.motion) not in known]
            if len(loose) == 1 and not any(share.table for share in rest[name]):
                found[loose[0]] = name
                known.add(loose[0])
    return found


#: A table of ``[joints]``.
Joint = Annotated[JointTable, Found(JOINTS)]


class Coordinate(Table):
    """A rigid coordinate: a motion that a joint leaves free, or the distance of two points, over a range."""

    one_of = ("joint", "points")
    joint: str | None = Field(None, description="name of a joint that turns or slides; its motion is the coordinate")
    motion: Literal["turning", "sliding"] | None = Field(
        None, description="which motion of the joint; needed where it has both"
    )
    points: Connection | None = Field(
        None, description='in place of a joint: two points, "body:point" or "ground:point", whose distance it is'
    )
    range: Annotated[Interval, Unit("rad", "m")] = Field(
        description="first and last angle (rad), displacement or distance (m); an angle is zero where the frames of "
        "both bodies point the same way, in space where the bodies are as placed, a displacement where the points meet"
    )
    periodic: bool = Field(
        False, strict=True, description="whether the range of an angle closes on itself (it is then 2 pi long)"
    )

    def check_entries(self) -> None:
        if self.points is not None and self.motion is not None:
            raise refusal("a distance has one motion; leave it out", "motion")
        low, high = self.range
        if self.periodic and abs(high - low - 2.0 * math.pi) > 1e-9:
            degrees = "; it is in rad, not in degrees" if high - low == 360.0 else ""
            raise refusal(f"the range of a periodic coordinate is 2 pi = {2.0 * math.pi!r} long{degrees}", "range")
