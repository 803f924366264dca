"""Nodes of a body that is given by matrices: their places, their numbers in the file, and sets of them.

A mesh file has cells as well, as a rule. Where they are of one kind that bodies may be meshed with, groups are faces of
them and are weighted by area; otherwise groups are sets of nodes that count alike.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pgmp_petsc.mesh.abaqus import read_abaqus_nodes
from pgmp_petsc.mesh.msh_groups import complete_physical_groups
from pgmp_petsc.mesh.reading import check_file, read_mesh, usable
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.mesh.solid_mesh_reading import KINDS, coordinates, numbered_as_filed
from pgmp_petsc.runtime.errors import InputError

NEEDED = "a file of nodes is needed: a mesh, .csv with the columns node, x, y(, z), or .npz with the array nodes"


@dataclass(frozen=True, eq=False)
class NodeFile:
    """Nodes in the order of their file.

    Attributes
    ----------
    nodes
        Shape (n, d), in the file's unit.
    labels
        The file's numbers of them, shape (n,).
    sets
        Places in `nodes` of the nodes of every set, by name, shape (n_set,).
    mesh
        Cells and groups of faces; None where the file has no cells that bodies may be meshed with.
    """

    nodes: np.ndarray
    labels: np.ndarray
    sets: dict[str, np.ndarray]
    mesh: SolidMesh | None = None

    def places_of(self, labels: np.ndarray) -> np.ndarray:
        """Return where nodes are by their numbers; -1 for those that are not there."""
        order = np.argsort(self.labels)
        at = np.minimum(np.searchsorted(self.labels, labels, sorter=order), len(order) - 1)
        return np.where(self.labels[order[at]] == labels, order[at], -1)


def read_nodes(path: Path, dimension: int, received: str) -> NodeFile:
    """Read nodes.

    Parameters
    ----------
    path
        A mesh, or a file ending in .csv or .npz.
    dimension
        2 for nodes in the plane z = 0, or 3.
    received
        The scene's entry and its value, with which messages begin.

    Raises
    ------
    InputError
        If the file is missing or unreadable, nodes have one number, are not finite, or off the plane; or if its mesh is
        not sound.
    """
    suffix = path.suffix.lower()
    if suffix not in (".csv", ".npz"):
        return _of_mesh(path, dimension, received)
    check_file(path, received, NEEDED)
    with usable(received):
        points, labels, sets = (_of_table if suffix == ".csv" else _of_arrays)(path, received)
        nodes = coordinates(points, dimension, received)
        if np.unique(labels).size < labels.size:
            again = np.sort(labels)[:-1][np.diff(np.sort(labels)) == 0][0]
            raise InputError(f"{received}: node {again} is there twice; every node has a number of its own")
        found = NodeFile(nodes, labels, {})
        for name, members in sets.items():
            found.sets[name] = found.places_of(np.asarray(members))
            if (found.sets[name] < 0).any():
                lost = np.asarray(members)[found.sets[name] < 0][0]
                raise InputError(f'{received}: the set "{name}" has node {lost}, which the file does not hold')
        return found


def _of_table(path: Path, received: str) -> tuple[np.ndarray, np.ndarray, dict]:
    """Read lines of a node's number and coordinates; a line of names may come first."""
    lines = [line.strip() for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    rows = [re.split(r"[,;\s]+", line.rstrip(",; ")) for line in lines if line and not line.startswith("#")]
    if rows and not rows[0][0].replace(".", "").isdecimal():
        rows = rows[1:]
    if not rows or {len(row) for row in rows} not in ({3}, {4}):
        raise InputError(f"{received}: lines of a node's number and its two or three coordinates are needed")
    numbers = np.array(rows, dtype=float)
    labels = numbers[:, 0].astype(np.int64)
    if (labels != numbers[:, 0]).any():
        raise InputError(f"{received}: numbers of nodes must be whole numbers")
    return numbers[:, 1:], labels, {}


def _of_arrays(path: Path, received: str) -> tuple[np.ndarray, np.ndarray, dict]:
    """Read the array nodes, perhaps labels, and sets: other arrays of whole numbers."""
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    points = arrays.pop("nodes", None)
    if points is None or points.ndim != 2 or points.shape[1] not in (2, 3) or not len(points):
        raise InputError(f"{received}: the array nodes, of shape (n, 2) or (n, 3), is needed")
    labels = arrays.pop("labels", np.arange(1, len(points) + 1))
    if labels.shape != (len(points),) or labels.dtype.kind not in "iu":
        raise InputError(f"{received}: the array labels must have a whole number for each of the {len(points)} nodes")
    sets = {name: array for name, array in arrays.items() if array.ndim == 1 and array.dtype.kind in "iu"}
    return points, labels.astype(np.int64), sets


def _of_mesh(path: Path, dimension: int, received: str) -> NodeFile:
    check_file(path, received, NEEDED)
    if path.suffix.lower() == ".inp":
        with usable(received):
            mesh, labels = read_abaqus_nodes(path, received)
    else:
        mesh = read_mesh(path, received)
        labels = np.arange(1, len(mesh.points) + 1)
    with usable(received):
        complete_physical_groups(mesh, path)
        if not len(mesh.points):
            raise InputError(f"{received}: it has no nodes; {NEEDED}")
        sets = {name: np.unique(members) for name, members in mesh.point_sets.items()}
        kinds = {block.type for block in mesh.cells if len(block.data) and block.dim == dimension}
        if len(kinds) == 1 and kinds <= set(KINDS[dimension]):
            solid = numbered_as_filed(mesh, dimension, received)
            return NodeFile(solid.nodes, labels, sets, solid)
        return NodeFile(coordinates(mesh.points, dimension, received), labels, sets)
