"""What this Python has of MPI, PETSc and SLEPc, and what is said where one of them is needed and absent.

Reduced models run without them: this process alone is then the communicator (`runtime.one_rank`), and a plain loop
drives the integration (`dynamics.drivers`). docs/without_petsc.md says what works so.

A communicator of this process alone, for a Python without MPI.
"""

from __future__ import annotations

import os
import sys
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, NoReturn

from pgmp_petsc.runtime.errors import InputError

if TYPE_CHECKING:
    from mpi4py import MPI


OF_PETSC = ("petsc4py", "slepc4py", "mpi4py")  # PETSc is handed communicators of mpi4py
CURE = "a ROM.h5 built where they are runs here; scripts/setup of the sources installs them (docs/without_petsc.md)"
#: What programs that start several processes tell each of how many there are, and which it is.
SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MPI_LOCALNRANKS")
NUMBERS = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "MPI_LOCALRANKID")


def missing() -> tuple[str, ...]:
    """Return which packages of `OF_PETSC` this Python does not have."""
    return tuple(name for name in OF_PETSC if not _is_there(name))


def has_petsc() -> bool:
    """Return whether PETSc and SLEPc are there, with MPI."""
    return not missing()


def has_mpi() -> bool:
    """Return whether mpi4py is there."""
    return _is_there("mpi4py")


def needs_petsc(what: str) -> None:
    """Refuse what cannot be done without PETSc, where it is absent.

    Parameters
    ----------
    what
        The subject of the message, in the plural: "eigenproblems of continuum bodies".

    Raises
    ------
    InputError
        Naming the packages that are missing; the same on all ranks.
    """
    absent = missing()
    if absent:
        raise InputError(f"{what} need PETSc and SLEPc, and this Python has no {', '.join(absent)}; {CURE}")


def alone() -> MPI.Comm:
    """Return the communicator of this process alone."""
    if not has_mpi():
        return OneRank()
    from mpi4py import MPI

    return MPI.COMM_SELF


def is_communicator(value: object) -> bool:
    """Return whether a value is what a call may run on."""
    if not has_mpi():
        return isinstance(value, OneRank)
    from mpi4py import MPI

    return isinstance(value, MPI.Intracomm) and value != MPI.COMM_NULL


def refuse_ranks() -> None:
    """Refuse to be one of several processes without mpi4py: each would do the whole work, and write the same files.

    Raises
    ------
    InputError
        Whose message is empty but on the first of them.
    """
    started = next((int(os.environ[name]) for name in SIZES if os.environ.get(name, "").isdecimal()), 1)
    if started > 1:
        first = next((os.environ[name] for name in NUMBERS if name in os.environ), "0") == "0"
        said = f"{started} processes were started together, and this Python has no mpi4py, so that none knows of the "
        raise InputError(said + "others; start one, or install mpi4py" if first else "")


@cache
def _is_there(name: str) -> bool:
    """Return whether a package can be found, without importing it: MPI and PETSc start when they are imported."""
    try:
        return find_spec(name) is not None
    except (ImportError, ValueError):
        return False


class OneRank:
    """What programs here ask of a communicator of mpi4py, with one rank; nothing is sent, and nothing waits.

    What several ranks alone do (messages between ranks, reductions with an operation of MPI) is not here: it is asked
    for where ``size`` is larger than 1.

    Attributes
    ----------
    rank, size
        0 and 1.
    """

    rank, size = 0, 1

    def Dup(self) -> OneRank:  # noqa: N802 (MPI's name, as are the others)
        """Return another communicator of the same rank."""
        return OneRank()

    def Split(self, color: int = 0, key: int = 0) -> OneRank:  # noqa: N802
        """Return the communicator of this rank's color."""
        return OneRank()

    def Free(self) -> None:  # noqa: N802
        """Give nothing back: nothing is held."""

    def Abort(self, errorcode: int = 0) -> NoReturn:  # noqa: N802
        """End the process."""
        sys.exit(errorcode)

    def bcast(self, obj: Any, root: int = 0) -> Any:
        """Return what the root has."""
        return obj

    def gather(self, sendobj: Any, root: int = 0) -> list[Any]:
        """Return what all ranks have."""
        return [sendobj]

    def allgather(self, sendobj: Any) -> list[Any]:
        """Return what all ranks have."""
        return [sendobj]

    def allreduce(self, sendobj: Any, op: object = None) -> Any:
        """Return the sum, or another reduction, over all ranks."""
        return sendobj
