"""Piecewise cubics on a uniform grid, as weighted sums of four rows of a table; compiled.

Two bases: ``OVERHAUSER``, the cubic Hermite polynomial with central-difference tangents (Naets et al. 2015, eqs.
(18)-(20)), whose rows are the samples themselves, and ``B_SPLINE``, whose rows are the coefficients of uniform cubic
B-splines. Everything that interpolates uses `stencil`, in Python and in the integrator's kernel alike.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.vectors import floor, load, store

N_ROWS = 4
OVERHAUSER, B_SPLINE = 0, 1


class Axis(NamedTuple):
    """Uniform grid of one coordinate, as the kernels take it."""

    #: lower, step: the first point, and the distance of points, rad
    lower: float
    step: float
    n: int  # number of points
    periodic: bool  # whether the last cell ends at the first point
    basis: int  # ``OVERHAUSER`` (the table has n rows) or ``B_SPLINE`` (n rows if periodic, else n + 2)

    @property
    def n_cells(self) -> int:
        """Number of cells of the grid."""
        return self.n if self.periodic else self.n - 1


@njit(cache=True, error_model="numpy")
def count_rows(axis):
    """Return the number of rows of a table along an axis."""
    return axis.n + 2 if axis.basis == B_SPLINE and not axis.periodic else axis.n


@njit(cache=True, error_model="numpy")
def stencil(theta, axis, rows, weights, slopes):
    """Fill the rows, weights and derivative weights for one theta.

    Parameters
    ----------
    theta
        Coordinate, rad; inside the range if the grid is not periodic.
    rows, weights, slopes
        Results, shape (4,): ``A = sum weights A[rows]``, ``dA/dtheta = sum slopes A[rows]``.
    """
    cell, s = locate(theta, axis)
    cell_stencil(cell, s, axis, rows, weights, slopes)


@njit(cache=True, error_model="numpy")
def locate(theta, axis):
    """Return the number of theta's cell, not yet taken into the range of a periodic grid, and its place s in it."""
    position = (theta - axis.lower) / axis.step
    cell = int(np.floor(position))
    if not axis.periodic:
        cell = min(max(cell, 0), axis.n - 2)
    return cell, position - cell


@njit(cache=True, error_model="numpy")
def cell_stencil(cell, s, axis, rows, weights, slopes):
    """Fill the rows, weights and derivative weights for a place s, from 0 to 1, in a cell; see `stencil`."""
    n, periodic, basis = axis.n, axis.periodic, axis.basis
    values, rates = _weights(s, cell, axis, False), _weights(s, cell, axis, True)
    first = cell if basis == B_SPLINE and not periodic else cell - 1
    for k in range(N_ROWS):
        rows[k], weights[k], slopes[k] = first + k, values[k], rates[k]
    if periodic:
        row = first % n
        for k in range(N_ROWS):  # a division for each would take longer than all else here
            rows[k] = row
            row = row + 1 if row + 1 < n else 0
    elif basis == OVERHAUSER:
        # a row beyond an end has the weight zero
        for k in range(N_ROWS):
            rows[k] = min(max(rows[k], 0), n - 1)


@njit(error_model="numpy", counted=False)
def _weights(s, cell, axis, sloped):
    """Return the weights of the rows of a cell for a place s in it, or a vector of places; where `sloped` those of the
    derivative.

    A row outside a limited range is replaced by quadratic extrapolation, 3 A_0 - 3 A_1 + A_2: the tangent at the end
    becomes the one-sided one of second order.
    """
    if axis.basis == B_SPLINE:
        return _b_spline_slopes(s, axis.step) if sloped else _b_spline_values(s)
    one, two, three, four = _overhauser_slopes(s, axis.step) if sloped else _overhauser_values(s)
    if not axis.periodic:
        if cell == 0:
            one, two, three, four = 0.0 * one, two + 3.0 * one, three - 3.0 * one, four + one
        if cell == axis.n - 2:
            one, two, three, four = one + four, two - 3.0 * four, three + 3.0 * four, 0.0 * four
    return one, two, three, four


@njit(error_model="numpy", counted=False)
def _overhauser_values(s):
    """Return the weights of A[i-1..i+2] at a place s of the cell i, or a vector of places, with tangents ``(A[i+1] -
    A[i-1]) / 2`` with respect to s."""
    s2, s3 = s * s, s * s * s
    value_1 = 3.0 * s2 - 2.0 * s3
    tangent_0, tangent_1 = s - 2.0 * s2 + s3, s3 - s2
    return -0.5 * tangent_0, 1.0 - value_1 - 0.5 * tangent_1, value_1 + 0.5 * tangent_0, 0.5 * tangent_1


@njit(error_model="numpy", counted=False)
def _b_spline_values(s):
    """Return those of four consecutive coefficients of uniform cubic B-splines."""
    t = 1.0 - s
    return (
        t * t * t / 6.0,
        (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0,
        (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        s * s * s / 6.0,
    )


@njit(error_model="numpy", counted=False)
def _overhauser_slopes(s, step):
    """Return their derivatives with the coordinate."""
    s2 = s * s
    rate_1 = 6.0 * s - 6.0 * s2
    rate_t0, rate_t1 = 1.0 - 4.0 * s + 3.0 * s2, 3.0 * s2 - 2.0 * s
    return (
        -0.5 * rate_t0 / step,
        (-rate_1 - 0.5 * rate_t1) / step,
        (rate_1 + 0.5 * rate_t0) / step,
        0.5 * rate_t1 / step,
    )


@njit(error_model="numpy", counted=False)
def _b_spline_slopes(s, step):
    """Return their derivatives with the coordinate."""
    t = 1.0 - s
    return (-0.5 * t * t / step, (-2.0 * s + 1.5 * s * s) / step, (2.0 * t - 1.5 * t * t) / step, 0.5 * s * s / step)


@njit(error_model="numpy", counted=False)
def lane_stencil(cell, axis, sloped, lanes):
    """Replace thetas of one cell, the first of four vectors (4, LANES), by the weights of the cell's rows, or where
    `sloped` by those of the derivative.

    The weights are those of `stencil` to the last bit.
    """
    position = (load(lanes, 0) - axis.lower) / axis.step
    if axis.periodic:
        s = position - floor(position)
    else:
        s = position - float(cell)
    values = _weights(s, cell, axis, sloped)
    for k in range(N_ROWS):
        store(lanes, k, values[k])
