"""Shift-invert Krylov-Schur for ``A x = lambda B x`` with A singular (rigid motion), B positive definite.

The shift is slightly negative, so that ``A - sigma B`` is positive definite and its Cholesky factor exists although A
is singular. SLEPc does not raise when it has not converged and cannot know of an eigenvalue that it missed; so every
solve is followed by its residuals and by Sylvester's law of inertia: the number of negative pivots of ``A - tau B`` is
the number of eigenvalues below tau.

The two checks (`check_residuals`, `check_complete`) are there for the pairs of other eigensolvers, too. The options
prefix is the caller's, for every problem its own (e.g. ``-pgmp_modes_eps_ncv 60``); the factorisation that counts has
``count_`` after it.

``A - sigma B`` is factorised by MUMPS (`ShiftedFactor`), which knows what a factor takes after its analysis. Where that
is more than it may have, it ends there, and the factor is made once more and kept in files ("out of core"): the same to
round-off, and every solve has to read it. These are in a folder (`FactorFiles`), one a rank, where MUMPS' own variable
``MUMPS_OOC_TMPDIR`` says, else where temporary files go (``TMPDIR``); it is gone when the factor is, also after a
failure and after the signals that end a run. A factor that only counts the eigenvalues below sigma is not kept at all;
MUMPS drops what no later pivot needs, and takes a fraction of the memory. Block low-rank factors are no alternative
here: see docs/solids.md.
"""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.base.errors import InputError, PgmpError, RunError, counted
from pgmp_petsc.base.progress import announce
from pgmp_petsc.ranks.agreement import agreed
from pgmp_petsc.ranks.ending import keep_no_longer, remove_at_end
from pgmp_petsc.ranks.petsc import mumps_factor, petsc_solver, solve_columns, use_cholesky

if TYPE_CHECKING:
    from petsc4py import PETSc


OUT_OF_CORE, MOST_MEMORY, NULL_PIVOTS, DISCARD = 22, 23, 24, 31  # numbers of MUMPS' settings ICNTL
TOO_LITTLE = (-8, -9, -13, -19)  # INFOG(1): what there is, or may be had, does not hold the factor
NUMBERS = 3  # INFO: of this rank's factor by the analysis; millions of them if it is negative
NO_FILES = -90
FULL = {errno.ENOSPC, errno.EFBIG, errno.EDQUOT}


