"""Reading of plane and solid meshes through meshio, what is refused, and parts of CAD.

Messages number nodes and cells in the file's order, from zero, as meshio does. Each cell is there once, all are one
piece, and the Jacobian of every cell's image of the reference cell has a positive determinant.

Unknowns are dealt to processes in contiguous shares of the nodes, which are therefore numbered from one end of the mesh
to the other: in the order of reverse Cuthill-McKee (A. George, J. W. H. Liu, Computer Solution of Large Sparse Positive
Definite Systems, 1981, chapter 4).

In gmsh's MSH 4.1 files an entity (a curve, a surface, ...) names all the physical groups it is in, with a negative sign
where the group has it reversed. meshio 5 gives the first of the groups, and all those with a positive sign. A curve
that is reversed in two groups, as happens to boundaries that gmsh was asked for, would be missing from one of them
unnoticed.

A group of faces is a physical group (gmsh) or another named set of cells whose dimension is one less than the mesh's,
or a node set (Abaqus and others) that holds all nodes of at least one face on the surface. A region is a physical
group or a set of cells of the mesh's own dimension.

A part of CAD is a STEP file of one solid, meshed by gmsh with tetra10. gmsh runs in a process of its own
(`part_by_gmsh`). Every face of the solid is a group, ``face1``, ``face2``, ... in the order of the file, and by its own
name where CAD gives one; whole cylinders are groups too: holes ``bore1``, ``bore2``, ... and what is round outside
``pin1``, ..., each from the widest on. Lengths are converted from the unit that the file states to the scene's. A part
that has been meshed is kept in memory until the process ends.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from hashlib import sha256
from pathlib import Path

import meshio
import numpy as np
from scipy.sparse.csgraph import breadth_first_order, reverse_cuthill_mckee

from pgmp_petsc.base.errors import InputError, shortened
from pgmp_petsc.mesh.meshes import (
    PLANE_KINDS,
    SOLID_KINDS,
    SolidMesh,
    cell_faces,
    check_pieces,
    check_repeated,
    incidence_edges,
    reference_element,
    set_numbers,
    shape_gradients,
    undirected_graph,
)
from pgmp_petsc.mesh.reading import RELATIVE_TOLERANCE, check_file, coordinates, made_by, read_mesh, shown, usable


def check_cells(kind: str, nodes: np.ndarray, cells: np.ndarray, received: str) -> None:
    """Refuse repeated cells, separate pieces, and cells that are inverted or have no volume: with det J <= 0 at any
    point of the mass quadrature or at any node.

    Nodes are (n_nodes, d), finite, m; cells (n_cells, n_cell_nodes) of meshio's type `kind`. Messages begin with
    `received`, the scene's entry and its value. Raises `InputError`, naming what is wrong, and where.

    Coordinates are known to `RELATIVE_TOLERANCE` times the mesh's extent. An error of this size in J changes det J by
    up to its product with the norm of J's cofactors, and below that a determinant has no certain sign. In other words,
    the smallest singular value of J, the thinnest measure of the cell, must be above the error of the coordinates,
    whatever the size of the cell and however slender it is.
    """
    check_repeated(kind, cells, received)
    check_pieces(cells, received)
    element = reference_element(kind)
    error = RELATIVE_TOLERANCE * np.ptp(nodes, axis=0).max()
    coordinates = nodes[cells].swapaxes(1, 2)
    smallest, unsound = np.full(len(cells), np.inf), np.zeros(len(cells), dtype=bool)
    # point after point, because the Jacobians of all cells at all points fill much more memory than the mesh
    for gradient in (*element.mass.gradients, *shape_gradients(kind, element.nodes)):
        determinants, cofactors = _determinants(coordinates @ gradient.T)
        np.minimum(smallest, determinants, out=smallest)
        unsound |= determinants <= error * cofactors
    if unsound.any():
        first = int(np.argmax(unsound))
        plane = element.dimension == 2
        count = f"all {len(cells)}" if unsound.all() else f"{unsound.sum()} of {len(cells)}"
        raise InputError(
            f"{received}: {count} cells of type {kind} are inverted or have no {'area' if plane else 'volume'}; the "
            f"first is cell {first} with the nodes {shown(cells[first])}, where the determinant of the Jacobian falls "
            f"to {smallest[first]:.3g}; it must be positive throughout each cell, with the nodes "
            f"in meshio's order{' (counter-clockwise)' if plane else ''}"
        )


def _determinants(jacobians: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the determinants of (n, d, d) matrices and the Frobenius norms of their cofactors, shape (n,) each."""
    columns = np.moveaxis(jacobians, -1, 0)
    if len(columns) == 2:
        (a, c), (b, d) = columns[0].T, columns[1].T
        return a * d - b * c, np.sqrt(a**2 + b**2 + c**2 + d**2)
    cofactors = np.cross(columns[[1, 2, 0]], columns[[2, 0, 1]])
    return (columns[0] * cofactors[0]).sum(axis=1), np.sqrt((cofactors**2).sum(axis=(0, 2)))


