"""Joints of a reduced model whose forces friction hangs on, from rows of gaps to what steps in lanes take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Self

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.effects.action import Action, first_terms
from pgmp_petsc.lanes.vectors import LANES, aligned_zeros
from pgmp_petsc.outputs.multipliers import OfConnection
from pgmp_petsc.reduced.carried import Carried, KeptGaps
from pgmp_petsc.reduced.cells import Cells, Grid
from pgmp_petsc.reduced.gap_forces import GapForces
from pgmp_petsc.reduction.interpolation import Interpolant
from pgmp_petsc.reduction.sample_grid import LengthGrid

TURNED = 1e-12  # of products of directions, by which they may differ from frames to frames
LOADS = 2  # the kind of terms, among those of `GapForces`, whose amplitudes go with time


@dataclass(frozen=True, eq=False)
class CarriedForces:
    """Joints of a model whose forces friction hangs on."""

    carried: Carried
    weights: tuple[Monomial, ...]  # of the terms

    @classmethod
    def none(cls, n_theta: int) -> Self:
        """Return those of a model without any."""
        nothing, no_numbers = Cells.none(n_theta), np.zeros(0, dtype=np.int64)
        pulls = np.zeros((0, 4), dtype=np.int64), np.zeros((0, 2))
        sizes = (0, n_theta, 0, False, 0), (0, 0, 0, 0, 0)
        return cls(Carried(no_numbers, *pulls, nothing, nothing, no_numbers, *sizes, 0.0, False), ())

    @classmethod
    def of(
        cls, gaps: GapForces | None, rows: Sequence[int], tables: Interpolant, grid: Sequence[Grid],
        forces: Sequence[OfConnection], rubbing: Sequence[int], actions: Sequence[Action],
    ) -> Self | None:  # fmt: skip
        """Prepare the forces over cells of a grid of tables; None where directions in which a joint pulls turn against
        each other, as those of a joint on a bent line do.

        Rows of the gaps are those of constraints with numbers `rows`, and there are none where joints hold no place, as
        with a clearance; `rubbing` are the numbers of the actions that rub, among all, one for each force.
        """
        pulls: list[tuple[int, int, int, int]] = []
        directions: list[np.ndarray] = []
        for number, force in enumerate(forces):
            own = _pulls_of(number, force, list(rows), actions)
            if own is None:
                return None
            pulls += own[0]
            directions.append(own[1])
        acting = (
            np.array(rubbing, dtype=np.int64),
            np.array(pulls, dtype=np.int64).reshape(-1, 4),
            np.concatenate(directions),
        )
        nothing, r = Cells.none(len(grid)), len(grid)
        if gaps is None:
            empty = Interpolant(tables.axes, np.zeros((*tables.rows.shape[:r], 0, 0)))
            sizes = (0, r, 0, False, 0), (r + r * (r + 1) // 2, 0, 0, 0, 0)
            none = np.zeros(0, dtype=np.int64)
            return cls(Carried(*acting, Cells.of(empty, grid), nothing, none, *sizes, 0.0, False), ())
        terms, loads, weights, lengths = _split(gaps)
        axes = gaps.table.axes
        made = Carried(
            *acting,
            Cells.of(Interpolant(axes, terms), grid),
            Cells.of(Interpolant(axes, loads), grid) if loads.size else nothing,
            np.zeros(len(weights), dtype=np.int64),
            (gaps.table.shape[0], *gaps.sizes),
            lengths,
            gaps.mass_damping,
            gaps.quadratic,
        )
        return cls(made, weights)

    @classmethod
    def joined(cls, grid: LengthGrid, members: Sequence[CarriedForces]) -> CarriedForces:
        """Return those of any lengths from those at the points of a grid; see `reduction.length_family`."""
        first, weights = members[0].carried, grid.weights(members[0].weights)
        terms, loads = ([getattr(one.carried, name).rows for one in members] for name in ("terms", "loads"))
        joined = first._replace(
            terms=first.terms.with_rows(grid.coefficients(terms)),
            loads=first.loads.with_rows(grid.coefficients(loads)) if loads[0].size else first.loads,
            together=np.zeros(len(weights), dtype=np.int64),
        )
        return replace(members[0], carried=joined, weights=weights)

    def kept(self, weights: np.ndarray, n_samples: int, n_effects: int, n_actions: int) -> KeptGaps:
        """Return what is kept of blocks with weights (n_blocks, n_terms, LANES), empty."""
        one, n_blocks = self.carried, len(weights) if self.carried.actions.size else 0
        cells = aligned_zeros((n_blocks, LANES))
        cells[:] = -1.0
        return KeptGaps(
            cells,
            weights,
            aligned_zeros((n_blocks, one.terms.polynomials.shape[2], LANES)),
            aligned_zeros((n_blocks, n_effects * one.loads.polynomials.shape[2], LANES)),
            np.empty((n_samples if n_blocks else 0, 4, n_actions)),
        )


def _pulls_of(
    number: int, force: OfConnection, rows: list[int], actions: Sequence[Action]
) -> tuple[list[tuple[int, int, int, int]], np.ndarray] | None:
    """Return what pulls in a joint, `carried.GAP` and so on, and in which directions (n, d) where the joint's frames
    are those of the ground; None where these do not turn together."""
    d, found, terms = force.space.dimension, [], []
    for row, (part, _) in zip(force.rows, force.held):
        found.append((rows.index(row), -1, -1, number))
        terms.append(part.terms)
    firsts, own = first_terms(actions).tolist(), {pull.action.effect for pull in force.pulls}
    for action in (k for k, one in enumerate(actions) if one.effect in own):
        for k, (statement, _) in enumerate(actions[action].statement.terms):
            found.append((-1, action, firsts[action] + k, number))
            terms.append(statement.terms)
    random, products, directions = np.random.default_rng(1), [], np.zeros((0, d))
    for turned in (True, True, False):  # the last ones are those of the ground
        turns = [np.linalg.qr(random.normal(size=(d, d)))[0] if turned else np.eye(d) for _ in range(2)]
        z = [np.concatenate([random.normal(size=d), turn.T.ravel()])[:, None] for turn in turns]
        directions = np.array(
            [sum((f.at(one.value(*z))[1] * one.gradient(*z))[len(z[0]) :][:d, 0] for one, f in own) for own in terms]
        ).reshape(-1, d)
        products.append(directions @ directions.T)
    same = all(np.allclose(one, products[-1], rtol=0.0, atol=TURNED) for one in products)
    return (found, directions) if same else None


def _split(gaps: GapForces) -> tuple[np.ndarray, np.ndarray, tuple[Monomial, ...], tuple[int, ...]]:
    """Return the rows of a gap's table, terms with their own weight together but for those of loads, which are apart,
    (..., n_terms, g n_entries); the weights; and how many entries of mass, stiffness, damping and local effects a gap
    has, and of a load."""
    rows, (g, _) = gaps.table.rows, gaps.table.shape
    along, monomials = rows.shape[:-2], [*gaps.weights, (Monomial(),)]
    lengths = [n if n_terms * n_tables else 0 for n, n_terms, n_tables in gaps.kinds]
    own = [0 if kind == LOADS else n for kind, n in enumerate(lengths)]
    begins = list(accumulate(own, initial=0))
    weights = tuple(sorted({one for kind, part in enumerate(monomials) if own[kind] for one in part}))
    terms, loads, first = np.zeros((*along, len(weights), g, sum(own))), [], 0
    for kind, (n, n_terms, n_tables) in enumerate(gaps.kinds):
        for t in range(n_terms * n_tables):
            block, first = rows[..., first : first + n], first + n
            if kind == LOADS:
                loads.append(block.reshape(*along, 1, g * n))
            else:
                terms[..., weights.index(monomials[kind][t]), :, begins[kind] : begins[kind] + n] += block
    of_loads = np.concatenate([*loads, np.zeros((*along, 0, g * lengths[LOADS]))], axis=-2)
    return terms.reshape(*along, len(weights), -1), of_loads, weights, (*own[:LOADS], *own[LOADS + 1 :], lengths[LOADS])