class ShiftedFactor:
    """A factor that is made anew for matrices of one nonzero pattern, after one analysis. Collective on the matrices.

    The prefix is that of options that reach its linear solver. Beyond `memory` bytes on this rank the factor is kept in
    files; None is as much as there is. `counts` tells that it only counts eigenvalues. Raises `InputError` if PETSc
    refuses an option with the prefix.
    """

    def __init__(self, comm: PETSc.Comm, prefix: str, memory: float | None = None, counts: bool = False) -> None:
        from petsc4py import PETSc

        self._prefix, self._memory, self._counts = prefix, memory, counts
        self._matrix: PETSc.Mat | None = None
        self._files: FactorFiles | None = None
        self._ksp = PETSc.KSP().create(comm)
        self._ksp.setOptionsPrefix(prefix)
        use_cholesky(self._ksp)
        try:
            with petsc_solver(prefix, "linear solver"):
                self._ksp.setFromOptions()
        except Exception:
            self.close()
            raise

    def close(self) -> None:
        """Destroy the PETSc objects, and remove the files."""
        self._ksp.destroy()
        self.forget_pattern()

    def forget_pattern(self) -> None:
        """Drop the analysis and the factor; to be called when the next matrices have another nonzero pattern."""
        if self._ksp:
            self._ksp.reset()
        if self._matrix is not None:
            self._matrix.destroy()
            self._matrix = None
        if self._files is not None:
            self._files.close()
            self._files = None

    def factor(self, a: PETSc.Mat, b: PETSc.Mat, shift: float, what: str) -> None:
        """Factorise ``A - shift B`` of symmetric matrices of one pattern; messages say what for.

        Raises `InputError` if files are needed and no folder can be made for them; `RunError` if the factorisation
        fails.
        """
        from petsc4py import PETSc

        pattern, fresh = PETSc.Mat.Structure.SAME_NONZERO_PATTERN, self._matrix is None
        if fresh:
            self._matrix = a.duplicate(copy=True)
        else:
            a.copy(self._matrix, structure=pattern)
        self._matrix.axpy(-shift, b, structure=pattern)
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        with petsc_solver(self._prefix, what):
            self._set_up(fresh)
            if self._lacks_memory():
                self._turn_to_files(what)
                self._set_up(True)
        factor = mumps_factor(self._ksp)
        if factor is not None and factor.getMumpsInfog(1) == NO_FILES:
            factor.incRef()  # its end would fail as well, and PETSc with it: it is left to that of the process
        check_factor(self._ksp, what, self._files)

    def apply_inverse(self, columns: np.ndarray, what: str) -> np.ndarray:
        """Return ``(A - sigma B)^-1`` times local columns (n_local, k). Raises `RunError` if a solve fails."""
        with petsc_solver(self._prefix, what):
            return apply_inverse(self._ksp, columns, what)

    def negative_pivots(self) -> int:
        """Return the number of eigenvalues of (A, B) below sigma, B positive definite."""
        return int(self._ksp.getPC().getFactorMatrix().getInertia()[0])

    def _set_up(self, fresh: bool) -> None:
        """Factorise the shifted matrix, after an analysis where its pattern is new."""
        self._ksp.setOperators(self._matrix)
        factor = mumps_factor(self._ksp)
        if fresh and factor is not None:
            self._prepare(factor)
        with nullcontext() if self._files is None else self._files.used():
            self._ksp.setUp()

    def _prepare(self, factor: PETSc.Mat) -> None:
        """Set what MUMPS reads at its analysis; the user's options come after and win."""
        factor.setOptionsPrefix(self._ksp.getOptionsPrefix())  # else it gets one too late for its options
        if self._counts:
            factor.setMumpsIcntl(NULL_PIVOTS, 1)  # MUMPS reports its inertia only with null-pivot detection on
            factor.setMumpsIcntl(DISCARD, 1)
        elif self._files is not None:
            factor.setMumpsIcntl(OUT_OF_CORE, 1)
        elif self._memory is not None:
            factor.setMumpsIcntl(MOST_MEMORY, max(1, int(self._memory / 1e6)))
        if self._files is None and self._given():
            self._open_files()

    def _given(self) -> bool:
        """Return whether a user has said where factors are to be."""
        from petsc4py import PETSc

        return PETSc.Options(self._prefix).hasName(f"mat_mumps_icntl_{OUT_OF_CORE}")

    def _lacks_memory(self) -> bool:
        """Return whether the factor failed for lack of memory and may be kept in files. Files are tried once."""
        factor = mumps_factor(self._ksp)
        if factor is None or self._counts or self._files is not None or self._given():
            return False
        return factor.getMumpsInfog(1) in TOO_LITTLE

    def _turn_to_files(self, what: str) -> None:
        """Drop a factor that failed; the next one goes into files."""
        comm, size = self._ksp.getComm(), self._matrix.getSize()[0]
        factor = mumps_factor(self._ksp)
        needed, numbers = 1e-3 * factor.getMumpsInfog(17), factor.getMumpsInfo(NUMBERS)
        self._ksp.reset()
        self._open_files()
        with agreed(comm.tompi4py(), "space for a factor"):
            self._files.reserve(8 * (numbers if numbers >= 0 else -1_000_000 * numbers), what)
        (self._files.path / "space").unlink()  # for MUMPS to take
        announce(
            f"{what}: the factor of {size} unknowns takes {needed:.2g} GB, more than it may have of the memory of "
            f"{counted(comm.size, 'rank')}; it is kept in files in '{self._files.path}', "
            f"{1e-9 * self._files.free:.3g} GB free",
            comm.tompi4py(),
        )

    def _open_files(self) -> None:
        with agreed(self._ksp.getComm().tompi4py(), "folder of a factor"):
            self._files = FactorFiles()


