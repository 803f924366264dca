"""Checks across tables: names that entries refer to exist and are of the right kind, and values fit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from typing import TYPE_CHECKING

from pgmp_petsc.runtime.errors import nearest_name
from pgmp_petsc.scene.effect_checks import NUMBERS, effect_problems, joint_problems
from pgmp_petsc.scene.effects import PrescribedMotion
from pgmp_petsc.scene.fields import GROUND, split_point
from pgmp_petsc.scene.joints import Revolute
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.outputs import Angle
from pgmp_petsc.scene.space_checks import space_problems

if TYPE_CHECKING:
    from pgmp_petsc.scene.schema import Scene


def reference_problems(scene: Scene) -> list[str]:
    """Return one line for each entry that does not fit the others, empty if the scene is consistent."""
    return list(
        chain(
            _bodies(scene),
            _joints(scene),
            _coordinates(scene),
            _effects(scene),
            _outputs(scene),
            _initial_states(scene),
            _parameter_uses(scene),
            space_problems(scene),
        )
    )


def _bodies(scene: Scene) -> Iterator[str]:
    for name, body in scene.bodies.items():
        if name == GROUND:
            yield problem(
                "bodies.ground", "this name means the points fixed in space; give the body another one"
            )
        if body.material is not None and body.material not in scene.materials:
            yield _unknown(f"bodies.{name}.material", "material", body.material, scene.materials)
        for region, material in body.regions.items():
            if material not in scene.materials:
                yield _unknown(f"bodies.{name}.regions.{region}", "material", material, scene.materials)


def _joints(scene: Scene) -> Iterator[str]:
    for name, joint in scene.joints.items():
        entry = f"joints.{name}.connect"
        owners = [split_point(point)[0] for point in joint.connect]
        yield from (
            line for point in joint.connect for line in _point(scene, entry, point, ground_allowed=True)
        )
        if owners[0] == owners[1]:
            yield problem(
                entry,
                "a joint connects two different bodies, or a body and the ground; "
                f"both points are on {owners[0]}",
                joint.connect,
            )


def _coordinates(scene: Scene) -> Iterator[str]:
    taken: dict[str, str] = {}
    for name, coordinate in scene.coordinates.items():
        entry = f"coordinates.{name}.joint"
        yield from _revolute(scene, entry, coordinate.joint)
        if coordinate.joint in taken:
            yield problem(
                entry,
                f"coordinates.{taken[coordinate.joint]} has the same joint; each joint may serve one "
                "coordinate",
                coordinate.joint,
            )
        taken.setdefault(coordinate.joint, name)


def _effects(scene: Scene) -> Iterator[str]:
    return effect_problems(scene, _point)


def _outputs(scene: Scene) -> Iterator[str]:
    for name, output in scene.outputs.items():
        if name in scene.parameters:
            yield problem(f"outputs.{name}", "a parameter has the same name; give the output another one")
        if name == "time":
            yield problem("outputs.time", "result files keep instants under this name; give the output another one")
        if isinstance(output, Angle):
            yield from _revolute(scene, f"outputs.{name}.joint", output.joint)
        else:
            yield from _point(scene, f"outputs.{name}.point", output.point, ground_allowed=False)


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
                f"simulation.initial.{name}",
                f"there is no such coordinate{nearest_name(name, scene.coordinates)}",
            )
    prescribed = {effect.coordinate for effect in scene.effects.values() if isinstance(effect, PrescribedMotion)}
    for name, coordinate in scene.coordinates.items():
        (low, high), position = coordinate.range, scene.initial_state(name).position
        if name not in prescribed and not (coordinate.periodic or low <= position <= high):
            yield problem(
                f"simulation.initial.{name}.position",
                f"must lie in the coordinate's range [{low}, {high}]",
                position,
            )


def _parameter_uses(scene: Scene) -> Iterator[str]:
    for entry, used, positive in numbers_of(scene):
        if not isinstance(used, str):
            continue
        if used not in scene.parameters:
            yield _unknown(entry, "parameter", used, scene.parameters)
        elif positive:
            parameter = scene.parameters[used]
            for key in ("nominal", "value"):
                number = getattr(parameter, key)
                if number is not None and number <= 0.0:
                    yield problem(
                        f"parameters.{used}.{key}", f"must be positive, because {entry} uses it", number
                    )


def numbers_of(scene: Scene) -> Iterator[tuple[str, float | str, bool]]:
    """Yield every entry that may name a parameter, what it holds, and whether it must be positive."""
    for name, material in scene.materials.items():
        yield f"materials.{name}.E", material.E, True
        yield f"materials.{name}.rho", material.rho, True
    for name, body in scene.bodies.items():
        for key in ("thickness", "section_scale"):
            if getattr(body, key) is not None:
                yield f"bodies.{name}.{key}", getattr(body, key), True
        for key, size in body.section or ():
            if key != "shape":
                yield f"bodies.{name}.section.{key}", size, key != "rotary_density" or body.flexible
    for name, effect in scene.effects.items():
        for key, positive in NUMBERS.get(type(effect), {}).items():
            yield f"effects.{name}.{key}", getattr(effect, key), positive


def _revolute(scene: Scene, entry: str, joint: str) -> Iterator[str]:
    return joint_problems(scene, entry, joint, (Revolute,))


def _point(scene: Scene, entry: str, point: str, ground_allowed: bool) -> Iterator[str]:
    """Check the owner of a point, and the point if on the ground; only its mesh knows a body's points."""
    owner, name = split_point(point)
    if owner == GROUND and not ground_allowed:
        yield problem(entry, "a point of a body is needed; the ground does not move", point)
    elif owner == GROUND:
        if name not in scene.ground.positions:
            yield _unknown(
                entry, "ground point", point, [f"ground:{known}" for known in scene.ground.positions]
            )
    elif owner not in scene.bodies:
        known = [*scene.bodies, GROUND] if ground_allowed else scene.bodies
        yield problem(entry, f"there is no body '{owner}'{nearest_name(owner, known)}", point)


def _unknown(entry: str, kind: str, name: str, known: Iterable[str]) -> str:
    return problem(entry, f"there is no such {kind}{nearest_name(name, known)}", name)
