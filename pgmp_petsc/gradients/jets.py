"""Weighted tables of the reduced model with their first and second derivatives at LANES places of a cell; compiled.

In a cell every entry of a table is a polynomial of the place (`reduced.arrays.Tables`). With the weights w of
one sample, or their derivatives with a parameter, in place of those of all terms,

    A = sum_t w_t sum_c C_tc prod_k x_k^(c_k),

and a jet of it has the value, the slopes ``d_k A`` and the second derivatives ``d_k d_l A``, those of each
slope together: jets of all entries are vectors (n_entries, n_jets, LANES).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pgmp_petsc.runtime.compiled import njit
from pgmp_petsc.runtime.tiles import store_rows
from pgmp_petsc.runtime.vectors import (
    N_POWERS,
    N_POWERS_OF_RIGID,
    coefficients_of,
    derivatives,
    join,
    load_rows,
    parts_of,
    vector,
)


def n_jets(r: int) -> int:
    """Return how many numbers a jet with r coordinates has."""
    return 1 + r + r * r


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def weigh(terms, weights, coefficients):
    """Fill coefficients (n,), numbers or vectors, with the sum of terms (n_terms, n) with weights of their kind."""
    nothing = 0.0 * weights[0]
    for c in range(coefficients.size):
        coefficients[c] = nothing
    for t in range(terms.shape[0]):
        for c in range(coefficients.size):
            coefficients[c] += weights[t] * terms[t, c]


def _jet(n_powers: int, order: int, about: str) -> Callable:
    @intrinsic
    def function(typing, coefficients, entry, place):
        r = len(place)
        wanted = [which for total in range(order + 1) for which in product(range(r), repeat=total)]

        def build(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
            rows = coefficients_of(context, builder, sig, args, n_powers)
            found = derivatives(builder, rows, parts_of(builder, args[2], r), n_powers, order)
            return join(builder, [found[tuple(which.count(k) for k in range(r))] for which in wanted])

        return types.UniTuple(vector, len(wanted))(coefficients, types.intp, place), build

    function.__doc__ = about
    return function


# Of a polynomial with coefficients (n_entries * n_powers^r,), the same numbers in all lanes, or vectors (..., LANES)
_jet_of = _jet(N_POWERS, 2, "Return the jet of an entry, cubic in each coordinate.")
_slopes_of = _jet(N_POWERS, 1, "Return value and slopes of an entry, cubic in each coordinate.")
_rigid_jet_of = _jet(N_POWERS_OF_RIGID, 2, "Return the jet of an entry of degree 7.")
_rigid_slopes_of = _jet(N_POWERS_OF_RIGID, 1, "Return value and slopes of an entry of degree 7.")


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_jets(coefficients, places, rigid, first, n_entries, whole, jets):
    """Fill the jets of entries from one on, at places (n_theta, LANES): value and slopes, and if `whole` the rest.

    `rigid` is a tuple as long as there are coordinates.
    """
    place, n = load_rows(places, 0, 1, rigid), jets.shape[1]
    for e in range(first, n_entries):
        if whole:
            store_rows(jets, e * n, _jet_of(coefficients, e, place))
        else:
            store_rows(jets, e * n, _slopes_of(coefficients, e, place))


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_rigid_jets(coefficients, places, rigid, n_entries, whole, jets):
    """Fill the jets of the first entries with those of the rigid inertia; see `fill_jets`."""
    place, n = load_rows(places, 0, 1, rigid), jets.shape[1]
    for e in range(n_entries):
        if whole:
            store_rows(jets, e * n, _rigid_jet_of(coefficients, e, place))
        else:
            store_rows(jets, e * n, _rigid_slopes_of(coefficients, e, place))
