"""Back-transformation: nodal motion from reduced coordinates (Naets et al. 2015, eq. (4)).

    q = rho(theta) + R(theta) (Psi(theta) delta + 1/2 chi(theta) delta delta)

with rho and the bodies' rotations R from the exact rigid kinematics and Psi, in body frames, interpolated; the same for
the curvature chi, if the model has one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import place_points
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel
from pgmp_petsc.reduction.second_order import pair_products


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
        self._shapes = interpolant(rom.tables.samples, np.concatenate(shapes, axis=2), scheme)

    def frames(self, eta: np.ndarray) -> np.ndarray:
        """Return the frames of the nodes, shape (n_nodes, 3, n), for eta of shape (n, n_eta)."""
        n_theta = self._kinematics.n_coordinates
        theta, delta = eta[:, 0], eta[:, n_theta:]
        factors = np.hstack([delta, pair_products(delta)]) if self._curved else delta
        moved = self._shapes.product(theta, factors).T
        local = moved.reshape(self._nodes.size, DOFS_PER_NODE, len(theta))
        poses = self._kinematics.poses(theta)
        frames = np.empty_like(local)
        for pose, body in zip(poses, self._kinematics.mechanism.bodies):
            inside = (self._nodes >= body.nodes.start) & (self._nodes < body.nodes.stop)
            points = body.mesh.nodes[self._nodes[inside] - body.first_node]
            frames[inside] = place_points(pose, points)
            cos, sin = np.cos(pose[2]), np.sin(pose[2])
            frames[inside, 0] += cos * local[inside, 0] - sin * local[inside, 1]
            frames[inside, 1] += sin * local[inside, 0] + cos * local[inside, 1]
            frames[inside, 2] += local[inside, 2]
        return frames
