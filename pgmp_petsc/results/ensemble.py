"""Many runs with random parameters: values, outputs at the end time, and figures with their confidence intervals
(statistics, probabilities of events, bands over time, Sobol indices); why there are so many, better models on the same
draws, and shards, which ``pgmp merge`` joins. The probability of a rare event, with the samples that it follows from.

Samples that failed have NaN in all that follows from a run.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import h5py
import numpy as np
import scipy

from pgmp_petsc.base.errors import Remark, from_json, to_json
from pgmp_petsc.base.units import behind
from pgmp_petsc.declare.records import (
    FLAGS,
    JSON,
    NEEDED,
    NO_FILE,
    Context,
    Record,
    Result,
    array,
    attribute,
    check_shape,
    check_sizes,
    derived,
    group_at,
    run_record,
    units_in,
)
from pgmp_petsc.files.hdf5 import MODELS, RunRecord, take
from pgmp_petsc.results.estimates import BALANCE, OF_REDUCED, OF_STEP, VALIDITY
from pgmp_petsc.results.numbers import axis_unit, interval_text, number_text, share_text

DOUBT = 2.5  # times its estimate an error is larger than in 5 % of runs, see docs/method.md
DOUBT_IF_UNSURE = 12.5  # times it where it is unsure: the smallest of 34 presses was 0.08 of the error, see there
OF_MODEL, OF_TIME_STEP = "the model's", "the time step's"
UNKNOWN = float("nan")


def _number(about: str, *sizes: str | int, unit: str = "{unit}") -> Any:
    return array(*sizes, unit=unit, about=about, gaps=True)


def _interval(of: str, *sizes: str | int, unit: str = "{unit}") -> Any:
    """Declare a confidence interval, or one a row."""
    about = f"{{own.confidence!p}} confidence interval: {of}; knows nothing of the model's error"
    return array(*sizes, unit=unit, about=about, gaps=True)


@dataclass(frozen=True)
class Statistics(Record):
    """Statistics of one quantity, in the quantity's unit: of an output over the samples that are fine, of a parameter
    over all. Numbers are NaN where there are too few values, and ends of intervals of quantiles infinite; the density
    has no bins where there are none."""

    count: int = array(about="number of values of '{name}' that these are of")
    mean: float = _number("mean of '{name}'")
    std: float = _number("standard deviation of '{name}'")
    mean_standard_error: float = _number("standard error of the mean of '{name}'")
    std_standard_error: float = _number("standard error of the standard deviation of '{name}'")
    pdf: np.ndarray = array("bin", unit="{per_unit}", about="probability density of '{name}'", gaps=True)
    edges: np.ndarray = _number("limits of the bins of the density", "edge")
    quantiles: np.ndarray = _number("quantiles of '{name}'", "probability")
    quantile_bounds: np.ndarray = _number(
        "between these lie the quantiles of all samples, whatever the failed ones would have been", "probability", 2
    )
    probabilities: np.ndarray = attribute("quantiles@probabilities", "probability", about="of the quantiles")
    mean_interval: np.ndarray = _interval("mean of '{name}'", 2)
    std_interval: np.ndarray = _interval("standard deviation of '{name}'", 2)
    quantile_intervals: np.ndarray = _interval("quantiles of '{name}'", "probability", 2)
    confidence: float = attribute(
        "mean_interval@confidence", also=("std_interval@confidence", "quantile_intervals@confidence"),
        about="level of the intervals",
    )  # fmt: skip
    constant: bool = attribute(
        "@constant", absent=False, about="whether all values are the same but for round-off: they have no deviation"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_shape("edges", self.edges.shape, (len(self.pdf) + 1 if len(self.pdf) else 0,), {})


@dataclass(frozen=True)
class Chance(Record):
    """The probability of an event; failed samples are outside it at the lower end of the interval, in it at the upper
    one."""

    event: str = attribute("@event", about="what comes true, in words")
    count: int = array(about="number of samples in which it came true")
    n: int = array(at="samples", about="number of samples of which it is known")
    estimate: float = _number("probability of '{name}': {own.event}", unit="1")
    interval: np.ndarray = _interval("probability of '{name}'", 2, unit="1")
    confidence: float = attribute("interval@confidence", about="level of the interval")
    n_failed: int = array(
        at="failed", absent=0,
        about="number of samples that failed: outside the event at the interval's lower end, in it at the upper one",
    )  # fmt: skip
    model_error: float = array(
        about="estimated error of the output, of its largest size in a sample; NaN if not estimated",
        absent=UNKNOWN, gaps=True,
    )  # fmt: skip
    holds_to: float = array(
        about="largest such error with which the probability is decided by this model; NaN where it is not known",
        absent=UNKNOWN, gaps=True,
    )  # fmt: skip
    whose: str = attribute(
        "model_error@of", allowed=(OF_MODEL, OF_TIME_STEP), absent=OF_MODEL,
        about="whose error that is: the model's with its time step, or the time step's where nothing is reduced",
    )  # fmt: skip
    better: str = attribute(
        "@better", absent="--full", about="options of pgmp montecarlo of a model or step that decides it, or may"
    )
    FURTHER = (derived(bool, lambda own, _: own.is_decided(), "@decided", about="whether this model decides it"),)

    def is_decided(self, model_error: float = float("nan")) -> bool:
        """Return whether it is known, and the model good enough for it, whose error is known: estimated, or given."""
        return bool(np.fmax(self.model_error, model_error) <= self.holds_to) and not np.isnan(self.estimate)

    def is_of_mesh(self, of_mesh: float) -> bool:
        """Return whether no other model decides it, as the mesh's part of the error is too large by itself."""
        return of_mesh > self.holds_to > 0.0

    @property
    def decided_by(self) -> str:
        """The command that decides it where the model does not; empty where too many samples failed for a figure."""
        return "" if np.isnan(self.estimate) else f"pgmp montecarlo SCENE {self.better} -n {self.n + self.n_failed}"

    def doubt(self, model_error: float = float("nan"), full_order_stops: bool = False, of_mesh: float = 0.0) -> str:
        """Return why the model does not decide it, and what does, unless the full-order run stops before its end.

        `of_mesh` is the part of the error that is the mesh's, which all models have.
        """
        error, needed = np.fmax(self.model_error, model_error), share_text(self.holds_to, 3)
        of_step = self.whose == OF_TIME_STEP
        what = f"{self.whose if of_step else 'its'} error"
        near = f"too many samples are nearer to the level than {what}, {share_text(error, 3)} of the output's largest"
        why = f"{near} value (it would take one below {needed})"
        why = "too many samples lie on the level itself" if self.holds_to == 0.0 else why
        why = f"{what} is not known" if np.isnan(error) else "no sample tells" if np.isnan(self.holds_to) else why
        if self.is_of_mesh(of_mesh):
            finer = f"{share_text(of_mesh, 3)} of it the mesh's, so that only a finer mesh does: more elements"
            return f"not decided with this mesh: {why}, {finer}, or a smaller mesh_size"
        if of_step:
            return f"not decided with this time step: {why}; {self.decided_by!r} tells whether it stays"
        stops = "nor by the full-order model, whose run stops before its end"
        return f"not decided by this model: {why}; {stops if full_order_stops else f'{self.decided_by!r} decides it'}"

    @property
    def of(self) -> str:
        """Of how many samples it is, and how many more failed: ``57 samples``."""
        failed = f", {self.n_failed} more failed and count both ways" if self.n_failed else ""
        return f"{self.n} samples{failed}"


