"""Forces that joints carry in the steps of reduced samples, LANES at a time, compiled: friction hangs on them.

The multiplier of a constraint is minus the row of a gap (`reduced.gap_forces`), whose entries are here polynomials in
cells, as all tables of the equations; derivatives with theta are those of the polynomials. With the directions n_c that
a joint's constraints pull in, which turn together, and what its springs and contacts pull, the force is the size of

    sum_c n_c (-lambda_c)  +  sum_t n_t f_t'(s_t) F_t.

Between two corrections forces are found at the iterate, under friction by those that were found before, and taken on by
`controllers.running.take_carried`.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from pgmp_petsc.controllers.running import N_FOLLOWED
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import aligned, square_root
from pgmp_petsc.lanes.vectors import LANES, load, load_rows, polynomial, spread, store
from pgmp_petsc.mechanism.statement_rows import is_itself
from pgmp_petsc.reduced.action_kernel import FORCE, LocalEffects, load_nodes, measure_term
from pgmp_petsc.reduced.cells import Cells, enter_cells, refill

GAP, ACTION, TERM, JOINT = range(4)  # of what pulls: its gap, or -1 and its action with the term; and its joint


class Carried(NamedTuple):
    """Joints of a batch whose forces friction hangs on, as compiled functions take them."""

    actions: np.ndarray  # numbers of the actions whose laws take the force as first parameter, (n,)
    pulls: np.ndarray  # of all that pulls, joint after joint, `GAP`, ..., (n_pulls, 4)
    directions: np.ndarray  # of each, (n_pulls, d)
    #: terms, loads: entries of mass, stiffness, damping and local effects of all gaps, and those of load terms
    terms: Cells
    loads: Cells
    together: np.ndarray  # as many zeros as there are terms
    sizes: tuple[int, int, int, bool, int]  # gaps, rigid and flexible coordinates, second order, prescribed coordinates
    parts: tuple[int, int, int, int, int]  # entries of a gap: of mass, stiffness, damping, local effects, and of a load
    mass_damping: float
    quadratic: bool


class KeptGaps(NamedTuple):
    """What is kept of every block: cells, weights of the terms, polynomials (see `arrays.Memory`), and what is known of
    actions besides what an iteration keeps of them, as of `action_kernel.act`."""

    cells: np.ndarray
    weights: np.ndarray
    terms: np.ndarray
    loads: np.ndarray
    known: np.ndarray


class CarriedRoom(NamedTuple):
    """Room for a block: vectors of factors, those of derivatives, rows of gaps, places in the cells, forces on nodes
    (n_nodes, n_dofs), and forces that joints carry; and of each lane these forces, as they are given and found, (LANES,
    n), and what `follow_carried` keeps."""

    factors: np.ndarray
    slopes: np.ndarray
    rows: np.ndarray
    place: np.ndarray
    loads: np.ndarray
    forces: np.ndarray
    given: np.ndarray
    found: np.ndarray
    followed: np.ndarray

    @classmethod
    def of(cls, carried: Carried, local: LocalEffects) -> Self:
        """Return room for joints of a batch."""
        (g, r, m, second, _), n, d = carried.sizes, carried.actions.size, local.actions.statements.axes.shape[2]
        n_changing = m * (1 + r if second else 1)
        sizes = (sum(carried.parts[:4]),), (r * n_changing,), (g,), (r,), (local.places.n_nodes, d * (d + 1) // 2), (n,)
        lanes = (np.zeros((LANES, *shape)) for shape in ((n,), (n,), (N_FOLLOWED + n, n)))
        return cls(*(aligned((*shape, LANES)) for shape in sizes), *lanes)


@njit(cache=True, apart=True, error_model="numpy", fastmath={"contract"}, counted=False)
def find_carried(equations, memory, room, block, places, strengths, samples, lanes):
    """Fill ``room.carried.forces`` with those that joints carry at the iterate in ``room.work``, in some lanes;
    `places` are those of its local effects."""
    carried, kept, own, work = equations.carried, memory.carried, room.carried, room.work
    _come_to_cells(equations, kept, block, strengths.loads.size > 0, own, work)
    load_nodes(
        equations.local, equations.grid, strengths.actions, work.q, work.rate, samples, lanes, room.rates,
        places, kept.known, memory.depths, own.loads,
    )  # fmt: skip
    g, r, m, second, driven = carried.sizes
    _fill_factors(carried, work, own)
    place, n = load_rows(own.place, 0, 1, equations.layout.rigid), own.factors.shape[0]
    terms, n_load = kept.terms[block], carried.parts[4]
    inertial = r + m + r * (r + 1) // 2 * (1 + (m if second else 0))
    n_changing = m + (r * m if second else 0)
    for gap in range(g):
        total = spread(0.0)
        for e in range(n):
            value, slopes = polynomial(terms, gap * n + e, place)
            total += value * load(own.factors, e)
            c = -1
            if r <= e < r + m:
                c = e - r
            elif second and inertial <= e < inertial + r * m:
                c = m + e - inertial
            if c >= 0:
                for k in range(len(place)):
                    total += slopes[k] * load(own.slopes, k * n_changing + c)
        for effect in range(strengths.loads.shape[0]):
            worked, first = spread(0.0), (effect * g + gap) * n_load
            for e in range(n_load):
                value, _ = polynomial(kept.loads[block], first + e, place)
                worked += value * (load(work.q, r + e - 1) if e > 0 else spread(1.0))
            total += -load(strengths.loads, effect) * worked
        store(own.rows, gap, total)
    _sum_up(equations, kept, room, samples, lanes)


@njit(error_model="numpy", forceinline=True, counted=False)
def _come_to_cells(equations, kept, block, loaded, own, work):
    """Bring the polynomials of a block to the cells of its samples, and fill the places in them."""
    carried, weights = equations.carried, equations.weights
    moved, cells = enter_cells(work.q, equations.grid, own.place, kept.cells, block), kept.cells[block]
    if moved != 0:
        refill(carried.terms, cells, moved, kept.weights[block], carried.together, 0, kept.terms[block])
        if loaded:
            refill(carried.loads, cells, moved, weights.loads[block], weights.effects, 0, kept.loads[block])


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_inertia(sizes, mass_damping, quadratic, q, rate, acceleration, factors, slopes, n_slopes):
    """Fill the factors F of mass terms, from the first one on, and those of their derivatives, G, n_slopes a rigid
    coordinate, as of `gap_forces`; return where F ends."""
    r, m, second, driven = sizes
    n, moving = r + m, 1.0 if quadratic else 0.0
    for x in range(n):
        store(factors, x, load(acceleration, x) + mass_damping * load(rate, x))
    for k in range(r):
        v, a = moving * load(rate, k), load(factors, k)
        for i in range(m):
            d, vi = load(q, r + i), moving * load(rate, r + i)
            store(slopes, k * n_slopes + i, v * vi + 0.5 * a * d)
            for h in range(r if second else 0):
                store(slopes, k * n_slopes + m + h * m + i, -v * (moving * load(rate, h)) * d)
    e = n
    for k in range(r):
        for j in range(k + 1):
            store(factors, e, moving * (1.0 if k == j else 2.0) * load(rate, k) * load(rate, j))
            e += 1
    if second:
        for pair in range(n, e):
            for i in range(m):
                store(factors, e, load(factors, pair) * load(q, r + i))
                e += 1
        for h in range(r):
            v, a = moving * load(rate, h), load(factors, h)
            for i in range(m):
                store(factors, e, -2.0 * v * (moving * load(rate, r + i)) - a * load(q, r + i))
                e += 1
        for h in range(driven):
            for i in range(m):
                store(factors, e, load(factors, h) * load(q, r + i))
                e += 1
    return e


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def fill_elasticity(sizes, q, factors, first):
    """Fill the factors F of stiffness terms from `first` on, as of `gap_forces`; return where they end."""
    r, m, second, _ = sizes
    e = first
    for i in range(m):
        store(factors, e, load(q, r + i))
        e += 1
    for i in range(m if second else 0):
        for j in range(i + 1):
            store(factors, e, (0.5 if i == j else 1.0) * load(q, r + i) * load(q, r + j))
            e += 1
    return e


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _fill_factors(carried, work, own):
    """Fill the factors of a gap's entries, and those of their derivatives; see `gap_forces`."""
    _, r, m, second, driven = carried.sizes
    q, v, factors, n_changing = work.q, work.rate, own.factors, m + (r * m if second else 0)
    e = fill_inertia(
        (r, m, second, driven), carried.mass_damping, carried.quadratic, q, v, work.acceleration, factors, own.slopes,
        n_changing,
    )  # fmt: skip
    if carried.parts[1] > 0:
        e = fill_elasticity((r, m, second, driven), q, factors, e)
    for x in range(carried.parts[2]):
        store(factors, e, load(v, x))
        e += 1
    for f in range(carried.parts[3] // (1 + (m if second else 0))):
        pull = -load(own.loads, f)
        store(factors, e, pull)
        e += 1
        for i in range(m if second else 0):
            store(factors, e, pull * load(q, r + i))
            e += 1


@njit(error_model="numpy", fastmath={"contract"}, counted=False)
def _sum_up(equations, kept, room, samples, lanes):
    """Fill the sizes of the forces, of rows of gaps and of forces of actions, whose nodes are placed."""
    carried, own, work = equations.carried, room.carried, room.rates
    n, d, pull = carried.actions.size, carried.directions.shape[1], 0
    statements = equations.local.actions.statements
    for joint in range(n):
        begin = pull
        total = spread(0.0)
        for c in range(d):
            component, pull = spread(0.0), begin
            while pull < carried.pulls.shape[0] and carried.pulls[pull, JOINT] == joint:
                gap, action, term = carried.pulls[pull, GAP], carried.pulls[pull, ACTION], carried.pulls[pull, TERM]
                direction = carried.directions[pull, c]
                pull += 1
                if gap >= 0:
                    component += direction * load(own.rows, gap)
                    continue
                measure_term(equations.local, term, len(equations.grid), room.work.q, False, False, work)
                slope = spread(1.0) if is_itself(statements, term) else load(work.function, 1)
                for lane in range(LANES):
                    work.measured[0, lane] = 0.0
                    if lanes & (1 << lane):
                        work.measured[0, lane] = kept.known[samples[lane], FORCE, action]
                component += direction * slope * load(work.measured, 0)
            total += component * component
        store(own.forces, joint, square_root(total))
