"""The samples of all groups of ranks, growing round by round."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.reduction.joining import JoinedSamples, join_samples
from pgmp_petsc.reduction.sample_grid import SampleGrid
from pgmp_petsc.reduction.sampler import Sample
from pgmp_petsc.runtime.groups import RankGroup


class SampleStore:
    """Who holds which sample, and this group's own ones. All ranks keep the same books.

    Parameters
    ----------
    group
        Groups of ranks; new configurations are dealt to them in contiguous arcs.
    samples
        The configurations to begin with.
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
        """Join all samples in their order; on the first rank, None elsewhere. Collective on all ranks."""
        return join_samples(self._group, self._owners[self._order()], self.own(), self.samples)

    def own(self) -> dict[int, Sample]:
        """Return this group's samples by their place in the order of all."""
        place = np.argsort(self._order())
        return {int(place[number]): sample for number, sample in sorted(self._own.items())}

    def _order(self) -> np.ndarray:
        """Return the numbers of the samples in their order, the last coordinate fastest."""
        return np.lexsort(self._theta.T[::-1])
