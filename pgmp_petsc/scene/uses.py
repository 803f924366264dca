"""Entries of a scene that hold a number or the name of a parameter: which sign and which unit they must have.

What an effect on a joint, or between points, acts on: a rotation, or a displacement along a line.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pgmp_petsc.scene.fields import Sign

if TYPE_CHECKING:
    from pgmp_petsc.scene.schema import Scene


MATERIAL = {"E": "Pa", "rho": "kg/m3"}
BODY = {"thickness": "m", "section_scale": "1"}
MATRICES = ("stiffness_scale", "mass_scale")


@dataclass(frozen=True)
class Use:
    """One entry that may name a parameter."""

    entry: str  # dotted name
    value: float | str  # what it holds
    sign: Sign  # which numbers make sense
    #: what it is in, any of them; "1" is without a unit. The factor of a table is without one, or has the table's.
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
        for key, (sign, unit) in body.section.quantities.items() if body.section is not None else ():
            sign = "positive" if body.flexible else sign
            yield Use(f"bodies.{name}.section.{key}", getattr(body.section, key), sign, unit.turning)
    for coordinate, name in velocity_names(scene).items():
        yield Use(f"simulation.initial.{coordinate}.velocity", name, "any", ("rad/s",))
    for name, effect in scene.effects.items():
        yield from effect.uses(f"effects.{name}", not slides(scene, effect))


def ordered_ends(scene: Scene) -> Iterator[tuple[str, str, float | str, float | str, float]]:
    """Yield pairs of entries of which the first is below the second, or a share of it: the first one's dotted name, the
    second one in words, both values, and the share."""
    sections = {f"bodies.{name}.section": body.section for name, body in scene.bodies.items() if body.section}
    effects = {f"effects.{name}": effect for name, effect in scene.effects.items()}
    for name, entry in (sections | effects).items():
        for low, high, *rest in entry.ordered:
            share = rest[0] if rest else 1.0
            if None not in (ends := (getattr(entry, low), getattr(entry, high))):
                yield f"{name}.{low}", f"{share:g} {high}" if rest else high, *ends, share


def slides(scene: Scene, entry: Any) -> bool:
    """Whether an effect or output acts along a line: at points, between two of them, or on a joint that slides."""
    if getattr(entry, "points", None) is not None or getattr(entry, "point", None) is not None:
        return True
    joint = scene.joints.get(getattr(entry, "joint", None))
    motions = () if joint is None else joint.motions
    return getattr(entry, "motion", None) == "sliding" if len(motions) > 1 else motions == ("sliding",)
