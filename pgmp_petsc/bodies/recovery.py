"""Recovery of a condensed body's mesh from its few coordinates.

Products of matrices with many columns, compiled: a column is the same to the last bit whatever the others are.

A sample's stress then depends neither on the batch that it is in nor on the number of ranks; a library's products
choose their order of summation by the number of columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.profile import Profiles
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mesh.line_mesh import LineMesh
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.scene import Scene


class Beams(Protocol):
    """What strains and stresses ask a body of flexible beams for; see `kinds.beam`."""

    name: str
    mesh: LineMesh
    axes: np.ndarray | None
    profiles: Profiles
    planar: bool
    dimension: int
    directions: np.ndarray
    extent: float

    def sections(self, kind: str) -> dict[Monomial, np.ndarray]: ...

    def stresses(self, scene: Scene) -> Any: ...


@dataclass(frozen=True, eq=False)
class Recovery:
    """The displacements that a condensed body's coordinates describe."""

    carrier: SolidMesh | Beams  # the mesh of continuum elements, or the body of beams, as it was before
    #: displacements (of beams and rotations) of the nodes in the body's frame for a unit of each coordinate, node after
    #: node, shape (n_mesh_dofs, n)
    shapes: np.ndarray
    #: whether the shapes hold the body's static answers to its own inertia forces, as stress outputs ask for
    answered: bool = True
    #: of pairs i >= j of coordinates those whose linear strains stand for ``E''_ij = sym(grad u_i^T grad u_j)``:
    #: against all fields T of the shapes they balance these, ``T^T K T curved_ij = int E''_ij : C : E'[T] dV``. Strains
    #: of second order are those of a motion's curvature and of these together; what T has not of them the body relieves
    #: itself. Shape (n (n + 1) / 2, n); None where terms of second order in the body are not known
    curved: np.ndarray | None = None

    @property
    def mesh(self) -> SolidMesh | LineMesh:
        """The mesh of the carrier."""
        return self.carrier if isinstance(self.carrier, SolidMesh) else self.carrier.mesh

    @property
    def by_node(self) -> np.ndarray:
        """The shapes as (n_nodes, n_of_a_node, n)."""
        return self.shapes.reshape(self.mesh.n_nodes, -1, self.shapes.shape[1])


def products(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the products of matrices (n, m, k) and (n, k, n_columns), shape (n, m, n_columns)."""
    result = np.zeros((*left.shape[:2], right.shape[2]))
    _add_products(np.ascontiguousarray(left), np.ascontiguousarray(right), result)
    return result


@njit(cache=True, error_model="numpy")
def _add_products(left, right, result):
    """Add all products; terms are added in the order of the rows of the right matrices."""
    n, m, n_terms = left.shape
    whole = n_terms - n_terms % 4  # sums stay in registers for four terms
    for e in range(n):
        for i in range(m):
            of_row, found = left[e, i], result[e, i]
            for term in range(0, whole, 4):
                for column in range(right.shape[2]):
                    total = found[column] + of_row[term] * right[e, term, column]
                    total += of_row[term + 1] * right[e, term + 1, column]
                    total += of_row[term + 2] * right[e, term + 2, column]
                    found[column] = total + of_row[term + 3] * right[e, term + 3, column]
            for term in range(whole, n_terms):
                for column in range(right.shape[2]):
                    found[column] += of_row[term] * right[e, term, column]
