"""Meshes of plane and solid bodies: cells of one kind, with named groups of faces and named regions of cells, their
connected pieces and reference elements; and line meshes of beams, in the plane z = 0 or in space, with named points.

Reference elements have shape functions, quadrature and faces in meshio's order of nodes. Shape functions and quadrature
come from scikit-fem. Its numbering of nodes is another one, so each node is found by its place in the reference cell,
which is [0, 1]^d or the unit simplex in both.

A point of a line mesh is named by a physical group of dimension 0 (gmsh) or by a node set (Abaqus
and others) that holds exactly one node.

Straight lines of equal cells need no mesh file (`straight_beam`); any line mesh can be refined in memory (`refined`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.base.errors import InputError, nearest_name, shortened
from pgmp_petsc.mesh.reading import RELATIVE_TOLERANCE, Counted, coordinates, read_mesh, shown, usable

if TYPE_CHECKING:
    import meshio
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


MOST_DIGITS = 18  # of a node's index
STRAIGHT = 1e-9  # of its mesh's extent, by which a node may be beside a line


@dataclass(frozen=True, eq=False)
class LineMesh(Counted):
    """Two-node line cells."""

    nodes: np.ndarray  # coordinates in the mesh's own frame (m)
    cells: np.ndarray  # the two nodes of each cell
    points: dict[str, int] = field(default_factory=dict)  # the node of each named point
    #: names that cannot serve as a point, with the number of nodes they hold; kept to explain the refusal
    groups: dict[str, int] = field(default_factory=dict)
    numbered: bool = True  # whether a node may be named by its index: frames of a body are no nodes of its mesh

    kind = "line"  # meshio's name of the cells

    @cached_property
    def lengths(self) -> np.ndarray:
        """Length of each cell (m), shape (n_cells,)."""
        return np.linalg.norm(np.diff(self.nodes[self.cells], axis=1)[:, 0], axis=1)

    def point(self, name: str, entry: str) -> int:
        """Return the node of the point `name`, or of that index: a decimal integer, from zero, that is no named point.
        Raises `InputError` if the mesh has neither; `entry` is the dotted name of the scene's entry that asks."""
        if name in self.points:
            return self.points[name]
        if name in self.groups:
            raise InputError(
                f'{entry} = "{name}": this group holds {self.groups[name]} nodes of line cells; a point '
                "holds exactly one"
            )
        if not self.numbered:
            known = ", ".join(self.points)
            raise InputError(
                f'{entry} = "{shortened(name)}": the body has no frame there in this model, which has those of points '
                f"that the scene names: {known}; name it in an entry of the scene that is a point"
            )
        if name.isascii() and name.isdecimal():
            if len(name) <= MOST_DIGITS and int(name) < self.n_nodes:
                return int(name)
            raise InputError(f'{entry} = "{shortened(name)}": there is no such node; allowed: 0 to {self.n_nodes - 1}')
        raise InputError(
            f'{entry} = "{shortened(name)}": the mesh has no point of this name{nearest_name(name, self.points)}'
            f" (or a node's index, 0 to {self.n_nodes - 1})"
        )

    def run(self, node: int, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the nodes of the straight run of cells through a node along a direction (d,), in its order, and how
        far along it from the node they are, m; shape (n,) each."""
        way = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
        arms = self.nodes - self.nodes[node]
        along = arms @ way
        on_line = np.linalg.norm(arms - np.outer(along, way), axis=1) <= STRAIGHT * np.max(np.ptp(self.nodes, axis=0))
        found = [node]
        for sign in (1.0, -1.0):
            while True:
                beside = self.cells[(self.cells == found[-1]).any(axis=1)].ravel()
                ahead = [k for k in beside if on_line[k] and sign * (along[k] - along[found[-1]]) > 0.0]
                if not ahead:
                    break
                found.append(min(ahead, key=lambda k: sign * along[k]))
            found.reverse()
        return np.array(found), along[found]


def read_line_mesh(path: Path | str, entry: str, dimension: int = 2) -> LineMesh:
    """Read a line mesh from a file of one of meshio's formats, in the plane or (3) in space.

    Nodes that are on no line cell are dropped; the others keep the file's order. `entry` is the dotted name of the
    scene's entry, for the messages. Raises `InputError` if the file is missing or unreadable, holds cells that beams
    cannot use, leaves the plane z = 0 in two dimensions, has cells of zero length or twice the same cell, or is not
    connected.
    """
    received = shortened(f'{entry} = "{path}"')
    mesh = read_mesh(Path(path), received)
    with usable(received):
        all_cells = _line_cells(mesh, received, dimension)
        used, cells = np.unique(all_cells, return_inverse=True)
        nodes = coordinates(mesh.points[used], dimension, received, used)
        line_mesh = LineMesh(nodes, cells.reshape(-1, 2), *_named_points(mesh, used))
        zero = np.flatnonzero(line_mesh.lengths <= RELATIVE_TOLERANCE * np.ptp(line_mesh.nodes, axis=0).max())
        if zero.size:
            raise InputError(
                f"{received}: line cell {zero[0]} between the nodes {all_cells[zero[0]].tolist()} has zero length; a "
                "positive length is needed"
            )
        check_repeated("line", all_cells, received)
        check_pieces(line_mesh.cells, received, all_cells)
    return line_mesh


def _line_cells(mesh: meshio.Mesh, received: str, dimension: int) -> np.ndarray:
    """Return the line cells in the file's node numbers; other cells than lines and vertices are refused."""
    types = sorted({block.type for block in mesh.cells if len(block.data)})
    others = [name for name in types if name not in ("line", "vertex")]
    if others:
        raise InputError(
            f"{received}: it has cells of type {', '.join(others)}; the element beam{dimension}d takes two-node "
            "cells of type line only"
        )
    if "line" not in types:
        raise InputError(
            f"{received}: it has no cells of type line, which the element beam{dimension}d needs "
            f"(it has: {', '.join(types) or 'no cells at all'})"
        )
    cells = np.concatenate([block.data for block in mesh.cells if block.type == "line"]).astype(int)
    if cells.min() < 0 or cells.max() >= len(mesh.points):
        raise InputError(f"{received}: a line cell names a node that the file does not hold")
    return cells


def _named_points(mesh: meshio.Mesh, used: np.ndarray) -> tuple[dict[str, int], dict[str, int]]:
    """Return the names of single nodes, and for every other named group how many of its nodes are used."""
    groups: dict[str, np.ndarray] = {name: np.asarray(nodes, dtype=int) for name, nodes in mesh.point_sets.items()}
    names = {int(tag): name for name, (tag, dimension) in mesh.field_data.items() if dimension == 0}
    for block, tags in zip(mesh.cells, mesh.cell_data.get("gmsh:physical", [])):
        if block.type == "vertex":
            for tag in np.intersect1d(tags, list(names)):
                nodes = block.data[np.asarray(tags) == tag].ravel().astype(int)
                groups[names[tag]] = np.append(groups.get(names[tag], np.array([], dtype=int)), nodes)
    points, unusable = {}, {}
    for name, nodes in groups.items():
        on_lines = np.flatnonzero(np.isin(used, nodes))
        if len(on_lines) == 1:
            points[name] = int(on_lines[0])
        else:
            unusable[name] = len(on_lines)
    return points, unusable


def straight_beam(length: float, n_cells: int, start: float = 0.0, dimension: int = 2) -> LineMesh:
    """Return a line along the x axis from `start` (m) on, with the points hinge, middle (where a node is) and tip."""
    nodes = np.zeros((n_cells + 1, dimension))
    nodes[:, 0] = np.linspace(start, start + length, n_cells + 1)
    cells = np.column_stack([np.arange(n_cells), np.arange(1, n_cells + 1)])
    points = {"hinge": 0, "tip": n_cells}
    if n_cells % 2 == 0:
        points["middle"] = n_cells // 2
    return LineMesh(nodes, cells, points)


def refined(mesh: LineMesh, parts: int) -> LineMesh:
    """Cut every cell into equal parts, at least 1; with 1 the mesh is returned as it is.

    The old nodes keep their numbers, and with them named points and points given by a node's index; the new ones
    follow, cell after cell. A curved body stays the polygon that its coarse mesh is.
    """
    if parts < 1:
        raise ValueError(f"parts = {parts}; at least 1 is needed")
    if parts == 1:
        return mesh
    share = np.arange(1, parts)[None, :, None] / parts
    first, last = mesh.nodes[mesh.cells[:, 0]][:, None], mesh.nodes[mesh.cells[:, 1]][:, None]
    inner = (1.0 - share) * first + share * last
    numbers = mesh.n_nodes + np.arange(mesh.n_cells * (parts - 1)).reshape(mesh.n_cells, parts - 1)
    chain = np.hstack([mesh.cells[:, :1], numbers, mesh.cells[:, 1:]])
    cells = np.stack([chain[:, :-1], chain[:, 1:]], axis=-1).reshape(-1, 2)
    return LineMesh(np.vstack([mesh.nodes, inner.reshape(-1, mesh.nodes.shape[1])]), cells, mesh.points, mesh.groups)
