"""The figures of a result as plain data, for `--json`, and as tables: mappings, lists, texts and numbers.

Numbers are None where a figure is not known or infinite (an end of an interval that too few samples leave open). Values
are in the units beside them, those of the scene. Tables have columns with their units in the first line of a CSV file,
all digits; docs/first_steps.md (figures for other programs) has which results have one, and of what.
"""

from __future__ import annotations

import csv
import io
import json
import os
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc.files.claims import TABLE, check_output, is_table, replacing

if TYPE_CHECKING:
    from pgmp_petsc.files.hdf5 import RunRecord
    from pgmp_petsc.results.ensemble import Chance, Ensemble, Joined, Sensitivity, ShardSamples, Statistics, Stopping
    from pgmp_petsc.results.gradients import Derivatives
    from pgmp_petsc.results.tradeoff import Tradeoff
    from pgmp_petsc.results.trajectory import ModesTable, Trajectory

# kinds whose figures are all that the file has, but for samples one by one
WHOLE = {
    "sensitivities": (),
    "fit": (),
    "design": (),
    "rare_event": ("names", "normal", "value", "weight", "status", "parameters", "curve"),
}


def json_text(data: object) -> str:
    """Return data as JSON, with arrays as lists."""
    return json.dumps(json_data(data), indent=1, allow_nan=False)


def json_data(data: object) -> Any:
    """Return data without arrays, dataclasses, tuples, and numbers that are not finite."""
    if isinstance(data, Mapping):
        return {str(name): json_data(value) for name, value in data.items()}
    if is_dataclass(data) and not isinstance(data, type):
        return json_data(asdict(data))
    if isinstance(data, np.ndarray):
        whole = data.dtype.kind in "iub" or data.dtype.kind == "f" and np.isfinite(data).all()
        return data.tolist() if whole else json_data(data.tolist())  # of a million numbers half a minute, one by one
    if isinstance(data, (list, tuple, set, frozenset)):
        return [json_data(value) for value in data]
    if isinstance(data, np.generic):
        data = data.item()
    if isinstance(data, float):
        return data if np.isfinite(data) else None
    return data if data is None or isinstance(data, (str, int, bool)) else str(data)


def summary_of(result: object) -> dict[str, Any]:
    """Return the figures of a result, and where it comes from."""
    kind = getattr(result, "kind", "")
    summaries = {"trajectory": _run, "ensemble": _ensemble, "tradeoff": _study, "modes": _modes, "shard": _shard}
    if kind in summaries:
        return {"kind": kind, **summaries[kind](result), **origin_of(result.record)}
    if kind not in WHOLE:
        raise TypeError(f"no figures of {type(result).__name__}")
    own = {item.name: getattr(result, item.name) for item in fields(result) if item.name not in WHOLE[kind]}
    return {**own, "kind": kind, **origin_of(own.pop("record"))}


def origin_of(record: RunRecord) -> dict[str, Any]:
    """Return where a result comes from, and what its reader has to know."""
    try:
        scene = str(record.tables["scene"]["name"])
    except (tomllib.TOMLDecodeError, KeyError, TypeError):
        scene = ""
    remarks = [asdict(remark) for remark in record.remarks]
    own = _parts(record, "parameters", "seed", "ranks")
    return {"scene": scene, **own, "remarks": remarks, "timings": record.timings}


def units_of_parameters(record: RunRecord) -> dict[str, str]:
    """Return the units of the parameters of the scene that a result is of."""
    given = record.tables.get("parameters", {})
    return {name: one.get("unit", "") for name, one in given.items()}


def _parts(of: object, *names: str) -> dict[str, Any]:
    return {name: getattr(of, name) for name in names}


def _shard(shard: ShardSamples) -> dict[str, Any]:
    place = shard.place
    ends = {"first": place.first, "last": place.first + len(shard.status) - 1, "of": place.n_samples}
    return {"model": shard.model, "shard": f"{place.number}/{place.count}", **ends}


def _rows(keys: str, *columns: Iterable[Any]) -> list[dict[str, Any]]:
    return [dict(zip(keys.split(), row)) for row in zip(*columns)]


