"""How many samples every model of a joined ensemble has, for a budget: from measured costs and correlations.

A pilot of every model's first samples gives both. The numbers are those of the least variance that the budget pays for
(`joined.allocation`), for the output whose models agree least. Times decide, which will not come again: a run that is
taken up keeps the numbers of the one before. Pilot samples are the first ones of the ensemble, and so are used; that
they have a part in the choice of the numbers has none in the intervals but by the spread that they showed.

What an ensemble is asked for, and what one batch of it gives.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.dynamics.status import Status
from pgmp_petsc.ensemble import joined
from pgmp_petsc.runtime.agreement import on_root
from pgmp_petsc.runtime.errors import InputError, Remark, RunError

if TYPE_CHECKING:
    from pgmp_petsc.ensemble.runner import Integration
    from pgmp_petsc.ensemble.stopping import Stop


PILOT = 16  # samples of every better model
PILOT_OF_OWN = 256  # of the ensemble's own, which is as a rule faster in large batches
FOR_DEVIATIONS = 0.1  # of the budget, for samples enough for an interval of the deviation
OVERDRAWN = 1.5  # by the least numbers of samples, before a budget is refused
ROUNDS = (0.1, 0.4, 1.0)  # shares of what is chosen that are integrated before costs are taken anew


def allot(
    own: Integration, better: Sequence[Integration], given: Sequence[int | None], limit: int | None, stop: Stop
) -> tuple[list[int], int]:
    """Integrate as many samples of all models as the budget pays for. Collective.

    Parameters
    ----------
    given
        Numbers of the better models' samples that are not to be chosen, None for the others.
    limit
        Number of the ensemble's samples, None where it is to be chosen.

    Returns
    -------
    list of int, int
        Numbers of samples of the better models, and of the ensemble's own.

    Raises
    ------
    InputError
        If the budget does not pay for what is given.
    RunError
        If the outputs of the pilot's samples are not known, or do not vary.
    """
    comm, models = own.comm, (*better, own)
    kept = on_root(comm, lambda: own.checkpoint.counts)
    if kept is not None and len(kept) == len(models):
        return [int(n) for n in kept[:-1]], int(kept[-1])
    wanted = [*given, limit]
    # what a stopped run left tells nothing of times
    pilot = np.array([model.n_finished + (PILOT_OF_OWN if model is own else PILOT) for model in models])
    pilot = np.minimum(pilot, [model.plan.n_samples for model in models])
    done, costs = np.zeros(len(models), dtype=int), np.full(len(models), np.nan)

    def integrate(sizes: np.ndarray) -> None:
        for k, (model, n) in enumerate(zip(models, sizes)):
            start = time.monotonic()
            computed = model.up_to(int(n))
            if computed:
                costs[k] = (time.monotonic() - start) / computed
        done[:] = np.maximum(done, sizes)

    def choose(share: float) -> np.ndarray:
        known = np.where(np.isfinite(costs), costs, np.min(costs[np.isfinite(costs)], initial=1.0))
        correlations = _correlations([model.kept(int(n)) for model, n in zip(models, done)], int(done.min()))
        chosen = counts(known, correlations, wanted, stop.left + float(known @ done), own.plan.n_samples)
        if chosen is None:
            raise InputError(
                f"--budget {stop.budget:g}s does not pay for {PILOT} samples of each better model and what is given: "
                f"samples take {', '.join(f'{cost:.2g} s' for cost in known)}, those of the best model first"
            )
        chosen = np.maximum(done, np.where(share < 1.0, (share * chosen).astype(int), chosen))
        if share == 1.0:
            own.checkpoint.keep_counts(chosen)
        return chosen

    # the first samples of a process wait for compiled code: they tell nothing of the others
    integrate(np.maximum(pilot - PILOT // 2, 1))
    integrate(pilot)
    for share in ROUNDS:
        integrate(on_root(comm, choose, share))
    return [int(n) for n in done[:-1]], int(done[-1])


def counts(
    costs: np.ndarray, correlations: np.ndarray, given: Sequence[int | None], budget: float, most: int
) -> np.ndarray | None:
    """Return the numbers of samples of all models, the best first, that a budget pays for; None where there are none.

    Parameters
    ----------
    costs
        Of a sample, s, (k,).
    correlations
        With the best model, (k,).
    given
        Numbers that are not to be chosen, None for the others.
    budget
        For all samples, s.
    most
        Samples of the cheapest model.
    """
    shares = joined.allocation(costs, correlations)
    enough = joined.FEWEST_OF_DEVIATION
    least = np.where(enough * costs <= FOR_DEVIATIONS * budget, enough, PILOT)
    free = np.array([n is None for n in given])
    found = np.array([most if n is None else n for n in given])
    behind = np.minimum.accumulate(found[::-1])[::-1]  # no more than any cheaper model has
    while free.any():
        left = budget - float(costs @ np.where(free, 0, found))
        if left <= 0.0:
            return None
        wanted = left * shares / float(np.sum((costs * shares)[free]))
        few = free & (wanted < least)
        # what is raised to the least number is given, and what is left is divided anew
        chosen = few if few.any() else free
        found = np.where(chosen, np.maximum(wanted, least).astype(int), found)
        free = free & ~chosen
    found = np.minimum(np.maximum.accumulate(found), behind)
    return found if costs @ found <= OVERDRAWN * budget else None


def _correlations(kept: Sequence, n: int) -> np.ndarray:
    """Return the correlations of all models with the best, (k,), of the output for which the next one's is least."""
    columns = [one.columns() for one in kept]
    fine = np.all([one["status"][:n] == Status.FINE for one in columns], axis=0)
    found = []
    for name in columns[0].of("outputs"):
        values = np.array([one.of("outputs")[name][:n][fine] for one in columns])
        if values.shape[1] >= joined.FEWEST and np.all(np.ptp(values, axis=1) > 0.0):
            found.append(np.corrcoef(values)[0])
    if not found:
        raise RunError(
            f"--correct MODEL=auto: of the pilot's {n} samples {int(fine.sum())} are fine in all models, and no output "
            "varies in all of them; give numbers, such as --correct full=200"
        )
    return min(found, key=lambda one: abs(one[1]))


