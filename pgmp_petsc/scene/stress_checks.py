"""Checks of stress outputs against the bodies that they name; places on a mesh are checked where there is a mesh.

The points of bodies that a scene names: where its joints, effects and outputs hold.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from pgmp_petsc.runtime.errors import nearest_name
from pgmp_petsc.scene.fields import split_point
from pgmp_petsc.scene.messages import problem
from pgmp_petsc.scene.outputs import OF_FIBRES, STRESSES, OutputEntry

if TYPE_CHECKING:
    from pgmp_petsc.scene.bodies import Body
    from pgmp_petsc.scene.schema import Scene


PLACES = ("at", "group", "region")


def stressed_bodies(scene: Scene) -> set[str]:
    """Return the names of the bodies that stress outputs name."""
    return {output.body for output in scene.outputs.values() if output.reads == "stresses"}


def stress_problems(scene: Scene, name: str, output: OutputEntry) -> Iterator[str]:
    """Yield one line for each entry of a stress output that does not fit the body it names."""
    entry = f"outputs.{name}"
    if output.body not in scene.bodies:
        yield problem(f"{entry}.body", f"there is no such body{nearest_name(output.body, scene.bodies)}", output.body)
        return
    body = scene.bodies[output.body]
    if not body.flexible:
        why = "this body is rigid, so nothing is known of its stresses; take a flexible body, or make it flexible"
        yield problem(f"{entry}.body", why, output.body)
        return
    if body.section_scale is not None:
        why = f"a body with section_scale has no stress outputs; leave bodies.{output.body}.section_scale out"
        yield problem(f"{entry}.body", why, output.body)
    if body.matrices is not None:
        why = f"matrices do not tell stresses from displacements; give bodies.{output.body} a mesh, or leave it out"
        yield problem(f"{entry}.body", why, output.body)
        return
    yield from _quantity(entry, output, body)
    yield from _place(entry, output, body)


def _quantity(entry: str, output: OutputEntry, body: Body) -> Iterator[str]:
    allowed = STRESSES[body.element]
    if output.quantity not in allowed:
        why = f"a {body.element} has no such quantity; allowed: {', '.join(allowed)}"
        yield problem(f"{entry}.quantity", why, output.quantity)
    elif output.quantity in OF_FIBRES and body.material is None:
        forces = ", ".join(name for name in allowed if name not in OF_FIBRES)
        why = f"a section given by coefficients has no outermost fibre; allowed: {forces}"
        yield problem(f"{entry}.quantity", why, output.quantity)


def _place(entry: str, output: OutputEntry, body: Body) -> Iterator[str]:
    given = [key for key in PLACES if getattr(output, key) is not None]
    if len(given) > 1:
        why = f"at most one of {', '.join(PLACES)} is needed; {' and '.join(given)} are given"
        yield problem(f"{entry}.{given[-1]}", why)
    if output.at is not None and len(output.at) != body.dimension:
        words = "two numbers (x, y)" if body.dimension == 2 else "three numbers (x, y, z)"
        yield problem(f"{entry}.at", f"{words} are needed for a {body.element}", list(output.at))
    if output.region is not None and not body.continuum:
        why = f"a {body.element} has no regions; take at or group, or leave it out for the whole body"
        yield problem(f"{entry}.region", why, output.region)


def points_used(scene: Scene, body: str) -> dict[str, str]:
    """Return the points of a body that the scene names, each with the entry that names it first."""
    addresses: list[tuple[str, str]] = []
    for name, joint in scene.joints.items():
        addresses += [(address, f"joints.{name}.connect") for address in joint.connect]
    for table in ("effects", "outputs"):
        for name, entry in getattr(scene, table).items():
            for key in ("point", "points", "towards"):
                value = getattr(entry, key, None)
                named = (value,) if isinstance(value, str) else value or ()
                addresses += [(address, f"{table}.{name}.{key}") for address in named]
    found: dict[str, str] = {}
    for address, entry in addresses:
        owner, point = split_point(address)
        if owner == body:
            found.setdefault(point, entry)
    return found
