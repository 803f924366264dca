"""Groups of ranks that each work on one configuration at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.runtime.errors import InputError

if TYPE_CHECKING:
    from mpi4py import MPI


@dataclass(frozen=True)
class RankGroup:
    """This rank's place among groups of ranks.

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
    def split(cls, world: MPI.Comm, ranks_per_group: int) -> RankGroup:
        """Split all ranks into groups; ranks left over join the last group. Collective on `world`.

        Raises
        ------
        InputError
            If a group needs more ranks than there are.
        """
        if not 1 <= ranks_per_group <= world.size:
            raise InputError(
                f"--ranks-per-angle = {ranks_per_group}: allowed are 1 to {world.size}, the number of ranks of this run"
            )
        count = world.size // ranks_per_group
        index = min(world.rank // ranks_per_group, count - 1)
        comm = world.Split(color=index, key=world.rank)
        roots = world.Split(color=0 if comm.rank == 0 else 1, key=index)
        return cls(world, comm, roots if comm.rank == 0 else None, index, count)

    def arcs(self, n: int) -> list[range]:
        """Return the groups' contiguous shares of n configurations; groups beyond the n-th have none."""
        bounds = np.linspace(0, n, min(self.count, n) + 1).round().astype(int)
        return [range(first, last) for first, last in zip(bounds, bounds[1:])]

    def arc(self, n: int) -> range:
        """Return this group's share; empty where it has none."""
        arcs = self.arcs(n)
        return arcs[self.index] if self.index < len(arcs) else range(0)
