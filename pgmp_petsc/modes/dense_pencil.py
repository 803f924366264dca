"""The pencil (K, M) of a small mechanism in the null space N of its constraints, with LAPACK on one rank.

For a hundred unknowns a sparse factorisation is all overhead. All eigenvalues are computed, so that none can be missed;
as with shift-invert they are those of the inverse,

    L^-1 M L^-T y = mu y,    K - sigma M = L L^T,    psi = L^-T y,    lambda = sigma + 1/mu,

so that the lowest ones, which are sought, come out to the last digits, however stiff the bodies are along their axes.
Unknowns without mass have mu = 0. N itself is never formed: but for those of the dependent unknowns its rows are those
of the identity.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh, eigh_tridiagonal, lapack

from pgmp_petsc.mechanism.null_space import NullSpace, NullSpaces
from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.solvers.eigenpair_checks import RESIDUAL_TOLERANCE
from pgmp_petsc.solvers.shift_invert import EigenPairs

MOST_UNKNOWNS = 250  # beyond, sparse factorisations are faster (benchmarks/scaling/angles.py)
BLOCK = 64  # columns that LAPACK treats together
SUBSET = 0.2  # of all eigenvectors: for more of them QR iterations for all are faster


class DensePencil:
    """A pencil that one rank has whole; methods and attributes are those of `SparsePencil`.

    Parameters
    ----------
    mass, stiffness
        Shape (n_dofs, n_dofs).
    """

    def __init__(self, mass: sp.csr_matrix, stiffness: sp.csr_matrix) -> None:
        self._mass, self._stiffness = mass.toarray(), stiffness.toarray()
        self.shift = 0.0
        self._null = NullSpaces(sp.csr_matrix((0, len(self._mass)))).of(np.zeros(0))
        self._reduced = (self._stiffness, self._mass)
        self._parts: tuple[_Parts, _Parts] | None = None
        self._factor: np.ndarray | None = None

    def close(self) -> None:
        """Do nothing: there is nothing to destroy."""

    def norms(self) -> tuple[float, float]:
        """Return the Frobenius norms of K and M."""
        return float(np.linalg.norm(self._stiffness)), float(np.linalg.norm(self._mass))

    def set_stiffness(self, stiffness: sp.csr_matrix) -> None:
        """Take another stiffness; it holds from the next `move_to` on."""
        self._stiffness, self._parts = stiffness.toarray(), None

    def shift_to(self, shift: float, prefix: str) -> None:  # noqa: ARG002  (no options reach LAPACK)
        """Solve with another shift."""
        self.shift, self._factor = shift, None

    def move_to(self, null: NullSpace) -> None:
        """Project K and M."""
        # from one angle to the next mostly the same unknowns stay
        known = self._parts is not None and all(
            np.array_equal(getattr(null, which), getattr(self._null, which)) for which in ("independent", "dependent")
        )
        self._null, self._factor = null, None
        if not known:
            stays, goes = null.independent, null.dependent
            self._parts = tuple(_Parts.of(matrix, stays, goes) for matrix in (self._stiffness, self._mass))
        self._reduced = tuple(part.reduced(null.weights) for part in self._parts)

    def solve(self, n_rigid: int, n_flexible: int, where: str) -> EigenPairs:
        """Compute the lowest eigenpairs and check their residuals; vectors are ``N psi``.

        Raises
        ------
        RunError
            If a factorisation fails, or a residual is too large.
        """
        what = f"eigenproblem at {where}"
        self.factor(what)
        mass, n_pairs = self._reduced[1], n_rigid + n_flexible
        n = len(mass)
        inverse = lapack.dsygst(mass, self._factor, itype=1, lower=1)[0]
        mu, vectors = _largest(inverse, n_pairs) if n_pairs < SUBSET * n else eigh(inverse, driver="ev")
        mu, vectors = mu[: -n_pairs - 1 : -1], vectors[:, : -n_pairs - 1 : -1]
        n_finite = int(np.sum(mu > n * np.finfo(float).eps * mu[0]))
        if n_finite < n_pairs:
            raise RunError(
                f"{what}: {n_finite} of {n_pairs} eigenvalues are finite; the other unknowns have no mass: take fewer "
                "modes"
            )
        values = self.shift + 1.0 / mu
        vectors = lapack.dtrtrs(self._factor, vectors, lower=1, trans=1)[0]
        # a step of inverse iteration takes the round-off out of the stiffest directions, where it costs most energy
        vectors = _solved(self._factor, mass @ vectors) / mu
        size = _factor(vectors.T @ mass @ vectors, f"{what}: inertia of the modes")
        vectors = lapack.dtrtrs(size, vectors.T, lower=1)[0].T
        self._check_residuals(values, vectors, n_rigid, what)
        return EigenPairs(values, self._expanded(vectors), np.zeros(0))

    def _check_residuals(self, values: np.ndarray, vectors: np.ndarray, n_rigid: int, what: str) -> None:
        """Check residuals relative to the eigenvalue; those of zero eigenvalues to the first positive one."""
        a, b = self._reduced
        inertia = b @ vectors
        floor = np.max(np.abs(values[: n_rigid + 1]))
        scale = np.linalg.norm(inertia, axis=0) * np.maximum(np.abs(values), floor)
        residuals = np.linalg.norm(a @ vectors - values * inertia, axis=0) / scale
        wrong = np.flatnonzero(~(residuals < RESIDUAL_TOLERANCE))
        if wrong.size:
            raise RunError(
                f"{what}: eigenvalue {values[wrong[0]]:.6g} has the relative residual {residuals[wrong[0]]:.2g}, above "
                f"{RESIDUAL_TOLERANCE:g}; the mesh may be too fine for double precision"
            )

    def factor(self, what: str = "factorisation") -> None:
        """Factor ``K - sigma M`` for `shifted_answers`, without solving for eigenpairs.

        Raises
        ------
        RunError
            If it is not positive definite.
        """
        a, b = self._reduced
        self._factor = _factor(a - self.shift * b, f"{what} with the shift {self.shift:.6g}")

    def count_below(self, tau: float) -> int:
        """Return the number of eigenvalues below tau."""
        values = eigh(*self._reduced, eigvals_only=True, check_finite=False)
        return int(np.sum(values < tau))

    def shifted_answers(self, loads: np.ndarray) -> np.ndarray:
        """Return ``N (N^T (K - sigma M) N)^-1 N^T`` times loads (n_dofs, k), with the factor of the last solve."""
        return self._expanded(_solved(self._factor, self.felt(loads)))

    def felt(self, loads: np.ndarray) -> np.ndarray:
        """Return ``N^T`` times loads (n_dofs, k)."""
        return loads[self._null.independent] + self._null.weights.T @ loads[self._null.dependent]

    def _expanded(self, independent: np.ndarray) -> np.ndarray:
        """Return N times columns (n_independent, k), shape (n_dofs, k)."""
        vectors = np.empty((self._null.n_dofs, independent.shape[1]))
        vectors[self._null.independent] = independent
        vectors[self._null.dependent] = self._null.weights @ independent
        return vectors

    def times_mass(self, vectors: np.ndarray) -> np.ndarray:
        """Return M times columns (n_dofs, k)."""
        return self._mass @ vectors

    def times_stiffness(self, vectors: np.ndarray) -> np.ndarray:
        """Return K times columns (n_dofs, k)."""
        return self._stiffness @ vectors


class _Parts(NamedTuple):
    """Blocks of a symmetric matrix: of unknowns that stay, of those that go with them, and of those that go."""

    staying: np.ndarray
    mixed: np.ndarray
    going: np.ndarray

    @classmethod
    def of(cls, matrix: np.ndarray, stays: np.ndarray, goes: np.ndarray) -> _Parts:
        """Take the blocks of unknowns, given by their numbers."""
        return cls(matrix[np.ix_(stays, stays)], matrix[np.ix_(goes, stays)], matrix[np.ix_(goes, goes)])

    def reduced(self, weights: np.ndarray) -> np.ndarray:
        """Return ``N^T A N`` where the unknowns that go are `weights` times those that stay, in LAPACK's order."""
        half = weights.T @ (self.mixed + 0.5 * (self.going @ weights))
        found = self.staying + half
        found += half.T
        return found.T  # symmetric


