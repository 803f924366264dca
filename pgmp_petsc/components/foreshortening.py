"""Foreshortening: the displacements of second order of a body of beams that bends.

With the axis t of an element, its slope u' and rotation phi, the axial strain of `beam2d` and `beam3d` is

    t.u' + 1/2 eps[xi, xi],    eps[a, b] = theta_a.u'_b + theta_b.u'_a - theta_a.theta_b,    theta = phi x t,

to second order. Left to the amplitudes that stretch the body, it would stiffen the bending, and a model of second order
needs these amplitudes with all their inertia and a cubic strain energy that has no lower bound. Instead the body
follows it at once (`stretching = "static"`): its displacements chi of second order are the static answer to strains of
``-eps[psi_i, psi_j]``,

    K chi_ij = -int EA eps[psi_i, psi_j] t.v' dx    for all v,

orthogonal to the rigid motions in the mass. A straight beam is then as long as before. Forces on its ends and inertia
forces do work on chi, which is what stiffens a spinning or stretched beam. What of psi stretches the body itself takes
no part in eps: its share is the operator ``S = (Psi^T K Psi)^-1 Psi^T K_axial Psi``, made steeper by ``3 S^2 - 2 S^3``
as in the reduced model (`modes.curvature`).
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.bodies.body import Body


def foreshortening(
    body: Body, modes: np.ndarray, stiffness: np.ndarray, axial: float, elastic: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Return chi of every pair of modes, shape (n_dofs, n, n), 1/m.

    Parameters
    ----------
    body
        Of beams.
    modes
        Displacement fields, shape (n_dofs, n).
    stiffness
        Of the amplitudes of the modes, shape (n, n), N/m.
    axial
        EA, N.
    elastic
        Eigenvalues and M-orthonormal elastic modes of the free body, all of them, shapes (m,) and (n_dofs, m).
    """
    mesh, d, n = body.mesh, body.mesh.nodes.shape[1], modes.shape[1]
    first, second = mesh.cells.T
    lengths = mesh.lengths[:, None, None]
    along = np.diff(mesh.nodes[mesh.cells], axis=1)[:, 0] / mesh.lengths[:, None]

    def slopes_and_turns(fields: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        by_node = fields.reshape(mesh.n_nodes, body.node_dofs, n)
        slopes = (by_node[second, :d] - by_node[first, :d]) / lengths
        turned = 0.5 * (by_node[first, d:] + by_node[second, d:])
        if d == 2:
            return slopes, np.stack([-along[:, 1], along[:, 0]], axis=1)[:, :, None] * turned
        return slopes, np.cross(turned, along[:, :, None], axisa=1, axisb=1, axisc=1)

    stretches = np.einsum("ec,ecn->en", along, slopes_and_turns(modes)[0])
    share = np.linalg.solve(stiffness, axial * np.einsum("en,em,e->nm", stretches, stretches, mesh.lengths))
    bending = np.eye(n) - share @ share @ (3.0 * np.eye(n) - 2.0 * share)
    slopes, turns = slopes_and_turns(modes @ bending)
    mixed = np.einsum("eci,ecj->eij", turns, slopes)
    strain = mixed + mixed.swapaxes(1, 2) - np.einsum("eci,ecj->eij", turns, turns)
    pull = axial * np.einsum("ec,eij->ecij", along, strain)
    forces = np.zeros((mesh.n_nodes, body.node_dofs, n, n))
    np.add.at(forces[:, :d], second, pull)
    np.add.at(forces[:, :d], first, -pull)
    values, vectors = elastic
    answers = (vectors.T @ forces.reshape(-1, n * n)) / values[:, None]
    return -(vectors @ answers).reshape(-1, n, n)
