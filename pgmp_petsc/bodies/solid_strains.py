"""Strains of a continuum body at the nodes of its mesh, recovered from the points where its elements know them best and
averaged there (Barlow 1976; Hinton and Campbell 1974; docs/solids.md, stresses).

Strains are Green and Lagrange's, ``E = (F^T F - 1) / 2`` with ``F = dx/dX``, unchanged by rigid motion, or for small
displacements in the body's frame their linear part ``(G + G^T) / 2``, ``G = du/dX``. Their components are (xx, yy, xy)
in the plane and (xx, yy, zz, xy, xz, yz) in space, of tensors: shear is half the change of a right angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.floating import products
from pgmp_petsc.mesh.meshes import SolidMesh, reference_element, shape_gradients, shape_values

#: Components of a symmetric tensor by dimension.
COMPONENTS = {2: ((0, 0), (1, 1), (0, 1)), 3: ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))}
INSIDE = 1e-6  # of a reference cell: how far outside a place may be that counts as in it
ROUNDS = 30  # of Newton's method for the place in a reference cell
CLOSE = 1e-12


@dataclass(frozen=True, eq=False)
class SolidStrains:
    """Points of a mesh at which strains are wanted, each a node or a place as an element sees it."""

    mesh: SolidMesh  # the body's
    cells: np.ndarray  # numbers of the cells that take part, shape (n_c,)
    gradients: np.ndarray  # ``dN_a/dX_j`` at their sampling points, shape (n_c, n_g, d, n_a), 1/m
    #: what makes the strains of the points from those of all sampling points, shape (n_points, n_c n_g)
    weights: sp.csr_matrix
    material: np.ndarray  # number of the material of every point, shape (n_points,)
    nodes: np.ndarray  # nodes that the points are at, shape (n_points,); -1 at places between them

    @property
    def n_points(self) -> int:
        """Number of points."""
        return self.material.size

    @property
    def width(self) -> int:
        """Numbers that an instant takes while strains are evaluated."""
        return self.cells.size * self.gradients.shape[1] * 9

    def of_places(self, places: np.ndarray) -> np.ndarray:
        """Return Green and Lagrange's strains, shape (n_points, n_strains, n), for nodes at places (n_nodes, d, n)."""
        d = self.mesh.dimension
        f = self._gradients(places)
        found = [0.5 * (np.sum(f[:, :, i] * f[:, :, j], axis=2) - (i == j)) for i, j in COMPONENTS[d]]
        return self._at_points(np.stack(found, axis=2))

    def of_displacements(self, displacements: np.ndarray) -> np.ndarray:
        """Return linear strains, shape (n_points, n_strains, n), for displacements of the nodes (n_nodes, d, n)."""
        d = self.mesh.dimension
        g = self._gradients(displacements)
        return self._at_points(np.stack([0.5 * (g[:, :, i, j] + g[:, :, j, i]) for i, j in COMPONENTS[d]], axis=2))

    def _gradients(self, vectors: np.ndarray) -> np.ndarray:
        """Return ``dv_i/dX_j`` at all sampling points, shape (n_c, n_g, j, i, n), of vectors at the nodes (n_nodes, d,
        n)."""
        n_c, n_g, d, n_a = self.gradients.shape
        own = vectors[self.mesh.cells[self.cells]].reshape(n_c, n_a, -1)
        return products(self.gradients.reshape(n_c, n_g * d, n_a), own).reshape(n_c, n_g, d, d, -1)

    def _at_points(self, sampled: np.ndarray) -> np.ndarray:
        """Return what points have of strains at sampling points (n_c, n_g, n_strains, n)."""
        n_c, n_g, *shape = sampled.shape
        return (self.weights @ sampled.reshape(n_c * n_g, -1)).reshape(self.n_points, *shape)

    def of_cells(self, values: np.ndarray) -> np.ndarray:
        """Return the means at the points, shape (n_points,), of what is constant in every cell."""
        return self.weights @ np.repeat(values[self.cells], self.gradients.shape[1])

    def within(self, materials: Sequence[np.ndarray], cells: np.ndarray) -> SolidStrains:
        """Return the points whose material is that of some cells, shape (n,)."""
        chosen = np.flatnonzero(np.isin(self.material, _owners(self.mesh, materials)[cells]))
        return replace(self, **{name: getattr(self, name)[chosen] for name in ("weights", "material", "nodes")})

    @classmethod
    def at_nodes(cls, mesh: SolidMesh, materials: Sequence[np.ndarray], nodes: np.ndarray) -> SolidStrains:
        """Take strains at nodes of these numbers, one point for every material, by its cells, that a node is in."""
        owner = _owners(mesh, materials)
        chosen = np.flatnonzero(np.isin(mesh.cells, nodes).any(axis=1))
        of_cells = mesh.cells[chosen]
        row, column = np.nonzero(np.isin(of_cells, nodes))
        keys = np.column_stack([owner[chosen][row], of_cells[row, column]])
        points, place, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        continued = continuation(mesh.kind)
        n_g, place = continued.shape[1], place.reshape(-1)
        entries = continued[column] / count[place][:, None]
        columns = row[:, None] * n_g + np.arange(n_g)
        weights = sp.csr_matrix(
            (entries.ravel(), (np.repeat(place, n_g), columns.ravel())), shape=(len(points), chosen.size * n_g)
        )
        return cls(mesh, chosen, _gradients(mesh, chosen), weights, points[:, 0], points[:, 1])

    @classmethod
    def in_middles(cls, mesh: SolidMesh, materials: Sequence[np.ndarray]) -> SolidStrains:
        """Take the mean strain of the sampling points of every cell, which is that in its middle: of no other cell."""
        cells, gradients = np.arange(mesh.n_cells), _gradients(mesh, np.arange(mesh.n_cells))
        n_g = gradients.shape[1]
        weights = sp.kron(sp.identity(mesh.n_cells), np.full((1, n_g), 1.0 / n_g), format="csr")
        return cls(mesh, cells, gradients, weights, _owners(mesh, materials), np.full(mesh.n_cells, -1))

    @classmethod
    def at_place(cls, mesh: SolidMesh, materials: Sequence[np.ndarray], place: np.ndarray) -> SolidStrains | None:
        """Take the strain at a place of the mesh, shape (d,), m: that of the nodes, interpolated as displacements are.

        None where the place is outside the mesh. On the border of two materials it has the value of one of them.
        """
        found = _locate(mesh, place)
        if found is None:
            return None
        cell, at = found
        owner = _owners(mesh, materials)
        nodal = cls.at_nodes(mesh, materials, mesh.cells[cell])
        chosen = np.flatnonzero(nodal.material == owner[cell])
        order = chosen[[int(np.flatnonzero(nodal.nodes[chosen] == node)[0]) for node in mesh.cells[cell]]]
        weights = sp.csr_matrix(shape_values(mesh.kind, at[None])) @ nodal.weights[order]
        return cls(
            mesh, nodal.cells, nodal.gradients, weights.tocsr(), np.array([owner[cell]]), np.array([-1], dtype=int)
        )


