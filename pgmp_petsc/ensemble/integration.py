"""The samples of one model, integrated over ranks into a checkpoint.

The samples are dealt out in pieces (`plan`): a rank integrates one as one system, a group of ranks one sample, and
rank 0 puts what came out into the checkpoint while the others go on.

An ensemble is of one model, or of several on the same draws. Nothing that was computed is lost when a run is killed;
`resume` takes up the checkpoint, with another number of ranks too, because a sample's numbers depend on seed and sample
number alone. What a second try takes over of an ensemble's file and repeats is in docs/uncertainty.md (failed samples).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.base.errors import InputError, Remark, note
from pgmp_petsc.base.progress import progress
from pgmp_petsc.base.resources import Timings
from pgmp_petsc.base.surroundings import Comm, alone
from pgmp_petsc.ensemble.checkpoint import Checkpoint, Finished
from pgmp_petsc.ensemble.description import FURTHER, Origin, describe_ensemble, shard_of
from pgmp_petsc.ensemble.plan import (
    IN_CHECKED,
    Batch,
    Piece,
    Plan,
    SampleFile,
    called,
    checked,
    missing,
    pieces,
    read_samples,
    within,
)
from pgmp_petsc.ensemble.sampling import Sampler, physical, unit_of_better
from pgmp_petsc.ensemble.stopping import Seen, Stop, see, stages, stopped, timed
from pgmp_petsc.ensemble.watchers import Begun, Found, RangeWatch, Watcher, Watching, watch_over_time
from pgmp_petsc.models import Model, Reduced, SeparateLengths, of_samples
from pgmp_petsc.ranks.agreement import agreed, on_root
from pgmp_petsc.ranks.groups import Pulse, RankGroup, deal_to_groups
from pgmp_petsc.reduction.rom import check_samples
from pgmp_petsc.results.ensemble import UNSTABLE, Ensemble, ShardSamples
from pgmp_petsc.results.numbers import Arrays
from pgmp_petsc.scene import Scene, scene_from_toml, scene_to_toml
from pgmp_petsc.scene.numerics import Ensemble as Settings
from pgmp_petsc.scene.units import to_own
from pgmp_petsc.stepping.generalised_alpha import (
    DIVISORS,
    Attempt,
    Run,
    Together,
    check_ts_options,
    integrate,
    integrate_with_smaller_steps,
)
from pgmp_petsc.stepping.second_order_system import SecondOrderSystem
from pgmp_petsc.stepping.status import Status

if TYPE_CHECKING:
    from pgmp_petsc.ensemble.joined import Better


class Integration:
    """The samples of one model, in a checkpoint; see `run_ensemble`. Collective on ``group.world``, as are all methods.

    Time goes to a `phase` of the timings. Samples come from the plan's sampler, unless they are another ensemble's.
    """

    def __init__(
        self, model: Model, plan: Plan, group: RankGroup, timings: Timings, phase: str, sampler: Sampler | None = None
    ) -> None:
        self.plan, self.comm = plan, group.world
        self._group, self._timings, self._phase = group, timings, phase
        # a scene with nothing to draw, and options that would change it, are refused before anything is touched
        with agreed(self.comm, "checking what the run is asked for"):
            self.sampler = sampler or Sampler(model.scene, plan)
            check_ts_options()
            self.model = model = of_samples(model, self.sampler.names)
        self._divisors = DIVISORS
        toml = scene_to_toml(model.scene)
        self.checkpoint = Checkpoint(plan, toml, model.name, model.identity, self.sampler.named, self.sampler.extends)
        self._finished = on_root(self.comm, self.checkpoint.open)
        with agreed(self.comm, "preparing the error indicator"):
            self._watching = Watching(model)

    def up_to(self, n: int) -> int:
        """Integrate what is missing of the plan's samples before sample n; return how many these were. Raises
        `RunError` if the system fails to write."""
        model, group, comm, first = self.model, self._group, self.comm, self.plan.samples[0]
        todo = missing([(first, n)], self._finished.samples)
        whole = n if self.plan.shard is None else self.plan.n_samples  # of which a shard has a part
        to_check = within(checked(self._watching.share, whole, self._watching.block), first, n)
        to_check = missing(to_check, self._finished.checked)
        dealt = pieces(todo, to_check, group.count, model.largest_batch if group.comm.size == 1 else 1)
        n_samples, n_todo = n - first, sum(end - begin for begin, end in todo)
        title = f"{model.title} samples"
        with self._timings.phase(self._phase), progress(n_samples, title, comm, n_samples - n_todo) as bar:

            def work(number: int, pulse: Pulse) -> Batch:
                piece = dealt[number]
                watchers, values = self._watching.of(piece), self.sampler.draw(piece.first, piece.last)
                counted = sum(part.last - part.first for part in piece.parts if not part.is_checked)

                def beat(share: float) -> None:
                    bar.within(share * counted * group.count)  # others are about as far with theirs
                    pulse()

                return run_batch(model, values, piece.first, watchers, group.comm, beat, self._divisors)

            def take(number: int, batch: Batch) -> None:
                bar.within(0.0)
                for part in dealt[number].parts:
                    self.checkpoint.add(part, batch)
                    bar.update(0 if part.is_checked else len(batch.status))

            with agreed(comm, "integration of the samples"):
                deal_to_groups(group, len(dealt), work, take)
        self._finished = Finished(
            tuple(sorted((*self._finished.samples, *todo))), tuple(sorted((*self._finished.checked, *to_check)))
        )
        return n_todo

    def take_over(self, earlier: Earlier) -> None:
        """Take the samples of an ensemble's file that are fine for finished, and try the others further."""

        def taking() -> Finished:
            known, added = (self._finished.samples, self._finished.checked), ([], [])
            for piece, batch in fine_pieces(earlier, self._watching.share, self._watching.block):
                ends, there = (piece.first, piece.last), known[piece.is_checked]
                near = there[max(bisect_left(there, ends) - 1, 0) : bisect_left(there, (piece.last,))]
                if missing([ends], near):
                    self.checkpoint.add(piece, batch)
                    added[piece.is_checked].append(ends)
            return Finished(*(tuple(sorted((*before, *now))) for before, now in zip(known, added)))

        self._divisors = FURTHER
        self._finished = on_root(self.comm, taking)

    @property
    def n_finished(self) -> int:
        return sum(last - first for first, last in self._finished.samples)


