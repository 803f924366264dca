"""Back-transformation: nodal motion from reduced coordinates (Naets et al. 2015, eq. (4)).

    q = rho(theta) + R(theta) (Psi(theta) delta + 1/2 chi(theta) delta delta)

with rho and the bodies' rotations R from the exact rigid kinematics and Psi, in body frames, interpolated; the same for
the curvature chi, if the model has one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import factorial

import numpy as np
import scipy
from numpy.polynomial import Polynomial

from pgmp_petsc.lanes.compiled import njit
from pgmp_petsc.mechanism.joints import Attachment
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.space import SPATIAL, leibniz
from pgmp_petsc.reduction.cell_products import N_ROWS, cell_stencil, count_rows, locate, pair_changes
from pgmp_petsc.reduction.interpolation import Interpolant
from pgmp_petsc.reduction.rom import ReducedOrderModel

BLOCK = 64


class Reconstruction:
    """Frames of some nodes, by their global numbers, from reduced coordinates.

    The reduced-order model has the projection; `internal` asks for the internal coordinates of all bodies, too.
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
        #: displacements and rotations of the nodes in body frames, as `ReducedOrderModel.displacements` has them
        self.displacements: Interpolant = rom.displacements(scheme, rows)
        self._curved = rom.curvature is not None
        bodies = kinematics.mechanism.bodies
        self._bodies = np.repeat(np.arange(len(bodies)), [body.n_nodes for body in bodies])[self._nodes]
        self._points = np.concatenate([body.mesh.nodes for body in bodies])[self._nodes]

    def frames(self, eta: np.ndarray) -> np.ndarray:
        """Return the frames of the nodes, shape (n_nodes, 3, n), for eta of shape (n, n_eta).

        In space a frame is position, directors and the rigid coordinates: shape (n_nodes, 12 + n_theta, n).
        """
        theta = self._theta(eta)
        return self._frames(theta, self._kinematics.poses(theta), self._displacements(eta))

    def unknowns(self, paths: np.ndarray) -> np.ndarray:
        """Return positions, in space with directors, and internal coordinates as a full-order model numbers them, shape
        (n_dofs, n_points, n), at the points (n_points, n, n_eta) of n short paths; see `mechanism.mechanism`.

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
            moved = local[:, : self._n_nodal].reshape(len(theta), self._nodes.size, self._space.n_dofs)
            turns = scipy.spatial.transform.Rotation.from_rotvec(moved[..., 3:].reshape(-1, 3)).as_matrix()
            _place_in_space(self._bodies, self._points, poses, moved, turns.reshape(*moved.shape[:2], 3, 3), frames)
            frames[:, self._space.n_pose :] = theta.T[: frames.shape[1] - self._space.n_pose]
        else:
            _place(self._bodies, self._points, poses, np.cos(poses[:, 2]), np.sin(poses[:, 2]), local, frames)

    def local(self, eta: np.ndarray) -> np.ndarray:
        """Return displacements and rotations in body frames, shape (n, n_nodes, 3), in space (n, n_nodes, 6)."""
        return self._displacements(eta).reshape(len(eta), self._nodes.size, self._space.n_dofs)

    def jets(self, states: Sequence[np.ndarray], order: int, cells_of: np.ndarray | None = None) -> list[np.ndarray]:
        """Return `frames` and their derivatives over time up to an order, each (n_nodes, n_pose, n); in space they are
        those of position and directors.

        All are exact: derivatives of poses from the kinematics, those of displacements from the cells of the tables.
        States are eta, its rates and, of order 2, its accelerations, each of shape (n, n_eta); tables may be continued
        from the cells of other eta, next to these.
        """
        eta = states[0]
        if not self._nodes.size:  # of forces in joints alone, most of which take no frames
            return [np.empty((0, self._space.n_pose, len(eta)))] * (order + 1)
        if order == 0 and cells_of is None:
            return [self.frames(eta)]
        theta, poses = self._theta(eta), self._kinematics.poses(self._theta(eta))
        local = self._displacement_jets(states[: order + 1], eta if cells_of is None else cells_of)
        found = [self._frames(theta, poses, local[0])]
        if order:
            moving = self._kinematics.jets(poses, [self._theta(part) for part in states[1 : order + 1]])
            found += self._frame_changes([poses, *moving], [part[:, : self._n_nodal].T for part in local])
        return found

    def _displacement_jets(self, states: Sequence[np.ndarray], cells_of: np.ndarray) -> list[np.ndarray]:
        """Return displacements in body frames and their derivatives over time, each (n, n_unknowns)."""
        r, order, (n, _) = self._kinematics.n_coordinates, len(states) - 1, states[0].shape
        deltas, shapes = [part[:, r:] for part in states], self.displacements
        factors = deltas
        if self._curved:
            i, j = np.tril_indices(deltas[0].shape[1])
            half = np.where(i == j, 0.5, 1.0)
            pairs = leibniz(np.multiply, [part[:, i] for part in deltas], [half * part[:, j] for part in deltas])
            factors = [np.hstack(parts) for parts in zip(deltas, pairs)]
        table = shapes.rows.reshape(-1, *shapes.shape)
        motion = np.array([self._theta(part) for part in states])
        found = np.zeros((order + 1, n, shapes.shape[-1]))
        _fill_jets(motion, np.ascontiguousarray(cells_of), shapes.axes, table, np.array(factors), found)
        return list(found)

    def _frame_changes(self, poses: Sequence[np.ndarray], local: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return the derivatives of frames, (n_nodes, n_pose, n) each, for poses (n_bodies, n_pose, n) and
        displacements (n_nodal, n) in body frames with theirs."""
        space, d = self._space, self._space.dimension
        moved = [part.reshape(self._nodes.size, space.n_dofs, -1) for part in local]
        origin = Attachment(0, 0, np.zeros(d), np.zeros(d))
        bodies = [origin.natural_jet([part[body] for part in poses]) for body in range(len(poses[0]))]
        found = np.empty((len(poses) - 1, self._nodes.size, space.n_pose, local[0].shape[1]))
        for node, (body, point) in enumerate(zip(self._bodies, self._points)):
            axes = [part[d:].reshape(d, d, -1) for part in bodies[body]]
            arms = [part[node, :d] for part in moved]
            arms[0] = arms[0] + point[:, None]
            places = leibniz(lambda u, axis: np.einsum("kn,kcn->cn", u, axis), arms, axes)
            if d == 3:
                turns = rotation_jet([part[node, 3:] for part in moved])
                directors = leibniz(lambda turn, axis: np.einsum("jkn,jcn->kcn", turn, axis), turns, axes)
            for k in range(1, len(poses)):
                found[k - 1, node, :d] = bodies[body][k][:d] + places[k]
                if d == 3:
                    found[k - 1, node, 3:] = directors[k].reshape(9, -1)
                else:
                    found[k - 1, node, 2] = poses[k][body, 2] + moved[k][node, 2]
        return list(found)

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
        slopes = [self.displacements.product(theta, delta, k) for k in range(n_theta)]

        def along(direction: np.ndarray) -> np.ndarray:
            bending = direction[:, n_theta:]
            changes = np.hstack([bending, pair_changes(delta, bending)]) if self._curved else bending
            rates = self.displacements.product(theta, np.ascontiguousarray(changes))
            for k, slope in enumerate(slopes):
                rates += direction[:, k, None] * slope
            return rates

        return along

    def _displacements(self, eta: np.ndarray) -> np.ndarray:
        n_theta = self._kinematics.n_coordinates
        return self.displacements.product(eta[:, :n_theta], eta[:, n_theta:])


