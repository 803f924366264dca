"""Joining the samples of all groups of ranks into one continuous basis.

What decides about continuity are small matrices, eigenvalues and overlaps of neighbouring modes; once the overlaps of
neighbours that different groups hold are known, the first rank works out every sample's rotation, whoever computed it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.modes.continuity import GridBasis, GridNeighbours
from pgmp_petsc.reduction.sample_grid import SampleGrid
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
        Cosine of the largest angle of a group of modes to a sample before, shape (n,).
    flipped
        Whether a vector changes its sign after a revolution of each coordinate, shape (n_theta, w).
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
    group: RankGroup, owners: np.ndarray, own: Mapping[int, Sample], samples: SampleGrid
) -> JoinedSamples | None:
    """Join the samples. Collective on ``group.world``.

    Parameters
    ----------
    owners
        Number of the group that holds each sample, shape (n,).
    own
        This group's samples by their number.
    samples
        All configurations.

    Returns
    -------
    JoinedSamples or None
        On the first rank, None elsewhere.

    Raises
    ------
    RunError
        If the modes cannot be made continuous (first rank).
    """
    overlaps = _overlaps(group, owners, own, samples)
    shapes = {k: _all_rows(group, own[k].shape) for k in sorted(own)}
    if group.roots is None:
        return None
    found = {k: ({name: getattr(sample, name) for name in TABLES}, shapes[k], overlaps[k]) for k, sample in own.items()}
    everything = group.roots.gather(found)
    if group.world.rank > 0:
        return None
    ordered = [item for _, item in sorted((k, item) for part in everything for k, item in part.items())]
    tables = {name: np.array([table[name] for table, _, _ in ordered]) for name in TABLES}
    overlaps = np.array([overlap for _, _, overlap in ordered]).swapaxes(0, 1)
    shapes = np.array([shape for _, shape, _ in ordered])
    neighbours = GridNeighbours(samples.shape, samples.periodic, tables["eigenvalues"], overlaps)
    basis = GridBasis.of(neighbours, tables["canonical"][0])
    # the snapshots of every parameter point turn as the kept vectors do
    times = shapes.shape[2] // overlaps.shape[-1]
    return JoinedSamples(
        tables=tables,
        shapes=shapes,
        rotations=_block_diagonal(basis.rotations, times),
        cosines=basis.cosines,
        flipped=np.tile(basis.flipped, times),
        groups=basis.groups,
    )


def _block_diagonal(blocks: np.ndarray, times: int) -> np.ndarray:
    """Return matrices (n, m, m), each several times along a diagonal, shape (n, m times, m times)."""
    n, m, _ = blocks.shape
    result = np.zeros((n, m * times, m * times))
    for first in range(0, m * times, m):
        result[:, first : first + m, first : first + m] = blocks
    return result


def _overlaps(
    group: RankGroup, owners: np.ndarray, own: Mapping[int, Sample], samples: SampleGrid
) -> dict[int, np.ndarray]:
    """Return ``V_k^T M V_before`` of the kept vectors of this group's samples k, shape (n_theta, n_kept, n_kept).

    The sample before is that along each axis; without one the product is zero. Neighbours are passed on in one order on
    all groups, so that nobody waits in a circle.
    """
    overlaps = {k: np.zeros((samples.n_coordinates, sample.n_kept, sample.n_kept)) for k, sample in own.items()}
    for axis in range(samples.n_coordinates):
        for here, before in enumerate(samples.before(axis)):
            giver, taker = owners[before], owners[here]
            if before < 0 or group.index not in (giver, taker):
                continue
            if giver == taker:
                rows = own[before].kept
            elif group.index == giver:
                whole = _all_rows(group, own[before].kept)
                if group.roots is not None:
                    group.roots.send(whole, dest=int(taker), tag=here)
                continue
            else:
                whole = None if group.roots is None else group.roots.recv(source=int(giver), tag=here)
                rows = _own_rows(group, own[here], group.comm.bcast(whole))
            product = own[here].mass_kept.T @ rows
            overlaps[here][axis] = product if group.comm.size == 1 else group.comm.allreduce(product)
    return overlaps


def _all_rows(group: RankGroup, rows: np.ndarray) -> np.ndarray | None:
    """Return the rows of all ranks of the group on its first one, None elsewhere."""
    if group.comm.size == 1:
        return rows
    parts = group.comm.gather(rows)
    return None if parts is None else np.concatenate(parts)


def _own_rows(group: RankGroup, sample: Sample, whole: np.ndarray) -> np.ndarray:
    counts = group.comm.allgather(len(sample.shape))
    first = sum(counts[: group.comm.rank])
    return whole[first : first + len(sample.shape)]