def _run(run: Trajectory) -> dict[str, Any]:
    outputs, errors, balance = {}, run.errors, run.balance
    for name, values in run.outputs.items():
        found = {"unit": run.units.get(name, "1"), "at_end": values[-1]}
        for key, at in (("min", int(np.argmin(values))), ("max", int(np.argmax(values)))):
            found |= {key: values[at], f"time_of_{key}": run.time[at]}
        outputs[name] = found
    about = {**_parts(run, "model", "status"), "why_stopped": run.why_stopped or None, "end_time": run.time[-1]}
    about |= {"steps": len(run.time) - 1, "steps_divided": run.steps_divided, "outputs": outputs}
    about |= dict.fromkeys(("errors", "errors_of", "errors_until"))
    if errors is not None:
        found = {name: {"maximum": errors.maximum(name), "share": errors.share(name)} for name in errors.outputs}
        for name in found.keys() & errors.absent.keys():
            found[name]["not_estimated"] = errors.absent[name]
        about |= {"errors": found, "errors_of": errors.what, "errors_until": errors.time[-1]}
    residual = None if balance is None else np.abs(balance.residual).max()
    moved = None if balance is None else {"residual": residual, "exchanged": balance.exchanged}
    return about | {"validity": run.validity, "balance": moved}


def _ensemble(ensemble: Ensemble) -> dict[str, Any]:
    units, status = ensemble.units, ensemble.status
    reasons = {ensemble.meanings[int(k)]: int(np.count_nonzero(status == k)) for k in np.unique(status[status != 0])}
    errors = {}
    for name, values in ensemble.errors.items():
        known = values[np.isfinite(values)]
        found = {"median": np.median(known), "largest": known.max()} if known.size else {}
        errors[name] = {"unit": units.get(name, "1"), "samples": known.size, **found}
    statistics = {name: {"unit": units.get(name, "1"), **_statistics(s)} for name, s in ensemble.statistics.items()}
    return {
        "model": ensemble.model,
        "samples": len(status),
        "failed": int(np.count_nonzero(status)),
        "reasons": reasons,
        "statistics": statistics,
        "probabilities": {label: _chance(chance) for label, chance in ensemble.probabilities.items()},
        "sobol": {name: _indices(found) for name, found in ensemble.sobol.items()},
        "errors": errors,
        "corrected": None if ensemble.joined is None else _joined(ensemble.joined),
        "stopping": None if ensemble.stopping is None else _stopping(ensemble.stopping),
    }


def _chance(chance: Chance) -> dict[str, Any]:
    decided = chance.is_decided()
    found = _parts(chance, "event", "estimate", "interval", "confidence", "count")
    found |= {"samples": chance.n, "failed": chance.n_failed, "decided": decided}
    found["decided_by"] = "" if decided else chance.decided_by
    return found | _parts(chance, "model_error", "holds_to")


def _indices(found: Sensitivity) -> dict[str, Any]:
    values = {"S1": found.first, "S1_interval": found.first_interval, "ST": found.total}
    return {**_parts(found, "parameters", "confidence"), **values, "ST_interval": found.total_interval}


def _joined(joined: Joined) -> dict[str, Any]:
    figures = {}
    for name, found in joined.corrected.items():
        known = {key: _parts(one, "estimate", "interval", "narrower") for key, one in found.figures.items()}
        figures[name] = {"samples": found.counts, **known}
    return {**_parts(joined, "models", "confidence"), "figures": figures}


def _stopping(stopping: Stopping) -> dict[str, Any]:
    looks = (stopping.rules, stopping.met, stopping.estimates[:, -1], stopping.intervals[:, -1])
    return {"why": stopping.why, "samples": stopping.samples[-1], "rules": _rows("rule met estimate interval", *looks)}


def _statistics(s: Statistics) -> dict[str, Any]:
    quantiles = (s.probabilities, s.quantiles, s.quantile_intervals, s.quantile_bounds)
    known = _parts(s, "count", "constant", "confidence", "mean", "mean_interval", "std", "std_interval")
    return {**known, "quantiles": _rows("probability value interval bounds", *quantiles)}


def _study(study: Tradeoff) -> dict[str, Any]:
    names = [study.name(row) for row in range(len(study.families))]
    errors = [dict(zip(study.outputs, row)) for row in study.errors]
    times = (study.times.offline, study.times.batch, study.times.single)
    settings = _rows(
        "name flags errors offline sample single reason", names, study.flags, errors, *times, study.reasons
    )
    return {**_parts(study, "samples", "reference"), "settings": settings, "advice": study.advice}


