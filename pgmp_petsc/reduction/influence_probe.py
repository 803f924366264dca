"""Influences of unit loads on the stiffness of the modes, at any configuration; see `stiffness_changes`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.effects import Action
from pgmp_petsc.effects.patterns import UnitForces
from pgmp_petsc.modes.curvature import CurvatureProblem
from pgmp_petsc.modes.problem import ModalProblem, ModeSet


class InfluenceProbe:
    """Computes influences at any configuration. Collective on the problem's communicator.

    Parameters
    ----------
    problem
        Eigenproblem at the nominal parameters; the third derivative of its bodies' strain energy is known.
    actions
        Local effects of the scene.
    """

    def __init__(self, problem: ModalProblem, actions: Sequence[Action]) -> None:
        self._problem = problem
        self._curvature = CurvatureProblem(problem)
        self._forces = UnitForces(actions, problem.mechanism)
        self._pairs = np.tril_indices(problem.kinematics.n_coordinates)
        masses = [problem.matrices.mass[weight] for weight in problem.mechanism.mass_weights]
        self._mass = sp.vstack(masses, format="csr")

    def at(self, modes: ModeSet, loads: np.ndarray) -> np.ndarray:
        """Return the influences at the configuration that the problem is at, shape (n_modes, n_columns).

        Parameters
        ----------
        modes
            The modes there.
        loads
            Load terms in body frames, local rows, shape (n_local, n_loads).
        """
        problem = self._problem
        answers = self._curvature.stiffness_answers(modes)
        motion = problem.kinematics.motion(modes.theta)
        turned = self._forces.at(motion.poses)[problem.rows.start : problem.rows.stop]
        k, j = self._pairs
        moving = np.hstack([modes.rigid, modes.rigid_curvature[:, k, j]])
        inertia = (self._mass @ problem.all_rows(moving)).reshape(-1, *moving.shape)
        found = problem.inner(answers, np.hstack([loads, turned, *-inertia]))
        self._add_rotary(modes, found[:, loads.shape[1] + turned.shape[1] :])
        return found

    def _add_rotary(self, modes: ModeSet, influences: np.ndarray) -> None:
        """Add the work of accelerations on the directors' part of second order, which is ``chi_kk`` of the modes' own
        with the other sign; influences of the motions, shape (n_modes, n_terms n_motions)."""
        problem, (k, j) = self._problem, self._pairs
        motion = problem.kinematics.motion(modes.theta)
        fields = np.concatenate([motion.velocities, motion.accelerations[:, :, k, j]], axis=2)
        vectors, each = problem.all_rows(modes.flexible), (np.arange(modes.flexible.shape[1]),) * 2
        for t, weight in enumerate(problem.mechanism.mass_weights):
            columns = slice(t * fields.shape[2], (t + 1) * fields.shape[2])
            influences[:, columns] += self._curvature.rotary.work(fields, vectors, each, weight).T
