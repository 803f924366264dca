"""What brings the few coordinates of a condensed body back to its mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.mesh.solid_mesh import SolidMesh

if TYPE_CHECKING:
    from pgmp_petsc.bodies.body import Body


@dataclass(frozen=True, eq=False)
class Recovery:
    """The displacements that a condensed body's coordinates stand for.

    Attributes
    ----------
    carrier
        The mesh of continuum elements, or the body of beams, as it was before.
    shapes
        Displacements (of beams and rotations) of the nodes in the body's frame for a unit of each coordinate, node
        after node, shape (n_mesh_dofs, n).
    answered
        Whether the shapes hold the body's static answers to its own inertia forces, as stress outputs ask for.
    """

    carrier: SolidMesh | Body
    shapes: np.ndarray
    answered: bool = True

    @property
    def by_node(self) -> np.ndarray:
        """The shapes as (n_nodes, n_of_a_node, n)."""
        mesh = self.carrier if isinstance(self.carrier, SolidMesh) else self.carrier.mesh
        return self.shapes.reshape(mesh.n_nodes, -1, self.shapes.shape[1])
