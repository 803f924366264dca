"""Whole turns of a joint's angle in space, where directors alone tell an angle up to turns.

The angle of a coordinate is the one that is nearest to the coordinate. That of another joint depends on where the
mechanism stands: it is the one nearest to a line over the coordinates,

    offset + sum_k slope_k theta_k,

which stays as close as can be to the joint's angle on the rigid mechanism, followed over the range. The slope of a
periodic coordinate is the number of turns in one of its own, so that the angle counts for as long as the mechanism
turns. No state has to remember turns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.mechanism.joints import Connection
from pgmp_petsc.mechanism.kinematics import RigidKinematics


@dataclass(frozen=True, eq=False)
class JointTurns:
    """The line that a joint's angle is near to: offset, rad, and slopes (n_theta,)."""

    offset: float
    slopes: np.ndarray

    @classmethod
    def of(cls, connection: Connection, kinematics: RigidKinematics, start: np.ndarray) -> JointTurns:
        """Return that of a joint, whose angle is in (-pi, pi] where the mechanism starts, theta (n_theta,).

        With more than two coordinates, over which no branch is followed, the angle of a joint that is none of them
        stays in (-pi, pi].
        """
        n = kinematics.n_coordinates
        for k, coordinate in enumerate(kinematics.coordinates):
            if coordinate.statement is connection.angle:
                return cls(0.0, np.eye(n)[k])
        if kinematics.branch is None:
            return cls(0.0, np.zeros(n))

        def measured(poses: np.ndarray) -> np.ndarray:
            sides = (side.frame_of_pose(poses) for side in connection.sides)
            return kinematics.mechanism.space.angle(connection.angle, *sides)

        axes = kinematics.branch.axes
        angles = measured(np.moveaxis(kinematics.branch.poses, 0, -1)).reshape([axis.size for axis in axes])
        for k in range(n):
            angles = np.unwrap(angles, axis=k)
        theta = np.meshgrid(*axes, indexing="ij")
        slopes = np.zeros(n)
        for k, (axis, coordinate) in enumerate(zip(axes, kinematics.coordinates)):
            rise = np.mean(np.take(angles, -1, axis=k) - np.take(angles, 0, axis=k))
            turns = np.rint(rise / (2.0 * np.pi)) * 2.0 * np.pi if coordinate.periodic else rise
            slopes[k] = turns / (axis[-1] - axis[0])
        rest = angles - sum(slope * part for slope, part in zip(slopes, theta))
        offset = 0.5 * (rest.max() + rest.min())
        first = measured(kinematics.poses(start[None]))[0]
        whole = np.rint((offset + slopes @ start - first) / (2.0 * np.pi))
        return cls(float(offset - 2.0 * np.pi * whole), slopes)

    def near(self, theta: np.ndarray) -> np.ndarray:
        """Return what the angle is near to, shape (...), at coordinates (n_theta, ...), rad."""
        return self.offset + np.tensordot(self.slopes, theta, axes=1)
