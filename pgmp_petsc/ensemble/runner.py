"""Monte Carlo over ranks.

The samples are worked off in rounds: in each, every rank integrates one batch as one system, and rank 0 gathers what
came out and puts it into a checkpoint. Nothing that was computed is lost when a run is killed; `resume` takes up the
checkpoint, with another number of ranks too, because a sample's numbers depend on seed and sample number alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from pgmp_petsc.dynamics.generalised_alpha import integrate
from pgmp_petsc.dynamics.second_order_system import State
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.ensemble.batch import Batch, Plan
from pgmp_petsc.ensemble.checkpoint import Checkpoint
from pgmp_petsc.ensemble.sampling import draw, physical
from pgmp_petsc.ensemble.checked_samples import checked
from pgmp_petsc.ensemble.statistics import describe
from pgmp_petsc.indicator.coverage import CURE, absence_of_estimates, is_indicated
from pgmp_petsc.indicator.error_indicator import ErrorIndicator, WatchedRun
from pgmp_petsc.indicator.validity import Validity, remarks_of
from pgmp_petsc.models import Model, ReducedModel
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.files import RunRecord
from pgmp_petsc.runtime.progress import progress
from pgmp_petsc.runtime.remarks import Remark, note
from pgmp_petsc.runtime.timings import Timings
from pgmp_petsc.scene import scene_to_toml


def run_ensemble(model: Model, plan: Plan, comm: MPI.Comm) -> Ensemble | None:
    """Integrate the samples that are missing, and describe all. Collective on `comm`.

    Returns
    -------
    Ensemble or None
        On the first rank, None elsewhere.

    Raises
    ------
    InputError
        If the checkpoint to resume belongs to another scene, model, seed or number of samples.
    """
    timings = Timings()
    scene_toml = scene_to_toml(model.scene)
    size = model.largest_batch
    draw(model.scene, plan.seed, 0, 1)  # a scene with nothing to draw is refused before anything is touched
    checkpoint = Checkpoint(plan, scene_toml, model.name)
    finished = on_root(comm, checkpoint.open)
    missing = [first for first in range(0, plan.n_samples, size) if first not in finished]
    with agreed(comm, "preparing the error indicator"):
        indicator = _indicator(model)
    with timings.phase("integration"), progress(plan.n_samples, f"{model.name} samples", comm) as bar:
        bar.update(plan.n_samples - sum(min(size, plan.n_samples - first) for first in missing))
        for start in range(0, len(missing), comm.size):
            turn = missing[start : start + comm.size]
            batch = None
            with agreed(comm, "integration of the samples"):
                if comm.rank < len(turn):
                    first = turn[comm.rank]
                    batch = run_batch(model, plan.seed, first, min(first + size, plan.n_samples), indicator)
            batches = comm.gather(batch)
            with agreed(comm, "writing the checkpoint"):
                if comm.rank == 0:
                    done = [item for item in batches if item is not None]
                    for item in done:
                        checkpoint.add(item)
                    bar.update(sum(len(item.status) for item in done))
    timings = timings.maximum(comm)
    if comm.rank > 0:
        return None
    with timings.phase("statistics"):
        return describe_ensemble(model, plan, checkpoint.batches(), scene_toml, comm.size, timings)


def run_batch(
    model: Model, seed: int, first: int, last: int, indicator: ErrorIndicator | None = None
) -> Batch:
    """Integrate samples first to last - 1 as one system, and estimate errors where there is an indicator."""
    scene = model.scene
    values = draw(scene, seed, first, last)
    alive = physical(scene, values)
    n = last - first
    # an unphysical sample takes the place of a nominal one in the arrays, and is never advanced
    safe = {name: np.where(alive, value, scene.nominal[name]) for name, value in values.items()}
    system = model.batch(safe, n)
    chosen = np.flatnonzero(alive & checked(scene.ensemble.checked_share, first, last))
    watched = indicator.watch(safe, chosen) if indicator is not None and chosen.size else None
    validity = Validity(model, system, safe) if isinstance(model, ReducedModel) else None
    observers = [watcher.observe for watcher in (watched, validity) if watcher is not None]

    def observe(number: int, time: float, state: State) -> None:
        for observer in observers:
            observer(number, time, state)

    run = integrate(system, scene.simulation, alive=alive, observer=observe if observers else None)
    fine = run.status == Status.FINE
    outputs = {name: np.full(n, np.nan) for name in model.outputs.functions}
    if fine.any():
        frames = model.output_frames(system, run.state)[..., fine]
        for name, result in model.outputs.evaluate(frames).items():
            outputs[name][fine] = result
    system.close()
    batch = Batch(first, values, outputs, run.status.astype(int), run.failure_time)
    if validity is not None:
        batch = replace(batch, validity=validity.of(run.status))
    return batch if indicator is None else _with_estimates(batch, watched, run.status, chosen)


def _indicator(model: Model) -> ErrorIndicator | None:
    """Return the indicator of a reduced model whose scene wants one."""
    wanted = is_indicated(model.scene) and model.scene.ensemble.checked_share > 0.0
    return ErrorIndicator(model) if wanted and isinstance(model, ReducedModel) else None


def _with_estimates(batch: Batch, watched: WatchedRun | None, status: np.ndarray, chosen: np.ndarray) -> Batch:
    """Add the estimated errors of the chosen samples, NaN for the others."""
    named = {
        kind: {name: np.full(status.size, np.nan) for name in batch.outputs} for kind in ("errors", "errors_at_end")
    }
    if watched is not None:
        estimate = watched.estimate(status)
        for kind, found in zip(named, (estimate.largest, estimate.at_end)):
            for name, values in found.items():
                named[kind][name][chosen] = values
    return replace(batch, **named)


def _remarks(
    model: Model, estimates: dict[str, dict[str, np.ndarray]], status: np.ndarray
) -> tuple[Remark, ...]:
    """Return what is beyond the limits of small deformations in a reduced ensemble, and which errors are not known."""
    if not isinstance(model, ReducedModel):
        return ()
    scene = model.scene
    remarks = [*absence_of_estimates(scene, ensemble=True), *remarks_of(scene, estimates["validity"])]
    chosen = checked(scene.ensemble.checked_share, 0, status.size) & (status == Status.FINE)
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
    statistics = {name: describe(v[fine & np.isfinite(v)], bins, probabilities) for name, v in outputs.items()}
    drawn = {name: v for name, v in parameters.items() if scene.parameters[name].distribution is not None}
    statistics |= {name: describe(v[np.isfinite(v)], bins, probabilities) for name, v in drawn.items()}
    estimates = {
        kind: {name: np.concatenate([getattr(b, kind)[name] for b in batches]) for name in getattr(batches[0], kind)}
        for kind in ("errors", "errors_at_end", "validity")
    }
    units = {name: parameter.unit or "1" for name, parameter in scene.parameters.items()} | model.outputs.units
    return Ensemble(
        model=model.name,
        record=RunRecord(
            scene_toml, scene.values, plan.seed, ranks, timings.as_dict(),
            remarks=_remarks(model, estimates, status),
        ),
        parameters=parameters,
        outputs=outputs,
        units=units,
        status=status,
        meanings={int(item): item.meaning for item in Status},
        failure_time=np.concatenate([b.failure_time for b in batches]),
        statistics=statistics,
        **estimates,
    )
