"""Copulas: how uniform numbers of independent parameters become those of parameters that depend on each other.

Each is a Rosenblatt transform (Annals of Mathematical Statistics 23 (1952) 470-472), one parameter after the other by
what is known of those before it: as many uniform numbers go in as come out, so that points of Latin hypercubes, of
Sobol sequences and of rare events' normal variables serve as random ones do.

======== ==============================================================================================================
gaussian uniform numbers become normal ones, z, these ``L z`` with ``L L^T`` the correlation matrix, and uniform again
student  z is of a spherical t distribution of f degrees of freedom: ``z_j = sqrt((f + z_1^2 + .. + z_(j-1)^2) / (f + j
         - 1)) t``, t of f + j - 1 degrees
clayton  ``psi(s) = (1 + s)^(-1 / theta)``: low values come together
gumbel   ``psi(s) = exp(-s^(1 / theta))``: high values come together
frank    ``psi(s) = -log(1 - (1 - e^-theta) e^-s) / theta``: none do in the end
======== ==============================================================================================================

The last three are Archimedean, ``C(u) = psi(psi^-1(u_1) + .. + psi^-1(u_d))``: of u_j with ``t = psi^-1(u_1) + .. +
psi^-1(u_(j-1))`` known the share below is ``psi^(m)(t + psi^-1(u_j)) / psi^(m)(t)``, m = j - 1, of the m-th derivative
(Hofert, Maechler and McNeil, Journal of Multivariate Analysis 110 (2012) 133-150, give them as polynomials), which
bisection inverts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.parameters import ARCHIMEDEAN, correlation_matrix, kendall

HALVINGS = 60  # of an interval of 1, to round-off
POINTS = 100  # of Gauss's quadrature of Debye's function


@dataclass(frozen=True, eq=False)
class Mixing:
    """The copula of correlated parameters."""

    factor: np.ndarray  # l of the correlation matrix ``L L^T``, shape (d, d)
    joined: np.ndarray  # numbers of the parameters that a coefficient names, in order
    copula: str  # its name
    #: degrees of freedom of Student's copula, theta of an Archimedean one; NaN of the Gaussian one, which has none
    number: float

    def applied(self, uniform: np.ndarray) -> np.ndarray:
        """Return the uniform numbers (n, d) of correlated parameters; other columns stay as they are."""
        made = {"gaussian": self._gaussian, "student": self._student} | dict.fromkeys(ARCHIMEDEAN, self._archimedean)
        return made[self.copula](uniform)

    def _gaussian(self, uniform: np.ndarray) -> np.ndarray:
        from scipy.special import ndtr, ndtri

        found, normal = uniform.copy(), ndtri(uniform)
        # one product after the other: a sample must not depend on how many there are
        for row in np.flatnonzero(np.count_nonzero(self.factor, axis=1) > 1):
            found[:, row] = ndtr(sum(self.factor[row, k] * normal[:, k] for k in range(row + 1)))
        return found

    def _student(self, uniform: np.ndarray) -> np.ndarray:
        from scipy.special import stdtr, stdtrit

        found, freedom, squares, spherical = uniform.copy(), self.number, np.zeros(len(uniform)), {}
        for number, column in enumerate(self.joined):
            known = np.sqrt((freedom + squares) / (freedom + number))
            spherical[column] = known * stdtrit(freedom + number, uniform[:, column])
            squares = squares + spherical[column] ** 2
            found[:, column] = stdtr(freedom, sum(self.factor[column, k] * own for k, own in spherical.items()))
        return found

    def _archimedean(self, uniform: np.ndarray) -> np.ndarray:
        found = uniform.copy()
        total = _inverse(self.copula, self.number, uniform[:, self.joined[0]])
        for m, column in enumerate(self.joined[1:], start=1):
            wanted = np.log(uniform[:, column]) + _derivative(self.copula, self.number, m, total)
            low, high = np.zeros(len(uniform)), np.ones(len(uniform))
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                further = total + _inverse(self.copula, self.number, middle)
                less = _derivative(self.copula, self.number, m, further) < wanted
                low, high = np.where(less, middle, low), np.where(less, high, middle)
            found[:, column] = 0.5 * (low + high)
            total = total + _inverse(self.copula, self.number, found[:, column])
        return found


def mixing_of(scene: Scene, names: Sequence[str]) -> Mixing | None:
    """Return what correlated parameters are made with; None where all are independent."""
    matrix = correlation_matrix(scene, names)
    if matrix is None:
        return None
    asked = scene.ensemble
    joined, number = np.flatnonzero(np.count_nonzero(matrix, axis=1) > 1), np.nan
    if asked.copula in ARCHIMEDEAN:
        number = theta_of(asked.copula, kendall(float(matrix[joined[0], joined[1]])))
    elif asked.copula == "student":
        number = float(asked.copula_freedom)
    return Mixing(np.linalg.cholesky(matrix), joined, asked.copula, number)


def theta_of(copula: str, tau: float) -> float:
    """Return theta of an Archimedean copula with Kendall's coefficient tau, between 0 and 1.

    ``tau = theta / (theta + 2)`` of Clayton's, ``1 - 1 / theta`` of Gumbel's, ``1 - 4 (1 - D(theta)) / theta`` of
    Frank's with Debye's function ``D(theta) = 1 / theta int_0^theta t / (e^t - 1) dt`` (Genest, Biometrika 74 (1987)
    549-555).
    """
    if copula == "clayton":
        return 2.0 * tau / (1.0 - tau)
    if copula == "gumbel":
        return 1.0 / (1.0 - tau)
    nodes, weights = np.polynomial.legendre.leggauss(POINTS)
    low, high = 1e-6, 1e3
    for _ in range(2 * HALVINGS):
        theta = 0.5 * (low + high)
        t = 0.5 * theta * (nodes + 1.0)
        debye = 0.5 * np.sum(weights * t * np.exp(-t) / -np.expm1(-t))
        low, high = (theta, high) if 1.0 - 4.0 * (1.0 - debye) / theta < tau else (low, theta)
    return 0.5 * (low + high)


def _inverse(copula: str, theta: float, u: np.ndarray) -> np.ndarray:
    """Return ``psi^-1(u)``, (n,)."""
    if copula == "clayton":
        return np.expm1(-theta * np.log(u))
    if copula == "gumbel":
        return (-np.log(u)) ** theta
    return np.log(np.expm1(-theta) / np.expm1(-theta * u))


def _derivative(copula: str, theta: float, m: int, s: np.ndarray) -> np.ndarray:
    """Return the logarithm of the magnitude of the m-th derivative of psi, m from 1, but for a constant, (n,)."""
    if copula == "clayton":
        return -(1.0 / theta + m) * np.log1p(s)
    polynomial = np.polynomial.Polynomial
    if copula == "gumbel":
        # exp(-x) s^-m p_m(x) with x = s^a, whose derivative is the same of m + 1
        a, p = 1.0 / theta, polynomial([1.0])
        for number in range(m):
            p = polynomial([number, a]) * p - polynomial([0.0, a]) * p.deriv()
        x = s**a
        return np.log(p(x)) - x - m * np.log(s)
    # y = z / (1 - z) with z = (1 - e^-theta) e^-s falls with s by y (1 + y)
    p = polynomial([0.0, 1.0])
    for _ in range(m - 1):
        p = polynomial([0.0, 1.0, 1.0]) * p.deriv()
    z = -np.expm1(-theta) * np.exp(-s)
    return np.log(p(z / (1.0 - z)))
