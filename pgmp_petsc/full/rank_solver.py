"""The linear systems of a sample that ranks share: assembled and solved by PETSc, what others have gathered.

Options prefix: ``pgmp_full_`` (e.g. ``-pgmp_full_mat_mumps_icntl_4 2``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.full.layout import RankLayout
from pgmp_petsc.runtime.errors import RunError
from pgmp_petsc.runtime.petsc import petsc_solver
from pgmp_petsc.runtime.surroundings import needs_petsc

if TYPE_CHECKING:
    from mpi4py import MPI

PREFIX = "pgmp_full_"
SPARE_MEMORY, MOST_SPARE_MEMORY = 20, 5000  # per cent of what MUMPS foresees, its ICNTL(14): its default, and the most
SHORT_OF_MEMORY = (-8, -9)  # INFOG(1) of MUMPS, the integer and the real work array


class RankSolver:
    """Matrix and solver. Collective on `comm`.

    Parameters
    ----------
    layout
        What this rank needs.
    own
        Places there of what it owns, in the order of its rows.
    rows
        Row of every unknown and multiplier of the mechanism, rank by rank, shape (n_all,).
    comm
        Ranks that share the system.
    """

    def __init__(self, layout: RankLayout, own: np.ndarray, rows: np.ndarray, comm: MPI.Comm) -> None:
        needs_petsc("full-order runs of large meshes, of solids in space, from equilibrium or on several ranks")
        from petsc4py import PETSc

        self._comm = comm
        columns = rows[layout.needed]
        row_here = np.full(layout.needed.size, -1)
        row_here[own] = np.arange(own.size)
        below, across = layout.lower
        stored = layout.needed.size + np.arange(below.size)  # behind the diagonal
        i = np.concatenate([np.arange(layout.needed.size), below, across])
        j = np.concatenate([np.arange(layout.needed.size), across, below])
        source = np.concatenate([np.arange(layout.needed.size), stored, stored])
        here = np.flatnonzero(row_here[i] >= 0)
        order = here[np.lexsort((columns[j[here]], row_here[i[here]]))]
        self._source = source[order]
        self._indices = columns[j[order]].astype(PETSc.IntType)
        self._indptr = np.searchsorted(row_here[i[order]], np.arange(own.size + 1)).astype(PETSc.IntType)
        self._matrix = PETSc.Mat().createAIJ(
            size=((own.size, None), (own.size, None)),
            csr=(self._indptr, self._indices, np.zeros(self._indices.size)),
            comm=comm,
        )
        self._x, self._rhs = self._matrix.createVecs()
        needed = PETSc.IS().createGeneral(columns.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
        self._ghosts, self._forward = PETSc.Vec().createSeq(columns.size), PETSc.Scatter.Mode.SCATTER_FORWARD
        self._scatter = PETSc.Scatter().create(self._x, needed, self._ghosts, None)
        needed.destroy()
        self._ksp = PETSc.KSP().create(comm)
        self._ksp.setOptionsPrefix(PREFIX)
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        self._ksp.getPC().setType(PETSc.PC.Type.LU)
        self._ksp.getPC().setFactorSolverType("mumps")
        self._ksp.setOperators(self._matrix)
        with petsc_solver(PREFIX, "full-order linear solver"):
            self._ksp.setFromOptions()
        self._spare, self._finite_matrix = SPARE_MEMORY, True

    def close(self) -> None:
        """Destroy the PETSc objects."""
        for item in (self._ksp, self._matrix, self._scatter, self._x, self._rhs, self._ghosts):
            item.destroy()

    def gather(self, own: np.ndarray) -> np.ndarray:
        """Return what is needed here, shape (n_needed,), of a vector that every rank has its rows of."""
        self._x.setArray(own)
        self._scatter.scatter(self._x, self._ghosts, addv=False, mode=self._forward)
        return self._ghosts.getArray(readonly=True).copy()

    def assemble(self, diagonal: np.ndarray, lower: np.ndarray) -> None:
        """Put the entries of a symmetric matrix, as they lie in the layout, into this rank's rows."""
        data = np.concatenate([diagonal, lower])[self._source]
        self._finite_matrix = bool(np.isfinite(data).all())
        self._matrix.setValuesCSR(self._indptr, self._indices, data)
        self._matrix.assemble()
        self._ksp.setOperators(self._matrix)

    def solve(self, rhs: np.ndarray) -> np.ndarray | None:
        """Return this rank's rows of the solution, or None, on all ranks, where PETSc finds none."""
        self._rhs.setArray(rhs)
        return self._x.getArray(readonly=True).copy() if self._solved() else None

    def _solved(self) -> bool:
        """Solve the linear system; return whether PETSc says that it is solved, the same on all ranks.

        Pivots of multipliers are zero, and MUMPS puts them off until it may run out of the memory that it foresaw: it
        is then given more. What an iteration that ran away made of the system is no matter of memory: it is not solved.
        """
        finite = self._finite_matrix and bool(np.isfinite(self._rhs.getArray(readonly=True)).all())
        if not all(self._comm.allgather(finite)):
            return False
        solved = self._solve_once()
        while not solved and self._short_of_memory() and self._spare < MOST_SPARE_MEMORY:
            self._spare *= 4
            preconditioner = self._ksp.getPC()
            preconditioner.reset()  # a matrix that is as it was would not be factorised again
            self._ksp.setOperators(self._matrix)
            preconditioner.setFactorSetUpSolverType()
            preconditioner.getFactorMatrix().setMumpsIcntl(14, self._spare)
            solved = self._solve_once()
        return solved

    def _short_of_memory(self) -> bool:
        preconditioner = self._ksp.getPC()
        direct = preconditioner.getType() == "lu" and preconditioner.getFactorSolverType() == "mumps"
        return direct and preconditioner.getFactorMatrix().getMumpsInfog(1) in SHORT_OF_MEMORY

    def _solve_once(self) -> bool:
        try:
            with petsc_solver(PREFIX, "full-order linear solver"):
                self._ksp.solve(self._rhs, self._x)
            solved = self._ksp.getConvergedReason() > 0
        except RunError:  # a factorisation that ends in an error, or -pgmp_full_ksp_error_if_not_converged
            solved = False
        return all(self._comm.allgather(solved))