KINDS = {2: PLANE_KINDS, 3: SOLID_KINDS}


def read_solid_mesh(path: Path | str, dimension: int, entry: str) -> SolidMesh:
    """Read the mesh of a plane (2) or solid (3) body from a file of one of meshio's formats.

    Nodes are numbered anew from one end of the body to the other, cells in the order of their lowest node. Cells of
    lower dimension serve as the faces of named groups only. `entry` is the dotted name of the scene's entry. Raises
    `InputError` if the file is missing or unreadable, or `solid_mesh` refuses what it holds.
    """
    received = shortened(f'{entry} = "{path}"')
    mesh = read_mesh(Path(path), received)
    with usable(received):
        complete_physical_groups(mesh, Path(path))
        return solid_mesh(mesh, dimension, received)


def solid_mesh(mesh: meshio.Mesh, dimension: int, received: str) -> SolidMesh:
    """Return the body's mesh from what meshio has read; `received` is the scene's entry and its value.

    Nodes that are in none of the cells are left out. Raises `InputError` if the cells are not of one supported type or
    name nodes that are not there; if coordinates are not finite or, in the plane, off z = 0; if cells are repeated,
    inverted, without volume or in several pieces; or if a named group has faces that the cells do not have.
    """
    return renumbered(numbered_as_filed(mesh, dimension, received))


def numbered_as_filed(mesh: meshio.Mesh, dimension: int, received: str) -> SolidMesh:
    """Return the body's mesh as `solid_mesh` does, but with nodes and cells in the order of the file."""
    kind, cells = _cells(mesh, dimension, received)
    lost = np.flatnonzero(((cells < 0) | (cells >= len(mesh.points))).any(axis=1))
    if lost.size:
        raise InputError(
            f"{received}: {lost.size} of {len(cells)} cells of type {kind} name a node that the file does not hold; "
            f"the first is cell {lost[0]} with the nodes {shown(cells[lost[0]], len(cells[0]))}; the file has "
            f"{len(mesh.points)} nodes, numbered from 0"
        )
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


#: Walks from one end of the mesh to the node farthest from it; more of them hardly ever find a longer way.
N_WALKS = 3


def renumbered(mesh: SolidMesh) -> SolidMesh:
    """Return the same mesh with the nodes of its cells in a compact order, and cells and faces in that of their lowest
    node."""
    used, cells = np.unique(mesh.cells, return_inverse=True)
    order = used[compact_order(len(used), cells.reshape(mesh.cells.shape))]
    node_numbers = np.full(mesh.n_nodes, -1)
    node_numbers[order] = np.arange(len(order))
    cells = node_numbers[mesh.cells]
    cell_order = np.argsort(cells.min(axis=1), kind="stable")
    cell_numbers = np.argsort(cell_order)
    groups = {name: node_numbers[faces] for name, faces in mesh.groups.items()}
    groups = {name: faces[np.lexsort(np.sort(faces, axis=1).T[::-1])] for name, faces in groups.items()}
    regions = {name: np.sort(cell_numbers[region]) for name, region in mesh.regions.items()}
    return SolidMesh(mesh.kind, mesh.nodes[order], cells[cell_order], groups, regions, mesh.small_groups)


def compact_order(n_nodes: int, cells: np.ndarray) -> np.ndarray:
    """Return the nodes of a connected mesh of cells (n_cells, n_cell_nodes) in the order of reverse Cuthill-McKee,
    shape (n_nodes,)."""
    edges = incidence_edges(n_nodes, cells)
    start = n_nodes + len(cells)
    graph = undirected_graph(edges, start)
    end = 0
    for _ in range(N_WALKS):
        end = int(breadth_first_order(graph, end, return_predecessors=False)[-1])
    # scipy starts where there are fewest edges, which for cells with nodes on their edges may be halfway along a body.
    # One more vertex that hangs on the end, and a loop on every other one, make it start there.
    graph = undirected_graph(np.hstack([edges, np.tile(np.arange(start), (2, 1)), [[end], [start]]]), start + 1)
    order = reverse_cuthill_mckee(graph, symmetric_mode=True)
    return order[order < n_nodes].astype(int)


