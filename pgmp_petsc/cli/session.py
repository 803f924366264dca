"""What a command is given besides its options: the ranks, and the options for PETSc."""

from __future__ import annotations

import gc
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mpi4py import MPI


@dataclass(frozen=True)
class Session:
    """One call of ``pgmp``; click's context object (``context.obj``).

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
        All ranks of the run.
    petsc_options : sequence of str
        What stood after ``--`` on the command line.
    """

    comm: MPI.Comm
    petsc_options: Sequence[str] = ()

    def start_petsc(self) -> None:
        """Start PETSc with the user's options; anything that imports PETSc is imported after this."""
        import petsc4py

        petsc4py.init(["pgmp", *self.petsc_options])

    def close(self) -> None:
        """Let go of what PETSc still holds, while Python lives. Collective on all ranks.

        A PETSc object that a cycle of Python references kept is only marked when the cycle is collected, and is
        destroyed with PETSc itself. Python has ended by then, and a time stepper written in Python crashes there.
        """
        from mpi4py import MPI

        # a rank whose command failed early may never have loaded PETSc
        if self.comm.allreduce("petsc4py.PETSc" in sys.modules, op=MPI.LAND):
            from petsc4py import PETSc

            gc.collect()
            PETSc.garbage_cleanup()
