"""The cost of accuracy: errors and times of many settings of all models, and of response surfaces.

Every setting is measured by one serial process; of several times the least is kept. Columns of settings are 0, false or
empty where they have no meaning, numbers NaN where a setting failed.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgmp_petsc.declare.records import JSON, Record, Result, array, attribute, derived, run_record, units_of
from pgmp_petsc.files.hdf5 import RunRecord, take

FAMILIES = ("reduced", "components", "full", "surface")
BUSY = 1.2  # wall time over processor time above which a machine had other things to do
# columns that settings are named by
_NEEDED = (
    "angles", "component_modes", "coordinates", "inertia_modes", "interpolation", "modes", "nodes", "parameter_modes",
    "refinement", "second_order", "static_modes", "step",
)  # fmt: skip
_PLACES = {
    "wall": {"offline": "offline", "batch": "online/batch", "single": "online/single"},
    "processor": {name: f"processor/{name}" for name in ("offline", "batch", "single")},
}
_TIMES = {
    "offline": "before the first sample",
    "batch": "a sample, {own.batch} together",
    "single": "of one sample alone",
}
_SHARE = "as a share of the output's largest value"


@dataclass(frozen=True)
class References(Record):
    """The converged full-order runs that errors are measured against, one for every mesh."""

    refinement: np.ndarray = array("mesh", about="parts of every cell")
    step: np.ndarray = array("mesh", unit="s", about="last step of the reference", gaps=True)
    moved: np.ndarray = array("mesh", "output", about="change at the last halving of the step", gaps=True)
    reason: tuple[str, ...] = array("mesh", about="why it was not refined further")


@dataclass(frozen=True)
class MeshErrors(Record):
    """Discretisation errors: full-order runs on refined meshes, all with the scene's step; none of continuum cells."""

    refinement: np.ndarray = array("refined", about="parts of every cell")
    cells: np.ndarray = array("refined", about="cells of all bodies")
    errors: np.ndarray = array("refined", "output", about="difference to the finest mesh", gaps=True)


@dataclass(frozen=True)
class Times(Record):
    """Times of settings by one clock: before the first sample, of a sample in a batch, and of one alone, s; NaN where
    the setting failed."""

    offline: np.ndarray = array("setting", unit="s", gaps=True)
    batch: np.ndarray = array("setting", unit="s", gaps=True)
    single: np.ndarray = array("setting", unit="s", gaps=True)


def _times(clock: str) -> Times:
    return array(found=lambda file, _: Times(*(take(file, place, 1) for place in _PLACES[clock].values())))


def _time(clock: str, name: str) -> Any:
    return derived(
        np.ndarray, lambda own, _: getattr(getattr(own, clock), name), _PLACES[clock][name], "setting", unit="s",
        about=f"{clock} time {_TIMES[name]}", gaps=True,
    )  # fmt: skip


