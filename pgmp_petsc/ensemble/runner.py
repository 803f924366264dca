"""Monte Carlo over ranks.

The samples are dealt out in pieces (`pieces`): a rank integrates one as one system, a group of ranks one sample, and
rank 0 puts what came out into a checkpoint while the others go on. Nothing that was computed is lost when a run is
killed; `resume` takes up the checkpoint, with another number of ranks too, because a sample's numbers depend on seed
and sample number alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from pgmp_petsc.dynamics.generalised_alpha import Run, Together, integrate
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
from pgmp_petsc.ensemble.checked_samples import checked, share_of
from pgmp_petsc.ensemble.pieces import Piece, missing, pieces
from pgmp_petsc.ensemble.watchers import BalanceWatcher, Begun, ErrorWatcher, Found, ValidityWatcher, Watcher
from pgmp_petsc.indicator.coverage import (
    CURE,
    absence_of_estimates,
    left_out_of_estimates,
    truncated_stresses,
    why_not_of_full_order,
)
from pgmp_petsc.indicator.error_indicator import ErrorIndicator
from pgmp_petsc.indicator.validity import remarks_of
from pgmp_petsc.models import Model, ReducedModel
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.dealing import Pulse, deal_to_groups
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
    # a scene with nothing to draw, and options that would change it, are refused before anything is touched
    with agreed(comm, "checking what the run is asked for"):
        draw(model.scene, plan.seed, 0, 1)
        check_ts_options()
    checkpoint = Checkpoint(plan, scene_toml, model.name, model.identity)
    finished = on_root(comm, checkpoint.open)
    with agreed(comm, "preparing the error indicator"):
        watching = Watching(model)
    todo = missing([(0, plan.n_samples)], finished.samples)
    to_check = missing(checked(watching.share, plan.n_samples), finished.checked)
    dealt = pieces(todo, to_check, group.count, model.largest_batch if group.comm.size == 1 else 1)
    taken_up = plan.n_samples - sum(last - first for first, last in todo)
    with timings.phase("integration"), progress(plan.n_samples, f"{model.title} samples", comm, taken_up) as bar:

        def work(number: int, pulse: Pulse) -> Batch:
            piece = dealt[number]
            watchers = watching.of(piece)
            return run_batch(model, plan.seed, piece.first, piece.last, watchers, group.comm, pulse)

        def take(number: int, batch: Batch) -> None:
            checkpoint.add(dealt[number], batch)
            bar.update(0 if dealt[number].is_checked else len(batch.status))

        with agreed(comm, "integration of the samples"):
            deal_to_groups(group, len(dealt), work, take)
    timings = timings.maximum(comm)
    with agreed(comm, "statistics"):
        return _described(model, plan, checkpoint, scene_toml, comm.size, timings) if comm.rank == 0 else None


def _described(
    model: Model, plan: Plan, checkpoint: Checkpoint, scene_toml: str, ranks: int, timings: Timings
) -> Ensemble:
    """Describe what the checkpoint holds, with what was found in it."""
    with timings.phase("statistics"):
        ensemble = describe_ensemble(model, plan, checkpoint, scene_toml, ranks, timings)
    remarks = (*checkpoint.remarks, *ensemble.record.remarks)
    return replace(ensemble, record=replace(ensemble.record, remarks=remarks))


def run_batch(
    model: Model,
    seed: int,
    first: int,
    last: int,
    watchers: Sequence[Watcher] = (),
    comm: MPI.Comm = MPI.COMM_SELF,
    pulse: Pulse | None = None,
) -> Batch:
    """Integrate samples first to last - 1 as one system, those that fail again with smaller steps.

    Several ranks share one sample. What the watchers find is added, NaN where nothing is known. `pulse` is called now
    and then. Collective on `comm`.
    """
    scene = model.scene
    values = draw(scene, seed, first, last)
    alive = physical(scene, values)
    n = last - first
    # an unphysical sample takes the place of a nominal one in the arrays, and is never advanced
    safe = {name: np.where(alive, value, scene.nominal[name]) for name, value in values.items()}
    outputs = {name: np.full(n, np.nan) for name in model.outputs.functions}
    unstable = np.zeros(n, dtype=bool)
    found: Found = {}

    def run(attempt: Attempt) -> Run:
        samples = attempt.samples
        some = {name: value[samples] for name, value in safe.items()}
        places = np.flatnonzero(alive[samples])
        if comm.size == 1:
            made = model.batch(some, samples.size)
        else:
            made = model.single({name: float(value[0]) for name, value in some.items()}, comm)
        with closing(made) as system:
            if system.settled is not None:
                unstable[samples] = system.settled.unstable & attempt.alive
            begun = Begun(system, some, places, attempt.simulation)
            watches = [watcher.watch(begun) for watcher in watchers if places.size]
            observer = Together([watch.observer for watch in watches]) if watches else None
            done = integrate(system, attempt.simulation, alive=attempt.alive, observer=observer, pulse=pulse)
            done = _with_outputs(model, system, done, samples, outputs, attempt.simulation.duration)
        for watch in watches:
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
        found = model.outputs.evaluate(model.observed(system, done.state)[..., fine])
    lost = fine[~np.all([np.isfinite(values) for values in found.values()] or [np.ones(fine.size)], axis=0)]
    status, failure_time = done.status.copy(), done.failure_time.copy()
    status[lost], failure_time[lost] = Status.NOT_FINITE, end
    for name, values in found.items():
        outputs[name][samples[fine]] = np.where(status[fine] == Status.FINE, values, np.nan)
    return replace(done, status=status, failure_time=failure_time)


class Watching:
    """What looks at the runs of a model's samples.

    Attributes
    ----------
    share
        Of the samples whose errors are estimated.
    """

    def __init__(self, model: Model) -> None:
        reduced = isinstance(model, ReducedModel)
        self.share = share_of(model) if reduced and model.scene.simulation.error_indicator else 0.0
        self._errors: list[Watcher] = [ErrorWatcher(ErrorIndicator(model))] if self.share > 0.0 else []
        self._others: list[Watcher] = [BalanceWatcher()] if model.scene.ensemble.balance else []
        if reduced:
            self._others.append(ValidityWatcher(model))

    def of(self, piece: Piece) -> list[Watcher]:
        """Return what looks at a piece."""
        return self._errors if piece.is_checked else self._others


def _remarks(model: Model, estimates: Mapping[str, Mapping[str, np.ndarray]], status: np.ndarray) -> tuple[Remark, ...]:
    """Return what is beyond the limits of small deformations in a reduced ensemble, and which errors are not known."""
    scene = model.scene
    if not isinstance(model, ReducedModel):
        return why_not_of_full_order(model)
    absent = (*absence_of_estimates(scene, ensemble=True), *truncated_stresses(scene))
    absent += left_out_of_estimates(model) if estimates["errors"] else ()
    remarks = [*absent, *remarks_of(scene, estimates["validity"])]
    if estimates["errors"]:
        chosen = np.zeros(status.size, dtype=bool)
        for first, last in checked(share_of(model), status.size):
            chosen[first:last] = status[first:last] == Status.FINE
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
    model: Model, plan: Plan, checkpoint: Checkpoint, scene_toml: str, ranks: int, timings: Timings
) -> Ensemble:
    """Put pieces together and describe parameters and outputs."""
    scene, columns = model.scene, checkpoint.columns()
    parameters, outputs, numerics = (columns.of(kind) for kind in ("parameters", "outputs", "numerics"))
    estimates = {kind: columns.of(kind) for kind in ("errors", "errors_at_end", "validity", "balance")}
    status = columns["status"].astype(np.int32)
    fine = status == Status.FINE
    bins, probabilities = scene.ensemble.bins, scene.ensemble.quantiles
    n_failed = int(np.sum(~fine))
    statistics = {name: describe(v[fine], bins, probabilities, n_failed) for name, v in outputs.items()}
    drawn = [name for name in parameters if scene.parameters[name].distribution is not None]
    for name in drawn:
        statistics[name] = describe(parameters[name][np.isfinite(parameters[name])], bins, probabilities)
    divisors = numerics["steps_divided"].astype(np.int32)
    units = {name: parameter.unit or "1" for name, parameter in scene.parameters.items()} | model.outputs.units
    remarks = (
        *failure_remarks(status, {name: parameters[name] for name in drawn} if n_failed else {}, units),
        *step_remarks(status, divisors, scene.simulation.step),
        *draw_remarks(scene),
        *starts_remarks(scene, numerics["unstable_start"] == 1.0),
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
        failure_time=columns["failure_time"],
        statistics=statistics,
        steps_divided=divisors,
        **estimates,
    )


def _single(n_fine: int) -> tuple[Remark, ...]:
    """Return what is to be said of statistics of one sample."""
    if n_fine != 1:
        return ()
    return (note("one sample has no deviation and no standard errors; draw more"),)
