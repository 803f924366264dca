"""PETSc matrices from the rows that each rank holds."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.runtime.installed import needs_petsc

if TYPE_CHECKING:
    from mpi4py import MPI
    from petsc4py import PETSc

FEW = 8  # columns that are multiplied one by one: the set-up for all at once takes longer


def aij_matrix(local: sp.csr_matrix, comm: MPI.Comm, n_local_columns: int) -> PETSc.Mat:
    """Make a distributed AIJ matrix of this rank's rows (global column numbers)."""
    needs_petsc("eigenproblems of many unknowns or on several ranks, and bodies of continuum elements")
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
    if columns.shape[1] < FEW:
        x, y = matrix.createVecs()
        return _apply(matrix.mult, x, y, columns)
    right = _dense(columns, matrix.getSize()[1], matrix.getComm())
    product = matrix.matMult(right)
    result = np.array(product.getDenseArray())
    product.destroy()
    right.destroy()
    return result


def transposed_times(matrix: PETSc.Mat, columns: np.ndarray) -> np.ndarray:
    """Return the transposed matrix times local columns (n_local, k)."""
    y, x = matrix.createVecs()
    return _apply(matrix.multTranspose, x, y, columns)


def solve_columns(factor: PETSc.Mat, columns: np.ndarray) -> np.ndarray:
    """Return the inverse of a factorised matrix times local columns (n_local, k)."""
    right = _dense(columns, factor.getSize()[0], factor.getComm())
    left = right.duplicate()
    left.assemble()
    factor.matSolve(right, left)
    result = np.array(left.getDenseArray())
    right.destroy()
    left.destroy()
    return result


def _dense(columns: np.ndarray, n_rows: int, comm: PETSc.Comm) -> PETSc.Mat:
    """Return local columns (n_local, k) as a distributed dense matrix with n_rows rows."""
    from petsc4py import PETSc

    size = ((columns.shape[0], n_rows), (None, columns.shape[1]))
    matrix = PETSc.Mat().createDense(size, array=np.asfortranarray(columns), comm=comm)
    matrix.setUp()
    matrix.assemble()
    return matrix


def _apply(product: Callable, x: PETSc.Vec, y: PETSc.Vec, columns: np.ndarray) -> np.ndarray:
    result = np.empty((y.getLocalSize(), columns.shape[1]))
    for i in range(columns.shape[1]):
        x.setArray(columns[:, i])
        product(x, y)
        result[:, i] = y.getArray(readonly=True)
    x.destroy()
    y.destroy()
    return result
