"""Effects: what acts on the mechanism. An effect that a scene does not name is never evaluated."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pgmp_petsc.scene.fields import (
    Connection,
    ConstantSpeed,
    Direction,
    Harmonic,
    LoadHarmonic,
    LoadTable,
    Name,
    NotNegative,
    NotNegativeOrParameter,
    Number,
    NumberOrParameter,
    Point,
    PositiveOrParameter,
    SpinUp,
    Table,
    TimeTable,
    exactly_one,
    no_parameter,
    refusal,
)

TABLE = (
    "rows [time (s), value]; linear between rows, constant before and after them; each value a number or a parameter's "
    "name"
)


class _OverTime(Table):
    """What acts with a given strength over time."""

    table: LoadTable | None = Field(None, description=TABLE)
    harmonic: LoadHarmonic | None = Field(None, description="{ amplitude, frequency_hz, phase = 0, mean = 0 }")
    scale: NumberOrParameter = Field(1.0, description="factor on it, a number or a parameter's name")

    @property
    def parameters_over_time(self) -> tuple[str, ...]:
        """The parameters that values of its function of time name, each once."""
        return tuple(dict.fromkeys(value for _, value in self.values_over_time if isinstance(value, str)))

    @property
    def values_over_time(self) -> tuple[tuple[str, float | str], ...]:
        """The values of its function of time with the entries that they are in, under the effect's."""
        if self.harmonic is not None:
            return tuple((f"harmonic.{key}", getattr(self.harmonic, key)) for key in ("amplitude", "mean"))
        return tuple((f"table[{row}]", value) for row, (_, value) in enumerate(self.table or ()))

    @model_validator(mode="after")
    def _one_function(self) -> Self:
        exactly_one(self, "table", "harmonic")
        if isinstance(self.scale, str) and self.parameters_over_time:
            raise refusal(
                f"a number is needed: values over time name {', '.join(self.parameters_over_time)}, and loads are "
                "affine in their parameters; give these values numbers, or leave the scale out",
                "scale",
            )
        return self


class _OnJoint(Table):
    """What acts on the motion in a joint."""

    joint: str = Field(description="name of a revolute joint, or of one that slides")
    motion: Literal["turning", "sliding"] | None = Field(
        None, description="which motion of a cylindrical joint; others have one"
    )


class Torque(_OverTime):
    """A torque (Nm) over time on a revolute or cylindrical joint: it turns the second body, and its reaction the
    first."""

    type: Literal["torque"]
    joint: str = Field(description="name of a revolute joint, in space also of a cylindrical one")


class Force(_OverTime):
    """A force (N) over time on a point of a body: along a direction of the ground or of the body, or towards a point.

    A force towards a point pulls that point as well, like a rope between the two.
    """

    type: Literal["force"]
    point: Point = Field(description='where it acts, "body:point"')
    direction: Direction | None = Field(
        None, description="direction (x, y), in space (x, y, z); its length does not matter"
    )
    follows: bool = Field(False, strict=True, description="whether the direction turns with the body at this point")
    towards: Point | None = Field(None, description='the point that it pulls towards, "body:point" or "ground:point"')

    @model_validator(mode="after")
    def _one_direction(self) -> Self:
        exactly_one(self, "direction", "towards")
        if self.follows and self.direction is None:
            raise refusal("a direction that turns with the body needs `direction`", "follows")
        return self


class Gravity(Table):
    """A uniform field of acceleration on every body and every point mass."""

    type: Literal["gravity"]
    direction: Direction = Field(
        (0.0, -1.0), description="direction (x, y), in space (x, y, z); its length does not matter"
    )
    acceleration: NumberOrParameter = Field(9.81, description="acceleration (m/s2), a number or a parameter's name")


