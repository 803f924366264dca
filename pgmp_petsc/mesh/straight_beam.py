"""Straight lines of equal cells, for bodies that need no mesh file."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.mesh.line_mesh import LineMesh


def straight_beam(length: float, n_cells: int, start: float = 0.0, dimension: int = 2) -> LineMesh:
    """Return a line along the x axis from `start` (m) on, with the points hinge, middle (where a node is) and tip."""
    nodes = np.zeros((n_cells + 1, dimension))
    nodes[:, 0] = np.linspace(start, start + length, n_cells + 1)
    cells = np.column_stack([np.arange(n_cells), np.arange(1, n_cells + 1)])
    points = {"hinge": 0, "tip": n_cells}
    if n_cells % 2 == 0:
        points["middle"] = n_cells // 2
    return LineMesh(nodes, cells, points)
