"""The loads whose static answers extend the basis, at any configuration and parameter values, in body frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.modes.problem import ModalProblem
from pgmp_petsc.scene.numerics import Reduction


@dataclass(frozen=True, eq=False)
class StaticLoads:
    """Load patterns of the effects, and the inertia forces of the rigid motion.

    Attributes
    ----------
    patterns
        Independent load patterns of the effects, local rows, shape (n_local, n_patterns).
    inertia
        Whether ``M d2 rho/d theta2`` is one more, the forces that bend the bodies of a mechanism that moves at constant
        speed. (Those of its acceleration, ``M d rho/d theta``, balance the applied loads and are in their answers.)
    """

    patterns: np.ndarray
    inertia: bool

    @classmethod
    def of(cls, problem: ModalProblem, patterns: np.ndarray, reduction: Reduction) -> StaticLoads:
        """Return the loads that a scene asks for, those that depend on others left out.

        Parameters
        ----------
        patterns
            Load patterns of the effects, local rows, shape (n_local, n); used where static modes are wanted.

        Raises
        ------
        InputError
            If the mesh has too few degrees of freedom for the whole basis.
        """
        wanted = patterns if reduction.static_modes else patterns[:, :0]
        loads = cls(problem.independent(wanted), reduction.inertia_modes)
        n_coordinates = problem.kinematics.n_coordinates
        n_inertia = n_coordinates * (n_coordinates + 1) // 2 if reduction.inertia_modes else 0
        problem.check_basis(loads.patterns.shape[1] + n_inertia, reduction.parameter_modes)
        return loads

    def at(self, problem: ModalProblem, rigid_curvature: np.ndarray) -> np.ndarray:
        """Return the loads at a configuration and the parameter values of a problem, shape (n_local, n_loads).

        Parameters
        ----------
        rigid_curvature
            ``d2 rho/d theta2`` at the configuration, shape (n_local, n_theta, n_theta).
        """
        if not self.inertia:
            return self.patterns
        once = np.tril_indices(rigid_curvature.shape[1])
        return np.hstack([self.patterns, problem.times_mass(rigid_curvature[:, once[0], once[1]])])
