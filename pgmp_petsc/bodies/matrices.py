"""Sparse affine matrices ``M = sum_i w_i M_i`` and ``K = sum_i w_i K_i`` of all bodies, in body frames.

A rank assembles the rows that it owns and no others: the elements that touch them are evaluated there, those on a
border twice, and nothing has to be communicated. All terms share one nonzero pattern, so that sums and shifted
matrices never change it.

Third derivative of the strain energy at rest, ``K3 = sum_i w_i K3_i``, times pairs of vectors, in body frames.

It is never stored for beams (`kinds.beam`); of a condensed body it is (`large_deformation`). A rank has the elements
that touch its rows, as in `bodies.matrices`.
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
    """Rows ``[rows.start, rows.stop)`` of every affine term."""

    rows: range  # the range of rows (unknowns) held here
    #: mass, stiffness: one CSR matrix of shape (n_rows, n_dofs) a weight; M_i (kg, kg m^2) and K_i (N/m, N m) are what
    #: remains when the weight is taken out
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
    return AffineMatrices(rows, mass=mass_of_bodies(bodies, rows), stiffness=_assemble_terms(bodies, rows, "stiffness"))


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


Pairs = tuple[np.ndarray, np.ndarray]


class ThirdDerivative:
    """The rows ``[rows.start, rows.stop)`` of ``K3_i[v_j, v_k]`` for every affine term i.

    Parameters
    ----------
    bodies
        Bodies of the mechanism; the strain energy of rigid ones is zero.
    rows
        The range of rows (unknowns) held here.

    Raises
    ------
    ValueError
        If the third derivative of a body is not known (`Body.third_derivative_known`).
    """

    def __init__(self, bodies: Sequence[Body], rows: range) -> None:
        self._rows, n_dofs = rows, sum(body.dofs.size for body in bodies)
        unknown = [body.name for body in bodies if not body.third_derivative_known]
        if unknown:
            raise ValueError(f"the third derivative of the strain energy of {', '.join(unknown)} is not known")
        parts = (body.third_derivative(rows, n_dofs) for body in bodies)
        self._parts = [part for part in parts if part is not None]

    def times(self, vectors: np.ndarray, pairs: Pairs) -> dict[Monomial, np.ndarray]:
        """Contract with pairs of vectors.

        Parameters
        ----------
        vectors
            All rows, shape (n_dofs, m).
        pairs
            Numbers j and k of the vectors of every pair, shape (n_pairs,) each.

        Returns
        -------
        dict
            For every weight an array of shape (n_rows, n_pairs): ``K3_i[v_j, v_k]``.
        """
        found: dict[Monomial, np.ndarray] = {}
        for part in self._parts:
            for weight, forces in zip(part.weights, part.forces(part.terms, vectors, pairs)):
                total = found.setdefault(weight, np.zeros((len(self._rows), pairs[0].size)))
                part.add(forces, total)
        return found

    def weighted(self, vectors: np.ndarray, pairs: Pairs, values: Mapping[str, float]) -> np.ndarray:
        """Return ``K3[v_j, v_k]`` at parameter values, shape (n_rows, n_pairs); see `times`."""
        total = np.zeros((len(self._rows), pairs[0].size))
        for part in self._parts:
            weighted = sum(float(weight.evaluate(values)) * term for weight, term in zip(part.weights, part.terms))
            for forces in part.forces([weighted], vectors, pairs):
                part.add(forces, total)
        return total
