"""Many runs with random parameters: values, outputs at the end time, and their statistics.

Samples that failed have NaN in all that follows from a run.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc.declare.records import (
    NO_FILE,
    Result,
    array,
    attribute,
    check_shape,
    derived,
    group_at,
    run_record,
    units_in,
)
from pgmp_petsc.results.balance import BALANCE_WORDS
from pgmp_petsc.results.corrected import Joined
from pgmp_petsc.results.errors import OF_REDUCED, OF_STEP, VALIDITY_WORDS
from pgmp_petsc.results.statistics import MODELS, Band, Chance, Sensitivity, Statistics
from pgmp_petsc.results.stopping import Stopping
from pgmp_petsc.runtime.files import RunRecord

if TYPE_CHECKING:
    import h5py

#: What is known of an output over time, sample by sample.
EXTREMES = {
    "max": "largest value of output '{name}' over time; NaN where the sample failed",
    "min": "smallest value of output '{name}' over time; NaN where the sample failed",
    "time_of_max": "instant of the largest value of output '{name}'",
    "time_of_min": "instant of the smallest value of output '{name}'",
}
UNSTABLE = "unstable_start"  # 1 where a sample began on an unstable static equilibrium, by name in `Ensemble.kept`
DESCRIBED = ("max", "min")  # of these, by statistics ``<output>.<which>``


def _over_time(own: Ensemble, key: str, _: object) -> dict[str, Any]:
    """Return what texts say of a name of `Ensemble.extremes`."""
    name, _, which = key.rpartition("/")
    unit = "s" if which.startswith("time") else own.units.get(name, "1")
    return {"unit": unit, "about": EXTREMES[which].format(name=name), "which": which, "of": name}


def _extremes(file: h5py.Group, _: object) -> Iterable[str]:
    outputs = group_at(file, "extremes") if "extremes" in file else ()
    return [f"{name}/{which}" for name in outputs for which in EXTREMES]


def _units(file: h5py.Group, _: object) -> dict[str, str]:
    """Return the unit of everything that has statistics."""
    units = units_in(file, "parameters", "outputs", "first_passages")
    return units | {f"{name}.{which}": units[name] for name in file.get("extremes", {}) for which in DESCRIBED}


def _of_samples(about: str, **how: Any) -> Any:
    """Declare arrays by name with a number for each sample, those that are not asked for being absent."""
    return array("sample", about=about, gaps=True, absent={}, **how)


def _has_errors(own: Ensemble) -> bool:
    return bool(own.errors)


@dataclass(frozen=True)
class Ensemble(Result):
    """N samples of the full-order or the reduced model.

    `units` has those of parameters, outputs, first passages and described extremes. Estimates (`errors`,
    `errors_at_end`, `validity`) are empty where no sample was to have one, `balance`, `extremes` and `first_passages`
    where they were not asked for; `extremes` are by ``<output>/max`` and others. `stopping` says why it ended, where
    the number of samples was not given.
    """

    kind = "ensemble"
    model: str = attribute("@model", allowed=MODELS, about="full, components or reduced")
    record: RunRecord = run_record()
    parameters: Mapping[str, np.ndarray] = array(
        "sample", unit="{unit}", about="sampled values of parameter '{name}'", ordered=True, label="parameter.{name}"
    )
    outputs: Mapping[str, np.ndarray] = array(
        "sample", unit="{unit}", about="output '{name}' at the end time", ordered=True, gaps=True, label="{name}"
    )
    units: dict[str, str] = array(found=_units)
    status: np.ndarray = array(
        "sample", about="how each sample ended; 0 = fine", stored=np.int32, label="sample.status"
    )
    meanings: dict[int, str] = attribute(
        "status@meanings", about="texts by number (JSON)",
        code=(
            lambda meanings: json.dumps({str(number): text for number, text in meanings.items()}),
            lambda text: {int(number): meaning for number, meaning in json.loads(text).items()},
        ),
    )  # fmt: skip
    failure_time: np.ndarray = array(
        "sample", unit="s", about="instant of failure; NaN where fine", gaps=True, label="sample.failure_time"
    )
    steps_divided: np.ndarray = array(
        "sample", about="by what simulation.step was divided in the last attempt", stored=np.int32
    )
    statistics: dict[str, Statistics] = array()
    errors: Mapping[str, np.ndarray] = _of_samples(
        "largest estimated error of output '{name}' over the run; NaN where not estimated", unit="{unit}",
        ordered=True, when=_has_errors, label="error.{name}",
    )  # fmt: skip
    errors_at_end: Mapping[str, np.ndarray] = _of_samples(
        "estimated error of output '{name}' at the end time, {own.what_errors}", unit="{unit}", ordered=True,
        when=_has_errors,
    )  # fmt: skip
    validity: Mapping[str, np.ndarray] = _of_samples(
        "{about}", unit="{unit}", keys=VALIDITY_WORDS, label="validity.{name}",
    )  # fmt: skip
    balance: Mapping[str, np.ndarray] = _of_samples(
        "{about}", at="energy", unit="{unit}", keys=BALANCE_WORDS, label="energy.{name}",
    )  # fmt: skip
    extremes: Mapping[str, np.ndarray] = _of_samples(
        "{about}",
        unit="{unit}",
        words=_over_time,
        names=_extremes,
        label="{which}.{of}",
        keys={f"<name>/{which}": {"about": about} for which, about in EXTREMES.items()},
    )
    first_passages: Mapping[str, np.ndarray] = _of_samples(
        "instant of the first passage of '{name}'; NaN where there is none", unit="s", label="first_passage.{name}"
    )
    probabilities: dict[str, Chance] = array(ordered=True, absent={})
    bands: dict[str, Band] = array(ordered=True, absent={})
    sobol: dict[str, Sensitivity] = array(ordered=True, absent={})
    stopping: Stopping | None = array(absent=None)
    joined: Joined | None = array(at="", absent=None)
    kept: Mapping[str, np.ndarray] = array(
        "...", unit="SI", about="{name} of the samples, for a further try of those that failed", gaps=True, absent={}
    )
    FURTHER = (
        derived(
            np.ndarray, lambda own, _: np.arange(len(own.status)), NO_FILE, "sample", about="number of the sample",
            label="sample", is_axis=True,
        ),
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, values in self.kept.items():  # one number for each sample, or bands of the first of them
            sizes = ("sample",) if name == UNSTABLE else ("known", "time")
            check_shape(f"kept '{name}'", values.shape, sizes, {"sample": len(self.status)})
        unknown = set(np.unique(self.status).tolist()) - self.meanings.keys()
        if unknown:
            raise ValueError(f"status {sorted(unknown)} has no meaning; known: {sorted(self.meanings)}")

    @property
    def what_errors(self) -> str:
        """What the estimated errors are of."""
        return OF_REDUCED if self.model == "reduced" else OF_STEP
