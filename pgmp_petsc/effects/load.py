"""What the full-order and the reduced model know of an effect.

An effect contributes load terms ``g_ext = amplitude(t) sum_j w_j(p) f_j``: nodal vectors f_j that do not depend on the
state, weights that are monomials of the parameters, and one function of time. The full-order model adds the vectors;
the reduced model stores ``Psi(theta)^T f_j`` and never sees the nodes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.matrices import AffineMatrices


@dataclass(frozen=True)
class Load:
    """One affine load term.

    Attributes
    ----------
    effect
        Name of the effect it belongs to.
    weight
        Its parameter dependence.
    vector
        Nodal forces (N) and couples (N m) in the inertial frame, for the rows of the matrices it was made with.
    """

    effect: str
    weight: Monomial
    vector: np.ndarray


class Effect(Protocol):
    """An effect of a scene."""

    name: str

    def loads(self, matrices: AffineMatrices) -> list[Load]:
        """Return the load terms for the rows of `matrices`."""

    def amplitude(self, time: float | np.ndarray) -> float | np.ndarray:
        """Return the common factor of the load terms at a time (s), or at each of several."""

    def patterns(self, matrices: AffineMatrices) -> list[np.ndarray]:
        """Return nodal vectors in body frames, for the rows of `matrices`, that span the loads in any configuration.

        The static answers to them extend the reduced basis. They do not change with the configuration.
        """
