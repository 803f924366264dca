"""What is of second order in the deformation of a condensed body, on the ranks that share its mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.large_deformation import FieldsOnCells, LargeDeformation, LongAxis, stretching_of
from pgmp_petsc.bodies.assembled import AssembledBody
from pgmp_petsc.bodies.solid import Solid
from pgmp_petsc.components.component_modes import own_nodes, weighted_sum_dense
from pgmp_petsc.components.floating_component import elastic_modes
from pgmp_petsc.components.foreshortening import contraction_of, foreshortening

if TYPE_CHECKING:
    from mpi4py import MPI


def with_second_order(
    component: Component,
    solid: Solid | AssembledBody,
    recovery: np.ndarray,
    comm: MPI.Comm,
    nominal: Mapping[str, float],
    n_followed: int | None = None,
    all_fields: bool = True,
) -> Component:
    """Return a condensed body with its foreshortening, and with what is of second order in all of its fields where that
    is wanted. Collective on `comm`.

    Nothing of it is known where the cross-section is scaled or matrices were assembled elsewhere, and no foreshortening
    of a body that is not slender.

    Parameters
    ----------
    component, solid, recovery
        The body, its mesh, and this rank's rows of the fields, shape (n_local, n); see `condense`.
    nominal
        Parameter values for the foreshortening.
    n_followed
        Free modes whose foreshortening is followed, the slowest ones; None for all.
    all_fields
        Whether it is wanted of all fields: that takes longest.
    """
    if not solid.third_derivative_known:
        return component
    fields = FieldsOnRanks(solid, recovery, comm)
    stretching, slenderness = fields.stretching(), fields.axis.slenderness
    third = partial(fields.third_with, values=nominal)
    if all_fields:
        large = LargeDeformation(fields.third(), stretching, slenderness)
        component, third = replace(component, large=large), contraction_of(weighted_sum_dense(large.third, nominal))
    if not fields.axis.is_long:
        return component
    modes = elastic_modes(component, nominal)
    stiffness, resisting = (
        modes.T @ weighted_sum_dense(terms, nominal) @ modes for terms in (component.stiffness, stretching)
    )
    followed = foreshortening(
        lambda vectors: np.tensordot(modes.T, third(modes @ vectors), 1), stiffness, resisting, n_followed
    )
    return replace(component, foreshortening=followed)


class FieldsOnRanks:
    """The displacement fields of a condensed body on the ranks that share its mesh; methods are collective.

    Parameters
    ----------
    solid
        The body; its cross-section is not scaled.
    recovery
        The fields at this rank's nodes, shape (d n_nodes, n).
    comm
        The ranks.

    Attributes
    ----------
    axis
        The body's long axis.
    """

    def __init__(self, solid: Solid, recovery: np.ndarray, comm: MPI.Comm) -> None:
        mesh, nodes = solid.mesh, own_nodes(solid.mesh.n_nodes, comm)
        # every cell is evaluated once, by the rank that has its first node
        own = np.flatnonzero((mesh.cells[:, 0] >= nodes.start) & (mesh.cells[:, 0] < nodes.stop))
        wanted = np.unique(mesh.cells[own])
        fields = _fetched(wanted, nodes, recovery.reshape(len(nodes), mesh.dimension, -1), comm)
        self.axis, self._comm = LongAxis(solid), comm
        self._on_cells = FieldsOnCells(solid, own, np.searchsorted(wanted, mesh.cells[own]), fields)

    def third(self) -> dict[Monomial, np.ndarray]:
        """Return W3 by weight, shape (n, n, n)."""
        return _summed(self._on_cells.third(), self._comm)

    def third_with(self, vectors: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        """Return ``W3[., v_i, v_j]``; see `FieldsOnCells.third_with`."""
        return _total(self._on_cells.third_with(vectors, values), self._comm)

    def stretching(self) -> dict[Monomial, np.ndarray]:
        """Return the stiffness against the mean strains of pieces by weight, shape (n, n)."""
        strains, moduli = self._on_cells.mean_strains(self.axis)
        return stretching_of(_total(strains, self._comm), _summed(moduli, self._comm))


def _fetched(wanted: np.ndarray, nodes: range, own: np.ndarray, comm: MPI.Comm) -> np.ndarray:
    """Return the rows of wanted nodes (sorted) from the ranks that have them, rows (n_own, ...) of each."""
    firsts = np.array(comm.allgather(nodes.start))
    owner = np.searchsorted(firsts, wanted, side="right") - 1
    # ranks without nodes start where the next one does: the last of them has the node
    asked = comm.alltoall([wanted[owner == rank] for rank in range(comm.size)])
    given = comm.alltoall([own[numbers - nodes.start] for numbers in asked])
    result = np.empty((wanted.size, *own.shape[1:]))
    for rank, rows in enumerate(given):
        result[owner == rank] = rows
    return result


def _summed(terms: dict[Monomial, np.ndarray], comm: MPI.Comm) -> dict[Monomial, np.ndarray]:
    """Return terms summed over the ranks, some of which may not have all of them."""
    shapes = {}
    for own in comm.allgather({weight: part.shape for weight, part in terms.items()}):
        shapes |= own
    return {weight: _total(terms.get(weight, np.zeros(shape)), comm) for weight, shape in sorted(shapes.items())}


def _total(part: np.ndarray, comm: MPI.Comm) -> np.ndarray:
    from mpi4py import MPI

    part = np.ascontiguousarray(part)
    total = np.empty_like(part)
    comm.Allreduce(part, total, op=MPI.SUM)
    return total
