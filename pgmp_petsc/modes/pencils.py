"""The pencil (K, M) of a small mechanism in the null space N of its constraints, with LAPACK on one rank.

For a hundred unknowns a sparse factorisation is all overhead. All eigenvalues are computed, so that none can be missed;
as with shift-invert they are those of the inverse,

    L^-1 M L^-T y = mu y,    K - sigma M = L L^T,    psi = L^-T y,    lambda = sigma + 1/mu,

so that the lowest ones, which are sought, come out to the last digits, however stiff the bodies are along their axes.
Unknowns without mass have mu = 0. Neither N nor the matrices in it are formed: what belongs to unknowns that no
constraint touches is the same at all configurations (`interior`), and of the others N has the rows of the identity but
for those of the dependent unknowns.

The unknowns that no constraint touches, eliminated from a dense pencil once for all configurations.

Constraints move with the configuration, and only the unknowns that they touch (o) change their part in the problem with
them. With the others (i) first, ``A = K - sigma M`` is

    A = [ L  0 ] [ I  0 ] [ L^T  X ]        X = L^-1 A_io,   A_ii = L L^T,   S = A_oo - X^T X,
        [X^T I ] [ 0  S ] [ 0    I ],

where L, X and S are constant. In the unknowns ``xi = L^T u_i + X u_o`` and u_o the mass is constant as well:

    [ C    Y ]      C = L^-1 M_ii L^-T,   Q = L^-1 M_io,   Y = Q - C X,
    [ Y^T  Z ],     Z = M_oo - X^T Q - Q^T X + X^T C X.

This is block Cholesky factorisation (Golub, Van Loan 2013, section 4.2.9), as stable as that of the whole matrix.

Static answers need no shift: with springs against the rigid motions R, through the unknowns o,

    A = K + R_o W R_o^T,    W = (R_o^T R_o)^-1 R^T M R |sigma| (R_o^T R_o)^-1,

is positive definite, once the unknowns that tell these motions belong to o. ``W R_o^T x = 0`` for every balanced load,
as R does no work: what springs add is round-off. W gives rigid motions the eigenvalue ``|sigma|``.

The pencil (K, M) of a mechanism in the null space N of its constraints, sparse, over ranks, with PETSc and SLEPc.

What a pencil offers is the same in both: `DensePencil` takes the small ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh, eigh_tridiagonal, lapack

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.mechanism.constraint_set import NullSpace, NullSpaces
from pgmp_petsc.ranks.petsc import aij_matrix, times, transposed_times
from pgmp_petsc.solvers.shift_invert import EigenPairs, ShiftInvertSolver, refuse_residuals

if TYPE_CHECKING:
    from petsc4py import PETSc


MOST_UNKNOWNS = 250  # beyond, sparse factorisations are faster (benchmarks/scaling/angles.py)
BLOCK = 64  # columns that LAPACK treats together
SUBSET = 0.2  # of all eigenvectors: for more of them QR iterations for all are faster


class DensePencil:
    """A pencil that one rank has whole, matrices of shape (n_dofs, n_dofs); as `SparsePencil` is used.

    `held` are unknowns that no rigid motion leaves at rest, together with those that constraints touch.
    """

    exact = True

    def __init__(self, mass: sp.csr_matrix, stiffness: sp.csr_matrix, held: np.ndarray | tuple[()] = ()) -> None:
        self._mass, self._stiffness = mass.toarray(), stiffness.toarray()
        self.shift = 0.0
        self._held, self._touched = np.array(held, dtype=int), None
        #: at all configurations, and at one, of ``K - sigma M`` and of K with springs against the rigid motions
        self._interiors: list[Interior | None] = [None, None]
        self._masses: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None
        self._factors: list[_Factor | None] = [None, None]
        self.move_to(NullSpaces(sp.csr_matrix((0, len(self._mass)))).of(np.zeros(0)))

    def close(self) -> None:
        """Do nothing: there is nothing to destroy."""

    def norms(self) -> tuple[float, float]:
        return float(np.linalg.norm(self._stiffness)), float(np.linalg.norm(self._mass))

    def set_stiffness(self, stiffness: sp.csr_matrix) -> None:
        self._stiffness = stiffness.toarray()
        self._forget()

    def shift_to(self, shift: float, prefix: str) -> None:  # noqa: ARG002  (no options reach LAPACK)
        self.shift = shift
        self._forget()

    def _forget(self) -> None:
        self._interiors, self._factors, self._masses = [None, None], [None, None], None

    def move_to(self, null: NullSpace) -> None:
        """Take the null space of a configuration."""
        if self._touched is None or not np.array_equal(null.touched, self._touched):
            self._touched, self._outer = null.touched, np.union1d(null.touched, self._held)
            self._forget()
        self._rows, self._factors = NullRows(null.independent, null.dependent, null.weights), [None, None]
        self._ends = NullRows.among(null, self._outer)

    def solve(self, n_rigid: int, n_flexible: int, where: str) -> EigenPairs:
        """Compute the lowest eigenpairs and check their residuals; vectors are ``N psi``.

        Raises `RunError` if a factorisation fails, or a residual is too large.
        """
        what = f"eigenproblem at {where}"
        factor = self._shifted(what)
        inverse, n_pairs = self._inverse(factor), n_rigid + n_flexible
        n = len(inverse)
        # nothing is set above the diagonal
        every = n_pairs >= SUBSET * n
        mu, vectors = eigh(inverse, driver="ev", check_finite=False) if every else _largest(inverse, n_pairs)
        mu, vectors = mu[: -n_pairs - 1 : -1], vectors[:, : -n_pairs - 1 : -1]
        n_finite = int(np.sum(mu > n * np.finfo(float).eps * mu[0]))
        if n_finite < n_pairs:
            raise RunError(
                f"{what}: {n_finite} of {n_pairs} eigenvalues are finite; the other unknowns have no mass: take fewer "
                "modes"
            )
        values = self.shift + 1.0 / mu
        # a step of inverse iteration takes the round-off out of the stiffest directions, where it costs most energy
        vectors = self.shifted_answers(self._mass @ factor.unfactored(vectors)) / mu
        inertia = self._mass @ vectors
        size = cholesky(vectors.T @ inertia, f"{what}: inertia of the modes")
        vectors, inertia = (forward(size, part.T).T for part in (vectors, inertia))
        momenta = self.felt(inertia)
        residuals = _lengths(self.felt(self._stiffness @ vectors) - values * momenta) / _lengths(momenta)
        refuse_residuals(values, residuals, np.max(np.abs(values[: n_rigid + 1])), what)
        return EigenPairs(values, vectors, np.zeros(0))

    def _inverse(self, factor: _Factor) -> np.ndarray:
        """Return the lower triangle of ``L^-1 N^T M N L^-T`` at the configuration, untouched unknowns first."""
        interior, ends = factor.interior, factor.ends
        if self._masses is None:
            self._masses = interior.masses(self._mass)
        inner_mass, mixed_mass, outer_mass = self._masses
        n_inner, n_outer = interior.inner.size, ends.stays.size
        matrix = np.empty((n_inner + n_outer, n_inner + n_outer), order="F")
        matrix[:n_inner, :n_inner] = inner_mass
        matrix[n_inner:, :n_inner] = forward(factor.outer, ends.felt(mixed_mass.T))
        matrix[n_inner:, n_inner:] = congruent(ends.felt(ends.felt(outer_mass).T), factor.outer)
        return matrix

    def _shifted(self, what: str) -> _Factor:
        """Return the factor of ``K - sigma M``. Raises `RunError` if it is not positive definite."""
        if self._factors[0] is None:
            what = f"{what} with the shift {self.shift:.6g}"
            if self._interiors[0] is None:
                self._interiors[0] = Interior.of(self._stiffness - self.shift * self._mass, self._outer, what)
            self._factors[0] = _Factor.of(self._interiors[0], self._ends, what)
        return self._factors[0]

    def _supported(self, motions: np.ndarray) -> _Factor:
        """Return the factor of K with springs against rigid motions (n_dofs, k). Raises as `_shifted`."""
        if self._factors[1] is None:
            what = "factorisation with springs against rigid motions"
            if self._interiors[1] is None:
                self._interiors[1] = Interior.of(self._stiffness, self._outer, what)
            springs = motions[self._outer]
            if springs.shape[1]:
                inertia = cholesky(abs(self.shift) * (motions.T @ self._mass @ motions), what)
                springs = springs @ np.linalg.solve(springs.T @ springs, inertia)
            self._factors[1] = _Factor.of(self._interiors[1], self._ends, what, springs)
        return self._factors[1]

    def count_below(self, tau: float) -> int:
        basis = self._rows.expanded(np.eye(self._rows.stays.size))
        stiffness, mass = (basis.T @ matrix @ basis for matrix in (self._stiffness, self._mass))
        return int(np.sum(eigh(stiffness, mass, eigvals_only=True, check_finite=False) < tau))

    def shifted_answers(self, loads: np.ndarray) -> np.ndarray:
        """Return ``N (N^T (K - sigma M) N)^-1 N^T`` times loads (n_dofs, k)."""
        return self._shifted("linear system").answers(loads)

    def static_steps(self, loads: np.ndarray, motions: np.ndarray) -> np.ndarray:
        """Return, but for rigid motions (n_dofs, n), ``N (N^T K N)^-1 N^T`` times loads (n_dofs, k) that do no work on
        these."""
        return self._supported(motions).answers(loads)

    def felt(self, loads: np.ndarray) -> np.ndarray:
        return self._rows.felt(loads)

    def times_mass(self, vectors: np.ndarray) -> np.ndarray:
        return self._mass @ vectors

    def times_stiffness(self, vectors: np.ndarray) -> np.ndarray:
        return self._stiffness @ vectors


class NullRows(NamedTuple):
    """The rows of N of all unknowns, or of those that constraints touch, at a configuration."""

    #: stays, goes: places of the independent unknowns and of the dependent ones among these, shapes (n_stays,),
    #: (n_goes,)
    stays: np.ndarray
    goes: np.ndarray
    weights: np.ndarray  # of the unknowns that stay in those that go, shape (n_goes, n_stays)

    @classmethod
    def among(cls, null: NullSpace, outer: np.ndarray) -> NullRows:
        """Take the rows of a null space whose constraints touch no unknowns but outer ones."""
        goes = np.searchsorted(outer, null.dependent)
        stay = np.ones(outer.size, dtype=bool)
        stay[goes] = False
        stays = np.flatnonzero(stay)
        return cls(stays, goes, null.weights[:, np.searchsorted(null.independent, outer[stays])])

    def felt(self, loads: np.ndarray) -> np.ndarray:
        """Return ``N^T`` times columns (n, k), shape (n_stays, k)."""
        return loads[self.stays] + self.weights.T @ loads[self.goes]

    def expanded(self, independent: np.ndarray) -> np.ndarray:
        """Return N times columns (n_stays, k), shape (n, k)."""
        found = np.empty((self.stays.size + self.goes.size, independent.shape[1]))
        found[self.stays], found[self.goes] = independent, self.weights @ independent
        return found


@dataclass(frozen=True, eq=False)
class _Factor:
    """A factor in the null space N of a configuration."""

    interior: Interior
    ends: NullRows
    outer: np.ndarray  # lower, of the outer unknowns that stay, shape (n_stays, n_stays)

    @classmethod
    def of(cls, interior: Interior, ends: NullRows, what: str, springs: np.ndarray | None = None) -> _Factor:
        """Finish a factorisation, with springs E that add ``E E^T`` in the outer unknowns, shape (n_o, n_springs).

        Raises `RunError` if the matrix is not positive definite; `what` says of what.
        """
        remainder = interior.remainder if springs is None else interior.remainder + springs @ springs.T
        return cls(interior, ends, cholesky(ends.felt(ends.felt(remainder).T), what))

    def answers(self, loads: np.ndarray) -> np.ndarray:
        """Return ``N (N^T A N)^-1 N^T`` times loads (n_dofs, k)."""
        interior = self.interior
        inner = forward(interior.factor, loads[interior.inner])
        outer = self.ends.felt(loads[interior.outer] - interior.coupling.T @ inner)
        return self.unfactored(np.concatenate([inner, forward(self.outer, outer)]))

    def unfactored(self, vectors: np.ndarray) -> np.ndarray:
        """Return ``N L^-T`` times columns (n_independent, k), untouched unknowns first, shape (n_dofs, k)."""
        interior, n_inner = self.interior, self.interior.inner.size
        found = np.empty((n_inner + interior.outer.size, vectors.shape[1]))
        outer = self.ends.expanded(backward(self.outer, vectors[n_inner:]))
        found[interior.outer] = outer
        found[interior.inner] = backward(interior.factor, vectors[:n_inner] - interior.coupling @ outer)
        return found


def _lengths(columns: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("dk,dk->k", columns, columns))


def _largest(matrix: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the k largest eigenvalues, ascending, and their vectors, of the lower triangle of a symmetric matrix,
    which is overwritten.

    By relatively robust representations of the tridiagonal matrix; LAPACK's own driver has these for all eigenvectors
    alone, and bisection for some, which takes half as long again.
    """
    n = len(matrix)
    reflectors, diagonal, beside, scales, _ = lapack.dsytrd(matrix, lower=1, lwork=BLOCK * n, overwrite_a=1)
    chosen = {"select": "i", "select_range": (n - k, n - 1), "lapack_driver": "stemr"}
    values, vectors = eigh_tridiagonal(diagonal, beside, check_finite=False, **chosen)
    turned = lapack.dormqr("L", "N", reflectors[1:, :-1], scales, vectors[1:], BLOCK * n)[0]
    return values, np.concatenate([vectors[:1], turned])


