"""Moments of inertia of a body's fields: what its mass matrix does to fields that are turned.

The points of a body have displacements whose component i is ``f_i = C_i y`` in its unknowns y: of a meshed body its
nodes', of beams those of natural coordinates, in which a node turns with its directors (`beam3d`). The mass m is the
same for every component, so that with the moments ``P_ij = C_i^T m C_j`` a matrix W that turns all points, in the
body's frame, has

    (W f)^T m g = y_f^T (sum_ij W_ji P_ij) y_g,        M = sum_i P_ii (+ rotary inertia in the plane, which W leaves).

Rotations in space are rotation vectors phi. Directors are ``exp(phi) e_k``, and their part of second order moves the
section's mass: with ``J_kl`` the inertia of the directors at a node, accelerations ``A e_k`` do on it the work

    sum_kl J_kl (A e_l) . (1/2 phi x (phi x e_k)).

Displacement fields that are linear in the place, and the rigid motions among them.

The fields are ordered as in `Component.fields`: the d displacements, then ``u_i = x_j`` at number ``d + d i + j``.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from pgmp_petsc.bodies.affine import Monomial
from pgmp_petsc.bodies.beam3d import N_FRAME, at_rest

if TYPE_CHECKING:
    from pgmp_petsc.bodies.body import Body

# the axes (from, to) that each rotation turns into each other, in the order of the rotations
TURNS = {2: ((0, 1),), 3: ((1, 2), (2, 0), (0, 1))}


def linear_fields(places: np.ndarray) -> np.ndarray:
    """Return the linear displacement fields at places.

    Parameters
    ----------
    places
        Shape (n, d), m.

    Returns
    -------
    ndarray, shape (n d, d (d + 1))
    """
    n, d = places.shape
    fields = np.zeros((n, d, d + d * d))
    for i in range(d):
        fields[:, i, i] = 1.0
        fields[:, i, d + d * i : d + d * (i + 1)] = places
    return fields.reshape(n * d, d + d * d)


def rigid_motions(centre: np.ndarray) -> np.ndarray:
    """Return unit displacements and rotations about a centre (d,) as linear fields, shape (d (d + 1), n_rigid)."""
    d = centre.size
    fields = np.zeros((d + d * d, d + len(TURNS[d])))
    fields[:d, :d] = np.eye(d)
    for column, (i, j) in enumerate(TURNS[d], d):
        # from axis i to axis j: u_j = x_i - c_i, u_i = -(x_j - c_j)
        fields[d + d * j + i, column], fields[d + d * i + j, column] = 1.0, -1.0
        fields[j, column], fields[i, column] = -centre[i], centre[j]
    return fields


Moments = dict[tuple[int, int], sp.csr_matrix]


def inertia_moments(body: Body) -> dict[Monomial, Moments]:
    """Return P_ij of a body that is not meshed, by weight, shape (n, n) in the order of its unknowns."""
    found: dict[Monomial, Moments] = {}
    d, n = body.dimension, body.dofs.size
    for weight, dofs, values in chain(body.moments(), _of_lumps(body)):
        own = found.setdefault(weight, {(i, j): sp.csr_matrix((n, n)) for i in range(d) for j in range(d)})
        rows, columns = np.repeat(dofs, dofs.shape[1], axis=1).ravel(), np.tile(dofs, dofs.shape[1]).ravel()
        for i in range(d):
            for j in range(d):
                own[i, j] = own[i, j] + sp.csr_matrix((values[:, i, j].ravel(), (rows, columns)), shape=(n, n))
    return found


def director_inertia(body: Body) -> dict[Monomial, np.ndarray]:
    """Return J of the nodes of a body in space by weight, shape (n_nodes, 3, 3), kg m2; none of condensed ones."""
    found: dict[Monomial, np.ndarray] = {}
    lumps = ((w, node, 0.5 * lump.inertia * np.eye(3)) for node, own in body.lumps.items() for w, lump in own.items())
    for weight, nodes, values in chain(body.director_inertia(), lumps):
        np.add.at(found.setdefault(weight, np.zeros((body.n_nodes, 3, 3))), nodes, values)
    return found


def turned(moments: Moments, turn: np.ndarray) -> sp.csr_matrix:
    """Return ``sum_ij W_ij P_ij``, which ``f^T m (W g)`` is made of, for W of shape (d, d)."""
    return sum(turn[i, j] * moment for (i, j), moment in moments.items() if turn[i, j]) + 0.0 * moments[0, 0]


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


def directors(inertia: np.ndarray) -> np.ndarray:
    """Return ``int rho X X^T dV`` of a tensor of inertia (3, 3)."""
    return 0.5 * np.trace(inertia) * np.eye(3) - inertia


def of_directors(inertia: np.ndarray) -> np.ndarray:
    """Return the moments of nodes (n, 3, 3, 6, 6) with an inertia of their directors (n, 3, 3)."""
    gradient = at_rest()[3:N_FRAME, :6].reshape(3, 3, 6).swapaxes(0, 1)
    return np.einsum("iak,nab,jbl->nijkl", gradient, inertia, gradient, optimize=True)
