"""What ties the frame of a group of faces to the mesh: mean position and mean rotation, see `bodies.face_frame`.

With the frame's unknowns (X, Y, phi), the nodes' positions x_i, their weights w_i and arms a_i,

    X - sum_i w_i x_i = 0,    -1/h sum_i (R(phi) a_i) x x_i = 0,    h = int X'.X' dA / A,

the second of which is ``phi`` less the faces' mean rotation to first order, and holds for any rotation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.body import DOFS_PER_NODE, Body
from pgmp_petsc.mechanism.attachment import rotate

N_TIES = 3


@dataclass(frozen=True, eq=False)
class FrameTie:
    """The three constraints between a frame and the nodes of its faces.

    Attributes
    ----------
    frame
        The frame's unknowns, shape (3,).
    nodes
        The positions of the nodes among all unknowns, shape (n, 2).
    weights, arms
        As in `FaceFrame`; the arms over h, 1/m.
    rows
        Numbers of the constraints among all.
    """

    frame: np.ndarray
    nodes: np.ndarray
    weights: np.ndarray
    arms: np.ndarray
    rows: slice

    @property
    def dofs(self) -> np.ndarray:
        """Unknowns that are tied: the frame's, then the nodes', shape (3 + 2 n,)."""
        return np.concatenate([self.frame, self.nodes.ravel()])

    def residual(self, q: np.ndarray) -> np.ndarray:
        """Return c, shape (3, ...), for q of shape (n_dofs, ...): m, m, rad."""
        x, y = np.moveaxis(q[self.nodes], 1, 0)
        means = np.tensordot(self.weights, np.stack([x, y], axis=1), axes=1)
        ax, ay = self._turned(q)
        return np.concatenate([q[self.frame[:2]] - means, -np.sum(ax * y - ay * x, axis=0)[None]])

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return dc/d(dofs), shape (3, 3 + 2 n, ...)."""
        x, y = np.moveaxis(q[self.nodes], 1, 0)
        ax, ay = self._turned(q)
        n = len(self.nodes)
        result = np.zeros((N_TIES, DOFS_PER_NODE + 2 * n, *q.shape[1:]))
        result[0, 0] = result[1, 1] = 1.0
        for axis in range(2):
            result[axis, DOFS_PER_NODE + axis :: 2] = -self.weights.reshape(-1, *(1,) * (q.ndim - 1))
        result[2, DOFS_PER_NODE::2], result[2, DOFS_PER_NODE + 1 :: 2] = ay, -ax
        # the arms turn to (-ay, ax)
        result[2, 2] = np.sum(ay * y + ax * x, axis=0)
        return result

    def curvature(self, q: np.ndarray, multipliers: np.ndarray) -> np.ndarray:
        """Return ``sum lambda d2c/dq2`` between phi and all of `dofs`, shape (3 + 2 n, ...); multipliers (3, ...)."""
        x, y = np.moveaxis(q[self.nodes], 1, 0)
        ax, ay = self._turned(q)
        result = np.zeros((DOFS_PER_NODE + 2 * len(self.nodes), *q.shape[1:]))
        result[2] = multipliers[2] * np.sum(ax * y - ay * x, axis=0)
        result[DOFS_PER_NODE::2], result[DOFS_PER_NODE + 1 :: 2] = multipliers[2] * ax, multipliers[2] * ay
        return result

    def drift(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return ``(dC/dt) v``, shape (3, ...)."""
        one = np.zeros((N_TIES, *q.shape[1:]))
        one[2] = 1.0
        curvature, rates, spin = self.curvature(q, one), v[self.dofs], v[self.frame[2]]
        result = np.zeros((N_TIES, *q.shape[1:]))
        result[2] = spin * (2.0 * np.sum(curvature * rates, axis=0) - curvature[2] * spin)
        return result

    def _turned(self, q: np.ndarray) -> np.ndarray:
        """Return the arms turned by phi, shape (2, n, ...)."""
        angle = q[self.frame[2]]
        arms = self.arms.T.reshape(2, -1, *(1,) * np.ndim(angle))
        return rotate(angle, arms)


def frame_ties(bodies: tuple[Body, ...], first_row: int) -> Iterator[FrameTie]:
    """Yield the ties of all frames of bodies on meshes, their rows from first_row on."""
    row = first_row
    for body in bodies:
        if body.meshed is None:
            continue
        for number, frame in enumerate(body.meshed.frames.values()):
            unknowns = DOFS_PER_NODE * (body.first_node + number) + np.arange(DOFS_PER_NODE)
            nodes = body.first_internal + 2 * frame.nodes[:, None] + np.arange(2)
            arms = frame.arms / frame.inertia[0, 0]
            yield FrameTie(unknowns, nodes, frame.weights, arms, slice(row, row + N_TIES))
            row += N_TIES
