"""Full-order equations of motion of samples on one rank, and Newton's correction of a batch, compiled.

    r   = M q'' + g_int(q) + C(q)^T lambda - g_ext(t),     c(q) = 0

(Naets et al. 2015, eq. (3)). One correction solves, for every sample by itself,

    [ gain_a M + gain_k K(q, lambda)   s C^T ] [  dq    ]     [  r  ]
    [ s C                               0    ] [ dlambda/s ] = - [ s c ]

with constraints scaled by s to the size of the inertia terms (Bottasso, Bauchau and Cardona 2007). Samples lie side by
side in the last axis (lanes); see `batched_ldl`. The equations of a sample that ranks share are the same, each rank
having the rows and the elements that it needs (`layout`).
"""

from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.beam2d import N_PACKED, fill_tangent, forces, strain_rates, strains, stresses, viscous_stresses
from pgmp_petsc.full.batched_ldl import Pattern, factorise, substitute
from pgmp_petsc.full.damping import ModalFactors, add_modal_damping
from pgmp_petsc.full.elements import Beams, Masses, Solids, add_beams, add_masses, add_solids
from pgmp_petsc.full.floating import add_floating
from pgmp_petsc.full.forces import BlockActions, Loads, add_actions, add_entry, add_loads
from pgmp_petsc.full.layout import FloatingBodies
from pgmp_petsc.full.node_constraints import NodeConstraints, add_constraints, gather
from pgmp_petsc.full.part_reference import loaded
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import absolute, beyond, borrowed, empty_lanes, fill, items, keep, select, sine_cosine
from pgmp_petsc.mechanism.statement_rows import Rows, scratch_of
from pgmp_petsc.mechanism.statement_rows import state as statement


class Elements(NamedTuple):
    """Beam elements in the plane: unknowns (n_e, 6), length, direction, body, where their 21 entries lie, whether each
    is counted here, in sums over all ranks, and whether any damps."""

    dofs: np.ndarray
    length: np.ndarray
    direction: np.ndarray
    body: np.ndarray
    positions: np.ndarray
    counted: np.ndarray
    damped: bool


class Lumps(NamedTuple):
    """Masses of nodes in the plane: unknown, body, where the diagonal entry is stored and whether it is counted here
    (n_lumped,); and the masses, by lane.

    `mass` has shape (n_blocks, n_lumped, n_lanes).
    """

    dofs: np.ndarray
    body: np.ndarray
    positions: np.ndarray
    counted: np.ndarray
    mass: np.ndarray


class FullProblem(NamedTuple):
    """The equations of all samples, block by block."""

    width: tuple[float, ...]  # as many numbers as there are lanes; see `lane_items`
    dimension: int  # 2 or 3
    #: elements, lumps, solids, beams, masses, floating, loads, actions, modal, constraints: what there is: beams and
    #: masses of nodes in the plane, continuum elements, beams and masses in space, bodies in floating frames, and what
    #: acts on them. The terms of a kind are compiled where there is one.
    elements: Elements
    lumps: Lumps
    solids: Solids
    beams: Beams
    masses: Masses
    floating: FloatingBodies
    loads: Loads
    actions: BlockActions
    modal: ModalFactors
    constraints: NodeConstraints
    angles: Rows  # statements of the angles of the coordinates in space, where nothing else counts turns
    pattern: Pattern  # of the iteration matrix
    #: ``(EA, k_s GA, EI, rho A, rho I, beta, alpha)`` of every body, and behind the bodies of elements with sections of
    #: their own, shape (n_blocks, n_sections, 7, n_lanes); the last two are those of structural damping, and all the
    #: others of beams in the plane. What an element calls its body is its row.
    section: np.ndarray
    rayleigh: np.ndarray  # beta (s) and alpha (1/s) of all rows, shape (n_sections, 2)
    units: np.ndarray  # 1/size for translations, 1 for rotations and directors, shape (n_dofs,)


class Strengths(NamedTuple):
    """Strengths at an instant, or at several, one a row: amplitudes of loads and actions, angles (rad) and speeds
    (rad/s) of the prescribed motions."""

    loads: np.ndarray
    actions: np.ndarray
    angles: np.ndarray
    speeds: np.ndarray


class Factors(NamedTuple):
    """Factorised iteration matrices, diagonal and lower entries (n_blocks, n + n_lower, n_lanes), and a right-hand side
    that is used again and again, (n, n_lanes)."""

    matrix: np.ndarray
    x: np.ndarray


@njit(error_model="numpy", forceinline=True)
def of_element(x, dofs, e):
    """Return the six unknowns of an element."""
    return x[dofs[e, 0]], x[dofs[e, 1]], x[dofs[e, 2]], x[dofs[e, 3]], x[dofs[e, 4]], x[dofs[e, 5]]


