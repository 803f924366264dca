"""Poses of a rigid mechanism with many coordinates: Newton's method along straight lines from where it is assembled.

A grid over three coordinates or more would have too many configurations to follow the assembly branch on; a run visits
only a line of them. Each configuration is reached from the assembled one by steps of its own, so that no other has a
part in its digits.
"""

from __future__ import annotations

import numpy as np

from pgmp_petsc.mechanism.closure import LoopClosure

LONGEST = (
    0.1  # rad of a step: from the rates at its start, Newton's method closes the loops in two or three corrections
)


class Walk:
    """Where a mechanism is assembled, and the way to other configurations.

    Parameters
    ----------
    closure
        Loop closure of the mechanism.
    theta
        Configuration where it is assembled, shape (n_theta,), rad.
    poses
        Its poses there, shape (n_bodies, n_pose, 1).
    """

    def __init__(self, closure: LoopClosure, theta: np.ndarray, poses: np.ndarray) -> None:
        self._closure, self._theta, self._poses = closure, theta, poses

    def poses(self, theta: np.ndarray) -> np.ndarray:
        """Return the poses (n_bodies, n_pose, n) at configurations (n, n_theta).

        Raises
        ------
        InputError
            If the mechanism cannot be closed somewhere on the way.
        """
        away = theta - self._theta
        n_steps = np.ceil(np.max(np.abs(away), axis=1, initial=0.0) / LONGEST).astype(int)
        poses = np.repeat(self._poses, len(theta), axis=2)
        for step in range(1, int(n_steps.max(initial=0)) + 1):
            going = np.flatnonzero(step <= n_steps)
            share = 1.0 / n_steps[going]
            along = self._closure.rates(poses[..., going])
            moved = np.einsum("bpkn,nk->bpn", along, share[:, None] * away[going])
            places = self._theta + (step * share)[:, None] * away[going]
            poses[..., going] = self._closure.close(poses[..., going] + moved, places)
        return poses
