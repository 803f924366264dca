"""Vectors of a mechanism turned into the inertial frame, factors of curved displacements, derivatives of poses."""

import numpy as np

from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism, to_body


def to_inertial(mechanism: Mechanism, poses: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Turn vectors (n_dofs, ...) from body frames at poses (n_bodies, n_pose) into the inertial frame."""
    return np.tensordot(to_body(mechanism, poses, np.eye(mechanism.n_dofs)).T, vectors, 1)


def pair_products(delta: np.ndarray) -> np.ndarray:
    """Return the factors of the packed chi in ``1/2 chi delta delta``, shape (n, n_pairs), for delta (n, n_delta)."""
    i, j = np.tril_indices(delta.shape[1])
    return np.where(i == j, 0.5, 1.0) * delta[:, i] * delta[:, j]


def check_derivatives(kinematics: RigidKinematics, theta: np.ndarray) -> None:
    """Compare rates and curvatures with differences, at theta of shape (n, n_theta)."""
    step, n_theta = 1e-3, theta.shape[1]
    rates = kinematics.rates(kinematics.poses(theta))
    second = kinematics.curvatures(kinematics.poses(theta), rates)
    shape = len(kinematics.mechanism.bodies), {2: 3, 3: 12}[kinematics.mechanism.space.dimension], n_theta
    assert rates.shape == (*shape, len(theta)) and second.shape == (*shape, n_theta, len(theta))
    for k in range(n_theta):
        at = {i: kinematics.poses(theta + i * step * np.eye(n_theta)[k]) for i in (-2, -1, 1, 2)}
        slope = (8 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12 * step)
        # fourth order, 1e-12 times the fifth derivative over 30, and poses solved to 1e-12 over the step
        np.testing.assert_allclose(rates[:, :, k], slope, rtol=0, atol=1e-8)
        of = {i: kinematics.rates(poses) for i, poses in at.items()}
        bend = (8 * (of[1] - of[-1]) - (of[2] - of[-2])) / (12 * step)
        np.testing.assert_allclose(second[:, :, :, k], bend, rtol=0, atol=1e-8)
    motion = np.random.default_rng(3).normal(size=(2, *theta.shape))
    turned, turning = kinematics.jets(kinematics.poses(theta), motion)
    np.testing.assert_allclose(turned, np.einsum("bpkn,nk->bpn", rates, motion[0]), rtol=0, atol=1e-12)
    bend = np.einsum("bpkln,nk,nl->bpn", second, *motion[[0, 0]]) + np.einsum("bpkn,nk->bpn", rates, motion[1])
    np.testing.assert_allclose(turning, bend, rtol=0, atol=1e-10)  # of sums that cancel, near dead centres