@njit(cache=True, error_model="numpy")
def add_elements(elements, width, sections, block, q, v, a, gains, fresh, x, place, diagonal, lower):
    """Add inertia and internal forces of all elements to x, and their tangents to the matrix."""
    q, v, a, sections = items(q, width), items(v, width), items(a, width), items(sections, width)
    x, diagonal, lower = items(x, width), items(diagonal, width), items(lower, width)
    gain_v, gain_a, gain_k = gains
    space, dofs = empty_lanes(N_PACKED, len(width)), elements.dofs
    tangent = items(space, width)
    for e in range(elements.length.size):
        length, body = elements.length[e], elements.body[e]
        section = sections[block, body, 0], sections[block, body, 1], sections[block, body, 2]
        line, rotary = sections[block, body, 3], sections[block, body, 4]
        u, moving = of_element(q, dofs, e), of_element(a, dofs, e)
        sin, cos = sine_cosine(0.5 * (u[2] + u[5]) + elements.direction[e])
        strain = strains(u, cos, sin, length)
        stress = stresses(strain, section)
        total, stiffer, gain_m = stress, gain_k, gain_a
        if elements.damped:
            beta, alpha = sections[block, body, 5], sections[block, body, 6]
            rate = of_element(v, dofs, e)
            moving = (
                moving[0] + alpha * rate[0], moving[1] + alpha * rate[1], moving[2] + alpha * rate[2],
                moving[3] + alpha * rate[3], moving[4] + alpha * rate[4], moving[5] + alpha * rate[5],
            )  # fmt: skip
            viscous = viscous_stresses(strain_rates(rate, strain, cos, sin, length), section, beta)
            total = stress[0] + viscous[0], stress[1] + viscous[1], stress[2] + viscous[2]
            stiffer, gain_m = gain_k * (1.0 + gain_v * beta), gain_a + gain_v * alpha
        force = forces(strain, total, cos, sin, length)
        third = length / 3.0
        line, rotary = third * line, third * rotary
        x[place[dofs[e, 0]]] += force[0] + line * (moving[0] + 0.5 * moving[3])
        x[place[dofs[e, 1]]] += force[1] + line * (moving[1] + 0.5 * moving[4])
        x[place[dofs[e, 2]]] += force[2] + rotary * (moving[2] + 0.5 * moving[5])
        x[place[dofs[e, 3]]] += force[3] + line * (moving[3] + 0.5 * moving[0])
        x[place[dofs[e, 4]]] += force[4] + line * (moving[4] + 0.5 * moving[1])
        x[place[dofs[e, 5]]] += force[5] + rotary * (moving[5] + 0.5 * moving[2])
        if fresh:
            section = stiffer * section[0], stiffer * section[1], stiffer * section[2]
            stress = gain_k * stress[0], gain_k * stress[1], gain_k * stress[2]
            fill_tangent(strain, stress, section, cos, sin, length, tangent)
            line, rotary = gain_m * line, gain_m * rotary
            for i in range(6):
                density, here = (line if i % 3 < 2 else rotary), i * (i + 1) // 2 + i
                tangent[here] += density
                if i >= 3:
                    tangent[here - 3] += 0.5 * density
            for t in range(N_PACKED):
                add_entry(elements.positions[e, t], tangent[t], diagonal, lower)
    keep(space)


@njit(error_model="numpy", forceinline=True)
def add_lumps(lumps, width, sections, block, v, a, gains, fresh, x, place, diagonal, lower):
    """Add the inertia forces of the nodes' own masses to x, and their tangents to the matrix."""
    v, a, masses, sections = items(v, width), items(a, width), items(lumps.mass, width), items(sections, width)
    x, diagonal, lower = items(x, width), items(diagonal, width), items(lower, width)
    gain_v, gain_a, _ = gains
    for k in range(lumps.dofs.size):
        dof, mass, braking = lumps.dofs[k], masses[block, k], sections[block, lumps.body[k], 6]
        x[place[dof]] += mass * (a[dof] + braking * v[dof])
        if fresh:
            add_entry(lumps.positions[k], mass * (gain_a + braking * gain_v), diagonal, lower)


