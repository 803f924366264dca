"""Which nodes and faces the cells of a mesh have, and how they hang together."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array

from pgmp_petsc.mesh.reference_element import reference_element


def set_numbers(rows: np.ndarray) -> np.ndarray:
    """Number rows such that two of them have the same number where they hold the same nodes, in any order.

    Parameters
    ----------
    rows : ndarray of int, shape (n, k)

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
    """Return the faces of all cells, cell after cell, so that an inner face is there twice.

    Parameters
    ----------
    kind : str
        meshio's name of the cell type.
    cells : ndarray of int, shape (n_cells, n_cell_nodes)

    Returns
    -------
    ndarray of int, shape (n_cells * n_faces, n_face_nodes)
        Nodes in the order of the reference element's faces.
    """
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
    rows, columns = np.hstack([edges, edges[::-1]])
    return coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(n_vertices, n_vertices)).tocsr()
