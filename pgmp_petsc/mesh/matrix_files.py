"""Sparse matrices from files of other programs, told apart by what is in them: two formats share the ending .mtx.

================== ==================================================================================
format             told by
================== ==================================================================================
Matrix Market      ``%%MatrixMarket`` in its first line
SciPy's npz        it is a zip file
Harwell-Boeing     its third line, such as ``RSA   300   300   4500   0``
Abaqus             lines of five numbers (row's node, direction, column's node, direction, value), formats MATRIX INPUT
                   and LABELS, or of three (row, column, value), format COORDINATE
================== ==================================================================================

Harwell-Boeing files of real, assembled matrices, as Ansys' HBMAT writes them.

Duff, Grimes and Lewis, ACM Trans. Math. Softw. 15, 1989. SciPy's reader takes neither symmetric ones nor right-hand
sides, which are passed over here.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.mesh.reading import MAX_REASON, check_file
from pgmp_petsc.runtime.errors import InputError

ZIP, MATRIX_MARKET, NASTRAN = b"PK\x03\x04", b"%%matrixmarket", "DMIG"
COMMENTS = ("**", "%", "#")
KINDS = "Matrix Market, npz of SciPy, Harwell-Boeing, and Abaqus' formats MATRIX INPUT, LABELS and COORDINATE"
SPARSEST = 1000  # rows to an entry; a stiffness has several entries to a row
HEAD = 4096  # bytes that tell the format


@dataclass(frozen=True, eq=False)
class MatrixFile:
    """A matrix as its file has it.

    Attributes
    ----------
    matrix
        Square, symmetric if the file lists one triangle.
    rows
        Node and direction (from 1) of every row, shape (n, 2); None where the file does not say.
    """

    matrix: sp.csr_matrix
    rows: np.ndarray | None = None


def read_matrix(path: Path, received: str) -> MatrixFile:
    """Read a matrix.

    Parameters
    ----------
    path
        The file.
    received
        The scene's entry and its value, with which messages begin.

    Raises
    ------
    InputError
        If there is no such file, it is of another format, damaged, not square, or has entries that are not finite.
    """
    check_file(path, received, f"a matrix is needed ({KINDS}; paths are relative to the scene's directory)")
    try:
        found = _read(path, received)
    except InputError:
        raise
    except NotTaken as error:
        raise InputError(f"{received}: {error}") from error
    except Exception as error:  # of many kinds, on damaged files
        reason = " ".join(str(error).split())[:MAX_REASON]
        raise InputError(
            f"{received}: this file cannot be read as a matrix ({type(error).__name__}: {reason}); it may be damaged: "
            "write it anew"
        ) from error
    if found.matrix.shape[0] != found.matrix.shape[1] or not found.matrix.shape[0]:
        raise InputError(
            f"{received}: it has {' by '.join(map(str, found.matrix.shape))} entries; a square matrix is needed"
        )
    if np.iscomplexobj(found.matrix):
        raise InputError(f"{received}: its entries are complex; real ones are needed")
    if not np.isfinite(found.matrix.data).all():
        raise InputError(f"{received}: it has entries that are not finite; finite numbers are needed")
    return found


def _read(path: Path, received: str) -> MatrixFile:
    with path.open("rb") as file:
        head = file.read(HEAD)
    if head.startswith(ZIP):
        return MatrixFile(_from_npz(path, received))
    if head.lower().startswith(MATRIX_MARKET):
        return MatrixFile(_from_matrix_market(path))
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    if is_harwell_boeing(lines[:4]):
        return MatrixFile(_whole(read_harwell_boeing(lines)))
    data = [line for line in lines if line.strip() and not line.lstrip().startswith(COMMENTS)]
    if any(line.lstrip().upper().startswith(NASTRAN) for line in data[:20]):
        raise InputError(
            f"{received}: a Nastran file, for which there is no reader here; write its matrices as Matrix Market files "
            f"(pyNastran reads DMIG and OP4). Taken are {KINDS}"
        )
    return _from_abaqus([line for line in data if not line.lstrip().startswith("*")], received)


def _from_npz(path: Path, received: str) -> sp.csr_matrix:
    """Read what ``scipy.sparse.save_npz`` wrote."""
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
        raise InputError(f"{received}: this file is of no format that is known; {KINDS} are")
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
    """Return a matrix from its entries, of which one triangle will do."""
    _check_size(entries)
    matrix = entries.tocsr()
    if (entries.row >= entries.col).all() or (entries.row <= entries.col).all():
        return matrix + matrix.T - sp.diags(matrix.diagonal(), format="csr")
    return matrix


TYPE = re.compile(r"\s*([RCP])([SUHZR])([AE])\s+(\d+)\s+(\d+)\s+(\d+)")
FIELD = re.compile(r"(\d*)\s*[IEDFG]\s*(\d+)", re.IGNORECASE)


class NotTaken(ValueError):
    """A matrix of a kind that no body has; says which."""


def is_harwell_boeing(head: Sequence[str]) -> bool:
    """Return whether the first lines of a file are the header of this format."""
    return len(head) > 3 and TYPE.match(head[2].upper()) is not None and FIELD.search(head[3]) is not None


def read_harwell_boeing(lines: Sequence[str]) -> sp.coo_matrix:
    """Return the entries that a file lists, of a symmetric matrix often one triangle.

    Parameters
    ----------
    lines
        Of the whole file, without line ends.

    Raises
    ------
    NotTaken
        If the matrix is complex, a pattern, skew, or not assembled.
    ValueError
        If the file is damaged.
    """
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
        parts.append(_fields(lines[first : first + n_lines], width))
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


def _fields(lines: Sequence[str], width: int) -> list[str]:
    """Return fields of one width, which need no blanks between them."""
    return [line[at : at + width] for line in lines for at in range(0, len(line.rstrip()), width)]
