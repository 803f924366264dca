"""Line meshes of beams: two-node cells, in the plane z = 0 or in space, with the named points where joints attach.

Whatever meshio reads is accepted. A point is named by a physical group of dimension 0 (gmsh) or by a node set (Abaqus
and others) that holds exactly one node.

Straight lines of equal cells need no mesh file (`straight_beam`); any line mesh can be refined in memory (`refined`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.base.errors import InputError, nearest_name, shortened
from pgmp_petsc.mesh.reading import RELATIVE_TOLERANCE, Counted, coordinates, read_mesh, usable
from pgmp_petsc.mesh.solid_mesh import check_pieces, check_repeated

if TYPE_CHECKING:
    import meshio

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
