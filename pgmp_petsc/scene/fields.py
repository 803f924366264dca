"""Field types that the tables of a scene share: numbers, pairs, names, points, and functions of time (tables,
harmonics, and the motions of a driven coordinate). Numbers are in the scene's units, or texts with a unit of their own
where the entry says its `Unit`."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import pairwise, product
from typing import Annotated, Any, ClassVar, Literal, Self, TypeGuard, TypeVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from pgmp_petsc.base.errors import visible
from pgmp_petsc.base.units import QUANTITY, SI, UnknownUnit, number_of
from pgmp_petsc.declare.ideas import refuse

GROUND = "ground"
GROUND_ORIGIN = "ground:origin"
#: Which numbers make sense in an entry. A spring may be negative: a magnet, or one past its dead point.
Sign = Literal["positive", "not negative", "not zero", "any"]
#: Largest magnitude of a number, and smallest other than 0: fourth powers of lengths and products of a few numbers stay
#: far within what a float can hold (1e-308 to 1e308).
LARGEST, SMALLEST = 1e30, 1e-30
MOST_RADIANS = 1e6  # beyond it an angle is rounded by more than 1e-10 rad
NAME = "[A-Za-z_][A-Za-z0-9_-]*"
NAMED = "a number or a parameter's name"  # of an entry that is missing
LONGEST_NAME = 100  # characters: names become data sets, columns and titles


class Table(BaseModel):
    """A table of a scene: unknown keys are refused and values never change after validation.

    Annotations of a base that many tables have are evaluated where they stand, not postponed: pydantic would evaluate
    their texts once more for each of the tables, which takes a noticeable part of the start.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    #: Entries of which it has exactly one; so it has of those that a class names of which it is a subclass.
    one_of: ClassVar[tuple[str, ...]] = ()

    @model_validator(mode="after")
    def _fits_itself(self) -> Self:
        declared = [vars(cls) for cls in reversed(type(self).__mro__)]
        for own in declared:
            if keys := own.get("one_of"):
                exactly_one(self, *keys)
        for own in declared:
            if check := own.get("check_entries"):
                check(self)
        return self

    def check_entries(self) -> None:
        """Raise `refusal` where entries do not fit each other; so do those of the classes of which it is a subclass."""


#: A scene as its own entries and their checks see it: a `Scene`, whose entries are of the kinds that are found.
AnyScene = Any


class OrText:
    """A note on numbers: each may be a text with its unit, as editors are told."""

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return _or_text(handler(schema))


@dataclass(frozen=True)
class Unit(OrText):
    """A note on an entry: its SI unit where it acts on a rotation, and on what slides; none if any may be.

    A number may then be a text with another unit of the dimension, which is converted to the scene's units.
    """

    on_turning: str = ""
    on_sliding: str = ""

    def where(self, slides: bool) -> str:
        """Return the unit where something slides, or a rotation is acted on."""
        return self.on_sliding or self.on_turning if slides else self.on_turning

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.with_info_before_validator_function(self.numbers, handler(source))

    def numbers(self, value: object, info: ValidationInfo) -> object:
        """Return numbers in the units of the scene; texts that are none, such as names of parameters, as they are."""
        if isinstance(value, (list, tuple)):
            return [self.numbers(one, info) for one in value]
        units = tuple(filter(None, dict.fromkeys((self.on_turning, self.on_sliding))))
        try:
            number = number_of(value, units, (info.context or {}).get("system", SI)) if isinstance(value, str) else None
        except UnknownUnit as error:
            raise refusal(str(error)) from error
        return value if number is None else number


#: A text that is a number with its unit, for editors.
TEXT = {"type": "string", "pattern": QUANTITY}


