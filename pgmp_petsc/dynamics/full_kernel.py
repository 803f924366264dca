"""Newton correction of the full-order equations of motion for a batch of samples, compiled.

    r   = M q'' + g_int(q) + C(q)^T lambda - g_ext(t),     c(q) = 0

(Naets et al. 2015, eq. (3)). One correction solves, for every sample by itself,

    [ gain_a M + gain_k K(q, lambda)   s C^T ] [  dq    ]     [  r  ]
    [ s C                               0    ] [ dlambda/s ] = - [ s c ]

with constraints scaled by s to the size of the inertia terms (Bottasso, Bauchau and Cardona 2007). Samples lie side by
side in the last axis (lanes); see `batched_ldl`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.beam2d import N_PACKED, add_damping, force_and_tangent
from pgmp_petsc.dynamics.batched_ldl import factorise, substitute
from pgmp_petsc.dynamics.full_forces import (
    BlockActions,
    Loads,
    ModalFactors,
    add_actions,
    add_entry,
    add_loads,
    add_modal_damping,
)
from pgmp_petsc.dynamics.node_constraints import NodeConstraints, add_constraints
from pgmp_petsc.runtime.compiled import njit


class Elements(NamedTuple):
    """Beam elements: unknowns (n_e, 6), length, direction, body, where their 21 entries lie, and whether any damps."""

    dofs: np.ndarray
    length: np.ndarray
    direction: np.ndarray
    body: np.ndarray
    positions: np.ndarray
    damped: bool


class Lumps(NamedTuple):
    """Masses of nodes: unknown, body and where the diagonal entry is stored (n_lumped,); and the masses, by lane.

    `mass` has shape (n_blocks, n_lumped, n_lanes).
    """

    dofs: np.ndarray
    body: np.ndarray
    positions: np.ndarray
    mass: np.ndarray


class Pattern(NamedTuple):
    """Numeric view of a symbolic factorisation; `place[unknown]` is its turn in the elimination."""

    place: np.ndarray
    starts: np.ndarray
    rows: np.ndarray
    targets: np.ndarray


class FullProblem(NamedTuple):
    """The equations of all samples, block by block.

    Attributes
    ----------
    elements, lumps, loads, actions, modal, constraints
        What there is.
    pattern
        Of the iteration matrix.
    section
        ``(EA, k_s GA, EI, rho A, rho I, beta, alpha)`` of every body, shape (n_blocks, n_bodies, 7, n_lanes); the last
        two are those of structural damping.
    node_mass
        Mass of a node in the mean, shape (n_blocks, n_lanes), kg; each sample's own, so that none is felt by another.
    units
        1/size for translations, 1 for rotations, shape (n_dofs,).
    """

    elements: Elements
    lumps: Lumps
    loads: Loads
    actions: BlockActions
    modal: ModalFactors
    constraints: NodeConstraints
    pattern: Pattern
    section: np.ndarray
    node_mass: np.ndarray
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


@njit(cache=True, error_model="numpy")
def correct(problem, factors, blocks, amplitudes, angles, residual, state, gains, active, fresh, size):
    """Do one Newton correction of every active sample of some blocks in place.

    Parameters
    ----------
    problem, factors
        The equations, and the matrices that are kept.
    blocks
        The first block, and the one behind the last.
    amplitudes, angles
        Those of loads and of actions, shapes (n_loads,) and (n_actions,); and of the motions, (n_motions,), rad.
    residual
        What stands for c, shape (n_blocks, n_constraints, n_lanes), or (n_blocks, 0, n_lanes) for c itself.
    state
        ``(q, v, a, multipliers)``, shapes (n_blocks, n_dofs or n_constraints, n_lanes).
    gains
        ``(gain_v, gain_a, gain_k)``.
    active
        Shape (n_blocks, n_lanes).
    fresh
        Whether to evaluate and factorise the matrix anew.
    size
        Result, shape (n_blocks, n_lanes).
    """
    gain_v, gain_a, gain_k = gains
    n_dofs, n_lanes = state[0].shape[1:]
    n_constraints = state[3].shape[1]
    place = problem.pattern.place
    x, scale = np.empty((n_dofs + n_constraints, n_lanes)), np.empty(n_lanes)
    for block in range(blocks[0], blocks[1]):
        size[block] = 0.0
        if not active[block].any():
            continue
        q, v, a, multipliers = state[0][block], state[1][block], state[2][block], state[3][block]
        section, diagonal, lower = problem.section[block], factors.diagonal[block], factors.lower[block]
        x[:] = 0.0
        if fresh:
            diagonal[:] = 0.0
            lower[:] = 0.0
        for lane in range(n_lanes):
            scale[lane] = gain_a * problem.node_mass[block, lane]
        add_elements(problem.elements, section, q, v, a, gains, fresh, x, place, diagonal, lower)
        if problem.lumps.dofs.size:
            add_lumps(
                problem.lumps, problem.lumps.mass[block], section, v, a, gains, fresh, x, place, diagonal, lower
            )
        if problem.actions.laws.size:
            add_actions(problem.actions, block, amplitudes[1], q, v, gains, fresh, x, place, diagonal, lower)
        if problem.modal.dofs.size:
            add_modal_damping(problem.modal, q, v, x, place, np.empty((problem.modal.starts.size - 1, n_lanes)))
        add_loads(problem.loads, block, amplitudes[0], x, place)
        add_constraints(
            problem.constraints, angles, residual[block], q, multipliers, scale, gain_k, fresh, x,
            place, diagonal, lower,
        )  # fmt: skip
        if fresh:
            factorise(problem.pattern.starts, problem.pattern.targets, diagonal, lower)
        substitute(problem.pattern.starts, problem.pattern.rows, diagonal, lower, x)
        take_correction(
            problem.units, place, x, scale, gain_v, gain_a, active[block], (q, v, a, multipliers), size[block]
        )


@njit(cache=True, error_model="numpy")
def take_correction(units, place, x, scale, gain_v, gain_a, active, state, size):
    """Correct the active samples of a block by the solution x in elimination order, and find its size (n_lanes,)."""
    q, v, a, multipliers = state
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
