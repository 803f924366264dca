"""Constraints on the nodes of full-order samples on one rank, compiled: joints, rigid directors, drives and ties.

    c = s(y_a, y_b) - wanted - driven(t) = 0

with a statement s in the unknowns y of two nodes (`mechanism.statement_rows`), or the tie of a frame to faces or to a
floating frame (`mechanism.constraint_set`). Statements that are linear in the unknowns, all at nodes in the plane but
the lines that turn, are a row of numbers; the others are evaluated for every sample.

Directors that no mass belongs to make the matrix singular before their constraints are in it, and nothing is pivoted.
For the constraints g that make directors a rotation it therefore holds ``w G^T G`` too, and the residual ``w G^T g``:
the solution is the same for any weight w (the augmented Lagrangian of Glowinski and Le Tallec 1989).
"""

from typing import NamedTuple

import numpy as np

from pgmp_petsc.full.forces import add_entry
from pgmp_petsc.full.part_reference import loaded
from pgmp_petsc.full.rank_solver import Layout
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import empty_lanes, items, keep
from pgmp_petsc.mechanism.constraint_set import ConstraintSet, Terms, parts_of
from pgmp_petsc.mechanism.statement_rows import Near, Rows, scratch_of, state


class Ties(NamedTuple):
    """Ties of frames to faces and floating frames."""

    terms: Terms  # as in `FrameTies`, rows being places among the constraints here, and unknowns those here
    #: where the matrix stores the three first and the four second derivatives (`Terms.derivatives`), each of shape (n,)
    positions: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class NodeConstraints(NamedTuple):
    """Constraints, as compiled functions take them."""

    rows: Rows  # the statements, n terms of constraints
    places: np.ndarray  # the places of their constraints among all here, shape (n,)
    wanted: np.ndarray  # what is taken off, shape (n,), m, 1 or rad
    motions: np.ndarray  # number of the prescribed motion that is taken off too, -1 where there is none, shape (n,)
    near: Near  # as in `ChosenRows`
    linear: np.ndarray  # whether a statement is linear in the unknowns, shape (n,)
    weights: np.ndarray  # w over the scale of the constraints, shape (n,), m2
    #: positions, curved_positions: where the matrix stores the first derivatives, and the second ones of those that are
    #: not
    positions: np.ndarray
    curved_positions: np.ndarray
    #: first entry of each row (n + 1,) among the products of two first derivatives that a weight adds, the two entries
    #: of each, and where the matrix stores it
    pairs: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    ties: Ties  # of frames to faces and floating frames
    counted: np.ndarray  # whether the multiplier of a statement belongs to this rank, shape (n,)


