"""The basis that is continuous over all samples, and the tables in it.

Kept vectors are M-orthonormal at the nominal parameters. Those compressed from snapshots, E, are made so by the
symmetric root ``E (E^T M E)^(-1/2)`` (Lowdin 1950) where the kinetic energy of changing modes is kept, and are taken as
they are without it (docs/method.md, parameters far from nominal). Where E is small, what it spans turns quickly: such a
basis needs more angles (`uneven`).

The samples of all groups of ranks are joined with small matrices alone, eigenvalues and overlaps of neighbouring modes:
once the overlaps of neighbours that different groups hold are known, the first rank works out every sample's rotation,
whoever computed it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from pgmp_petsc.effects import Load
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.modes.continuity import GridBasis, GridNeighbours
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.cell_products import pair_rotations
from pgmp_petsc.reduction.sample_grid import SampleGrid
from pgmp_petsc.reduction.sampler import TABLES, Compression, Sample
from pgmp_petsc.reduction.tables import ReducedTables, SecondOrderTables, weighted

Item = TypeVar("Item")


@dataclass(frozen=True, eq=False)
class JoinedSamples:
    """All samples in order, and what makes them continuous."""

    tables: dict[str, np.ndarray]  # `Sample`'s arrays by name, stacked over the samples, in the eigensolver's own bases
    shapes: np.ndarray  # flexible vectors, all rows, shape (n, n_dofs, w): kept ones, snapshots, and given ones
    rotations: np.ndarray  # ``V_continuous = V Q``, shape (n, w, w)
    cosines: np.ndarray  # cosine of the largest angle of a group of modes to a sample before, shape (n,)
    flipped: np.ndarray  # whether a vector changes its sign after a revolution of each coordinate, shape (n_theta, w)
    groups: list[np.ndarray]  # numbers of the kept vectors of each group
    n_given: int = 0  # of the vectors, the last ones: those of joints that are off, the same in every basis

    @property
    def n_kept(self) -> int:
        """Number of kept vectors."""
        return sum(group.size for group in self.groups)

    @property
    def snapshots(self) -> slice:
        """Numbers of the snapshots among the vectors."""
        return slice(self.n_kept, self.shapes.shape[2] - self.n_given)


def in_order(group: RankGroup, own: Mapping[int, Item]) -> list[Item] | None:
    """Return what all groups have by numbers, in the order of these; on the first rank, None elsewhere. Collective."""
    everything = None if group.roots is None else group.roots.gather(own)
    if everything is None:
        return None
    return [item for _, item in sorted((k, item) for part in everything for k, item in part.items())]


def _with_given(flipped: np.ndarray, n_given: int) -> np.ndarray:
    """Return which vectors change their sign after a turn, (n_theta, m), with given ones, which do not, behind them."""
    return np.hstack([flipped, np.zeros((len(flipped), n_given), dtype=bool)])


def _all_rows(group: RankGroup, rows: np.ndarray) -> np.ndarray | None:
    """Return the rows of all ranks of the group on its first one, None elsewhere."""
    if group.comm.size == 1:
        return rows
    parts = group.comm.gather(rows)
    return None if parts is None else np.concatenate(parts)


class SampleStore:
    """Who holds which sample, and this group's own ones. All ranks keep the same books.

    New configurations are dealt to groups of ranks in contiguous arcs.
    """

    def __init__(self, group: RankGroup, samples: SampleGrid) -> None:
        self._group = group
        self._range = samples
        self._theta = np.empty((0, samples.n_coordinates))
        self._owners = np.empty(0, dtype=int)
        self._own: dict[int, Sample] = {}
        self.request(samples.theta)

    @property
    def samples(self) -> SampleGrid:
        """All configurations, in order."""
        return self._range.tabulated(self._theta)

    def request(self, theta: np.ndarray) -> None:
        """Deal out further configurations, shape (n, n_theta), in order; with those before they make a grid."""
        shares = [len(share) for share in self._group.arcs(len(theta))]
        self._theta = np.concatenate([self._theta, theta])
        self._owners = np.concatenate([self._owners, np.repeat(np.arange(len(shares)), shares)])

    def missing(self) -> dict[int, np.ndarray]:
        """Return number and theta (n_theta,) of the samples that this group still has to compute."""
        own = np.flatnonzero(self._owners == self._group.index)
        return {int(k): self._theta[k] for k in own if int(k) not in self._own}

    def put(self, number: int, sample: Sample) -> None:
        """Keep a sample of this group."""
        self._own[number] = sample

    def join(self) -> JoinedSamples | None:
        """Join all samples in their order; on the first rank, None elsewhere. Collective on all ranks.

        Raises `RunError` if the modes cannot be made continuous (first rank).
        """
        group, own, samples = self._group, self.own(), self.samples
        overlaps = self._overlaps(own)
        shapes = {k: _all_rows(group, np.hstack([own[k].shape, own[k].built_in])) for k in sorted(own)}
        found = {
            k: ({name: getattr(sample, name) for name in TABLES}, shapes[k], overlaps[k]) for k, sample in own.items()
        }
        ordered = in_order(group, found)
        if ordered is None:
            return None
        tables = {name: np.array([table[name] for table, _, _ in ordered]) for name in TABLES}
        overlaps = np.array([overlap for _, _, overlap in ordered]).swapaxes(0, 1)
        shapes = np.array([shape for _, shape, _ in ordered])
        strained = tables["stiffness"][..., : overlaps.shape[-1]].any(axis=(0, 1, 2))
        neighbours = GridNeighbours(samples.shape, samples.periodic, tables["eigenvalues"], overlaps, strained)
        basis = GridBasis.of(neighbours, tables["canonical"][0])
        # the snapshots of every parameter point turn as the kept vectors do
        n_given = next(iter(own.values())).built_in.shape[1]
        (n, m, _), times = basis.rotations.shape, (shapes.shape[2] - n_given) // overlaps.shape[-1]
        rotations = np.tile(np.eye(m * times + n_given), (n, 1, 1))
        for first in range(0, m * times, m):
            rotations[:, first : first + m, first : first + m] = basis.rotations
        return JoinedSamples(
            tables=tables,
            shapes=shapes,
            rotations=rotations,
            cosines=basis.cosines,
            flipped=_with_given(np.tile(basis.flipped, times), n_given),
            groups=basis.groups,
            n_given=n_given,
        )

    def _overlaps(self, own: Mapping[int, Sample]) -> dict[int, np.ndarray]:
        """Return ``V_k^T M V_before`` of the kept vectors of this group's samples k by their place in the order of all,
        shape (n_theta, n_kept, n_kept).

        The sample before is that along each axis; without one the product is zero. Neighbours are passed on in one
        order on all groups, so that nobody waits in a circle.
        """
        group, owners, samples = self._group, self._owners[self._order()], self.samples
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
                    counts = group.comm.allgather(len(own[here].shape))
                    first = sum(counts[: group.comm.rank])
                    rows = group.comm.bcast(whole)[first : first + len(own[here].shape)]
                product = own[here].mass_kept.T @ rows
                overlaps[here][axis] = product if group.comm.size == 1 else group.comm.allreduce(product)
        return overlaps

    def own(self) -> dict[int, Sample]:
        """Return this group's samples by their place in the order of all."""
        place = np.argsort(self._order())
        return {int(place[number]): sample for number, sample in sorted(self._own.items())}

    def _order(self) -> np.ndarray:
        """Return the numbers of the samples in their order, the last coordinate fastest."""
        return np.lexsort(self._theta.T[::-1])


