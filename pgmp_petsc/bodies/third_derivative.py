"""Third derivative of the strain energy at rest, ``K3 = sum_i w_i K3_i``, times pairs of vectors, in body frames.

It is never stored: elements are contracted with the vectors and their forces summed into the rows that a rank owns,
those on a border on both sides, as in `bodies.matrices`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.matrices import element_dofs, touching


class ThirdDerivative:
    """The rows ``[rows.start, rows.stop)`` of ``K3_i[v_j, v_k]`` for every affine term i.

    Parameters
    ----------
    bodies
        Bodies of the mechanism.
    rows
        The range of rows (unknowns) held here.
    """

    def __init__(self, bodies: Sequence[Body], rows: range) -> None:
        self._n_rows = len(rows)
        self._parts = []
        for body in bodies:
            chosen = touching(body, rows)
            dofs = element_dofs(body.elements[chosen])
            owned = np.flatnonzero((dofs.ravel() >= rows.start) & (dofs.ravel() < rows.stop))
            gather = sp.csr_matrix(
                (np.ones(owned.size), (dofs.ravel()[owned] - rows.start, owned)), shape=(self._n_rows, dofs.size)
            )
            self._parts.append((body, chosen, dofs, gather))

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
        n_pairs = pairs[0].size
        result: dict[Monomial, np.ndarray] = {}
        for body, chosen, dofs, gather in self._parts:
            for monomial, entries in body.cubic_entries(chosen, vectors[dofs], pairs).items():
                total = result.setdefault(monomial, np.zeros((self._n_rows, n_pairs)))
                total += gather @ entries.reshape(dofs.size, n_pairs)
        return result
