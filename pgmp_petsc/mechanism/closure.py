"""The loop closure of the rigid mechanism and what drives it: one system of equations for the poses.

The poses P solve the loop closure together with the coordinates' definition,

    c(P) = 0,    theta_k(P) = theta_k,

by Newton's method. With J the Jacobian of both, implicit differentiation gives ``J dP/dtheta_k = e_k`` and
``J d2P/dtheta_k dtheta_l = -(d2c/dP2)[dP_k, dP_l]``.

Redundant constraints (the same statement twice) are allowed: J then has more rows than columns and full column rank.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.mechanism import Coordinate, Mechanism
from pgmp_petsc.runtime.errors import InputError

MAX_ITERATIONS = 25
CLOSURE_TOLERANCE = 1e-12  # of the mechanism's size (positions) or of 1 rad


class LoopClosure:
    """Closure and driving equations of a mechanism.

    Parameters
    ----------
    mechanism
        The mechanism; all its coordinates drive.

    Attributes
    ----------
    size
        A length that is typical of the mechanism: the largest extent of a body, m.
    n_coordinates
        Number of independent rigid coordinates n_theta.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.size = max(body.extent for body in mechanism.bodies)
        self.n_coordinates = len(mechanism.coordinates)
        # joints hold at points of rigid bodies here: their unknowns are those of the bodies' poses
        self._connections = mechanism.pose_connections
        self.n_constraints = self._connections[-1].rows.stop if self._connections else 0
        self.n_pose = mechanism.space.n_pose
        self._units = np.tile(mechanism.space.units(self.size), len(mechanism.bodies))
        self._scale = np.ones(self.n_constraints + self.n_coordinates)
        for connection in self._connections:
            self._scale[connection.rows][connection.joint.lengths] = self.size

    def describe(self, theta: np.ndarray) -> str:
        """Name a configuration (n_theta,): ``theta = 0.1 rad``."""
        values = (f"{c.name} = {value:.6g}" for c, value in zip(self.mechanism.coordinates, theta))
        return f"{', '.join(values)} rad"

    def measured(self, poses: np.ndarray) -> np.ndarray:
        """Return the coordinates at poses (n_bodies, n_pose, n), shape (n_theta, n)."""
        return np.array([c.measure(*self._frames(c, poses)) for c in self.mechanism.coordinates])

    def _frames(self, coordinate: Coordinate, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = coordinate.connection.sides
        return a.frame_of_pose(poses), b.frame_of_pose(poses)

    def residual(self, poses: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Return closure and driving residuals at theta (n, n_theta), shape (n_constraints + n_theta, n)."""
        away = self.measured(poses) - theta.T
        return np.concatenate([self._gaps(poses), self.mechanism.space.principal(away)])

    def jacobian(self, poses: np.ndarray) -> np.ndarray:
        """Return d(residual)/dP, shape (n_constraints + n_theta, n_pose n_bodies, n)."""
        unknowns = _unknowns(poses)
        jacobian = np.zeros((self.n_constraints + self.n_coordinates, *unknowns.shape))
        for c in self._connections:
            jacobian[c.rows, c.dofs] = c.jacobian(unknowns)[:, c.moving_columns]
        for row, coordinate in enumerate(self.mechanism.coordinates, self.n_constraints):
            gradient, _ = coordinate.derivatives(*self._frames(coordinate, poses))
            for first, side in zip((0, self.n_pose), coordinate.connection.sides):
                if not side.on_ground:
                    part = gradient[first : first + self.n_pose]
                    jacobian[row, self._own(side)] += np.tensordot(side.pose_map.T, part, axes=1)
        return jacobian

    def _own(self, side: Attachment) -> slice:
        return slice(self.n_pose * side.body, self.n_pose * (side.body + 1))

    def scaled_jacobian(self, poses: np.ndarray) -> np.ndarray:
        """Return J with lengths scaled by the size, so that singular values do not depend on the unit.

        Shape (n, n_constraints + n_theta, n_pose n_bodies).
        """
        return np.moveaxis(self.jacobian(poses) * self._units[:, None] / self._scale[:, None, None], -1, 0)

    def singular_values(self, poses: np.ndarray) -> np.ndarray:
        """Return the singular values of the scaled J, descending, shape (n, n_pose n_bodies)."""
        return np.linalg.svd(self.scaled_jacobian(poses), compute_uv=False)

    def rates(self, poses: np.ndarray) -> np.ndarray:
        """Return ``dP/dtheta_k`` at poses (n_bodies, n_pose, n), shape (n_bodies, n_pose, n_theta, n)."""
        n = poses.shape[2]
        jacobian = np.moveaxis(self.jacobian(poses), -1, 0)
        unit = np.zeros((n, jacobian.shape[1], self.n_coordinates))
        unit[:, -self.n_coordinates :] = np.eye(self.n_coordinates)
        rates = np.linalg.pinv(jacobian) @ unit
        return np.moveaxis(rates, 0, -1).reshape(-1, self.n_pose, self.n_coordinates, n)

    def curvatures(self, poses: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return ``d2P/dtheta_k dtheta_l``, shape (n_bodies, n_pose, n_theta, n_theta, n)."""
        n, n_theta, unknowns = poses.shape[2], self.n_coordinates, _unknowns(poses)
        jacobian = self.jacobian(poses)
        right = np.zeros((jacobian.shape[0], n_theta, n_theta, n))
        moving = rates.reshape(len(unknowns), n_theta, n)
        for c in self._connections:
            hessian = c.hessian(unknowns)[:, c.moving_columns][:, :, c.moving_columns]
            right[c.rows] = np.einsum("cijn,ikn,jln->ckln", hessian, moving[c.dofs], moving[c.dofs], optimize=True)
        for row, coordinate in enumerate(self.mechanism.coordinates, self.n_constraints):
            _, hessian = coordinate.derivatives(*self._frames(coordinate, poses))
            if hessian is not None:
                pushed = [self._pushed(side, moving) for side in coordinate.connection.sides]
                both = np.concatenate(pushed)
                right[row] = np.einsum("ijn,ikn,jln->kln", hessian, both, both, optimize=True)
        inverse = np.linalg.pinv(np.moveaxis(jacobian, -1, 0))
        result = -np.einsum("npc,ckln->pkln", inverse, right)
        return result.reshape(-1, self.n_pose, n_theta, n_theta, n)

    def _pushed(self, side: Attachment, moving: np.ndarray) -> np.ndarray:
        """Return how a side's frame moves, shape (n_pose, n_theta, n), where poses move by (n_bodies n_pose, n_theta,
        n)."""
        if side.on_ground:
            return np.zeros((self.n_pose, *moving.shape[1:]))
        return np.tensordot(side.pose_map, moving[self._own(side)], axes=1)

    def close(self, poses: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Run Newton's method at all theta (n, n_theta) together, from poses (n_bodies, n_pose, n).

        Raises
        ------
        InputError
            Where it does not converge.
        """
        poses, residual, gap = self._newton(poses, theta)
        if np.all(gap < CLOSURE_TOLERANCE):
            return poses
        worst = int(np.nanargmax(gap)) if np.any(np.isfinite(gap)) else 0
        rows = residual[: self.n_constraints, worst]
        blame = max(self.mechanism.connections, key=lambda c: np.max(np.abs(rows[c.rows])))
        ranges = " or ".join(f"coordinates.{c.name}.range" for c in self.mechanism.coordinates)
        raise InputError(
            f"joints.{blame.name}: the mechanism cannot close at {self.describe(theta[worst])}; "
            f"a gap of {np.max(np.abs(rows[blame.rows])):.3g} m remains. Check the bodies' lengths and placements, "
            f"or narrow {ranges}"
        )

    def closed_freely(self, poses: np.ndarray) -> np.ndarray:
        """Close the loops near poses (n_bodies, n_pose, n) wherever the coordinates then are; best effort."""
        return self._newton(poses, None)[0]

    def newton_step(self, poses: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Return what to take off the poses; of the closure alone, if the residual has no driving rows."""
        jacobian = self.jacobian(poses)[: len(residual)]
        inverse = np.linalg.pinv(np.moveaxis(jacobian, -1, 0), rcond=1e-10)
        return np.einsum("npc,cn->pn", inverse, residual).reshape(poses.shape)

    def _gaps(self, poses: np.ndarray) -> np.ndarray:
        unknowns = _unknowns(poses)
        return np.concatenate([np.empty((0, poses.shape[2])), *(c.residual(unknowns) for c in self._connections)])

    def _newton(self, poses: np.ndarray, theta: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return poses, residual and the largest scaled entry of each; undriven where no theta is given."""
        poses = poses.copy()
        for _ in range(MAX_ITERATIONS):
            residual = self._gaps(poses) if theta is None else self.residual(poses, theta)
            gap = np.max(np.abs(residual) / self._scale[: len(residual), None], axis=0, initial=0.0)
            # each theta stops by itself, so that the others in the call have no part in its last digits
            open_ones = ~(gap < CLOSURE_TOLERANCE)
            if not open_ones.any() or not np.all(np.isfinite(gap)):
                break
            moving = poses[..., open_ones]
            step = self.newton_step(moving, residual[:, open_ones])
            # far from the solution a whole step can throw a body around; no more than half a radian at once
            turn = np.max(self.mechanism.space.turns(step), axis=0)
            poses[..., open_ones] = moving - step * np.minimum(1.0, 0.5 / np.maximum(turn, 1e-300))
        return poses, residual, gap


def _unknowns(poses: np.ndarray) -> np.ndarray:
    """Return the poses (n_bodies, n_pose, n) of all bodies one after the other, shape (n_bodies n_pose, n)."""
    return poses.reshape(poses.shape[0] * poses.shape[1], poses.shape[2])
