"""From the finished samples of an ensemble, of one run or of all its shards, to its result: statistics, probabilities,
bands, and what is to be said.

Shards are parts of an ensemble that are runs of their own, on one machine or many. A sample's numbers depend on the
seed and its own number alone, and statistics are of all samples together: shards keep samples, and whoever joins them
describes them, bit for bit as one run of all samples.

Samples rarely fail at random. Where they fail mostly at large torques, mean, deviation and density of the others are
those of small torques: biased, by an amount that nobody knows. Rank statistics, which assume no distribution, ask which
parameters tell failed samples from fine ones: the test of Mann and Whitney (1947) for a side, and the same test on the
distance from the median for both ends or the middle.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy

from pgmp_petsc.base.errors import Remark, gathered, note, warning
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.units import Units, behind
from pgmp_petsc.ensemble import intervals
from pgmp_petsc.ensemble.checkpoint import Checkpoint, Kept, Shards
from pgmp_petsc.ensemble.plan import IN_CHECKED, SHARE, Plan, SampleFile, block_of, checked, share_of
from pgmp_petsc.ensemble.sampling import Sampler, sampler_remarks
from pgmp_petsc.ensemble.statistics import (
    Peaks,
    came_true,
    describe,
    holds_to,
    in_words,
    of_event,
    quantile_bounds,
    quantities,
    sensitivities,
    sensitivity_remarks,
)
from pgmp_petsc.ensemble.stopping import level_of_each
from pgmp_petsc.ensemble.watchers import band_steps
from pgmp_petsc.estimates import own_error
from pgmp_petsc.estimates.validity import remarks_of
from pgmp_petsc.files.hdf5 import RunRecord
from pgmp_petsc.mechanism.capabilities import comparing
from pgmp_petsc.models import LengthLanes, Model, Reduced
from pgmp_petsc.results.ensemble import (
    DESCRIBED,
    DOUBT,
    DOUBT_IF_UNSURE,
    OF_MODEL,
    OF_TIME_STEP,
    UNSTABLE,
    Band,
    Chance,
    Ensemble,
    Place,
    Sensitivity,
    ShardSamples,
    Statistics,
)
from pgmp_petsc.results.numbers import VANISHING, Arrays
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
from pgmp_petsc.scene.numerics import Event
from pgmp_petsc.scene.units import own_values, result_units
from pgmp_petsc.scene.uses import length_names
from pgmp_petsc.stepping.generalised_alpha import DIVISORS, RETRIED, instants
from pgmp_petsc.stepping.static_equilibrium import starts_remarks
from pgmp_petsc.stepping.status import Status

OVER_TIME = ("extremes", "first_passages")
FEWEST_OF_TAIL = 50  # values
FEW_OF_TAIL = 5.0  # degrees of freedom of the variance of squares, below which few values decide on a deviation
LONG_TAIL = 12.0  # kurtosis: of 512 values of a lognormal law with s = 1 in 19 of 20 samples, exponential ones 1 in 10
ESTIMATES = (*IN_CHECKED, "validity", "balance")
OF_SAMPLES = 0.9  # of those whose errors are estimated, the share whose errors are below what is taken for the model's


def describe_ensemble(
    origin: Origin, plan: Plan, sampler: Sampler, kept: Kept, ranks: int, timings: Timings, looked: bool = False
) -> Ensemble:
    """Put samples together and describe parameters and outputs; one column of samples is in memory at a time.

    `looked` says whether intervals have decided on the number of samples (see `stopping`).
    """
    scene = origin.scene
    samples = _Samples(origin, sampler, kept, looked)
    statistics = samples.statistics()
    constant = [name for name, one in statistics.items() if name in samples.sizes and one.constant]
    probabilities = {label: samples.chance(label, event) for label, event in scene.ensemble.probabilities.items()}
    units = result_units(scene) | origin.units
    extremes = scene.ensemble.with_extremes(samples.outputs)
    units |= {f"{name}.{which}": units[name] for name in extremes for which in DESCRIBED}
    units |= dict.fromkeys(samples.over_time["first_passages"], "s")
    of_blocks = scene.ensemble.replicates if sampler.kind == "saltelli" else None
    sobol = samples.sobol(constant, of_blocks)
    divisors = samples.numerics["steps_divided"].astype(np.int32)
    fine, status, n_chosen = samples.fine, samples.status, int(samples.chosen.sum())
    drawn = {name: samples.parameters[name] for name in sampler.names} if not fine.all() else {}
    own = own_values(scene, drawn), {name: scene.system.unit(units[name]) for name in drawn}
    may_be_retried = not looked and has_steps_left(status, divisors)  # an ensemble with rules is repeated instead
    correlated = sampler.kind != "file" and bool(scene.correlation)
    remarks = (
        *kept.remarks,
        *failure_remarks(
            status, *own, origin.model, scene.ensemble.failed_share, may_be_retried, length_names(scene),
            scene.beyond_steps,
        ),
        *step_remarks(status, divisors, scene.simulation.step),
        *sampler_remarks(scene, plan),
        *starts_remarks(scene, samples.numerics["unstable_start"] == 1.0),
        *_of_numbers(n_chosen, constant),
        *tail_remarks(samples.varying(constant), samples.chosen, samples.replicates),
        *sensitivity_remarks(sobol, of_blocks, len(sampler.names), fine, correlated, samples.replicates),
        *_partial_bands(samples.bands, n_chosen),
        *over_time_remarks({name: one.count for name, one in statistics.items()}, samples.over_time, n_chosen),
        *_estimate_remarks(origin, samples.estimates, status, samples.peaks, samples.length),
        *own_error.of_statistics(
            samples.felt(constant), samples.estimates["errors_at_end"],
            samples.chosen, units, ("mean", f"deviation, quantiles{' and Sobol indices' if sobol else ''}"),
            origin.model, scene.system,
        ),
    )  # fmt: skip
    of_others: dict[str, np.ndarray] = {}  # what a further try of failed samples needs of the others
    if not fine.all():
        of_others = {f"bands.{name}": values for name, values in kept.bands(scene.ensemble.band_samples).items()}
        of_others[UNSTABLE] = samples.numerics["unstable_start"]
    said, seed = (*scene.remarks, *remarks), None if plan.file else plan.seed
    return Ensemble(
        model=origin.model,
        record=RunRecord(scene_to_toml(scene), own_values(scene), seed, ranks, timings.as_dict(), said),
        parameters=samples.parameters,
        outputs=samples.outputs,
        units=units,
        status=status,
        meanings=_meanings(length_names(scene)),
        failure_time=samples.failure_time,
        statistics=statistics,
        steps_divided=divisors,
        probabilities=probabilities,
        bands=samples.bands,
        sobol=sobol,
        kept=of_others,
        **samples.estimates,
        **samples.over_time,
    )


class _Samples:
    """The samples of an ensemble, and which of them count.

    Samples that failed hide what they would have shown: where they are too many, none is chosen.
    """

    def __init__(self, origin: Origin, sampler: Sampler, kept: Kept, looked: bool) -> None:
        self._origin, self._asked, self._names = origin, origin.scene.ensemble, sampler.names
        columns = kept.columns()
        self.parameters, self.outputs, self.numerics = map(columns.of, ("parameters", "outputs", "numerics"))
        self.estimates = {kind: columns.of(kind) for kind in ESTIMATES}
        self.over_time = {kind: columns.of(kind) for kind in OVER_TIME}
        self.status, self.failure_time = columns["status"].astype(np.int32), columns["failure_time"]
        n = self.status.size
        self.fine, self._described = self.status == Status.FINE, sampler.described(n)
        self.replicates = sampler.replicates(n)
        self._is_hiding = int(np.sum(~self.fine)) > self._asked.failed_share * n
        self.chosen = self.fine & self._described & (not self._is_hiding)
        self._level = level_of_each(self._asked.confidence) if looked else self._asked.confidence
        self.bands, ends = _bands(origin.scene, kept, self.chosen)
        self.peaks = Peaks(self.outputs, self.over_time["extremes"], ends)
        lines = [origin.scene.number(one.line.length) for one in origin.scene.bodies.values() if one.line is not None]
        rigid = [one.rigid for one in origin.scene.bodies.values() if one.rigid is not None]
        lines += [float(np.linalg.norm(place)) for one in rigid for place in one.places.values()]
        self.length = max(lines, default=0.0)  # of the mechanism, m, beside which displacements are round-off
        #: beside what outputs, at the end and over time, vary by round-off
        self.sizes = self.peaks.sizes(origin.units, self.fine, self.length)

    def _quantities(self) -> Iterator[tuple[str, np.ndarray]]:
        return quantities(self.outputs, self.over_time["extremes"])

    def varying(self, constant: Collection[str]) -> Iterator[tuple[str, np.ndarray]]:
        """Return the outputs, at the end and over time, but for those that are constant."""
        return (one for one in self._quantities() if one[0] not in constant)

    def felt(self, constant: Collection[str]) -> Iterator[tuple[str, np.ndarray]]:
        """Return the outputs at the end but for those that are constant, or with their errors what is left of none."""
        for name, values in self.outputs.items():
            both = np.abs((values, self.estimates["errors_at_end"].get(name, values)))[:, self.chosen]
            largest = np.max(both, where=np.isfinite(both), initial=0.0)
            if name not in constant and largest > VANISHING * self.sizes[name]:
                yield name, values

    def statistics(self) -> dict[str, Statistics]:
        n_failed = int(np.sum(self._described & ~self.fine))
        found = {name: self._of(one, self.chosen, n_failed, self.sizes[name]) for name, one in self._quantities()}
        found |= {name: self._of(self.parameters[name], self._described) for name in self._names}
        return found | {name: self._of(one, self.chosen) for name, one in self.over_time["first_passages"].items()}

    def _of(self, values: np.ndarray, of: np.ndarray, n_missing: int = 0, size: float = 0.0) -> Statistics:
        asked, known = self._asked, of & np.isfinite(values)
        numbers = None if self.replicates is None else self.replicates[known]
        found = describe(values[known], asked.bins, asked.quantiles, n_missing, self._level, numbers, size)
        if self._is_hiding and n_missing:  # bounds hide nothing
            known = self.fine & self._described & np.isfinite(values)
            found = replace(found, quantile_bounds=quantile_bounds(values[known], found.probabilities, n_missing))
        return replace(found, confidence=asked.confidence)

    def sobol(self, constant: Collection[str], n_replicates: int | None) -> dict[str, Sensitivity]:
        fine = self.fine & (not self._is_hiding)
        found = sensitivities(
            self.varying(constant), self.parameters, self._names, fine, n_replicates, self._level, self.replicates
        )
        return {name: replace(one, confidence=self._asked.confidence) for name, one in found.items()}

    def chance(self, label: str, event: Event) -> Chance:
        """Return the probability of an event over the samples of which it is known.

        Its interval hides nothing of those that failed, so that it is given where the estimate would.
        """
        peaks, origin, level = self.peaks, self._origin, self._level
        known, failed = self._described & self.fine, self._described & ~self.fine
        true = came_true(event, label, self.outputs, self.over_time["first_passages"])
        if event.when == "end":
            lost = known & ~np.isfinite(self.outputs[event.output])
            known, failed = known & ~lost, failed | lost
        count, n, ends = of_event(true, known, failed, self.replicates, level)
        excess, largest = peaks.excess(event), peaks.largest(event.output)
        seen = known & np.isfinite(excess)
        beyond = np.where(true, np.fmax(excess, 0.0), np.fmin(excess, 0.0))[seen]
        limit = holds_to(beyond, largest[seen], float(np.ptp(ends)), count / n if n else 0.0)
        error = self._share_of_error(event, known, largest)
        estimate = count / n if n and not self._is_hiding else float("nan")
        words = in_words(event, origin.units[event.output], origin.scene.system)
        lost, told_by = int(failed.sum()), origin.told_by(error, limit)
        return Chance(words, count, n, estimate, ends, self._asked.confidence, lost, error, limit, *told_by)

    def _share_of_error(self, event: Event, known: np.ndarray, largest: np.ndarray) -> float:
        """Return what errors of an event's output hardly exceed in the samples that are `known`, shape (N,), as a share
        of its `largest` value in each; NaN where none of them tells: of component modes no estimate does."""
        name = event.output
        if self._origin.is_of_modes or name not in self.estimates["errors"]:
            return float("nan")
        errors = self.estimates["errors_at_end" if event.when == "end" else "errors"][name]
        doubts = np.where(self.estimates["errors_unsure"].get(name, 0.0) == 1.0, DOUBT_IF_UNSURE, DOUBT)
        shares = (doubts * np.abs(errors) / np.maximum(largest, np.finfo(float).tiny))[known]
        shares = shares[np.isfinite(shares)]
        return float(np.quantile(shares, OF_SAMPLES, method="higher")) if shares.size else float("nan")


def _bands(scene: Scene, kept: Kept, chosen: np.ndarray) -> tuple[dict[str, Band], dict[str, np.ndarray]]:
    """Return the outputs over time of the first samples that are fine, and the smallest and largest values (2, n) of
    each of the first samples; NaN where one is no number."""
    asked, simulation = scene.ensemble, scene.simulation
    steps = band_steps(simulation, asked.bands)
    time = instants(simulation.duration, simulation.n_steps)[steps]
    found, ends = {}, {}
    for name, values in kept.bands(asked.band_samples).items() if steps.size else ():
        are_fine = chosen[: len(values)]
        ends[name] = np.array([values.min(axis=1), values.max(axis=1)])
        of_fine = values if are_fine.all() else values[are_fine]
        n, unknown = len(of_fine), np.full(time.size, np.nan)
        columns = np.ascontiguousarray(of_fine.T)
        quantiles = np.full((time.size, len(asked.quantiles)), np.nan)
        known = np.isfinite(columns).all(axis=1) & (n > 0)
        if known.any():
            quantiles[known] = np.quantile(columns[known], asked.quantiles, axis=1).T
        found[name] = Band(
            time=time,
            mean=of_fine.mean(axis=0) if n else unknown,
            std=of_fine.std(axis=0, ddof=1) if n > 1 else unknown,
            quantiles=quantiles,
            probabilities=np.array(asked.quantiles),
            count=n,
        )
    return found, ends


@gathered
def _of_numbers(n_fine: int, constant: Collection[str]) -> Iterator[Remark]:
    """Return what is to be said of too few samples, and of quantities that are the same in all of them."""
    if n_fine == 1:
        yield note("one sample has no deviation, no standard errors and no intervals; draw more")
    elif 1 < n_fine < 5:
        yield note(f"{n_fine} samples have no interval of the deviation, which takes 5 at least; draw more")
    if constant:
        verb = "is constant: it varies" if len(constant) == 1 else "are constant: they vary"
        what = f"{', '.join(constant)} {verb} over the samples by round-off alone"
        yield note(f"{what}; no deviation and no Sobol indices")


@gathered
def tail_remarks(
    values: Iterable[tuple[str, np.ndarray]], chosen: np.ndarray, replicates: np.ndarray | None = None
) -> Iterator[Remark]:
    """Return whose deviations rest on few values far out, of samples of every quantity, each (N,).

    Of 1,000 values that is so of no normal sample, 3 % of exponential ones, and 27 to 34 % where the interval of the
    deviation is short (held in 87 to 89 %): Student's t of 3.2 degrees of freedom, lognormal with s = 1. Replicates of
    Sobol sequences seldom have such few values; of them it is the kurtosis that tells.
    """
    names = []
    for name, each in values:
        known = each[chosen & np.isfinite(each)]
        if known.size < FEWEST_OF_TAIL:
            continue
        known -= np.mean(known)
        known *= known
        is_long = replicates is not None and np.mean(known**2) > LONG_TAIL * np.mean(known) ** 2
        if is_long or intervals.freedom_of(known, known.size - 1) < FEW_OF_TAIL:
            names.append(name)
    if not names:
        return
    yield warning(
        f"the deviation of {', '.join(names)} rests on a few samples far from the others: its interval is wide for "
        "that, and still short where the tail goes on beyond them; take more samples, or go by the quantiles"
    )


@gathered
def over_time_remarks(
    counts: Mapping[str, int], over_time: Mapping[str, Collection[str]], n_fine: int
) -> Iterator[Remark]:
    """Return which figures over time are of a part of the `n_fine` samples, by the number of values that the statistics
    of each quantity are of, and the names of ``extremes`` and ``first_passages`` that are known."""
    for label in over_time["first_passages"]:
        if counts[label] < n_fine:
            yield note(
                f"first passages of {label} are described over the {counts[label]} of {n_fine} samples that have one"
                "; the others may have theirs after the end of the run"
                if counts[label]
                else f"none of {n_fine} samples has a first passage of {label} within the run"
            )
    for name in dict.fromkeys(key.rpartition("/")[0] for key in over_time["extremes"]):
        unknown = n_fine - counts[f"{name}.{DESCRIBED[0]}"]
        if unknown:
            yield note(
                f"extremes of {name} are not known of {unknown} of {n_fine} samples that are fine: for a while it "
                "was no number there"
            )


@gathered
def _partial_bands(bands: Mapping[str, Band], n_fine: int) -> Iterator[Remark]:
    count = max((band.count for band in bands.values()), default=n_fine)
    if count == n_fine:
        return
    yield note(
        f"bands over time are of the first {count} of the {n_fine} samples that are fine (/bands/<name>/count), "
        "which are as good as any others: ensemble.band_samples says of how many values over time are kept"
    )


@gathered
def _estimate_remarks(
    origin: Origin, estimates: Mapping[str, Arrays], status: np.ndarray, peaks: Peaks, length: float
) -> Iterator[Remark]:
    """Return what is beyond the limits of small deformations in a reduced ensemble, and which errors are large or not
    known."""
    scene = origin.scene
    yield from origin.said
    why = "the run with a coarser step, which they are taken from, failed; take a smaller simulation.step"
    n_steps = scene.simulation.n_steps
    if origin.model == "reduced":
        yield from remarks_of(scene, estimates["validity"])
        why = f"pgmp simulate with their --set says why, sample by sample; {comparing(scene)}"
    if estimates["errors"]:
        counted = scene.counted  # see `outputs.multipliers.judged`
        sizes = {n: np.abs(peaks.outputs[n]) if n in counted else peaks.largest(n) for n in estimates["errors"]}
        yield from own_error.large_errors(estimates["errors"], sizes, origin.units, origin.model, scene, length)
    if estimates["errors"] and (origin.model == "reduced" or not own_error.too_few_steps(n_steps, scene)):
        chosen = np.zeros(status.size, dtype=bool)
        for first, last in checked(origin.checked_share, status.size, block_of(scene, origin.model)):
            chosen[first:last] = status[first:last] == Status.FINE
        unknown = int(np.sum(chosen & np.any([~np.isfinite(v) for v in estimates["errors"].values()], axis=0)))
        if unknown:
            yield note(
                f"errors were not estimated for {unknown} of the {int(chosen.sum())} samples that are checked, of "
                f"one output or more: {why}"
            )
    unsure = np.any([one == 1.0 for one in estimates["errors_unsure"].values()] or np.zeros((1, status.size)), axis=0)
    if unsure.any() and origin.model != "reduced":  # of reduced ones `own_error.few_steps` says so
        n = int(np.sum(np.any([np.isfinite(one) for one in estimates["errors"].values()], axis=0)))
        yield warning(
            f"estimated errors of the time step are unsure in {int(unsure.sum())} of the {n} samples that are checked, "
            "and may be several times too small or too large: pgmp simulate with their --set says why; compare with a "
            "smaller simulation.step"
        )


@dataclass(frozen=True)
class Origin:
    """Origin of samples: the model and its scene."""

    model: str  # ``full``, ``components`` or ``reduced``
    scene: Scene  # the scene of the run
    units: dict[str, str]  # of the outputs, by name
    said: tuple[Remark, ...]  # of loops that do not quite close, and of errors that are not estimated
    checked_share: float  # of the samples whose errors are estimated

    @property
    def is_of_modes(self) -> bool:
        """Whether bodies deform in component modes, of whose errors nothing is known."""
        return self.model == "components" and any(body.flexible for body in self.scene.bodies.values())

    def told_by(self, error: float, limit: float) -> tuple[str, str]:
        """Return whose the error of an output is, and with which options samples tell whether a probability stays that
        holds up to a `limit` of it: the full-order model's, or where nothing is reduced those of a smaller step."""
        if self.model == "reduced" or self.is_of_modes:
            return OF_MODEL, "--full"
        simulation, again = self.scene.simulation, f"--{self.model} --override"
        if not simulation.error_indicator:
            return OF_TIME_STEP, f"{again} simulation.error_indicator=true"
        if self.scene.ensemble.checked_share == 0.0:
            return OF_TIME_STEP, f"{again} ensemble.checked_share={SHARE}"
        ratio = error / limit if error > limit > 0.0 else 1.0  # an error of second order
        halvings = min(max(int(np.ceil(np.log2(ratio) / 2.0)), 1), MOST_HALVINGS)
        return OF_TIME_STEP, f"{again} simulation.step={simulation.step / 2**halvings:.4g}"

    @classmethod
    def of(cls, model: Model) -> Origin:
        scene, share, is_reduced = model.scene, share_of(model), isinstance(model, Reduced)
        absent = own_error.absence_of_estimates(scene, ensemble=True, of_step=not is_reduced)
        absent += own_error.truncated_stresses(scene) if is_reduced else own_error.why_not_of_full_order(model)
        if share > 0.0 and is_reduced:
            absent += own_error.few_steps(scene.simulation.n_steps) + own_error.left_out_of_estimates(model)
        elif share > 0.0:
            absent += own_error.too_few_steps(scene.simulation.n_steps, scene)
        if isinstance(model, LengthLanes):
            absent += (own_error.polynomials_of_lengths(model, share > 0.0),)
        return cls(model.name, scene, dict(model.outputs.units), (*model.kinematics.remarks, *absent), share)


