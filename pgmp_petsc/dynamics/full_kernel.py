"""Full-order equations of motion of samples on one rank, and Newton's correction of a batch, compiled.

    r   = M q'' + g_int(q) + C(q)^T lambda - g_ext(t),     c(q) = 0

(Naets et al. 2015, eq. (3)). One correction solves, for every sample by itself,

    [ gain_a M + gain_k K(q, lambda)   s C^T ] [  dq    ]     [  r  ]
    [ s C                               0    ] [ dlambda/s ] = - [ s c ]

with constraints scaled by s to the size of the inertia terms (Bottasso, Bauchau and Cardona 2007). Samples lie side by
side in the last axis (lanes); see `batched_ldl`. The equations of a sample that ranks share are the same, each rank
having the rows and the elements that it needs (`layout`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.beam2d import N_PACKED, add_damping, force_and_tangent
from pgmp_petsc.dynamics.batched_ldl import factorise, substitute
from pgmp_petsc.dynamics.full_beams import Beams, Masses, add_beams, add_masses
from pgmp_petsc.dynamics.full_forces import BlockActions, Loads, add_actions, add_entry, add_loads
from pgmp_petsc.dynamics.full_modal import ModalFactors, add_modal_damping
from pgmp_petsc.dynamics.full_solids import Solids, add_solids
from pgmp_petsc.dynamics.node_constraints import NodeConstraints, add_constraints
from pgmp_petsc.mechanism.node_statements import scratch_of
from pgmp_petsc.mechanism.node_statements import state as statement
from pgmp_petsc.mechanism.statement_rows import Rows
from pgmp_petsc.runtime.compiled import njit


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


class Pattern(NamedTuple):
    """Numeric view of a symbolic factorisation; `place[unknown]` is its turn in the elimination."""

    place: np.ndarray
    starts: np.ndarray
    rows: np.ndarray


class FullProblem(NamedTuple):
    """The equations of all samples, block by block.

    Attributes
    ----------
    dimension
        2 or 3.
    elements, lumps, solids, beams, masses, loads, actions, modal, constraints
        What there is: beams and masses of nodes in the plane, continuum elements, beams and masses in space, and what
        acts on them.
    angles
        Statements of the angles of the coordinates in space, where nothing else counts turns.
    pattern
        Of the iteration matrix.
    section
        ``(EA, k_s GA, EI, rho A, rho I, beta, alpha)`` of every body, shape (n_blocks, n_bodies, 7, n_lanes); the last
        two are those of structural damping, and all the others of beams in the plane.
    rayleigh
        beta (s) and alpha (1/s) of every body, shape (n_bodies, 2).
    units
        1/size for translations, 1 for rotations and directors, shape (n_dofs,).
    """

    dimension: int
    elements: Elements
    lumps: Lumps
    solids: Solids
    beams: Beams
    masses: Masses
    loads: Loads
    actions: BlockActions
    modal: ModalFactors
    constraints: NodeConstraints
    angles: Rows
    pattern: Pattern
    section: np.ndarray
    rayleigh: np.ndarray
    units: np.ndarray


class Strengths(NamedTuple):
    """What acts at an instant, or at several, one a row: amplitudes of loads and actions, angles (rad) and speeds
    (rad/s) of the prescribed motions."""

    loads: np.ndarray
    actions: np.ndarray
    angles: np.ndarray
    speeds: np.ndarray


class Factors(NamedTuple):
    """Factorised iteration matrices: diagonal (n_blocks, n, n_lanes) and lower entries (n_blocks, n_lower, n_lanes)."""

    diagonal: np.ndarray
    lower: np.ndarray


@njit(cache=True, error_model="numpy")
def add_elements(elements, section, q, v, a, gains, fresh, x, place, diagonal, lower):
    """Add inertia and internal forces of all elements to x, and their tangents to the matrix."""
    n_lanes = x.shape[1]
    gain_v, gain_a, gain_k = gains
    u, acceleration, rate = np.empty((6, n_lanes)), np.empty((6, n_lanes)), np.empty((6, n_lanes))
    power, gain_m = np.empty(n_lanes), np.empty(n_lanes)
    force, tangent = np.empty((6, n_lanes)), np.empty((N_PACKED, n_lanes))
    for e in range(elements.length.size):
        length, properties = elements.length[e], section[elements.body[e]]
        for i in range(6):
            dof = elements.dofs[e, i]
            for lane in range(n_lanes):
                u[i, lane] = q[dof, lane]
                acceleration[i, lane] = a[dof, lane]
        force_and_tangent(u, length, elements.direction[e], properties[:3], force, tangent, fresh)
        for lane in range(n_lanes):
            gain_m[lane] = gain_a
        if elements.damped:
            for i in range(6):
                dof = elements.dofs[e, i]
                for lane in range(n_lanes):
                    rate[i, lane] = v[dof, lane]
                    acceleration[i, lane] += properties[6, lane] * v[dof, lane]
            for lane in range(n_lanes):
                gain_m[lane] += properties[6, lane] * gain_v
            add_damping(
                u, rate, length, elements.direction[e], properties[:3], properties[5], gain_v, force, tangent, power,
                fresh,
            )  # fmt: skip
        for i in range(6):
            density = properties[3] if i % 3 < 2 else properties[4]
            other = (i + 3) % 6
            row = place[elements.dofs[e, i]]
            third = length / 3.0
            for lane in range(n_lanes):
                inertia = third * density[lane] * (acceleration[i, lane] + 0.5 * acceleration[other, lane])
                x[row, lane] += force[i, lane] + inertia
        if fresh:
            for t in range(N_PACKED):
                for lane in range(n_lanes):
                    tangent[t, lane] *= gain_k
            for i in range(6):
                density = properties[3] if i % 3 < 2 else properties[4]
                here = i * (i + 1) // 2 + i
                for lane in range(n_lanes):
                    tangent[here, lane] += gain_m[lane] * length / 3.0 * density[lane]
                if i >= 3:
                    for lane in range(n_lanes):
                        tangent[here - 3, lane] += gain_m[lane] * length / 6.0 * density[lane]
            for t in range(N_PACKED):
                add_entry(elements.positions[e, t], 1.0, tangent[t], diagonal, lower)


@njit(cache=True, error_model="numpy")
def add_lumps(lumps, mass, section, v, a, gains, fresh, x, place, diagonal, lower):
    """Add the inertia forces of the nodes' own masses to x, and their tangents to the matrix."""
    n_lanes = x.shape[1]
    gain_v, gain_a, _ = gains
    entry = np.empty(n_lanes)
    for k in range(lumps.dofs.size):
        dof = lumps.dofs[k]
        braking = section[lumps.body[k], 6]
        row = place[dof]
        for lane in range(n_lanes):
            x[row, lane] += mass[k, lane] * (a[dof, lane] + braking[lane] * v[dof, lane])
            entry[lane] = mass[k, lane] * (gain_a + braking[lane] * gain_v)
        if fresh:
            add_entry(lumps.positions[k], 1.0, entry, diagonal, lower)


