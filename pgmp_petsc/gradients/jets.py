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

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.tiles import store_rows
from pgmp_petsc.lanes.vectors import (
    CACHE_LINE,
    N_POWERS,
    N_POWERS_OF_RIGID,
    join,
    load_rows,
    parts_of,
    row_of,
    spread_number,
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


def _derivatives(
    builder: ir.IRBuilder, coefficient: Callable[[int], ir.Value], places: list[ir.Value], n_powers: int, order: int
) -> dict[tuple[int, ...], ir.Value]:
    """Build a polynomial and its derivatives up to an order, by how often each coordinate is differentiated with."""

    def along(level: int, first: int) -> dict[tuple[int, ...], ir.Value]:
        if level == len(places):
            return {(): coefficient(first)}
        stride, s = n_powers ** (len(places) - level - 1), places[level]
        inner = [along(level + 1, first + power * stride) for power in range(n_powers)]
        found = {}
        for others in inner[0]:
            # Horner's scheme, and what it makes of its own partial sums
            sums = [inner[-1][others]]
            for power in range(n_powers - 2, -1, -1):
                longer = [builder.fadd(builder.fmul(s, sums[0]), inner[power][others])]
                longer += [builder.fadd(builder.fmul(s, y), x) for x, y in zip(sums, sums[1:])]
                sums = (longer + sums[-1:])[: order - sum(others) + 1]
            for times, total in enumerate(sums):
                found[(times, *others)] = builder.fadd(total, total) if times == 2 else total
        return found

    return along(0, 0)


def _jet(n_powers: int, order: int, about: str) -> Callable:
    @intrinsic
    def function(typing, coefficients, entry, place):
        r = len(place)
        wanted = [which for total in range(order + 1) for which in product(range(r), repeat=total)]

        def build(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> ir.Value:
            base = builder.mul(args[1], ir.Constant(args[1].type, n_powers**r))

            def coefficient(number: int) -> ir.Value:
                at = builder.add(base, ir.Constant(base.type, number))
                if coefficients.ndim == 2:
                    return builder.load(row_of(context, builder, coefficients, args[0], at), align=CACHE_LINE)
                data = context.make_array(coefficients)(context, builder, args[0]).data
                return spread_number(builder, builder.load(builder.gep(data, [at])))

            found = _derivatives(builder, coefficient, parts_of(builder, args[2], r), n_powers, order)
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
