"""Interpolated tables of LANES samples at once: a polynomial in each cell of the grid, compiled.

A sample stays in one cell of a table for many steps. Its polynomial there, cubic in each rigid coordinate, all terms
already weighted with the sample's own parameters, is kept until it leaves the cell. The number of coordinates is the
length of a grid, which the compiler knows.

The coefficients of a cell follow from the rows of an interpolant (`reduction.interpolation`) that reach into it, one
coordinate after the other,

    c_ij.. = sum_a B1_ia sum_b B2_jb ... rows_ab..,

with the matrix B of the cell along each coordinate. They are made when a sample enters the cell, and stay, for the
samples beside it and those that come later, until their room is needed: the coefficients of all cells would be 4 or 16
times the rows over one or two coordinates, and 64 times over three. Neighbouring cells may have one polynomial
(`Grid.begins`), which a sample keeps from one to the next.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import absolute, floor
from pgmp_petsc.lanes.vectors import (
    EVERY_LANE,
    LANES,
    N_POWERS,
    beyond,
    differing,
    equal,
    first_lane,
    larger,
    load,
    number_at,
    select,
    spread,
    store,
)
from pgmp_petsc.reduction.cell_products import N_ROWS, OVERHAUSER, Axis, count_rows, stencil
from pgmp_petsc.reduction.interpolation import Interpolant

FURTHEST = 1e9  # rad
FEWEST_HELD, MOST_HELD = 16, 2**22  # cells of which polynomials are held, and numbers that these take: 32 MB


class Grid(NamedTuple):
    """Cells of equal width of one coordinate; the first begins at `lower` (rad)."""

    lower: float
    step: float
    n_cells: int
    periodic: bool
    #: the cell in which the polynomial of each one begins, (n_cells,): itself, or one before it
    begins: np.ndarray

    @classmethod
    def even(cls, lower: float, step: float, n_cells: int, periodic: bool) -> Grid:
        """Return cells each of which has a polynomial of its own."""
        return cls(lower, step, n_cells, periodic, np.arange(float(n_cells)))


class Cells(NamedTuple):
    """Polynomials in cells of a table, of places in rad from their lower ends, and what they are made from."""

    #: coefficients one after the other, shape (n_held, n_terms, n_entries * n_powers**n_theta), those of the last
    #: coordinate fastest
    polynomials: np.ndarray
    held: np.ndarray  # numbers of the cells that they are of, -1 for none, shape (n_held,)
    rows: np.ndarray  # rows of the table, the last coordinate fastest, shape (n_rows, n_terms, n_entries)
    counts: np.ndarray  # of cells and of rows along each coordinate, shape (n_theta, 2)
    #: stencils, matrices: numbers of the rows that reach into a cell along a coordinate, shape (n_theta, n_cells,
    #: n_reach), and coefficients from these, (n_theta, n_cells, n_powers, n_reach); of other coordinates' cells zero
    stencils: np.ndarray
    matrices: np.ndarray
    room: np.ndarray  # for sums over some of the coordinates, shape (2, n)

    @classmethod
    def of(cls, part: Interpolant, grid: Sequence[Grid], n_powers: int = N_POWERS) -> Cells:
        """Return polynomials through an interpolant of tables (n_terms, n_entries), in cells of a grid over its range.

        They go through it at the Chebyshev points of a cell along every coordinate: cubic ones in cells within those of
        the interpolant are the interpolant itself.
        """
        found = [_along(axis, cells, n_powers) for axis, cells in zip(part.axes, grid)]
        counts = np.array([(cells.n_cells, count_rows(axis)) for axis, cells in zip(part.axes, grid)])
        n_cells, n_reach = counts[:, 0].max(), max(stencils.shape[1] for stencils, _ in found)
        all_stencils = np.zeros((len(grid), n_cells, n_reach), dtype=np.int64)
        all_matrices = np.zeros((len(grid), n_cells, n_powers, n_reach))
        for k, (stencils, matrices) in enumerate(found):
            all_stencils[k, : len(stencils), : stencils.shape[1]] = stencils
            all_matrices[k, : len(stencils), :, : stencils.shape[1]] = matrices
        nothing = np.empty((0, 0, 0)), np.empty(0, dtype=np.int64), np.empty((0, 0, 0))
        empty = cls(*nothing, counts, all_stencils, all_matrices, np.empty((0, 0)))
        return empty.with_rows(part.rows.reshape(math.prod(counts[:, 1]), *part.shape))

    @classmethod
    def none(cls, n_theta: int) -> Cells:
        """Return those of a table without entries."""
        nowhere = (Axis(0.0, 1.0, 1, True, OVERHAUSER),) * n_theta
        nothing = Interpolant(nowhere, np.zeros((*(1,) * n_theta, 1, 0)))
        return cls.of(nothing, (Grid.even(0.0, 1.0, 1, True),) * n_theta)

    def with_rows(self, rows: np.ndarray) -> Cells:
        """Return those of another table over the same cells, none of which is held yet."""
        (_, n_terms, n_entries), (n_theta, _, n_powers, n_reach) = rows.shape, self.matrices.shape
        n_coefficients, n_cells = n_entries * n_powers**n_theta, math.prod(self.counts[:, 0])
        n_held = min(n_cells, max(FEWEST_HELD, MOST_HELD // max(n_terms * n_coefficients, 1)))
        return self._replace(
            polynomials=np.zeros((n_held, n_terms, n_coefficients)),
            held=np.full(n_held, -1),
            rows=rows,
            room=np.empty((2, n_terms * n_entries * max(n_powers, n_reach) ** n_theta)),
        )


def _along(axis: Axis, cells: Grid, n_powers: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows (n_cells, n_reach) that reach into cells along an axis, and the coefficients that they make,
    (n_cells, n_powers, n_reach)."""
    places, first = 0.5 - 0.5 * np.cos(np.pi * (np.arange(n_powers) + 0.5) / n_powers), cells.begins.astype(int)
    widths = np.bincount(first, minlength=cells.n_cells)  # of polynomials that begin there, in cells; or 0
    rows = np.empty((cells.n_cells, n_powers, N_ROWS), dtype=np.int64)
    weights, n_rows = np.empty(rows.shape), count_rows(axis)
    _fill_stencils(axis, cells.lower, cells.step, np.maximum(widths, 1)[:, None] * places, rows, weights)
    ahead = rows[:, :, 0] - rows[:, :1, 0]
    ahead = ahead % n_rows if axis.periodic else ahead
    n_more = int(ahead.max())
    further = rows[:, 0, -1:] + 1 + np.arange(n_more)
    further = further % n_rows if axis.periodic else np.minimum(further, n_rows - 1)
    values = np.zeros((cells.n_cells, n_powers, N_ROWS + n_more))
    number = np.arange(cells.n_cells)[:, None]
    for j in range(N_ROWS):
        values[number, np.arange(n_powers), ahead + j] += weights[:, :, j]
    powers, lengths = np.arange(n_powers), cells.step * np.maximum(widths, 1)[:, None, None]
    made = np.linalg.inv(np.vander(places, increasing=True)) / lengths ** powers[:, None] @ values
    # a polynomial that began in a cell before, about the lower end of this one
    moved = (number - first[:, None])[..., None] * cells.step
    shift = scipy.special.comb(powers, powers[:, None]) * moved ** np.maximum(powers - powers[:, None], 0)
    return np.concatenate([rows[:, 0], further], axis=1)[first], shift @ made[first]


