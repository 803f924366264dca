"""Loads: constant nodal vectors with an affine weight; their strength over time is the effect's amplitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.affine import Monomial


@dataclass(frozen=True)
class Load:
    """One affine load term."""

    effect: str  # name of the effect it belongs to
    weight: Monomial  # its parameter dependence
    vector: np.ndarray  # nodal forces (N) and couples (N m), for the rows of the matrices it was made with
    #: of a uniform body force the mass term and the field of accelerations, all rows, inertial frame: ``vector`` is
    #: their product where nodes are all there is, and a condensed body takes their product in its own frame. None of
    #: others.
    body_force: tuple[Monomial, np.ndarray] | None = None
    #: whether the vector is constant in the frames of the bodies; otherwise in the inertial frame
    in_bodies: bool = False
