"""Sparse affine matrices ``M = sum_i w_i M_i`` and ``K = sum_i w_i K_i`` of all bodies, in body frames.

A rank assembles the rows that it owns and no others: the elements that touch them are evaluated there, those on a
border twice, and nothing has to be communicated. All terms share one nonzero pattern, so that sums and shifted
matrices never change it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import DOFS_PER_NODE, Body


@dataclass(frozen=True)
class AffineMatrices:
    """Rows ``[rows.start, rows.stop)`` of every affine term.

    Attributes
    ----------
    rows
        The range of rows (unknowns) held here.
    mass, stiffness
        One CSR matrix of shape (n_rows, n_dofs) a weight; M_i (kg, kg m^2) and K_i (N/m, N m) are what remains
        when the weight is taken out.
    """

    rows: range
    mass: dict[Monomial, sp.csr_matrix]
    stiffness: dict[Monomial, sp.csr_matrix]


@dataclass(frozen=True, eq=False)
class MassesOnDemand:
    """`AffineMatrices` without stiffness, whose masses are assembled when asked for: of all loads only weights do."""

    bodies: Sequence[Body]
    rows: range

    @cached_property
    def mass(self) -> dict[Monomial, sp.csr_matrix]:
        """As of `AffineMatrices`."""
        return mass_of_bodies(self.bodies, self.rows)


def weighted_sum(terms: Mapping[Monomial, sp.csr_matrix], values: Mapping[str, float]) -> sp.csr_matrix:
    """Return ``sum_i w_i A_i`` on the common pattern (SciPy's own sum would drop stored zeros)."""
    first = next(iter(terms.values()))
    data = sum(float(monomial.evaluate(values)) * matrix.data for monomial, matrix in terms.items())
    return sp.csr_matrix((data, first.indices, first.indptr), shape=first.shape)


def owned_rows(n_dofs: int, rank: int, size: int) -> range:
    """Return a rank's contiguous share of the unknowns, whole nodes at a time; the last one has what is left over."""
    n_nodes = n_dofs // DOFS_PER_NODE
    first, last = n_nodes * rank // size, n_nodes * (rank + 1) // size
    return range(DOFS_PER_NODE * first, DOFS_PER_NODE * last if rank < size - 1 else n_dofs)


def assemble(bodies: Sequence[Body], rows: range) -> AffineMatrices:
    """Assemble the given rows of all affine terms of all bodies, in body frames."""
    return AffineMatrices(
        rows,
        mass=mass_of_bodies(bodies, rows),
        stiffness=_assemble_terms(bodies, rows, "stiffness"),
    )


def mass_of_bodies(bodies: Sequence[Body], rows: range) -> dict[Monomial, sp.csr_matrix]:
    """Assemble the given rows of all affine terms of the mass."""
    return _assemble_terms(bodies, rows, "mass")


def axial_stiffness(bodies: Sequence[Body], rows: range, values: Mapping[str, float]) -> sp.csr_matrix:
    """Return the given rows of the part of the stiffness that resists extension, shape (n_rows, n_dofs).

    Of condensed bodies it is that against the mean strains of pieces (`large_deformation`).
    """
    return weighted_sum(_assemble_terms(bodies, rows, "stretching"), values)


def _assemble_terms(bodies: Sequence[Body], rows: range, kind: str) -> dict[Monomial, sp.csr_matrix]:
    """Assemble the entries of one kind; see `Body.entries`."""
    n_dofs, none = sum(body.dofs.size for body in bodies), np.zeros(0, dtype=int)
    parts = [(none, none, {}), *(part for body in bodies for part in body.entries(kind, rows))]
    row, column = (np.concatenate([part[k] for part in parts]) for k in range(2))
    owned = (row >= rows.start) & (row < rows.stop)
    shape = (len(rows), n_dofs)
    terms = {}
    for monomial in dict.fromkeys(m for *_, values in parts for m in values):
        # zeros of bodies without this weight stay in the pattern: it is common to all terms
        values = np.concatenate([values.get(monomial, np.zeros(own.size)) for own, _, values in parts])
        coo = sp.coo_matrix((values[owned], (row[owned] - rows.start, column[owned])), shape=shape)
        terms[monomial] = coo.tocsr()
    return terms
