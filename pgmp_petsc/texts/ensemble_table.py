"""Texts on ensembles, on parts of them and on rare events: figures and probabilities with their intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from pgmp_petsc.base.errors import Remark, counted
from pgmp_petsc.base.units import behind
from pgmp_petsc.results import Ensemble, RareEvent
from pgmp_petsc.results.ensemble import ShardSamples
from pgmp_petsc.results.numbers import axis_unit, interval_text, number_text, percent, plain, share_text
from pgmp_petsc.texts.models import closing, of_balance, of_ensemble

SHOWN = 12  # parameters of a design point


def report(ensemble: Ensemble, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return what is known of the outputs and parameters, what is not, and the estimated errors."""
    first = f"{path}: {ensemble.model} model, {counted(len(ensemble.status), 'sample')}; {ensemble.answer()}"
    return "\n".join([first, *lines_with_estimates(ensemble), *closing(ensemble.record, said)])


def report_of_shard(shard: ShardSamples, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return which samples are there, and what is left to do."""
    place, failed = shard.place, int(np.sum(shard.status != 0))
    first, last = place.first, place.first + len(shard.status)
    which = f"shard {place.number}/{place.count}, samples {first} to {last - 1} of {place.n_samples}"
    lines = [f"{path}: {shard.model} model, {which}", *(f"  {remark}" for remark in shard.found)]
    if failed:
        lines.append(f"  {failed} of {last - first} samples failed; pgmp merge says why")
    lines.append(f"  pgmp merge joins the files of all {place.count} shards and describes the samples")
    return "\n".join([*lines, *closing(shard.record, said)])


def lines_with_estimates(ensemble: Ensemble) -> list[str]:
    return [*lines_of(ensemble), *of_ensemble(ensemble), *of_balance(ensemble)]


def lines_of(ensemble: Ensemble) -> list[str]:
    lines = list(_moments(ensemble))
    if ensemble.outputs:
        lines += _quantiles(ensemble)
    if ensemble.probabilities:
        level = next(iter(ensemble.probabilities.values())).confidence
        lines.append(f"  probabilities, {percent(level)} intervals")
        for label, chance in ensemble.probabilities.items():
            shown = f"{'unknown':>14s}" if np.isnan(chance.estimate) else f"{chance.estimate:14.4g}"
            what = f"{chance.event}, {chance.count} of {chance.of}"
            lines.append(f"  {label:24s}{shown} {interval_text(chance.interval):26s}{what}")
            if not (np.isnan(chance.estimate) or chance.is_decided()):
                lines.append(f"  {'':24s}{chance.doubt()}")
    lines += _corrected(ensemble)
    if ensemble.stopping is not None:
        lines += ensemble.stopping.lines()
    lines += _sobol(ensemble)
    if any(band.count for band in ensemble.bands.values()):
        band = next(iter(ensemble.bands.values()))
        samples = f"{counted(band.count, 'sample')} at {band.time.size} instants"
        lines.append(f"  outputs over time: mean, deviation and quantiles of {samples}, in /bands")
    return lines


def _moments(ensemble: Ensemble) -> Iterator[str]:
    if not ensemble.statistics:
        return
    interval = f"{percent(next(iter(ensemble.statistics.values())).confidence)} interval"
    yield f"  {'':24s}{'mean':>14s} {interval:26s}{'deviation':>12s} {interval:26s}{'samples':>9s}"
    for name, s in ensemble.statistics.items():
        title = f"{name}: first passage" if name in ensemble.first_passages else name
        factor, unit = _unit(ensemble, name)
        ends, spread = factor * s.mean_interval, factor * s.std_interval
        mean = f"{number_text(factor * s.mean, ends, 7):>14s} {interval_text(ends):26s}"
        std = f"{number_text(factor * s.std, spread, 6):>12s} {interval_text(spread):26s}"
        if s.constant:
            mean, std = f"{factor * s.mean:14.7g} {'':26s}", f"{'constant':>12s} {'':26s}"
        elif not s.count:
            mean, std = f"{'none' if name in ensemble.without_passage else 'unknown':>14s} {'':26s}", f"{'':39s}"
        yield f"  {title:24s}{mean}{std}{s.count:9d} {unit}".rstrip()


def _quantiles(ensemble: Ensemble) -> Iterator[str]:
    failed = bool(np.any(ensemble.status != 0))
    known = [(name, ensemble.statistics[name]) for name in ensemble.outputs]
    bounded = [name for name, s in known if failed and np.isfinite(s.quantile_bounds).any()]
    known = [(name, s) for name, s in known if name in bounded or (s.count and not s.constant)]
    if known and known[0][1].probabilities.size:
        yield f"  quantiles at the end, {percent(known[0][1].confidence)} intervals of sampling"
    for name, s in known:
        factor, unit = _unit(ensemble, name)
        for k, (probability, quantile, ends) in enumerate(zip(s.probabilities, s.quantiles, s.quantile_intervals)):
            quantile, ends = factor * quantile, factor * ends
            shown = f"{number_text(quantile, ends, 6):>14s} {interval_text(ends, quantile):26s} {unit}"
            low, high = factor * s.quantile_bounds[k]
            below = "no bound below" if np.isinf(low) else f"at least {low:.6g}"
            above = "no bound above" if np.isinf(high) else f"at most {high:.6g}"
            bounds = f"; whatever the failed ones would have been {below}, {above}" if failed else ""
            yield f"  {name if k == 0 else '':24s}{f'{100 * probability:g} %':>9s}{shown}{bounds}".rstrip()


def _sobol(ensemble: Ensemble) -> Iterator[str]:
    for number, (name, found) in enumerate(ensemble.sobol.items()):
        interval = f"{percent(found.confidence)} interval"
        if not number:
            total = "" if found.total is None else f"{'total':>9s} {interval}"
            yield f"  {'Sobol indices':24s}{'':24s}{'first':>9s} {interval:26s}{total}".rstrip()
        for k, place in enumerate(np.argsort(-(found.first if found.total is None else found.total))):
            total = ""
            if found.total is not None:
                total = f"{found.total[place]:9.3f} {_fixed(found.total_interval[place])}"
            first = f"{found.first[place]:9.3f} {_fixed(found.first_interval[place]):26s}"
            yield f"  {name if k == 0 else '':24s}{found.parameters[place]:24s}{first}{total}".rstrip()


def _corrected(ensemble: Ensemble) -> Iterator[str]:
    joined = ensemble.joined
    if joined is None or not joined.corrected:
        return
    best, interval = joined.models[0], f"{percent(joined.confidence)} interval"
    for key, title in (("mean", "mean"), ("std", "deviation"), ("bias", f"{joined.models[-1]} less {best}"),
                       ("estimate", "probability")):  # fmt: skip
        having = {name: one for name, one in joined.corrected.items() if key in one.figures}
        if not having:
            continue
        n = int(next(iter(having.values())).counts[0])
        beside = "" if key == "bias" else f"against {n} samples of {best} alone"
        yield f"  {f'{best}: {title}':32s}{'':>6s} {interval:32s}{beside}".rstrip()
        for name, one in having.items():
            figure = one.figures[key]
            factor, unit = (1.0, "") if key == "estimate" else _unit(ensemble, name)
            estimate, ends = factor * figure.estimate, factor * figure.interval
            shown = f"{number_text(estimate, ends, 7):>14s} {interval_text(ends):26s}"
            times = "" if np.isnan(figure.narrower) else _times(figure.narrower)
            yield f"  {name:24s}{shown}{unit:6s}{times}".rstrip()


def _times(narrower: float) -> str:
    return f"{narrower:.2g} times narrower" if narrower >= 1.0 else f"{1 / narrower:.2g} times wider"


def _fixed(ends: np.ndarray) -> str:
    return f"[{ends[0]:.3f}, {ends[1]:.3f}]"


def _unit(ensemble: Ensemble, name: str) -> tuple[float, str]:
    """Return the unit that a quantity is read in, and how many of it the file's is; the same in all tables."""
    s = ensemble.statistics.get(name)
    factor, unit = axis_unit(ensemble.units.get(name, "1"), *(() if s is None or not s.count else (s.quantiles,)))
    return factor, "" if unit == "1" else unit


def report_of_rare_event(result: RareEvent, path: Path, said: Sequence[Remark] = ()) -> str:
    """Return the probability of a rare event, how it was found, and all remarks but those that were said before."""
    lines = [f"{path}: {result.model} model, {len(result.value)} samples", *lines_of_rare_event(result)]
    return "\n".join([*lines, *closing(result.record, said)])


def lines_of_rare_event(result: RareEvent) -> list[str]:
    """Return the levels and the probability of a rare event."""
    found = [*_levels(result, behind(result.unit)), *_probability(result), *_most_likely(result)]
    return [f"  rare event              {result.event}", *found]


def _levels(result: RareEvent, unit: str) -> Iterator[str]:
    if len(result.threshold):
        yield f"  {'level':>7s}{'of ' + result.output + unit:>32s}{'share':>10s}{'so far':>12s}{'accepted':>10s}"
    reached = np.cumprod(result.share)
    for k, (threshold, share, accepted) in enumerate(zip(result.threshold, result.share, result.accepted), 1):
        yield f"  {k:7d}{threshold:32.6g}{share:10.3f}{reached[k - 1]:12.3g}{accepted:10.2f}"


def _probability(result: RareEvent) -> Iterator[str]:
    if not result.reached:
        low, bound = result.interval
        if low > 0.0:
            yield f"  probability             {low:.3g} to {bound:.3g} ({100 * result.confidence:g} %): not decided"
            return
        most = f"at most {bound:.3g} ({100 * result.confidence:g} %)" if np.isfinite(bound) else "unknown"
        yield f"  probability             {most}: not reached"
        return
    low, high = result.interval
    n_weighted = int(np.count_nonzero(result.weight))
    known = f"a {100 * result.confidence:g} % interval; coefficient of variation {share_text(result.variation)}"
    yield f"  probability             {result.estimate:.4g} [{low:.4g}, {high:.4g}], {known}"
    as_good = (1.0 / result.estimate - 1.0) / result.variation**2 if result.variation > 0.0 else np.inf
    worth = f"  {n_weighted} weighted samples, worth {result.n_effective:.0f} equally weighted ones in the event"
    yield f"{worth}; as many random samples as are as good: {plain(as_good)}" if as_good > 0.0 else worth


def _most_likely(result: RareEvent) -> Iterator[str]:
    """Yield beta of every design point, and of the first one the values and shares of parameters, the largest first."""
    found = result.most_likely
    if found is None:
        unknown = "no derivatives, too few samples left, or values that step"
        why = unknown if result.reached else "the event was not reached"
        yield f"  design point            none found ({why})"
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
