"""Local effects: a force law on a scalar measure of two frames.

Torques and forces that keep their direction are loads (`load`); what depends on the state acts locally, on the frames
of two attachments, and is described once for the full-order and the reduced model: an `Action` is a measure, the two
attachments and a law. The full-order model gives the attachments' frames from nodal unknowns, the reduced one from its
coordinates; the compiled functions of `measures` and `laws` do the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgmp_petsc.bodies.affine import Quantity
from pgmp_petsc.effects.laws import N_PARAMETERS, STOP, depth, law
from pgmp_petsc.effects.measures import COLUMNS, measure
from pgmp_petsc.mechanism.joints import N_FRAME, N_PAIR
from pgmp_petsc.mechanism.mechanism import Attachment
from pgmp_petsc.runtime.compiled import njit


@dataclass(frozen=True, eq=False)
class Action:
    """A force law on a measure of two attachments.

    Attributes
    ----------
    effect
        Name of the effect that it belongs to.
    measure
        Kind of measure, see `measures`.
    a, b
        The attachments whose frames are measured.
    law
        Kind of law, see `laws`.
    parameters
        Of the law, in its order.
    direction
        Of the measure, (x, y); any length; not used by measures without one.
    amplitude
        Of a source at a time (s) or several; None for other laws.
    """

    effect: str
    measure: int
    a: Attachment
    b: Attachment
    law: int
    parameters: tuple[Quantity, ...]
    direction: tuple[float, float] = (1.0, 0.0)
    amplitude: Callable[[float], float] | None = None

    @property
    def sides(self) -> tuple[Attachment, Attachment]:
        """Both attachments."""
        return self.a, self.b

    @property
    def unit_direction(self) -> np.ndarray:
        """The direction with length 1, shape (2,)."""
        return np.asarray(self.direction, dtype=float) / np.hypot(*self.direction)

    @property
    def columns(self) -> tuple[int, ...]:
        """Which of the six frame unknowns move the measure: those of its kind that are not on the ground."""
        moving = [not side.on_ground for side in self.sides]
        return tuple(column for column in COLUMNS[self.measure] if moving[column // N_FRAME])

    @property
    def has_events(self) -> bool:
        """Whether the law has an edge whose crossing is to be found in time."""
        return self.law == STOP


class Actions(NamedTuple):
    """Local effects of a batch of samples, as compiled functions take them.

    Attributes
    ----------
    measures, laws
        Kinds, shape (n_actions,).
    directions
        Unit vectors, shape (n_actions, 2).
    parameters
        Of the laws, shape (n_actions, n_samples, N_PARAMETERS).
    """

    measures: np.ndarray
    laws: np.ndarray
    directions: np.ndarray
    parameters: np.ndarray


def compile_actions(actions: Sequence[Action], values: Mapping[str, np.ndarray], n_samples: int) -> Actions:
    """Evaluate the parameters of actions for samples with values of shape (n_samples,)."""
    parameters = np.zeros((len(actions), n_samples, N_PARAMETERS))
    for action, table in zip(actions, parameters):
        for k, quantity in enumerate(action.parameters):
            table[:, k] = quantity.coefficient * np.asarray(quantity.monomial.evaluate(values))
    return Actions(
        np.array([action.measure for action in actions], dtype=np.int64),
        np.array([action.law for action in actions], dtype=np.int64),
        np.array([action.unit_direction for action in actions]).reshape(-1, 2),
        parameters,
    )


def amplitudes_of(actions: Sequence[Action], time: float) -> np.ndarray:
    """Return the amplitude of every action now, 0 where it is no source, shape (n_actions,)."""
    return np.array([0.0 if action.amplitude is None else float(action.amplitude(time)) for action in actions])


@njit(cache=True, error_model="numpy")
def evaluate_actions(actions, amplitudes, z, rates, gain_v, forces, tangents, powers, stored, depths):
    """Evaluate all actions for all samples.

    Parameters
    ----------
    actions, amplitudes
        As from `compile_actions`, `amplitudes_of`.
    z, rates
        Pairs of frames and their rates, shape (n_actions, 6, n_samples).
    gain_v
        Derivative of velocities with positions in the iteration, 1/s.
    forces, tangents
        Results: force on the frame unknowns, shape (n_actions, 6, n_samples), and minus its derivative,
        shape (n_actions, 6, 6, n_samples).
    powers, stored
        Results: power of what is not elastic (W) and potential energy of what is (J), shape (n_actions, n_samples).
    depths
        Result: how deep a stop is entered (negative: how far it is), NaN for other laws, shape (n_actions, n_samples).
    """
    gradient, hessian = np.empty(N_PAIR), np.empty((N_PAIR, N_PAIR))
    for k in range(actions.measures.size):
        for sample in range(z.shape[2]):
            p = actions.parameters[k, sample]
            s = measure(actions.measures[k], actions.directions[k], z[k, :, sample], gradient, hessian)
            rate = 0.0
            for i in range(N_PAIR):
                rate += gradient[i] * rates[k, i, sample]
            force, stiffness, damping, elastic, potential = law(actions.laws[k], p, amplitudes[k], s, rate)
            powers[k, sample] = (force - elastic) * rate
            stored[k, sample] = potential
            depths[k, sample] = depth(actions.laws[k], p, s)
            for i in range(N_PAIR):
                forces[k, i, sample] = force * gradient[i]
                for j in range(N_PAIR):
                    along = (stiffness + gain_v * damping) * gradient[i] * gradient[j]
                    tangents[k, i, j, sample] = along - force * hessian[i, j]
