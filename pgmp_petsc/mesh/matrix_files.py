"""Sparse matrices and nodes of bodies from files of other programs (docs/matrices.md, files of matrices; files of
nodes). Formats are told apart by contents: two share the ending .mtx.

A Harwell-Boeing file (Duff, Grimes and Lewis, ACM Trans. Math. Softw. 15, 1989) is known by its third line, such as
``RSA   300   300   4500   0``. SciPy's reader takes neither symmetric ones nor right-hand sides, which are passed over
here.

The node and the direction that a row of a matrix is of are known from the matrix' own file, from a list beside it, or
by counting. Of nodes a file has their places, their numbers, and sets of them.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
import scipy.sparse as sp

from pgmp_petsc.base.errors import InputError, shortened
from pgmp_petsc.mesh.meshes import SolidMesh
from pgmp_petsc.mesh.reading import ABAQUS, check_file, coordinates, made_by, read_abaqus, read_mesh, usable
from pgmp_petsc.mesh.solid_mesh_reading import KINDS, complete_physical_groups, numbered_as_filed

ZIP, MATRIX_MARKET, NASTRAN = b"PK\x03\x04", b"%%matrixmarket", "DMIG"
COMMENTS = ("**", "%", "#")
FORMATS = (
    "Matrix Market, npz of SciPy, Harwell-Boeing, Abaqus' formats MATRIX INPUT, LABELS and COORDINATE, CalculiX' .sti "
    "and .mas, Nastran's DMIG, .op2 and .op4, and Ansys' .full"
)
PROGRAM = Path(__file__).with_name("read_by_library.py")
LONGEST = 600.0  # s that a library may take
#: Formats that libraries read, by the endings of files of matrices and of nodes.
OF_ENDING = {".op2": "op2", ".op4": "op4", ".full": "full"}
DECKS = {".bdf": "deck", ".nas": "deck", ".fem": "deck", ".cdb": "cdb"}
SPARSEST = 1000  # rows to an entry; a stiffness has several entries to a row
HEAD = 4096  # bytes that tell the format


@dataclass(frozen=True, eq=False)
class MatrixFile:
    """A matrix as its file has it."""

    matrix: sp.csr_matrix  # square, symmetric if the file lists one triangle
    #: node and direction (from 1) of every row, shape (n, 2); None where the file does not say
    rows: np.ndarray | None = None


def read_matrix(path: Path, received: str, kind: str = "stiffness") -> MatrixFile:
    """Read a matrix; messages begin with `received`, the scene's entry and its value. Of a file that holds several it
    is that of `kind`, ``"stiffness"``, ``"mass"`` or ``"modes"``, which need not be square. Raises `InputError` if
    there is no such file, it is of another format, damaged, not square, or has entries that are not finite."""
    check_file(path, received, f"a matrix is needed ({FORMATS}; paths are relative to the scene's directory)")
    with usable(received, "this file cannot be read as a matrix"):
        try:
            found = _read(path, received, kind)
        except NotTaken as error:
            raise InputError(f"{received}: {error}") from error
    if kind != "modes" and found.matrix.shape[0] != found.matrix.shape[1] or not found.matrix.shape[0]:
        raise InputError(
            f"{received}: it has {' by '.join(map(str, found.matrix.shape))} entries; a square matrix is needed"
        )
    if np.iscomplexobj(found.matrix):
        raise InputError(f"{received}: its entries are complex; real ones are needed")
    if not np.isfinite(found.matrix.data).all():
        raise InputError(f"{received}: it has entries that are not finite; finite numbers are needed")
    return found


def _read(path: Path, received: str, kind: str) -> MatrixFile:
    ending = path.suffix.lower()
    if ending in OF_ENDING:
        return _by_library(OF_ENDING[ending], kind, path)
    with path.open("rb") as file:
        head = file.read(HEAD)
    if head.startswith(ZIP):
        return MatrixFile(_from_npz(path, received))
    if head.lower().startswith(MATRIX_MARKET):
        return MatrixFile(_from_matrix_market(path))
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    if len(lines) > 3 and TYPE.match(lines[2].upper()) and FIELD.search(lines[3]):
        return MatrixFile(_whole(read_harwell_boeing(lines)))
    data = [line for line in lines if line.strip() and not line.lstrip().startswith(COMMENTS)]
    if any(line.lstrip().upper().startswith(NASTRAN) for line in data[:20]):
        return _by_library("dmig", kind, path)
    return _from_abaqus([line for line in data if not line.lstrip().startswith("*")], received)


def _by_library(form: str, kind: str, path: Path) -> MatrixFile:
    """Read what a library reads, in a process of its own."""
    found = made_by(PROGRAM, (form, kind, path.resolve()), LONGEST)
    if isinstance(found, str):
        raise NotTaken(found)
    entries = sp.coo_matrix((found["value"], (found["row"], found["column"])), shape=tuple(found["size"]))
    return MatrixFile(_whole(entries), found.get("rows"))


def _from_npz(path: Path, received: str) -> sp.csr_matrix:
    with np.load(path, allow_pickle=False) as file:
        if "format" not in file:
            names = ", ".join(file.files)
            raise InputError(
                f"{received}: an npz file with the arrays {names}; what scipy.sparse.save_npz writes is needed"
            )
        for name in ("row", "col"):  # SciPy would cut them to 32 bits
            if name in file and file[name].max(initial=0) >= max(file["shape"]):
                raise ValueError(f"{name} numbers beyond its sizes")
    matrix = sp.load_npz(path)
    if hasattr(matrix, "check_format"):  # what has pointers; SciPy looks at them when asked, and reads anywhere else
        matrix.check_format(full_check=True)
    _check_size(matrix)
    return sp.csr_matrix(matrix)


def _from_matrix_market(path: Path) -> sp.csr_matrix:
    """Read what SciPy's reader takes, which never ends where a file ends before the line of its sizes."""
    from scipy.io import mmread

    with path.open("rb") as file:
        if not any(line.strip() and not line.startswith(b"%") for line in file):
            raise ValueError("it ends before the line of its sizes")
    matrix = mmread(path)
    _check_size(matrix)
    return sp.csr_matrix(matrix)


