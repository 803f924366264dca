"""Continuum elements of full-order samples on one rank, compiled: their part of the residual, the matrix, the energy.

Samples lie side by side in the last axis (lanes). Of a single sample as many elements of one material are evaluated
side by side.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.continuum import Cells, cell_work, evaluate_cells, strain_energies
from pgmp_petsc.dynamics.full_forces import add_entry
from pgmp_petsc.runtime.compiled import njit

TOGETHER = 16  # elements of a single sample that are evaluated side by side: what fits the vectors of any machine


class Solids(NamedTuple):
    """Continuum elements; those with fewer nodes or quadrature points than others have some without weight.

    Attributes
    ----------
    dofs
        Unknowns of the nodes' positions, -1 where an element has no such node, shape (n_e, n_a, d).
    gradients, volumes
        ``dN_a/dX_j`` (n_e, n_q, n_a, d) and volumes (n_e, n_q).
    mass
        ``int N_a N_b dV``, shape (n_e, n_a, n_a), m^d.
    region, body
        Number of the material and of the body, shape (n_e,).
    lame
        Of the materials over Young's modulus, shape (n_regions, 2).
    rayleigh
        beta (s) and alpha (1/s) of the materials' damping, shape (n_regions, 2).
    moduli
        Young's modulus and density, in the plane times the thickness, shape (n_blocks, n_regions, 2, n_lanes).
    positions
        Where the matrix stores the packed entries, shape (n_e, m (m + 1) / 2); see `add_entry`.
    counted
        Whether an element is counted here, in sums over all ranks, shape (n_e,).
    """

    dofs: np.ndarray
    gradients: np.ndarray
    volumes: np.ndarray
    mass: np.ndarray
    region: np.ndarray
    body: np.ndarray
    lame: np.ndarray
    rayleigh: np.ndarray
    moduli: np.ndarray
    positions: np.ndarray
    counted: np.ndarray


class _Columns(NamedTuple):
    """Cells as columns, what the nodes do, and what the columns' material is."""

    cells: Cells
    places: np.ndarray
    rates: np.ndarray
    accelerations: np.ndarray
    modulus: np.ndarray
    density: np.ndarray