N_SERIES = 16  # terms of rotations' series: up to pi the first one left out is below 1e-16


def rotation_jet(phi: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return ``exp(phi) = 1 + a P + b P^2``, (3, 3, n), P = phi x, of rotation vectors (3, n), with as many derivatives
    over time as there are of these; a = sin(t) / t and b = (1 - cos(t)) / t^2 as series of t^2."""
    number = np.arange(N_SERIES)
    x = leibniz(lambda u, v: np.sum(u * v, axis=0), phi, phi)
    crossed = [np.array([[0.0 * p[0], -p[2], p[1]], [p[2], 0.0 * p[0], -p[0]], [-p[1], p[0], 0.0 * p[0]]]) for p in phi]
    squared = leibniz(lambda one, other: np.einsum("ijn,jkn->ikn", one, other), crossed, crossed)
    found = [0.0, 0.0, 0.0][: len(phi)]
    for first, matrix in ((1, crossed), (2, squared)):
        series = Polynomial([(-1.0) ** k / factorial(2 * k + first) for k in number])
        slope, bend = series.deriv(1)(x[0]), series.deriv(2)(x[0])
        factor = [series(x[0]), *(slope * part for part in x[1:])]
        if len(phi) > 2:
            factor[2] = factor[2] + bend * x[1] ** 2
        found = [one + part for one, part in zip(found, leibniz(np.multiply, factor, matrix))]
    found[0] = found[0] + np.eye(3)[:, :, None]
    return found


@njit(cache=True, entry=True, error_model="numpy")
def _fill_jets(motion, cells_of, axes, table, factors, found):
    """Add sums of the rows of a table (n_rows, n_in, n_out), with factors (1 + order, n, n_in) and the weights of a
    motion (1 + order, n, n_theta) in the cells of other thetas (n, n_theta), and their derivatives over time to found
    (1 + order, n, n_out)."""
    order, n_rows = motion.shape[0] - 1, N_ROWS ** len(axes)
    along, rows = np.empty(N_ROWS, dtype=np.int64), np.empty(n_rows, dtype=np.int64)
    ahead, behind, slopes, spare = np.empty(N_ROWS), np.empty(N_ROWS), np.empty(N_ROWS), np.empty(N_ROWS)
    one, weights = np.zeros((3, N_ROWS)), np.zeros((3, n_rows))
    for k in range(motion.shape[1]):
        rows[0], weights[0, 0], weights[1, 0], weights[2, 0] = 0, 1.0, 0.0, 0.0
        n_filled = 1
        for axis in range(len(axes)):
            cell, _ = locate(cells_of[k, axis], axes[axis])
            s = (motion[0, k, axis] - axes[axis].lower) / axes[axis].step - cell
            # slopes are of second degree: their differences are exact
            cell_stencil(cell, s + 0.5, axes[axis], along, spare, ahead)
            cell_stencil(cell, s - 0.5, axes[axis], along, spare, behind)
            cell_stencil(cell, s, axes[axis], along, one[0], slopes)
            for j in range(N_ROWS if order > 0 else 0):
                one[1, j] = slopes[j] * motion[1, k, axis]
                if order > 1:
                    bend = (ahead[j] - behind[j]) / axes[axis].step
                    one[2, j] = bend * motion[1, k, axis] ** 2 + slopes[j] * motion[2, k, axis]
            for i in range(n_filled - 1, -1, -1):
                row, w, dw, ddw = rows[i] * count_rows(axes[axis]), weights[0, i], weights[1, i], weights[2, i]
                for j in range(N_ROWS):
                    to = N_ROWS * i + j
                    rows[to] = row + along[j]
                    weights[0, to] = w * one[0, j]
                    weights[1, to] = dw * one[0, j] + w * one[1, j]
                    weights[2, to] = ddw * one[0, j] + 2.0 * dw * one[1, j] + w * one[2, j]
            n_filled *= N_ROWS
        for p in range(n_rows):
            for i in range(table.shape[1]):
                value = weights[0, p] * factors[0, k, i]
                first = second = 0.0
                if order > 0:
                    first = weights[1, p] * factors[0, k, i] + weights[0, p] * factors[1, k, i]
                if order > 1:
                    second = weights[2, p] * factors[0, k, i] + 2.0 * weights[1, p] * factors[1, k, i]
                    second += weights[0, p] * factors[2, k, i]
                entries = table[rows[p], i]
                for e in range(entries.size):
                    found[0, k, e] += value * entries[e]
                for e in range(entries.size if order > 0 else 0):
                    found[1, k, e] += first * entries[e]
                for e in range(entries.size if order > 1 else 0):
                    found[2, k, e] += second * entries[e]


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


@njit(cache=True, error_model="numpy")
def _place_in_space(bodies, points, poses, moved, turns, frames):
    """Fill the first 12 entries of frames (n_nodes, at least 12, n): points moved by (n, n_nodes, 6) and directors
    turned by (n, n_nodes, 3, 3) in body frames, put at poses (n_bodies, 12, n)."""
    n = moved.shape[0]
    for first in range(0, n, BLOCK):
        for node in range(bodies.size):
            body = bodies[node]
            for k in range(first, min(first + BLOCK, n)):
                x, y, z = (points[node, 0] + moved[k, node, 0], points[node, 1] + moved[k, node, 1],
                           points[node, 2] + moved[k, node, 2])  # fmt: skip
                for c in range(3):
                    d, e, f = poses[body, 3 + c, k], poses[body, 6 + c, k], poses[body, 9 + c, k]
                    frames[node, c, k] = poses[body, c, k] + (x * d + y * e + z * f)
                    for j in range(3):
                        turn = turns[k, node, 0, j] * d + turns[k, node, 1, j] * e + turns[k, node, 2, j] * f
                        frames[node, 3 + 3 * j + c, k] = turn