VERSION = b"4.1"


def complete_physical_groups(mesh: meshio.Mesh, path: Path) -> None:
    """Set the cell sets of what meshio has read to all cells of each physical group, if `path` is a file of this
    format."""
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
    """Return the tags of the physical groups, without signs, by dimension and tag of the entity; nothing for files of
    other formats, or that do not tell entities."""
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


Named = dict[str, np.ndarray]


def named_groups(mesh: meshio.Mesh, kind: str, cells: np.ndarray, received: str) -> tuple[Named, Named, dict[str, int]]:
    """Return groups of faces (n_faces, n_face_nodes), regions of cells (n,), and how many nodes other names hold.

    Where a set of cells and a node set have the same name, the faces are those of the set of cells. `cells` are all
    cells of meshio's type `kind`, block after block, in the file's numbers of nodes. Raises `InputError` if a group has
    cells that are no faces of the mesh, or a set of cells cannot be told.
    """
    own = cell_faces(kind, cells)
    face_kind = reference_element(kind).face_kind
    blocks = [np.asarray(block.data, dtype=int) for block in mesh.cells if block.type == face_kind and len(block.data)]
    file_faces = np.concatenate([np.empty((0, own.shape[1]), dtype=int), *blocks])
    # where each of the file's faces is among those of the cells, -1 where it is none; an inner one, which bounds two
    # cells, is found in the first of them
    numbers = set_numbers(np.concatenate([own, file_faces]))
    own_numbers, file_numbers = np.split(numbers, [len(own)])
    first = np.full(numbers.max() + 1, -1)
    first[own_numbers[::-1]] = np.arange(len(own))[::-1]
    places, surface = first[file_numbers], own[np.bincount(own_numbers)[own_numbers] == 1]

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
            parts = [np.ravel(block.data[own]) for block, own in zip(mesh.cells, members) if own.size]
            small_groups[name] = len(np.unique(np.concatenate(parts))) if parts else 0
    for name, held in mesh.point_sets.items():
        whole = np.isin(surface, held).all(axis=1)
        if name not in groups and whole.any():
            groups[name] = surface[whole]
            small_groups.pop(name, None)
        elif name not in groups and name not in regions:
            small_groups[name] = len(np.unique(held))
    return groups, regions, small_groups


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
    """Return the numbers of a cell set's cells within each block, as far as meshio tells them."""
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


def _check_face_types(mesh: meshio.Mesh, members: list[np.ndarray], kind: str, beginning: str) -> None:
    element = reference_element(kind)
    for block, numbers in zip(mesh.cells, members):
        if numbers.size and block.dim == element.dimension - 1 and block.type != element.face_kind:
            raise InputError(
                f"{beginning} has {numbers.size} faces of type {block.type}, the first with the nodes "
                f"{shown(block.data[numbers[0]])}; faces of {kind} cells are of type {element.face_kind}"
            )


def _check_found(places: np.ndarray, faces: np.ndarray, kind: str, beginning: str) -> None:
    lost = np.flatnonzero(places < 0)
    if lost.size:
        raise InputError(
            f"{beginning} has {lost.size} of {len(faces)} faces that are no face of any {kind} cell; the first has the "
            f"nodes {shown(faces[lost[0]])}; each must have all nodes of a cell's face"
        )


PROGRAM = Path(__file__).with_name("part_by_gmsh.py")
LONGEST = 900.0  # s that gmsh may take
KEPT = 8  # parts
MILLIMETRE = 1e-3  # m; what gmsh is asked for
ROUND_OFF = 1e-9  # of the extent: places on an axis that are as good as 0


@dataclass(frozen=True, eq=False)
class Cylinder:
    """A whole cylinder among the faces of a part."""

    name: str  # of its group
    inner: bool  # whether it is a bore
    radius: float  # m
    axis: np.ndarray  # along it, shape (3,)
    centre: np.ndarray  # the middle of its axis, shape (3,), m
    length: float  # m
    faces: tuple[str, ...]  # groups that it is made of


@dataclass(frozen=True, eq=False)
class CadPart:
    """A meshed part, and what the solid itself has."""

    mesh: SolidMesh
    cylinders: tuple[Cylinder, ...]
    n_faces: int
    volume: float  # m3
    centre: np.ndarray  # of the volume, shape (3,), m
    inertia: np.ndarray  # about the centre at a density of 1, shape (3, 3), m5