@dataclass(frozen=True, eq=False)
class ContinuousBasis:
    """Tables and vectors over all samples; over two turns of a coordinate where a vector changes sign after one."""

    tables: ReducedTables  # in the continuous basis
    projection: np.ndarray  # the basis, shape (n, n_dofs, n_delta)
    groups: list[np.ndarray]  # numbers of the vectors that turn among themselves
    #: the basis in terms of each sample's own vectors, one turn, shape (n_sampled, n_vectors, n_delta)
    combinations: np.ndarray
    #: whether a vector changes its sign after a turn of each rigid coordinate, shape (n_theta, n_delta)
    flipped: np.ndarray
    #: second derivatives of the displacement, pairs packed, shape (n, n_dofs, n_pairs); None where not wanted
    curvature: np.ndarray | None = None
    #: largest factors by which the size of a vector that was made orthonormal changes between neighbouring angles, in
    #: the order of these; of no such vectors none
    uneven: np.ndarray = field(default_factory=lambda: np.ones(0))

    @classmethod
    def of(
        cls,
        mechanism: Mechanism,
        samples: SampleGrid,
        loads: Sequence[Load],
        joined: JoinedSamples,
        compression: Compression,
        nominal: Mapping[str, float] | None,
    ) -> ContinuousBasis:
        """Express the samples' tables and vectors in the continuous basis, orthonormal at `nominal` parameters."""
        n_kept, n_parameter = joined.n_kept, compression.matrix.shape[1]
        combinations, uneven = joined.rotations @ compression.beside(n_kept, joined.n_given), np.ones(0)
        if n_parameter and nominal is not None:
            c = compression.matrix
            squares, directions = np.linalg.eigh(c.T @ _grams(mechanism, nominal, joined) @ c)
            sizes, turned = np.sqrt(squares)[:, None], np.swapaxes(directions, 1, 2)
            inverse = (directions / sizes) @ turned
            own = slice(n_kept, n_kept + n_parameter)
            combinations[:, :, own] = combinations[:, :, own] @ inverse
            uneven = _unevenness((directions * sizes) @ turned, inverse, samples)
        tables = ReducedTables(
            samples=samples,
            mass_weights=mechanism.mass_weights,
            stiffness_weights=mechanism.stiffness_weights,
            load_weights=tuple(load.weight for load in loads),
            load_effects=tuple(load.effect for load in loads),
            n_given=joined.n_given,
            **{name: joined.tables[name] for name in ("mass", "inertia", "stiffness", "load")},
        ).turned(combinations)
        projection = joined.shapes @ combinations
        flipped = _with_given(np.hstack([joined.flipped[:, :n_kept], compression.flips]), joined.n_given)
        groups = [*joined.groups, *np.arange(n_kept, n_kept + n_parameter)[:, None]]
        for grid, axis, signs in samples.turns(flipped):
            projection = grid.twice(axis, projection, projection * signs)
            tables = grid.doubled(axis, tables, signs, samples=grid.over_two_turns(axis))
        return cls(tables, projection, groups, combinations, flipped, uneven=uneven)

    def curved(self, samples: SampleGrid, curvature: np.ndarray, tables: SecondOrderTables) -> ContinuousBasis:
        """Add what is of second order at the samples of one turn of the rigid coordinates: chi, pairs packed, shape
        (n_sampled, n_dofs, n_pairs), and tables."""
        for grid, axis, signs in samples.turns(self.flipped):
            tables = grid.doubled(axis, tables, signs)
            curvature = grid.twice(axis, curvature, curvature @ pair_rotations(np.diag(signs)[None]))
        return replace(self, curvature=curvature, tables=replace(self.tables, second_order=tables))


