"""Interpolated tables at LANES configurations at once: a polynomial in each cell of the grid, compiled.

A sample stays in one cell of a table for many steps. Its polynomial there, cubic in each rigid coordinate, all terms
already weighted with the sample's own parameters, is kept until it leaves the cell; evaluating it is then the same
short loop for every lane. The number of coordinates, one or two, is the length of a grid, which the compiler knows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.dynamics.lanes import LANES, aligned_zeros
from pgmp_petsc.runtime.compiled import njit

N_COEFFICIENTS = 4  # along each coordinate


class Grid(NamedTuple):
    """Cells of equal width of one coordinate; the first begins at `lower` (rad)."""

    lower: float
    step: float
    n_cells: int
    periodic: bool


class Cache(NamedTuple):
    """Polynomials of the cells that the samples are in.

    Attributes
    ----------
    cells
        Numbers of the cells, -1 before the first, shape (n_blocks, LANES).
    terms
        Shape (n_blocks, n_entries, 4**n_theta, LANES).
    loads
        A unit of every effect's amplitude, effect after effect, shape (n_blocks, n_effects * n_load_entries,
        4**n_theta, LANES).
    """

    cells: np.ndarray
    terms: np.ndarray
    loads: np.ndarray

    @classmethod
    def empty(cls, n_blocks: int, n_entries: int, n_load_entries: int, n_theta: int) -> Cache:
        """Return a cache that holds nothing yet."""
        n_coefficients = N_COEFFICIENTS**n_theta
        return cls(
            np.full((n_blocks, LANES), -1, dtype=np.int64),
            aligned_zeros((n_blocks, n_entries, n_coefficients, LANES)),
            aligned_zeros((n_blocks, n_load_entries, n_coefficients, LANES)),
        )


@njit(cache=True, error_model="numpy")
def locate(theta, grid):
    """Return the cell of a theta on one coordinate's grid and its place in it, from 0 to 1."""
    position = (theta - grid.lower) / grid.step
    cell = int(np.floor(position))
    if grid.periodic:
        return cell % grid.n_cells, position - cell
    cell = min(max(cell, 0), grid.n_cells - 1)
    return cell, position - cell


@njit(inline="always")
def locate_all(q, sample, grid, lane, place):
    """Return the number of the cell of a sample's q (n_samples, n_eta); fill its place in it.

    The place is a lane of `place` (n_theta, LANES). What is not a number, or out of all measure, is put at the lower
    end: the sample is lost, but has a cell.
    """
    cell = 0
    for k in range(len(grid)):
        theta = q[sample, k]
        if not abs(theta) < 1e9:
            theta = grid[k].lower
        along, place[k, lane] = locate(theta, grid[k])
        cell = cell * grid[k].n_cells + along
    return cell


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def refill(table, cell, weights, slots, n_entries, lane, kept):
    """Put the weighted sum of a cell's terms into one lane of `kept` (n_kept, 4**n_theta, LANES).

    Parameters
    ----------
    table
        Shape (n_cells, n_terms, 4**n_theta, n_entries).
    weights
        Of the terms, shape (n_terms,).
    slots
        Which group of `n_entries` rows of `kept` each term is added to, shape (n_terms,).
    """
    total = np.zeros(kept.shape[0])
    for k in range(kept.shape[1]):
        total[:] = 0.0
        for t in range(weights.size):
            first, weight = slots[t] * n_entries, weights[t]
            row = table[cell, t, k]
            for e in range(n_entries):
                total[first + e] += weight * row[e]
        for e in range(kept.shape[0]):
            kept[e, k, lane] = total[e]


@njit(inline="always")
def _cubic(c0, c1, c2, c3, s):
    return c0 + s * (c1 + s * (c2 + s * c3))


