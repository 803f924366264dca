"""Checks of a body's cells: each is there once, all are one piece, and all have a sound shape.

A cell is the image x(xi) = sum_a N_a(xi) x_a of the reference cell. Its shape is sound where the Jacobian J = dx/dxi
has a positive determinant.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import connected_components

from pgmp_petsc.mesh.reading import RELATIVE_TOLERANCE
from pgmp_petsc.mesh.reference_element import reference_element, shape_gradients
from pgmp_petsc.mesh.solid_mesh import incidence_edges, set_numbers, undirected_graph
from pgmp_petsc.runtime.errors import InputError


def jacobian_determinants(nodes: np.ndarray, cells: np.ndarray, gradients: np.ndarray) -> np.ndarray:
    """Return det J of every cell at some points (m^d), shape (n_cells, n_points).

    Parameters
    ----------
    nodes : ndarray of float, shape (n_nodes, d)
        Coordinates (m).
    cells : ndarray of int, shape (n_cells, n_cell_nodes)
    gradients : ndarray of float, shape (n_points, d, n_cell_nodes)
        Of the shape functions at the points, in reference coordinates.
    """
    coordinates = nodes[cells].swapaxes(1, 2)
    return np.column_stack([_determinants(coordinates @ gradient.T)[0] for gradient in gradients])


def check_cells(kind: str, nodes: np.ndarray, cells: np.ndarray, received: str) -> None:
    """Refuse repeated cells, separate pieces, and cells that are inverted or have no volume.

    Nodes are (n_nodes, d), finite, m; cells (n_cells, n_cell_nodes) of meshio's type `kind` use every node. Messages
    begin with `received`, the scene's entry and its value, and number cells and nodes in the file's order, from zero.

    Raises
    ------
    InputError
        Naming what is wrong, and where.
    """
    _check_repeated(kind, cells, received)
    _check_pieces(len(nodes), cells, received)
    _check_shapes(kind, nodes, cells, received)


def shown(numbers: np.ndarray, most: int = 8) -> str:
    """Return numbers as text, the first few of many: ``[3, 4, ...]``."""
    return f"[{', '.join(str(number) for number in numbers[:most])}{', ...' if len(numbers) > most else ''}]"


def _check_repeated(kind: str, cells: np.ndarray, received: str) -> None:
    numbers = set_numbers(cells)
    _, first = np.unique(numbers, return_index=True)
    again = np.setdiff1d(np.arange(len(cells)), first)
    if again.size:
        original = first[numbers[again[0]]]
        raise InputError(
            f"{received}: {again.size} of {len(cells)} cells of type {kind} repeat the nodes of another one; the first "
            f"is cell {again[0]}, which has the nodes {shown(cells[again[0]])} of cell {original}; each cell may be "
            "there once (MSH files before version 4 hold a cell once for every physical group it is in)"
        )


def _check_pieces(n_nodes: int, cells: np.ndarray, received: str) -> None:
    graph = undirected_graph(incidence_edges(n_nodes, cells), n_nodes + len(cells))
    n_pieces, labels = connected_components(graph, directed=False)
    if n_pieces > 1:
        pieces = labels[n_nodes:]
        sizes = np.bincount(pieces)
        aside = int(np.flatnonzero(pieces != pieces[0])[0])
        raise InputError(
            f"{received}: the cells form {n_pieces} separate pieces of {shown(np.sort(sizes)[::-1])} cells; the first "
            f"that does not hang together with cell 0 is cell {aside} with the nodes {shown(cells[aside])}; a body is "
            "one connected piece (nodes at the same place must be merged)"
        )


def _check_shapes(kind: str, nodes: np.ndarray, cells: np.ndarray, received: str) -> None:
    """Refuse det J <= 0 at any point of the mass quadrature or at any node.

    Coordinates are known to `RELATIVE_TOLERANCE` times the mesh's extent. An error of this size in J changes det J by
    up to its product with the norm of J's cofactors, and below that a determinant has no certain sign. In other words,
    the smallest singular value of J, the thinnest measure of the cell, must be above the error of the coordinates,
    whatever the size of the cell and however slender it is.
    """
    element = reference_element(kind)
    error = RELATIVE_TOLERANCE * np.ptp(nodes, axis=0).max()
    coordinates = nodes[cells].swapaxes(1, 2)
    smallest, unsound = np.full(len(cells), np.inf), np.zeros(len(cells), dtype=bool)
    # point after point, because the Jacobians of all cells at all points fill much more memory than the mesh
    for gradient in (*element.mass.gradients, *shape_gradients(kind, element.nodes)):
        determinants, cofactors = _determinants(coordinates @ gradient.T)
        np.minimum(smallest, determinants, out=smallest)
        unsound |= determinants <= error * cofactors
    if unsound.any():
        first = int(np.argmax(unsound))
        plane = element.dimension == 2
        count = f"all {len(cells)}" if unsound.all() else f"{unsound.sum()} of {len(cells)}"
        raise InputError(
            f"{received}: {count} cells of type {kind} are inverted or have no {'area' if plane else 'volume'}; the "
            f"first is cell {first} with the nodes {shown(cells[first])}, where the determinant of the Jacobian falls "
            f"to {smallest[first]:.3g} m^{element.dimension}; it must be positive throughout each cell, with the nodes "
            f"in meshio's order{' (counter-clockwise)' if plane else ''}"
        )


def _determinants(jacobians: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the determinants of (n, d, d) matrices and the Frobenius norms of their cofactors, shape (n,) each."""
    columns = np.moveaxis(jacobians, -1, 0)
    if len(columns) == 2:
        (a, c), (b, d) = columns[0].T, columns[1].T
        return a * d - b * c, np.sqrt(a**2 + b**2 + c**2 + d**2)
    cofactors = np.cross(columns[[1, 2, 0]], columns[[2, 0, 1]])
    return (columns[0] * cofactors[0]).sum(axis=1), np.sqrt((cofactors**2).sum(axis=(0, 2)))
