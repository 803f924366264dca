"""Wall time, or processor time, of named phases."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter
from typing import TYPE_CHECKING

from pgmp_petsc.runtime.progress import doing

if TYPE_CHECKING:
    from mpi4py import MPI


class Timings:
    """Accumulates time under names; a phase may be entered any number of times, and phases may nest.

    Parameters
    ----------
    seconds
        What there is already.
    clock
        Wall time by default; `time.process_time` is that of this process alone.
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

    def maximum(self, comm: MPI.Comm) -> Timings:
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