class PointMass(Table):
    """A mass and a moment of inertia at a point of a body."""

    type: Literal["point_mass"]
    point: Point = Field(description='where it is, "body:point"')
    mass: PositiveOrParameter = Field(description="mass (kg), a number or a parameter's name")
    inertia: NotNegativeOrParameter = Field(
        0.0, description="moment of inertia about the point (kg m2), a number or a parameter's name"
    )


class JointDamping(_OnJoint):
    """Viscous damping of the relative rotation or sliding in a joint."""

    type: Literal["joint_damping"]
    coefficient: NotNegativeOrParameter = Field(description="Nm s/rad or N s/m, a number or a parameter's name")


class JointFriction(_OnJoint):
    """Coulomb friction in a joint under a constant load, regularised: ``-limit tanh(rate / speed)``."""

    type: Literal["joint_friction"]
    limit: NotNegativeOrParameter = Field(
        description="friction torque (Nm) or force (N) while it slides, a number or a parameter's name"
    )
    speed: PositiveOrParameter = Field(
        description="rate at which 76 % of the limit are reached (rad/s or m/s), a number or a parameter's name"
    )


class SpringDamper(_OnJoint):
    """A linear spring and damper: between the bodies of a joint, or between two points."""

    type: Literal["spring_damper"]
    joint: str | None = Field(None, description="name of a revolute joint, or of one that slides")
    points: Connection | None = Field(None, description='two points, "body:point" or "ground:point"')
    stiffness: NumberOrParameter = Field(0.0, description="Nm/rad or N/m, a number or a parameter's name")
    damping: NotNegativeOrParameter = Field(0.0, description="Nm s/rad or N s/m, a number or a parameter's name")
    rest: NumberOrParameter | None = Field(
        None,
        description="angle (rad), displacement or distance (m) without force, a number or a parameter's name; 0 for a "
        "joint if not given",
    )

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        exactly_one(self, "joint", "points")
        if self.points is not None and self.rest is None:
            raise refusal("a spring between points needs the distance without force (m)", "rest")
        if not (self.stiffness or self.damping):
            raise refusal("at least one of stiffness and damping is needed")
        return self


class Bushing(Table):
    """An elastic mount between two points: a spring and a damper along every axis of a reference frame, which turns
    with the owner of the first point, and about every axis.

    Along an axis the force is ``-k s - c s'`` on the displacement s; about it the couple is that of ``-k s - c s'`` on
    the sine s of the rotation from the way in which the bodies are placed, in the plane on the rotation.
    """

    type: Literal["bushing"]
    points: Connection = Field(description='two points, "body:point" or "ground:point"')
    reference: tuple[Direction, ...] = Field(
        description="first axis, and in space a second one, of the frame in which it is stiff, "
        "in the frame of the first point's owner; their lengths do not matter"
    )
    stiffness: tuple[NotNegativeOrParameter, ...] = Field(
        (), description="along each axis, the last completes the frame (N/m), numbers or parameters' names"
    )
    damping: tuple[NotNegativeOrParameter, ...] = Field((), description="along each axis (N s/m)")
    turning_stiffness: tuple[NotNegativeOrParameter, ...] = Field((), description="about each axis (Nm/rad)")
    turning_damping: tuple[NotNegativeOrParameter, ...] = Field((), description="about each axis (Nm s/rad)")

    @model_validator(mode="after")
    def _something(self) -> Self:
        keys = ("stiffness", "damping", "turning_stiffness", "turning_damping")
        if not any(value for key in keys for value in getattr(self, key)):
            raise refusal(f"at least one of {', '.join(keys)} must be above zero")
        return self


_OF_DAMPING = no_parameter(
    "matrices of structural damping are made once for all samples; build once for each value (--override), or damp "
    "joints, springs or bushings, whose coefficients may be parameters"
)


