"""Factorisation of many small sparse symmetric matrices of one pattern at once.

The iteration matrices of a batch of full-order samples differ in their numbers only. Ordering and fill-in are found
once; the numeric factorisation ``L D L^T`` then runs over the common pattern, with the samples of a block side by side
in vectors (`lane_items`). A sample never touches another's numbers.

There is no pivoting: the matrices are saddle points ``[[S, C^T], [C, 0]]``, and the order of elimination makes every
leading block non-singular. With S positive definite at reasonable steps a constraint comes behind all unknowns that it
acts on, because C has full rank. Frames of faces have neither mass nor stiffness: first come the nodes of the mesh,
then the ties of the frames, which give the frames a pivot, then the frames, and then what acts on these.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import splu

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import fused

MOST_LISTED = 2**15  # products
MANY = 2**20  # products, from which on another order is looked for


@dataclass(frozen=True)
class Symbolic:
    """Elimination order and fill pattern."""

    order: np.ndarray  # ``order[k]`` is the unknown eliminated k-th, shape (n,)
    #: starts, rows: columns of L below the diagonal in elimination order: column k holds
    #: ``rows[starts[k]:starts[k+1]]``
    starts: np.ndarray
    rows: np.ndarray

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.order.size

    @cached_property
    def place(self) -> np.ndarray:
        """Turn of every unknown in the elimination, shape (n,)."""
        place = np.empty(self.n, dtype=np.int64)
        place[self.order] = np.arange(self.n)
        return place

    @property
    def n_products(self) -> np.ndarray:
        """Number of `products` of every column, shape (n,)."""
        n_below = np.diff(self.starts)
        return n_below * (n_below + 1) // 2

    @cached_property
    def products(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Products that the factorisation takes off, column by column.

        Of small matrices the first of each column, shape (n + 1,), and both factors of each and what it is taken from,
        (n_products,), numbered with the diagonal in front: columns of a mechanism of beams have a few entries each, and
        loops over them end before a processor has guessed that they will. Of larger ones nothing but, in place of what
        one product is taken from, where the stretches begin whose entries lie one behind the other in both columns, and
        how long they are, (n_stretches,).
        """
        firsts = np.concatenate([[0], np.cumsum(self.n_products)])
        if firsts[-1] > MOST_LISTED:
            n = _stretches(self.starts, self.rows, np.empty((2, 0), dtype=np.uint32))
            found = np.empty((2, n), dtype=np.uint32)
            _stretches(self.starts, self.rows, found)
            return firsts[:0], np.zeros(0, dtype=np.uint32), found[1], found[0]
        return firsts, *_listed(self.starts, self.rows, firsts)

    def position(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Return where matrix entries (unknown numbers) are stored: entry of L, or ``-1 - k`` on the diagonal."""
        first, second = self.place[np.asarray(row)], self.place[np.asarray(column)]
        lower, upper = np.maximum(first, second), np.minimum(first, second)
        return np.where(lower == upper, -1 - lower, np.searchsorted(self._keys, upper * self.n + lower))

    @cached_property
    def _keys(self) -> np.ndarray:
        """Numbers of the entries of L, column after column, each with growing rows."""
        return np.repeat(np.arange(self.n), np.diff(self.starts)) * self.n + self.rows


class Pattern(NamedTuple):
    """Numeric view of a symbolic factorisation; `place[unknown]` is its turn in the elimination."""

    place: np.ndarray
    starts: np.ndarray
    rows: np.ndarray
    products: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def analyse(pattern: sp.spmatrix, levels: np.ndarray) -> Symbolic:
    """Find an elimination order and the fill-in of a symmetric pattern, shape (n, n).

    Each unknown or multiplier is eliminated after all of lower `levels`, shape (n,), that it is coupled with. Otherwise
    the order is that of reverse Cuthill-McKee, which goes along slender bodies; with `MANY` products it is that of
    minimum degree where this has fewer: in bulky bodies a quarter.
    """
    pattern = sp.csr_matrix(pattern)
    found = _eliminated(reverse_cuthill_mckee(pattern, symmetric_mode=True), pattern, levels)
    if found.n_products.sum() > MANY:
        dominant = pattern.shape[0] * sp.identity(pattern.shape[0]) + (pattern != 0.0)
        without_pivoting = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
        columns = splu(dominant.tocsc(), permc_spec="MMD_AT_PLUS_A", **without_pivoting).perm_c
        other = _eliminated(np.argsort(columns), pattern, levels)
        found = min(found, other, key=lambda one: one.n_products.sum())
    return found


def _eliminated(order: np.ndarray, pattern: sp.csr_matrix, levels: np.ndarray) -> Symbolic:
    """Return the fill-in of an order that is changed as far as `levels` ask for."""
    order = _by_levels(order, pattern, levels)
    place = np.empty(order.size, dtype=np.int64)
    place[order] = np.arange(order.size)
    columns: list[set[int]] = [set() for _ in order]
    coo = pattern.tocoo()
    for i, j in zip(place[coo.row], place[coo.col]):
        if i > j:
            columns[j].add(int(i))
    for column in columns:
        if column:
            # fill-in: the first row below inherits the rest (elimination tree)
            parent = min(column)
            columns[parent] |= column - {parent}
    starts = np.concatenate([[0], np.cumsum([len(column) for column in columns])]).astype(np.int64)
    rows = np.array([i for column in columns for i in sorted(column)], dtype=np.int64)
    return Symbolic(order, starts, rows)


def _by_levels(order: np.ndarray, pattern: sp.csr_matrix, levels: np.ndarray) -> np.ndarray:
    """Move what has a level above 0 right behind the last of the lower levels that it is coupled with."""
    place = np.empty(order.size)
    place[order] = np.arange(order.size)
    for level in range(1, levels.max(initial=0) + 1):
        for number in np.flatnonzero(levels == level):
            neighbours = pattern.indices[pattern.indptr[number] : pattern.indptr[number + 1]]
            place[number] = max(place[neighbours[levels[neighbours] < level]], default=place[number]) + 0.25**level
    return np.argsort(place, kind="stable")


@njit(cache=True, error_model="numpy")
def _listed(starts, rows, firsts):
    """Return the two factors and the target of every product; see `Symbolic.products`."""
    n = starts.size - 1
    products, at = np.empty((3, firsts[n]), dtype=np.uint32), 0
    for k in range(n):
        for b in range(starts[k], starts[k + 1]):
            products[0, at], products[1, at], products[2, at] = n + b, n + b, rows[b]
            at += 1
            target = starts[rows[b]]
            for a in range(b + 1, starts[k + 1]):
                while rows[target] != rows[a]:
                    target += 1
                products[0, at], products[1, at], products[2, at] = n + b, n + a, n + target
                at += 1
    return products


@njit(cache=True, error_model="numpy")
def _stretches(starts, rows, found):
    """Count the stretches of products below the diagonal, and fill beginnings and lengths, (2, n), as far as there is
    room; see `Symbolic.products`."""
    n, count = starts.size - 1, 0
    for k in range(n):
        for b in range(starts[k], starts[k + 1]):
            a, at = b + 1, starts[rows[b]]
            while a < starts[k + 1]:
                # the rows below are among those of their column
                while rows[at] != rows[a]:
                    at += 1
                first = at
                while a < starts[k + 1] and at < starts[rows[b] + 1] and rows[at] == rows[a]:
                    a, at = a + 1, at + 1
                if count < found.shape[1]:
                    found[0, count], found[1, count] = n + first, at - first
                count += 1
    return count


@njit(cache=True, error_model="numpy")
def factorise(starts, rows, products, matrix):
    """Factorise in place by a symbolic factorisation: the diagonal becomes the inverse of D, and the rest ``L D``. The
    matrix has items (n + n_entries,), see `lane_items`: the diagonal in elimination order, and the entries below it.

    Of larger matrices two columns one behind the other with the same rows below both are taken off these together,
    which reads and writes what they are taken from once.
    """
    n = starts.size - 1
    firsts, one, other, target = products
    if firsts.size:
        for k in range(n):
            inverse = 1.0 / matrix[k]
            matrix[k] = inverse
            for at in range(firsts[k], firsts[k + 1]):
                matrix[target[at]] = fused(-(matrix[one[at]] * inverse), matrix[other[at]], matrix[target[at]])
        return
    k = stretch = 0
    while k < n:
        first, end, nothing = n + starts[k], n + starts[k + 1], 0.0 * matrix[k]
        inverse, gap = 1.0 / matrix[k], end - first - 1
        matrix[k] = inverse
        # the other rows of a column are among those of the column that has the number of its first
        if gap >= 0 and rows[starts[k]] == k + 1 and starts[k + 2] - starts[k + 1] == gap:
            stretch = _take_off(first, first + 1, end, inverse, 0, nothing, rows, products, stretch, matrix)
            second, before = 1.0 / matrix[k + 1], stretch
            matrix[k + 1] = second
            stretch = _take_off(first + 1, end, end, inverse, gap, second, rows, products, stretch, matrix)
            k, stretch = k + 2, 2 * stretch - before  # the second column has as many stretches
        else:
            k, stretch = k + 1, _take_off(first, end, end, inverse, 0, nothing, rows, products, stretch, matrix)


@njit(inline="always")
def _take_off(first, last, end, inverse, gap, second, rows, products, stretch, matrix):
    """Take off the products of a column's entries from a first one to a last, and of those so much behind them with the
    inverse of their own D; return the number of the stretch behind."""
    lengths, beginnings, n = products[2], products[3], matrix.size - rows.size
    for b in range(first, last):
        column, scaled, also, a = rows[b - n], -(matrix[b] * inverse), -(matrix[b + gap] * second), b + 1
        matrix[column] = fused(also, matrix[b + gap], fused(scaled, matrix[b], matrix[column]))
        while a < end:
            at, length = beginnings[stretch], lengths[stretch]
            one, other, into = matrix[a : a + length], matrix[a + gap : a + gap + length], matrix[at : at + length]
            for i in range(length):  # views, so that the loop is one of vectors
                into[i] = fused(also, other[i], fused(scaled, one[i], into[i]))
            a, stretch = a + length, stretch + 1
    return stretch


@njit(cache=True, error_model="numpy")
def substitute(starts, rows, matrix, x):
    """Solve ``L D L^T y = x`` in place, x items (n,) in elimination order."""
    n = starts.size - 1
    for k in range(n):
        known = x[k] * matrix[k]
        x[k] = known
        for a in range(starts[k], starts[k + 1]):
            x[rows[a]] = fused(-known, matrix[n + a], x[rows[a]])
    for k in range(n - 1, -1, -1):
        total = x[k] * 0.0
        for a in range(starts[k], starts[k + 1]):
            total = fused(matrix[n + a], x[rows[a]], total)
        x[k] = fused(-total, matrix[k], x[k])
