"""Local effects: a force law on a statement about two frames.

Torques and forces that keep their direction are loads (`load`); what depends on the state acts locally, on the frames
of two attachments, and is described once for the full-order and the reduced model, in the plane and in space: an
`Action` is a statement s (`mechanism.statements`), the two attachments and a law F(t, s, s') (`laws`). With the
statement's gradient g the frames feel ``F g``, and the power is ``F s'`` in every model alike. The full-order model
gives the frames from its unknowns, the reduced one from its coordinates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.laws import N_PARAMETERS, SPRING_DAMPER, STOP
from pgmp_petsc.mechanism.mechanism import Attachment
from pgmp_petsc.mechanism.spatial_attachment import SpatialAttachment
from pgmp_petsc.mechanism.statements import Statement


@dataclass(frozen=True, eq=False)
class Action:
    """A force law on a statement about two attachments.

    Attributes
    ----------
    effect
        Name of the effect that it belongs to.
    statement
        What is measured.
    a, b
        The attachments whose frames are measured.
    law
        Kind of law, see `laws`.
    parameters
        Of the law, in its order.
    amplitude
        Of a source at a time (s) or several; None for other laws.
    coordinate
        Number of the coordinate that an angle is, -1 where it is none.
    """

    effect: str
    statement: Statement
    a: Attachment | SpatialAttachment
    b: Attachment | SpatialAttachment
    law: int
    parameters: tuple[Quantity, ...]
    amplitude: Callable[[float], float] | None = None
    coordinate: int = -1

    @property
    def sides(self) -> tuple[Attachment | SpatialAttachment, Attachment | SpatialAttachment]:
        """Both attachments."""
        return self.a, self.b

    @property
    def has_events(self) -> bool:
        """Whether the law has an edge whose crossing is to be found in time."""
        return self.law == STOP

    @property
    def is_spring(self) -> bool:
        """Whether the law is linear and has a stiffness, whatever its damping."""
        return self.law == SPRING_DAMPER and self.parameters[0].coefficient != 0.0


class Actions(NamedTuple):
    """Local effects of a batch of samples, as compiled functions take them.

    Attributes
    ----------
    kinds, laws
        Of statements and of laws, shape (n_actions,).
    axes
        Directions of the statements, shape (n_actions, 3, d).
    arms
        From the nodes of both sides to the points, in the frames of the nodes, shape (n_actions, 2, d), m.
    ground
        Frames of sides on the ground, zero for others, shape (n_actions, 2 d (d + 1)).
    on_ground
        Which sides are, shape (n_actions, 2).
    parameters
        Of the laws, shape (n_actions, n_samples, N_PARAMETERS).
    """

    kinds: np.ndarray
    laws: np.ndarray
    axes: np.ndarray
    arms: np.ndarray
    ground: np.ndarray
    on_ground: np.ndarray
    parameters: np.ndarray


def compile_actions(
    actions: Sequence[Action], values: Mapping[str, np.ndarray], n_samples: int, dimension: int
) -> Actions:
    """Evaluate the parameters of actions in 2 or 3 dimensions for samples with values of shape (n_samples,)."""
    parameters = np.zeros((len(actions), n_samples, N_PARAMETERS))
    for action, table in zip(actions, parameters):
        for k, quantity in enumerate(action.parameters):
            table[:, k] = quantity.coefficient * np.asarray(quantity.monomial.evaluate(values))
    sides = [side for action in actions for side in action.sides]
    n_frame = dimension * (dimension + 1)
    grounded = np.zeros((len(sides), n_frame))
    for side, frame in zip(sides, grounded):
        if side.on_ground:
            frame[:] = np.concatenate([side.point, np.eye(dimension).ravel()])
    return Actions(
        np.array([action.statement.kind for action in actions], dtype=np.int64),
        np.array([action.law for action in actions], dtype=np.int64),
        np.array([action.statement.axes for action in actions]).reshape(-1, 3, dimension),
        np.array([side.arm for side in sides]).reshape(-1, 2, dimension),
        grounded.reshape(-1, 2 * n_frame),
        np.array([side.on_ground for side in sides], dtype=bool).reshape(-1, 2),
        parameters,
    )


def amplitudes_of(actions: Sequence[Action], time: float) -> np.ndarray:
    """Return the amplitude of every action now, 0 where it is no source, shape (n_actions,)."""
    return np.array([0.0 if action.amplitude is None else float(action.amplitude(time)) for action in actions])
