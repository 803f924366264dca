"""Plane and solid meshes made in memory, rectangles and boxes of every kind of cells, without a file; bodies on them.

They reach from the origin to the given lengths. Their sides are groups of faces: left and right across x; in the plane
bottom and top across y; in space front and back across y, bottom and top across z. The region body has all cells.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import meshio
import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from skfem.quadrature import get_quadrature

from pgmp_petsc.bodies.affine import Monomial, Quantity
from pgmp_petsc.bodies.solid import FaceFrame, Region, Solid
from pgmp_petsc.components.large_deformation import FieldsOnRanks, cyclic
from pgmp_petsc.mesh import SolidMesh
from pgmp_petsc.mesh.meshes import Quadrature, _element, _tabulated, cell_faces, reference_element
from pgmp_petsc.mesh.solid_mesh_reading import solid_mesh

SIDES = {2: (("left", "right"), ("bottom", "top")), 3: (("left", "right"), ("front", "back"), ("bottom", "top"))}
# corners of the parts into which a square or a cube is cut; a cube along the paths from its first to its last corner
TRIANGLES = (((0, 0), (1, 0), (1, 1)), ((0, 0), (1, 1), (0, 1)))
TETRAHEDRA = (
    ((0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1)), ((0, 0, 0), (1, 1, 0), (0, 1, 0), (1, 1, 1)),
    ((0, 0, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1)), ((0, 0, 0), (0, 1, 1), (0, 0, 1), (1, 1, 1)),
    ((0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1)), ((0, 0, 0), (1, 0, 1), (1, 0, 0), (1, 1, 1)),
)  # fmt: skip


def jacobian_determinants(nodes: np.ndarray, cells: np.ndarray, gradients: np.ndarray) -> np.ndarray:
    """Return det J (m^d) of cells on nodes (n_nodes, d) where shape functions have such gradients in reference
    coordinates (n_points, d, n_cell_nodes), shape (n_cells, n_points)."""
    coordinates = nodes[cells].swapaxes(1, 2)
    return np.column_stack([np.linalg.det(coordinates @ gradient.T) for gradient in gradients])


def rectangle_mesh(kind: str, counts: tuple[int, int], lengths: tuple[float, float]) -> SolidMesh:
    """Return a rectangle of counts[0] by counts[1] quads, or of twice as many triangles; lengths in m."""
    return solid_mesh(grid(kind, counts, lengths), 2, "rectangle")


def box_mesh(kind: str, counts: tuple[int, int, int], lengths: tuple[float, float, float]) -> SolidMesh:
    """Return a box of hexahedra, `counts` along x, y and z, or of six times as many tetrahedra; lengths in m."""
    return solid_mesh(grid(kind, counts, lengths), 3, "box")


def mesh_of(kind: str, counts: Sequence[int], lengths: Sequence[float]) -> SolidMesh:
    """Return a rectangle or a box, by the kind of its cells; entries beyond its dimension are not used."""
    d = dimension_of(kind)
    return (rectangle_mesh if d == 2 else box_mesh)(kind, tuple(counts[:d]), tuple(lengths[:d]))


def body_of(mesh: SolidMesh, modulus: float = 1.0, density: float = 1.0, nu: float = 0.3) -> Solid:
    cells = np.arange(mesh.n_cells)
    return Solid("body", mesh, (Region(cells, Quantity.of(modulus), Quantity.of(density), nu),))


def matrices_of(solid: Solid) -> tuple[sp.csr_matrix, sp.csr_matrix]:
    """Return stiffness and mass of a body without parameters."""
    nodes = range(solid.mesh.n_nodes)
    return solid.stiffness(nodes)[Monomial()], solid.mass(nodes)[Monomial()]


def rod(kind: str, two_materials: bool = False) -> tuple[Solid, dict[str, FaceFrame], list[dict[str, float]]]:
    """Return a rod of steel with its frames and the parameter values to serve, nominal first.

    With two materials the half on the left has a parameter E as its Young's modulus; the other half is of aluminium.
    """
    mesh = mesh_of(kind, (12, 2, 2) if dimension_of(kind) == 2 else (8, 2, 2), (0.6, 0.06, 0.04))
    face_kind = reference_element(kind).face_kind
    frames = {name: FaceFrame.of(mesh.nodes, mesh.groups[name], face_kind) for name in ("left", "right")}
    if not two_materials:
        return body_of(mesh, 210e9, 7800.0), frames, [{}]
    left = mesh.nodes[mesh.cells].mean(axis=1)[:, 0] < 0.3
    regions = (
        Region(np.flatnonzero(left), Quantity.of("E"), Quantity.of(7800.0), 0.3),
        Region(np.flatnonzero(~left), Quantity.of(70e9), Quantity.of(2700.0), 0.33),
    )
    # as of a distribution: nominal, outermost and half-way
    points = [{"E": value} for value in (2e11, 1.2e11, 1.6e11, 2.4e11, 2.8e11)]
    return Solid("rod", mesh, regions), frames, points


def corner_weights(kind: str) -> np.ndarray:
    """Return what makes the nodes of a cell with straight edges from its corners, shape (n_nodes, n_corners)."""
    nodes = reference_element(kind).nodes
    if kind.startswith(("tri", "tet")):
        return np.column_stack([1.0 - nodes.sum(axis=1), nodes])
    corners = nodes[: 2 ** nodes.shape[1]]
    return np.prod(np.where(corners == 1.0, nodes[:, None], 1.0 - nodes[:, None]), axis=2)


def straightened(mesh: SolidMesh) -> SolidMesh:
    """Return a mesh with the nodes between corners put where the cells' edges are straight."""
    weights, nodes = corner_weights(mesh.kind), mesh.nodes.copy()
    nodes[mesh.cells] = np.einsum("ac,eci->eai", weights, mesh.nodes[mesh.cells[:, : weights.shape[1]]])
    return replace(mesh, nodes=nodes)


