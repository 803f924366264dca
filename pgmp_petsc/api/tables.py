"""Results of a program for ParaView, and as tables."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from pgmp_petsc.api.arguments import checked
from pgmp_petsc.api.files import stopped_runs
from pgmp_petsc.api.ranks import ranks_of, tell
from pgmp_petsc.api.result import Result, file_of
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.claims import KINDS, TABLE, TABULAR, check_output, is_table, named
from pgmp_petsc.runtime.errors import InputError

if TYPE_CHECKING:
    from mpi4py import MPI


@checked
def export_result(
    result: Result | str | PathLike[str], output: str | PathLike[str], *, comm: MPI.Comm | None = None
) -> Path:
    """Write a trajectory's frames as XDMF, or a result's columns as CSV, and return where; as ``pgmp export``.

    Collective on `comm`.

    Parameters
    ----------
    result
        A result, or its file. An XDMF file refers to the trajectory's file and copies nothing: keep the two together.
    output
        ``NAME.xdmf``, ``NAME.xmf`` or ``NAME.csv``.

    Raises
    ------
    InputError
        If the result has no frames, or no rows and columns, or cannot be written there.
    RunError
        If the system fails to write.
    """
    comm = ranks_of(comm)
    with agreed(comm, "looking at the arguments"):
        file = file_of(result)
    target = Path(output)
    if is_table(target):
        rows, columns = on_root(comm, _write_table, file, target)
        tell(comm, f"{target}: {rows} rows, {columns} columns, with their units in the first line")
        return target
    n_frames = on_root(comm, _write_frames, file, target)
    tell(comm, f"{target}: {n_frames} frames, stored in {file}")
    for line in on_root(comm, _what_lacks, file):
        tell(comm, line)
    return target


def _write_frames(file: Path, output: Path) -> int:
    """Describe the frames of a trajectory for ParaView; return their number. By one process."""
    from pgmp_petsc.export.xdmf import write_xdmf
    from pgmp_petsc.runtime.files import open_file

    with open_file(file, KINDS) as opened:
        kind = str(opened.attrs["kind"])
    if kind != "trajectory":
        name = output.with_suffix(".csv") if output.name else "NAME.csv"
        table = f"; a table of it is written as -o {name}" if kind in TABULAR else ""
        raise InputError(f"output '{output}': {named(kind)} ('{file}') has no frames, a trajectory has{table}")
    return write_xdmf(file, output)


def _write_table(file: Path, output: Path) -> tuple[int, int]:
    """Write the columns of a result; return the numbers of rows and columns. By one process."""
    from pgmp_petsc.results.readers import READERS
    from pgmp_petsc.results.tables import columns_of, write_result
    from pgmp_petsc.runtime.files import open_file

    with open_file(file, KINDS) as opened:
        kind = str(opened.attrs["kind"])
    if kind not in TABULAR:
        known = ", ".join(named(one) for one in TABULAR)
        raise InputError(
            f"output '{output}': {named(kind)} ('{file}') has no rows and columns; a table can be made of {known}; "
            f"'pgmp info {file} --json' has its figures"
        )
    result = READERS[kind].read(file)
    check_output(output, TABLE, (file,))
    write_result(result, output)
    columns = columns_of(result)
    return len(next(iter(columns.values()))[1]), len(columns)


def _what_lacks(file: Path) -> list[str]:
    """Return what the stresses of a reduced run lack, and why a run stopped early; by one process."""
    from pgmp_petsc.results.body_fields import GROUP, truncated
    from pgmp_petsc.runtime.files import open_file

    with open_file(file, "trajectory") as opened:
        reduced, scene = str(opened.attrs["model"]) == "reduced", str(opened.attrs["scene"])
        lacking = truncated(scene) if reduced and GROUP in opened else ""
    return [f"  note: {lacking}"] * bool(lacking) + stopped_runs(file)
