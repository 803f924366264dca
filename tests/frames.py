"""Vectors of a mechanism turned into the inertial frame, and factors of curved displacements, as formulas have them."""

import numpy as np

from pgmp_petsc.mechanism.body_frames import to_body
from pgmp_petsc.mechanism.mechanism import Mechanism


def to_inertial(mechanism: Mechanism, poses: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Turn vectors (n_dofs, ...) from body frames at poses (n_bodies, n_pose) into the inertial frame."""
    return np.tensordot(to_body(mechanism, poses, np.eye(mechanism.n_dofs)).T, vectors, 1)


def pair_products(delta: np.ndarray) -> np.ndarray:
    """Return the factors of the packed chi in ``1/2 chi delta delta``, shape (n, n_pairs), for delta (n, n_delta)."""
    i, j = np.tril_indices(delta.shape[1])
    return np.where(i == j, 0.5, 1.0) * delta[:, i] * delta[:, j]
