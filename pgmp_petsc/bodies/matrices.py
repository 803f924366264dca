"""Sparse affine matrices ``M = sum_i w_i M_i`` and ``K = sum_i w_i K_i`` of all bodies, in body frames.

A rank assembles the rows that it owns and no others: the elements that touch them are evaluated there, those on a
border twice, and nothing has to be communicated. All terms share one nonzero pattern, so that sums and shifted
matrices never change it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
        stiffness=_assemble_terms(bodies, rows, Body.stiffness_entries, "stiffness"),
    )


def mass_of_bodies(bodies: Sequence[Body], rows: range) -> dict[Monomial, sp.csr_matrix]:
    """Assemble the given rows of all affine terms of the mass."""
    return _assemble_terms(bodies, rows, Body.mass_entries, "mass")


def axial_stiffness(bodies: Sequence[Body], rows: range, values: Mapping[str, float]) -> sp.csr_matrix:
    """Return the given rows of the part of the stiffness that resists extension, shape (n_rows, n_dofs).

    Of condensed bodies it is that against the mean strains of pieces (`large_deformation`).
    """
    return weighted_sum(_assemble_terms(bodies, rows, Body.axial_entries, "stretching"), values)


def _assemble_terms(
    bodies: Sequence[Body],
    rows: range,
    entries_of: Callable[[Body, np.ndarray], dict[Monomial, np.ndarray]],
    kind: str,
) -> dict[Monomial, sp.csr_matrix]:
    """Assemble element entries, the lumps of the mass, and the matrices of condensed bodies of one kind."""
    n_dofs = sum(body.dofs.size for body in bodies)
    row_parts, column_parts, value_parts = [], [], []
    for body in bodies:
        chosen = touching(body, rows)
        dofs = element_dofs(body.elements[chosen], body.node_dofs)
        row_parts.append(np.repeat(dofs, dofs.shape[1], axis=1).ravel())
        column_parts.append(np.tile(dofs, (1, dofs.shape[1])).ravel())
        value_parts.append({m: values.ravel() for m, values in entries_of(body, chosen).items()})
        if body.component is not None:
            dofs = body.dofs
            row_parts.append(np.repeat(dofs, dofs.size))
            column_parts.append(np.tile(dofs, dofs.size))
            value_parts.append({m: matrix.ravel() for m, matrix in body.component.terms(kind).items()})
        if body.meshed is not None:
            meshed = meshed_rows(body, rows, kind)
            first = next(iter(meshed.values()))
            row_parts.append(first.row)
            column_parts.append(first.col)
            value_parts.append({weight: matrix.data for weight, matrix in meshed.items()})
        if kind == "mass" and body.lumps:
            dofs, values = lumped_entries(body)
            row_parts.append(dofs)
            column_parts.append(dofs)
            value_parts.append(values)
    row, column = np.concatenate(row_parts), np.concatenate(column_parts)
    owned = (row >= rows.start) & (row < rows.stop)
    shape = (len(rows), n_dofs)
    terms = {}
    for monomial in dict.fromkeys(m for part in value_parts for m in part):
        # zeros of bodies without this weight stay in the pattern: it is common to all terms
        values = np.concatenate([part.get(monomial, np.zeros(r.size)) for part, r in zip(value_parts, row_parts)])
        coo = sp.coo_matrix((values[owned], (row[owned] - rows.start, column[owned])), shape=shape)
        terms[monomial] = coo.tocsr()
    return terms


def meshed_rows(body: Body, rows: range, kind: str) -> dict[Monomial, sp.coo_matrix]:
    """Return the entries of a continuum body's ``"mass"`` or ``"stiffness"`` on its mesh, for rows among all
    unknowns."""
    solid, d = body.meshed.solid, body.meshed.solid.mesh.dimension
    first = min(max(rows.start - body.first_internal, 0), solid.n_dofs)
    last = min(max(rows.stop - body.first_internal, 0), solid.n_dofs)
    nodes = range(first // d, -(-last // d))
    found = {}
    for weight, matrix in getattr(solid, kind)(nodes).items():
        coo = matrix.tocoo()
        shape = (body.first_internal + solid.n_dofs,) * 2
        place = (body.first_internal + d * nodes.start + coo.row, body.first_internal + coo.col)
        found[weight] = sp.coo_matrix((coo.data, place), shape=shape)
    return found


def lumped_entries(body: Body) -> tuple[np.ndarray, dict[Monomial, np.ndarray]]:
    """Return the unknowns of a body's nodes with masses of their own, and these masses by weight, each (n_lumped,)."""
    nodes = np.array(list(body.lumps), dtype=int)
    weights = {weight for lumps in body.lumps.values() for weight in lumps}
    n, d = body.node_dofs, body.mesh.nodes.shape[1]
    values = {weight: np.zeros((nodes.size, n)) for weight in sorted(weights)}
    for row, lumps in enumerate(body.lumps.values()):
        for weight, lump in lumps.items():
            values[weight][row, :d], values[weight][row, d:] = lump.mass, lump.inertia
    dofs = n * (body.first_node + nodes)[:, None] + np.arange(n)
    return dofs.ravel(), {weight: part.ravel() for weight, part in values.items()}


def touching(body: Body, rows: range) -> np.ndarray:
    """Return the numbers of the body's elements that touch the given rows, shape (n_chosen,)."""
    if body.is_continuum:
        return np.zeros(0, dtype=int)
    first = body.node_dofs * body.elements
    touches = (first < rows.stop) & (first + body.node_dofs > rows.start)
    return np.flatnonzero(touches.any(axis=1))


def element_dofs(elements: np.ndarray, per_node: int = DOFS_PER_NODE) -> np.ndarray:
    """Return the unknowns of two-node elements, shape (n_elements, 2 per_node)."""
    return (per_node * elements[:, :, None] + np.arange(per_node)).reshape(len(elements), 2 * per_node)