def _check_size(matrix: sp.spmatrix | np.ndarray) -> None:
    """Refuse more rows or columns than memory may hold that entries are spread over: a damaged size, or number."""
    n = matrix.nnz if sp.issparse(matrix) else matrix.size
    if max(matrix.shape) > SPARSEST * (n + 1):
        raise ValueError(f"{' by '.join(map(str, matrix.shape))} are its sizes, and it has {n} entries")


def _from_abaqus(lines: list[str], received: str) -> MatrixFile:
    """Read lines of three or five numbers."""
    count = len(lines[0].replace(",", " ").split()) if lines else 0
    if count not in (3, 5):
        raise InputError(
            f"{received}: this file has no matrix in a format that is known; {FORMATS} are. A deck of nodes and "
            "elements has none: the program that solves it writes them (docs/matrices.md)"
        )
    text = "\n".join(lines).replace(",", " ").upper().replace("D", "E")  # Fortran's exponents
    numbers = np.loadtxt(io.StringIO(text), ndmin=2, comments=None)
    places, values = numbers[:, :-1].astype(np.int64), numbers[:, -1]
    if (places != numbers[:, :-1]).any():
        raise InputError(f"{received}: its nodes, directions, rows or columns are no whole numbers; it may be damaged")
    if count == 3:
        if places.min() < 1:
            raise InputError(f"{received}: rows and columns count from 1, but it has {places.min()}")
        size = int(places.max())
        return MatrixFile(_whole(sp.coo_matrix((values, tuple(places.T - 1)), shape=(size, size))))
    nodes, directions = places[:, ::2].ravel(), places[:, 1::2].ravel()
    base = int(np.abs(directions).max()) + 1  # one number for both, which is quicker to sort than pairs
    keys, numbered = np.unique(nodes * base + directions, return_inverse=True)
    labels = np.column_stack(np.divmod(keys, base))
    row, column = numbered.reshape(-1, 2).T
    return MatrixFile(_whole(sp.coo_matrix((values, (row, column)), shape=(len(labels),) * 2)), labels)


