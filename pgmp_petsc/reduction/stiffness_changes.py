"""How the forces in the bodies change the stiffness of each mode: what geometric stiffness a model has, or would lack.

A static deformation u changes the stiffness of a mode psi_k, whose eigenvalue is lambda_k, by the share

    s_k = psi_k.K3[u] psi_k / lambda_k,

positive where bodies are pulled, negative where they are pressed; -1 is buckling in the shape of the mode. With
``K3[psi_k, psi_k] = g_k`` and the symmetric static answer ``u = A f``, the share of any load f is ``h_k.f / lambda_k``
with ``h_k = A g_k``: one static answer a mode tells what every load does. The *influences* ``h_k.f`` are kept for units
of all that loads the bodies, in this order of columns:

- every load term of the effects, its weight taken out,
- every action (local effect), per unit of its force,
- for every mass term, its weight taken out: the inertia forces of unit accelerations theta_k'', and those of unit
  products theta_k' theta_l', k >= l, each pair once: where k > l a motion has twice as much of it.

They hold at the nominal parameters, at which forces in statically determinate bodies do not depend on the stiffness;
lambda_k is kept term by term and follows the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.third_derivative import ThirdDerivative
from pgmp_petsc.effects import Action
from pgmp_petsc.effects.patterns import UnitForces
from pgmp_petsc.reduction.sample_grid import SampleGrid

if TYPE_CHECKING:
    from pgmp_petsc.modes.problem import ModalProblem, ModeSet


@dataclass(frozen=True, eq=False)
class StiffnessChanges:
    """Influences of all loads on the stiffness of the modes at the samples.

    Attributes
    ----------
    influence
        Shape (n, n_modes, n_columns), modes in ascending order at every sample.
    stiffness
        ``psi_k.K_t psi_k`` of every stiffness term, shape (n, n_stiffness_terms, n_modes).
    """

    influence: np.ndarray
    stiffness: np.ndarray

    def over_two_turns(self, samples: SampleGrid, axes: Sequence[int]) -> StiffnessChanges:
        """Append a second revolution of some coordinates, on which the influences are the same."""
        influence, stiffness = self.influence, self.stiffness
        for axis in axes:
            influence, stiffness = (samples.twice(axis, part, part) for part in (influence, stiffness))
            samples = samples.over_two_turns(axis)
        return StiffnessChanges(influence, stiffness)


class InfluenceProbe:
    """Computes influences at any configuration. Collective on the problem's communicator.

    Parameters
    ----------
    problem
        Eigenproblem at the nominal parameters; its flexible bodies are beams.
    actions
        Local effects of the scene.
    """

    def __init__(self, problem: ModalProblem, actions: Sequence[Action]) -> None:
        self._problem = problem
        self._third = ThirdDerivative(problem.mechanism.bodies, problem.rows)
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
        each = np.arange(modes.flexible.shape[1])
        forces = self._third.weighted(problem.all_rows(modes.flexible), (each, each), problem.values)
        answers = problem.static_answers(modes.rigid[:, modes.free], forces, "influence of loads on the stiffness")
        turned = self._forces.at(problem.kinematics.motion(modes.theta).poses)[problem.rows.start : problem.rows.stop]
        k, j = self._pairs
        moving = np.hstack([modes.rigid, modes.rigid_curvature[:, k, j]])
        inertia = (self._mass @ problem.all_rows(moving)).reshape(-1, *moving.shape)
        return problem.inner(answers, np.hstack([loads, turned, *-inertia]))