def _or_text(schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of numbers, for editors, where texts are numbers too; texts that are allowed stay."""
    if schema.get("type") == "number":
        limits = {key: schema[key] for key in _OF_NUMBERS if key in schema}
        return {key: one for key, one in schema.items() if key not in limits} | {"anyOf": [limits, TEXT]}
    if schema.get("type") == "array":
        changed = {"items": _or_text, "prefixItems": lambda items: [_or_text(one) for one in items]}
        return schema | {key: change(schema[key]) for key, change in changed.items() if key in schema}
    kinds = schema.get("anyOf", ())
    if not kinds or any(one.get("type") == "string" for one in kinds):
        return schema
    parts = [_or_text(one) for one in kinds]
    return {**schema, "anyOf": [one for part in parts for one in part.get("anyOf", [part])]}


_OF_NUMBERS = ("type", "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum")


@dataclass(frozen=True)
class Quantified:
    """A note on a type that takes a parameter's name: which numbers make sense."""

    sign: Sign


Note = TypeVar("Note")


def notes_on(field: FieldInfo, kind: type[Note]) -> list[Note]:
    """Return the notes of a kind on a field of a table and on its types, from the outside inwards."""

    def within(hint: Any) -> Iterator[Any]:
        yield from getattr(hint, "__metadata__", ())
        for part in get_args(hint):
            yield from within(part)

    return [note for note in (*field.metadata, *within(field.annotation)) if isinstance(note, kind)]


@cache
def quantities_of(table: type[Table]) -> dict[str, tuple[Sign, Unit]]:
    """Return the entries of a table that may name a parameter, with their signs and units; raises `InputError` if one
    of them has no unit."""
    found = {}
    for name, field in table.model_fields.items():
        signs, units = notes_on(field, Quantified), notes_on(field, Unit)
        if signs and not units:
            raise refuse(table, f'{name} may name a parameter, and has no unit: write Annotated[..., Unit("N m")]')
        if signs:
            found[name] = signs[0].sign, units[0]
    return found


#: Values of entries, of which each is given the first that it takes.
TRIED = (1.0, 1, "ground:origin", (1.0, 0.0), (1.0, 0.0, 0.0), ("ground:origin", "body:point"), ((1.0, 0.0),))


def tried(table: type[Table]) -> Any:
    """Return a table with some value in each entry that it needs, as far as one is found: its methods can be tried."""
    values = {}
    for key, entry in table.model_fields.items():
        if entry.is_required():
            kind = TypeAdapter(Annotated[entry.annotation, entry])
            for value in TRIED:
                with suppress(ValidationError):
                    values.setdefault(key, kind.validate_python(value))
    return table.model_construct(**values)


@dataclass(frozen=True)
class Use:
    """One entry that may name a parameter, or whose unit alone is told."""

    entry: str  # dotted name
    value: float | str = 0.0  # what it holds
    sign: Sign = "any"  # which numbers make sense
    #: what it is in, any of them; "1" is without a unit, none is any unit. The factor of a table is without one, or has
    #: the table's.
    units: tuple[str, ...] = ()

    @classmethod
    def of_rows(cls, entry: str, rows: Rows | None, *units: str) -> Iterator[Self]:
        """Yield the entries of a table's rows, as many columns as have units; none where there is no table."""
        for row, column in product(range(len(rows or ())), range(len(units))):
            yield cls(f"{entry}[{row}][{column}]", units=(units[column],))

    @property
    def parameter(self) -> str | None:
        """Name of the parameter that it holds, or None."""
        return self.value if isinstance(self.value, str) else None


def named_numbers(entry: str, table: Table | None, slides: bool = False) -> Iterator[Use]:
    """Yield each number of a table, whose own entry is given, that may name a parameter, where it has one.

    `slides` is whether they are of what slides; what is rigid, with an infinite stiffness, is none.
    """
    for key, (sign, unit) in quantities_of(type(table)).items() if table is not None else ():
        found, units = getattr(table, key), tuple(filter(None, (unit.where(slides),)))
        if isinstance(found, dict):
            yield from (Use(f"{entry}.{key}.{name}", value, sign, units) for name, value in found.items())
        else:
            values = found if isinstance(found, tuple) else (found,)
            numbers = (value for value in values if value is not None and value != math.inf)
            yield from (Use(f"{entry}.{key}", value, sign, units) for value in numbers)


def refusal(allowed: str, key: str = "") -> PydanticCustomError:
    """Return the error that a validator raises: what is allowed, and the key that is to blame."""
    return PydanticCustomError("refusal", "{allowed}", {"allowed": allowed, "key": key})


def exactly_one(table: Table, *keys: str) -> None:
    """Refuse a table that does not have exactly one of some keys."""
    given = [key for key in keys if getattr(table, key) is not None]
    if len(given) != 1:
        found = f"{' and '.join(given)} are given" if given else "none is given"
        raise refusal(f"exactly one of {', '.join(keys)} is needed; {found}", given[-1] if given else keys[0])


def is_number(value: object) -> TypeGuard[float]:
    """Say whether `value` is a finite number; true and false are none."""
    try:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an integer beyond the largest float
        return False


@dataclass(frozen=True)
class at_most:  # noqa: N801, is among the other notes on a type and reads as they do
    """A check that refuses numbers above `limit`, with the reason for it; schemas for editors have the limit."""

    limit: float
    reason: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {**handler(schema), "maximum": self.limit}

    def _check(self, value: float) -> float:
        if value > self.limit:
            raise refusal(f"must be at most {self.limit:,}: {self.reason}")
        return value


def raw_tables(data: dict[str, Any], key: str) -> dict[str, dict[str, Any]]:
    """Return the tables [KEY.NAME] of raw tables by name; what is none is left for the validation to refuse."""
    tables = data.get(key)
    return {name: one for name, one in tables.items() if isinstance(one, dict)} if isinstance(tables, dict) else {}


def split_point(point: str) -> tuple[str, str]:
    """Split ``"rod:tip"`` into the body's name (or ``"ground"``) and the name of the point on it."""
    owner, _, name = point.partition(":")
    return owner, name


Words = str | Callable[[Any], str]


def needed(what: Words, fits: Callable[[Any], object], kind: Any = BeforeValidator) -> Any:
    """Return the check of a value, by default as it is written, which says `what` is needed where it does not fit."""

    def check(value: object) -> object:
        if not fits(value):
            raise refusal(what(value) if callable(what) else what)
        return value

    return kind(check)


def _read(what: Words, fits: Callable[[Any], object]) -> AfterValidator:
    """Return the check of a value that was read."""
    return needed(what, fits, AfterValidator)


def _parts(value: object) -> tuple[Any, ...]:
    """Return the entries of a tuple or list, or the one value."""
    return tuple(value) if isinstance(value, (list, tuple)) else (value,)


def _is_list(value: object, *lengths: int) -> bool:
    return isinstance(value, (list, tuple)) and len(value) in lengths


def _are_numbers(*lengths: int) -> Callable[[Any], bool]:
    return lambda value: _is_list(value, *lengths) and all(map(is_number, value))


def _is_number_or_name(value: object) -> bool:
    return isinstance(value, str) or is_number(value)


def no_parameter(why: str) -> BeforeValidator:
    """Return the check of an entry that is a number, or numbers, alone: a name is refused with why, and the cure."""

    def has_no_name(value: object) -> bool:
        return not any(isinstance(one, str) for part in _parts(value) for one in _parts(part))

    return needed(f"numbers are needed, no parameter: {why}", has_no_name)


def _either(**bounds: float) -> WithJsonSchema:
    """Return the schema, for editors, of a number within bounds, or a parameter's name."""
    name = {"type": "string", "description": "a parameter's name"}
    return WithJsonSchema({"anyOf": [{"type": "number", **bounds}, name]})


def _or_parameter(
    what: str, sign: Sign, fits: Callable[[float], bool] = lambda x: True, infinite: bool = False, **bounds: float
) -> Any:
    """Return the type of a number that fits, or of the name of a parameter."""

    def is_one(value: object) -> bool:
        return isinstance(value, str) or (is_number(value) or infinite and value == math.inf) and fits(value)

    check = needed(f"{what} or the name of a parameter is needed", is_one)
    return Annotated[(float | str, check, _SENSIBLE, _either(**bounds), Quantified(sign))]


def _of_sensible_size(value: object) -> bool:
    numbers = (n for n in _parts(value) if not isinstance(n, str))
    return all(not n or n == math.inf or SMALLEST <= abs(n) <= LARGEST for n in numbers)


_SENSIBLE = _read(f"0 or a magnitude from {SMALLEST:g} to {LARGEST:g} is needed", _of_sensible_size)
_FEW_TURNS = _read(
    f"must be within {MOST_RADIANS:,.0f} rad of 0; larger angles are rounded", lambda x: abs(x) <= MOST_RADIANS
)
#: A finite number; text and booleans are refused.
Number = Annotated[float, Field(strict=True, allow_inf_nan=False), _SENSIBLE]
#: An angle (rad).
Angle = Annotated[Number, _FEW_TURNS, Unit("rad")]
#: An angle (rad), or a displacement (m) where what it is of slides.
AngleOrPlace = Annotated[Number, _FEW_TURNS, Unit("rad", "m")]
#: A time (s).
Time = Annotated[Number, Unit("s")]
#: An integer; numbers with a decimal point are refused.
Integer = Annotated[int, Field(strict=True)]
#: A number, or the name of a parameter.
NumberOrParameter = _or_parameter("a finite number", "any")
#: A number other than 0, or the name of a parameter.
NotZeroOrParameter = _or_parameter("a number other than 0", "not zero", lambda x: x != 0)
#: A positive number, or the name of a parameter.
PositiveOrParameter = _or_parameter("a positive number", "positive", lambda x: x > 0, exclusiveMinimum=0)
#: Two positive numbers, or names of parameters.
PositivePair = Annotated[
    tuple[float | str, float | str],
    needed(
        "two positive numbers in brackets are needed, such as [0.05, 0.1], each a number or a parameter's name",
        lambda value: _is_list(value, 2) and all(isinstance(x, str) or is_number(x) and x > 0 for x in value),
    ),
    _SENSIBLE,
    WithJsonSchema({"type": "array", "items": _either(exclusiveMinimum=0).json_schema, "minItems": 2, "maxItems": 2}),
    Quantified("positive"),
]
#: A number that is not negative, or the name of a parameter.
NotNegativeOrParameter = _or_parameter("a number that is not negative", "not negative", lambda x: x >= 0, minimum=0)
#: A stiffness: a number that is not negative, inf for what is rigid, or the name of a parameter.
StiffnessOrParameter = _or_parameter(
    "a number that is not negative, inf for rigid,", "not negative", lambda x: x >= 0, True, minimum=0
)
#: A positive number.
PositiveNumber = Annotated[Number, Field(gt=0.0)]
#: A number that is not negative.
NotNegative = Annotated[Number, Field(ge=0.0)]
#: Two finite numbers (x, y).
Pair = Annotated[
    tuple[float, float],
    needed("two finite numbers in brackets are needed, such as [0.0, 1.0]", _are_numbers(2)),
    _SENSIBLE,
]
#: A time (s), and a number or the name of a parameter.
Row = Annotated[
    tuple[float, float | str],
    needed(
        "a finite number, and one or the name of a parameter, are needed in brackets, such as [0.0, 1.0]",
        lambda value: _is_list(value, 2) and is_number(value[0]) and _is_number_or_name(value[1]),
    ),
    _SENSIBLE,
    WithJsonSchema({"type": "array", "prefixItems": [{"type": "number"}, _either().json_schema]}),
]
#: Two finite numbers (low, high), low < high.
Interval = Annotated[Pair, _read("the first number must be below the second", lambda ends: ends[0] < ends[1])]
#: A place along a line (m) that no parameter can be.
Along = Annotated[
    Number,
    no_parameter(
        "it moves the axes of a body's frame alone, and no mechanism; the length of a line and places of ground.points "
        "may be parameters"
    ),
    Unit("m"),
]
#: A point or vector: two finite numbers (x, y) in the plane, three (x, y, z) in space.
Vector = Annotated[
    tuple[float, ...],
    needed("two finite numbers in brackets (three in space) are needed, such as [0.0, 1.0]", _are_numbers(2, 3)),
    _SENSIBLE,
    WithJsonSchema({"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 3}),
]
#: A place (m): two entries (x, y) in the plane, three in space, each a number or the name of a parameter.
Place = Annotated[
    tuple[float | str, ...],
    needed(
        "two finite numbers in brackets (three in space) are needed, such as [0.0, 1.0], each a number or a "
        "parameter's name",
        lambda value: _is_list(value, 2, 3) and all(map(_is_number_or_name, value)),
    ),
    _SENSIBLE,
    WithJsonSchema({"type": "array", "items": _either().json_schema, "minItems": 2, "maxItems": 3}),
    Unit("m"),
]
#: Places in a body's frame or in space (m), which no parameter can be.
FixedPlace = Annotated[Vector, Unit("m")]
_NOT_ZERO = _read(lambda value: f"a direction other than [{', '.join('0' for _ in value)}] is needed", any)
#: A vector other than zero; its length does not matter.
Direction = Annotated[Vector, _NOT_ZERO]
#: Three finite numbers (x, y, z).
Triple = Annotated[
    tuple[float, float, float],
    needed("three finite numbers in brackets are needed, such as [0.0, 0.0, 1.0]", _are_numbers(3)),
    _SENSIBLE,
]
#: A direction in space.
Axis = Annotated[Triple, _NOT_ZERO]


@cache
def directions_of(table: type[Table]) -> tuple[str, ...]:
    """Return the entries of a table that are directions, in their order."""
    return tuple(key for key, field in table.model_fields.items() if _NOT_ZERO in notes_on(field, AfterValidator))


#: A moment of inertia, or the six entries of a tensor, each a number or the name of a parameter.
Inertia = Annotated[
    float | str | tuple[float | str, ...],
    needed(
        "moments of inertia are positive", lambda value: all(isinstance(n, str) or n > 0.0 for n in _parts(value)[:3])
    ),
    needed(
        "a moment of inertia in the plane, or six entries [ixx, iyy, izz, ixy, ixz, iyz] in space, each a number or a "
        "parameter's name, are needed",
        lambda value: (
            len(_parts(value)) == (6 if isinstance(value, (list, tuple)) else 1)
            and all(map(_is_number_or_name, _parts(value)))
        ),
    ),
    _SENSIBLE,
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "number", "exclusiveMinimum": 0},
                {"type": "string"},
                {"type": "array", "items": _either().json_schema, "minItems": 6, "maxItems": 6},
            ]
        }
    ),
    Unit("kg m2"),
]
#: A text that titles and terminals show.
OneLine = Annotated[
    str,
    _read(
        "control characters and line ends have no place in it: titles and terminals show it",
        lambda text: visible(text) == text and "\n" not in text and "\t" not in text,
    ),
]
#: Name of a table that the user chooses; it becomes the name of a data set.
Name = Annotated[
    str,
    _read(
        lambda name: f"a name has at most {LONGEST_NAME} characters, this one has {len(name)}",
        lambda name: len(name) <= LONGEST_NAME,
    ),
    _read(
        "a name starts with a letter or _ and goes on with letters, digits, _ or -",
        lambda name: re.fullmatch(NAME, name),
    ),
    WithJsonSchema({"type": "string", "pattern": f"^{NAME}$"}),
]
#: Names of two joints.
TwoNames = Annotated[
    tuple[Name, Name],
    needed(
        'the names of two joints in brackets are needed, such as ["input", "output"]',
        lambda value: _is_list(value, 2) and all(isinstance(name, str) for name in value),
    ),
]
_AT_A_POINT = needed(
    'a point is needed, written "body:point" or "ground:point"',
    lambda value: isinstance(value, str) and all(split_point(value)),
)
#: "body:point" or "ground:point".
Point = Annotated[str, _AT_A_POINT, WithJsonSchema({"type": "string", "pattern": "^[^:]+:.+$"})]
#: The two points that a joint connects.
Connection = Annotated[
    tuple[Point, Point],
    needed(
        'two points in brackets are needed, such as ["ground:origin", "crank:hinge"]', lambda value: _is_list(value, 2)
    ),
]


