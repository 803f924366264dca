"""Outputs of one run over time with their derivatives with parameters, as ``pgmp sensitivities`` finds them, and what
is found by these: parameters that fit a measured history, and a design, which meets a goal best under constraints.

The derivative of an extreme is that of the history there (the envelope theorem; Danskin 1966) only at the true extreme,
between instants: at an instant next to it there is ``(t_k - t*) dy'/dp`` besides, of first order in the step. The
vertex of the parabola through the values at three equally distant instants,

    s = (y_{k-1} - y_{k+1}) / (2 (y_{k-1} - 2 y_k + y_{k+1})),    -1/2 <= s <= 1/2,
    y* = y_k + s (y_{k+1} - y_{k-1}) / 2 + s^2 / 2 (y_{k-1} - 2 y_k + y_{k+1}),

does not move with s to first order, so that its derivative is the same expression of the derivatives: exact for y*, and
of second order in the step for the extreme of the history.

Between two instants a history that bends one way is below the straight lines through two instants before and behind.
A parabola that is above where these meet, on both sides of its instant, is refuted: there is a corner (a stop,
friction, a limit), which is taken to be where the lines meet, on the side where that is higher.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np

from pgmp_petsc.declare.records import (
    FLAGS,
    Record,
    Result,
    array,
    attribute,
    check_known,
    check_shape,
    derived,
    group_at,
    run_record,
    units_of,
)
from pgmp_petsc.files.hdf5 import RunRecord, take
from pgmp_petsc.results.ensemble import UNKNOWN

STRAIGHT = 0.3  # of the bend at an extreme: vibrations of 8 steps have 0.41 of it a step beside, or more
DEVIATION, PERCENT = "one standard deviation", "1 % of its value"


@dataclass(frozen=True)
class Figure:
    """A figure of an output: its value at one instant of the run, and its derivatives; of extremes see `vertex`."""

    name: str  # ``at the end``, ``largest`` or ``smallest``
    #: value, time: in the output's unit; s
    value: float
    time: float
    derivatives: np.ndarray  # with the parameters, shape (n_parameters,)


@dataclass(frozen=True, eq=False)
class Instants(Record):
    """Instants at which end stops are met and left, in order of time."""

    effects: tuple[str, ...] = array("contact", about="end stops that are met and left")
    met: np.ndarray = array("contact", about="1 where it is met, 0 where it is left", stored=int, code=FLAGS)
    time: np.ndarray = array("contact", unit="s", about="when")
    turning: np.ndarray = array("contact", unit="s", about="within which time the path would turn back there")
    derivatives: np.ndarray = array("contact", "parameter", unit="{units}", about="of the instants with the parameters")


def _extreme(about: str) -> Any:
    return array(unit="{unit}", about=f"{about} value of '{{name}}'")


def _its_derivatives(about: str) -> Any:
    words = f"derivatives of the {about} value of '{{name}}' with the parameters"
    return array("parameter", unit="{units}", about=words)


@dataclass(frozen=True, eq=False)
class Extremes(Record):
    """The largest and the smallest value of an output; found once, in the units of the run: the vertices of parabolas
    through nearly equal values would move with the last digits of the same values in other units."""

    max: float = _extreme("largest")
    time_of_max: float = array(unit="s", about="when it is the largest")
    max_derivatives: np.ndarray = _its_derivatives("largest")
    min: float = _extreme("smallest")
    time_of_min: float = array(unit="s", about="when it is the smallest")
    min_derivatives: np.ndarray = _its_derivatives("smallest")

    @classmethod
    def of(cls, time: np.ndarray, values: np.ndarray, rows: np.ndarray) -> Extremes:
        """Find those of a history, shape (n_t,), with its derivatives, shape (n_parameters, n_t)."""
        places = [vertex(values, sign) for sign in (1.0, -1.0)]
        return cls(
            *(one for place in places for one in (float(values[place.at]), float(time[place.at]), place.of(rows)))
        )


def _changes(group: h5py.Group, _: dict[str, Any]) -> dict[str, tuple[float, str]]:
    names = json.loads(group.attrs["parameters_differentiated"])
    values = {name: check_known(group, f"changes/{name}", take(group, f"changes/{name}", 0)) for name in names}
    return {name: (float(value), str(group[f"changes/{name}"].attrs["what"])) for name, value in values.items()}


@dataclass(frozen=True)
class Derivatives(Result):
    """Derivatives of one run.

    `changes` has of each parameter the change to which effects refer, and whether that is `DEVIATION` or `PERCENT`;
    `correlation` is zero where a parameter has no distribution, and `contacts` None where no end stop is met.
    """

    kind = "sensitivities"
    record: RunRecord = run_record()
    time: np.ndarray = array("time", unit="s", about="time", label="time", is_axis=True)
    outputs: dict[str, np.ndarray] = array(
        "time", unit="{unit}", about="output '{name}' over time", ordered=True, label="{name}"
    )
    derivatives: dict[str, dict[str, np.ndarray]] = array(
        "time", unit="{unit}", about="derivative of '{outer}' with '{name}'", ordered=True,
        label="derivative.{outer}.{name}",
        words=lambda own, name, at: {"unit": own.unit(at.words.get("name", ""), name)},
    )  # fmt: skip
    units: dict[str, str] = units_of("outputs", "changes")
    changes: dict[str, tuple[float, str]] = array("parameter", found=_changes)
    correlation: np.ndarray = array("parameter", "parameter", about="correlation of the parameters")
    steps_divided: int = attribute("@steps_divided", default=1, about="by what simulation.step was divided")
    contacts: Instants | None = array(
        absent=None, words=lambda own, *_: {"units": ", ".join(f"s/({own.units.get(n, '1')})" for n in own.changes)}
    )
    extremes: dict[str, Extremes] = array(
        default={}, words=lambda own, name, _: {"units": ", ".join(own.unit(name, other) for other in own.changes)}
    )
    FURTHER = (
        derived(
            tuple[str, ...], lambda own, _: json.dumps(own.parameters), "@parameters_differentiated", "parameter",
            about="names of the parameters (JSON)",
        ),
        derived(
            dict[str, float], lambda own, _: {name: change for name, (change, _) in own.changes.items()},
            "changes/{key}", unit="{unit}", about="{what} of '{name}'", label="change.{name}",
            words=lambda own, name, _: {"what": own.changes[name][1]},
        ),
        derived(
            dict[str, str], lambda own, _: {name: what for name, (_, what) in own.changes.items()},
            "changes/{key}@what", about="what change it is",
        ),
    )  # fmt: skip

    def __post_init__(self) -> None:
        if not self.outputs:
            raise ValueError("there are no outputs")
        for output in self.outputs:
            if self.derivatives[output].keys() != self.changes.keys():
                raise ValueError(f"derivatives of '{output}' are not with the parameters of the run")
        if not self.extremes:
            found = {one: Extremes.of(self.time, self.outputs[one], self._rows(one)) for one in self.outputs}
            object.__setattr__(self, "extremes", found)
        super().__post_init__()

    def converted_by_itself(self, convert: Callable[[Any, str], Any]) -> dict[str, Any]:
        found = {name: (float(convert(x, self.units[name])), what) for name, (x, what) in self.changes.items()}
        return {"changes": found}

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of n_parameters."""
        return tuple(self.changes)

    def unit(self, output: str, parameter: str) -> str:
        above, below = (self.units.get(name, "1") for name in (output, parameter))
        if below == "1":
            return above
        return f"{above}/({below})" if set(below) & set("/ *") else f"{above}/{below}"

    def effects(self, figure: Figure) -> np.ndarray:
        """Return what the changes of the parameters do to a figure, to first order, shape (n_parameters,)."""
        return figure.derivatives * np.array([change for change, _ in self.changes.values()])

    def deviation(self, figure: Figure) -> float:
        """Return the standard deviation of a figure, to first order: what all distributions do together."""
        effects = self.effects(figure)
        return float(np.sqrt(max(effects @ self.correlation @ effects, 0.0)))

    def figures(self, output: str) -> Iterator[Figure]:
        """Yield the figures of an output: at the end, the largest and the smallest."""
        own = self.extremes[output]
        yield Figure("at the end", float(self.outputs[output][-1]), float(self.time[-1]), self._rows(output)[:, -1])
        yield Figure("largest", own.max, own.time_of_max, own.max_derivatives)
        yield Figure("smallest", own.min, own.time_of_min, own.min_derivatives)

    def _rows(self, output: str) -> np.ndarray:
        """Return the derivatives of an output, shape (n_parameters, n_t)."""
        return np.array(list(self.derivatives[output].values()))


