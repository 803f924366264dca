"""Vibration modes of the reduced model where it stands, with each sample's own parameters.

    K phi = omega^2 M~ phi,     M~ = M_dd - M_dt M_td / M_tt,     Phi^T M~ Phi = I

with the blocks of the reduced mass (8) that belong to theta (t) and to the flexible coordinates (d). The rigid
coordinate is free: a vibration turns it by ``-follow.delta`` with ``follow = M_td / M_tt``, and the sum
``theta + follow.delta`` does not vibrate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.tables import ReducedTables

FARTHEST = 1e6  # rad; tables of one revolution have no digits left there


@dataclass(frozen=True)
class Modes:
    """Modes of n samples.

    Attributes
    ----------
    omega
        Circular frequencies, shape (n, n_delta), rad/s.
    shapes, inverse
        Phi and ``Phi^-1 = Phi^T M~``, shape (n, n_delta, n_delta).
    follow
        Shape (n, n_delta).
    """

    omega: np.ndarray
    shapes: np.ndarray
    inverse: np.ndarray
    follow: np.ndarray


class FlexibleModes:
    """Modes at any angle, from the tables of a reduced model with one rigid coordinate.

    Parameters
    ----------
    tables
        Reduced matrices at the sampled angles.
    scheme
        Interpolation between them.
    """

    def __init__(self, tables: ReducedTables, scheme: str) -> None:
        self._tables = tables
        self._mass = interpolant(tables.samples, tables.mass, scheme)
        self._stiffness = interpolant(tables.samples, tables.stiffness, scheme)

    def weights(self, values: Mapping[str, np.ndarray], n: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the weights of mass and stiffness terms for parameter values (n,), shapes (n, n_terms)."""
        monomials = (self._tables.mass_weights, self._tables.stiffness_weights)
        return tuple(np.broadcast_to(evaluate_weights(w, values).T, (n, len(w))) for w in monomials)

    def at(self, theta: np.ndarray, weights: tuple[np.ndarray, np.ndarray]) -> Modes:
        """Return the modes at theta of shape (n,), rad, for the weights of the same samples.

        Beyond the ends of a limited range the modes are those at the end; of a sample that ran away, those at the
        start.
        """
        samples = self._tables.samples.axes[0]
        theta = np.where(np.abs(theta) < FARTHEST, theta, samples.lower)
        if not samples.periodic:
            theta = np.clip(theta, samples.lower, samples.upper)
        mass = np.einsum("ntij,nt->nij", self._mass(theta), weights[0])
        stiffness = np.einsum("ntij,nt->nij", self._stiffness(theta), weights[1])
        follow = mass[:, 0, 1:] / mass[:, :1, 0]
        flexible = mass[:, 1:, 1:] - mass[:, 1:, :1] * follow[:, None, :]
        lower = _factors(flexible)
        outer = np.swapaxes(np.linalg.inv(lower), 1, 2)
        squares, inner = np.linalg.eigh(np.swapaxes(outer, 1, 2) @ stiffness @ outer)
        shapes = outer @ inner
        inverse = np.swapaxes(lower @ inner, 1, 2)
        return Modes(np.sqrt(np.maximum(squares, 0.0)), shapes, inverse, follow)


def _factors(matrices: np.ndarray) -> np.ndarray:
    """Return Cholesky factors; of a matrix that lost its definiteness between the samples, those of one nearby.

    A sample far from the sampled configurations must not end the run of the others.
    """
    try:
        return np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(matrices)
        values = np.maximum(values, 1e-12 * np.abs(values).max(axis=-1, keepdims=True))
        positive = (vectors * values[..., None, :]) @ np.swapaxes(vectors, -1, -2)
        return np.linalg.cholesky(0.5 * (positive + np.swapaxes(positive, -1, -2)))
