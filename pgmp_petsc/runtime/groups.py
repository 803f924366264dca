"""Groups of ranks that each work on one configuration at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.runtime.errors import InputError

if TYPE_CHECKING:
    from mpi4py import MPI


UNKNOWNS_PER_RANK = 3000  # of a run that is shared by ranks


@dataclass(frozen=True)
class RankGroup:
    """This rank's place among groups of ranks; in a ``with`` block, which frees the groups' communicators.

    Attributes
    ----------
    world
        All ranks.
    comm
        The ranks of this group.
    roots
        The first ranks of all groups (on those ranks), else None.
    index, count
        Number of this group, and of groups.
    """

    world: MPI.Comm
    comm: MPI.Comm
    roots: MPI.Comm | None
    index: int
    count: int

    @classmethod
    def split(cls, world: MPI.Comm, ranks_per_group: int, option: str = "--ranks-per-angle") -> RankGroup:
        """Split all ranks into groups; ranks left over join the last group. Collective on `world`.

        Who splits closes. `option` is what asks for it, in messages.

        Raises
        ------
        InputError
            If a group needs more ranks than there are.
        """
        if not 1 <= ranks_per_group <= world.size:
            raise InputError(
                f"{option} = {ranks_per_group}: allowed are 1 to {world.size}, the number of ranks of this run"
            )
        count = world.size // ranks_per_group
        index = min(world.rank // ranks_per_group, count - 1)
        comm = world.Split(color=index, key=world.rank)
        roots = world.Split(color=int(comm.rank > 0), key=index)
        if comm.rank > 0:
            roots.Free()
        return cls(world, comm, roots if comm.rank == 0 else None, index, count)

    def close(self) -> None:
        """Free the communicators of this rank. Collective on each of them."""
        for comm in (self.roots, self.comm):
            if comm is not None:
                comm.Free()

    def __enter__(self) -> RankGroup:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def arcs(self, n: int) -> list[range]:
        """Return the groups' contiguous shares of n configurations; groups beyond the n-th have none."""
        bounds = np.linspace(0, n, min(self.count, n) + 1).round().astype(int)
        return [range(first, last) for first, last in zip(bounds, bounds[1:])]

    def arc(self, n: int) -> range:
        """Return this group's share; empty where it has none."""
        arcs = self.arcs(n)
        return arcs[self.index] if self.index < len(arcs) else range(0)


@contextmanager
def first_ranks(comm: MPI.Comm, n: int) -> Iterator[MPI.Comm]:
    """Yield a communicator of the first n ranks, and one of the others on those. Collective on `comm`.

    It is freed at the end of the block, whatever happens there: freeing waits for nobody in MPI's usual
    implementations.
    """
    part = comm.Split(color=int(comm.rank >= n), key=comm.rank)
    try:
        yield part
    finally:
        part.Free()