def _over_time(label: str, about: str, *sizes: str) -> Any:
    return array("time", *sizes, unit="{unit}", about=about, gaps=True, label=f"{label}.{{name}}")


@dataclass(frozen=True)
class Band(Record):
    """An output over time: what its samples do together; NaN where there are too few."""

    time: np.ndarray = array("time", unit="s", about="instants", label="time", is_axis=True)
    mean: np.ndarray = _over_time("mean", "mean of output '{name}' over the samples at each instant")
    std: np.ndarray = _over_time("std", "standard deviation of output '{name}' at each instant")
    quantiles: np.ndarray = _over_time("quantile", "quantiles of output '{name}', instant by instant", "probability")
    probabilities: np.ndarray = attribute(
        "quantiles@probabilities", "probability", about="of the quantiles", label="probability", is_axis=True
    )
    count: int = array(about="number of samples that these are of: the first ones that are fine")


_ORDER = "of '{name}', in the order of attribute parameters"
_OF_INDICES = "{own.confidence!p} confidence intervals of"


@dataclass(frozen=True)
class Sensitivity(Record):
    """First and total Sobol indices with their intervals; total ones only where samples were drawn for them."""

    parameters: tuple[str, ...] = attribute("@parameters", "parameter", about="names, in the order of the arrays")
    method: str = attribute("@method", about="saltelli or given data")
    count: int = array(about="number of blocks, or of samples, that these are estimated from")
    confidence: float = attribute("@confidence", about="level of the intervals")
    first: np.ndarray = array("parameter", at="S1", about=f"first Sobol indices {_ORDER}", gaps=True)
    first_interval: np.ndarray = array("parameter", 2, at="S1_interval", about=f"{_OF_INDICES} S1", gaps=True)
    total: np.ndarray | None = array(
        "parameter", at="ST", about=f"total Sobol indices {_ORDER}", gaps=True, absent=None
    )
    total_interval: np.ndarray | None = array(
        "parameter", 2, at="ST_interval", about=f"{_OF_INDICES} ST", gaps=True, absent=None
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.total is None) != (self.total_interval is None):
            raise ValueError("total Sobol indices and their intervals go together; one of them is missing")


