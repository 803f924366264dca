"""Matrices of meshed bodies as other programs write them, each format by hand from its description."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy.io
import scipy.sparse as sp

from pgmp_petsc.mesh import SolidMesh

ABAQUS = {"quad": "CPS4", "quad8": "CPS8", "hexahedron": "C3D8", "hexahedron20": "C3D20", "tetra": "C3D4"}
GAP = 10  # numbers of nodes in files: 10, 20, 30, ... so that they are no places


def labels_of(mesh: SolidMesh) -> np.ndarray:
    """Return the numbers that nodes have in files."""
    return GAP * np.arange(1, mesh.n_nodes + 1)


def write_inp(path: Path, mesh: SolidMesh, length: float = 1.0, cells: bool = True) -> None:
    """Write an Abaqus file with a node set for every group of faces, lengths in a unit of so many metres."""
    labels = labels_of(mesh)
    lines = ["*HEADING", "a body", "*NODE"]
    for label, place in zip(labels, mesh.nodes / length):
        lines.append(", ".join([str(label), *(f"{x:.17g}" for x in (*place, 0.0)[:3])]))
    if cells:
        lines.append(f"*ELEMENT, TYPE={ABAQUS[mesh.kind]}, ELSET=ALL")
        for number, cell in enumerate(mesh.cells, 1):
            words = [str(number), *map(str, labels[cell])]  # 16 to a line
            lines += [
                ", ".join(words[:16]) + ("," if words[16:] else ""),
                *([", ".join(words[16:])] if words[16:] else []),
            ]
    for name, faces in mesh.groups.items():
        lines.append(f"*NSET, NSET={name}")
        members = labels[np.unique(faces)]
        lines += [", ".join(map(str, members[k : k + 16])) for k in range(0, members.size, 16)]
    path.write_text("\n".join(lines) + "\n")


def write_csv(path: Path, mesh: SolidMesh, length: float = 1.0) -> None:
    lines = ["node," + ",".join("xyz"[: mesh.dimension])]
    for label, place in zip(labels_of(mesh), mesh.nodes / length):
        lines.append(",".join([str(label), *(f"{x:.17g}" for x in place)]))
    path.write_text("\n".join(lines) + "\n")


def write_node_arrays(path: Path, mesh: SolidMesh, length: float = 1.0) -> None:
    sets = {name: labels_of(mesh)[np.unique(faces)] for name, faces in mesh.groups.items()}
    np.savez(path, nodes=mesh.nodes / length, labels=labels_of(mesh), **sets)


def write_abaqus(path: Path, matrix: sp.spmatrix, mesh: SolidMesh, triangle: bool = True) -> None:
    """Write FORMAT=MATRIX INPUT: row's node, direction, column's node, direction, value."""
    d, labels, entries = mesh.dimension, labels_of(mesh), sp.coo_matrix(matrix)
    lines = ["** Assembled matrix"]
    for i, j, value in zip(entries.row, entries.col, entries.data):
        if j <= i or not triangle:
            lines.append(f"{labels[i // d]},{i % d + 1}, {labels[j // d]},{j % d + 1}, {value:.15e}")
    path.write_text("\n".join(lines) + "\n")


def write_coordinates(path: Path, matrix: sp.spmatrix, mesh: SolidMesh) -> None:
    """Write FORMAT=COORDINATE: row, column, value."""
    entries = sp.coo_matrix(matrix)
    lines = [f"{i + 1} {j + 1} {value:.17e}" for i, j, value in zip(entries.row, entries.col, entries.data)]
    path.write_text("\n".join(lines) + "\n")


def write_market(path: Path, matrix: sp.spmatrix, mesh: SolidMesh) -> None:
    scipy.io.mmwrite(path, sp.coo_matrix(matrix), precision=17, symmetry="symmetric")


def write_npz(path: Path, matrix: sp.spmatrix, mesh: SolidMesh) -> None:
    sp.save_npz(path, sp.csr_matrix(matrix))


def write_harwell_boeing(path: Path, matrix: sp.spmatrix, mesh: SolidMesh) -> None:
    """Write RSA with Fortran's exponents, fields without blanks between them, and a right-hand side, as HBMAT does."""
    lower = sp.tril(matrix, format="csc")
    lower.sort_indices()
    n, n_entries = lower.shape[0], lower.nnz
    pointers = _cards([f"{p + 1:14d}" for p in lower.indptr], 5)
    rows = _cards([f"{i + 1:14d}" for i in lower.indices], 5)
    values = _cards([f"{v:25.17E}".replace("E", "D") for v in lower.data], 3)
    right = _cards([f"{0.0:25.17E}".replace("E", "D") for _ in range(n)], 3)
    parts = (pointers, rows, values, right)
    header = [
        f"{'matrix':<72}{'key':<8}",
        f"{sum(map(len, parts)):14d}" + "".join(f"{len(part):14d}" for part in parts),
        f"{'RSA':<14}{n:14d}{n:14d}{n_entries:14d}{0:14d}",
        f"{'(5I14)':<16}{'(5I14)':<16}{'(1P,3D25.17)':<20}{'(1P,3D25.17)':<20}",
        f"{'F':<14}{1:14d}{0:14d}",
    ]
    path.write_text("\n".join([*header, *pointers, *rows, *values, *right]) + "\n")


def _cards(fields: Sequence[str], n: int) -> list[str]:
    return ["".join(fields[k : k + n]) for k in range(0, len(fields), n)]


WRITERS = {
    "abaqus.mtx": write_abaqus, "coordinate.mtx": write_coordinates, "market.mtx": write_market,
    "sparse.npz": write_npz, "hbmat.matrix": write_harwell_boeing,
}  # fmt: skip


def write_body(
    folder: Path,
    name: str,
    mesh: SolidMesh,
    stiffness: sp.spmatrix,
    mass: sp.spmatrix,
    kind: str = "abaqus.mtx",
    units: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> str:
    """Write the files of a body in units of so many metres, kilograms and seconds, and return its table in a scene."""
    length, of_mass, time = units
    write_inp(folder / f"{name}.inp", mesh, length)
    WRITERS[kind](folder / f"{name}_k_{kind}", stiffness * (time**2 / of_mass), mesh)
    WRITERS[kind](folder / f"{name}_m_{kind}", mass / of_mass, mesh)
    return f'{{stiffness="{folder}/{name}_k_{kind}", mass="{folder}/{name}_m_{kind}", nodes="{folder}/{name}.inp"}}'