SAMPLERS = ("random", "latin_hypercube", "sobol", "saltelli")
MOST_SAMPLES = 10**9  # the pieces of a checkpoint are in order by nine digits
LARGEST_SEED = 2**63 - 1  # the largest whole number that every reader of the file knows


@dataclass(frozen=True)
class SampleFile:
    """Samples that a file gives: values (N,) by parameter, the identity of its content, and what is said of it."""

    path: Path
    values: dict[str, np.ndarray]
    identity: str
    remarks: tuple[Remark, ...] = ()


@dataclass(frozen=True)
class Shard:
    """One of `count` parts of an ensemble, numbered from 1, which are runs of their own."""

    number: int
    count: int

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"


@dataclass(frozen=True)
class Plan:
    """How many samples, from which seed or file, where the result goes, whether to take up a checkpoint, and which part
    of the samples is wanted where it is not all of them. `is_limited` is false where nobody asked for a number of
    samples, and `n_samples` is one that no run comes to."""

    n_samples: int
    seed: int
    output: Path = Path()
    resume: bool = False
    file: SampleFile | None = None
    shard: Shard | None = None
    is_limited: bool = True

    @property
    def samples(self) -> tuple[int, int]:
        """First of the samples that are wanted, and the one behind the last."""
        if self.shard is None:
            return 0, self.n_samples
        return tuple(self.n_samples * k // self.shard.count for k in (self.shard.number - 1, self.shard.number))


@dataclass(frozen=True)
class Batch:
    """Samples ``first`` to ``first + n - 1``: parameters, outputs at the end, status and time of failure, each (n,).

    ``numerics`` says how each was integrated: ``steps_divided`` is by what the scene's step was divided,
    ``unstable_start`` whether it began on an unstable static equilibrium. The reduced
    model adds the largest estimated errors of the outputs, those at the end, and the validity of small deformations,
    each (n,) and NaN where they were not estimated. ``balance`` is that of energy, where it was asked for, as are
    ``extremes`` of the outputs over time and ``first_passages`` of events; ``bands`` are outputs at some instants, each
    (n, n_t).
    """

    first: int
    parameters: dict[str, np.ndarray]
    outputs: dict[str, np.ndarray]
    status: np.ndarray
    failure_time: np.ndarray
    numerics: dict[str, np.ndarray] = field(default_factory=dict)
    errors: dict[str, np.ndarray] = field(default_factory=dict)
    errors_at_end: dict[str, np.ndarray] = field(default_factory=dict)
    validity: dict[str, np.ndarray] = field(default_factory=dict)
    balance: dict[str, np.ndarray] = field(default_factory=dict)
    extremes: dict[str, np.ndarray] = field(default_factory=dict)
    first_passages: dict[str, np.ndarray] = field(default_factory=dict)
    bands: dict[str, np.ndarray] = field(default_factory=dict)
