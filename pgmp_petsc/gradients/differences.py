"""Derivatives of runs by differences, where exact ones are not known: of component models, and of scenes with
controllers, or friction by the force that a joint carries.

The run and four beside it for each parameter are samples of one batch, or of as few as the model takes. Differences are
of fourth order, central, or forward where a parameter has no sense below zero and is next to it.

A run is smooth between instants at which a law, a limit of a controller or an edge takes another branch. Where such an
instant passes the end of a step with the parameter, outputs have a corner or jump by a part of the scheme's own error,
which differences over it do not know from a slope: the closer the runs, the rarer this is. What iterations leave of
runs asks for the opposite: at `NEAR` it is 1e-8 of motions and up to 1e-4 of small deformations. At 2e-3, derivatives
over contacts were 4e-2 off, and over limits of controllers 7e-2. Parameters for which `NEAR` may leave more than
`ENOUGH` have runs at `FAR` too, those for which more than `CORNER` is left have others at `CLOSE`, and each output
takes those that may be off by less.

How far a derivative may be off is estimated from what second order is off, for what is smooth, and from the fourth
difference, which has nothing of that: noise, corners and jumps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pgmp_petsc.base.errors import InputError
from pgmp_petsc.base.progress import announce
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.models import ComponentModel, Model, ReducedModel

NEAR, FAR, CLOSE = 3e-5, 2e-4, 3e-7  # of a parameter's size, that runs beside are away
ENOUGH = 1e-5  # of the largest effect on an output: derivatives that may be no more off are good
CORNER = 1e-3  # of that: what noise at `NEAR` leaves is mostly less, a corner or a jump between runs makes more
#: Runs after those at `NEAR`: how far they are away, for parameters for which more than a share is left.
FURTHER = ((FAR, ENOUGH), (CLOSE, CORNER))
ROUND_OFF = 1e-10  # of an output's largest value: effects that are no larger are what round-off makes of runs so near
OF_BOUNDS = 0.1  # of the width of its bounds, which its size is at least
#: Offsets in steps, and weights of the runs there: of fourth order, what second order is off, and a share of the fourth
#: difference that is no less than what noise, a corner or a jump makes of the derivative.
CENTRAL = (
    np.arange(-2.0, 3.0),
    np.array([[1.0, -8.0, 0.0, 8.0, -1.0], [1.0, -2.0, 0.0, 2.0, -1.0], [3.0, -12.0, 18.0, -12.0, 3.0]]) / 12.0,
)
FORWARD = (
    np.arange(5.0),
    np.array([[-25.0, 48.0, -36.0, 16.0, -3.0], [-7.0, 24.0, -30.0, 16.0, -3.0], [25.0, -100.0, 150.0, -100.0, 25.0]])
    / 12.0,
)


class Off(NamedTuple):
    """How far derivatives may be off: the largest share of the largest effect of any parameter on an output, and of
    which output with which parameter."""

    share: float = 0.0
    output: str = ""
    parameter: str = ""


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of one output with parameters by their names, each (n_t,), and how far each may be off, times the
    parameters' sizes; and the output's largest value."""

    effects: dict[str, np.ndarray]
    away: dict[str, float]
    size: float

    def offs(self, output: str) -> list[Off]:
        """Return how far they are off by parameter; none where no parameter has an effect."""
        largest = max((float(np.abs(effect).max(initial=0.0)) for effect in self.effects.values()), default=0.0)
        felt = largest > ROUND_OFF * self.size
        return [Off(away / largest, output, name) for name, away in self.away.items()] if felt else []

    def take(self, other: Slopes) -> None:
        """Take derivatives from others where these may be off by less."""
        for name, away in other.away.items():
            if away < self.away[name]:
                self.effects[name], self.away[name] = other.effects[name], away


def why_differences(model: Model) -> str:
    """Return why derivatives of a model's runs are differences; empty where they are exact."""
    named = [f"the {model.title} model"] if model.name == ComponentModel.name else []
    return ", ".join([*named, *model.scene.beside])


def announce_runs(model: Model, names: Sequence[str], what: str, comm: Comm) -> None:
    """Say before the work begins how many runs derivatives take, where they are not samples of one batch."""
    why = why_differences(model)
    n = Differences.of(model, model.scene.values, names, NEAR).n_runs if why else 0
    if n > model.largest_batch:
        each = "one after the other" if model.largest_batch == 1 else f"{model.largest_batch} at a time"
        faster = "" if model.name == ReducedModel.name else "; a reduced model (pgmp build) takes them at once"
        runs = f"{n} to {(1 + len(FURTHER)) * n} runs"
        announce(f"{what} takes {runs}, {each}: derivatives are differences, because of {why}{faster}", comm)


@dataclass(frozen=True, eq=False)
class Differences:
    """Values of every parameter, (n_runs,), in a run that is differentiated, the first one, and in those beside it;
    weights of the runs' outputs in derivatives with the named parameters, and in both that these may be off, (3,
    n_parameters, n_runs), and sizes of these parameters, (n_parameters,)."""

    names: tuple[str, ...]
    values: dict[str, np.ndarray]
    weights: np.ndarray
    sizes: np.ndarray

    @classmethod
    def of(cls, model: Model, values: Mapping[str, float], names: Sequence[str], share: float) -> Differences:
        """Return the runs for derivatives with some parameters, by a share of their sizes; raises `InputError` if one
        has no size."""
        columns, sizes = [np.array(list(values.values()))], [_size(model, values, name) for name in names]
        weights = np.zeros((3, len(names), 1 + 4 * len(names)))
        for row, (name, size) in enumerate(zip(names, sizes)):
            below = values[name] - 2.0 * share * size
            forward = below < 0.0 and name in model.scene.parameters_not_negative
            offsets, formulas = FORWARD if forward else CENTRAL
            for offset, weight in zip(offsets, formulas.T):
                weights[:, row, len(columns) if offset else 0] = weight / (share * size)
                if offset:
                    step = offset * share * size
                    columns.append(np.array([value + step * (one == name) for one, value in values.items()]))
        return cls(tuple(names), dict(zip(values, np.array(columns).T)), weights, np.array(sizes))

    def slopes(self, values: np.ndarray) -> Slopes:
        """Return the derivatives of an output (n_runs, n_t); zero where runs are the same."""
        effects, *doubts = self.sizes[:, None] * (self.weights @ (values - values[:1]))
        away = np.abs(doubts).sum(axis=0).max(axis=-1, initial=0.0)
        size = float(np.abs(values).max(initial=0.0))
        return Slopes(dict(zip(self.names, effects)), dict(zip(self.names, away.tolist())), size)

    @property
    def n_runs(self) -> int:
        return self.weights.shape[-1]


def _size(model: Model, values: Mapping[str, float], name: str) -> float:
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
