"""A flexible continuum body that is not condensed: positions of the nodes of its mesh, tied to its frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from pgmp_petsc.base.units import UnitSystem
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import Body, Entries, frame_mesh
from pgmp_petsc.bodies.framed_solid import FramedSolid, framed_solid
from pgmp_petsc.bodies.shape import ContinuumShape
from pgmp_petsc.bodies.solid import Solid
from pgmp_petsc.bodies.stresses import CellStresses
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.bodies import Body as BodyEntry

UNKNOWN_SECONDS = {2: 3.0e-7, 3: 3.0e-5}  # of a step, by the dimension


@dataclass(frozen=True, kw_only=True)
class BodyOnMesh(Body):
    """A continuum body on its mesh, or with its matrices."""

    framed: FramedSolid  # mesh and frames

    @classmethod
    def takes(cls, entry: BodyEntry, shape: object) -> bool:
        return isinstance(shape, ContinuumShape) and entry.flexible

    @classmethod
    def of(cls, scene: Scene, name: str, shape: ContinuumShape) -> BodyOnMesh:
        return cls.framing(framed_solid(scene, name, shape).at(scene.values))

    @classmethod
    def framing(cls, framed: FramedSolid) -> BodyOnMesh:
        """Return the body of a mesh with its frames."""
        centres = np.array([frame.centre for frame in framed.frames.values()])
        mesh = frame_mesh(centres, {point: number for number, point in enumerate(framed.frames)})
        return cls(framed.solid.name, mesh, mesh, framed=framed)

    n_internal = property(attrgetter("framed.solid.n_dofs"))

    @property
    def own_dofs(self) -> np.ndarray:
        return self.dofs[self.node_dofs * self.n_nodes :]

    tied_nodes = property(attrgetter("nodes"))
    points = property(attrgetter("framed.solid.mesh.nodes"))

    def moving_nodes(self, q: np.ndarray, frames: np.ndarray) -> np.ndarray:
        return self.at_points(q)

    face_frames = property(attrgetter("framed.frames"))

    @property
    def extent(self) -> float:
        return float(np.max(np.ptp(self.points, axis=0)))

    @property
    def to_condense(self) -> Sequence[FramedSolid]:
        return (self.framed,)

    @property
    def drawn(self) -> SolidMesh | None:
        return self.framed.solid.mesh if isinstance(self.framed.solid, Solid) else None

    @property
    def size(self) -> tuple[int, int]:
        mesh = self.framed.solid.mesh
        return mesh.n_nodes, mesh.n_cells

    def described(self, system: UnitSystem) -> str:
        return f"{len(self.points)} nodes, {self.framed.solid.described(system)}"

    @property
    def step_seconds(self) -> float:
        return UNKNOWN_SECONDS[self.dimension] * self.n_internal

    def stresses(self, scene: Scene) -> CellStresses | None:
        return None if self.drawn is None else CellStresses(scene, self.name, self.drawn)

    third_derivative_known = False

    def blocks(self, kernel: str) -> Sequence[Solid]:
        return (self.framed.solid,) if kernel == "cells" else ()

    def own_weights(self, kind: str) -> set[Monomial]:
        return self.framed.solid.weights(kind)

    def condensed_weights(self, kind: str) -> set[Monomial]:
        lumped = self._lumped_weights if kind == "mass" else set()
        return lumped | self.framed.condensed_weights(kind)

    def entries(self, kind: str, rows: range) -> Iterator[Entries]:
        solid, d, first = self.framed.solid, self.dimension, self.first_internal
        start, stop = (min(max(row - first, 0), solid.n_dofs) for row in (rows.start, rows.stop))
        nodes = range(start // d, -(-stop // d))
        coo = {weight: matrix.tocoo() for weight, matrix in getattr(solid, kind)(nodes).items()}
        one = next(iter(coo.values()))
        yield first + d * nodes.start + one.row, first + one.col, {weight: part.data for weight, part in coo.items()}
        yield from super().entries(kind, rows)
