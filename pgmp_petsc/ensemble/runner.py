"""Monte Carlo over ranks.

The samples are worked off in rounds: in each, every rank integrates one batch as one system, or a group of ranks one
sample, and rank 0 gathers what came out and puts it into a checkpoint. Nothing that was computed is lost when a run is
killed; `resume` takes up the checkpoint, with another number of ranks too, because a sample's numbers depend on seed
and sample number alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from pgmp_petsc.dynamics.generalised_alpha import Run, integrate
from pgmp_petsc.dynamics.second_order_system import SecondOrderSystem
from pgmp_petsc.dynamics.settled_start import starts_remarks
from pgmp_petsc.dynamics.smaller_steps import Attempt, integrate_with_smaller_steps
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.dynamics.ts_options import check_ts_options
from pgmp_petsc.ensemble.batch import Batch, Plan
from pgmp_petsc.ensemble.checkpoint import Checkpoint
from pgmp_petsc.ensemble.sampling import draw, draw_remarks, physical
from pgmp_petsc.ensemble.failures import failure_remarks, step_remarks
from pgmp_petsc.ensemble.statistics import describe
from pgmp_petsc.ensemble.checked_samples import checked
from pgmp_petsc.ensemble.watchers import BalanceWatcher, Begun, ErrorWatcher, Found, ValidityWatcher, Watcher, together
from pgmp_petsc.indicator.coverage import CURE, absence_of_estimates, is_indicated, why_not_of_full_order
from pgmp_petsc.indicator.error_indicator import ErrorIndicator
from pgmp_petsc.indicator.validity import remarks_of
from pgmp_petsc.models import Model, ReducedModel
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.files import RunRecord
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.runtime.progress import progress
from pgmp_petsc.runtime.remarks import Remark, note
from pgmp_petsc.runtime.timings import Timings
from pgmp_petsc.scene import scene_to_toml


def run_ensemble(model: Model, plan: Plan, group: RankGroup) -> Ensemble | None:
    """Integrate the samples that are missing, and describe all. Collective on ``group.world``.

    Groups of several ranks share one full-order sample at a time.

    Returns
    -------
    Ensemble or None
        On the first rank, None elsewhere.

    Raises
    ------
    InputError
        If the checkpoint to resume belongs to another scene, model, seed or number of samples.
    RunError
        If the finished batches are not all samples, each once.
    """
    timings, comm = Timings(), group.world
    scene_toml = scene_to_toml(model.scene)
    size = model.largest_batch if group.count == comm.size else 1
    # a scene with nothing to draw, and options that would change it, are refused before anything is touched
    with agreed(comm, "checking what the run is asked for"):
        draw(model.scene, plan.seed, 0, 1)
        check_ts_options()
    checkpoint = Checkpoint(plan, scene_toml, model.name, model.identity, size)
    finished = on_root(comm, checkpoint.open)
    missing = [first for first in range(0, plan.n_samples, size) if first not in finished]
    with agreed(comm, "preparing the error indicator"):
        watchers = _watchers(model, plan.n_samples)
    taken_up = plan.n_samples - sum(min(size, plan.n_samples - first) for first in missing)
    with timings.phase("integration"), progress(plan.n_samples, f"{model.name} samples", comm, taken_up) as bar:
        for start in range(0, len(missing), group.count):
            turn = missing[start : start + group.count]
            batch = None
            with agreed(comm, "integration of the samples"):
                if group.index < len(turn):
                    first = turn[group.index]
                    batch = run_batch(model, plan.seed, first, min(first + size, plan.n_samples), watchers, group.comm)
            batches = comm.gather(batch if group.comm.rank == 0 else None)
            with agreed(comm, "writing the checkpoint"):
                if comm.rank == 0:
                    done = [item for item in batches if item is not None]
                    for item in done:
                        checkpoint.add(item)
                    bar.update(sum(len(item.status) for item in done))
    timings = timings.maximum(comm)
    with agreed(comm, "statistics"):
        return _described(model, plan, checkpoint, scene_toml, comm.size, timings) if comm.rank == 0 else None


def _described(
    model: Model, plan: Plan, checkpoint: Checkpoint, scene_toml: str, ranks: int, timings: Timings
) -> Ensemble:
    """Describe what the checkpoint holds, with what was found in it."""
    with timings.phase("statistics"):
        ensemble = describe_ensemble(model, plan, checkpoint.batches(), scene_toml, ranks, timings)
    remarks = (*checkpoint.remarks, *ensemble.record.remarks)
    return replace(ensemble, record=replace(ensemble.record, remarks=remarks))


def run_batch(
    model: Model, seed: int, first: int, last: int, watchers: Sequence[Watcher] = (), comm: MPI.Comm = MPI.COMM_SELF
) -> Batch:
    """Integrate samples first to last - 1 as one system, those that fail again with smaller steps.

    Several ranks share one sample. What the watchers find is added where they look, and is NaN elsewhere. Collective on
    `comm`.
    """
    scene = model.scene
    values = draw(scene, seed, first, last)
    alive = physical(scene, values)
    n = last - first
    # an unphysical sample takes the place of a nominal one in the arrays, and is never advanced
    safe = {name: np.where(alive, value, scene.nominal[name]) for name, value in values.items()}
    wanted = [alive & watcher.chosen(first, last) for watcher in watchers]
    outputs = {name: np.full(n, np.nan) for name in model.outputs.functions}
    unstable = np.zeros(n, dtype=bool)
    found: Found = {}

    def run(attempt: Attempt) -> Run:
        samples = attempt.samples
        some = {name: value[samples] for name, value in safe.items()}
        chosen = [np.flatnonzero(mask[samples]) for mask in wanted]
        if comm.size == 1:
            made = model.batch(some, samples.size)
        else:
            made = model.single({name: float(value[0]) for name, value in some.items()}, comm)
        with closing(made) as system:
            if system.settled is not None:
                unstable[samples] = system.settled.unstable & attempt.alive
            watched = [
                (places, watcher.watch(Begun(system, some, places, attempt.simulation)))
                for watcher, places in zip(watchers, chosen)
                if places.size
            ]
            observer = together([watch for _, watch in watched])
            done = integrate(system, attempt.simulation, alive=attempt.alive, observer=observer)
            done = _with_outputs(model, system, done, samples, outputs, attempt.simulation.duration)
        for places, watch in watched:
            for kind, arrays in watch.found(done.status).items():
                for name, estimates in arrays.items():
                    kept = found.setdefault(kind, {}).setdefault(name, np.full(n, np.nan))
                    kept[samples[places]] = estimates
        return done

    outcome = integrate_with_smaller_steps(run, scene.simulation, alive)
    for watcher in watchers:
        for kind, names in watcher.names.items():
            for name in names:
                found.setdefault(kind, {}).setdefault(name, np.full(n, np.nan))
    numerics = {"steps_divided": outcome.divisors, "unstable_start": unstable}
    return Batch(first, values, outputs, outcome.status, outcome.failure_time, numerics, **found)


def _with_outputs(
    model: Model, system: SecondOrderSystem, done: Run, samples: np.ndarray, outputs: dict[str, np.ndarray], end: float
) -> Run:
    """Evaluate the outputs of the samples that are fine into `outputs`; one that is no finite number is a failure."""
    fine = np.flatnonzero(done.status == Status.FINE)
    if not fine.size:
        return done
    with np.errstate(all="ignore"):
        found = model.outputs.evaluate(model.output_frames(system, done.state)[..., fine])
    lost = fine[~np.all([np.isfinite(values) for values in found.values()] or [np.ones(fine.size)], axis=0)]
    status, failure_time = done.status.copy(), done.failure_time.copy()
    status[lost], failure_time[lost] = Status.NOT_FINITE, end
    for name, values in found.items():
        outputs[name][samples[fine]] = np.where(status[fine] == Status.FINE, values, np.nan)
    return replace(done, status=status, failure_time=failure_time)


def _watchers(model: Model, n_samples: int) -> list[Watcher]:
    """Return what looks at the runs of a model's samples."""
    watchers: list[Watcher] = [BalanceWatcher()] if model.scene.ensemble.balance else []
    if not isinstance(model, ReducedModel):
        return watchers
    share = model.scene.ensemble.checked_share
    validity = ValidityWatcher(model)
    if is_indicated(model.scene) and share > 0.0:
        watchers.append(ErrorWatcher(ErrorIndicator(model), share, n_samples))
    return [*watchers, validity]


