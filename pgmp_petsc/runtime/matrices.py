"""PETSc matrices from the rows that each rank holds."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

if TYPE_CHECKING:
    from mpi4py import MPI
    from petsc4py import PETSc


def aij_matrix(local: sp.csr_matrix, comm: MPI.Comm, n_local_columns: int) -> PETSc.Mat:
    """Make a distributed AIJ matrix of this rank's rows (global column numbers)."""
    from petsc4py import PETSc

    local.sort_indices()
    matrix = PETSc.Mat().createAIJ(
        size=((local.shape[0], None), (n_local_columns, local.shape[1])),
        csr=(local.indptr.astype(PETSc.IntType), local.indices.astype(PETSc.IntType), local.data),
        comm=comm,
    )
    matrix.assemble()
    return matrix


def times(matrix: PETSc.Mat, columns: np.ndarray) -> np.ndarray:
    """Return matrix times local columns (n_local, k)."""
    x, y = matrix.createVecs()
    return _apply(matrix.mult, x, y, columns)


def transposed_times(matrix: PETSc.Mat, columns: np.ndarray) -> np.ndarray:
    """Return the transposed matrix times local columns (n_local, k)."""
    y, x = matrix.createVecs()
    return _apply(matrix.multTranspose, x, y, columns)


def solve_columns(factor: PETSc.Mat, columns: np.ndarray) -> np.ndarray:
    """Return the inverse of a factorised matrix times local columns (n_local, k)."""
    from petsc4py import PETSc

    size = ((columns.shape[0], factor.getSize()[0]), (None, columns.shape[1]))
    right = PETSc.Mat().createDense(size, array=np.asfortranarray(columns), comm=factor.getComm())
    left = PETSc.Mat().createDense(size, comm=factor.getComm())
    for matrix in (right, left):
        matrix.setUp()
        matrix.assemble()
    factor.matSolve(right, left)
    result = np.array(left.getDenseArray())
    right.destroy()
    left.destroy()
    return result


def _apply(product: Callable, x: PETSc.Vec, y: PETSc.Vec, columns: np.ndarray) -> np.ndarray:
    result = np.empty((y.getLocalSize(), columns.shape[1]))
    for i in range(columns.shape[1]):
        x.setArray(columns[:, i])
        product(x, y)
        result[:, i] = y.getArray(readonly=True)
    x.destroy()
    y.destroy()
    return result
