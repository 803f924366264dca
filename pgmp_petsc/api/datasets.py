"""Results as datasets of xarray: their arrays by name, with units and descriptions as attributes.

Outputs have their own names; what else there is begins with its kind and a dot, which no name of a scene has:
``parameter.r1``, ``state.theta``, ``error.crank_angle``, ``energy.kinetic``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc import __version__
from pgmp_petsc.results import Derivatives, Ensemble, ModesTable, Trajectory
from pgmp_petsc.results.balance import BALANCE
from pgmp_petsc.results.ensemble import EXTREMES
from pgmp_petsc.results.errors import VALIDITY
from pgmp_petsc.results.summary import origin_of
from pgmp_petsc.runtime.errors import InputError

if TYPE_CHECKING:
    import xarray

    from pgmp_petsc.api.result import Result

#: Variables and coordinates of a dataset: dimensions, values and attributes by name.
Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, str]]]


def dataset_of(result: Result) -> xarray.Dataset:
    """Return the dataset of a result.

    Raises
    ------
    InputError
        If xarray is not installed, or results of its kind have none.
    """
    try:
        import xarray
    except ImportError as error:
        raise InputError(
            "to_xarray: the package xarray is not installed (pip install 'xarray<2024.4' suits numpy before 2); the "
            f"arrays themselves are attributes of the result ({error})"
        ) from error
    if type(result.data) not in DATASETS:
        known = ", ".join(kind.__name__ for kind in DATASETS)
        raise InputError(f"to_xarray: there is no dataset of a {result.kind}; its arrays are attributes ({known} have)")
    variables, coordinates = DATASETS[type(result.data)](result.data)
    taken = [
        name for name in variables if name in {*coordinates, *(dim for dims, *_ in variables.values() for dim in dims)}
    ]
    if taken:
        raise InputError(
            f"to_xarray: '{taken[0]}' is the name of an axis of the dataset; give the scene's another name"
        )
    record = result.record
    about = {
        "kind": result.kind,
        "scene": origin_of(record)["scene"],
        "program_version": __version__,
        "parameters": json.dumps(record.parameters),
        "remarks": [str(remark) for remark in record.remarks],
    }
    about |= {"model": result.data.model} if hasattr(result.data, "model") else {}
    about |= {} if record.seed is None else {"seed": record.seed}
    return xarray.Dataset(variables, coordinates, about)


def _entry(dims: tuple[str, ...], values: Any, unit: str, text: str) -> tuple[tuple[str, ...], Any, dict[str, str]]:
    return dims, values, {"units": unit, "long_name": text}


def _time(values: np.ndarray) -> Variables:
    return {"time": _entry(("time",), values, "s", "time")}


def _of_run(run: Trajectory) -> tuple[Variables, Variables]:
    over, coordinates = ("time",), _time(run.time)
    found = {name: _entry(over, values, run.units[name], f"output {name}") for name, values in run.outputs.items()}
    for column, (name, unit) in zip(run.coordinates.T, run.coordinate_units.items()):
        found[f"state.{name}"] = _entry(over, column, unit, f"rigid coordinate {name}")
    if run.modal is not None:
        found["state.modal"] = _entry(("time", "mode"), run.modal, "1", "flexible coordinates delta")
    if run.errors is not None:
        coordinates["error_time"] = _entry(("error_time",), run.errors.time, "s", "instants of estimated errors")
        for name, values in run.errors.outputs.items():
            text = f"estimated error of {name}, reduced less full-order"
            found[f"error.{name}"] = _entry(("error_time",), values, run.units[name], text)
    if run.balance is not None:
        for name in ("kinetic", "strain", "potential", "residual"):
            found[f"energy.{name}"] = _entry(over, getattr(run.balance, name), "J", f"{name} of the balance of energy")
        for name, values in run.balance.work.items():
            found[f"work.{name}"] = _entry(over, values, "J", f"work of effect {name} since the start")
    for name, value in run.validity.items():
        found[f"validity.{name}"] = _entry((), value, *VALIDITY[name])
    return found, coordinates


def _of_ensemble(ensemble: Ensemble) -> tuple[Variables, Variables]:
    over, units = ("sample",), ensemble.units
    coordinates = {"sample": _entry(over, np.arange(len(ensemble.status)), "1", "number of the sample")}
    # an output may have the name of a parameter
    found = {
        f"parameter.{name}": _entry(over, values, units[name], f"parameter {name}")
        for name, values in ensemble.parameters.items()
    }
    for name, values in ensemble.outputs.items():
        found[name] = _entry(over, values, units[name], f"output {name} at the end time; NaN where the sample failed")
    meanings = "; ".join(f"{number}: {text}" for number, text in ensemble.meanings.items())
    found["sample.status"] = _entry(over, ensemble.status, "1", f"how the sample ended ({meanings})")
    found["sample.failure_time"] = _entry(over, ensemble.failure_time, "s", "instant of failure; NaN where fine")
    for name, values in ensemble.errors.items():
        found[f"error.{name}"] = _entry(over, values, units[name], f"largest estimated error of {name} over the run")
    for prefix, arrays, abouts in (("validity", ensemble.validity, VALIDITY), ("energy", ensemble.balance, BALANCE)):
        found |= {f"{prefix}.{name}": _entry(over, values, *abouts[name]) for name, values in arrays.items()}
    for key, values in ensemble.extremes.items():
        name, _, which = key.rpartition("/")
        unit = "s" if which.startswith("time") else units[name]
        found[f"{which}.{name}"] = _entry(over, values, unit, EXTREMES[which].format(name=name))
    for label, values in ensemble.first_passages.items():
        found[f"first_passage.{label}"] = _entry(
            over, values, "s", f"first passage of {label}; NaN where there is none"
        )
    for name, band in ensemble.bands.items():
        coordinates |= _time(band.time)
        coordinates["probability"] = _entry(("probability",), band.probabilities, "1", "of the quantiles")
        found[f"mean.{name}"] = _entry(("time",), band.mean, units[name], f"mean of {name} over {band.count} samples")
        found[f"std.{name}"] = _entry(("time",), band.std, units[name], f"standard deviation of {name}")
        found[f"quantile.{name}"] = _entry(("time", "probability"), band.quantiles, units[name], f"quantiles of {name}")
    return found, coordinates


def _of_derivatives(data: Derivatives) -> tuple[Variables, Variables]:
    found: Variables = {}
    for output, values in data.outputs.items():
        found[output] = _entry(("time",), values, data.units[output], f"output {output}")
        for name in data.changes:
            text = f"derivative of {output} with {name}"
            found[f"derivative.{output}.{name}"] = _entry(
                ("time",), data.derivatives[output][name], data.unit(output, name), text
            )
    for name, (change, what) in data.changes.items():
        found[f"change.{name}"] = _entry((), change, data.units[name], f"{what} of {name}")
    return found, _time(data.time)


def _of_modes(table: ModesTable) -> tuple[Variables, Variables]:
    over = "configuration"
    found = {
        f"frequency.{name}": _entry((over, f"{name}_mode"), values, "Hz", f"eigenfrequencies of the {name} model")
        for name, values in (("full", table.full_hz), ("reduced", table.reduced_hz))
        if values is not None
    }
    return found, {
        f"theta.{name}": _entry((over,), values, unit, f"rigid coordinate {name}")
        for (name, unit), values in zip(table.coordinate_units.items(), np.atleast_2d(table.theta))
    }


DATASETS: Mapping[type, Callable[[Any], tuple[Variables, Variables]]] = {
    Trajectory: _of_run,
    Ensemble: _of_ensemble,
    Derivatives: _of_derivatives,
    ModesTable: _of_modes,
}
