"""Checks across tables: names that entries refer to exist and are of the right kind, and values fit.

Checks that entries belong to where the mechanism moves: the plane, or space where bodies are beam3d or solid3d.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import chain
from typing import TYPE_CHECKING

from pgmp_petsc.declare.ideas import JOINTS
from pgmp_petsc.runtime.errors import nearest_name
from pgmp_petsc.scene.effect_checks import (
    effect_problems,
    joint_problems,
    motion_problems,
    point_problems,
    points_problems,
    unknown,
)
from pgmp_petsc.scene.effects import Driving
from pgmp_petsc.scene.fields import GROUND, split_point
from pgmp_petsc.scene.joints import joints_with
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.uses import Use, uses_of

if TYPE_CHECKING:
    from pgmp_petsc.scene.schema import Scene


MOST_RADIANS_OF_RANGE = 100.0  # 5,000 configurations to be assembled one after the other: some seconds
DEGREES, FEW_TURNS = 5.0, 25.0  # angles in degrees are multiples of 5 as a rule; rad that nobody gives as such a range


def reference_problems(scene: Scene) -> list[str]:
    """Return one line for each entry that does not fit the others, empty if the scene is consistent."""
    return list(
        chain(
            _bodies(scene),
            _joints(scene),
            _coordinates(scene),
            effect_problems(scene),
            _outputs(scene),
            _initial_states(scene),
            _parameter_uses(scene),
            space_problems(scene),
        )
    )


def _bodies(scene: Scene) -> Iterator[str]:
    connected = {split_point(point)[0] for joint in scene.joints.values() for point in joint.connect}
    for name, body in scene.bodies.items():
        if name not in connected:
            yield problem(f"bodies.{name}", "no joint connects it with the mechanism; add one, or leave the body out")
        if name == GROUND:
            yield problem("bodies.ground", "this name means the points fixed in space; give the body another one")
        if body.material is not None and body.material not in scene.materials:
            yield unknown(f"bodies.{name}.material", "material", body.material, scene.materials)
        for region, material in body.regions.items():
            if material not in scene.materials:
                yield unknown(f"bodies.{name}.regions.{region}", "material", material, scene.materials)


def _joints(scene: Scene) -> Iterator[str]:
    for name, joint in scene.joints.items():
        entry = f"joints.{name}.connect"
        owners = [split_point(point)[0] for point in joint.connect]
        for point in joint.connect:
            yield from point_problems(scene, entry, point, ground_allowed=True)
        if owners[0] == owners[1]:
            yield problem(
                entry,
                f"a joint connects two different bodies, or a body and the ground; both points are on {owners[0]}",
                joint.connect,
            )
        if scene.dimension not in joint.dimensions:
            here, elsewhere = ("in the plane", "in space")[:: 1 if scene.dimension == 2 else -1]
            kinds = (one for one, kind in zip(JOINTS.names, JOINTS.found()) if scene.dimension in kind.dimensions)
            words = f"for mechanisms {elsewhere} (allowed {here}: {', '.join(kinds)})"
            yield problem(f"joints.{name}.type", words, joint.type)
        else:
            yield from joint.problems(scene, name)


def _coordinates(scene: Scene) -> Iterator[str]:
    taken: dict[str, str] = {}
    for name, coordinate in scene.coordinates.items():
        entry = f"coordinates.{name}.joint"
        low, high = coordinate.range
        turns = f"{(high - low) / (2 * math.pi):.4g} turns"
        if high - low >= FEW_TURNS and low % DEGREES == 0.0 == high % DEGREES:
            inside = ", ".join(f"{math.radians(end):.5g}" for end in (low, high))
            yield problem(
                f"coordinates.{name}.range",
                f"looks like degrees: it is in rad, and {turns} long; write [{inside}]. What turns for ever has range "
                f"= [0.0, {2 * math.pi!r}] and periodic = true",
                list(coordinate.range),
            )
        elif high - low > MOST_RADIANS_OF_RANGE:
            yield problem(
                f"coordinates.{name}.range",
                f"is {turns} long, and each is followed in small steps; at most "
                f"{MOST_RADIANS_OF_RANGE:g} rad are taken. What turns for ever has range = [0.0, {2 * math.pi!r}] and "
                "periodic = true",
                list(coordinate.range),
            )
        fitting = joints_with("turning", dimension=scene.dimension)
        yield from joint_problems(scene, entry, coordinate.joint, fitting)
        if coordinate.joint in taken:
            yield problem(
                entry,
                f"coordinates.{taken[coordinate.joint]} has the same joint; each joint may serve one coordinate",
                coordinate.joint,
            )
        taken.setdefault(coordinate.joint, name)


def _outputs(scene: Scene) -> Iterator[str]:
    for name, output in scene.outputs.items():
        if name in scene.parameters:
            yield problem(f"outputs.{name}", "a parameter has the same name; give the output another one")
        if name == "time":
            yield problem("outputs.time", "result files keep instants under this name; give the output another one")
        if output.joints and output.joint is not None:
            fitting = joints_with(*output.joints, dimension=scene.dimension)
            yield from joint_problems(scene, f"outputs.{name}.joint", output.joint, fitting)
            yield from motion_problems(scene, f"outputs.{name}", output)
        if getattr(output, "points", None) is not None:
            yield from points_problems(scene, f"outputs.{name}.points", output.points)
        if getattr(output, "point", None) is not None:
            yield from point_problems(scene, f"outputs.{name}.point", output.point, ground_allowed=False)
        yield from output.problems(scene, name)


def _initial_states(scene: Scene) -> Iterator[str]:
    for name, state in scene.simulation.initial.items():
        if scene.initial.equilibrium and state.velocity != 0.0:
            yield problem(
                f"simulation.initial.{name}.velocity",
                "with initial.equilibrium = true a run starts at rest; leave the velocity out, or the equilibrium",
                state.velocity,
            )
    for name in scene.simulation.initial:
        if name not in scene.coordinates:
            yield problem(
                f"simulation.initial.{name}", f"there is no such coordinate{nearest_name(name, scene.coordinates)}"
            )
    prescribed = {effect.coordinate for effect in scene.effects.values() if isinstance(effect, Driving)}
    for name, coordinate in scene.coordinates.items():
        (low, high), position = coordinate.range, scene.initial_state(name).position
        if name not in prescribed and not (coordinate.periodic or low <= position <= high):
            yield problem(
                f"simulation.initial.{name}.position", f"must lie in the coordinate's range [{low}, {high}]", position
            )


def _parameter_uses(scene: Scene) -> Iterator[str]:
    for use in uses_of(scene):
        if use.parameter is None:
            continue
        if use.parameter not in scene.parameters:
            yield unknown(use.entry, "parameter", use.parameter, scene.parameters)
        else:
            parameter = scene.parameters[use.parameter]
            for key in ("nominal", "value"):
                number = getattr(parameter, key)
                if number is not None:
                    yield from _sign(use, f"parameters.{use.parameter}.{key}", number)


def _sign(use: Use, entry: str, number: float) -> Iterator[str]:
    if use.sign == "positive" and number <= 0.0:
        yield problem(entry, f"must be positive, because {use.entry} uses it", number)
    elif use.sign == "not negative" and number < 0.0:
        yield problem(entry, f"must not be negative, because {use.entry} uses it", number)


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
    for name, body in scene.bodies.items():
        if body.placement is not None and body.placement.rotation is not None:
            rotation = list(body.placement.rotation)
            yield problem(f"bodies.{name}.placement.rotation", "for mechanisms in space; give angle", rotation)


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
