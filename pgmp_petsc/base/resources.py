"""Resources of the work: time of named phases, and the memory that is free for it."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from time import perf_counter

from pgmp_petsc.base.progress import doing
from pgmp_petsc.base.surroundings import Comm


class Timings:
    """Accumulates time under names, where there may be some already; a phase may be entered any number of times, and
    phases may nest.

    The clock is wall time by default; `time.process_time` is that of this process alone.
    """

    def __init__(self, seconds: Mapping[str, float] | None = None, clock: Callable[[], float] = perf_counter) -> None:
        self._seconds, self._clock = dict(seconds or {}), clock

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the time of the block to phase ``name``, also when the block raises."""
        start = self._clock()
        try:
            with doing(name):
                yield
        finally:
            self._seconds[name] = self._seconds.get(name, 0.0) + self._clock() - start

    def as_dict(self) -> dict[str, float]:
        """Return the seconds of every phase, in the order of their first end."""
        return dict(self._seconds)

    def maximum(self, comm: Comm) -> Timings:
        """Return the maximum over the ranks of every phase that any rank has. Collective on ``comm``."""
        if comm.size == 1:
            return Timings(self._seconds)
        longest: dict[str, float] = {}
        for seconds in comm.allgather(self._seconds):
            for name, value in seconds.items():
                longest[name] = max(value, longest.get(name, 0.0))
        return Timings(longest)

    def table(self) -> str:
        """Return one line a phase, aligned, for printing; an empty string if there is none."""
        width = max((len(name) for name in self._seconds), default=0)
        return "\n".join(f"{name:<{width}}  {seconds:10.3f} s" for name, seconds in self._seconds.items())


MEMINFO = Path("/proc/meminfo")
GROUP = Path("/sys/fs/cgroup")  # where a batch system or a container says what a job may take


def free_share(comm: Comm) -> float | None:
    """Return the free memory of this rank's node over the ranks of `comm` there, bytes; None where the system does not
    tell. Collective on `comm`."""
    n_ranks = 1 if comm.size == 1 else _ranks_of_node(comm)
    free = free_memory()
    return None if free is None else free / n_ranks


def _ranks_of_node(comm: Comm) -> int:
    """Return how many ranks of `comm` are on this rank's node. Collective on `comm`."""
    from mpi4py import MPI

    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    try:
        return node.size
    finally:
        node.Free()


def free_memory() -> float | None:
    """Return what new allocations may take on this machine and within the job's limit, bytes; None if unknown."""
    return min([bound for bound in (_of_machine(), _of_job()) if bound is not None], default=None)


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
