"""Tables of numbers as CSV that users hand over: names in the first line, then a row a line; empty lines have no part.

Commas separate columns. A unit may follow a name, ``time (s)``, as in the tables that this program writes;
another one than that of the column is refused.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping
from typing import TextIO

from pgmp_petsc.runtime.errors import InputError, shortened

WITH_UNIT = re.compile(r"(.*?)\s*\((.*)\)")
#: What other programs put between columns.
OTHERS = {";": "semicolons", "\t": "tabs"}


def csv_table(
    stream: TextIO, where: str, units: Mapping[str, str]
) -> tuple[list[str], Iterator[tuple[int, list[str]]]]:
    """Return the names of the columns, and the rows with the numbers of their lines, read one by one.

    Parameters
    ----------
    stream
        Opened with ``encoding="utf-8-sig", newline=""``.
    where
        How messages name the file.
    units
        By name, the unit of each column that has a part; empty where only SI is known.

    Raises
    ------
    InputError
        If columns are separated otherwise, a column is in another unit, or a row has more or fewer entries.
    """
    rows = csv.reader(stream, skipinitialspace=True)
    first = [name.strip() for name in next(rows, [])]
    for sign, plural in OTHERS.items():
        if len(first) == 1 and sign in first[0]:
            shown = shortened(" ".join(first[0].split()), 60)
            raise InputError(
                f"{where}: columns are separated by {plural} ('{shown}'); commas are needed, and points in numbers"
            )
    names = [_without_unit(name, where, units) for name in first]
    return names, _rows(rows, len(names), where)


def _without_unit(column: str, where: str, units: Mapping[str, str]) -> str:
    """Return the name of a column without its unit, which has to be the one that is asked for."""
    parts = WITH_UNIT.fullmatch(column)
    if column in units or parts is None or parts[1] not in units:
        return column
    name, unit = parts.groups()
    if unit.strip() != units[name]:
        needed = units[name] or "SI units"
        raise InputError(f"{where}: the column '{column}' has to be in {needed}: convert it, and name it '{name}'")
    return name


def _rows(rows: Iterator[list[str]], n_columns: int, where: str) -> Iterator[tuple[int, list[str]]]:
    for row in rows:
        if row and len(row) != n_columns:
            raise InputError(
                f"{where}: line {rows.line_num} has {len(row)} entries; the first line names {n_columns} columns"
            )
        if row:
            yield rows.line_num, row
