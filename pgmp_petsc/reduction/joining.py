"""Joining the samples of all groups of ranks into one continuous basis.

What decides about continuity are small matrices, eigenvalues and overlaps of neighbouring modes; once the overlaps of
neighbours that different groups hold are known, the first rank works out every sample's rotation, whoever computed it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.modes.continuity import close_revolution, group_modes, transport
from pgmp_petsc.reduction.sampler import TABLES, Sample
from pgmp_petsc.runtime.groups import RankGroup


@dataclass(frozen=True, eq=False)
class JoinedSamples:
    """All samples in order, and what makes them continuous.

    Attributes
    ----------
    tables
        `Sample`'s arrays by name, stacked over the samples, in the eigensolver's own bases.
    shapes
        Flexible vectors, all rows, shape (n, n_dofs, w): kept ones and snapshots.
    rotations
        ``V_continuous = V Q``, shape (n, w, w).
    cosines
        Cosine of the largest angle of a group of modes to the sample before, shape (n,).
    flipped
        Whether a vector changes its sign after a revolution, shape (w,).
    groups
        Numbers of the kept vectors of each group.
    """

    tables: dict[str, np.ndarray]
    shapes: np.ndarray
    rotations: np.ndarray
    cosines: np.ndarray
    flipped: np.ndarray
    groups: list[np.ndarray]

    @property
    def n_kept(self) -> int:
        """Number of kept vectors."""
        return sum(group.size for group in self.groups)


def join_samples(
    group: RankGroup, owners: np.ndarray, own: Mapping[int, Sample], periodic: bool
) -> JoinedSamples | None:
    """Join the samples. Collective on ``group.world``.

    Parameters
    ----------
    owners
        Number of the group that holds each sample, shape (n,).
    own
        This group's samples by their number.
    periodic
        Whether the first sample follows the last.

    Returns
    -------
    JoinedSamples or None
        On the first rank, None elsewhere.
    """
    overlaps = _overlaps(group, owners, own)
    rows = {k: group.comm.gather(own[k].shape) for k in sorted(own)}
    if group.roots is None:
        return None
    found = {
        k: ({name: getattr(sample, name) for name in TABLES}, np.concatenate(rows[k]), overlaps[k])
        for k, sample in own.items()
    }
    everything = group.roots.gather(found)
    if group.world.rank > 0:
        return None
    ordered = [item for _, item in sorted((k, item) for part in everything for k, item in part.items())]
    tables = {name: np.array([table[name] for table, _, _ in ordered]) for name in TABLES}
    overlaps = np.array([overlap for _, _, overlap in ordered])
    shapes = np.array([shape for _, shape, _ in ordered])
    rotations, cosines, turned, groups = _continuous(tables, overlaps, periodic)
    n_kept = overlaps.shape[-1]
    # the snapshots of every parameter point turn as the kept vectors do
    times = shapes.shape[2] // n_kept
    return JoinedSamples(
        tables=tables,
        shapes=shapes,
        rotations=_block_diagonal(rotations, times),
        cosines=cosines,
        flipped=np.tile(np.isin(np.arange(n_kept), turned), times),
        groups=groups,
    )


def _block_diagonal(blocks: np.ndarray, times: int) -> np.ndarray:
    """Return matrices (n, m, m), each several times along a diagonal, shape (n, m times, m times)."""
    n, m, _ = blocks.shape
    result = np.zeros((n, m * times, m * times))
    for first in range(0, m * times, m):
        result[:, first : first + m, first : first + m] = blocks
    return result


def _continuous(
    tables: dict[str, np.ndarray], overlaps: np.ndarray, periodic: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """Work out rotations, cosines, flipped vectors and groups of kept ones; ``overlaps[0]`` closes the revolution."""
    groups = group_modes(tables["eigenvalues"], overlaps if periodic else overlaps[1:])
    rotations, cosines = transport(overlaps[1:], groups, tables["canonical"][0])
    flipped = np.zeros(0, dtype=int)
    if periodic:
        rotations, flipped, cosines[0] = close_revolution(rotations, overlaps[0], groups)
    return rotations, cosines, flipped, groups


def _overlaps(group: RankGroup, owners: np.ndarray, own: Mapping[int, Sample]) -> dict[int, np.ndarray]:
    """Return ``V_k^T M V_{k-1}`` of the kept vectors of this group's samples k, cyclically.

    Neighbours are passed on in the order of the samples on all groups, so that nobody waits in a circle.
    """
    from mpi4py import MPI

    n = len(owners)
    overlaps = {}
    for k in range(n):
        before, here = owners[k - 1], owners[k]
        if group.index not in (before, here):
            continue
        whole = None
        if group.index == before:
            parts = group.comm.gather(own[(k - 1) % n].kept)
            whole = np.concatenate(parts) if parts is not None else None
        if before != here and group.comm.rank == 0:
            if group.index == before:
                group.roots.send(whole, dest=int(here), tag=k)
            else:
                whole = group.roots.recv(source=int(before), tag=k)
        if group.index == here:
            product = own[k].mass_kept.T @ _own_rows(group, own[k], group.comm.bcast(whole))
            overlaps[k] = group.comm.allreduce(product, op=MPI.SUM)
    return overlaps


def _own_rows(group: RankGroup, sample: Sample, whole: np.ndarray) -> np.ndarray:
    counts = group.comm.allgather(len(sample.shape))
    first = sum(counts[: group.comm.rank])
    return whole[first : first + len(sample.shape)]
