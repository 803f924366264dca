"""Figures of an ensemble with their confidence intervals: statistics, probabilities of events, bands over time, and
Sobol indices, which parameters the variance of an output comes from; and the probability of a rare event, with the
samples that it follows from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import h5py
import numpy as np
import scipy

from pgmp_petsc.declare.records import Record, Result, array, attribute, check_shape, derived, run_record
from pgmp_petsc.files.hdf5 import MODELS, RunRecord, take
from pgmp_petsc.results.numbers import share_text

DOUBT = 2.5  # times its estimate an error is larger than in 5 % of runs, see docs/method.md
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
        about="estimated error of the output, of its largest size in a sample, 0 of full order; NaN if not estimated",
        absent=UNKNOWN, gaps=True,
    )  # fmt: skip
    holds_to: float = array(
        about="largest such error with which the probability is decided by this model; NaN where it is not known",
        absent=UNKNOWN, gaps=True,
    )  # fmt: skip
    FURTHER = (derived(bool, lambda own, _: own.is_decided(), "@decided", about="whether this model decides it"),)

    def is_decided(self, model_error: float = float("nan")) -> bool:
        """Return whether it is known, and the model good enough for it, whose error is known: estimated, or given."""
        return bool(np.fmax(self.model_error, model_error) <= self.holds_to) and not np.isnan(self.estimate)

    @property
    def decided_by(self) -> str:
        """The command that decides it where the model does not; empty where too many samples failed for a figure."""
        return "" if np.isnan(self.estimate) else f"pgmp montecarlo SCENE --full -n {self.n + self.n_failed}"

    def doubt(self, model_error: float = float("nan"), full_order_stops: bool = False) -> str:
        """Return why the model does not decide it, and what does, unless the full-order run stops before its end."""
        error, needed = np.fmax(self.model_error, model_error), share_text(self.holds_to, 3)
        near = (
            f"too many samples are nearer to the level than its error, {share_text(error, 3)} of the output's largest"
        )
        why = f"{near} value (it would take one below {needed})"
        why = "too many samples lie on the level itself" if self.holds_to == 0.0 else why
        why = "its error is not known" if np.isnan(error) else "no sample tells" if np.isnan(self.holds_to) else why
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
