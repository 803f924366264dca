"""Parameters that were fitted to a measured history.

Layout of the file (kind ``fit``; root attributes ``parameters_fitted`` (JSON, the names in the order of the axis
n_parameters), ``units`` (JSON, theirs), ``converged``, ``n_runs``; ``parameters`` holds the fitted values):

============================== ============================ =======================================================
dataset                        shape                        content
============================== ============================ =======================================================
``/estimates``, ``/starts``    (n_parameters)               fitted values, and where the fit began
``/standard_errors``           (n_parameters)               infinite where a parameter is not identifiable
``/limits``                    (n_parameters, 2)            between which it was searched
``/correlation``               (n_parameters, n_parameters) of the estimates; NaN where one is not identifiable
``/time``                      (n)                          measured instants, s
``/measured/<output>``         (n)                          what was measured
``/fitted/<output>``           (n)                          outputs of the run with the fitted values
``/begun/<output>``            (n)                          outputs of the run that the fit began with
``/noise/<output>``            ()                           deviation of the noise; attribute ``given`` says whether it
                                                            was given
============================== ============================ =======================================================
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass

import numpy as np

from pgmp_petsc.results.layout import check_shape, put_named, take_known, take_named, units_of
from pgmp_petsc.runtime.files import RunRecord, open_file, put, shapes_of, take, write_file

KIND = "fit"


@dataclass(frozen=True)
class FittedParameter:
    """A parameter: its name and unit, where it began and ended, its standard error, and the limits of its search."""

    name: str
    unit: str
    start: float
    estimate: float
    error: float
    lower: float
    upper: float


@dataclass(frozen=True)
class FittedOutput:
    """An output at the measured instants: what was measured, fitted, and begun with, each (n,), and the deviation of
    the noise."""

    unit: str
    measured: np.ndarray
    fitted: np.ndarray
    begun: np.ndarray
    noise: float
    noise_given: bool


@dataclass(frozen=True)
class Fit:
    """A fit.

    Parameters
    ----------
    record : RunRecord
        With the fitted values.
    time : ndarray, shape (n,)
        s.
    outputs : dict of str to FittedOutput
    parameters : tuple of FittedParameter
    correlation : ndarray, shape (n_parameters, n_parameters)
    n_runs : int
        Runs that were differentiated.
    converged : bool
    """

    record: RunRecord
    time: np.ndarray
    outputs: dict[str, FittedOutput]
    parameters: tuple[FittedParameter, ...]
    correlation: np.ndarray
    n_runs: int
    converged: bool

    def __post_init__(self) -> None:
        n = len(self.parameters)
        check_shape("correlation", self.correlation, (n, n))
        for name, output in self.outputs.items():
            for what in ("measured", "fitted", "begun"):
                check_shape(f"{what} '{name}'", getattr(output, what), (len(self.time),))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file; by one process only. Raises as :func:`~pgmp_petsc.runtime.files.write_file`."""
        attributes = {
            "parameters_fitted": json.dumps([parameter.name for parameter in self.parameters]),
            "units": json.dumps([parameter.unit for parameter in self.parameters]),
            "converged": self.converged,
            "n_runs": self.n_runs,
        }
        with write_file(path, KIND, attributes) as file:
            self.record.write(file)
            unit = ", ".join(parameter.unit for parameter in self.parameters)
            rows = np.array([[p.estimate, p.start, p.error] for p in self.parameters]).T
            put(file, "estimates", rows[0], unit, "fitted values of the parameters")
            put(file, "starts", rows[1], unit, "values that the fit began with")
            put(file, "standard_errors", rows[2], unit, "standard errors; infinite: not identifiable")
            limits = np.array([[p.lower, p.upper] for p in self.parameters])
            put(file, "limits", limits, unit, "limits of the search")
            put(file, "correlation", self.correlation, "1", "correlation of the estimates")
            put(file, "time", self.time, "s", "measured instants")
            units = {name: output.unit for name, output in self.outputs.items()}
            for what, text in (("measured", "measured"), ("fitted", "with fitted values"), ("begun", "begun with")):
                values = {name: getattr(output, what) for name, output in self.outputs.items()}
                put_named(file, what, values, units, f"output '{{name}}', {text}")
            for name, output in self.outputs.items():
                data = put(file, f"noise/{name}", output.noise, output.unit, f"deviation of the noise of '{name}'")
                data.attrs["given"] = output.noise_given

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Fit:
        """Read a file; raises `InputError` where it is not a whole one."""
        with open_file(path, KIND) as file, shapes_of(file):
            names, units = (json.loads(file.attrs[key]) for key in ("parameters_fitted", "units"))
            rows = [take_known(file, name, 1) for name in ("starts", "estimates", "standard_errors")]
            rows += list(take_known(file, "limits", 2).T)
            found = {what: take_named(file, what, 1, take_known) for what in ("measured", "fitted", "begun")}
            of_outputs = units_of(file, "measured")
            outputs = {
                name: FittedOutput(
                    of_outputs[name],
                    *(found[what][name] for what in found),
                    float(take_known(file, f"noise/{name}", 0)),
                    bool(file[f"noise/{name}"].attrs["given"]),
                )
                for name in found["measured"]
            }  # fmt: skip
            return cls(
                RunRecord.read(file),
                take_known(file, "time", 1),
                outputs,
                tuple(FittedParameter(*words, *map(float, row)) for *words, row in zip(names, units, np.array(rows).T)),
                take(file, "correlation", 2),
                int(file.attrs["n_runs"]),
                bool(file.attrs["converged"]),
            )