def run_batch(
    model: Model,
    values: Arrays,
    first: int = 0,
    watchers: Sequence[Watcher] = (),
    comm: Comm | None = None,
    pulse: Callable[[float], object] | None = None,
    divisors: tuple[int, ...] = DIVISORS,
) -> Batch:
    """Integrate samples first, first + 1, ... as one system, those that fail again with smaller steps.

    Values of all parameters have shape (n,). Several ranks share one sample. What the watchers find is added, NaN where
    nothing is known. `pulse` is called now and then with the share of the steps that are done, `divisors` are those of
    the steps that are tried. Collective on `comm`.
    """
    scene, comm = model.scene, comm or alone()
    if model.outputs.counts and not any("extremes" in watcher.names for watcher in watchers):
        watchers = [*watchers, watch_over_time(model, False, Settings())]
    alive = physical(scene, values)
    if isinstance(model, SeparateLengths):
        alive = model.closes(values, alive)
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
            observers, inside = [watch.observer for watch in watches], None
            if not isinstance(model, Reduced) and model.limited:
                inside = RangeWatch(model, system)
                observers.append(inside)
            observer = Together(observers) if observers else None
            done = integrate(system, attempt.simulation, alive=attempt.alive, observer=observer, pulse=pulse)
            done = done if inside is None else inside.judged(done)
            counted = {name: values for watch in watches for name, values in watch.counted().items()}
            done = _with_outputs(model, system, done, attempt, outputs, counted)
            for watch in watches:
                for kind, arrays in watch.found(done.status).items():
                    for name, estimates in arrays.items():
                        found[kind][name][samples[places]] = estimates
        return done

    outcome = integrate_with_smaller_steps(run, scene.simulation, alive, divisors)
    numerics = {"steps_divided": outcome.divisors, "unstable_start": unstable}
    return Batch(first, dict(values), outputs, outcome.status, outcome.failure_time, numerics, **found)


