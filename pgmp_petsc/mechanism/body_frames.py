"""Between inertial and body frames, and rigid velocities as vectors in body frames.

Vectors have shape (n_dofs, ...): displacements and rotations of every node, and internal coordinates, which of
condensed bodies are in body frames always. In its body's frame a vector is turned back: ``u = R^T v``. A rigid velocity
of a body is then a combination of constant vectors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pgmp_petsc.mechanism.mechanism import Mechanism, on_mesh


def to_inertial(mechanism: Mechanism, poses: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Turn vectors (n_dofs, ...) from body frames at poses (n_bodies, n_pose) into the inertial frame."""
    return _turn(mechanism, [mechanism.space.rotation(pose) for pose in poses], vectors)


def to_body(mechanism: Mechanism, poses: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Turn vectors (n_dofs, ...) from the inertial frame into body frames at poses (n_bodies, n_pose)."""
    return _turn(mechanism, [mechanism.space.rotation(pose).T for pose in poses], vectors)


def rigid_positions(mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return the undeformed bodies' positions in the inertial frame, as vectors in body frames, shape (n_dofs,).

    Poses have the shape (n_bodies, n_pose). What belongs to rotations is zero: a position has none.
    """
    d = mechanism.space.dimension
    places = np.zeros(mechanism.n_dofs)
    for (dofs, fields), pose in zip(mechanism.linear_fields, poses):
        origin = mechanism.space.to_body(pose[:, None], pose[:d, None])[:, 0]
        places[dofs] = fields @ np.concatenate([origin, np.eye(d).ravel()])
    return places


def linear_motion(mechanism: Mechanism, coefficients: Sequence[np.ndarray]) -> np.ndarray:
    """Return displacements in body frames of bodies that move as linear fields.

    Parameters
    ----------
    coefficients
        Of every body, shape (n_bodies, d + d^2, ...).

    Returns
    -------
    ndarray, shape (n_dofs, ...)
    """
    trailing = coefficients[0].shape[1:]
    result = np.zeros((mechanism.n_dofs, math.prod(trailing)))
    for (dofs, fields), own in zip(mechanism.linear_fields, coefficients):
        result[dofs] = fields @ own.reshape(len(own), -1)
    return result.reshape(mechanism.n_dofs, *trailing)


def rigid_velocities(mechanism: Mechanism, poses: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return ``d rho / d theta`` in body frames.

    Parameters
    ----------
    poses
        One configuration, shape (n_bodies, n_pose).
    rates
        ``dP/dtheta``, shape (n_bodies, n_pose, n_theta).

    Returns
    -------
    ndarray, shape (n_dofs, n_theta)
    """
    return linear_motion(mechanism, [mechanism.space.velocity_field(*own) for own in zip(poses, rates)])


def rigid_curvatures(mechanism: Mechanism, poses: np.ndarray, rates: np.ndarray, curvatures: np.ndarray) -> np.ndarray:
    """Return ``d2 rho / d theta_k d theta_l`` in body frames.

    Parameters
    ----------
    poses, rates
        As for `rigid_velocities`.
    curvatures
        ``d2P/dtheta2``, shape (n_bodies, n_pose, n_theta, n_theta).

    Returns
    -------
    ndarray, shape (n_dofs, n_theta, n_theta)
    """
    space = mechanism.space
    return linear_motion(mechanism, [space.acceleration_field(*own) for own in zip(poses, rates, curvatures)])


def _turn(mechanism: Mechanism, rotations: list[np.ndarray], vectors: np.ndarray) -> np.ndarray:
    shape, d = vectors.shape, mechanism.space.dimension
    turned = vectors.reshape(len(vectors), -1).copy()
    nodal = mechanism.by_node(turned)
    for body, rotation in zip(mechanism.bodies, rotations):
        nodal[body.nodes] = np.einsum("ij,njk->nik", rotation, nodal[body.nodes])
        if body.meshed is not None:
            on_mesh(body, turned)[:] = np.einsum("ij,njk->nik", rotation[:d, :d], on_mesh(body, turned))
    return turned.reshape(shape)
