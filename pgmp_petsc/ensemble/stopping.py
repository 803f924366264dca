"""When an ensemble has samples enough: rules looked at on a fixed schedule (`looks`), and a budget of time.

Rules decide on the figures of all samples so far, at numbers of samples that nothing measured has a part in: the same
stop on any ranks and after a resume. A budget depends on the machine. It decides on how many samples the last stage
has, from the time that those of the one before took; the value of no sample decides with it, so that intervals hold.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.ensemble.allotment import Plan
from pgmp_petsc.ensemble.description import Kept
from pgmp_petsc.ensemble.looks import level_of_each, looks
from pgmp_petsc.ensemble.quantities import came_true, quantity
from pgmp_petsc.ensemble.rules import MOMENTS, Rule
from pgmp_petsc.ensemble.sampling import Sampler
from pgmp_petsc.ensemble.statistics import describe, of_event
from pgmp_petsc.results.ensemble import Ensemble
from pgmp_petsc.results.stopping import Stopping, reach_of
from pgmp_petsc.runtime.errors import Remark, note, warning
from pgmp_petsc.scene import Scene

if TYPE_CHECKING:
    from mpi4py import MPI

RESERVE = 0.95  # of a budget, for the samples
PROBE = 8  # samples that tell what one takes
MOST = 10**9


@dataclass(frozen=True)
class Stop:
    """What ends an ensemble before its last sample: rules that are met, or a budget of wall time (s) that is spent.

    `start` is the instant (`time.monotonic`) from which the budget counts.
    """

    rules: tuple[Rule, ...] = ()
    budget: float | None = None
    start: float = field(default_factory=time.monotonic)

    @property
    def left(self) -> float:
        """What is left of the budget, s."""
        return np.inf if self.budget is None else RESERVE * self.budget - (time.monotonic() - self.start)


@dataclass(frozen=True)
class Seen:
    """Figures of the rules after n samples: estimates (n_rules,) and intervals (n_rules, 2)."""

    n: int
    estimates: np.ndarray
    intervals: np.ndarray


def see(rules: tuple[Rule, ...], scene: Scene, sampler: Sampler, kept: Kept, n: int) -> Seen:
    """Return the figures of the rules."""
    if not rules:
        return Seen(n, np.zeros(0), np.zeros((0, 2)))
    level, columns = level_of_each(scene.ensemble.confidence), kept.columns()
    outputs, extremes, passages = (columns.of(kind) for kind in ("outputs", "extremes", "first_passages"))
    fine, described, replicates = columns["status"] == Status.FINE, sampler.described(n), sampler.replicates(n)
    chosen = fine & described
    estimates, ends = [], []
    for rule in rules:
        if rule.kind in MOMENTS:
            values = quantity(rule.quantity, outputs, extremes)
            known = chosen & np.isfinite(values)
            found = describe(values[known], 1, (), 0, level, None if replicates is None else replicates[known])
            estimates.append(getattr(found, rule.kind))
            ends.append(getattr(found, f"{rule.kind}_interval"))
            continue
        event = rule.event or scene.ensemble.probabilities[rule.quantity]
        true = came_true(event, rule.quantity, outputs, passages)
        count, n_fine, of_both = of_event(true, chosen, described & ~fine, replicates, level)
        estimates.append(count / n_fine if n_fine else np.nan)
        ends.append(of_both)
    return Seen(n, np.array(estimates), np.array(ends))


def are_met(rules: tuple[Rule, ...], seen: Seen) -> np.ndarray:
    """Return which rules the figures meet, (n_rules,)."""
    wanted, relative = np.array([rule.wanted for rule in rules]), np.array([rule.relative for rule in rules], bool)
    return reach_of(seen.estimates, seen.intervals, relative) <= wanted


@dataclass
class Clock:
    """Says how many samples a budget still pays for, by what the last ones took; rank 0 decides for all.

    Attributes
    ----------
    seconds
        Of a sample; None where that is not known.
    """

    stop: Stop
    comm: MPI.Comm
    seconds: float | None = None

    def affordable(self, unit: int) -> int:
        """Return how many more samples are within the budget, a multiple of `unit`. Collective."""
        n = None
        if self.comm.rank == 0:
            left = self.stop.left
            if left < (1.0 - RESERVE) * self.stop.budget:
                n = 0
            elif self.seconds is None:
                n = -(-PROBE // unit) * unit
            else:
                n = int(min(left / self.seconds, MOST)) // unit * unit
        return self.comm.bcast(n)

    def measure(self, run: Callable[[int], int], n: int) -> None:
        """Integrate up to sample n, and take the time; what was taken up from a checkpoint tells nothing."""
        start = time.monotonic()
        computed = run(n)
        if computed:
            self.seconds = max((time.monotonic() - start) / computed, 1e-9)


def stages(
    stop: Stop, unit: int, most: int, run: Callable[[int], int], seen: Callable[[int], Seen], comm: MPI.Comm
) -> list[Seen]:
    """Integrate stage by stage until the rules are met, the budget is spent, or there is no further sample.

    Collective on `comm`.

    Parameters
    ----------
    unit, most
        As of `looks`.
    run
        Integrates all samples up to a number; returns how many there were to do.
    seen
        Looks at these; on every rank the same.
    """
    found: list[Seen] = []
    clock, done = Clock(stop, comm), 0
    for n in looks(unit, most):
        while done < n:
            target = n
            if stop.budget is not None:
                more = clock.affordable(unit)
                if not more and done:
                    break
                target = min(n, done + max(more, unit))
            clock.measure(run, target)
            done = target
        found.append(seen(done))
        if done < n or stop.rules and np.all(are_met(stop.rules, found[-1])):
            break
    return found


def stopped(ensemble: Ensemble, scene: Scene, plan: Plan, stop: Stop, history: list[Seen]) -> Ensemble:
    """Return an ensemble with why it ended, and what is to be said of that."""
    found, record = stopping_of(stop, history, plan, ensemble.units), ensemble.record
    remarks = (*record.remarks, *stopping_remarks(found, scene.ensemble.confidence))
    return replace(ensemble, stopping=found, record=replace(record, remarks=remarks))


def stopping_of(stop: Stop, history: list[Seen], plan: Plan, units: dict[str, str]) -> Stopping:
    """Return what is kept of the looks; `units` are those of the quantities."""
    last = history[-1]
    met = are_met(stop.rules, last)
    if stop.rules and np.all(met):
        why = "the rules are met" if len(stop.rules) > 1 else "the rule is met"
    elif last.n >= plan.n_samples:
        why = f"these are all samples (-n {plan.n_samples})"
    else:
        why = f"the budget of {stop.budget:g} s is spent"
    return Stopping(
        why,
        stop.budget,
        tuple(rule.text for rule in stop.rules),
        tuple(units.get(rule.quantity, "1") if rule.kind in MOMENTS else "1" for rule in stop.rules),
        np.array([rule.wanted for rule in stop.rules]),
        np.array([rule.relative for rule in stop.rules], dtype=bool),
        met,
        np.array([seen.n for seen in history]),
        np.array([seen.estimates for seen in history]).T.reshape(len(stop.rules), len(history)),
        np.array([seen.intervals for seen in history]).transpose(1, 0, 2),
    )


def stopping_remarks(stopping: Stopping, confidence: float) -> tuple[Remark, ...]:
    """Return what is to be said of intervals after looks, of rules that are not met, and of times that decided."""
    remarks = []
    for text, met, reached, relative in zip(stopping.rules, stopping.met, stopping.reached[:, -1], stopping.relative):
        if not met:
            shown = f"+- {100 * reached:.3g} % was reached" if relative else f"+- {reached:.3g} was reached"
            shown = shown if np.isfinite(reached) else "its figure is not known yet from so few samples"
            remarks.append(
                warning(
                    f'--until "{text}" is not met: {stopping.why}, and {shown}; --resume with '
                    "a larger -n or --budget goes on"
                )
            )
    if stopping.rules:
        times = "once" if len(stopping.samples) == 1 else f"{len(stopping.samples)} times"
        remarks.append(
            note(
                f"samples were looked at {times}; each interval is taken at the level "
                f"{100 * level_of_each(confidence):.2f} %, so that at the stop it holds with {100 * confidence:g} % "
                "although one looked (whichever of two neighbouring looks it is, docs/uncertainty.md)"
            )
        )
    if stopping.budget is not None:
        remarks.append(
            note(
                f"--budget {stopping.budget:g}s: the number of samples follows from measured times, and another run "
                "may have another; the samples themselves are the same. Where slow samples are others than quick ones, "
                "no bias comes of it: samples are taken in their order"
            )
        )
    return tuple(remarks)