@cache
def points_of(table: type[Table]) -> tuple[str, ...]:
    """Return the entries of a table that are points, or several of them, in their order."""
    return tuple(key for key, field in table.model_fields.items() if _AT_A_POINT in notes_on(field, BeforeValidator))


Rows = tuple[tuple[float, float | str], ...]
_OF_MOTIONS = no_parameter(
    "a prescribed motion is a constraint, one for all samples; run once for each value (--override), or drive the "
    "coordinate by a torque, whose amplitude may be a parameter"
)
_OF_TIME = no_parameter(
    "loads are affine in their parameters, which frequencies and phases are not; two harmonics of one frequency a "
    "quarter of a turn apart have any phase, by their amplitudes; run once for each frequency (--override)"
)


def _times_increase(table: Rows) -> Rows:
    for earlier, later in pairwise(table):
        if not earlier[0] < later[0]:
            raise refusal(f"times must increase strictly, but {later[0]} s follows {earlier[0]} s")
    return table


@dataclass(frozen=True)
class OrFile:
    """A note on a type: a file's name, or one with the names of two columns, stands for its rows."""

    columns: bool

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        columns = {key: {"type": "string"} for key in ("file", "x", "y")}
        in_file = {"type": "object", "properties": columns, "required": ["file"], "additionalProperties": False}
        return {"anyOf": [handler(schema), {"type": "string"}, *([in_file] if self.columns else [])]}


