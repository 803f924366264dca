"""Which node and direction a row of a matrix is of: from the matrix' own file, from a list beside it, or by counting.

Rows that no file tells of are taken node after node in the order of the nodes' file, x, y (and z) of each.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.mesh.matrix_files import MatrixFile
from pgmp_petsc.mesh.node_file import NodeFile
from pgmp_petsc.mesh.reading import check_file
from pgmp_petsc.runtime.errors import InputError, shortened

DIRECTIONS = {"UX": 1, "UY": 2, "UZ": 3, "ROTX": 4, "ROTY": 5, "ROTZ": 6}
SHOWN = 3
TURNING = (
    "rotations of nodes; bodies have displacements of nodes alone: write the matrices of solid elements, or mesh the "
    "body here"
)


def read_rows(path: Path, received: str) -> np.ndarray:
    """Read lines of a row's number from 1, its node and its direction (1, 2, 3 or UX, UY, UZ), such as those of Ansys'
    ``.mapping``; lines that do not begin with a number are passed over.

    Returns
    -------
    ndarray of int, shape (n, 2)
        Node and direction of every row.

    Raises
    ------
    InputError
        If there is no such file, a line is none of the kind, or rows are missing or there twice.
    """
    check_file(path, received, "a list of rows is needed (row, node, direction)")
    found = {}
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
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

    Parameters
    ----------
    file
        The matrix.
    rows
        From `read_rows`; None where there is no such list.
    nodes
        All nodes of the body.
    received, of_nodes
        The scene's entries of the matrix and of the nodes, and their values.

    Raises
    ------
    InputError
        If the matrix has another size, or rows of nodes that are not there, of internal nodes, or of rotations.
    """
    entries, d = file.matrix.tocoo(), nodes.nodes.shape[1]
    size, wanted = entries.shape[0], d * len(nodes.nodes)
    rows = file.rows if file.rows is not None else rows
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
    """Refuse rows that are not of displacements of the nodes."""
    internal, turning, across = rows[:, 0] < 1, rows[:, 1] > 3, rows[:, 1] > d
    if internal.any():
        raise InputError(
            f"{received}: {internal.sum()} rows are of internal nodes, such as {rows[internal][0, 0]} (of incompatible "
            "modes, multipliers or couplings), which have no place; write the matrices without what makes them"
        )
    if turning.any():
        node, direction = rows[turning][0]
        raise InputError(
            f"{received}: {turning.sum()} rows, the first of node {node}, direction {direction}, are of {TURNING}"
        )
    if across.any() or (rows[:, 1] < 1).any():
        node, direction = rows[across | (rows[:, 1] < 1)][0]
        raise InputError(
            f"{received}: a row of node {node} has the direction {direction}; those of a solid{d}d body are 1 to {d}"
        )
    lost = np.unique(rows[nodes.places_of(rows[:, 0]) < 0, 0])
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
