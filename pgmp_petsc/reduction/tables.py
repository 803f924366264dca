"""Reduced affine matrices at the sampled configurations (Naets et al. 2015, eqs. (13)-(14)):

    M^r_i(theta) = Psi^T M_i Psi,   K^r_i(theta) = Psi^T K_i Psi,   Q_j(theta) = Psi^T f_j,

with Psi = [d rho/d theta, Psi_flexible] and the coordinates eta = [theta, delta]. Stiffness acts on delta alone: a
rigid motion strains nothing. A further table projects the acceleration of the rigid motion at constant speed,

    c_i(theta) = (d2 rho/d theta2)^T M_i Psi_flexible,

the inertia forces that bend the bodies; eq. (12), in which only M^r appears, has no term for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.reduction.cell_products import SecondOrderTables, congruent
from pgmp_petsc.reduction.mode_changes import ModeChanges
from pgmp_petsc.reduction.sample_grid import SampleGrid


@dataclass(frozen=True)
class ReducedTables:
    """Reduced matrices and loads at the samples.

    Attributes
    ----------
    samples
        Sampled configurations, n of them; the last coordinate runs fastest.
    mass_weights, stiffness_weights, load_weights
        Monomials of the affine terms.
    load_effects
        Name of the effect of every load term.
    mass
        Shape (n, n_mass_terms, n_eta, n_eta).
    inertia
        Shape (n, n_mass_terms, n_theta, n_theta, n_delta).
    stiffness
        Shape (n, n_stiffness_terms, n_delta, n_delta).
    load
        Shape (n, n_load_terms, n_eta).
    second_order
        Tables of second order in the flexible coordinates, None where the scene does not ask for them.
    changes
        Kinetic energy of the modes' change with theta, which comes with them. It is known once the whole basis is
        continuous; what makes other tables of these leaves it out.
    """

    samples: SampleGrid
    mass_weights: tuple[Monomial, ...]
    stiffness_weights: tuple[Monomial, ...]
    load_weights: tuple[Monomial, ...]
    load_effects: tuple[str, ...]
    mass: np.ndarray
    inertia: np.ndarray
    stiffness: np.ndarray
    load: np.ndarray
    second_order: SecondOrderTables | None = None
    changes: ModeChanges | None = None

    @property
    def n_modes(self) -> int:
        """Number of flexible coordinates n_delta."""
        return self.stiffness.shape[-1]

    @property
    def n_coordinates(self) -> int:
        """Number of rigid coordinates n_theta."""
        return self.mass.shape[-1] - self.n_modes

    def at(self, rows: np.ndarray) -> ReducedTables:
        """Return the tables at some of the samples of one coordinate, given by their increasing numbers."""
        return replace(
            self,
            samples=self.samples.tabulated(self.samples.theta[rows]),
            mass=self.mass[rows],
            inertia=self.inertia[rows],
            stiffness=self.stiffness[rows],
            load=self.load[rows],
            second_order=None if self.second_order is None else self.second_order.at(rows),
            changes=None,
        )

    def turned(self, rotations: np.ndarray) -> ReducedTables:
        """Express the flexible coordinates in another basis at every sample.

        Parameters
        ----------
        rotations
            Matrices Q with ``Psi_new = Psi Q``, shape (n, n_delta, n_new): orthogonal, or combinations of fewer
            vectors.
        """
        whole = beside_rigid(rotations, self.n_coordinates)
        return replace(
            self,
            mass=congruent(whole, self.mass),
            inertia=np.einsum("nij,ntkli->ntklj", rotations, self.inertia),
            stiffness=congruent(rotations, self.stiffness),
            load=np.einsum("nij,nti->ntj", whole, self.load),
            second_order=None if self.second_order is None else self.second_order.turned(rotations),
            changes=None,
        )

    def over_two_turns(self, flipped: np.ndarray, axis: int = 0) -> ReducedTables:
        """Append a second revolution along an axis, in which some flexible coordinates have the opposite sign."""
        signs = flipping_signs(self.n_modes, flipped)
        everywhere = np.broadcast_to(np.diag(signs), (self.samples.n, signs.size, signs.size))
        second, curved = replace(self, second_order=None).turned(everywhere), self.second_order
        names = ("mass", "inertia", "stiffness", "load")
        both = {name: self.samples.twice(axis, getattr(self, name), getattr(second, name)) for name in names}
        return replace(
            self,
            samples=self.samples.over_two_turns(axis),
            **both,
            second_order=None if curved is None else curved.over_two_turns(self.samples, axis, signs),
            changes=None,
        )

    def frequencies_hz(
        self, mass_weights: np.ndarray, stiffness_weights: np.ndarray, free: Sequence[int] | None = None
    ) -> np.ndarray:
        """Return the eigenfrequencies of the reduced model at every sample, rigid motion left out.

        Parameters
        ----------
        mass_weights, stiffness_weights
            Values of the weights, shapes (n_mass_terms,) and (n_stiffness_terms,).
        free
            Numbers of the coordinates that are not prescribed, which are held; all by default.

        Returns
        -------
        ndarray, shape (n, n_delta), Hz
        """
        r = self.n_coordinates
        mass = np.einsum("t,ntij->nij", mass_weights, self.mass)
        stiffness = np.einsum("t,ntij->nij", stiffness_weights, self.stiffness)
        # free-free modes: the free rigid coordinates are condensed out of the kinetic energy
        free = np.arange(r) if free is None else np.asarray(free, dtype=int)
        coupled = mass[:, free, r:]
        follow = np.linalg.solve(mass[:, free[:, None], free], coupled)
        flexible = mass[:, r:, r:] - np.einsum("nri,nrj->nij", coupled, follow)
        lower = np.linalg.inv(np.linalg.cholesky(flexible))
        values = np.linalg.eigvalsh(lower @ stiffness @ np.swapaxes(lower, 1, 2))
        return np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi)


def beside_rigid(rotations: np.ndarray, n_rigid: int) -> np.ndarray:
    """Return rotations (n, m, n_new) beside an identity of rigid vectors, shape (n, n_rigid + m, n_rigid + n_new)."""
    n, m, n_new = rotations.shape
    whole = np.zeros((n, n_rigid + m, n_rigid + n_new))
    whole[:, :n_rigid, :n_rigid] = np.eye(n_rigid)
    whole[:, n_rigid:, n_rigid:] = rotations
    return whole


def flipping_signs(n: int, flipped: np.ndarray) -> np.ndarray:
    """Return the signs of n coordinates on the second of two turns: -1 for the flipped ones, given by their numbers."""
    signs = np.ones(n)
    signs[flipped] = -1.0
    return signs
