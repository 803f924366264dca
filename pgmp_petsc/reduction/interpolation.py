"""Interpolation of tables over the samples of a coordinate.

============== =================================================================== ====================== =======
scheme         what it is                                                          samples                order
============== =================================================================== ====================== =======
``overhauser`` cubic Hermite, central-difference tangents (the paper's)            uniform                3
``spline``     periodic or not-a-knot cubic spline                                 any                    4
``spectral``   trigonometric if periodic, else polynomial through Chebyshev points uniform, Chebyshev     any power
============== =================================================================== ====================== =======

Whatever the scheme, the result is a piecewise cubic on a uniform grid (`Interpolant`), so that the integrator's kernel
knows one way of interpolating. A spline through uniform samples is represented as it stands; the other interpolants are
evaluated on a grid so fine that its own error, of fourth order in the fine step, does not count.

The paper prints (20) with a denominator that would make the tangents scale with the step; the tangent with respect to
s is ``(A_{i+1} - A_{i-1}) / 2``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_banded
from scipy.signal import resample

from pgmp_petsc.reduction.samples import Samples
from pgmp_petsc.reduction.stencil import B_SPLINE, N_ROWS, OVERHAUSER, cell_stencil, stencil

# coefficients of s^0 to s^3 from value and slope at s = 0, value and slope at s = 1
_HERMITE = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [-3.0, -2.0, 3.0, -1.0], [2.0, 1.0, -2.0, 1.0]])
FINE = 1024  # points over the range of interpolants that are not splines of their own samples


@dataclass(frozen=True, eq=False)
class Interpolant:
    """A piecewise cubic on a uniform grid.

    Attributes
    ----------
    lower, step, n, periodic, basis
        As for `stencil`.
    rows
        Samples or spline coefficients, shape (n_rows, ...).
    """

    lower: float
    step: float
    n: int
    periodic: bool
    basis: int
    rows: np.ndarray

    @property
    def grid(self) -> tuple[float, float, int, bool, int]:
        """The grid as the kernels take it."""
        return self.lower, self.step, self.n, self.periodic, self.basis

    @property
    def n_cells(self) -> int:
        """Number of cells of the grid."""
        return self.n if self.periodic else self.n - 1

    def polynomials(self) -> np.ndarray:
        """Return the coefficients of ``s^0`` to ``s^3`` in every cell, s from 0 to 1, shape (n_cells, 4, ...)."""
        rows, matrix = np.empty(N_ROWS, dtype=np.int64), np.empty((4, N_ROWS))
        result = np.empty((self.n_cells, 4, *self.rows.shape[1:]))
        for cell in range(self.n_cells):
            for end in (0, 1):
                value, slope = matrix[2 * end], matrix[2 * end + 1]
                cell_stencil(cell, float(end), self.step, self.n, self.periodic, self.basis, rows, value, slope)
                slope *= self.step
            result[cell] = np.tensordot(_HERMITE @ matrix, self.rows[rows], axes=1)
        return result

    def __call__(self, theta: np.ndarray) -> np.ndarray:
        """Return the values at theta of shape (k,), shape (k, ...)."""
        return self._sum(theta, slope=False)

    def slope(self, theta: np.ndarray) -> np.ndarray:
        """Return the derivative with theta, shape (k, ...)."""
        return self._sum(theta, slope=True)

    def product(self, theta: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Return vectors (k, n_in) times the values at theta (k,), matrices of shape (n_in, n_out); shape (k, n_out)."""
        result = np.zeros((len(theta), self.rows.shape[2]))
        _add_products(_contiguous(theta), self.grid, self.rows, _contiguous(vectors), result)
        return result

    def _sum(self, theta: np.ndarray, slope: bool) -> np.ndarray:
        result = np.zeros((len(theta), *self.rows.shape[1:]))
        _add_rows(
            _contiguous(theta), self.grid, slope, self.rows.reshape(len(self.rows), -1), result.reshape(len(theta), -1)
        )
        return result


def _contiguous(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=float)