@dataclass(frozen=True)
class Tradeoff(Result):
    """Errors and times of n settings, of which the first is the scene's own.

    Times are by the clock on the wall, and processor times of the one serial process that measured a setting. A line of
    `advice` that begins with ``--`` has options to paste.
    """

    kind = "tradeoff"
    record: RunRecord = run_record()
    units: dict[str, str] = attribute(
        "errors@units", "output", code=JSON, about="units of the outputs, in the order of the columns (JSON)"
    )
    test_values: dict[str, np.ndarray] = array(
        "test", at="parameters", unit="{unit}", about="test values of '{name}'", ordered=True,
        words=lambda own, name, _: {"unit": own.parameter_units.get(name, "1")},
    )  # fmt: skip
    parameter_units: dict[str, str] = units_of("parameters")
    families: tuple[str, ...] = array(
        "setting", at="settings/family", about="reduced, component or full-order model, or response surface",
        allowed=FAMILIES,
    )  # fmt: skip
    columns: dict[str, Any] = array(
        "setting", at="settings", unit="{unit}", about="{column} of the setting", ordered=True, gaps=True,
        words=lambda own, name, _: {"unit": "s" if name == "step" else "1", "column": name.replace("_", " ")},
    )  # fmt: skip
    flags: tuple[str, ...] = array(
        "setting", at="settings/flags", about="options of pgmp that turn the scene into the setting"
    )
    reasons: tuple[str, ...] = array(
        "setting", at="settings/reason", about="why the setting failed; empty where it did not"
    )
    errors: np.ndarray = array(
        "setting", "output", about=f"largest error over time and test values, {_SHARE}", gaps=True
    )
    wall: Times = _times("wall")
    processor: Times = _times("processor")
    references: References = array(at="reference")
    mesh: MeshErrors = array()
    batch: int = attribute("@batch", about="samples that were timed together")
    repeats: int = attribute("@repeats", about="how often each time was taken; the least is kept")
    samples: int = attribute("@samples", default=1, about="number of samples that the advice is for")
    quick: bool = attribute("@quick", default=False, about="whether fewer settings were measured")
    waiting: float = attribute(
        "@waiting", default=1.0, about="wall time over processor time of the timed runs; 1 on a quiet machine"
    )
    advice: tuple[str, ...] = array("sentence", about="which setting to take", default=())
    reference: str = attribute("@reference", default="", about="why that, and how far it is from the mesh")
    reference_model: str = attribute(
        "@reference_model", default="full", about="what errors are against: full for the mesh, or components"
    )
    rigid_coordinates: int = attribute("@rigid_coordinates", default=1, about="number of rigid coordinates")
    FURTHER = (
        derived(
            tuple[str, ...], lambda own, _: json.dumps(own.outputs), "errors@names", "output",
            about="names of the outputs (JSON)",
        ),
        *(_time(clock, name) for clock in _PLACES for name in _TIMES),
        derived(
            np.ndarray, lambda own, _: own.pareto, "pareto", "setting", "output", stored=np.int8,
            about="1 where none of its kind is cheaper and better",
        ),
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        missing = set(_NEEDED) - self.columns.keys()
        if missing:
            raise ValueError(f"/settings lacks {', '.join(sorted(missing))}")

    @property
    def busy(self) -> bool:
        """Whether the machine had so much else to do that wall times say little."""
        return self.waiting > BUSY

    @property
    def times(self) -> Times:
        """The times to compare: by the wall, or processor times where the machine was busy.

        On a quiet machine both are the same, because every setting is measured by one serial process.
        """
        return self.processor if self.busy else self.wall

    @property
    def outputs(self) -> list[str]:
        return list(self.units)

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the parameters that differ between test values."""
        return tuple(name for name, values in self.test_values.items() if np.ptp(values) > 0.0)

    @property
    def simulated(self) -> np.ndarray:
        """Settings of one of the models, not of a response surface, shape (n,)."""
        return np.array([family != "surface" for family in self.families], dtype=bool)

    @property
    def own_mesh(self) -> np.ndarray:
        """Settings on the scene's own meshes, whose errors are against the same reference, shape (n,)."""
        return self.columns["refinement"] == 1

    @property
    def pareto(self) -> np.ndarray:
        """Settings on the scene's meshes than which none of its family is cheaper online and better, (n, n_outputs)."""
        return self.fronts(self.times.batch)

    def fronts(self, cost: np.ndarray) -> np.ndarray:
        """Return the fronts as `pareto` does, for any cost of shape (n,)."""
        result = np.zeros(self.errors.shape, dtype=bool)
        for family in FAMILIES:
            kind = self.own_mesh & (np.array(self.families) == family)
            for column in range(self.errors.shape[1]):
                result[kind, column] = pareto_front(cost[kind], self.errors[kind, column])
        return result

    def total_seconds(self, n_samples: int) -> np.ndarray:
        """Return the time of n samples, build and preparation included, shape (n,), s."""
        return self.times.offline + n_samples * self.times.batch

    def name(self, row: int) -> str:
        """Return a setting in words: ``reduced, 7 + 1 modes, 48 angles, spline, 1 ms``."""
        at = {name: values[row] for name, values in self.columns.items()}
        if self.families[row] == "surface":
            return f"response surface, {at['nodes']} {self.reference_runs}"
        words = ["full order"]
        if self.families[row] == "components":
            words = ["component modes", f"for {at['component_modes']} modes"]
        if self.families[row] == "reduced":
            words = ["reduced", f"{self.modes(row)} modes", f"{at['angles']} angles", str(at["interpolation"])]
            # else two settings may read the same
            words += ["inertia modes alone"] if at["inertia_modes"] and not at["static_modes"] else []
            words += ["second order"] if at["second_order"] else []
        words.append(f"{1e3 * at['step']:.4g} ms")
        words += [f"cells / {at['refinement']}"] if at["refinement"] > 1 else []
        return ", ".join(words)

    @property
    def reference_runs(self) -> str:
        """Runs that a response surface goes through, in words."""
        return "component runs" if self.reference_model == "components" else "full-order runs"

    def modes(self, row: int) -> str:
        """Return ``7 + 1 + 2``: modes, static modes and those of other parameters; without those it has not."""
        n_modes, n_coordinates = int(self.columns["modes"][row]), int(self.columns["coordinates"][row])
        n_parameter = int(self.columns["parameter_modes"][row])
        words = [str(n_modes)]
        if self.columns["static_modes"][row] or self.columns["inertia_modes"][row]:
            # a setting that failed has none to count
            words.append(
                str(n_coordinates - self.rigid_coordinates - n_modes - n_parameter) if n_coordinates else "static"
            )
        elif n_parameter:
            words.append("0")
        return " + ".join([*words, str(n_parameter)] if n_parameter else words)


def pareto_front(cost: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return which points, costs and errors of shape (n,), no other one dominates: has at most their cost and error,
    and less of one of them. A point with a number that is not finite is never on the front."""
    known = np.isfinite(cost) & np.isfinite(error)
    at_most = (cost[:, None] <= cost) & (error[:, None] <= error)
    less = (cost[:, None] < cost) | (error[:, None] < error)
    return known & ~np.any(at_most & less & known[:, None], axis=0)
