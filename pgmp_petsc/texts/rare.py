"""What is said of the probability of a rare event."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pgmp_petsc.results.numbers import share_text
from pgmp_petsc.texts.estimates import closing

if TYPE_CHECKING:
    from pgmp_petsc.results.rare_event import RareEvent
    from pgmp_petsc.runtime.errors import Remark

SHOWN = 12  # parameters of a design point


def report(result: RareEvent, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return the probability of a rare event, how it was found, and all remarks but those that were said before."""
    lines = [f"{path}: {result.model} model, {len(result.value)} samples", *lines_of(result)]
    return "\n".join([*lines, *closing(result.record, said)])


def lines_of(result: RareEvent) -> list[str]:
    """Return the levels and the probability of a rare event."""
    unit = "" if result.unit == "1" else f" {result.unit}"
    found = [*_levels(result, unit), *_probability(result), *_most_likely(result)]
    return [f"  rare event              {result.event}", *found]


def _levels(result: RareEvent, unit: str) -> Iterator[str]:
    if len(result.threshold):
        yield f"  {'level':>7s}{'of ' + result.output + unit:>32s}{'share':>10s}{'so far':>12s}{'accepted':>10s}"
    reached = np.cumprod(result.share)
    for k, (threshold, share, accepted) in enumerate(zip(result.threshold, result.share, result.accepted), 1):
        yield f"  {k:7d}{threshold:32.6g}{share:10.3f}{reached[k - 1]:12.3g}{accepted:10.2f}"


def _probability(result: RareEvent) -> Iterator[str]:
    if not result.reached:
        bound = result.interval[1]
        most = f"at most {bound:.3g} ({100 * result.confidence:g} %)" if np.isfinite(bound) else "unknown"
        yield f"  probability             {most}: not reached"
        return
    low, high = result.interval
    n_weighted = int(np.count_nonzero(result.weight))
    yield (
        f"  probability             {result.estimate:.4g} [{low:.4g}, {high:.4g}], a {100 * result.confidence:g} % "
        f"interval; coefficient of variation {share_text(result.variation)}"
    )
    plain = (1.0 / result.estimate - 1.0) / result.variation**2 if result.variation > 0.0 else np.inf
    yield (
        f"  {n_weighted} weighted samples, worth {result.n_effective:.0f} equally weighted ones in the event; as many "
        f"random samples as are as good: {plain:.2g}"
    )


def _most_likely(result: RareEvent) -> Iterator[str]:
    """Yield beta of every design point, and of the first one the values and shares of parameters, the largest first."""
    found = result.most_likely
    if found is None:
        yield "  design point            none: no search for it ended (no derivatives, or too few samples left)"
        return
    how = "exact derivatives" if found.is_exact else "differences"
    for beta, chance in zip(found.beta, found.probability):
        yield f"  design point            beta {beta:.4g}, first-order probability {chance:.4g} ({how})"
    yield f"  {'most likely at':24s}{'value':>14s}{'share':>10s}"
    order = np.argsort(-found.shares[0])
    for k in order[:SHOWN]:
        name = result.names[k]
        yield f"    {name:22s}{found.parameters[name][0]:14.6g}{100 * found.shares[0, k]:8.1f} %"
    if len(order) > SHOWN:
        yield f"    {len(order) - SHOWN} others{100 * found.shares[0, order[SHOWN:]].sum():31.1f} %"
