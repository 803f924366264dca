"""Forces that effects are made of, as nodal vectors in body frames: their static answers extend the reduced basis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.bodies.matrices import AffineMatrices
from pgmp_petsc.effects.action import Action
from pgmp_petsc.effects.measures import FOLLOWING, ROTATION, measure
from pgmp_petsc.mechanism.attachment import onto_nodes
from pgmp_petsc.mechanism.body_frames import to_body
from pgmp_petsc.mechanism.joints import N_FRAME, N_PAIR
from pgmp_petsc.mechanism.mechanism import Mechanism

#: Measures whose force has a constant direction in body frames.
FIXED = (ROTATION, FOLLOWING)


@dataclass(frozen=True, eq=False)
class GroundForce:
    """A unit force on a node that keeps its direction in space.

    Attributes
    ----------
    dofs
        Unknowns of the node's position, shape (d,).
    direction
        Of length 1, shape (d,).
    """

    dofs: np.ndarray
    direction: np.ndarray


@dataclass(frozen=True, eq=False)
class Patterns:
    """The forces that some effects are made of.

    Attributes
    ----------
    fixed
        Vectors that do not change with the configuration, local rows, shape (n_local, n_fixed).
    turning
        Forces that turn in body frames with the configuration; one vector each (`turning_force`).
    """

    fixed: np.ndarray
    turning: tuple[Action | GroundForce, ...] = ()

    @property
    def n(self) -> int:
        """Number of vectors at a configuration."""
        return self.fixed.shape[1] + len(self.turning)


def fixed_pattern(action: Action, matrices: AffineMatrices) -> np.ndarray:
    """Return an action's unit force in body frames, equal in any configuration: couples, or what turns with a body."""
    vector = np.zeros(len(matrices.rows))
    force = (0.0, 0.0, -1.0, 0.0, 0.0, 1.0) if action.measure == ROTATION else (0.0, 0.0, 0.0, *action.direction, 0.0)
    for column in action.columns:
        dof = action.sides[column // N_FRAME].dofs[column % N_FRAME]
        if dof in matrices.rows:
            vector[dof - matrices.rows.start] = force[column]
    return vector


def turning_force(action: Action | GroundForce, mechanism: Mechanism, poses: np.ndarray) -> np.ndarray:
    """Return a unit force on the rigid mechanism at poses (n_bodies, n_pose), in body frames, shape (n_dofs,)."""
    if isinstance(action, GroundForce):
        total = np.zeros(mechanism.n_dofs)
        total[action.dofs] = action.direction
        return to_body(mechanism, poses, total)
    q = mechanism.place(poses)
    z = np.concatenate([side.frame_of_node(q) for side in action.sides])
    gradient, hessian = np.empty(N_PAIR), np.empty((N_PAIR, N_PAIR))
    measure(action.measure, action.unit_direction, z, gradient, hessian)
    gradient = gradient[None]
    onto_nodes(action.sides, q, gradient)
    total = np.zeros(mechanism.n_dofs)
    for first, side in zip((0, N_FRAME), action.sides):
        if not side.on_ground:
            total[side.dofs] += gradient[0, first : first + N_FRAME]
    return to_body(mechanism, poses, total)
