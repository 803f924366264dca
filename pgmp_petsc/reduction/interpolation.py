"""Interpolation of tables over the samples of the rigid coordinates (docs/method.md, reduced equations).

``overhauser``, the paper's, takes uniform samples, ``spline``, periodic or not-a-knot, any, and ``spectral`` uniform
ones where it is trigonometric, else Chebyshev points. Whatever the scheme, the result is a piecewise cubic on a uniform
grid (`Interpolant`), so that the integrator's kernel knows one way of interpolating. A spline through uniform samples
is represented as it stands, as is one through those of halved intervals, on a grid through all; other interpolants are
evaluated on a grid so fine that its own error, of fourth order in the fine step, does not count. Over several
coordinates it is the tensor product: one scheme along each axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from scipy.linalg import solve_banded

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.reduction.cell_products import (
    B_SPLINE,
    N_ROWS,
    OVERHAUSER,
    Axis,
    products_of,
    stencil_room,
    tensor_stencil,
)
from pgmp_petsc.reduction.sample_grid import SampleGrid, Samples

FINE = 1024  # points over the range of interpolants that are not splines of their own samples
# the same along each axis of two: an error of (2 pi / 96)^4 / 384 = 5e-8 of the fourth derivative, and of three, 4e-6
FINE_OF_MORE, FINE_OF_THREE = 96, 32
ON_GRID = 1e-9  # of its cells: a sample as close to a point of a grid is one
COLUMNS = 4096  # of a table that are fitted together


@dataclass(frozen=True, eq=False)
class Interpolant:
    """A piecewise polynomial on a uniform tensor grid, cubic along each axis."""

    axes: tuple[Axis, ...]  # grid of every coordinate
    rows: np.ndarray  # samples or spline coefficients, shape (n_rows_1, ..., n_rows_n_theta, ...)
    #: along every axis the cells in which a polynomial begins, increasing; () where each cell has its own
    begins: tuple[np.ndarray, ...] = ()

    @property
    def n_theta(self) -> int:
        """Number of coordinates."""
        return len(self.axes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a value."""
        return self.rows.shape[self.n_theta :]

    def __call__(self, theta: np.ndarray, derivative: int = -1) -> np.ndarray:
        """Return the values at theta of shape (k, n_theta), or (k,) for one coordinate; shape (k, ...). In place of the
        values are, if asked for, their derivatives with the coordinate of a number."""
        table = self.rows.reshape(int(np.prod(self.rows.shape[: self.n_theta])), -1)
        result = np.zeros((len(theta), table.shape[1]))
        _add_rows(self._points(theta), self.axes, derivative, table, result)
        return result.reshape(len(theta), *self.shape)

    def product(self, theta: np.ndarray, vectors: np.ndarray, derivative: int = -1) -> np.ndarray:
        """Return factors (k, n_in) times the values at theta, matrices of shape (n_in, n_out); shape (k, n_out).

        In place of the values are, if asked for, their derivatives with the coordinate of a number. The factors are
        the vectors (k, m) and, where there are more, products of pairs of these behind them.
        """
        table = self.rows.reshape(int(np.prod(self.rows.shape[: self.n_theta])), *self.shape)
        return products_of(self._points(theta), self.axes, table, _contiguous(vectors), derivative)

    def _points(self, theta: np.ndarray) -> np.ndarray:
        return _contiguous(theta).reshape(len(theta), self.n_theta)


def _contiguous(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=float)


@njit(cache=True, error_model="numpy")
def _add_rows(theta, axes, derivative, table, result):
    """Add the interpolated rows of a table (n_rows, size), or a derivative of them, to result (k, size)."""
    n_rows = N_ROWS ** len(axes)
    one_axis, rows, weights = stencil_room(), np.empty(n_rows, dtype=np.int64), np.empty(n_rows)
    for k in range(theta.shape[0]):
        tensor_stencil(theta[k], axes, derivative, one_axis, rows, weights)
        for r in range(0, n_rows, N_ROWS):  # four in one pass: less to load and to store
            row_0, row_1, row_2, row_3 = table[rows[r]], table[rows[r + 1]], table[rows[r + 2]], table[rows[r + 3]]
            w_0, w_1, w_2, w_3 = weights[r], weights[r + 1], weights[r + 2], weights[r + 3]
            for e in range(table.shape[1]):
                total = result[k, e] + w_0 * row_0[e] + w_1 * row_1[e]
                result[k, e] = total + w_2 * row_2[e] + w_3 * row_3[e]