@dataclass(frozen=True, eq=False)
class MostLikely(Record):
    """Where an event is most likely: its design points, the most likely one first, in the space of normal variables."""

    beta: np.ndarray = array("point", about="distance of each design point from the origin in normal variables")
    normal: np.ndarray = array(
        "point", "drawn", about="design points in normal variables, in the order of parameters_drawn"
    )
    shares: np.ndarray = array("point", "drawn", about="importance shares of the parameters, alpha^2")
    parameters: dict[str, np.ndarray] = array(
        "point", about="values of '{name}' at the design points, in the scene's units", ordered=True
    )
    is_exact: bool = attribute("@is_exact", about="whether they follow from exact derivatives, not from differences")
    n_runs: int = attribute("@n_runs", about="runs that were taken")

    @property
    def probability(self) -> np.ndarray:
        """Of the planes that touch the event's border there, ``Phi(-beta)`` (FORM), shape (n_points,)."""
        return scipy.special.ndtr(-self.beta)


def _curve(file: h5py.Group, _: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    value, probability = (take(file, f"curve/{name}", 1) for name in ("value", "probability"))
    check_shape("curve/probability", probability.shape, value.shape, {})
    return value, probability


@dataclass(frozen=True, eq=False)
class RareEvent(Result):
    """A rare event.

    `curve` has values of the output and how probable values beyond them are, as the levels know it. Failed samples are
    outside the event at the interval's lower end, and in it at the upper one; where the event was not reached it goes
    from 0 to a bound. Samples of exact derivatives, of `asked` ones, are not among the samples.
    """

    kind = "rare_event"
    model: str = attribute("@model", allowed=MODELS, about="full, components or reduced")
    record: RunRecord = run_record()
    event: str = attribute("@event", about="what comes true, in words")
    output: str = attribute("@output", about="the output that it is of")
    unit: str = attribute("samples/value@unit")
    confidence: float = attribute("@confidence", about="level of the interval")
    estimate: float = array(
        at="probability/estimate", about="probability of '{own.event}'; NaN where it was not reached", gaps=True
    )
    interval: np.ndarray = array(
        2, at="probability/interval", about="{own.confidence!p} confidence interval", gaps=True
    )
    variation: float = array(at="probability/variation", about="coefficient of variation of the estimate", gaps=True)
    at_most: float = array(
        at="probability/at_most", about="the estimate if all failed samples had been in the event", gaps=True
    )
    n_effective: float = array(
        at="probability/n_effective", gaps=True,
        about="number of equally weighted samples in the event that would be as good",
    )  # fmt: skip
    threshold: np.ndarray = array(
        "level", at="levels/threshold", unit="{own.unit}", about="of '{own.output}', of every level"
    )
    share: np.ndarray = array("level", at="levels/share", about="of the samples before that pass it")
    accepted: np.ndarray = array(
        "level", at="levels/accepted", about="share of the steps of its chains that were accepted", gaps=True
    )
    curve: tuple[np.ndarray, np.ndarray] = array(found=_curve)
    names: tuple[str, ...] = attribute(
        "@parameters_drawn", "drawn", about="parameters that are drawn, in the order of the normal variables"
    )
    normal: np.ndarray = array(
        "sample", "drawn", at="samples/normal", about="standard normal variables, in the order of parameters_drawn"
    )
    value: np.ndarray = array(
        "sample", at="samples/value", unit="{own.unit}", about="of '{own.output}', NaN of failed samples", gaps=True
    )
    weight: np.ndarray = array(
        "sample", at="samples/weight", about="of importance sampling; 0 of what only leads there"
    )
    parameters: dict[str, np.ndarray] = array("sample", about="values of '{name}', in the scene's units", ordered=True)
    status: np.ndarray = array("sample", about="how each sample ended, 0 = fine", stored=np.int32)
    most_likely: MostLikely | None = array(absent=None)
    asked: int = attribute("@asked", absent=0, about="samples that it might take")
    text: str = attribute("@text", absent="", about="the event as --rare takes it")
    FURTHER = (
        derived(
            np.ndarray, lambda own, _: own.curve[0], "curve/value", "value", unit="{own.unit}", gaps=True,
            about="of '{own.output}'",
        ),
        derived(
            np.ndarray, lambda own, _: own.curve[1], "curve/probability", "value", gaps=True,
            about="of beyond these values, as the levels know it",
        ),
    )  # fmt: skip

    def converted_by_itself(self, convert: Callable[[Any, str], Any]) -> dict[str, Any]:
        """Return the curve, and values of parameters, whose units are in the scene."""
        units = {name: one.get("unit", "1") for name, one in self.record.tables["parameters"].items()}

        def of(parameters: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
            return {name: convert(values, units[name]) for name, values in parameters.items()}

        likely = self.most_likely
        return {
            "curve": (convert(self.curve[0], self.unit), self.curve[1]),
            "parameters": of(self.parameters),
            "most_likely": None if likely is None else replace(likely, parameters=of(likely.parameters)),
        }

    @property
    def reached(self) -> bool:
        return bool(np.isfinite(self.estimate))

    @property
    def n_failed(self) -> int:
        return int(np.count_nonzero(self.status))


_UNIT = "as attribute units"


@dataclass(frozen=True)
class Stopping(Record):
    """Figures at every look, and why the last one was the last; without rules a budget alone decided."""

    why: str = attribute("@why", about="why it ended, in words")
    budget: float | None = attribute("@budget", about="wall time for the samples, s; empty where there was none")
    rules: tuple[str, ...] = attribute("@rules", "rule", about="texts of the rules")
    units: tuple[str, ...] = attribute("@units", "rule", about="units of their figures")
    wanted: np.ndarray = array(
        "rule", unit=_UNIT, gaps=True,
        about="half the width of its interval that each rule wants, a share of the figure where relative is 1",
    )  # fmt: skip
    relative: np.ndarray = array("rule", about="whether that is a share of the figure", stored=np.int32, code=FLAGS)
    met: np.ndarray = array("rule", about="whether each rule was met at the last look", stored=np.int32, code=FLAGS)
    samples: np.ndarray = array("look", about="number of samples at each look")
    estimates: np.ndarray = array("rule", "look", unit=_UNIT, about="figure of each rule at each look", gaps=True)
    intervals: np.ndarray = array(
        "rule", "look", 2, unit=_UNIT, about="confidence interval of each rule's figure at each look", gaps=True
    )

    def converted_by_itself(self, convert: Callable[[Any, str], Any]) -> dict[str, Any]:
        """Return figures, each in the unit of its rule; shares have none."""
        units = ["1" if is_share else unit for unit, is_share in zip(self.units, self.relative)]
        rows = {"wanted": units, "estimates": self.units, "intervals": self.units}
        found = {key: [convert(row, unit) for row, unit in zip(getattr(self, key), own)] for key, own in rows.items()}
        return {key: np.array(own).reshape(getattr(self, key).shape) for key, own in found.items()}

    @property
    def is_met(self) -> bool:
        return bool(np.all(self.met))

    @property
    def reached(self) -> np.ndarray:
        """Half the widths of the intervals, as `wanted` has them, shape (n_rules, n_looks); infinite where unknown."""
        return reach_of(self.estimates, self.intervals, self.relative[:, None])

    def lines(self) -> Iterator[str]:
        """Yield what is to be said on the screen."""
        yield f"  stopped after {int(self.samples[-1])} samples, look {len(self.samples)}: {self.why}"
        for text, unit, estimate, ends, share, relative, met in zip(
            self.rules, self.units, self.estimates[:, -1], self.intervals[:, -1], self.reached[:, -1], self.relative,
            self.met,
        ):  # fmt: skip
            unit = behind(unit)
            reached = f"{100 * share:.3g} %" if relative else f"{share:.3g}{unit}"
            known = f"{estimate:.6g}{unit} [{ends[0]:.6g}, {ends[1]:.6g}], +- {reached}"
            yield f"  {text:40s} {'met' if met else 'NOT MET':8s}{known if np.isfinite(share) else 'not known yet'}"


def reach_of(estimates: np.ndarray, intervals: np.ndarray, relative: np.ndarray | bool) -> np.ndarray:
    """Return half the widths of intervals (..., 2), as a share of the size of their figures (...) where relative; 0 of
    what is the same in all samples."""
    with np.errstate(all="ignore"):
        half = 0.5 * (intervals[..., 1] - intervals[..., 0])
        reach = np.where(relative & (half != 0.0), half / np.abs(estimates), half)
    return np.where(np.isfinite(reach), reach, np.inf)


PARAMETERS = "parameters."  # before the names of columns that are parameters
_REMARKS = (to_json, from_json)


@dataclass(frozen=True)
class Place:
    """Which part of which ensemble a shard is."""

    #: number, count: of the shard, from 1, and of shards
    number: int
    count: int
    n_samples: int  # of the whole ensemble
    first: int  # number of the first sample
    run: dict[str, object]  # what the ensemble is, by key; the same for all shards
    #: of the samples where they are from a file: its path, the identity of its content and the parameters it gives
    file: dict[str, object] | None = None


@dataclass(frozen=True)
class ShardSamples(Result):
    """The samples of a shard; the remarks of its record are those on the scene.

    `columns` are by ``<kind>.<name>``, and ``status`` and ``failure_time``; arrays of a file are read one by one.
    """

    kind, internal = "shard", True
    model: str = attribute("@model", allowed=MODELS, about="full, components or reduced")
    record: RunRecord = run_record()
    place: Place = attribute(
        "@shard", code=(lambda place: json.dumps(vars(place)), lambda text: Place(**json.loads(text))),
        about="which part it is of which ensemble (JSON)",
    )  # fmt: skip
    units: dict[str, str] = attribute("@units", code=JSON, about="of the outputs, by name (JSON)")
    not_estimated: tuple[Remark, ...] = attribute(
        "@not_estimated", code=_REMARKS, about="on errors that are not estimated (JSON)"
    )
    file_remarks: tuple[Remark, ...] = attribute("@file_remarks", code=_REMARKS, about="on a file of samples (JSON)")
    checked_share: float = attribute("@checked_share", about="of the samples whose errors are estimated")
    found: tuple[Remark, ...] = attribute(
        "@found", code=_REMARKS, about="on pieces of the checkpoint that were not taken up (JSON)"
    )
    columns: Mapping[str, np.ndarray] = array(
        "sample", unit="SI", about="{name} of each sample", ordered=True, colons=True, lazy=True,
        gaps=lambda name: not name.startswith(PARAMETERS),
    )  # fmt: skip
    bands: Mapping[str, np.ndarray] = array(
        "known", "time", unit="SI", about="{name} over time, one sample a row", ordered=True, colons=True, lazy=True,
        gaps=True,
    )  # fmt: skip

    def __post_init__(self) -> None:
        if not isinstance(self.units, dict):
            raise ValueError(f"units are {self.units!r}; needed: one of every output")
        if "status" not in [*self.columns]:
            raise ValueError("columns lack 'status'")
        sizes = check_sizes(self)
        if sizes.get("known", 0) > sizes["sample"]:
            raise ValueError(f"bands are of {sizes['known']} samples; needed: at most the {sizes['sample']} there are")

    @property
    def status(self) -> np.ndarray:
        """How each sample ended, 0 = fine, shape (n,)."""
        return self.columns["status"]


#: Read a shard; its arrays are read one by one, within the block.
read_shard = ShardSamples.opened


FIGURES = {
    "mean": "mean",
    "std": "standard deviation",
    "bias": "mean of the ensemble's model less the best's",
    "estimate": "probability",
}


def _of_best(own: Figure) -> bool:
    return bool(np.isfinite(own.alone))


@dataclass(frozen=True)
class Figure(Record):
    """A figure of the best model; of a bias one model alone has none."""

    estimate: float = array(at="{name}", unit="{unit}", about="{of}, from samples of all models", gaps=True)
    interval: np.ndarray = array(
        2, at="{name}_interval", unit="{unit}", gaps=True,
        about="{confidence!p} confidence interval: {of}, the error of the cheaper models included",
    )  # fmt: skip
    alone: float = array(
        at="{name}_alone", unit="{unit}", about="{of}, from the samples of the best model alone", gaps=True,
        absent=UNKNOWN, when=_of_best,
    )  # fmt: skip
    alone_interval: np.ndarray = array(
        2, at="{name}_alone_interval", unit="{unit}", about="its confidence interval", gaps=True,
        default=np.full(2, UNKNOWN),
        absent=lambda taken: NEEDED if np.isfinite(taken["alone"]) else np.full(2, UNKNOWN), when=_of_best,
    )  # fmt: skip
    FURTHER = (derived(float, lambda _, at: at.words["confidence"], "{name}_interval@confidence"),)

    @property
    def narrower(self) -> float:
        """How many times narrower the interval is than that of the best model alone; NaN where one is not known."""
        width, alone = (float(ends[1] - ends[0]) for ends in (self.interval, self.alone_interval))
        return alone / width if width > 0.0 and np.isfinite(alone) else float("nan")


def _words(own: Corrected, name: str, at: Context) -> dict[str, Any]:
    unit = at.words["unit"] if "mean" in own.figures else "1"
    return {"unit": unit, "of": f"{FIGURES[name]} of '{at.words['name']}'"}


@dataclass(frozen=True)
class Corrected(Record):
    """A quantity in the best model: of an output mean, deviation and bias (the mean of the ensemble's own model less
    that of the best one), of an event its probability, ``estimate``."""

    figures: dict[str, Figure] = array(at="", words=_words, names=lambda group, _: [k for k in FIGURES if k in group])
    counts: np.ndarray = array("model", at="samples", about="samples of each model, the best first")
    correlations: np.ndarray = array(
        "cheaper", at="correlation", about="of the cheaper models with the best one", gaps=True
    )
    coefficients: np.ndarray = array(
        "cheaper", at="coefficient", about="with which the cheaper models are taken", gaps=True
    )


@dataclass(frozen=True)
class Joined(Record):
    """Several models of one scene on the same draws: figures by quantity and by label of an event, and the samples of
    the better models; a failed one has NaN."""

    models: tuple[str, ...] = attribute("corrected@models", "model", about="the best first, that of the ensemble last")
    confidence: float = attribute("corrected@confidence", about="level of the intervals")
    corrected: dict[str, Corrected] = array(ordered=True, words=lambda own, *_: {"confidence": own.confidence})
    outputs: dict[str, Mapping[str, np.ndarray]] = array(
        "...", at="better/{key}/outputs", unit="{unit}", colons=True, gaps=True,
        about="output '{name}' of {outer} at the end time, of the ensemble's first samples",
        names=lambda _, taken: taken["models"][:-1],
    )  # fmt: skip
    status: dict[str, np.ndarray] = array(
        "...", at="better/{key}/status", about="how each sample of {name} ended; 0 = fine", stored=np.int32,
        colons=True, names=lambda _, taken: taken["models"][:-1],
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        for model, status in self.status.items():
            for name, values in self.outputs[model].items():
                check_shape(f"outputs '{name}' of {model}", values.shape, status.shape, {})

    @property
    def n_failed(self) -> int:
        """Samples of the better models that failed."""
        return sum(int(np.sum(status != 0)) for status in self.status.values())


#: What is known of an output over time, sample by sample.
EXTREMES = {
    "max": "largest value of output '{name}' over time; NaN where the sample failed",
    "min": "smallest value of output '{name}' over time; NaN where the sample failed",
    "time_of_max": "instant of the largest value of output '{name}'",
    "time_of_min": "instant of the smallest value of output '{name}'",
}
UNSTABLE = "unstable_start"  # 1 where a sample began on an unstable static equilibrium, by name in `Ensemble.kept`
DESCRIBED = ("max", "min")  # of these, by statistics ``<output>.<which>``


def _of_extremes(own: Ensemble, key: str, _: object) -> dict[str, Any]:
    """Return what texts say of a name of `Ensemble.extremes`."""
    name, _, which = key.rpartition("/")
    unit = "s" if which.startswith("time") else own.units.get(name, "1")
    return {"unit": unit, "about": EXTREMES[which].format(name=name), "which": which, "of": name}


def _extremes(file: h5py.Group, _: object) -> Iterable[str]:
    outputs = group_at(file, "extremes") if "extremes" in file else ()
    return [f"{name}/{which}" for name in outputs for which in EXTREMES]


def _units(file: h5py.Group, _: object) -> dict[str, str]:
    """Return the unit of everything that has statistics."""
    units = units_in(file, "parameters", "outputs", "first_passages")
    return units | {f"{name}.{which}": units[name] for name in file.get("extremes", {}) for which in DESCRIBED}


def _of_samples(about: str, **how: Any) -> Any:
    """Declare arrays by name with a number for each sample, those that are not asked for being absent."""
    return array("sample", about=about, gaps=True, absent={}, **how)


def _has_errors(own: Ensemble) -> bool:
    return bool(own.errors)


@dataclass(frozen=True)
class Ensemble(Result):
    """N samples of the full-order or the reduced model.

    `units` has those of parameters, outputs, first passages and described extremes. Estimates (`errors`,
    `errors_at_end`, `errors_unsure`, `validity`) are empty where no sample was to have one, `balance`, `extremes` and
    `first_passages` where they were not asked for; `extremes` are by ``<output>/max`` and others. `stopping` says why
    it ended, where the number of samples was not given.
    """

    kind = "ensemble"
    model: str = attribute("@model", allowed=MODELS, about="full, components or reduced")
    record: RunRecord = run_record()
    parameters: Mapping[str, np.ndarray] = array(
        "sample", unit="{unit}", about="sampled values of parameter '{name}'", ordered=True, label="parameter.{name}"
    )
    outputs: Mapping[str, np.ndarray] = array(
        "sample", unit="{unit}", about="output '{name}' at the end time", ordered=True, gaps=True, label="{name}"
    )
    units: dict[str, str] = array(found=_units)
    status: np.ndarray = array(
        "sample", about="how each sample ended; 0 = fine", stored=np.int32, label="sample.status"
    )
    meanings: dict[int, str] = attribute(
        "status@meanings", about="texts by number (JSON)",
        code=(
            lambda meanings: json.dumps({str(number): text for number, text in meanings.items()}),
            lambda text: {int(number): meaning for number, meaning in json.loads(text).items()},
        ),
    )  # fmt: skip
    failure_time: np.ndarray = array(
        "sample", unit="s", about="instant of failure; NaN where fine", gaps=True, label="sample.failure_time"
    )
    steps_divided: np.ndarray = array(
        "sample", about="by what simulation.step was divided in the last attempt", stored=np.int32
    )
    statistics: dict[str, Statistics] = array()
    errors: Mapping[str, np.ndarray] = _of_samples(
        "largest estimated error of output '{name}' over the run; NaN where not estimated", unit="{unit}",
        ordered=True, when=_has_errors, label="error.{name}",
    )  # fmt: skip
    errors_at_end: Mapping[str, np.ndarray] = _of_samples(
        "estimated error of output '{name}' at the end time, {own.what_errors}", unit="{unit}", ordered=True,
        when=_has_errors,
    )  # fmt: skip
    errors_unsure: Mapping[str, np.ndarray] = _of_samples(
        "1 where the estimated error of output '{name}' is unsure, which may then be several times too small or too "
        "large, 0 where it is not; NaN where not estimated", ordered=True, when=_has_errors,
    )  # fmt: skip
    validity: Mapping[str, np.ndarray] = _of_samples(
        "{about}", unit="{unit}", keys=VALIDITY, label="validity.{name}",
    )  # fmt: skip
    balance: Mapping[str, np.ndarray] = _of_samples(
        "{about}", at="energy", unit="{unit}", keys=BALANCE, label="energy.{name}",
    )  # fmt: skip
    extremes: Mapping[str, np.ndarray] = _of_samples(
        "{about}",
        unit="{unit}",
        words=_of_extremes,
        names=_extremes,
        label="{which}.{of}",
        keys={f"<name>/{which}": {"about": about} for which, about in EXTREMES.items()},
    )
    first_passages: Mapping[str, np.ndarray] = _of_samples(
        "instant of the first passage of '{name}'; NaN where there is none", unit="s", label="first_passage.{name}"
    )
    probabilities: dict[str, Chance] = array(ordered=True, absent={})
    bands: dict[str, Band] = array(ordered=True, absent={})
    sobol: dict[str, Sensitivity] = array(ordered=True, absent={})
    stopping: Stopping | None = array(absent=None)
    joined: Joined | None = array(at="", absent=None)
    kept: Mapping[str, np.ndarray] = array(
        "...", unit="SI", about="{name} of the samples, for a further try of those that failed", gaps=True, absent={}
    )
    FURTHER = (
        derived(
            np.ndarray, lambda own, _: np.arange(len(own.status)), NO_FILE, "sample", about="number of the sample",
            label="sample", is_axis=True,
        ),
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, values in self.kept.items():  # one number for each sample, or bands of the first of them
            sizes = ("sample",) if name == UNSTABLE else ("known", "time")
            check_shape(f"kept '{name}'", values.shape, sizes, {"sample": len(self.status)})
        unknown = set(np.unique(self.status).tolist()) - self.meanings.keys()
        if unknown:
            raise ValueError(f"status {sorted(unknown)} has no meaning; known: {sorted(self.meanings)}")

    def answer(
        self, model_error: Callable[[str], tuple[float, float]] = lambda _: (float("nan"), 0.0), stops: bool = False
    ) -> str:
        """Return the probability of the first event or, without events, the mean of the last output, in words.

        What is known besides of the model's error, as a share, and the mesh's part of it come of the label of an event;
        where the full-order run `stops` before its end it decides nothing.
        """
        for label, chance in self.probabilities.items():
            ends, (error, of_mesh) = 100.0 * chance.interval, model_error(label)
            if np.isnan(chance.estimate):
                return f"P({chance.event}) is not known {interval_text(ends)} %"
            if chance.is_decided(error):
                return f"P({chance.event}) = {number_text(100 * chance.estimate, ends, 6)} % {interval_text(ends)}"
            return f"P({chance.event}) is {chance.doubt(error, stops, of_mesh)}"
        described = [name for name in self.outputs if name in self.statistics]
        # the last output that varies; sorted is stable
        for name in sorted(reversed(described), key=lambda name: self.statistics[name].constant):
            s, unit = self.statistics[name], self.units.get(name, "1")
            factor, shown = axis_unit(unit, np.array([s.mean]))
            mean, ends = factor * s.mean, factor * s.mean_interval
            words = f"{mean:.7g}" if s.constant else f"{number_text(mean, ends, 7)} {interval_text(ends)}"
            words += ("" if unit == "1" else f" {shown}") + (", constant" if s.constant else "")
            return f"mean {name} {words if np.isfinite(s.mean) else 'is not known'}"
        return "no output is described"

    @property
    def without_passage(self) -> frozenset[str]:
        """Labels of events of which no sample, of those that did not fail, has a first passage."""
        fine = self.status == 0
        return frozenset(name for name, at in self.first_passages.items() if fine.any() and np.isnan(at[fine]).all())

    @property
    def what_errors(self) -> str:
        """The model or step whose errors are estimated, in words."""
        return OF_REDUCED if self.model == "reduced" else OF_STEP
