"""Back-transformation: nodal motion from reduced coordinates (Naets et al. 2015, eq. (4)).

    q = rho(theta) + R(theta) (Psi(theta) delta + 1/2 chi(theta) delta delta)

with rho and the bodies' rotations R from the exact rigid kinematics and Psi, in body frames, interpolated; the same for
the curvature chi, if the model has one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.space import SPATIAL
from pgmp_petsc.reduction.cell_products import pair_changes
from pgmp_petsc.reduction.interpolation import Interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel

BLOCK = 64
DIFFERENCE = 2e-3  # of poses and displacements, m and rad, of fourth order: truncation leaves 1e-12, rounding 1e-13


class Reconstruction:
    """Frames of some nodes from reduced coordinates.

    Parameters
    ----------
    rom
        The reduced-order model, with the projection.
    scheme
        Interpolation over the samples.
    nodes
        Global numbers of the nodes wanted.
    internal
        Whether the internal coordinates of all bodies are wanted too.
    """

    def __init__(
        self,
        kinematics: RigidKinematics,
        rom: ReducedOrderModel,
        scheme: str,
        nodes: Sequence[int],
        internal: bool = False,
    ) -> None:
        self._kinematics = kinematics
        self._nodes = np.asarray(nodes, dtype=int)
        self._space = kinematics.mechanism.space
        per_node = self._space.n_dofs
        rows = (per_node * self._nodes[:, None] + np.arange(per_node)).ravel()
        self._n_nodal = rows.size
        if internal:
            mechanism = kinematics.mechanism
            rows = np.append(rows, np.arange(per_node * mechanism.n_nodes, mechanism.n_dofs))
        self._curved, self._shapes = rom.curvature is not None, rom.displacements(scheme, rows)
        bodies = kinematics.mechanism.bodies
        self._bodies = np.repeat(np.arange(len(bodies)), [body.n_nodes for body in bodies])[self._nodes]
        self._points = np.concatenate([body.mesh.nodes for body in bodies])[self._nodes]

    @property
    def displacements(self) -> Interpolant:
        """Displacements and rotations of the nodes in body frames, values of shape (n_factors, n_unknowns).

        Factors are the flexible coordinates and, where the model is curved, the products of their pairs.
        """
        return self._shapes

    def frames(self, eta: np.ndarray) -> np.ndarray:
        """Return the frames of the nodes, shape (n_nodes, 3, n), for eta of shape (n, n_eta).

        In space a frame is position, directors and the rigid coordinates: shape (n_nodes, 12 + n_theta, n).
        """
        theta = self._theta(eta)
        return self._frames(theta, self._kinematics.poses(theta), self._displacements(eta))

    def unknowns(self, paths: np.ndarray) -> np.ndarray:
        """Return positions, in space with directors, and internal coordinates as a full-order model numbers them, shape
        (n_dofs, n_points, n), at the points (n_points, n, n_eta) of n short paths; see `mechanism.unknowns`.

        First and second differences from the first point of each, at which loops are closed, are those of the
        mechanism: poses at the others are those of `RigidKinematics.near`.
        """
        eta = paths.reshape(-1, paths.shape[2])
        theta, middle = self._theta(eta), self._theta(paths[0])
        poses = self._kinematics.poses(middle)
        if len(paths) > 1:
            near = self._kinematics.near(middle, poses, order=2)
            poses = np.concatenate([poses, *(near(self._theta(point)) for point in paths[1:])], axis=2)
        local, n_pose = self._displacements(eta), self._space.n_pose
        n_of_frames = n_pose * self._nodes.size
        found = np.empty((n_of_frames + local.shape[1] - self._n_nodal, len(eta)))
        self._fill_frames(theta, poses, local, found[:n_of_frames].reshape(self._nodes.size, n_pose, len(eta)))
        found[n_of_frames:] = local[:, self._n_nodal :].T
        return found.reshape(-1, *paths.shape[:2])

    def _theta(self, eta: np.ndarray) -> np.ndarray:
        return eta[:, : self._kinematics.n_coordinates]

    def _frames(self, theta: np.ndarray, poses: np.ndarray, local: np.ndarray) -> np.ndarray:
        n_theta = self._kinematics.n_coordinates if self._space is SPATIAL else 0
        frames = np.empty((self._nodes.size, self._space.n_pose + n_theta, len(theta)))
        self._fill_frames(theta, poses, local, frames)
        return frames

    def _fill_frames(self, theta: np.ndarray, poses: np.ndarray, local: np.ndarray, frames: np.ndarray) -> None:
        """Fill frames (n_nodes, n_pose, n), in space with the rigid coordinates behind where there is room."""
        if self._space is SPATIAL:
            self._fill_in_space(theta, poses, local[:, : self._n_nodal], frames)
        else:
            _place(self._bodies, self._points, poses, np.cos(poses[:, 2]), np.sin(poses[:, 2]), local, frames)

    def local(self, eta: np.ndarray) -> np.ndarray:
        """Return displacements and rotations in body frames, shape (n, n_nodes, 3), in space (n, n_nodes, 6)."""
        return self._displacements(eta).reshape(len(eta), self._nodes.size, self._space.n_dofs)

    def rates(self, eta: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the rates of position and rotation, in space of directors, (n_nodes, n_pose, n), for eta and its rates
        (n, n_eta).

        Poses and displacements in body frames have exact rates; what frames are made of these is smooth, and
        differenced.
        """
        theta, local = self._theta(eta), self._displacements(eta)
        poses, turning = self._kinematics.poses(theta), self._theta(v)
        moving = np.einsum("bpkn,nk->bpn", self._kinematics.rates(poses), turning)
        changes = self._changes(theta, np.ascontiguousarray(eta[:, theta.shape[1] :]))(v)
        far = DIFFERENCE / np.maximum(np.maximum(np.abs(moving).max(axis=(0, 1)), np.abs(changes).max(axis=1)), 1e-300)
        total = 0.0
        for offset, factor in zip((-2.0, -1.0, 1.0, 2.0), (1.0, -8.0, 8.0, -1.0)):
            h = offset * far
            there = self._frames(theta, poses + h * moving, local + h[:, None] * changes)
            total = total + factor * there[:, : self._space.n_pose]
        return total / (12.0 * far)

    def along(self, eta: np.ndarray) -> tuple[np.ndarray, Callable[[np.ndarray], Callable[[np.ndarray], np.ndarray]]]:
        """Return `frames` at eta (n, n_eta), and what gives them on lines through eta, straight in displacements.

        The latter takes directions (n, n_eta), and what it returns for these how far to go along them (n,).
        Displacements in body frames change by their exact derivative along the direction, so that no cell of the tables
        is left; poses are those of `RigidKinematics.near`.
        """
        theta, local = self._theta(eta), self._displacements(eta)
        poses = self._kinematics.poses(theta)
        poses_near = self._kinematics.near(theta, poses)
        changes = self._changes(theta, np.ascontiguousarray(eta[:, theta.shape[1] :]))

        def line(direction: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
            rates = changes(direction)

            def at(far: np.ndarray) -> np.ndarray:
                there = theta + far[:, None] * self._theta(direction)
                return self._frames(there, poses_near(there), local + far[:, None] * rates)

            return at

        return self._frames(theta, poses, local), line

    def _changes(self, theta: np.ndarray, delta: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Return what gives the exact derivative of displacements, (n, n_unknowns), along directions (n, n_eta)."""
        n_theta = theta.shape[1]
        slopes = [self._shapes.product(theta, delta, k) for k in range(n_theta)]

        def along(direction: np.ndarray) -> np.ndarray:
            bending = direction[:, n_theta:]
            changes = np.hstack([bending, pair_changes(delta, bending)]) if self._curved else bending
            rates = self._shapes.product(theta, np.ascontiguousarray(changes))
            for k, slope in enumerate(slopes):
                rates += direction[:, k, None] * slope
            return rates

        return along

    def _displacements(self, eta: np.ndarray) -> np.ndarray:
        n_theta = self._kinematics.n_coordinates
        return self._shapes.product(eta[:, :n_theta], eta[:, n_theta:])

    def _fill_in_space(self, theta: np.ndarray, poses: np.ndarray, local: np.ndarray, frames: np.ndarray) -> None:
        """Fill frames from displacements and rotations (n, 6 n_nodes) in body frames at poses (n_bodies, 12, n)."""
        from scipy.spatial.transform import Rotation  # takes a noticeable time, and the plane has no use for it

        n = len(theta)
        moved = local.reshape(n, self._nodes.size, SPATIAL.n_dofs)
        for node, (body, point) in enumerate(zip(self._bodies, self._points)):
            axes = poses[body, 3:].reshape(3, 3, n)
            frames[node, :3] = poses[body, :3] + np.einsum("nk,kcn->cn", point + moved[:, node, :3], axes)
            turn = Rotation.from_rotvec(moved[:, node, 3:]).as_matrix()
            frames[node, 3:12] = np.einsum("njk,jcn->kcn", turn, axes).reshape(9, n)
        frames[:, 12:] = theta.T[: frames.shape[1] - 12]


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
