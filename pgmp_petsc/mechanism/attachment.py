"""Where joints and effects hold: a point of a body, seen as a frame ``(x, y, phi)``, or a point of the ground."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pgmp_petsc.bodies.body import DOFS_PER_NODE
from pgmp_petsc.mechanism.joints import N_FRAME


@dataclass(frozen=True, eq=False)
class Attachment:
    """A point of a body or of the ground.

    Attributes
    ----------
    body
        Index of the body, or -1 for the ground.
    node
        Global number of the node that carries it, or -1 for the ground.
    point
        Coordinates in the body's (or the ground's) frame, shape (2,), m.
    arm
        From the node to the point, in the body's frame, shape (2,), m: zero but for rigid bodies, whose only node is
        their centre of mass.
    """

    body: int
    node: int
    point: np.ndarray
    arm: np.ndarray = field(default_factory=lambda: np.zeros(2))

    @property
    def on_ground(self) -> bool:
        """Whether it is a point of the ground."""
        return self.body < 0

    @property
    def at_node(self) -> bool:
        """Whether the point is the node itself, so that its frame is linear in the unknowns."""
        return not self.arm.any()

    @property
    def dofs(self) -> np.ndarray:
        """The node's unknowns, shape (3,)."""
        return DOFS_PER_NODE * self.node + np.arange(N_FRAME)

    @property
    def pose_map(self) -> np.ndarray:
        """What of a pose turns the point's frame, shape (3, 3); its position turns with it, which no coordinate
        measures."""
        return np.eye(N_FRAME)

    def frame_of_node(self, q: np.ndarray) -> np.ndarray:
        """Return the frame (3, ...) from nodal unknowns q of shape (n_dofs, ...)."""
        if self.on_ground:
            return self.ground_frame(q.shape[1:])
        return self.frame_of(q[DOFS_PER_NODE * self.node : DOFS_PER_NODE * self.node + N_FRAME])

    def frame_of(self, node_frame: np.ndarray) -> np.ndarray:
        """Return the frame (3, ...) from that of the node."""
        if self.at_node:
            return node_frame
        frame = node_frame.copy()
        frame[:2] += rotate(node_frame[2], self.arm)
        return frame

    def frame_of_pose(self, poses: np.ndarray) -> np.ndarray:
        """Return the frame (3, ...) from rigid poses of shape (n_bodies, 3, ...)."""
        if self.on_ground:
            return self.ground_frame(poses.shape[2:])
        pose = poses[self.body]
        frame = pose.copy()
        frame[:2] += rotate(pose[2], self.point)
        return frame

    def ground_frame(self, trailing: tuple[int, ...]) -> np.ndarray:
        """Return the frame of a point of the ground, shape (3, *trailing)."""
        frame = np.zeros((N_FRAME, *trailing))
        frame[0], frame[1] = self.point
        return frame


def rotate(angle: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Turn points (2, ...) by angles that broadcast against a coordinate; the result has shape (2, ...)."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * point[0] - sin * point[1], sin * point[0] + cos * point[1]])


def place_points(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the frames (n_points, 3, ...) of points (n_points, 2) of a rigid body at a pose (3, ...)."""
    frames = np.empty((len(points), N_FRAME, *pose.shape[1:]))
    frames[:, :2] = pose[:2] + np.moveaxis(rotate(pose[2][..., None], points.T), -1, 0)
    frames[:, 2] = pose[2]
    return frames


def onto_nodes(
    sides: tuple[Attachment, Attachment], q: np.ndarray, gradient: np.ndarray, hessian: np.ndarray | None = None
) -> None:
    """Turn derivatives in two frames into derivatives in the unknowns of their nodes, in place.

    A point at the arm r of a node moves with it as ``x = X + R(phi) r``, so that ``dx/dphi`` is R r turned by a right
    angle and ``d2x/dphi2 = -R r``.

    Parameters
    ----------
    sides
        The two attachments.
    q
        Nodal unknowns, shape (n_dofs, ...).
    gradient
        Derivatives in the six frame unknowns, shape (k, 6, ...).
    hessian
        Second derivatives, shape (k, 6, 6, ...), if wanted.
    """
    for first, side in zip((0, N_FRAME), sides):
        if side.on_ground or side.at_node:
            continue
        x, y = rotate(q[side.dofs[2]], side.arm)
        turn = first + 2
        if hessian is not None:
            hessian[:, :, turn] += x * hessian[:, :, first + 1] - y * hessian[:, :, first]
            hessian[:, turn] += x * hessian[:, first + 1] - y * hessian[:, first]
            hessian[:, turn, turn] -= x * gradient[:, first] + y * gradient[:, first + 1]
        gradient[:, turn] += x * gradient[:, first + 1] - y * gradient[:, first]
