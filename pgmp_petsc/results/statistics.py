"""Figures of an ensemble with their confidence intervals: statistics, probabilities of events, and bands over time.

Sobol indices of an output: which parameters its variance comes from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import h5py
import numpy as np

from pgmp_petsc.results.layout import check_shape
from pgmp_petsc.runtime.files import put, take

_SCALARS = {
    "mean": "mean",
    "std": "standard deviation",
    "mean_standard_error": "standard error of the mean",
    "std_standard_error": "standard error of the standard deviation",
}
DOUBT = 2.5  # times its estimate an error is larger than in 5 % of runs, see docs/method.md
_INTERVALS = {"mean_interval": "mean", "std_interval": "standard deviation"}


@dataclass(frozen=True)
class Statistics:
    """Statistics of one quantity, in the quantity's unit: of an output over the samples that are fine.

    Parameters
    ----------
    count : int
        Number of values.
    mean, std, mean_standard_error, std_standard_error : float
    pdf : ndarray, shape (n_bins,)
        Probability density, 1/unit.
    edges : ndarray, shape (n_bins + 1,)
        Limits of the bins; both arrays are empty where no sample is fine.
    quantiles, probabilities : ndarray, shape (n_quantiles,)
        Values and the probabilities that they belong to.
    quantile_bounds : ndarray, shape (n_quantiles, 2)
        Between which the quantiles of all samples lie, whatever the failed ones would have been.
    mean_interval, std_interval : ndarray, shape (2,)
        Confidence intervals; NaN where nothing is known.
    quantile_intervals : ndarray, shape (n_quantiles, 2)
        Confidence intervals of the quantiles; infinite where the sample is too small to have an end.
    confidence : float
        Level of the intervals.
    constant : bool
        Whether all values are the same but for round-off; they have no deviation then.
    """

    count: int
    mean: float
    std: float
    mean_standard_error: float
    std_standard_error: float
    pdf: np.ndarray
    edges: np.ndarray
    quantiles: np.ndarray
    quantile_bounds: np.ndarray
    probabilities: np.ndarray
    mean_interval: np.ndarray
    std_interval: np.ndarray
    quantile_intervals: np.ndarray
    confidence: float
    constant: bool = False

    def __post_init__(self) -> None:
        check_shape("pdf", self.pdf, (None,))
        check_shape("edges", self.edges, (len(self.pdf) + 1 if len(self.pdf) else 0,))
        check_shape("quantiles", self.quantiles, (None,))
        check_shape("quantile_bounds", self.quantile_bounds, (len(self.quantiles), 2))
        check_shape("probabilities", self.probabilities, (len(self.quantiles),))
        check_shape("mean_interval", self.mean_interval, (2,))
        check_shape("std_interval", self.std_interval, (2,))
        check_shape("quantile_intervals", self.quantile_intervals, (len(self.quantiles), 2))

    def write(self, group: h5py.Group, name: str, unit: str) -> None:
        """Write them into a group of their own."""
        put(group, "count", self.count, "1", f"number of values of '{name}' that these are of")
        group.attrs["constant"] = self.constant
        for scalar, words in _SCALARS.items():
            put(group, scalar, float(getattr(self, scalar)), unit, f"{words} of '{name}'")
        per_unit = "1" if unit == "1" else f"1/{unit}"
        put(group, "pdf", self.pdf, per_unit, f"probability density of '{name}'")
        put(group, "edges", self.edges, unit, "limits of the bins of the density")
        quantiles = put(group, "quantiles", self.quantiles, unit, f"quantiles of '{name}'")
        quantiles.attrs["probabilities"] = self.probabilities
        about = "between these lie the quantiles of all samples, whatever the failed ones would have been"
        put(group, "quantile_bounds", self.quantile_bounds, unit, about)
        for interval, words in _INTERVALS.items():
            _put_interval(group, interval, getattr(self, interval), unit, f"{words} of '{name}'", self.confidence)
        about = f"quantiles of '{name}'"
        _put_interval(group, "quantile_intervals", self.quantile_intervals, unit, about, self.confidence)

    @classmethod
    def read(cls, group: h5py.Group) -> Self:
        """Read what `write` wrote."""
        scalars = {scalar: float(take(group, scalar, 0)) for scalar in _SCALARS}
        arrays = {name: take(group, name, 1) for name in ("pdf", "edges", "quantiles", *_INTERVALS)}
        return cls(
            count=int(take(group, "count", 0)),
            **scalars,
            **arrays,
            quantile_bounds=take(group, "quantile_bounds", 2),
            quantile_intervals=take(group, "quantile_intervals", 2),
            probabilities=np.array(group["quantiles"].attrs["probabilities"]),
            confidence=float(group["mean_interval"].attrs["confidence"]),
            constant=bool(group.attrs.get("constant", False)),
        )


@dataclass(frozen=True)
class Chance:
    """The probability of an event.

    Parameters
    ----------
    event : str
        What comes true, in words.
    count, n : int
        Of how many samples that are fine, and of how many it is known.
    estimate : float
        NaN where it is known of none.
    interval : ndarray, shape (2,)
        Confidence interval; failed samples are outside the event at its lower end, and in it at its upper one.
    confidence : float
        Its level.
    n_failed : int
        Number of samples that failed.
    model_error : float
        Of the output, as a share of its largest size in a sample: what is estimated to be exceeded in no more than 5 %
        of samples; zero where nothing was reduced, NaN where it is not estimated.
    holds_to : float
        The largest such share with which the event is in doubt in too few samples to matter; NaN where it is not known.
    """

    event: str
    count: int
    n: int
    estimate: float
    interval: np.ndarray
    confidence: float
    n_failed: int = 0
    model_error: float = float("nan")
    holds_to: float = float("nan")

    def __post_init__(self) -> None:
        check_shape("interval", self.interval, (2,))

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

    def write(self, group: h5py.Group, label: str) -> None:
        """Write it into a group of its own."""
        put(group, "estimate", self.estimate, "1", f"probability of '{label}': {self.event}")
        _put_interval(group, "interval", self.interval, "1", f"probability of '{label}'", self.confidence)
        put(group, "count", self.count, "1", "number of samples in which it came true")
        put(group, "samples", self.n, "1", "number of samples of which it is known")
        about = "number of samples that failed: outside the event at the interval's lower end, in it at the upper one"
        put(group, "failed", self.n_failed, "1", about)
        about = "estimated error of the output, of its largest size in a sample, 0 of full order; NaN if not estimated"
        put(group, "model_error", self.model_error, "1", about)
        about = "largest such error with which the probability is decided by this model; NaN where it is not known"
        put(group, "holds_to", self.holds_to, "1", about)
        group.attrs["event"] = self.event
        group.attrs["decided"] = self.is_decided()

    @classmethod
    def read(cls, group: h5py.Group) -> Self:
        """Read what `write` wrote."""
        return cls(
            event=str(group.attrs["event"]),
            count=int(take(group, "count", 0)),
            n=int(take(group, "samples", 0)),
            estimate=float(take(group, "estimate", 0)),
            interval=take(group, "interval", 1),
            confidence=float(group["interval"].attrs["confidence"]),
            n_failed=int(take(group, "failed", 0)) if "failed" in group else 0,
            **{name: float(take(group, name, 0)) for name in ("model_error", "holds_to") if name in group},
        )


@dataclass(frozen=True)
class Band:
    """An output over time: what its samples do together.

    Parameters
    ----------
    time : ndarray, shape (n_t,)
        s.
    mean, std : ndarray, shape (n_t,)
        NaN where there are too few.
    quantiles : ndarray, shape (n_t, n_quantiles)
    probabilities : ndarray, shape (n_quantiles,)
    count : int
        Number of samples that these are of.
    """

    time: np.ndarray
    mean: np.ndarray
    std: np.ndarray
    quantiles: np.ndarray
    probabilities: np.ndarray
    count: int

    def __post_init__(self) -> None:
        check_shape("time", self.time, (None,))
        for name in ("mean", "std"):
            check_shape(name, getattr(self, name), self.time.shape)
        check_shape("probabilities", self.probabilities, (None,))
        check_shape("quantiles", self.quantiles, (len(self.time), len(self.probabilities)))

    def write(self, group: h5py.Group, name: str, unit: str) -> None:
        """Write it into a group of its own."""
        put(group, "time", self.time, "s", "instants")
        put(group, "mean", self.mean, unit, f"mean of output '{name}' over the samples at each instant")
        put(group, "std", self.std, unit, f"standard deviation of output '{name}' at each instant")
        quantiles = put(group, "quantiles", self.quantiles, unit, f"quantiles of output '{name}', instant by instant")
        quantiles.attrs["probabilities"] = self.probabilities
        put(group, "count", self.count, "1", "number of samples that these are of: the first ones that are fine")

    @classmethod
    def read(cls, group: h5py.Group) -> Self:
        """Read what `write` wrote."""
        return cls(
            **{name: take(group, name, 1) for name in ("time", "mean", "std")},
            quantiles=take(group, "quantiles", 2),
            probabilities=np.array(group["quantiles"].attrs["probabilities"]),
            count=int(take(group, "count", 0)),
        )


def _put_interval(group: h5py.Group, name: str, ends: np.ndarray, unit: str, of: str, confidence: float) -> None:
    """Write a confidence interval, or one a row."""
    about = f"{100 * confidence:g} % confidence interval: {of}; knows nothing of the model's error"
    put(group, name, ends, unit, about).attrs["confidence"] = confidence


@dataclass(frozen=True)
class Sensitivity:
    """First and total Sobol indices with their intervals; total ones only where samples were drawn for them.

    Parameters
    ----------
    parameters : tuple of str
        Names, in the order of the arrays.
    method : {"saltelli", "given data"}
    count : int
        Number of blocks, or of samples, that they are estimated from.
    confidence : float
        Level of the intervals.
    first, total : ndarray, shape (d,)
        ``S1`` and ``ST``; the latter None where it is not known.
    first_interval, total_interval : ndarray, shape (d, 2)
    """

    parameters: tuple[str, ...]
    method: str
    count: int
    confidence: float
    first: np.ndarray
    first_interval: np.ndarray
    total: np.ndarray | None = None
    total_interval: np.ndarray | None = None

    def __post_init__(self) -> None:
        d = len(self.parameters)
        check_shape("first", self.first, (d,))
        check_shape("first_interval", self.first_interval, (d, 2))
        if self.total is not None:
            check_shape("total", self.total, (d,))
            check_shape("total_interval", self.total_interval, (d, 2))

    def write(self, group: h5py.Group, name: str) -> None:
        """Write them into a group of their own."""
        group.attrs["parameters"] = list(self.parameters)
        group.attrs["method"] = self.method
        group.attrs["confidence"] = self.confidence
        put(group, "count", self.count, "1", "number of blocks, or of samples, that these are estimated from")
        put(group, "S1", self.first, "1", f"first Sobol indices of '{name}', in the order of attribute parameters")
        put(group, "S1_interval", self.first_interval, "1", f"{100 * self.confidence:g} % confidence intervals of S1")
        if self.total is not None:
            put(group, "ST", self.total, "1", f"total Sobol indices of '{name}', in the order of attribute parameters")
            about = f"{100 * self.confidence:g} % confidence intervals of ST"
            put(group, "ST_interval", self.total_interval, "1", about)

    @classmethod
    def read(cls, group: h5py.Group) -> Self:
        """Read what `write` wrote."""
        has_total = "ST" in group
        return cls(
            parameters=tuple(str(name) for name in group.attrs["parameters"]),
            method=str(group.attrs["method"]),
            count=int(take(group, "count", 0)),
            confidence=float(group.attrs["confidence"]),
            first=take(group, "S1", 1),
            first_interval=take(group, "S1_interval", 2),
            total=take(group, "ST", 1) if has_total else None,
            total_interval=take(group, "ST_interval", 2) if has_total else None,
        )