def shard_of(origin: Origin, plan: Plan, checkpoint: Checkpoint, ranks: int, timings: Timings) -> ShardSamples:
    """Return what a finished checkpoint of a shard holds."""
    scene, file = origin.scene, plan.file
    first, last = plan.samples
    of_file = None if file is None else {"path": str(file.path), "identity": file.identity, "names": [*file.values]}
    place = Place(plan.shard.number, plan.shard.count, plan.n_samples, first, checkpoint.run, of_file)
    seed = None if file is not None else plan.seed
    return ShardSamples(
        origin.model,
        RunRecord(scene_to_toml(scene), own_values(scene), seed, ranks, timings.as_dict(), scene.remarks),
        place,
        origin.units,
        origin.said,
        () if file is None else file.remarks,
        origin.checked_share,
        checkpoint.remarks,
        checkpoint.columns(),
        checkpoint.bands(min(scene.ensemble.band_samples, last)),
    )


def describe_shards(shards: Shards, output: Path) -> Ensemble:
    first = shards.all[0]
    record, place = first.record, first.place
    scene = scene_from_toml(record.scene_toml, ".").with_remarks(record.remarks)
    origin = Origin(first.model, scene, first.units, first.not_estimated, first.checked_share)
    file = None
    if place.file is not None:
        names, parameters = place.file["names"], shards.columns().of("parameters")
        values = {str(name): parameters[name] for name in names}
        file = SampleFile(Path(place.file["path"]), values, str(place.file["identity"]), first.file_remarks)
    plan = Plan(place.n_samples, record.seed or 0, output, file=file)
    ranks = sum(shard.record.ranks for shard in shards.all)
    seconds: Counter[str] = Counter()  # of all shards together: they may have run one after the other
    for shard in shards.all:
        seconds.update(shard.record.timings)
    return describe_ensemble(origin, plan, Sampler(scene, plan), shards, ranks, Timings(dict(seconds)))


