"""Between inertial and body frames, and rigid velocities as vectors in body frames.

Vectors have shape (n_dofs, ...): displacements and rotations of every node, and internal coordinates, which of
condensed bodies are in body frames always. In its body's frame a vector is turned back: ``u = R^T v``. A rigid velocity
of a body is then a combination of constant vectors.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.mechanism.mechanism import Mechanism, on_mesh
from pgmp_petsc.mechanism.space import at_nodes, at_points


def to_inertial(mechanism: Mechanism, poses: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Turn vectors (n_dofs, ...) from body frames at poses (n_bodies, n_pose) into the inertial frame."""
    return _turn(mechanism, [mechanism.space.rotation(pose) for pose in poses], vectors)


def to_body(mechanism: Mechanism, poses: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Turn vectors (n_dofs, ...) from the inertial frame into body frames at poses (n_bodies, n_pose)."""
    return _turn(mechanism, [mechanism.space.rotation(pose).T for pose in poses], vectors)


def linear_fields(body: Body) -> np.ndarray:
    """Return the linear displacement fields of a body in its own frame, shape (n_body_dofs, d (d + 1)).

    They are ordered as in `Component.fields`; a beam and a rigid body follow those that are no rigid motion at their
    nodes. The sections of beams in space turn with their fibres.
    """
    if body.component is not None:
        return body.component.fields
    d = body.mesh.nodes.shape[1]
    unit = np.eye(d + d * d)
    nodal = at_nodes(unit, body.mesh.nodes)
    if body.axes is not None:
        nodal[:, d:, d:] = body.section_turns()
    parts = [nodal.reshape(-1, d + d * d)]
    if body.meshed is not None:
        parts.append(at_points(unit, body.meshed.solid.mesh.nodes).reshape(-1, d + d * d))
    return np.concatenate(parts)


def rigid_positions(mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return the undeformed bodies' positions in the inertial frame, as vectors in body frames, shape (n_dofs,).

    Poses have the shape (n_bodies, n_pose). What belongs to rotations is zero: a position has none.
    """
    d = mechanism.space.dimension
    places = np.zeros(mechanism.n_dofs)
    for body, pose in zip(mechanism.bodies, poses):
        origin = mechanism.space.to_body(pose[:, None], pose[:d, None])[:, 0]
        places[body.dofs] = linear_fields(body) @ np.concatenate([origin, np.eye(d).ravel()])
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
    for body, pose, rate in zip(mechanism.bodies, poses, rates):
        velocities[body.dofs] = linear_fields(body) @ mechanism.space.velocity_field(pose, rate)
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
    for body, pose, rate, curvature in zip(mechanism.bodies, poses, rates, curvatures):
        field = mechanism.space.acceleration_field(pose, rate, curvature)
        result[body.dofs] = np.tensordot(linear_fields(body), field, axes=1)
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
