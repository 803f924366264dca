"""The shape of the mechanism at some instants, from the frames of its nodes.

A beam's shape is that of its nodes. A rigid body's only node is its centre of mass ``(X, Y, phi)``: its shape is its
mesh, placed by ``x_k = (X, Y) + R(phi) (s_k - s_centre)``.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.results.trajectory import Frames


def shape_frames(mechanism: Mechanism, nodal: np.ndarray, time: np.ndarray) -> Frames:
    """Return the shapes of all bodies.

    Parameters
    ----------
    nodal
        Frames of all nodes in the ground frame, shape (n_f, n_nodes, n_frame): ``(x, y, phi)``, m and rad, in the
        plane, position and directors in space.
    time
        Their instants, shape (n_f,), s.
    """
    shapes = {body.name: _shape(mechanism, body, nodal[:, body.nodes]) for body in mechanism.bodies}
    d = mechanism.space.dimension
    turned = _rotation_vectors if mechanism.space is SPATIAL else (lambda shape: shape[..., 2])
    return Frames(
        time=time,
        positions={name: shape[..., :d] for name, shape in shapes.items()},
        rotations={name: turned(shape) for name, shape in shapes.items()},
        nodes={body.name: body.shape.nodes for body in mechanism.bodies},
        cells={body.name: body.shape.cells for body in mechanism.bodies},
        rigid=frozenset(body.name for body in mechanism.bodies if not body.flexible),
    )


def _shape(mechanism: Mechanism, body: Body, nodal: np.ndarray) -> np.ndarray:
    """Return the frames of the nodes of a body's shape, (n_f, n_shape, n_frame), from those of its own nodes."""
    if body.flexible:
        return nodal
    arms = body.shape.nodes - body.mesh.nodes
    return np.moveaxis(mechanism.space.place(nodal[:, 0, : mechanism.space.n_pose].T, arms), -1, 0)


def _rotation_vectors(shape: np.ndarray) -> np.ndarray:
    """Return the rotations of nodes (n_f, n_nodes, n_frame) in space as axis times angle, shape (n_f, n_nodes, 3)."""
    from scipy.spatial.transform import Rotation  # takes a noticeable time, and the plane has no use for it

    directors = shape[..., 3:12].reshape(-1, 3, 3)
    turns = Rotation.from_matrix(directors.swapaxes(1, 2)).as_rotvec()
    return turns.reshape(*shape.shape[:2], 3)
