"""Tables from one tensor grid to another."""

from __future__ import annotations

import numpy as np

from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.sample_grid import SampleGrid


def interpolated_to(target: SampleGrid, samples: SampleGrid, table: np.ndarray, scheme: str) -> np.ndarray:
    """Interpolate a table at the configurations of another grid, one coordinate after the other.

    Parameters
    ----------
    target
        Configurations wanted, in the range of `samples`.
    samples
        Where the table (n, ...) is known.
    scheme
        Interpolation over the samples.

    Returns
    -------
    ndarray, shape (target.n, ...)
    """
    values = table.reshape(*samples.shape, *table.shape[1:])
    for number, (axis, wanted) in enumerate(zip(samples, target)):
        first = np.moveaxis(values, number, 0)
        values = np.moveaxis(interpolant(axis, first, scheme)(wanted.theta), 0, number)
    return values.reshape(target.n, *table.shape[1:])
