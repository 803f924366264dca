"""Constraints on the nodes of full-order samples on one rank, compiled: joints, rigid directors, drives and ties.

    c = s(y_a, y_b) - wanted - driven(t) = 0

with a statement s in the unknowns y of two nodes (`mechanism.statement_rows`), or the tie of a frame to faces or to a
floating frame (`mechanism.frame_ties`). Statements that are linear in the unknowns, all at nodes in the plane but the
lines that turn, are a row of numbers; the others are evaluated for every sample.

Directors that no mass belongs to make the matrix singular before their constraints are in it, and nothing is pivoted.
For the constraints g that make directors a rotation it therefore holds ``w G^T G`` too, and the residual ``w G^T g``:
the solution is the same for any weight w (the augmented Lagrangian of Glowinski and Le Tallec 1989).

Ties of second order in the deformation in full-order samples on one rank, compiled; see `mechanism.frame_ties`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.full.forces import add_entry, add_entry_of_lane
from pgmp_petsc.full.part_reference import loaded
from pgmp_petsc.full.rank_solver import Layout
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import items
from pgmp_petsc.mechanism.constraint_set import ConstraintSet
from pgmp_petsc.mechanism.frame_ties import PHI, Arms, CurvedTies, Products, Quadratics, director
from pgmp_petsc.mechanism.node_statements import scratch_of, state
from pgmp_petsc.mechanism.statement_rows import FROM_SUM, Rows


class Ties(NamedTuple):
    """Ties of frames to faces and floating frames."""

    #: linear, products, arms: as in `FrameTies`, rows being places among the constraints here, and unknowns those here
    linear: tuple[np.ndarray, np.ndarray, np.ndarray]
    products: Products
    arms: Arms
    turning: np.ndarray  # the unknown of its frame that each product depends on, shape (n_products,)
    #: where the matrix stores what is linear, the products' derivatives in the position and in the frame, the mixed
    #: second ones, in the plane the second ones in the angle, and the first and second derivatives of arms
    positions: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    curved: Curved  # what is of second order in the deformation of bodies in floating frames


class NodeConstraints(NamedTuple):
    """Constraints, as compiled functions take them."""

    rows: Rows  # the statements, n terms of constraints
    places: np.ndarray  # the places of their constraints among all here, shape (n,)
    wanted: np.ndarray  # what is taken off, shape (n,), m, 1 or rad
    motions: np.ndarray  # number of the prescribed motion that is taken off too, -1 where there is none, shape (n,)
    near: np.ndarray  # as in `ChosenRows`, shape (n,)
    linear: np.ndarray  # whether a statement is linear in the unknowns, shape (n,)
    weights: np.ndarray  # w over the scale of the constraints, shape (n,), m2
    #: positions, curved_positions: where the matrix stores the first derivatives, and the second ones of those that are
    #: not
    positions: np.ndarray
    curved_positions: np.ndarray
    #: first entry of each row (n + 1,) among the products of two first derivatives that a weight adds, the two entries
    #: of each, and where the matrix stores it
    pairs: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    ties: Ties  # those of frames to faces
    counted: np.ndarray  # whether the multiplier of a statement belongs to this rank, shape (n,)


class ConstraintParts:
    """Constraints of a rank before their place in the matrix is known.

    Parameters
    ----------
    constraints
        All constraints of a mechanism.
    chosen
        Numbers of those that are here, increasing.
    size
        Of the mechanism, m.

    Attributes
    ----------
    pattern
        Rows and columns, unknowns or multipliers, of all entries of the matrix.
    """

    def __init__(self, constraints: ConstraintSet, chosen: np.ndarray, size: float) -> None:
        self._n_dofs, self._chosen = constraints.n_dofs, chosen
        self._own = constraints.rows_among(chosen)
        self._tie_places, self._ties = constraints.ties_among(chosen)
        self._weights = np.where(self._own.of_directors, size**2, 0.0)
        system = self._own.rows
        starts, _, unknowns = system.compiled.entries
        firsts, ones, others = [0], [], []
        for term, weight in enumerate(self._weights):
            one, other = np.tril_indices(starts[term + 1] - starts[term] if weight else 0)
            ones.append(starts[term] + one)
            others.append(starts[term] + other)
            firsts.append(firsts[-1] + one.size)
        empty = np.zeros(0, dtype=np.int64)
        self._pairs = np.array(firsts), np.concatenate([empty, *ones]), np.concatenate([empty, *others])
        multipliers = self._n_dofs + chosen[self._own.places]
        self._jacobian = np.repeat(multipliers, np.diff(starts)), unknowns
        self._products = unknowns[self._pairs[1]], unknowns[self._pairs[2]]
        self._tie_entries = self._entries_of_ties()
        parts = (self._jacobian, system.curvature_pattern, self._products, *self._tie_entries)
        self.pattern = tuple(np.concatenate([part[k] for part in parts]) for k in range(2))

    def _entries_of_ties(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the rows and columns of all entries of the ties that are here, in the order of `Ties.positions`."""
        row, unknown, _ = self._ties.linear
        products, turning, arms = self._ties.products, self._ties.turning, self._ties.arms
        here, there, near = (self._tie_places[part] >= 0 for part in (row, products.rows, arms.rows))
        self._linear_here, self._products_here, self._arms_here = here, there, near
        multipliers = self._n_dofs + np.append(self._chosen, 0)[self._tie_places]  # of a tie elsewhere, not looked at
        of_products, turning, positions = multipliers[products.rows[there]], turning[there], products.positions[there]
        of_arms = arms.frames[near] + PHI
        self._curved = CurvedParts(self._ties.curved, self._tie_places, multipliers)
        return [
            (multipliers[row[here]], unknown[here]),
            (of_products, positions),
            (of_products, turning),
            (turning, positions),
            (turning, turning),
            (multipliers[arms.rows[near]], of_arms),
            (of_arms, of_arms),
            *self._curved.entries,
        ]

    def placed(self, layout: Layout, owned: np.ndarray) -> NodeConstraints:
        """Return the constraints in the numbering of a layout; `owned` are those whose multipliers belong to this rank,
        shape (n,)."""
        own, compiled = self._own, self._own.rows.compiled
        linear = np.zeros(own.places.size, dtype=bool)
        linear[compiled.linear] = True
        starts, columns, unknowns = compiled.entries
        entries = starts, columns, layout.unknowns(unknowns)
        rows = compiled._replace(dofs=layout.unknowns(compiled.dofs), entries=entries)
        row, unknown, factors = (part[self._linear_here] for part in self._ties.linear)
        products = Products(*(part[self._products_here] for part in self._ties.products))
        placed = products._replace(
            rows=self._tie_places[products.rows],
            frames=layout.unknowns(products.frames),
            positions=layout.unknowns(products.positions),
        )
        arms = Arms(*(part[self._arms_here] for part in self._ties.arms))
        arms = arms._replace(rows=self._tie_places[arms.rows], frames=layout.unknowns(arms.frames))
        ties = Ties(
            (self._tie_places[row], layout.unknowns(unknown), factors),
            placed,
            arms,
            layout.unknowns(self._ties.turning[self._products_here]),
            tuple(layout.positions(*entries) for entries in self._tie_entries[: -len(self._curved.entries)]),
            self._curved.placed(layout),
        )
        return NodeConstraints(
            rows, own.places, own.wanted, own.motions, own.near, linear, self._weights,
            layout.positions(*self._jacobian), layout.positions(*own.rows.curvature_pattern),
            (*self._pairs, layout.positions(*self._products)), ties, owned[own.places],
        )  # fmt: skip


