"""Shift-invert Krylov-Schur for ``A x = lambda B x`` with A singular (rigid motion), B positive definite.

The shift is slightly negative, so that ``A - sigma B`` is positive definite and its Cholesky factor exists although A
is singular. SLEPc does not raise when it has not converged and cannot know of an eigenvalue that it missed; so every
solve is followed by its residuals and by Sylvester's law of inertia: the number of negative pivots of ``A - tau B`` is
the number of eigenvalues below tau.

The options prefix is the caller's, for every problem its own (e.g. ``-pgmp_modes_eps_ncv 60``); the factorisation that
counts has ``count_`` after it.

What every eigensolver's pairs have to pass: residuals, and that none is missing below the highest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.runtime.errors import PgmpError, RunError
from pgmp_petsc.runtime.petsc import petsc_solver
from pgmp_petsc.solvers.shifted_factor import ShiftedFactor, apply_inverse, check_factor, use_cholesky

if TYPE_CHECKING:
    from petsc4py import PETSc

RESIDUAL_TOLERANCE = 1e-6  # of |lambda| |B x|; the eigenvalue's own error is of the order of its square


def check_residuals(
    a: PETSc.Mat, b: PETSc.Mat, values: np.ndarray, vectors: np.ndarray, floor: float, where: str
) -> None:
    """Check residuals relative to the eigenvalue; those of zero eigenvalues to the first positive one.

    Raises `RunError` if one is too large.

    Parameters
    ----------
    a, b
        Of ``A x = lambda B x``.
    values, vectors
        Shape (n,), and local rows (n_local, n).
    floor
        The first positive eigenvalue.
    where
        Configuration, for messages.
    """
    x, ax, bx = a.createVecRight(), a.createVecLeft(), a.createVecLeft()
    try:
        for value, column in zip(values, vectors.T):
            x.setArray(column)
            a.mult(x, ax)
            b.mult(x, bx)
            scale = bx.norm() * max(abs(value), floor)
            ax.axpy(-value, bx)
            residual = ax.norm() / scale
            if not residual < RESIDUAL_TOLERANCE:
                raise RunError(
                    f"eigenproblem at {where}: eigenvalue {value:.6g} has the relative residual {residual:.2g}, "
                    f"above {RESIDUAL_TOLERANCE:g}; the mesh may be too fine for double precision"
                )
    finally:
        for work in (x, ax, bx):
            work.destroy()


def check_complete(
    count_below: Callable[[float], int], values: np.ndarray, n_pairs: int, where: str, cure: str = ""
) -> None:
    """Count the eigenvalues below a gap by inertia, and compare with those found.

    Raises `RunError` if eigenvalues are missing.

    Parameters
    ----------
    count_below
        Number of eigenvalues below a value.
    values
        All that were found, ascending.
    n_pairs
        Number of the lowest ones that are wanted.
    where, cure
        Configuration, and what may help, for messages.
    """
    # the widest relative gap at or above the last wanted pair, so that the count is not ambiguous
    candidates = np.arange(n_pairs, values.size)
    if candidates.size:
        sizes = np.abs(values) + np.finfo(float).tiny
        gaps = np.diff(values)[candidates - 1] / np.maximum(sizes[candidates], sizes[candidates - 1])
        found = int(candidates[np.argmax(gaps)])
        tau = 0.5 * (values[found - 1] + values[found])
    else:
        found, tau = n_pairs, values[n_pairs - 1] + 1e-6 * np.abs(values[n_pairs - 1])
    below = count_below(tau)
    if below != found:
        raise RunError(
            f"eigenproblem at {where}: {below} eigenvalues lie below {tau:.6g} (rad/s)^2 but {found} were found{cure}"
        )


SOLVER_TOLERANCE = 1e-13
SPARE_PAIRS = 3  # computed beyond those asked for, to find a gap for the count


@dataclass(frozen=True)
class EigenPairs:
    """Lowest eigenpairs, ascending, rigid ones included."""

    values: np.ndarray  # shape (n_pairs,), (rad/s)^2
    vectors: np.ndarray  # b-orthonormal, local rows: shape (n_local, n_pairs)
    spare: np.ndarray  # the eigenvalues found beyond, ascending


class ShiftInvertSolver:
    """SLEPc solver that is set up once and reused for matrices of one nonzero pattern. Collective on the matrices.

    Parameters
    ----------
    comm
        That of the matrices.
    shift
        sigma, below all eigenvalues.
    prefix
        Of the options that reach this solver.

    Raises
    ------
    InputError
        If PETSc refuses an option with the prefix.
    """

    def __init__(self, comm: PETSc.Comm, shift: float, prefix: str) -> None:
        from petsc4py import PETSc
        from slepc4py import SLEPc

        self.shift, self._prefix = shift, prefix
        self._eps = SLEPc.EPS().create(comm)
        self._eps.setOptionsPrefix(prefix)
        self._eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
        self._eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
        self._eps.setTarget(shift)
        self._eps.setTolerances(SOLVER_TOLERANCE, 200)
        st = self._eps.getST()
        st.setType(SLEPc.ST.Type.SINVERT)
        st.setShift(shift)
        st.setMatStructure(PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        use_cholesky(st.getKSP())
        self._count: ShiftedFactor | None = None
        try:
            self._count = ShiftedFactor(comm, f"{prefix}count_", counts=True)
            with petsc_solver(prefix, "eigensolver"):
                self._eps.setFromOptions()
                self._user_subspace = PETSc.Options(prefix).getInt("eps_ncv", 0)
        except PgmpError:
            self.close()
            raise

    def close(self) -> None:
        """Destroy the PETSc objects."""
        self._eps.destroy()
        if self._count is not None:
            self._count.close()

    def forget_pattern(self) -> None:
        """Drop symbolic factorisations; to be called when the next matrices have another nonzero pattern."""
        self._eps.reset()
        self._count.forget_pattern()

    def solve(self, a: PETSc.Mat, b: PETSc.Mat, n_rigid: int, n_flexible: int, where: str) -> EigenPairs:
        """Compute the lowest eigenpairs and check them.

        Raises `RunError` if a factorisation fails, the solver did not converge, a residual is too large, or eigenvalues
        are missing.

        Parameters
        ----------
        a, b
            Symmetric matrices of one pattern.
        n_rigid, n_flexible
            Number of eigenvalues of A that are or may be zero, and of others to be found.
        where
            Configuration, for messages.
        """
        size, n_pairs = a.getSize()[0], n_rigid + n_flexible
        wanted = min(size, n_pairs + SPARE_PAIRS)
        eps = self._eps
        eps.setOperators(a, b)
        for subspace in self._subspaces(size, wanted):
            # the last is the largest projected problem: one that stayed from a smaller space is refused
            eps.setDimensions(wanted, subspace, subspace)
            start = a.createVecRight()
            start.set(1.0)
            eps.setInitialSpace(start)
            start.destroy()
            with petsc_solver(self._prefix, f"eigenproblem at {where}"):
                eps.solve()
            try:
                return self._checked(a, b, n_rigid, n_pairs, where)
            except RunError as error:
                failure = error
        raise failure

    def _subspaces(self, size: int, wanted: int) -> list[int]:
        """Return the subspace sizes to try: the user's, or growing ones.

        Copies of equal eigenvalues can escape a small Krylov space, which grows from a single vector.
        """
        if self._user_subspace:
            return [min(size, self._user_subspace)]
        usual = max(2 * wanted, wanted + 16)
        return sorted({min(size, factor * usual) for factor in (1, 2, 4)})

    def _checked(self, a: PETSc.Mat, b: PETSc.Mat, n_rigid: int, n_pairs: int, where: str) -> EigenPairs:
        """Fetch the pairs of the last solve and check convergence, residuals and completeness."""
        eps = self._eps
        converged, reason = eps.getConverged(), eps.getConvergedReason()
        # stopped early with all that is wanted, and some spare pairs missing, it has converged for our purpose
        if converged < n_pairs:
            raise RunError(
                f"eigenproblem at {where}: {converged} of {n_pairs} eigenpairs converged in "
                f"{eps.getIterationNumber()} iterations (reason {reason}) with the tolerance "
                f"{eps.getTolerances()[0]:.2g}; a larger -{self._prefix}eps_ncv may help"
            )
        values, vectors = self._fetch(a, converged)
        floor = np.max(np.abs(values[: n_rigid + 1]))
        check_residuals(a, b, values[:n_pairs], vectors[:, :n_pairs], floor, where)
        if values.size < a.getSize()[0]:
            cure = f"; a larger -{self._prefix}eps_ncv may help"
            check_complete(lambda tau: self.count_below(a, b, tau), values, n_pairs, where, cure)
        return EigenPairs(values[:n_pairs], vectors[:, :n_pairs], values[n_pairs:])

    def factor(self, a: PETSc.Mat, b: PETSc.Mat) -> None:
        """Factor ``A - sigma B`` for `apply_inverse`, without solving for eigenpairs.

        Raises `RunError` if the factorisation fails.
        """
        self._eps.setOperators(a, b)
        ksp = self._eps.getST().getKSP()
        with petsc_solver(self._prefix, f"factorisation with the shift {self.shift:.6g}"):
            self._eps.setUp()
            ksp.setUp()
        check_factor(ksp, f"factorisation with the shift {self.shift:.6g}")

    def apply_inverse(self, columns: np.ndarray) -> np.ndarray:
        """Return ``(A - sigma B)^-1`` times local columns (n_local, k), with the last factor.

        Raises `RunError` if a solve fails.
        """
        ksp, what = self._eps.getST().getKSP(), f"linear system with the shift {self.shift:.6g}"
        with petsc_solver(self._prefix, what):
            return apply_inverse(ksp, columns, what)

    def _fetch(self, a: PETSc.Mat, n_pairs: int) -> tuple[np.ndarray, np.ndarray]:
        vector = a.createVecRight()
        values = np.empty(n_pairs)
        vectors = np.empty((vector.getLocalSize(), n_pairs))
        for i in range(n_pairs):
            values[i] = self._eps.getEigenpair(i, vector).real
            vectors[:, i] = vector.getArray(readonly=True)
        vector.destroy()
        order = np.argsort(values, kind="stable")
        return values[order], vectors[:, order]

    def count_below(self, a: PETSc.Mat, b: PETSc.Mat, tau: float) -> int:
        """Return the number of eigenvalues below tau, from the inertia of ``A - tau B``.

        Raises `RunError` if the factorisation fails.
        """
        self._count.factor(a, b, tau, f"count of the eigenvalues below {tau:.6g}")
        return self._count.negative_pivots()
