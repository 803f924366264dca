"""Interpolated tables of LANES samples at once: a polynomial in each cell of the grid, compiled.

A sample stays in one cell of a table for many steps. Its polynomial there, cubic in each rigid coordinate, all terms
already weighted with the sample's own parameters, is kept until it leaves the cell. The number of coordinates is the
length of a grid, which the compiler knows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.runtime.vectors import absolute, blend, exceeding, floor, larger, load, spread, store
from pgmp_petsc.runtime.compiled import njit

FURTHEST = 1e9  # rad


class Grid(NamedTuple):
    """Cells of equal width of one coordinate; the first begins at `lower` (rad)."""

    lower: float
    step: float
    n_cells: int
    periodic: bool


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
def locate_all(q, grid, place):
    """Return the numbers of the cells of vectors q (n_theta or more, LANES), a vector of whole numbers.

    Fills the places in the cells, rad from their lower ends, (n_theta, LANES). What is not a number, or out of all
    measure, is put at the lower end: the sample is lost, but has a cell.
    """
    number = spread(0.0)
    for k in range(len(grid)):
        theta, n = load(q, k), float(grid[k].n_cells)
        theta = blend(exceeding(absolute(theta), spread(FURTHEST)), spread(grid[k].lower), theta)
        position = (theta - grid[k].lower) / grid[k].step
        cell = floor(position)
        if grid[k].periodic:
            number = number * n + (cell - n * floor(cell / n))
        else:
            cell = larger(cell, spread(0.0))
            cell = blend(exceeding(cell, spread(n - 1.0)), spread(n - 1.0), cell)
            number = number * n + cell
        store(place, k, (position - cell) * grid[k].step)
    return number


@njit(inline="always")
def locate_lane(q, grid, lane, place):
    """Return the number of the cell of one lane of q (n_theta or more, LANES); fill its place in it, from 0 to 1.

    The place is a lane of `place` (n_theta, LANES). What is not a number, or out of all measure, is put at the lower
    end: the sample is lost, but has a cell.
    """
    cell = 0
    for k in range(len(grid)):
        theta = q[k, lane]
        if not abs(theta) <= FURTHEST:
            theta = grid[k].lower
        along, place[k, lane] = locate(theta, grid[k])
        cell = cell * grid[k].n_cells + along
    return cell


@njit(cache=True, error_model="numpy", fastmath={"contract"}, counted=False)
def refill(table, cell, weights, slots, first, end, lanes, kept):
    """Put the weighted sums of a cell's terms into some lanes of kept polynomials.

    Parameters
    ----------
    table
        Coefficients one after the other, shape (n_cells, n_terms, n_coefficients).
    weights
        Of the terms, vectors (n_terms, LANES).
    slots
        Which group of coefficients each term is added to, in increasing order, shape (n_terms,).
    first, end
        Coefficients to fill.
    lanes
        The lanes that enter the cell.
    kept
        Vectors (n_slots * n_coefficients, LANES).
    """
    t = 0
    while t < slots.size:
        behind = t
        while behind < slots.size and slots[behind] == slots[t]:
            behind += 1
        into = slots[t] * table.shape[2]
        for c in range(first, end):
            total = load(weights, t) * table[cell, t, c]
            for term in range(t + 1, behind):
                total += load(weights, term) * table[cell, term, c]
            store(kept, into + c, blend(lanes, total, load(kept, into + c)))
        t = behind


@njit(inline="always")
def _cubic(c0, c1, c2, c3, s):
    return c0 + s * (c1 + s * (c2 + s * c3))


@njit(inline="always")
def _cubic_slope(c1, c2, c3, s):
    return c1 + s * (2.0 * c2 + 3.0 * s * c3)


@njit(cache=True, error_model="numpy", fastmath={"contract"}, counted=False)
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