def _with_outputs(
    model: Model,
    system: SecondOrderSystem,
    done: Run,
    attempt: Attempt,
    outputs: dict[str, np.ndarray],
    counted: Arrays,
) -> Run:
    """Evaluate the outputs of the samples that are fine into `outputs`, but for those that were counted over the run;
    one that is no finite number is a failure."""
    fine = np.flatnonzero(done.status == Status.FINE)
    if not fine.size:
        return done
    with np.errstate(all="ignore"):
        found = model.outputs.evaluate(model.observed(system, done.state, attempt.simulation.duration)[..., fine])
    found |= {name: values[fine] for name, values in counted.items()}
    lost = fine[~np.all([np.isfinite(values) for values in found.values()] or [np.ones(fine.size)], axis=0)]
    status, failure_time = done.status.copy(), done.failure_time.copy()
    status[lost], failure_time[lost] = Status.NOT_FINITE, attempt.simulation.duration
    for name, values in found.items():
        outputs[name][attempt.samples[fine]] = np.where(status[fine] == Status.FINE, values, np.nan)
    return replace(done, status=status, failure_time=failure_time)


def run_ensemble(
    model: Model,
    plan: Plan,
    group: RankGroup,
    stop: Stop | None = None,
    better: Sequence[Better] = (),
    earlier: Earlier | None = None,
) -> Ensemble | ShardSamples | None:
    """Integrate the samples that are missing; describe all, or keep those of a shard. Collective on ``group.world``.

    Groups of several ranks share one full-order sample at a time. `stop` may end the ensemble before the plan's last
    sample; `better` models, the best first, integrate its first samples too; of an `earlier` ensemble the failed
    samples alone are integrated, further than in an ensemble. The first rank gets the result, others None.

    Raises `InputError` if the checkpoint to resume belongs to another scene, model, seed or number of samples;
    `RunError` if the finished batches are not all samples, each once.
    """
    timings, comm = Timings(), group.world
    own = Integration(model, plan, group, timings, "integration")
    if better:
        from pgmp_petsc.ensemble.joined import plan_of, with_better  # most ensembles are of one model
    others = [
        Integration(one.model, plan_of(plan, one), group, timings, f"integration of {one.key}", own.sampler)
        for one in better
    ]
    if earlier is not None:
        own.take_over(earlier)
    model = own.model
    history, given, n = [], [one.count for one in better], plan.samples[1]
    if None in given:
        given, n = allot(own, others, given, n if plan.is_limited else None, stop)
    elif stop is not None:

        def seen(n: int) -> Seen:
            return on_root(comm, see, stop.rules, model.scene, own.sampler, own.checkpoint.up_to(n), n)

        history = stages(stop, own.sampler.unit, plan.n_samples, own.up_to, seen, comm)
        n = history[-1].n
    own.up_to(n)
    for one, count in zip(others, given):
        one.up_to(count)
    timings = timings.maximum(comm)
    with agreed(comm, "statistics"):
        if comm.rank > 0:
            return None
        if plan.shard is not None:
            return shard_of(Origin.of(model), plan, own.checkpoint, comm.size, timings)
        found = describe_ensemble(
            Origin.of(model), replace(plan, n_samples=n), own.sampler, own.checkpoint.up_to(n), comm.size, timings,
            looked=bool(history) and bool(stop.rules),
        )  # fmt: skip
        if history:
            found = stopped(found, model.scene, plan, stop, history)
        if earlier is not None:
            found = replace(found, record=replace(found.record, remarks=(*found.record.remarks, earlier.remark)))
        if better:
            parts = {one.name: part.checkpoint.up_to(k).columns() for one, part, k in zip(better, others, given)}
            columns = {**parts, model.name: own.checkpoint.up_to(n).columns()}
            found = with_better(found, model.scene, columns, own.sampler.replicates(n))
        return found


