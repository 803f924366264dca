"""Back-transformation: nodal motion from reduced coordinates (Naets et al. 2015, eq. (4)).

    q = rho(theta) + R(theta) (Psi(theta) delta + 1/2 chi(theta) delta delta)

with rho and the bodies' rotations R from the exact rigid kinematics and Psi, in body frames, interpolated; the same for
the curvature chi, if the model has one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.second_order import pair_products

BLOCK = 64


class Reconstruction:
    """Frames of some nodes from reduced coordinates.

    Parameters
    ----------
    kinematics
        Rigid kinematics of the mechanism.
    rom
        The reduced-order model, with the projection.
    scheme
        Interpolation over the samples.
    nodes
        Global numbers of the nodes wanted.
    """

    def __init__(
        self, kinematics: RigidKinematics, rom: ReducedOrderModel, scheme: str, nodes: Sequence[int]
    ) -> None:
        self._kinematics = kinematics
        self._nodes = np.asarray(nodes, dtype=int)
        rows = (DOFS_PER_NODE * self._nodes[:, None] + np.arange(DOFS_PER_NODE)).ravel()
        self._curved = rom.curvature is not None
        shapes = [rom.projection[:, rows]]
        if self._curved:
            shapes.append(rom.curvature[:, rows])
        table = np.ascontiguousarray(np.swapaxes(np.concatenate(shapes, axis=2), 1, 2))
        self._shapes = interpolant(rom.tables.samples, table, scheme)
        bodies = kinematics.mechanism.bodies
        self._bodies = np.repeat(np.arange(len(bodies)), [body.n_nodes for body in bodies])[self._nodes]
        self._points = np.concatenate([body.mesh.nodes for body in bodies])[self._nodes]

    def frames(self, eta: np.ndarray) -> np.ndarray:
        """Return the frames of the nodes, shape (n_nodes, 3, n), for eta of shape (n, n_eta)."""
        n_theta = self._kinematics.n_coordinates
        theta, delta = eta[:, :n_theta], eta[:, n_theta:]
        factors = np.hstack([delta, pair_products(delta)]) if self._curved else delta
        local = self._shapes.product(theta, factors)
        frames = np.empty((self._nodes.size, DOFS_PER_NODE, len(eta)))
        poses = self._kinematics.poses(theta)
        _place(self._bodies, self._points, poses, np.cos(poses[:, 2]), np.sin(poses[:, 2]), local, frames)
        return frames


@njit(cache=True, error_model="numpy")
def _place(bodies, points, poses, cos, sin, local, frames):
    """Fill frames (n_nodes, 3, n): points moved by local (n, n_dofs) in body frames, put at poses (n_bodies, 3, n)."""
    n = local.shape[0]
    # in blocks of states: both arrays, which run across each other, stay in the cache
    for first in range(0, n, BLOCK):
        for node in range(bodies.size):
            body, at = bodies[node], 3 * node
            for k in range(first, min(first + BLOCK, n)):
                x, y = points[node, 0] + local[k, at], points[node, 1] + local[k, at + 1]
                frames[node, 0, k] = poses[body, 0, k] + cos[body, k] * x - sin[body, k] * y
                frames[node, 1, k] = poses[body, 1, k] + sin[body, k] * x + cos[body, k] * y
                frames[node, 2, k] = poses[body, 2, k] + local[k, at + 2]
