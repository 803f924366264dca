"""Rigid kinematics: poses of the undeformed bodies over the independent coordinates.

The poses P solve the loop closure together with the coordinates' definition,

    c(P) = 0,    theta_k(P) = theta_k,

by Newton's method, continued from configuration to configuration so that the assembly branch is kept
(``rho(theta)`` of Naets et al. 2015, eq. (4)). With J the Jacobian of both, implicit differentiation gives
``J dP/dtheta_k = e_k`` and ``J d2P/dtheta_k dtheta_l = -(d2c/dP2)[dP_k, dP_l]``.

Redundant constraints (the same statement twice) are allowed: J then has more rows than columns and full column rank.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.linalg import qr

from pgmp_petsc.mechanism.joints import N_FRAME
from pgmp_petsc.mechanism.mechanism import Attachment, Mechanism, place_points
from pgmp_petsc.runtime.errors import InputError

CONTINUATION_STEP = 0.02  # rad; Newton's method converges from a linear prediction over far larger steps
NEARLY_SINGULAR = 1e-2  # the same, where a bisection ended that may not come closer
REACH = 0.05  # rad beyond a limited range: the bending of a joint's node at the range's end
MAX_ITERATIONS = 25
CLOSURE_TOLERANCE = 1e-12  # of the mechanism's size (positions) or of 1 rad
SINGULAR_TOLERANCE = 1e-5  # smallest singular value of J over the largest, lengths scaled by the mechanism's size


class RigidKinematics:
    """Rigid motion of a mechanism with one independent coordinate over its range.

    Parameters
    ----------
    mechanism
        The mechanism; it is assembled near ``mechanism.first_guess``.

    Raises
    ------
    InputError
        If the mechanism cannot be closed somewhere in the range, if the number of coordinates is not its number of
        degrees of freedom, or if the coordinates lose control of it (singular J).
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.size = _size(mechanism)
        if len(mechanism.coordinates) != 1:
            names = ", ".join(coordinate.name for coordinate in mechanism.coordinates)
            raise InputError(
                f"coordinates: {names}: {len(mechanism.coordinates)} independent coordinates were given; "
                "this version takes exactly one"
            )
        self.coordinate = mechanism.coordinates[0]
        self._check_count()
        self._continue()

    @property
    def n_coordinates(self) -> int:
        """Number of independent rigid coordinates n_theta."""
        return len(self.mechanism.coordinates)

    def poses(self, theta: np.ndarray) -> np.ndarray:
        """Solve the rigid closure.

        Parameters
        ----------
        theta
            Coordinate values, shape (n,), rad; inside the range unless the coordinate is periodic.

        Returns
        -------
        ndarray, shape (n_bodies, 3, n)
            ``(X, Y, Phi)`` of every body: m, m, rad.
        """
        theta = np.asarray(theta, dtype=float)
        turns = np.zeros_like(theta)
        if self.coordinate.periodic:
            turns = np.floor((theta - self.coordinate.lower) / (2 * np.pi))
        inside = theta - 2 * np.pi * turns
        poses = self._close(self._guess(inside), inside)
        poses[:, 2] += np.outer(self._winding, 2 * np.pi * turns)
        return poses

    def rates(self, poses: np.ndarray) -> np.ndarray:
        """Return ``dP/dtheta_k`` at poses (n_bodies, 3, n), shape (n_bodies, 3, n_theta, n)."""
        n = poses.shape[2]
        jacobian = np.moveaxis(self._jacobian(poses), -1, 0)
        unit = np.zeros((n, jacobian.shape[1], self.n_coordinates))
        unit[:, -self.n_coordinates :] = np.eye(self.n_coordinates)
        rates = np.linalg.pinv(jacobian) @ unit
        return np.moveaxis(rates, 0, -1).reshape(-1, N_FRAME, self.n_coordinates, n)

    def curvatures(self, poses: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return ``d2P/dtheta_k dtheta_l``, shape (n_bodies, 3, n_theta, n_theta, n).

        Parameters
        ----------
        poses, rates
            As from `poses` and `rates`.
        """
        n, n_theta = poses.shape[2], self.n_coordinates
        jacobian = self._jacobian(poses)
        right = np.zeros((jacobian.shape[0], n_theta, n_theta, n))
        for connection in self.mechanism.connections:
            a, b = connection.a.frame_of_pose(poses), connection.b.frame_of_pose(poses)
            first = np.concatenate(
                [_push(side, poses, rates) for side in (connection.a, connection.b)]
            )  # (6, n_theta, n)
            second = np.concatenate(
                [_push_curvature(side, poses, rates) for side in (connection.a, connection.b)]
            )  # (6, n_theta, n_theta, n)
            right[connection.rows] = np.einsum(
                "cijn,ikn,jln->ckln", connection.joint.hessian(a, b), first, first
            ) + np.einsum("cin,ikln->ckln", connection.joint.jacobian(a, b), second)
        inverse = np.linalg.pinv(np.moveaxis(jacobian, -1, 0))
        result = -np.einsum("npc,ckln->pkln", inverse, right)
        return result.reshape(-1, N_FRAME, n_theta, n_theta, n)

    def positions(self, node: int, theta: np.ndarray) -> np.ndarray:
        """Return the frame of one node of the rigid mechanism, shape (3, n), at theta of shape (n,)."""
        index, body = next(
            (i, b) for i, b in enumerate(self.mechanism.bodies) if node in range(b.nodes.start, b.nodes.stop)
        )
        point = body.mesh.nodes[node - body.first_node]
        return place_points(self.poses(theta)[index], point[None])[0]

    def within_reach(self, theta: np.ndarray) -> np.ndarray:
        """Return where the rigid mechanism can be placed: in the range, or a little (`REACH`) outside it."""
        if self.coordinate.periodic:
            return np.isfinite(theta)
        return (theta >= self.coordinate.lower - REACH) & (theta <= self.coordinate.upper + REACH)

    def residual(self, poses: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Return closure and driving residuals, shape (n_constraints + n_theta, n)."""
        parts = [
            c.joint.residual(c.a.frame_of_pose(poses), c.b.frame_of_pose(poses))
            for c in self.mechanism.connections
        ]
        driven = self.coordinate.connection
        measured = self.coordinate.measure(driven.a.frame_of_pose(poses), driven.b.frame_of_pose(poses))
        return np.concatenate([*parts, (measured - theta)[None]])

    def _guess(self, theta: np.ndarray) -> np.ndarray:
        """Return poses between the configurations of the continuation, by quintic Hermite polynomials.

        They are so close (sixth order in `CONTINUATION_STEP`) that Newton's method has nothing left to do as a rule.
        """
        result = np.empty((theta.size, self._continued.shape[2]))
        _hermite(theta, self._theta[0], self._step, self._continued, result)
        return np.ascontiguousarray(result.T).reshape(len(self.mechanism.bodies), N_FRAME, theta.size)

    def _jacobian(self, poses: np.ndarray) -> np.ndarray:
        """Return d(residual)/dP, shape (n_constraints + n_theta, 3 n_bodies, n)."""
        n_rows = self.mechanism.n_constraints + self.n_coordinates
        jacobian = np.zeros((n_rows, len(self.mechanism.bodies), N_FRAME, poses.shape[2]))
        for c in self.mechanism.connections:
            frames = c.joint.jacobian(c.a.frame_of_pose(poses), c.b.frame_of_pose(poses))
            for offset, side in ((0, c.a), (N_FRAME, c.b)):
                if not side.on_ground:
                    block = frames[:, offset : offset + N_FRAME]
                    jacobian[c.rows, side.body] += np.einsum("cfn,fpn->cpn", block, _frame_gradient(side, poses))
        for sign, side in ((-1.0, self.coordinate.connection.a), (1.0, self.coordinate.connection.b)):
            if not side.on_ground:
                jacobian[-1, side.body, 2] += sign
        return jacobian.reshape(n_rows, -1, poses.shape[2])

    def _scaled(self, jacobian: np.ndarray) -> np.ndarray:
        """Scale lengths by the mechanism's size, so that singular values do not depend on the unit."""
        rows = np.ones(jacobian.shape[0])
        for connection in self.mechanism.connections:
            rows[connection.rows] = 1.0 / self.size
        columns = np.tile([self.size, self.size, 1.0], len(self.mechanism.bodies))
        return rows[:, None] * jacobian * columns

    def _close(self, poses: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Run Newton's method at all theta together; raise where it does not converge."""
        scale = np.ones(self.mechanism.n_constraints + self.n_coordinates)
        for connection in self.mechanism.connections:
            scale[connection.rows] = self.size
        poses = poses.copy()
        for _ in range(MAX_ITERATIONS):
            residual = self.residual(poses, theta)
            gap = np.max(np.abs(residual) / scale[:, None], axis=0, initial=0.0)
            # each theta stops by itself, so that the others in the call have no part in its last digits
            open_ones = ~(gap < CLOSURE_TOLERANCE)
            if not open_ones.any():
                return poses
            if not np.all(np.isfinite(gap)):
                break
            moving = poses[..., open_ones]
            step = self._newton_step(moving, residual[:, open_ones])
            # far from the solution a whole step can throw a body around; no more than half a radian at once
            turn = np.max(np.abs(step[:, 2]), axis=0)
            poses[..., open_ones] = moving - step * np.minimum(1.0, 0.5 / np.maximum(turn, 1e-300))
        worst = int(np.nanargmax(gap)) if np.any(np.isfinite(gap)) else 0
        rows = residual[:-1, worst]
        blame = max(self.mechanism.connections, key=lambda c: np.max(np.abs(rows[c.rows])))
        raise InputError(
            f"joints.{blame.name}: the mechanism cannot close at {self.coordinate.name} = {theta[worst]:.6g} rad; "
            f"a gap of {np.max(np.abs(rows[blame.rows])):.3g} m remains. Check the bodies' lengths and placements, "
            f"or narrow coordinates.{self.coordinate.name}.range"
        )

    def _newton_step(self, poses: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Return what to take off the poses."""
        inverse = np.linalg.pinv(np.moveaxis(self._jacobian(poses), -1, 0), rcond=1e-10)
        return np.einsum("npc,cn->pn", inverse, residual).reshape(poses.shape)

    def _check_count(self) -> None:
        """Compare the number of coordinates with the degrees of freedom at the assembled configuration."""
        start = self._close(self.mechanism.first_guess[:, :, None], np.array([self.coordinate.lower]))
        self._start = start
        n_constraints = self.mechanism.n_constraints
        values = np.linalg.svd(self._scaled(self._jacobian(start)[:n_constraints, :, 0]), compute_uv=False)
        rank = int(np.sum(values > SINGULAR_TOLERANCE * values[0]))
        freedom = N_FRAME * len(self.mechanism.bodies) - rank
        if freedom != self.n_coordinates:
            raise InputError(
                f"joints: they leave the rigid mechanism {freedom} degrees of freedom "
                f"({N_FRAME * len(self.mechanism.bodies)} of its {len(self.mechanism.bodies)} bodies less "
                f"{rank} independent constraints), but {self.n_coordinates} coordinate was named: "
                f"{self.coordinate.name}. Both numbers must be equal"
            )
        self.n_redundant = n_constraints - rank

    def _check_control(self, poses: np.ndarray, theta: float) -> None:
        values = np.linalg.svd(self._scaled(self._jacobian(poses)[:, :, 0]), compute_uv=False)
        if values[-1] < SINGULAR_TOLERANCE * values[0]:
            self._refuse_control(theta, values)

    def _refuse_control(self, theta: float, values: np.ndarray) -> None:
        raise InputError(
            f"coordinates.{self.coordinate.name}: it does not control the mechanism at {theta:.6g} rad (smallest "
            f"singular value of the closure {values[-1]:.3g}, largest {values[0]:.3g}); choose another joint or a "
            "range without this configuration"
        )

    def _orientation(self, poses: np.ndarray) -> float:
        """Return the sign of det J on the rows chosen last."""
        return float(np.linalg.slogdet(self._scaled(self._jacobian(poses)[:, :, 0])[self._pivots])[0])

    def _continue(self) -> None:
        """Follow the branch over the range, from its lower end."""
        lower, upper = self.coordinate.lower, self.coordinate.upper
        n_steps = max(8, int(np.ceil((upper - lower) / CONTINUATION_STEP)))
        self._theta = np.linspace(lower, upper, n_steps + 1)
        self._step = self._theta[1] - self._theta[0]
        sign = self._choose_pivots(self._start)
        poses = []
        guess = self._start
        for theta in self._theta:
            now = self._close(guess, np.array([theta]))
            self._check_control(now, theta)
            if self._orientation(now) != sign:
                self._check_change(poses[-1][..., None], theta - self._step, theta, sign)
                sign = self._choose_pivots(now)
            poses.append(now[..., 0])
            guess = now + self.rates(now)[:, :, 0] * self._step
        self._poses = np.stack(poses, axis=-1)
        # one step more, to the last digit: all later poses are interpolated between these
        self._poses -= self._newton_step(self._poses, self.residual(self._poses, self._theta))
        rates = self.rates(self._poses)
        curvatures = self.curvatures(self._poses, rates)[:, :, 0, 0]
        rates = rates[:, :, 0]
        derivatives = (self._poses, rates * self._step, curvatures * (0.5 * self._step**2))
        self._continued = np.array([part.reshape(-1, self._theta.size).T for part in derivatives])
        self._winding = np.zeros(len(self.mechanism.bodies))
        if self.coordinate.periodic:
            self._check_period()

    def _choose_pivots(self, poses: np.ndarray) -> float:
        """Choose independent rows of J at a configuration and return the sign of their determinant."""
        _, _, order = qr(self._scaled(self._jacobian(poses)[:, :, 0]).T, pivoting=True)
        self._pivots = order[: N_FRAME * len(self.mechanism.bodies)]
        return self._orientation(poses)

    def _check_change(self, poses: np.ndarray, before: float, after: float, sign: float) -> None:
        """Bisect for the configuration between two steps where the determinant changes its sign.

        It is refused if J is singular there; with redundant constraints it may be the chosen rows alone that are.
        """
        for _ in range(30):
            middle = 0.5 * (before + after)
            there = self._close(poses, np.array([middle]))
            if self._orientation(there) == sign:
                before, poses = middle, there
            else:
                after = middle
        values = np.linalg.svd(self._scaled(self._jacobian(poses)[:, :, 0]), compute_uv=False)
        if not self.n_redundant or values[-1] < NEARLY_SINGULAR * values[0]:
            self._refuse_control(before, values)

    def _check_period(self) -> None:
        change = self._poses[..., -1] - self._poses[..., 0]
        self._winding = np.rint(change[:, 2] / (2 * np.pi))
        change[:, 2] -= 2 * np.pi * self._winding
        if np.max(np.abs(change / [self.size, self.size, 1.0])) > 1e-8:
            raise InputError(
                f"coordinates.{self.coordinate.name}.periodic = true: after one turn the mechanism does not come "
                "back to where it began (it moved to another assembly branch); give a range that is not periodic"
            )


def _size(mechanism: Mechanism) -> float:
    """Return a length that is typical of the mechanism: the largest extent of a body, m."""
    return max(float(np.max(np.ptp(body.shape.nodes, axis=0))) for body in mechanism.bodies)


def _frame_gradient(side: Attachment, poses: np.ndarray) -> np.ndarray:
    """Return d(frame)/d(pose), shape (3, 3, n)."""
    gradient = np.zeros((N_FRAME, N_FRAME, poses.shape[2]))
    for i in range(N_FRAME):
        gradient[i, i] = 1.0
    angle = poses[side.body, 2]
    x, y = side.point
    gradient[0, 2] = -np.sin(angle) * x - np.cos(angle) * y
    gradient[1, 2] = np.cos(angle) * x - np.sin(angle) * y
    return gradient


def _push(side: Attachment, poses: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return the frame's derivatives with theta, shape (3, n_theta, n)."""
    if side.on_ground:
        return np.zeros((N_FRAME, *rates.shape[2:]))
    return np.einsum("fpn,pkn->fkn", _frame_gradient(side, poses), rates[side.body])


def _push_curvature(side: Attachment, poses: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return the frame's second derivatives with theta at straight poses, shape (3, n_theta, n_theta, n)."""
    n_theta, n = rates.shape[2:]
    second = np.zeros((N_FRAME, n_theta, n_theta, n))
    if not side.on_ground:
        arm = side.frame_of_pose(poses)[:2] - poses[side.body, :2]
        turn = rates[side.body, 2]
        second[:2] = -np.einsum("fn,kn,ln->fkln", arm, turn, turn)
    return second


@njit(cache=True, error_model="numpy")
def _hermite(theta, first, step, continued, result):
    """Fill result (n, n_p) with quintic Hermite polynomials through values and derivatives at equal distances.

    `continued` holds values, first derivatives times the step and second ones times half its square, shape (3, n_points,
    n_p).
    """
    for k in range(theta.size):
        position = (theta[k] - first) / step
        cell = min(max(int(position), 0), continued.shape[1] - 2)
        x = position - cell
        y = 1.0 - x
        # seen from its far end, a cell is that of the near one in the mirror
        a, b = y * y * y, x * x * x
        for i in range(result.shape[1]):
            near = continued[0, cell, i] * (1.0 + x * (3.0 + 6.0 * x)) + x * (1.0 + 3.0 * x) * continued[1, cell, i]
            far = continued[0, cell + 1, i] * (1.0 + y * (3.0 + 6.0 * y)) - y * (1.0 + 3.0 * y) * continued[1, cell + 1, i]
            near += x * x * continued[2, cell, i]
            far += y * y * continued[2, cell + 1, i]
            result[k, i] = a * near + b * far
