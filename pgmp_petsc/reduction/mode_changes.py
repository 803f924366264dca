"""How modes change with theta: the kinetic energy of ``D_k = d(R Psi)/d theta_k``, left out by eq. (7) of the paper.

A flexible mode moves with the velocity ``sum_k theta_k' D_k delta`` even where delta is constant. In body frames
``D_k = d_k Psi + W_k Psi``, with d_k Psi from the interpolated projection and W_k = R^T d_k R the body's spin per unit
of theta_k, which turns its points (`bodies.inertia_moments`).

How the forces in the bodies change the stiffness of each mode: what geometric stiffness a model has, or would lack.

A static load f changes the stiffness of a mode psi_k, whose eigenvalue is lambda_k, by the share

    s_k = h_k.f / lambda_k,

positive where bodies are pulled, negative where they are pressed; -1 is buckling in the shape of the mode. One static
answer a mode, h_k, tells what every load does (`CurvatureProblem.stiffness_answers`; without the curvature of joints it
is the answer to ``K3[psi_k, psi_k]``). The *influences* ``h_k.f`` are kept for units of all that loads the bodies, in
this order of columns:

- every load term of the effects, its weight taken out,
- every action (local effect), per unit of its force,
- for every mass term, its weight taken out: the inertia forces of unit accelerations theta_k'', and those of unit
  products theta_k' theta_l', k >= l, each pair once: where k > l a motion has twice as much of it.

They hold at the nominal parameters, at which forces in statically determinate bodies do not depend on the stiffness;
lambda_k is kept term by term and follows the parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.inertia_moments import Moments, inertia_moments, turned
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.sample_grid import SampleGrid


@dataclass(frozen=True, eq=False)
class ModeChanges:
    """Tables of changing modes at n samples."""

    #: skew part of ``D_k^T M_i Psi``, shape (n, n_mass_terms, n_theta, n_delta, n_delta). Its symmetric part is half
    #: the derivative of ``Psi^T M_i Psi``, which vanishes at the nominal parameters.
    gyroscopic: np.ndarray
    #: symmetric part of ``D_k^T M_i D_l``, pairs k >= l, shape (n, n_mass_terms, n_pairs, n_delta, n_delta)
    spread: np.ndarray


def mode_changes(
    kinematics: RigidKinematics,
    masses: Mapping[Monomial, sp.csr_matrix],
    samples: SampleGrid,
    projection: np.ndarray,
    scheme: str,
) -> ModeChanges:
    """Return the tables of changing modes.

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
    over = interpolant(samples, projection, scheme)
    slopes = np.array([over.slope(samples.theta, k) for k in range(r)])
    bodies = [(body.dofs, inertia_moments(body)) for body in mechanism.bodies]
    n, _, m = projection.shape
    n_terms, pairs = len(mechanism.mass_weights), np.tril_indices(r)
    gyroscopic, spread = np.empty((n, n_terms, r, m, m)), np.empty((n, n_terms, pairs[0].size, m, m))
    for sample in range(n):
        shape, changes = projection[sample], slopes[:, sample]
        # W_k of every body, each of shape (n_theta, d, d)
        theta = samples.theta[sample]
        d = kinematics.mechanism.space.dimension
        fields = kinematics.motion(theta).velocities[:, d:]
        spins = [np.moveaxis(own.reshape(d, d, -1), -1, 0) for own in fields]
        for t, weight in enumerate(mechanism.mass_weights):
            m_changes = [masses[weight] @ change for change in changes]
            m_spins = [_turned(bodies, weight, [own[k] for own in spins], shape) for k in range(r)]
            for k in range(r):
                mixed = m_changes[k].T @ shape + m_spins[k].T @ shape
                gyroscopic[sample, t, k] = 0.5 * (mixed - mixed.T)
            for pair, (k, j) in enumerate(zip(*pairs)):
                both = _turned(bodies, weight, [own[k].T @ own[j] for own in spins], shape)
                crossed = changes[k].T @ m_spins[j] + m_spins[k].T @ changes[j]
                spread[sample, t, pair] = changes[k].T @ m_changes[j] + crossed + shape.T @ both
    return ModeChanges(gyroscopic, 0.5 * (spread + np.swapaxes(spread, -1, -2)))


def _turned(
    bodies: list[tuple[np.ndarray, dict[Monomial, Moments]]],
    weight: Monomial,
    turns: list[np.ndarray],
    vectors: np.ndarray,
) -> np.ndarray:
    """Return ``C^T m (W C v)`` of one mass term, shape (n_dofs, m), for a matrix W (d, d) of every body."""
    result = np.zeros_like(vectors)
    for (dofs, moments), turn in zip(bodies, turns):
        if weight in moments:
            result[dofs] += turned(moments[weight], turn) @ vectors[dofs]
    return result


@dataclass(frozen=True, eq=False)
class StiffnessChanges:
    """Influences of all loads on the stiffness of the modes at the samples."""

    influence: np.ndarray  # shape (n, n_modes, n_columns), modes in ascending order at every sample
    stiffness: np.ndarray  # ``psi_k.K_t psi_k`` of every stiffness term, shape (n, n_stiffness_terms, n_modes)

    def over_two_turns(self, samples: SampleGrid, axes: Sequence[int]) -> StiffnessChanges:
        """Append a second revolution of some coordinates, on which the influences are the same."""
        influence, stiffness = self.influence, self.stiffness
        for axis in axes:
            influence, stiffness = (samples.twice(axis, part, part) for part in (influence, stiffness))
            samples = samples.over_two_turns(axis)
        return StiffnessChanges(influence, stiffness)
