"""A continuum body together with the frames that hold it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.bodies.affine import Monomial, Quantity
from pgmp_petsc.bodies.assembled import Assembled, AssembledBody
from pgmp_petsc.bodies.profile import UNIFORM, Profiles, SectionScale
from pgmp_petsc.bodies.random_fields import profiles_of
from pgmp_petsc.bodies.solid import SMALLEST_RADIUS, FaceFrame, Region, Solid
from pgmp_petsc.mesh.meshes import SolidMesh, reference_element
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.bodies import Body as BodyEntry
from pgmp_petsc.scene.bodies import Material
from pgmp_petsc.scene.messages import toml_text
from pgmp_petsc.scene.references import points_used

ON_AXIS = 1e-6  # over the extent of the mesh: how far a group may be off the axis that its section is scaled about


@dataclass(frozen=True, eq=False)
class FramedSolid:
    """A continuum body and its frames."""

    solid: Solid | AssembledBody  # mesh and materials, or assembled matrices
    frames: dict[str, FaceFrame]  # by the name of the group of faces
    drawn: SectionScale | None = None  # what the cross-section of the mesh was scaled with already (`at`)

    @classmethod
    def of(
        cls,
        name: str,
        entry: BodyEntry,
        materials: Mapping[str, Material],
        mesh: SolidMesh,
        points: Mapping[str, str],
        profiles: Profiles = UNIFORM,
    ) -> FramedSolid:
        """Make a scene's body of its entry, on its mesh, with groups of faces that the scene names, by the entry that
        names each, and constants multiplied by profiles, cell by cell.

        Raises `InputError` if a region or a group is missing, overlaps another one, or is too small to carry a
        rotation; with a scaled cross-section, if a group is no section across the x axis.
        """
        frames = {}
        for point, blame in points.items():
            faces = mesh.faces(point, blame)
            frame = FaceFrame.of(mesh.nodes, faces, reference_element(mesh.kind).face_kind)
            frames[point] = _carrying(frame, mesh.nodes, f'{blame} = "{point}": its {len(faces)} faces')
        scale = None
        if entry.section_scale is not None:
            scale = SectionScale(Quantity.of(entry.section_scale))
            for point, frame in frames.items():
                _check_section(f"bodies.{name}.section_scale", mesh, point, frame)
        thickness, regions = Quantity.of(1.0 if entry.thickness is None else entry.thickness), []
        for chosen, cells in cells_of_materials(name, entry, mesh):
            material = materials[chosen]
            modulus, density = thickness * Quantity.of(material.E), thickness * Quantity.of(material.rho)
            regions.append(Region(cells, modulus, density, material.nu))
        return cls(Solid(name, mesh, tuple(regions), scale, profiles), frames)

    @classmethod
    def assembled(cls, name: str, entry: BodyEntry, body: Assembled, points: Mapping[str, str]) -> FramedSolid:
        """Make a scene's body that is given by matrices; parameters as of `of`.

        Raises `InputError` if there is no such set of nodes, or it is too small to carry a rotation.
        """
        given, frames = entry.matrices, {}
        for point, blame in points.items():
            wanted, asked = given.faces.get(point, point), f'{blame} = "{point}"'
            if point in given.faces:
                asked = f"bodies.{name}.matrices.faces.{point} = {toml_text(wanted)}"
            frame = body.frame(wanted, asked)
            frames[point] = _carrying(frame, body.nodes, f"{asked}: its {frame.nodes.size} nodes")
        factors = Quantity.of(given.stiffness_scale), Quantity.of(given.mass_scale)
        return cls(AssembledBody(name, body, *factors), frames)

    def at(self, values: Mapping[str, float]) -> FramedSolid:
        """Return the body whose mesh has the cross-section that parameter values give, and no scale any more."""
        solid = self.solid
        if solid.section_scale is None:
            return self
        stretch = solid.section_scale.stretch(solid.mesh.dimension, values)
        mesh, regions = replace(solid.mesh, nodes=solid.mesh.nodes * stretch), solid.regions
        if mesh.dimension == 2:  # the thickness is part of the section
            scaled = [(region.modulus * stretch[1], region.density * stretch[1]) for region in regions]
            regions = tuple(
                replace(region, modulus=modulus, density=density) for region, (modulus, density) in zip(regions, scaled)
            )
        frames = {
            point: replace(frame, arms=frame.arms * stretch, inertia=frame.inertia * stretch[1] ** 2)
            for point, frame in self.frames.items()
        }
        return FramedSolid(Solid(solid.name, mesh, regions, None, solid.profiles), frames, solid.section_scale)

    def condensed_weights(self, kind: str) -> set[Monomial]:
        """Return the weights of the terms of ``"mass"`` or ``"stiffness"`` that the body has condensed, where scales
        are kept."""
        weights, scale = self.solid.weights(kind), self.drawn or self.solid.section_scale
        if scale is None:
            return weights
        bare = replace(self.solid, section_scale=None).weights(kind)
        return {weight * (scale.factor**power).monomial for weight in bare for power in scale.powers[kind]}


def framed_solid(scene: Scene, name: str, mesh: SolidMesh | Assembled) -> FramedSolid:
    """Return a scene's body on its mesh or with its matrices; raises as `FramedSolid.of` and `profiles_of`."""
    points = points_used(scene, name)
    if isinstance(mesh, Assembled):
        return FramedSolid.assembled(name, scene.bodies[name], mesh, points)
    return FramedSolid.of(name, scene.bodies[name], scene.materials, mesh, points, profiles_of(scene, name, mesh))


