"""A joint in space between two attachments."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.mechanism.spatial_attachment import SpatialAttachment
from pgmp_petsc.mechanism.spatial_joints import SpatialJoint


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
                gradient = SPATIAL.frame_gradient(frame) @ side.node_map
                found.append((side.dofs, jacobian[:, first : first + SPATIAL.n_pose] @ gradient))
        return found


def angle_between(axes: tuple[np.ndarray, np.ndarray], frame_a: np.ndarray, frame_b: np.ndarray) -> np.ndarray:
    """Return how far b is turned against a about a joint's first axis, shape (...), rad, in (-pi, pi].

    Parameters
    ----------
    axes
        As in `SpatialConnection`; frames are turned by 0 where both triads agree.
    frame_a, frame_b
        Shape (12, ...) or more rows.
    """
    cos, sin = _turn(axes, frame_a, frame_b)
    return np.arctan2(sin, cos)


def angle_derivatives(
    axes: tuple[np.ndarray, np.ndarray], frame_a: np.ndarray, frame_b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return first and second derivatives of the angle in both frames, shapes (24, ...) and (24, 24, ...).

    The second ones are those of ``cos(theta) s - sin(theta) c`` with the angle held, which in directions that keep the
    directors orthonormal are the angle's own.
    """
    cos, sin = _turn(axes, frame_a, frame_b)
    forms = _forms(axes)
    z = np.concatenate([frame_a[:12], frame_b[:12]])
    slopes = [np.tensordot(form, z, axes=1) for form in forms]
    size = cos**2 + sin**2
    gradient = (cos * slopes[1] - sin * slopes[0]) / size
    hessian = np.multiply.outer(forms[1], cos) - np.multiply.outer(forms[0], sin)
    return gradient, hessian / size


def _turn(
    axes: tuple[np.ndarray, np.ndarray], frame_a: np.ndarray, frame_b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    (second, third), (in_b, _) = ((matrix[:, 1], matrix[:, 2]) for matrix in axes)
    directors_a, directors_b = (frame[3:12].reshape(3, 3, *frame.shape[1:]) for frame in (frame_a, frame_b))
    turned = np.tensordot(in_b, directors_b, axes=1)
    return tuple(np.sum(np.tensordot(axis, directors_a, axes=1) * turned, axis=0) for axis in (second, third))


def _forms(axes: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrices (24, 24) of the quadratic forms ``1/2 z^T Q z`` that are cosine and sine."""
    found = []
    for axis in (axes[0][:, 1], axes[0][:, 2]):
        form = np.zeros((24, 24))
        for i, j, c in np.ndindex(3, 3, 3):
            form[3 + 3 * i + c, 15 + 3 * j + c] += axis[i] * axes[1][j, 1]
        found.append(form + form.T)
    return tuple(found)
