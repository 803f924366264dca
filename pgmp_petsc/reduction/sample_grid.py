"""Where the configurations of a mechanism are sampled: a tensor grid, one axis for each rigid coordinate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

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

    def nearest(self, theta: np.ndarray) -> np.ndarray:
        """Return the numbers of the samples next to configurations (n, n_theta), shape (n,)."""
        return np.ravel_multi_index([axis.nearest(part) for axis, part in zip(self.axes, theta.T)], self.shape)

    @property
    def periodic(self) -> tuple[bool, ...]:
        """Whether each coordinate is periodic."""
        return tuple(axis.periodic for axis in self.axes)

    def before(self, axis: int) -> np.ndarray:
        """Return the number of the configuration before each one along an axis, shape (n,).

        Before the first one of a periodic axis comes the last; before that of a limited one none, which is -1.
        """
        before = np.roll(np.arange(self.n).reshape(self.shape), 1, axis)
        if not self.axes[axis].periodic:
            before[(slice(None),) * axis + (0,)] = -1
        return before.ravel()

    def over_two_turns(self, axis: int) -> SampleGrid:
        """Return the grid with two revolutions along an axis."""
        return replace(self, axes=(*self.axes[:axis], self.axes[axis].over_two_turns(), *self.axes[axis + 1 :]))

    def twice(self, axis: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Join tables (n, ...) of the first and the second revolution along an axis, shape (2 n, ...)."""
        parts = [table.reshape(*self.shape, *table.shape[1:]) for table in (first, second)]
        return np.concatenate(parts, axis=axis).reshape(2 * self.n, *first.shape[1:])

    def tabulated(self, configurations: np.ndarray) -> SampleGrid:
        """Return a grid of these configurations (n, n_theta), in any order, over the same ranges."""
        axes = (replace(axis, theta=np.unique(part)) for axis, part in zip(self.axes, configurations.T))
        return SampleGrid(tuple(axes))
