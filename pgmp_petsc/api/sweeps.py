"""Runs over a grid or table of parameters, and of an ensemble's samples, as one dataset of xarray.

Points are integrated as the samples of an ensemble, side by side in compiled lanes and dealt out over ranks; a sample's
numbers depend on neither, so that a point has those of its single run. Outputs are kept at the ends of all steps.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pgmp_petsc.api.arguments import PointSet, needs_xarray, wrong
from pgmp_petsc.api.declared import Argument, interface
from pgmp_petsc.api.ranks import RESULT, solving_ranks_of, tell_remarks
from pgmp_petsc.api.result import Result, in_memory
from pgmp_petsc.api.sources import BUILT, SOURCE, AnySource, Origin, place_on_the_way
from pgmp_petsc.base import __version__
from pgmp_petsc.base.errors import InputError, Remark, nearest_name, note, warning
from pgmp_petsc.base.resources import free_memory
from pgmp_petsc.base.surroundings import Comm
from pgmp_petsc.base.units import ROUNDING, UnitSystem
from pgmp_petsc.ensemble.integration import run_ensemble
from pgmp_petsc.ensemble.plan import Plan, SampleFile, Shard, of_columns
from pgmp_petsc.models import Model
from pgmp_petsc.ranks.agreement import on_root
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.reduction.rom import check_samples
from pgmp_petsc.results.ensemble import Ensemble, ShardSamples
from pgmp_petsc.results.estimates import VALIDITY
from pgmp_petsc.scene import Scene
from pgmp_petsc.scene.numerics import MOST_STEPS
from pgmp_petsc.scene.parameters import uncertain_names
from pgmp_petsc.scene.units import own_units, own_values, si_values
from pgmp_petsc.stepping.status import Status

if TYPE_CHECKING:
    import xarray

COPIES = 3  # of all numbers, which are in memory for a moment
UNCHECKED = "errors were not estimated; with ensemble.checked_share = 1.0 among the overrides they are (error.<name>)"
#: Labels of what is known of each run beside its outputs, and what is said of it.
OF_SAMPLES: dict[str, tuple[str, dict[str, str]]] = {
    "status": (
        "sample.status",
        {
            "long_name": "how each run ended; 0 = fine",
            "meanings": json.dumps({str(int(one)): one.meaning for one in Status}),
        },
    ),
    "failure_time": ("sample.failure_time", {"units": "s", "long_name": "instant of failure; NaN where fine"}),
    "numerics.steps_divided": (
        "sample.steps_divided",
        {"long_name": "by what simulation.step was divided in the last attempt"},
    ),
    "numerics.unstable_start": (
        "sample.unstable_start",
        {"long_name": "1 where a run began on an unstable static equilibrium"},
    ),
}


def sweep(origin: Origin, points: PointSet, comm: Comm, on_all_ranks: bool) -> xarray.Dataset | None:
    """Run a model at points of a grid or table; see `runs.simulate`. Collective on `comm`."""
    with _prepared(origin, comm, _keeping_outputs) as (model, place):

        def looking_at_the_points() -> tuple[PointSet, SampleFile]:
            scene = model.scene
            for name in points.arrays:
                if name not in scene.parameters:
                    hint = nearest_name(name, scene.parameters)
                    raise InputError(f"parameters {name}: the scene has no parameter '{name}'{hint}")
            taken = points.of(scene.parameters)
            twice = [name for name in taken.arrays if name in points.fixed]
            names = {*scene.outputs, "time"}
            clashing = [name for name in (*taken.arrays, *taken.dimensions) if name in names]
            if twice or clashing:
                why = "given twice" if twice else "the name of an output, or of time, in the dataset"
                raise InputError(f"parameters: {(twice or clashing)[0]} is {why}; give it another name")
            file = of_columns(taken.columns(), scene, "parameters", place="point")
            remarks = check_samples(model.served, file.values, "parameters")
            return taken, replace(file, remarks=(*file.remarks, *remarks))

        taken, file = on_root(comm, looking_at_the_points)
        found = _run(model, file, place, comm, on_all_ranks)
    if found is None:
        return None
    data, remarks = found
    return _dataset(model.scene, data, taken.dimensions, {**taken.places, **taken.arrays}, remarks)


@interface(
    "Outputs over time along the dimension sample, with those of the ensemble's numbers bit for bit.",
    source=SOURCE,
    ensemble=Argument("An ensemble of this model, or its file."),
    samples=Argument("Numbers of its samples, from 0.", allowed="a list of numbers of samples"),
)
def histories(
    source: AnySource,
    ensemble: Result | str | PathLike[str],
    samples: Sequence[int],
    *,
    model: str | None = None,
    on_all_ranks: bool = True,
    comm: Comm | None = None,
) -> xarray.Dataset | Any:
    """Run samples of an ensemble again, with what the ensemble was asked for, and return their outputs over time.

    Samples that failed are not a number. A warning says so where the model does not repeat the ensemble's numbers.
    """
    comm = solving_ranks_of(comm)
    origin = Origin.of(comm, source, model, (), ())
    numbers = np.array(samples, dtype=int)
    data = on_root(comm, _looking_at_the_ensemble, ensemble, numbers, origin.model)
    directory = ensemble.directory if isinstance(ensemble, Result) else Path(ensemble).parent
    asked = Result("ensemble", data, comm, directory).scene

    def of_ensemble(scene: Scene) -> Scene:
        for table in BUILT:
            if getattr(scene, table) != getattr(asked, table):
                raise InputError(f"ensemble: its [{table}] is not that of {origin.name}; give the model that it is of")
        return _keeping_outputs(asked)

    with _prepared(origin, comm, of_ensemble) as (prepared, place):
        columns = {name: values[numbers] for name, values in data.parameters.items()}
        uncertain = uncertain_names(prepared.scene)
        drawn = [name for name, values in data.parameters.items() if name in uncertain or np.ptp(values) > 0.0]
        of_samples = si_values(prepared.scene, {name: columns[name] for name in drawn})
        found = _run(prepared, SampleFile(Path("samples"), of_samples, "histories"), place, comm, on_all_ranks)
    if found is None:
        return None
    (run, remarks), system = found, prepared.scene.system
    if differing := _differing(data, numbers, run, system):
        what = f"at the end outputs differ from those of the ensemble, {', '.join(differing)}"
        remarks += (warning(f"{what}: this model, machine or version of the program is not the one that it is of"),)
        tell_remarks(comm, remarks[-1:], RESULT)
    xarray = needs_xarray("histories")
    coords = {"sample": xarray.DataArray(numbers, dims="sample")}
    coords |= {name: xarray.DataArray(values, dims="sample") for name, values in columns.items() if name in drawn}
    return _dataset(prepared.scene, run, {"sample": numbers.size}, coords, remarks)


def _looking_at_the_ensemble(ensemble: Result | str | PathLike[str], numbers: np.ndarray, model: str) -> Ensemble:
    """Return an ensemble that has samples of these numbers, of a model; by one process."""
    data = Ensemble.read(Path(ensemble)) if isinstance(ensemble, (str, PathLike)) else ensemble.data
    if not isinstance(data, Ensemble):
        raise wrong("ensemble", data, "an ensemble, as from pgmp.montecarlo, pgmp.merge or pgmp.read")
    if not 0 <= numbers.min() <= numbers.max() < len(data.status):
        raise InputError(f"samples = {numbers.tolist()}: allowed are numbers from 0 to {len(data.status) - 1}")
    if data.model != model:
        what = f"samples of the {data.model} model; here it is the {model} one"
        raise InputError(f"ensemble: {what}; give the model that they are of")
    return in_memory(data)


def _differing(data: Ensemble, numbers: np.ndarray, run: ShardSamples, system: UnitSystem) -> list[str]:
    """Return which outputs at the end of samples that were run again are not those of the ensemble, in words."""
    found = []
    for name, before in data.outputs.items():
        before, now = before[numbers], system.shown(run.columns[f"outputs.{name}"], run.units[name])
        # numbers that were written in mm are not to the last bit those that the run had
        if not np.allclose(before, now, 0.0 if system.is_si else ROUNDING, 0.0, equal_nan=True):
            found.append(f"{name} by up to {np.nanmax(np.abs(before - now), initial=0.0):.3g}")
    return found


def _keeping_outputs(scene: Scene) -> Scene:
    """Return the scene with outputs kept at the ends of all steps of all samples, and nothing estimated unasked."""
    changed = {"bands": int(MOST_STEPS) + 2, "band_samples": 10**9, "extremes": False, "balance": False}
    changed |= {"probabilities": {}, "checked_share": scene.ensemble.checked_share or 0.0}
    return scene.with_entries(ensemble=changed)


@contextmanager
def _prepared(origin: Origin, comm: Comm, changed: Callable[[Scene], Scene]) -> Iterator[tuple[Model, Path]]:
    """Yield the model of a changed scene, and a place for what is kept on the way, which goes at the end."""
    needs_xarray("simulate")
    model = origin.settled(comm, changed, many=True)
    with place_on_the_way(comm) as place:
        yield model, place


def _run(
    model: Model, file: SampleFile, place: Path, comm: Comm, on_all_ranks: bool
) -> tuple[ShardSamples, tuple[Remark, ...]] | None:
    """Integrate samples; return them with what is to be said. None on ranks that get nothing. Collective on `comm`."""
    n, simulation = len(next(iter(file.values.values()))), model.scene.simulation
    n_numbers = n * (simulation.n_steps + 1) * len(model.outputs.functions)

    def looking_at_the_memory() -> None:
        free = free_memory()
        if free is not None and COPIES * 8.0 * n_numbers > free:
            raise InputError(
                f"parameters: {n} points need {COPIES * 8e-9 * n_numbers:.3g} GB for their outputs over time, and "
                f"{free / 1e9:.3g} GB are free; take fewer points, or pgmp.montecarlo(samples=...), which keeps ends"
            )

    on_root(comm, looking_at_the_memory)
    with RankGroup.split(comm, 1) as group:
        found = run_ensemble(model, Plan(n, 0, place, False, file, Shard(1, 1)), group)

    def taking_the_samples() -> tuple[ShardSamples, tuple[Remark, ...]]:
        data = replace(found, columns=dict(found.columns), bands=dict(found.bands))
        unchecked = () if model.scene.ensemble.checked_share else (note(UNCHECKED),)
        return data, (*file.remarks, *_failures(data.status), *model.kinematics.remarks, *unchecked)

    taken = on_root(comm, taking_the_samples)
    tell_remarks(comm, taken[1], RESULT)
    return taken if on_all_ranks or comm.rank == 0 else None


def _failures(status: np.ndarray) -> tuple[Remark, ...]:
    counts = Counter(int(one) for one in status if one != Status.FINE)
    if not counts:
        return ()
    reasons = "; ".join(f"{n} with status {one}: {Status(one).meaning}" for one, n in sorted(counts.items()))
    return (warning(f"{sum(counts.values())} of {status.size} runs failed and are not a number, {reasons}"),)


def _dataset(
    scene: Scene, data: ShardSamples, sizes: Mapping[str, int], coords: Mapping[str, Any], remarks: Sequence[Remark]
) -> xarray.Dataset:
    """Return samples of a scene as a dataset along some dimensions."""
    dims, shape, system = tuple(sizes), tuple(sizes.values()), scene.system
    found: dict[str, tuple[Any, ...]] = {}
    for name, values in data.bands.items():
        values, unit = system.named(values, data.units[name])
        about = {"units": unit, "long_name": f"output '{name}' over time"}
        found[name] = ((*dims, "time"), values.reshape(*shape, -1), about)
    for place, values in data.columns.items():
        kind, _, name = place.partition(".")
        if place in OF_SAMPLES:
            label, about = OF_SAMPLES[place]
            values = values if place == "failure_time" else values.astype(int)
        elif kind == "errors":
            label = f"error.{name}"
            values, unit = system.named(values, data.units[name])
            about = {"units": unit, "long_name": f"largest estimated error of output '{name}' over the run"}
        elif kind == "errors_unsure":
            label, about = f"error_unsure.{name}", {"long_name": f"1 where error.{name} is unsure"}
        elif kind == "validity":
            label, about = place, {"units": VALIDITY[name]["unit"], "long_name": VALIDITY[name]["about"]}
        else:
            continue
        found[label] = (dims, values.reshape(shape), about)
    known = {name: {"units": unit, "long_name": f"parameter '{name}'"} for name, unit in own_units(scene).items()}
    where = {name: one.assign_attrs(known.get(name, {})) for name, one in coords.items()}
    n_steps = scene.simulation.n_steps
    time = scene.simulation.duration * np.arange(n_steps + 1) / n_steps
    about = {"scene": scene.scene.name, "model": data.model, "program_version": __version__}
    others = {name: value for name, value in own_values(scene).items() if name not in coords}
    about |= {"parameters": json.dumps(others), "remarks": [str(remark) for remark in remarks]}
    return needs_xarray("simulate").Dataset(
        found, {**where, "time": ("time", time, {"units": "s", "long_name": "time"})}, about
    )
