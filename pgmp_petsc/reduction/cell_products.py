"""Piecewise cubics on a uniform grid, and vectors times matrices that they interpolate; compiled.

At many configurations, LANES of one cell are computed side by side,

    y_k = sum_r w_r(theta_k) f_k T_r

with the rows T_r of a table that belong to the cell of theta_k, and the weights of `stencil`, on a tensor grid products
of one along each axis. Where a cell has many configurations, each row is loaded once for LANES of them.

Along an axis a value is a weighted sum of four rows of the table, in one of two bases: ``OVERHAUSER``, the cubic
Hermite polynomial with central-difference tangents (Naets et al. 2015, eqs. (18)-(20)), whose rows are the samples
themselves, and ``B_SPLINE``, whose rows are the coefficients of uniform cubic B-splines. Everything that interpolates
uses `stencil`, in Python and in the integrator's kernel alike.
"""

from __future__ import annotations

from itertools import permutations
from typing import NamedTuple

import numpy as np

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import floor
from pgmp_petsc.lanes.vectors import LANES, aligned_zeros, load, store

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
    """Fill the rows, weights and slopes, (4,) each, for a theta (rad) that is inside the range if the grid is not
    periodic: ``A = sum weights A[rows]``, ``dA/dtheta = sum slopes A[rows]``."""
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


def products_of(
    theta: np.ndarray, axes: tuple[Axis, ...], table: np.ndarray, vectors: np.ndarray, derivative: int = -1
) -> np.ndarray:
    """Return factors (k, n_in) times matrices interpolated at `theta`, (k, n_theta), rad, shape (k, n_out), or their
    derivative with the coordinate of that number.

    The table has rows over the grid of every coordinate, shape (n_rows, n_in, n_out). Factors are the vectors, shape
    (k, m); where there are more, they are products of pairs of these.
    """
    (_, n_in, n_out), cells = table.shape, cells_of(theta, axes)
    result = np.empty((len(theta), n_out))
    work = tuple(aligned_zeros((n, LANES)) for n in (N_ROWS ** len(axes), N_ROWS, n_in, n_out))
    vectors = np.require(vectors, requirements="CW")  # one kind of array, one compiled function
    _fill_products(theta, axes, table, vectors, derivative, cells, by_cell(cells), work, result)
    return result


def cells_of(theta: np.ndarray, axes: tuple[Axis, ...]) -> np.ndarray:
    """Return the number of the cell of every theta (k, n_theta), shape (k,)."""
    cells = np.empty(len(theta), dtype=np.int64)
    _fill_cells(theta, axes, cells)
    return cells


def by_cell(cells: np.ndarray) -> np.ndarray:
    """Return an order (n,) that puts equal cells (n,) side by side."""
    # in so few bits it is fast, and were there more, some would share fewer loads of the table
    return np.argsort(cells.astype(np.uint16), kind="stable")


@njit(error_model="numpy")
def stencil_room():
    """Return room for rows and weights along an axis."""
    return np.empty(N_ROWS, dtype=np.int64), np.empty((2, N_ROWS))


@njit(cache=True, error_model="numpy", counted=False)
def tensor_stencil(theta, axes, derivative, one_axis, rows, weights):
    """Fill the rows (4**n_theta,) of a flattened table and their weights for one theta of shape (n_theta,).

    The weights are those of the value, or of the derivative with the coordinate of that number. `one_axis` is room for
    rows and weights along an axis (`stencil_room`): to make it anew would take longer than to fill it.
    """
    along, chosen = one_axis
    rows[0], weights[0] = 0, 1.0
    n_filled = 1
    for k in range(len(axes)):
        stencil(theta[k], axes[k], along, chosen[0], chosen[1])
        which = 1 if k == derivative else 0
        # from the last on, in place: each row makes four
        for i in range(n_filled - 1, -1, -1):
            row, weight = rows[i] * count_rows(axes[k]), weights[i]
            for j in range(N_ROWS):
                rows[N_ROWS * i + j] = row + along[j]
                weights[N_ROWS * i + j] = weight * chosen[which, j]
        n_filled *= N_ROWS


@njit(cache=True, error_model="numpy")
def _fill_cells(theta, axes, cells):
    """Fill the number of the cell of every theta, (k, n_theta)."""
    for k in range(theta.shape[0]):
        cells[k] = 0
        for axis in range(len(axes)):
            cell, _ = locate(theta[k, axis], axes[axis])
            n_cells = axes[axis].n if axes[axis].periodic else axes[axis].n - 1
            cells[k] = cells[k] * n_cells + cell % n_cells


@njit(cache=True, error_model="numpy")
def _fill_products(theta, axes, table, vectors, derivative, cells, order, work, result):
    """Fill the products of `products_of`; `order` puts equal cells (k,) side by side.

    A product is the same to the last bit whatever is computed beside it. `work` has room for the weights of rows, those
    along an axis, factors and products, vectors (4**n_theta, LANES), (4, LANES), (n_in, LANES), (n_out, LANES).
    """
    n_rows = N_ROWS ** len(axes)
    room = stencil_room(), np.empty(n_rows, dtype=np.int64), np.empty(n_rows)
    _fill_from_cells(theta, axes, table, vectors, derivative, cells, order, room, work, result)


