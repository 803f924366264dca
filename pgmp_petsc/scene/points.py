"""The points of bodies that a scene names: where its joints, effects and outputs hold."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pgmp_petsc.scene.fields import split_point

if TYPE_CHECKING:
    from pgmp_petsc.scene.schema import Scene


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
