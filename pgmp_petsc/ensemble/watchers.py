"""What looks at the runs of an ensemble's batches while they go on, and adds arrays to what is kept of the samples.

Samples of full-order and component models whose coordinates leave their ranges, where a deformation is an output.

Such a model goes on beyond the range, but the deformation is not known there: neither its extremes, nor whether it ever
passes a level. A sample that leaves the range at the end of any step has failed, though it may come back; so it is with
a single run. Reduced models stop there by themselves.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from pgmp_petsc.dynamics.energies import Energies, RunningBalance
from pgmp_petsc.dynamics.generalised_alpha import Observer, Run
from pgmp_petsc.dynamics.second_order_system import SecondOrderSystem, State
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.indicator.coarser_run import OutputRecord, run_coarser, step_errors
from pgmp_petsc.indicator.error_indicator import ErrorIndicator, WatchedRun
from pgmp_petsc.indicator.member_errors import MemberIndicator, WatchedSamples
from pgmp_petsc.indicator.validity import Validity
from pgmp_petsc.models import FullModel, LengthLanes, Model, ReducedModel, SeparateLengths
from pgmp_petsc.results.balance import BALANCE
from pgmp_petsc.results.errors import VALIDITY

if TYPE_CHECKING:
    from pgmp_petsc.scene.numerics import Simulation


TOGETHER = 512  # states of reduced samples whose energies are evaluated together, about as many as stay in a cache
Found = dict[str, dict[str, np.ndarray]]


@dataclass(frozen=True, eq=False)
class Begun:
    """A run of some samples that begins.

    Attributes
    ----------
    system, values
        The system, and the parameter values of all its samples.
    samples
        Numbers of those that are watched: what is no mechanism at all is not.
    simulation
        Its steps.
    """

    system: SecondOrderSystem
    values: Mapping[str, np.ndarray]
    samples: np.ndarray
    simulation: Simulation


class Watch(Protocol):
    """Looks at one run of some samples.

    Attributes
    ----------
    observer
        Takes in the states of the whole run.
    """

    observer: Observer

    def found(self, status: np.ndarray) -> Found:
        """Return what was found once the run has ended with the given status of all its samples.

        Arrays (n_watched,) by name, and these by the field of `Batch` that they belong to; NaN where nothing is known.
        """


class Watcher(Protocol):
    """Looks at the runs of all batches."""

    def empty(self, n: int) -> Found:
        """Return the arrays of n samples of which nothing is known: NaN."""

    def watch(self, begun: Begun) -> Watch:
        """Begin to watch a run."""


def nothing_known(names: Iterable[str], n: int) -> dict[str, np.ndarray]:
    """Return columns (n,) of NaN."""
    return {name: np.full(n, np.nan) for name in names}


class ErrorWatcher:
    """Estimates the errors of all samples.

    Parameters
    ----------
    indicator
        Of the model.
    """

    def __init__(self, indicator: ErrorIndicator | MemberIndicator) -> None:
        self._indicator = indicator

    def empty(self, n: int) -> Found:
        """Return the arrays of n samples of which nothing is known."""
        outputs = self._indicator.model.outputs.functions
        return {kind: nothing_known(outputs, n) for kind in ("errors", "errors_at_end")}

    def watch(self, begun: Begun) -> Watch:
        """Begin to watch a run with steps of its own."""
        return _ErrorWatch(self._indicator.stepped(begun.simulation).watch(begun.values, begun.samples))


class _ErrorWatch:
    def __init__(self, run: WatchedRun | WatchedSamples) -> None:
        self._run = self.observer = run

    def found(self, status: np.ndarray) -> Found:
        """Return the estimate."""
        estimate = self._run.estimate(status)
        return {"errors": estimate.largest, "errors_at_end": estimate.at_end}


class CoarserWatcher:
    """Estimates the errors of the time step of all samples of a full-order or component model."""

    def __init__(self, model: Model) -> None:
        self._model = model

    def empty(self, n: int) -> Found:
        """Return the arrays of n samples of which nothing is known."""
        return {kind: nothing_known(self._model.outputs.functions, n) for kind in ("errors", "errors_at_end")}

    def watch(self, begun: Begun) -> Watch:
        """Begin to watch a run."""
        return _CoarserWatch(self._model, begun)


class _CoarserWatch:
    """Keeps the outputs of a run, and runs its system again."""

    def __init__(self, model: Model, begun: Begun) -> None:
        self._model, self._begun = model, begun
        self.observer = OutputRecord(model, begun.system)

    def found(self, status: np.ndarray) -> Found:
        """Return the largest errors, and those at the end; NaN where they are not known."""
        model, begun = self._model, self._begun
        time, outputs = self.observer.outputs()
        alive = np.isin(np.arange(status.size), begun.samples) & (status == Status.FINE)
        other = run_coarser(model, begun.system, begun.simulation, alive)
        largest, at_end = (nothing_known(outputs, begun.samples.size) for _ in range(2))
        for place, sample in enumerate(begun.samples):
            own = {name: values[:, sample] for name, values in outputs.items()}
            errors = step_errors(model.scene, time, own, other, sample) if alive[sample] else None
            if errors is None or errors.time.size < other.time.size:
                continue
            for name, values in errors.outputs.items():
                largest[name][place], at_end[name][place] = np.abs(values).max(), values[-1]
        return {"errors": largest, "errors_at_end": at_end}


class ValidityWatcher:
    """Keeps how far every sample leaves small deformations.

    Parameters
    ----------
    model
        The reduced model.
    """

    def __init__(self, model: ReducedModel | LengthLanes) -> None:
        self._model = model

    def empty(self, n: int) -> Found:
        """Return the arrays of n samples of which nothing is known."""
        return {"validity": nothing_known(VALIDITY, n)}

    def watch(self, begun: Begun) -> Watch:
        """Begin to watch a run."""
        return _ValidityWatch(Validity(self._model, begun.system, begun.values, begun.simulation), begun.samples)


class _ValidityWatch:
    def __init__(self, validity: Validity, samples: np.ndarray) -> None:
        self._validity, self._samples = validity, samples
        self.observer = validity

    def found(self, status: np.ndarray) -> Found:
        """Return the extremes."""
        return {"validity": {name: values[self._samples] for name, values in self._validity.extremes.items()}}


class BalanceWatcher:
    """Draws up the balance of energy of every sample; see `results.balance`."""

    def empty(self, n: int) -> Found:
        """Return the arrays of n samples of which nothing is known."""
        return {"balance": nothing_known(BALANCE, n)}

    def watch(self, begun: Begun) -> Watch:
        """Begin to watch a run."""
        return _BalanceWatch(begun.system, begun.samples)


class _BalanceWatch(Observer):
    """Sums up works as the run goes on, by the trapezoidal rule over its steps."""

    def __init__(self, system: SecondOrderSystem, samples: np.ndarray) -> None:
        self._system, self._samples = system, samples
        self._residual = self._exchanged = np.zeros(system.n_samples)
        self._sums = RunningBalance()
        self.observer = self

    def over(self, numbers: np.ndarray, times: np.ndarray, trail: np.ndarray) -> None:
        """Take in the states after many steps of reduced samples."""
        n = self._system.n_samples
        together = max(1, TOGETHER // n)
        for first in range(0, times.size, together):
            some = slice(first, first + together)
            with np.errstate(all="ignore"):  # samples that have failed stand still, whatever they are
                energies = self._system.energies_over(times[some], trail[some])
            for k, time in enumerate(times[some]):
                self._add(float(time), energies[n * k : n * (k + 1)])

    def __call__(self, number: int, time: float, state: State) -> None:
        """Take in the state after a step."""
        with np.errstate(all="ignore"):  # as above
            energies = self._system.energies(time, state)
        self._add(time, energies)

    def _add(self, time: float, energies: Energies) -> None:
        """Sum up to the next instant."""
        with np.errstate(all="ignore"):  # as above
            residual, exchanged = self._sums.add(time, energies)
            self._residual = np.maximum(self._residual, np.abs(residual))
            self._exchanged = np.maximum(self._exchanged, exchanged)

    def found(self, status: np.ndarray) -> Found:
        """Return the largest residual and the most energy that was moved around, NaN for samples that failed."""
        kept = np.where(status == Status.FINE, [self._residual, self._exchanged], np.nan)[:, self._samples]
        return {"balance": dict(zip(BALANCE, kept))}


class RangeWatch(Observer):
    """Sees which samples of a run leave the range, and when.

    Parameters
    ----------
    model, system
        The model, some of whose outputs are deformations, and its samples.
    """

    def __init__(self, model: FullModel | SeparateLengths, system: SecondOrderSystem) -> None:
        self._model, self._system = model, system
        self._time = np.full(system.n_samples, np.inf)

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