def _modes(table: ModesTable) -> dict[str, Any]:
    tables = {"full": table.full_hz, "reduced": table.reduced_hz}
    known = {f"{name}_frequencies_hz": values for name, values in tables.items() if values is not None}
    ranges = {name: {"min": values.min(axis=0), "max": values.max(axis=0)} for name, values in known.items()}
    return {"configurations": len(table.full_hz), **ranges}


#: Unit ("1" or "" for none) and values, shape (n_rows,), by name.
Columns = dict[str, tuple[str, np.ndarray]]


def columns_of(result: Any) -> Columns:
    """Return the columns of a trajectory, an ensemble, a table of modes, a trade-off study or sensitivities; raises
    `TypeError` if it is something else."""
    kind = getattr(result, "kind", "")
    if kind not in _COLUMNS:
        raise TypeError(f"{type(result).__name__} has no table")
    return _COLUMNS[kind](result)


def csv_text(columns: Mapping[str, tuple[str, np.ndarray]], rows: int | None = None) -> str:
    """Return the first `rows` rows (all if not given) as CSV: names with units, then numbers with all digits."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([f"{name} ({unit})" if unit not in ("", "1") else name for name, (unit, _) in columns.items()])
    texts = ([repr(x) if isinstance(x, float) else str(x) for x in own[:rows].tolist()] for _, own in columns.values())
    writer.writerows(zip(*texts))
    return stream.getvalue()


def write_result(result: Any, path: str | os.PathLike[str], *parts: Any) -> None:
    """Write a result, and what adds itself to the file: of any kind that `write` is a method of as HDF5, of one with
    columns as a table where the file's name ends in .csv. By one process only. Raises `InputError` if the file cannot
    be made there, or is there and may not be replaced; `RunError` if the system fails to write."""
    if not is_table(path):
        result.write(path, *parts)
        return
    text = csv_text(columns_of(result))
    with replacing(check_output(path, TABLE)) as partial:
        Path(partial).write_text(text, encoding="utf-8")


def _of_run(run: Trajectory) -> Columns:
    return {"time": ("s", run.time)} | {name: (run.units.get(name, "1"), run.outputs[name]) for name in run.outputs}


def _of_ensemble(ensemble: Ensemble) -> Columns:
    columns: Columns = {"sample": ("1", np.arange(len(ensemble.status))), "status": ("1", ensemble.status)}
    for name, values in (*ensemble.parameters.items(), *ensemble.outputs.items()):
        columns[name] = (ensemble.units.get(name, "1"), values)
    for key, values in ensemble.extremes.items():
        name, _, which = key.rpartition("/")
        columns[f"{name}.{which}"] = ("s" if which.startswith("time") else ensemble.units.get(name, "1"), values)
    return columns | {label: ("s", values) for label, values in ensemble.first_passages.items()}


def _of_modes(table: ModesTable) -> Columns:
    angles = np.atleast_2d(table.theta)
    columns: Columns = {name: (unit, angle) for (name, unit), angle in zip(table.coordinate_units.items(), angles)}
    for model, frequencies in (("full", table.full_hz), ("reduced", table.reduced_hz)):
        for number, values in enumerate(() if frequencies is None else frequencies.T, 1):
            columns[f"{model}.{number}"] = ("Hz", values)
    return columns


def _of_study(study: Tradeoff) -> Columns:
    names = np.array([study.name(row) for row in range(len(study.families))], dtype=object)
    columns: Columns = {"setting": ("", names)}
    columns |= {f"error {name}": ("1", study.errors[:, k]) for k, name in enumerate(study.outputs)}
    return columns | {f"{clock} time": ("s", values) for clock, values in vars(study.times).items()}


def _of_derivatives(found: Derivatives) -> Columns:
    columns: Columns = {"time": ("s", found.time)}
    columns |= {name: (found.units.get(name, "1"), values) for name, values in found.outputs.items()}
    for output, derivatives in found.derivatives.items():
        columns |= {f"d {output} / d {name}": (found.unit(output, name), derivatives[name]) for name in derivatives}
    return columns


_COLUMNS: dict[str, Callable[[Any], Columns]] = {
    "trajectory": _of_run,
    "ensemble": _of_ensemble,
    "modes": _of_modes,
    "tradeoff": _of_study,
    "sensitivities": _of_derivatives,
}
