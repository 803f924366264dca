"""End stops that the mechanism starts in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pgmp_petsc.effects.joint_measure import joint_measure
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.effects import EndStop, PrescribedMotion
from pgmp_petsc.scene.slides import slides
from pgmp_petsc.studies.plausibility.finding import Finding, doubt, named, refusal

DEEPEST = 1.0  # rad, or the size of the mechanism: a stop beyond is no stop


def stop_findings(scene: Scene, meshes: Mapping[str, LineMesh | SolidMesh] | None) -> Iterator[Finding]:
    """Yield stops that are violated at the start.

    Where a stop is on another joint than that of a coordinate, the mechanism is assembled, which takes its meshes.

    Raises
    ------
    InputError
        If it cannot be.
    """
    coordinates = {coordinate.joint: name for name, coordinate in scene.coordinates.items()}
    driven = {effect.coordinate for effect in scene.effects.values() if isinstance(effect, PrescribedMotion)}
    kinematics = None
    for name, effect in scene.effects.items():
        if not isinstance(effect, EndStop):
            continue
        if effect.joint in coordinates:
            start, deepest, unit = scene.initial_state(coordinates[effect.joint]).position, DEEPEST, "rad"
        elif meshes is None or driven:
            continue
        else:
            kinematics = kinematics or RigidKinematics(Mechanism.from_scene(scene, meshes))
            start, unit = _measured(kinematics, scene, effect)
            deepest = DEEPEST * (1.0 if unit == "rad" else kinematics.size)
        for key, side in (("lower", -1.0), ("upper", 1.0)):
            if getattr(effect, key) is None:
                continue
            where, end = named(scene, f"effects.{name}.{key}", getattr(effect, key))
            depth = side * (start - end)
            if depth > 1e-9 * deepest:
                make = refusal if depth > deepest else doubt
                yield make(
                    where,
                    f"{effect.joint} starts at {start:.4g} {unit}, {depth:.3g} {unit} beyond this stop, which throws "
                    "it back; move the stop or the start (simulation.initial)",
                    end,
                )


def _measured(kinematics: RigidKinematics, scene: Scene, effect: EndStop) -> tuple[float, str]:
    """Return the angle or displacement of a joint at the start, and its unit."""
    start = [scene.initial_state(coordinate.name).position for coordinate in kinematics.coordinates]
    mechanism, poses = kinematics.mechanism, kinematics.poses([start])[..., 0]
    place = joint_measure(mechanism, effect)
    frames, space = [place[side].frame_of_pose(poses) for side in "ab"], mechanism.space
    if slides(scene, effect):
        return float(place["statement"].value(*map(space.natural, frames))), "m"
    return float(space.angle(place["statement"], *frames)), "rad"
