"""Joining the arcs of all groups of ranks, and closing the revolution."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pgmp_petsc.modes.continuity import Closure, procrustes
from pgmp_petsc.reduction.sampler import TABLES, ArcSamples
from pgmp_petsc.reduction.tables import Grid
from pgmp_petsc.runtime.groups import RankGroup


@dataclass(frozen=True)
class JoinedSamples:
    """The samples of all arcs and what makes them continuous.

    Attributes
    ----------
    samples
        Samples of the whole grid, all rows, each arc in its own basis.
    rotations
        ``Psi_continuous = Psi Q``, shape (n, n_modes, n_modes).
    flipped
        Coordinate that changes its sign after a revolution, or -1.
    """

    samples: ArcSamples
    rotations: np.ndarray
    flipped: int


def join_arcs(group: RankGroup, grid: Grid, samples: ArcSamples | None) -> JoinedSamples | None:
    """Join the arcs. Collective on ``group.world``.

    Parameters
    ----------
    samples
        This group's samples; None if its arc is empty.

    Returns
    -------
    JoinedSamples or None
        On the first rank, None elsewhere.
    """
    turn, cosine = _turn_to_previous(group, grid, samples)
    whole = _gather_rows(group, samples)
    if group.roots is None:
        return None
    arcs = group.roots.gather((whole, turn, cosine))
    if group.world.rank > 0:
        return None
    arcs = [arc for arc in arcs if arc[0] is not None]
    rotations, start = [], np.eye(arcs[0][0].shapes.shape[2])
    cosines = []
    for index, (arc, turn, cosine) in enumerate(arcs):
        if index > 0:
            start = turn @ start
            arc.cosines[0] = cosine
        rotations += [start] * len(arc.shapes)
        cosines.append(arc.cosines)
    flipped = -1
    if grid.periodic:
        _, turn, cosines[0][0] = arcs[0]
        closure = Closure.of(turn @ start)
        flipped = closure.flipped
        rotations = [q @ closure.rotation(k / grid.n) for k, q in enumerate(rotations)]
    tables = {
        name: np.concatenate([getattr(arc, name) for arc, _, _ in arcs]) for name in (*TABLES, "shapes")
    }
    joined = ArcSamples(**{**tables, "cosines": np.concatenate(cosines)}, mass_first=arcs[0][0].mass_first)
    return JoinedSamples(joined, np.array(rotations), flipped)


def _turn_to_previous(
    group: RankGroup, grid: Grid, samples: ArcSamples | None
) -> tuple[np.ndarray | None, float]:
    """Return the rotation of this arc's first basis to the last one of the arc before (cyclically)."""
    from mpi4py import MPI

    n_arcs = min(group.count, grid.n)
    if samples is None:
        return None, 1.0
    last = _rows_on_root(group.comm, samples.shapes[-1])
    if group.comm.rank == 0 and n_arcs > 1:
        last = group.roots.sendrecv(
            last, dest=(group.index + 1) % n_arcs, source=(group.index - 1) % n_arcs
        )
    n_local = samples.mass_first.shape[0]
    first_row = group.comm.exscan(n_local) if group.comm.size > 1 else 0
    last = group.comm.bcast(last, root=0)
    first_row = first_row or 0
    previous = last[first_row : first_row + n_local]
    overlap = group.comm.allreduce(samples.mass_first.T @ previous, op=MPI.SUM)
    return procrustes(overlap)


def _gather_rows(group: RankGroup, samples: ArcSamples | None) -> ArcSamples | None:
    """Return the group's samples with all rows, on its first rank."""
    if samples is None:
        return None
    shapes = group.comm.gather(samples.shapes)
    if group.comm.rank > 0:
        return None
    return replace(samples, shapes=np.concatenate(shapes, axis=1))


def _rows_on_root(comm, columns: np.ndarray) -> np.ndarray | None:
    parts = comm.gather(columns)
    return np.concatenate(parts) if comm.rank == 0 else None
