"""Visible parts of a mechanism: the bodies whose meshes a model knows, and where they have stresses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.sections.section import BeamSection
from pgmp_petsc.bodies.stresses import BeamLaw, SolidLaw, Strains
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.outputs.stress import EXTREMES, FURTHEST
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.references import stressed_bodies

LARGEST = 2**28  # bytes of the fields of bodies that no stress output names, over all frames
ROD = 0.02  # radius of the lines of a body without a section over its extent
Values = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Stresses:
    """Where and how a flexible body has stresses."""

    #: nodal, inner: points at the nodes, one for each material or element that meets there, and in the middles of the
    #: cells
    nodal: Strains
    inner: Strains
    law: SolidLaw | BeamLaw  # what makes quantities of strains
    units: dict[str, str]  # of the quantities

    def at_nodes(self, strains: np.ndarray, values: Mapping[str, float]) -> Values:
        """Return all quantities at the nodes, each of shape (n_nodes, n), for strains (n_points, n_strains, n)."""
        found = self.law.values(self.units, self.nodal, strains, values)
        return {quantity: EXTREMES.get(quantity, FURTHEST)(own[self._by_node]) for quantity, own in found.items()}

    def at_cells(self, strains: np.ndarray, values: Mapping[str, float]) -> Values:
        """Return all quantities in the middles of the cells, each of shape (n_cells, n), as `at_nodes`."""
        return self.law.values(self.units, self.inner, strains, values)

    @cached_property
    def _by_node(self) -> np.ndarray:
        """The points of every node, the first of them again where there are fewer, shape (k, n_nodes)."""
        nodes = self.nodal.nodes
        order, counts = np.argsort(nodes, kind="stable"), np.bincount(nodes)
        starts = np.cumsum(counts) - counts
        each = np.minimum(np.arange(counts.max())[:, None], counts - 1)
        return order[starts + each]


@dataclass(frozen=True, eq=False)
class FieldPoints:
    """A body that can be seen."""

    number: int  # of the body
    mesh: SolidMesh | LineMesh  # its cells, or the lines of beams
    stresses: Stresses | None  # none of a rigid body
    radius: float | None  # of beams: that of the circle with the section's radius of gyration, m; None of cells

    @property
    def kind(self) -> str:
        """meshio's name of the cells."""
        return self.mesh.kind

    @property
    def units(self) -> dict[str, str]:
        """Quantities with their units; none of a rigid body."""
        return {} if self.stresses is None else self.stresses.units

    @property
    def frame_bytes(self) -> int:
        """Memory that a frame takes, as results keep it."""
        n_nodes, n_cells = len(self.mesh.nodes), len(self.mesh.cells)
        return 8 * (n_nodes * (9 + len(self.units)) + n_cells * len(self.units))

    @property
    def width(self) -> int:
        """Numbers that an instant takes while it is evaluated."""
        return self.mesh.nodes.size if self.stresses is None else max(self.mesh.nodes.size, self.stresses.nodal.width)


@dataclass(frozen=True, eq=False)
class FieldSet:
    """The bodies whose fields are kept."""

    points: dict[str, FieldPoints]  # by body
    left_out: dict[str, str]  # why other bodies are not among them, by body, with the cure

    @classmethod
    def of(cls, scene: Scene, bodies: tuple[Body, ...], n_frames: int) -> FieldSet:
        """Choose them among the model's bodies; `n_frames` are stored."""
        if not n_frames:
            return cls({}, {})
        points, left_out = {}, {}
        for number, body in enumerate(bodies):
            if body.name not in scene.bodies:
                continue  # a point mass
            if scene.bodies[body.name].section_scale is not None:
                left_out[body.name] = "its cross-section scales, and its mesh is that of scale 1"
                continue
            mesh = body.drawn
            if mesh is None:
                left_out[body.name] = (
                    "the reduced model is without its large mesh; name a stress output of it, and build again"
                )
            elif len(mesh.cells):
                points[body.name] = _points(scene, number, body, mesh)
        asked, taken = stressed_bodies(scene), 0
        for name, field in sorted(points.items(), key=lambda item: (item[0] not in asked, item[1].frame_bytes)):
            size = n_frames * field.frame_bytes
            if name in asked or taken + size <= LARGEST:
                taken += 0 if name in asked else size
                continue
            del points[name]
            left_out[name] = (
                f"{n_frames} frames of it take {size / 1e6:.0f} MB; store fewer (--override simulation.frames=N), or "
                "name a stress output of it"
            )
        return cls(points, left_out)


def _points(scene: Scene, number: int, body: Body, mesh: SolidMesh | LineMesh) -> FieldPoints:
    stresses, here = None, body.stresses(scene)
    if here is not None:
        stresses = Stresses(here.everywhere(), here.in_middles(), here.law, here.units)
    return FieldPoints(number, mesh, stresses, _radius(scene, body) if mesh.kind == "line" else None)


def _radius(scene: Scene, body: Body) -> float:
    """Return the radius of a circle with the radius of gyration of a section of beams: ``r^2 = 4 I / A``, m; of a rigid
    body without a section one that is seen."""
    if scene.bodies[body.name].section is None:
        return ROD * body.extent
    section = BeamSection.of(scene, body.name)
    resists = np.mean([float(part.at(scene.values)) for part in section.bending])
    return float(2.0 * np.sqrt(resists / float(section.axial.at(scene.values))))
