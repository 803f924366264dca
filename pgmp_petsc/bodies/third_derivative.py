"""Third derivative of the strain energy at rest, ``K3 = sum_i w_i K3_i``, times pairs of vectors, in body frames.

It is never stored for beams (`kinds.beam`); of a condensed body it is (`large_deformation`). A rank has the elements
that touch its rows, as in `bodies.matrices`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import Body

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
