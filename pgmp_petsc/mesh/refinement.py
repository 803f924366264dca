"""Uniform refinement of line meshes in memory."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.mesh.line_mesh import LineMesh


def refined(mesh: LineMesh, parts: int) -> LineMesh:
    """Cut every cell into equal parts.

    The old nodes keep their numbers, and with them named points and points given by a node's index; the new ones
    follow, cell after cell. A curved body stays the polygon that its coarse mesh is.

    Parameters
    ----------
    mesh : LineMesh
    parts : int
        Number of parts, at least 1; with 1 the mesh is returned as it is.
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