def _whole(entries: sp.coo_matrix) -> sp.csr_matrix:
    _check_size(entries)
    matrix = entries.tocsr()
    if matrix.shape[0] != matrix.shape[1]:
        return matrix
    if (entries.row >= entries.col).all() or (entries.row <= entries.col).all():
        return matrix + matrix.T - sp.diags(matrix.diagonal(), format="csr")
    return matrix


TYPE = re.compile(r"\s*([RCP])([SUHZR])([AE])\s+(\d+)\s+(\d+)\s+(\d+)")
FIELD = re.compile(r"(\d*)\s*[IEDFG]\s*(\d+)", re.IGNORECASE)


class NotTaken(ValueError):
    """A matrix of a kind that no body has; says which."""


def read_harwell_boeing(lines: Sequence[str]) -> sp.coo_matrix:
    """Return the entries that the lines of a file list, of a symmetric matrix often one triangle. Raises `NotTaken` if
    the matrix is complex, a pattern, skew, or not assembled; `ValueError` if the file is damaged."""
    cards = [int(lines[1][start : start + 14] or 0) for start in (14, 28, 42)]  # of pointers, indices and values
    n_right_hand = int(lines[1][56:70].strip() or 0)
    value_type, structure, storage, *counts = TYPE.match(lines[2].upper()).groups()
    n_rows, n_columns, n_entries = map(int, counts)
    if value_type != "R" or structure not in "SU" or storage != "A":
        raise NotTaken(
            f"a matrix of the type {value_type}{structure}{storage}; real assembled ones, RSA or RUA, are taken"
        )
    widths = [int(width) for _, width in FIELD.findall(re.sub(r"\d*P\s*,?", "", lines[3], flags=re.IGNORECASE))]
    first, parts = 5 if n_right_hand else 4, []
    for n_lines, width in zip(cards, widths[:3]):
        of_part = lines[first : first + n_lines]
        parts.append([line[at : at + width] for line in of_part for at in range(0, len(line.rstrip()), width)])
        first += n_lines
    pointers, rows = (np.array(part, dtype=np.int64) - 1 for part in parts[:2])
    values = np.array([text.upper().replace("D", "E") for text in parts[2]], dtype=float)
    if pointers.size != n_columns + 1 or rows.size != n_entries or values.size != n_entries:
        raise ValueError(
            f"{n_columns + 1} pointers and {n_entries} entries are announced, {pointers.size}, {rows.size} and "
            f"{values.size} are there"
        )
    columns = np.repeat(np.arange(n_columns), np.diff(pointers))
    return sp.coo_matrix((values, (rows, columns)), shape=(n_rows, n_columns))


NODE_AND_DIRECTION = re.compile(r"\d+\.[1-6]")  # a line of CalculiX' list of rows
DIRECTIONS = {"UX": 1, "UY": 2, "UZ": 3, "ROTX": 4, "ROTY": 5, "ROTZ": 6}
SHOWN = 3
TURNING = (
    "rotations of nodes; bodies have displacements of nodes alone: write the matrices of solid elements, or mesh the "
    "body here"
)