def allot(
    own: Integration, better: Sequence[Integration], given: Sequence[int | None], limit: int | None, stop: Stop
) -> tuple[list[int], int]:
    """Integrate as many samples of all models as the budget pays for; return the numbers of samples of the better
    models, and of the ensemble's own. Collective.

    Numbers of better models that are `given` are not chosen, nor the `limit` of the ensemble's own; None are. Raises
    `InputError` if the budget does not pay for what is given; `RunError` if the outputs of the pilot's samples are not
    known, or do not vary.
    """
    from pgmp_petsc.ensemble.joined import PILOT, PILOT_OF_OWN, ROUNDS, correlations_of, counts  # as in `run_ensemble`

    comm, models = own.comm, (*better, own)
    kept = on_root(comm, lambda: own.checkpoint.counts)
    if kept is not None and len(kept) == len(models):
        return [int(n) for n in kept[:-1]], int(kept[-1])
    wanted, units = [*given, limit], np.array([unit_of_better(own.sampler.unit)] * len(better) + [own.sampler.unit])
    # what a stopped run left tells nothing of times
    pilot = np.array([model.n_finished + (PILOT_OF_OWN if model is own else PILOT) for model in models])
    pilot = np.minimum(-(-pilot // units) * units, [model.plan.n_samples for model in models])
    done, costs = np.zeros(len(models), dtype=int), np.full(len(models), np.nan)

    def integrate(sizes: np.ndarray) -> None:
        for k, (model, n) in enumerate(zip(models, sizes)):
            costs[k] = timed(model.up_to, int(n)) or costs[k]
        done[:] = np.maximum(done, sizes)

    def choose(share: float) -> np.ndarray:
        known = np.where(np.isfinite(costs), costs, np.min(costs[np.isfinite(costs)], initial=1.0))
        kept = [model.checkpoint.up_to(int(n)) for model, n in zip(models, done)]
        correlations = correlations_of(kept, int(done.min()))
        chosen = counts(known, correlations, wanted, stop.left + float(known @ done), own.plan.n_samples)
        if chosen is None:
            raise InputError(
                f"--budget {stop.budget:g}s does not pay for {PILOT} samples of each better model and what is given: "
                f"samples take {', '.join(f'{cost:.2g} s' for cost in known)}, those of the best model first"
            )
        free = [n is None or share < 1.0 for n in wanted]
        chosen = np.maximum(done, np.where(free, (share * chosen).astype(int) // units * units, chosen))
        if share == 1.0:
            own.checkpoint.keep_counts(chosen)
        return chosen

    # the first samples of a process wait for compiled code: they tell nothing of the others
    integrate(np.maximum(pilot - PILOT // 2, 1))
    integrate(pilot)
    for share in ROUNDS:
        integrate(on_root(comm, choose, share))
    return [int(n) for n in done[:-1]], int(done[-1])


OPTION = "--retry-failed"
FREE = {"ensemble": {"batch", "failed_share"}, "scene": {"name", "description"}}  # entries that no sample depends on
SAME_DRAW = 1e-9  # of a value: machines differ in the last digits of distributions, other designs in the first


@dataclass(frozen=True)
class Earlier:
    """An ensemble whose failed samples are tried again."""

    path: Path  # its file
    n_samples: int
    n_failed: int
    seed: int  # where its samples are from, or the file
    file: SampleFile | None

    @property
    def remark(self) -> Remark:
        return note(
            f"{self.n_failed} samples that had failed in '{self.path}' were tried again with steps down to "
            f"1/{FURTHER[-1]} of simulation.step; the others are those of that file"
        )


def samples_for(model: Model, given: Path | Arrays, n: int | None) -> SampleFile:
    """Return the first n samples of a file, or of columns, or all, with what is said of those that the model was not
    built for; see `read_samples`."""
    file = read_samples(given, model.scene, n)
    return replace(file, remarks=(*file.remarks, *check_samples(model.served, file.values, called(given))))


def read_earlier(path: Path, model: Model) -> Earlier:
    """Return what a file says, without its samples. By one process. Raises `InputError` if it is no ensemble of this
    scene and model, or nothing in it can be tried again."""
    found = Ensemble.read(path).in_si_units()
    n_failed = int(np.sum(found.status != Status.FINE))
    if not n_failed:
        raise InputError(f"{OPTION} {path}: all of its {len(found.status)} samples are fine; nothing is left to do")
    for what, present in (("--correct", found.joined), ("--until or --budget", found.stopping)):
        if present is not None:
            raise InputError(
                f"{OPTION} {path}: an ensemble with {what}, whose figures are of more than its own samples; repeat it "
                "with a smaller simulation.step"
            )
    if found.model != model.name:
        raise InputError(f"{OPTION} {path}: samples of the {found.model} model; here it is the {model.name} one")
    if UNSTABLE not in found.kept or found.errors.keys() != found.errors_unsure.keys():
        raise InputError(f"{OPTION} {path}: written by another version, which kept less of its samples; run it again")
    _check_scene(path, scene_from_toml(found.record.scene_toml, path.parent), model.scene)
    n, seed = len(found.status), found.record.seed
    file = None if seed is not None else samples_for(model, path, None)
    if file is None:
        _check_draws(path, found, model.scene, Sampler(model.scene, Plan(n, seed)))
    return Earlier(path, n, n_failed, seed or 0, file)


def _check_scene(path: Path, there: Scene, here: Scene) -> None:
    """Refuse another scene: its fine samples would be others."""
    one, two = there.model_dump(), here.model_dump()
    for table in one:
        a, b = one[table], two[table]
        if isinstance(a, dict) and isinstance(b, dict):
            free = FREE.get(table, set())
            differing = [key for key in {**a, **b} if key not in free and a.get(key) != b.get(key)]
            if differing:
                raise InputError(
                    f"{OPTION} {path}: {table}.{differing[0]} is not that of the file, and the samples that are fine "
                    f"would be others; leave it as it was. Smaller steps, down to 1/{FURTHER[-1]}, are tried anyway"
                )
        elif a != b:
            raise InputError(f"{OPTION} {path}: [{table}] is not that of the file; leave it as it was")


def _check_draws(path: Path, found: Ensemble, scene: Scene, sampler: Sampler) -> None:
    """Refuse samples that are not those of the sampler: failed ones would be drawn anew among fine ones of another
    design, as another version of the program had it."""
    drawn = sampler.draw(0, len(found.status))
    for name in sampler.names:
        there, here = found.parameters[name], drawn[name]
        differing = np.flatnonzero(~np.isclose(there, here, rtol=SAME_DRAW, atol=0.0, equal_nan=True))
        if differing.size:
            k, own = differing[0], to_own(scene, name)
            raise InputError(
                f"{OPTION} {path}: sample {k} has {name} = {own * there[k]:.9g} there and {own * here[k]:.9g} here: it "
                f"is of another version, whose sampler {sampler.kind} drew other samples; run the ensemble again"
            )


def fine_pieces(earlier: Earlier, share: float, block: int) -> Iterator[tuple[Piece, Batch]]:
    """Yield neighbouring samples that are fine, and those of them whose errors were estimated: a share, in blocks."""
    found = Ensemble.read(earlier.path).in_si_units()
    ends = found.status, found.failure_time
    samples = Batch(
        0, found.parameters, found.outputs, *ends, validity=found.validity, balance=found.balance,
        numerics={"steps_divided": found.steps_divided, "unstable_start": found.kept[UNSTABLE]},
        extremes=found.extremes, first_passages=found.first_passages,
        bands={name.partition(".")[2]: values for name, values in found.kept.items() if name != UNSTABLE},
    )  # fmt: skip
    estimates = Batch(0, found.parameters, {}, *ends, **{kind: getattr(found, kind) for kind in IN_CHECKED})
    fine = found.status == Status.FINE
    for first, last in _runs(fine, 0, fine.size):
        yield Piece(first, last), samples.part(first, last)
    for begin, end in checked(share, fine.size, block):
        for first, last in _runs(fine, begin, end):
            yield Piece(first, last, True), estimates.part(first, last)


def _runs(fine: np.ndarray, begin: int, end: int) -> Iterator[tuple[int, int]]:
    """Yield the ranges of neighbours that are fine."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], fine[begin:end].astype(int), [0]])))
    yield from ((begin + int(first), begin + int(last)) for first, last in zip(edges[::2], edges[1::2]))