@cache
def in_files(table: type[Table]) -> tuple[tuple[str, ...], ...]:
    """Return which entries of a table may have their rows in a file, by their keys from the outside inwards."""
    found: list[tuple[str, ...]] = []
    for key, field in table.model_fields.items():
        found += [(key,) for note in notes_on(field, OrFile) if note.columns]
        for kind in (field.annotation, *get_args(field.annotation)):
            if isinstance(kind, type) and issubclass(kind, Table):
                found += [(key, *within) for within in in_files(kind)]
    return tuple(found)


#: Rows [time (s), value] with increasing times.
TimeTable = Annotated[
    tuple[Pair, ...], Field(min_length=1), AfterValidator(_times_increase), _OF_MOTIONS, Unit(), OrFile(True)
]
#: Rows [time (s), value] of a load, whose values may be parameters.
LoadTable = Annotated[tuple[Row, ...], Field(min_length=1), AfterValidator(_times_increase), Unit(), OrFile(True)]

JUMP = 0.2  # of a table's largest value: what changes by more within a step jumps


def jumps_within(rows: LoadTable, step: float) -> bool:
    """Return whether rows within a step of that length, s, differ by much of the largest value, or by a parameter."""
    largest = max((abs(value) for _, value in rows if not isinstance(value, str)), default=0.0)
    return any(
        end - begin < step and (isinstance(a, str) or isinstance(b, str) or abs(b - a) > JUMP * largest)
        for (begin, a), (end, b) in pairwise(rows)
    )