@njit(cache=True, error_model="numpy")
def evaluate(problem, block, amplitudes, angles, share, residual, state, gains, scale, fresh, x, diagonal, lower):
    """Evaluate the residual of a block, by its number, and the matrix where it is to be `fresh`, into x, diagonal and
    lower.

    The state is ``(q, v, a, multipliers, turns)``; `turns` are the angles of coordinates and of actions in space at the
    instant before, rad, shape (n_turns, n_lanes): those here are the nearest. `amplitudes` are those of loads and of
    actions, (n_loads,) and (n_actions,), of which a `share` acts; `angles` those of the motions, (n_motions,), rad. The
    residual in place of c has shape (n_constraints, n_lanes), or (0, n_lanes) for c itself. Gains are ``(gain_v,
    gain_a, gain_k)``; the constraints have the scale (n_lanes,).
    """
    width, place = problem.width, problem.pattern.place
    q, v, a, multipliers, turns = state
    fill(x, 0.0, width)
    if fresh:
        fill(diagonal, 0.0, width)
        fill(lower, 0.0, width)
    if problem.elements.length.size:
        add_elements(problem.elements, width, problem.section, block, q, v, a, gains, fresh, x, place, diagonal, lower)
    if problem.lumps.dofs.size:
        add_lumps(problem.lumps, width, problem.section, block, v, a, gains, fresh, x, place, diagonal, lower)
    if problem.solids.region.size:
        add_solids(problem.solids, width, block, q, v, a, gains, fresh, x, place, diagonal, lower)
    if problem.beams.length.size:
        add_beams(problem.beams, width, problem.rayleigh, block, q, v, a, gains, fresh, x, place, diagonal, lower)
    if problem.masses.body.size:
        add_masses(problem.masses, width, problem.rayleigh, block, v, a, gains, fresh, x, place, diagonal, lower)
    if problem.floating.body.size:
        add_floating(
            problem.dimension, problem.floating, width, problem.rayleigh, block, amplitudes[0], share, q, v, a, gains,
            fresh, x, place, diagonal, lower,
        )  # fmt: skip
    if problem.actions.counted.size:
        of_actions = turns[problem.angles.dofs.shape[0] :]
        add_actions(
            problem.actions, width, block, amplitudes[1], share, q, v, of_actions, gains, fresh, x, place, diagonal,
            lower,
        )  # fmt: skip
    if problem.modal.kinds.size:
        powers = np.empty((problem.modal.kinds.size, x.shape[1]))
        add_modal_damping(problem.modal, problem.dimension, q, v, x, place, powers)
    add_loads(problem.loads, width, block, amplitudes[0], share, x, place)
    add_constraints(
        problem.constraints, width, problem.dimension, angles, turns, residual, q, multipliers, scale, gains[2], fresh,
        x, place, diagonal, lower,
    )  # fmt: skip


@njit(cache=True, apart=True, error_model="numpy")
def count_turns(problem, q, turns):
    """Put the angles of coordinates and actions in space, (n_turns, n_lanes), to those at q nearest to them."""
    n_angles = problem.angles.dofs.shape[0]
    if turns.shape[0]:
        _count(problem.angles.statements, problem.angles.dofs, problem.width, q, turns[:n_angles])
        _count(problem.actions.statements, problem.actions.dofs, problem.width, q, turns[n_angles:])


@njit(cache=True, apart=True, error_model="numpy")
def _count(statements, dofs, width, q, turns):
    """Put statements near `turns`, (n, n_lanes), there; of functions of them, but for splines, what they are of."""
    statements = loaded(statements)
    (n, m), n_lanes = dofs.shape, q.shape[1]
    scratch, y, g = scratch_of(statements, m // 2, width), empty_lanes(m, n_lanes), empty_lanes(m, n_lanes)
    h, angle = empty_lanes(1, n_lanes).reshape((1, 1, n_lanes)), empty_lanes(1, n_lanes)[0]
    for k in range(n):
        gather(dofs[k], width, q, y)
        items(angle, width)[()] = statement(statements, k, y, turns[k], np.bool_(False), scratch, width, g, h)
        for lane in range(n_lanes):
            if np.isfinite(angle[lane]):
                turns[k, lane] = angle[lane] / statements.factors[k]
    keep(angle)


@njit(cache=True, apart=True, error_model="numpy")
def correct_block(
    problem, factors, block, amplitudes, angles, residual, state, gains, typical_mass, lanes, fresh, scale, size
):  # fmt: skip
    """Correct some lanes of a block; `scale` is a work array (n_lanes,)."""
    width, pattern = problem.width, problem.pattern
    x, matrix = borrowed(factors.x), borrowed(factors.matrix)[block]
    diagonal, lower = matrix[: x.shape[0]], matrix[x.shape[0] :]
    for lane in range(scale.size):
        scale[lane] = gains[1] * typical_mass[lane]
    evaluate(problem, block, amplitudes, angles, 1.0, residual, state, gains, scale, fresh, x, diagonal, lower)
    if fresh:
        factorise(pattern.starts, pattern.rows, pattern.products, items(matrix, width))
    substitute(pattern.starts, pattern.rows, items(matrix, width), items(x, width))
    take_correction(problem.units, width, pattern.place, x, scale, gains, lanes, state, size)


@njit(error_model="numpy", forceinline=True)
def take_correction(units, width, place, x, scale, gains, lanes, state, size):
    """Correct some lanes of a block by the solution x in elimination order, and find its size (n_lanes,)."""
    q, v, a = items(state[0], width), items(state[1], width), items(state[2], width)
    multipliers, x = items(state[3], width), items(x, width)
    scale, size = items(scale, width), items(size, width)
    gain_v, gain_a, _ = gains
    largest = 0.0
    for dof in range(q.size):
        step = select(lanes, x[place[dof]], 0.0)
        q[dof] -= step
        v[dof] -= gain_v * step
        a[dof] -= gain_a * step
        moved = absolute(step) * units[dof]
        largest = select(beyond(moved, largest), moved, largest)  # written so that a NaN is kept
    for row in range(multipliers.size):
        multipliers[row] -= select(lanes, scale[()] * x[place[q.size + row]], 0.0)
    size[()] = largest
