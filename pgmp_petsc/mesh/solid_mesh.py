"""Meshes of plane and solid bodies: cells of one kind, with named groups of faces and named regions of cells.

Which nodes and faces the cells of a mesh have, and how they hang together.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.base.errors import InputError, nearest_name
from pgmp_petsc.mesh.reading import Counted
from pgmp_petsc.mesh.reference_element import reference_element

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, eq=False)
class SolidMesh(Counted):
    """Continuum cells of one kind, in the plane or in space."""

    kind: str  # meshio's name of the cell type, one of ``PLANE_KINDS`` or ``SOLID_KINDS`` of the reference elements
    nodes: np.ndarray  # coordinates in the mesh's own frame (m), d = 2 or 3
    cells: np.ndarray  # the nodes of each cell in meshio's order
    #: the faces of each named group (edges in the plane); the nodes of a face are in the order of the reference
    #: element's faces
    groups: dict[str, np.ndarray] = field(default_factory=dict)
    regions: dict[str, np.ndarray] = field(default_factory=dict)  # the cells of each named region, increasing
    #: names that hold no face and no cell of the mesh, with the number of nodes they hold; kept to explain the refusal
    small_groups: dict[str, int] = field(default_factory=dict)

    @property
    def dimension(self) -> int:
        """Dimension of the cells and of the space, 2 or 3."""
        return self.nodes.shape[1]

    def faces(self, name: str, entry: str) -> np.ndarray:
        """Return the faces of the group `name`, shape (n_faces, n_face_nodes).

        Raises `InputError` if the name is unknown or holds no face; `entry` is the dotted name of the scene's entry
        that asks.
        """
        return self._named(name, entry, ("group of faces", self.groups), ("region", "cells", self.regions))

    def region(self, name: str, entry: str) -> np.ndarray:
        """Return the cells of the region `name`, increasing, shape (n,); arguments and errors as of `faces`."""
        return self._named(name, entry, ("region of cells", self.regions), ("group", "faces", self.groups))

    def _named(
        self,
        name: str,
        entry: str,
        needed: tuple[str, dict[str, np.ndarray]],
        other: tuple[str, str, dict[str, np.ndarray]],
    ) -> np.ndarray:
        """Return what a name holds; `other` is what it may hold in its place."""
        (what, known), (kind, parts, others) = needed, other
        if name in known:
            return known[name]
        received = f'{entry} = "{name}"'
        if name in others:
            n = len(others[name])
            raise InputError(f"{received}: this is a {kind} of {n} {parts}; a {what} is needed{_known(known)}")
        if name not in self.small_groups:
            raise InputError(f"{received}: the mesh has no {what} of this name{nearest_name(name, known)}")
        count = self.small_groups[name]
        held = f"holds {count} nodes but no whole face on the surface of the mesh" if count else "holds nothing"
        raise InputError(f"{received}: this name {held}; a {what} is needed{_known(known)}")


def _known(names: dict[str, np.ndarray]) -> str:
    return f"; known: {', '.join(sorted(names))}" if names else "; none is defined"


def set_numbers(rows: np.ndarray) -> np.ndarray:
    """Number rows (n, k) so that two of them have the same number where they hold the same nodes, in any order.

    Returns
    -------
    ndarray of int, shape (n,)
        From zero without gaps, growing with the lowest node of the row.
    """
    rows = np.sort(rows, axis=1)
    order = np.lexsort(rows.T[::-1])  # many times faster than np.unique of rows
    is_new = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    numbers = np.zeros(len(rows), dtype=int)
    numbers[order[1:]] = np.cumsum(is_new)
    return numbers


def cell_faces(kind: str, cells: np.ndarray) -> np.ndarray:
    """Return the faces of all cells (n_cells, n_cell_nodes) of meshio's type `kind`, cell after cell, so that an inner
    face is there twice: shape (n_cells n_faces, n_face_nodes), nodes in the order of the reference element's faces."""
    faces = reference_element(kind).faces
    return cells[:, faces].reshape(-1, faces.shape[1])


def bounds_one_cell(faces: np.ndarray) -> np.ndarray:
    """Return which faces of all cells (n_faces, n_face_nodes), each cell's own, bound no other cell."""
    numbers = set_numbers(faces)
    return np.bincount(numbers)[numbers] == 1


def incidence_edges(n_nodes: int, cells: np.ndarray) -> np.ndarray:
    """Return an edge from each cell to each of its nodes, shape (2, n_edges); cell i is vertex n_nodes + i.

    Two nodes of a cell are two edges apart. The graph that joins them directly says the same, but has several times as
    many edges.
    """
    return np.array([cells.ravel(), n_nodes + np.repeat(np.arange(len(cells)), cells.shape[1])])


def undirected_graph(edges: np.ndarray, n_vertices: int) -> csr_array:
    """Return the symmetric matrix of a graph from its edges, shape (2, n_edges)."""
    from scipy.sparse import coo_array  # scenes of beams do without it

    rows, columns = np.hstack([edges, edges[::-1]])
    return coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(n_vertices, n_vertices)).tocsr()
