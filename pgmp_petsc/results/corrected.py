"""Figures of a better model, from few samples of it and many of cheaper ones on the same draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgmp_petsc.declare.records import NEEDED, Context, Record, array, attribute, check_shape, derived

UNKNOWN = float("nan")
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
