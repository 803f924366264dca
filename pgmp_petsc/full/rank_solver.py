"""Where unknowns, multipliers and the entries of the iteration matrix lie in the arrays of one rank, and the linear
systems of a sample that ranks share: assembled and solved by PETSc, what others have gathered.

Matrices are symmetric, and stored as a diagonal and entries below it. All unknowns of a batch are on one rank, in the
order of its factorisation; a sample that is shared by ranks has on each what its elements and joints touch.

Options prefix: ``pgmp_full_`` (e.g. ``-pgmp_full_mat_mumps_icntl_4 2``).
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.base.surroundings import Comm, needs_petsc
from pgmp_petsc.full.batched_ldl import Pattern, Symbolic
from pgmp_petsc.ranks.petsc import mumps_factor, petsc_solver, use_cholesky

PREFIX = "pgmp_full_"
SPARE_MEMORY, MOST_SPARE_MEMORY = 20, 5000  # per cent of what MUMPS foresees, its ICNTL(14): its default, and the most
PAIRS = 2  # ICNTL(12): pairs of a multiplier, whose pivot is zero, and an unknown are ordered as one
SCALING = 7  # ICNTL(8): of each matrix; by itself it takes that of the analysis, of one that may be far from the others
SHORT_OF_MEMORY = (-8, -9)  # INFOG(1) of MUMPS, the integer and the real work array


class Layout:
    """A layout."""

    #: numbers of the unknowns, and then of the multipliers behind all unknowns, that are here, increasing, (n,)
    needed: np.ndarray
    n_unknowns: int  # how many of these are unknowns
    #: turn of every unknown and multiplier here in the arrays of right-hand side and diagonal, and what the kernel
    #: factorises here
    pattern: Pattern
    n_lower: int  # number of entries below the diagonal

    def unknowns(self, dofs: np.ndarray) -> np.ndarray:
        """Return the numbers here of unknowns, -1 where they are -1."""
        return dofs

    def positions(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return where entries are stored: below the diagonal, or ``-1 - k`` on it."""
        raise NotImplementedError


class WholeLayout(Layout):
    """All unknowns, in the order of a factorisation."""

    def __init__(self, symbolic: Symbolic, n_unknowns: int) -> None:
        self.needed, self.n_unknowns, self.n_lower = np.arange(symbolic.n), n_unknowns, symbolic.rows.size
        self.pattern = Pattern(symbolic.place, symbolic.starts, symbolic.rows, symbolic.products)
        self.positions = symbolic.position