@njit(cache=True, entry=True, error_model="numpy")
def _fill_stencils(axis, lower, step, places, rows, weights):
    """Fill rows and weights (n_cells, n, 4) of an axis at places (n_cells, n), in cells, from their lower ends on."""
    slopes = np.empty(N_ROWS)
    for cell in range(rows.shape[0]):
        for k in range(places.shape[1]):
            stencil(lower + (cell + places[cell, k]) * step, axis, rows[cell, k], weights[cell, k], slopes)


@njit(cache=True, apart=True, error_model="numpy", fastmath={"contract"})
def _make(rows, counts, stencils, matrices, cell, room, made):
    """Fill the polynomials (n_terms, n_coefficients) of a cell; see `Cells`."""
    r, n_powers, n_reach = matrices.shape[0], matrices.shape[2], matrices.shape[3]
    n_entries, size = rows.shape[2], rows.shape[1] * rows.shape[2]
    number = np.empty(r, dtype=np.int64)
    for k in range(r - 1, -1, -1):
        number[k] = cell % counts[k, 0]
        cell //= counts[k, 0]
    before, behind = room[0], room[1]
    for place in range(n_reach**r):
        row, left, scale = 0, place, n_reach ** (r - 1)
        for k in range(r):
            row = row * counts[k, 1] + stencils[k, number[k], left // scale]
            left, scale = left % scale, max(scale // n_reach, 1)
        for t in range(rows.shape[1]):
            for e in range(n_entries):
                before[place * size + t * n_entries + e] = rows[row, t, e]
    n_left, n_right = n_reach ** (r - 1), size
    for k in range(r - 1, -1, -1):
        matrix = matrices[k, number[k]]
        for left in range(n_left):
            for power in range(n_powers):
                to = (left * n_powers + power) * n_right
                for i in range(n_right):
                    behind[to + i] = 0.0
                for j in range(n_reach):
                    factor, of = matrix[power, j], (left * n_reach + j) * n_right
                    for i in range(n_right):
                        behind[to + i] += factor * before[of + i]
        n_left, n_right = n_left // n_reach, n_right * n_powers
        before, behind = behind, before
    n_all = n_powers**r
    for power in range(n_all):
        for t in range(rows.shape[1]):
            for e in range(n_entries):
                made[t, e * n_all + power] = before[power * size + t * n_entries + e]


@njit(error_model="numpy", counted=False)
def place_of(cells, cell):
    """Return where among the polynomials those of a cell are; made where they are not there."""
    place = cell % cells.held.size
    if cells.held[place] != cell:
        cells.held[place] = cell
        _make(cells.rows, cells.counts, cells.stencils, cells.matrices, cell, cells.room, cells.polynomials[place])
    return place


@njit(inline="always")
def enter_cells(q, grid, place, kept, row):
    """Return the set of lanes in which vectors q (n_theta or more, LANES) are in other cells than kept before.

    Fills a row of kept numbers of cells, and the places in the cells, rad from their lower ends, (n_theta, LANES). What
    is not a number, or out of all measure, is put at the lower end: the sample is lost, but has a cell.
    """
    number = spread(0.0)
    for k in range(len(grid)):
        theta, n = load(q, k), float(grid[k].n_cells)
        theta = select(beyond(absolute(theta), spread(FURTHEST)), spread(grid[k].lower), theta)
        # division of vectors takes as long as twenty products: it is done once, of numbers
        position = (theta - grid[k].lower) * (1.0 / grid[k].step)
        cell = floor(position)
        if grid[k].periodic:
            # half a cell on, so that the round-off of the quotient does not reach the next whole number
            inside = cell - n * floor((cell + 0.5) * (1.0 / n))
        else:
            cell = larger(cell, spread(0.0))
            inside = cell = select(beyond(cell, spread(n - 1.0)), spread(n - 1.0), cell)
        store(place, k, inside)
        for lane in range(LANES):
            place[k, lane] = grid[k].begins[int(place[k, lane])]
        begin = load(place, k)
        number = number * n + begin
        store(place, k, (position - cell + (inside - begin)) * grid[k].step)
    moved = differing(number, load(kept, row))
    store(kept, row, number)
    return moved


@njit(cache=True, error_model="numpy", fastmath={"contract"}, counted=False)
def refill(cells, numbers, moved, weights, slots, first, kept):
    """Put the weighted sums of the terms of cells into kept polynomials, (n_slots * n_coefficients, LANES).

    Numbers are those of every lane's cell (LANES,); only lanes that moved are filled. Weights of the terms are vectors
    (n_terms, LANES), and each is added to one of the groups of coefficients, `slots`, increasing, (n_terms,).
    Coefficients are filled from `first` on, a multiple of N_POWERS.
    """
    if moved == EVERY_LANE and equal(load(numbers, 0), spread(numbers[0])) == EVERY_LANE:
        _fill_all(cells.polynomials, place_of(cells, int(numbers[0])), weights, slots, first, kept)
        return
    while moved != 0:
        # lane by lane, as samples enter a cell one by one: some processors take as long for the stores of parts of a
        # vector as for all the sums
        lane = first_lane(moved)
        moved &= moved - 1
        made = cells.polynomials[place_of(cells, int(numbers[lane]))]
        _fill_lane(made, lane, weights, slots, first, cells.room[0], kept)


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _fill_lane(made, lane, weights, slots, first, room, kept):
    """Fill one lane from polynomials (n_terms, n_coefficients); sums are made side by side, then dealt out."""
    sums = room[: made.shape[1] - first]
    for t in range(slots.size):
        weight, of = weights[t, lane], made[t, first:]
        if t == 0 or slots[t] != slots[t - 1]:
            for c in range(sums.size):
                sums[c] = of[c] * weight
        else:
            for c in range(sums.size):
                sums[c] += of[c] * weight
        if t + 1 == slots.size or slots[t] != slots[t + 1]:
            into = kept[slots[t] * made.shape[1] + first :, lane]
            for c in range(sums.size):
                into[c] = sums[c]


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _fill_all(table, place, weights, slots, first, kept):
    """Fill all lanes from a place among polynomials; N_POWERS coefficients have their sums side by side."""
    end, t = table.shape[2], 0
    while t < slots.size:
        behind = t
        while behind < slots.size and slots[behind] == slots[t]:
            behind += 1
        into, start = slots[t] * end, (place * table.shape[1] + t) * end
        for c in range(first, end, N_POWERS):
            at, weight = start + c, load(weights, t)
            one, two = number_at(table, at) * weight, number_at(table, at + 1) * weight
            three, four = number_at(table, at + 2) * weight, number_at(table, at + 3) * weight
            for term in range(t + 1, behind):
                at, weight = at + end, load(weights, term)
                one, two = one + number_at(table, at) * weight, two + number_at(table, at + 1) * weight
                three, four = three + number_at(table, at + 2) * weight, four + number_at(table, at + 3) * weight
            store(kept, into + c, one)
            store(kept, into + c + 1, two)
            store(kept, into + c + 2, three)
            store(kept, into + c + 3, four)
        t = behind
