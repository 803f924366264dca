"""Figures of a better model, from few samples of it and many of cheaper ones on the same draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self

import h5py
import numpy as np

from pgmp_petsc.results.layout import check_shape
from pgmp_petsc.runtime.files import put, take


@dataclass(frozen=True)
class Figure:
    """A figure of the best model.

    Parameters
    ----------
    estimate, interval : float, ndarray of shape (2,)
        From the samples of all models; NaN where it is not known.
    alone, alone_interval : float, ndarray of shape (2,)
        From those of the best model alone; NaN of a bias, which one model has not.
    """

    estimate: float
    interval: np.ndarray
    alone: float = float("nan")
    alone_interval: np.ndarray = field(default_factory=lambda: np.full(2, np.nan))

    def __post_init__(self) -> None:
        check_shape("interval", self.interval, (2,))
        check_shape("alone_interval", self.alone_interval, (2,))

    @property
    def narrower(self) -> float:
        """How many times narrower the interval is than that of the best model alone; NaN where one is not known."""
        width, alone = (float(ends[1] - ends[0]) for ends in (self.interval, self.alone_interval))
        return alone / width if width > 0.0 and np.isfinite(alone) else float("nan")

    def write(self, group: h5py.Group, name: str, unit: str, of: str, confidence: float) -> None:
        """Write ``<name>``, ``<name>_interval`` and the two of the best model alone."""
        level = f"{100 * confidence:g} % confidence interval: {of}, the error of the cheaper models included"
        put(group, name, self.estimate, unit, f"{of}, from samples of all models")
        put(group, f"{name}_interval", self.interval, unit, level).attrs["confidence"] = confidence
        if np.isfinite(self.alone):
            put(group, f"{name}_alone", self.alone, unit, f"{of}, from the samples of the best model alone")
            put(group, f"{name}_alone_interval", self.alone_interval, unit, "its confidence interval")

    @classmethod
    def read(cls, group: h5py.Group, name: str) -> Self:
        """Read what `write` wrote."""
        known = float(take(group, name, 0)), take(group, f"{name}_interval", 1)
        if f"{name}_alone" not in group:
            return cls(*known)
        return cls(*known, float(take(group, f"{name}_alone", 0)), take(group, f"{name}_alone_interval", 1))


@dataclass(frozen=True)
class Corrected:
    """A quantity in the best model: of an output mean, deviation and bias, of an event its probability.

    Parameters
    ----------
    figures : dict of str to Figure
        ``mean``, ``std`` and ``bias`` (the mean of the ensemble's own model less that of the best one), or ``estimate``
        of a probability.
    counts : ndarray of int, shape (n_models,)
        Samples of each model that have a part, those of the best first.
    correlations, coefficients : ndarray, shape (n_models - 1,)
        Of the cheaper models with the best one, and with what each is taken; empty for a probability.
    """

    figures: dict[str, Figure]
    counts: np.ndarray
    correlations: np.ndarray
    coefficients: np.ndarray

    def write(self, group: h5py.Group, name: str, unit: str, confidence: float) -> None:
        """Write it into a group of its own."""
        words = {"mean": "mean", "std": "standard deviation", "bias": "mean of the ensemble's model less the best's"}
        for key, figure in self.figures.items():
            figure.write(group, key, unit, f"{words.get(key, 'probability')} of '{name}'", confidence)
        put(group, "samples", self.counts, "1", "samples of each model, the best first")
        put(group, "correlation", self.correlations, "1", "of the cheaper models with the best one")
        put(group, "coefficient", self.coefficients, "1", "with which the cheaper models are taken")

    @classmethod
    def read(cls, group: h5py.Group) -> Self:
        """Read what `write` wrote."""
        known = [name for name in ("mean", "std", "bias", "estimate") if name in group]
        return cls(
            {name: Figure.read(group, name) for name in known},
            take(group, "samples", 1),
            take(group, "correlation", 1),
            take(group, "coefficient", 1),
        )


@dataclass(frozen=True)
class Joined:
    """Several models of one scene on the same draws.

    Parameters
    ----------
    models : tuple of str
        The best first, that of the ensemble last.
    confidence : float
        Level of the intervals.
    corrected : dict of str to Corrected
        By quantity, and by label of an event.
    outputs : dict of str to dict of str to ndarray, shape (K,)
        Of the better models, by model and output; NaN where a sample failed.
    status : dict of str to ndarray of int, shape (K,)
        How their samples ended, by model.
    """

    models: tuple[str, ...]
    confidence: float
    corrected: dict[str, Corrected]
    outputs: dict[str, Mapping[str, np.ndarray]]
    status: dict[str, np.ndarray]

    def __post_init__(self) -> None:
        for model, status in self.status.items():
            for name, values in self.outputs[model].items():
                check_shape(f"'{name}' of {model}", values, status.shape)

    @property
    def n_failed(self) -> int:
        """Samples of the better models that failed."""
        return sum(int(np.sum(status != 0)) for status in self.status.values())

    def write(self, file: h5py.File, units: Mapping[str, str]) -> None:
        """Write ``/corrected`` and ``/better``."""
        target = file.create_group("corrected", track_order=True)
        target.attrs["models"] = list(self.models)
        target.attrs["confidence"] = self.confidence
        for name, one in self.corrected.items():
            one.write(target.create_group(name), name, units.get(name, "1") if "mean" in one.figures else "1",
                      self.confidence)  # fmt: skip
        for model, status in self.status.items():
            group = file.create_group(f"better/{_key(model)}")
            put(group, "status", status.astype(np.int32), "1", f"how each sample of {model} ended; 0 = fine")
            for name, values in self.outputs[model].items():
                about = f"output '{name}' of {model} at the end time, of the ensemble's first samples"
                put(group, f"outputs/{name}", values, units.get(name, "1"), about)

    @classmethod
    def read(cls, file: h5py.File) -> Self | None:
        """Read what `write` wrote; None where there is nothing."""
        if "corrected" not in file:
            return None
        group = file["corrected"]
        models = tuple(str(name) for name in group.attrs["models"])
        better = {model: file["better"][_key(model)] for model in models[:-1]}
        return cls(
            models,
            float(group.attrs["confidence"]),
            {name: Corrected.read(one) for name, one in group.items()},
            {model: {name: take(one["outputs"], name, 1) for name in one.get("outputs", {})}
             for model, one in better.items()},
            {model: take(one, "status", 1) for model, one in better.items()},
        )  # fmt: skip


def _key(model: str) -> str:
    """Return the name of a model's group: a slash would make another one."""
    return model.replace("/", ":")
