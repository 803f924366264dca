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
                                                         run, of other models than the reduced one that of the time
                                                         step; NaN where it was not estimated
``/errors_at_end/<name>``                (N)             estimated error at the end time, the sample's less the exact
``/validity/<name>``                     (N)             how far each run left small deformations (`errors.VALIDITY`),
                                                         NaN where not known; of every sample of the reduced model
``/energy/residual``, ``exchanged``      (N)             largest residual of a sample's balance of energy, and the
                                                         most that was moved around, J; where ``ensemble.balance``
                                                         asks for them, NaN where the sample failed
``/statistics/<name>/count``             ()              how many values the statistics are of: for an output the
                                                         samples that are fine, for a parameter all; attribute
                                                         ``constant``: whether all are the same but for round-off
``.../mean``, ``std``                    ()              NaN where there are too few
``.../mean_standard_error``              ()              standard errors of these two estimates,
``.../std_standard_error``               ()
``.../pdf``                              (n_bins)        probability density, per unit of the quantity
``.../edges``                            (n_bins + 1)    limits of its bins
``.../quantiles``                        (n_quantiles)   attribute ``probabilities``
``.../quantile_bounds``                  (n_quantiles,   between which the quantiles of all samples lie, whatever the
                                         2)              failed ones would have been; infinite where there are none
``.../mean_interval``, ``std_interval``  (2)             confidence intervals, attribute ``confidence``; NaN where there
                                                         are too few
``.../quantile_intervals``               (n_quantiles,   the same of the quantiles; an end is infinite where there are
                                         2)              too few
``/extremes/<name>/max``, ``min``,       (N)             of each output over time, and when they are reached first;
``time_of_max``, ``time_of_min``                         where ``ensemble.extremes`` asks for them, NaN where the sample
                                                         failed; ``/statistics/<name>.max`` and ``.min`` describe them
``/first_passages/<label>``              (N)             instant of the first passage of an event that may come true at
                                                         any time, s; NaN where it did not; ``/statistics/<label>``
                                                         describes those that did
``/probabilities/<label>/estimate``      ()              of the scene's ``ensemble.probabilities``; ``count`` of
``.../interval``                         (2)             ``samples`` came true; attribute ``event`` says what
``.../failed``                           ()              samples that failed: outside the event at the interval's lower
                                                         end, in it at the upper one
``.../model_error``, ``holds_to``        ()              error of the output as a share of its largest size in a sample:
                                                         estimated (NaN where not), and up to which the event is decided
                                                         (attribute ``decided``) by this model
``/bands/<name>/time``, ``mean``,        (n_t)           each output over time, of the first samples
``std``                                                  (``ensemble.band_samples``) that are fine; ``count`` of them
``.../quantiles``                        (n_t,           attribute ``probabilities``
                                         n_quantiles)
``/sobol/<name>/S1``, ``ST``             (d)             Sobol indices of each output, in the order of the group's
                                                         attribute ``parameters``; ``ST`` of the sampler saltelli alone
``.../S1_interval``, ``ST_interval``     (d, 2)          their intervals; attribute ``confidence`` of the group
``/kept/unstable_start``                 (N)             where samples failed: what else of the others a further try of
``.../bands.<name>``                     (n_known, n_t)  these needs (``--retry-failed``)
``/corrected/<name>/mean``, ``std``,     ()              figures of a better model (``--correct``), each with
``bias``; of an event ``estimate``                       ``<figure>_interval`` (2), and ``<figure>_alone`` and
                                                         ``<figure>_alone_interval`` of the better model's samples
                                                         alone; ``bias``: this ensemble's mean less the better model's;
                                                         attributes ``models`` (the best first) and ``confidence``
``.../samples``                          (n_models)      how many of each model have a part
``.../correlation``, ``coefficient``     (n_models - 1)  of the cheaper models with the best; empty of an event
``/better/<model>/outputs/<name>``,      (K)             the better models' own samples, on the first draws; ``full/4``
``status``                                               is the group ``full:4``
``/stopping/samples``                    (n_looks)       where the number of samples was not given: numbers at which one
                                                         looked; attributes ``why``, ``budget`` (s), ``rules``,
                                                         ``units``
``.../estimates``                        (n_rules,       figures of the rules at every look, and
                                         n_looks)
``.../intervals``                        (n_rules,       their intervals
                                         n_looks, 2)
``.../wanted``, ``relative``, ``met``    (n_rules)       half the width that a rule wants; whether that is a share of
                                                         the figure; whether it was reached
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
from pgmp_petsc.results.corrected import Joined
from pgmp_petsc.results.errors import OF_REDUCED, OF_STEP, VALIDITY
from pgmp_petsc.results.layout import check_model, check_shape, put_named, take_named, units_of
from pgmp_petsc.results.statistics import Band, Chance, Sensitivity, Statistics
from pgmp_petsc.results.stopping import Stopping, read_stopping
from pgmp_petsc.runtime.files import RunRecord, open_file, put, shapes_of, take, write_file

