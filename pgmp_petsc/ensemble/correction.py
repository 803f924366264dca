"""Samples of better models on an ensemble's own draws, and the figures that they lead to (`joined`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pgmp_petsc.base.errors import Remark, gathered, note, warning
from pgmp_petsc.ensemble import intervals, joined
from pgmp_petsc.ensemble.checkpoint import Columns
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.statistics import came_true, is_constant, parts_of_tails, quantities, quantity
from pgmp_petsc.files.checkpoint_folder import within_checkpoint
from pgmp_petsc.models import Model
from pgmp_petsc.results.ensemble import Corrected, Ensemble, Figure, Joined
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import Event
from pgmp_petsc.stepping.status import Status


@dataclass(frozen=True)
class Better:
    """A better model than that of an ensemble, and how many samples of it are wanted."""

    name: str  # as it was asked for: ``full``, ``full/4``
    model: Model  # its scene is that of the ensemble, but for the step
    count: int | None  # none where measured costs and correlations are to decide

    @property
    def key(self) -> str:
        """The name without a slash, which makes groups in files and folders of paths."""
        return self.name.replace("/", ":")


def plan_of(plan: Plan, better: Better) -> Plan:
    """Return the plan of a better model's samples, whose checkpoint lies within that of the ensemble."""
    output = within_checkpoint(plan.output, better.key)
    return replace(plan, n_samples=plan.n_samples if better.count is None else better.count, output=output)


