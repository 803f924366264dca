"""Elastic modes of a free body in its own frame: ``(K - omega^2 M) phi = 0`` beyond its rigid motions.

The frames of a body on a mesh have neither mass nor stiffness of their own: its modes are those of its mesh.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.bodies.matrices import assemble, weighted_sum
from pgmp_petsc.runtime.errors import InputError

DENSE = 300  # unknowns up to which a dense solver is faster


def free_modes(
    body: Body, values: Mapping[str, float], n_modes: int, entry: str
) -> tuple[np.ndarray, np.ndarray, sp.csr_matrix]:
    """Compute the first elastic modes of a body.

    Parameters
    ----------
    body
        A flexible body.
    values
        Parameter values.
    n_modes
        Number of modes.
    entry
        The scene entry that asks for them, for messages.

    Returns
    -------
    omega
        Angular frequencies, shape (n_modes,), rad/s.
    phi
        M-orthonormal modes in the body's frame, shape (n_own, n_modes), at the unknowns `own_unknowns`.
    mass
        M, shape (n_own, n_own).

    Raises
    ------
    InputError
        If the mesh has fewer modes.
    """
    alone = body.alone()
    own = own_unknowns(alone)
    n_dofs, n_rigid = own.size, alone.node_dofs  # as many rigid motions as a node has unknowns
    if n_modes > n_dofs - n_rigid:
        raise InputError(f"{entry}: {n_modes} modes of {body.name} are asked for; its mesh has {n_dofs - n_rigid}")
    matrices = assemble([alone], range(alone.dofs.size))
    mass, stiffness = (weighted_sum(terms, values)[own][:, own] for terms in (matrices.mass, matrices.stiffness))
    wanted = n_rigid + n_modes
    if n_dofs <= DENSE or wanted >= n_dofs - 1:
        squares, vectors = eigh(stiffness.toarray(), mass.toarray(), subset_by_index=(0, wanted - 1))
    else:
        # a small negative shift keeps the matrix regular in spite of the rigid motions
        shift = -1e-9 * stiffness.diagonal().sum() / mass.diagonal().sum()
        start = np.random.default_rng(0).standard_normal(n_dofs)
        squares, vectors = eigsh(stiffness.tocsc(), wanted, mass.tocsc(), sigma=shift, v0=start)
        order = np.argsort(squares)
        squares, vectors = squares[order], vectors[:, order]
    return np.sqrt(squares[n_rigid:]), vectors[:, n_rigid:], mass


def own_unknowns(body: Body) -> np.ndarray:
    """Return the unknowns of a body that have mass and stiffness, shape (n_own,)."""
    return body.dofs if body.meshed is None else body.dofs[body.node_dofs * body.n_nodes :]
