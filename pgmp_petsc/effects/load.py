"""Loads: constant nodal vectors with an affine weight; their strength over time is the effect's amplitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.affine import Monomial


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