#: What is known of an output over time, sample by sample.
EXTREMES = {
    "max": "largest value of output '{name}' over time; NaN where the sample failed",
    "min": "smallest value of output '{name}' over time; NaN where the sample failed",
    "time_of_max": "instant of the largest value of output '{name}'",
    "time_of_min": "instant of the smallest value of output '{name}'",
}
UNSTABLE = "unstable_start"  # 1 where a sample began on an unstable static equilibrium, by name in `Ensemble.kept`
DESCRIBED = ("max", "min")  # of these, by statistics ``<output>.<which>``


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
    extremes : mapping of str to ndarray, shape (N,)
        ``<output>/max`` and the others, NaN where a sample failed; empty where they were not asked for.
    first_passages : mapping of str to ndarray, shape (N,)
        Instants by label, s; NaN where the event did not come true.
    probabilities : dict of str to Chance
        By label.
    bands : dict of str to Band
        By output.
    sobol : dict of str to Sensitivity
        Sobol indices by output; empty where they are not known.
    stopping : Stopping or None
        Why it ended, where the number of samples was not given.
    joined : Joined or None
        Figures of a better model, where there are samples of it.
    kept : mapping of str to ndarray
        Where samples failed, what else of the others a further try of these needs: `UNSTABLE`, shape (N,), and
        ``bands.<name>``, outputs of the first samples at the instants of the bands, shape (n_known, n_t).
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
    extremes: Mapping[str, np.ndarray] = field(default_factory=dict)
    first_passages: Mapping[str, np.ndarray] = field(default_factory=dict)
    probabilities: dict[str, Chance] = field(default_factory=dict)
    bands: dict[str, Band] = field(default_factory=dict)
    sobol: dict[str, Sensitivity] = field(default_factory=dict)
    stopping: Stopping | None = None
    joined: Joined | None = None
    kept: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n_samples = len(self.status)
        check_model(self.model)
        check_shape("status", self.status, (None,))
        check_shape("failure_time", self.failure_time, (n_samples,))
        check_shape("steps_divided", self.steps_divided, (n_samples,))
        of_samples = (self.parameters, self.outputs, self.errors, self.errors_at_end, self.validity, self.balance)
        for arrays in (*of_samples, self.extremes, self.first_passages):
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
                statistics.write(group, name, self.units.get(name, "1"))
            self._write_over_time(file)
            probabilities = file.create_group("probabilities", track_order=True)
            for label, chance in self.probabilities.items():
                chance.write(probabilities.create_group(label), label)
            sobol = file.create_group("sobol", track_order=True)
            for name, indices in self.sobol.items():
                indices.write(sobol.create_group(name), name)
            for name, values in self.kept.items():
                put(
                    file, f"kept/{name}", values, "SI", f"{name} of the samples, for a further try of those that failed"
                )
            if self.stopping is not None:
                self.stopping.write(file)
            if self.joined is not None:
                self.joined.write(file, self.units)

    def _write_estimates(self, file: h5py.File) -> None:
        """Write what is known of errors, and of the balance of energy."""
        if self.errors:
            about = "largest estimated error of output '{name}' over the run; NaN where not estimated"
            put_named(file, "errors", self.errors, self.units, about)
            about = f"estimated error of output '{{name}}' at the end time, {OF_REDUCED if self.model == 'reduced' else OF_STEP}"
            put_named(file, "errors_at_end", self.errors_at_end, self.units, about)
        for name, values in self.validity.items():
            put(file, f"validity/{name}", values, *VALIDITY[name])
        for name, values in self.balance.items():
            put(file, f"energy/{name}", values, *BALANCE[name])

    def _write_over_time(self, file: h5py.File) -> None:
        """Write what is known of the outputs over time."""
        for key, values in self.extremes.items():
            name, _, which = key.rpartition("/")
            unit = "s" if which.startswith("time") else self.units.get(name, "1")
            put(file, f"extremes/{key}", values, unit, EXTREMES[which].format(name=name))
        for label, values in self.first_passages.items():
            about = f"instant of the first passage of '{label}'; NaN where there is none"
            put(file, f"first_passages/{label}", values, "s", about)
        bands = file.create_group("bands", track_order=True)
        for name, band in self.bands.items():
            band.write(bands.create_group(name), name, self.units.get(name, "1"))

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
                units=_units(file),
                status=status,
                meanings={int(key): text for key, text in meanings.items()},
                failure_time=take(file, "failure_time", 1),
                steps_divided=take(file, "steps_divided", 1),
                statistics={name: Statistics.read(group) for name, group in file.get("statistics", {}).items()},
                errors=take_named(file, "errors", 1),
                errors_at_end=take_named(file, "errors_at_end", 1),
                validity=take_named(file, "validity", 1),
                balance=take_named(file, "energy", 1),
                extremes={
                    f"{name}/{which}": take(group, which, 1)
                    for name, group in file.get("extremes", {}).items()
                    for which in EXTREMES
                },
                first_passages=take_named(file, "first_passages", 1),
                probabilities={name: Chance.read(group) for name, group in file.get("probabilities", {}).items()},
                bands={name: Band.read(group) for name, group in file.get("bands", {}).items()},
                sobol={name: Sensitivity.read(group) for name, group in file.get("sobol", {}).items()},
                stopping=read_stopping(file),
                joined=Joined.read(file),
                kept={name: take(file["kept"], name, 1 if name == UNSTABLE else 2) for name in file.get("kept", {})},
            )


def _units(file: h5py.File) -> dict[str, str]:
    """Return the unit of everything that has statistics."""
    units = units_of(file, "parameters", "outputs", "first_passages")
    return units | {f"{name}.{which}": units[name] for name in file.get("extremes", {}) for which in DESCRIBED}
