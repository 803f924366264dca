"""Reading scenes and their meshes, on one rank for all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from typing import TypeVar

import numpy as np

from pgmp_petsc.base.errors import shortened
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.base.units import SI, times
from pgmp_petsc.bodies.random_fields import field_remarks
from pgmp_petsc.bodies.shape import BodyShape, shape_in_scene
from pgmp_petsc.mechanism.capabilities import Purpose, check_capabilities
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh, read_line_mesh
from pgmp_petsc.ranks.agreement import on_root
from pgmp_petsc.scene import Scene, load_scene
from pgmp_petsc.scene.loading import changed
from pgmp_petsc.scene.references import stressed_bodies
from pgmp_petsc.studies.plausibility import plausibility

AnyMesh = TypeVar("AnyMesh", LineMesh, SolidMesh)
COARSER = 1.5  # times as large are cells of the mesh that tells what meshing does


def read_scene(
    source: Scene | str | PathLike[str], overrides: Sequence[str], settings: Sequence[str], comm: Comm, purpose: Purpose
) -> tuple[Scene, dict[str, BodyShape]]:
    """Return a scene, of a file or of a program, with other entries and with remarks on what it says that probably is
    not meant, and its meshes. Collective on `comm`. Raises `InputError` if the scene or a mesh cannot be read, says
    what cannot be meant, or has what the purpose cannot do with it."""

    def reading_the_scene() -> tuple[Scene, dict[str, BodyShape]]:
        is_file = isinstance(source, (str, PathLike))
        return with_meshes((load_scene if is_file else changed)(source, overrides, settings), purpose)

    return on_root(comm, reading_the_scene)


def with_meshes(scene: Scene, purpose: Purpose) -> tuple[Scene, dict[str, BodyShape]]:
    """Return a scene with its remarks, and its meshes; by one process. Raises as `read_scene`."""
    meshes = {name: _mesh_of(scene, name) for name in scene.bodies}
    check_capabilities(scene, purpose, meshes)
    if stressed_bodies(scene):
        from pgmp_petsc.outputs.stress import check_stresses  # few scenes have stress outputs

        check_stresses(scene, meshes)
    return scene.with_remarks((*plausibility(scene, meshes), *field_remarks(scene, meshes))), meshes


def coarser_parts(scene: Scene, comm: Comm) -> dict[str, BodyShape]:
    """Return meshes of the parts of CAD with cells `COARSER` times as large. Collective on `comm`; raises as
    `read_scene`."""
    parts = [name for name, body in scene.bodies.items() if body.of_cad]
    return on_root(comm, lambda: {name: _mesh_of(scene, name, COARSER) for name in parts})


def _mesh_of(scene: Scene, name: str, coarser: float = 1.0) -> BodyShape:
    body = scene.bodies[name]
    written = shape_in_scene(scene, name)
    if written is not None:
        return written
    if body.matrices is not None:
        # takes a noticeable time, and only such bodies need it
        from pgmp_petsc.bodies.assembled_reading import read_assembled

        return read_assembled(scene, name)
    path, entry = scene.path_of(body.mesh), f"bodies.{name}.mesh"
    length = scene.system.length
    if not body.continuum:
        return in_metres(read_line_mesh(path, entry, body.dimension), length)
    # take a noticeable time, and only runs with continuum bodies need them
    from pgmp_petsc.mesh.solid_mesh_reading import read_part, read_solid_mesh, with_groups

    if body.of_cad:
        mesh = read_part(path, shortened(f'{entry} = "{path}"'), SI.length, body.mesh_size, coarser).mesh
    else:
        mesh = in_metres(read_solid_mesh(path, body.dimension, entry), length)
    return with_groups(mesh, body.faces, f"bodies.{name}.faces")


def in_metres(mesh: AnyMesh, length: float) -> AnyMesh:
    """Return a mesh with nodes in m, of which its unit is so many; through decimals, as entries of scenes are."""
    if length == 1.0:
        return mesh
    nodes = [times(number, length) for number in mesh.nodes.ravel().tolist()]
    return replace(mesh, nodes=np.array(nodes).reshape(mesh.nodes.shape))
