"""Reading of plane and solid meshes through meshio, and what is refused.

Messages number nodes and cells in the file's order, from zero, as meshio does.

Numbering of a mesh from one of its ends to the other, so that contiguous shares of the nodes are compact.

Unknowns are dealt to processes in contiguous shares of the nodes. The order is that of reverse Cuthill-McKee: layers of
nodes with the same distance from one end (A. George, J. W. H. Liu, Computer Solution of Large Sparse Positive Definite
Systems, 1981, chapter 4).
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import meshio
import numpy as np
from scipy.sparse.csgraph import breadth_first_order, reverse_cuthill_mckee

from pgmp_petsc.mesh.abaqus import check_sets
from pgmp_petsc.mesh.cell_checks import check_cells, shown
from pgmp_petsc.mesh.face_groups import named_groups
from pgmp_petsc.mesh.incidence import incidence_edges, undirected_graph
from pgmp_petsc.mesh.msh_groups import complete_physical_groups
from pgmp_petsc.mesh.reading import FARTHEST, RELATIVE_TOLERANCE, read_mesh, usable
from pgmp_petsc.mesh.reference_element import PLANE_KINDS, SOLID_KINDS
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.runtime.errors import InputError, shortened

KINDS = {2: PLANE_KINDS, 3: SOLID_KINDS}


def read_solid_mesh(path: Path | str, dimension: int, entry: str) -> SolidMesh:
    """Read the mesh of a plane or solid body from a file of one of meshio's formats.

    Nodes are numbered anew from one end of the body to the other, cells in the order of their lowest node. Cells of
    lower dimension serve as the faces of named groups only.

    Parameters
    ----------
    path : Path or str
        The mesh file.
    dimension : int
        Of the cells: 2 in the plane z = 0, or 3.
    entry : str
        Dotted name of the scene's entry, such as ``bodies.crank.mesh``, for the messages.

    Raises
    ------
    InputError
        If the file is missing or unreadable, has sets that meshio misreads, or `solid_mesh` refuses what it holds.
    """
    received = shortened(f'{entry} = "{path}"')
    mesh = read_mesh(Path(path), received)
    with usable(received):
        complete_physical_groups(mesh, Path(path))
        check_sets(Path(path), received)
        return solid_mesh(mesh, dimension, received)


def solid_mesh(mesh: meshio.Mesh, dimension: int, received: str) -> SolidMesh:
    """Return the body's mesh from what meshio has read.

    Parameters
    ----------
    mesh : meshio.Mesh
    dimension : int
        Of the cells, 2 or 3.
    received : str
        The scene's entry and its value, with which messages begin.

    Raises
    ------
    InputError
        If the cells are not of one supported type, name nodes that are not there or leave nodes unused; if coordinates
        are not finite or, in the plane, off z = 0; if cells are repeated, inverted, without volume or in several
        pieces; or if a named group has faces that the cells do not have.
    """
    return renumbered(numbered_as_filed(mesh, dimension, received))


def numbered_as_filed(mesh: meshio.Mesh, dimension: int, received: str) -> SolidMesh:
    """Return the body's mesh as `solid_mesh` does, but with nodes and cells in the order of the file."""
    kind, cells = _cells(mesh, dimension, received)
    _check_nodes(mesh.points, kind, cells, received)
    nodes = coordinates(mesh.points, dimension, received)
    check_cells(kind, nodes, cells, received)
    groups, regions, small_groups = named_groups(mesh, kind, cells, received)
    return SolidMesh(kind, nodes, cells, groups, regions, small_groups)


def _cells(mesh: meshio.Mesh, dimension: int, received: str) -> tuple[str, np.ndarray]:
    """Return the type of the cells of this dimension and their nodes; there must be one type, and it supported."""
    counts, dimensions = Counter(), {}
    for block in mesh.cells:
        if len(block.data):
            counts[block.type] += len(block.data)
            dimensions[block.type] = block.dim
    kinds = [name for name in counts if dimensions[name] == dimension]
    allowed = f"{'plane' if dimension == 2 else 'solid'} bodies take cells of one of the types " + ", ".join(
        KINDS[dimension]
    )
    if not kinds:
        raise InputError(
            f"{received}: it has no cells of dimension {dimension} (it has: {_listed(counts) or 'no cells at all'}); "
            f"{allowed}"
        )
    unusable = {name: counts[name] for name in counts if dimensions[name] > dimension}
    unusable |= {name: counts[name] for name in kinds if name not in KINDS[dimension]}
    if unusable:
        raise InputError(f"{received}: it has {_listed(unusable)} cells, which cannot be used here; {allowed}")
    if len(kinds) > 1:
        raise InputError(
            f"{received}: it has {_listed({name: counts[name] for name in kinds})} cells together; {allowed}, the same "
            "shape and order throughout"
        )
    blocks = [block.data for block in mesh.cells if block.type == kinds[0] and len(block.data)]
    return kinds[0], np.concatenate(blocks).astype(int)


