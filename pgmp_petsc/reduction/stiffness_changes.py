"""How the forces in the bodies change the stiffness of each mode: what geometric stiffness a model has, or would lack.

A static load f changes the stiffness of a mode psi_k, whose eigenvalue is lambda_k, by the share

    s_k = h_k.f / lambda_k,

positive where bodies are pulled, negative where they are pressed; -1 is buckling in the shape of the mode. One static
answer a mode, h_k, tells what every load does (`CurvatureProblem.stiffness_answers`; without the curvature of joints it
is the answer to ``K3[psi_k, psi_k]``). The *influences* ``h_k.f`` are kept for units of all that loads the bodies, in
this order of columns:

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

import numpy as np

from pgmp_petsc.reduction.sample_grid import SampleGrid


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
