"""The figures of a result as plain data, for `--json`: mappings, lists, texts and numbers.

Numbers are None where a figure is not known or infinite (an end of an interval that too few samples leave open).

Values are in the units that stand beside them, SI units throughout.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pgmp_petsc.results.corrected import Joined
    from pgmp_petsc.results.ensemble import Ensemble
    from pgmp_petsc.results.modes import ModesTable
    from pgmp_petsc.results.shard import ShardSamples
    from pgmp_petsc.results.statistics import Statistics
    from pgmp_petsc.results.stopping import Stopping
    from pgmp_petsc.results.tradeoff import Tradeoff
    from pgmp_petsc.results.trajectory import Trajectory
    from pgmp_petsc.runtime.files import RunRecord

# kinds whose figures are all that the file has, but for samples one by one
WHOLE = {
    "sensitivities": (),
    "fit": (),
    "design": (),
    "rare_event": ("names", "normal", "value", "weight", "status", "parameters", "curve"),
}


def json_text(data: object) -> str:
    """Return data as JSON, with arrays as lists."""
    return json.dumps(plain(data), indent=1, allow_nan=False)


def plain(data: object) -> Any:
    """Return data without arrays, dataclasses, tuples, and numbers that are not finite."""
    if isinstance(data, Mapping):
        return {str(name): plain(value) for name, value in data.items()}
    if is_dataclass(data) and not isinstance(data, type):
        return plain(asdict(data))
    if isinstance(data, np.ndarray):
        whole = data.dtype.kind in "iub" or data.dtype.kind == "f" and np.isfinite(data).all()
        return data.tolist() if whole else plain(data.tolist())  # of a million numbers half a minute, one by one
    if isinstance(data, (list, tuple, set, frozenset)):
        return [plain(value) for value in data]
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
        scene = str(tomllib.loads(record.scene_toml)["scene"]["name"])
    except (tomllib.TOMLDecodeError, KeyError, TypeError):
        scene = ""
    return {
        "scene": scene,
        "parameters": record.parameters,
        "seed": record.seed,
        "ranks": record.ranks,
        "remarks": [asdict(remark) for remark in record.remarks],
        "timings": record.timings,
    }


def _shard(shard: ShardSamples) -> dict[str, Any]:
    place = shard.place
    ends = {"first": place.first, "last": place.first + len(shard.status) - 1, "of": place.n_samples}
    return {"model": shard.model, "shard": f"{place.number}/{place.count}", **ends}


def _run(run: Trajectory) -> dict[str, Any]:
    outputs = {}
    for name, values in run.outputs.items():
        low, high = int(np.argmin(values)), int(np.argmax(values))
        outputs[name] = {
            "unit": run.units.get(name, "1"),
            "at_end": values[-1],
            "min": values[low],
            "time_of_min": run.time[low],
            "max": values[high],
            "time_of_max": run.time[high],
        }
    errors, balance = run.errors, run.balance
    return {
        "model": run.model,
        "status": run.status,
        "why_stopped": run.why_stopped or None,
        "end_time": run.time[-1],
        "steps": len(run.time) - 1,
        "steps_divided": run.steps_divided,
        "outputs": outputs,
        "errors": (
            None
            if errors is None
            else {
                name: {"maximum": errors.maximum(name), "share": errors.share(name)}
                | ({"not_estimated": errors.absent[name]} if name in errors.absent else {})
                for name in errors.outputs
            }
        ),
        "errors_of": None if errors is None else errors.what,
        "errors_until": None if errors is None else errors.time[-1],
        "validity": run.validity,
        "balance": (
            None if balance is None else {"residual": np.abs(balance.residual).max(), "exchanged": balance.exchanged}
        ),
    }


def _ensemble(ensemble: Ensemble) -> dict[str, Any]:
    units, status = ensemble.units, ensemble.status
    errors = {}
    for name, values in ensemble.errors.items():
        known = values[np.isfinite(values)]
        found = {"median": np.median(known), "largest": known.max()} if known.size else {}
        errors[name] = {"unit": units.get(name, "1"), "samples": known.size, **found}
    return {
        "model": ensemble.model,
        "samples": len(status),
        "failed": int(np.count_nonzero(status)),
        "reasons": {
            ensemble.meanings[int(number)]: int(np.count_nonzero(status == number))
            for number in np.unique(status[status != 0])
        },
        "statistics": {
            name: {"unit": units.get(name, "1"), **_statistics(s)} for name, s in ensemble.statistics.items()
        },
        "probabilities": {
            label: {
                "event": chance.event,
                "estimate": chance.estimate,
                "interval": chance.interval,
                "confidence": chance.confidence,
                "count": chance.count,
                "samples": chance.n,
                "failed": chance.n_failed,
                "decided": chance.is_decided(),
                "decided_by": "" if chance.is_decided() else chance.decided_by,
                "model_error": chance.model_error,
                "holds_to": chance.holds_to,
            }
            for label, chance in ensemble.probabilities.items()
        },
        "sobol": {
            name: {
                "parameters": found.parameters,
                "confidence": found.confidence,
                "S1": found.first,
                "S1_interval": found.first_interval,
                "ST": found.total,
                "ST_interval": found.total_interval,
            }
            for name, found in ensemble.sobol.items()
        },
        "errors": errors,
        "corrected": None if ensemble.joined is None else _joined(ensemble.joined),
        "stopping": None if ensemble.stopping is None else _stopping(ensemble.stopping),
    }


def _joined(joined: Joined) -> dict[str, Any]:
    return {
        "models": joined.models,
        "confidence": joined.confidence,
        "figures": {
            name: {
                "samples": found.counts,
                **{
                    key: {"estimate": figure.estimate, "interval": figure.interval, "narrower": figure.narrower}
                    for key, figure in found.figures.items()
                },
            }
            for name, found in joined.corrected.items()
        },
    }


def _stopping(stopping: Stopping) -> dict[str, Any]:
    looks = zip(stopping.rules, stopping.met, stopping.estimates[:, -1], stopping.intervals[:, -1])
    return {
        "why": stopping.why,
        "samples": stopping.samples[-1],
        "rules": [
            {"rule": rule, "met": met, "estimate": estimate, "interval": interval}
            for rule, met, estimate, interval in looks
        ],
    }


def _statistics(s: Statistics) -> dict[str, Any]:
    quantiles = zip(s.probabilities, s.quantiles, s.quantile_intervals, s.quantile_bounds)
    return {
        "count": s.count,
        "constant": s.constant,
        "confidence": s.confidence,
        "mean": s.mean,
        "mean_interval": s.mean_interval,
        "std": s.std,
        "std_interval": s.std_interval,
        "quantiles": [
            {"probability": p, "value": value, "interval": ends, "bounds": bounds}
            for p, value, ends, bounds in quantiles
        ],
    }


def _study(study: Tradeoff) -> dict[str, Any]:
    return {
        "samples": study.samples,
        "reference": study.reference,
        "settings": [
            {
                "name": study.name(row),
                "flags": study.flags[row],
                "errors": dict(zip(study.outputs, study.errors[row])),
                "offline": study.times.offline[row],
                "sample": study.times.batch[row],
                "single": study.times.single[row],
                "reason": study.reasons[row],
            }
            for row in range(len(study.families))
        ],
        "advice": study.advice,
    }


def _modes(table: ModesTable) -> dict[str, Any]:
    tables = {"full": table.full_hz, "reduced": table.reduced_hz}
    return {
        "configurations": len(table.full_hz),
        **{
            f"{name}_frequencies_hz": {"min": values.min(axis=0), "max": values.max(axis=0)}
            for name, values in tables.items()
            if values is not None
        },
    }
