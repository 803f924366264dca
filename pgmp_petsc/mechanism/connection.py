"""A joint between two attachments, in the unknowns of the nodes that carry them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.mechanism.attachment import Attachment, onto_nodes
from pgmp_petsc.mechanism.joints import N_FRAME, Joint
from pgmp_petsc.mechanism.space import PLANE


@dataclass(frozen=True, eq=False)
class Connection:
    """A named joint between two attachments, and the rows of its constraints."""

    name: str
    joint: Joint
    a: Attachment
    b: Attachment
    rows: slice

    @property
    def sides(self) -> tuple[Attachment, Attachment]:
        """Both attachments."""
        return self.a, self.b

    @property
    def linear(self) -> bool:
        """Whether the constraints are linear in nodal unknowns."""
        return self.joint.linear and self.a.at_node and self.b.at_node

    @property
    def moving_columns(self) -> np.ndarray:
        """Which of the six node unknowns there are: those of sides that are not on the ground."""
        return np.concatenate(
            [f + np.arange(N_FRAME) for f, side in zip((0, N_FRAME), self.sides) if not side.on_ground]
        )

    @property
    def dofs(self) -> np.ndarray:
        """The nodal unknowns of the sides that are not on the ground."""
        return np.concatenate([side.dofs for side in self.sides if not side.on_ground])

    def residual(self, q: np.ndarray) -> np.ndarray:
        """Return c, shape (n_constraints, ...), for q of shape (n_dofs, ...)."""
        return self.joint.residual(*self._frames(q))

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """Return the derivatives of c in the unknowns of both nodes, shape (n_constraints, 6, ...)."""
        gradient = self.joint.jacobian(*self._frames(q))
        onto_nodes(self.sides, q, gradient)
        return gradient

    def hessian(self, q: np.ndarray) -> np.ndarray:
        """Return the second derivatives of c in the unknowns of both nodes, shape (n_constraints, 6, 6, ...)."""
        frames = self._frames(q)
        gradient, hessian = self.joint.jacobian(*frames), self.joint.hessian(*frames)
        onto_nodes(self.sides, q, gradient, hessian)
        return hessian

    def on_poses(self) -> Connection:
        """Return the joint between points of rigid bodies, in the unknowns of the bodies' poses."""
        return Connection(self.name, self.joint, _on_pose(self.a), _on_pose(self.b), self.rows)

    def body_jacobian(self, poses: np.ndarray, q: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return, for each side that moves, its node's unknowns (3,) and dc in them (n_constraints, 3), in body frames.

        Parameters
        ----------
        poses
            One configuration, shape (n_bodies, 3).
        q
            The undeformed bodies there, shape (n_dofs,).
        """
        jacobian = self.jacobian(q)
        return [
            (side.dofs, jacobian[:, first : first + N_FRAME] @ PLANE.rotation(poses[side.body]))
            for first, side in zip((0, N_FRAME), self.sides)
            if not side.on_ground
        ]

    def _frames(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.a.frame_of_node(q), self.b.frame_of_node(q)


def _on_pose(side: Attachment) -> Attachment:
    """Return an attachment whose node is the pose of its body: the point is then at an arm of it."""
    return side if side.on_ground else Attachment(side.body, side.body, side.point, side.point)
