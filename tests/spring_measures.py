"""What springs measure when nodes are turned exactly: a reference for their stiffness."""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from pgmp_petsc.effects import Action
from pgmp_petsc.mechanism.mechanism import Mechanism


def measure_of(action: Action, mechanism: Mechanism, poses: np.ndarray) -> tuple[np.ndarray, Callable]:
    """Return the unknowns of the nodes at the ends of a spring, and the measure as a function of their displacements.

    Displacements, shape (n,), are in body frames from the rigid mechanism at poses (n_bodies, n_pose): places, and
    rotation vectors.
    """
    space = mechanism.space
    d, n = space.dimension, space.n_dofs
    sides = [side for side in action.sides if not side.on_ground]

    def frame(side: object, u: np.ndarray) -> np.ndarray:
        natural = space.natural(side.frame_of_pose(poses))
        if side.on_ground:
            return natural
        turn = natural[d:].reshape(d, d).T
        vector = u[d:] if d == 3 else np.array([0.0, 0.0, u[2]])
        small = Rotation.from_rotvec(vector).as_matrix()[:d, :d]
        place = natural[:d] + turn @ (u[:d] + (small - np.eye(d)) @ side.arm)
        return np.concatenate([place, (turn @ small).T.ravel()])

    def measure(u: np.ndarray) -> float:
        parts = iter(u.reshape(-1, n))
        frames = [frame(side, np.zeros(n) if side.on_ground else next(parts)) for side in action.sides]
        return float(action.statement.value(*frames))

    return np.concatenate([side.dofs for side in sides]), measure
