"""Third derivative of the strain energy at rest, ``K3 = sum_i w_i K3_i``, times pairs of vectors, in body frames.

It is never stored: with the strains ``e = S v`` of the elements (`beam2d.rest_strains`) it is

    K3_i[v_j, v_k] = S^T (EA_i L f(e_j, e_k) + GA_i L g(e_j, e_k)),

f and g from `beam2d.third_derivative`. A rank has the elements that touch its rows, as in `bodies.matrices`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies import beam2d
from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.matrices import element_dofs, touching


class ThirdDerivative:
    """The rows ``[rows.start, rows.stop)`` of ``K3_i[v_j, v_k]`` for every affine term i; of beams in the plane.

    Parameters
    ----------
    bodies
        Bodies of the mechanism; those that are no beams in the plane are left out.
    rows
        The range of rows (unknowns) held here.
    """

    def __init__(self, bodies: Sequence[Body], rows: range) -> None:
        n_dofs = sum(body.dofs.size for body in bodies)
        dofs, strains = [np.zeros((0, 6), dtype=int)], [np.zeros((0, 3, 6))]
        stiffness: list[dict[Monomial, np.ndarray]] = []
        for body in (body for body in bodies if body.is_planar_beam):
            chosen = touching(body, rows)
            lengths = body.mesh.lengths[chosen]
            dofs.append(element_dofs(body.elements[chosen]))
            strains.append(beam2d.rest_strains(lengths, body.directions[chosen]))
            terms = body.section.stiffness_terms()
            stiffness.append({weight: np.outer(lengths, coefficients[:2]) for weight, coefficients in terms.items()})
        columns = np.repeat(np.concatenate(dofs), 3, axis=0).ravel()
        entries = np.concatenate(strains).ravel()
        starts = 6 * np.arange(entries.size // 6 + 1)
        self._strains = sp.csr_matrix((entries, columns, starts), shape=(starts.size - 1, n_dofs))
        self._forces = self._strains.T.tocsr()[rows.start : rows.stop]
        # (EA, GA) times the length of every element, by weight
        none = [np.zeros((len(part), 2)) for part in dofs[1:]]
        self._stiffness = {
            weight: np.concatenate([part.get(weight, zero) for part, zero in zip(stiffness, none)])
            for weight in dict.fromkeys(weight for part in stiffness for weight in part)
        }

    def times(self, vectors: np.ndarray, pairs: tuple[np.ndarray, np.ndarray]) -> dict[Monomial, np.ndarray]:
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
        units = self._of_units(vectors, pairs)
        return {weight: self._summed(stiffness, units) for weight, stiffness in self._stiffness.items()}

    def weighted(
        self, vectors: np.ndarray, pairs: tuple[np.ndarray, np.ndarray], values: Mapping[str, float]
    ) -> np.ndarray:
        """Return ``K3[v_j, v_k]`` at parameter values, shape (n_rows, n_pairs); see `times`."""
        parts = (float(weight.evaluate(values)) * stiffness for weight, stiffness in self._stiffness.items())
        return self._summed(sum(parts, np.zeros((self._strains.shape[0] // 3, 2))), self._of_units(vectors, pairs))

    def _of_units(self, vectors: np.ndarray, pairs: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        strains = (self._strains @ vectors).reshape(self._strains.shape[0] // 3, 3, vectors.shape[1])
        return beam2d.third_derivative(strains[..., pairs[0]], strains[..., pairs[1]])

    def _summed(self, stiffness: np.ndarray, units: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Return the forces on the unknowns for a stiffness (n_elements, 2)."""
        axial, shear = stiffness.T[..., None, None]
        on_strains = axial * units[0] + shear * units[1]
        return self._forces @ on_strains.reshape(self._strains.shape[0], on_strains.shape[2])