@njit(cache=True, error_model="numpy")
def add_constraints(
    constraints, width, d, driven, turns, residual, q, multipliers, scale, gain_k, fresh, x, place, diagonal, lower
):  # fmt: skip
    """Add ``C^T lambda`` and ``s c`` to x, and ``s C`` and ``gain_k lambda d2c/dq2`` to the matrix.

    Parameters
    ----------
    width
        As many numbers as there are lanes; see `lane_items`.
    d
        Dimension.
    driven
        Angles of the motions now, shape (n_motions,), rad.
    turns
        In space the angles that those of coordinates are near to, shape (n_coordinates or more, n_lanes), rad.
    residual
        Residual in place of c, shape (n, n_lanes), or (0, n_lanes) for c itself.
    q, multipliers
        Shapes (n_dofs, n_lanes) and (n, n_lanes).
    scale
        Of the constraints, shape (n_lanes,).
    gain_k, fresh
        Factor of the curvature, and whether the matrix is wanted.
    x, place, diagonal, lower
        Right-hand side in elimination order, the turn of each unknown, and the matrix.
    """
    rows, n_dofs, itself = constraints.rows, q.shape[0], residual.shape[0] == 0
    starts, _, unknowns = rows.entries
    of_x, of_q, entries = items(x, width), items(q, width), items(lower, width)
    scales, forces, still = items(scale, width)[()], items(multipliers, width), items(residual, width)
    n_linear = 0
    for k in range(constraints.places.size):
        if constraints.linear[k]:
            n_linear += 1
            number = constraints.places[k]
            off, force = rows.constants[k] - _wanted(constraints, k, driven), forces[number]
            for entry in range(starts[k], starts[k + 1]):
                slope, dof = rows.slopes[entry], unknowns[entry]
                off += slope * of_q[dof]
                of_x[place[dof]] += slope * force
                if fresh:
                    entries[constraints.positions[entry]] += slope * scales
            if itself:
                of_x[place[n_dofs + number]] += scales * off
    for number in range(still.size):
        of_x[place[n_dofs + number]] += scales * still[number]
    if n_linear < constraints.places.size:
        _add_curved(
            constraints, driven, turns, residual, q, multipliers, scale, gain_k, fresh, x, place, diagonal, lower
        )
    if constraints.ties.linear[0].size:
        _add_ties(constraints.ties, width, d, itself, q, multipliers, scale, gain_k, fresh, x, place, diagonal, lower)