@njit(cache=True, error_model="numpy", inline="always")
def evaluate(problem, block, amplitudes, angles, share, residual, state, gains, scale, fresh, x, diagonal, lower):
    """Evaluate the residual of a block, and the matrix.

    Parameters
    ----------
    problem, block
        The equations, and the number of the block.
    amplitudes, angles
        Those of loads and of actions, shapes (n_loads,) and (n_actions,); and of the motions, (n_motions,), rad.
    share
        What part of loads and actions acts.
    residual
        What stands for c, shape (n_constraints, n_lanes), or (0, n_lanes) for c itself.
    state
        ``(q, v, a, multipliers, turns)`` of the block. The angles `turns` are those of coordinates and of actions in
        space at the instant before, rad, shape (n_turns, n_lanes); those here are the nearest.
    gains, scale
        ``(gain_v, gain_a, gain_k)``, and that of the constraints, shape (n_lanes,).
    fresh
        Whether the matrix is wanted.
    x, diagonal, lower
        Results.
    """
    gain_k = gains[2]
    q, v, a, multipliers, turns = state
    section, place = problem.section[block], problem.pattern.place
    x[:] = 0.0
    if fresh:
        diagonal[:] = 0.0
        lower[:] = 0.0
    if problem.elements.length.size:
        add_elements(problem.elements, section, q, v, a, gains, fresh, x, place, diagonal, lower)
    if problem.lumps.dofs.size:
        add_lumps(problem.lumps, problem.lumps.mass[block], section, v, a, gains, fresh, x, place, diagonal, lower)
    if problem.solids.region.size:
        add_solids(problem.solids, block, q, v, a, gains, fresh, x, place, diagonal, lower)
    if problem.beams.length.size:
        add_beams(problem.beams, problem.rayleigh, block, q, v, a, gains, fresh, x, place, diagonal, lower)
    if problem.masses.body.size:
        add_masses(problem.masses, problem.rayleigh, block, v, a, gains, fresh, x, place, diagonal, lower)
    if problem.actions.laws.size:
        of_actions = turns[problem.angles.dofs.shape[0] :]
        add_actions(
            problem.actions, block, amplitudes[1], share, q, v, of_actions, gains, fresh, x, place, diagonal,
            lower,
        )  # fmt: skip
    if problem.modal.kinds.size:
        powers = np.empty((problem.modal.kinds.size, x.shape[1]))
        add_modal_damping(problem.modal, problem.dimension, q, v, x, place, powers)
    add_loads(problem.loads, block, amplitudes[0], share, x, place)
    add_constraints(
        problem.constraints, problem.dimension, angles, residual, q, multipliers, scale, gain_k, fresh, x, place,
        diagonal, lower,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def count_turns(problem, q, turns):
    """Put the angles of coordinates and actions in space, (n_turns, n_lanes), to those at q nearest to them."""
    n_angles = problem.angles.dofs.shape[0]
    if turns.shape[0]:
        _count(problem.angles.statements, problem.angles.dofs, q, turns[:n_angles])
        _count(problem.actions.statements, problem.actions.dofs, q, turns[n_angles:])


@njit(cache=True, error_model="numpy")
def _count(statements, dofs, q, turns):
    """Put statements near `turns`, (n, n_lanes), there."""
    n, m = dofs.shape
    scratch, y, g, h = scratch_of(statements, m // 2), np.zeros(m), np.zeros(m), np.zeros((1, 1))
    for k in range(n):
        for lane in range(q.shape[1]):
            for i in range(m):
                y[i] = q[dofs[k, i], lane] if dofs[k, i] >= 0 else 0.0
            angle = statement(statements, k, y, turns[k, lane], np.bool_(False), scratch, g, h)
            if np.isfinite(angle):
                turns[k, lane] = angle


@njit(cache=True, error_model="numpy")
def correct(problem, factors, blocks, amplitudes, angles, residual, state, gains, typical_mass, active, fresh, size):
    """Do one Newton correction of every active sample of some blocks in place.

    Parameters
    ----------
    problem, factors
        The equations, and the matrices that are kept.
    blocks
        The first block, and the one behind the last.
    amplitudes, angles, gains
        As for `evaluate`.
    residual
        What stands for c, shape (n_blocks, n_constraints, n_lanes), or (n_blocks, 0, n_lanes) for c itself.
    state
        ``(q, v, a, multipliers, turns)``, shapes (n_blocks, n_dofs, n_constraints or n_turns, n_lanes).
    typical_mass
        Whose inertia the constraints are scaled to, shape (n_blocks, n_lanes), kg; each sample's own, so that none is
        felt by another.
    active
        Shape (n_blocks, n_lanes).
    fresh
        Whether to evaluate and factorise the matrix anew.
    size
        Result, shape (n_blocks, n_lanes).
    """
    gain_v, gain_a, _ = gains
    n_dofs, n_lanes = state[0].shape[1:]
    n_constraints = state[3].shape[1]
    pattern = problem.pattern
    x, scale = np.empty((n_dofs + n_constraints, n_lanes)), np.empty(n_lanes)
    for block in range(blocks[0], blocks[1]):
        size[block] = 0.0
        if not active[block].any():
            continue
        own = state[0][block], state[1][block], state[2][block], state[3][block], state[4][block]
        diagonal, lower = factors.diagonal[block], factors.lower[block]
        for lane in range(n_lanes):
            scale[lane] = gain_a * typical_mass[block, lane]
        evaluate(problem, block, amplitudes, angles, 1.0, residual[block], own, gains, scale, fresh, x, diagonal, lower)
        if fresh:
            factorise(pattern.starts, pattern.rows, diagonal, lower)
        substitute(pattern.starts, pattern.rows, diagonal, lower, x)
        take_correction(problem.units, pattern.place, x, scale, gain_v, gain_a, active[block], own, size[block])


@njit(cache=True, error_model="numpy")
def take_correction(units, place, x, scale, gain_v, gain_a, active, state, size):
    """Correct the active samples of a block by the solution x in elimination order, and find its size (n_lanes,)."""
    q, v, a, multipliers, _ = state
    n_lanes = x.shape[1]
    for dof in range(q.shape[0]):
        at, unit = place[dof], units[dof]
        for lane in range(n_lanes):
            step = x[at, lane] if active[lane] else 0.0
            q[dof, lane] -= step
            v[dof, lane] -= gain_v * step
            a[dof, lane] -= gain_a * step
            moved = abs(step) * unit
            # written so that a NaN is kept
            if not moved <= size[lane]:
                size[lane] = moved
    for row in range(multipliers.shape[0]):
        at = place[q.shape[0] + row]
        for lane in range(n_lanes):
            if active[lane]:
                multipliers[row, lane] -= scale[lane] * x[at, lane]
