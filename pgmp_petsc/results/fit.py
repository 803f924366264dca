"""Parameters that were fitted to a measured history."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgmp_petsc.declare.records import Record, Result, array, attribute, group_at, run_record
from pgmp_petsc.runtime.files import RunRecord

KIND = "fit"


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


def _history(at: str, words: str) -> np.ndarray:
    return array("time", at=f"{at}/{{name}}", unit="{own.unit}", about=f"output '{{name}}', {words}", ordered=True)


@dataclass(frozen=True)
class FittedOutput(Record):
    """An output at the measured instants."""

    unit: str = attribute("measured/{name}@unit")
    measured: np.ndarray = _history("measured", "measured")
    fitted: np.ndarray = _history("fitted", "with fitted values")
    begun: np.ndarray = _history("begun", "begun with")
    noise: float = array(at="noise/{name}", unit="{own.unit}", about="deviation of the noise of '{name}'")
    noise_given: bool = attribute("noise/{name}@given", about="whether it was given")


@dataclass(frozen=True)
class Fit(Result):
    """A fit; its record has the fitted values."""

    kind = KIND
    record: RunRecord = run_record()
    time: np.ndarray = array("time", unit="s", about="measured instants")
    outputs: dict[str, FittedOutput] = array(at="", names=lambda file, _: group_at(file, "measured"))
    parameters: tuple[FittedParameter, ...] = array("parameter", at="")
    correlation: np.ndarray = array("parameter", "parameter", about="correlation of the estimates", gaps=True)
    n_runs: int = attribute("@n_runs", about="runs that were differentiated")
    converged: bool = attribute("@converged", about="whether the fit converged")

    @property
    def unit(self) -> str:
        """Units of the parameters."""
        return ", ".join(parameter.unit for parameter in self.parameters)
