"""Estimated errors of samples with lengths of their own: each against the full-order equations of its own mechanism.

Samples side by side follow tables that are polynomials of the lengths, rigid inertia included, and their outputs are
polynomials through those of several mechanisms (`models.lengths`). A sample's reduced coordinates are those of the
model of its own lengths, whose kinematics are exact: with these the motion is put into the full-order equations, and
the outputs of the corrected motion are compared with what the sample said. So what the polynomials are off by is in the
estimate, with all the rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.dynamics.generalised_alpha import Observer
from pgmp_petsc.dynamics.second_order_system import State
from pgmp_petsc.indicator.error_indicator import ErrorIndicator, Estimate, WatchedRun
from pgmp_petsc.models import LengthLanes, ReducedModel
from pgmp_petsc.runtime.errors import InputError

if TYPE_CHECKING:
    from pgmp_petsc.scene.numerics import Simulation


def indicator_of(model: ReducedModel | LengthLanes) -> ErrorIndicator | MemberIndicator:
    """Return what estimates the errors of a model's samples."""
    return MemberIndicator(model) if isinstance(model, LengthLanes) else ErrorIndicator(model)


class MemberIndicator:
    """Estimates the errors of runs of samples with lengths of their own; see `ErrorIndicator`."""

    def __init__(self, model: LengthLanes) -> None:
        self.model = model
        self._simulation = model.scene.simulation

    def stepped(self, simulation: Simulation) -> MemberIndicator:
        """Return the indicator of runs of the same model with other steps."""
        other = copy(self)
        other._simulation = simulation
        return other

    def watch(self, values: Mapping[str, np.ndarray], samples: np.ndarray) -> WatchedSamples:
        """Begin to watch a run of a batch; see `ErrorIndicator.watch`."""
        return WatchedSamples([self._of(values, int(sample)) for sample in samples], list(self.model.outputs.functions))

    def _of(self, values: Mapping[str, np.ndarray], sample: int) -> WatchedRun | None:
        """Begin to watch a sample; None where its mechanism cannot be closed."""
        lengths = {name: float(values[name][sample]) for name in self.model.lengths}
        try:
            own = self.model.at_lengths(self.model.scene.with_values(lengths))
        except InputError:
            return None
        return ErrorIndicator(own, self.model).stepped(self._simulation).watch(values, np.array([sample]))


class WatchedSamples(Observer):
    """The run of one batch, whose samples are watched one by one; see `WatchedRun`."""

    def __init__(self, runs: list[WatchedRun | None], outputs: list[str]) -> None:
        self._runs, self._outputs = runs, outputs

    def __call__(self, number: int, time: float, state: State) -> None:
        """Take in the state after a step; the observer of the run."""
        for run in self._known:
            run(number, time, state)

    def over(self, numbers: np.ndarray, times: np.ndarray, trail: np.ndarray) -> None:
        """Take in the states after many steps; see `Observer`."""
        for run in self._known:
            run.over(numbers, times, trail)

    def estimate(self, status: np.ndarray) -> Estimate:
        """Return the estimate once the run has ended with the status of the whole batch, shape (n_batch,)."""
        found = [_nothing(self._outputs) if run is None else run.estimate(status) for run in self._runs]
        largest, at_end = (
            {name: np.concatenate([getattr(one, part)[name] for one in found]) for name in self._outputs}
            for part in ("largest", "at_end")
        )
        absent = {name: tuple(one.absent[name][0] for one in found) for name in self._outputs}
        return Estimate(largest, at_end, tuple(history for one in found for history in one.histories), absent)

    @property
    def _known(self) -> list[WatchedRun]:
        return [run for run in self._runs if run is not None]


def _nothing(outputs: list[str]) -> Estimate:
    """Return that nothing is known of a sample."""
    unknown = {name: np.full(1, np.nan) for name in outputs}
    histories = ((np.zeros(0), {name: np.zeros(0) for name in outputs}),)
    return Estimate(unknown, dict(unknown), histories, dict.fromkeys(outputs, ("",)))
