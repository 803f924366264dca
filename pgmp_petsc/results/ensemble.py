"""Many runs with random parameters: values, outputs at the end time, and their statistics.

Layout of the file (kind ``ensemble``, root attribute ``model``: ``full`` or ``reduced``):

======================================== =============== ====================================================
dataset                                  shape           content
======================================== =============== ====================================================
``/parameters/<name>``                   (N)             sampled values
``/outputs/<name>``                      (N)             outputs at the end time; NaN where the sample failed
``/status``                              (N)             0 = fine; attribute ``meanings`` (JSON, number: text)
``/failure_time``                        (N)             instant at which a sample failed, s; NaN where fine
``/steps_divided``                       (N)             by what ``simulation.step`` was divided in the sample's last
                                                         attempt: 1, or more where it failed with the scene's step
``/errors/<name>``                       (N)             largest size of the estimated error of an output over the
                                                         run; this and the two below for the reduced model only, NaN
                                                         where it was not estimated
``/errors_at_end/<name>``                (N)             estimated error at the end time, reduced less full-order
``/validity/<name>``                     (N)             how far each run left small deformations (`errors.VALIDITY`),
                                                         NaN where not known; of every sample of the reduced model
``/energy/residual``, ``exchanged``      (N)             largest residual of a sample's balance of energy, and the
                                                         most that was moved around, J; where ``ensemble.balance``
                                                         asks for them, NaN where the sample failed
``/statistics/<name>/count``             ()              how many values the statistics are of: for an output the
                                                         samples that are fine, for a parameter all
``.../mean``, ``std``                    ()              NaN where there are too few
``.../mean_standard_error``              ()              standard errors of these two estimates,
``.../std_standard_error``               ()
``.../pdf``                              (n_bins)        probability density, per unit of the quantity
``.../edges``                            (n_bins + 1)    limits of its bins
``.../quantiles``                        (n_quantiles)   attribute ``probabilities``
``.../quantile_bounds``                  (n_quantiles,   between which the quantiles of all samples lie, whatever the
                                         2)              failed ones would have been; infinite where there are none
======================================== =============== ====================================================
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field

import h5py
import numpy as np

from pgmp_petsc.results.balance import BALANCE
from pgmp_petsc.results.errors import VALIDITY
from pgmp_petsc.results.layout import check_model, check_shape, put_named, take_named, units_of
from pgmp_petsc.runtime.files import RunRecord, open_file, put, shapes_of, take, write_file

_SCALARS = {
    "mean": "mean",
    "std": "standard deviation",
    "mean_standard_error": "standard error of the mean",
    "std_standard_error": "standard error of the standard deviation",
}


@dataclass(frozen=True)
class Statistics:
    """Statistics of one quantity, in the quantity's unit: of an output over the samples that are fine.

    Parameters
    ----------
    count : int
        Number of values.
    mean, std, mean_standard_error, std_standard_error : float
    pdf : ndarray, shape (n_bins,)
        Probability density, 1/unit.
    edges : ndarray, shape (n_bins + 1,)
        Limits of the bins; both arrays are empty where no sample is fine.
    quantiles, probabilities : ndarray, shape (n_quantiles,)
        Values and the probabilities that they belong to.
    quantile_bounds : ndarray, shape (n_quantiles, 2)
        Between which the quantiles of all samples lie, whatever the failed ones would have been.
    """

    count: int
    mean: float
    std: float
    mean_standard_error: float
    std_standard_error: float
    pdf: np.ndarray
    edges: np.ndarray
    quantiles: np.ndarray
    quantile_bounds: np.ndarray
    probabilities: np.ndarray

    def __post_init__(self) -> None:
        check_shape("pdf", self.pdf, (None,))
        check_shape("edges", self.edges, (len(self.pdf) + 1 if len(self.pdf) else 0,))
        check_shape("quantiles", self.quantiles, (None,))
        check_shape("quantile_bounds", self.quantile_bounds, (len(self.quantiles), 2))
        check_shape("probabilities", self.probabilities, (len(self.quantiles),))


@dataclass(frozen=True)
class Ensemble:
    """N samples of the full-order or the reduced model.

    Parameters
    ----------
    model : {"full", "components", "reduced"}
    record : RunRecord
    parameters, outputs : mapping of str to ndarray, shape (N,)
    units : dict of str to str
        Unit of every parameter and output.
    status : ndarray of int, shape (N,)
        0 = fine.
    meanings : dict of int to str
        What the numbers in `status` say.
    failure_time : ndarray, shape (N,)
        s; NaN where the sample is fine.
    steps_divided : ndarray of int, shape (N,)
        By what the scene's step was divided in the sample's last attempt.
    statistics : dict of str to Statistics
    errors, errors_at_end, validity : mapping of str to ndarray, shape (N,)
        Estimates of the reduced model, NaN where a sample has none; empty where no sample was to have one.
    balance : mapping of str to ndarray, shape (N,)
        Of energy, NaN where a sample failed; empty where it was not asked for.
    """

    model: str
    record: RunRecord
    parameters: Mapping[str, np.ndarray]
    outputs: Mapping[str, np.ndarray]
    units: dict[str, str]
    status: np.ndarray
    meanings: dict[int, str]
    failure_time: np.ndarray
    steps_divided: np.ndarray
    statistics: dict[str, Statistics]
    errors: Mapping[str, np.ndarray] = field(default_factory=dict)
    errors_at_end: Mapping[str, np.ndarray] = field(default_factory=dict)
    validity: Mapping[str, np.ndarray] = field(default_factory=dict)
    balance: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n_samples = len(self.status)
        check_model(self.model)
        check_shape("status", self.status, (None,))
        check_shape("failure_time", self.failure_time, (n_samples,))
        check_shape("steps_divided", self.steps_divided, (n_samples,))
        for arrays in (self.parameters, self.outputs, self.errors, self.errors_at_end, self.validity, self.balance):
            for name, values in arrays.items():
                check_shape(f"'{name}'", values, (n_samples,))
        unknown = set(np.unique(self.status).tolist()) - self.meanings.keys()
        if unknown:
            raise ValueError(f"status {sorted(unknown)} has no meaning; known: {sorted(self.meanings)}")

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file; by one process only. Raises as :func:`~pgmp_petsc.runtime.files.write_file`."""
        with write_file(path, "ensemble", {"model": self.model}) as file:
            self.record.write(file)
            put_named(file, "parameters", self.parameters, self.units, "sampled values of parameter '{name}'")
            put_named(file, "outputs", self.outputs, self.units, "output '{name}' at the end time")
            status = put(file, "status", self.status.astype(np.int32), "1", "how each sample ended; 0 = fine")
            status.attrs["meanings"] = json.dumps({str(key): text for key, text in self.meanings.items()})
            put(file, "failure_time", self.failure_time, "s", "instant of failure; NaN where fine")
            about = "by what simulation.step was divided in the last attempt"
            put(file, "steps_divided", self.steps_divided.astype(np.int32), "1", about)
            self._write_estimates(file)
            for name, statistics in self.statistics.items():
                group = file.create_group(f"statistics/{name}")
                _write_statistics(group, name, statistics, self.units.get(name, "1"))

    def _write_estimates(self, file: h5py.File) -> None:
        """Write what is known of the reduced model's errors, and of the balance of energy."""
        if self.errors:
            about = "largest estimated error of output '{name}' over the run; NaN where not estimated"
            put_named(file, "errors", self.errors, self.units, about)
            about = "estimated error of output '{name}' at the end time, reduced less full-order"
            put_named(file, "errors_at_end", self.errors_at_end, self.units, about)
        for name, values in self.validity.items():
            put(file, f"validity/{name}", values, *VALIDITY[name])
        for name, values in self.balance.items():
            put(file, f"energy/{name}", values, *BALANCE[name])

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Ensemble:
        """Read a file; raises `InputError` where it is not a whole ensemble."""
        with open_file(path, "ensemble") as file, shapes_of(file):
            status = take(file, "status", 1)
            meanings = json.loads(file["status"].attrs["meanings"])
            return cls(
                model=str(file.attrs["model"]),
                record=RunRecord.read(file),
                parameters=take_named(file, "parameters", 1),
                outputs=take_named(file, "outputs", 1),
                units=units_of(file, "parameters", "outputs"),
                status=status,
                meanings={int(key): text for key, text in meanings.items()},
                failure_time=take(file, "failure_time", 1),
                steps_divided=take(file, "steps_divided", 1),
                statistics={name: _read_statistics(group) for name, group in file.get("statistics", {}).items()},
                errors=take_named(file, "errors", 1),
                errors_at_end=take_named(file, "errors_at_end", 1),
                validity=take_named(file, "validity", 1),
                balance=take_named(file, "energy", 1),
            )


