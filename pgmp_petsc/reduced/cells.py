"""Interpolated tables of LANES samples at once: a polynomial in each cell of the grid, compiled.

A sample stays in one cell of a table for many steps. Its polynomial there, cubic in each rigid coordinate, all terms
already weighted with the sample's own parameters, is kept until it leaves the cell. The number of coordinates is the
length of a grid, which the compiler knows.
"""

from __future__ import annotations

from typing import NamedTuple

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.vectors import (
    N_POWERS,
    absolute,
    blend,
    exceeding,
    floor,
    larger,
    load,
    number_at,
    spread,
    store,
)

FURTHEST = 1e9  # rad


class Grid(NamedTuple):
    """Cells of equal width of one coordinate; the first begins at `lower` (rad)."""

    lower: float
    step: float
    n_cells: int
    periodic: bool


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
        # division of vectors takes as long as twenty products: it is done once, of numbers
        position = (theta - grid[k].lower) * (1.0 / grid[k].step)
        cell = floor(position)
        if grid[k].periodic:
            # half a cell on, so that the round-off of the quotient does not reach the next whole number
            number = number * n + (cell - n * floor((cell + 0.5) * (1.0 / n)))
        else:
            cell = larger(cell, spread(0.0))
            cell = blend(exceeding(cell, spread(n - 1.0)), spread(n - 1.0), cell)
            number = number * n + cell
        store(place, k, (position - cell) * grid[k].step)
    return number


@njit(inline="always")
def _put(kept, row, lanes, x):
    """Put some lanes of a vector into a row."""
    store(kept, row, blend(lanes, x, load(kept, row)))


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
        Coefficients to fill, multiples of N_POWERS: so many have their sums side by side.
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
        into, start = slots[t] * table.shape[2], (cell * table.shape[1] + t) * table.shape[2]
        for c in range(first, end, N_POWERS):
            at, weight = start + c, load(weights, t)
            one, two = number_at(table, at) * weight, number_at(table, at + 1) * weight
            three, four = number_at(table, at + 2) * weight, number_at(table, at + 3) * weight
            for term in range(t + 1, behind):
                at, weight = at + table.shape[2], load(weights, term)
                one, two = one + number_at(table, at) * weight, two + number_at(table, at + 1) * weight
                three, four = three + number_at(table, at + 2) * weight, four + number_at(table, at + 3) * weight
            _put(kept, into + c, lanes, one)
            _put(kept, into + c + 1, lanes, two)
            _put(kept, into + c + 2, lanes, three)
            _put(kept, into + c + 3, lanes, four)
        t = behind
