"""Weighted tables of the reduced model with their first and second derivatives at a place; compiled.

In a cell every entry of a table is a polynomial of the place (`dynamics.reduced_arrays.Tables`). With the weights w of
one sample, or their derivatives with a parameter, in place of those of all terms,

    A = sum_t w_t sum_c C_tc prod_k x_k^(c_k),

and a jet of it has the value, the slopes ``d_k A`` and the second derivatives ``d_k d_l A``, k >= l, in rows.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.runtime.compiled import njit


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


@njit(error_model="numpy")
def fill_basis(place, n_powers, basis):
    """Fill the monomials of a place and their derivatives, (n_jets, n_powers**n_theta); last coordinate fastest."""
    r = place.size
    powers, orders = np.zeros((r, 3, n_powers)), np.empty(r, dtype=np.int64)
    for k in range(r):
        for c in range(n_powers):
            powers[k, 0, c] = place[k] ** c
            powers[k, 1, c] = c * place[k] ** (c - 1) if c > 0 else 0.0
            powers[k, 2, c] = c * (c - 1) * place[k] ** (c - 2) if c > 1 else 0.0
    for c in range(basis.shape[1]):
        value, rest = 1.0, c
        for k in range(r - 1, -1, -1):
            orders[k], rest = rest % n_powers, rest // n_powers
            value *= powers[k, 0, orders[k]]
        basis[0, c] = value
        for k in range(r):
            for l in range(-1, k + 1):  # -1: the slope
                product = 1.0
                for h in range(r):
                    product *= powers[h, (h == k) + (h == l), orders[h]]
                basis[1 + k if l < 0 else second(r, k, l), c] = product


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def weigh(terms, weights, coefficients):
    """Fill the coefficients (n_c, n_entries) of weighted terms (n_terms, n_entries * n_c), n_c = n_powers**n_theta."""
    n_coefficients, n_entries = coefficients.shape
    coefficients[:] = 0.0
    for t in range(terms.shape[0]):
        if weights[t] != 0.0:
            for c in range(n_coefficients):
                for e in range(n_entries):
                    coefficients[c, e] += weights[t] * terms[t, e * n_coefficients + c]


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_jet(basis, coefficients, n_rows, jet):
    """Fill the first rows of the jet (n_jets, n_entries or more) of polynomials."""
    for row in range(n_rows):
        for e in range(coefficients.shape[1]):
            jet[row, e] = 0.0
        for c in range(coefficients.shape[0]):
            factor = basis[row, c]
            for e in range(coefficients.shape[1]):
                jet[row, e] += factor * coefficients[c, e]
