"""Named groups of faces and named regions of cells, from the ways in which mesh formats name them.

A group of faces is a physical group (gmsh) or another named set of cells whose dimension is one less than the mesh's,
or a node set (Abaqus and others) that holds all nodes of at least one face on the surface. A region is a physical
group or a set of cells of the mesh's own dimension.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.mesh.cell_checks import shown
from pgmp_petsc.mesh.incidence import cell_faces, set_numbers
from pgmp_petsc.mesh.reference_element import reference_element
from pgmp_petsc.runtime.errors import InputError

if TYPE_CHECKING:
    import meshio

    Named = dict[str, np.ndarray]


def named_groups(mesh: meshio.Mesh, kind: str, cells: np.ndarray, received: str) -> tuple[Named, Named, dict[str, int]]:
    """Return groups of faces, regions of cells, and the number of nodes of every other name.

    Where a set of cells and a node set have the same name, the faces are those of the set of cells.

    Parameters
    ----------
    mesh : meshio.Mesh
        What was read.
    kind : str
        meshio's name of the cell type.
    cells : ndarray of int, shape (n_cells, n_cell_nodes)
        All cells of this type, block after block, in the file's numbers of nodes.
    received : str
        The scene's entry and its value, with which messages begin.

    Returns
    -------
    groups : dict of str to ndarray of int, shape (n_faces, n_face_nodes)
    regions : dict of str to ndarray of int, shape (n,)
    small_groups : dict of str to int

    Raises
    ------
    InputError
        If a group has cells that are no faces of the mesh, or a set of cells cannot be told.
    """
    own = cell_faces(kind, cells)
    face_kind = reference_element(kind).face_kind
    blocks = [np.asarray(block.data, dtype=int) for block in mesh.cells if block.type == face_kind and len(block.data)]
    file_faces = np.concatenate([np.empty((0, own.shape[1]), dtype=int), *blocks])
    places, on_surface = _matched(own, file_faces)
    surface = own[on_surface]

    groups, regions, small_groups = {}, {}, {}
    for name, members in _members(mesh, received).items():
        _check_face_types(mesh, members, kind, f'{received}: mixed element orders: the group "{name}"')
        region, faces = _numbers(mesh, members, kind), _numbers(mesh, members, face_kind)
        if region.size:
            regions[name] = region
        if faces.size:
            _check_found(places[faces], file_faces[faces], kind, f'{received}: the group "{name}"')
            groups[name] = own[np.unique(places[faces])]
        if not region.size and not faces.size:
            small_groups[name] = _n_nodes(mesh, members)
    for name, held in mesh.point_sets.items():
        whole = np.isin(surface, held).all(axis=1)
        if name not in groups and whole.any():
            groups[name] = surface[whole]
            small_groups.pop(name, None)
        elif name not in groups and name not in regions:
            small_groups[name] = len(np.unique(held))
    return groups, regions, small_groups


def _matched(own: np.ndarray, file_faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where each of the file's faces is among those of the cells (-1: nowhere), and which of these bound one.

    An inner face, which bounds two cells, is found in the first of them.
    """
    numbers = set_numbers(np.concatenate([own, file_faces]))
    own_numbers, file_numbers = np.split(numbers, [len(own)])
    first = np.full(numbers.max() + 1, -1)
    first[own_numbers[::-1]] = np.arange(len(own))[::-1]
    return first[file_numbers], np.bincount(own_numbers)[own_numbers] == 1


def _members(mesh: meshio.Mesh, received: str) -> dict[str, list[np.ndarray]]:
    """Return the cells of every physical group and cell set, as numbers within each block of cells."""
    members = {
        name: _set_members(mesh, name, numbers, received)
        for name, numbers in mesh.cell_sets.items()
        if not name.startswith("gmsh:")  # meshio keeps the bounding entities of blocks there
    }
    # A block of MSH 4.1 may be in several groups: its tags tell the first, the sets all of them.
    tags = mesh.cell_data.get("gmsh:physical", [np.zeros(len(block.data), dtype=int) for block in mesh.cells])
    for name, value in mesh.field_data.items():
        if np.size(value) != 2 or np.asarray(value).dtype.kind not in "iu":
            continue  # no physical group
        tag, dimension = (int(number) for number in np.ravel(value))
        found = [  # a negative tag is that of a reversed entity
            np.flatnonzero((block.dim == dimension) & (np.abs(numbers) == tag))
            for block, numbers in zip(mesh.cells, tags)
        ]
        others = members.get(name, [np.empty(0, dtype=int)] * len(found))
        members[name] = [np.union1d(ours, theirs) for ours, theirs in zip(found, others)]
    return members


def _set_members(mesh: meshio.Mesh, name: str, blocks: list, received: str) -> list[np.ndarray]:
    """Return the numbers of a cell set's cells within each block, as far as meshio tells them.

    The set of an Abaqus file that stands before some of the cells has fewer entries than there are blocks.
    """
    try:
        members = [np.asarray([] if numbers is None else numbers, dtype=int) for numbers in blocks]
    except (TypeError, ValueError):
        members = []
    if len(members) != len(mesh.cells) or any(
        numbers.ndim != 1 or (numbers.size and not 0 <= numbers.min() <= numbers.max() < len(block.data))
        for block, numbers in zip(mesh.cells, members)
    ):
        raise InputError(
            f'{received}: the cells of the set "{name}" cannot be told from what meshio reads; a set must list its own '
            "cells, after all of them (one made from other sets must be removed or written out)"
        )
    return members


def _numbers(mesh: meshio.Mesh, members: list[np.ndarray], kind: str) -> np.ndarray:
    """Return the numbers of a group's cells among all cells of a type, increasing."""
    blocks = [(len(block.data), numbers) for block, numbers in zip(mesh.cells, members) if block.type == kind]
    starts = np.cumsum([0, *(length for length, _ in blocks)])
    return np.concatenate(
        [np.empty(0, dtype=int), *(start + np.unique(numbers) for start, (_, numbers) in zip(starts, blocks))]
    )


def _n_nodes(mesh: meshio.Mesh, members: list[np.ndarray]) -> int:
    """Return how many nodes a group's cells have."""
    parts = [np.ravel(block.data[numbers]) for block, numbers in zip(mesh.cells, members) if numbers.size]
    return len(np.unique(np.concatenate(parts))) if parts else 0


def _check_face_types(mesh: meshio.Mesh, members: list[np.ndarray], kind: str, beginning: str) -> None:
    """Refuse faces of another type than the cells have."""
    element = reference_element(kind)
    for block, numbers in zip(mesh.cells, members):
        if numbers.size and block.dim == element.dimension - 1 and block.type != element.face_kind:
            raise InputError(
                f"{beginning} has {numbers.size} faces of type {block.type}, the first with the nodes "
                f"{shown(block.data[numbers[0]])}; faces of {kind} cells are of type {element.face_kind}"
            )


def _check_found(places: np.ndarray, faces: np.ndarray, kind: str, beginning: str) -> None:
    """Refuse faces that are in no cell."""
    lost = np.flatnonzero(places < 0)
    if lost.size:
        raise InputError(
            f"{beginning} has {lost.size} of {len(faces)} faces that are no face of any {kind} cell; the first has the "
            f"nodes {shown(faces[lost[0]])}; each must have all nodes of a cell's face"
        )
