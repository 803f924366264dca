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
from pgmp_petsc.reduction.second_order import SecondOrderTables
from pgmp_petsc.runtime.groups import RankGroup


@dataclass(frozen=True, eq=False)
class JoinedSamples:
    """All samples in order, and what makes them continuous.

    Attributes
    ----------
    tables
        `Sample`'s arrays by name, stacked over the samples, in the eigensolver's own bases.
    shapes
        Flexible vectors, all rows, shape (n, n_dofs, n_delta).
    curvatures
        Their second derivatives, pairs packed, all rows, shape (n, n_dofs, n_pairs), or None.
    second_order
        Tables of second order in the eigensolver's own bases, or None.
    rotations
        ``Psi_continuous = Psi Q``, shape (n, n_delta, n_delta).
    cosines
        Cosine of the largest angle of a group of modes to the sample before, shape (n,).
    flipped
        Coordinates that change their sign after a revolution.
    groups
        Numbers of the vectors of each group.
    """

    tables: dict[str, np.ndarray]
    shapes: np.ndarray
    curvatures: np.ndarray | None
    second_order: SecondOrderTables | None
    rotations: np.ndarray
    cosines: np.ndarray
    flipped: np.ndarray
    groups: list[np.ndarray]


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
    nodal = {k: np.hstack([sample.shape, sample.curvature]) for k, sample in own.items()}
    rows = {k: group.comm.gather(nodal[k]) for k in sorted(own)}
    if group.roots is None:
        return None
    found = {
        k: ({name: getattr(sample, name) for name in (*TABLES, "second_order")}, np.concatenate(rows[k]), overlaps[k])
        for k, sample in own.items()
    }
    everything = group.roots.gather(found)
    if group.world.rank > 0:
        return None
    ordered = [item for _, item in sorted((k, item) for part in everything for k, item in part.items())]
    tables = {name: np.array([table[name] for table, _, _ in ordered]) for name in TABLES}
    curved = [table["second_order"] for table, _, _ in ordered]
    overlaps = np.array([overlap for _, _, overlap in ordered])
    shapes, curvatures = np.split(np.array([nodal for _, nodal, _ in ordered]), [overlaps.shape[-1]], axis=2)
    second_order = SecondOrderTables.joined(curved) if curvatures.size else None
    found = _continuous(tables, overlaps, periodic)
    return JoinedSamples(tables, shapes, curvatures if curvatures.size else None, second_order, *found)


def _continuous(
    tables: dict[str, np.ndarray], overlaps: np.ndarray, periodic: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """Work out rotations, cosines, flipped coordinates and groups; ``overlaps[0]`` closes the revolution."""
    groups = group_modes(tables["eigenvalues"], overlaps if periodic else overlaps[1:])
    rotations, cosines = transport(overlaps[1:], groups, tables["canonical"][0])
    flipped = np.zeros(0, dtype=int)
    if periodic:
        rotations, flipped, cosines[0] = close_revolution(rotations, overlaps[0], groups)
    return rotations, cosines, flipped, groups


def _overlaps(group: RankGroup, owners: np.ndarray, own: Mapping[int, Sample]) -> dict[int, np.ndarray]:
    """Return ``V_k^T M V_{k-1}`` of this group's samples k, cyclically.

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
            parts = group.comm.gather(own[(k - 1) % n].shape)
            whole = np.concatenate(parts) if parts is not None else None
        if before != here and group.comm.rank == 0:
            if group.index == before:
                group.roots.send(whole, dest=int(here), tag=k)
            else:
                whole = group.roots.recv(source=int(before), tag=k)
        if group.index == here:
            product = own[k].mass_shape.T @ _own_rows(group, own[k], group.comm.bcast(whole))
            overlaps[k] = group.comm.allreduce(product, op=MPI.SUM)
    return overlaps


def _own_rows(group: RankGroup, sample: Sample, whole: np.ndarray) -> np.ndarray:
    counts = group.comm.allgather(len(sample.shape))
    first = sum(counts[: group.comm.rank])
    return whole[first : first + len(sample.shape)]