def check_factor(ksp: PETSc.KSP, what: str, files: FactorFiles | None = None) -> None:
    """Raise where a direct solver's last factorisation, or its last solve, failed. Collective on the solver.

    Raises `RunError`, with MUMPS' own error and the size of the system.
    """
    factor = mumps_factor(ksp)
    if factor is not None and factor.getMumpsInfog(1) < 0:
        raise RunError(
            f"{what}: MUMPS failed on {factor.getSize()[0]} unknowns with INFOG(1) = {factor.getMumpsInfog(1)}, "
            f"INFOG(2) = {factor.getMumpsInfog(2)}{_meaning(factor.getMumpsInfog(1), files)}"
        )
    if ksp.getConvergedReason() < 0:
        raise RunError(f"{what}: the linear solver failed (reason {ksp.getConvergedReason()})")


def apply_inverse(ksp: PETSc.KSP, columns: np.ndarray, what: str) -> np.ndarray:
    """Return what a solver answers to local columns (n_local, k). Collective on the solver.

    Raises `RunError` if a solve fails, or its answer is not finite.
    """
    if ksp.getType() == "preonly" and ksp.getPC().getType() == "cholesky":
        # all columns at once: many times faster than one by one, above all on several ranks and with files
        result = solve_columns(ksp.getPC().getFactorMatrix(), columns)
        check_factor(ksp, what)
    else:
        result = _solve_each(ksp, columns, what)
    from mpi4py import MPI

    finite, comm = bool(np.isfinite(result).all()), ksp.getComm()
    if not (finite if comm.size == 1 else comm.tompi4py().allreduce(finite, op=MPI.LAND)):
        raise RunError(f"{what}: the solution is not finite; the mesh may be too fine for double precision")
    return result


def _meaning(infog: int, files: FactorFiles | None) -> str:
    """Say what the usual errors of MUMPS come from."""
    if infog in (-9, -13, -17, -19, -20):
        return ": not enough memory; take more ranks for an angle (--ranks-per-angle) or a coarser mesh"
    if infog == -10:
        return ": the matrix is singular"
    if infog == NO_FILES and files is not None:
        return f": its files in '{files.path}' cannot be written or read, {files.cure}"
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


VARIABLE = "MUMPS_OOC_TMPDIR"
LONGEST = 200  # characters of a path that MUMPS takes, and its names besides


class FactorFiles:
    """A new folder, or `InputError` if it cannot be made. Of one rank; who makes it closes it."""

    def __init__(self) -> None:
        given = os.environ.get(VARIABLE)
        try:
            self.path = Path(tempfile.mkdtemp(prefix="pgmp_factor_", dir=given))
        except OSError as error:
            where = f"{VARIABLE} = '{given}'" if given else "the folder of temporary files"
            raise InputError(
                f"{where}: no file can be made there ({error.strerror}), and a factor is to go there that does not fit "
                f"into memory; let {VARIABLE} name a folder of a local disk, or give the run more memory or ranks"
            ) from error
        remove_at_end(self.path)
        if len(str(self.path)) > LONGEST:
            self.close()
            raise InputError(
                f"{VARIABLE} or TMPDIR: '{self.path.parent}' is longer than the {LONGEST} characters that MUMPS takes"
            )

    @contextmanager
    def used(self) -> Iterator[None]:
        """Let MUMPS make its files in the folder, within the block."""
        before = os.environ.get(VARIABLE)
        os.environ[VARIABLE] = str(self.path)
        try:
            yield
        finally:
            if before is None:
                del os.environ[VARIABLE]
            else:
                os.environ[VARIABLE] = before

    @property
    def free(self) -> float:
        """Space that is left on the disk, bytes."""
        return float(shutil.disk_usage(self.path).free)

    @property
    def cure(self) -> str:
        """The cure where there is too little."""
        return (
            f"{1e-9 * self.free:.3g} GB are free there; let {VARIABLE} name a folder of a disk with more space, or "
            "give the run more memory or ranks"
        )

    def reserve(self, size: int, what: str) -> None:
        """Take as much space as MUMPS' files will have, bytes, in a file "space": all ranks hold theirs at a time.
        Raises `RunError` where there is too little; MUMPS may wait for ever for what cannot be written."""
        with (self.path / "space").open("wb") as file:
            try:
                os.posix_fallocate(file.fileno(), 0, max(size, 1))
            except OSError as error:
                if error.errno in FULL:  # others say that the disk takes no reservations
                    raise RunError(
                        f"{what}: the {1e-9 * size:.2g} GB of its factor cannot be written in '{self.path}' "
                        f"({error.strerror}), {self.cure}"
                    ) from error

    def close(self) -> None:
        """Remove the folder with all that is in it."""
        shutil.rmtree(self.path, ignore_errors=True)
        keep_no_longer(self.path)


