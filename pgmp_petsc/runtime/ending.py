"""The end of a program: its exit status, and what PETSc still holds."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, NoReturn

from pgmp_petsc.runtime.errors import PgmpError
from pgmp_petsc.runtime.petsc import start_mpi

if TYPE_CHECKING:
    from mpi4py import MPI


def release_petsc(comm: MPI.Comm) -> None:
    """Let go of what PETSc still holds on `comm` and on this rank, while Python lives. Collective on `comm`.

    A PETSc object that a cycle of Python references kept is only marked when the cycle is collected, and is
    destroyed with PETSc itself. Python has ended by then, and a time stepper written in Python crashes there.
    That is so with PETSc 3.18, and was not seen with 3.26.
    """
    # a rank whose work failed early may never have loaded PETSc
    if all(comm.allgather("petsc4py.PETSc" in sys.modules)):
        from petsc4py import PETSc

        gc.collect()
        for where in (comm, PETSc.COMM_SELF):
            PETSc.garbage_cleanup(where)


def guarded(work: Callable[[], None]) -> int:
    """Run a program's work and return its exit status; errors of the user's go to stderr."""
    try:
        work()
    except PgmpError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_status
    return 0


def end(status: int) -> NoReturn:
    """Exit from a script of one's own; collective on COMM_WORLD."""
    release_petsc(start_mpi())
    sys.exit(status)
