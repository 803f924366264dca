"""Flexible continuum bodies: on their meshes, by condensed matrices, and in floating frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from pgmp_petsc.base.units import UnitSystem
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import Body, Entries, Pairs, ThirdPart, dense_entries, frame_mesh
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.floating import FloatingBody
from pgmp_petsc.bodies.framed_solid import FramedSolid, framed_solid
from pgmp_petsc.bodies.kinds.rigid import STEP_SECONDS
from pgmp_petsc.bodies.shape import ContinuumShape
from pgmp_petsc.bodies.solid import Solid
from pgmp_petsc.bodies.stresses import CellStresses, Recovered
from pgmp_petsc.mesh.meshes import LineMesh, SolidMesh
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.bodies import Body as BodyEntry

UNKNOWN_SECONDS = {2: 3.0e-7, 3: 3.0e-5}  # of a step, by the dimension


@dataclass(frozen=True, kw_only=True)
class BodyOnMesh(Body):
    """A body on its mesh, or with its matrices, that is not condensed: positions of nodes, tied to its frames."""

    framed: FramedSolid  # mesh and frames

    @classmethod
    def takes(cls, entry: BodyEntry, shape: object) -> bool:
        return isinstance(shape, ContinuumShape) and entry.flexible

    @classmethod
    def of(cls, scene: Scene, name: str, shape: ContinuumShape) -> BodyOnMesh:
        framed = framed_solid(scene, name, shape).at(scene.values)
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


@dataclass(frozen=True, kw_only=True)
class CondensedBody(Recovered, Body):
    """A body from its condensed matrices: its frames, and amplitudes that do not turn with it."""

    component: Component  # its matrices

    dense = True

    @classmethod
    def takes(cls, entry: BodyEntry, shape: object) -> bool:
        return isinstance(shape, Component) and not shape.rigid

    @classmethod
    def of(cls, scene: Scene, name: str, shape: Component) -> CondensedBody:
        mesh = frame_mesh(shape.centres, shape.frames)
        return cls(name, mesh, mesh, component=shape)

    n_internal = property(attrgetter("component.n_internal"))
    extent = property(attrgetter("component.extent"))

    probes = property(attrgetter("component.probes"))

    @property
    def step_seconds(self) -> float:
        """See `Body`; only reduced models have it."""
        return STEP_SECONDS

    recovery = property(attrgetter("component.recovery"))

    @property
    def curved_strains(self) -> np.ndarray | None:
        return None if self.recovery is None else self.recovery.curved

    def own_weights(self, kind: str) -> set[Monomial]:
        return set(self.component.terms(kind))

    def entries(self, kind: str, rows: range) -> Iterator[Entries]:
        yield dense_entries(self.dofs, self.component.terms(kind))
        yield from super().entries(kind, rows)

    def linear_fields(self) -> np.ndarray:
        return self.component.fields

    def moments(self) -> Iterator[tuple[Monomial, np.ndarray, np.ndarray]]:
        for weight, moments in self.component.moments.items():
            yield weight, np.arange(self.dofs.size)[None], moments[None]

    @property
    def third_derivative_known(self) -> bool:
        return self.component.large is not None

    def third_derivative(self, rows: range, n_dofs: int) -> ThirdPart:
        return _Third(self, rows)


class _Third(ThirdPart):
    """Its terms are third derivatives (n, n, n)."""

    def __init__(self, body: CondensedBody, rows: range) -> None:
        self._dofs = body.dofs
        self._own = np.flatnonzero((self._dofs >= rows.start) & (self._dofs < rows.stop))
        self._places = self._dofs[self._own] - rows.start
        third = body.component.large.third
        self.weights, self.terms = list(third), list(third.values())

    def forces(self, terms: Iterable[np.ndarray], vectors: np.ndarray, pairs: Pairs) -> Iterable[np.ndarray]:
        """Yield the forces on the body's own rows, each of shape (n_own, n_pairs)."""
        own = vectors[self._dofs]
        for third in terms:
            # one after the other: of n fields, m vectors and p pairs n^3 m + n^2 p products, not n^3 p
            half = np.einsum("iab,bk->iak", third[self._own], own, optimize=True)
            yield np.einsum("iap,ap->ip", half[:, :, pairs[1]], own[:, pairs[0]], optimize=True)

    def add(self, forces: np.ndarray, total: np.ndarray) -> None:
        total[self._places] += forces


@dataclass(frozen=True, kw_only=True)
class BodyInFloatingFrame(Recovered, Body):
    """A body in a floating frame (`bodies.floating`), whose origin is that of the body's own: its last node, behind
    those of the frames that hold it."""

    floating: FloatingBody  # its moments, stiffness and shapes

    @classmethod
    def takes(cls, entry: BodyEntry, shape: object) -> bool:
        return isinstance(shape, FloatingBody)

    @classmethod
    def of(cls, scene: Scene, name: str, shape: FloatingBody) -> BodyInFloatingFrame:
        frames, origin = frame_mesh(shape.centres, shape.frames), np.zeros((1, shape.centres.shape[1]))
        mesh = LineMesh(np.concatenate([shape.centres, origin]), frames.cells, dict(shape.frames), numbered=False)
        return cls(name, mesh, mesh, floating=shape)

    step_seconds = STEP_SECONDS  # `bench.prices` knows component models by their trees
    n_amplitudes = property(attrgetter("floating.n"))
    n_internal = property(attrgetter("floating.n"))

    @property
    def tied_nodes(self) -> slice:
        return slice(self.nodes.start, self.nodes.stop - 1)

    extent = property(attrgetter("floating.extent"))

    recovery = property(attrgetter("floating.recovery"))

    def in_frame(self, vectors: np.ndarray, n_frame_dofs: int) -> np.ndarray:
        return np.concatenate([vectors[:, :n_frame_dofs], self.floating.parts @ vectors], axis=1)

    third_derivative_known = False

    def blocks(self, kernel: str) -> Sequence[FloatingBody]:
        return (self.floating,) if kernel == "floating" else ()

    def own_weights(self, kind: str) -> set[Monomial]:
        return set(self.floating.moments if kind == "mass" else self.floating.stiffness)
