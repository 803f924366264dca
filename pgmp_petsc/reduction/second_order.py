"""Reduced tables of second order in the flexible coordinates, for the quadratic manifold (Jain et al. 2017)

    u = Psi(theta) delta + 1/2 sum_ij chi_ij(theta) delta_i delta_j,     chi_ij = chi_ji,

in body frames (`modes.curvature`). With K3_t, the third derivative of a term of the strain energy at rest,

    cubic_t[i, j, k] = K3_t[psi_i, psi_j, psi_k] + psi_i.K_t chi_jk + psi_j.K_t chi_ik + psi_k.K_t chi_ij
    curved_load_l[i, j] = f_l.chi_ij
    curved_inertia_t[kl, i, j] = (d2 rho/d theta_k d theta_l).M_t chi_ij,     pairs k >= l of rigid coordinates

are the strain energy of third order, ``1/6 cubic delta delta delta``, and what loads and the acceleration of the rigid
motion do along the manifold's curvature.

Pairs (i, j) of coordinates are packed as ``np.tril_indices`` orders them, each once: ``1/2 chi delta delta`` is the sum
over the packed pairs of ``chi_ij delta_i delta_j``, halved where i = j.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from pgmp_petsc.reduction.sample_grid import SampleGrid
from pgmp_petsc.runtime.compiled import njit


@dataclass(frozen=True, eq=False)
class SecondOrderTables:
    """Tables at n samples, symmetric in the flexible indices.

    Attributes
    ----------
    cubic
        Shape (n, n_stiffness_terms, n_delta, n_delta, n_delta).
    curved_load
        Shape (n, n_load_terms, n_delta, n_delta).
    curved_inertia
        Shape (n, n_mass_terms, n_theta (n_theta + 1) / 2, n_delta, n_delta).
    """

    cubic: np.ndarray
    curved_load: np.ndarray
    curved_inertia: np.ndarray

    def at(self, rows: np.ndarray) -> SecondOrderTables:
        """Return the tables at some of the samples, given by their numbers."""
        return SecondOrderTables(self.cubic[rows], self.curved_load[rows], self.curved_inertia[rows])

    def turned(self, rotations: np.ndarray) -> SecondOrderTables:
        """Express the flexible coordinates in another basis, ``Psi_new = Psi Q``, Q of shape (n, n_delta, n_delta)."""
        cubic = np.einsum("nia,njb,nkc,ntijk->ntabc", rotations, rotations, rotations, self.cubic, optimize=True)
        return SecondOrderTables(
            symmetric(cubic), congruent(rotations, self.curved_load), congruent(rotations, self.curved_inertia)
        )

    def over_two_turns(self, samples: SampleGrid, axis: int, signs: np.ndarray) -> SecondOrderTables:
        """Append a second revolution along an axis with other signs of the flexible coordinates, shape (n_delta,)."""
        second = self.turned(np.broadcast_to(np.diag(signs), (samples.n, signs.size, signs.size)))
        names = ("cubic", "curved_load", "curved_inertia")
        return SecondOrderTables(*(samples.twice(axis, getattr(self, name), getattr(second, name)) for name in names))

    @classmethod
    def joined(cls, parts: Sequence[SecondOrderTables]) -> SecondOrderTables:
        """Return the tables of all parts, one after the other."""
        return cls(
            np.concatenate([part.cubic for part in parts]),
            np.concatenate([part.curved_load for part in parts]),
            np.concatenate([part.curved_inertia for part in parts]),
        )


def congruent(left: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Return ``Q^T A Q`` for Q (n, i, j) and A (n, terms, ..., i, i), exactly symmetric."""
    product = np.einsum("nki,n...kl,nlj->n...ij", left, matrices, left, optimize=True)
    return 0.5 * (product + np.swapaxes(product, -1, -2))


def symmetric(cubic: np.ndarray) -> np.ndarray:
    """Return tables (..., m, m, m) as means over the orders of their indices, equal to the last bit."""
    m, first = cubic.shape[-1], cubic.ndim - 3
    leading = range(first)
    mean = sum(np.transpose(cubic, (*leading, *(first + np.array(order)))) for order in permutations(range(3))) / 6.0
    # sums in different orders round differently: one entry of each sextuple is taken for all
    return mean[..., *np.sort(np.indices((m, m, m)), axis=0)]


def unpacked(pairs: np.ndarray) -> np.ndarray:
    """Return packed pairs (..., n_pairs) as symmetric matrices (..., m, m)."""
    m = int(np.sqrt(2 * pairs.shape[-1]))
    i, j = np.tril_indices(m)
    matrices = np.empty((*pairs.shape[:-1], m, m))
    matrices[..., i, j] = matrices[..., j, i] = pairs
    return matrices


@njit(cache=True, error_model="numpy")
def pair_products(delta):
    """Return the factors of the packed chi in ``1/2 chi delta delta``, shape (n, n_pairs), for delta (n, n_delta)."""
    n, m = delta.shape
    result = np.empty((n, m * (m + 1) // 2))
    for k in range(n):
        pair = 0
        for i in range(m):
            for j in range(i + 1):
                result[k, pair] = (0.5 if i == j else 1.0) * delta[k, i] * delta[k, j]
                pair += 1
    return result


def pair_changes(delta: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return the derivative of `pair_products` along a direction (n, n_delta), shape (n, n_pairs)."""
    i, j = np.tril_indices(delta.shape[1])
    return np.where(i == j, 0.5, 1.0) * (delta[:, i] * rate[:, j] + rate[:, i] * delta[:, j])


def pair_rotations(rotations: np.ndarray) -> np.ndarray:
    """Return what turns packed pairs, ``chi_new = chi P``, for rotations (n, m, m); shape (n, n_pairs, n_pairs)."""
    i, j = np.tril_indices(rotations.shape[1])
    left, right = rotations[:, i], rotations[:, j]  # rows i and j: shape (n, n_pairs, m)
    straight = left[:, :, i] * right[:, :, j]
    crossed = left[:, :, j] * right[:, :, i]
    return np.where((i == j)[:, None], straight, straight + crossed)