class ConstraintParts:
    """Constraints of a rank before their place in the matrix is known.

    They are the `chosen` ones, by increasing numbers, of all constraints of a mechanism of `size` (m). `pattern` has
    rows and columns, unknowns or multipliers, of all entries of the matrix.
    """

    def __init__(self, constraints: ConstraintSet, chosen: np.ndarray, size: float) -> None:
        self._n_dofs, self._chosen = constraints.n_dofs, chosen
        self._own = constraints.rows_among(chosen)
        self._tie_places, self._ties = constraints.ties_among(chosen)
        self._weights = np.where(self._own.of_directors, size**2, 0.0)
        system = self._own.rows
        starts, _, unknowns = system.compiled.entries
        firsts, ones, others = [0], [], []
        n_paired = np.where(self._weights > 0.0, np.diff(starts), 0)
        lower = {n: np.tril_indices(n) for n in set(n_paired.tolist())}
        for term, n in enumerate(n_paired.tolist()):
            one, other = lower[n]
            ones.append(starts[term] + one)
            others.append(starts[term] + other)
            firsts.append(firsts[-1] + one.size)
        empty = np.zeros(0, dtype=np.int64)
        self._pairs = np.array(firsts), np.concatenate([empty, *ones]), np.concatenate([empty, *others])
        multipliers = self._n_dofs + chosen[self._own.places]
        self._jacobian = np.repeat(multipliers, np.diff(starts)), unknowns
        self._products = unknowns[self._pairs[1]], unknowns[self._pairs[2]]
        here = self._tie_places[self._ties.terms.rows] >= 0
        terms = self._terms = Terms(*(part[here] for part in self._ties.terms))
        numbered = terms._replace(rows=self._n_dofs + self._chosen[self._tie_places[terms.rows]])
        first, second = numbered.derivatives(self._ties.d)
        self._derivatives = [*first, *second]  # in the order of `Ties.positions`
        self._tie_entries = [(one[has], other[has]) for has, one, other in self._derivatives]
        parts = (self._jacobian, system.curvature_pattern, self._products, *self._tie_entries)
        self.pattern = tuple(np.concatenate([part[k] for part in parts]) for k in range(2))

    def placed(self, layout: Layout, owned: np.ndarray) -> NodeConstraints:
        """Return the constraints in the numbering of a layout; `owned` are those whose multipliers belong to this rank,
        shape (n,)."""
        own, compiled = self._own, self._own.rows.compiled
        linear = np.zeros(own.places.size, dtype=bool)
        linear[compiled.linear] = True
        starts, columns, unknowns = compiled.entries
        entries = starts, columns, layout.unknowns(unknowns)
        rows = compiled._replace(dofs=layout.unknowns(compiled.dofs), entries=entries)
        placed = {name: layout.unknowns(getattr(self._terms, name)) for name in ("turning", "first", "second")}
        terms = self._terms._replace(rows=self._tie_places[self._terms.rows], **placed)
        positions = [np.zeros(terms.rows.size, dtype=np.int64) for _ in self._derivatives]
        for place, (has, _, _), entries in zip(positions, self._derivatives, self._tie_entries):
            place[has] = layout.positions(*entries)
        ties = Ties(terms, tuple(positions))
        return NodeConstraints(
            rows, own.places, own.wanted, own.motions, own.near, linear, self._weights,
            layout.positions(*self._jacobian), layout.positions(*own.rows.curvature_pattern),
            (*self._pairs, layout.positions(*self._products)), ties, owned[own.places],
        )  # fmt: skip


