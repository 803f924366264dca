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
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.mesh.harwell_boeing import NotTaken, is_harwell_boeing, read_harwell_boeing
from pgmp_petsc.mesh.reading import MAX_REASON, check_file
from pgmp_petsc.runtime.errors import InputError

ZIP, MATRIX_MARKET, NASTRAN = b"PK\x03\x04", b"%%matrixmarket", "DMIG"
COMMENTS = ("**", "%", "#")
KINDS = "Matrix Market, npz of SciPy, Harwell-Boeing, and Abaqus' formats MATRIX INPUT, LABELS and COORDINATE"
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
        from scipy.io import mmread

        return MatrixFile(sp.csr_matrix(mmread(path), dtype=None))
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
    with zipfile.ZipFile(path) as archive:
        names = [name.removesuffix(".npy") for name in archive.namelist()]
    if "format" not in names:
        raise InputError(
            f"{received}: an npz file with the arrays {', '.join(names)}; what scipy.sparse.save_npz writes is needed"
        )
    return sp.csr_matrix(sp.load_npz(path))


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
    matrix = entries.tocsr()
    if (entries.row >= entries.col).all() or (entries.row <= entries.col).all():
        return matrix + matrix.T - sp.diags(matrix.diagonal(), format="csr")
    return matrix
