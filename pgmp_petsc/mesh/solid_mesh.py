"""Meshes of plane and solid bodies: cells of one kind, with named groups of faces and named regions of cells; their
faces and connected pieces; and the reference elements of these cells.

Reference elements have shape functions, quadrature and faces in meshio's order of nodes. Shape functions and quadrature
come from scikit-fem. Its numbering of nodes is another one, so each node is found by its place in the reference cell,
which is [0, 1]^d or the unit simplex in both.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.base.errors import InputError, nearest_name, shortened
from pgmp_petsc.mesh.reading import Counted, shown

if TYPE_CHECKING:
    import skfem.element
    from scipy.sparse import csr_array


@dataclass(frozen=True)
class _Shape:
    """A shape of cells: its corners in meshio's order, its edges, and the corners of its faces (edges in the plane),
    seen from outside in the order that makes the normal point outwards."""

    corners: tuple[tuple[int, ...], ...]
    edges: tuple[tuple[int, int], ...]
    faces: tuple[tuple[int, ...], ...]


_LINE = _Shape(((0,), (1,)), ((0, 1),), ((0,), (1,)))
_TRIANGLE = _Shape(((0, 0), (1, 0), (0, 1)), *(((0, 1), (1, 2), (2, 0)),) * 2)
_QUAD = _Shape(((0, 0), (1, 0), (1, 1), (0, 1)), *(((0, 1), (1, 2), (2, 3), (3, 0)),) * 2)
_TETRA = _Shape(
    ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    (*_TRIANGLE.edges, (0, 3), (1, 3), (2, 3)),
    ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
)
_HEXAHEDRON = _Shape(
    tuple((*corner, z) for z in (0, 1) for corner in _QUAD.corners),
    (*_QUAD.edges, (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)),
    ((0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 7, 6, 2), (0, 3, 2, 1), (4, 5, 6, 7)),
)

#: Shape, scikit-fem's element, the groups of corners that have a node in their middle after the corners themselves,
#: degrees of exact quadrature of the stiffness and of the mass (of undistorted cells), the type of the faces. A mass of
#: curved cells is positive definite if all weights are: those of scikit-fem's fourth degree in tetrahedra are not.
_KINDS = {
    "line": (_LINE, "ElementLineP1", (), 1, 2, ""),
    "line3": (_LINE, "ElementLineP2", ("edges",), 2, 4, ""),
    "triangle": (_TRIANGLE, "ElementTriP1", (), 1, 2, "line"),
    "triangle6": (_TRIANGLE, "ElementTriP2", ("edges",), 2, 4, "line3"),
    "quad": (_QUAD, "ElementQuad1", (), 2, 2, "line"),
    "quad8": (_QUAD, "ElementQuadS2", ("edges",), 4, 4, "line3"),
    "quad9": (_QUAD, "ElementQuad2", ("edges", "cell"), 4, 4, "line3"),
    "tetra": (_TETRA, "ElementTetP1", (), 1, 2, "triangle"),
    "tetra10": (_TETRA, "ElementTetP2", ("edges",), 2, 5, "triangle6"),
    "hexahedron": (_HEXAHEDRON, "ElementHex1", (), 2, 2, "quad"),
    "hexahedron20": (_HEXAHEDRON, "ElementHexS2", ("edges",), 4, 4, "quad8"),
    "hexahedron27": (_HEXAHEDRON, "ElementHex2", ("edges", "faces", "cell"), 4, 4, "quad9"),
}
#: Cells that bodies can be meshed with, by dimension.
PLANE_KINDS = ("triangle", "triangle6", "quad", "quad8", "quad9")
SOLID_KINDS = ("tetra", "tetra10", "hexahedron", "hexahedron20", "hexahedron27")


@dataclass(frozen=True, eq=False)
class Quadrature:
    """Shape functions at quadrature points."""

    weights: np.ndarray  # shape (n_q,); their sum is the reference cell's volume
    values: np.ndarray  # shape (n_q, n_nodes)
    gradients: np.ndarray  # in reference coordinates, shape (n_q, d, n_nodes)


@dataclass(frozen=True, eq=False)
class ReferenceElement:
    """An element on its reference cell."""

    kind: str  # meshio's name of the cell type
    dimension: int  # of the cell
    nodes: np.ndarray  # reference coordinates of the nodes in meshio's order, shape (n_nodes, d)
    #: stiffness, mass: quadrature that is exact for the stiffness or the mass of undistorted cells
    stiffness: Quadrature
    mass: Quadrature
    face_kind: str  # meshio's name of the faces' type; "" for lines


@cache
def reference_element(kind: str) -> ReferenceElement:
    """Return the element on cells of one of meshio's types."""
    shape, _, middles, stiffness_degree, mass_degree, face_kind = _KINDS[kind]
    nodes = _nodes(shape, middles)
    quadratures = (_quadrature(kind, nodes, degree) for degree in (stiffness_degree, mass_degree))
    return ReferenceElement(kind, nodes.shape[1], nodes, *quadratures, face_kind)


def shape_gradients(kind: str, points: np.ndarray) -> np.ndarray:
    """Return the gradients of the shape functions of an element of meshio's cell type at points (n_points, d) in
    reference coordinates, shape (n_points, d, n_nodes)."""
    return _tabulated(kind, reference_element(kind).nodes, points)[1]


