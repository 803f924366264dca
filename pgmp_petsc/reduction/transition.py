"""From the samples of one coordinate to a grid, until all tables come with one."""

from __future__ import annotations

from pgmp_petsc.reduction.sample_grid import SampleGrid
from pgmp_petsc.reduction.samples import Samples


def as_grid(samples: SampleGrid | Samples) -> SampleGrid:
    """Return the samples of one coordinate as a grid of one axis."""
    return samples if isinstance(samples, SampleGrid) else SampleGrid((samples,))