@njit(cache=True, error_model="numpy")
def add_constraints(
    constraints, width, d, driven, turns, residual, q, multipliers, scale, gain_k, fresh, x, place, diagonal, lower
):  # fmt: skip
    """Add ``C^T lambda`` and ``s c`` to x, and where `fresh` ``s C`` and ``gain_k lambda d2c/dq2`` to the matrix; s is
    the scale (n_lanes,).

    `driven` are the angles of the motions now, (n_motions,), rad; `turns` in space the angles that those of coordinates
    are near to, (n_coordinates or more, n_lanes), rad. The residual in place of c has shape (n, n_lanes), or (0,
    n_lanes) for c itself; x is in elimination order, in which `place` is the turn of each unknown.
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
            constraints, width, driven, turns, residual, q, multipliers, scale, gain_k, fresh, x, place, diagonal, lower
        )
    if constraints.ties.terms.rows.size:
        _add_ties(constraints.ties, width, d, itself, q, multipliers, scale, gain_k, fresh, x, place, diagonal, lower)


@njit(error_model="numpy", forceinline=True)
def _wanted(constraints, k, driven):
    """Return what is taken off a statement."""
    motion = constraints.motions[k]
    return constraints.wanted[k] + driven[motion] if motion >= 0 else constraints.wanted[k]


@njit(error_model="numpy", forceinline=True)
def gather(dofs, width, q, y):
    """Fill unknowns y (n, n_lanes) of two nodes from all of them (n_dofs, n_lanes), zero on the ground."""
    q, y = items(q, width), items(y, width)
    for i in range(dofs.size):
        if dofs[i] >= 0:
            y[i] = q[dofs[i]]
        else:
            y[i] = 0.0


@njit(cache=True, apart=True, error_model="numpy")
def _add_curved(
    constraints, width, driven, turns, residual, q, multipliers, scale, gain_k, fresh, x, place, diagonal, lower
):  # fmt: skip
    """Add what statements give that are not linear; see `add_constraints`."""
    rows, statements = constraints.rows, loaded(constraints.rows.statements)
    n_dofs, n_lanes = q.shape
    m, itself = rows.dofs.shape[1], residual.shape[0] == 0
    starts, columns, unknowns = rows.entries
    curved_starts, one, other = rows.curved
    pair_starts, first, second, pair_positions = constraints.pairs
    scratch, y, g = scratch_of(statements, m // 2, width), empty_lanes(m, n_lanes), empty_lanes(m, n_lanes)
    h, space = empty_lanes(m * m, n_lanes).reshape((m, m, n_lanes)), empty_lanes(2, n_lanes)
    of_q, of_x, slopes, bends = items(q, width), items(x, width), items(g, width), items(h, width)
    diagonal, lower, turned = items(diagonal, width), items(lower, width), items(turns, width)
    forces, scales, still = items(multipliers, width), items(scale, width)[()], items(residual, width)
    # what an angle is near to, and the terms of a constraint before this one, less what is wanted
    near, so_far = 0, 1
    known = items(space, width)
    for k in range(constraints.places.size):
        begins = k == 0 or constraints.places[k] != constraints.places[k - 1]
        alone = begins and (k + 1 == constraints.places.size or constraints.places[k] != constraints.places[k + 1])
        before = known[so_far]
        if constraints.linear[k]:
            if not alone:
                known[so_far] = rows.constants[k] - _wanted(constraints, k, driven)
                for entry in range(starts[k], starts[k + 1]):
                    known[so_far] += rows.slopes[entry] * of_q[unknowns[entry]]
                if not begins:
                    known[so_far] += before
            continue
        number, motion, of = constraints.places[k], constraints.motions[k], constraints.near
        if of.left[k]:
            known[near] = -before / statements.factors[k]
        else:
            known[near] = driven[motion] if motion >= 0 else of.offsets[k]
            for entry in range(of.starts[k], of.starts[k + 1] if turned.size and motion < 0 else 0):
                known[near] += of.slopes[entry] * turned[of.numbers[entry]]
        gather(rows.dofs[k], width, q, y)
        missed = state(statements, k, y, space[near], fresh, scratch, width, g, h) - _wanted(constraints, k, driven)
        known[so_far] = missed if begins else before + missed
        against = missed if itself else still[number]
        force, weight = forces[number] + constraints.weights[k] * scales * against, constraints.weights[k] * scales
        for entry in range(starts[k], starts[k + 1]):
            slope = slopes[columns[entry]]
            of_x[place[unknowns[entry]]] += slope * force
            if fresh:
                lower[constraints.positions[entry]] += slope * scales
        for entry in range(curved_starts[k], curved_starts[k + 1] if fresh else 0):
            bent = gain_k * forces[number] * bends[one[entry], other[entry]]
            add_entry(constraints.curved_positions[entry], bent, diagonal, lower)
        for pair in range(pair_starts[k], pair_starts[k + 1] if fresh else 0):
            product = slopes[columns[first[pair]]] * slopes[columns[second[pair]]]
            add_entry(pair_positions[pair], weight * product, diagonal, lower)
        if itself:
            of_x[place[n_dofs + number]] += scales * missed
    keep(g)
    keep(h)
    keep(space)


@njit(cache=True, apart=True, error_model="numpy")
def _add_ties(ties, width, d, itself, q, multipliers, scale, gain_k, fresh, x, place, diagonal, lower):
    """Add what ties of frames give; see `add_constraints` and `FrameTies`."""
    n_dofs, terms = q.shape[0], loaded(ties.terms)
    of_first, of_second, of_turn, of_both, mixed, also_mixed, twice = ties.positions
    q, x, forces, scaled = items(q, width), items(x, width), items(multipliers, width), items(scale, width)[()]
    diagonal, lower = items(diagonal, width), items(lower, width)
    for e in range(terms.rows.size):
        one, other, turning, number = terms.first[e], terms.second[e], terms.turning[e], terms.rows[e]
        along, slope, bend, here, there = parts_of(d, terms, e, q)
        force = forces[number]
        bent = gain_k * force
        if itself:
            x[place[n_dofs + number]] += scaled * along * here * there
        if one >= 0:
            x[place[one]] += along * there * force
            if fresh:
                lower[of_first[e]] += scaled * along * there
        if other >= 0:
            x[place[other]] += along * here * force
            if fresh:
                lower[of_second[e]] += scaled * along * here
                add_entry(of_both[e], bent * (2.0 if one == other else 1.0) * along, diagonal, lower)
        if turning >= 0:
            x[place[turning]] += slope * here * there * force
            if fresh:
                lower[of_turn[e]] += scaled * slope * here * there
                if one >= 0:
                    add_entry(mixed[e], bent * slope * there, diagonal, lower)
                if other >= 0:
                    add_entry(also_mixed[e], bent * slope * here, diagonal, lower)
                if d == 2:
                    add_entry(twice[e], bent * bend * here * there, diagonal, lower)
