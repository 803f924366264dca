"""Where unknowns, multipliers and the entries of the iteration matrix lie in the arrays of one rank.

Matrices are symmetric, and stored as a diagonal and entries below it. All unknowns of a batch are on one rank, in the
order of its factorisation; a sample that is shared by ranks has on each what its elements and joints touch.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from pgmp_petsc.dynamics.batched_ldl import Symbolic


class Layout(Protocol):
    """A layout.

    Attributes
    ----------
    needed
        Numbers of the unknowns, and then of the multipliers behind all unknowns, that are here, increasing, (n,).
    n_unknowns
        How many of these are unknowns.
    place
        Turn of every unknown and multiplier here in the arrays of right-hand side and diagonal.
    n_lower
        Number of entries below the diagonal.
    """

    needed: np.ndarray
    n_unknowns: int
    place: np.ndarray
    n_lower: int

    def unknowns(self, dofs: np.ndarray) -> np.ndarray:
        """Return the numbers here of unknowns, -1 where they are -1."""

    def positions(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return where entries are stored: below the diagonal, or ``-1 - k`` on it."""


@dataclass(frozen=True, eq=False)
class WholeLayout:
    """All unknowns, in the order of a factorisation."""

    symbolic: Symbolic
    n_unknowns: int

    @property
    def needed(self) -> np.ndarray:
        """See `Layout`."""
        return np.arange(self.symbolic.n)

    @property
    def place(self) -> np.ndarray:
        """See `Layout`."""
        return self.symbolic.place

    @property
    def n_lower(self) -> int:
        """See `Layout`."""
        return self.symbolic.rows.size

    def unknowns(self, dofs: np.ndarray) -> np.ndarray:
        """See `Layout`."""
        return dofs

    def positions(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """See `Layout`."""
        return self.symbolic.position(rows, columns)


class RankLayout:
    """What one rank needs of unknowns and multipliers, in their order.

    Parameters
    ----------
    n_dofs, n_all
        Number of unknowns of the mechanism, and of unknowns and multipliers.
    pattern
        Rows and columns of all entries that are evaluated here, and whatever else is needed as a pair with itself.
    """

    def __init__(self, n_dofs: int, n_all: int, pattern: tuple[np.ndarray, np.ndarray]) -> None:
        rows, columns = pattern
        self.needed = np.unique(np.concatenate([rows, columns]))
        self.n_unknowns = int(np.searchsorted(self.needed, n_dofs))
        self._n_all = n_all
        off = rows != columns
        self._stored = np.unique(np.maximum(rows, columns)[off] * n_all + np.minimum(rows, columns)[off])
        self.place = np.arange(self.needed.size)

    @property
    def n_lower(self) -> int:
        """See `Layout`."""
        return self._stored.size

    def unknowns(self, dofs: np.ndarray) -> np.ndarray:
        """See `Layout`."""
        return np.where(dofs < 0, -1, np.searchsorted(self.needed, dofs))

    def positions(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """See `Layout`."""
        keys = np.maximum(rows, columns) * self._n_all + np.minimum(rows, columns)
        return np.where(rows == columns, -1 - self.unknowns(rows), np.searchsorted(self._stored, keys))

    @cached_property
    def lower(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the entries below the diagonal among the needed, each (n_lower,)."""
        return tuple(np.searchsorted(self.needed, part) for part in np.divmod(self._stored, self._n_all))
