"""A basis that is continuous over the configurations.

An eigensolver returns, at every configuration, signs, an order and rotations inside clusters that mean nothing. What
does mean something is the subspace. Each basis is therefore turned, by an orthogonal matrix, to lie as close as possible
in the mass norm to its neighbour: the M-weighted orthogonal Procrustes problem

    min || B_k - V_k Q ||_M,   Q^T Q = I,    solved by the polar factor of  V_k^T M B_{k-1}.

Crossing and veering modes need no special care, because modes are not followed one by one. After a whole revolution
the basis returns turned by an orthogonal matrix H (its holonomy); the turn is taken back evenly over the revolution.
Should H contain a reflection, no continuous basis exists over one revolution, but one exists over two, in which a
single coordinate changes its sign from the first turn to the second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import schur

CLUSTER_TOLERANCE = 1e-6  # relative gap below which eigenvalues share one cluster


def procrustes(overlap: np.ndarray) -> tuple[np.ndarray, float]:
    """Solve the orthogonal Procrustes problem.

    Parameters
    ----------
    overlap
        ``V^T M B``, shape (m, m): the new vectors V against the neighbour's basis B.

    Returns
    -------
    rotation
        Orthogonal Q such that ``V Q`` is closest to B, shape (m, m).
    cosine
        Cosine of the largest angle between the two subspaces; 1 where they agree.
    """
    left, cosines, right = np.linalg.svd(overlap)
    return left @ right, float(cosines[-1])


def canonical_rotation(eigenvalues: np.ndarray, probe: np.ndarray) -> np.ndarray:
    """Fix signs and rotations inside clusters by a probe, so that the basis does not depend on the solver's run.

    Parameters
    ----------
    eigenvalues
        Ascending, shape (m,).
    probe
        ``V^T W`` with fixed vectors W, shape (m, m).

    Returns
    -------
    ndarray, shape (m, m)
        Block-diagonal orthogonal matrix, one block a cluster.
    """
    rotation = np.zeros((eigenvalues.size, eigenvalues.size))
    splits = np.flatnonzero(np.diff(eigenvalues) > CLUSTER_TOLERANCE * eigenvalues[1:]) + 1
    for cluster in np.split(np.arange(eigenvalues.size), splits):
        block = np.ix_(cluster, cluster)
        rotation[block], _ = procrustes(probe[block])
    return rotation


@dataclass(frozen=True)
class Closure:
    """How a transported basis is closed over a revolution.

    Attributes
    ----------
    frame
        Orthogonal matrix whose columns span the planes that turn, shape (m, m).
    planes
        Pairs of columns, shape (n_planes, 2).
    angles
        Angle that each plane has turned over the revolution, shape (n_planes,), rad.
    flipped
        Column that comes back reflected, or -1.
    """

    frame: np.ndarray
    planes: np.ndarray
    angles: np.ndarray
    flipped: int

    @classmethod
    def of(cls, holonomy: np.ndarray) -> Closure:
        """Split an orthogonal holonomy into plane rotations and at most one reflection."""
        form, frame = schur(holonomy, output="real")
        planes, angles, reflected = [], [], []
        column, size = 0, len(form)
        while column < size:
            if column + 1 < size and abs(form[column + 1, column]) > 1e-12:
                planes.append((column, column + 1))
                angles.append(np.arctan2(form[column + 1, column], form[column, column]))
                column += 2
            else:
                if form[column, column] < 0:
                    reflected.append(column)
                column += 1
        # two reflections are one half turn
        while len(reflected) > 1:
            planes.append((reflected.pop(), reflected.pop()))
            angles.append(np.pi)
        return cls(
            frame, np.array(planes, dtype=int).reshape(-1, 2), np.array(angles), reflected[0] if reflected else -1
        )

    def rotation(self, fraction: float) -> np.ndarray:
        """Return the matrix that the transported basis is multiplied with, a fraction of the way round.

        With a reflection the basis is expressed in `frame`, so that the reflected direction is a coordinate.
        """
        turn = np.eye(len(self.frame))
        for (i, j), angle in zip(self.planes, self.angles):
            cos, sin = np.cos(fraction * angle), np.sin(fraction * angle)
            turn[[i, i, j, j], [i, j, i, j]] = cos, sin, -sin, cos
        rotated = self.frame @ turn
        return rotated if self.flipped >= 0 else rotated @ self.frame.T
