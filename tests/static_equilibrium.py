"""Nonlinear static equilibrium of a mechanism held at one configuration, by Newton's method with dense matrices.

In body frames, with the strain energy V of all large rotations, constraints c and the rigid motion r = d rho/d theta,

    dV/du + C(u)^T lambda + M r nu = f,     c(u) = 0,     r^T M u = 0:

the inertia forces of a rigid acceleration balance the load, and theta is what it is through the last equation.
"""

from collections.abc import Mapping

import numpy as np
from compiled_elements import beam2d
from frames import to_inertial

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.bodies.body import element_dofs
from pgmp_petsc.bodies.matrices import AffineMatrices, weighted_sum
from pgmp_petsc.mechanism.constraint_set import ConstraintSet
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Unknowns, rigid_velocities


class StaticEquilibrium:
    """Strain energy, constraints and nonlinear static answers at one theta (rad), for given parameter values."""

    def __init__(self, kinematics: RigidKinematics, values: Mapping[str, float], theta: float) -> None:
        self._mechanism = mechanism = kinematics.mechanism
        matrices = AffineMatrices(mechanism.bodies, range(mechanism.n_dofs))
        self.mass = weighted_sum(matrices.mass, values).toarray()
        self.stiffness = weighted_sum(matrices.stiffness, values).toarray()
        poses = kinematics.poses(np.array([theta]))
        self.pose = poses[..., 0]
        self._rho = Unknowns(mechanism).place(self.pose)
        rigid = rigid_velocities(mechanism, self.pose, kinematics.rates(poses)[..., 0])
        self.rigid = rigid
        self._rest = np.zeros((mechanism.n_nodes, 3))
        self._elements = []
        for body in mechanism.bodies:
            self._rest[body.nodes, :2] = body.mesh.nodes
            terms = body.section.terms("stiffness")
            section = evaluate_weights(terms, values) @ np.array(list(terms.values()))
            dofs = element_dofs(body.elements)
            self._elements += [(*part, section) for part in zip(dofs, body.mesh.lengths, body.directions)]
        self._constraints = ConstraintSet(Unknowns(mechanism))
        self.linear_joints = self._constraints.linear

    def energy(self, u: np.ndarray) -> float:
        """Return the strain energy, J, for u of shape (n_dofs,)."""
        total, q = 0.0, self._rest.ravel() + u
        for dofs, length, alpha, section in self._elements:
            x1, y1, phi1, x2, y2, phi2 = q[dofs]
            psi = 0.5 * (phi1 + phi2) + alpha
            eps = (np.cos(psi) * (x2 - x1) + np.sin(psi) * (y2 - y1)) / length - 1.0
            gamma = (np.cos(psi) * (y2 - y1) - np.sin(psi) * (x2 - x1)) / length
            total += 0.5 * length * section @ np.array([eps, gamma, (phi2 - phi1) / length]) ** 2
        return total

    def forces(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return gradient (n_dofs,) and Hessian (n_dofs, n_dofs) of the strain energy."""
        q = self._rest.ravel() + u
        total, stiffness = np.zeros(u.size), np.zeros((u.size, u.size))
        for dofs, length, alpha, section in self._elements:
            force, tangent = beam2d(q[dofs], length, alpha, section)
            total[dofs] += force
            stiffness[np.ix_(dofs, dofs)] += tangent
        return total, stiffness

    def constraints(self, u: np.ndarray) -> np.ndarray:
        """Return c, shape (n_constraints,), m."""
        return self._constraints.residual(self._nodal(u))

    def jacobian(self, u: np.ndarray) -> np.ndarray:
        """Return C in body frames, shape (n_constraints, n_dofs)."""
        rows, columns = self._constraints.jacobian_pattern
        jacobian = np.zeros((self._constraints.n_constraints, u.size))
        np.add.at(jacobian, (rows, columns), self._constraints.jacobian_values(self._nodal(u)))
        return self._from_inertial(jacobian.T).T

    def solve(self, load: np.ndarray) -> np.ndarray:
        """Return u of shape (n_dofs,) for a load in body frames."""
        n, n_c = load.size, self._constraints.n_constraints
        held = self.mass @ self.rigid
        u, multipliers = np.zeros(n), np.zeros(n_c + held.shape[1])
        system = np.zeros((n + multipliers.size,) * 2)
        for _ in range(40):
            force, stiffness = self.forces(u)
            borders = np.vstack([self.jacobian(u), held.T])
            residual = np.concatenate([force + borders.T @ multipliers - load, self.constraints(u), held.T @ u])
            system[:n, :n] = stiffness + self._curvature(u, multipliers[:n_c])
            system[:n, n:], system[n:, :n] = borders.T, borders
            # rows and columns scaled, so that forces and displacements are of one size; redundant rows have no pivot
            scale = np.concatenate([1.0 / np.sqrt(np.diagonal(self.stiffness)), np.ones(multipliers.size)])
            scale[n:] = 1.0 / np.linalg.norm(borders * scale[:n], axis=1)
            step = -scale * np.linalg.lstsq(scale[:, None] * system * scale, scale * residual, rcond=1e-14)[0]
            u, multipliers = u + step[:n], multipliers + step[n:]
            if np.max(np.abs(step[:n])) < 1e-15 + 1e-13 * np.max(np.abs(u)):
                return u
        raise RuntimeError(f"no equilibrium: last step {np.max(np.abs(step[:n])):.2g}")

    def _nodal(self, u: np.ndarray) -> np.ndarray:
        return self._rho + to_inertial(self._mechanism, self.pose, u)

    def _from_inertial(self, columns: np.ndarray) -> np.ndarray:
        """Return ``R^T`` times columns (n_dofs, k)."""
        turn = to_inertial(self._mechanism, self.pose, np.eye(len(columns)))
        return turn.T @ columns

    def _curvature(self, u: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return ``sum lambda d2c/du2``, shape (n_dofs, n_dofs), by central differences."""
        if self.linear_joints:
            return np.zeros((u.size, u.size))
        steps = 1e-6 * np.eye(u.size)
        return np.array([(self.jacobian(u + s) - self.jacobian(u - s)).T @ multipliers for s in steps]) / 2e-6