@njit(cache=True, error_model="numpy")
def _columns(solids, n):
    n_q, n_nodes, d = solids.gradients.shape[1:]
    of_nodes = (n_nodes, d, n)
    return _Columns(
        Cells(np.empty((n_q, n_nodes, d, n)), np.empty((n_q, n))),
        np.zeros(of_nodes), np.zeros(of_nodes), np.zeros(of_nodes), np.empty(n), np.empty(n),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _n_together(solids, first, n_lanes):
    """Return how many elements from `first` on are evaluated together: with several samples one."""
    last = first + 1
    while n_lanes == 1 and last < min(first + TOGETHER, solids.region.size):
        if solids.region[last] != solids.region[first]:
            break
        last += 1
    return last - first


@njit(cache=True, error_model="numpy")
def _gather(solids, block, first, n_elements, q, v, a, columns):
    """Fill the columns: lanes of one element, or elements of one lane, the last of them again in what is left."""
    n_q, n_nodes, d = solids.gradients.shape[1:]
    g, volumes = columns.cells
    for c in range(volumes.shape[1]):
        e, lane = (first, c) if q.shape[1] > 1 else (first + min(c, n_elements - 1), 0)
        for point in range(n_q):
            volumes[point, c] = solids.volumes[e, point]
            for node in range(n_nodes):
                for i in range(d):
                    g[point, node, i, c] = solids.gradients[e, point, node, i]
        for node in range(n_nodes):
            for i in range(d):
                dof = solids.dofs[e, node, i]
                if dof >= 0:
                    columns.places[node, i, c] = q[dof, lane]
                    columns.rates[node, i, c] = v[dof, lane]
                    columns.accelerations[node, i, c] = a[dof, lane]
        columns.modulus[c] = solids.moduli[block, solids.region[e], 0, lane]
        columns.density[c] = solids.moduli[block, solids.region[e], 1, lane]


@njit(cache=True, error_model="numpy")
def add_solids(solids, block, q, v, a, gains, fresh, x, place, diagonal, lower):
    """Add inertia, internal and damping forces of all elements to x, and their tangents to the matrix."""
    n_lanes = q.shape[1]
    gain_v, gain_a, gain_k = gains
    n_nodes, d = solids.dofs.shape[1:]
    n = n_lanes if n_lanes > 1 else TOGETHER
    columns, work = _columns(solids, n), cell_work(n_nodes, d, n)
    forces, powers, entry = np.empty((n_nodes, d, n)), np.empty(n), np.empty(n_lanes)
    tangents = np.empty((n_nodes * d * (n_nodes * d + 1) // 2, n))
    first = np.int64(0)  # a literal would be another type, and everything compiled once more
    while first < solids.region.size:
        n_elements = _n_together(solids, first, n_lanes)
        region = solids.region[first]
        beta, alpha = solids.rayleigh[region]
        _gather(solids, block, first, n_elements, q, v, a, columns)
        evaluate_cells(
            columns.cells, (solids.lame[region, 0], solids.lame[region, 1]), columns.modulus, beta, gain_v,
            columns.places, columns.rates, beta != 0.0, fresh, work, forces, tangents, powers,
        )  # fmt: skip
        for e in range(first, first + n_elements):
            for node in range(n_nodes):
                for i in range(d):
                    dof = solids.dofs[e, node, i]
                    if dof < 0:
                        continue
                    row = place[dof]
                    for lane in range(n_lanes):
                        x[row, lane] += forces[node, i, lane + e - first]
                    for other in range(n_nodes):
                        shared = solids.mass[e, node, other]
                        for lane in range(n_lanes):
                            c = lane + e - first
                            moving = columns.accelerations[other, i, c] + alpha * columns.rates[other, i, c]
                            x[row, lane] += columns.density[c] * shared * moving  # (M (q'' + alpha q'))_i
        if fresh:
            gain_m = gain_a + alpha * gain_v
            for e in range(first, first + n_elements):
                at = 0
                for node in range(n_nodes):
                    for i in range(d):
                        for other in range(node + 1):
                            shared = gain_m * solids.mass[e, node, other]
                            for j in range(d if other < node else i + 1):
                                if solids.dofs[e, node, 0] >= 0:  # other has a lower number
                                    for lane in range(n_lanes):
                                        entry[lane] = gain_k * tangents[at, lane + e - first]
                                    if i == j:
                                        for lane in range(n_lanes):
                                            entry[lane] += columns.density[lane + e - first] * shared
                                    add_entry(solids.positions[e, at], 1.0, entry, diagonal, lower)
                                at += 1
        first += n_elements


@njit(cache=True, error_model="numpy")
def add_energies(solids, block, q, v, kinetic, strain, powers):
    """Add kinetic and strain energy of the elements that are counted here, shape (n_lanes,), J, and the power of the
    damping of their bodies, shape (n_bodies, n_lanes), W."""
    n_lanes = q.shape[1]
    n_nodes, d = solids.dofs.shape[1:]
    n = n_lanes if n_lanes > 1 else TOGETHER
    columns, work = _columns(solids, n), cell_work(n_nodes, d, n)
    forces, damped, energies, unused = np.empty((n_nodes, d, n)), np.zeros(n), np.empty(n), np.empty((1, 1))
    first = np.int64(0)
    while first < solids.region.size:
        n_elements = _n_together(solids, first, n_lanes)
        region = solids.region[first]
        beta, alpha = solids.rayleigh[region]
        lame = (solids.lame[region, 0], solids.lame[region, 1])
        _gather(solids, block, first, n_elements, q, v, v, columns)
        strain_energies(columns.cells, lame, columns.modulus, columns.places, work, energies)
        if beta != 0.0:
            evaluate_cells(
                columns.cells, lame, columns.modulus, beta, 0.0, columns.places, columns.rates, beta != 0.0,
                np.bool_(False), work, forces, unused, damped,
            )  # fmt: skip
        for e in range(first, first + n_elements):
            for lane in range(n_lanes if solids.counted[e] else 0):
                c = lane + e - first
                moving = 0.0  # q'.M q'
                for node in range(n_nodes):
                    for other in range(n_nodes):
                        for i in range(d):
                            product = columns.rates[node, i, c] * columns.rates[other, i, c]
                            moving += columns.density[c] * solids.mass[e, node, other] * product
                kinetic[lane] += 0.5 * moving
                strain[lane] += energies[c]
                powers[solids.body[e], lane] += damped[c] - alpha * moving
        first += n_elements