def compression_of(
    mechanism: Mechanism,
    nominal: Mapping[str, float],
    joined: JoinedSamples,
    n_parameter: int,
    before: Compression | None,
) -> Compression:
    """Return the compression of all samples' snapshots, at the nominal parameters.

    That of the samples `before` stays, for tables to be compared, unless one of its vectors vanishes between these: it
    turned up at a sample that came since. Others are then chosen, or fewer.
    """
    n_snapshots = joined.snapshots.stop - joined.n_kept
    if not n_parameter or not n_snapshots:
        return before or Compression(np.empty((n_snapshots, 0)), np.empty((len(joined.flipped), 0), dtype=bool))
    grams, flipped = _grams(mechanism, nominal, joined), joined.flipped[:, joined.snapshots]
    return before if before is not None and before.holds(grams) else Compression.of(grams, flipped, n_parameter)


def _unevenness(roots: np.ndarray, inverse: np.ndarray, samples: SampleGrid) -> np.ndarray:
    """Return the largest factors between roots (n, p, p) at neighbouring samples of a turn, and their inverses there,
    along one axis after the other, shape (n_pairs,)."""
    found = []
    for axis in range(samples.n_coordinates):
        before = samples.before(axis)
        here = np.flatnonzero((before >= 0) & (before < np.arange(before.size)))
        factors = np.linalg.svd(inverse[here] @ roots[before[here]], compute_uv=False)
        found.append(np.maximum(factors[:, 0], 1.0 / factors[:, -1]))
    return np.concatenate(found)


def _grams(mechanism: Mechanism, nominal: Mapping[str, float], joined: JoinedSamples) -> np.ndarray:
    """Return the Gram matrices of the snapshots in the continuous basis, shape (n, n_snapshots, n_snapshots)."""
    turned = joined.rotations[:, joined.snapshots, joined.snapshots]
    n_rigid = joined.tables["mass"].shape[-1] - joined.shapes.shape[2]
    own = slice(joined.n_kept + n_rigid, joined.snapshots.stop + n_rigid)
    own = joined.tables["mass"][..., own, own]
    return np.swapaxes(turned, 1, 2) @ weighted(own, mechanism.mass_weights, nominal) @ turned
