"""A flexible body in a floating frame (`bodies.floating`): its last node, behind those of the frames that hold it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import Body, frame_mesh
from pgmp_petsc.bodies.floating import PAIR_SECONDS, FloatingBody
from pgmp_petsc.bodies.recovery import Recovery
from pgmp_petsc.bodies.stresses import Recovered
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.bodies import Body as BodyEntry


@dataclass(frozen=True, kw_only=True)
class BodyInFloatingFrame(Recovered, Body):
    """A body in a floating frame, whose origin is that of the body's own."""

    floating: FloatingBody  # its moments, stiffness and shapes

    @classmethod
    def takes(cls, entry: BodyEntry, shape: object) -> bool:
        """See `Body`."""
        return isinstance(shape, FloatingBody)

    @classmethod
    def of(cls, scene: Scene, name: str, shape: FloatingBody) -> BodyInFloatingFrame:
        """See `Body`."""
        frames, origin = frame_mesh(shape.centres, shape.frames), np.zeros((1, shape.centres.shape[1]))
        mesh = LineMesh(np.concatenate([shape.centres, origin]), frames.cells, dict(shape.frames))
        return cls(name, mesh, mesh, floating=shape)

    @property
    def n_amplitudes(self) -> int:
        """See `Body`."""
        return self.floating.n

    @property
    def n_internal(self) -> int:
        """See `Body`."""
        return self.floating.n

    @property
    def tied_nodes(self) -> slice:
        """See `Body`."""
        return slice(self.nodes.start, self.nodes.stop - 1)

    @property
    def extent(self) -> float:
        """See `Body`."""
        return self.floating.extent

    @property
    def step_seconds(self) -> float:
        """See `Body`."""
        return PAIR_SECONDS * self.floating.n**2

    @property
    def recovery(self) -> Recovery | None:
        """See `Recovered`."""
        return self.floating.recovery

    def in_frame(self, vectors: np.ndarray, n_frame_dofs: int) -> np.ndarray:
        """See `Body`."""
        return np.concatenate([vectors[:, :n_frame_dofs], self.floating.parts @ vectors], axis=1)

    @property
    def third_derivative_known(self) -> bool:
        """See `Body`."""
        return False

    def blocks(self, kernel: str) -> Sequence[FloatingBody]:
        """See `Body`."""
        return (self.floating,) if kernel == "floating" else ()

    def own_weights(self, kind: str) -> set[Monomial]:
        """See `Body`."""
        return set(self.floating.moments if kind == "mass" else self.floating.stiffness)
