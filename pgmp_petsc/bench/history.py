"""Outputs over time of some samples, and errors between two histories of the same samples: the one definition of error
of tolerances, of the trade-off and of chosen steps.

Response surfaces interpolate histories between full-order runs. With one uncertain parameter that is a cubic spline
(not-a-knot; a polynomial where there are fewer than four nodes), with several a cubic radial basis function with a
polynomial, every instant of every output by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from pgmp_petsc.base.errors import RunError
from pgmp_petsc.bench.cases import Setting, Training
from pgmp_petsc.models import Model, OutputRecord, ReducedModel
from pgmp_petsc.models.model import floors_of as floors_of
from pgmp_petsc.outputs.multipliers import judged
from pgmp_petsc.outputs.readings import Reading
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import Reduction
from pgmp_petsc.scene.units import values_text
from pgmp_petsc.stepping.generalised_alpha import integrate
from pgmp_petsc.stepping.second_order_system import SecondOrderSystem, State
from pgmp_petsc.stepping.status import Status

MOST_INSTANTS = 1024  # kept of a run: enough for the largest value over time
MARGIN = 0.02  # of a limited range: what the flexible bodies may add to the coordinate
MOST_MISSING = 0.1  # share of the exact run's instants at which an output may be no number without being a failure
Pulse = Callable[[int], object]  # what is called with numbers of steps while they are taken
OF_SAMPLES = ("outputs", "status", "inside", "failure_time")


@dataclass(frozen=True)
class History:
    """Outputs of a run of n samples, with the status of each."""

    n_steps: int  # steps of the run
    every: int  # steps between two kept instants
    outputs: np.ndarray  # shape (n_outputs, n_kept, n_samples); NaN where a sample failed
    status: np.ndarray  # of every sample, shape (n_samples,)
    inside: np.ndarray  # samples that stayed in the range of their coordinate, shape (n_samples,)
    failure_time: np.ndarray  # when samples failed, shape (n_samples,), s; NaN where they did not

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        return {name: np.array(value) for name, value in vars(self).items()}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Self:
        return cls(**{name: int(value) if name in ("n_steps", "every") else value for name, value in arrays.items()})

    def require_fine(self, scene: Scene, values: Mapping[str, np.ndarray]) -> Self:
        """Return the history, of samples of a scene with some parameter values; raises `RunError` if a sample failed,
        with the first one's values, time and reason."""
        failed = np.flatnonzero(self.status != Status.FINE)
        if not failed.size:
            return self
        first = failed[0]
        where = values_text(scene, {name: float(column[first]) for name, column in values.items()}, ".4g")
        raise RunError(
            f"{failed.size} of {self.status.size} samples failed, the first{f' ({where})' if where else ''} at "
            f"{self.failure_time[first]:.4g} s: {Status(self.status[first]).meaning}"
        )


def spacing(n_steps: int) -> int:
    """Return the steps between kept instants: a power of two, so that runs with doubled steps share instants."""
    every = 1
    while n_steps > MOST_INSTANTS * every:
        every *= 2
    return every


def run_history(
    model: Model, values: Mapping[str, np.ndarray], n_samples: int, n_steps: int, pulse: Pulse = lambda n: None
) -> History:
    """Integrate samples with some parameter values, each of shape (n_samples,), in equal steps over the scene's
    duration; on this rank, in batches as large as the model takes."""
    parts = []
    for first in range(0, n_samples, model.largest_batch):
        chosen = slice(first, min(first + model.largest_batch, n_samples))
        some = {name: column[chosen] for name, column in values.items()}
        with closing(model.batch(some, chosen.stop - chosen.start)) as made:
            parts.append(integrated(model, made, n_steps, pulse))
    if len(parts) == 1:
        return parts[0]
    joined = {name: np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in OF_SAMPLES}
    return History(n_steps, parts[0].every, **joined)