EQUAL_TOLERANCE = 1e-6  # relative gap below which eigenvalues are one and the same to the solver
RESIDUAL_TOLERANCE = 1e-6  # of |lambda| |B x|; the eigenvalue's own error is of the order of its square


def check_residuals(
    a: PETSc.Mat, b: PETSc.Mat, values: np.ndarray, vectors: np.ndarray, floor: float, where: str
) -> None:
    """Check the residuals of ``A x = lambda B x`` for values (n,) and local rows of vectors (n_local, n).

    `floor` and errors are those of `refuse_residuals`; `where` is the configuration, for messages.
    """
    x, ax, bx = a.createVecRight(), a.createVecLeft(), a.createVecLeft()
    residuals = np.empty(len(values))
    try:
        for k, value in enumerate(values):
            x.setArray(vectors[:, k])
            a.mult(x, ax)
            b.mult(x, bx)
            ax.axpy(-value, bx)
            residuals[k] = ax.norm() / bx.norm()
    finally:
        for work in (x, ax, bx):
            work.destroy()
    refuse_residuals(values, residuals, floor, f"eigenproblem at {where}")


def refuse_residuals(values: np.ndarray, residuals: np.ndarray, floor: float, what: str) -> None:
    """Refuse residuals ``|A x - lambda B x| / |B x|`` that are large beside the eigenvalues.

    Those of zero eigenvalues are compared with the first positive one, `floor`. Raises `RunError`, beginning with
    `what`.
    """
    relative = residuals / np.maximum(np.abs(values), floor)
    wrong = np.flatnonzero(~(relative < RESIDUAL_TOLERANCE))
    if wrong.size:
        raise RunError(
            f"{what}: eigenvalue {values[wrong[0]]:.6g} has the relative residual {relative[wrong[0]]:.2g}, above "
            f"{RESIDUAL_TOLERANCE:g}; the mesh may be too fine for double precision"
        )


def check_complete(
    count_below: Callable[[float], int], values: np.ndarray, n_pairs: int, where: str, cure: str = ""
) -> None:
    """Count the eigenvalues below a gap by inertia, `count_below` a value, and compare with all that were found,
    ascending.

    Raises `RunError` if eigenvalues are missing among the lowest `n_pairs`, with where that is and what may help.
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

    The shift is below all eigenvalues; options with the prefix reach this solver. Raises `InputError` if PETSc refuses
    one.
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
        """Compute the lowest eigenpairs of symmetric matrices of one pattern and check them.

        `n_rigid` eigenvalues of A are or may be zero, and `n_flexible` others are found. Raises `RunError` if a
        factorisation fails, the solver did not converge, a residual is too large, or eigenvalues are missing.
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
        ksp, what = self._eps.getST().getKSP(), f"factorisation with the shift {self.shift:.6g}"
        with petsc_solver(self._prefix, what):
            self._eps.setUp()
            ksp.setUp()
        check_factor(ksp, what)

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
