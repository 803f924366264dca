"""Where the configurations of a mechanism are sampled: a tensor grid, one axis for each rigid coordinate;
and the points of the parameter space at which a basis takes further modes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class Samples:
    """Sampled values of a coordinate."""

    theta: np.ndarray  # increasing, shape (n,), rad
    #: lower, upper: the range, rad; a periodic one is closed: its upper end is its lower end again and is no sample
    lower: float
    upper: float
    periodic: bool  # whether the coordinate is periodic

    @classmethod
    def uniform(cls, lower: float, upper: float, n: int, periodic: bool) -> Samples:
        """Sample a range with n points at equal distances."""
        return cls(np.linspace(lower, upper, n, endpoint=not periodic), lower, upper, periodic)

    @classmethod
    def chebyshev(cls, lower: float, upper: float, n: int) -> Samples:
        """Sample a limited range with the n Chebyshev points of the second kind, ends included."""
        points = -np.cos(np.pi * np.arange(n) / (n - 1))
        return cls(lower + (upper - lower) * (points + 1) / 2, lower, upper, False)

    @property
    def n(self) -> int:
        """Number of samples."""
        return self.theta.size

    @property
    def is_uniform(self) -> bool:
        """Whether all distances are equal to round-off."""
        ideal = np.linspace(self.lower, self.upper, self.n, endpoint=not self.periodic)
        return bool(np.max(np.abs(self.theta - ideal)) <= 1e-12 * (self.upper - self.lower))

    def over_two_turns(self) -> Samples:
        """Return the samples of two revolutions."""
        turn = self.upper - self.lower
        return Samples(np.concatenate([self.theta, self.theta + turn]), self.lower, self.upper + turn, True)

    def contains(self, theta: np.ndarray | float) -> np.ndarray | bool:
        """Return whether values lie in the range; always, if it is periodic."""
        return self.periodic | ((theta >= self.lower) & (theta <= self.upper))

    def nearest(self, theta: np.ndarray) -> np.ndarray:
        """Return the numbers of the samples next to values, of their shape."""
        turn = self.upper - self.lower
        known, numbers = self.theta, np.arange(self.n)
        if self.periodic:
            theta = self.lower + np.mod(theta - self.lower, turn)
            known, numbers = np.append(known, known[0] + turn), np.append(numbers, 0)
        return numbers[np.searchsorted(0.5 * (known[1:] + known[:-1]), theta)]


@dataclass(frozen=True, eq=False)
class SampleGrid:
    """Sampled configurations; the last coordinate runs fastest."""

    axes: tuple[Samples, ...]  # samples of every coordinate, in the order of the mechanism's coordinates

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


@dataclass(frozen=True)
class ParameterPoints:
    """The points of a greedy choice."""

    values: dict[str, np.ndarray]  # values of the parameters, shape (n_points,) each
    #: largest share of the energy norm that the basis misses at any candidate: before, and with each further point
    missed: np.ndarray
    n_vectors: int  # number of vectors that the basis takes from them

    @property
    def points(self) -> list[dict[str, float]]:
        """The points one by one."""
        n_points = len(self.missed) - 1
        return [{name: float(column[k]) for name, column in self.values.items()} for k in range(n_points)]

    @classmethod
    def none(cls) -> ParameterPoints:
        """Return no points."""
        return cls({}, np.ones(1), 0)
