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
from pgmp_petsc.dynamics.smaller_steps import Attempt, integrate_with_smaller_steps
from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.dynamics.ts_options import check_ts_options
from pgmp_petsc.ensemble.batch import Batch, Plan
from pgmp_petsc.ensemble.checkpoint import Checkpoint
from pgmp_petsc.ensemble.checked_samples import checked, share_of
from pgmp_petsc.ensemble.description import describe_ensemble
from pgmp_petsc.ensemble.origin import Origin
from pgmp_petsc.ensemble.over_time import OverTimeWatcher
from pgmp_petsc.ensemble.pieces import Piece, missing, pieces, within
from pgmp_petsc.ensemble.sampling import Sampler, physical
from pgmp_petsc.ensemble.shards import shard_of
from pgmp_petsc.ensemble.watchers import BalanceWatcher, Begun, ErrorWatcher, Found, ValidityWatcher, Watcher
from pgmp_petsc.indicator.error_indicator import ErrorIndicator
from pgmp_petsc.models import Model, ReducedModel
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.results.shard import ShardSamples
from pgmp_petsc.runtime.agreement import agreed, on_root
from pgmp_petsc.runtime.dealing import Pulse, deal_to_groups
from pgmp_petsc.runtime.groups import RankGroup
from pgmp_petsc.runtime.progress import progress
from pgmp_petsc.runtime.timings import Timings
from pgmp_petsc.scene import scene_to_toml


def run_ensemble(model: Model, plan: Plan, group: RankGroup) -> Ensemble | ShardSamples | None:
    """Integrate the samples that are missing; describe all, or keep those of a shard. Collective on ``group.world``.

    Groups of several ranks share one full-order sample at a time.

    Returns
    -------
    Ensemble, or ShardSamples of a shard, or None
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
        sampler = Sampler(model.scene, plan)
        check_ts_options()
    checkpoint = Checkpoint(plan, scene_toml, model.name, model.identity, sampler.extends)
    finished = on_root(comm, checkpoint.open)
    with agreed(comm, "preparing the error indicator"):
        watching = Watching(model)
    first, last = plan.samples
    todo = missing([(first, last)], finished.samples)
    to_check = missing(within(checked(watching.share, plan.n_samples), first, last), finished.checked)
    dealt = pieces(todo, to_check, group.count, model.largest_batch if group.comm.size == 1 else 1)
    n_samples = last - first
    taken_up = n_samples - sum(end - begin for begin, end in todo)
    with timings.phase("integration"), progress(n_samples, f"{model.title} samples", comm, taken_up) as bar:

        def work(number: int, pulse: Pulse) -> Batch:
            piece = dealt[number]
            watchers = watching.of(piece)
            return run_batch(model, sampler.draw(piece.first, piece.last), piece.first, watchers, group.comm, pulse)

        def take(number: int, batch: Batch) -> None:
            checkpoint.add(dealt[number], batch)
            bar.update(0 if dealt[number].is_checked else len(batch.status))

        with agreed(comm, "integration of the samples"):
            deal_to_groups(group, len(dealt), work, take)
    timings = timings.maximum(comm)
    with agreed(comm, "statistics"):
        if comm.rank > 0:
            return None
        if plan.shard is not None:
            return shard_of(Origin.of(model), plan, checkpoint, comm.size, timings)
        return describe_ensemble(Origin.of(model), plan, sampler, checkpoint, comm.size, timings)


def run_batch(
    model: Model,
    values: Mapping[str, np.ndarray],
    first: int = 0,
    watchers: Sequence[Watcher] = (),
    comm: MPI.Comm = MPI.COMM_SELF,
    pulse: Pulse | None = None,
) -> Batch:
    """Integrate samples first, first + 1, ... as one system, those that fail again with smaller steps.

    Values of all parameters have shape (n,). Several ranks share one sample. What the watchers find is added, NaN where
    nothing is known. `pulse` is called now and then. Collective on `comm`.
    """
    scene = model.scene
    alive = physical(scene, values)
    n = alive.size
    # an unphysical sample takes the place of a nominal one in the arrays, and is never advanced
    safe = {name: np.where(alive, value, scene.nominal[name]) for name, value in values.items()}
    outputs = {name: np.full(n, np.nan) for name in model.outputs.functions}
    unstable = np.zeros(n, dtype=bool)
    found: Found = {kind: arrays for watcher in watchers for kind, arrays in watcher.empty(n).items()}

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
                    found[kind][name][samples[places]] = estimates
        return done

    outcome = integrate_with_smaller_steps(run, scene.simulation, alive)
    numerics = {"steps_divided": outcome.divisors, "unstable_start": unstable}
    return Batch(first, dict(values), outputs, outcome.status, outcome.failure_time, numerics, **found)


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
        self.share = share_of(model)
        self._errors: list[Watcher] = [ErrorWatcher(ErrorIndicator(model))] if self.share > 0.0 else []
        self._others: list[Watcher] = [BalanceWatcher()] if model.scene.ensemble.balance else []
        if reduced:
            self._others.append(ValidityWatcher(model))
        self._n_bands = model.scene.ensemble.band_samples
        self._over_time = {with_bands: OverTimeWatcher(model, with_bands) for with_bands in (True, False)}

    def of(self, piece: Piece) -> list[Watcher]:
        """Return what looks at a piece; at outputs over time of the first samples more than of the others."""
        if piece.is_checked:
            return self._errors
        over_time = self._over_time[piece.first < self._n_bands]
        return [*self._others, over_time] if over_time.is_asked else self._others
