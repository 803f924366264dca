"""Numbering of a mesh from one of its ends to the other, so that contiguous shares of the nodes are compact.

Unknowns are dealt to processes in contiguous shares of the nodes. The order is that of reverse Cuthill-McKee: layers of
nodes with the same distance from one end (A. George, J. W. H. Liu, Computer Solution of Large Sparse Positive Definite
Systems, 1981, chapter 4).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import breadth_first_order, reverse_cuthill_mckee

from pgmp_petsc.mesh.incidence import incidence_edges, undirected_graph
from pgmp_petsc.mesh.solid_mesh import SolidMesh

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