@njit(cache=True, error_model="numpy")
def _add_rows(theta, grid, slope, table, result):
    """Add the interpolated rows of a table (n_rows, size), or their derivatives, to result (k, size)."""
    rows = np.empty(N_ROWS, dtype=np.int64)
    weights, slopes = np.empty(N_ROWS), np.empty(N_ROWS)
    for k in range(theta.size):
        stencil(theta[k], *grid, rows, weights, slopes)
        chosen = slopes if slope else weights
        for r in range(N_ROWS):
            for e in range(table.shape[1]):
                result[k, e] += chosen[r] * table[rows[r], e]


@njit(cache=True, error_model="numpy")
def _add_products(theta, grid, table, vectors, result):
    """Add vectors (k, n_in) times the interpolated matrices of a table (n_rows, n_in, n_out) to result (k, n_out)."""
    rows = np.empty(N_ROWS, dtype=np.int64)
    weights, slopes = np.empty(N_ROWS), np.empty(N_ROWS)
    for k in range(theta.size):
        stencil(theta[k], *grid, rows, weights, slopes)
        w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
        for i in range(table.shape[1]):
            x = vectors[k, i]
            row_0, row_1, row_2, row_3 = table[rows[0], i], table[rows[1], i], table[rows[2], i], table[rows[3], i]
            # along the contiguous entries, where it vectorises; the four rows in one pass
            for j in range(table.shape[2]):
                result[k, j] += x * (w0 * row_0[j] + w1 * row_1[j] + w2 * row_2[j] + w3 * row_3[j])


def interpolant(samples: Samples, table: np.ndarray, scheme: str) -> Interpolant:
    """Interpolate a table of shape (n, ...) given at the samples.

    Raises
    ------
    ValueError
        If the scheme does not take such samples.
    """
    if scheme == "overhauser":
        if not samples.is_uniform:
            raise ValueError("Overhauser interpolation needs uniform samples")
        step = (samples.upper - samples.lower) / (samples.n if samples.periodic else samples.n - 1)
        return Interpolant(samples.lower, step, samples.n, samples.periodic, OVERHAUSER, _contiguous(table))
    if scheme == "spline":
        return _as_splines(samples, table if samples.is_uniform else _spline_on_fine_grid(samples, table))
    if scheme == "spectral":
        return _as_splines(samples, _spectral_on_fine_grid(samples, table))
    raise ValueError(f"interpolation '{scheme}'; known: overhauser, spline, spectral")


def samples_for(scheme: str, lower: float, upper: float, n: int, periodic: bool) -> Samples:
    """Return n samples of a range as the scheme wants them."""
    if scheme == "spectral" and not periodic:
        return Samples.chebyshev(lower, upper, n)
    return Samples.uniform(lower, upper, n, periodic)


def _as_splines(samples: Samples, uniform: np.ndarray) -> Interpolant:
    """Return the cubic spline through values at uniform points over the samples' range."""
    n = len(uniform)
    step = (samples.upper - samples.lower) / (n if samples.periodic else n - 1)
    coefficients = _periodic_coefficients(uniform) if samples.periodic else _coefficients(uniform)
    return Interpolant(samples.lower, step, n, samples.periodic, B_SPLINE, _contiguous(coefficients))


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


def _fine_count(samples: Samples) -> int:
    cells = samples.n if samples.periodic else samples.n - 1
    return cells * -(-FINE // cells)


def _spline_on_fine_grid(samples: Samples, table: np.ndarray) -> np.ndarray:
    fine = Samples.uniform(samples.lower, samples.upper, _fine_count(samples), samples.periodic)
    if not samples.periodic:
        return CubicSpline(samples.theta, table)(fine.theta)
    theta = np.append(samples.theta, samples.theta[0] + samples.upper - samples.lower)
    return CubicSpline(theta, np.concatenate([table, table[:1]]), bc_type="periodic")(fine.theta)


def _spectral_on_fine_grid(samples: Samples, table: np.ndarray) -> np.ndarray:
    count = _fine_count(samples)
    if samples.periodic:
        if not samples.is_uniform:
            raise ValueError("trigonometric interpolation needs uniform samples")
        return resample(table, count, axis=0)
    fine = Samples.uniform(samples.lower, samples.upper, count, False)
    return _barycentric(samples.theta, table, fine.theta)


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
