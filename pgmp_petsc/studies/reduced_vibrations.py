"""Frequencies of the reduced model on the springs of its scene: what its runs would show of small vibrations.

The reduced stiffness has no springs, which act as local forces; linearised about the configuration they add

    Psi^T K_s Psi,     Psi = [d rho/d theta, Psi_flexible],

with the same blocks as in the full-order model (`modes.spring_stiffness`), the exact rigid motion and the flexible
vectors as runs interpolate them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.linalg import eigh

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.bodies.matrices import assemble, weighted_sum
from pgmp_petsc.mechanism.body_frames import rigid_velocities
from pgmp_petsc.modes.spring_stiffness import SpringStiffness
from pgmp_petsc.modes.vibration import frequencies_of
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.runtime.installed import alone


def reduced_vibrations(
    rom: ReducedOrderModel, springs: SpringStiffness, scheme: str, values: Mapping[str, float], theta: np.ndarray
) -> np.ndarray:
    """Return the frequencies at configurations (n, n_theta), rad, by one process.

    Parameters
    ----------
    rom
        The reduced model.
    springs
        What springs add, for the mechanism of `rom` with its condensed bodies.
    scheme
        Interpolation over the samples.
    values
        Parameter values.

    Returns
    -------
    ndarray, shape (n, n_free + n_delta - n_rigid)
        Ascending, without the rigid motions that no spring resists, Hz; below zero as in `frequencies_of`.
    """
    tables, kinematics = rom.tables, springs.kinematics
    mechanism, r, free = kinematics.mechanism, rom.tables.n_coordinates, springs.free
    matrices = assemble(mechanism.bodies, range(mechanism.n_dofs))
    whole_mass = weighted_sum(matrices.mass, values)
    n_rigid = free.size - springs.n_resisted(matrices, alone())
    kept = np.concatenate([free, np.arange(r, r + tables.n_modes)])
    mass = np.einsum(
        "t,ntij->nij", evaluate_weights(tables.mass_weights, values),
        interpolant(tables.samples, tables.mass, scheme)(theta),
    )[:, kept][:, :, kept]  # fmt: skip
    stiffness = np.zeros_like(mass)
    stiffness[:, free.size :, free.size :] = np.einsum(
        "t,ntij->nij", evaluate_weights(tables.stiffness_weights, values),
        interpolant(tables.samples, tables.stiffness, scheme)(theta),
    )  # fmt: skip
    dofs = np.unique(np.concatenate([np.zeros(0, dtype=int), *springs.dofs]))
    shapes = interpolant(tables.samples, rom.projection[:, dofs], scheme)(theta)
    found = np.empty((len(theta), kept.size - n_rigid))
    for number, configuration in enumerate(theta):
        poses = kinematics.poses(configuration)
        rigid = rigid_velocities(mechanism, poses[..., 0], kinematics.rates(poses)[..., 0])[:, free]
        mass[number, : free.size, : free.size] = rigid.T @ (whole_mass @ rigid)
        psi = np.hstack([rigid[dofs], shapes[number]])
        for block in springs.at(configuration, matrices, alone()):
            own = psi[np.searchsorted(dofs, block.dofs)]
            stiffness[number] += own.T @ block.matrix @ own
        # scaled to a unit diagonal of the mass: coordinates have units of their own
        scale = 1.0 / np.sqrt(np.diag(mass[number]))
        values_here = eigh(
            stiffness[number] * scale * scale[:, None], mass[number] * scale * scale[:, None], eigvals_only=True
        )
        order = np.argsort(np.abs(values_here), kind="stable")
        found[number] = np.sort(values_here[order[n_rigid:]])
    return frequencies_of(found)
