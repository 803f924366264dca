"""Which scenes the error indicator covers: one free coordinate, and effects that are loads or masses."""

from __future__ import annotations

from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import Effect

#: Effects that the full-order equations of the error know as they stand.
COVERED = ("torque", "gravity", "point_mass", "geometric_stiffening", "mode_inertia")


def is_covered(scene: Scene) -> bool:
    """Return whether the errors of a scene's reduced runs can be estimated."""
    flexible = all(body.flexible and not body.continuum for body in scene.bodies.values())
    return len(scene.coordinates) == 1 and flexible and all(map(_is_known, scene.effects.values()))


def is_indicated(scene: Scene) -> bool:
    """Return whether the errors of a scene's reduced runs are to be estimated, and can be."""
    return scene.simulation.error_indicator and is_covered(scene)


def _is_known(effect: Effect) -> bool:
    fixed_force = effect.type == "force" and effect.towards is None and not effect.follows
    return fixed_force or effect.type in COVERED