@njit(error_model="numpy", counted=False)
def _fill_from_cells(theta, axes, table, vectors, derivative, cells, order, room, work, result):
    """Fill the products cell by cell; see `_fill_products`. `room` is that of `tensor_stencil`."""
    (one_axis, rows, weights), (of_rows, along, factors, products) = room, work
    first, n_in, m = 0, table.shape[1], vectors.shape[1]
    while first < order.size:
        together = order[first : end_of_cell(cells, order, first)]
        tensor_stencil(theta[together[0]], axes, -1, one_axis, rows, weights)
        fill_lane_weights(theta, axes, together, derivative, along, of_rows)
        for lane in range(together.size):
            for i in range(m):
                factors[i, lane] = vectors[together[lane], i]
        if n_in > m:
            _multiply_pairs(m, factors)
        _multiply(rows, table, of_rows, factors, products)
        for lane in range(together.size):
            for j in range(table.shape[2]):
                result[together[lane], j] = products[j, lane]
        first += together.size


@njit(error_model="numpy", counted=False)
def end_of_cell(cells, order, first):
    """Return where those end in an order, LANES at most, that have the cell of the one at `first`."""
    behind = first + 1
    while behind < min(first + LANES, order.size) and cells[order[behind]] == cells[order[first]]:
        behind += 1
    return behind


@njit(error_model="numpy", counted=False)
def fill_lane_weights(theta, axes, together, derivative, along, weights):
    """Fill the weights of the rows of a cell for some of its configurations side by side, or those of a derivative; see
    `tensor_stencil`. `along` has room for those of an axis, vectors (4, LANES)."""
    store(weights, 0, 1.0)
    n_filled = 1
    for k in range(len(axes)):
        for lane in range(together.size):
            along[0, lane] = theta[together[lane], k]
        cell, _ = locate(along[0, 0], axes[k])
        lane_stencil(cell, axes[k], k == derivative, along)
        for i in range(n_filled - 1, -1, -1):
            weight = load(weights, i)
            for j in range(N_ROWS):
                store(weights, N_ROWS * i + j, weight * load(along, j))
        n_filled *= N_ROWS


@njit(error_model="numpy", counted=False)
def _multiply_pairs(m, factors):
    """Fill the factors behind the first m with those of the packed chi in ``1/2 chi delta delta``: products of pairs
    i >= j of these, and halves of their squares."""
    pair = m
    for i in range(m):
        for j in range(i + 1):
            store(factors, pair, (0.5 if i == j else 1.0) * load(factors, i) * load(factors, j))
            pair += 1


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _multiply(rows, table, weights, factors, products):
    """Fill the products of one cell, whose rows are given; four of them in one pass."""
    for j in range(table.shape[2]):
        store(products, j, 0.0)
    for r in range(0, rows.size, N_ROWS):
        row_0, row_1, row_2, row_3 = table[rows[r]], table[rows[r + 1]], table[rows[r + 2]], table[rows[r + 3]]
        for i in range(table.shape[1]):
            x = load(factors, i)
            x_0, x_1 = x * load(weights, r), x * load(weights, r + 1)
            x_2, x_3 = x * load(weights, r + 2), x * load(weights, r + 3)
            for j in range(table.shape[2]):
                total = load(products, j) + x_0 * row_0[i, j] + x_1 * row_1[i, j]
                store(products, j, total + x_2 * row_2[i, j] + x_3 * row_3[i, j])


def congruent(left: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Return ``Q^T A Q`` for Q (n, i, j) and A (n, terms, ..., i, i), exactly symmetric."""
    product = np.einsum("nki,n...kl,nlj->n...ij", left, matrices, left, optimize=True)
    return 0.5 * (product + np.swapaxes(product, -1, -2))


def symmetric(cubic: np.ndarray) -> np.ndarray:
    """Return tables (..., m, m, m) as means over the orders of their indices, equal to the last bit."""
    m, first = cubic.shape[-1], cubic.ndim - 3
    leading = range(first)
    mean = sum(np.transpose(cubic, (*leading, *(first + np.array(order)))) for order in permutations(range(3))) / 6.0
    # sums in different orders round differently: one entry of each sextuple is taken for all
    return mean[..., *np.sort(np.indices((m, m, m)), axis=0)]


def unpacked(pairs: np.ndarray) -> np.ndarray:
    """Return packed pairs (..., n_pairs) as symmetric matrices (..., m, m)."""
    i, j = np.indices(2 * (int(np.sqrt(2 * pairs.shape[-1])),))
    larger = np.maximum(i, j)
    return pairs[..., larger * (larger + 1) // 2 + np.minimum(i, j)]


def pair_changes(delta: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return the derivative of the products of pairs along a direction (n, n_delta), shape (n, n_pairs)."""
    i, j = np.tril_indices(delta.shape[1])
    return np.where(i == j, 0.5, 1.0) * (delta[:, i] * rate[:, j] + rate[:, i] * delta[:, j])


def pair_rotations(rotations: np.ndarray) -> np.ndarray:
    """Return what turns packed pairs, ``chi_new = chi P``, for rotations (n, m, m); shape (n, n_pairs, n_pairs)."""
    i, j = np.tril_indices(rotations.shape[1])
    left, right = rotations[:, i], rotations[:, j]  # rows i and j: shape (n, n_pairs, m)
    straight = left[:, :, i] * right[:, :, j]
    crossed = left[:, :, j] * right[:, :, i]
    return np.where((i == j)[:, None], straight, straight + crossed)