def _write_statistics(group: h5py.Group, name: str, statistics: Statistics, unit: str) -> None:
    """Write the statistics of one quantity."""
    put(group, "count", statistics.count, "1", f"number of values of '{name}' that these are of")
    for scalar, words in _SCALARS.items():
        put(group, scalar, float(getattr(statistics, scalar)), unit, f"{words} of '{name}'")
    per_unit = "1" if unit == "1" else f"1/{unit}"
    put(group, "pdf", statistics.pdf, per_unit, f"probability density of '{name}'")
    put(group, "edges", statistics.edges, unit, "limits of the bins of the density")
    quantiles = put(group, "quantiles", statistics.quantiles, unit, f"quantiles of '{name}'")
    quantiles.attrs["probabilities"] = statistics.probabilities
    about = "between these lie the quantiles of all samples, whatever the failed ones would have been"
    put(group, "quantile_bounds", statistics.quantile_bounds, unit, about)


def _read_statistics(group: h5py.Group) -> Statistics:
    """Read the statistics of one quantity."""
    scalars = {scalar: float(take(group, scalar, 0)) for scalar in _SCALARS}
    arrays = {name: take(group, name, 1) for name in ("pdf", "edges", "quantiles")}
    return Statistics(
        count=int(take(group, "count", 0)),
        **scalars,
        **arrays,
        quantile_bounds=take(group, "quantile_bounds", 2),
        probabilities=np.array(group["quantiles"].attrs["probabilities"]),
    )
