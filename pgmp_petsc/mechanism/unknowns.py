"""The unknowns of full-order models: frames of nodes, and the positions of meshes.

In the plane a node has ``(x, y, phi)``. In space every node, the frame of a group of faces or the centre of mass of a
rigid body, has the twelve natural coordinates of its frame, position and directors (`space`): rigid motion, joints and
ties are then polynomials of first and second degree (Garcia de Jalon and Bayo 1994), and nothing is singular anywhere.
After all of them come the positions of the meshes' nodes.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.bodies.body import Body
from pgmp_petsc.mechanism.mechanism import Mechanism, placed
from pgmp_petsc.mechanism.space import SPATIAL

N_POSE = SPATIAL.n_pose


class Unknowns:
    """The numbering of the unknowns of a mechanism, whose flexible bodies are on their meshes where they are solids in
    space.

    `bodies` are the mechanism's, with internal coordinates numbered as here, in 2 or 3 dimensions, with n_dofs
    unknowns.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism, self._space = mechanism, mechanism.space
        self.dimension = self._space.dimension
        self._more = self._space.n_pose - self._space.n_dofs  # unknowns of a frame than it has in the mechanism
        more = self._more * mechanism.n_nodes
        self.bodies: tuple[Body, ...] = tuple(
            body.numbered(body.first_node, body.first_internal + more) for body in mechanism.bodies
        )
        self.n_dofs = mechanism.n_dofs + more

    def frame(self, node: int) -> np.ndarray:
        """Return the unknowns of a node's frame, shape (3,) or (12,)."""
        return self._space.n_pose * node + np.arange(self._space.n_pose)

    def frames(self, q: np.ndarray) -> np.ndarray:
        """View the frames of all nodes in unknowns (n_dofs, ...), shape (n_nodes, n_pose, ...)."""
        n_nodes, n_pose = self.mechanism.n_nodes, self._space.n_pose
        return q[: n_pose * n_nodes].reshape(n_nodes, n_pose, *q.shape[1:])

    def place(self, poses: np.ndarray) -> np.ndarray:
        """Return the unknowns (n_dofs, ...) of undeformed bodies at poses (n_bodies, n_pose, ...).

        In space it is linear in the poses, so that rates of poses give those of the unknowns.
        """
        return placed(self._space, self.bodies, self.n_dofs, poses)

    def share(self, rank: int, size: int) -> range:
        """Return a rank's contiguous share of the unknowns, whole frames and whole nodes of meshes at a time."""
        first, last = (self._boundary(self.n_dofs * part // size) for part in (rank, rank + 1))
        return range(first, last)

    def in_mechanism(self, rows: range) -> range:
        """Return the numbers that a share of the unknowns has in the mechanism."""
        frames = (min(bound // self._space.n_pose, self.mechanism.n_nodes) for bound in (rows.start, rows.stop))
        return range(*(bound - self._more * n for bound, n in zip((rows.start, rows.stop), frames)))

    def of_mechanism(self, dofs: np.ndarray) -> np.ndarray:
        """Return the unknowns of positions that have given numbers in the mechanism, shape (n,)."""
        return dofs + self._more * np.minimum(dofs // self._space.n_dofs, self.mechanism.n_nodes)

    def _boundary(self, number: int) -> int:
        of_frames = self._space.n_pose * self.mechanism.n_nodes
        if number <= of_frames:
            return number // self._space.n_pose * self._space.n_pose
        if number == self.n_dofs:
            return number
        return of_frames + (number - of_frames) // self.dimension * self.dimension
