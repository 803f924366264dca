"""Rigid motion in the plane and in space: what a pose is, and how it moves the points of a body.

In the plane a pose is ``(X, Y, Phi)``. In space it is the position of the body's origin and the three directors, the
axes of the body's frame, ``(r, d_1, d_2, d_3)``: twelve numbers, six of which are independent. A point of the body is
then linear in the pose, ``x = r + X_1 d_1 + X_2 d_2 + X_3 d_3``, joints are quadratic in it, and nothing is singular
anywhere (natural coordinates; Garcia de Jalon and Bayo 1994).

Velocities and accelerations of a rigid body are linear fields in its own frame, ``v_i + A_ij X_j``; their coefficients
are kept as in `Component.fields`: first v, then A row by row.

Displacements and rotations of a frame, small ones in the body's frame, are ``(u_x, u_y, phi)`` or ``(u, phi)`` with 6
numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import comb

import numpy as np

from pgmp_petsc.bodies.beam3d import cross
from pgmp_petsc.mechanism.statements import ANGLE, Statement


class Plane:
    """The plane; `Spatial` has the same of space."""

    dimension = 2
    n_pose = 3  # numbers of a pose; 12 in space
    n_dofs = 3  # displacements and rotations of a node; 6 in space
    identity = np.zeros(3)  # the pose of a body at rest in the ground's frame, shape (n_pose,)

    def units(self, size: float) -> np.ndarray:
        """Return what the numbers of a pose are measured in, shape (n_pose,): the size for lengths, 1 for
        directions."""
        return np.array([size, size, 1.0])

    def turns(self, step: np.ndarray) -> np.ndarray:
        """Return how far bodies turn with a small step of poses (n_bodies, n_pose, n), shape (n_bodies, n), rad."""
        return np.abs(step[:, 2])

    def measure(
        self, statement: Statement, a: np.ndarray, b: np.ndarray, turned: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """Return a statement for frames of shape (n_pose or more, ...). Angles, rad, are as far as frames have turned
        in the plane, and in space nearest to `turned`."""
        return b[2] - a[2] if statement.kind == ANGLE else statement.value(self.natural(a), self.natural(b))

    def moved(self, poses: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Return poses (n_bodies, n_pose, n) after a change of them of first order, or of first and second: in space
        bodies turn by the vector that belongs to it, however far."""
        return poses + change

    def displaced(self, poses: np.ndarray, motions: np.ndarray) -> np.ndarray:
        """Return poses (n_bodies, n_pose, n) after displacements and turns of bodies, along the inertial axes, shape
        (n_bodies, n_dofs, n): in space by rotation vectors, however long."""
        return poses + motions

    def changes(self, poses: np.ndarray, motions: np.ndarray) -> np.ndarray:
        """Return the changes of poses (n_bodies, n_pose, n) of first order with such motions (n_bodies, n_dofs, k, n),
        shape (n_bodies, n_pose, k, n)."""
        return motions

    def bends(self, poses: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return the second derivatives of poses (n_bodies, n_pose, n) that change by given rates (n_bodies, n_pose, k,
        n) and by nothing else, shape (n_bodies, n_pose, k, k, n)."""
        return np.zeros((*rates.shape[:3], *rates.shape[2:]))

    def straightened(self, poses: np.ndarray) -> np.ndarray:
        """Return a copy of poses (n_bodies, n_pose, n) with directors at right angles, where they are not."""
        return poses.copy()

    def winding(self, change: np.ndarray) -> np.ndarray:
        """Return the whole turns in a change of poses (n_bodies, n_pose), shape (n_bodies,), that poses count."""
        return np.rint(change[:, 2] / (2 * np.pi))

    def turned(self, poses: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Return poses (n_bodies, n_pose, n) with whole turns (n_bodies, n) added."""
        poses[:, 2] += 2 * np.pi * turns
        return poses

    def rotation(self, pose: np.ndarray) -> np.ndarray:
        """Return the matrix (n_dofs, n_dofs) that turns displacements of nodes, ``(u_x, u_y, phi)``, from the body's
        frame."""
        return self.frame_gradients(pose[None])[0]

    def frame_gradients(self, poses: np.ndarray) -> np.ndarray:
        """Return the changes of frames at poses (k, n_pose) with their displacements in the body's frame, shape (k,
        n_pose, n_dofs)."""
        found = np.zeros((len(poses), 3, 3))
        found[:, 0, 0] = found[:, 1, 1] = np.cos(poses[:, 2])
        found[:, 1, 0] = np.sin(poses[:, 2])
        found[:, 0, 1], found[:, 2, 2] = -found[:, 1, 0], 1.0
        return found

    def frame_curvatures(self, poses: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Return the second derivatives (n, k, n_dofs, n_dofs) of what has the slopes (n, k, n_pose) in frames at poses
        (k, n_pose) and is linear in each; rotations in space are rotation vectors."""
        return np.zeros((*slopes.shape, 3))

    def to_body(self, pose: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Turn vectors (d, n) into the frame of a body at poses (n_pose, n)."""
        return rotate(-pose[2], vectors)

    def natural(self, frame: np.ndarray) -> np.ndarray:
        """Return position and directors (d (d + 1), ...) of a frame (n_pose or more, ...), as `statements` take it."""
        cos, sin = np.cos(frame[2]), np.sin(frame[2])
        return np.array([frame[0], frame[1], cos, sin, -sin, cos])

    def place(self, pose: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return the frames (n, n_pose, ...) of points (n, d) of a rigid body at a pose (n_pose, ...)."""
        frames = np.empty((len(points), *pose.shape))
        frames[:, :2] = pose[:2] + np.moveaxis(rotate(pose[2][..., None], points.T), -1, 0)
        frames[:, 2] = pose[2]
        return frames

    def place_rates(self, pose: np.ndarray, rates: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return the rates (n, n_pose, ...) of these frames for those of the pose (n_pose, ...), itself (n_pose,)."""
        x, y = rotate(pose[2], points.T)
        found = np.repeat(rates[None], len(points), axis=0)
        found[:, :2] += np.multiply.outer(np.stack([-y, x], axis=1), rates[2])
        return found

    def velocity_field(self, pose: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return the coefficients (d + d^2, k, ...) of velocities for poses (n_pose, ...) and rates (n_pose, k,
        ...): ``R^T r'`` and ``phi' J``, J a right angle's rotation."""
        zero = np.zeros_like(rates[2])
        return np.array([*rotate(-pose[2], rates[:2]), zero, -rates[2], rates[2], zero])

    def acceleration_field(self, pose: np.ndarray, rates: np.ndarray, curvatures: np.ndarray) -> np.ndarray:
        """Return the coefficients (d + d^2, k, k, ...) of accelerations for second derivatives of the pose (n_pose, k,
        k, ...): ``R^T r''`` and ``phi'' J - phi' phi' 1``."""
        spin, centripetal = curvatures[2], rates[2][:, None] * rates[2]
        return np.array([*rotate(-pose[2], curvatures[:2]), -centripetal, -spin, spin, -centripetal])


class Spatial:
    """Space; what is not said here is said of `Plane`."""

    dimension, n_pose, n_dofs = 3, 12, 6
    identity = np.concatenate([np.zeros(3), np.eye(3).ravel()])

    def units(self, size: float) -> np.ndarray:
        return np.concatenate([np.full(3, size), np.ones(9)])

    def turns(self, step: np.ndarray) -> np.ndarray:
        return np.linalg.norm(step[:, 3:], axis=1) / np.sqrt(2.0)  # three directors, each of which one axis leaves

    def measure(
        self, statement: Statement, a: np.ndarray, b: np.ndarray, turned: np.ndarray | float = 0.0
    ) -> np.ndarray:
        return statement.value(self.natural(a), self.natural(b), turned)

    def moved(self, poses: np.ndarray, change: np.ndarray) -> np.ndarray:
        axes = poses[:, 3:].reshape(len(poses), 3, 3, -1)
        vector = 0.5 * cross(axes, change[:, 3:].reshape(axes.shape), axis=2).sum(axis=1)
        return self.displaced(poses, np.concatenate([change[:, :3], vector], axis=1))

    def displaced(self, poses: np.ndarray, motions: np.ndarray) -> np.ndarray:
        axes, vector = poses[:, 3:].reshape(len(poses), 3, 3, -1), motions[:, None, 3:]
        angle = np.linalg.norm(vector, axis=2, keepdims=True)
        once, twice = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
        across = cross(vector, axes, axis=2)
        turned = axes + once * across + twice * cross(vector, across, axis=2)
        return np.concatenate([poses[:, :3] + motions[:, :3], turned.reshape(len(poses), 9, -1)], axis=1)

    def changes(self, poses: np.ndarray, motions: np.ndarray) -> np.ndarray:
        n_bodies, _, k, n = motions.shape
        axes = poses[:, 3:].reshape(n_bodies, 3, 3, 1, n)
        turned = cross(motions[:, None, 3:], axes, axis=2)
        return np.concatenate([motions[:, :3], turned.reshape(n_bodies, 9, k, n)], axis=1)

    def bends(self, poses: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return the least that keeps directors a rotation, ``d_i'' = -sum_j (d_i' . d_j') d_j``."""
        n_bodies, _, k, n = rates.shape
        moving = rates[:, 3:].reshape(n_bodies, 3, 3, k, n)
        product = np.einsum("bickn,bjcln->bijkln", moving, moving)
        product = -0.5 * (product + product.swapaxes(3, 4))
        turned = np.einsum("bijkln,bjcn->bickln", product, poses[:, 3:].reshape(n_bodies, 3, 3, n))
        return np.concatenate([np.zeros((n_bodies, 3, k, k, n)), turned.reshape(n_bodies, 9, k, k, n)], axis=1)

    def straightened(self, poses: np.ndarray) -> np.ndarray:
        first, second = poses[:, 3:6], poses[:, 6:9]
        third = cross(first, second, axis=1)
        axes = [first, cross(third, first, axis=1), third]
        return np.concatenate([poses[:, :3], *(one / np.linalg.norm(one, axis=1)[:, None] for one in axes)], axis=1)

    def winding(self, change: np.ndarray) -> np.ndarray:
        return np.zeros(len(change))

    def turned(self, poses: np.ndarray, turns: np.ndarray) -> np.ndarray:
        return poses

    def rotation(self, pose: np.ndarray) -> np.ndarray:
        """Return the rotation of ``(u, phi)``."""
        turn, zero = directors(pose), np.zeros((3, 3))
        return np.block([[turn, zero], [zero, turn]])

    def to_body(self, pose: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        return np.einsum("kcn,cn->kn", pose[3:12].reshape(3, 3, -1), vectors)

    def frame_gradients(self, poses: np.ndarray) -> np.ndarray:
        """Return ``dr = R u``, ``d(d_k) = R (phi x e_k)``."""
        turned, found = poses[:, 3:].reshape(-1, 3, 3).swapaxes(1, 2), np.zeros((len(poses), 12, 6))
        found[:, :3, :3] = turned
        found[:, 3:, 3:] = (turned[:, None] @ TURNED_AXES).reshape(-1, 9, 3)
        return found

    def frame_curvatures(self, poses: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Return the part of ``exp(phi) e_k`` of second order, ``1/2 phi x (phi x e_k)``, times the slopes."""
        n, k, _ = slopes.shape
        found, turned = np.zeros((n, k, 6, 6)), poses[:, 3:].reshape(k, 3, 3).swapaxes(1, 2)
        along = slopes[..., 3:].reshape(n, k, 3, 3) @ turned  # slopes of d_k, on d_j
        found[..., 3:, 3:] = turning_of_second_order(along.swapaxes(-1, -2))
        return found

    def natural(self, frame: np.ndarray) -> np.ndarray:
        return frame[: self.n_pose]

    def place(self, pose: np.ndarray, points: np.ndarray) -> np.ndarray:
        frames = np.empty((len(points), *pose.shape))
        frames[:, 3:] = pose[3:]
        frames[:, :3] = pose[:3] + np.einsum("nk,ki...->ni...", points, pose[3:].reshape(3, 3, *pose.shape[1:]))
        return frames

    def place_rates(self, pose: np.ndarray, rates: np.ndarray, points: np.ndarray) -> np.ndarray:
        return self.place(rates, points)

    def velocity_field(self, pose: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return ``R^T r'`` and ``R^T R'``."""
        return self._field(pose, rates)

    def acceleration_field(self, pose: np.ndarray, rates: np.ndarray, curvatures: np.ndarray) -> np.ndarray:
        """Return ``R^T r''`` and ``R^T R''``."""
        n_pose, k, _, *trailing = curvatures.shape
        found = self._field(pose, curvatures.reshape(n_pose, k * k, *trailing))
        return found.reshape(len(found), k, k, *trailing)

    def _field(self, pose: np.ndarray, change: np.ndarray) -> np.ndarray:
        # director k is the column k of R: (R^T R')_ij = d_i . d_j'
        axes = pose[3:].reshape(3, 3, *pose.shape[1:])
        translation = np.einsum("ic...,ck...->ik...", axes, change[:3])
        moving = change[3:].reshape(3, 3, *change.shape[1:])
        gradient = np.einsum("ic...,jck...->ijk...", axes, moving)
        return np.concatenate([translation, gradient.reshape(9, *change.shape[1:])])


def leibniz(times: Callable[[np.ndarray, np.ndarray], np.ndarray], x: Sequence, y: Sequence) -> list[np.ndarray]:
    """Return a product and as many of its derivatives as there are of its factors."""
    return [sum(comb(n, k) * times(x[k], y[n - k]) for k in range(n + 1)) for n in range(len(x))]


def rotate(angle: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Turn points (2, ...) by angles that broadcast against a coordinate; the result has shape (2, ...)."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * point[0] - sin * point[1], sin * point[0] + cos * point[1]])


def directors(pose: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (3, 3) whose columns are the directors of a pose (12,)."""
    return pose[3:].reshape(3, 3).T


def cross_matrix(vector: np.ndarray) -> np.ndarray:
    """Return the matrix (3, 3) of ``vector x``."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def turning_of_second_order(columns: np.ndarray) -> np.ndarray:
    """Return the matrices Q (..., 3, 3) with ``phi.Q phi = sum_k g_k . (phi x (phi x e_k))``, g_k the columns of
    matrices (..., 3, 3): their symmetric part less their trace."""
    trace = np.trace(columns, axis1=-2, axis2=-1)[..., None, None]
    return 0.5 * (columns + np.swapaxes(columns, -1, -2)) - trace * np.eye(3)


TURNED_AXES = -np.array([cross_matrix(axis) for axis in np.eye(3)])  # ``phi x e_k`` of every k, shape (3, 3, 3)
Space = Plane | Spatial
PLANE, SPATIAL = Plane(), Spatial()


def space_of(dimension: int) -> Space:
    """Return the plane for 2, space for 3."""
    return PLANE if dimension == 2 else SPATIAL
