"""Derivatives of runs by differences, where exact ones are not known: of component models, and of scenes with
controllers, or friction by the force that a joint carries.

The run and those beside it are samples of one batch, or of as few as the model takes. Differences are of fourth order,
central, or forward where a parameter has no sense below zero and is next to it. With steps of `SHARE` of a parameter's
size the iteration's tolerance leaves about 1e-9 of those of reduced runs, and truncation less as long as a parameter of
that size moves phases by less than some hundred radians. What differences of second order of the same runs are off
bounds the error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.progress import announce
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.models import ComponentModel, LengthLanes, ReducedModel, SeparateLengths

AnyModel = ReducedModel | LengthLanes | ComponentModel | SeparateLengths
SHARE = 2e-3  # of a parameter's size, that runs beside are away
OF_BOUNDS = 0.1  # of the width of its bounds, which its size is at least
#: Offsets in steps, and weights of fourth and of second order.
CENTRAL = (np.array([-2.0, -1.0, 1.0, 2.0]), np.array([[1.0, -8.0, 8.0, -1.0], [0.0, -6.0, 6.0, 0.0]]) / 12.0)
FORWARD = (
    np.array([0.0, 1.0, 2.0, 3.0, 4.0]),
    np.array([[-25.0, 48.0, -36.0, 16.0, -3.0], [-18.0, 24.0, -6.0, 0.0, 0.0]]) / 12.0,
)


def why_differences(model: AnyModel) -> str:
    """Return why derivatives of a model's runs are differences; empty where they are exact."""
    named = [f"the {model.title} model"] if model.name == ComponentModel.name else []
    return ", ".join([*named, *model.scene.beside])


def announce_runs(model: AnyModel, names: Sequence[str], what: str, comm: Comm) -> None:
    """Say before the work begins how many runs derivatives take, where they are not samples of one batch."""
    why = why_differences(model)
    n = Differences.of(model, model.scene.values, names).n_runs if why else 0
    if n > model.largest_batch:
        each = "one after the other" if model.largest_batch == 1 else f"{model.largest_batch} at a time"
        faster = "" if model.name == ReducedModel.name else "; a reduced model (pgmp build) takes them at once"
        announce(f"{what} takes {n} runs, {each}: derivatives are differences, because of {why}{faster}", comm)


@dataclass(frozen=True, eq=False)
class Differences:
    """Values of every parameter, (n_runs,), in a run that is differentiated, the first one, and in those beside it, and
    what makes derivatives of them: weights of the runs' outputs in these, (n_parameters, n_runs), and in those of
    second order, `coarse`; sizes of the parameters are (n_parameters,)."""

    values: dict[str, np.ndarray]
    weights: np.ndarray
    coarse: np.ndarray
    sizes: np.ndarray

    @classmethod
    def of(cls, model: AnyModel, values: Mapping[str, float], names: Sequence[str]) -> Differences:
        """Return the runs for derivatives with some parameters; raises `InputError` if one has no size."""
        scene, columns, rows, sizes = model.scene, [np.array(list(values.values()))], [], []
        for name in names:
            sizes.append(_size(model, values, name))
            step = SHARE * sizes[-1]
            below = values[name] - 2.0 * step
            offsets, weights = FORWARD if below < 0.0 and name in scene.parameters_not_negative else CENTRAL
            rows.append((len(columns), weights / step))
            for offset in offsets:
                columns.append(np.array([value + offset * step * (one == name) for one, value in values.items()]))
        found = np.zeros((2, len(names), len(columns)))
        for row, (first, weights) in enumerate(rows):
            found[:, row, first : first + weights.shape[1]] = weights
        return cls(dict(zip(values, np.array(columns).T)), *found, np.array(sizes))

    def off(self, outputs: Mapping[str, np.ndarray]) -> float:
        """Return how far derivatives of outputs (n_runs, n_t) are from those of second order, the largest share of the
        largest effect of any parameter on an output."""
        shares = [0.0]
        for values in outputs.values():
            fine, away = (
                np.abs(self.sizes[:, None] * (weights @ values))
                for weights in (self.weights, self.weights - self.coarse)
            )
            if fine.size and fine.max() > 0.0:
                shares.append(float(away.max() / fine.max()))
        return max(shares)

    @property
    def n_runs(self) -> int:
        return self.weights.shape[1]


def _size(model: AnyModel, values: Mapping[str, float], name: str) -> float:
    """Return what a parameter is of the size of: its value, or a share of its bounds, or its deviation."""
    parameter, sizes = model.scene.parameters[name], [abs(values[name])]
    if parameter.bounds is not None:
        sizes.append(OF_BOUNDS * (parameter.bounds[1] - parameter.bounds[0]))
    if parameter.distribution is not None:
        sizes.append(parameter.deviation)
    if not max(sizes) > 0.0:
        raise InputError(
            f"parameters.{name} = 0: with {why_differences(model)} derivatives are differences of runs, and how far "
            "apart is not known without its size; give it bounds"
        )
    return max(sizes)