def integrated(model: Model, system: SecondOrderSystem, n_steps: int, pulse: Pulse = lambda n: None) -> History:
    """Integrate a system, on the ranks that share it, and evaluate the outputs at the kept instants."""
    kinematics, n_samples = model.kinematics, system.n_samples
    # what measures free coordinates with a limited range; a reduced model watches its own itself
    free = [c for c in kinematics.coordinates if not (c.periodic or c.prescribed or isinstance(model, ReducedModel))]
    measures = [(c, Reading.of_coordinate(c, kinematics)) for c in free]
    nodes = sorted(set().union(*(angle.nodes for _, angle in measures)))
    record = _Record(model, system, nodes, pulse, spacing(n_steps))
    run = integrate(system, model.scene.simulation.in_steps(n_steps), observer=record)
    outputs = np.array(list(judged(model.scene, record.outputs()[1]).values()))
    by_node, inside = record.by_node(), np.ones(n_samples, dtype=bool)
    for c, angle in measures:
        angles, margin = angle.value(by_node).reshape(-1, n_samples), MARGIN * (c.upper - c.lower)
        kept = (angles > c.lower + margin) & (angles < c.upper - margin)
        # a start near the end of the range is none of the run's doing
        inside &= np.all(kept | (angles == angles[0]), axis=0)
    outputs[..., run.status != Status.FINE] = np.nan
    return History(n_steps, record.every, outputs, run.status, inside, run.failure_time)


class _Record(OutputRecord):
    """Keeps outputs, and frames of some nodes, after one of `every` so many steps."""

    def __init__(self, model: Model, system: SecondOrderSystem, nodes: list[int], *how: Any) -> None:
        super().__init__(model, system, *how)
        self._nodes, self._frames = nodes, []

    def see(self, first: int, states: State) -> None:
        super().see(first, states)
        if self._nodes:
            self._frames.append(self._system.frames_over(states)[self._nodes])

    def by_node(self) -> dict[int, np.ndarray]:
        """Return the frames of the nodes, (n_frame, n) each."""
        return dict(zip(self._nodes, np.concatenate(self._frames, axis=-1))) if self._nodes else {}


