"""How much memory is free, and what a process need not hold any more."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mpi4py import MPI

MEMINFO = Path("/proc/meminfo")
GROUP = Path("/sys/fs/cgroup")  # where a batch system or a container says what a job may take


def free_share(comm: MPI.Comm) -> float | None:
    """Return the free memory of this rank's node over the ranks of `comm` there, bytes. Collective on `comm`.

    None where the system does not tell.
    """
    n_ranks = 1 if comm.size == 1 else _ranks_of_node(comm)
    free = free_memory()
    return None if free is None else free / n_ranks


def _ranks_of_node(comm: MPI.Comm) -> int:
    """Return how many ranks of `comm` are on this rank's node. Collective on `comm`."""
    from mpi4py import MPI

    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    try:
        return node.size
    finally:
        node.Free()


def free_memory() -> float | None:
    """Return what new allocations may take on this machine and within the job's limit, bytes; None if unknown."""
    bounds = [bound for bound in (_of_machine(), _of_job()) if bound is not None]
    return min(bounds, default=None)


def give_back() -> None:
    """Return to the system what this process has freed.

    The C library keeps it otherwise: 9 of 16 GB after a body of 700,000 unknowns was condensed.
    """
    with suppress(AttributeError):  # a C library other than GNU's
        ctypes.CDLL(None).malloc_trim(0)


def _of_machine() -> float | None:
    try:
        lines = MEMINFO.read_text(encoding="ascii").splitlines()
        return next(1024.0 * float(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))
    except (OSError, ValueError, StopIteration):
        return None


def _of_job() -> float | None:
    """Return what a control group leaves; its files in memory can be dropped and do not count."""
    try:
        limit, used = (float((GROUP / name).read_text()) for name in ("memory.max", "memory.current"))
        lines = (GROUP / "memory.stat").read_text().splitlines()
        files = sum(float(line.split()[1]) for line in lines if line.startswith(("active_file ", "inactive_file ")))
    except (OSError, ValueError):  # "max" is no number: there is no limit
        return None
    return limit - used + files
