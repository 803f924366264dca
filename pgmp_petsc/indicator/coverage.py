"""Which scenes the error indicator covers: one free coordinate, and effects that are loads or masses."""

from __future__ import annotations

from pgmp_petsc.scene import Scene

#: Effects that the full-order equations of the error know as they stand.
COVERED = ("torque", "gravity", "point_mass", "geometric_stiffening", "mode_inertia")


def uncovered(scene: Scene) -> str:
    """Return why the errors of a scene's reduced runs cannot be estimated, "" where they can."""
    if len(scene.coordinates) > 1:
        return f"{len(scene.coordinates)} coordinates"
    for name, effect in scene.effects.items():
        loads = effect.type == "force" and effect.towards is None and not effect.follows
        if not (loads or effect.type in COVERED):
            return f"effects.{name}, a {effect.type}"
    rigid = [name for name, body in scene.bodies.items() if not body.flexible]
    return f"the rigid body {rigid[0]}" if rigid else ""


def is_indicated(scene: Scene) -> bool:
    """Return whether the errors of a scene's reduced runs are to be estimated, and can be."""
    return scene.simulation.error_indicator and not uncovered(scene)
