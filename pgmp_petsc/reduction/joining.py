"""Joining the samples of all groups of ranks into one continuous basis.

What decides about continuity are small matrices, eigenvalues and overlaps of neighbouring modes; once the overlaps over
the borders of the arcs are known, the first rank works out every sample's rotation, whoever computed it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.modes.continuity import close_revolution, group_modes, transport
from pgmp_petsc.reduction.sampler import TABLES, ArcSamples
from pgmp_petsc.reduction.tables import Grid
from pgmp_petsc.runtime.groups import RankGroup


@dataclass(frozen=True)
class JoinedSamples:
    """The samples of all arcs and what makes them continuous.

    Attributes
    ----------
    samples
        Samples of the whole grid, all rows, in the eigensolver's own bases.
    rotations
        ``Psi_continuous = Psi Q``, shape (n, n_modes, n_modes).
    cosines
        Cosine of the largest angle of a group of modes to the sample before, shape (n,).
    flipped
        Coordinates that change their sign after a revolution.
    groups
        Mode numbers of the groups.
    """

    samples: ArcSamples
    rotations: np.ndarray
    cosines: np.ndarray
    flipped: np.ndarray
    groups: list[np.ndarray]


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
    border = _overlap_with_previous_arc(group, grid, samples)
    shapes = None if samples is None else group.comm.gather(samples.shapes)
    if group.roots is None:
        return None
    arcs = group.roots.gather((samples, shapes, border))
    if group.world.rank > 0:
        return None
    arcs = [arc for arc in arcs if arc[0] is not None]
    whole = ArcSamples(
        **{name: np.concatenate([getattr(arc, name) for arc, _, _ in arcs]) for name in TABLES},
        shapes=np.concatenate([np.concatenate(parts, axis=1) for _, parts, _ in arcs]),
        mass_first=arcs[0][0].mass_first,
    )
    # overlaps from each sample to the next, those over the borders of the arcs among them
    overlaps = [item for arc, _, border in arcs for item in (border, *arc.overlaps)]
    return _continuous(grid, whole, np.array(overlaps))


def _continuous(grid: Grid, samples: ArcSamples, overlaps: np.ndarray) -> JoinedSamples:
    """Work out the rotations; ``overlaps[0]`` closes the revolution."""
    inner = overlaps[1:]
    groups = group_modes(samples.eigenvalues, overlaps if grid.periodic else inner)
    rotations, cosines = transport(inner, groups, samples.canonical[0])
    flipped = np.zeros(0, dtype=int)
    if grid.periodic:
        rotations, flipped, cosines[0] = close_revolution(rotations, overlaps[0], groups)
    return JoinedSamples(samples, rotations, cosines, flipped, groups)


def _overlap_with_previous_arc(
    group: RankGroup, grid: Grid, samples: ArcSamples | None
) -> np.ndarray | None:
    """Return ``V_first^T M V_last`` with the last modes of the arc before (cyclically)."""
    from mpi4py import MPI

    if samples is None:
        return None
    n_arcs = min(group.count, grid.n)
    parts = group.comm.gather(samples.shapes[-1])
    last = np.concatenate(parts) if parts is not None else None
    if group.comm.rank == 0 and n_arcs > 1:
        last = group.roots.sendrecv(
            last, dest=(group.index + 1) % n_arcs, source=(group.index - 1) % n_arcs
        )
    last = group.comm.bcast(last, root=0)
    n_local = samples.mass_first.shape[0]
    first_row = sum(group.comm.allgather(n_local)[: group.comm.rank])
    previous = last[first_row : first_row + n_local]
    return group.comm.allreduce(samples.mass_first.T @ previous, op=MPI.SUM)
