"""Matrices of all bodies in body frames: affine mass ``M = sum_i w_i M_i`` and stiffness ``K = sum_i w_i K_i``, the
third derivative of the strain energy, and moments of inertia.

A rank assembles the rows that it owns and no others: the elements that touch them are evaluated there, those on a
border twice, and nothing has to be communicated. All terms share one nonzero pattern, so that sums and shifted
matrices never change it.

The third derivative at rest, ``K3 = sum_i w_i K3_i``, is given times pairs of vectors. It is never stored for beams
(`kinds.beam`); of a condensed body it is (`components`). A rank has the elements that touch its rows.

Moments of inertia say what the mass matrix does to displacement fields that are turned. The points of a body have
displacements whose component i is ``f_i = C_i y`` in its unknowns y: of a meshed body its nodes', of beams those of
natural coordinates, in which a node turns with its directors (`beam3d`). The mass m is the same for every component, so
that with the moments ``P_ij = C_i^T m C_j`` a matrix W that turns all points, in the body's frame, has

    (W f)^T m g = y_f^T (sum_ij W_ji P_ij) y_g,        M = sum_i P_ii (+ rotary inertia in the plane, which W leaves).

Rotations in space are rotation vectors phi. Directors are ``exp(phi) e_k``, and their part of second order moves the
section's mass: with ``J_kl`` the inertia of the directors at a node, accelerations ``A e_k`` do on it the work

    sum_kl J_kl (A e_l) . (1/2 phi x (phi x e_k)).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.affine import Monomial, total_at
from pgmp_petsc.bodies.body import DOFS_PER_NODE, Body, Pairs
from pgmp_petsc.bodies.component import of_directors


@dataclass(frozen=True, eq=False)
class AffineMatrices:
    """Rows ``[rows.start, rows.stop)`` of every affine term of all bodies, in body frames: one CSR matrix of shape
    (n_rows, n_dofs) a weight, what remains when the weight is taken out. They are assembled when they are asked for."""

    bodies: Sequence[Body]
    rows: range  # the range of rows (unknowns) held here

    @cached_property
    def mass(self) -> dict[Monomial, sp.csr_matrix]:
        """M_i, kg and kg m^2."""
        return self._terms("mass")

    @cached_property
    def stiffness(self) -> dict[Monomial, sp.csr_matrix]:
        """K_i, N/m and N m."""
        return self._terms("stiffness")

    @cached_property
    def stretching(self) -> dict[Monomial, sp.csr_matrix]:
        """The part of the stiffness that resists extension; of condensed bodies that against the mean strains of pieces
        (`components.large_deformation`)."""
        return self._terms("stretching")

    def _terms(self, kind: str) -> dict[Monomial, sp.csr_matrix]:
        """Assemble the entries of one kind; see `Body.entries`."""
        n_dofs, none, rows = sum(body.dofs.size for body in self.bodies), np.zeros(0, dtype=int), self.rows
        parts = [(none, none, {}), *(part for body in self.bodies for part in body.entries(kind, rows))]
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


class ThirdDerivative:
    """The rows ``[rows.start, rows.stop)`` of ``K3_i[v_j, v_k]`` for every affine term i of the bodies' strain energy,
    zero of rigid ones.

    Raises ValueError if the third derivative of a body is not known (`Body.third_derivative_known`).
    """

    def __init__(self, bodies: Sequence[Body], rows: range) -> None:
        self._rows, n_dofs = rows, sum(body.dofs.size for body in bodies)
        unknown = [body.name for body in bodies if not body.third_derivative_known]
        if unknown:
            raise ValueError(f"the third derivative of the strain energy of {', '.join(unknown)} is not known")
        parts = (body.third_derivative(rows, n_dofs) for body in bodies)
        self._parts = [part for part in parts if part is not None]

    def times(self, vectors: np.ndarray, pairs: Pairs) -> dict[Monomial, np.ndarray]:
        """Return by weight ``K3_i[v_j, v_k]``, shape (n_rows, n_pairs), for pairs of vectors, all rows, shape (n_dofs,
        m).

        Pairs are the numbers j and k, shape (n_pairs,) each.
        """
        found: dict[Monomial, np.ndarray] = {}
        for part in self._parts:
            for weight, forces in zip(part.weights, part.forces(part.terms, vectors, pairs)):
                part.add(forces, found.setdefault(weight, np.zeros((len(self._rows), pairs[0].size))))
        return found

    def weighted(self, vectors: np.ndarray, pairs: Pairs, values: Mapping[str, float]) -> np.ndarray:
        """Return ``K3[v_j, v_k]`` at parameter values, shape (n_rows, n_pairs); see `times`."""
        total = np.zeros((len(self._rows), pairs[0].size))
        for part in self._parts:
            weighted = total_at(dict(zip(part.weights, part.terms)), values)
            for forces in part.forces([weighted], vectors, pairs):
                part.add(forces, total)
        return total


def inertia_moments(body: Body) -> dict[Monomial, sp.csr_matrix]:
    """Return P_ij of a body that is not meshed, by weight, in the order of its unknowns: one above the other, in
    order of (i, j), shape (d * d * n, n)."""
    found: dict[Monomial, sp.csr_matrix] = {}
    pairs, n = np.arange(body.dimension**2), body.dofs.size
    for weight, dofs, values in chain(body.moments(), _of_lumps(body)):
        rows, columns = np.repeat(dofs, dofs.shape[1], axis=1).ravel(), np.tile(dofs, dofs.shape[1]).ravel()
        entries = np.moveaxis(values, 0, 2).ravel()
        places = np.add.outer(n * pairs, rows).ravel(), np.tile(columns, pairs.size)
        own = sp.csr_matrix((entries, places), shape=(n * pairs.size, n))
        found[weight] = found[weight] + own if weight in found else own
    return found


def director_inertia(body: Body) -> dict[Monomial, np.ndarray]:
    """Return J of the nodes of a body in space by weight, shape (n_nodes, 3, 3), kg m2; none of condensed ones."""
    found: dict[Monomial, np.ndarray] = {}
    lumps = ((w, node, 0.5 * lump.inertia * np.eye(3)) for node, own in body.lumps.items() for w, lump in own.items())
    for weight, nodes, values in chain(body.director_inertia(), lumps):
        np.add.at(found.setdefault(weight, np.zeros((body.n_nodes, 3, 3))), nodes, values)
    return found


def _of_lumps(body: Body) -> Iterator[tuple[Monomial, np.ndarray, np.ndarray]]:
    if not body.lumps:
        return
    d, per_node = body.dimension, body.node_dofs
    dofs, values = body.alone().lumped_entries()
    dofs = dofs.reshape(-1, per_node)
    for weight, own in values.items():
        own = own.reshape(-1, per_node)
        moments = np.einsum("n,ik,jl->nijkl", own[:, 0], np.eye(d, per_node), np.eye(d, per_node))
        if d == 3:
            moments += of_directors(np.einsum("n,kl->nkl", 0.5 * own[:, 3], np.eye(3)))
        yield weight, dofs, moments
