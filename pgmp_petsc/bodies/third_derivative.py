"""Third derivative of the strain energy at rest, ``K3 = sum_i w_i K3_i``, times pairs of vectors, in body frames.

It is never stored for beams: with the strains ``e = S v`` of the elements at rest

    K3_i[v_j, v_k] = S^T f_i(e_j, e_k),

f from `beam2d.third_derivative` or `spatial_rest_strains.third_derivative`. A rank has the elements that touch its
rows, as in `bodies.matrices`. Of a condensed body it is stored (`large_deformation`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies import beam2d, spatial_rest_strains
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.matrices import element_dofs, touching

Pairs = tuple[np.ndarray, np.ndarray]


def is_known_of(body: Body) -> bool:
    """Return whether the third derivative of a body is known: of beams, rigid bodies and some condensed ones."""
    return not body.flexible or body.is_beam or (body.component is not None and body.component.large is not None)


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
        If the third derivative of a body is not known (`is_known_of`).
    """

    def __init__(self, bodies: Sequence[Body], rows: range) -> None:
        self._rows, n_dofs = rows, sum(body.dofs.size for body in bodies)
        unknown = [body.name for body in bodies if not is_known_of(body)]
        if unknown:
            raise ValueError(f"the third derivative of the strain energy of {', '.join(unknown)} is not known")
        self._parts: list[_OfBeam | _OfComponent] = []
        for body in (body for body in bodies if body.flexible):
            part = _OfBeam(body, rows, n_dofs) if body.is_beam else _OfComponent(body, rows)
            self._parts.append(part)

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


class _OfBeam:
    """A body of beams; its terms are sectional coefficients."""

    def __init__(self, body: Body, rows: range, n_dofs: int) -> None:
        chosen = touching(body, rows)
        self._lengths = body.mesh.lengths[chosen]
        if body.is_planar_beam:
            self._contracted = beam2d.third_derivative
            strains = beam2d.rest_strains(self._lengths, body.directions[chosen])
        else:
            self._contracted = spatial_rest_strains.third_derivative
            strains = spatial_rest_strains.rest_strains(self._lengths, body.axes[chosen])
        dofs, self._n = element_dofs(body.elements[chosen], body.node_dofs), strains.shape[1]
        columns, starts = np.repeat(dofs, self._n, axis=0), dofs.shape[1] * np.arange(dofs.shape[0] * self._n + 1)
        shape = (starts.size - 1, n_dofs)
        self._strains = sp.csr_matrix((strains.ravel(), columns.ravel(), starts), shape=shape)
        self._on_rows = self._strains.T.tocsr()[rows.start : rows.stop]
        terms = body.sections("stiffness")
        self.weights, self.terms = list(terms), [coefficients[chosen].T for coefficients in terms.values()]

    def forces(self, terms: Iterable[np.ndarray], vectors: np.ndarray, pairs: Pairs) -> Iterable[np.ndarray]:
        """Yield the forces on the strains for sections, each of shape (n_elements n_strains, n_pairs)."""
        strains = (self._strains @ vectors).reshape(self._lengths.size, self._n, vectors.shape[1])
        one, other = strains[..., pairs[0]], strains[..., pairs[1]]
        for section in terms:
            forces = self._contracted(one, other, section) * self._lengths[:, None, None]
            yield forces.reshape(self._strains.shape[0], pairs[0].size)

    def add(self, forces: np.ndarray, total: np.ndarray) -> None:
        """Add forces to those on the rows (n_rows, n_pairs)."""
        total += self._on_rows @ forces


class _OfComponent:
    """A condensed body; its terms are third derivatives (n, n, n)."""

    def __init__(self, body: Body, rows: range) -> None:
        self._dofs = body.dofs
        self._own = np.flatnonzero((self._dofs >= rows.start) & (self._dofs < rows.stop))
        self._places = self._dofs[self._own] - rows.start
        third = body.component.large.third
        self.weights, self.terms = list(third), list(third.values())

    def forces(self, terms: Iterable[np.ndarray], vectors: np.ndarray, pairs: Pairs) -> Iterable[np.ndarray]:
        """Yield the forces on the body's own rows, each of shape (n_own, n_pairs)."""
        own = vectors[self._dofs]
        for third in terms:
            # one after the other: of n fields, m vectors and p pairs n^3 m + n^2 p products, not n^3 p
            half = np.einsum("iab,bk->iak", third[self._own], own, optimize=True)
            yield np.einsum("iap,ap->ip", half[:, :, pairs[1]], own[:, pairs[0]], optimize=True)

    def add(self, forces: np.ndarray, total: np.ndarray) -> None:
        """Add forces to those on the rows (n_rows, n_pairs)."""
        total[self._places] += forces