def interpolant(samples: SampleGrid | Samples, table: np.ndarray, scheme: str) -> Interpolant:
    """Interpolate a table of shape (n, ...) given at the samples of a grid, or of one axis.

    Raises `ValueError` if the scheme does not take such samples.
    """
    grid = samples if isinstance(samples, SampleGrid) else SampleGrid((samples,))
    rows = table.reshape(*grid.shape, *table.shape[1:])
    fine = (FINE, FINE_OF_MORE, FINE_OF_THREE)[grid.n_coordinates - 1]
    axes, begins = [], []
    for k, along in enumerate(grid.axes):
        axis, fitted = _fit(along, np.moveaxis(rows, k, 0), scheme, fine)
        axes.append(axis)
        begins.append(_begins(along, axis) if scheme == "spline" else np.arange(axis.n_cells))
        rows = np.moveaxis(fitted, 0, k)
    return Interpolant(tuple(axes), _contiguous(rows), tuple(begins))


def _fit(samples: Samples, table: np.ndarray, scheme: str, fine: int) -> tuple[Axis, np.ndarray]:
    """Return grid and rows of the interpolant along one axis, the first of the table."""
    if scheme == "overhauser":
        if not samples.is_uniform:
            raise ValueError("Overhauser interpolation needs uniform samples")
        return _axis(samples, samples.n, OVERHAUSER), table
    if scheme not in ("spline", "spectral"):
        raise ValueError(f"interpolation '{scheme}'; known: overhauser, spline, spectral")
    # columns are independent of each other: what is between a table and its coefficients takes several times as much
    columns, found = table.reshape(len(table), -1), None
    for first in range(0, max(1, columns.shape[1]), COLUMNS):
        part = columns[:, first : first + COLUMNS]
        if scheme == "spectral":
            part = _spectral_on_fine_grid(samples, part, fine)
        elif not samples.is_uniform:
            part = _spline_on_fine_grid(samples, part, fine)
        axis = _axis(samples, len(part), B_SPLINE)
        part = _periodic_coefficients(part) if samples.periodic else _coefficients(part)
        if found is None:
            found = np.empty((len(part), columns.shape[1]))
        found[:, first : first + COLUMNS] = part
    return axis, found.reshape(len(found), *table.shape[1:])


def _axis(samples: Samples, n: int, basis: int) -> Axis:
    step = (samples.upper - samples.lower) / (n if samples.periodic else n - 1)
    return Axis(samples.lower, step, n, samples.periodic, basis)


def samples_for(scheme: str, lower: float, upper: float, n: int, periodic: bool) -> Samples:
    """Return n samples of a range as the scheme wants them."""
    if scheme == "spectral" and not periodic:
        return Samples.chebyshev(lower, upper, n)
    return Samples.uniform(lower, upper, n, periodic)


