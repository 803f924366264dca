"""A body's affine matrices in PETSc: ``A = sum_i w_i A_i`` with weights w_i that parameter values give."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import scipy.sparse as sp

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.runtime.matrices import aij_matrix

if TYPE_CHECKING:
    from mpi4py import MPI
    from petsc4py import PETSc

Terms = Mapping[Monomial, "PETSc.Mat"]


def petsc_terms(rows: dict[Monomial, sp.csr_matrix], comm: MPI.Comm) -> dict[Monomial, PETSc.Mat]:
    """Return distributed matrices of this rank's rows by weight, and empty `rows`: large ones are held once only."""
    terms = {}
    for weight in list(rows):
        local = rows.pop(weight)
        terms[weight] = aij_matrix(local, comm, local.shape[0])
    return terms


def matrix_sum(terms: Terms, values: Mapping[str, float]) -> tuple[PETSc.Mat, bool]:
    """Return the sum at parameter values, and whether it is a new matrix: a single term of weight 1 is its own sum."""
    (first, matrix), *others = ((float(weight.evaluate(values)), matrix) for weight, matrix in terms.items())
    if not others and first == 1.0:
        return matrix, False
    total = matrix.duplicate(copy=True)
    total.scale(first)
    for weight, other in others:
        total.axpy(weight, other, structure=other.Structure.SAME_NONZERO_PATTERN)
    return total, True