@dataclass(frozen=True)
class Vertex:
    """The vertex of the parabola through a value and those before and after it, or a corner of two straight lines."""

    at: int  # number of the instant
    offset: float  # by how much of a step it is later, from -1/2 to 1/2, of a corner to 1; 0 at both ends of a history
    beyond: float | None = None  # of a corner: share that the line through the two instants beyond it has in it

    def of(self, histories: np.ndarray) -> np.ndarray:
        """Return what the parabolas through histories have there, shape (...) for histories of shape (..., n_t)."""
        here = histories[..., self.at]
        if self.offset == 0.0:
            return here
        if self.beyond is not None:
            side, way = int(np.copysign(1, self.offset)), abs(self.offset)
            near, far, last = (histories[..., self.at + number * side] for number in (-1, 1, 2))
            ahead, back = here + way * (here - near), far + (1.0 - way) * (far - last)
            return (1.0 - self.beyond) * ahead + self.beyond * back
        before, after = histories[..., self.at - 1], histories[..., self.at + 1]
        return here + 0.5 * self.offset * (after - before) + 0.5 * self.offset**2 * (before - 2.0 * here + after)


def vertex(values: np.ndarray, sign: float) -> Vertex:
    """Return where a history of equally distant instants, shape (n_t,), has its largest value (sign 1), or its smallest
    (-1)."""
    at = int(np.argmax(sign * values))
    if not 0 < at < len(values) - 1:
        return Vertex(at, 0.0)
    before, here, after = values[at - 1 : at + 2]
    bend = before - 2.0 * here + after
    smooth = Vertex(at, float(0.5 * (before - after) / bend) if bend != 0.0 else 0.0)
    size = sign * values
    if not (1 < at < len(values) - 2 and size[at - 2] <= size[at - 1] and size[at + 1] >= size[at + 2]):
        return smooth
    corner = max((_corner(size, at, side) for side in (1, -1)), key=lambda one: one.of(size))
    return min(smooth, corner, key=lambda one: one.of(size))


