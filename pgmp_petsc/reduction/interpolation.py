"""Overhauser interpolation of tables over a uniform grid (Naets et al. 2015, eqs. (18)-(20)).

Between samples i and i+1, with ``s = (theta - theta_i) / step``, a cubic Hermite polynomial in s is built on central
difference tangents ``(A_{i+1} - A_{i-1}) / 2`` (the paper prints another denominator, with which the tangents would
scale with the step). At the ends of a range that is not periodic, tangents are the one-sided ones of second order.

Whatever the scheme, an interpolated value is a weighted sum of a few rows of the table; `stencil` gives the rows and
the weights of the value and of its derivative, and everything that interpolates uses it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pgmp_petsc.reduction.tables import Grid

N_ROWS = 4


@njit(cache=True, error_model="numpy")
def stencil(theta, lower, step, n, periodic, rows, weights, slopes):
    """Fill the rows, weights and derivative weights for one theta.

    Parameters
    ----------
    theta
        Coordinate, rad; inside the range if the grid is not periodic.
    lower, step, n, periodic
        The grid.
    rows, weights, slopes
        Results, shape (4,): ``A = sum weights A[rows]``, ``dA/dtheta = sum slopes A[rows]``.
    """
    position = (theta - lower) / step
    cell = int(np.floor(position))
    if not periodic:
        cell = min(max(cell, 0), n - 2)
    s = position - cell
    s2, s3 = s * s, s * s * s
    value_1 = 3.0 * s2 - 2.0 * s3
    value_0 = 1.0 - value_1
    tangent_0 = s - 2.0 * s2 + s3
    tangent_1 = s3 - s2
    slope_1 = (6.0 * s - 6.0 * s2) / step
    slope_0 = -slope_1
    tangent_slope_0 = (1.0 - 4.0 * s + 3.0 * s2) / step
    tangent_slope_1 = (3.0 * s2 - 2.0 * s) / step
    for k in range(4):
        rows[k] = cell - 1 + k
    if not periodic and cell == 0:
        # tangent at the end: (-3 A0 + 4 A1 - A2) / 2
        rows[0] = 3 if n > 3 else 0
        weights[0] = 0.0
        weights[1] = value_0 - 1.5 * tangent_0 - 0.5 * tangent_1
        weights[2] = value_1 + 2.0 * tangent_0
        weights[3] = -0.5 * tangent_0 + 0.5 * tangent_1
        slopes[0] = 0.0
        slopes[1] = slope_0 - 1.5 * tangent_slope_0 - 0.5 * tangent_slope_1
        slopes[2] = slope_1 + 2.0 * tangent_slope_0
        slopes[3] = -0.5 * tangent_slope_0 + 0.5 * tangent_slope_1
    elif not periodic and cell == n - 2:
        rows[3] = n - 4 if n > 3 else 0
        weights[0] = 0.5 * tangent_1 - 0.5 * tangent_0
        weights[1] = value_0 - 2.0 * tangent_1
        weights[2] = value_1 + 0.5 * tangent_0 + 1.5 * tangent_1
        weights[3] = 0.0
        slopes[0] = 0.5 * tangent_slope_1 - 0.5 * tangent_slope_0
        slopes[1] = slope_0 - 2.0 * tangent_slope_1
        slopes[2] = slope_1 + 0.5 * tangent_slope_0 + 1.5 * tangent_slope_1
        slopes[3] = 0.0
    else:
        weights[0] = -0.5 * tangent_0
        weights[1] = value_0 - 0.5 * tangent_1
        weights[2] = value_1 + 0.5 * tangent_0
        weights[3] = 0.5 * tangent_1
        slopes[0] = -0.5 * tangent_slope_0
        slopes[1] = slope_0 - 0.5 * tangent_slope_1
        slopes[2] = slope_1 + 0.5 * tangent_slope_0
        slopes[3] = 0.5 * tangent_slope_1
        if periodic:
            for k in range(4):
                rows[k] = rows[k] % n


def interpolate(grid: Grid, table: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Interpolate a table.

    Parameters
    ----------
    grid
        The grid, of n samples.
    table
        Shape (n, ...).
    theta
        Shape (n_theta,), rad.

    Returns
    -------
    ndarray, shape (n_theta, ...)
    """
    return _weighted_rows(grid, table, theta, slope=False)


def interpolate_slope(grid: Grid, table: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Return the derivative of the interpolant with theta; arguments as for `interpolate`."""
    return _weighted_rows(grid, table, theta, slope=True)


def _weighted_rows(grid: Grid, table: np.ndarray, theta: np.ndarray, slope: bool) -> np.ndarray:
    rows = np.empty(N_ROWS, dtype=np.int64)
    weights, slopes = np.empty(N_ROWS), np.empty(N_ROWS)
    result = np.empty((len(theta), *table.shape[1:]))
    for k, value in enumerate(theta):
        stencil(value, grid.lower, grid.step, grid.n, grid.periodic, rows, weights, slopes)
        result[k] = np.tensordot(slopes if slope else weights, table[rows], axes=1)
    return result
