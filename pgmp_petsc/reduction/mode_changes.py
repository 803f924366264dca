"""How modes change with theta: the kinetic energy of ``D_k = d(R Psi)/d theta_k``, left out by eq. (7) of the paper.

A flexible mode moves with the velocity ``sum_k theta_k' D_k delta`` even where delta is constant. In body frames
``D_k = d_k Psi + w_k x Psi``, with d_k Psi from the interpolated projection, w_k the body's spin per unit of theta_k.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.sample_grid import SampleGrid


@dataclass(frozen=True, eq=False)
class ModeChanges:
    """Tables of changing modes at n samples.

    Attributes
    ----------
    gyroscopic
        Skew part of ``D_k^T M_i Psi``, shape (n, n_mass_terms, n_theta, n_delta, n_delta). Its symmetric part is half
        the derivative of ``Psi^T M_i Psi``, which vanishes at the nominal parameters.
    spread
        Symmetric part of ``D_k^T M_i D_l``, pairs k >= l, shape (n, n_mass_terms, n_pairs, n_delta, n_delta).
    """

    gyroscopic: np.ndarray
    spread: np.ndarray


def mode_changes(
    kinematics: RigidKinematics,
    masses: Mapping[Monomial, sp.csr_matrix],
    samples: SampleGrid,
    projection: np.ndarray,
    scheme: str,
) -> ModeChanges:
    """Return the tables of changing modes, in the plane.

    Parameters
    ----------
    masses
        All rows of the mass terms, in body frames, shape (n_dofs, n_dofs) each.
    projection
        Flexible vectors in body frames, shape (n, n_dofs, n_delta), continuous.
    scheme
        Interpolation over the samples.
    """
    mechanism, r = kinematics.mechanism, kinematics.n_coordinates
    rates = kinematics.rates(kinematics.poses(samples.theta))
    over = interpolant(samples, projection, scheme)
    slopes = [over.slope(samples.theta, k) for k in range(r)]
    n, n_dofs, m = projection.shape
    n_terms, pairs = len(mechanism.mass_weights), np.tril_indices(r)
    gyroscopic, spread = np.empty((n, n_terms, r, m, m)), np.empty((n, n_terms, pairs[0].size, m, m))
    for sample in range(n):
        shape = projection[sample].reshape(-1, DOFS_PER_NODE, m)
        changes = np.array([slope[sample].reshape(shape.shape) for slope in slopes])
        for number, body in enumerate(mechanism.bodies):
            spins = rates[number, 2, :, sample][:, None, None]
            changes[:, body.nodes, 0] -= spins * shape[body.nodes, 1]
            changes[:, body.nodes, 1] += spins * shape[body.nodes, 0]
        changes = changes.reshape(r, n_dofs, m)
        for t, weight in enumerate(mechanism.mass_weights):
            m_changes = [masses[weight] @ change for change in changes]
            for k, m_change in enumerate(m_changes):
                mixed = m_change.T @ projection[sample]
                gyroscopic[sample, t, k] = 0.5 * (mixed - mixed.T)
            for pair, (k, j) in enumerate(zip(*pairs)):
                spread[sample, t, pair] = changes[k].T @ m_changes[j]
    return ModeChanges(gyroscopic, 0.5 * (spread + np.swapaxes(spread, -1, -2)))
