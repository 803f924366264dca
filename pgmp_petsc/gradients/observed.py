"""Outputs of a run, and their derivatives along sensitivities of the reduced coordinates.

All outputs but stresses are smooth functions of poses and of displacements in body frames. Displacements
``u = Psi(theta) delta + 1/2 chi(theta) delta delta`` are interpolated, and their derivative is exact,

    du/dp = (Psi + chi delta) S_delta + sum_k (d_k Psi delta + 1/2 d_k chi delta delta) S_theta_k;

what outputs make of them and of the rigid kinematics is differentiated along the line (theta + h S_theta, u + h du/dp)
by central differences, which cross no cells of the tables and close no loops but those that the outputs themselves ask
for (`RigidKinematics.near`). Stresses have central differences along the whole line. Where outputs are polynomials of
lengths through those of several models, ``y = sum_p L_p(l) y_p``, their derivative is ``sum_p L_p dy_p + dL_p/dl y_p``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from pgmp_petsc.models import LengthLanes, ReducedModel

# in rad or of the mechanism's size: truncation leaves 2e-9, and rounding 1e-12 of the mechanism's size
DIFFERENCE = 1e-4
OF_STRESSES = 1e-5  # of stresses, and of the parameter: their lines leave cells, where slopes of tables have corners


class ObservedChanges:
    """The outputs of one run and their derivatives.

    Parameters
    ----------
    model
        The reduced model.
    values
        Value of every parameter.
    eta
        Reduced coordinates over the run, shape (n_t, n_eta).
    """

    def __init__(self, model: ReducedModel | LengthLanes, values: Mapping[str, float], eta: np.ndarray) -> None:
        self._model, self._values = model, dict(values)
        self._members = [_Member(member, self._values, eta) for member in model.members]

    @property
    def outputs(self) -> dict[str, np.ndarray]:
        """The outputs, each of shape (n_t,)."""
        shares = self._model.shares(self._values)
        return _total(_times(share, member.outputs) for share, member in zip(shares, self._members))

    def of(self, name: str, changes: np.ndarray) -> dict[str, np.ndarray]:
        """Return the derivatives of all outputs with a parameter, each (n_t,), for those of eta, (n_t, n_eta)."""
        shares, slopes = self._model.shares(self._values), self._model.shares(self._values, name)
        parts = [_times(share, member.changes(name, changes)) for share, member in zip(shares, self._members)]
        parts += [_times(slope, member.outputs) for slope, member in zip(slopes, self._members) if slope]
        return _total(parts)


class _Member:
    """The same of one of the models whose outputs, each with its share, make those of the whole."""

    def __init__(self, model: ReducedModel, values: Mapping[str, float], eta: np.ndarray) -> None:
        self._model, self._values, self._eta = model, values, eta
        frames, self._along = model.reconstruction.along(eta)
        observed = model.outputs.observed(frames, self._stresses(eta, values))
        # the loops that this closes serve all evaluations next to it
        self._evaluate = model.outputs.near(observed)
        self.outputs = self._evaluate(observed)

    def changes(self, name: str, changes: np.ndarray) -> dict[str, np.ndarray]:
        """Return the derivatives of the outputs with a parameter."""
        model, eta = self._model, self._eta
        size = np.max(np.abs(changes) * model.terms.scale, axis=1)
        value = self._values[name]
        steps = DIFFERENCE / np.where(size > 0.0, size, 1.0)
        # what is multiplied by the parameter itself must not be taken far from its value
        of_stresses = OF_STRESSES / np.where(size > 0.0, np.maximum(size, _inverse(value)), _inverse(value) or 1.0)
        total: dict[str, np.ndarray] = {}
        frames_at = self._along(changes)
        for share in (-1.0, 1.0):
            frames, moved = frames_at(share * steps), share * of_stresses
            stresses = self._stresses(eta + moved[:, None] * changes, self._values | {name: value + moved})
            found = self._evaluate(model.outputs.observed(frames, stresses))
            for output, values in found.items():
                far = of_stresses if model.outputs.functions[output] is None else steps
                total[output] = total.get(output, 0.0) + share * values / (2.0 * far)
        return total

    def _stresses(self, eta: np.ndarray, values: Mapping[str, np.ndarray | float]) -> np.ndarray:
        return np.empty((0, len(eta))) if self._model.stresses is None else self._model.stresses.of(eta, values)


def _times(share: float, outputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {output: share * values for output, values in outputs.items()}


def _total(parts: Iterable[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    total: dict[str, np.ndarray] = {}
    for part in parts:
        total = {output: total.get(output, 0.0) + values for output, values in part.items()}
    return total


def _inverse(value: float) -> float:
    return 1.0 / abs(value) if value else 0.0