SIGNIFICANT = 0.01  # for all parameters and sides together
NAMED = 3  # parameters, the clearest first
FURTHER = (*DIVISORS, 16, 32, 64)  # of the scene's step
MOST_HALVINGS = 4  # of the step, in what is advised: beyond them nobody knows an order


def _meanings(lengths: Sequence[str]) -> dict[int, str]:
    """Return what status of samples mean; `lengths` are parameters with which a mechanism may not close."""
    found = {int(item): item.meaning for item in Status}
    if lengths:
        how = f"over its range, as pgmp check SCENE --set {lengths[0]}=VALUE says"
        found[Status.UNPHYSICAL] += f"; or a mechanism of its {', '.join(lengths)} cannot be put together {how}"
    return found


@gathered
def failure_remarks(
    status: np.ndarray,
    parameters: Arrays,
    units: Units,
    model: str,
    hidden: float = 1.0,
    may_be_retried: bool = True,
    lengths: Sequence[str] = (),
    beyond_steps: str = "",
) -> Iterator[Remark]:
    """Return what is to be said of failed samples of a model by status (N,) and drawn values (N,) with their units;
    nothing where all are fine.

    `hidden` is the largest share of failed samples that the others are described without; `may_be_retried` says whether
    a further try takes any of them with steps that were not tried; `lengths` are parameters with which a mechanism may
    not close; `beyond_steps` is what helps where smaller steps do not.
    """
    failed = status != Status.FINE
    n, n_failed = failed.size, int(failed.sum())
    if not n_failed:
        return
    for code in np.unique(status[failed]):
        reason, count = Status(code), int(np.sum(status == code))
        yield warning(
            f"{count} of {n} samples failed (status {int(code)}): {_meanings(lengths)[reason]}; cure: "
            f"{reason.cure(model, beyond_steps)}"
        )
    if n_failed == n:
        yield warning("no sample is fine, so the outputs have no statistics")
        return
    where = _where(failed, parameters, units)
    if n_failed > hidden * n:
        retry = "--retry-failed with this file tries them with smaller steps"
        cure = retry if may_be_retried else "that of the reason above"
        yield warning(
            f"{n_failed} of {n} samples failed, more than ensemble.failed_share = {hidden:g} of them: outputs have "
            f"no mean, deviation, density, probability, band or index, which would hide that"
            f"{''.join(f'; {words}' for words in where)}. Their quantile_bounds hold, and "
            f"intervals of probabilities. Cure: {cure}; "
            "--override ensemble.failed_share=1.0 describes the others"
        )
        return
    bias = "and may be biased: no parameter alone tells failed samples from fine ones, which does not rule it out"
    bias = f"and are biased: {'; '.join(where)}" if where else bias
    yield warning(
        f"mean, deviation and density of the outputs are those of the {n - n_failed} samples that are fine {bias}; "
        f"no bounds hold for them. Quantiles of all {n} samples lie between their quantile_bounds, "
        f"whatever the failed ones would have been, and intervals of probabilities count these both ways. "
        f"Parameters are described over all {n} samples"
    )


