"""Displacement fields that are linear in the place, the rigid motions among them, and moments of inertia of directors.

The fields are ordered as in `Component.fields`: the d displacements, then ``u_i = x_j`` at number ``d + d i + j``.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.bodies.beam3d import N_FRAME, at_rest

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


def directors(inertia: np.ndarray) -> np.ndarray:
    """Return ``int rho X X^T dV`` of a tensor of inertia (3, 3)."""
    return 0.5 * np.trace(inertia) * np.eye(3) - inertia


def of_directors(inertia: np.ndarray) -> np.ndarray:
    """Return the moments of nodes (n, 3, 3, 6, 6) with an inertia of their directors (n, 3, 3)."""
    gradient = at_rest()[3:N_FRAME, :6].reshape(3, 3, 6).swapaxes(0, 1)
    return np.einsum("iak,nab,jbl->nijkl", gradient, inertia, gradient, optimize=True)


def incommensurate(rows: np.ndarray, n: int, waves: np.ndarray) -> np.ndarray:
    """Return waves with given numbers (k,), from 1, over some rows (m,) of n unknowns, shape (m, k): no mode shape is
    orthogonal to all of them but by accident."""
    return np.cos(np.outer(1.0 + rows * (np.sqrt(5.0) / n), 1.0 + np.sqrt(2.0) * waves))
