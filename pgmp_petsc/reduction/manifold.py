"""The curvature of a finished basis at its samples, and the tables of second order that follow from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pgmp_petsc.effects import Load
from pgmp_petsc.modes.curvature import CurvatureProblem
from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.reduction.sampler import Sample, TurnedLoads
from pgmp_petsc.reduction.second_order import SecondOrderTables, symmetric, unpacked
from pgmp_petsc.reduction.static_loads import StaticLoads


class Manifold:
    """Curvature at any sampled configuration. Collective on the problem's communicator.

    Parameters
    ----------
    problem
        Eigenproblem at the nominal parameters.
    loads
        Load terms of the scene, local rows, inertial frame.
    static_loads
        Loads whose static answers the basis holds.
    static_stretching
        As for `CurvatureProblem`.
    """

    def __init__(
        self,
        problem: ModalProblem,
        loads: Sequence[Load],
        static_loads: StaticLoads,
        static_stretching: bool = False,
    ) -> None:
        self._problem, self._loads, self._static_loads = problem, TurnedLoads(problem, loads), static_loads
        self._curvature = CurvatureProblem(problem, static_stretching)

    def at(self, theta: np.ndarray, sample: Sample, combination: np.ndarray) -> tuple[np.ndarray, SecondOrderTables]:
        """Return chi in body frames, pairs packed, local rows, shape (n_local, n_pairs), and the tables of one sample.

        Parameters
        ----------
        theta
            The configuration, shape (n_theta,), rad.
        sample
            What was found there.
        combination
            The basis in terms of the sample's vectors, shape (n_vectors, n_delta).

        Raises
        ------
        RunError
            If the refinement of an answer does not converge.
        """
        problem = self._problem
        modes = problem.resume(theta, sample.eigenvalues, sample.shape[:, : sample.n_modes])
        static = sample.kept[:, sample.n_modes :]
        answered = self._curvature.answered_loads(modes, static, self._static_loads.at(problem, modes))
        shape = sample.shape @ combination
        curvature = self._curvature.solve(modes, shape, answered @ combination[: sample.n_kept])
        everywhere = problem.all_rows(curvature.chi)
        mass = [problem.matrices.mass[weight] for weight in problem.mechanism.mass_weights]
        # (k, pair of i, j): a third of K3, which comes three times, and psi_k.K_t chi_ij
        thirds = [
            problem.inner(shape, curvature.third[weight] / 3.0 + problem.matrices.stiffness[weight] @ everywhere)
            for weight in problem.mechanism.stiffness_weights
        ]
        k, j = np.tril_indices(modes.rigid.shape[1])
        accelerations = modes.rigid_curvature[:, k, j]
        inertia = np.array([problem.inner(accelerations, term @ everywhere) for term in mass])
        fields = problem.kinematics.motion(theta).accelerations[:, :, k, j]
        vectors, pairs = problem.all_rows(shape), np.tril_indices(shape.shape[1])
        for term, weight in zip(inertia, problem.mechanism.mass_weights):
            term += self._curvature.rotary.work(fields, vectors, pairs, weight)
        return curvature.chi, SecondOrderTables(
            cubic=symmetric(3.0 * unpacked(np.array(thirds)))[None],
            curved_load=unpacked(problem.inner(self._loads.at(theta), curvature.chi))[None],
            curved_inertia=unpacked(inertia)[None],
        )
