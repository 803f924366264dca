"""Between inertial and body frames, and rigid velocities as vectors in body frames.

Vectors have shape (n_dofs, ...) with ``(x, y, phi)`` a node, and internal coordinates, which are in body frames always. In its body's frame a vector is turned back by the
body's angle: ``u = R^T v``. A rigid velocity of a body is then a combination of three constant vectors.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.mechanism.mechanism import Mechanism


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
        x, y = body.mesh.nodes.T[..., None]
        nodal[body.nodes, 0] = local[0] - y * rate[2]
        nodal[body.nodes, 1] = local[1] + x * rate[2]
        nodal[body.nodes, 2] = rate[2]
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
        x, y = body.mesh.nodes.T[..., None, None]
        spin, centripetal = curvature[2], np.outer(rate[2], rate[2])
        nodal[body.nodes, 0] = local[0] - y * spin - x * centripetal
        nodal[body.nodes, 1] = local[1] + x * spin - y * centripetal
        nodal[body.nodes, 2] = spin
        if body.component is not None:
            # a rigid motion has no internal coordinates, but a field that stretches the body has
            internal = body.dofs[DOFS_PER_NODE * body.n_nodes :]
            stretching = body.component.spreading[DOFS_PER_NODE * body.n_nodes :]
            result[internal] = -np.einsum("n,kl->nkl", stretching, centripetal)
    return result


def _turn(mechanism: Mechanism, angles: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    shape = vectors.shape
    turned = vectors.reshape(len(vectors), -1).copy()
    nodal = mechanism.by_node(turned)
    for body, angle in zip(mechanism.bodies, angles):
        nodal[body.nodes] = np.einsum("ij,njk->nik", rotation(angle), nodal[body.nodes])
    return turned.reshape(shape)
