"""Where a coordinate's range is sampled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Samples:
    """Sampled values of a coordinate.

    Attributes
    ----------
    theta
        Increasing, shape (n,), rad.
    lower, upper
        The range, rad; a periodic one is closed: its upper end is its lower end again and is no sample.
    periodic
        Whether the coordinate is periodic.
    """

    theta: np.ndarray
    lower: float
    upper: float
    periodic: bool

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