def _listed(counts: dict[str, int]) -> str:
    return " and ".join(f"{count} {name}" for name, count in sorted(counts.items()))


def _check_nodes(points: np.ndarray, kind: str, cells: np.ndarray, received: str) -> None:
    """Refuse cells with nodes that are not there, and nodes without a cell."""
    lost = np.flatnonzero(((cells < 0) | (cells >= len(points))).any(axis=1))
    if lost.size:
        raise InputError(
            f"{received}: {lost.size} of {len(cells)} cells of type {kind} name a node that the file does not hold; "
            f"the first is cell {lost[0]} with the nodes {shown(cells[lost[0]], len(cells[0]))}; the file has "
            f"{len(points)} nodes, numbered from 0"
        )
    unused = np.flatnonzero(np.bincount(cells.ravel(), minlength=len(points)) == 0)
    if unused.size:
        raise InputError(
            f"{received}: a mesh with unused nodes: {unused.size} of {len(points)} nodes are in no cell of type "
            f"{kind}; the first is node {unused[0]} at {points[unused[0]].tolist()}, counted from 0; each node must be "
            "in a cell (gmsh leaves out centres of arcs and other points if only physical groups are saved)"
        )


def coordinates(points: np.ndarray, dimension: int, received: str) -> np.ndarray:
    """Return the coordinates in the plane or in space after checking that they are finite and in the plane z = 0."""
    points = np.asarray(points, dtype=float)
    strange = np.flatnonzero(~(np.abs(points) < FARTHEST).all(axis=1))
    if strange.size:
        what = f"beyond {FARTHEST:g}" if np.isfinite(points).all() else "not finite"
        raise InputError(
            f"{received}: {strange.size} of {len(points)} nodes have coordinates that are {what}; the first is "
            f"node {strange[0]} at {points[strange[0]].tolist()}; finite numbers are needed"
        )
    off_plane = np.abs(points[:, dimension:]).max(axis=1, initial=0.0)
    off = np.flatnonzero(off_plane > RELATIVE_TOLERANCE * np.ptp(points, axis=0).max())
    if off.size:
        raise InputError(
            f"{received}: {off.size} of {len(points)} nodes are off the plane z = 0, where plane bodies lie; the first "
            f"is node {off[0]} at {points[off[0]].tolist()}"
        )
    missing = np.zeros((len(points), max(0, dimension - points.shape[1])))  # files of plane points for a solid body
    return np.hstack([points[:, :dimension], missing])


#: Walks from one end of the mesh to the node farthest from it; more of them hardly ever find a longer way.
N_WALKS = 3


def renumbered(mesh: SolidMesh) -> SolidMesh:
    """Return the same mesh with its nodes in a compact order, and cells and faces in that of their lowest node."""
    order = compact_order(mesh.n_nodes, mesh.cells)
    node_numbers = _inverse(order)
    cells = node_numbers[mesh.cells]
    cell_order = np.argsort(cells.min(axis=1), kind="stable")
    cell_numbers = _inverse(cell_order)
    groups = {name: _in_order(node_numbers[faces]) for name, faces in mesh.groups.items()}
    regions = {name: np.sort(cell_numbers[region]) for name, region in mesh.regions.items()}
    return SolidMesh(mesh.kind, mesh.nodes[order], cells[cell_order], groups, regions, mesh.small_groups)


def compact_order(n_nodes: int, cells: np.ndarray) -> np.ndarray:
    """Return the nodes of a connected mesh in the order of reverse Cuthill-McKee, shape (n_nodes,).

    Parameters
    ----------
    n_nodes : int
    cells : ndarray of int, shape (n_cells, n_cell_nodes)
    """
    edges = incidence_edges(n_nodes, cells)
    start = n_nodes + len(cells)
    graph = undirected_graph(edges, start)
    end = 0
    for _ in range(N_WALKS):
        end = int(breadth_first_order(graph, end, return_predecessors=False)[-1])
    # scipy starts where there are fewest edges, which for cells with nodes on their edges may be halfway along a body.
    # One more vertex that hangs on the end, and a loop on every other one, make it start there.
    loops = np.tile(np.arange(start), (2, 1))
    graph = undirected_graph(np.hstack([edges, loops, [[end], [start]]]), start + 1)
    order = reverse_cuthill_mckee(graph, symmetric_mode=True)
    return order[order < n_nodes].astype(int)


def _inverse(order: np.ndarray) -> np.ndarray:
    numbers = np.empty_like(order)
    numbers[order] = np.arange(len(order))
    return numbers


def _in_order(faces: np.ndarray) -> np.ndarray:
    return faces[np.lexsort(np.sort(faces, axis=1).T[::-1])]
