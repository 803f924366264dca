"""Structural damping in the reduced model; `effects.structural_damping` has the equations.

In body frames the damping matrices of all bodies are constant, so that

    D(theta) = Psi^T (sum_b beta_b K_b + alpha_b M_b + P_b P_b^T) Psi,     Psi = [d rho/d theta, Psi_flexible]

and rigid motion is braked by alpha alone. What all bodies have of alpha in common brakes the momentum of the reduced
model itself (`reduced_equations`), which has the terms of higher order in the deformation, too; only what exceeds it is
in D.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.matrices import assemble
from pgmp_petsc.dynamics.full_damping import BodyDampings
from pgmp_petsc.effects import Effect
from pgmp_petsc.mechanism.body_frames import rigid_velocities
from pgmp_petsc.mechanism.kinematics import RigidKinematics
from pgmp_petsc.reduction.rom import ReducedOrderModel


@dataclass(frozen=True)
class ReducedDamping:
    """Structural damping of a reduced model.

    Attributes
    ----------
    effect
        Name of the effect, or of several.
    mass
        Factor alpha that all bodies have in common, 1/s.
    weights
        Monomials of the terms of D.
    table
        ``D_i`` at the samples, symmetric, shape (n, n_terms, n_eta, n_eta).
    """

    effect: str
    mass: float
    weights: tuple[Monomial, ...]
    table: np.ndarray

    @classmethod
    def of(
        cls, effects: Sequence[Effect], kinematics: RigidKinematics, rom: ReducedOrderModel
    ) -> ReducedDamping | None:
        """Return the damping of all bodies, None if there is none."""
        mechanism = kinematics.mechanism
        found = BodyDampings.of(effects, mechanism)
        names = dict.fromkeys([*found.effects.values(), *(modal.effect for modal in found.modal)])
        if not names:
            return None
        rayleigh = [found.rayleigh_of(number) for number in range(len(mechanism.bodies))]
        common = min(alpha for _, alpha in rayleigh)
        shapes = _shapes(kinematics, rom)
        r, n_eta = rom.tables.n_coordinates, shapes.shape[2]
        terms: dict[Monomial, np.ndarray] = {}

        def add(weight: Monomial, table: np.ndarray) -> None:
            terms[weight] = terms.get(weight, 0.0) + 0.5 * (table + np.swapaxes(table, 1, 2))

        for body, (beta, alpha) in zip(mechanism.bodies, rayleigh):
            rows, alone = body.dofs, body.alone()
            matrices = assemble([alone], range(rows.size))
            for factor, of_body, first in ((beta, matrices.stiffness, r), (alpha - common, matrices.mass, 0)):
                if factor:
                    for weight, matrix in of_body.items():
                        table = np.zeros((len(shapes), n_eta, n_eta))
                        table[:, first:, first:] = _congruent(factor * matrix.toarray(), shapes[:, rows, first:])
                        add(weight, table)
        for modal in found.modal:
            own = shapes[:, mechanism.bodies[modal.body].dofs, r:]
            rates = np.einsum("im,nij->nmj", modal.factor, own)
            table = np.zeros((len(shapes), n_eta, n_eta))
            table[:, r:, r:] = np.einsum("nmi,nmj->nij", rates, rates)
            add(Monomial(), table)
        table = np.zeros((len(shapes), len(terms), n_eta, n_eta))
        for k, values in enumerate(terms.values()):
            table[:, k] = values
        return cls(", ".join(names), common, tuple(terms), table)


def _shapes(kinematics: RigidKinematics, rom: ReducedOrderModel) -> np.ndarray:
    """Return ``[d rho/d theta, Psi_flexible]`` in body frames at the samples, shape (n, n_dofs, n_eta)."""
    poses = kinematics.poses(rom.tables.samples.theta)
    rates = kinematics.rates(poses)
    velocities = [rigid_velocities(kinematics.mechanism, poses[..., k], rates[..., k]) for k in range(poses.shape[2])]
    return np.concatenate([np.array(velocities), rom.projection], axis=2)


def _congruent(matrix: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    return np.einsum("nki,kl,nlj->nij", shapes, matrix, shapes, optimize=True)
