"""A flexible body: its mesh in its own frame, its place among the unknowns, and its affine matrices.

In the body's frame the mass and the tangent stiffness at rest are constant for every configuration of the mechanism,
so both are made once (`Body.stiffness_entries`, `Body.mass_entries`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies import beam2d
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.section import BeamSection
from pgmp_petsc.mesh.line_mesh import LineMesh

DOFS_PER_NODE = 3  # x, y, phi


@dataclass(frozen=True)
class Body:
    """A beam body.

    Attributes
    ----------
    name
        Name in the scene.
    mesh
        Nodes (m) in the body's own frame, and line cells.
    section
        Sectional coefficients.
    first_node
        Number of the body's first node among all nodes of the mechanism.
    """

    name: str
    mesh: LineMesh
    section: BeamSection
    first_node: int

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.mesh.nodes)

    @property
    def nodes(self) -> slice:
        """The body's range of global node numbers."""
        return slice(self.first_node, self.first_node + self.n_nodes)

    @property
    def elements(self) -> np.ndarray:
        """Global node numbers of the elements, shape (n_elements, 2)."""
        return self.mesh.cells + self.first_node

    @property
    def directions(self) -> np.ndarray:
        """Directions of the elements in the mesh, shape (n_elements,), rad."""
        edges = np.diff(self.mesh.nodes[self.mesh.cells], axis=1)[:, 0]
        return np.arctan2(edges[:, 1], edges[:, 0])

    def stiffness_entries(self, chosen: np.ndarray) -> dict[Monomial, np.ndarray]:
        """Return element tangents at rest in the body's frame, (n_chosen, 6, 6), by weight."""
        lengths, directions = self.mesh.lengths[chosen], self.directions[chosen]
        return {
            monomial: beam2d.undeformed_stiffness(lengths, directions, np.array(coefficients))
            for monomial, coefficients in self.section.stiffness_terms().items()
        }

    def cubic_entries(self, chosen: np.ndarray, vectors: np.ndarray) -> dict[Monomial, np.ndarray]:
        """Return third derivatives of the strain energy at rest, times pairs of vectors, by weight.

        Parameters
        ----------
        chosen
            Numbers of elements, n_chosen of them.
        vectors
            Their unknowns in the body's frame, shape (n_chosen, 6, m).

        Returns
        -------
        dict
            Each of shape (n_chosen, 6, m (m + 1) / 2), pairs as in `beam2d.third_derivative`.
        """
        lengths, directions = self.mesh.lengths[chosen], self.directions[chosen]
        return {
            monomial: beam2d.third_derivative(lengths, directions, np.array(coefficients), vectors)
            for monomial, coefficients in self.section.stiffness_terms().items()
        }

    def mass_entries(self, chosen: np.ndarray) -> dict[Monomial, np.ndarray]:
        """Return consistent element masses, (n_chosen, 6, 6), by weight."""
        lengths = self.mesh.lengths[chosen]
        return {
            monomial: beam2d.consistent_mass(lengths, *coefficients)
            for monomial, coefficients in self.section.mass_terms().items()
        }
