"""A flexible continuum body from its condensed matrices: its frames, and amplitudes that do not turn with it.

A flexible body in a floating frame (`bodies.floating`): its last node, behind those of the frames that hold it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import Body, Entries, ThirdPart, dense_entries, frame_mesh
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.floating import FloatingBody
from pgmp_petsc.bodies.kinds.rigid import STEP_SECONDS
from pgmp_petsc.bodies.stresses import Recovered
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.bodies import Body as BodyEntry


@dataclass(frozen=True, kw_only=True)
class CondensedBody(Recovered, Body):
    """A condensed body."""

    component: Component  # its matrices

    dense = True

    @classmethod
    def takes(cls, entry: BodyEntry, shape: object) -> bool:
        return isinstance(shape, Component) and not shape.rigid

    @classmethod
    def of(cls, scene: Scene, name: str, shape: Component) -> CondensedBody:
        return cls.of_component(name, shape)

    @classmethod
    def of_component(cls, name: str, component: Component) -> CondensedBody:
        """Return the body of a component."""
        mesh = frame_mesh(component.centres, component.frames)
        return cls(name, mesh, mesh, component=component)

    n_internal = property(attrgetter("component.n_internal"))
    extent = property(attrgetter("component.extent"))

    @property
    def has_long_axis(self) -> bool:
        return self.component.large is None or self.component.large.slender

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

    def forces(
        self, terms: Iterable[np.ndarray], vectors: np.ndarray, pairs: tuple[np.ndarray, np.ndarray]
    ) -> Iterable[np.ndarray]:
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
    """A body in a floating frame, whose origin is that of the body's own."""

    floating: FloatingBody  # its moments, stiffness and shapes

    @classmethod
    def takes(cls, entry: BodyEntry, shape: object) -> bool:
        return isinstance(shape, FloatingBody)

    @classmethod
    def of(cls, scene: Scene, name: str, shape: FloatingBody) -> BodyInFloatingFrame:
        frames, origin = frame_mesh(shape.centres, shape.frames), np.zeros((1, shape.centres.shape[1]))
        mesh = LineMesh(np.concatenate([shape.centres, origin]), frames.cells, dict(shape.frames))
        return cls(name, mesh, mesh, floating=shape)

    step_seconds = STEP_SECONDS  # `bench.finished` knows component models by their trees
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
