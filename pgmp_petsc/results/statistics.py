"""Figures of an ensemble with their confidence intervals: statistics, probabilities of events, and bands over time.

Sobol indices of an output: which parameters its variance comes from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pgmp_petsc.declare.records import Record, array, attribute, check_shape, derived

MODELS = ("full", "components", "reduced")
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
        "@constant",
        absent=False,
        about="whether all values are the same but for round-off; then they have no deviation",
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
        """Return whether the model is good enough for it, whose error is known: estimated, or given."""
        return bool(np.fmax(self.model_error, model_error) <= self.holds_to)

    @property
    def decided_by(self) -> str:
        """The command that decides it where the model does not."""
        return f"pgmp montecarlo SCENE --full -n {self.n + self.n_failed}"

    def doubt(self, model_error: float = float("nan")) -> str:
        """Return why the model does not decide it, and what does."""
        error = np.fmax(self.model_error, model_error)
        why = (
            f"too many samples are nearer to the level than its error, {100.0 * error:.3g} % of the output's largest "
            f"value (it would take one below {100.0 * self.holds_to:.3g} %)"
        )
        why = "too many samples lie on the level itself" if self.holds_to == 0.0 else why
        why = "its error is not known" if np.isnan(error) else "no sample tells" if np.isnan(self.holds_to) else why
        return f"not decided by this model: {why}; '{self.decided_by}' decides it"

    @property
    def of(self) -> str:
        """Of how many samples it is, and how many more failed: ``57 samples``."""
        failed = f", {self.n_failed} more failed and count both ways" if self.n_failed else ""
        return f"{self.n} samples{failed}"


@dataclass(frozen=True)
class Band(Record):
    """An output over time: what its samples do together; NaN where there are too few."""

    time: np.ndarray = array("time", unit="s", about="instants", label="time", is_axis=True)
    mean: np.ndarray = array(
        "time", unit="{unit}", about="mean of output '{name}' over the samples at each instant", gaps=True,
        label="mean.{name}",
    )  # fmt: skip
    std: np.ndarray = array(
        "time", unit="{unit}", about="standard deviation of output '{name}' at each instant", gaps=True,
        label="std.{name}",
    )  # fmt: skip
    quantiles: np.ndarray = array(
        "time", "probability", unit="{unit}", about="quantiles of output '{name}', instant by instant", gaps=True,
        label="quantile.{name}",
    )  # fmt: skip
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