class NoMatrix(Layout):
    """All unknowns as they are, of equations whose matrix is made elsewhere: every entry is in a place of its own."""

    n_lower = 0

    def __init__(self, n_unknowns: int, n_all: int) -> None:
        self.needed, self.n_unknowns = np.arange(n_all), n_unknowns
        self.pattern = unfactorised(n_all)

    def positions(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        return np.arange(rows.size).reshape(rows.shape)


class RankLayout(Layout):
    """Unknowns and multipliers that one rank needs, in their order.

    The mechanism has `n_dofs` unknowns and `n_all` with multipliers; `pattern` has rows and columns of all entries that
    are evaluated here, and whatever else is needed as a pair with itself.
    """

    def __init__(self, n_dofs: int, n_all: int, pattern: tuple[np.ndarray, np.ndarray]) -> None:
        rows, columns = pattern
        self.needed = np.unique(np.concatenate([rows, columns]))
        self.n_unknowns = int(np.searchsorted(self.needed, n_dofs))
        self._n_all = n_all
        off = rows != columns
        self._stored = np.unique(np.maximum(rows, columns)[off] * n_all + np.minimum(rows, columns)[off])
        self.n_lower = self._stored.size
        self.pattern = unfactorised(self.needed.size)

    def unknowns(self, dofs: np.ndarray) -> np.ndarray:
        return np.where(dofs < 0, -1, np.searchsorted(self.needed, dofs))

    def positions(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        keys = np.maximum(rows, columns) * self._n_all + np.minimum(rows, columns)
        return np.where(rows == columns, -1 - self.unknowns(rows), np.searchsorted(self._stored, keys))

    @cached_property
    def lower(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the entries below the diagonal among the needed, each (n_lower,)."""
        return tuple(np.searchsorted(self.needed, part) for part in np.divmod(self._stored, self._n_all))


def unfactorised(n: int) -> Pattern:
    """Return the pattern of n rows that the kernel factorises nothing of."""
    nothing = np.zeros((3, 0), dtype=np.int64)
    return Pattern(np.arange(n), *nothing[:2], (nothing[2], *np.zeros((3, 0), dtype=np.uint32)))


class RankSolver:
    """Matrix and solver of the `layout` that this rank needs. Collective on `comm`.

    `own` are places there of what the rank owns, in the order of its rows, and `rows` that of every unknown and
    multiplier of the mechanism, rank by rank, shape (n_all,).
    """

    def __init__(self, layout: RankLayout, own: np.ndarray, rows: np.ndarray, comm: Comm) -> None:
        needs_petsc("full-order runs of large meshes, from equilibrium or on several ranks")
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
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._x, self._rhs = self._matrix.createVecs()
        needed = PETSc.IS().createGeneral(columns.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
        self._ghosts, self._forward = PETSc.Vec().createSeq(columns.size), PETSc.Scatter.Mode.SCATTER_FORWARD
        self._scatter = PETSc.Scatter().create(self._x, needed, self._ghosts, None)
        needed.destroy()
        self._ksp = PETSc.KSP().create(comm)
        self._ksp.setOptionsPrefix(PREFIX)
        use_cholesky(self._ksp)
        self._ksp.setOperators(self._matrix)
        self._spare, self._finite_matrix = SPARE_MEMORY, True
        with petsc_solver(PREFIX, "full-order linear solver"):
            self._ksp.setFromOptions()
            self._prepare()

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
        """Return this rank's rows of the solution, or None, on all ranks, where PETSc finds none.

        Pivots of multipliers are zero, and MUMPS puts them off until it may run out of the memory that it foresaw: it
        is then given more. What an iteration that ran away made of the system is no matter of memory: it is not solved,
        and the next one is solved as if it were the first.
        """
        self._rhs.setArray(rhs)
        if not all(self._comm.allgather(self._finite_matrix and bool(np.isfinite(rhs).all()))):
            return None
        solved = self._solve_once()
        while not solved and self._short_of_memory() and self._spare < MOST_SPARE_MEMORY:
            self._spare *= 4
            self._forget_factors()
            solved = self._solve_once()
        if not solved:
            self._forget_factors()
            return None
        return self._x.getArray(readonly=True).copy()

    def _forget_factors(self) -> None:
        """Let the next matrix be factorised from the beginning, whatever became of the last one.

        PETSc factorises neither a matrix that is as it was, nor any with factors of MUMPS that once ended in an error
        (MatFactorNumeric_MUMPS returns where INFOG(1) < 0, as if the analysis had failed).
        """
        self._ksp.getPC().reset()
        self._ksp.setOperators(self._matrix)
        self._prepare()

    def _prepare(self) -> None:
        """Set what MUMPS reads at its analysis; the user's options come after and win."""
        factor = mumps_factor(self._ksp)
        if factor is not None:
            factor.setOptionsPrefix(PREFIX)  # else it gets one too late for its options
            factor.setMumpsIcntl(14, self._spare)
            factor.setMumpsIcntl(12, PAIRS)
            factor.setMumpsIcntl(8, SCALING)

    def _short_of_memory(self) -> bool:
        factor = mumps_factor(self._ksp)
        return factor is not None and factor.getMumpsInfog(1) in SHORT_OF_MEMORY

    def _solve_once(self) -> bool:
        try:
            with petsc_solver(PREFIX, "full-order linear solver"):
                self._ksp.solve(self._rhs, self._x)
            solved = self._ksp.getConvergedReason() > 0
        except RunError:  # a factorisation that ends in an error, or -pgmp_full_ksp_error_if_not_converged
            solved = False
        return all(self._comm.allgather(solved))