def dimension_of(kind: str) -> int:
    return reference_element(kind).dimension


def rule_of(kind: str, degree: int) -> Quadrature:
    """Return shape functions at the points of a rule of a degree of one's own."""
    points, weights = get_quadrature(_element(kind).refdom, degree)
    return Quadrature(weights, *_tabulated(kind, reference_element(kind).nodes, points.T))


def grid(kind: str, counts: Sequence[int], lengths: Sequence[float]) -> meshio.Mesh:
    """Return the rectangle or box as meshio's mesh, its sides and the body as gmsh's physical groups.

    Blocks of cells: the body, then the sides in the order of `SIDES`.
    """
    counts, dimension = np.array(counts), len(counts)
    # Places are whole numbers of half a square's or cube's side.
    corners = 2 * np.moveaxis(np.indices(counts), 0, -1).reshape(-1, dimension)
    simplices = {"tri": TRIANGLES, "tet": TETRAHEDRA}.get(kind[:3], (None,))
    parts = np.array([_part(kind, part) for part in simplices])
    places = (corners[:, None, None] + parts).reshape(-1, parts.shape[1], dimension)
    used, cells = np.unique(places.reshape(-1, dimension), axis=0, return_inverse=True)
    cells = cells.reshape(-1, parts.shape[1])
    points = np.zeros((len(used), 3))
    points[:, :dimension] = used * np.array(lengths) / (2 * counts)
    faces, groups = cell_faces(kind, cells), {}
    for axis, sides in enumerate(SIDES[dimension]):
        for name, place in zip(sides, (0, 2 * counts[axis])):
            groups[name] = faces[(used[faces, axis] == place).all(axis=1)]
    return grouped(points, kind, cells, groups)


def grouped(points: np.ndarray, kind: str, cells: np.ndarray, groups: Mapping[str, np.ndarray]) -> meshio.Mesh:
    """Return meshio's mesh of a body's cells and groups of their faces, which are gmsh's physical groups."""
    element = reference_element(kind)
    blocks = [(kind, cells), *((element.face_kind, faces) for faces in groups.values())]
    tags = [np.full(len(block), number) for number, (_, block) in enumerate(blocks, start=1)]
    names = {name: np.array([number, element.dimension - 1]) for number, name in enumerate(groups, start=2)}
    tagged = {"gmsh:physical": tags, "gmsh:geometrical": list(tags)}
    return meshio.Mesh(points, blocks, cell_data=tagged, field_data={"body": np.array([1, element.dimension])} | names)


def _part(kind: str, corners: tuple | None) -> np.ndarray:
    """Return the places of a part's nodes in the square or cube from 0 to 2, shape (n_nodes, d)."""
    nodes = reference_element(kind).nodes
    if corners is not None:
        corners = np.array(corners)
        nodes = corners[0] + nodes @ (corners[1:] - corners[0])
    return np.rint(2 * nodes).astype(int)


def fields_on(solid: Solid, fields: np.ndarray) -> FieldsOnRanks:
    """Return displacement fields on all cells, by nodes (n_nodes, d, n) or unknowns (n_nodes d, n)."""
    return FieldsOnRanks(solid, fields.reshape(solid.n_dofs, -1), MPI.COMM_SELF)


def third_of(solid: Solid, fields: np.ndarray) -> dict[Monomial, np.ndarray]:
    """Return the third derivative of the strain energy at rest, by weight, shape (n, n, n)."""
    pairs = fields_on(solid, fields).of_pairs()
    return {weight: cyclic(part, fields.shape[-1]) for weight, part in pairs.items()}
