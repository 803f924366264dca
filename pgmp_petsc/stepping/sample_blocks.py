"""How the samples of a batch lie in arrays: sample k is lane ``k % n_lanes`` of block ``k // n_lanes``, or in an order
of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from pgmp_petsc.lanes.vectors import LANES


@dataclass(frozen=True)
class SampleBlocks:
    """Blocks of samples side by side; the last is filled up with copies of the last sample that are never active.

    A sample's numbers do not depend on how many lie beside it.
    """

    n_samples: int  # number of samples
    #: n_lanes, n_blocks: samples of a block, LANES but for a sample alone, and number of blocks
    n_lanes: int
    n_blocks: int
    #: numbers of the samples as they lie in the lanes, shape (n_samples,); None where they lie one after the other
    order: np.ndarray | None = None

    @classmethod
    def of(cls, n_samples: int) -> SampleBlocks:
        """Choose the blocks for a number of samples."""
        n_lanes = 1 if n_samples == 1 else LANES
        return cls(n_samples, n_lanes, -(-n_samples // n_lanes))

    @property
    def n_places(self) -> int:
        """Number of lanes of all blocks."""
        return self.n_blocks * self.n_lanes

    def ordered(self, order: np.ndarray) -> Self:
        """Return the same blocks with the samples in another order."""
        return replace(self, order=order)

    @property
    def samples(self) -> np.ndarray:
        """Number of the sample in each lane, shape (n_blocks, n_lanes)."""
        return self.pack(np.arange(self.n_samples))

    def fill(self, rows: np.ndarray) -> np.ndarray:
        """Repeat the last sample so that the last axis, of samples, fills all blocks."""
        return np.concatenate([rows, np.repeat(rows[..., -1:], self.n_places - self.n_samples, axis=-1)], axis=-1)

    def pack(self, rows: np.ndarray, place: int = 0) -> np.ndarray:
        """Return rows of shape (..., n_samples) as contiguous (n_blocks, ..., n_lanes); the axis of blocks may have
        another place."""
        rows = rows if self.order is None else rows[..., self.order]
        blocks = self.fill(rows).reshape(*rows.shape[:-1], self.n_blocks, self.n_lanes)
        return np.ascontiguousarray(np.moveaxis(blocks, -2, place))

    def unpack(self, array: np.ndarray) -> np.ndarray:
        """Return an array of shape (n_blocks, ..., n_lanes) as (..., n_samples)."""
        # one block, of a single run, is not moved: that takes as long as some of the work
        rows = array[0] if self.n_blocks == 1 else np.moveaxis(array, 0, -2).reshape(*array.shape[1:-1], self.n_places)
        rows = rows[..., : self.n_samples]
        if self.order is None:
            return rows
        result = np.empty_like(rows)
        result[..., self.order] = rows
        return result

    def mask(self, samples: np.ndarray) -> np.ndarray:
        """Return a mask of samples as (n_blocks, n_lanes), False where there is none."""
        filled = np.zeros(self.n_places, dtype=bool)
        filled[: self.n_samples] = samples if self.order is None else samples[self.order]
        return filled.reshape(self.n_blocks, self.n_lanes)
