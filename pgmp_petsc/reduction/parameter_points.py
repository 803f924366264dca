"""Points of the parameter space at which a basis takes further modes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ParameterPoints:
    """The points of a greedy choice.

    Attributes
    ----------
    values
        Values of the parameters, shape (n_points,) each.
    missed
        Largest share of the energy norm that the basis misses at any candidate: before, and with each further point.
    n_vectors
        Number of vectors that the basis takes from them.
    """

    values: dict[str, np.ndarray]
    missed: np.ndarray
    n_vectors: int

    @property
    def points(self) -> list[dict[str, float]]:
        """The points one by one."""
        n_points = len(self.missed) - 1
        return [{name: float(column[k]) for name, column in self.values.items()} for k in range(n_points)]

    @classmethod
    def none(cls) -> ParameterPoints:
        """Return no points."""
        return cls({}, np.ones(1), 0)
