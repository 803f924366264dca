"""Interpolated tables at LANES thetas at once: a cubic polynomial in each cell of the grid, compiled.

A sample stays in one cell of a table for many steps. Its polynomial there, all terms already weighted with the
sample's own parameters, is kept until it leaves the cell; evaluating it is then the same short loop for every lane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from pgmp_petsc.dynamics.lanes import LANES

N_COEFFICIENTS = 4


class Grid(NamedTuple):
    """Cells of equal width; the first begins at `lower` (rad)."""

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
        Shape (n_blocks, n_entries, 4, LANES).
    loads
        A unit of every effect's amplitude, effect after effect, shape (n_blocks, n_effects * n_load_entries, 4, LANES).
    """

    cells: np.ndarray
    terms: np.ndarray
    loads: np.ndarray

    @classmethod
    def empty(cls, n_blocks: int, n_entries: int, n_load_entries: int) -> Cache:
        """Return a cache that holds nothing yet."""
        return cls(
            np.full((n_blocks, LANES), -1, dtype=np.int64),
            np.zeros((n_blocks, n_entries, N_COEFFICIENTS, LANES)),
            np.zeros((n_blocks, n_load_entries, N_COEFFICIENTS, LANES)),
        )


@njit(cache=True, error_model="numpy")
def locate(theta, grid):
    """Return the cell of a theta and its place in it, from 0 to 1."""
    position = (theta - grid.lower) / grid.step
    cell = int(np.floor(position))
    if grid.periodic:
        return cell % grid.n_cells, position - cell
    cell = min(max(cell, 0), grid.n_cells - 1)
    return cell, position - cell


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def refill(table, cell, weights, slots, n_entries, lane, kept):
    """Put the weighted sum of a cell's terms into one lane of `kept` (n_kept, 4, LANES).

    Parameters
    ----------
    table
        Shape (n_cells, n_terms, 4, n_entries).
    weights
        Of the terms, shape (n_terms,).
    slots
        Which group of `n_entries` rows of `kept` each term is added to, shape (n_terms,).
    """
    total = np.zeros(kept.shape[0])
    for k in range(N_COEFFICIENTS):
        total[:] = 0.0
        for t in range(weights.size):
            first, weight = slots[t] * n_entries, weights[t]
            row = table[cell, t, k]
            for e in range(n_entries):
                total[first + e] += weight * row[e]
        for e in range(kept.shape[0]):
            kept[e, k, lane] = total[e]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def evaluate(kept, n_entries, place, step, values, slopes):
    """Evaluate polynomials (n_entries, 4, LANES) and their derivatives with theta at `place` (LANES,) of the cell."""
    n_lanes = values.shape[1]
    rate = 1.0 / step
    for e in range(n_entries):
        for lane in range(n_lanes):
            s = place[lane]
            second, third = kept[e, 2, lane], kept[e, 3, lane]
            values[e, lane] = kept[e, 0, lane] + s * (kept[e, 1, lane] + s * (second + s * third))
            slopes[e, lane] = (kept[e, 1, lane] + s * (2.0 * second + 3.0 * s * third)) * rate


@njit(cache=True, error_model="numpy")
def evaluate_one(table, grid, theta, weights):
    """Return the first entry of a table (n_cells, n_terms, 4, n_entries), and its derivative, at one theta."""
    cell, s = locate(theta, grid)
    value, slope = 0.0, 0.0
    for t in range(weights.size):
        c = table[cell, t]
        value += weights[t] * (c[0, 0] + s * (c[1, 0] + s * (c[2, 0] + s * c[3, 0])))
        slope += weights[t] * (c[1, 0] + s * (2.0 * c[2, 0] + 3.0 * s * c[3, 0]))
    return value, slope / grid.step