def _periodic_coefficients(values: np.ndarray) -> np.ndarray:
    """Solve ``(c_{i-1} + 4 c_i + c_{i+1}) / 6 = values_i`` around the circle."""
    n = len(values)
    symbol = (4.0 + 2.0 * np.cos(2 * np.pi * np.arange(n // 2 + 1) / n)) / 6.0
    shape = (-1, *(1,) * (values.ndim - 1))
    return np.fft.irfft(np.fft.rfft(values, axis=0) / symbol.reshape(shape), n, axis=0)


def _coefficients(values: np.ndarray) -> np.ndarray:
    """Solve for n + 2 coefficients, not-a-knot at both ends (third derivative continuous at the second point)."""
    n = len(values)
    bands = np.zeros((9, n + 2))  # row 4 + i - j holds entry (i, j)
    for column in range(n + 2):
        for row, entry in ((column - 1, 1 / 6), (column, 4 / 6), (column + 1, 1 / 6)):
            if 1 <= row <= n:
                bands[4 + row - column, column] = entry
    for k, entry in enumerate((1.0, -4.0, 6.0, -4.0, 1.0)):
        bands[4 - k, k] = entry
        bands[4 + k, n + 1 - k] = entry
    right = np.zeros((n + 2, int(np.prod(values.shape[1:], dtype=int))))
    right[1:-1] = values.reshape(n, -1)
    return solve_banded((4, 4), bands, right).reshape(n + 2, *values.shape[1:])


def _fine_count(samples: Samples, fine: int) -> int:
    """Return the first multiple of the samples' cells that is no less than `fine`."""
    cells = samples.n if samples.periodic else samples.n - 1
    return cells * -(-fine // cells)


def _count_through(samples: Samples, most: int) -> int:
    """Return how many points a uniform grid has that goes through all samples, as of halved intervals: their spline is
    one of its own; `most` where there is none of fewer points."""
    distances = np.diff(np.append(samples.theta, samples.upper) if samples.periodic else samples.theta)
    cells = round((samples.upper - samples.lower) / distances.min())
    n = cells + (not samples.periodic)
    return n if n < most and _on_grid(samples, cells) is not None else most


def _on_grid(samples: Samples, cells: int) -> np.ndarray | None:
    """Return which points of a uniform grid of so many cells samples are at, (n,); None where some are at none."""
    places = (samples.theta - samples.lower) / (samples.upper - samples.lower) * cells
    whole = np.round(places)
    return whole.astype(int) if np.allclose(places, whole, rtol=0.0, atol=ON_GRID) else None


def _begins(samples: Samples, axis: Axis) -> np.ndarray:
    """Return the cells of an axis in which cubics of the spline through samples begin: from sample to sample there is
    one."""
    points = _on_grid(samples, axis.n_cells)
    return np.arange(axis.n_cells) if points is None else points[points < axis.n_cells]


def _spline_on_fine_grid(samples: Samples, table: np.ndarray, count: int) -> np.ndarray:
    count = _count_through(samples, _fine_count(samples, count))
    fine = Samples.uniform(samples.lower, samples.upper, count, samples.periodic)
    if not samples.periodic:
        return scipy.interpolate.CubicSpline(samples.theta, table)(fine.theta)
    theta = np.append(samples.theta, samples.theta[0] + samples.upper - samples.lower)
    return scipy.interpolate.CubicSpline(theta, np.concatenate([table, table[:1]]), bc_type="periodic")(fine.theta)


def _spectral_on_fine_grid(samples: Samples, table: np.ndarray, fine: int) -> np.ndarray:
    count = _fine_count(samples, fine)
    if samples.periodic:
        if not samples.is_uniform:
            raise ValueError("trigonometric interpolation needs uniform samples")
        return scipy.signal.resample(table, count, axis=0)
    points = Samples.uniform(samples.lower, samples.upper, count, False)
    return _barycentric(samples.theta, table, points.theta)


def _barycentric(points: np.ndarray, table: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Evaluate the polynomial through Chebyshev points of the second kind (Berrut and Trefethen 2004, eq. (4.2))."""
    weights = (-1.0) ** np.arange(points.size)
    weights[[0, -1]] *= 0.5
    distance = theta[:, None] - points
    hit = np.abs(distance) < 1e-14 * (points[-1] - points[0])
    terms = weights / np.where(hit, 1.0, distance)
    terms[hit.any(axis=1)] = 0.0
    terms[hit] = 1.0
    flat = table.reshape(points.size, -1)
    return (terms @ flat / terms.sum(axis=1)[:, None]).reshape(theta.size, *table.shape[1:])