class Harmonic(Table):
    """``mean + amplitude sin(2 pi frequency_hz t + phase)`` of a coordinate."""

    amplitude: Annotated[Number, _OF_MOTIONS, Unit("rad", "m")] = Field(description="amplitude (rad or m)")
    frequency_hz: Annotated[Number, _OF_MOTIONS, Unit("Hz")] = Field(gt=0.0, description="frequency (Hz)")
    phase: Annotated[Angle, _OF_MOTIONS, Unit("rad")] = Field(0.0, description="phase at time 0 (rad)")
    mean: Annotated[Number, _OF_MOTIONS, Unit("rad", "m")] = Field(0.0, description="mean value (rad or m)")


class LoadHarmonic(Table):
    """``mean + amplitude sin(2 pi frequency_hz t + phase)`` of a torque (N m) or force (N)."""

    amplitude: Annotated[NumberOrParameter, Unit()] = Field(description="amplitude (N m) or (N)")
    frequency_hz: Annotated[Number, _OF_TIME, Unit("Hz")] = Field(gt=0.0, description="frequency (Hz)")
    phase: Annotated[Angle, _OF_TIME, Unit("rad")] = Field(0.0, description="phase at time 0 (rad)")
    mean: Annotated[NumberOrParameter, Unit()] = Field(0.0, description="mean value (N m) or (N)")


