"""Parts of CAD: a STEP file of one solid, meshed by gmsh with tetra10, and what is known of its faces.

gmsh runs in a process of its own (`part_by_gmsh`). Every face of the solid is a group, ``face1``, ``face2``, ... in the
order of the file, and by its own name where CAD gives one; whole cylinders are groups too: holes ``bore1``, ``bore2``,
... and what is round outside ``pin1``, ..., each from the widest on. Lengths are converted from the unit that the file
states to the scene's. A part that has been meshed is kept in memory until the process ends.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

import meshio
import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.mesh.reading import check_file, made_by
from pgmp_petsc.mesh.solid_mesh import SolidMesh
from pgmp_petsc.mesh.solid_mesh_reading import solid_mesh

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
