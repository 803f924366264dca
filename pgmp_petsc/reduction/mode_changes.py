"""How modes change with theta: the kinetic energy of ``D = d(R Psi)/d theta``, which eq. (7) of the paper leaves out.

A flexible mode moves with the velocity ``theta' D delta`` even where delta is constant. In body frames ``D = Psi' + w x
Psi``, with Psi' from the interpolated projection and w the spin of the body per unit of theta.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.bodies.matrices import assemble
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.sample_grid import SampleGrid


@dataclass(frozen=True, eq=False)
class ModeChanges:
    """Tables of changing modes at n samples.

    Attributes
    ----------
    gyroscopic
        Skew part of ``D^T M_i Psi``, shape (n, n_mass_terms, n_delta, n_delta). Its symmetric part is half the
        derivative of ``Psi^T M_i Psi``, which vanishes at the nominal parameters.
    spread
        ``D^T M_i D``, of the same shape.
    """

    gyroscopic: np.ndarray
    spread: np.ndarray


def mode_changes(kinematics: RigidKinematics, samples: SampleGrid, projection: np.ndarray, scheme: str) -> ModeChanges:
    """Return the tables of changing modes, for one rigid coordinate.

    Parameters
    ----------
    projection
        Flexible vectors in body frames, shape (n, n_dofs, n_delta), continuous.
    scheme
        Interpolation over the samples.
    """
    mechanism = kinematics.mechanism
    masses = assemble(mechanism.bodies, range(mechanism.n_dofs)).mass
    rates = kinematics.rates(kinematics.poses(samples.theta))
    slopes = interpolant(samples, projection, scheme).slope(samples.theta)
    n, n_dofs, m = projection.shape
    gyroscopic = np.empty((n, len(mechanism.mass_weights), m, m))
    spread = np.empty_like(gyroscopic)
    for k in range(n):
        change = slopes[k].reshape(-1, DOFS_PER_NODE, m)
        shape = projection[k].reshape(-1, DOFS_PER_NODE, m)
        for body, rate in zip(mechanism.bodies, rates[:, 2, 0, k]):
            change[body.nodes, 0] -= rate * shape[body.nodes, 1]
            change[body.nodes, 1] += rate * shape[body.nodes, 0]
        change = change.reshape(n_dofs, m)
        for t, weight in enumerate(mechanism.mass_weights):
            m_change = masses[weight] @ change
            mixed = m_change.T @ projection[k]
            gyroscopic[k, t] = 0.5 * (mixed - mixed.T)
            spread[k, t] = change.T @ m_change
    return ModeChanges(gyroscopic, 0.5 * (spread + np.swapaxes(spread, 2, 3)))
