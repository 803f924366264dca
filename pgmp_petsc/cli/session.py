"""What a command is given besides its options: the ranks, and the options for PETSc."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pgmp_petsc.runtime.petsc import start_petsc

if TYPE_CHECKING:
    from mpi4py import MPI


@dataclass
class Session:
    """One call of ``pgmp``; click's context object (``context.obj``).

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
        All ranks of the run.
    petsc_options : sequence of str
        What stood after ``--`` on the command line.
    quiet : bool
        Whether `cli.report.say` prints nothing.
    json : bool
        Whether the command prints its figures as JSON, and nothing else.

    Attributes
    ----------
    petsc_started : bool
        Whether PETSc was started for the command.
    """

    comm: MPI.Comm
    petsc_options: Sequence[str] = ()
    quiet: bool = False
    json: bool = False
    petsc_started: bool = field(default=False, init=False)

    def start_petsc(self) -> None:
        """Start PETSc with the user's options; anything that imports PETSc is imported after this."""
        start_petsc(self.petsc_options)
        self.petsc_started = True
