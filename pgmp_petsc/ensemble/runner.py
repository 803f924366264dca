"""Monte Carlo over ranks: an ensemble of one model, or of several on the same draws.

Nothing that was computed is lost when a run is killed; `resume` takes up the checkpoint, with another number of ranks
too, because a sample's numbers depend on seed and sample number alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from pgmp_petsc.base.resources import Timings
from pgmp_petsc.ensemble.description import Origin, describe_ensemble
from pgmp_petsc.ensemble.failures import Earlier
from pgmp_petsc.ensemble.integration import Integration
from pgmp_petsc.ensemble.plan import Plan
from pgmp_petsc.ensemble.stopping import Seen, Stop, see, stages, stopped
from pgmp_petsc.models import Model
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.ranks.groups import RankGroup
from pgmp_petsc.results.ensemble import Ensemble, ShardSamples

if TYPE_CHECKING:
    from pgmp_petsc.ensemble.correction import Better


def run_ensemble(
    model: Model,
    plan: Plan,
    group: RankGroup,
    stop: Stop | None = None,
    better: Sequence[Better] = (),
    earlier: Earlier | None = None,
) -> Ensemble | ShardSamples | None:
    """Integrate the samples that are missing; describe all, or keep those of a shard. Collective on ``group.world``.

    Groups of several ranks share one full-order sample at a time. Raises `InputError` if the checkpoint to resume
    belongs to another scene, model, seed or number of samples; `RunError` if the finished batches are not all samples,
    each once.

    Parameters
    ----------
    stop
        What ends the ensemble before the plan's last sample, if anything.
    better
        Better models, the best first, that integrate the first samples of the ensemble too.
    earlier
        The same ensemble, whose failed samples alone are integrated, further than in an ensemble.

    Returns
    -------
    Ensemble, or ShardSamples of a shard, or None
        On the first rank, None elsewhere.
    """
    timings, comm = Timings(), group.world
    own = Integration(model, plan, group, timings, "integration")
    if better:
        from pgmp_petsc.ensemble.correction import plan_of, with_better  # most ensembles are of one model
    others = [
        Integration(one.model, plan_of(plan, one), group, timings, f"integration of {one.key}", own.sampler)
        for one in better
    ]
    if earlier is not None:
        own.take_over(earlier)
    model = own.model
    history, given, n = [], [one.count for one in better], plan.samples[1]
    if None in given:
        from pgmp_petsc.ensemble.joined import allot  # as above

        given, n = allot(own, others, given, n if plan.is_limited else None, stop)
    elif stop is not None:
        history = look_at(own, stop)
        n = history[-1].n
    own.up_to(n)
    for one, count in zip(others, given):
        one.up_to(count)
    timings = timings.maximum(comm)
    with agreed(comm, "statistics"):
        if comm.rank > 0:
            return None
        if plan.shard is not None:
            from pgmp_petsc.ensemble.shards import shard_of

            return shard_of(Origin.of(model), plan, own.checkpoint, comm.size, timings)
        found = describe_ensemble(
            Origin.of(model), replace(plan, n_samples=n), own.sampler, own.kept(n), comm.size, timings,
            looked=bool(history) and bool(stop.rules),
        )  # fmt: skip
        if history:
            found = stopped(found, model.scene, plan, stop, history)
        if earlier is not None:
            remarks = (*found.record.remarks, earlier.remark)
            found = replace(found, record=replace(found.record, remarks=remarks))
        if better:
            parts = {one.name: part.kept(k).columns() for one, part, k in zip(better, others, given)}
            columns = {**parts, model.name: own.kept(n).columns()}
            found = with_better(found, model.scene, columns, own.sampler.replicates(n))
        return found


def look_at(own: Integration, stop: Stop) -> list[Seen]:
    """Integrate until the rules are met or the budget is spent; return what was seen. Collective."""

    def seen(n: int) -> Seen:
        def looking() -> Seen:
            return see(stop.rules, own.model.scene, own.sampler, own.kept(n), n)

        return on_root(own.comm, looking)

    return stages(stop, own.sampler.unit, own.plan.n_samples, own.up_to, seen, own.comm)
