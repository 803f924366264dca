"""The pencil (K, M) of a mechanism in the null space N of its constraints, sparse, over ranks, with PETSc and SLEPc.

What a pencil offers is the same here and in `dense_pencil`, which takes the small ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.mechanism.null_space import NullSpace
from pgmp_petsc.runtime.petsc import aij_matrix, times, transposed_times
from pgmp_petsc.solvers.shift_invert import EigenPairs, ShiftInvertSolver

if TYPE_CHECKING:
    from mpi4py import MPI
    from petsc4py import PETSc


class SparsePencil:
    """A pencil that ranks share; each has a range of rows. Collective on `comm`.

    Parameters
    ----------
    mass, stiffness
        This rank's rows, shape (n_local, n_dofs).
    comm
        Ranks that share the pencil.

    Attributes
    ----------
    shift
        sigma, below all eigenvalues; see `shift_to`.
    """

    def __init__(self, mass: sp.csr_matrix, stiffness: sp.csr_matrix, comm: MPI.Comm) -> None:
        self._comm, self._first = comm, comm.scan(mass.shape[0]) - mass.shape[0]
        self._mass, self._stiffness = (aij_matrix(matrix, comm, mass.shape[0]) for matrix in (mass, stiffness))
        self.shift = 0.0
        self._null: PETSc.Mat | None = None
        self._reduced: tuple[PETSc.Mat, PETSc.Mat] | None = None
        self._signature = b""
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
        n_local = self._mass.getLocalSize()[0]
        rows = slice(self._first, self._first + n_local)
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
        pairs = self._solver.solve(*self._reduced, n_rigid, n_flexible, where)
        return EigenPairs(pairs.values, times(self._null, pairs.vectors), pairs.spare)

    def factor(self) -> None:
        """Factor ``K - sigma M`` for `shifted_answers`, without solving for eigenpairs."""
        self._solver.factor(*self._reduced)

    def count_below(self, tau: float) -> int:
        """Return the number of eigenvalues below tau."""
        return self._solver.count_below(*self._reduced, tau)

    def shifted_answers(self, loads: np.ndarray) -> np.ndarray:
        """Return ``N (N^T (K - sigma M) N)^-1 N^T`` times loads (n_local, k), with the factor of the last solve."""
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