@dataclass(frozen=True, eq=False)
class Interior:
    """The part that is constant over the configurations."""

    #: inner, outer: numbers of the unknowns that no constraint touches and of the others, shapes (n_i,) and (n_o,)
    inner: np.ndarray
    outer: np.ndarray
    factor: np.ndarray  # l, lower, shape (n_i, n_i)
    coupling: np.ndarray  # x, shape (n_i, n_o)
    remainder: np.ndarray  # s, shape (n_o, n_o)

    @classmethod
    def of(cls, matrix: np.ndarray, outer: np.ndarray, what: str) -> Interior:
        """Eliminate all unknowns but the outer ones from A, shape (n_dofs, n_dofs).

        Raises `RunError` if A is not positive definite in them; `what` says of what.
        """
        inner = np.setdiff1d(np.arange(len(matrix)), outer)
        factor = cholesky(matrix[np.ix_(inner, inner)], what)
        x = forward(factor, matrix[np.ix_(inner, outer)])
        return cls(inner, outer, factor, x, matrix[np.ix_(outer, outer)] - x.T @ x)

    def masses(self, mass: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return C, of which the upper triangle is not set, Y and Z of M, shapes (n_i, n_i), (n_i, n_o), (n_o, n_o)."""
        x, q = self.coupling, forward(self.factor, mass[np.ix_(self.inner, self.outer)])
        c = congruent(mass[np.ix_(self.inner, self.inner)], self.factor)
        cx, xq = np.tril(c) @ x + np.tril(c, -1).T @ x, x.T @ q
        return c, q - cx, mass[np.ix_(self.outer, self.outer)] - xq - xq.T + x.T @ cx


def cholesky(matrix: np.ndarray, what: str) -> np.ndarray:
    """Return the lower Cholesky factor. Raises `RunError` if the matrix is not positive definite, or not finite."""
    if not len(matrix):
        return matrix
    factor, failed = lapack.dpotrf(matrix, lower=1)
    if failed or not np.isfinite(factor).all():
        raise RunError(f"{what}: the matrix is not positive definite; the mesh may be too fine for double precision")
    return factor


def forward(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return ``L^-1`` times columns (n, k), for a lower factor L."""
    return lapack.dtrtrs(factor, right, lower=1)[0] if right.size else right


def backward(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return ``L^-T`` times columns (n, k), for a lower factor L."""
    return lapack.dtrtrs(factor, right, lower=1, trans=1)[0] if right.size else right


def congruent(matrix: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return the lower triangle of ``L^-1 A L^-T`` for that of a symmetric matrix; the other entries mean nothing."""
    return lapack.dsygst(matrix, factor, itype=1, lower=1)[0] if len(matrix) else matrix


class SparsePencil:
    """A pencil that ranks share; each has its rows of the matrices, shape (n_local, n_dofs). Collective on `comm`.

    `shift` is sigma, below all eigenvalues; see `shift_to`. `exact` is whether `static_steps` are, but for round-off.
    """

    exact = False

    def __init__(self, mass: sp.csr_matrix, stiffness: sp.csr_matrix, comm: Comm) -> None:
        self._comm, self._first = comm, comm.scan(mass.shape[0]) - mass.shape[0]
        self._mass, self._stiffness = (aij_matrix(matrix, comm, mass.shape[0]) for matrix in (mass, stiffness))
        self.shift = 0.0
        self._null: PETSc.Mat | None = None
        self._reduced: tuple[PETSc.Mat, PETSc.Mat] | None = None
        self._signature, self._factored = b"", False
        self._solver: ShiftInvertSolver | None = None

    def close(self) -> None:
        """Destroy the PETSc objects."""
        self._drop_reduced()
        if self._solver is not None:
            self._solver.close()
        self._mass.destroy()
        self._stiffness.destroy()

    def norms(self) -> tuple[float, float]:
        """Return the Frobenius norms of K and M."""
        return self._stiffness.norm(), self._mass.norm()

    def set_stiffness(self, stiffness: sp.csr_matrix) -> None:
        """Take another stiffness with the same pattern (this rank's rows); it holds from the next `move_to` on."""
        self._stiffness.setValuesCSR(stiffness.indptr, stiffness.indices, stiffness.data)
        self._stiffness.assemble()

    def shift_to(self, shift: float, prefix: str) -> None:
        """Solve with another shift, and with the PETSc options of a prefix."""
        if self._solver is not None:
            self._solver.close()
        self.shift, self._solver = shift, ShiftInvertSolver(self._mass.getComm(), shift, prefix)

    def move_to(self, null: NullSpace) -> None:
        """Refill N, ``N^T K N`` and ``N^T M N``; symbolic work is repeated only where N's pattern changes."""
        self._factored = False
        rows = slice(self._first, self._first + self._mass.getLocalSize()[0])
        lo, hi = np.searchsorted(null.independent, (rows.start, rows.stop))
        local = null.matrix[rows].tocsr()
        signature = null.matrix.indptr.tobytes() + null.matrix.indices.tobytes()
        if signature != self._signature:
            self._drop_reduced()
            self._signature = signature
        if self._null is None:
            self._null = aij_matrix(local, self._comm, int(hi - lo))
            self._reduced = (self._stiffness.ptap(self._null), self._mass.ptap(self._null))
            for matrix in self._reduced:
                matrix.setOption(matrix.Option.SYMMETRIC, True)
        else:
            self._null.setValuesCSR(local.indptr, local.indices, local.data)
            self._null.assemble()
            self._stiffness.ptap(self._null, result=self._reduced[0])
            self._mass.ptap(self._null, result=self._reduced[1])

    def _drop_reduced(self) -> None:
        if self._null is not None:
            for matrix in (self._null, *self._reduced):
                matrix.destroy()
            self._null = self._reduced = None
        if self._solver is not None:
            self._solver.forget_pattern()

    def solve(self, n_rigid: int, n_flexible: int, where: str) -> EigenPairs:
        """Compute the lowest eigenpairs, as `ShiftInvertSolver.solve`; vectors are ``N psi``, local rows."""
        pairs, self._factored = self._solver.solve(*self._reduced, n_rigid, n_flexible, where), True
        return EigenPairs(pairs.values, times(self._null, pairs.vectors), pairs.spare)

    def count_below(self, tau: float) -> int:
        """Return the number of eigenvalues below tau."""
        return self._solver.count_below(*self._reduced, tau)

    def static_steps(self, loads: np.ndarray, motions: np.ndarray) -> np.ndarray:  # noqa: ARG002  (the shift's factor)
        """Return ``N (N^T (K - sigma M) N)^-1 N^T`` times loads (n_local, k) that do no work on rigid motions."""
        if not self._factored:
            self._solver.factor(*self._reduced)
            self._factored = True
        return times(self._null, self._solver.apply_inverse(self.felt(loads)))

    def felt(self, loads: np.ndarray) -> np.ndarray:
        """Return ``N^T`` times loads (n_local, k)."""
        return transposed_times(self._null, loads)

    def times_mass(self, vectors: np.ndarray) -> np.ndarray:
        """Return M times local columns (n_local, k)."""
        return times(self._mass, vectors)

    def times_stiffness(self, vectors: np.ndarray) -> np.ndarray:
        """Return K times local columns (n_local, k)."""
        return times(self._stiffness, vectors)
