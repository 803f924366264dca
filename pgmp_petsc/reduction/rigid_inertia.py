"""Inertia of the rigid motion over the configurations, from the exact kinematics without an eigenproblem."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.reduction.sample_grid import SampleGrid, Samples

N_FINE = 1024  # cubic spline: an error of (2 pi / 1024)^4 / 384 = 4e-12 of the fourth derivative
N_FINE_OF_MORE = 192  # along each axis of two coordinates: 3e-9 of the fourth derivative, and some 40 MB


def fine_grid(samples: SampleGrid) -> SampleGrid:
    """Return the grid on which what the rigid kinematics gives is tabulated, over the range of the samples."""
    n = N_FINE if samples.n_coordinates == 1 else N_FINE_OF_MORE
    return SampleGrid(tuple(Samples.uniform(axis.lower, axis.upper, n, axis.periodic) for axis in samples))


def rigid_inertia(
    samples: SampleGrid, mass: Mapping[Monomial, sp.csr_matrix], kinematics: RigidKinematics
) -> np.ndarray:
    """Return ``(d rho/d theta_k)^T M_i (d rho/d theta_l)`` of every mass term on the fine grid.

    In its own frame a body moves as a combination of constant vectors, so the mass that belongs to the velocities of
    all bodies is projected once.

    Parameters
    ----------
    mass
        All rows of the mass terms, in body frames, shape (n_dofs, n_dofs) each.

    Returns
    -------
    ndarray, shape (n_fine, n_mass_terms, n_theta (n_theta + 1) / 2)
        Lower triangles row by row.
    """
    fine, mechanism = fine_grid(samples), kinematics.mechanism
    unit = np.zeros((mechanism.n_dofs, 0))
    for dofs, fields in mechanism.linear_fields:
        own = np.zeros((mechanism.n_dofs, fields.shape[1]))
        own[dofs] = fields
        unit = np.hstack([unit, own])
    poses = kinematics.poses(fine.theta)
    rates = kinematics.rates(poses)
    local = np.concatenate([mechanism.space.velocity_field(*pair) for pair in zip(poses, rates)])
    terms = [unit.T @ (mass[weight] @ unit) for weight in mechanism.mass_weights]
    values = [np.einsum("akn,ab,bjn->nkj", local, term, local, optimize=True) for term in terms]
    rows, columns = np.tril_indices(kinematics.n_coordinates)
    return np.ascontiguousarray(np.stack(values, axis=1)[..., rows, columns])
