"""Derivatives of outputs along sensitivities of the reduced coordinates.

All outputs but stresses are smooth functions of poses and of displacements in body frames. Displacements
``u = Psi(theta) delta + 1/2 chi(theta) delta delta`` are interpolated, and their derivative is exact,

    du/dp = (Psi + chi delta) S_delta + sum_k (d_k Psi delta + 1/2 d_k chi delta delta) S_theta_k;

what outputs make of them and of the rigid kinematics is differentiated along the line (theta + h S_theta, u + h du/dp)
by central differences, which cross no cells of the tables. Stresses have central differences along the whole line.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pgmp_petsc.models import ReducedModel

# in rad or of the mechanism's size: truncation leaves 2e-9, and rounding 1e-12 of the mechanism's size
DIFFERENCE = 1e-4
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

    def __init__(self, model: ReducedModel, values: Mapping[str, float], eta: np.ndarray) -> None:
        self._model, self._values, self._eta = model, dict(values), eta
        self._along = model.reconstruction.along(eta)

    def of(self, name: str, changes: np.ndarray) -> dict[str, np.ndarray]:
        """Return the derivatives of all outputs with a parameter, each (n_t,), for those of eta, (n_t, n_eta)."""
        model, eta = self._model, self._eta
        size = np.max(np.abs(changes) * model.terms.scale, axis=1)
        value = self._values[name]
        steps = DIFFERENCE / np.where(size > 0.0, size, 1.0)
        # what is multiplied by the parameter itself must not be taken far from its value
        of_stresses = OF_STRESSES / np.where(size > 0.0, np.maximum(size, _inverse(value)), _inverse(value) or 1.0)
        total: dict[str, np.ndarray] = {}
        for share in (-1.0, 1.0):
            frames, moved = self._along(changes, share * steps), share * of_stresses
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
