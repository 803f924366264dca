"""Where joints and effects hold in space: a point of a body with the body's directors, or a point of the ground.

A frame is ``(p, d_1, d_2, d_3)``, the position of the point and the directors, shape (12, ...); see `space`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pgmp_petsc.mechanism.space import SPATIAL


@dataclass(frozen=True, eq=False)
class SpatialAttachment:
    """A point of a body or of the ground.

    Attributes
    ----------
    body
        Index of the body, or -1 for the ground.
    node
        Global number of the node that carries it, or -1 for the ground.
    point
        Coordinates in the body's (or the ground's) frame, shape (3,), m.
    arm
        From the node to the point, in the body's frame, shape (3,), m: zero but for rigid bodies.
    """

    body: int
    node: int
    point: np.ndarray
    arm: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @property
    def on_ground(self) -> bool:
        """Whether it is a point of the ground."""
        return self.body < 0

    @property
    def at_node(self) -> bool:
        """Whether the point is the node itself."""
        return not self.arm.any()

    @property
    def dofs(self) -> np.ndarray:
        """The node's unknowns, shape (6,)."""
        return SPATIAL.n_dofs * self.node + np.arange(SPATIAL.n_dofs)

    @cached_property
    def pose_map(self) -> np.ndarray:
        """The frame is this matrix times the pose of a rigid body, shape (12, 12)."""
        return _moved_by(self.point)

    @cached_property
    def frame_map(self) -> np.ndarray:
        """The frame is this matrix times that of the node, shape (12, 12)."""
        return _moved_by(self.arm)

    def frame_of_pose(self, poses: np.ndarray) -> np.ndarray:
        """Return the frame (12, ...) from rigid poses of shape (n_bodies, 12, ...)."""
        if self.on_ground:
            return self.ground_frame(poses.shape[2:])
        return np.tensordot(self.pose_map, poses[self.body], axes=1)

    def frame_of(self, node_frame: np.ndarray) -> np.ndarray:
        """Return the frame (12 or more, ...) from that of the node."""
        frame = node_frame.copy()
        axes = node_frame[3:12].reshape(3, 3, *node_frame.shape[1:])
        frame[:3] += np.tensordot(self.arm, axes, axes=1)
        return frame

    def ground_frame(self, trailing: tuple[int, ...]) -> np.ndarray:
        """Return the frame of a point of the ground, shape (12, *trailing)."""
        frame = np.concatenate([self.point, np.eye(3).ravel()])
        return np.broadcast_to(frame.reshape(-1, *(1,) * len(trailing)), (SPATIAL.n_pose, *trailing)).copy()


def _moved_by(arm: np.ndarray) -> np.ndarray:
    """Return what makes a frame that is moved by an arm (3,) along its own axes of a frame, shape (12, 12)."""
    result = np.eye(SPATIAL.n_pose)
    for k, length in enumerate(arm):
        result[:3, 3 + 3 * k : 6 + 3 * k] = length * np.eye(3)
    return result
