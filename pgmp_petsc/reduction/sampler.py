"""Modes and reduced matrices at one configuration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pgmp_petsc.effects import Load
from pgmp_petsc.mechanism.body_frames import to_body
from pgmp_petsc.modes.continuity import canonical_rotation
from pgmp_petsc.modes.curvature import CurvatureProblem
from pgmp_petsc.modes.problem import ModalProblem, ModeSet
from pgmp_petsc.reduction.second_order import SecondOrderTables, symmetric, unpacked

# a test's way to spoil signs and order after the solver
Scramble = Callable[[ModeSet], ModeSet]
TABLES = ("eigenvalues", "mass", "inertia", "stiffness", "load", "canonical")


@dataclass(frozen=True, eq=False)
class Sample:
    """What a group of ranks computed at one configuration, in the eigensolver's own basis.

    Flexible vectors are the eigenmodes, ascending, and after them the static modes of the loads.

    Attributes
    ----------
    eigenvalues
        Full-order eigenvalues at the nominal parameters, shape (n_modes,), (rad/s)^2.
    mass, inertia, stiffness, load
        As in `ReducedTables`, at this configuration.
    canonical
        Rotation that fixes the signs of the basis by itself, shape (n_delta, n_delta).
    shape
        Flexible vectors V in body frames, local rows, shape (n_local, n_delta).
    mass_shape
        M V, local rows, shape (n_local, n_delta).
    curvature
        Second derivatives chi in body frames, pairs packed, local rows, shape (n_local, n_pairs); (n_local, 0) where
        the scene does not ask for them.
    second_order
        The tables of second order, one sample; None where the scene does not ask for them.
    """

    eigenvalues: np.ndarray
    mass: np.ndarray
    inertia: np.ndarray
    stiffness: np.ndarray
    load: np.ndarray
    canonical: np.ndarray
    shape: np.ndarray
    mass_shape: np.ndarray
    curvature: np.ndarray
    second_order: SecondOrderTables | None


class Sampler:
    """Computes samples. Collective on the problem's communicator.

    Parameters
    ----------
    problem
        Eigenproblem at the nominal parameters.
    loads
        Load terms of the scene, local rows, inertial frame.
    patterns
        Load patterns in body frames, local rows, shape (n_local, n_patterns), whose static answers extend the basis.
    second_order
        Whether what is of second order in the flexible coordinates is wanted.
    """

    def __init__(
        self, problem: ModalProblem, loads: Sequence[Load], patterns: np.ndarray, second_order: bool = False
    ) -> None:
        self.problem = problem
        mechanism = problem.mechanism
        self._mass = [problem.matrices.mass[w] for w in mechanism.mass_weights]
        self._stiffness = [problem.matrices.stiffness[w] for w in mechanism.stiffness_weights]
        self._loads = loads
        self._patterns = problem.independent(patterns)
        problem.check_basis(self._patterns.shape[1])
        self._curvature = CurvatureProblem(problem) if second_order else None

    def sample(self, theta: float, scramble: Scramble) -> Sample:
        """Sample one configuration (rad).

        Raises
        ------
        RunError
            If the eigensolver fails; see `ModalProblem.solve`.
        """
        problem = self.problem
        modes = _ascending(scramble(problem.solve(theta)))
        loads = self._turned_loads(theta)
        static = problem.static_modes(modes, self._patterns)
        shape = np.hstack([modes.flexible, static])
        basis = np.hstack([modes.rigid, shape])
        chi, second_order = self._second_order(modes, static, loads)
        return Sample(
            eigenvalues=modes.eigenvalues,
            mass=self._project(self._mass, basis),
            inertia=self._project_inertia(modes.rigid_curvature, shape),
            stiffness=self._project(self._stiffness, shape),
            load=problem.inner(loads, basis),
            canonical=self._canonical(modes, shape.shape[1]),
            shape=shape,
            mass_shape=problem.times_mass(shape),
            curvature=chi,
            second_order=second_order,
        )

    def _second_order(
        self, modes: ModeSet, static: np.ndarray, loads: np.ndarray
    ) -> tuple[np.ndarray, SecondOrderTables | None]:
        """Return chi and its tables, where they are wanted."""
        problem = self.problem
        if self._curvature is None:
            return np.empty((len(static), 0)), None
        curvature = self._curvature.solve(modes, static, self._patterns)
        shape, everywhere = np.hstack([modes.flexible, static]), problem.all_rows(curvature.chi)
        # (k, pair of i, j): a third of K3, which comes three times, and psi_k.K_t chi_ij
        thirds = [
            problem.inner(shape, curvature.third[weight] / 3.0 + term @ everywhere)
            for weight, term in zip(problem.mechanism.stiffness_weights, self._stiffness)
        ]
        acceleration = modes.rigid_curvature[:, 0, :1]
        inertia = np.concatenate([problem.inner(acceleration, term @ everywhere) for term in self._mass])
        return curvature.chi, SecondOrderTables(
            cubic=symmetric(3.0 * unpacked(np.array(thirds)))[None],
            curved_load=unpacked(problem.inner(loads, curvature.chi))[None],
            curved_inertia=unpacked(inertia)[None],
        )

    def _canonical(self, modes: ModeSet, n_delta: int) -> np.ndarray:
        """Return the rotation that fixes the modes' signs whatever the solver made of them."""
        n, n_modes = self.problem.mechanism.n_dofs, modes.flexible.shape[1]
        rows = np.arange(self.problem.rows.start, self.problem.rows.stop)
        # incommensurate waves: no mode shape of any mesh is orthogonal to its own one but by accident
        waves = np.cos(np.outer(1.0 + rows * (np.sqrt(5.0) / n), 1.0 + np.sqrt(2.0) * np.arange(1, n_modes + 1)))
        rotation = np.eye(n_delta)
        probe = self.problem.inner(modes.flexible, waves)
        rotation[:n_modes, :n_modes] = canonical_rotation(modes.eigenvalues, probe)
        return rotation

    def _project(self, terms: Sequence, basis: np.ndarray) -> np.ndarray:
        everywhere = self.problem.all_rows(basis)
        products = [self.problem.inner(basis, term @ everywhere) for term in terms]
        return np.array([0.5 * (product + product.T) for product in products])

    def _project_inertia(self, curvature: np.ndarray, shape: np.ndarray) -> np.ndarray:
        n_theta = curvature.shape[1]
        everywhere = self.problem.all_rows(shape)
        columns = curvature.reshape(len(curvature), n_theta**2)
        products = [self.problem.inner(columns, term @ everywhere) for term in self._mass]
        return np.array(products).reshape(len(self._mass), n_theta, n_theta, -1)

    def _turned_loads(self, theta: float) -> np.ndarray:
        """Return the load vectors in body frames, local rows, shape (n_local, n_loads)."""
        problem = self.problem
        if not self._loads:
            return np.zeros((len(problem.rows), 0))
        poses = problem.kinematics.poses(np.array([theta]))[..., 0]
        vectors = problem.all_rows(np.array([load.vector for load in self._loads]).T)
        return to_body(problem.mechanism, poses, vectors)[problem.rows.start : problem.rows.stop]


def _ascending(modes: ModeSet) -> ModeSet:
    order = np.argsort(modes.eigenvalues, kind="stable")
    return replace(modes, eigenvalues=modes.eigenvalues[order], flexible=modes.flexible[:, order])

