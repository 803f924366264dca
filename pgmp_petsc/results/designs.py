"""A design: parameters that meet a goal best under constraints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc.declare.records import (
    Record,
    Result,
    array,
    attribute,
    check_known,
    check_shape,
    derived,
    run_record,
    units_of,
)
from pgmp_petsc.runtime.files import RunRecord, take

if TYPE_CHECKING:
    import h5py

KIND = "design"
UNKNOWN = float("nan")


@dataclass(frozen=True)
class DesignParameter(Record):
    """A parameter."""

    name: str = attribute("@parameters_designed", about="names of the parameters (JSON)")
    unit: str = attribute("@units", about="their units (JSON)")
    start: float = array(at="starts", unit="{own.unit}", about="values at the start of the search")
    value: float = array(at="values", unit="{own.unit}", about="designed values")
    lower: float = array(at="limits", part=0, unit="{own.unit}", about="limits of the search")
    upper: float = array(at="limits", part=1, unit="{own.unit}")


def _interval(row: np.ndarray) -> tuple[float, float] | None:
    return None if np.isnan(row).all() else (float(row[0]), float(row[1]))


@dataclass(frozen=True)
class DesignConstraint(Record):
    """A constraint as it was written, by how much it is missed at the start and of the design (negative: it holds with
    room to spare), whether the design is at it, and between what it is missed over other samples; None of nominal
    figures."""

    text: str = attribute("@constraints", about="the constraints (JSON)")
    start: float = array(at="constraints", part=0, about="by how much each is missed, at the start and of the design")
    value: float = array(at="constraints", part=1)
    active: bool = array(stored=np.int8, about="whether the design is at the constraint")
    interval: tuple[float, float] | None = array(
        2, at="constraint_intervals", default=None, gaps=True,
        code=(lambda ends: ends or (UNKNOWN, UNKNOWN), _interval),
        about="{own.confidence!p} confidence interval over other samples; NaN of nominal figures",
    )  # fmt: skip


def _goal(number: int) -> float:
    """Declare the goal at the start (0) or of the design (1)."""

    def found(file: h5py.Group, _: dict[str, Any]) -> float:
        values = check_known(file, "goal", take(file, "goal", 1))
        check_shape("goal", values.shape, (2,), {})
        return float(values[number])

    return array(found=found)


@dataclass(frozen=True)
class Design(Result):
    """A design; its record has the designed values."""

    kind = KIND
    record: RunRecord = run_record()
    goal: str = attribute("@goal", about="the goal as it was written")
    goal_start: float = _goal(0)
    goal_value: float = _goal(1)
    parameters: tuple[DesignParameter, ...] = array("parameter", at="")
    constraints: tuple[DesignConstraint, ...] = array("constraint", at="")
    tried: np.ndarray = array(
        "tried", "parameter", at="search/designs", unit="{own.unit}", about="designs that were tried"
    )
    goals: np.ndarray = array("tried", at="search/goal", about="the goal of these", gaps=True)
    deviations: float | None = attribute(
        "@deviations", about="of robust figures; NaN: nominal",
        code=(lambda own: UNKNOWN if own is None else own, lambda value: None if np.isnan(value) else float(value)),
    )  # fmt: skip
    n_samples: int = attribute("@n_samples", about="samples of robust figures")
    time: np.ndarray = array("time", unit="s", about="time")
    begun: dict[str, np.ndarray] = array(
        "time", unit="{unit}", about="output '{name}' at the start of the search", ordered=True
    )
    designed: dict[str, np.ndarray] = array("time", unit="{unit}", about="output '{name}' of the design", ordered=True)
    units: dict[str, str] = units_of("designed")
    converged: bool = attribute("@converged", about="whether the search converged")
    goal_interval: np.ndarray = array(
        2, default=np.full(2, UNKNOWN), gaps=True,
        about="{own.confidence!p} confidence interval over other samples; NaN of nominal figures",
    )  # fmt: skip
    confidence: float = attribute("goal_interval@confidence", default=0.95, about="level of the intervals")
    FURTHER = (
        derived(
            np.ndarray, lambda own, _: np.array([own.goal_start, own.goal_value]), "goal", 2,
            about="goal at the start and of the design",
        ),
    )  # fmt: skip

    @property
    def unit(self) -> str:
        """Units of the parameters."""
        return ", ".join(parameter.unit for parameter in self.parameters)