def shape_values(kind: str, points: np.ndarray) -> np.ndarray:
    """Return an element's shape functions at points, shape (n_points, n_nodes); `points` as for `shape_gradients`."""
    return _tabulated(kind, reference_element(kind).nodes, points)[0]


def _nodes(shape: _Shape, middles: tuple[str, ...]) -> np.ndarray:
    corners = np.array(shape.corners, dtype=float)
    groups = {"edges": shape.edges, "faces": shape.faces, "cell": (tuple(range(len(corners))),)}
    further = [corners[list(group)].mean(axis=0) for name in middles for group in groups[name]]
    return np.vstack([corners, *further])


@cache
def faces_of(kind: str) -> np.ndarray:
    """Return the local numbers of the nodes of every face of a cell, shape (n_faces, n_face_nodes), normal outwards, in
    the order of the face's element: its corners, then the middles of its edges, ..."""
    shape, _, own, *_, face_kind = _KINDS[kind]
    face_shape, _, middles, *_ = _KINDS[face_kind]
    nodes, weights = _nodes(shape, own), _barycentric(face_shape, _nodes(face_shape, middles))
    return np.array(
        [[_number_at(nodes, place) for place in weights @ nodes[list(corners)]] for corners in shape.faces], dtype=int
    )


def _barycentric(shape: _Shape, places: np.ndarray) -> np.ndarray:
    """Return the linear (bilinear) weights of a face's corners at places in it, shape (n_places, n_corners)."""
    corners = np.array(shape.corners, dtype=float)
    if len(corners) == corners.shape[1] + 1:  # a simplex
        return np.column_stack([1.0 - places.sum(axis=1), places])
    return np.array([[np.prod(np.where(corner == 1.0, x, 1.0 - x)) for corner in corners] for x in places])


def _number_at(places: np.ndarray, place: np.ndarray) -> int:
    return int(np.argmin(np.abs(places - place).max(axis=1)))


def _element(kind: str) -> skfem.element.Element:
    import skfem.element  # takes a noticeable time, and runs with beams alone do not need it

    return getattr(skfem.element, _KINDS[kind][1])()


def _tabulated(kind: str, nodes: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values (n_points, n_nodes) and gradients (n_points, d, n_nodes) of shape functions at points."""
    element = _element(kind)
    order = [_number_at(element.doflocs, node) for node in nodes]
    tabulated = [element.lbasis(points.T, number) for number in order]
    values = np.array([np.broadcast_to(value, len(points)) for value, _ in tabulated])
    gradients = np.array([np.broadcast_to(gradient, points.T.shape) for _, gradient in tabulated])
    return values.T.copy(), np.moveaxis(gradients, 0, -1).swapaxes(0, 1).copy()


def _quadrature(kind: str, nodes: np.ndarray, degree: int) -> Quadrature:
    from skfem.quadrature import get_quadrature

    points, weights = get_quadrature(_element(kind).refdom, degree)
    return Quadrature(weights, *_tabulated(kind, nodes, points.T))


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
        """Return the faces of the group `name`, shape (n_faces, n_face_nodes). Raises `InputError` if the name is
        unknown or holds no face; `entry` is the dotted name of the scene's entry that asks."""
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
        received = f'{entry} = "{shortened(name)}"'
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

    Numbers (n,) are from zero without gaps, growing with the lowest node of the row.
    """
    rows = np.sort(rows, axis=1)
    order = np.lexsort(rows.T[::-1])  # many times faster than np.unique of rows
    is_new = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    numbers = np.zeros(len(rows), dtype=int)
    numbers[order[1:]] = np.cumsum(is_new)
    return numbers


def cell_faces(kind: str, cells: np.ndarray) -> np.ndarray:
    """Return the faces of all cells (n_cells, n_cell_nodes) of meshio's type `kind`, cell after cell, so that an inner
    face is there twice: shape (n_cells n_faces, n_face_nodes), nodes in the order of `faces_of`."""
    faces = faces_of(kind)
    return cells[:, faces].reshape(-1, faces.shape[1])


def outer_faces(kind: str, cells: np.ndarray) -> np.ndarray:
    """Return the faces, as `cell_faces`, that bound one cell alone."""
    faces = cell_faces(kind, cells)
    numbers = set_numbers(faces)
    return faces[np.bincount(numbers)[numbers] == 1]


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


def check_repeated(kind: str, cells: np.ndarray, received: str) -> None:
    """Refuse cells of one type that have the nodes of another one."""
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


def check_pieces(cells: np.ndarray, received: str, filed: np.ndarray | None = None) -> None:
    """Refuse cells that are not one piece; `filed` are the same in the file's numbers, if others."""
    from scipy.sparse.csgraph import connected_components

    n_nodes = int(cells.max()) + 1
    graph = undirected_graph(incidence_edges(n_nodes, cells), n_nodes + len(cells))
    pieces = connected_components(graph, directed=False)[1][n_nodes:]
    sizes = np.unique(pieces, return_counts=True)[1]
    if len(sizes) > 1:
        aside = int(np.flatnonzero(pieces != pieces[0])[0])
        of_aside = shown((cells if filed is None else filed)[aside])
        raise InputError(
            f"{received}: the cells form {len(sizes)} separate pieces of {shown(np.sort(sizes)[::-1])} cells; the "
            f"first that does not hang together with cell 0 is cell {aside} with the nodes {of_aside}; a body is one "
            "connected piece (nodes at the same place must be merged)"
        )
