"""Harwell-Boeing files of real, assembled matrices, as Ansys' HBMAT writes them.

Duff, Grimes and Lewis, ACM Trans. Math. Softw. 15, 1989. SciPy's reader takes neither symmetric ones nor right-hand
sides, which are passed over here.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

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
