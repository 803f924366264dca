"""Checks that entries belong to where the mechanism moves: the plane, or space where bodies are beam3d or solid3d."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from pgmp_petsc.scene.joints import PLANAR_JOINTS
from pgmp_petsc.scene.messages import problem

if TYPE_CHECKING:
    from pgmp_petsc.scene.schema import Scene


def space_problems(scene: Scene) -> Iterator[str]:
    """Yield one line for each entry that does not fit the space."""
    space = scene.dimension == 3
    yield from _vectors(scene)
    yield from _in_space(scene) if space else _in_the_plane(scene)


def _vectors(scene: Scene) -> Iterator[str]:
    """Yield points and directions with the wrong number of components."""
    n = scene.dimension
    entries = {f"ground.points.{name}": point for name, point in scene.ground.points.items() if any(point)}
    for name, body in scene.bodies.items():
        if body.placement is not None and any(body.placement.origin):
            entries[f"bodies.{name}.placement.origin"] = body.placement.origin
    for table in ("joints", "effects"):
        for name, entry in getattr(scene, table).items():
            direction = getattr(entry, "direction", None)
            if direction is not None and "direction" in entry.model_fields_set:
                entries[f"{table}.{name}.direction"] = direction
    for entry, value in entries.items():
        if len(value) != n:
            words = (
                "two numbers (x, y) are needed in the plane"
                if n == 2
                else "three numbers (x, y, z) are needed in space"
            )
            yield problem(entry, words, list(value))


def _in_the_plane(scene: Scene) -> Iterator[str]:
    for name, joint in scene.joints.items():
        if joint.type not in PLANAR_JOINTS:
            allowed = ", ".join(PLANAR_JOINTS)
            yield problem(
                f"joints.{name}.type", f"for mechanisms in space (allowed in the plane: {allowed})", joint.type
            )
        elif joint.type == "revolute" and joint.axis is not None:
            yield problem(
                f"joints.{name}.axis", "for mechanisms in space; in the plane the axis is z", list(joint.axis)
            )
    for name, body in scene.bodies.items():
        if body.placement is not None and body.placement.rotation is not None:
            rotation = list(body.placement.rotation)
            yield problem(f"bodies.{name}.placement.rotation", "for mechanisms in space; give angle", rotation)
    for name, output in scene.outputs.items():
        if getattr(output, "axis", "x") == "z":
            yield problem(f"outputs.{name}.axis", "x or y is needed in the plane", "z")


def _in_space(scene: Scene) -> Iterator[str]:
    for name, body in scene.bodies.items():
        if body.dimension == 2:
            others = ", ".join(
                f"{other} ({entry.element})" for other, entry in scene.bodies.items() if entry.dimension == 3
            )
            yield problem(
                f"bodies.{name}.element",
                f"in the plane, but {others} in space; all bodies are beam2d and solid2d, or beam3d and solid3d",
                body.element,
            )
        if body.placement is not None and body.placement.angle:
            yield problem(f"bodies.{name}.placement.angle", "for the plane; give rotation", body.placement.angle)
    for name, joint in scene.joints.items():
        if joint.type == "revolute" and joint.axis is None:
            yield problem(f"joints.{name}.axis", "missing; needed in space: axis (x, y, z) of the rotation")
    for name, effect in scene.effects.items():
        if effect.type == "gravity" and "direction" not in effect.model_fields_set:
            yield problem(f"effects.{name}.direction", "missing; needed in space: direction (x, y, z)")
    for name, output in scene.outputs.items():
        if output.type == "rotation":
            why = "a rotation in space is no single number; take the angle of a joint"
            yield problem(f"outputs.{name}.type", why, output.type)
