"""A continuum body together with the frames that hold it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.bodies.face_frame import SMALLEST_RADIUS, FaceFrame
from pgmp_petsc.bodies.solid import Region, Solid
from pgmp_petsc.mesh.reference_element import reference_element
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.scene.bodies import Body as BodyEntry
from pgmp_petsc.scene.bodies import Material


@dataclass(frozen=True, eq=False)
class FramedSolid:
    """A continuum body and its frames.

    Attributes
    ----------
    solid
        Mesh and materials.
    frames
        By the name of the group of faces.
    """

    solid: Solid
    frames: dict[str, FaceFrame]

    @classmethod
    def of(
        cls,
        name: str,
        entry: BodyEntry,
        materials: Mapping[str, Material],
        mesh: SolidMesh,
        points: Mapping[str, str],
    ) -> FramedSolid:
        """Make a scene's body.

        Parameters
        ----------
        name, entry
            The body in the scene.
        materials
            Of the scene.
        mesh
            Of the body.
        points
            Groups of faces that the scene names, with the entry that names each.

        Raises
        ------
        InputError
            If a region or a group is missing, overlaps another one, or is too small to carry a rotation.
        """
        frames = {point: _frame(mesh, point, blame) for point, blame in points.items()}
        return cls(Solid(name, mesh, _regions(name, entry, materials, mesh)), frames)


def _frame(mesh: SolidMesh, point: str, blame: str) -> FaceFrame:
    faces = mesh.faces(point, blame)
    frame = FaceFrame.of(mesh.nodes, faces, reference_element(mesh.kind).face_kind)
    extent = float(np.ptp(mesh.nodes, axis=0).max())
    if not frame.radius > SMALLEST_RADIUS * extent:
        raise InputError(
            f'{blame} = "{point}": its {len(faces)} faces have a radius of gyration of {frame.radius:.3g} m, too small to '
            f"carry a rotation; more than {SMALLEST_RADIUS * extent:.3g} m is needed"
        )
    return frame


def _regions(name: str, entry: BodyEntry, materials: Mapping[str, Material], mesh: SolidMesh) -> tuple[Region, ...]:
    """Return the cells of every material: those of named regions, and the rest."""
    thickness = Quantity.of(1.0 if entry.thickness is None else entry.thickness)
    owner = np.zeros(mesh.n_cells, dtype=int)
    names = [entry.material]
    for region, material in entry.regions.items():
        cells = mesh.region(region, f"bodies.{name}.regions.{region}")
        taken = cells[owner[cells] > 0]
        if taken.size:
            other = list(entry.regions)[owner[taken[0]] - 1]
            raise InputError(
                f"bodies.{name}.regions.{region}: {taken.size} of its {cells.size} cells are in region {other} as well; "
                "every cell has one material"
            )
        names.append(material)
        owner[cells] = len(names) - 1
    found = []
    for number, chosen in enumerate(names):
        cells, material = np.flatnonzero(owner == number), materials[chosen]
        if cells.size:
            modulus, density = thickness * Quantity.of(material.E), thickness * Quantity.of(material.rho)
            found.append(Region(cells, modulus, density, material.nu))
    return tuple(found)