def with_values(over_time: Any, value: Callable[[Any], Any]) -> Any:
    """Return an entry with a `LoadTable` or a `LoadHarmonic` with other values in it."""
    if over_time.harmonic is None:
        return over_time.model_copy(update={"table": tuple((time, value(one)) for time, one in over_time.table)})
    wave = over_time.harmonic
    changed = wave.model_copy(update={key: value(getattr(wave, key)) for key in ("amplitude", "mean")})
    return over_time.model_copy(update={"harmonic": changed})


class SpinUp(Table):
    """From rest to a constant speed without a jump of the acceleration (Simo and Vu-Quoc 1986, section 5)."""

    speed: Annotated[Number, _OF_MOTIONS, Unit("rad/s", "m/s")] = Field(description="speed at the end (rad/s or m/s)")
    time: Annotated[Number, _OF_MOTIONS, Unit("s")] = Field(gt=0.0, description="time it takes (s)")
    start: Annotated[AngleOrPlace, _OF_MOTIONS, Unit("rad", "m")] = Field(
        0.0, description="angle (rad) or displacement (m) at time 0"
    )


class ConstantSpeed(Table):
    """A motion at constant speed."""

    speed: Annotated[Number, _OF_MOTIONS, Unit("rad/s", "m/s")] = Field(description="speed (rad/s or m/s)")
    start: Annotated[AngleOrPlace, _OF_MOTIONS, Unit("rad", "m")] = Field(
        0.0, description="angle (rad) or displacement (m) at time 0"
    )