def read_part(path: Path, received: str, unit: float, size: float | None = None, coarser: float = 1.0) -> CadPart:
    """Return the part of a STEP file in a unit of length of so many m; messages begin with the scene's entry and its
    value.

    The size is the largest one of a cell, in that unit; by the thickness of the walls where it is not given. Cells are
    made `coarser` times as large. Raises `InputError` if there is no such file, it is no STEP file or has no solid or
    several, gmsh is not there, or cannot mesh it.
    """
    check_file(path, received, "a STEP file of one solid is needed (paths are relative to the scene's directory)")
    content = path.read_bytes()
    if not content.lstrip().startswith(b"ISO-10303-21"):
        raise InputError(f"{received}: this is no STEP file, which begins with ISO-10303-21; export the part anew")
    if b"END-ISO-10303-21" not in content:
        cure = "copy or export the part anew"
        raise InputError(
            f"{received}: the file breaks off: END-ISO-10303-21, with which a STEP file ends, is missing; {cure}"
        )
    asked = 0.0 if size is None else size * unit / MILLIMETRE
    found = _by_gmsh(sha256(content).hexdigest(), path, asked, coarser)
    if isinstance(found, str):
        raise InputError(f"{received}: {found}")
    return _part(found, received, MILLIMETRE / unit)


@lru_cache(maxsize=KEPT)
def _by_gmsh(content: str, path: Path, size: float, coarser: float) -> dict[str, np.ndarray] | str:
    """Return what gmsh makes of a file with a digest, or why there is nothing; `size` in mm."""
    return made_by(PROGRAM, (path.resolve(), size, coarser), LONGEST)


def _part(found: dict[str, np.ndarray], received: str, scale: float) -> CadPart:
    faces = {name: own for name, own in found.items() if name.startswith("face") and name[4:].isdecimal()}
    round_off = ROUND_OFF * float(np.ptp(found["nodes"], axis=0).max())
    cylinders = tuple(_cylinders(found, scale, round_off))
    blocks = [("tetra10", found["cells"]), *(("triangle6", own) for own in faces.values())]
    number = {name: k for k, name in enumerate(faces, start=1)}
    named = {name: [name] for name in faces}
    for name in faces:
        own = str(found[f"named{name[4:]}"])
        if own and own not in faces:
            named.setdefault(own, []).append(name)
    for one in cylinders:
        if {*one.faces} != {*(own := named.setdefault(one.name, list(one.faces)))}:
            cure = f"also the name of the cylinder of {', '.join(one.faces)}; give another one in CAD"
            raise InputError(f"{received}: {', '.join(own)} has the name {one.name}, {cure}")
    sets = {
        name: [np.arange(len(data)) if k in {number[one] for one in own} else [] for k, (_, data) in enumerate(blocks)]
        for name, own in named.items()
    }
    mesh = solid_mesh(meshio.Mesh(scale * found["nodes"], blocks, cell_sets=sets), 3, received)
    volume, centre = float(found["volume"]) * scale**3, scale * _clean(found["centre"], round_off)
    return CadPart(mesh, cylinders, len(faces), volume, centre, found["inertia"] * scale**5)


def _cylinders(found: dict[str, np.ndarray], scale: float, round_off: float) -> Iterator[Cylinder]:
    """Yield whole cylinders, bores and pins counted apart."""
    count = {True: 0, False: 0}
    for k in range(sum(name.startswith("cylinder") for name in found)):
        inner, radius, *places, length = found[f"cylinder{k}"]
        inner = bool(inner)
        count[inner] += 1
        name = f"{'bore' if inner else 'pin'}{count[inner]}"
        axis, centre = _clean(places[:3], ROUND_OFF), scale * _clean(places[3:], round_off)
        faces = tuple(f"face{tag}" for tag in found[f"faces{k}"])
        yield Cylinder(name, inner, float(scale * radius), axis, centre, float(scale * length), faces)


def _clean(place: np.ndarray, round_off: float) -> np.ndarray:
    return np.where(np.abs(place) < round_off, 0.0, place)


def with_groups(mesh: SolidMesh, wanted: dict[str, str | tuple[str, ...]], entry: str) -> SolidMesh:
    """Return a mesh with further groups of faces, each one or several of its own; `entry` is the scene's. Raises
    `InputError` if a group is missing, or has a name that the mesh has already."""
    groups = dict(mesh.groups)
    for name, own in wanted.items():
        if name in mesh.groups:
            raise InputError(f"{entry}.{name}: the mesh has a group of this name already; take another one")
        parts = [mesh.faces(one, f"{entry}.{name}") for one in ((own,) if isinstance(own, str) else own)]
        groups[name] = np.unique(np.concatenate(parts), axis=0) if len(parts) > 1 else parts[0]
    return replace(mesh, groups=groups)
