"""Between inertial and body frames, and rigid velocities as vectors in body frames.

Vectors have shape (n_dofs, ...) with ``(x, y, phi)`` a node, and internal coordinates, which are in body frames always. In its body's frame a vector is turned back by the
body's angle: ``u = R^T v``. A rigid velocity of a body is then a combination of three constant vectors.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.mechanism.mechanism import Mechanism, on_mesh


def rotation(angle: float) -> np.ndarray:
    """Return the 3 x 3 rotation of ``(x, y, phi)`` by an angle (rad)."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def to_inertial(mechanism: Mechanism, poses: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Turn nodal vectors (n_dofs, ...) from body frames at poses (n_bodies, 3) into the inertial frame."""
    return _turn(mechanism, poses[:, 2], vectors)


def to_body(mechanism: Mechanism, poses: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Turn nodal vectors (n_dofs, ...) from the inertial frame into body frames at poses (n_bodies, 3)."""
    return _turn(mechanism, -poses[:, 2], vectors)


def rigid_velocities(mechanism: Mechanism, poses: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return ``d rho / d theta`` in body frames.

    Parameters
    ----------
    poses
        One configuration, shape (n_bodies, 3).
    rates
        ``dP/dtheta``, shape (n_bodies, 3, n_theta).

    Returns
    -------
    ndarray, shape (n_dofs, n_theta)
    """
    n_theta = rates.shape[2]
    velocities = np.zeros((mechanism.n_dofs, n_theta))
    nodal = mechanism.by_node(velocities)
    for body, pose, rate in zip(mechanism.bodies, poses, rates):
        local = rotation(pose[2]).T @ rate
        nodal[body.nodes, :2] = _velocities(local, body.mesh.nodes)
        nodal[body.nodes, 2] = rate[2]
        if body.meshed is not None:
            on_mesh(body, velocities)[:] = _velocities(local, body.meshed.solid.mesh.nodes)
    return velocities


def rigid_curvatures(
    mechanism: Mechanism, poses: np.ndarray, rates: np.ndarray, curvatures: np.ndarray
) -> np.ndarray:
    """Return ``d2 rho / d theta_k d theta_l`` in body frames.

    Parameters
    ----------
    poses, rates
        As for `rigid_velocities`.
    curvatures
        ``d2P/dtheta2``, shape (n_bodies, 3, n_theta, n_theta).

    Returns
    -------
    ndarray, shape (n_dofs, n_theta, n_theta)
    """
    n_theta = rates.shape[2]
    result = np.zeros((mechanism.n_dofs, n_theta, n_theta))
    nodal = mechanism.by_node(result)
    for body, pose, rate, curvature in zip(mechanism.bodies, poses, rates, curvatures):
        local = np.einsum("ji,jkl->ikl", rotation(pose[2]), curvature)
        centripetal = np.outer(rate[2], rate[2])
        nodal[body.nodes, :2] = _accelerations(local, centripetal, body.mesh.nodes)
        nodal[body.nodes, 2] = curvature[2]
        if body.meshed is not None:
            on_mesh(body, result)[:] = _accelerations(local, centripetal, body.meshed.solid.mesh.nodes)
        if body.component is not None:
            # a rigid motion has no internal coordinates, but a field that stretches the body has
            stretching = body.component.spreading[DOFS_PER_NODE * body.n_nodes :]
            result[body.internal] = -np.einsum("n,kl->nkl", stretching, centripetal)
    return result


def _turn(mechanism: Mechanism, angles: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    shape = vectors.shape
    turned = vectors.reshape(len(vectors), -1).copy()
    nodal = mechanism.by_node(turned)
    for body, angle in zip(mechanism.bodies, angles):
        turn = rotation(angle)
        nodal[body.nodes] = np.einsum("ij,njk->nik", turn, nodal[body.nodes])
        if body.meshed is not None:
            on_mesh(body, turned)[:] = np.einsum("ij,njk->nik", turn[:2, :2], on_mesh(body, turned))
    return turned.reshape(shape)


def _velocities(twist: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the velocities (n, 2, k) of points (n, 2) of a body with velocities and spins (3, k), in its frame."""
    x, y = points.T[..., None]
    return np.stack([twist[0] - y * twist[2], twist[1] + x * twist[2]], axis=1)


def _accelerations(local: np.ndarray, centripetal: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return ``d2 x / d theta_k d theta_l`` (n, 2, k, l) of points, from that of the pose (3, k, l), in its frame."""
    x, y = points.T[..., None, None]
    spin = local[2]
    return np.stack([local[0] - y * spin - x * centripetal, local[1] + x * spin - y * centripetal], axis=1)