def _remarks(model: Model, estimates: dict[str, dict[str, np.ndarray]], status: np.ndarray) -> tuple[Remark, ...]:
    """Return what is beyond the limits of small deformations in a reduced ensemble, and which errors are not known."""
    scene = model.scene
    if not isinstance(model, ReducedModel):
        return why_not_of_full_order(scene)
    remarks = [*absence_of_estimates(scene, ensemble=True), *remarks_of(scene, estimates["validity"])]
    chosen = checked(scene.ensemble.checked_share, 0, status.size, status.size) & (status == Status.FINE)
    if estimates["errors"]:
        unknown = int(np.sum(chosen & np.any([~np.isfinite(v) for v in estimates["errors"].values()], axis=0)))
        if unknown:
            remarks.append(
                note(
                    f"errors were not estimated for {unknown} of the {int(chosen.sum())} samples that are checked: the "
                    f"full-order equations could not be solved about their motion; {CURE}"
                )
            )
    return tuple(remarks)


def describe_ensemble(
    model: Model, plan: Plan, batches: list[Batch], scene_toml: str, ranks: int, timings: Timings
) -> Ensemble:
    """Put batches together and describe parameters and outputs."""
    scene = model.scene
    parameters = {name: np.concatenate([b.parameters[name] for b in batches]) for name in scene.parameters}
    outputs = {name: np.concatenate([b.outputs[name] for b in batches]) for name in model.outputs.functions}
    status = np.concatenate([b.status for b in batches])
    fine = status == Status.FINE
    bins, probabilities = scene.ensemble.bins, scene.ensemble.quantiles
    n_failed = int(np.sum(~fine))
    statistics = {name: describe(v[fine], bins, probabilities, n_failed) for name, v in outputs.items()}
    drawn = {name: v for name, v in parameters.items() if scene.parameters[name].distribution is not None}
    statistics |= {name: describe(v[np.isfinite(v)], bins, probabilities) for name, v in drawn.items()}
    estimates = {
        kind: {name: np.concatenate([getattr(b, kind)[name] for b in batches]) for name in getattr(batches[0], kind)}
        for kind in ("numerics", "errors", "errors_at_end", "validity", "balance")
    }
    numerics = estimates.pop("numerics")
    divisors = numerics["steps_divided"]
    units = {name: parameter.unit or "1" for name, parameter in scene.parameters.items()} | model.outputs.units
    remarks = (
        *failure_remarks(status, drawn, units),
        *step_remarks(status, divisors, scene.simulation.step),
        *draw_remarks(scene),
        *starts_remarks(scene, numerics["unstable_start"]),
        *_single(int(fine.sum())),
        *_remarks(model, estimates, status),
    )
    return Ensemble(
        model=model.name,
        record=RunRecord(scene_toml, scene.values, plan.seed, ranks, timings.as_dict(), (*scene.remarks, *remarks)),
        parameters=parameters,
        outputs=outputs,
        units=units,
        status=status,
        meanings={int(item): item.meaning for item in Status},
        failure_time=np.concatenate([b.failure_time for b in batches]),
        statistics=statistics,
        steps_divided=divisors,
        **estimates,
    )


def _single(n_fine: int) -> tuple[Remark, ...]:
    """Return what is to be said of statistics of one sample."""
    if n_fine != 1:
        return ()
    return (note("one sample has no deviation and no standard errors; draw more"),)
