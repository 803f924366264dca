"""Condensing all continuum bodies of a scene, body by body, dealt to groups of ranks."""

from __future__ import annotations

from collections.abc import Mapping

from pgmp_petsc.bodies.framed_solid import FramedSolid
from pgmp_petsc.bodies.shape import BodyShape
from pgmp_petsc.components.component_modes import condense
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.runtime.agreement import agreed
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.runtime.timings import Timings
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.points import points_used
from pgmp_petsc.scene.spanning_values import spanning_values


def condensed(
    scene: Scene, shapes: Mapping[str, BodyShape], group: RankGroup, *, timings: Timings | None = None
) -> dict[str, BodyShape]:
    """Return the shapes of a scene's bodies with every mesh of continuum elements condensed. Collective on ``group.world``.

    Parameters
    ----------
    scene
        The scene.
    shapes
        By body; what is no continuum mesh stays as it is.
    group
        Ranks that share a body.
    timings
        Gets this rank's wall time of the phases of `condense`.

    Raises
    ------
    InputError, RunError
        On all ranks, whichever rank met it.
    """
    waiting = [name for name, shape in shapes.items() if isinstance(shape, SolidMesh)]
    found = {}
    with agreed(group.world, "components"):
        for name in waiting[group.index :: group.count]:
            meshed = FramedSolid.of(
                name, scene.bodies[name], scene.materials, shapes[name], points_used(scene, name)
            )
            found[name], _ = condense(
                meshed.solid, meshed.frames, _points(scene, meshed), scene.reduction.modes, group.comm, timings
            )
    done = dict(shapes)
    for part in group.world.allgather(found if group.comm.rank == 0 else {}):
        done.update(part)
    return done


def _points(scene: Scene, meshed: FramedSolid) -> list[dict[str, float]]:
    """Return the parameter values to serve: where one factor is all that changes, those of any point serve everywhere."""
    solid = meshed.solid
    if max(len(solid.weights("mass")), len(solid.weights("stiffness"))) == 1:
        return [scene.nominal]
    used = {name for kind in ("mass", "stiffness") for weight in solid.weights(kind) for name, _ in weight.powers}
    spanning, n = spanning_values(scene)
    # values that the body does not feel are left at the nominal ones
    points = [scene.nominal | {name: float(spanning[name][k]) for name in used} for k in range(n)]
    return [scene.nominal, *(point for k, point in enumerate(points) if point not in [scene.nominal, *points[:k]])]