def is_sharp(values: np.ndarray, at: int) -> bool:
    """Return whether a history bends much less a step beside its extreme than there, so that no parabola is known to
    follow it."""
    bends = np.diff(values[max(at - 2, 0) : at + 3], 2)
    return bends.size == 3 and bool(min(bends[0] * bends[1], bends[2] * bends[1]) < STRAIGHT * bends[1] ** 2)


def _corner(values: np.ndarray, at: int, side: int) -> Vertex:
    """Return where straight lines through the values before and behind an interval at the largest one meet."""
    near, here, far, last = (float(values[at + number * side]) for number in (-1, 0, 1, 2))
    rise, fall = here - near, far - last
    way = min(far + fall - here, rise + fall)
    return Vertex(at, side * way / (rise + fall), rise / (rise + fall)) if way > 0.0 else Vertex(at, 0.0, 0.0)


@dataclass(frozen=True)
class FittedParameter(Record):
    """A parameter: where it began and ended, its standard error, and the limits of its search."""

    name: str = attribute("@parameters_fitted", about="names of the parameters (JSON)")
    unit: str = attribute("@units", about="their units (JSON)")
    start: float = array(at="starts", unit="{own.unit}", about="values that the fit began with")
    estimate: float = array(at="estimates", unit="{own.unit}", about="fitted values of the parameters")
    error: float = array(at="standard_errors", unit="{own.unit}", about="standard errors; infinite: not identifiable")
    lower: float = array(at="limits", part=0, unit="{own.unit}", about="limits of the search")
    upper: float = array(at="limits", part=1, unit="{own.unit}")


def _history(at: str, words: str, gaps: bool = False) -> np.ndarray:
    about = f"output '{{name}}', {words}"
    return array("time", at=f"{at}/{{name}}", unit="{own.unit}", about=about, ordered=True, gaps=gaps)


@dataclass(frozen=True)
class FittedOutput(Record):
    """An output at the measured instants."""

    unit: str = attribute("measured/{name}@unit")
    measured: np.ndarray = _history("measured", "measured", gaps=True)
    fitted: np.ndarray = _history("fitted", "with fitted values")
    begun: np.ndarray = _history("begun", "begun with")
    noise: float = array(at="noise/{name}", unit="{own.unit}", about="deviation of the noise of '{name}'")
    noise_given: bool = attribute("noise/{name}@given", about="whether it was given")


@dataclass(frozen=True)
class Fit(Result):
    """A fit; its record has the fitted values."""

    kind = "fit"
    record: RunRecord = run_record()
    time: np.ndarray = array("time", unit="s", about="measured instants")
    outputs: dict[str, FittedOutput] = array(at="", names=lambda file, _: group_at(file, "measured"))
    parameters: tuple[FittedParameter, ...] = array("parameter", at="")
    correlation: np.ndarray = array("parameter", "parameter", about="correlation of the estimates", gaps=True)
    n_runs: int = attribute("@n_runs", about="runs that were differentiated")
    converged: bool = attribute("@converged", about="whether the fit converged")

    @property
    def unit(self) -> str:
        return ", ".join(parameter.unit for parameter in self.parameters)


@dataclass(frozen=True)
class DesignParameter(Record):
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
    measure: str = attribute("@constraint_units", absent="1", about="their units in the scene (JSON); 1: not known")


def _goal(number: int) -> float:

    def found(file: h5py.Group, _: dict[str, Any]) -> float:
        values = check_known(file, "goal", take(file, "goal", 1))
        check_shape("goal", values.shape, (2,), {})
        return float(values[number])

    return array(found=found)


@dataclass(frozen=True)
class Design(Result):
    """A design; its record has the designed values."""

    kind = "design"
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
    goal_unit: str = attribute("@goal_unit", absent="1", about="unit of the goal in the scene; 1: not known")
    FURTHER = (
        derived(
            np.ndarray, lambda own, _: np.array([own.goal_start, own.goal_value]), "goal", 2,
            about="goal at the start and of the design",
        ),
    )  # fmt: skip

    @property
    def unit(self) -> str:
        return ", ".join(parameter.unit for parameter in self.parameters)