class Levels:
    """The samples of all models, the best first, as far as they are fine in their own model and in all cheaper ones.

    `columns` are those of every model by its name, the ensemble's own last, as many samples as each has, `replicates`,
    (N,), what these belong to, None where they are independent. `names` are those of the models, `n_lost` the number of
    draws that failed in a better model, though not in the ensemble's own.
    """

    def __init__(self, columns: Mapping[str, Columns], replicates: np.ndarray | None = None) -> None:
        self.names, self.columns = tuple(columns), list(columns.values())
        self._replicates = replicates
        status = [one["status"] for one in self.columns]
        fine = status[-1] == Status.FINE
        self._usable = fine.copy()
        for of_model in status[-2::-1]:
            self._usable[: of_model.size] &= of_model == Status.FINE
        self.n_lost = int(np.sum(fine & ~self._usable))
        self._sizes = [one.size for one in status]

    @property
    def counts(self) -> np.ndarray:
        """Number of samples of each model that can be used."""
        return np.array([int(self._usable[:n].sum()) for n in self._sizes])

    def values(self, of: Callable[[Columns], np.ndarray]) -> tuple[list[np.ndarray], np.ndarray | None]:
        """Return a quantity of every model, of the samples that can be used and have one in all models, and the
        replicates that these belong to; None where they are independent."""
        each = [of(one) for one in self.columns]
        usable = self._usable.copy()
        for values in each:
            usable[: values.size] &= np.isfinite(values) if values.dtype.kind == "f" else True
        replicates = None if self._replicates is None else self._replicates[usable]
        return [values[usable[: values.size]] for values in each], replicates

    def events(self, label: str, event: Event) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Return in which samples of every model an event came true, and of which it is known, bool."""
        known = [one["status"] == Status.FINE for one in self.columns]
        true = [came_true(event, label, one.of("outputs"), one.of("first_passages")) for one in self.columns]
        return [one & of for one, of in zip(true, known)], known


def join(scene: Scene, levels: Levels) -> Joined:
    """Return the figures of the best model, of every quantity and every event."""
    level, found = scene.ensemble.confidence, {}
    *better, own = levels.columns
    for name in [name for name, _ in quantities(own.of("outputs"), own.of("extremes"))]:
        values, replicates = levels.values(lambda one: quantity(name, one.of("outputs"), one.of("extremes")))
        n = values[0].size
        in_all = replicates is None or np.unique(replicates[:n]).size == np.unique(replicates).size > 1
        if n >= joined.FEWEST and in_all:
            found[name] = corrected(values, level, replicates)
    for label, event in scene.ensemble.probabilities.items():
        if levels.counts[0] >= joined.FEWEST:
            found[label] = _probability(*levels.events(label, event), level)
    outputs = {name: dict(columns.of("outputs").items()) for name, columns in zip(levels.names, better)}
    status = {name: columns["status"].astype(int) for name, columns in zip(levels.names, better)}
    return Joined(levels.names, level, found, outputs, status)


def with_better(
    ensemble: Ensemble, scene: Scene, columns: Mapping[str, Columns], replicates: np.ndarray | None
) -> Ensemble:
    """Return an ensemble with the figures of the best model, and what is to be said of them; columns and replicates are
    as of `Levels`."""
    levels = Levels(columns, replicates)
    found, record = join(scene, levels), ensemble.record
    remarks = (*record.remarks, *joined_remarks(found, levels), *event_remarks(scene, levels))
    return replace(ensemble, joined=found, record=replace(record, remarks=remarks))


def corrected(values: Sequence[np.ndarray], confidence: float, replicates: np.ndarray | None = None) -> Corrected:
    """Return mean, deviation and bias from values of all models, as `joined.mean_of` takes them."""
    best, own = values[0], values[-1]
    nearer = joined.calibrated(values)
    n_curved = sum(one is not other for one, other in zip(nearer, values))
    parts = parts_alone = (0.0, 0.0)
    if replicates is not None and not is_constant(own):
        n_replicates = np.unique(replicates).size
        parts, parts_alone = (parts_of_tails(nearer[-1], n / n_replicates) for n in (own.size, best.size))
    mean = joined.mean_of(nearer, replicates, n_curved, parts[0])
    # half of the part: the many values of the cheapest model know of the tails
    deviation, of_deviation = joined.deviation_of(nearer, mean, confidence, replicates, n_curved, 0.5 * parts[1])
    # the cheapest model less the best, with the same controls
    bias = joined.mean_of([own[: best.size] - best, *values[1:]], replicates)
    if replicates is None:
        alone = intervals.of_mean(best, confidence), intervals.of_deviation(best, confidence)
    else:
        of_best = joined.mean_of([best], replicates[: best.size], part=parts_alone[0])
        squares = joined.deviation_of([best], of_best, confidence, replicates[: best.size], part=parts_alone[1])[1]
        alone = of_best.interval(confidence), squares
    figures = {
        "mean": Figure(mean.value, mean.interval(confidence), float(best.mean()), alone[0]),
        "std": Figure(deviation, of_deviation, float(best.std(ddof=1)), alone[1]),
        "bias": Figure(bias.value, bias.interval(confidence)),
    }
    return Corrected(figures, np.array([one.size for one in values]), mean.correlations, mean.coefficients)


def _probability(true: Sequence[np.ndarray], known: Sequence[np.ndarray], confidence: float) -> Corrected:
    value, ends = joined.probability_with_failed(true, known, confidence)
    count, n, n_failed = int(true[0].sum()), int(known[0].sum()), int(np.sum(~known[0]))
    alone = intervals.of_probability(count, n, confidence, n_failed)
    figure = Figure(value, ends, count / n if n else np.nan, alone)
    return Corrected({"estimate": figure}, np.array([int(one.sum()) for one in known]), np.zeros(0), np.zeros(0))


@gathered
def joined_remarks(found: Joined, levels: Levels) -> Iterator[Remark]:
    """Return what corrected figures rest on, and what is left out of them."""
    best, counts = found.models[0], levels.counts
    which = ", ".join(f"{n} of {name}" for name, n in zip(found.models, counts))
    yield note(
        f"/corrected: figures of {best} from samples of several models on the same draws ({which}); their "
        f"intervals carry the error of {' and '.join(found.models[1:])} against {best}. A cheaper model in which "
        f"{best} is clearly curved counts through the parabola that fits. Quantiles, densities, bands and "
        f"Sobol indices are of {found.models[-1]} alone"
    )
    if "/" not in best:
        yield note(
            f"{best} has the steps of the ensemble, so that /corrected knows nothing of their error; "
            f"--correct {best}/2=K has steps half as long"
        )
    if counts[0] < joined.FEWEST:
        yield warning(f"{counts[0]} samples of {best} are fine: too few for /corrected, which takes {joined.FEWEST}")
    elif counts[0] < joined.FEWEST_OF_DEVIATION:
        yield note(
            f"corrected deviations have no interval: it takes {joined.FEWEST_OF_DEVIATION} samples of {best}, and "
            f"there are {counts[0]}"
        )
    if joined.FEWEST <= counts[0] < joined.FEWEST_OF_PARABOLA:
        yield note(
            f"{counts[0]} samples of {best} show whether it is curved in the others only where it is that nearly "
            f"alone; where it is curved and noisy, intervals of corrected means are short: take "
            f"{joined.FEWEST_OF_PARABOLA} or more"
        )
    if found.n_failed or levels.n_lost:
        yield warning(
            f"{found.n_failed} samples of better models failed (/better/<model>/status); /corrected is without "
            f"{levels.n_lost} draws that failed in one model and not in the ensemble's own, and may be biased; "
            "intervals of probabilities count all failed ones both ways"
        )


@gathered
def event_remarks(scene: Scene, levels: Levels) -> Iterator[Remark]:
    """Return the events of which models disagree so seldom that intervals are of what few samples cannot show."""
    for label, event in scene.ensemble.probabilities.items():
        known, _ = levels.values(lambda one: came_true(event, label, one.of("outputs"), one.of("first_passages")))
        best, cheaper = known[:2]
        n = best.size
        count = int(np.sum(best != cheaper[:n]))
        if n >= joined.FEWEST and count < joined.FEW_DISAGREEMENTS:
            more = f"; about {joined.FEW_DISAGREEMENTS * n // count} samples would show it" if count else ""
            which = f"{levels.names[0]} and {levels.names[1]} disagree in {count} of {n} samples"
            room = f"its interval leaves room for what {n} samples do not show, and holds more often than it says"
            yield note(f"/corrected/{label}: {which}: {room}{more}")
