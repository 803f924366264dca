"""The ranks that a call runs on, and the start of MPI, PETSc and SLEPc where a program has not started them."""

from __future__ import annotations

import atexit
import logging
from functools import cache
from typing import TYPE_CHECKING

from pgmp_petsc.runtime.ending import release_petsc
from pgmp_petsc.runtime.errors import InputError
from pgmp_petsc.runtime.installed import alone, is_communicator
from pgmp_petsc.runtime.petsc import start_mpi, start_petsc

if TYPE_CHECKING:
    from mpi4py import MPI

    from pgmp_petsc.runtime.remarks import Remark

#: Gets what commands print on the way: what was chosen, and why (level INFO); remarks on results (level WARNING).
LOGGER = logging.getLogger("pgmp_petsc")


def ranks_of(comm: MPI.Comm | None) -> MPI.Comm:
    """Return the ranks of a call: those that are given, else COMM_WORLD where it has several, else COMM_SELF.

    Raises
    ------
    InputError
        If it is no communicator of mpi4py.
    """
    world = start_mpi()
    if comm is None:
        return world if world.size > 1 else alone()
    if not is_communicator(comm):
        raise InputError(f"comm = {comm!r}: allowed is a communicator of mpi4py, such as MPI.COMM_WORLD")
    return comm


def solving_ranks_of(comm: MPI.Comm | None) -> MPI.Comm:
    """Return the same, with PETSc and SLEPc started where they are installed.

    The first such call of a program is collective on COMM_WORLD.
    """
    own = ranks_of(comm)
    _start()
    return own


@cache
def _start() -> None:
    """Start PETSc once; a program that did so itself has given its own options."""
    start_petsc()
    atexit.register(release_petsc, start_mpi())


def tell(comm: MPI.Comm, text: str) -> None:
    """Log what a command would print, on the first rank; not collective."""
    if comm.rank == 0 and text:
        LOGGER.info(text)


def tell_remarks(comm: MPI.Comm, remarks: tuple[Remark, ...]) -> None:
    """Log the remarks on a result on the first rank: warnings are seen unless a program says otherwise."""
    if comm.rank == 0:
        for remark in remarks:
            LOGGER.log(logging.WARNING if remark.kind == "warning" else logging.INFO, "%s", remark)
