"""Vibration modes of the reduced model where it stands, with each sample's own parameters.

    K phi = omega^2 M~ phi,     M~ = M_dd - M_dt M_tt^-1 M_td,     Phi^T M~ Phi = I,     z_k = 1/2 phi_k.D phi_k

with the blocks of the reduced mass (8) that belong to the free rigid coordinates (t) and to the flexible coordinates
(d), and structural damping D. Free coordinates turn with a vibration by ``-follow.delta``, ``follow = M_tt^-1 M_td``,
and the sums ``theta + follow.delta`` do not vibrate. A prescribed coordinate p follows nothing; its acceleration
acts on the modes with ``-drag.theta_p''``, ``drag = (M_pd - M_pt follow) Phi``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.affine import evaluate_weights
from pgmp_petsc.dynamics.reduced_damping import ReducedDamping
from pgmp_petsc.reduction.interpolation import interpolant
from pgmp_petsc.reduction.tables import ReducedTables

FARTHEST = 1e6  # rad; tables of one revolution have no digits left there
# inertia of a vibration, as a share of the largest: interpolated between sampled angles it may come to nothing and
# less. What vibrates so fast would gain 1 / LEAST of its energy where the inertia comes back, and run away
LEAST = 1e-3
Weights = tuple[np.ndarray, ...]


@dataclass(frozen=True)
class Modes:
    """Modes of n samples.

    Attributes
    ----------
    omega, decay
        Circular frequencies without damping, and z, the rates at which amplitudes die away, shape (n, n_delta), 1/s.
    shapes, inverse
        Phi and ``Phi^-1 = Phi^T M~``, shape (n, n_delta, n_delta).
    follow, drag
        Shape (n, n_theta, n_delta); zero for prescribed and for free coordinates respectively.
    """

    omega: np.ndarray
    decay: np.ndarray
    shapes: np.ndarray
    inverse: np.ndarray
    follow: np.ndarray
    drag: np.ndarray


class FlexibleModes:
    """Modes at any configuration, from the tables of a reduced model.

    Parameters
    ----------
    tables
        Reduced matrices at the sampled configurations.
    scheme
        Interpolation between them.
    damping
        Structural damping, if there is any.
    driven
        Numbers of the prescribed coordinates.
    """

    def __init__(
        self,
        tables: ReducedTables,
        scheme: str,
        damping: ReducedDamping | None = None,
        driven: tuple[int, ...] = (),
    ) -> None:
        self._samples, r = tables.samples, tables.n_coordinates
        self._free, self._driven = [k for k in range(r) if k not in driven], list(driven)
        self._mass = interpolant(tables.samples, tables.mass, scheme)
        self._stiffness = interpolant(tables.samples, tables.stiffness, scheme)
        self._common, self._braking, of_damping = 0.0, None, ()
        if damping is not None:
            self._common, of_damping = damping.mass, damping.weights
            self._braking = interpolant(tables.samples, np.ascontiguousarray(damping.table[:, :, r:, r:]), scheme)
        self._monomials = (tables.mass_weights, tables.stiffness_weights, of_damping)

    def weights(self, values: Mapping[str, np.ndarray], n: int) -> Weights:
        """Return the weights of mass, stiffness and damping terms for parameter values (n,), shapes (n, n_terms)."""
        return tuple(np.broadcast_to(evaluate_weights(w, values).T, (n, len(w))) for w in self._monomials)

    def at(self, theta: np.ndarray, weights: Weights) -> Modes:
        """Return the modes at theta of shape (n, n_theta), rad, for the weights of the same samples.

        Beyond the ends of a limited range the modes are those at the end; of a sample that ran away, those at the
        start.
        """
        theta = theta.copy()
        for axis, part in zip(self._samples, theta.T):
            part[~(np.abs(part) < FARTHEST)] = axis.lower
            if not axis.periodic:
                np.clip(part, axis.lower, axis.upper, out=part)
        r, free = theta.shape[1], self._free
        mass = np.einsum("ntij,nt->nij", self._mass(theta), weights[0])
        stiffness = np.einsum("ntij,nt->nij", self._stiffness(theta), weights[1])
        follow = np.zeros((len(theta), r, mass.shape[1] - r))
        follow[:, free] = np.linalg.solve(mass[:, free][:, :, free], mass[:, free, r:])
        flexible = mass[:, r:, r:] - mass[:, r:, :r] @ follow
        lower = _factors(0.5 * (flexible + np.swapaxes(flexible, 1, 2)))
        outer = np.swapaxes(np.linalg.inv(lower), 1, 2)
        squares, inner = np.linalg.eigh(np.swapaxes(outer, 1, 2) @ stiffness @ outer)
        shapes = outer @ inner
        inverse = np.swapaxes(lower @ inner, 1, 2)
        drag = np.zeros_like(follow)
        for p in self._driven:
            carried = np.einsum("nt,ntd->nd", mass[:, p, :r], follow)
            drag[:, p] = np.einsum("nd,ndk->nk", mass[:, p, r:] - carried, shapes)
        decay = np.full(squares.shape, 0.5 * self._common)
        if self._braking is not None:
            braking = np.einsum("ntij,nt->nij", self._braking(theta), weights[2])
            decay += 0.5 * np.einsum("nik,nij,njk->nk", shapes, braking, shapes)
        return Modes(np.sqrt(np.maximum(squares, 0.0)), decay, shapes, inverse, follow, drag)


def _factors(matrices: np.ndarray) -> np.ndarray:
    """Return Cholesky factors; of a matrix that is hardly definite between the samples, those of one nearby.

    A sample far from the sampled configurations must not end the run of the others, nor change a digit of theirs.
    """
    try:
        factors = np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        return np.array([_factor(matrix) for matrix in matrices])
    pivots = np.diagonal(factors, axis1=1, axis2=2) ** 2
    for number in np.flatnonzero(pivots.min(axis=1) < LEAST * pivots.max(axis=1)):
        factors[number] = _factor(matrices[number])
    return factors


def _factor(matrix: np.ndarray) -> np.ndarray:
    """Return the Cholesky factor of one matrix; see `_factors`."""
    values, vectors = np.linalg.eigh(matrix)
    if values[0] >= LEAST * values[-1]:
        return np.linalg.cholesky(matrix)
    values = np.maximum(values, LEAST * np.abs(values).max())
    positive = (vectors * values) @ vectors.T
    return np.linalg.cholesky(0.5 * (positive + positive.T))
