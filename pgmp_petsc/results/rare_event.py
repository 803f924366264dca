"""The probability of a rare event, and the samples that it follows from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc.declare.records import Record, Result, array, attribute, check_shape, derived, run_record
from pgmp_petsc.results.statistics import MODELS
from pgmp_petsc.runtime.files import RunRecord, take

if TYPE_CHECKING:
    import h5py

KIND = "rare_event"


@dataclass(frozen=True, eq=False)
class MostLikely(Record):
    """Where an event is most likely: its design points, the most likely one first, in the space of normal variables."""

    beta: np.ndarray = array("point", about="distance of each design point from the origin in normal variables")
    normal: np.ndarray = array(
        "point", "drawn", about="design points in normal variables, in the order of parameters_drawn"
    )
    shares: np.ndarray = array("point", "drawn", about="importance shares of the parameters, alpha^2")
    parameters: dict[str, np.ndarray] = array(
        "point", about="values of '{name}' at the design points, SI units", ordered=True
    )
    is_exact: bool = attribute("@is_exact", about="whether they follow from exact derivatives, not from differences")
    n_runs: int = attribute("@n_runs", about="runs that were taken")

    @property
    def probability(self) -> np.ndarray:
        """Of the planes that touch the event's border there, ``Phi(-beta)`` (FORM), shape (n_points,)."""
        from scipy.special import ndtr

        return ndtr(-self.beta)


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

    kind = KIND
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
    parameters: dict[str, np.ndarray] = array("sample", about="values of '{name}', SI units", ordered=True)
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

    @property
    def reached(self) -> bool:
        """Whether the event was reached."""
        return bool(np.isfinite(self.estimate))

    @property
    def n_failed(self) -> int:
        """Number of samples that failed."""
        return int(np.count_nonzero(self.status))
