"""Continuum elements of full-order samples on one rank, compiled: their part of the residual, the matrix, the energy.

LANES columns are evaluated side by side: an element of as many samples, or of a single sample as many elements of one
material. What is evaluated is compiled once for both.

Beams and masses of frames in space of full-order samples on one rank, compiled: residual, matrix and energy.

Unknowns are natural coordinates, twelve a frame. Samples lie side by side in the last axis (lanes); see
`bodies.beam3d` for the element. With the moments ``J = int rho X X^T dV`` about a frame's position, the kinetic energy
of what moves with it is ``1/2 m p'.p' + 1/2 sum J_kl d_k'.d_l'``: one density, (4, 4), for every direction in space.
"""

from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.beam3d import N_ELEMENT, add_force, beam_work, fill_tangent, stretch, viscous_stress
from pgmp_petsc.bodies.elasticity import Cells, cell_work, evaluate_cells, n_work, strain_energies
from pgmp_petsc.full.forces import add_entry
from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.lanes.lane_items import WIDE, empty_lanes, items, keep, of_column
from pgmp_petsc.lanes.vectors import LANES

N_VECTORS = 4  # of a frame: position and directors
N_SECTION = 6  # coefficients of stiffness, the first of a section


class Beams(NamedTuple):
    """Beam elements in space."""

    dofs: np.ndarray  # shape (n_e, 24)
    #: length, axes: m, and the section's axes, shape (n_e, 3, 3)
    length: np.ndarray
    axes: np.ndarray
    body: np.ndarray  # number of the body, shape (n_e,)
    #: ``(EA, GA_2, GA_3, GJ, EI_2, EI_3, rho A, rho I_2, rho I_3)`` of every body, shape (n_blocks, n_bodies, 9,
    #: n_lanes)
    section: np.ndarray
    positions: np.ndarray  # where the matrix stores the packed entries, shape (n_e, 300)
    counted: np.ndarray  # whether an element is counted here, in sums over all ranks, shape (n_e,)


class Masses(NamedTuple):
    """Masses of frames in space."""

    dofs: np.ndarray  # shape (n, 12)
    body: np.ndarray  # number of the body, shape (n,)
    density: np.ndarray  # m and J, shape (n_blocks, n, 4, 4, n_lanes), kg and kg m2
    #: where the matrix stores the entries of two vectors in a direction, the second not behind the first, shape (n, 4,
    #: 4, 3)
    positions: np.ndarray
    counted: np.ndarray  # whether it is counted here, shape (n,)


