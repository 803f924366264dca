"""Terms of second order in the deformation of a condensed body, on the ranks that share its mesh.

Foreshortening: the displacements of second order of a slender body that bends or twists.

A body that bends becomes shorter, and follows that at once (docs/components.md, foreshortening): amplitudes xi
represent displacements ``Psi (xi + 1/2 xi^T c xi)``, and

    c_ij = -S K^-1 W3[B e_i, B e_j, .],    S = s^2 (3 - 2 s),    s = K^-1 K_s,    B = 1 - S,

with the stiffness K, the part K_s of it that resists stretching, and the third derivative W3 of the strain energy at
rest. Left to the amplitudes that stretch the body, shortening would stiffen the bending, and take these amplitudes with
all their inertia and a cubic strain energy that has no lower bound.

It is the same for beams, whose W3 follows from strains (`bodies.matrices`), and for bodies of cells
(`bodies.large_deformation`). The fields answer forces at frames and inertia forces of rigid motion statically, so that
these do all of their work on c.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.bodies.affine import ByWeight, Monomial, total_at
from pgmp_petsc.bodies.assembled import AssembledBody
from pgmp_petsc.bodies.component import Component
from pgmp_petsc.bodies.large_deformation import FieldsOnCells, LargeDeformation, LongAxis, cyclic
from pgmp_petsc.bodies.solid import Solid
from pgmp_petsc.components.component_modes import elastic_modes, own_nodes

Contraction = Callable[[np.ndarray], np.ndarray]


def contraction_of(third: np.ndarray) -> Contraction:
    """Return what makes ``W3[., V e_i, V e_j]``, (n, m, m), of vectors V (n, m), from W3, symmetric, (n, n, n)."""
    return lambda vectors: np.einsum("kab,ai,bj->kij", third, vectors, vectors, optimize=True)


def foreshortening(third: Contraction, stiffness: np.ndarray, stretching: np.ndarray, fields: np.ndarray) -> np.ndarray:
    """Return c of some fields, amplitudes of shape (n, m), the second derivatives of all amplitudes, shape (n, m, m),
    1/m, the amplitude that is moved first.

    `third` is W3 of the amplitudes times pairs of vectors (see `contraction_of`), N/m2; K, positive definite, and K_s
    have shape (n, n), N/m.
    """
    n, m = fields.shape
    share = np.linalg.solve(stiffness, stretching)
    stretched = share @ share @ (3.0 * np.eye(n) - 2.0 * share)
    forces = third(fields - stretched @ fields).reshape(n, m * m)
    found = -(stretched @ np.linalg.solve(stiffness, forces)).reshape(n, m, m)
    return 0.5 * (found + found.swapaxes(1, 2))


def with_second_order(
    component: Component,
    solid: Solid | AssembledBody,
    recovery: np.ndarray,
    comm: Comm,
    nominal: Mapping[str, float],
    n_followed: int | None = None,
    all_fields: bool = True,
) -> Component:
    """Return a condensed body with its foreshortening, and with what is of second order in all of its fields, which
    takes longest, where that is wanted. Collective on `comm`.

    Nothing of it is known where the cross-section is scaled or matrices were assembled elsewhere, and no foreshortening
    of a body that is not slender. The fields are this rank's rows, shape (n_local, n); see `condense`. The
    foreshortening is that at nominal parameter values, of the slowest `n_followed` free modes; None for all.
    """
    if not solid.third_derivative_known:
        return component
    fields = FieldsOnRanks(solid, recovery, comm)
    stretching, slenderness = fields.stretching(), fields.axis.slenderness
    third = partial(fields.third_with, values=nominal)
    if all_fields:
        of_pairs = fields.of_pairs()
        whole = {weight: cyclic(part, recovery.shape[1]) for weight, part in of_pairs.items()}
        large = LargeDeformation(whole, stretching, slenderness)
        third = contraction_of(total_at(whole, nominal))
        kept = component.recovery and replace(component.recovery, curved=curved_strains(component, of_pairs, nominal))
        component = replace(component, large=large, recovery=kept)
    if not fields.axis.is_long:
        return component
    modes = elastic_modes(component, nominal)
    stiffness, resisting = (modes.T @ total_at(terms, nominal) @ modes for terms in (component.stiffness, stretching))
    n, m = len(stiffness), len(stiffness) if n_followed is None else min(n_followed, len(stiffness))
    curvature = np.zeros((n, n, n))
    curvature[:, :m, :m] = foreshortening(
        lambda vectors: np.tensordot(modes.T, third(modes @ vectors), 1), stiffness, resisting, np.eye(n)[:, :m]
    )
    return replace(component, foreshortening=curvature)


def curved_strains(component: Component, of_pairs: ByWeight, nominal: Mapping[str, float]) -> np.ndarray:
    """Return the unknowns whose linear strains stand for those of second order of pairs of fields
    (`FieldsOnCells.of_pairs`); see `Recovery`."""
    modes = elastic_modes(component, nominal)
    stiffness = modes.T @ total_at(component.stiffness, nominal) @ modes
    forces = total_at(of_pairs, nominal) @ modes
    return np.linalg.solve(stiffness, forces.T).T @ modes.T


class FieldsOnRanks:
    """The displacement fields of a condensed body on the ranks that share its mesh; methods are collective.

    The body's cross-section is not scaled; the fields are at this rank's nodes, shape (d n_nodes, n), and the axis is
    the long one.
    """

    def __init__(self, solid: Solid, recovery: np.ndarray, comm: Comm) -> None:
        mesh, nodes = solid.mesh, own_nodes(solid.mesh.n_nodes, comm)
        # every cell is evaluated once, by the rank that has its first node
        own = np.flatnonzero((mesh.cells[:, 0] >= nodes.start) & (mesh.cells[:, 0] < nodes.stop))
        wanted = np.unique(mesh.cells[own])
        fields = _fetched(wanted, nodes, recovery.reshape(len(nodes), mesh.dimension, -1), comm)
        self.axis, self._comm = LongAxis(solid), comm
        self._on_cells = FieldsOnCells(solid, own, np.searchsorted(wanted, mesh.cells[own]), fields)

    def of_pairs(self) -> dict[Monomial, np.ndarray]:
        """Return what W3 is the cyclic sum of; see `FieldsOnCells.of_pairs`."""
        return _summed(self._on_cells.of_pairs(), self._comm)

    def third_with(self, vectors: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        """Return ``W3[., v_i, v_j]``; see `FieldsOnCells.third_with`."""
        return _total(self._on_cells.third_with(vectors, values), self._comm)

    def stretching(self) -> dict[Monomial, np.ndarray]:
        """Return the stiffness against the mean strains of pieces by weight, shape (n, n)."""
        strains, moduli = self._on_cells.mean_strains(self.axis)
        strains, moduli = _total(strains, self._comm), _summed(moduli, self._comm)
        means = strains[:, 1:] / np.where(strains[:, 0] > 0.0, strains[:, 0], 1.0)[:, None]
        return {weight: means.T @ (modulus[:, None] * means) for weight, modulus in moduli.items()}


def _fetched(wanted: np.ndarray, nodes: range, own: np.ndarray, comm: Comm) -> np.ndarray:
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


def _summed(terms: dict[Monomial, np.ndarray], comm: Comm) -> dict[Monomial, np.ndarray]:
    """Return terms summed over the ranks, some of which may not have all of them."""
    shapes = {}
    for own in comm.allgather({weight: part.shape for weight, part in terms.items()}):
        shapes |= own
    return {weight: _total(terms.get(weight, np.zeros(shape)), comm) for weight, shape in sorted(shapes.items())}


def _total(part: np.ndarray, comm: Comm) -> np.ndarray:
    part = np.ascontiguousarray(part)
    total = np.empty_like(part)
    comm.Allreduce(part, total)
    return total
