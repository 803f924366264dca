"""Local effects: a force law on a statement about two frames.

Torques and forces that keep their direction are loads (`load`); what depends on the state acts locally, on the frames
of two attachments, and is described once for the full-order and the reduced model, in the plane and in space: an
`Action` is a statement s (`mechanism.statements`), the two attachments and a law F(t, s, s') (`laws`). With the
statement's gradient g the frames feel ``F g``, and the power is ``F s'`` in every model alike. The full-order model
gives the frames from its unknowns, the reduced one from its coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.laws import N_PARAMETERS, SPRING_DAMPER, STOP
from pgmp_petsc.effects.time_function import TimeFunction
from pgmp_petsc.mechanism.attachment import Attachment
from pgmp_petsc.mechanism.node_statements import NodeStatements
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
        Of a source over time, s; None for other laws.
    coordinate
        Number of the coordinate that an angle is, -1 where it is none.
    """

    effect: str
    statement: Statement
    a: Attachment
    b: Attachment
    law: int
    parameters: tuple[Quantity, ...]
    amplitude: TimeFunction | None = None
    coordinate: int = -1

    @property
    def sides(self) -> tuple[Attachment, Attachment]:
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
    statements
        What they measure.
    laws
        Kinds of laws, shape (n_actions,).
    parameters
        Of the laws, shape (n_actions, n_samples, N_PARAMETERS).
    """

    statements: NodeStatements
    laws: np.ndarray
    parameters: np.ndarray


def compile_actions(
    actions: Sequence[Action], values: Mapping[str, np.ndarray], n_samples: int, dimension: int
) -> Actions:
    """Evaluate the parameters of actions in 2 or 3 dimensions for samples with values of shape (n_samples,)."""
    parameters = np.zeros((len(actions), n_samples, N_PARAMETERS))
    for action, table in zip(actions, parameters):
        for k, quantity in enumerate(action.parameters):
            table[:, k] = quantity.coefficient * np.asarray(quantity.monomial.evaluate(values))
    return Actions(
        NodeStatements.of([action.statement for action in actions], [action.sides for action in actions], dimension),
        np.array([action.law for action in actions], dtype=np.int64),
        parameters,
    )


def amplitudes_over(actions: Sequence[Action], times: np.ndarray) -> np.ndarray:
    """Return the amplitudes of actions at times (n,), 0 where one is no source, shape (n, n_actions)."""
    result = np.zeros((times.size, len(actions)))
    for column, action in zip(result.T, actions):
        if action.amplitude is not None:
            column[:] = action.amplitude(times)
    return result
