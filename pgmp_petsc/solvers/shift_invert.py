"""Shift-invert Krylov-Schur for ``A x = lambda B x`` with A singular (rigid motion), B positive definite.

The shift is slightly negative, so that ``A - sigma B`` is positive definite and its Cholesky factor exists although A
is singular. SLEPc does not raise when it has not converged and cannot know of an eigenvalue that it missed; so every
solve is followed by its residuals and by Sylvester's law of inertia: the number of negative pivots of ``A - tau B`` is
the number of eigenvalues below tau.

The options prefix is the caller's, for every problem its own (e.g. ``-pgmp_modes_eps_ncv 60``); the factorisation that
counts has ``count_`` after it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.runtime.errors import PgmpError, RunError
from pgmp_petsc.runtime.matrices import solve_columns
from pgmp_petsc.runtime.petsc import petsc_solver

if TYPE_CHECKING:
    from petsc4py import PETSc

MUMPS = "mumps"
SOLVER_TOLERANCE = 1e-13
RESIDUAL_TOLERANCE = 1e-6  # of |lambda| |B x|; the eigenvalue's own error is of the order of its square
SPARE_PAIRS = 3  # computed beyond those asked for, to find a gap for the count


@dataclass(frozen=True)
class EigenPairs:
    """Lowest eigenpairs, ascending, rigid ones included.

    Attributes
    ----------
    values
        Shape (n_pairs,), (rad/s)^2.
    vectors
        B-orthonormal, local rows: shape (n_local, n_pairs).
    spare
        The eigenvalues found beyond, ascending.
    """

    values: np.ndarray
    vectors: np.ndarray
    spare: np.ndarray


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
        _use_cholesky(st.getKSP())
        self._count = PETSc.KSP().create(comm)
        self._count.setOptionsPrefix(f"{prefix}count_")
        _use_cholesky(self._count)
        self._shifted: PETSc.Mat | None = None
        try:
            with petsc_solver(prefix, "eigensolver"):
                self._eps.setFromOptions()
                self._user_subspace = PETSc.Options(prefix).getInt("eps_ncv", 0)
                self._count.setFromOptions()
        except PgmpError:
            self.close()
            raise

    def close(self) -> None:
        """Destroy the PETSc objects."""
        self._eps.destroy()
        self._count.destroy()
        if self._shifted is not None:
            self._shifted.destroy()

    def forget_pattern(self) -> None:
        """Drop symbolic factorisations; to be called when the next matrices have another nonzero pattern."""
        self._eps.reset()
        self._count.reset()
        if self._shifted is not None:
            self._shifted.destroy()
            self._shifted = None

    def solve(self, a: PETSc.Mat, b: PETSc.Mat, n_rigid: int, n_flexible: int, where: str) -> EigenPairs:
        """Compute the lowest eigenpairs and check them.

        Parameters
        ----------
        a, b
            Symmetric matrices of one pattern.
        n_rigid, n_flexible
            Number of eigenvalues of A that are or may be zero, and of others to be found.
        where
            Configuration, for messages.

        Raises
        ------
        RunError
            If a factorisation fails, the solver did not converge, a residual is too large, or eigenvalues are missing.
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
        self._check_residuals(a, b, values[:n_pairs], vectors[:, :n_pairs], floor, where)
        self._check_complete(a, b, values, n_pairs, where)
        return EigenPairs(values[:n_pairs], vectors[:, :n_pairs], values[n_pairs:])

    def factor(self, a: PETSc.Mat, b: PETSc.Mat) -> None:
        """Factor ``A - sigma B`` for `apply_inverse`, without solving for eigenpairs.

        Raises
        ------
        RunError
            If the factorisation fails.
        """
        self._eps.setOperators(a, b)
        ksp = self._eps.getST().getKSP()
        with petsc_solver(self._prefix, f"factorisation with the shift {self.shift:.6g}"):
            self._eps.setUp()
            ksp.setUp()
        check_factor(ksp, f"factorisation with the shift {self.shift:.6g}")

    def apply_inverse(self, columns: np.ndarray) -> np.ndarray:
        """Return ``(A - sigma B)^-1`` times local columns (n_local, k), with the last factor.

        Raises
        ------
        RunError
            If a solve fails.
        """
        ksp, what = self._eps.getST().getKSP(), f"linear system with the shift {self.shift:.6g}"
        with petsc_solver(self._prefix, what):
            if ksp.getType() == "preonly" and ksp.getPC().getType() == "cholesky":
                # all columns at once: many times faster than one by one, above all on several ranks
                result = solve_columns(ksp.getPC().getFactorMatrix(), columns)
                check_factor(ksp, what)
            else:
                result = _solve_each(ksp, columns, what)
        if not _finite_everywhere(result, ksp):
            raise RunError(f"{what}: the solution is not finite; the mesh may be too fine for double precision")
        return result

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

    def _check_residuals(
        self, a: PETSc.Mat, b: PETSc.Mat, values: np.ndarray, vectors: np.ndarray, floor: float, where: str
    ) -> None:
        """Check residuals relative to the eigenvalue; those of zero eigenvalues to the first positive one."""
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

    def _check_complete(self, a: PETSc.Mat, b: PETSc.Mat, values: np.ndarray, n_pairs: int, where: str) -> None:
        """Count the eigenvalues below a gap by inertia, and compare with those found."""
        if values.size == a.getSize()[0]:
            return
        # the widest relative gap at or above the last wanted pair, so that the count is not ambiguous
        candidates = np.arange(n_pairs, values.size)
        if candidates.size:
            sizes = np.abs(values) + np.finfo(float).tiny
            gaps = np.diff(values)[candidates - 1] / np.maximum(sizes[candidates], sizes[candidates - 1])
            found = int(candidates[np.argmax(gaps)])
            tau = 0.5 * (values[found - 1] + values[found])
        else:
            found, tau = n_pairs, values[n_pairs - 1] + 1e-6 * np.abs(values[n_pairs - 1])
        below = self.count_below(a, b, tau)
        if below != found:
            raise RunError(
                f"eigenproblem at {where}: {below} eigenvalues lie below {tau:.6g} (rad/s)^2 but {found} were found; "
                f"a larger -{self._prefix}eps_ncv may help"
            )

    def count_below(self, a: PETSc.Mat, b: PETSc.Mat, tau: float) -> int:
        """Return the number of eigenvalues below tau, from the inertia of ``A - tau B``.

        Raises
        ------
        RunError
            If the factorisation fails.
        """
        from petsc4py import PETSc

        fresh = self._shifted is None
        if fresh:
            self._shifted = a.duplicate(copy=True)
        else:
            a.copy(self._shifted, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self._shifted.axpy(-tau, b, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        what = f"count of the eigenvalues below {tau:.6g}"
        with petsc_solver(f"{self._prefix}count_", what):
            self._count.setOperators(self._shifted)
            pc = self._count.getPC()
            if fresh and pc.getFactorSolverType() == MUMPS:
                pc.setFactorSetUpSolverType()
                factor = pc.getFactorMatrix()
                factor.setOptionsPrefix(self._count.getOptionsPrefix())  # else it gets one too late for its options
                factor.setMumpsIcntl(24, 1)  # MUMPS reports its inertia only with null-pivot detection on
            self._count.setUp()
            check_factor(self._count, what)
            negative, _, _ = pc.getFactorMatrix().getInertia()
        return int(negative)


def _use_cholesky(ksp: PETSc.KSP) -> None:
    ksp.setType("preonly")
    pc = ksp.getPC()
    pc.setType("cholesky")
    pc.setFactorSolverType(MUMPS)


def check_factor(ksp: PETSc.KSP, what: str) -> None:
    """Raise where a direct solver's last factorisation, or its last solve, failed. Collective on the solver.

    Raises
    ------
    RunError
        With MUMPS' own error and the size of the system.
    """
    pc = ksp.getPC()
    factor = pc.getFactorMatrix() if pc.getType() in ("cholesky", "lu") else None
    if factor and factor.handle and pc.getFactorSolverType() == MUMPS and factor.getMumpsInfog(1) < 0:
        raise RunError(
            f"{what}: MUMPS failed on {factor.getSize()[0]} unknowns with INFOG(1) = {factor.getMumpsInfog(1)}, "
            f"INFOG(2) = {factor.getMumpsInfog(2)}{_meaning(factor.getMumpsInfog(1))}"
        )
    if ksp.getConvergedReason() < 0:
        raise RunError(f"{what}: the linear solver failed (reason {ksp.getConvergedReason()})")


def _meaning(infog: int) -> str:
    """Say what the usual errors of MUMPS come from."""
    if infog in (-9, -13, -17, -20):
        return ": not enough memory; take more ranks for an angle (--ranks-per-angle) or a coarser mesh"
    if infog == -10:
        return ": the matrix is singular"
    return ""


def _solve_each(ksp: PETSc.KSP, columns: np.ndarray, what: str) -> np.ndarray:
    """Solve for local columns one by one, with any Krylov method and preconditioner."""
    x, y = ksp.getOperators()[0].createVecs()
    result = np.empty_like(columns)
    try:
        for i in range(columns.shape[1]):
            x.setArray(columns[:, i])
            ksp.solve(x, y)
            if ksp.getConvergedReason() <= 0:
                raise RunError(
                    f"{what}: the linear solver ({ksp.getType()}) stopped after {ksp.getIterationNumber()} iterations "
                    f"with the residual {ksp.getResidualNorm():.2g} (reason {ksp.getConvergedReason()})"
                )
            result[:, i] = y.getArray(readonly=True)
    finally:
        x.destroy()
        y.destroy()
    return result


def _finite_everywhere(columns: np.ndarray, ksp: PETSc.KSP) -> bool:
    """Return whether the local columns of all ranks are finite. Collective on the solver."""
    from mpi4py import MPI

    finite = bool(np.isfinite(columns).all())
    return finite if ksp.getComm().size == 1 else ksp.getComm().tompi4py().allreduce(finite, op=MPI.LAND)