def _largest(matrix: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the k largest eigenvalues, ascending, and their vectors, of the lower triangle of a symmetric matrix.

    By relatively robust representations of the tridiagonal matrix; LAPACK's own driver has these for all eigenvectors
    alone, and bisection for some, which takes half as long again.
    """
    n = len(matrix)
    reflectors, diagonal, beside, scales, _ = lapack.dsytrd(matrix, lower=1, lwork=BLOCK * n)
    chosen = {"select": "i", "select_range": (n - k, n - 1), "lapack_driver": "stemr"}
    values, vectors = eigh_tridiagonal(diagonal, beside, check_finite=False, **chosen)
    turned = lapack.dormqr("L", "N", reflectors[1:, :-1], scales, vectors[1:], BLOCK * n)[0]
    return values, np.concatenate([vectors[:1], turned])


def _solved(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return ``(L L^T)^-1`` times columns, for a lower factor L."""
    return lapack.dpotrs(factor, right, lower=1)[0]


def _factor(matrix: np.ndarray, what: str) -> np.ndarray:
    """Return the lower Cholesky factor.

    Raises
    ------
    RunError
        If the matrix is not positive definite, or not finite.
    """
    factor, failed = lapack.dpotrf(matrix, lower=1)
    if failed or not np.isfinite(factor).all():
        raise RunError(f"{what}: the matrix is not positive definite; the mesh may be too fine for double precision")
    return factor
