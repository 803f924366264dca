"""The unknowns of full-order models in space: natural coordinates of frames, and the positions of meshes.

Every node, the frame of a group of faces or the centre of mass of a rigid body, has the twelve numbers of its frame,
position and directors (`space`); after all of them come the positions of the meshes' nodes. Rigid motion, joints and
ties are then polynomials of first and second degree (Garcia de Jalon and Bayo 1994), and nothing is singular anywhere.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.mechanism.mechanism import Mechanism, on_mesh
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.mechanism.spatial_attachment import SpatialAttachment
from pgmp_petsc.mechanism.spatial_connection import SpatialConnection

N_POSE = SPATIAL.n_pose


class NaturalUnknowns:
    """The numbering of a mechanism's unknowns.

    Parameters
    ----------
    mechanism
        In space, its flexible bodies on their meshes.

    Attributes
    ----------
    bodies
        The mechanism's, with internal coordinates numbered as here.
    n_dofs
        Number of unknowns.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        more = (N_POSE - SPATIAL.n_dofs) * mechanism.n_nodes
        self.bodies: tuple[Body, ...] = tuple(
            body.numbered(body.first_node, body.first_internal + more) for body in mechanism.bodies
        )
        self.n_dofs = mechanism.n_dofs + more

    def frame(self, node: int) -> np.ndarray:
        """Return the unknowns of a node's frame, shape (12,)."""
        return N_POSE * node + np.arange(N_POSE)

    def frames(self, q: np.ndarray) -> np.ndarray:
        """View the frames of all nodes in unknowns (n_dofs, ...), shape (n_nodes, 12, ...)."""
        n_nodes = self.mechanism.n_nodes
        return q[: N_POSE * n_nodes].reshape(n_nodes, N_POSE, *q.shape[1:])

    def place(self, poses: np.ndarray) -> np.ndarray:
        """Return the unknowns (n_dofs,) of undeformed bodies at poses (n_bodies, 12).

        It is linear in the poses, so that rates of poses give those of the unknowns.
        """
        q = np.zeros(self.n_dofs)
        for body, pose in zip(self.bodies, poses):
            self.frames(q)[body.nodes] = SPATIAL.place(pose, body.mesh.nodes)
            if body.meshed is not None:
                on_mesh(body, q)[:] = SPATIAL.place(pose, body.meshed.solid.mesh.nodes)[:, :3]
        return q

    def uniform(self, direction: np.ndarray) -> np.ndarray:
        """Return the same displacement, shape (3,), of all points, shape (n_dofs,)."""
        q = np.zeros(self.n_dofs)
        self.frames(q)[:, :3] = direction
        for body in self.bodies:
            if body.meshed is not None:
                on_mesh(body, q)[:] = direction
        return q


class NaturalSides:
    """The two frames that a joint holds, as functions of the unknowns: ``(a, b) = T y + t``.

    Parameters
    ----------
    unknowns
        The numbering.
    sides
        The attachments.

    Attributes
    ----------
    dofs
        The unknowns y of sides that are not on the ground, shape (m,).
    map, constant
        T, shape (24, m), and t, shape (24,).
    """

    def __init__(self, unknowns: NaturalUnknowns, sides: tuple[SpatialAttachment, SpatialAttachment]) -> None:
        moving = [not side.on_ground for side in sides]
        self.dofs = np.concatenate(
            [unknowns.frame(side.node) for side in sides if not side.on_ground] or [np.zeros(0, dtype=int)]
        )
        columns = np.repeat(moving, N_POSE)
        self.map = block_diag(*(side.frame_map for side in sides))[:, columns]
        self.constant = np.concatenate(
            [np.zeros(N_POSE) if moves else side.ground_frame(()) for side, moves in zip(sides, moving)]
        )

    def frames(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return both frames (12,) from unknowns (n_dofs,)."""
        both = self.map @ q[self.dofs] + self.constant
        return both[:N_POSE], both[N_POSE:]


class JointAngle:
    """How far the second body of a joint is turned against the first, about its axis, in natural coordinates.

    Parameters
    ----------
    unknowns
        The numbering.
    connection
        A joint with one axis.

    Attributes
    ----------
    dofs
        The unknowns that it depends on, shape (m,).
    """

    def __init__(self, unknowns: NaturalUnknowns, connection: SpatialConnection) -> None:
        self._sides, self._angle = NaturalSides(unknowns, connection.sides), connection.angle
        self.dofs = self._sides.dofs

    def value(self, q: np.ndarray) -> float:
        """Return the angle in (-pi, pi], rad."""
        return float(self._angle.value(*self._sides.frames(q)))

    def derivatives(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return first (m,) and second derivatives (m, m)."""
        frames = self._sides.frames(q)
        gradient, hessian = self._angle.gradient(*frames), self._angle.hessian(*frames)
        return gradient @ self._sides.map, self._sides.map.T @ hessian @ self._sides.map