def read_rows(path: Path, received: str) -> np.ndarray:
    """Return node and direction of every row, shape (n, 2), int.

    Lines have a row's number from 1, its node and its direction (1, 2, 3 or UX, UY, UZ), such as those of Ansys'
    ``.mapping``, or node and direction as ``12.3`` alone, row after row, as CalculiX' ``.dof``; lines that do not begin
    with a number are passed over. Raises `InputError` if there is no such file, a line is none of the kind, or rows are
    missing or there twice.
    """
    check_file(path, received, "a list of rows is needed (row, node, direction)")
    found, lines = {}, path.read_text(encoding="utf-8", errors="replace").splitlines()
    if any(NODE_AND_DIRECTION.fullmatch(line.strip()) for line in lines[:HEAD]):
        lines = [f"{n} {line.replace('.', ' ')}" for n, line in enumerate(filter(None, map(str.strip, lines)), 1)]
    for number, line in enumerate(lines, 1):
        words = line.replace(",", " ").split()
        if not words or not words[0].isdecimal():
            continue
        direction = DIRECTIONS.get(words[2].upper(), words[2]) if len(words) > 2 else ""
        if len(words) < 3 or not words[1].isdecimal() or not str(direction).isdecimal():
            raise InputError(
                f"{received}: line {number} is '{shortened(line.strip(), 60)}'; a row's number, its node, and its "
                "direction (1, 2, 3 or UX, UY, UZ) are needed"
            )
        if int(words[0]) in found:
            raise InputError(f"{received}: row {words[0]} is there twice, again in line {number}")
        found[int(words[0])] = (int(words[1]), int(direction))
    if not found or sorted(found) != list(range(1, len(found) + 1)):
        missing = next((n for n in range(1, len(found) + 1) if n not in found), 1)
        raise InputError(f"{received}: row {missing} is not in it; a line for every row from 1 on is needed")
    return np.array([found[row] for row in range(1, len(found) + 1)])