@njit(error_model="numpy", forceinline=True)
def _wanted(constraints, k, driven):
    """Return what is taken off a statement."""
    motion = constraints.motions[k]
    return constraints.wanted[k] + driven[motion] if motion >= 0 else constraints.wanted[k]


@njit(cache=True, apart=True, error_model="numpy")
def _add_curved(constraints, driven, turns, residual, q, multipliers, scale, gain_k, fresh, x, place, diagonal, lower):
    """Add what statements give that are not linear, lane by lane; see `add_constraints`."""
    rows, statements = constraints.rows, loaded(constraints.rows.statements)
    n_dofs, n_lanes = q.shape
    m, itself = rows.dofs.shape[1], residual.shape[0] == 0
    starts, columns, unknowns = rows.entries
    curved_starts, one, other = rows.curved
    pair_starts, first, second, pair_positions = constraints.pairs
    y, g, h, scratch = np.zeros(m), np.zeros(m), np.zeros((m, m)), scratch_of(statements, m // 2)
    so_far = np.zeros(n_lanes)  # of the terms of a constraint before this one, less what is wanted
    for k in range(constraints.places.size):
        begins = k == 0 or constraints.places[k] != constraints.places[k - 1]
        alone = begins and (k + 1 == constraints.places.size or constraints.places[k] != constraints.places[k + 1])
        if constraints.linear[k]:
            for lane in range(0 if alone else n_lanes):
                value = rows.constants[k] - _wanted(constraints, k, driven)
                for entry in range(starts[k], starts[k + 1]):
                    value += rows.slopes[entry] * q[unknowns[entry], lane]
                so_far[lane] = value if begins else so_far[lane] + value
        else:
            number, motion, of = constraints.places[k], constraints.motions[k], constraints.near[k]
            goal, near = _wanted(constraints, k, driven), driven[motion] if motion >= 0 else 0.0
            for lane in range(n_lanes):
                if of == FROM_SUM:
                    near = -so_far[lane] / statements.factors[k]
                elif of >= 0 and of < turns.shape[0]:
                    near = turns[of, lane]
                for i in range(m):
                    dof = rows.dofs[k, i]
                    y[i] = q[dof, lane] if dof >= 0 else 0.0
                missed = state(statements, k, y, near, fresh, scratch, g, h) - goal
                so_far[lane] = missed if begins else so_far[lane] + missed
                against = missed if itself else residual[number, lane]
                force = multipliers[number, lane] + constraints.weights[k] * scale[lane] * against
                for entry in range(starts[k], starts[k + 1]):
                    i = columns[entry]
                    x[place[unknowns[entry]], lane] += g[i] * force
                    if fresh:
                        lower[constraints.positions[entry], lane] += g[i] * scale[lane]
                for entry in range(curved_starts[k], curved_starts[k + 1] if fresh else 0):
                    bent = gain_k * multipliers[number, lane] * h[one[entry], other[entry]]
                    add_entry_of_lane(constraints.curved_positions[entry], lane, bent, diagonal, lower)
                for pair in range(pair_starts[k], pair_starts[k + 1] if fresh else 0):
                    product = g[columns[first[pair]]] * g[columns[second[pair]]]
                    add_entry_of_lane(
                        pair_positions[pair], lane, constraints.weights[k] * scale[lane] * product, diagonal, lower
                    )
                if itself:
                    x[place[n_dofs + number], lane] += scale[lane] * missed


@njit(cache=True, apart=True, error_model="numpy")
def _add_ties(ties, width, d, itself, q, multipliers, scale, gain_k, fresh, x, place, diagonal, lower):
    """Add what ties of frames give; see `add_constraints` and `FrameTies`."""
    n_dofs, n_lanes = q.shape
    rows, unknowns, factors = ties.linear
    products, arms, curved = loaded(ties.products), loaded(ties.arms), loaded(ties.curved)
    of_linear, of_position, of_turn, mixed, twice, of_arm, bent = ties.positions
    scales, of_x, of_q, forces = items(scale, width)[()], items(x, width), items(q, width), items(multipliers, width)
    of_diagonal, entries = items(diagonal, width), items(lower, width)
    for e in range(rows.size):
        dof, number, factor = unknowns[e], rows[e], factors[e]
        of_x[place[dof]] += factor * forces[number]
        if itself:
            of_x[place[n_dofs + number]] += scales * factor * of_q[dof]
        if fresh:
            add_entry(of_linear[e], factor * scales, of_diagonal, entries)
    for e in range(products.rows.size):
        number, position, turning, factor = (
            products.rows[e],
            products.positions[e],
            ties.turning[e],
            products.factors[e],
        )
        row, at, at_turn = place[n_dofs + number], place[position], place[turning]
        for lane in range(n_lanes):
            along, slope = director(d, products, e, q, lane)
            if d == 3:
                slope = 1.0
            far, force = q[position, lane], multipliers[number, lane]
            x[at, lane] += factor * along * force
            x[at_turn, lane] += factor * slope * far * force
            if itself:
                x[row, lane] += scale[lane] * factor * along * far
            if fresh:
                lower[of_position[e], lane] += scale[lane] * factor * along
                lower[of_turn[e], lane] += scale[lane] * factor * slope * far
                add_entry_of_lane(mixed[e], lane, gain_k * factor * slope * force, diagonal, lower)
                if d == 2:  # d2 d_k / d phi2 = -d_k
                    add_entry_of_lane(twice[e], lane, -gain_k * factor * along * far * force, diagonal, lower)
    for e in range(arms.rows.size):
        number, turning, factor = arms.rows[e], arms.frames[e] + PHI, arms.factors[e]
        row, at_turn = place[n_dofs + number], place[turning]
        for lane in range(n_lanes):
            along, slope = director(d, arms, e, q, lane)
            force = multipliers[number, lane]
            x[at_turn, lane] += factor * slope * force
            if itself:
                x[row, lane] += scale[lane] * factor * along
            if fresh:
                add_entry_of_lane(of_arm[e], lane, scale[lane] * factor * slope, diagonal, lower)
                add_entry_of_lane(bent[e], lane, -gain_k * factor * along * force, diagonal, lower)
    if curved.rows.size:
        add_curved_ties(curved, d, itself, q, multipliers, scale, gain_k, fresh, x, place, diagonal, lower)


class Curved(NamedTuple):
    """Products ``f d x y`` of ties that are here."""

    #: rows, frames, directors, first, second, factors: as in `Quadratics`, rows being places among the constraints
    #: here, and unknowns those here
    rows: np.ndarray
    frames: np.ndarray
    directors: np.ndarray
    first: np.ndarray
    second: np.ndarray
    factors: np.ndarray
    turning: np.ndarray  # the unknown of its frame that each depends on, shape (n,)
    #: where the matrix stores the derivatives in x, in y and in the frame, and the second ones in x and y, in the frame
    #: and x, in the frame and y, and in the plane in the angle
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


@njit(cache=True, apart=True, error_model="numpy")
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