@njit(inline="always")
def _cubic_slope(c1, c2, c3, s):
    return c1 + s * (2.0 * c2 + 3.0 * s * c3)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def evaluate(kept, first, end, place, grid, values, slopes):
    """Evaluate entries first to end - 1 of kept polynomials, and their derivatives with theta.

    Parameters
    ----------
    kept
        Shape (n_entries, 4**n_theta, LANES).
    place
        In the cell, shape (n_theta, LANES).
    values, slopes
        Results, shapes (n_entries, LANES) and (n_theta, n_entries, LANES).
    """
    n_lanes = values.shape[1]
    rate = 1.0 / grid[0].step
    if len(grid) == 1:
        for e in range(first, end):
            for lane in range(n_lanes):
                s = place[0, lane]
                c1, c2, c3 = kept[e, 1, lane], kept[e, 2, lane], kept[e, 3, lane]
                values[e, lane] = _cubic(kept[e, 0, lane], c1, c2, c3, s)
                slopes[0, e, lane] = _cubic_slope(c1, c2, c3, s) * rate
        return
    other_rate = 1.0 / grid[-1].step
    for e in range(first, end):
        c = kept[e]
        for lane in range(n_lanes):
            s, t = place[0, lane], place[-1, lane]
            p0 = _cubic(c[0, lane], c[1, lane], c[2, lane], c[3, lane], t)
            p1 = _cubic(c[4, lane], c[5, lane], c[6, lane], c[7, lane], t)
            p2 = _cubic(c[8, lane], c[9, lane], c[10, lane], c[11, lane], t)
            p3 = _cubic(c[12, lane], c[13, lane], c[14, lane], c[15, lane], t)
            d0 = _cubic_slope(c[1, lane], c[2, lane], c[3, lane], t)
            d1 = _cubic_slope(c[5, lane], c[6, lane], c[7, lane], t)
            d2 = _cubic_slope(c[9, lane], c[10, lane], c[11, lane], t)
            d3 = _cubic_slope(c[13, lane], c[14, lane], c[15, lane], t)
            values[e, lane] = _cubic(p0, p1, p2, p3, s)
            slopes[0, e, lane] = _cubic_slope(p1, p2, p3, s) * rate
            slopes[-1, e, lane] = _cubic(d0, d1, d2, d3, s) * other_rate


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def evaluate_values(kept, first, end, place, grid, values):
    """Evaluate entries first to end - 1 of kept polynomials without their derivatives; see `evaluate`."""
    n_lanes = values.shape[1]
    for e in range(first, end):
        c = kept[e]
        for lane in range(n_lanes):
            s, t = place[0, lane], place[-1, lane]
            values[e, lane] = _cubic(c[0, lane], c[1, lane], c[2, lane], c[3, lane], t)
            if len(grid) == 2:
                p1 = _cubic(c[4, lane], c[5, lane], c[6, lane], c[7, lane], t)
                p2 = _cubic(c[8, lane], c[9, lane], c[10, lane], c[11, lane], t)
                p3 = _cubic(c[12, lane], c[13, lane], c[14, lane], c[15, lane], t)
                values[e, lane] = _cubic(values[e, lane], p1, p2, p3, s)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def evaluate_directly(table, cells, grid, weights, first, count, place, values, slopes):
    """Evaluate all entries of a table (n_cells, n_terms, 4**n_theta, n_entries), weighted, lane by lane.

    For few entries on a grid so fine that nothing is gained by keeping its cells.

    Parameters
    ----------
    cells
        Cell of every lane, shape (LANES,).
    weights
        Of the terms, shape (n_samples, n_terms); the lanes have samples first to first + count - 1, the last one again
        in all lanes that are left.
    place
        In the cell, shape (n_theta, LANES).
    values, slopes
        Results, shapes (n_entries or more, LANES) and (n_theta, n_entries or more, LANES).
    """
    rate, other_rate = 1.0 / grid[0].step, 1.0 / grid[-1].step
    for lane in range(values.shape[1]):
        s, t, cell, sample = place[0, lane], place[-1, lane], cells[lane], first + min(lane, count - 1)
        for e in range(table.shape[3]):
            value, slope, other_slope = 0.0, 0.0, 0.0
            for term in range(weights.shape[1]):
                c, weight = table[cell, term], weights[sample, term]
                if len(grid) == 1:
                    value += weight * _cubic(c[0, e], c[1, e], c[2, e], c[3, e], s)
                    slope += weight * _cubic_slope(c[1, e], c[2, e], c[3, e], s)
                else:
                    p0 = _cubic(c[0, e], c[1, e], c[2, e], c[3, e], t)
                    p1 = _cubic(c[4, e], c[5, e], c[6, e], c[7, e], t)
                    p2 = _cubic(c[8, e], c[9, e], c[10, e], c[11, e], t)
                    p3 = _cubic(c[12, e], c[13, e], c[14, e], c[15, e], t)
                    d0, d1 = _cubic_slope(c[1, e], c[2, e], c[3, e], t), _cubic_slope(c[5, e], c[6, e], c[7, e], t)
                    d2, d3 = _cubic_slope(c[9, e], c[10, e], c[11, e], t), _cubic_slope(c[13, e], c[14, e], c[15, e], t)
                    value += weight * _cubic(p0, p1, p2, p3, s)
                    slope += weight * _cubic_slope(p1, p2, p3, s)
                    other_slope += weight * _cubic(d0, d1, d2, d3, s)
            values[e, lane] = value
            slopes[0, e, lane] = slope * rate
            if len(grid) == 2:
                slopes[-1, e, lane] = other_slope * other_rate


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def evaluate_row(polynomials, grid, s, t, values, slopes):
    """Evaluate the polynomials (4**n_theta, n_entries) of one cell at one place in it, entry beside entry.

    Parameters
    ----------
    s, t
        Place in the cell along the first and the last coordinate.
    values, slopes
        Results, shapes (n_entries,) and (n_theta, n_entries).
    """
    c = polynomials
    rate, other_rate = 1.0 / grid[0].step, 1.0 / grid[-1].step
    for e in range(values.size):
        if len(grid) == 1:
            values[e] = _cubic(c[0, e], c[1, e], c[2, e], c[3, e], s)
            slopes[0, e] = _cubic_slope(c[1, e], c[2, e], c[3, e], s) * rate
        else:
            p0 = _cubic(c[0, e], c[1, e], c[2, e], c[3, e], t)
            p1 = _cubic(c[4, e], c[5, e], c[6, e], c[7, e], t)
            p2 = _cubic(c[8, e], c[9, e], c[10, e], c[11, e], t)
            p3 = _cubic(c[12, e], c[13, e], c[14, e], c[15, e], t)
            d0, d1 = _cubic_slope(c[1, e], c[2, e], c[3, e], t), _cubic_slope(c[5, e], c[6, e], c[7, e], t)
            d2, d3 = _cubic_slope(c[9, e], c[10, e], c[11, e], t), _cubic_slope(c[13, e], c[14, e], c[15, e], t)
            values[e] = _cubic(p0, p1, p2, p3, s)
            slopes[0, e] = _cubic_slope(p1, p2, p3, s) * rate
            slopes[-1, e] = _cubic(d0, d1, d2, d3, s) * other_rate