def in_order_of_nodes(
    file: MatrixFile, rows: np.ndarray | None, nodes: NodeFile, received: str, of_nodes: str
) -> sp.coo_matrix:
    """Return a matrix with its rows node after node, shape (d n_nodes, d n_nodes).

    `rows` are those of `read_rows`, None where there is no such list; `received` and `of_nodes` the scene's entries of
    the matrix and of the nodes, with their values. Raises `InputError` if the matrix has another size, or rows of nodes
    that are not there, of internal nodes, or of rotations.
    """
    entries, d = file.matrix.tocoo(), nodes.nodes.shape[1]
    size, wanted = entries.shape[0], d * len(nodes.nodes)
    rows = file.rows if file.rows is not None else rows
    if rows is None and d == 3 and size == 2 * wanted:  # Nastran's, six to a node; those of solids have no rotations
        turning = np.arange(size) % 6 > 2
        if not (turning[entries.row] & (entries.data != 0.0)).any():
            keep = ~(turning[entries.row] | turning[entries.col])
            row, column = (3 * (at // 6) + at % 6 for at in (entries.row[keep], entries.col[keep]))
            return sp.coo_matrix((entries.data[keep], (row, column)), shape=(wanted, wanted))
    if rows is None:
        if size != wanted:
            raise InputError(_wrong_size(size, len(nodes.nodes), d, received, of_nodes))
        return entries
    if len(rows) != size:
        raise InputError(f"{received}: it has {size} rows, and the list of rows has {len(rows)}")
    _check(rows, nodes, d, received, of_nodes)
    at = d * nodes.places_of(rows[:, 0]) + rows[:, 1] - 1
    if np.unique(at).size < at.size:
        node, direction = rows[np.flatnonzero(np.bincount(at)[at] > 1)[0]]
        raise InputError(f"{received}: node {node}, direction {direction} has two rows")
    return sp.coo_matrix((entries.data, (at[entries.row], at[entries.col])), shape=(wanted, wanted))


def _check(rows: np.ndarray, nodes: NodeFile, d: int, received: str, of_nodes: str) -> None:
    of, directions = rows.T
    for wrong, words in (
        (of < 1, "{n} rows are of internal nodes, such as {node} (of incompatible modes, multipliers or couplings), "
         "which have no place; write the matrices without what makes them"),
        (directions == 0, "{n} rows are of scalar points, such as {node}, as the modal amplitudes of a Craig-Bampton "
         "reduction are; inertia forces of large rotations need the fields behind these: write the matrices of all "
         "nodes, or add `modes`"),
        (directions > 3, f"{{n}} rows, the first of node {{node}}, direction {{direction}}, are of {TURNING}"),
        ((directions > d) | (directions < 1),
         f"a row of node {{node}} has the direction {{direction}}; those of a solid{d}d body are 1 to {d}"),
    ):  # fmt: skip
        if wrong.any():
            node, direction = rows[wrong][0]
            raise InputError(f"{received}: {words.format(n=wrong.sum(), node=node, direction=direction)}")
    lost = np.unique(of[nodes.places_of(of) < 0])
    if lost.size:
        raise InputError(
            f"{received}: it has rows of {lost.size} nodes that {of_nodes} does not hold, the first are "
            f"{', '.join(map(str, lost[:SHOWN]))}; matrices and nodes must be of the same body"
        )


def _wrong_size(size: int, n_nodes: int, d: int, received: str, of_nodes: str) -> str:
    """Return what to say of a matrix of another size than the nodes."""
    text = f"{received}: {size} by {size} entries, but {n_nodes} nodes ({of_nodes}) have {d * n_nodes} displacements"
    if size in (6 * n_nodes, 3 * n_nodes) and d < 3 or size == 6 * n_nodes:
        return f"{text}: {size // n_nodes} unknowns a node look like those of space, or like {TURNING}"
    return f"{text}; matrices and nodes must be of the same body, all of its nodes and no others, without constraints"


NEEDED = "a file of nodes is needed: a mesh, .csv with the columns node, x, y(, z), or .npz with the array nodes"


@dataclass(frozen=True, eq=False)
class NodeFile:
    """Nodes in the order of their file."""

    nodes: np.ndarray  # shape (n, d), in the file's unit
    labels: np.ndarray  # the file's numbers of them, shape (n,)
    sets: dict[str, np.ndarray]  # places in `nodes` of the nodes of every set, by name, shape (n_set,)
    #: cells and groups of faces; None where the file has no cells that bodies may be meshed with
    mesh: SolidMesh | None = None

    def places_of(self, labels: np.ndarray) -> np.ndarray:
        """Return where nodes are by their numbers; -1 for those that are not there."""
        order = np.argsort(self.labels)
        at = np.minimum(np.searchsorted(self.labels, labels, sorter=order), len(order) - 1)
        return np.where(self.labels[order[at]] == labels, order[at], -1)


def read_nodes(path: Path, dimension: int, received: str) -> NodeFile:
    """Read nodes from a mesh, or a file ending in .csv or .npz, in the plane z = 0 (2) or in space (3). Raises
    `InputError` if the file is missing or unreadable, nodes have one number, are not finite, or off the plane; or if
    its mesh is not sound. Messages begin with `received`."""
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
    if rows and not re.match(r"[-+.\d]", rows[0][0]):
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
    if path.suffix.lower() in DECKS:
        mesh, labels = _of_deck(path, received)
    elif path.suffix.lower() == ABAQUS:
        with usable(received):
            mesh, labels, unknown = read_abaqus(path, received)
        if unknown:  # cells beside ones of no known type would not be all of the body
            mesh.cells = []
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


def _of_deck(path: Path, received: str) -> tuple[meshio.Mesh, np.ndarray]:
    """Return nodes, sets and cells of a deck that a library reads, and the numbers of the nodes."""
    found = made_by(PROGRAM, (DECKS[path.suffix.lower()], "nodes", path.resolve()), LONGEST)
    if isinstance(found, str):
        raise InputError(f"{received}: {found}")
    labels = found["labels"].astype(np.int64)
    nodes = NodeFile(found["nodes"], labels, {})
    places = {name: nodes.places_of(own) for name, own in found.items() if name.startswith(("set:", "cells:"))}
    lost = [name for name, own in places.items() if (own < 0).any()]
    if lost:
        kind, _, name = lost[0].partition(":")
        raise InputError(f"{received}: the {kind.rstrip('s')} {name} has a node that the file does not hold")
    cells = [(name[6:], own) for name, own in places.items() if name.startswith("cells:")]
    sets = {name[4:]: own for name, own in places.items() if name.startswith("set:")}
    return meshio.Mesh(nodes.nodes, cells, point_sets=sets), labels
