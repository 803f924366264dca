"""Samples of full-order and component models whose coordinates leave their ranges, where a deformation is an output.

Such a model goes on beyond the range, but the deformation is not known there: neither its extremes, nor whether it ever
passes a level. A sample that leaves the range at the end of any step has failed, though it may come back; so it is with
a single run. Reduced models stop there by themselves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pgmp_petsc.dynamics.generalised_alpha import Run
from pgmp_petsc.dynamics.second_order_system import SecondOrderSystem, State
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.models import FullModel, SeparateLengths


class RangeWatch:
    """Sees which samples of a run leave the range, and when.

    Parameters
    ----------
    model, system
        The model, some of whose outputs are deformations, and its samples.
    """

    every = 1

    def __init__(self, model: FullModel | SeparateLengths, system: SecondOrderSystem) -> None:
        self._model, self._system = model, system
        self._time = np.full(system.n_samples, np.inf)

    def over(self, numbers: np.ndarray, times: np.ndarray, trail: np.ndarray) -> None:
        """Take in the states after many steps."""
        for number, time, parts in zip(numbers, times, trail):
            self(int(number), float(time), State(*parts, np.zeros(0)))

    def __call__(self, number: int, time: float, state: State) -> None:
        """Take in the state after a step."""
        left = self._model.left_range(self._system, state)
        self._time[left & np.isinf(self._time)] = time

    def judged(self, done: Run) -> Run:
        """Return the run with the samples that left the range as failed, whatever happened to them later."""
        lost = np.isfinite(self._time) & ~(done.failure_time <= self._time)
        return replace(
            done,
            status=np.where(lost, Status.LEFT_RANGE, done.status),
            failure_time=np.where(lost, self._time, done.failure_time),
        )