@njit(cache=True, apart=True, error_model="numpy")
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
                            shared = (2.0 if i // 12 == j // 12 else 1.0) / 6.0  # of both shape functions
                            value += gain_m * shared * density[i // 3 % N_VECTORS, j // 3 % N_VECTORS]
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


@njit(cache=True, error_model="numpy")
def _inertia(density, moving, i):
    """Return row i of an element's mass matrix times a vector (24,)."""
    total, direction, vector = 0.0, i % 3, i // 3 % N_VECTORS
    for other in range(N_VECTORS):
        near, far = moving[i // 12 * 12 + 3 * other + direction], moving[(1 - i // 12) * 12 + 3 * other + direction]
        total += density[vector, other] * (2.0 * near + far) / 6.0
    return total


@njit(cache=True, apart=True, error_model="numpy")
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


@njit(cache=True, apart=True, error_model="numpy")
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


@njit(cache=True, apart=True, error_model="numpy")
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


class Solids(NamedTuple):
    """Continuum elements; those with fewer nodes or quadrature points than others have some without weight."""

    dofs: np.ndarray  # unknowns of the nodes' positions, -1 where an element has no such node, shape (n_e, n_a, d)
    #: gradients, volumes: ``dN_a/dX_j`` (n_e, n_q, n_a, d) and volumes (n_e, n_q)
    gradients: np.ndarray
    volumes: np.ndarray
    mass: np.ndarray  # ``int N_a N_b dV``, shape (n_e, n_a, n_a), m^d
    #: region, body: number of the material and of the body, shape (n_e,)
    region: np.ndarray
    body: np.ndarray
    lame: np.ndarray  # of the materials over Young's modulus, shape (n_regions, 2)
    rayleigh: np.ndarray  # beta (s) and alpha (1/s) of the materials' damping, shape (n_regions, 2)
    #: Young's modulus and density, in the plane times the thickness, shape (n_blocks, n_regions, 2, n_lanes)
    moduli: np.ndarray
    positions: np.ndarray  # where the matrix stores the packed entries, shape (n_e, m (m + 1) / 2); see `add_entry`
    counted: np.ndarray  # whether an element is counted here, in sums over all ranks, shape (n_e,)


class Columns(NamedTuple):
    """LANES cells as columns, the last axis of all arrays: their geometry, what the nodes do, and the material."""

    gradients: np.ndarray
    volumes: np.ndarray
    mass: np.ndarray
    places: np.ndarray
    rates: np.ndarray
    accelerations: np.ndarray
    material: np.ndarray
    forces: np.ndarray
    tangents: np.ndarray


@njit(inline="always")
def _columns(solids):
    n_q, n_nodes, d = solids.gradients.shape[1:]
    m, of_nodes = n_nodes * d, (n_nodes, d, LANES)
    nodal = empty_lanes(4 * m, LANES)
    nodal[:] = 0.0
    return Columns(
        empty_lanes(n_q * m, LANES).reshape((n_q, n_nodes, d, LANES)), empty_lanes(n_q, LANES),
        empty_lanes(n_nodes * n_nodes, LANES).reshape((n_nodes, n_nodes, LANES)), nodal[:m].reshape(of_nodes),
        nodal[m : 2 * m].reshape(of_nodes), nodal[2 * m : 3 * m].reshape(of_nodes), empty_lanes(2, LANES),
        nodal[3 * m :].reshape(of_nodes), empty_lanes(m * (m + 1) // 2, LANES),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _n_together(solids, first, n_lanes):
    """Return how many elements from `first` on are evaluated together: with several samples one."""
    last = first + 1
    while n_lanes == 1 and last < min(first + LANES, solids.region.size):
        one, other = solids.region[first], solids.region[last]
        same = solids.lame[one, 0] == solids.lame[other, 0] and solids.lame[one, 1] == solids.lame[other, 1]
        if not same or solids.body[first] != solids.body[last]:  # moduli may differ, damping is that of bodies
            break
        last += 1
    return last - first


@njit(cache=True, error_model="numpy")
def _gather(solids, block, first, n_elements, q, v, a, columns):
    """Fill the columns: lanes of one element, or elements of one lane, the last of them again in what is left."""
    n_q, n_nodes, d = solids.gradients.shape[1:]
    for c in range(LANES):
        e, lane = (first, c) if q.shape[1] > 1 else (first + min(c, n_elements - 1), 0)
        for point in range(n_q):
            columns.volumes[point, c] = solids.volumes[e, point]
            for node in range(n_nodes):
                for i in range(d):
                    columns.gradients[point, node, i, c] = solids.gradients[e, point, node, i]
        for node in range(n_nodes):
            for other in range(n_nodes):
                columns.mass[node, other, c] = solids.mass[e, node, other]
            for i in range(d):
                dof = solids.dofs[e, node, i]
                if dof >= 0:
                    columns.places[node, i, c] = q[dof, lane]
                    columns.rates[node, i, c] = v[dof, lane]
                    columns.accelerations[node, i, c] = a[dof, lane]
        columns.material[0, c] = solids.moduli[block, solids.region[e], 0, lane]
        columns.material[1, c] = solids.moduli[block, solids.region[e], 1, lane]


@njit(cache=True, apart=True, error_model="numpy", fastmath={"contract"})
def _evaluate(columns, lame, rayleigh, gains, fresh, work):
    """Fill the forces of the columns, inertia and damping with them, and their tangents."""
    gain_v, gain_a, gain_k = gains
    beta, alpha = rayleigh[0], rayleigh[1]
    mass, material = items(columns.mass, WIDE), items(columns.material, WIDE)
    rates, accelerations = items(columns.rates, WIDE), items(columns.accelerations, WIDE)
    forces, tangents = items(columns.forces, WIDE), items(columns.tangents, WIDE)
    cells = Cells(items(columns.gradients, WIDE), items(columns.volumes, WIDE))
    evaluate_cells(
        cells, (lame[0], lame[1]), material[0], beta, gain_v, items(columns.places, WIDE), rates, beta != 0.0, fresh,
        work, forces, tangents,
    )  # fmt: skip
    density, gain_m = material[1], gain_a + alpha * gain_v
    n_nodes, d = forces.shape
    for node in range(n_nodes):
        for i in range(d):
            moving = density * 0.0
            for other in range(n_nodes):
                moving += mass[node, other] * (accelerations[other, i] + alpha * rates[other, i])
            forces[node, i] += density * moving  # (M (q'' + alpha q'))_i
    for row in range(n_nodes * d if fresh else 0):
        first = row * (row + 1) // 2
        for column in range(row + 1):
            own = gain_k * tangents[first + column]
            if (row - column) % d == 0:
                own += gain_m * density * mass[row // d, column // d]
            tangents[first + column] = own


@njit(cache=True, apart=True, error_model="numpy")
def add_solids(solids, width, block, q, v, a, gains, fresh, x, place, diagonal, lower):
    """Add inertia, internal and damping forces of all elements to x, and their tangents to the matrix."""
    n_lanes, columns = q.shape[1], _columns(solids)
    n_nodes, d = solids.dofs.shape[1:]
    space = empty_lanes(n_work(n_nodes, d), LANES)
    work = cell_work(n_nodes, d, items(space, WIDE))
    x, diagonal, lower = items(x, width), items(diagonal, width), items(lower, width)
    positions = solids.positions
    first = np.int64(0)  # a literal would be another type, and everything compiled once more
    while first < solids.region.size:
        n_elements = _n_together(solids, first, n_lanes)
        region = solids.region[first]
        _gather(solids, block, first, n_elements, q, v, a, columns)
        _evaluate(columns, solids.lame[region], solids.rayleigh[region], gains, fresh, work)
        for c in range(n_elements):
            e = first + c
            for row in range(n_nodes * d):
                node, i = row // d, row % d
                dof, at = solids.dofs[e, node, i], row * (row + 1) // 2
                if dof < 0:
                    continue
                x[place[dof]] += of_column(columns.forces, row, c, width)
                for entry in range(at, at + row + 1 if fresh else at):
                    add_entry(positions[e, entry], of_column(columns.tangents, entry, c, width), diagonal, lower)
        first += n_elements
    keep(space)


@njit(cache=True, apart=True, error_model="numpy", fastmath={"contract"})
def _fill_energies(columns, lame, rayleigh, work, found):
    """Fill kinetic and strain energy of the columns, and the power of their damping, shape (3, LANES)."""
    beta, alpha = rayleigh[0], rayleigh[1]
    mass, rates, material = items(columns.mass, WIDE), items(columns.rates, WIDE), items(columns.material, WIDE)
    cells, places = Cells(items(columns.gradients, WIDE), items(columns.volumes, WIDE)), items(columns.places, WIDE)
    found, constants = items(found, WIDE), (lame[0], lame[1])
    moving = material[1] * 0.0  # q'.M q'
    for node in range(rates.shape[0]):
        for other in range(rates.shape[0]):
            for i in range(rates.shape[1]):
                moving += material[1] * mass[node, other] * (rates[node, i] * rates[other, i])
    found[0] = 0.5 * moving
    found[1] = strain_energies(cells, constants, material[0], places, work)
    found[2] = -alpha * moving
    if beta != 0.0:
        found[2] += evaluate_cells(
            cells, constants, material[0], beta, 0.0, places, rates, np.bool_(True), np.bool_(False), work,
            items(columns.forces, WIDE), items(columns.tangents, WIDE),
        )  # fmt: skip


@njit(cache=True, apart=True, error_model="numpy")
def add_energies(solids, block, q, v, kinetic, strain, powers):
    """Add kinetic and strain energy of the elements that are counted here, shape (n_lanes,), J, and the power of the
    damping of their bodies, shape (n_bodies, n_lanes), W."""
    n_lanes, columns, found = q.shape[1], _columns(solids), empty_lanes(3, LANES)
    n_nodes, d = solids.dofs.shape[1:]
    space = empty_lanes(n_work(n_nodes, d), LANES)
    work = cell_work(n_nodes, d, items(space, WIDE))
    first = np.int64(0)
    while first < solids.region.size:
        n_elements = _n_together(solids, first, n_lanes)
        region = solids.region[first]
        _gather(solids, block, first, n_elements, q, v, v, columns)
        _fill_energies(columns, solids.lame[region], solids.rayleigh[region], work, found)
        for e in range(first, first + n_elements):
            for lane in range(n_lanes if solids.counted[e] else 0):
                c = lane + e - first
                kinetic[lane] += found[0, c]
                strain[lane] += found[1, c]
                powers[solids.body[e], lane] += found[2, c]
        first += n_elements
    keep(space)
