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
from pgmp_petsc.dynamics.lanes import LANES
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

    `mass` has shape (n_blocks, n_lumped, LANES).
    """

    dofs: np.ndarray
    body: np.ndarray
    positions: np.ndarray
    mass: np.ndarray


class Entries(NamedTuple):
    """Sparse entries with numbers a lane: row, column (or load and unknown), and where the matrix stores them."""

    rows: np.ndarray
    columns: np.ndarray
    positions: np.ndarray


class Pattern(NamedTuple):
    """Numeric view of a symbolic factorisation; `place[unknown]` is its turn in the elimination."""

    place: np.ndarray
    starts: np.ndarray
    rows: np.ndarray
    targets: np.ndarray


@njit(cache=True, error_model="numpy")
def add_entry(position, factor, values, diagonal, lower):
    """Add ``factor * values`` (LANES,) at a stored position."""
    n_lanes = diagonal.shape[1]
    if position < 0:
        for lane in range(n_lanes):
            diagonal[-1 - position, lane] += factor * values[lane]
    else:
        for lane in range(n_lanes):
            lower[position, lane] += factor * values[lane]


@njit(cache=True, error_model="numpy")
def add_elements(elements, section, q, v, a, gains, fresh, x, place, diagonal, lower):
    """Add inertia and internal forces of all elements to x, and their tangents to the matrix."""
    n_lanes = x.shape[1]
    gain_v, gain_a, gain_k = gains
    u, acceleration = np.empty((6, LANES)), np.empty((6, LANES))
    rate, power, gain_m = np.empty((6, LANES)), np.empty(LANES), np.empty(LANES)
    force, tangent = np.empty((6, LANES)), np.empty((N_PACKED, LANES))
    for e in range(elements.length.size):
        length, properties = elements.length[e], section[elements.body[e]]
        for i in range(6):
            dof = elements.dofs[e, i]
            for lane in range(n_lanes):
                u[i, lane] = q[dof, lane]
                acceleration[i, lane] = a[dof, lane]
        force_and_tangent(u, length, elements.direction[e], properties[:3], force, tangent)
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
                u, rate, length, elements.direction[e], properties[:3], properties[5], gain_v, force, tangent, power
            )
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
    entry = np.empty(LANES)
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
def add_constraints(jacobian, values, residual, multipliers, first_row, scale, fresh, x, place, diagonal, lower):
    """Add ``C^T lambda`` and ``s c`` to x, and ``s C`` to the matrix; `values` are the entries of C, by lane."""
    n_lanes = x.shape[1]
    scaled = np.empty(LANES)
    for k in range(jacobian.rows.size):
        row, at = jacobian.rows[k], place[jacobian.columns[k]]
        for lane in range(n_lanes):
            x[at, lane] += values[k, lane] * multipliers[row, lane]
        if fresh:
            for lane in range(n_lanes):
                scaled[lane] = scale[lane] * values[k, lane]
            add_entry(jacobian.positions[k], 1.0, scaled, diagonal, lower)
    for row in range(residual.shape[0]):
        at = place[first_row + row]
        for lane in range(n_lanes):
            x[at, lane] += scale[lane] * residual[row, lane]


@njit(cache=True, error_model="numpy")
def correct(
    elements, lumps, section, jacobian, curvature, loads, pattern, constraint, load_factors, local, state, gains, scale,
    active, fresh, factors, units, size,
):
    """Do one Newton correction of every active sample in place.

    Parameters
    ----------
    elements, pattern
        Structure of the problem.
    section
        ``(EA, k_s GA, EI, rho A, rho I, beta, alpha)`` of every body, shape (n_blocks, n_bodies, 7, LANES); the last
        two are those of structural damping.
    lumps
        Masses of nodes.
    jacobian, curvature
        Entries of C, and of ``sum lambda d2c/dq2`` and of the local forces' tangents (lower triangle).
    loads
        Entries (load, unknown) of the load vectors; `positions` is not used.
    constraint
        ``(residual, jacobian values, curvature values, load values)``: shapes (n_blocks, n_constraints, LANES),
        (n_blocks, n_entries, LANES), (n_blocks, n_curvature_entries, LANES), (n_load_entries,).
    load_factors
        Amplitude times weight of every load, shape (n_blocks, n_loads, LANES).
    local
        Forces of local effects on all unknowns, shape (n_blocks, n_dofs, LANES), or (n_blocks, 0, LANES) without any.
    state
        ``(q, v, a, multipliers)``, shapes (n_blocks, n_dofs or n_constraints, LANES).
    gains
        ``(gain_v, gain_a, gain_k)``.
    scale
        Of the constraints, shape (n_blocks, LANES).
    active
        Shape (n_blocks, LANES).
    fresh
        Whether to evaluate and factorise the matrix anew.
    factors
        ``(diagonal, lower)`` of every block.
    units
        1/size for translations, 1 for rotations, shape (n_dofs,).
    size
        Result, shape (n_blocks, LANES).
    """
    n_lanes = active.shape[1]
    q, v, a, multipliers = state
    residual, jacobian_values, curvature_values, load_values = constraint
    gain_v, gain_a, gain_k = gains
    n_dofs, n_constraints = q.shape[1], residual.shape[1]
    x = np.empty((n_dofs + n_constraints, LANES))
    for block in range(q.shape[0]):
        if not active[block].any():
            for lane in range(n_lanes):
                size[block, lane] = 0.0
            continue
        diagonal, lower = factors[0][block], factors[1][block]
        x[:] = 0.0
        if fresh:
            diagonal[:] = 0.0
            lower[:] = 0.0
        add_elements(
            elements, section[block], q[block], v[block], a[block], gains, fresh, x, pattern.place, diagonal, lower
        )
        add_lumps(
            lumps,
            lumps.mass[block],
            section[block],
            v[block],
            a[block],
            gains,
            fresh,
            x,
            pattern.place,
            diagonal,
            lower,
        )
        for dof in range(local.shape[1]):
            at = pattern.place[dof]
            for lane in range(n_lanes):
                x[at, lane] -= local[block, dof, lane]
        for k in range(loads.rows.size):
            at, value, factor = pattern.place[loads.columns[k]], load_values[k], load_factors[block, loads.rows[k]]
            for lane in range(n_lanes):
                x[at, lane] -= value * factor[lane]
        add_constraints(
            jacobian, jacobian_values[block], residual[block], multipliers[block], n_dofs, scale[block], fresh, x,
            pattern.place, diagonal, lower,
        )
        if fresh:
            for k in range(curvature.positions.size):
                add_entry(curvature.positions[k], gain_k, curvature_values[block, k], diagonal, lower)
            factorise(pattern.starts, pattern.targets, diagonal, lower)
        substitute(pattern.starts, pattern.rows, diagonal, lower, x)
        for lane in range(n_lanes):
            size[block, lane] = 0.0
        for dof in range(n_dofs):
            at, unit = pattern.place[dof], units[dof]
            for lane in range(n_lanes):
                step = x[at, lane] if active[block, lane] else 0.0
                q[block, dof, lane] -= step
                v[block, dof, lane] -= gain_v * step
                a[block, dof, lane] -= gain_a * step
                moved = abs(step) * unit
                # written so that a NaN is kept
                if not moved <= size[block, lane]:
                    size[block, lane] = moved
        for row in range(n_constraints):
            at = pattern.place[n_dofs + row]
            for lane in range(n_lanes):
                if active[block, lane]:
                    multipliers[block, row, lane] -= scale[block, lane] * x[at, lane]
