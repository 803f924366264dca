"""Entries of a scene that hold a number or the name of a parameter: which sign and which unit they must have.

What an effect on a joint, or between points, acts on: a rotation, or a displacement along a line.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import pgmp_petsc.scene.effects as kinds

if TYPE_CHECKING:
    from pgmp_petsc.scene.schema import Scene


Sign = Literal["positive", "not negative", "any"]

MATERIAL = {"E": "Pa", "rho": "kg/m3"}
BODY = {"thickness": "m", "section_scale": "1"}
MATRICES = ("stiffness_scale", "mass_scale")
SECTION = {
    "radius": "m",
    "width": "m",
    "height": "m",
    "axial": "N",
    "shear": "N",
    "bending": "N m2",
    "line_density": "kg/m",
    "rotary_density": "kg m",
    "shear_2": "N",
    "shear_3": "N",
    "torsion": "N m2",
    "bending_2": "N m2",
    "bending_3": "N m2",
    "rotary_2": "kg m",
    "rotary_3": "kg m",
}
#: Entries of effects with their sign, and their units on a joint that turns and on what slides.
EFFECT: dict[type, dict[str, tuple[Sign, tuple[str, ...], tuple[str, ...]]]] = {
    kinds.Torque: {"scale": ("any", ("1", "N m"), ("1", "N m"))},
    kinds.Force: {"scale": ("any", ("1", "N"), ("1", "N"))},
    kinds.Gravity: {"acceleration": ("any", ("m/s2",), ("m/s2",))},
    kinds.PointMass: {
        "mass": ("positive", ("kg",), ("kg",)),
        "inertia": ("not negative", ("kg m2",), ("kg m2",)),
    },
    kinds.JointDamping: {"coefficient": ("not negative", ("N m s/rad",), ("N s/m",))},
    kinds.JointFriction: {
        "limit": ("not negative", ("N m",), ("N",)),
        "speed": ("positive", ("rad/s",), ("m/s",)),
    },
    kinds.SpringDamper: {
        "stiffness": ("any", ("N m/rad",), ("N/m",)),
        "damping": ("not negative", ("N m s/rad",), ("N s/m",)),
        "rest": ("any", ("rad",), ("m",)),
    },
    kinds.EndStop: {
        "lower": ("any", ("rad",), ("m",)),
        "upper": ("any", ("rad",), ("m",)),
        "stiffness": ("positive", ("N m/rad",), ("N/m",)),
        "damping": ("not negative", ("s/rad",), ("s/m",)),
    },
    kinds.Bushing: {
        "stiffness": ("not negative", ("N/m",), ("N/m",)),
        "damping": ("not negative", ("N s/m",), ("N s/m",)),
        "turning_stiffness": ("not negative", ("N m/rad",), ("N m/rad",)),
        "turning_damping": ("not negative", ("N m s/rad",), ("N m s/rad",)),
    },
}


@dataclass(frozen=True)
class Use:
    """One entry that may name a parameter.

    Attributes
    ----------
    entry
        Dotted name.
    value
        What it holds.
    sign
        Which numbers make sense. A spring may be negative: a magnet, or a preloaded one past its dead point.
    units
        What it is in, any of them; "1" is without a unit. The factor of a table is without one, or has the table's.
    """

    entry: str
    value: float | str
    sign: Sign
    units: tuple[str, ...]

    @property
    def parameter(self) -> str | None:
        """Name of the parameter that it holds, or None."""
        return self.value if isinstance(self.value, str) else None


def length_uses(scene: Scene) -> Iterator[Use]:
    """Yield the entries of lengths and places: of straight lines, and of points of the ground (`scene.lengths`)."""
    for name, body in scene.bodies.items():
        if body.line is not None:
            yield Use(f"bodies.{name}.line.length", body.line.length, "positive", ("m",))
    for name, place in scene.ground.points.items():
        for axis, value in zip("xyz", place):
            yield Use(f"ground.points.{name}.{axis}", value, "any", ("m",))


def velocity_names(scene: Scene) -> dict[str, str]:
    """Return the parameters that are velocities at the start, by the names of the coordinates."""
    starts = scene.simulation.initial.items()
    return {coordinate: state.velocity for coordinate, state in starts if isinstance(state.velocity, str)}


def uses_of(scene: Scene) -> Iterator[Use]:
    """Yield every entry that may name a parameter."""
    yield from length_uses(scene)
    for name, material in scene.materials.items():
        for key, unit in MATERIAL.items():
            yield Use(f"materials.{name}.{key}", getattr(material, key), "positive", (unit,))
    for name, field in scene.fields.items():
        for parameter in field.names(name):
            yield Use(f"fields.{name}", parameter, "any", ("1",))
    for name, body in scene.bodies.items():
        for key, unit in BODY.items():
            if getattr(body, key) is not None:
                yield Use(f"bodies.{name}.{key}", getattr(body, key), "positive", (unit,))
        for key in MATRICES if body.matrices is not None else ():
            yield Use(f"bodies.{name}.matrices.{key}", getattr(body.matrices, key), "positive", ("1",))
        for key, size in body.section or ():
            if key != "shape":
                sign = "not negative" if key == "rotary_density" and not body.flexible else "positive"
                yield Use(f"bodies.{name}.section.{key}", size, sign, (SECTION[key],))
    for coordinate, name in velocity_names(scene).items():
        yield Use(f"simulation.initial.{coordinate}.velocity", name, "any", ("rad/s",))
    for name, effect in scene.effects.items():
        turns = not slides(scene, effect)
        for key, (sign, turning, sliding) in EFFECT.get(type(effect), {}).items():
            found = getattr(effect, key)
            for value in found if isinstance(found, tuple) else (found,):
                if value is not None:
                    yield Use(f"effects.{name}.{key}", value, sign, turning if turns else sliding)
        if isinstance(effect, (kinds.Torque, kinds.Force)):
            unit = "N m" if isinstance(effect, kinds.Torque) else "N"
            for entry, value in effect.values_over_time:
                yield Use(f"effects.{name}.{entry}", value, "any", (unit,))


def stop_ends(scene: Scene) -> Iterator[tuple[str, float | str, float | str]]:
    """Yield the stops at both ends of a motion: name of the effect, lower and upper end."""
    for name, effect in scene.effects.items():
        if isinstance(effect, kinds.EndStop) and None not in (effect.lower, effect.upper):
            yield name, effect.lower, effect.upper


def slides(scene: Scene, entry: Any) -> bool:
    """Whether an effect or output acts along a line: between two points, or on a joint that slides."""
    if getattr(entry, "points", None) is not None:
        return True
    joint = scene.joints.get(getattr(entry, "joint", None))
    motions = () if joint is None else joint.motions
    return getattr(entry, "motion", None) == "sliding" if len(motions) > 1 else motions == ("sliding",)