@cache
def sampling_points(kind: str) -> np.ndarray:
    """Return where an element knows its strains best, shape (n_g, d), in reference coordinates."""
    d, linear = reference_element(kind).dimension, kind in ("triangle", "quad", "tetra", "hexahedron")
    simplex = kind.startswith("t")
    if linear:
        return np.full((1, d), 1.0 / (d + 1) if simplex else 0.5)
    if simplex:  # exact for polynomials of second degree, with one point near each corner
        near = {2: 2.0 / 3.0, 3: (5.0 + 3.0 * np.sqrt(5.0)) / 20.0}[d]
        barycentric = np.full((d + 1, d + 1), (1.0 - near) / d) + (near - (1.0 - near) / d) * np.eye(d + 1)
        return barycentric[:, 1:]
    half = 0.5 / np.sqrt(3.0)
    return 0.5 + half * (2.0 * np.indices((2,) * d).reshape(d, -1).T - 1.0)


@cache
def continuation(kind: str) -> np.ndarray:
    """Return what continues values at the sampling points of an element to its nodes, shape (n_a, n_g)."""
    points = sampling_points(kind)
    return _polynomials(kind, reference_element(kind).nodes, len(points)) @ np.linalg.inv(
        _polynomials(kind, points, len(points))
    )


def _polynomials(kind: str, places: np.ndarray, n: int) -> np.ndarray:
    """Return the polynomials that n sampling points decide on, at places (k, d): shape (k, n)."""
    d = places.shape[1]
    if n == 1:
        return np.ones((len(places), 1))
    if kind.startswith("t"):
        return np.column_stack([np.ones(len(places)), places])
    return np.prod(places[:, :, None] ** np.indices((2,) * d).reshape(d, -1), axis=1)


def _gradients(mesh: SolidMesh, cells: np.ndarray) -> np.ndarray:
    """Return ``dN_a/dX_j`` at the sampling points of cells, shape (n_c, n_g, d, n_a)."""
    reference = shape_gradients(mesh.kind, sampling_points(mesh.kind))
    jacobians = np.einsum("gja,cai->cgij", reference, mesh.nodes[mesh.cells[cells]], optimize=True)
    return np.einsum("cgji,gja->cgia", np.linalg.inv(jacobians), reference, optimize=True)


def _owners(mesh: SolidMesh, materials: Sequence[np.ndarray]) -> np.ndarray:
    """Return the number of every cell's material, shape (n_cells,)."""
    owner = np.zeros(mesh.n_cells, dtype=int)
    for number, cells in enumerate(materials):
        owner[cells] = number
    return owner


def _locate(mesh: SolidMesh, place: np.ndarray) -> tuple[int, np.ndarray] | None:
    """Return a cell that holds a place, and where that is in the reference cell, shape (d,); None outside the mesh."""
    corners = mesh.nodes[mesh.cells]
    low, high = corners.min(axis=1), corners.max(axis=1)
    margin = 0.1 * (high - low).max(axis=1, keepdims=True)  # cells with curved edges bulge beyond their nodes
    for cell in np.flatnonzero(((place >= low - margin) & (place <= high + margin)).all(axis=1)):
        at = _reference_place(mesh.kind, corners[cell], place)
        if at is not None:
            return int(cell), at
    return None


def _reference_place(kind: str, nodes: np.ndarray, place: np.ndarray) -> np.ndarray | None:
    """Return where a place is in the reference cell, shape (d,); None where it is outside."""
    simplex, d = kind.startswith("t"), place.size
    size = float(np.ptp(nodes, axis=0).max())
    at = np.full(d, 1.0 / (d + 1) if simplex else 0.5)
    for _ in range(ROUNDS):
        away = place - shape_values(kind, at[None])[0] @ nodes
        if np.abs(away).max() <= CLOSE * size:
            inside = at.min() >= -INSIDE and (at.sum() if simplex else at.max()) <= 1.0 + INSIDE
            return at if inside else None
        jacobian = (shape_gradients(kind, at[None])[0] @ nodes).T
        at = np.clip(at + np.linalg.lstsq(jacobian, away, rcond=None)[0], -1.0, 2.0)
    return None
