"""Ties of second order in the deformation in full-order samples on one rank, compiled; see `mechanism.curved_ties`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.dynamics.full_forces import add_entry_of_lane
from pgmp_petsc.dynamics.layout import Layout
from pgmp_petsc.mechanism.curved_ties import CurvedTies, Quadratics
from pgmp_petsc.mechanism.frame_ties import director
from pgmp_petsc.runtime.compiled import njit


class Curved(NamedTuple):
    """Products ``f d x y`` of ties that are here.

    Attributes
    ----------
    rows, frames, directors, first, second, factors
        As in `Quadratics`, rows being places among the constraints here, and unknowns those here.
    turning
        The unknown of its frame that each depends on, shape (n,).
    positions
        Where the matrix stores the derivatives in x, in y and in the frame, and the second ones in x and y, in the
        frame and x, in the frame and y, and in the plane in the angle.
    """

    rows: np.ndarray
    frames: np.ndarray
    directors: np.ndarray
    first: np.ndarray
    second: np.ndarray
    factors: np.ndarray
    turning: np.ndarray
    positions: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class CurvedParts:
    """The products of a rank before their place in the matrix is known.

    Parameters
    ----------
    ties
        Those of a mechanism.
    places
        Place of every tie among the constraints here, -1 where it is not, shape (n_ties,).
    multipliers
        Number that the multiplier of every tie has among all unknowns and multipliers, shape (n_ties,).

    Attributes
    ----------
    entries
        Rows and columns of the entries, in the order of `Curved.positions`.
    """

    def __init__(self, ties: CurvedTies, places: np.ndarray, multipliers: np.ndarray) -> None:
        here = places[ties.products.rows] >= 0
        p = self._products = Quadratics(*(part[here] for part in ties.products))
        self._turning, self._places = ties.turning[here], places
        rows, turning = multipliers[p.rows], self._turning
        self.entries = [
            (rows, p.first), (rows, p.second), (rows, turning), (p.first, p.second), (turning, p.first),
            (turning, p.second), (turning, turning),
        ]  # fmt: skip

    def placed(self, layout: Layout) -> Curved:
        """Return them in the numbering of a layout."""
        p = self._products
        frames, first, second = (layout.unknowns(part) for part in (p.frames, p.first, p.second))
        positions = tuple(layout.positions(*entries) for entries in self.entries)
        rows, turning = self._places[p.rows], layout.unknowns(self._turning)
        return Curved(rows, frames, p.directors, first, second, p.factors, turning, positions)


@njit(cache=True, error_model="numpy")
def add_curved_ties(curved, d, itself, q, multipliers, scale, gain_k, fresh, x, place, diagonal, lower):
    """Add what ties have of second order; see `node_constraints.add_constraints`."""
    n_dofs, n_lanes = q.shape
    of_first, of_second, of_turn, of_pair, mixed, also_mixed, twice = curved.positions
    for e in range(curved.rows.size):
        one, other, turning = curved.first[e], curved.second[e], curved.turning[e]
        number, factor, count = curved.rows[e], curved.factors[e], 2.0 if one == other else 1.0
        for lane in range(n_lanes):
            along, slope = director(d, curved, e, q, lane)
            if d == 3:
                slope = 1.0
            along, slope = factor * along, factor * slope
            here, there, force, scaled = q[one, lane], q[other, lane], multipliers[number, lane], scale[lane]
            x[place[one], lane] += along * there * force
            x[place[other], lane] += along * here * force
            x[place[turning], lane] += slope * here * there * force
            if itself:
                x[place[n_dofs + number], lane] += scaled * along * here * there
            if fresh:
                lower[of_first[e], lane] += scaled * along * there
                lower[of_second[e], lane] += scaled * along * here
                lower[of_turn[e], lane] += scaled * slope * here * there
                add_entry_of_lane(of_pair[e], lane, gain_k * count * along * force, diagonal, lower)
                add_entry_of_lane(mixed[e], lane, gain_k * slope * there * force, diagonal, lower)
                add_entry_of_lane(also_mixed[e], lane, gain_k * slope * here * force, diagonal, lower)
                if d == 2:  # d2 d_k / d phi2 = -d_k
                    add_entry_of_lane(twice[e], lane, -gain_k * along * here * there * force, diagonal, lower)