class StructuralDamping(Table):
    """Damping within the bodies: Rayleigh's, or ratios of the modes of each free body."""

    type: Literal["structural_damping"]
    bodies: tuple[Name, ...] | None = Field(None, min_length=1, description="names of bodies; all if not given")
    stiffness: Annotated[NotNegative, _OF_DAMPING] = Field(
        0.0, description="share of the strain's rate that acts like strain (s): stresses of eps + stiffness eps'"
    )
    mass: Annotated[NotNegative, _OF_DAMPING] = Field(
        0.0, description="braking of all motion, as in a viscous medium, by its momentum (1/s)"
    )
    ratios: Annotated[tuple[Annotated[Number, Field(ge=0.0, lt=1.0)], ...], _OF_DAMPING] = Field(
        (), description="damping ratios of the first elastic modes of each free body"
    )

    @model_validator(mode="after")
    def _something(self) -> Self:
        if not (self.stiffness or self.mass or any(self.ratios)):
            raise refusal("at least one of stiffness, mass and ratios must be above zero")
        return self


class PrescribedMotion(Table):
    """A coordinate that moves as given, whatever it takes."""

    type: Literal["prescribed_motion"]
    coordinate: str = Field(description="name of a coordinate")
    table: TimeTable | None = Field(
        None, description="rows [time (s), angle (rad)]; cubic spline, at rest at both ends and beyond"
    )
    harmonic: Harmonic | None = Field(None, description="{ amplitude, frequency_hz, phase = 0, mean = 0 }")
    spin_up: SpinUp | None = Field(None, description="{ speed, time, start = 0 }: from rest to a constant speed")
    constant_speed: ConstantSpeed | None = Field(None, description="{ speed, start = 0 }")

    @model_validator(mode="after")
    def _one_function(self) -> Self:
        exactly_one(self, "table", "harmonic", "spin_up", "constant_speed")
        if self.table is not None and len(self.table) < 2:
            raise refusal("a motion needs at least two rows", "table")
        return self


class EndStop(_OnJoint):
    """A one-sided elastic stop of a joint, with the instants of contact found exactly."""

    type: Literal["end_stop"]
    lower: NumberOrParameter | None = Field(
        None, description="where the stop at the lower end is (rad or m), a number or a parameter's name"
    )
    upper: NumberOrParameter | None = Field(
        None, description="where the stop at the upper end is (rad or m), a number or a parameter's name"
    )
    stiffness: PositiveOrParameter = Field(description="Nm/rad or N/m, a number or a parameter's name")
    damping: NotNegativeOrParameter = Field(
        0.0,
        description="of Hunt and Crossley (s/rad or s/m): force of stiffness times depth (1 + damping depth'), a "
        "number or a parameter's name",
    )

    @model_validator(mode="after")
    def _some_end(self) -> Self:
        if self.lower is None and self.upper is None:
            raise refusal("at least one of lower and upper is needed")
        return self


class Gyroscopic(Table):
    """The inertia forces that are quadratic in velocities: there unless a slow scene leaves them out."""

    type: Literal["gyroscopic"]
    keep: bool = Field(True, strict=True, description="false leaves them out of the reduced model")


class GeometricStiffening(Table):
    """Stiffness by forces that act: axial loads and inertia forces (of reduced and component models; the full-order one
    has it)."""

    type: Literal["geometric_stiffening"]
    stretching: Literal["static", "dynamic"] = Field(
        "static",
        description="how bodies follow their shortening by bending: at once, which holds for large deflections, or by "
        "the coordinates that stretch them, which is more accurate for small ones at high frequencies (as "
        "reduction.second_order)",
    )


class ModeInertia(Table):
    """Inertia of mode shapes that change with the configuration (the reduced model's; the full-order one has it)."""

    type: Literal["mode_inertia"]


Effect = Annotated[
    Torque
    | Force
    | Gravity
    | PointMass
    | JointDamping
    | JointFriction
    | SpringDamper
    | Bushing
    | StructuralDamping
    | PrescribedMotion
    | EndStop
    | Gyroscopic
    | GeometricStiffening
    | ModeInertia,
    Field(discriminator="type"),
]
