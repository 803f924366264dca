"""Beams and masses of frames in space of full-order samples on one rank, compiled: residual, matrix and energy.

Unknowns are natural coordinates, twelve a frame. Samples lie side by side in the last axis (lanes); see
`bodies.beam3d` for the element. With the moments ``J = int rho X X^T dV`` about a frame's position, the kinetic energy
of what moves with it is ``1/2 m p'.p' + 1/2 sum J_kl d_k'.d_l'``: one density, (4, 4), for every direction in space.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.beam3d import N_ELEMENT, add_force, beam_work, fill_tangent, stretch, viscous_stress
from pgmp_petsc.dynamics.full_forces import add_entry
from pgmp_petsc.runtime.lane_items import items
from pgmp_petsc.runtime.compiled import njit

N_VECTORS = 4  # of a frame: position and directors
N_SECTION = 6  # coefficients of stiffness, the first of a section


class Beams(NamedTuple):
    """Beam elements in space.

    Attributes
    ----------
    dofs
        Shape (n_e, 24).
    length, axes
        m, and the section's axes, shape (n_e, 3, 3).
    body
        Number of the body, shape (n_e,).
    section
        ``(EA, GA_2, GA_3, GJ, EI_2, EI_3, rho A, rho I_2, rho I_3)`` of every body, shape (n_blocks, n_bodies, 9,
        n_lanes).
    positions
        Where the matrix stores the packed entries, shape (n_e, 300).
    counted
        Whether an element is counted here, in sums over all ranks, shape (n_e,).
    """

    dofs: np.ndarray
    length: np.ndarray
    axes: np.ndarray
    body: np.ndarray
    section: np.ndarray
    positions: np.ndarray
    counted: np.ndarray


class Masses(NamedTuple):
    """Masses of frames in space.

    Attributes
    ----------
    dofs
        Shape (n, 12).
    body
        Number of the body, shape (n,).
    density
        m and J, shape (n_blocks, n, 4, 4, n_lanes), kg and kg m2.
    positions
        Where the matrix stores the entries of two vectors in a direction, the second not behind the first, shape (n, 4,
        4, 3).
    counted
        Whether it is counted here, shape (n,).
    """

    dofs: np.ndarray
    body: np.ndarray
    density: np.ndarray
    positions: np.ndarray
    counted: np.ndarray


@njit(cache=True, error_model="numpy")
def add_beams(beams, width, rayleigh, block, q, v, a, gains, fresh, x, place, diagonal, lower):
    """Add inertia, internal and damping forces of all elements to x, and their tangents to the matrix."""
    gain_v, gain_a, gain_k = gains
    u, rate, moving = np.empty(N_ELEMENT), np.empty(N_ELEMENT), np.empty(N_ELEMENT)
    force, stress, tangent = np.empty(N_ELEMENT), np.empty(6), np.empty(N_ELEMENT * (N_ELEMENT + 1) // 2)
    density, work = np.empty((N_VECTORS, N_VECTORS)), beam_work()
    for e in range(beams.length.size):
        body = beams.body[e]
        beta, alpha = rayleigh[body]
        for lane in range(q.shape[1]):
            for i in range(N_ELEMENT):
                dof = beams.dofs[e, i]
                u[i], rate[i] = q[dof, lane], v[dof, lane]
                moving[i] = a[dof, lane] + alpha * rate[i]
            section = beams.section[block, body, :, lane]
            stretch(u, beams.length[e], beams.axes[e], section[:N_SECTION], work)
            force[:] = 0.0
            add_force(work, work.stress, force)
            if beta != 0.0:
                viscous_stress(work, rate, stress)
                for s in range(6):
                    stress[s] *= beta
                add_force(work, stress, force)
            _density(beams.axes[e], section, beams.length[e], density)
            for i in range(N_ELEMENT):
                row = place[beams.dofs[e, i]]
                x[row, lane] += force[i] + _inertia(density, moving, i)
            if fresh:
                fill_tangent(work, beams.length[e], beta * gain_v, tangent)
                gain_m = gain_a + alpha * gain_v
                at = 0
                for i in range(N_ELEMENT):
                    for j in range(i + 1):
                        value = gain_k * tangent[at]
                        if i % 3 == j % 3:
                            value += gain_m * _shared(i, j) * density[i // 3 % N_VECTORS, j // 3 % N_VECTORS]
                        position = beams.positions[e, at]
                        if position < 0:
                            diagonal[-1 - position, lane] += value
                        else:
                            lower[position, lane] += value
                        at += 1


@njit(cache=True, error_model="numpy")
def _density(axes, section, length, density):
    """Fill the mass of an element per pair of vectors: ``rho A`` and ``rho I_3 T_2 T_2^T + rho I_2 T_3 T_3^T``."""
    density[:] = 0.0
    density[0, 0] = section[6] * length
    for i in range(3):
        for j in range(3):
            moment = section[8] * axes[i, 1] * axes[j, 1] + section[7] * axes[i, 2] * axes[j, 2]
            density[1 + i, 1 + j] = moment * length


@njit(inline="always")
def _shared(i, j):
    """Return the integral of the shape functions of two unknowns' nodes over the length."""
    return (2.0 if i // 12 == j // 12 else 1.0) / 6.0


@njit(cache=True, error_model="numpy")
def _inertia(density, moving, i):
    """Return row i of an element's mass matrix times a vector (24,)."""
    total, direction, vector = 0.0, i % 3, i // 3 % N_VECTORS
    for other in range(N_VECTORS):
        near, far = moving[i // 12 * 12 + 3 * other + direction], moving[(1 - i // 12) * 12 + 3 * other + direction]
        total += density[vector, other] * (2.0 * near + far) / 6.0
    return total


@njit(cache=True, error_model="numpy")
def add_masses(masses, width, rayleigh, block, v, a, gains, fresh, x, place, diagonal, lower):
    """Add inertia and braking of all frames with masses to x, and their tangents to the matrix."""
    v, a, x, densities = items(v, width), items(a, width), items(x, width), items(masses.density, width)
    diagonal, lower = items(diagonal, width), items(lower, width)
    gain_v, gain_a, _ = gains
    for k in range(masses.body.size):
        alpha = rayleigh[masses.body[k], 1]
        for one in range(N_VECTORS):
            for other in range(N_VECTORS):
                mass = densities[block, k, one, other]
                for c in range(3):
                    dof = masses.dofs[k, 3 * other + c]
                    x[place[masses.dofs[k, 3 * one + c]]] += mass * (a[dof] + alpha * v[dof])
                    if fresh and other <= one:
                        position = masses.positions[k, one, other, c]
                        add_entry(position, (gain_a + alpha * gain_v) * mass, diagonal, lower)


@njit(cache=True, error_model="numpy")
def add_energies_of_beams(beams, rayleigh, block, q, v, kinetic, strain, powers):
    """Add kinetic and strain energy of the elements that are counted here, shape (n_lanes,), J, and the power of the
    damping of their bodies, shape (n_bodies, n_lanes), W."""
    u, rate, stress, work = np.empty(N_ELEMENT), np.empty(N_ELEMENT), np.empty(6), beam_work()
    density = np.empty((N_VECTORS, N_VECTORS))
    for e in range(beams.length.size):
        beta, alpha = rayleigh[beams.body[e]]
        for lane in range(q.shape[1] if beams.counted[e] else 0):
            for i in range(N_ELEMENT):
                u[i], rate[i] = q[beams.dofs[e, i], lane], v[beams.dofs[e, i], lane]
            section = beams.section[block, beams.body[e], :, lane]
            strain[lane] += stretch(u, beams.length[e], beams.axes[e], section[:N_SECTION], work)
            _density(beams.axes[e], section, beams.length[e], density)
            moving = 0.0  # q'.M q'
            for i in range(N_ELEMENT):
                moving += rate[i] * _inertia(density, rate, i)
            kinetic[lane] += 0.5 * moving
            powers[beams.body[e], lane] -= alpha * moving
            if beta != 0.0:
                powers[beams.body[e], lane] -= beta * viscous_stress(work, rate, stress)


@njit(cache=True, error_model="numpy")
def add_energies_of_masses(masses, rayleigh, block, v, kinetic, powers):
    """Add the kinetic energy of the frames that are counted here, and the power of what brakes them."""
    for k in range(masses.body.size):
        alpha = rayleigh[masses.body[k], 1]
        for lane in range(v.shape[1] if masses.counted[k] else 0):
            moving = 0.0
            for one in range(N_VECTORS):
                for other in range(N_VECTORS):
                    for c in range(3):
                        product = v[masses.dofs[k, 3 * one + c], lane] * v[masses.dofs[k, 3 * other + c], lane]
                        moving += masses.density[block, k, one, other, lane] * product
            kinetic[lane] += 0.5 * moving
            powers[masses.body[k], lane] -= alpha * moving
