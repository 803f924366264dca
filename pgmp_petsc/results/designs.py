"""A design: parameters that meet a goal best under constraints.

Layout of the file (kind ``design``; root attributes ``goal``, ``constraints`` (JSON, their texts),
``parameters_designed`` and ``units`` (JSON), ``deviations`` (of robust figures; NaN: nominal), ``n_samples``,
``converged``; ``parameters`` holds the designed values):

============================ ======================== ===============================================================
dataset                      shape                    content
============================ ======================== ===============================================================
``/values``, ``/starts``     (n_parameters)           designed values, and where the search began
``/limits``                  (n_parameters, 2)        between which it went
``/goal``                    (2)                      the goal at the start and of the design
``/constraints``             (n_constraints, 2)       by how much each is missed, at the start and of the design;
                                                      negative: it holds with room to spare
``/goal_interval``           (2)                      confidence interval of the goal over other samples, attribute
                                                      ``confidence``; this and the next NaN of nominal figures
``/constraint_intervals``    (n_constraints, 2)       the same of by how much each is missed
``/active``                  (n_constraints)          whether the design is at it
``/search/designs``          (n, n_parameters)        designs that were tried, in order
``/search/goal``             (n)                      the goal there
``/time``                    (n_t)                    s
``/begun/<output>``          (n_t)                    outputs at the start, without deviations
``/designed/<output>``       (n_t)                    outputs of the design, without deviations
============================ ======================== ===============================================================
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field

import numpy as np

from pgmp_petsc.results.layout import check_shape, put_named, take_known, take_named, units_of
from pgmp_petsc.runtime.files import RunRecord, open_file, put, shapes_of, take, write_file

KIND = "design"


@dataclass(frozen=True)
class DesignParameter:
    """A parameter: its name and unit, where it began and ended, and the limits of the search."""

    name: str
    unit: str
    start: float
    value: float
    lower: float
    upper: float


@dataclass(frozen=True)
class DesignConstraint:
    """A constraint as it was written, by how much it is missed at the start and of the design, whether the design is at
    it, and between what it is missed over other samples, with the design's confidence; None of nominal figures."""

    text: str
    start: float
    value: float
    active: bool
    interval: tuple[float, float] | None = None


@dataclass(frozen=True)
class Design:
    """A design; attributes as of the file.

    Parameters
    ----------
    record : RunRecord
        With the designed values.
    goal : str
    goal_start, goal_value : float
    parameters : tuple of DesignParameter
    constraints : tuple of DesignConstraint
    tried : ndarray, shape (n, n_parameters)
    goals : ndarray, shape (n,)
    deviations : float or None
    n_samples : int
    time : ndarray, shape (n_t,)
    begun, designed : dict of str to ndarray, shape (n_t,)
    units : dict of str to str
    converged : bool
    goal_interval : ndarray, shape (2,)
    confidence : float
    """

    record: RunRecord
    goal: str
    goal_start: float
    goal_value: float
    parameters: tuple[DesignParameter, ...]
    constraints: tuple[DesignConstraint, ...]
    tried: np.ndarray
    goals: np.ndarray
    deviations: float | None
    n_samples: int
    time: np.ndarray
    begun: dict[str, np.ndarray]
    designed: dict[str, np.ndarray]
    units: dict[str, str]
    converged: bool
    goal_interval: np.ndarray = field(default_factory=lambda: np.full(2, np.nan))
    confidence: float = 0.95

    def __post_init__(self) -> None:
        check_shape("goal_interval", self.goal_interval, (2,))
        check_shape("tried", self.tried, (None, len(self.parameters)))
        check_shape("goals", self.goals, (len(self.tried),))
        for outputs in (self.begun, self.designed):
            for name, values in outputs.items():
                check_shape(f"output '{name}'", values, (len(self.time),))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file; by one process only. Raises as :func:`~pgmp_petsc.runtime.files.write_file`."""
        attributes = {
            "goal": self.goal,
            "constraints": json.dumps([constraint.text for constraint in self.constraints]),
            "parameters_designed": json.dumps([parameter.name for parameter in self.parameters]),
            "units": json.dumps([parameter.unit for parameter in self.parameters]),
            "deviations": np.nan if self.deviations is None else self.deviations,
            "n_samples": self.n_samples,
            "converged": self.converged,
        }
        with write_file(path, KIND, attributes) as file:
            self.record.write(file)
            unit = ", ".join(parameter.unit for parameter in self.parameters)
            put(file, "values", np.array([p.value for p in self.parameters]), unit, "designed values")
            put(file, "starts", np.array([p.start for p in self.parameters]), unit, "values at the start of the search")
            limits = np.array([[p.lower, p.upper] for p in self.parameters])
            put(file, "limits", limits, unit, "limits of the search")
            put(file, "goal", np.array([self.goal_start, self.goal_value]), "1", "goal at the start and of the design")
            missed = np.array([[c.start, c.value] for c in self.constraints]).reshape(-1, 2)
            put(file, "constraints", missed, "1", "by how much each is missed, at the start and of the design")
            about = f"{100 * self.confidence:g} % confidence interval over other samples; NaN of nominal figures"
            put(file, "goal_interval", self.goal_interval, "1", about).attrs["confidence"] = self.confidence
            ends = np.array([c.interval or (np.nan, np.nan) for c in self.constraints]).reshape(-1, 2)
            put(file, "constraint_intervals", ends, "1", about)
            active = np.array([c.active for c in self.constraints], dtype=np.int8)
            put(file, "active", active, "1", "whether the design is at the constraint")
            put(file, "search/designs", self.tried, unit, "designs that were tried")
            put(file, "search/goal", self.goals, "1", "the goal of these")
            put(file, "time", self.time, "s", "time")
            put_named(file, "begun", self.begun, self.units, "output '{name}' at the start of the search")
            put_named(file, "designed", self.designed, self.units, "output '{name}' of the design")

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Design:
        """Read a file; raises `InputError` where it is not a whole one."""
        with open_file(path, KIND) as file, shapes_of(file):
            names, units, texts = (
                json.loads(file.attrs[key]) for key in ("parameters_designed", "units", "constraints")
            )
            rows = [take_known(file, "starts", 1), take_known(file, "values", 1), *take_known(file, "limits", 2).T]
            missed, active = take_known(file, "constraints", 2), take(file, "active", 1)
            deviations = float(file.attrs["deviations"])
            nominal, of_goal = np.isnan(deviations), take(file, "goal_interval", 1)
            between = take(file, "constraint_intervals", 2)
            ends = [None if nominal else tuple(map(float, row)) for row in between]
            return cls(
                RunRecord.read(file),
                str(file.attrs["goal"]),
                *map(float, take_known(file, "goal", 1)),
                tuple(DesignParameter(*words, *map(float, row)) for *words, row in zip(names, units, np.array(rows).T)),
                tuple(
                    DesignConstraint(t, *map(float, m), bool(a), e) for t, m, a, e in zip(texts, missed, active, ends)
                ),
                take_known(file, "search/designs", 2),
                take(file, "search/goal", 1),
                None if np.isnan(deviations) else deviations,
                int(file.attrs["n_samples"]),
                take_known(file, "time", 1),
                take_named(file, "begun", 1, take_known),
                take_named(file, "designed", 1, take_known),
                units_of(file, "designed"),
                bool(file.attrs["converged"]),
                of_goal,
                float(file["goal_interval"].attrs["confidence"]),
            )
