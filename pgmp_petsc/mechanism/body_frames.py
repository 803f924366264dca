"""Between inertial and body frames, and rigid velocities as vectors in body frames.

Vectors have shape (n_dofs, ...): displacements and rotations of every node, and internal coordinates, which of
condensed bodies are in body frames always. In its body's frame a vector is turned back: ``u = R^T v``. A rigid velocity
of a body is then a combination of constant vectors.
"""

from __future__ import annotations

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
    velocities = np.zeros((mechanism.n_dofs, rates.shape[2]))
    for (dofs, fields), pose, rate in zip(mechanism.linear_fields, poses, rates):
        velocities[dofs] = fields @ mechanism.space.velocity_field(pose, rate)
    return velocities


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
    n_theta = rates.shape[2]
    result = np.zeros((mechanism.n_dofs, n_theta, n_theta))
    for (dofs, fields), pose, rate, curvature in zip(mechanism.linear_fields, poses, rates, curvatures):
        field = mechanism.space.acceleration_field(pose, rate, curvature)
        result[dofs] = (fields @ field.reshape(len(field), -1)).reshape(-1, n_theta, n_theta)
    return result


def _turn(mechanism: Mechanism, rotations: list[np.ndarray], vectors: np.ndarray) -> np.ndarray:
    shape, d = vectors.shape, mechanism.space.dimension
    turned = vectors.reshape(len(vectors), -1).copy()
    nodal = mechanism.by_node(turned)
    for body, rotation in zip(mechanism.bodies, rotations):
        nodal[body.nodes] = np.einsum("ij,njk->nik", rotation, nodal[body.nodes])
        if body.meshed is not None:
            on_mesh(body, turned)[:] = np.einsum("ij,njk->nik", rotation[:d, :d], on_mesh(body, turned))
    return turned.reshape(shape)
