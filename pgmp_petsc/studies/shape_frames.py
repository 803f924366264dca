"""The shape of the mechanism at some instants, from the frames of its nodes.

A beam's shape is that of its nodes. A rigid body's only node is its centre of mass ``(X, Y, phi)``: its shape is its
mesh, placed by ``x_k = (X, Y) + R(phi) (s_k - s_centre)``.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.mechanism.attachment import place_points
from pgmp_petsc.mechanism.mechanism import Mechanism
from pgmp_petsc.results.trajectory import Frames


def shape_frames(mechanism: Mechanism, nodal: np.ndarray, time: np.ndarray) -> Frames:
    """Return the shapes of all bodies.

    Parameters
    ----------
    nodal
        Frames ``(x, y, phi)`` of all nodes in the ground frame, shape (n_f, n_nodes, 3), m and rad.
    time
        Their instants, shape (n_f,), s.
    """
    shapes = {body.name: _shape(body, nodal[:, body.nodes]) for body in mechanism.bodies}
    return Frames(
        time=time,
        positions={name: shape[..., :2] for name, shape in shapes.items()},
        rotations={name: shape[..., 2] for name, shape in shapes.items()},
        nodes={body.name: body.shape.nodes for body in mechanism.bodies},
        cells={body.name: body.shape.cells for body in mechanism.bodies},
        rigid=frozenset(body.name for body in mechanism.bodies if not body.flexible),
    )


def _shape(body: Body, nodal: np.ndarray) -> np.ndarray:
    """Return the frames of the nodes of a body's shape, (n_f, n_shape, 3), from those of its own nodes."""
    if body.flexible:
        return nodal
    arms = body.shape.nodes - body.mesh.nodes
    return np.moveaxis(place_points(nodal[:, 0].T, arms), -1, 0)
