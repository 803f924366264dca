"""A communicator of this process alone, for a Python without MPI."""

from __future__ import annotations

import sys
from typing import Any, NoReturn


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
