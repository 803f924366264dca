"""Physical groups of gmsh's MSH 4.1 files, which meshio tells in part.

In this format an entity (a curve, a surface, ...) names all the physical groups it is in, with a negative sign where
the group has it reversed. meshio 5 gives the first of the groups, and all those with a positive sign. A curve that is
reversed in two groups, as happens to boundaries that gmsh was asked for, would be missing from one of them unnoticed.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import meshio

VERSION = b"4.1"


def complete_physical_groups(mesh: meshio.Mesh, path: Path) -> None:
    """Set the mesh's cell sets to all cells of each physical group, if `path` is a file of this format.

    Parameters
    ----------
    mesh : meshio.Mesh
        What meshio has read from the file.
    path : Path
    """
    groups = entity_groups(path)
    if not groups or "gmsh:geometrical" not in mesh.cell_data:
        return
    # a block of cells is of one entity
    held = [
        (block.dim, groups.get((block.dim, int(entity[0])), []), len(block.data)) if len(block.data) else (-1, [], 0)
        for block, entity in zip(mesh.cells, mesh.cell_data["gmsh:geometrical"])
    ]
    for name, (tag, dimension) in mesh.field_data.items():
        mesh.cell_sets[name] = [np.arange(count if at == dimension and tag in tags else 0) for at, tags, count in held]


def entity_groups(path: Path) -> dict[tuple[int, int], np.ndarray]:
    """Return the tags of the physical groups, without signs, by dimension and tag of the entity.

    Nothing is returned for files of other formats, or that do not tell entities.
    """
    groups: dict[tuple[int, int], np.ndarray] = {}
    with path.open("rb") as file:
        if not _found(file, b"$MeshFormat"):
            return groups
        version, binary, n_bytes = file.readline().split()[:3]
        if version != VERSION or not _found(file, b"$Entities"):
            return groups
        read = partial(np.fromfile, file, sep="" if int(binary) else " ")
        count = np.dtype(f"u{int(n_bytes)}")
        for dimension, n_entities in enumerate(read(count, 4)):
            for _ in range(int(n_entities)):
                (entity,) = read(np.int32, 1)
                read(np.float64, 6 if dimension else 3)  # where it is
                groups[dimension, int(entity)] = np.abs(read(np.int32, int(read(count, 1)[0])))
                if dimension:
                    read(np.int32, int(read(count, 1)[0]))  # what bounds it
    return groups


def _found(file: object, section: bytes) -> bool:
    """Read on to the line that begins a section; stop where the nodes begin, before which these sections are."""
    for line in iter(file.readline, b""):
        if line.strip() == section:
            return True
        if line.strip() == b"$Nodes":
            break
    return False
