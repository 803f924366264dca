"""Stiffness and mass of mechanisms as matrices, by themselves and on a null space of their constraints, and modes."""

from collections.abc import Mapping

import numpy as np
import scipy.linalg
from mpi4py import MPI
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import eigsh

from pgmp_petsc.bodies.matrices import AffineMatrices, weighted_sum
from pgmp_petsc.mechanism.constraint_set import ConstraintSet
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.mechanism.mechanism import Mechanism, constraint_jacobian
from pgmp_petsc.modes.problem import ModalProblem


def modal_problem(
    kinematics: RigidKinematics, values: Mapping[str, float], n_modes: int, *matrices: AffineMatrices
) -> ModalProblem:
    """Return the eigenproblem on this process; to be closed."""
    return ModalProblem(kinematics, values, n_modes, MPI.COMM_SELF, *matrices)


def matrices_of(mechanism: Mechanism, values: Mapping[str, float]) -> tuple[csr_matrix, csr_matrix]:
    """Return stiffness and mass at parameter values."""
    found = AffineMatrices(mechanism.bodies, range(mechanism.n_dofs))
    return tuple(weighted_sum(terms, values) for terms in (found.stiffness, found.mass))


def dense_of(mechanism: Mechanism, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    return tuple(matrix.toarray() for matrix in matrices_of(mechanism, values))


def free_hz(stiffness: csr_matrix, mass: csr_matrix, n: int, n_rigid: int = 6) -> np.ndarray:
    """Return the first n elastic frequencies of a free body, Hz, by a factor with a shift: dense solvers err by 1e-16
    of the largest eigenvalue."""
    start = np.random.default_rng(0).standard_normal(stiffness.shape[0])
    stiffness, mass = stiffness.tocsc(), mass.tocsc()
    values = eigsh(stiffness, n + n_rigid, mass, sigma=-1e5, v0=start, return_eigenvectors=False)
    return np.sqrt(np.sort(values)[n_rigid:]) / (2.0 * np.pi)


def constraints_at(kinematics: RigidKinematics, theta: float | np.ndarray) -> np.ndarray:
    """Return the Jacobian of the constraints, dense, at one configuration."""
    poses = kinematics.poses(np.atleast_1d(theta))[..., 0]
    return constraint_jacobian(kinematics.mechanism, poses).toarray()


def dense_jacobian(constraints: ConstraintSet, q: np.ndarray) -> np.ndarray:
    """Return the Jacobian of a set of constraints, dense, at unknowns of shape (n_dofs,)."""
    jacobian = np.zeros((constraints.n_constraints, q.size))
    np.add.at(jacobian, constraints.jacobian_pattern, constraints.jacobian_values(q[:, None])[:, 0])
    return jacobian


def dense_pencil(
    kinematics: RigidKinematics, theta: float | np.ndarray, values: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return stiffness and mass on an orthonormal null space of the constraints."""
    null = scipy.linalg.null_space(constraints_at(kinematics, theta))
    return tuple(null.T @ matrix @ null for matrix in dense_of(kinematics.mechanism, values))