def _carrying(frame: FaceFrame, nodes: np.ndarray, what: str) -> FaceFrame:
    """Return a frame if it can carry a rotation."""
    extent = float(np.ptp(nodes, axis=0).max())
    if not frame.radius > SMALLEST_RADIUS * extent:
        raise InputError(
            f"{what} have a radius of gyration of {frame.radius / extent:.3g} of the body's extent, too small to carry "
            f"a rotation; more than {SMALLEST_RADIUS:g} of it is needed"
        )
    return frame


def _check_section(entry: str, mesh: SolidMesh, point: str, frame: FaceFrame) -> None:
    """Refuse a group whose place or whose mean rotation would be another function of the scale."""
    extent = float(np.ptp(mesh.nodes, axis=0).max())
    off, spread = np.abs(frame.centre[1:]).max(), np.ptp(mesh.nodes[frame.nodes, 0])
    if off > ON_AXIS * extent:
        raise InputError(
            f'{entry}: the faces of "{point}" have their centre {off / extent:.3g} of the extent of the mesh off its '
            "x axis; sections are scaled about it, so that points that joints, effects and outputs name have to be on "
            f"it (to {ON_AXIS:g} of the extent)"
        )
    if spread > ON_AXIS * extent:
        raise InputError(
            f'{entry}: the faces of "{point}" extend over {spread / extent:.3g} of the mesh along its x axis; groups '
            "of a body with a scaled cross-section are sections across the axis"
        )


def cells_of_materials(name: str, entry: BodyEntry, mesh: SolidMesh) -> list[tuple[str, np.ndarray]]:
    """Return the materials of a body's mesh with their cells: that of named regions, and that of the rest.

    Raises `InputError` if a region is missing or overlaps another one.
    """
    owner = np.zeros(mesh.n_cells, dtype=int)
    names = [entry.material]
    for region, material in entry.regions.items():
        cells = mesh.region(region, f"bodies.{name}.regions.{region}")
        taken = cells[owner[cells] > 0]
        if taken.size:
            other = list(entry.regions)[owner[taken[0]] - 1]
            raise InputError(
                f"bodies.{name}.regions.{region}: {taken.size} of its {cells.size} cells are in region {other} as "
                "well; every cell has one material"
            )
        names.append(material)
        owner[cells] = len(names) - 1
    found = ((material, np.flatnonzero(owner == number)) for number, material in enumerate(names))
    return [(material, cells) for material, cells in found if cells.size]
