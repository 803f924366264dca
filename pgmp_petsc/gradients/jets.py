"""Weighted tables of the reduced model with their first and second derivatives at LANES places of a cell; compiled.

In a cell every entry of a table is a polynomial of the place (`dynamics.reduced_arrays.Tables`). With the weights w of
one sample, or their derivatives with a parameter, in place of those of all terms,

    A = sum_t w_t sum_c C_tc prod_k x_k^(c_k),

and a jet of it has the value, the slopes ``d_k A`` and the second derivatives ``d_k d_l A``, k >= l, in rows. Places,
monomials and jets are arrays of vectors without their axis of lanes (`lane_items.items`).
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.runtime.compiled import njit
from pgmp_petsc.runtime.vectors import spread


@njit(inline="always")
def n_jets(r):
    """Return the number of rows of a jet with r coordinates."""
    return 1 + r + r * (r + 1) // 2


@njit(inline="always")
def second(r, k, l):
    """Return the row of ``d_k d_l A`` in a jet."""
    return 1 + r + (k * (k + 1) // 2 + l if k >= l else l * (l + 1) // 2 + k)


@njit(error_model="numpy")
def cell_of(theta, grid, place):
    """Return the number of the cell of theta (n_theta or more,), and fill the place in it, rad; see `locate_all`."""
    number = 0
    for k in range(len(grid)):
        n = grid[k].n_cells
        position = (theta[k] - grid[k].lower) / grid[k].step
        cell = int(np.floor(position))
        place[k] = (position - cell) * grid[k].step
        if grid[k].periodic:
            cell = cell % n
        elif cell < 0 or cell > n - 1:
            inside = min(max(cell, 0), n - 1)
            place[k] += (cell - inside) * grid[k].step
            cell = inside
        number = number * n + cell
    return number


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_basis(r, place, n_powers, powers, orders, basis):
    """Fill the monomials of places (n_theta,) and their derivatives, (n_jets, n_powers**n_theta); last coordinate fastest.

    `powers` (n_theta, 3, n_powers or more) and `orders` (n_theta,) are room.
    """
    for k in range(r):
        powers[k, 0, 0], powers[k, 1, 0], powers[k, 2, 0] = spread(1.0), spread(0.0), spread(0.0)
        for c in range(1, n_powers):
            powers[k, 0, c] = powers[k, 0, c - 1] * place[k]
            powers[k, 1, c] = float(c) * powers[k, 0, c - 1]
            powers[k, 2, c] = float(c) * powers[k, 1, c - 1]
    for c in range(basis.shape[1]):
        rest = c
        for k in range(r - 1, -1, -1):
            orders[k], rest = rest % n_powers, rest // n_powers
        for k in range(-1, r):  # -1: the value
            for l in range(-1, k + 1):  # -1: the slope
                product = spread(1.0)
                for h in range(r):
                    product *= powers[h, int(h == k) + int(h == l), orders[h]]
                basis[0 if k < 0 else 1 + k if l < 0 else second(r, k, l), c] = product


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def weigh(terms, weights, coefficients):
    """Fill the coefficients (n_entries, n_c), n_c = n_powers**n_theta, with a weighted sum of terms.

    Terms are of shape (n_terms, n_entries * n_c), weights numbers or vectors (n_terms,), coefficients what these are.
    """
    n_entries, n_c = coefficients.shape
    nothing = 0.0 * weights[0]
    for e in range(n_entries):
        for c in range(n_c):
            coefficients[e, c] = nothing
    for t in range(terms.shape[0]):
        for e in range(n_entries):
            for c in range(n_c):
                coefficients[e, c] += weights[t] * terms[t, e * n_c + c]


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True, counted=False)
def fill_jet(basis, coefficients, n_rows, n_c, jet):
    """Fill the first rows of the jet (n_jets, n_entries or more) of polynomials, of numbers or vectors (n_entries, n_c)."""
    for e in range(coefficients.shape[0]):
        for row in range(n_rows):
            total = basis[row, 0] * coefficients[e, 0]
            for c in range(1, n_c):
                total += basis[row, c] * coefficients[e, c]
            jet[row, e] = total
