"""Modes and reduced matrices along one arc of configurations, and the overlaps of neighbouring modes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.effects import Load
from pgmp_petsc.mechanism.body_frames import to_body
from pgmp_petsc.modes.continuity import canonical_rotation
from pgmp_petsc.modes.problem import ModalProblem, ModeSet

TABLES = ("eigenvalues", "mass", "inertia", "stiffness", "load", "canonical", "overlaps")

# a test's way to spoil signs and order after the solver
Scramble = Callable[[ModeSet], ModeSet]


@dataclass(frozen=True)
class ArcSamples:
    """What a group of ranks computed on its arc of n samples, in the eigensolver's own bases.

    Attributes
    ----------
    eigenvalues
        Full-order eigenvalues at the nominal parameters, ascending, shape (n, n_modes), (rad/s)^2.
    mass, inertia, stiffness, load
        As in `ReducedTables`, over the arc.
    canonical
        Rotations that fix the signs of each sample by itself, shape (n, n_modes, n_modes).
    overlaps
        ``V_k^T M V_{k-1}`` inside the arc, shape (n - 1, n_modes, n_modes).
    shapes
        Flexible modes V in body frames, local rows, shape (n, n_local, n_modes).
    mass_first
        M times the first flexible modes, local rows, shape (n_local, n_modes): what the arc before is compared with.
    """

    eigenvalues: np.ndarray
    mass: np.ndarray
    inertia: np.ndarray
    stiffness: np.ndarray
    load: np.ndarray
    canonical: np.ndarray
    overlaps: np.ndarray
    shapes: np.ndarray
    mass_first: np.ndarray


class ArcSampler:
    """Computes `ArcSamples`. Collective on the problem's communicator."""

    def __init__(self, problem: ModalProblem, loads: Sequence[Load]) -> None:
        self.problem = problem
        mechanism = problem.mechanism
        self._mass = [problem.matrices.mass[w] for w in mechanism.mass_weights]
        self._stiffness = [problem.matrices.stiffness[w] for w in mechanism.stiffness_weights]
        self._loads = loads

    def run(self, theta: np.ndarray, scramble: Scramble, tick: Callable[[], None]) -> ArcSamples:
        """Sample the configurations theta, shape (n,), in order."""
        problem = self.problem
        samples: dict[str, list] = {name: [] for name in TABLES}
        shapes: list[np.ndarray] = []
        for angle in theta:
            modes = _ascending(scramble(problem.solve(angle)))
            if shapes:
                samples["overlaps"].append(problem.inner(modes.flexible, problem.times_mass(shapes[-1])))
            shapes.append(modes.flexible)
            samples["eigenvalues"].append(modes.eigenvalues)
            samples["canonical"].append(self._canonical(modes))
            basis = np.hstack([modes.rigid, modes.flexible])
            samples["mass"].append(self._project(self._mass, basis))
            samples["inertia"].append(self._project_inertia(modes.rigid_curvature, modes.flexible))
            samples["stiffness"].append(self._project(self._stiffness, modes.flexible))
            samples["load"].append(self._project_loads(angle, basis))
            tick()
        m = shapes[0].shape[1]
        arrays = {name: np.array(values) for name, values in samples.items()}
        arrays["overlaps"] = arrays["overlaps"].reshape(-1, m, m)
        return ArcSamples(shapes=np.array(shapes), mass_first=problem.times_mass(shapes[0]), **arrays)

    def _canonical(self, modes: ModeSet) -> np.ndarray:
        """Return the rotation that fixes the modes' signs whatever the solver made of them."""
        n, n_modes = self.problem.mechanism.n_dofs, modes.flexible.shape[1]
        rows = np.arange(self.problem.rows.start, self.problem.rows.stop)
        # incommensurate waves: no mode shape of any mesh is orthogonal to its own one but by accident
        waves = np.cos(np.outer(1.0 + rows * (np.sqrt(5.0) / n), 1.0 + np.sqrt(2.0) * np.arange(1, n_modes + 1)))
        return canonical_rotation(modes.eigenvalues, self.problem.inner(modes.flexible, waves))

    def _project(self, terms: Sequence, basis: np.ndarray) -> np.ndarray:
        everywhere = _all_rows(self.problem, basis)
        products = [self.problem.inner(basis, term @ everywhere) for term in terms]
        return np.array([0.5 * (product + product.T) for product in products])

    def _project_inertia(self, curvature: np.ndarray, shape: np.ndarray) -> np.ndarray:
        n_theta = curvature.shape[1]
        everywhere = _all_rows(self.problem, shape)
        columns = curvature.reshape(len(curvature), n_theta**2)
        products = [self.problem.inner(columns, term @ everywhere) for term in self._mass]
        return np.array(products).reshape(len(self._mass), n_theta, n_theta, -1)

    def _project_loads(self, angle: float, basis: np.ndarray) -> np.ndarray:
        if not self._loads:
            return np.zeros((0, basis.shape[1]))
        problem = self.problem
        poses = problem.kinematics.poses(np.array([angle]))[..., 0]
        vectors = _all_rows(problem, np.array([load.vector for load in self._loads]).T)
        turned = to_body(problem.mechanism, poses, vectors)[problem.rows.start : problem.rows.stop]
        return problem.inner(turned, basis)


def _ascending(modes: ModeSet) -> ModeSet:
    order = np.argsort(modes.eigenvalues, kind="stable")
    return replace(modes, eigenvalues=modes.eigenvalues[order], flexible=modes.flexible[:, order])


def _all_rows(problem: ModalProblem, columns: np.ndarray) -> np.ndarray:
    """Gather local rows (n_local, k) of all ranks of the group."""
    if problem.comm.size == 1:
        return columns
    return np.concatenate(problem.comm.allgather(columns))
