"""Derivatives of outputs along sensitivities of the reduced coordinates.

All outputs but stresses are smooth functions of poses and of displacements in body frames. Displacements
``u = Psi(theta) delta + 1/2 chi(theta) delta delta`` are interpolated, and their derivative is exact,

    du/dp = (Psi + chi delta) S_delta + sum_k (d_k Psi delta + 1/2 d_k chi delta delta) S_theta_k;

what outputs make of them and of the rigid kinematics is differentiated along the line (theta + h S_theta, u + h du/dp)
by central differences, which cross no cells of the tables. Stresses have central differences along the whole line.
Where outputs are polynomials of lengths through those of several models, ``y = sum_p L_p(l) y_p``, their derivative is
``sum_p L_p dy_p + dL_p/dl y_p``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from pgmp_petsc.models import LengthLanes, ReducedModel

# in rad or of the mechanism's size: truncation leaves 2e-9, and rounding 1e-12 of the mechanism's size
DIFFERENCE = 1e-4
Along = Callable[[np.ndarray], Callable[[np.ndarray], np.ndarray]]
OF_STRESSES = 1e-5  # of stresses, and of the parameter: their lines leave cells, where slopes of tables have corners


class ObservedChanges:
    """Derivatives of the outputs of one run.

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
        self._model, self._values, self._eta = model, dict(values), eta
        self._members = [(member, member.reconstruction.along(eta)) for member in model.members]

    def of(self, name: str, changes: np.ndarray) -> dict[str, np.ndarray]:
        """Return the derivatives of all outputs with a parameter, each (n_t,), for those of eta, (n_t, n_eta)."""
        shares, slopes = self._model.shares(self._values), self._model.shares(self._values, name)
        total: dict[str, np.ndarray] = {}
        for share, slope, (member, along) in zip(shares, slopes, self._members):
            found = self._of_member(member, along, name, changes)
            if slope:
                here = member.outputs.evaluate(member.observed_of(self._eta, self._values))
                found = {output: share * found[output] + slope * here[output] for output in found}
            elif share != 1.0:
                found = {output: share * found[output] for output in found}
            total = {output: total.get(output, 0.0) + found[output] for output in found}
        return total

    def _of_member(self, model: ReducedModel, along: Along, name: str, changes: np.ndarray) -> dict[str, np.ndarray]:
        eta = self._eta
        size = np.max(np.abs(changes) * model.terms.scale, axis=1)
        value = self._values[name]
        steps = DIFFERENCE / np.where(size > 0.0, size, 1.0)
        # what is multiplied by the parameter itself must not be taken far from its value
        of_stresses = OF_STRESSES / np.where(size > 0.0, np.maximum(size, _inverse(value)), _inverse(value) or 1.0)
        total: dict[str, np.ndarray] = {}
        frames_at = along(changes)
        for share in (-1.0, 1.0):
            frames, moved = frames_at(share * steps), share * of_stresses
            stresses = np.empty((0, len(eta)))
            if model.stresses is not None:
                stresses = model.stresses.of(eta + moved[:, None] * changes, self._values | {name: value + moved})
            found = model.outputs.evaluate(model.outputs.observed(frames, stresses))
            for output, values in found.items():
                far = of_stresses if model.outputs.functions[output] is None else steps
                total[output] = total.get(output, 0.0) + share * values / (2.0 * far)
        return total


def _inverse(value: float) -> float:
    return 1.0 / abs(value) if value else 0.0