@gathered
def step_remarks(status: np.ndarray, divisors: np.ndarray, step: float) -> Iterator[Remark]:
    """Return which samples needed smaller steps (s), and that failed ones were tried with them; shapes (N,)."""
    saved = (status == Status.FINE) & (divisors > 1)
    if saved.any():
        counts = [f"{int(np.sum(saved & (divisors == d)))} with 1/{d} of it" for d in np.unique(divisors[saved])]
        yield note(
            f"{int(saved.sum())} of {status.size} samples failed with simulation.step = {step:g} s and were "
            f"integrated again with smaller ones: {', '.join(counts)} (/steps_divided); they are fine, but the "
            "step is large for this ensemble"
        )
    given_up = (status != Status.FINE) & (divisors > 1)
    if given_up.any():
        smallest = int(divisors[given_up].max())
        yield note(
            f"{int(given_up.sum())} of the samples that failed were tried with steps down to 1/{smallest} of "
            f"simulation.step = {step:g} s before they were given up (/steps_divided)"
        )


def _where(failed: np.ndarray, parameters: Arrays, units: Units) -> list[str]:
    """Return in words which parameters tell failed samples from fine ones, the clearest first."""
    found = []
    for name, values in parameters.items():
        known = np.isfinite(values)
        lost, fine = values[known & failed], values[known & ~failed]
        if not lost.size or not fine.size or np.ptp(values[known]) == 0.0:
            continue
        unit = behind(units.get(name, "1"))
        middle = float(np.median(values[known]))
        medians = f"median {np.median(lost):.4g} against {np.median(fine):.4g}{unit}"
        aside = _significance(lost, fine)
        apart = _significance(np.abs(lost - middle), np.abs(fine - middle))
        if aside[0] <= apart[0]:
            found.append((aside[0], f"failures are mostly at {'high' if aside[1] else 'low'} {name} ({medians}, "))
        else:
            place = "at both ends of" if apart[1] else "in the middle of"
            found.append((apart[0], f"failures are mostly {place} {name} ({medians}, "))
    limit = SIGNIFICANT / max(2 * len(parameters), 1)
    clear = sorted(item for item in found if item[0] < limit)
    return [f"{words}p = {p:.1g})" for p, words in clear[:NAMED]]


def _significance(lost: np.ndarray, fine: np.ndarray) -> tuple[float, bool]:
    """Return the probability of such ranks by chance, and whether those of `lost` are the larger ones."""
    test = scipy.stats.mannwhitneyu(lost, fine, alternative="two-sided")
    return float(test.pvalue), bool(test.statistic > 0.5 * lost.size * fine.size)


def has_steps_left(status: np.ndarray, divisors: np.ndarray) -> bool:
    """Return whether a further try takes any failed sample with smaller steps than were tried; shapes (N,)."""
    return bool(np.any(np.isin(status, RETRIED) & (divisors < FURTHER[-1])))
