"""What is of second order in the deformation of a condensed body, on the ranks that share its mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.large_deformation import FieldsOnCells, LargeDeformation, LongAxis, stretching_of
from pgmp_petsc.bodies.solid import Solid

if TYPE_CHECKING:
    from mpi4py import MPI


def large_deformation(solid: Solid, nodes: range, recovery: np.ndarray, comm: MPI.Comm) -> LargeDeformation:
    """Evaluate the terms of a body's displacement fields. Collective on `comm`.

    Parameters
    ----------
    solid
        The body; its cross-section is not scaled.
    nodes
        This rank's nodes.
    recovery
        The fields there, shape (d n_nodes, n).
    """
    mesh, axis = solid.mesh, LongAxis(solid)
    # every cell is evaluated once, by the rank that has its first node
    own = np.flatnonzero((mesh.cells[:, 0] >= nodes.start) & (mesh.cells[:, 0] < nodes.stop))
    wanted = np.unique(mesh.cells[own])
    fields = _fetched(wanted, nodes, recovery.reshape(len(nodes), mesh.dimension, -1), comm)
    on_cells = FieldsOnCells(solid, own, np.searchsorted(wanted, mesh.cells[own]), fields)
    strains, moduli = on_cells.mean_strains(axis)
    return LargeDeformation(
        _summed(on_cells.third(), comm),
        stretching_of(_total(strains, comm), _summed(moduli, comm)),
        axis.slenderness,
    )


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
