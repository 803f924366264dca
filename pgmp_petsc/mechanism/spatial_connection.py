"""A joint in space between two attachments."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.mechanism.spatial_attachment import SpatialAttachment
from pgmp_petsc.mechanism.spatial_joints import SpatialJoint
from pgmp_petsc.mechanism.statements import Statement, angle


@dataclass(frozen=True, eq=False)
class PoseConnection:
    """A joint between two points of rigid bodies, in the unknowns of the bodies' poses."""

    joint: SpatialJoint
    a: SpatialAttachment
    b: SpatialAttachment
    rows: slice

    @property
    def moving_columns(self) -> np.ndarray:
        """Which of the 24 numbers of both poses there are: those of sides that are not on the ground."""
        sides = zip((0, SPATIAL.n_pose), (self.a, self.b))
        return np.concatenate([f + np.arange(SPATIAL.n_pose) for f, side in sides if not side.on_ground])

    @property
    def dofs(self) -> np.ndarray:
        """The poses of the sides that are not on the ground, among those of all bodies."""
        moving = [side.body for side in (self.a, self.b) if not side.on_ground]
        return np.concatenate([SPATIAL.n_pose * body + np.arange(SPATIAL.n_pose) for body in moving])

    def residual(self, unknowns: np.ndarray) -> np.ndarray:
        """Return c, shape (n_constraints, n), for poses one after the other (n_bodies 12, n)."""
        return self.joint.residual(*self._frames(unknowns))

    def jacobian(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the derivatives of c in both poses, shape (n_constraints, 24, n)."""
        jacobian = self.joint.jacobian(*self._frames(unknowns))
        return np.einsum("cin,ij->cjn", jacobian, self._map)

    def hessian(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the second derivatives of c in both poses, shape (n_constraints, 24, 24, n)."""
        constant = self._map.T @ self.joint.curvature @ self._map
        return np.broadcast_to(constant[..., None], (*constant.shape, unknowns.shape[1]))

    def _frames(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        poses = unknowns.reshape(-1, SPATIAL.n_pose, unknowns.shape[1])
        return self.a.frame_of_pose(poses), self.b.frame_of_pose(poses)

    @cached_property
    def _map(self) -> np.ndarray:
        """Return what makes both frames of both poses, shape (24, 24)."""
        eye = np.eye(SPATIAL.n_pose)
        return block_diag(*(eye if side.on_ground else side.pose_map for side in (self.a, self.b)))


@dataclass(frozen=True, eq=False)
class SpatialConnection:
    """A named joint between two attachments, and the rows of its constraints.

    Attributes
    ----------
    axes
        The joint's triad in the frames of a and of b, shape (3, 3) each, one axis a column.
    """

    name: str
    joint: SpatialJoint
    a: SpatialAttachment
    b: SpatialAttachment
    rows: slice
    axes: tuple[np.ndarray, np.ndarray]

    @property
    def sides(self) -> tuple[SpatialAttachment, SpatialAttachment]:
        """Both attachments."""
        return self.a, self.b

    @cached_property
    def angle(self) -> Statement:
        """How far b is turned against a about the first axis; 0 where both triads agree."""
        return angle(*self.axes)

    def on_poses(self) -> PoseConnection:
        """Return the joint between points of rigid bodies, in the unknowns of the bodies' poses."""
        return PoseConnection(self.joint, self.a, self.b, self.rows)

    def body_jacobian(self, poses: np.ndarray, held: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return, for each side that moves, its node's unknowns (6,) and dc in them (n_constraints, 6), in body frames.

        Both arguments are the poses (n_bodies, 12) of one configuration.
        """
        frames = [side.frame_of_pose(poses) for side in self.sides]
        jacobian = self.joint.jacobian(*frames)
        found = []
        for first, side, frame in zip((0, SPATIAL.n_pose), self.sides, frames):
            if not side.on_ground:
                gradient = SPATIAL.natural_gradient(frame, side.arm)
                found.append((side.dofs, jacobian[:, first : first + SPATIAL.n_pose] @ gradient))
        return found
