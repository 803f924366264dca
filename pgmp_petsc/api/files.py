"""Result files that a program reads."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pgmp_petsc.api.declared import Argument, interface
from pgmp_petsc.api.ranks import ranks_of, solving_ranks_of
from pgmp_petsc.api.result import Result, Rom, in_memory
from pgmp_petsc.runtime.agreement import on_root

if TYPE_CHECKING:
    from mpi4py import MPI


@interface(path=Argument("File of a result of any kind but a shard."))
def read(path: str | PathLike[str], *, comm: MPI.Comm | None = None) -> Result:
    """Read a result file: a `Rom`, or a `Result`; raises `InputError` if it is no whole result of this program."""
    comm, path = ranks_of(comm), Path(path)
    kind = on_root(comm, _kind_of, path)
    if kind == "rom":
        # its modules need PETSc, which all ranks start together
        solving_ranks_of(comm)
    data = on_root(comm, _read, path, kind)
    return (Rom if kind == "rom" else Result)(kind, data, comm, path.parent, path)


def stopped_runs(*paths: Path) -> list[str]:
    """Return a line for every file that holds only a part of a run, saying why; by one process."""
    from pgmp_petsc.runtime.files import KINDS, RunRecord, open_file

    lines = []
    for path in paths:
        with open_file(path, KINDS) as file:
            if file.attrs.get("status", 0):
                lines += [f"{path}: {remark}" for remark in RunRecord.read(file).remarks[:1]]
    return lines


def _kind_of(path: Path) -> str:
    from pgmp_petsc.results.readers import READERS
    from pgmp_petsc.runtime.files import open_file

    with open_file(path, ("rom", *READERS)) as file:
        return str(file.attrs["kind"])


def _read(path: Path, kind: str) -> Any:
    if kind != "rom":
        from pgmp_petsc.results.readers import READERS

        return in_memory(READERS[kind].read(path))
    from pgmp_petsc.studies.building import Built

    return Built.read(path)