def errors_between(found: History, exact: History, floors: np.ndarray) -> np.ndarray:
    """Return the largest error over time of every output and sample, shape (n_outputs, n_samples).

    The error is a share of the largest value of the exact output over time, or of `floors`, (n_outputs,) in its unit,
    where that is larger. It is infinite where only `found` failed, or has no number at a tenth of the instants and more
    at which the exact run has one (a deformation is none outside a limited range); NaN where the exact run failed or
    has no number at any instant. The number of steps of one history divides that of the other.
    """
    finest = max(found.n_steps, exact.n_steps)
    strides = [item.every * (finest // item.n_steps) for item in (found, exact)]
    shared = int(np.lcm(*strides))  # of the instants that both kept
    one, other = (item.outputs[:, :: shared // stride] for item, stride in zip((found, exact), strides))
    known = np.isfinite(other)
    both = known & np.isfinite(one)
    difference = np.where(both, np.abs(np.where(both, one, 0.0) - np.where(both, other, 0.0)), 0.0)
    errors = difference.max(axis=1) / np.maximum(sizes_of(exact), floors[:, None])
    # one of them may be at the end of the range a little before the other
    errors[both.sum(axis=1) < (1.0 - MOST_MISSING) * known.sum(axis=1)] = np.inf
    errors[:, found.status != Status.FINE] = np.inf
    errors[~known.any(axis=1)] = np.nan
    return errors


def largest_errors(found: History, exact: History, floors: np.ndarray) -> np.ndarray:
    """Return the largest error of every output over time and samples, shape (n_outputs,); see `errors_between`.

    Where both are below `floors` they differ by round-off, which is no error. NaN where a sample's output has no number
    where the exact one has, or no sample has any to compare with.
    """
    errors = errors_of_samples(found, exact, floors)
    largest = np.max(errors, axis=1, initial=-1.0, where=np.isfinite(errors) | np.isposinf(errors))
    return np.where(np.isinf(largest) | (largest < 0.0), np.nan, largest)


def errors_of_samples(found: History, exact: History, floors: np.ndarray) -> np.ndarray:
    """Return `errors_between`, with 0 for what is zero to round-off and differs by no more."""
    errors = errors_between(found, exact, floors)
    return np.where((round_off_of(exact, floors) == 1.0) & (errors <= 1.0), 0.0, errors)


def round_off_of(exact: History, floors: np.ndarray) -> np.ndarray:
    """Return below which share of its largest value an output's error is round-off, shape (n_outputs, n_samples)."""
    return floors[:, None] / np.maximum(sizes_of(exact), floors[:, None])


def sizes_of(history: History) -> np.ndarray:
    """Return the largest value over time of every output and sample, shape (n_outputs, n_samples), in its unit."""
    return np.max(np.abs(history.outputs), axis=1, initial=0.0, where=np.isfinite(history.outputs))


@dataclass(frozen=True)
class Errors:
    """Errors of one kind over all training cases."""

    # shares of the outputs' largest values, shape (n_loads, n_outputs, n_samples); NaN where a case does not count
    values: np.ndarray
    round_off: np.ndarray  # what of it is below what counts as zero: errors as small are round-off; the same shape
    loads: tuple[str, ...]  # loads, outputs: names
    outputs: tuple[str, ...]
    training: Training  # the cases

    @property
    def by_output(self) -> np.ndarray:
        """Largest error of every output, shape (n_outputs,); zero where no case counts."""
        return np.max(np.nan_to_num(self.values, nan=0.0, posinf=np.inf), axis=(0, 2))

    @property
    def largest(self) -> float:
        return float(self.by_output.max())

    @property
    def place(self) -> tuple[int, int, int]:
        """Load, output and sample of the largest error."""
        filled = np.nan_to_num(self.values, nan=-1.0, posinf=np.inf)
        return tuple(int(k) for k in np.unravel_index(np.argmax(filled), filled.shape))

    @property
    def is_round_off(self) -> bool:
        """Whether the largest error is below what counts as zero."""
        return self.largest <= self.round_off[self.place]

    @property
    def where(self) -> str:
        """Where the largest error is, in words."""
        load, output, sample = self.place
        values = self.training.sample_text(sample)
        return f"{self.outputs[output]}, load '{self.loads[load]}'" + (f", {values}" if values else "")


@dataclass(frozen=True)
class Trial:
    """A candidate that was tried."""

    reduction: Reduction  # reduction, n_steps: what it is
    n_steps: int
    errors: Errors  # against the full-order model with the same step
    reason: str  # why it could not be built or run; empty where it could
    seconds: float  # wall time of build and runs
    built: bool  # whether it could be built

    def at(self, n_steps: int) -> Setting:
        """Return it as a setting, with so many steps."""
        return Setting("reduced", n_steps, reduction=self.reduction)

    @property
    def setting(self) -> Setting:
        return self.at(self.n_steps)

    @property
    def exact(self) -> Setting:
        """The setting that it is compared with."""
        return Setting("reference", self.n_steps)


class ResponseSurface:
    """Interpolates outputs over time, each of shape (n_t, n_nodes), between nodes in the space of the parameters, shape
    (n_nodes, n_parameters). Raises `ValueError` if there are too few nodes for any interpolation."""

    def __init__(self, nodes: np.ndarray, outputs: Mapping[str, np.ndarray]) -> None:
        self._names = list(outputs)
        every = np.concatenate(list(outputs.values())).T  # (n_nodes, n_outputs * n_t)
        # a deformation may be no number at some instants of a run that leaves a limited range
        self._known = np.isfinite(every).all(axis=0)
        data = every[:, self._known]
        from scipy.interpolate import CubicSpline, RBFInterpolator  # a noticeable time, and few commands have surfaces

        self._low, self._width = nodes.min(axis=0), np.ptp(nodes, axis=0)
        scaled = self._scaled(nodes)
        if nodes.shape[1] == 1:
            self._interpolate = CubicSpline(scaled[:, 0], data)
        else:
            (n, n_parameters), linear = nodes.shape, nodes.shape[1] + 1
            if n <= linear:
                raise ValueError(f"{n} nodes for {n_parameters} parameters; at least {linear + 1} are needed")
            # the largest that the nodes determine, with one node to spare
            degree = 2 if n > linear * (n_parameters + 2) // 2 else 1
            self._interpolate = RBFInterpolator(scaled, data, kernel="cubic", degree=degree)

    def evaluate(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """Return the outputs over time, each of shape (n_t, n), at parameter values of shape (n, n_parameters); no
        number where a run of the surface has none."""
        scaled = self._scaled(points)
        rows = np.full((len(points), self._known.size), np.nan)
        rows[:, self._known] = self._interpolate(scaled[:, 0] if scaled.shape[1] == 1 else scaled)
        return dict(zip(self._names, np.split(rows.T, len(self._names))))

    def _scaled(self, points: np.ndarray) -> np.ndarray:
        return (points - self._low) / self._width
