"""Back-transformation: nodal motion from reduced coordinates (Naets et al. 2015, eq. (4)).

    q = rho(theta) + R(theta) Psi(theta) delta

with rho and the bodies' rotations R from the exact rigid kinematics and Psi, in body frames, interpolated.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import place_points
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel


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
        self._projection = interpolant(rom.tables.samples, rom.projection[:, rows], scheme)

    def frames(self, eta: np.ndarray) -> np.ndarray:
        """Return the frames of the nodes, shape (n_nodes, 3, n), for eta of shape (n, n_eta)."""
        n_theta = self._kinematics.n_coordinates
        theta, delta = eta[:, 0], eta[:, n_theta:]
        psi = self._projection(theta)
        local = np.einsum("ndm,nm->dn", psi, delta).reshape(self._nodes.size, DOFS_PER_NODE, len(theta))
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
