"""Where joints and effects hold: a point of a body, seen as a frame, or a point of the ground.

A frame is given as a pose is (`space`): ``(x, y, phi)`` in the plane, position and directors in space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pgmp_petsc.mechanism.space import Space, space_of


@dataclass(frozen=True, eq=False)
class Attachment:
    """A point of a body or of the ground."""

    body: int  # index of the body, or -1 for the ground
    node: int  # global number of the node that carries it, or -1 for the ground
    point: np.ndarray  # coordinates in the body's (or the ground's) frame, shape (d,), m
    #: from the node to the point, in the body's frame, shape (d,), m: zero but for rigid bodies, whose only node is
    #: their centre of mass
    arm: np.ndarray

    @classmethod
    def on_ground_at(cls, point: np.ndarray) -> Attachment:
        """Return a point (d,) of the ground."""
        return cls(-1, -1, point, np.zeros(len(point)))

    @property
    def space(self) -> Space:
        """Space that it moves in."""
        return space_of(len(self.point))

    @property
    def on_ground(self) -> bool:
        """Whether it is a point of the ground."""
        return self.body < 0

    @cached_property
    def at_node(self) -> bool:
        """Whether the point is the node itself."""
        return not self.arm.any()

    @property
    def dofs(self) -> np.ndarray:
        """The node's unknowns, shape (3,), in space (6,)."""
        return self.space.n_dofs * self.node + np.arange(self.space.n_dofs)

    def on_pose(self) -> Attachment:
        """Return the same point with the pose of its body as its node."""
        return self if self.on_ground else Attachment(self.body, self.body, self.point, self.point)

    def frame_of(self, node_frame: np.ndarray) -> np.ndarray:
        """Return the frame (n_pose or more, ...) from that of the node; what follows it is kept."""
        if self.at_node:
            return node_frame
        frame, n = node_frame.copy(), self.space.n_pose
        frame[:n] = self.space.place(node_frame[:n], self.arm[None])[0]
        return frame

    def natural_jet(self, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return position and directors (d (d + 1), n), with as many derivatives over time as there are of the frame of
        the node, (n_pose or more, n) each."""
        d, (frame, *changes) = self.space.dimension, parts
        z = self.space.natural(self.frame_of(frame))
        found = [z]
        for order, change in enumerate(changes, start=1):
            if d == 2:  # a director turns to the other one, and that back
                ahead, across = z[2:4], z[4:6]
                turned = [change[2] * across, -change[2] * ahead]
                if order == 2:
                    turned = [part - changes[0][2] ** 2 * axis for part, axis in zip(turned, (ahead, across))]
                change = np.concatenate([change[:2], *turned])
            else:
                change = change.copy()
            if not self.at_node:
                change[:d] += np.einsum("j,jcn->cn", self.arm, change[d:].reshape(d, d, -1))
            found.append(change)
        return found

    def frame_of_pose(self, poses: np.ndarray) -> np.ndarray:
        """Return the frame (n_pose, ...) from rigid poses of shape (n_bodies, n_pose, ...)."""
        if self.on_ground:
            return self.ground_frame(poses.shape[2:])
        return self.space.place(poses[self.body], self.point[None])[0]

    def ground_frame(self, trailing: tuple[int, ...]) -> np.ndarray:
        """Return the frame of a point of the ground, shape (n_pose, *trailing)."""
        frame = self.space.identity.copy()
        frame[: self.point.size] = self.point
        found = np.empty((frame.size, *trailing))
        found[:] = frame.reshape(-1, *(1,) * len(trailing))
        return found
