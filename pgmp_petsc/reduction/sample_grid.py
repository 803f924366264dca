"""Where the configurations of a mechanism are sampled: a tensor grid, one axis for each rigid coordinate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.reduction.samples import Samples


@dataclass(frozen=True, eq=False)
class SampleGrid:
    """Sampled configurations; the last coordinate runs fastest.

    Attributes
    ----------
    axes
        Samples of every coordinate, in the order of the mechanism's coordinates.
    """

    axes: tuple[Samples, ...]

    def __iter__(self) -> Iterator[Samples]:
        return iter(self.axes)

    @property
    def n_coordinates(self) -> int:
        """Number of rigid coordinates n_theta."""
        return len(self.axes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of samples along each axis."""
        return tuple(axis.n for axis in self.axes)

    @property
    def n(self) -> int:
        """Number of configurations."""
        return int(np.prod(self.shape))

    @property
    def theta(self) -> np.ndarray:
        """All configurations, shape (n, n_theta), rad."""
        return np.stack([part.ravel() for part in np.meshgrid(*(a.theta for a in self.axes), indexing="ij")], axis=1)

    def contains(self, theta: np.ndarray) -> np.ndarray:
        """Return whether configurations (..., n_theta) lie in the range, shape (...)."""
        inside = [axis.contains(theta[..., k]) for k, axis in enumerate(self.axes)]
        return np.logical_and.reduce([np.broadcast_to(part, theta.shape[:-1]) for part in inside])
